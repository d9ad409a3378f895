//! Why a session cannot go on as it should.

use crate::pause::PauseError;
use pulsetrain_board::{RemoteError, SwitchRefused};
use pulsetrain_core::lease::LapseCause;
use pulsetrain_motion::LawError;
use pulsetrain_plan::Refused;

/// Why a session cannot begin, go on or change. The motors that are in motion brake within their limits then.
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
    /// The host stood still: what comes next was not sent in time.
    #[error(
        "this computer was too slow: at {at_s:.3} s the board had no more plan for motor {motor}, and stopped the motors gently; more came \
         {:.1} ms too late", 1e3 * .late_s
    )]
    Stopped {
        /// Index of the motor that had least.
        motor: usize,
        /// From when on the motors brake, s of the laws.
        at_s: f64,
        /// How much later the host looked after the board again, s.
        late_s: f64,
    },
    /// The board could not follow what it was told: a fault of the planner or the board, not of the motion.
    #[error("at {at_s:.3} s {}, and the board stopped the motors gently: please report it", in_words(*.cause))]
    Fault {
        /// From when on the motors brake, s of the laws.
        at_s: f64,
        /// What happened there.
        cause: LapseCause,
    },
    /// The board does not come to rest: a fault of the board, not of the motion.
    #[error("the motors should rest since {at_s:.3} s, but the board says that they still move: please report it")]
    Restless {
        /// When the last step was to be made, s of the laws.
        at_s: f64,
    },
    /// The board did not accept the beginning: this computer or the line needed too long to bring it. No motor moved.
    #[error("the beginning of the motion did not reach the board in time, and nothing moved")]
    NotBegun,
    /// The board did not accept a change.
    #[error("the change did not reach the board in time: {0}")]
    Switch(SwitchRefused),
    /// Nothing can be said to the board any more.
    #[error("the motion could not go on, so the motors brake: {0}")]
    Lost(RemoteError),
    /// A queue of the board ran short, or does not hold what a plan begins with.
    #[error(
        "at {at_s:.3} s the board's queue for motor {motor}, which takes {capacity}, was used up before more of the plan could be there"
    )]
    QueueTooShort {
        /// Index of the motor in the program.
        motor: usize,
        /// When, s of the laws.
        at_s: f64,
        /// Room in the empty queue.
        capacity: usize,
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
    /// A change while the board has not made the last one, or a pause at a tick of which it knows nothing yet.
    #[error("tick {at} cannot be changed yet; ask again from tick {until} on")]
    Waiting {
        /// Asked for.
        at: u64,
        /// From then on it can be asked for again, and may be refused again.
        until: u64,
    },
    /// A change in what the board was not told yet, or while the motors brake.
    #[error("tick {at} is too late for a change; after {latest} the motors brake, or nothing is told yet")]
    Late {
        /// Asked for.
        at: u64,
        /// Last tick at which a change joins the motion.
        latest: u64,
    },
}

/// Why a lease was over before its time, in words.
const fn in_words(cause: LapseCause) -> &'static str {
    match cause {
        LapseCause::NotExtended => "the lease was over",
        LapseCause::Ordered => "a stop was ordered",
        LapseCause::Underrun => "a motor had no more plan under its lease",
        LapseCause::BadItem => "the board could not read a part of the plan",
        LapseCause::StepMissed => "a step reached the board too late",
    }
}

impl From<PauseError> for SessionError {
    fn from(error: PauseError) -> SessionError {
        match error {
            PauseError::Law { motor, error } => SessionError::Law { motor, error },
            error @ PauseError::NoRoom { .. } => SessionError::Pause(error),
        }
    }
}
