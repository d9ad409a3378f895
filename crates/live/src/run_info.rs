//! What clients know of a run: its first line.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use pulsetrain_board::BoardKind;
use pulsetrain_motion::machine::{Kinematics, Machine};
use pulsetrain_motion::program::Program;
use pulsetrain_report::plan_report::max_speed;
use pulsetrain_report::positions::start;

/// The protocol's version. It changes when a client of an older version could misread a line.
pub const VERSION: u32 = 1;

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
    /// Whether it is a live motion, which takes the commands of one.
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

/// Where a run is: what the program around it knows.
#[derive(Clone, Debug, Default)]
pub struct RunPlace<'a> {
    /// Its process.
    pub pid: u32,
    /// The board's port, as the user named it. `None` on virtual boards and on the native one.
    pub port: Option<&'a str>,
    /// Other paths that lead to that port.
    pub port_paths: Vec<PathBuf>,
    /// Whether it is on the native board though its board has an emulated chip.
    pub is_native: bool,
}

impl RunInfo {
    /// The first line of a run of a program.
    #[must_use]
    pub fn new(file: &str, program: &Program, place: RunPlace<'_>) -> RunInfo {
        let RunPlace { pid, port, port_paths, is_native } = place;
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
            port_paths,
            motors: motors.collect(),
            machines: program.machines.iter().map(MachineInfo::of).collect(),
            knobs: Vec::new(),
            cues: Vec::new(),
            is_live: false,
        }
    }

    /// A run without motors, for tests of clients.
    #[must_use]
    pub fn nothing() -> RunInfo {
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

    /// Whether a run of that name is this one, or a port of that name, to which `paths` lead, is its port.
    #[must_use]
    pub fn is_at(&self, name: &str, paths: &[PathBuf]) -> bool {
        let is_same = |path: &PathBuf| self.port_paths.contains(path);
        self.name == name || self.port.as_deref() == Some(name) || paths.iter().any(is_same)
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
    letters.take(MAX_WORD_LEN).collect()
}

/// A socket's path has a hundred bytes or so on every system.
const MAX_WORD_LEN: usize = 20;

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_gives_a_run_a_name_that_every_file_may_have() {
        assert_eq!(port_word("/dev/serial/by-id/usb Arduino_(www.arduino.cc)"), "usb-Arduino--www-ard");
        assert_eq!(port_word(r"\\.\COM10"), "COM10");
    }
}
