//! What clients ask of a live motion, and what they hear of it: one set of values for the terminal, the control socket, OSC and the page.

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
    /// Take over a changed motion file.
    Motion {
        /// The text of the whole file.
        text: String,
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
    /// The motors had braked since the host or the line was too slow, and join the motion again.
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

/// What a client needs to know of a knob to show it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct KnobInfo {
    /// Its name.
    pub name: String,
    /// Its unit; empty for a bare number.
    pub unit: String,
    /// The least value, in its unit. `None` if the file gives none: then the laws and the motors' limits decide.
    pub least: Option<f64>,
    /// The greatest value, in its unit.
    pub greatest: Option<f64>,
    /// The value now, in its unit.
    pub value: f64,
}
