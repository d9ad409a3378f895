//! What was asked of a live motion and what was done, as lines of JSON, and the same once more.
//!
//! The first line says what runs. Then come lines with the board's tick: `asked` is a [`Batch`], `done` a [`RunEvent`]. On a virtual board
//! the same commands at the same ticks make the same edges.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{self, BufRead};
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::command::Batch;
use crate::event::RunEvent;
use crate::input_line::{InputLine, next_line};
use crate::setpoints::FileTexts;

/// The longest line of a log, bytes: one with a motion file and the tables that it names.
pub const MAX_LOG_LINE_BYTES: u64 = 200_000_000;

/// The version of these lines.
pub const VERSION: u32 = 1;

/// The first line of a log.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LogHead {
    /// The version of these lines: [`VERSION`].
    pub pulsetrain_log: u32,
    /// The version of the program.
    pub program: String,
    /// The motion file's name.
    pub file: String,
    /// Its text.
    pub text: String,
    /// The files that it names.
    pub files: BTreeMap<PathBuf, String>,
    /// The board that replaced the file's own.
    pub board: Option<String>,
    /// Whether it ran on the native board.
    pub is_native: bool,
    /// The serial port of a real board. Such a run can be made again, but not tick for tick.
    pub port: Option<String>,
    /// The rate of the line, baud, if one was asked for.
    pub baud: Option<u32>,
    /// Whether the motors were to join the motion again after a stop.
    pub rejoins: bool,
    /// Where the motors rested at the beginning, steps, if they did not begin the motion at once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rests_at: Option<Vec<f64>>,
}

/// A line after the first one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LogLine {
    /// The board's time, ticks.
    pub tick: u64,
    /// The same from the begin of the motion, s.
    #[serde(default)]
    pub at_s: f64,
    /// The clock of the computer that wrote it: seconds since 1970 in UTC. A replay does not look at it.
    #[serde(default)]
    pub unix_s: f64,
    /// What it says.
    #[serde(flatten)]
    pub entry: LogEntry,
}

/// What a line says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LogEntry {
    /// Somebody asked for something.
    Asked(Batch),
    /// Something happened.
    Done(RunEvent),
    /// Files that a changed motion file names.
    Files(FileTexts),
    /// The log ends here: the motion is over.
    Over,
}

/// A number that differs for texts that differ.
#[must_use]
pub fn text_hash(text: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    text.hash(&mut hasher);
    hasher.finish()
}

/// A log that was read.
#[derive(Clone, Debug, PartialEq)]
pub struct Replay {
    /// What ran.
    pub head: LogHead,
    /// In the order of time.
    pub lines: Vec<LogLine>,
}

/// Why a file is no log.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// It cannot be read.
    #[error("{0}")]
    Read(#[from] io::Error),
    /// A line is none of a log.
    #[error("line {line} is none of a log of `pulsetrain live`: {error}")]
    Line {
        /// From 1.
        line: usize,
        /// Why not.
        error: serde_json::Error,
    },
    /// A line is longer than those of a log.
    #[error("line {0} is none of a log of `pulsetrain live`: it has more than 200 MB")]
    LongLine(usize),
    /// Another version wrote it.
    #[error("it has version {0} of the log's lines; this program reads version {VERSION}")]
    Version(u32),
    /// It has no lines.
    #[error("it is empty")]
    Empty,
}

impl Replay {
    /// Reads a log. A last line without its end, of a program that was killed, is left out.
    ///
    /// # Errors
    /// If it is no log.
    pub fn read(mut input: impl BufRead) -> Result<Replay, LogError> {
        let (mut head, mut lines) = (None, Vec::new());
        let mut text = Vec::new();
        for line in 1.. {
            if next_line(&mut input, &mut text, MAX_LOG_LINE_BYTES)? == InputLine::TooLong {
                return Err(LogError::LongLine(line));
            }
            if !text.ends_with(b"\n") {
                break;
            }
            let error = |error| LogError::Line { line, error };
            match &head {
                None => {
                    let read: LogHead = serde_json::from_slice(&text).map_err(error)?;
                    if read.pulsetrain_log != VERSION {
                        return Err(LogError::Version(read.pulsetrain_log));
                    }
                    head = Some(read);
                }
                Some(_) => lines.push(serde_json::from_slice(&text).map_err(error)?),
            }
        }
        Ok(Replay { head: head.ok_or(LogError::Empty)?, lines })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{KnobValue, RunCommand};

    #[test]
    fn logs_are_read_as_they_are_written() {
        let head = LogHead {
            pulsetrain_log: VERSION,
            program: "0".to_owned(),
            file: "m.toml".to_owned(),
            text: "board = \"uno\"\n".to_owned(),
            files: BTreeMap::from([(PathBuf::from("a.csv"), "t,x\n".to_owned())]),
            board: None,
            is_native: true,
            port: None,
            baud: Some(1_000_000),
            rejoins: true,
            rests_at: None,
        };
        let value = KnobValue::Text("0.9 Hz".to_owned());
        let asked = |command: RunCommand| LogEntry::Asked(command.into());
        let turned = RunCommand::Set { knob: "a".to_owned(), value };
        let entries = [
            (7, asked(turned)),
            (7, asked(RunCommand::Tempo { rate: 0.1 + 0.2 })),
            (8, LogEntry::Done(RunEvent::Stopping { at_s: 1.0 / 3.0 })),
            (9, LogEntry::Over),
        ];
        let lines =
            entries.map(|(tick, entry)| LogLine { tick, at_s: tick as f64 / 3.0, unix_s: 1_764_300_000.123, entry });
        let mut text = serde_json::to_string(&head).unwrap() + "\n";
        for line in &lines {
            text += &(serde_json::to_string(line).unwrap() + "\n");
        }
        let read = Replay::read(text.as_bytes()).unwrap();
        assert_eq!((&read.head, &read.lines[..]), (&head, &lines[..]));
        // Killed while it wrote.
        let cut = Replay::read(&text.as_bytes()[..text.len() - 1]).unwrap();
        assert_eq!(cut.lines, lines[..3]);
        let wrong = text.replace("\"asked\"", "\"axed\"");
        assert!(Replay::read(wrong.as_bytes()).unwrap_err().to_string().starts_with("line 2 is none"));
        assert!(matches!(Replay::read(&b""[..]), Err(LogError::Empty)));
    }
}
