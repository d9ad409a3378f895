//! The lines that a run and its clients send each other.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use pulsetrain_report::positions::MotorPosition;
use pulsetrain_session::control::Command;

use crate::command::{Batch, RunCommand};
use crate::event::RunEvent;
use crate::run_info::RunInfo;
pub use crate::run_info::VERSION;

/// The longest line of a client, bytes, its end included.
pub const MAX_LINE_BYTES: usize = 4096;
/// The longest line with the command `motion`, bytes: JSON may write a byte of a text in six (`\u003c`), and so the largest file always fits. One client
/// sends such a line at a time.
pub const MAX_MOTION_LINE_BYTES: usize = 6 * pulsetrain_motion::file::MOST_OF_A_MOTION_FILE as usize + MAX_LINE_BYTES;

/// The most commands in a list that act together.
pub const MAX_BATCH_COMMANDS: usize = 64;

/// A line that a run sends after its first one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum RunLine {
    /// Something happened. [`RunEvent::Status`] goes to clients alone that follow, [`RunEvent::Progress`] to none.
    Event(RunEvent),
    /// The run is over. It is the last line.
    Ended(RunEnded),
    /// Which page controls the motors. It goes to pages alone.
    Control {
        /// Who controls.
        control: ControlState,
    },
    /// The run has other knobs or cues now.
    Info(RunInfo),
    /// A line of the client was not understood, or not obeyed.
    Error {
        /// Why not.
        error: String,
    },
}

/// Which page controls the motors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct ControlState {
    /// The page that reads this.
    pub yours: bool,
    /// Some page.
    pub taken: bool,
    /// How many pages there are.
    pub pages: usize,
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RunEnded {
    /// How it ended.
    pub ended: Ending,
    /// What went wrong, if something did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
    /// Where the motors are, if that is known.
    #[serde(default)]
    pub motors: Vec<MotorPosition>,
    /// The command that brings the motors back to the motion's start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub way_back: Option<String>,
    /// Whether the motors had begun to move.
    #[serde(default)]
    pub moved: bool,
}

/// The ways in which a run ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Ending {
    /// The motion came to its end.
    Finished,
    /// It was stopped, as somebody asked for.
    Stopped,
    /// It failed, or was refused before it began.
    Failed,
}

impl RunEnded {
    /// The end of a run that failed.
    #[must_use]
    pub fn failed(why: String) -> RunEnded {
        RunEnded { ended: Ending::Failed, why: Some(why), motors: Vec::new(), way_back: None, moved: false }
    }
}

/// A line of a client.
#[derive(Clone, Debug, PartialEq)]
pub enum ClientLine {
    /// Commands for the motion.
    Batch(Batch),
    /// Whether it wants each status.
    Follow(bool),
    /// Whether it wants control of the motors.
    Control(bool),
}

impl ClientLine {
    /// Reads a line of JSON.
    ///
    /// # Errors
    /// Why it says nothing, for the client.
    pub fn read(line: &[u8]) -> Result<ClientLine, String> {
        let value: Value = serde_json::from_slice(line).map_err(|error| format!("this is no line of JSON: {error}"))?;
        let switch = |key: &str| match value.get(key) {
            Some(Value::Bool(value)) => Ok(Some(*value)),
            Some(_) => Err(format!("`{key}` is true or false")),
            None => Ok(None),
        };
        if let Some(follows) = switch("follow")? {
            return Ok(ClientLine::Follow(follows));
        }
        if let Some(controls) = switch("control")? {
            return Ok(ClientLine::Control(controls));
        }
        if value.get("together").is_some() {
            return read_batch(&value).map(ClientLine::Batch);
        }
        let command = RunCommand::deserialize(&value).map_err(|error| {
            // Of a word that is no command, the commands that every run takes are listed.
            let of_session = Command::deserialize(&value).err();
            let error = of_session.filter(|_| error.to_string().starts_with("unknown variant")).unwrap_or(error);
            format!("this is no command: {error}; write {{\"command\":\"stop\"}} or {{\"follow\":true}}")
        });
        command.map(|command| ClientLine::Batch(command.into()))
    }
}

/// Reads a list of commands that act as one.
fn read_batch(value: &Value) -> Result<Batch, String> {
    let is_list = |value: &Value| value.get("together").is_some();
    if value["together"].as_array().is_some_and(|list| list.iter().any(is_list)) {
        return Err("a list of commands has no list in it".to_owned());
    }
    let batch = Batch::deserialize(value).map_err(|error| format!("this is no list of commands: {error}"))?;
    match batch.commands.len() {
        1..=MAX_BATCH_COMMANDS => Ok(batch),
        len => Err(format!("a list of commands has 1 to {MAX_BATCH_COMMANDS}, this one has {len}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::KnobValue;

    #[test]
    fn lines_of_clients_are_commands_or_follow() {
        let check = |line: &str, expected: Result<ClientLine, &str>| match (ClientLine::read(line.as_bytes()), expected)
        {
            (Ok(read), Ok(expected)) => assert_eq!(read, expected, "{line}"),
            (Err(why), Err(part)) => assert!(why.contains(part), "{line}: {why}"),
            (read, expected) => panic!("{line}: {read:?}, not {expected:?}"),
        };
        let single = |command: RunCommand| Ok(ClientLine::Batch(command.into()));
        check(r#"{"command":"stop"}"#, single(RunCommand::Stop));
        check(r#" {"command": "stop_now"} "#, single(RunCommand::StopNow));
        check(r#"{"command":"cue","name":"dawn"}"#, single(RunCommand::Cue { name: "dawn".to_owned() }));
        let value = KnobValue::Text("0.9 Hz".to_owned());
        check(
            r#"{"command":"set","knob":"a.frequency","value":"0.9 Hz"}"#,
            single(RunCommand::Set { knob: "a.frequency".to_owned(), value }),
        );
        check(r#"{"command":"cue"}"#, Err("missing field `name`"));
        check(r#"{"command":"tempo"}"#, Err("missing field `rate`"));
        check(r#"{"command":"tempo","rate":"fast"}"#, Err("expected f64"));
        check(r#"{"command":"goto","position":4}"#, Err("expected a string"));
        check(r#"{"control":true}"#, Ok(ClientLine::Control(true)));
        check(r#"{"control":"me"}"#, Err("true or false"));
        check(r#"{"follow":true}"#, Ok(ClientLine::Follow(true)));
        check(r#"{"follow":1}"#, Err("true or false"));
        check(r#"{"command":"stopp"}"#, Err("unknown variant `stopp`"));
        let list = |at_s| Batch { commands: vec![RunCommand::Tempo { rate: 0.5 }, RunCommand::Go], at_s };
        let text = r#""together":[{"command":"tempo","rate":0.5},{"command":"go"}]"#;
        check(&format!("{{{text}}}"), Ok(ClientLine::Batch(list(None))));
        check(&format!("{{{text},\"at_s\":1.5}}"), Ok(ClientLine::Batch(list(Some(1.5)))));
        check(&format!("{{\"together\":[{{{text}}}]}}"), Err("has no list in it"));
        check(r#"{"together":[]}"#, Err("1 to 64, this one has 0"));
        let many = vec![r#"{"command":"go"}"#; 65].join(",");
        check(&format!("{{\"together\":[{many}]}}"), Err("1 to 64, this one has 65"));
        check(r#"{"together":[{"command":"fly"}]}"#, Err("no list of commands"));
        check("stop", Err("no line of JSON"));
        check("[]", Err("no command"));
        check("", Err("no line of JSON"));
    }
}
