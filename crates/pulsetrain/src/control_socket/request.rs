//! What clients ask of a live motion, and what they hear of it: one set of values for the terminal, the control socket, OSC and the page.

use std::collections::BTreeMap;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use pulsetrain_session::control::{Command, Event};

/// What a client asks of a motion that runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Request {
    /// Pause, resume, tempo, stop: every run obeys these.
    Session(Command),
    /// A change of the motion itself: only `pulsetrain live` obeys these.
    Live(LiveCommand),
    /// Several changes that act as one: only `pulsetrain live` obeys these.
    Together(Together),
}

/// Requests that make one change of the motion, with one first tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Together {
    /// In the order in which they count; none of them is such a list itself.
    pub together: Vec<Request>,
    /// When the change begins, s of the motion. `None`, or a time that is past: as soon as it can.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_s: Option<f64>,
}

impl Request {
    /// One request for all of these.
    #[must_use]
    pub fn together(mut requests: Vec<Request>, at_s: Option<f64>) -> Request {
        match requests.pop() {
            Some(only) if requests.is_empty() && at_s.is_none() => only,
            last => {
                requests.extend(last);
                Request::Together(Together { together: requests, at_s })
            }
        }
    }

    /// The requests of a list, or this one alone.
    #[must_use]
    pub fn each(self) -> Vec<Request> {
        match self {
            Request::Together(Together { together, .. }) => together.into_iter().flat_map(Request::each).collect(),
            one => vec![one],
        }
    }
}

/// A change of a live motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "command", rename_all = "snake_case")]
pub enum LiveCommand {
    /// Turn a knob. The motors change to the new motion within their limits.
    Set {
        /// Its name in `[live.knobs]`, or MOTOR.PARAMETER.
        knob: String,
        /// Its new value.
        value: KnobValue,
    },
    /// Go to the next cue.
    Go,
    /// Go to the cue before this one.
    Back,
    /// Go to a cue.
    Cue {
        /// Its name.
        name: String,
    },
    /// Bring all motors to rest at a position.
    Goto {
        /// A position with its unit, or `0`: where the motion began. [`Command::Resume`] goes on with the motion.
        position: String,
    },
    /// Let the motion begin, from its beginning. The motors must have been brought to rest, by `Goto` or `Rest`.
    Begin,
    /// Bring all motors to rest until it is time for the motion: `Begin`, or after a rest in place [`Command::Resume`].
    Rest {
        /// Whether they rest where they are on their paths; else where the motion begins.
        in_place: bool,
        /// When the motion begins, in words; empty if no time is set.
        until: String,
    },
    /// Say where motors stand, when their positions are unknown.
    Here {
        /// The motor; `None`: all.
        motor: Option<String>,
        /// A position with its unit; `0` or `start`: where the motion begins; `last`: where they were when they were known last.
        position: String,
    },
    /// Take over a changed motion file.
    Motion {
        /// The text of the whole file.
        text: String,
        /// Texts of files that it names, such as CSV files, by the names that it gives them. What is left out stays as it was read last.
        #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
        files: BTreeMap<PathBuf, String>,
    },
}

/// The value of a knob: a number in the knob's own unit, or text with a unit such as "0.9 Hz".
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum KnobValue {
    /// In the knob's unit.
    Number(f64),
    /// With its own unit.
    Text(String),
}

/// What happens to a motion that runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Happened {
    /// An event of the session.
    Session(Event),
    /// A change of the motion itself.
    Live(LiveEvent),
}

/// An event of a live motion. Times are seconds from the begin of the motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum LiveEvent {
    /// A knob was turned.
    Set {
        /// Its name.
        knob: String,
        /// Its new value, in its unit.
        value: f64,
        /// Its unit.
        unit: String,
        /// The limit that a value nearer to the wanted one would break, if that is why it is not the wanted one.
        ceiling: Option<String>,
        /// When the motors begin to change, and when they follow the new motion, s.
        from_s: f64,
        /// See `from_s`.
        until_s: f64,
    },
    /// A cue began.
    Cue {
        /// Its name.
        name: String,
        /// When the motors begin to change, and when they follow the cue, s.
        from_s: f64,
        /// See `from_s`.
        until_s: f64,
    },
    /// The motors go to a position, and rest there.
    Goto {
        /// The position, as it was asked for.
        position: String,
        /// When they begin to change, and when they rest, s.
        from_s: f64,
        /// See `from_s`.
        until_s: f64,
    },
    /// The motors leave the position to which they were sent, and follow the motion again.
    Returned {
        /// When they begin to change, and when they follow the motion, s.
        from_s: f64,
        /// See `from_s`.
        until_s: f64,
    },
    /// The motion begins, from its beginning.
    Began {
        /// When the motors begin to move, and when they follow the motion, s.
        from_s: f64,
        /// See `from_s`.
        until_s: f64,
    },
    /// The answer to `begin` or `resume` while the motion runs: it goes on as it is.
    AlreadyRuns,
    /// All motors have come to the end of the motion, and rest there. The motion can begin again, or be changed.
    MotionEnded {
        /// When that was seen, s.
        at_s: f64,
    },
    /// It is not time for the motion: the motors rest, or come to rest.
    Resting {
        /// When the motion begins, in words; empty if no time is set.
        until: String,
    },
    /// The board cannot be reached any more: its cable was pulled, say. The motors brake within their limits, and the run waits for the board.
    Unplugged {
        /// What failed.
        why: String,
        /// The port for which the run waits.
        port: String,
    },
    /// The positions of motors are unknown. The run waits for [`LiveCommand::Here`].
    Unplaced {
        /// Why not.
        why: String,
        /// The motors.
        motors: Vec<String>,
        /// Where they stood when they were known last, if they rested there.
        last: Vec<String>,
    },
    /// Somebody said where motors stand.
    Placed {
        /// The motors.
        motors: Vec<String>,
        /// The position, as it was said.
        position: String,
    },
    /// A changed motion file was taken over.
    Motion {
        /// When the motors begin to change, and when they follow the new motion, s.
        from_s: f64,
        /// See `from_s`.
        until_s: f64,
    },
    /// A changed motion file was not taken over. The motion goes on as it was.
    MotionRefused {
        /// What is wrong.
        error: String,
        /// Where, if that is known: the line from 1, and the column from 1.
        line: Option<u32>,
        /// See `line`.
        column: Option<u32>,
    },
    /// The planner refused a part of the motion, long after a change that it had allowed. The motors braked; now they join the motion before that change, or
    /// an earlier one.
    TakenBack {
        /// What was refused.
        why: String,
        /// No earlier motion keeps to the limits: the motors rest where they stand.
        #[serde(default)]
        rests: bool,
        /// When they begin to, s.
        from_s: f64,
        /// When they follow it, s.
        until_s: f64,
    },
    /// A change for a time of the motion began later than that, since it was asked for too late, or another change was under way.
    Late {
        /// The time for which it was, s of the motion.
        wanted_s: f64,
        /// How much later it began, s.
        by_s: f64,
    },
    /// The motors had braked since the host or the line was too slow, or the cable was pulled. They join the motion again.
    Rejoined {
        /// When they begin to, s.
        from_s: f64,
        /// When they follow the motion, s.
        until_s: f64,
        /// How many times that has happened.
        times: u32,
    },
    /// A command was not obeyed, and the motion goes on as it was.
    Refused {
        /// The refused command.
        command: LiveCommand,
        /// Why it was refused.
        why: String,
    },
}

impl LiveEvent {
    /// When the motors begin to change, s; `None` if they do not.
    #[must_use]
    pub const fn changes_from_s(&self) -> Option<f64> {
        match self {
            LiveEvent::Set { from_s, .. }
            | LiveEvent::Cue { from_s, .. }
            | LiveEvent::Goto { from_s, .. }
            | LiveEvent::Returned { from_s, .. }
            | LiveEvent::Began { from_s, .. }
            | LiveEvent::Motion { from_s, .. }
            | LiveEvent::TakenBack { from_s, .. }
            | LiveEvent::Rejoined { from_s, .. } => Some(*from_s),
            LiveEvent::AlreadyRuns
            | LiveEvent::MotionEnded { .. }
            | LiveEvent::Resting { .. }
            | LiveEvent::Unplugged { .. }
            | LiveEvent::Unplaced { .. }
            | LiveEvent::Placed { .. }
            | LiveEvent::MotionRefused { .. }
            | LiveEvent::Late { .. }
            | LiveEvent::Refused { .. } => None,
        }
    }
}

/// What a client needs to know of a knob to show it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct KnobInfo {
    /// Its name.
    pub name: String,
    /// The number of a law that it sets, MOTOR.KEY.
    #[serde(default)]
    pub target: String,
    /// Its unit; empty for a bare number.
    pub unit: String,
    /// The least value, in its unit. `None` if the file gives none: then the laws and the motors' limits decide.
    pub least: Option<f64>,
    /// The greatest value, in its unit.
    pub greatest: Option<f64>,
    /// The value now, in its unit.
    pub value: f64,
}
