//! The lease: up to which tick a board may follow its plan, from the host's side, with 64-bit ticks. [`pulsetrain_core::lease`] has the rules.

use crate::{Board, SwitchRefused};
use pulsetrain_core::Epoch;
use pulsetrain_core::braking::Limit;
use pulsetrain_core::lease::LapseCause;

/// How long a board may follow its plan without hearing from the host. At the end of a lease all motors brake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lease {
    /// Up to this tick, exclusive.
    Until(u64),
    /// To the plan's end, which the board has.
    Last,
}

/// The state of a board's lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeaseState {
    /// There is no lease.
    Off,
    /// The plan holds up to this tick.
    Until(u64),
    /// The plan holds to its end.
    Last,
    /// The lease is over: the motors brake or rest.
    Lapsed {
        /// Steps before this tick were the plan's; later ones are the stop's.
        at: u64,
        /// Why it is over.
        cause: LapseCause,
        /// Whether a motor is known to have been in motion then. If not, the motion had just ended, or the board has not reported it yet.
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

/// Why an extension was refused. The lease before it stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ExtendRefused {
    /// No switch has begun a lease.
    #[error("there is no lease to extend: a switch begins one")]
    Off,
    /// The lease is over: only a switch begins a new one.
    #[error("the lease ended at tick {at}: the motors brake, or rest")]
    Lapsed {
        /// The tick at which it ended.
        at: u64,
    },
    /// A motor is committed beyond the new end.
    #[error("the board is committed up to tick {horizon}")]
    Late {
        /// The first tick that would be accepted now.
        horizon: u64,
    },
    /// The tick is 2^30 or more ahead of the board's time.
    #[error("the lease is too long: only ticks before {limit} can be told apart")]
    Early {
        /// The first tick that is too far ahead.
        limit: u64,
    },
    /// The board can no longer be reached; the lease that it has stands. [`Board::lost`] says why.
    #[error("nothing can be said to the board any more")]
    Lost,
}

/// Why items were not taken back. All of them stay in their queues.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TrimRefused {
    /// The new end of the lease is refused.
    #[error(transparent)]
    Extend(#[from] ExtendRefused),
    /// A motor has begun one of the items already.
    #[error("motor {motor}: what is to be taken back has been begun")]
    Read {
        /// Index of the motor.
        motor: usize,
    },
}

/// A board whose plans hold by lease.
pub trait Leased: Board {
    /// Begins `epoch` at `tick` on all motors, with the given lease. They drop the rest of the old epoch: none of its steps at `tick` or later is
    /// made.
    ///
    /// `limits` say how hard each motor may brake. A motor beyond their number keeps its limit.
    ///
    /// One switch may wait for its tick. A further switch for the same tick or an earlier one replaces it.
    ///
    /// # Errors
    /// When one motor refuses, none switches: the items of `epoch` are dropped, and the old plan goes on.
    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[Limit]) -> Result<(), SwitchRefused>;

    /// Moves the end of the lease, and sets new braking limits for the motors that have one in `limits`.
    ///
    /// A board at the end of a cable gets the extension after all items that were pushed before. This call does not wait for the answer, which
    /// [`extended`](Leased::extended) gives; until then [`lease`](Leased::lease) keeps its value. If several extensions are on their way, the board
    /// may refuse one and accept the next.
    ///
    /// # Errors
    /// When one motor refuses, nothing changes. For a board at the end of a cable, only what is known without an answer is an error here.
    fn extend(&mut self, lease: Lease, limits: &[Limit]) -> Result<(), ExtendRefused>;

    /// Removes the last `items[m]` items of each motor's queue, and ends the lease at `until`.
    ///
    /// # Errors
    /// When one motor refuses, nothing changes. If the line breaks before the answer, the lease ends at `until` or where [`lease`](Leased::lease) says.
    fn trim(&mut self, until: u64, items: &[usize]) -> Result<(), TrimRefused>;

    /// Orders all motors to brake, and returns the tick from which they do: an earlier one if they brake already or the lease ends sooner. `None` if
    /// there is no lease or the board is lost.
    fn brake(&mut self) -> Option<u64>;

    /// The lease, as far as the board has confirmed it.
    fn lease(&self) -> LeaseState;

    /// The board's next answer to an extension: whether the board accepted it. Answers come once each, in the order of the extensions; `None` if there
    /// is no further one yet.
    fn extended(&mut self) -> Option<bool>;

    /// Waits until the board has answered all extensions or is lost. [`switch`](Leased::switch) and [`trim`](Leased::trim) do so by themselves.
    fn await_extensions(&mut self) {}
}
