//! Commands to a running session, and its events and status, as plain values: a thread, a web page or another program can send and receive them.
//!
//! ```
//! use pulsetrain_session::control::Command;
//! let line = serde_json::to_string(&Command::StopNow).unwrap();
//! assert_eq!(line, r#"{"command":"stop_now"}"#);
//! assert_eq!(serde_json::from_str::<Command>(&line).unwrap(), Command::StopNow);
//! ```

use crate::lateness::Lateness;
use serde::{Deserialize, Serialize};

/// A command to a running session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "command", rename_all = "snake_case")]
pub enum Command {
    /// Bring all motors to a halt on their paths, as soon as their limits allow.
    Pause,
    /// Go on after a pause.
    Resume,
    /// Bring all motors to rest within their limits, as soon as possible. The motion is over then.
    Stop,
    /// Make no further step. A motor that is faster than its pull-in rate may turn further than it counts.
    StopNow,
}

/// An event of a running session. Times are seconds from the begin of the motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// Time has passed.
    Progress {
        /// Time of the motion, s.
        at_s: f64,
    },
    /// The state of all motors, of the lease and of the lateness.
    Status(Status),
    /// A pause begins.
    Pausing {
        /// When all motors rest, s.
        rests_s: f64,
    },
    /// The motion goes on after a pause.
    Resuming {
        /// When it has its full speed, s.
        full_speed_s: f64,
    },
    /// All motors come to rest within their limits.
    Stopping {
        /// When they begin to brake, s.
        at_s: f64,
    },
    /// No further step is made.
    StoppedAtOnce {
        /// Steps of each motor, as the board counted them.
        positions: Vec<i64>,
        /// For each motor: whether it was too fast to stop at once, and may stand elsewhere than it counted.
        uncertain: Vec<bool>,
    },
    /// A command was not obeyed, and the motion goes on as it was.
    Refused {
        /// The refused command.
        command: Command,
        /// Why it was refused, for the user.
        why: String,
    },
}

/// The state of a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Time of the motion, s.
    pub at_s: f64,
    /// For how much longer the board follows the plan if it gets nothing more, s. `None` if it has the whole plan.
    pub lease_s: Option<f64>,
    /// The motors, in the file's order.
    pub motors: Vec<MotorStatus>,
    /// How late the STEP edges were so far, where that is measured.
    pub lateness: Option<Lateness>,
}

/// The state of a motor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotorStatus {
    /// Steps made, forward minus backward.
    pub position: i64,
    /// The position of its law, steps; `None` while the motor brakes for a stop.
    pub target: Option<f64>,
    /// The law's speed, steps/s; `None` while the motor brakes for a stop.
    pub speed: Option<f64>,
    /// Room in its queue on the board, in the board's unit: now, and when the queue is empty.
    pub queue: (usize, usize),
}
