//! The lease: up to which tick a plan is valid. The host extends it again and again. If it does not, all motors brake.
//!
//! # Terms
//! - A lease begins with a switch that carries one. With [`Lease::Off`] (motions in flash, verbs) a plan is valid
//!   without a time limit.
//! - [`Until`](Lease::Until) U: steps due before U are the plan's, none at U or later. An extension is accepted if U is not before the
//!   horizon. It may move U to an earlier tick. Steps after U are kept until the horizon reaches U, so that a later extension can still
//!   reach them.
//! - [`Last`](Lease::Last): the host has sent all of the plan. The lease needs no more extensions.
//! - Once the horizon passes U the lease has [lapsed](Lapse). All motors brake from U (see [`braking`](crate::braking)). Waiting items
//!   of their epoch are dropped, later ones are refused, and a switch that waits at U or later is cancelled. After that only a new
//!   switch, or the immediate stop, changes anything.
//!
//! # How a motor brakes
//! It begins with the interval of the step that it would have made next, in the direction of its motion; with nothing planned, with the
//! interval of its last step. It rests at once if it is *fresh*: an anchor, a wait or a reversal came after its last step. **Where
//! a motor's motion ends before those of others, the plan must end with a wait, of 0 ticks if need be**: a motor that has nothing
//! planned, and is not fresh, counts as one whose plan came too late.
//!
//! # One motor stops all
//! If a motor has nothing more to do before U, if bytes are no item, or if a step cannot be made, then that motor brakes at once, and
//! all others brake from the horizon. So the owner of several channels checks after each event whether one of them [has
//! lapsed](crate::Channel::has_unreported_lapse), and gives [the lapse of all](crate::channels::agreed_lapse) to each.

use crate::Tick32;

/// How long a plan is valid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lease {
    /// For as long as there is a plan: there is no lease.
    Off,
    /// For steps before this tick, which is less than 2^30 ticks ahead when it is set.
    Until(Tick32),
    /// To the plan's end. The host has sent all of it.
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
    /// Waiting bytes were no item, or a check failed.
    BadItem,
    /// A step came too late, or too soon after another.
    StepMissed,
}

impl LapseCause {
    /// Whether one motor's plan was wrong or came too late, rather than the lease of all.
    #[must_use]
    pub const fn is_fault(self) -> bool {
        matches!(self, LapseCause::Underrun | LapseCause::BadItem | LapseCause::StepMissed)
    }
}

/// The end of a lease that was not extended, or of a plan that cannot be followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lapse {
    /// Motors brake from this tick on. A motor that was itself the cause brakes earlier.
    pub at: Tick32,
    /// Why.
    pub cause: LapseCause,
}

/// Why an extension is refused, by all motors of a machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExtendRefused {
    /// There is no lease.
    Off,
    /// The lease has lapsed.
    Lapsed {
        /// The tick from which on motors brake.
        at: Tick32,
    },
    /// The tick is committed already.
    Late {
        /// The first tick that would be accepted now.
        horizon: Tick32,
    },
}
