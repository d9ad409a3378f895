//! The control socket of a run. Other commands of the same user find the run there, send it commands, and follow its events.
//!
//! Each run listens at a Unix socket `NAME-PID.sock` in the user's runtime folder: `$XDG_RUNTIME_DIR/pulsetrain`, or
//! `pulsetrain-UID` in the folder for temporary files. The folder has mode 0700 and the socket 0600, so that no other user
//! can connect. Both sides send lines of JSON. A client's have at most [`LONGEST_LINE`] bytes; one with a motion file at most [`LONGEST_MOTION_LINE`]:
//!
//! 1. The run sends [`RunInfo`]. Its field `pulsetrain_control` is the protocol's version, [`VERSION`].
//! 2. The client sends [`Request`]s, such as `{"command":"stop"}`, and `{"follow":true}` if it wants each status.
//! 3. The run sends [`RunLine`]s: an [`Event`] or a [`LiveEvent`], an error about a line of the client, and at last [`RunEnded`].
//!
//! The socket is one transport of the run's [`Hub`], which has the clients of all kinds and their queues. A client never
//! delays a step: threads of its own read and write, and a client that takes no lines is dropped.
//! docs/control.md describes the same for other programs. Windows has no such socket yet.

use std::io;
use std::path::PathBuf;

use miette::Diagnostic;
use pulsetrain_board::BoardKind;
use pulsetrain_motion::machine::{Kinematics, Machine};
use pulsetrain_motion::program::Program;
use pulsetrain_session::control::{Command, Event};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use pulsetrain_report::plan_report::max_speed;
use pulsetrain_report::positions::{MotorPosition, start};

#[cfg(unix)]
mod client;
mod control;
mod hub;
mod request;
#[cfg(unix)]
mod server;
#[cfg(not(unix))]
mod without;

#[cfg(unix)]
pub(crate) use client::folder;
#[cfg(unix)]
pub use client::{RunClient, runs};
pub use control::Control;
pub(crate) use hub::LONG_LINE_TIME;
pub use hub::{ClientKind, Hub, HubClient, HubLines, HubSender, JoinError, Next};
pub use request::{Happened, KnobInfo, KnobValue, LiveCommand, LiveEvent, Request, Together};
#[cfg(unix)]
use server::ControlSocket;
#[cfg(not(unix))]
use without::NoSocket as ControlSocket;
#[cfg(not(unix))]
pub use without::{NoClient as RunClient, runs};

/// The protocol's version. It changes when a client of an older version could misread a line.
pub const VERSION: u32 = 1;

/// The longest line of a client, bytes, its end included.
pub const LONGEST_LINE: usize = 4096;
/// The longest line with the command `motion`, bytes: JSON may write a byte of a text in six (`\u003c`), and so the largest file always fits. One client
/// sends such a line at a time.
pub const LONGEST_MOTION_LINE: usize = 6 * pulsetrain_motion::file::MOST_OF_A_MOTION_FILE as usize + LONGEST_LINE;

/// The most commands in a list that act together.
const MOST_TOGETHER: usize = 64;

/// The first line of a run: what it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RunInfo {
    /// The protocol's version: [`VERSION`].
    pub pulsetrain_control: u32,
    /// The version of the program that runs.
    pub program: String,
    /// Its process.
    pub pid: u32,
    /// A name for the run: of its port, "virtual" or "native", and the process.
    pub name: String,
    /// The motion file, as the user named it.
    pub file: String,
    /// The board, by its name in motion files.
    pub board: String,
    /// Ticks in a second of the board's clock, in which lateness is given; 0 if that is not known.
    #[serde(default)]
    pub tick_hz: u64,
    /// The board's port, as the user named it. `None` on virtual boards and on the native one.
    pub port: Option<String>,
    /// Other paths that led to that port when the run began.
    pub port_paths: Vec<PathBuf>,
    /// The motors, in the file's order.
    pub motors: Vec<MotorInfo>,
    /// The machines, in the file's order.
    #[serde(default)]
    pub machines: Vec<MachineInfo>,
    /// The knobs of a live motion.
    #[serde(default)]
    pub knobs: Vec<KnobInfo>,
    /// The names of a live motion's cues, in their order.
    #[serde(default)]
    pub cues: Vec<String>,
    /// Whether it is a live motion, which takes [`LiveCommand`]s.
    #[serde(default)]
    pub is_live: bool,
}

/// What a client needs to know of a motor to show its position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MotorInfo {
    /// Its name in the file.
    pub name: String,
    /// Its unit of position in the file.
    pub unit: String,
    /// Steps in one such unit.
    pub steps_per_unit: f64,
    /// Where it was when the board's count was 0, steps.
    pub start_steps: f64,
    /// The highest speed that the board, its driver and the motor allow, steps/s.
    #[serde(default)]
    pub max_speed: Option<f64>,
}

/// What a client needs to know of a machine to draw its figure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MachineInfo {
    /// Its name in the file.
    pub name: String,
    /// The unit of the tip's coordinates.
    pub unit: String,
    /// Its motors, as indices into the run's: x and y, or the three arms.
    pub motors: Vec<usize>,
    /// Each motor's position when the board's count was 0, steps in the machine's coordinates.
    pub home: Vec<f64>,
    /// How the motors move the tip.
    pub kinematics: KinematicsInfo,
}

/// How a machine's motors move its tip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum KinematicsInfo {
    /// Each motor moves along its own axis.
    Xy {
        /// Steps in one unit of the machine, for x and for y.
        steps_per_unit: [f64; 2],
    },
    /// A delta robot's three arms, at 0°, 120° and 240°.
    Delta {
        /// From the robot's axis to a motor's shaft, mm.
        base_mm: f64,
        /// From the motor's shaft to the elbow, mm.
        upper_arm_mm: f64,
        /// From the elbow to the effector's joint, mm.
        forearm_mm: f64,
        /// From the effector's middle to its joints, mm.
        effector_mm: f64,
        /// Steps in a radian, of each arm.
        steps_per_rad: [f64; 3],
    },
}

impl MachineInfo {
    fn of(machine: &Machine) -> MachineInfo {
        let kinematics = match &machine.kinematics {
            Kinematics::Xy { steps_per_unit } => KinematicsInfo::Xy { steps_per_unit: *steps_per_unit },
            Kinematics::Delta { arms, steps_per_rad, .. } => KinematicsInfo::Delta {
                base_mm: arms.base_mm,
                upper_arm_mm: arms.upper_arm_mm,
                forearm_mm: arms.forearm_mm,
                effector_mm: arms.effector_mm,
                steps_per_rad: *steps_per_rad,
            },
        };
        MachineInfo {
            name: machine.name.clone(),
            unit: machine.unit.clone(),
            motors: machine.motors.clone(),
            home: machine.home.clone(),
            kinematics,
        }
    }
}

impl RunInfo {
    /// The line of a run of this process.
    #[must_use]
    pub fn new(file: &str, program: &Program, port: Option<&str>, is_native: bool) -> RunInfo {
        let pid = std::process::id();
        let board = BoardKind::emulated(&program.board.name).filter(|_| !is_native);
        let kind = board.map_or_else(|| "native".to_owned(), |board| format!("virtual-{}", board.name()));
        let motors = program.motors.iter().map(|motor| MotorInfo {
            name: motor.name.clone(),
            unit: motor.scale.unit.clone(),
            steps_per_unit: motor.scale.steps_per_unit,
            start_steps: start(motor),
            max_speed: Some(max_speed(program, motor)),
        });
        RunInfo {
            pulsetrain_control: VERSION,
            program: env!("CARGO_PKG_VERSION").to_owned(),
            pid,
            name: format!("{}-{pid}", port.map_or(kind, port_word)),
            file: file.to_owned(),
            board: program.board.name.clone(),
            tick_hz: program.board.tick_hz,
            port: port.map(str::to_owned),
            port_paths: port.map(port_paths).unwrap_or_default(),
            motors: motors.collect(),
            machines: program.machines.iter().map(MachineInfo::of).collect(),
            knobs: Vec::new(),
            cues: Vec::new(),
            is_live: false,
        }
    }

    /// A run of nothing, for tests.
    #[cfg(test)]
    pub(crate) fn nothing() -> RunInfo {
        RunInfo {
            pulsetrain_control: VERSION,
            program: String::new(),
            pid: 7,
            name: "native-7".to_owned(),
            file: "nothing.toml".to_owned(),
            board: "native".to_owned(),
            tick_hz: 0,
            port: None,
            port_paths: Vec::new(),
            motors: Vec::new(),
            machines: Vec::new(),
            knobs: Vec::new(),
            cues: Vec::new(),
            is_live: false,
        }
    }

    /// The run's port for people; the run's name if it has none.
    #[must_use]
    pub fn place(&self) -> &str {
        self.port.as_deref().unwrap_or(&self.name)
    }

    /// Whether a port of that name, or a run of that name, is this one.
    #[must_use]
    pub fn is_at(&self, name: &str) -> bool {
        let same = |path: &PathBuf| self.port_paths.contains(path);
        self.name == name || self.port.as_deref() == Some(name) || port_paths(name).iter().any(same)
    }

    /// The position of a motor in its unit, from the board's count.
    #[must_use]
    pub fn position(&self, motor: usize, count: i64) -> Option<f64> {
        let MotorInfo { steps_per_unit, start_steps, .. } = self.motors.get(motor)?;
        Some((start_steps + count as f64) / steps_per_unit)
    }
}

/// The last part of a port's name, with letters that every file name may have.
fn port_word(port: &str) -> String {
    let last = port.rsplit(['/', '\\']).next().unwrap_or(port);
    let letters = last.chars().map(|letter| if letter.is_ascii_alphanumeric() { letter } else { '-' });
    letters.take(LONGEST_WORD).collect()
}

/// A socket's path has a hundred bytes or so on every system.
const LONGEST_WORD: usize = 20;

/// The absolute path of a port, and the path behind its links.
fn port_paths(port: &str) -> Vec<PathBuf> {
    let absolute = std::path::absolute(port).ok();
    absolute.into_iter().chain(std::fs::canonicalize(port).ok()).collect()
}

/// A line that a run sends after its first one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum RunLine {
    /// Something happened. [`Event::Status`] goes to clients alone that follow, [`Event::Progress`] to none.
    Event(Event),
    /// Something happened to a live motion.
    Live(LiveEvent),
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
enum ClientLine {
    Request(Request),
    Follow(bool),
    Control(bool),
}

impl ClientLine {
    fn read(line: &[u8]) -> Result<ClientLine, String> {
        let value: serde_json::Value =
            serde_json::from_slice(line).map_err(|error| format!("this is no line of JSON: {error}"))?;
        let switch = |key: &str| match value.get(key) {
            Some(serde_json::Value::Bool(value)) => Ok(Some(*value)),
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
            let together =
                Together::deserialize(&value).map_err(|error| format!("this is no list of commands: {error}"))?;
            let is_list = |request: &Request| matches!(request, Request::Together(_));
            return match together.together.len() {
                1..=MOST_TOGETHER if !together.together.iter().any(is_list) => {
                    Ok(ClientLine::Request(Request::Together(together)))
                }
                1..=MOST_TOGETHER => Err("a list of commands has no list in it".to_owned()),
                len => Err(format!("a list of commands has 1 to {MOST_TOGETHER}, this one has {len}")),
            };
        }
        let command = match (Command::deserialize(&value), LiveCommand::deserialize(&value)) {
            (Ok(command), _) => Ok(Request::Session(command)),
            (_, Ok(command)) => Ok(Request::Live(command)),
            // Of a command of live motions its own error says more.
            (Err(error), Err(live)) => Err(if live.to_string().starts_with("unknown variant") { error } else { live }),
        };
        command.map(ClientLine::Request).map_err(|error| {
            format!("this is no command: {error}; write {{\"command\":\"stop\"}} or {{\"follow\":true}}")
        })
    }
}

/// Why runs cannot be found, or a run cannot be reached.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum SocketError {
    /// The folder of the sockets is another user's, or others may write in it.
    #[error("{} is not this user's alone, so nothing in it can be trusted", .folder.display())]
    #[diagnostic(help("remove it, or set XDG_RUNTIME_DIR to a folder of your own"))]
    Folder {
        /// The folder.
        folder: PathBuf,
    },
    /// The folder, or a socket in it, cannot be used.
    #[error("cannot use {}: {error}", .path.display())]
    Access {
        /// The folder or the socket.
        path: PathBuf,
        /// The system's error.
        error: io::Error,
    },
    /// The run is of another version of this program.
    #[error("the run at {place} speaks version {theirs} of the control lines, this program {VERSION}")]
    #[diagnostic(help("press Ctrl-C where it runs, or use the version of pulsetrain that runs it"))]
    Version {
        /// The run's port, or its name.
        place: String,
        /// Its version.
        theirs: u32,
    },
    /// The run has ended, or closed the connection.
    #[error("the run at {place} went away without saying how it ended")]
    #[diagnostic(help("`pulsetrain stop --port PORT` asks the board itself"))]
    Gone {
        /// The run's port, or its name.
        place: String,
    },
    /// This system has no control socket.
    #[error("this system has no control socket yet: only runs on Linux, macOS and other Unix systems have one")]
    #[diagnostic(help("press Ctrl-C where it runs; a second Ctrl-C stops at once"))]
    System,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_clients_are_commands_or_follow() {
        let check = |line: &str, expected: Result<ClientLine, &str>| match (ClientLine::read(line.as_bytes()), expected)
        {
            (Ok(read), Ok(expected)) => assert_eq!(read, expected, "{line}"),
            (Err(why), Err(part)) => assert!(why.contains(part), "{line}: {why}"),
            (read, expected) => panic!("{line}: {read:?}, not {expected:?}"),
        };
        let session = |command| Ok(ClientLine::Request(Request::Session(command)));
        let live = |command| Ok(ClientLine::Request(Request::Live(command)));
        check(r#"{"command":"stop"}"#, session(Command::Stop));
        check(r#" {"command": "stop_now"} "#, session(Command::StopNow));
        check(r#"{"command":"cue","name":"dawn"}"#, live(LiveCommand::Cue { name: "dawn".to_owned() }));
        let value = KnobValue::Text("0.9 Hz".to_owned());
        check(
            r#"{"command":"set","knob":"a.frequency","value":"0.9 Hz"}"#,
            live(LiveCommand::Set { knob: "a.frequency".to_owned(), value }),
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
        let tempo = Request::Session(Command::Tempo { rate: 0.5 });
        let list =
            |at_s| Request::Together(Together { together: vec![tempo.clone(), Request::Live(LiveCommand::Go)], at_s });
        let text = r#""together":[{"command":"tempo","rate":0.5},{"command":"go"}]"#;
        check(&format!("{{{text}}}"), Ok(ClientLine::Request(list(None))));
        check(&format!("{{{text},\"at_s\":1.5}}"), Ok(ClientLine::Request(list(Some(1.5)))));
        check(&format!("{{\"together\":[{{{text}}}]}}"), Err("has no list in it"));
        check(r#"{"together":[]}"#, Err("1 to 64, this one has 0"));
        let many = vec![r#"{"command":"go"}"#; 65].join(",");
        check(&format!("{{\"together\":[{many}]}}"), Err("1 to 64, this one has 65"));
        check(r#"{"together":[{"command":"fly"}]}"#, Err("no list of commands"));
        check("stop", Err("no line of JSON"));
        check("[]", Err("no command"));
        check("", Err("no line of JSON"));
    }

    #[test]
    fn a_port_is_found_by_each_of_its_names() {
        let info = RunInfo {
            name: "ttyACM0-7".to_owned(),
            port: Some("board".to_owned()),
            port_paths: port_paths("board"),
            ..RunInfo::nothing()
        };
        let absolute = std::path::absolute("board").unwrap().display().to_string();
        for (name, is_it) in [("board", true), ("./board", true), (&absolute, true), ("ttyACM0-7", true), ("x", false)]
        {
            assert_eq!(info.is_at(name), is_it, "{name}");
        }
        assert_eq!(port_word("/dev/serial/by-id/usb Arduino_(www.arduino.cc)"), "usb-Arduino--www-ard");
        assert_eq!(port_word(r"\\.\COM10"), "COM10");
    }
}
