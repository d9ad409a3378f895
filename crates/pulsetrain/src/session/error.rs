//! Why a session cannot go on as it should.

use crate::pause::PauseError;
use pulsetrain_board::{RemoteError, SwitchRefused};
use pulsetrain_motion::LawError;
use pulsetrain_plan::Refused;

/// Why a session cannot begin, go on or change; what the board was told before stands, and ends in a stop.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SessionError {
    /// The board still runs something else.
    #[error("the board is busy")]
    Busy,
    /// Program and board do not have the same motors or ticks.
    #[error("the program has {program} motors and the board {board}; they must match, and so must their ticks")]
    Motors {
        /// Motors of the program.
        program: usize,
        /// Motors of the board, or of the program before.
        board: usize,
    },
    /// The plan is refused.
    #[error("motor {}: {}", .0.motor, .0.error)]
    Plan(#[from] Refused),
    /// A law breaks where the host looks at it.
    #[error("motor {motor}: {error}")]
    Law {
        /// Index of the motor in the program.
        motor: usize,
        /// How.
        error: LawError,
    },
    /// The board did not accept what comes next: it was sent too late.
    #[error("what comes next did not reach the board in time, so the motors stop as planned: {0}")]
    Switch(SwitchRefused),
    /// Nothing can be said to the board any more.
    #[error("the motion could not go on, so the motors stop as planned: {0}")]
    Lost(RemoteError),
    /// The shortest part of the plan and its stop do not fit the board's queue.
    #[error(
        "motor {motor} at {at_s:.3} s: the next {:.1} ms and a stop take {needed} of its queue of {capacity}, where \
         {room} are free by then", 1e3 * .span_s
    )]
    QueueTooShort {
        /// Index of the motor in the program.
        motor: usize,
        /// When, s of the laws.
        at_s: f64,
        /// What is to be told at once, s: the shortest that is not over before the next can be told.
        span_s: f64,
        /// Room in the empty queue.
        capacity: usize,
        /// Items or bytes, as the board's queue is measured.
        needed: usize,
        /// In the same unit.
        room: usize,
    },
    /// The motion leaves no room for a pause, or for going on.
    #[error(transparent)]
    Pause(PauseError),
    /// Nothing was paused, or the motors were stopped since.
    #[error("the motion is not paused")]
    NotPaused,
    /// A change before the board can be told.
    #[error("tick {at} is too early for a change; the earliest is {earliest}")]
    Early {
        /// Asked for.
        at: u64,
        /// First tick that can still be changed.
        earliest: u64,
    },
    /// A change behind as many switches as the board can hold.
    #[error(
        "tick {at} cannot be changed yet: as many switches as the board holds come before it; the first of them is made at tick {until}"
    )]
    Waiting {
        /// Asked for.
        at: u64,
        /// From then on it can be asked for again; it may be refused again, as long as epochs come before it.
        until: u64,
    },
    /// A change in what is not planned yet, or during a stop.
    #[error("tick {at} is too late for a change; after {latest} the motors stop, or nothing is planned yet")]
    Late {
        /// Asked for.
        at: u64,
        /// Last tick at which a change joins the motion.
        latest: u64,
    },
}

impl From<PauseError> for SessionError {
    fn from(error: PauseError) -> SessionError {
        match error {
            PauseError::Law { motor, error } => SessionError::Law { motor, error },
            error @ PauseError::NoRoom { .. } => SessionError::Pause(error),
        }
    }
}
