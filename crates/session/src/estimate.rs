//! What a motion comes to before it is planned: steps, time, files.

use pulsetrain_board::BoardKind;
use std::fmt::{self, Display};

use pulsetrain_motion::law::Workload;
use pulsetrain_motion::program::{Board, Motor, Wiring};
use pulsetrain_motion::{Time, human};
use pulsetrain_trace::{steps, vcd_file};
use serde::Serialize;

use crate::prepare::{Prepared, spans};

/// What planning takes on a PC, s: a piece or a segment, and a step in it. By `plan` of sines of 1 to 10 000 steps, and of the examples, for hours.
const SEGMENT_S: f64 = 1.2e-6;
const STEP_S: f64 = 2e-8;
/// The same of a turn within a piece, and of an operation of a formula in a piece or at a turn.
const TURN_S: f64 = 1.5e-6;
const OPERATION_S: f64 = 1e-7;
/// A piece that bends has so many segments for each power of ten of its steps; no more than steps.
const SEGMENTS_PER_DECADE: f64 = 12.0;

/// What a run takes beside that, s: a step of the native board, judged, written and drawn; and a second of motion, which
/// is looked at 20 times. An emulated chip is so many times as fast as a real one. By `run` of sweep.toml and pico.toml.
const NATIVE_STEP_S: f64 = 2e-6;
const NATIVE_SECOND_S: f64 = 2e-5;

/// Beyond these somebody is asked.
const MOST_STEPS: f64 = 5e7;
const MOST_PLANNING_S: f64 = 60.0;
const MOST_RUNNING_S: f64 = 3600.0;
const MOST_FILE_BYTES: f64 = 1e9;
/// What is to be done with a motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// It is planned, or held against a capture.
    Plan,
    /// It is run on the native board; `files` are written of it.
    Native {
        /// Whether steps.csv and trace.vcd are written.
        files: bool,
    },
    /// It is run on the virtual board that it is for, and files are written.
    Virtual,
    /// It is run on a real board.
    Port,
}

/// What a motion comes to, about.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// How long the motion lasts, s.
    pub motion_s: f64,
    /// Steps of all motors.
    pub steps: f64,
    /// How long it takes to plan it, s.
    pub planning_s: f64,
    /// How long it takes to run it on a board that is none, s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub running_s: Option<f64>,
    /// Of steps.csv and trace.vcd, bytes.
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
    /// Of a motion that is not cut yet, `length` of it.
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
        let emulated = BoardKind::named(&program.board.name);
        Estimate {
            motion_s,
            steps: all.steps,
            planning_s,
            running_s: match task {
                Task::Plan | Task::Port => None,
                Task::Virtual => Some(emulated.map_or(native_s, |kind| motion_s / kind.emulation_speed())),
                Task::Native { .. } => Some(native_s),
            },
            file_bytes: files.then_some(row_bytes),
        }
    }

    /// Whether it is so much that nobody should wait for it without having been asked.
    #[must_use]
    pub fn is_much(&self) -> bool {
        self.steps > MOST_STEPS
            || self.planning_s > MOST_PLANNING_S
            || self.running_s.is_some_and(|running_s| running_s > MOST_RUNNING_S)
            || self.file_bytes.is_some_and(|bytes| bytes > MOST_FILE_BYTES)
    }
}

/// How long it takes to plan a law, about, s.
pub(crate) fn planning_s(workload: Workload) -> f64 {
    (workload.pieces + segments_of(workload)) * SEGMENT_S
        + workload.steps * STEP_S
        + workload.turns * TURN_S
        + workload.operations * OPERATION_S
}

/// About how many segments the plan of a law has.
fn segments_of(workload: Workload) -> f64 {
    let steps_of_piece = workload.steps / workload.pieces.max(1.0);
    workload.pieces * steps_of_piece.min(SEGMENTS_PER_DECADE * (1.0 + steps_of_piece).log10())
}

/// Of steps.csv and trace.vcd, about.
fn bytes_of_step(motor: &Motor, board: &Board, motion_s: f64) -> f64 {
    let edges = match motor.wiring {
        // A pulse, and now and then a turn of DIR.
        Wiring::StepDir { .. } => 2.1,
        Wiring::Coils { .. } => 1.2,
    };
    steps::row_bytes(&motor.name, board.tick_hz, motion_s) + edges * vcd_file::edge_bytes(board.tick_hz, motion_s)
}
