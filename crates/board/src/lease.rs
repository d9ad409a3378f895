//! How long a board's plan holds, as a host says it: ticks are 64 bits here. What it means is [`pulsetrain_core::lease`]'s.

use crate::{Board, SwitchRefused};
use pulsetrain_core::Epoch;
use pulsetrain_core::braking::Limit;
use pulsetrain_core::lease::LapseCause;

/// How long a plan holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lease {
    /// Up to this tick, without it.
    Until(u64),
    /// To its end, which has been told.
    Last,
}

/// What has become of a lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeaseState {
    /// There is none.
    Off,
    /// The plan holds up to this tick.
    Until(u64),
    /// The plan holds to its end.
    Last,
    /// It is over.
    Lapsed {
        /// Steps before it were the plan's.
        at: u64,
        /// Why.
        cause: LapseCause,
        /// Whether a motor was in motion, so far: else the motion had just ended.
        in_motion: bool,
    },
}

impl From<Lease> for LeaseState {
    fn from(lease: Lease) -> LeaseState {
        match lease {
            Lease::Until(until) => LeaseState::Until(until),
            Lease::Last => LeaseState::Last,
        }
    }
}

/// An extension that was refused: what was told before stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ExtendRefused {
    /// No switch has begun a lease.
    #[error("there is no lease to extend: a switch begins one")]
    Off,
    /// It is over: only a switch begins another.
    #[error("the lease ended at tick {at}: the motors brake, or rest")]
    Lapsed {
        /// Since then.
        at: u64,
    },
    /// A motor is committed beyond that tick.
    #[error("the board is committed up to tick {horizon}")]
    Late {
        /// The first tick that would be accepted now.
        horizon: u64,
    },
    /// The tick is 2^30 or more ahead of the board's time.
    #[error("the lease is too long: only ticks before {limit} can be told apart")]
    Early {
        /// First tick that is too far.
        limit: u64,
    },
    /// Nothing can be said to the board any more; what it was told stands. [`Board::lost`] says why.
    #[error("nothing can be said to the board any more")]
    Lost,
}

/// Items that were not taken back: all of them wait as before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TrimRefused {
    /// The new end of the lease is refused.
    #[error(transparent)]
    Extend(#[from] ExtendRefused),
    /// One of them is being done, or has been.
    #[error("motor {motor}: what is to be taken back has been begun")]
    Read {
        /// Index of the motor.
        motor: usize,
    },
}

/// A board whose plans hold by lease.
pub trait Leased: Board {
    /// Begins `epoch` at `tick`. All motors drop the rest of the old epoch then. The new plan holds as long as `lease` says.
    ///
    /// `limits` say how hard each motor may brake. A motor that has none there keeps the limit that it has.
    ///
    /// A step of the old epoch at `tick` or later is not made. One switch may wait: another one replaces it at its tick or before.
    ///
    /// # Errors
    /// All motors or none: when one refuses, the items of `epoch` are dropped, and the old plan goes on.
    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[Limit]) -> Result<(), SwitchRefused>;

    /// Puts the end of the lease off, or earlier, and gives the motors other limits, if there are any.
    ///
    /// A board at the end of a cable gets the extension behind all items that were pushed before. This call does not wait for the answer:
    /// [`extended`](Leased::extended) gives it. Until then [`lease`](Leased::lease) keeps its value. With several on their way, the board may refuse
    /// one and accept the next.
    ///
    /// # Errors
    /// All motors or none. A board at the end of a cable: what is known without asking it.
    fn extend(&mut self, lease: Lease, limits: &[Limit]) -> Result<(), ExtendRefused>;

    /// Takes back so many items from the end of each motor's queue; the plan that is left holds up to `until`.
    ///
    /// # Errors
    /// All motors or none. If the line breaks before the answer, the plan holds up to `until`, or as [`lease`](Leased::lease) says.
    fn trim(&mut self, until: u64, items: &[usize]) -> Result<(), TrimRefused>;

    /// All motors brake as soon as they can; gives the tick from which on. `None` if there is no lease, or the board is lost. If they brake
    /// already, or the lease ends sooner, that tick.
    fn brake(&mut self) -> Option<u64>;

    /// How long the plan holds, as far as the board has confirmed it.
    fn lease(&self) -> LeaseState;

    /// The board's next answer to an extension: whether it accepted it. `None` if no further answer has come. Each answer is given once, in the order
    /// of the extensions.
    fn extended(&mut self) -> Option<bool>;

    /// Waits until the board has answered all extensions, or is lost. A switch and a trim wait by themselves.
    fn await_extensions(&mut self) {}
}
