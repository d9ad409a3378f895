//! From a motion file to what can be planned: a board, settings for each motor, an end for endless laws.

use std::path::Path;

use miette::Diagnostic;
use pulsetrain_motion::law::{Cursor, Law};
use pulsetrain_motion::program::{BoardError, Motor, Program};
use pulsetrain_motion::{LawError, Time, boards, file};
use pulsetrain_plan::{Certificate, Move, PlanError, Planner, Settings};

use crate::fit;

/// How much of an endless motion is shown, s, if nobody says.
pub const DEFAULT_LENGTH_S: f64 = 10.0;

/// Where nothing says how hard a motor may be braked, it stops within this time, s.
const SOFTEST_STOP_S: f64 = 1.0;

/// A motion that can be planned.
#[derive(Clone, Debug)]
pub struct Prepared {
    /// The motion file, as it was called.
    pub file: String,
    /// What it says; every law ends.
    pub program: Program,
    /// Where endless laws were cut; they brake from there.
    pub cut_at: Option<Time>,
}

/// Why a motion cannot be prepared or planned.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum Refusal {
    /// The motion does not fit the board that the user asked for.
    #[error("{file}: {error}")]
    Board {
        /// The motion file.
        file: String,
        /// What is wrong.
        error: BoardError,
    },
    /// A law breaks before it can be cut.
    #[error("{file}: motor {motor}: {error}")]
    Law {
        /// The motion file.
        file: String,
        /// Whose.
        motor: String,
        /// How.
        error: LawError,
    },
    /// A plan would break a limit.
    #[error("{file}: motor {motor}: {error}")]
    Plan {
        /// The motion file.
        file: String,
        /// Whose.
        motor: String,
        /// Which limit, where.
        error: PlanError,
        /// What would fit.
        #[help]
        advice: String,
    },
}

impl Prepared {
    /// Reads a motion file, puts it on `board` if that is given, and cuts endless laws after `length`.
    ///
    /// # Errors
    /// When the file is wrong, or does not fit the board.
    pub fn load(path: &Path, board: Option<&str>, length: Option<Time>) -> miette::Result<Prepared> {
        let mut program = file::load(path)?;
        let file = path.display().to_string();
        if let Some(row) = board.and_then(boards::find) {
            program = program.with_board(row.board).map_err(|error| Refusal::Board { file: file.clone(), error })?;
        }
        let cut_at =
            cut(&mut program, length).map_err(|(motor, error)| Refusal::Law { file: file.clone(), motor, error })?;
        Ok(Prepared { file, program, cut_at })
    }

    /// What the plan of a motor must keep to.
    #[must_use]
    pub fn settings(&self, motor: &Motor) -> Settings {
        settings(&self.program, motor)
    }

    /// Plans every motor and hands each move on; nothing is kept.
    ///
    /// # Errors
    /// When a plan would break a limit: with what would fit.
    pub fn plan(&self, mut watch: impl FnMut(f64)) -> Result<Vec<Planned>, Refusal> {
        self.program
            .motors
            .iter()
            .map(|motor| {
                let mut steps_from_s = 0.0;
                certify(&motor.law, &self.settings(motor), |seconds| {
                    watch(seconds - steps_from_s);
                    steps_from_s = seconds;
                })
                .map_err(|error| self.refuse(motor, error))
            })
            .collect()
    }

    /// A plan's error as the user should see it.
    #[must_use]
    pub fn refuse(&self, motor: &Motor, error: PlanError) -> Refusal {
        let advice = fit::advice(self, motor, &error);
        Refusal::Plan { file: self.file.clone(), motor: motor.name.clone(), error, advice }
    }

    /// When the last law ends, s.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.program.motors.iter().filter_map(|motor| motor.law.end()).map(Time::seconds).fold(0.0, f64::max)
    }
}

/// What the plan of a motor of `program` must keep to.
#[must_use]
pub fn settings(program: &Program, motor: &Motor) -> Settings {
    let board = &program.board;
    let ticks = |ns: u32| ticks(ns, board.tick_hz);
    let timing = &motor.timing;
    // The last entry serves for more motors.
    let own = board.min_interval_ticks.get(program.motors.len() - 1).or(board.min_interval_ticks.last());
    let pulse = ticks(timing.pulse_high_ns) + ticks(timing.pulse_low_ns);
    Settings {
        tolerance_ticks: program.tolerance.ticks(board.tick_hz),
        grid: program.grid,
        min_interval_ticks: own.map_or(1, |own| u64::from(*own)).max(pulse),
        reversal_ticks: ticks(timing.pulse_high_ns) + ticks(timing.dir_hold_ns) + ticks(timing.dir_setup_ns),
        limits: motor.limits,
        ..Settings::new(board.tick_hz, board.fraction_bits)
    }
}

/// Nanoseconds as whole ticks, rounded up.
#[must_use]
pub fn ticks(ns: u32, tick_hz: u64) -> u64 {
    // 2^32 ns at 2^64 Hz would not fit; boards tick at some 10^8 Hz.
    (u128::from(ns) * u128::from(tick_hz)).div_ceil(1_000_000_000) as u64
}

/// A motor's plan, in figures.
#[derive(Clone, Debug)]
pub struct Planned {
    /// What is proven.
    pub certificate: Certificate,
    /// The tick of the last step.
    pub last_tick: u64,
}

/// Plans a law to its end; `watch` hears how far it is, s.
///
/// # Errors
/// When the plan would break a limit.
pub fn certify(law: &Law, settings: &Settings, mut watch: impl FnMut(f64)) -> Result<Planned, PlanError> {
    let mut planner = Planner::new(law, settings)?;
    let mut moves: u32 = 0;
    let mut last_tick = 0;
    while let Some(next) = planner.next_move()? {
        if matches!(next, Move::Run { .. }) {
            last_tick = planner.tick().unsigned_abs();
        }
        moves = moves.wrapping_add(1);
        if moves.is_multiple_of(256) {
            watch(planner.tick() as f64 / settings.tick_hz as f64);
        }
    }
    Ok(Planned { certificate: planner.certificate().clone(), last_tick })
}

/// Gives every endless law an end: after `length`, or after the default but not before the finite laws end. A
/// `length` that is given cuts finite laws too. Returns the time of the cut, if one was made.
fn cut(program: &mut Program, length: Option<Time>) -> Result<Option<Time>, (String, LawError)> {
    let ends: Vec<Option<Time>> = program.motors.iter().map(|motor| motor.law.end()).collect();
    let at = match length {
        Some(length) => length,
        None if ends.iter().all(Option::is_some) => return Ok(None),
        None => ends.iter().copied().flatten().fold(Time::from_seconds(DEFAULT_LENGTH_S), Time::max),
    };
    let mut cut = false;
    for (motor, end) in program.motors.iter_mut().zip(ends) {
        if end.is_some_and(|end| end <= at) {
            continue;
        }
        let limits = motor.limits;
        let stopped = braking(&motor.law, at, limits.max_acceleration)
            .and_then(|braking| motor.law.clone().stopped(at, braking, limits.pull_in));
        motor.law = stopped.map_err(|error| (motor.name.clone(), error))?;
        cut = true;
    }
    Ok(cut.then_some(at))
}

/// How hard to brake, steps/s²: by the motor's limit, else by what the law itself asked for before, else softly.
fn braking(law: &Law, at: Time, limit: Option<f64>) -> Result<f64, LawError> {
    const LOOKS: u64 = 1000;
    if let Some(limit) = limit {
        return Ok(limit);
    }
    let mut cursor = Cursor::new(law);
    let mut hardest = 0.0_f64;
    // The last seconds are looked at: the law is walked through once, whatever its length.
    let span = at.min(Time::from_seconds(DEFAULT_LENGTH_S));
    for k in 0..=LOOKS {
        let sample = cursor.at(at - span + span.times(k).divided_by(LOOKS))?;
        hardest = hardest.max(sample.acceleration.abs());
    }
    let speed = cursor.at(at)?.speed.abs();
    Ok(hardest.max(speed / SOFTEST_STOP_S).max(f64::MIN_POSITIVE))
}
