//! Why a session cannot go on as it should.

use crate::pause::PauseError;
use pulsetrain_board::{RemoteError, SwitchRefused};
use pulsetrain_core::lease::LapseCause;
use pulsetrain_motion::LawError;
use pulsetrain_plan::Refused;

/// Why a session cannot begin, go on or change. Motors that are in motion and get no more of a plan brake within their limits.
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
    /// The planner refuses a motor's law: it breaks a limit.
    #[error("motor {}: {}", .0.motor, .0.error)]
    Plan(#[from] Refused),
    /// A law cannot be evaluated where the host needs it.
    #[error("motor {motor}: {error}")]
    Law {
        /// Index of the motor in the program.
        motor: usize,
        /// Why it cannot be evaluated.
        error: LawError,
    },
    /// The host was too slow: the next part of the plan was not sent in time.
    #[error(
        "this computer was too slow: at {at_s:.3} s the board had no more plan for motor {motor}, and stopped the motors gently; more came \
         {:.1} ms too late", 1e3 * .late_s
    )]
    Stopped {
        /// Index of the motor whose plan on the board ended soonest.
        motor: usize,
        /// From when on the motors brake, s of the laws.
        at_s: f64,
        /// How long after that the host filled the queues again, s.
        late_s: f64,
    },
    /// The board could not follow the plan: a fault of the planner or the board, not of the motion.
    #[error("at {at_s:.3} s {}, and the board stopped the motors gently: please report it", in_words(*.cause))]
    Fault {
        /// From when on the motors brake, s of the laws.
        at_s: f64,
        /// The board's reason.
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
    /// The board can no longer be reached.
    #[error("the motion could not go on, so the motors brake: {0}")]
    Lost(RemoteError),
    /// A queue of the board is too short: it ran empty before more could be there, or it does not hold the beginning of a plan.
    #[error(
        "at {at_s:.3} s the board's queue for motor {motor}, which takes {capacity}, was used up before more of the plan could be there"
    )]
    QueueTooShort {
        /// Index of the motor in the program.
        motor: usize,
        /// When it ran empty, s of the laws.
        at_s: f64,
        /// Room in the empty queue, in the board's unit (bytes on a board with a firmware).
        capacity: usize,
    },
    /// The motion needs all that the motors can do: there is no room for a pause, or for a resumption.
    #[error(transparent)]
    Pause(PauseError),
    /// The wanted tempo is no rate.
    #[error(
        "a tempo is a number above 0, and at most 10: 1 is as the file has it; to halt the motors, pause the motion"
    )]
    NoTempo,
    /// The motion is not paused, or its motors were stopped during the pause.
    #[error("the motion is not paused")]
    NotPaused,
    /// A change at a tick that is too near: it cannot reach the board in time.
    #[error("it is too soon: a change at that time cannot reach the board before it")]
    Early {
        /// The tick of the change, or of the begin.
        at: u64,
        /// First tick that can still be changed.
        earliest: u64,
    },
    /// A change while another one waits for its tick, or a pause at a tick for which nothing was sent yet.
    #[error("another change has not begun yet, or the board has no plan for that time yet: try again later")]
    Waiting {
        /// The tick of the change, or of the begin.
        at: u64,
        /// From this tick on it can be tried again. It may be refused again.
        until: u64,
    },
    /// A change at a tick for which nothing was sent yet, or while the motors brake.
    #[error("it is too late: the motors brake or rest by then, or the board has no plan for that time yet")]
    Late {
        /// The tick of the change, or of the begin.
        at: u64,
        /// Last tick at which a change joins the motion.
        latest: u64,
    },
}

/// Why a lease ended early, for messages.
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
            error @ (PauseError::NoRoom { .. } | PauseError::Parting { .. }) => SessionError::Pause(error),
        }
    }
}
