//! The lease: how long a plan holds. A host puts its end off again and again; if it does not, all motors brake.
//!
//! # Terms
//! - A lease begins with a switch that carries one. With [`Lease::Off`] (motions in flash, verbs) a plan holds as long as there is one.
//! - [`Until`](Lease::Until) U: steps due before U are the plan's, none at U or later. An extension is accepted if U is not before the
//!   horizon; it may be shorter. Nothing behind U is dropped before the horizon reaches U, so that a longer one restores it.
//! - [`Last`](Lease::Last): all has been told; the plan ends by itself.
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
//! # One for all
//! A motor that runs dry before U, items that are none, a step that cannot be made: that motor brakes at once, and all others from the
//! horizon. So whoever has several channels looks after each event whether one [has news](crate::Channel::has_news), and tells
//! [what is agreed](agreed) to all.

use crate::{Channel, Tick32};

/// How long a plan holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lease {
    /// As long as there is one.
    Off,
    /// Up to this tick, without it. Less than 2^30 ticks ahead when it is told.
    Until(Tick32),
    /// To its end, which has been told.
    Last,
}

/// Why motors brake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The lease was not put off in time.
    NotExtended,
    /// The host said so.
    Ordered,
    /// A motor had nothing more to do before the lease's end.
    RanDry,
    /// What waited was no item, or a check failed.
    BadItem,
    /// A step came too late, or too soon after another.
    StepMissed,
}

impl Cause {
    /// Whether the plan was at fault, or came too late.
    #[must_use]
    pub const fn is_fault(self) -> bool {
        matches!(self, Cause::RanDry | Cause::BadItem | Cause::StepMissed)
    }
}

/// A lease that is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lapse {
    /// Steps before it are the plan's. A motor that was at fault brakes earlier.
    pub at: Tick32,
    /// Why.
    pub cause: Cause,
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

/// The latest of all channels' horizons: the first tick that none has committed.
pub fn horizon<'a, const F: u32>(channels: impl Iterator<Item = &'a Channel<F>>) -> Option<Tick32> {
    channels.map(Channel::horizon).reduce(Tick32::or_later)
}

/// What all channels are to be [told](Channel::lapse_at), if one of them has news.
pub fn agreed<'a, const F: u32>(channels: impl Iterator<Item = &'a Channel<F>> + Clone) -> Option<Lapse> {
    let open = horizon(channels.clone())?;
    let news = channels.filter(|channel| channel.has_news()).filter_map(Channel::lapse);
    let since = |lapse: Lapse| if lapse.cause.is_fault() { Lapse { at: open, ..lapse } } else { lapse };
    news.map(since).reduce(|one, other| {
        let at = if other.at.is_before(one.at) { other.at } else { one.at };
        Lapse { at, cause: if one.cause.is_fault() { one.cause } else { other.cause } }
    })
}
