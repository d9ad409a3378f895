//! What clients ask of a motion that runs: one type for the terminal, the control socket, OSC, MIDI and the page.

use std::collections::BTreeMap;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use pulsetrain_session::control::Command;

/// What a client asks of a motion that runs. Every run takes those of a session: pause, resume, tempo, stop. Only a live motion takes the others.
///
/// ```
/// use pulsetrain_live::RunCommand;
/// let line = serde_json::to_string(&RunCommand::Cue { name: "dawn".to_owned() }).unwrap();
/// assert_eq!(line, r#"{"command":"cue","name":"dawn"}"#);
/// assert_eq!(serde_json::from_str::<RunCommand>(r#"{"command":"stop"}"#).unwrap(), RunCommand::Stop);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "command", rename_all = "snake_case")]
pub enum RunCommand {
    /// Bring all motors to a halt on their paths, as soon as their limits allow.
    Pause,
    /// Go on after a pause, or leave the position to which the motors were sent.
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
        /// A position with its unit, or `0`: where the motion began. [`RunCommand::Resume`] goes on with the motion.
        position: String,
    },
    /// Let the motion begin, from its beginning. The motors must have been brought to rest, by [`RunCommand::Goto`] or [`RunCommand::Rest`].
    Begin,
    /// Bring all motors to rest until it is time for the motion: [`RunCommand::Begin`], or after a rest in place [`RunCommand::Resume`].
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

impl From<Command> for RunCommand {
    fn from(command: Command) -> RunCommand {
        match command {
            Command::Pause => RunCommand::Pause,
            Command::Resume => RunCommand::Resume,
            Command::Tempo { rate } => RunCommand::Tempo { rate },
            Command::Stop => RunCommand::Stop,
            Command::StopNow => RunCommand::StopNow,
        }
    }
}

impl RunCommand {
    /// The same for a session; `None` if only a live motion takes it.
    #[must_use]
    pub const fn of_session(&self) -> Option<Command> {
        match self {
            RunCommand::Pause => Some(Command::Pause),
            RunCommand::Resume => Some(Command::Resume),
            RunCommand::Tempo { rate } => Some(Command::Tempo { rate: *rate }),
            RunCommand::Stop => Some(Command::Stop),
            RunCommand::StopNow => Some(Command::StopNow),
            RunCommand::Set { .. }
            | RunCommand::Go
            | RunCommand::Back
            | RunCommand::Cue { .. }
            | RunCommand::Goto { .. }
            | RunCommand::Begin
            | RunCommand::Rest { .. }
            | RunCommand::Here { .. }
            | RunCommand::Motion { .. } => None,
        }
    }

    /// Whether it ends the run: [`RunCommand::Stop`] or [`RunCommand::StopNow`].
    #[must_use]
    pub const fn is_stop(&self) -> bool {
        matches!(self, RunCommand::Stop | RunCommand::StopNow)
    }
}

/// Commands that act as one: they make one change of the motion, with one first tick. As JSON a single command without a time is that command, and others
/// are `{"together":[…],"at_s":…}`.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// In the order in which they count.
    pub commands: Vec<RunCommand>,
    /// When the change begins, s of the motion. `None`, or a time that is past: as soon as it can.
    pub at_s: Option<f64>,
}

impl From<RunCommand> for Batch {
    fn from(command: RunCommand) -> Batch {
        Batch { commands: vec![command], at_s: None }
    }
}

impl Batch {
    /// Commands that act as one as soon as they can.
    #[must_use]
    pub fn now(commands: Vec<RunCommand>) -> Batch {
        Batch { commands, at_s: None }
    }

    /// Its command, if it is a single one without a time.
    #[must_use]
    pub fn single(&self) -> Option<&RunCommand> {
        match (self.commands.as_slice(), self.at_s) {
            ([only], None) => Some(only),
            _ => None,
        }
    }

    /// Whether it has a stop for now: a run obeys that before all that waits.
    #[must_use]
    pub fn has_stop(&self) -> bool {
        self.at_s.is_none() && self.commands.iter().any(RunCommand::is_stop)
    }
}

/// A batch as it is written and read.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum BatchLine {
    Single(RunCommand),
    List {
        together: Vec<RunCommand>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        at_s: Option<f64>,
    },
}

impl Serialize for Batch {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.single() {
            Some(only) => only.serialize(serializer),
            None => BatchLine::List { together: self.commands.clone(), at_s: self.at_s }.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Batch {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Batch, D::Error> {
        Ok(match BatchLine::deserialize(deserializer)? {
            BatchLine::Single(command) => command.into(),
            BatchLine::List { together, at_s } => Batch { commands: together, at_s },
        })
    }
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
