//! Commands to a running session, and its events and status, as plain values: a thread, a web page or another program can send and receive them.
//!
//! ```
//! use pulsetrain_session::control::Command;
//! let line = serde_json::to_string(&Command::StopNow).unwrap();
//! assert_eq!(line, r#"{"command":"stop_now"}"#);
//! assert_eq!(serde_json::from_str::<Command>(&line).unwrap(), Command::StopNow);
//! ```

use crate::lateness::Lateness;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A command to a running session.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "command", rename_all = "snake_case")]
pub enum Command {
    /// Bring all motors to a halt on their paths, as soon as their limits allow.
    Pause,
    /// Go on after a pause.
    Resume,
    /// Let the motion run at another tempo, as soon as the limits allow. All motors keep their paths and phases.
    Tempo {
        /// The rate of the motion's time: 1 is that of the file, 0.5 half as fast. More than 0, and at most 10.
        rate: f64,
    },
    /// Bring all motors to rest within their limits, as soon as possible. The motion is over then.
    Stop,
    /// Make no further step. A motor that is faster than its pull-in rate may turn further than it counts.
    StopNow,
}

/// An event of a running session. Times are seconds from the begin of the motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
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
    /// The tempo changes. While the motion is paused, this is the tempo at which it will go on.
    Tempo {
        /// The new rate of the motion's time. If motors or board cannot follow the wanted one, the highest that they can.
        rate: f64,
        /// When the motion has it, s.
        from_s: f64,
        /// The motor or the machine, and its limit that a higher rate would break, if that is why the rate is not the wanted one.
        ceiling: Option<String>,
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
    /// The motion has come to its end, or was stopped. This is the last event.
    Ended(Ended),
    /// The motors stopped before the motion's end, without an order. This is the last event.
    Failed {
        /// The reason, for the user.
        why: String,
        /// When the motors began to brake, s, if that is known.
        at_s: Option<f64>,
        /// Where the motors are, if they moved.
        positions: Option<Positions>,
        /// What the user can do, if something is known to help.
        advice: Option<String>,
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
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
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MotorStatus {
    /// Steps made, forward minus backward.
    pub position: i64,
    /// The position of its law, steps, counted as `position` is; `None` while the motor brakes for a stop.
    pub target: Option<f64>,
    /// The law's speed, steps/s; `None` while the motor brakes for a stop.
    pub speed: Option<f64>,
    /// Room in its queue on the board, in the board's unit: now, and when the queue is empty.
    pub queue: (usize, usize),
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Ended {
    /// Steps of each motor, forward minus backward, as the board counted them.
    pub counted: Vec<i64>,
    /// It was stopped before its end, within the motors' limits.
    pub stopped: bool,
    /// If it was stopped at once: for each motor, whether it was too fast for that and may stand elsewhere than it counted.
    pub uncertain: Option<Vec<bool>>,
}

/// Where the motors are after a run that failed, and how that is known.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Positions {
    /// Each motor's name and its steps forward minus backward since the board was set up.
    pub motors: Vec<(String, i64)>,
    /// How the steps are known.
    pub by: Knowledge,
}

/// How the positions of motors are known, the surest way first.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "by", rename_all = "snake_case")]
pub enum Knowledge {
    /// The board counted them; they came to rest within their limits.
    Counted,
    /// The board counted them, and stopped them at once. A motor that was faster than its pull-in rate may have turned further than it counted.
    StoppedAtOnce,
    /// The board cannot be reached. The host computed them from what it had sent.
    Replayed {
        /// Other places where the motors may be: one for each message that the board may not have received. Empty if no answer was missing.
        or: Vec<Vec<i64>>,
    },
    /// The line broke before the board answered an order to brake. The counts are the last that the board reported.
    StopUnanswered,
    /// The board restarted and has lost its count. These are the last counts that it reported before.
    LastReport {
        /// Why it restarted, in words.
        reset: String,
    },
}

impl Positions {
    /// What the user has to do before the next run.
    pub(crate) const fn advice(&self) -> &'static str {
        match self.by {
            Knowledge::Counted => "the next run counts from here: move the motors to their start position first",
            Knowledge::StoppedAtOnce => {
                "nothing moves until the next run. Look where the motors are: one that was stopped at speed may have turned further than the \
                 board counted. `pulsetrain info --port PORT` shows the board's counters"
            }
            Knowledge::Replayed { .. } | Knowledge::StopUnanswered => {
                "look at the cable and at the board's supply. The motors brake within half a second, and nothing moves until the \
                 next run. An Uno that lost its supply, or whose port was opened again, was reset: look where the motors are"
            }
            Knowledge::LastReport { .. } => {
                "the positions of the motors are not known. Nothing moves until the next run: move the motors to their start position first. Then find \
                 out what reset the board: its supply, or another program that opened its port"
            }
        }
    }
}

impl std::fmt::Display for Positions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let list = |counts: &[i64]| {
            let each = self.motors.iter().zip(counts).map(|((name, _), steps)| format!("{name} at {steps} steps"));
            each.collect::<Vec<_>>().join(", ")
        };
        let counts: Vec<i64> = self.motors.iter().map(|(_, steps)| *steps).collect();
        let motors = list(&counts);
        match &self.by {
            Knowledge::Counted => write!(f, "the motors braked and stand still: {motors}, as the board counted"),
            Knowledge::StoppedAtOnce => write!(f, "the motors were stopped at once: {motors}, as the board counted"),
            Knowledge::Replayed { or } => {
                write!(
                    f,
                    "the board does not answer, so these positions are calculated from the plan that it has: the motors brake and come to rest at {motors}"
                )?;
                if or.is_empty() {
                    return Ok(());
                }
                let each: Vec<String> = or.iter().map(|counts| list(counts)).collect();
                write!(f, ". If the last messages did not reach the board: {}", each.join(", or "))
            }
            Knowledge::StopUnanswered => write!(
                f,
                "the board was sent the order to stop and did not answer. Its last report: {motors}. The motors have come to rest since then, within \
                 their limits, but their positions are not known"
            ),
            Knowledge::LastReport { reset } => write!(
                f,
                "the board restarted during the motion ({}) and lost its count. Its last report: {motors}. The motors stopped at \
                 once, soon after that",
                reset
            ),
        }
    }
}
