//! Estimates of a motion before it is planned: how many steps, how long, how large its files.

use pulsetrain_board::BoardKind;
use std::fmt::{self, Display};

use pulsetrain_motion::law::Workload;
use pulsetrain_motion::program::{BoardLimits, Motor, Wiring};
use pulsetrain_motion::{Time, human};
use pulsetrain_trace::{steps, vcd_file};
use schemars::JsonSchema;
use serde::Serialize;

use crate::prepare::{Prepared, spans};

/// Seconds that planning a piece or a segment takes on a PC. Obtained with the command `plan`, of sines of 1 to 10 000 steps and of the examples.
const SEGMENT_S: f64 = 1.2e-6;
/// Seconds for each step in a segment, obtained in the same way.
const STEP_S: f64 = 2e-8;
/// Seconds for each turn within a piece, obtained in the same way.
const TURN_S: f64 = 1.5e-6;
/// Seconds for each operation of a formula, in a piece or at a turn, obtained in the same way.
const OPERATION_S: f64 = 1e-7;
/// Seconds for each operation of a formula, for each segment. Obtained with `plan`, of a sum of 5000 sinusoids.
const SEGMENT_OPERATION_S: f64 = 2e-7;
/// Segments of a curved piece for each power of ten of its steps; it never has more segments than steps.
const SEGMENTS_PER_DECADE: f64 = 12.0;

/// Seconds that a run on the native board takes for each step, to make, judge, write and draw it. Obtained with `run` of sweep.toml and pico.toml.
const NATIVE_STEP_S: f64 = 2e-6;
/// Seconds that such a run takes for each second of motion, with its 20 reports of status. Obtained in the same way.
const NATIVE_SECOND_S: f64 = 2e-5;

// Beyond one of these limits the user is asked first: a motion file may ask for days of work by a slip of a digit.
/// Steps of all motors.
const MOST_STEPS: f64 = 5e7;
/// Planning time, s.
const MOST_PLANNING_S: f64 = 60.0;
/// Running time on a virtual board, s.
const MOST_RUNNING_S: f64 = 3600.0;
/// Size of the files, bytes.
const MOST_FILE_BYTES: f64 = 1e9;

/// What the user wants done with a motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// It is planned, or compared with a capture.
    Plan,
    /// It is run on the native board.
    Native {
        /// Whether steps.csv and trace.vcd are written.
        files: bool,
    },
    /// It is run on the virtual board that it is for, and its files are written.
    Virtual,
    /// It is run on a real board.
    Port,
}

/// The estimate; all figures are approximate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Estimate {
    /// How long the motion lasts, s.
    pub motion_s: f64,
    /// Steps of all motors.
    pub steps: f64,
    /// How long it takes to plan it, s.
    pub planning_s: f64,
    /// How long it takes to run it on the native or a virtual board, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub running_s: Option<f64>,
    /// Size of steps.csv and trace.vcd, bytes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file_bytes: Option<f64>,
}

impl Display for Estimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Estimate { motion_s, steps, planning_s, running_s, file_bytes } = *self;
        let time = human::long_time;
        write!(
            f,
            "about {} steps in {}, {} of planning",
            human::significant(steps, 2),
            time(motion_s),
            time(planning_s)
        )?;
        running_s.map_or(Ok(()), |running_s| write!(f, ", {} of running", time(running_s)))?;
        file_bytes.map_or(Ok(()), |bytes| write!(f, ", {} of files", human::bytes(bytes)))
    }
}

impl Estimate {
    /// Estimates a motion that is not cut yet, as if it were cut after `length`.
    #[must_use]
    pub fn of(prepared: &Prepared, length: Option<Time>, task: Task) -> Estimate {
        let program = &prepared.program;
        let spans = spans(program, length);
        let motion_s = spans.iter().copied().fold(Time::ZERO, Time::max).seconds();
        let (mut all, mut planning_s, mut row_bytes) = (Workload::default(), 0.0, 0.0);
        for (motor, span) in program.motors.iter().zip(spans) {
            let workload = motor.law.workload(span);
            planning_s += self::planning_s(workload);
            row_bytes += workload.steps * bytes_of_step(motor, &program.board, motion_s);
            all = all.and(workload);
        }
        let files = matches!(task, Task::Native { files: true } | Task::Virtual | Task::Port);
        let native_s = all.steps * NATIVE_STEP_S + motion_s * NATIVE_SECOND_S;
        let emulation = BoardKind::named(&program.board.name).and_then(|kind| kind.profile().emulation);
        Estimate {
            motion_s,
            steps: all.steps,
            planning_s,
            running_s: match task {
                Task::Plan | Task::Port => None,
                Task::Virtual => Some(emulation.map_or(native_s, |emulation| motion_s / emulation.speed)),
                Task::Native { .. } => Some(native_s),
            },
            file_bytes: files.then_some(row_bytes),
        }
    }

    /// Whether it is so much that the user should be asked first.
    #[must_use]
    pub fn is_much(&self) -> bool {
        self.steps > MOST_STEPS
            || self.planning_s > MOST_PLANNING_S
            || self.running_s.is_some_and(|running_s| running_s > MOST_RUNNING_S)
            || self.file_bytes.is_some_and(|bytes| bytes > MOST_FILE_BYTES)
    }
}

/// About how long it takes to plan a law, s.
pub(crate) fn planning_s(workload: Workload) -> f64 {
    let operations = workload.operations / (workload.pieces + workload.turns).max(1.0);
    (workload.pieces + segments_of(workload)) * SEGMENT_S
        + segments_of(workload) * operations * SEGMENT_OPERATION_S
        + workload.steps * STEP_S
        + workload.turns * TURN_S
        + workload.operations * OPERATION_S
}

/// About how long it takes to plan a second of a motion, s; of its first seconds.
pub(crate) fn second_s(prepared: &Prepared) -> f64 {
    const LOOK_S: f64 = 10.0;
    Estimate::of(prepared, Some(Time::from_seconds(LOOK_S)), Task::Plan).planning_s / LOOK_S
}

/// About how many moves of a motion's first seconds are planned in `budget_s`.
pub(crate) fn moves_in(budget_s: f64, prepared: &Prepared) -> u32 {
    let program = &prepared.program;
    let spans = spans(program, Some(Time::from_seconds(10.0)));
    let workloads = program.motors.iter().zip(spans).map(|(motor, span)| motor.law.workload(span));
    let (moves, planning_s) = workloads.fold((0.0, 0.0), |(moves, planning_s), workload| {
        (moves + workload.pieces + segments_of(workload), planning_s + self::planning_s(workload))
    });
    (budget_s * moves / planning_s) as u32
}

/// About how many segments the plan of a law has.
fn segments_of(workload: Workload) -> f64 {
    let steps_of_piece = workload.steps / workload.pieces.max(1.0);
    workload.pieces * steps_of_piece.min(SEGMENTS_PER_DECADE * libm::log10(1.0 + steps_of_piece))
}

/// About how many bytes of steps.csv and trace.vcd a step takes.
fn bytes_of_step(motor: &Motor, board: &BoardLimits, motion_s: f64) -> f64 {
    let edges = match motor.wiring {
        // Two edges of a pulse, and now and then one of DIR.
        Wiring::StepDir { .. } => 2.1,
        Wiring::Coils { .. } => 1.2,
    };
    steps::row_bytes(&motor.name, board.tick_hz, motion_s) + edges * vcd_file::edge_bytes(board.tick_hz, motion_s)
}
