//! The lease: how long a plan holds. A host puts its end off again and again; if it does not, all motors brake.
//!
//! # Terms
//! - A lease begins with a switch that carries one. With [`Lease::Off`] (motions in flash, verbs) a plan is valid
//!   without a time limit.
//! - [`Until`](Lease::Until) U: steps due before U are the plan's, none at U or later. An extension is accepted if U is not before the
//!   horizon; it may be shorter. Nothing behind U is dropped before the horizon reaches U, so that a longer one restores it.
//! - [`Last`](Lease::Last): the host has sent all of the plan, which ends by itself.
//! - Once the horizon passes U the lease has [lapsed](Lapse). All motors brake from U (see [`braking`](crate::braking)), what waits of
//!   their epoch is dropped, and what comes of it later is not kept. So is a switch that waits at U or later. Only another switch,
//!   or the immediate stop, ends that.
//!
//! # How a motor brakes
//! From the interval before the step that it would have made next, in the direction that it goes; with nothing planned, from the
//! interval before its last step once more. It rests at once if it is *fresh*: an anchor, a wait or a
//! reversal came after its last step. **A motor whose motion ends before that of others says so by a wait, of 0 ticks if need be**: one
//! that has nothing planned, and is not fresh, has run dry.
//!
//! # One motor stops all
//! If a motor has nothing more to do before U, if bytes are no item, or if a step cannot be made, then that motor
//! brakes at once and all others brake from the horizon. So the owner of several channels checks after each event
//! whether one of them [has news](crate::Channel::has_news), and passes [what is agreed](crate::channels::agreed_lapse)
//! to all.

use crate::Tick32;

/// How long a plan holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lease {
    /// As long as there is one.
    Off,
    /// Up to this tick, without it. Less than 2^30 ticks ahead when it is set.
    Until(Tick32),
    /// To its end, which the host has sent.
    Last,
}

/// Why motors brake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LapseCause {
    /// The host did not extend the lease in time.
    NotExtended,
    /// The host ordered it.
    Ordered,
    /// A motor had nothing more to do before the lease's end.
    Underrun,
    /// The waiting bytes were no item, or a check failed.
    BadItem,
    /// A step came too late, or too soon after another.
    StepMissed,
}

impl LapseCause {
    /// Whether the plan was at fault, or came too late.
    #[must_use]
    pub const fn is_fault(self) -> bool {
        matches!(self, LapseCause::Underrun | LapseCause::BadItem | LapseCause::StepMissed)
    }
}

/// A lease that is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lapse {
    /// Steps before it are the plan's. A motor that was at fault brakes earlier.
    pub at: Tick32,
    /// Why.
    pub cause: LapseCause,
}

/// An extension that is refused, by all motors of a machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExtendRefused {
    /// There is no lease.
    Off,
    /// It is over.
    Lapsed {
        /// Since then.
        at: Tick32,
    },
    /// The tick is committed already.
    Late {
        /// The first tick that would be accepted now.
        horizon: Tick32,
    },
}
