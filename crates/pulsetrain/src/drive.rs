//! Motions on the native board: a session, in virtual time and bounded memory.

use miette::Diagnostic;
use pulsetrain_board::native::{ConfigError, Faults};
use pulsetrain_board::{Config, Edge, MotorConfig, Native, Observer, ScheduledStep, Wiring};
use pulsetrain_core::output::Sequence;
use pulsetrain_motion::program::{self, CoilSequence, Motor, Program};
use pulsetrain_trace::{Line, lines};

use crate::prepare::Prepared;
use crate::session::{Session, SessionError};

/// Why a run did not come to its end.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum DriveError {
    /// The session could not begin or go on.
    #[error(transparent)]
    Session(#[from] SessionError),
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

/// A prepared motion on the native board, in virtual time, just before its laws begin.
pub struct Driven<'a> {
    session: Session<'a, Native>,
    program: &'a Program,
    /// The lines of its traces, as they stand when the laws begin.
    pub lines: Vec<Line>,
}

impl<'a> Driven<'a> {
    /// Sends the beginning of the motion and lets the board come to the tick at which the laws begin.
    ///
    /// # Errors
    /// When the board cannot be wired so, or the plan is refused, which [`Prepared::plan`] would have said before.
    pub fn new(prepared: &'a Prepared) -> Result<Driven<'a>, DriveError> {
        let program = &prepared.program;
        let mut session = Session::new(Native::new(&config(program))?, program)?;
        let mut lines = lines::of(program);
        // A first step soon after the start has its DIR set before: in a trace that is where the line begins.
        session.advance(session.zero() - 1, &mut |edge: Edge| lines[usize::from(edge.line)].initial = edge.level)?;
        Ok(Driven { session, program, lines })
    }

    /// Runs it to its end; what is observed has the laws' time, and `watch` hears how far it is, s.
    ///
    /// # Errors
    /// When the motion stopped before its end, or the board and the host count differently: faults of ours.
    pub fn run(mut self, observer: &mut impl Observer, mut watch: impl FnMut(f64)) -> Result<(), DriveError> {
        let zero = self.session.zero();
        let hz = self.program.board.tick_hz as f64;
        let report =
            self.session.run(&mut Since { zero, observer }, |tick| watch(tick.saturating_sub(zero) as f64 / hz));
        if let Some(failure) = report.failure {
            return Err(failure.into());
        }
        let counts = report.counted.iter().zip(&report.replayed).zip(&report.faults);
        for (motor, ((counted, replayed), faults)) in self.program.motors.iter().zip(counts) {
            if counted != replayed || *faults != Faults::default() {
                return Err(DriveError::Missed { motor: motor.name.clone() });
            }
        }
        Ok(())
    }
}

/// Counts an observer's ticks from the laws' beginning.
struct Since<'o, O> {
    zero: u64,
    observer: &'o mut O,
}

impl<O: Observer> Observer for Since<'_, O> {
    fn edge(&mut self, edge: Edge) {
        self.observer.edge(Edge { tick: edge.tick - self.zero, ..edge });
    }

    fn step(&mut self, step: ScheduledStep) {
        self.observer.step(ScheduledStep { tick: step.tick - self.zero, ..step });
    }
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
