//! What a running session can be told, and what it tells: plain values, so that a thread, a page or another program can hold it.
//!
//! ```
//! use pulsetrain_session::control::Command;
//! let line = serde_json::to_string(&Command::StopNow).unwrap();
//! assert_eq!(line, r#"{"command":"stop_now"}"#);
//! assert_eq!(serde_json::from_str::<Command>(&line).unwrap(), Command::StopNow);
//! ```

use crate::lateness::Lateness;
use serde::{Deserialize, Serialize};

/// What a session can be told while it runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "command", rename_all = "snake_case")]
pub enum Command {
    /// Bring all motors to a halt on their paths, as soon as their limits allow.
    Pause,
    /// Go on after a pause.
    Resume,
    /// Bring all motors to rest within their limits, as soon as possible. The motion is over then.
    Stop,
    /// Make no further step. A motor that is faster than its pull-in rate may go further than it counts.
    StopNow,
}

/// What a session tells. Times are seconds of the motion, from its begin on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The time that has passed.
    Progress {
        /// s.
        at_s: f64,
    },
    /// Where everything is.
    Status(Status),
    /// A pause begins; all motors rest from a time on.
    Pausing {
        /// s.
        rests_s: f64,
    },
    /// The motion goes on after a pause, and has its full speed from a time on.
    Resuming {
        /// s.
        full_speed_s: f64,
    },
    /// All motors brake within their limits from a time on.
    Stopping {
        /// s.
        at_s: f64,
    },
    /// No further step is made.
    StoppedAtOnce {
        /// Steps of each motor, as the board counted them.
        positions: Vec<i64>,
        /// Whether each motor was too fast for that, and may be elsewhere.
        uncertain: Vec<bool>,
    },
    /// A command was not obeyed, and the motion goes on as it was.
    Refused {
        /// Which.
        command: Command,
        /// Why not.
        why: String,
    },
}

/// Where a session is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// Time of the motion, s.
    pub at_s: f64,
    /// For how much longer the board moves the motors if it hears nothing more, s; `None`: to the end of the plan.
    pub lease_s: Option<f64>,
    /// The motors, in the file's order.
    pub motors: Vec<MotorStatus>,
    /// How late pulses were so far, where that is measured.
    pub lateness: Option<Lateness>,
}

/// Where a motor is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MotorStatus {
    /// Steps made, forward minus backward.
    pub position: i64,
    /// Where its law is, steps; `None` while the motor brakes for a stop.
    pub target: Option<f64>,
    /// The law's speed, steps/s.
    pub speed: Option<f64>,
    /// Room in its queue on the board, in the board's unit: free, and of the empty queue.
    pub queue: (usize, usize),
}
