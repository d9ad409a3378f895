//! Plans on the native board, in virtual time and bounded memory.

use miette::Diagnostic;
use pulsetrain_board::native::{ConfigError, Faults};
use pulsetrain_board::{Config, MotorConfig, Native, Observer, Wiring};
use pulsetrain_core::output::Sequence;
use pulsetrain_core::{Entry, Epoch, Item, Moment};
use pulsetrain_motion::program::{self, CoilSequence, Motor, Program};
use pulsetrain_plan::{Move, Settings};
use pulsetrain_trace::{Line, lines};

use crate::prepare::{Planned, Plans, Prepared, Refusal};

/// Why a run did not come to its end.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum DriveError {
    /// The motion is refused.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Refused(#[from] Refusal),
    /// The native board cannot be wired so.
    #[error("the native board cannot run this motion: {0}")]
    Config(#[from] ConfigError),
    /// The board dropped steps: a fault of the planner, not of the motion.
    #[error("motor {motor} missed steps on the native board; please report this motion file")]
    Missed {
        /// Whose.
        motor: String,
    },
}

/// Longest dwell of one item, ticks.
const LONGEST_DWELL_TICKS: u64 = 1 << 30;

/// Runs a prepared motion; `watch` hears how far it is, s. Line i of the observer is line i of [`lines::of`].
///
/// # Errors
/// When the motion is refused, which [`Prepared::plan`] would have said before anything moved.
pub fn drive(
    prepared: &Prepared,
    observer: &mut impl Observer,
    mut watch: impl FnMut(f64),
) -> Result<Vec<Planned>, DriveError> {
    let program = &prepared.program;
    let hz = program.board.tick_hz as f64;
    let mut board = Native::new(&config(program))?;
    let mut plans = Plans::new(program).map_err(|refused| prepared.refuse(refused))?;
    // An edge of DIR comes before its step: the board must not pass it before the step is known.
    let lead = program.motors.iter().map(|motor| Settings::of(program, motor).reversal_ticks).max().unwrap_or(0);
    let mut feed = |board: &mut Native, motor: usize, item: Item, known: u64| {
        let mut entry = Entry { epoch: Epoch(0), item };
        while let Err(returned) = board.push(motor, entry) {
            entry = returned;
            board.advance(known.saturating_sub(lead).max(board.now()), observer);
            watch(known as f64 / hz);
        }
    };
    for motor in 0..program.motors.len() {
        feed(&mut board, motor, Item::Anchor { tick: Moment(0) }, 0);
    }
    while let Some((_, mut known)) = plans.least_far() {
        let Some((motor, next)) = plans.next_move().map_err(|refused| prepared.refuse(refused))? else { break };
        match next {
            Move::Run { segment, direction } => feed(&mut board, motor, Item::Run { segment, direction }, known),
            Move::Dwell { mut ticks } => {
                while ticks > 0 {
                    let part = ticks.min(LONGEST_DWELL_TICKS);
                    feed(&mut board, motor, Item::Dwell { ticks: part as u32 }, known);
                    (ticks, known) = (ticks - part, known + part);
                }
            }
        }
    }
    let planned = plans.finish();
    let last = planned.iter().map(|planned| planned.last_tick).max().unwrap_or(0);
    board.advance(last, observer);
    while !board.idle() {
        board.advance(board.now() + lead.max(1), observer);
    }
    for (motor, settings) in program.motors.iter().enumerate() {
        if board.faults(motor) != Faults::default() {
            return Err(DriveError::Missed { motor: settings.name.clone() });
        }
    }
    Ok(planned)
}

/// The native board for a program: lines in the order of its traces.
fn config(program: &Program) -> Config {
    let lines = lines::of(program);
    let hz = program.board.tick_hz;
    let motors = program.motors.iter().map(|motor| MotorConfig {
        wiring: wiring(motor, &lines, hz),
        pull_in_ticks: if motor.limits.pull_in > 0.0 { (hz as f64 / motor.limits.pull_in) as u64 } else { u64::MAX },
    });
    Config { fraction_bits: program.board.fraction_bits, motors: motors.collect() }
}

fn wiring(motor: &Motor, lines: &[Line], tick_hz: u64) -> Wiring {
    let line = |pin: u8| {
        let name = format!("pin{pin}");
        // Every pin of a program has a line; a board refuses the number that stands for none.
        lines.iter().position(|line| line.names.contains(&name)).map_or(u8::MAX, |line| line as u8)
    };
    match motor.wiring {
        program::Wiring::StepDir { step, dir, forward_high, .. } => {
            let timing = motor.timing.ticks(tick_hz);
            Wiring::StepDir {
                step: line(step),
                dir: line(dir),
                forward_high,
                pulse_ticks: timing.pulse_high.max(1) as u32,
                setup_ticks: timing.dir_setup as u32,
            }
        }
        program::Wiring::Coils { pins, sequence } => Wiring::Coils {
            lines: pins.map(line),
            sequence: match sequence {
                CoilSequence::Wave => Sequence::Wave,
                CoilSequence::Full => Sequence::Full,
                CoilSequence::Half => Sequence::Half,
            },
            release_ticks: None,
        },
    }
}
