//! Lines of text for a live motion, as people type them: `second.frequency 0.9 Hz`, `tempo 0.5`, `pause`, `go`.

use pulsetrain_motion::quantity::Quantity;

use crate::command::{KnobValue, RunCommand};

/// What a line asks for.
#[derive(Clone, Debug, PartialEq)]
pub enum TypedLine {
    /// Something for the motion.
    Command(RunCommand),
    /// A list of the knobs.
    Knobs,
    /// A list of the cues.
    Cues,
    /// A list of what can be written.
    Help,
    /// Nothing: it is empty, or a comment.
    Nothing,
}

/// Why a line asks for nothing.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LineError {
    /// A word is missing.
    #[error("`{command}` needs {what}: {command} {example}")]
    Needs {
        /// The line's first word.
        command: &'static str,
        /// What is missing.
        what: &'static str,
        /// An example of it.
        example: &'static str,
    },
    /// A tempo is no number.
    #[error("\"{text}\" is no tempo: write a number, such as 0.5 for half as fast")]
    NoTempo {
        /// What was written.
        text: String,
    },
    /// Where motors stand is no position.
    #[error(
        "\"{text}\" is no position: write one with its unit, such as `here 0 deg`, or `here MOTOR 90 deg` for one motor"
    )]
    NoPosition {
        /// What was written.
        text: String,
    },
    /// A command takes nothing, and something follows it.
    #[error("`{command}` stands alone, but \"{rest}\" follows")]
    Alone {
        /// The line's first word.
        command: &'static str,
        /// What follows.
        rest: String,
    },
    /// A knob has no value.
    #[error("`{knob}` is no command; a knob needs a value: {knob} 1.5, with its unit if it has one")]
    NoValue {
        /// The knob, or a misspelt command.
        knob: String,
    },
    /// The line is too long.
    #[error("a line has {MAX_TYPED_LINE_BYTES} bytes at most")]
    TooLong,
}

/// The longest line, bytes.
pub const MAX_TYPED_LINE_BYTES: usize = 4096;

/// What can be written, for people.
pub const HELP: &str = "\
KNOB VALUE      turn a knob, such as: second.frequency 0.9 Hz
knobs           list them
tempo 0.5       half as fast; 1 is as the file has it
pause, resume   halt on the path, and go on
go, back        the next cue, and the one before
cue NAME        that cue; `cues` lists them
goto 0          bring the motors to where the motion began, or to a position such as 90 deg; `resume` goes on
begin           let motors that rest begin the motion, from its beginning
here 0 deg      where the motors stand, if that is not known; `here MOTOR 90 deg` for one motor
stop            brake, and end (also: quit, exit, q); `stop now` stops at once
";

impl TypedLine {
    /// Reads a line.
    ///
    /// ```
    /// use pulsetrain_live::{KnobValue, RunCommand, TypedLine};
    /// let value = KnobValue::Text("0.9 Hz".to_owned());
    /// let set = RunCommand::Set { knob: "second.frequency".to_owned(), value };
    /// assert_eq!(TypedLine::read("second.frequency 0.9 Hz"), Ok(TypedLine::Command(set)));
    /// assert!(TypedLine::read("tempo fast").is_err());
    /// ```
    ///
    /// # Errors
    /// If the line asks for nothing that there is.
    pub fn read(line: &str) -> Result<TypedLine, LineError> {
        if line.len() > MAX_TYPED_LINE_BYTES {
            return Err(LineError::TooLong);
        }
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            return Ok(TypedLine::Nothing);
        }
        let (word, rest) = match line.split_once(|c: char| c.is_whitespace() || c == '=') {
            Some((word, rest)) => (word, rest.trim_start_matches(|c: char| c.is_whitespace() || c == '=')),
            None => (line, ""),
        };
        let alone = |command: &'static str, line: TypedLine| match rest {
            "" => Ok(line),
            rest => Err(LineError::Alone { command, rest: rest.to_owned() }),
        };
        let with = |command: &'static str, what: &'static str, example: &'static str| match rest {
            "" => Err(LineError::Needs { command, what, example }),
            rest => Ok(rest.to_owned()),
        };
        let command = TypedLine::Command;
        match word.to_ascii_lowercase().as_str() {
            "pause" => alone("pause", command(RunCommand::Pause)),
            "resume" => alone("resume", command(RunCommand::Resume)),
            "stop" if rest.eq_ignore_ascii_case("now") => Ok(command(RunCommand::StopNow)),
            "stop" => alone("stop", command(RunCommand::Stop)),
            // What other programs call it. A knob may have one of these names, and then has a value.
            "quit" | "exit" | "q" if rest.is_empty() => Ok(command(RunCommand::Stop)),
            "tempo" => {
                let text = with("tempo", "a number", "0.5")?;
                let rate = text.parse().ok().filter(|rate: &f64| rate.is_finite());
                rate.map(|rate| command(RunCommand::Tempo { rate })).ok_or(LineError::NoTempo { text })
            }
            "go" => alone("go", command(RunCommand::Go)),
            "back" => alone("back", command(RunCommand::Back)),
            "cue" => Ok(command(RunCommand::Cue { name: with("cue", "a name", "dawn")? })),
            "begin" => alone("begin", command(RunCommand::Begin)),
            "here" => here(&with("here", "a position", "0 deg, or here MOTOR 90 deg")?).map(command),
            "goto" => Ok(command(RunCommand::Goto { position: with("goto", "a position", "0")? })),
            "knobs" => alone("knobs", TypedLine::Knobs),
            "cues" => alone("cues", TypedLine::Cues),
            "help" | "?" => alone("help", TypedLine::Help),
            _ if rest.is_empty() => Err(LineError::NoValue { knob: word.to_owned() }),
            _ => Ok(command(RunCommand::Set { knob: word.to_owned(), value: KnobValue::Text(rest.to_owned()) })),
        }
    }
}

/// Reads `0 deg`, or `second 90 deg` of one motor. Names of motors may have spaces.
fn here(text: &str) -> Result<RunCommand, LineError> {
    let is_position = |text: &str| matches!(text, "0" | "start" | "last") || Quantity::parse(text).is_ok();
    if is_position(text) {
        return Ok(RunCommand::Here { motor: None, position: text.to_owned() });
    }
    let spaces = text.match_indices(char::is_whitespace);
    let parts = { spaces }.map(|(at, _)| (text[..at].trim(), text[at..].trim()));
    let named = { parts }.find(|(_, position)| is_position(position));
    named.map_or_else(
        || Err(LineError::NoPosition { text: text.to_owned() }),
        |(motor, position)| Ok(RunCommand::Here { motor: Some(motor.to_owned()), position: position.to_owned() }),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn lines_are_requests() {
        let check = |line: &str, expected: Result<RunCommand, &str>| match (TypedLine::read(line), expected) {
            (Ok(TypedLine::Command(read)), Ok(expected)) => assert_eq!(read, expected, "{line}"),
            (Err(error), Err(part)) => assert!(error.to_string().contains(part), "{line}: {error}"),
            (read, expected) => panic!("{line}: {read:?}, not {expected:?}"),
        };
        let set = |knob: &str, value: &str| {
            Ok(RunCommand::Set { knob: knob.to_owned(), value: KnobValue::Text(value.to_owned()) })
        };
        check("second.frequency 0.9 Hz", set("second.frequency", "0.9 Hz"));
        check("  speed = 0.9 Hz ", set("speed", "0.9 Hz"));
        check("speed=2", set("speed", "2"));
        check("tempo 0.5", Ok(RunCommand::Tempo { rate: 0.5 }));
        check("tempo", Err("needs a number"));
        check("tempo fast", Err("\"fast\" is no tempo"));
        check("tempo nan", Err("\"nan\" is no tempo"));
        check("PAUSE", Ok(RunCommand::Pause));
        check("pause 3", Err("stands alone"));
        check("resume", Ok(RunCommand::Resume));
        check("stop", Ok(RunCommand::Stop));
        check("stop now", Ok(RunCommand::StopNow));
        check("stop it", Err("stands alone"));
        for word in ["quit", "exit", "q", " Quit "] {
            check(word, Ok(RunCommand::Stop));
        }
        check("q 1.5", set("q", "1.5"));
        check("go", Ok(RunCommand::Go));
        check("back", Ok(RunCommand::Back));
        check("cue the long night", Ok(RunCommand::Cue { name: "the long night".to_owned() }));
        check("cue", Err("needs a name"));
        check("goto 90 deg", Ok(RunCommand::Goto { position: "90 deg".to_owned() }));
        let here = |motor: Option<&str>, position: &str| {
            let motor = motor.map(str::to_owned);
            Ok(RunCommand::Here { motor, position: position.to_owned() })
        };
        check("here 0 deg", here(None, "0 deg"));
        check("here last", here(None, "last"));
        check("here second 90 deg", here(Some("second"), "90 deg"));
        check("here the second arm -1.5 rev", here(Some("the second arm"), "-1.5 rev"));
        check("here second", Err("\"second\" is no position"));
        check("begin", Ok(RunCommand::Begin));
        check("puase", Err("`puase` is no command"));
        check(&"x".repeat(5000), Err("4096 bytes"));
        assert_eq!(TypedLine::read(" # a remark"), Ok(TypedLine::Nothing));
        assert_eq!((TypedLine::read("knobs"), TypedLine::read("?")), (Ok(TypedLine::Knobs), Ok(TypedLine::Help)));
    }

    proptest! {
        /// Whatever is written: a request, or an error with words. What is read is written and read again the same.
        #[test]
        fn any_line_is_read_or_refused(line in "\\PC{0,80}", spaces in "[ \\t]{0,3}") {
            match (TypedLine::read(&line), TypedLine::read(&format!("{spaces}{line}{spaces}"))) {
                (Ok(one), Ok(other)) => prop_assert_eq!(one, other),
                (Err(error), Err(_)) => prop_assert!(!error.to_string().is_empty()),
                (one, other) => prop_assert!(false, "{:?}, {:?}", one, other),
            }
        }
    }
}
