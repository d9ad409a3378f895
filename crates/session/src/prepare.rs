//! From a motion file to a motion that can be planned: chooses the board, gives endless laws an end, plans, and says what would fit.

use pulsetrain_board::BoardKind;
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::boards::PinsError;
use pulsetrain_motion::file::{Contents, TableColumns};
use pulsetrain_motion::law::{Cursor, Ease, Law};
use pulsetrain_motion::program::{BoardError, Limits, Program, TipRecording};
use pulsetrain_motion::time::Rate;
use pulsetrain_motion::{Grid, LawError, Time, boards};
use pulsetrain_plan::{Line, PlanError, SOFTEST_STOP_S, Way};

use crate::pause::{self, PauseError, Paused};

/// Seconds of an endless motion that are planned if the user gives no length: enough to see it, short enough to wait for.
pub const DEFAULT_LENGTH_S: f64 = 10.0;

/// The length of a motion whose endless laws stay endless.
pub const FOREVER: Time = Time::MAX;

/// The most that a board's clock can be off, ppm: twice the tolerance of a ceramic resonator (0.5 %).
pub const WORST_CLOCK_PPM: f64 = 10_000.0;

/// A motion that can be planned.
#[derive(Clone, Debug)]
pub struct Prepared {
    /// The name of the motion file, as the user gave it.
    pub file: String,
    /// Its program. Every law ends after [`Prepared::ending`].
    pub program: Program,
    /// Where longer laws were cut; `None` if none was.
    pub cut: Option<Cut>,
    /// The pause that was inserted by [`Prepared::pause`].
    pub pause: Option<Paused>,
    /// The line over which the plan comes to the board while it runs; `None` if it does not come over a line.
    pub line: Option<Line>,
    /// How the columns of its CSV files were read.
    pub tables: Vec<TableColumns>,
    /// Of each machine: its recording, if it is a delta robot whose only motion that is.
    pub recordings: Vec<Option<TipRecording>>,
}

/// Where a motion was cut: from there motors brake, and machines slow down along their path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cut {
    /// From the laws' beginning on.
    pub at: Time,
    /// When the motion would have ended without the cut; `None` if never.
    pub end: Option<Time>,
}

/// Why a motion cannot be prepared or planned.
#[derive(Debug, thiserror::Error)]
pub enum Refusal {
    /// The motion does not fit the board that the user asked for.
    #[error("{file}: {error}")]
    Board {
        /// The motion file.
        file: String,
        /// Why it does not fit.
        error: BoardError,
    },
    /// The board cannot drive the pins of the motors together.
    #[error("{file}: {error}")]
    Pins {
        /// The motion file.
        file: String,
        /// Which pins do not go together.
        error: PinsError,
        /// Which pins would fit.
        advice: String,
    },
    /// A law cannot be evaluated before the place where it is to be cut.
    #[error("{file}: motor {motor}: {error}")]
    Law {
        /// The motion file.
        file: String,
        /// The motor's name.
        motor: String,
        /// Why it cannot be evaluated.
        error: LawError,
    },
    /// The motion ends before the pause would begin.
    #[error("{file}: a pause at {at_s} s comes too late: the motion ends at {end_s} s")]
    Over {
        /// The motion file.
        file: String,
        /// When the pause was to begin, s.
        at_s: f64,
        /// When the last law ends, s.
        end_s: f64,
    },
    /// The motion cannot be paused there.
    #[error("{file}: {error}")]
    Pause {
        /// The motion file.
        file: String,
        /// Why not.
        error: PauseError,
    },
    /// A plan would break a limit.
    #[error("{file}: motor {motor}: {error}")]
    Plan {
        /// The motion file.
        file: String,
        /// The motor's name.
        motor: String,
        /// Which limit, and where.
        error: PlanError,
        /// What would fit.
        advice: String,
    },
}

impl Refusal {
    /// What the user can do, if something is known to help.
    #[must_use]
    pub fn advice(&self) -> Option<&str> {
        match self {
            Refusal::Pins { advice, .. } | Refusal::Plan { advice, .. } => Some(advice),
            Refusal::Board { .. } | Refusal::Law { .. } | Refusal::Over { .. } | Refusal::Pause { .. } => None,
        }
    }
}

impl Prepared {
    /// The motion of a file, for the board named `board` if that is given, else for the file's own. Endless laws stay endless. `file` is the file's
    /// name, for messages.
    ///
    /// # Errors
    /// When the motion does not fit the board.
    pub fn new(file: String, contents: Contents, board: Option<&str>) -> Result<Prepared, Refusal> {
        let Contents { mut program, tables, recordings, .. } = contents;
        if let Some(profile) = board.and_then(boards::find) {
            program =
                program.with_board(profile.limits()).map_err(|error| Refusal::Board { file: file.clone(), error })?;
        }
        let refuse = |error: PinsError| Refusal::Pins { file: file.clone(), advice: error.advice(), error };
        wire(&mut program).map_err(refuse)?;
        Ok(Prepared { file, program, cut: None, pause: None, line: None, tables, recordings })
    }

    /// Cuts the laws after `length`, if that is not [`FOREVER`]. Without one, only endless laws are cut: after [`DEFAULT_LENGTH_S`], but not before the finite laws end.
    ///
    /// # Errors
    /// When a law cannot be evaluated before the cut.
    pub fn ending(self, length: Option<Time>) -> Result<Prepared, Refusal> {
        let Prepared { file, mut program, line, tables, recordings, .. } = self;
        let cut =
            cut(&mut program, length).map_err(|(motor, error)| Refusal::Law { file: file.clone(), motor, error })?;
        Ok(Prepared { file, program, cut, pause: None, line, tables, recordings })
    }

    /// Plans for a board whose clock runs `ppm` parts per million faster than its nominal rate, so that a second of the law is a second of the clock
    /// that measured this. The rate is rounded to whole ticks a second: on an Uno to 0.03 ppm.
    pub fn calibrate(&mut self, ppm: f64) {
        let hz = &mut self.program.board.tick_hz;
        *hz = (*hz as f64 * (1.0 + ppm * 1e-6)).round() as u64;
    }

    /// Inserts a pause: the motors slow down to a halt from `at` on, and go on at `until`; see [`pause::paused`].
    ///
    /// # Errors
    /// When the motion is over by then, or leaves no room for it.
    pub fn pause(&mut self, at: Time, until: Option<Time>) -> Result<(), Refusal> {
        let file = || self.file.clone();
        if !self.is_endless() && self.end_s() <= at.seconds() {
            return Err(Refusal::Over { file: file(), at_s: at.seconds(), end_s: self.end_s() });
        }
        let (program, paused) =
            pause::paused(&self.program, at, until).map_err(|error| Refusal::Pause { file: file(), error })?;
        (self.program, self.pause) = (program, Some(paused));
        Ok(())
    }

    /// Lets the plan come to the board over a UART at `baud`; without a rate, by the [usual line](usual_line).
    pub fn over_line(&mut self, baud: Option<Baud>) {
        self.line = match baud {
            Some(baud) => Line::of(&self.program, Way::Uart(baud.rate())),
            None => usual_line(&self.program),
        };
    }

    /// Whether a law has no end.
    #[must_use]
    pub fn is_endless(&self) -> bool {
        self.program.motors.iter().any(|motor| motor.law.end().is_none())
    }

    /// When the last law ends, s.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.program.motors.iter().filter_map(|motor| motor.law.end()).map(Time::seconds).fold(0.0, f64::max)
    }
}

/// Gives the program's board the limits that it has with these motors' pins.
///
/// # Errors
/// If the board cannot drive the pins together.
pub(crate) fn wire(program: &mut Program) -> Result<(), PinsError> {
    let profile = program.board.profile;
    profile.check_pins(&program.motors)?;
    program.board.min_interval_ticks = profile.shortest_intervals(&program.motors);
    program.board.turn_ticks = profile.turn_ticks(&program.motors);
    program.board.shared_steps = profile.shared_steps(&program.motors);
    Ok(())
}

/// The [usual rate](BoardKind::usual_baud) of the line to a board.
#[must_use]
pub fn usual_baud(board: &str) -> Baud {
    BoardKind::named(board).map_or(Baud::B1M, BoardKind::usual_baud)
}

/// The line by which plans usually come to a board: its own USB, or a UART at its [usual rate](usual_baud).
#[must_use]
pub fn usual_line(program: &Program) -> Option<Line> {
    Line::of(program, Way::Usb).or_else(|| Line::of(program, Way::Uart(usual_baud(&program.board.name).rate())))
}

/// When each motor's law ends; `None`: never.
fn ends(program: &Program) -> Vec<Option<Time>> {
    program.motors.iter().map(|motor| motor.law.end()).collect()
}

/// When longer laws are cut; `None` if no law is to be cut.
fn cut_at(ends: &[Option<Time>], length: Option<Time>) -> Option<Time> {
    let is_endless = ends.iter().any(Option::is_none);
    let default = || ends.iter().copied().flatten().fold(Time::from_seconds(DEFAULT_LENGTH_S), Time::max);
    length.or_else(|| is_endless.then(default))
}

/// How long each motor's law lasts once it is cut, without the stop after the cut.
pub(crate) fn spans(program: &Program, length: Option<Time>) -> Vec<Time> {
    let ends = ends(program);
    let at = cut_at(&ends, length).unwrap_or(Time::MAX);
    ends.into_iter().map(|end| end.map_or(at, |end| end.min(at))).collect()
}

/// Gives every endless law an end: after `length`, or after the default but not before the finite laws end. A
/// `length` that is given cuts finite laws too.
pub(crate) fn cut(program: &mut Program, length: Option<Time>) -> Result<Option<Cut>, (String, LawError)> {
    let ends = ends(program);
    let Some(at) = cut_at(&ends, length).filter(|at| *at < FOREVER) else { return Ok(None) };
    let goes_on = |end: &Option<Time>| end.is_none_or(|end| end > at);
    if !ends.iter().any(goes_on) {
        return Ok(None);
    }
    let mut brakes: Vec<bool> = ends.iter().map(goes_on).collect();
    for machine in program.machines.clone() {
        if machine.motors.iter().any(|motor| brakes[*motor]) && keeps_to_path(program, &machine.motors, at) {
            machine.motors.iter().for_each(|motor| brakes[*motor] = false);
        }
    }
    let grid = program.grid;
    for (motor, _) in program.motors.iter_mut().zip(brakes).filter(|(_, brakes)| *brakes) {
        motor.law = stopped(&motor.law, at, motor.limits, grid).map_err(|error| (motor.name.clone(), error))?;
    }
    let end = ends.iter().copied().collect::<Option<Vec<Time>>>().and_then(|ends| ends.into_iter().max());
    Ok(Some(Cut { at, end }))
}

/// Slows a machine's motors down to a halt from `at` on, along their path, as for a pause. Returns false and changes nothing if their limits leave
/// no room for that.
fn keeps_to_path(program: &mut Program, motors: &[usize], at: Time) -> bool {
    let mut machine = program.clone();
    machine.motors = motors.iter().map(|motor| program.motors[*motor].clone()).collect();
    let halt = (Rate::ONE, Rate::ZERO);
    let Ok(Ease { after, over, .. }) = pause::quickest(&machine, at, halt, 1.0, Rate::ONE) else { return false };
    let eased = machine.motors.into_iter().map(|motor| motor.law.eased_out(Time::ZERO, at + after, over));
    let Ok(eased) = eased.collect::<Result<Vec<Law>, LawError>>() else { return false };
    for (motor, law) in motors.iter().zip(eased) {
        program.motors[*motor].law = law;
    }
    true
}

/// A law that is brought to rest from `at` on.
pub(crate) fn stopped(law: &Law, at: Time, limits: Limits, grid: Grid) -> Result<Law, LawError> {
    let braking = braking(law, at, limits.max_acceleration, grid)?;
    law.clone().stopped(at, braking, limits.pull_in)
}

/// How hard to brake, steps/s². By the motor's limit; else as hard as the law itself accelerated before; else softly. A little less than that, so
/// that the motor does not come to rest just where a step is due, whose time would be undefined.
fn braking(law: &Law, at: Time, limit: Option<f64>, grid: Grid) -> Result<f64, LawError> {
    /// Places of the law whose acceleration is read: one each 10 ms.
    const LOOKS: u64 = 1000;
    let mut cursor = Cursor::new(law);
    let start = cursor.at(Time::ZERO)?;
    let mut hardest = 0.0_f64;
    // Only the last seconds are read: a long law would take too long.
    let span = at.min(Time::from_seconds(DEFAULT_LENGTH_S));
    for k in 0..=LOOKS {
        let sample = cursor.at(at - span + span.times(k).divided_by(LOOKS))?;
        hardest = hardest.max(sample.acceleration.abs());
    }
    let from = cursor.at(at)?;
    let speed = from.speed.abs();
    let braking = limit.unwrap_or(hardest.max(speed / SOFTEST_STOP_S));
    if speed == 0.0 || braking == 0.0 {
        return Ok(1.0);
    }
    let way = speed * speed / (2.0 * braking);
    // θ in the direction of travel, from the law's start. The motor shall rest half a step from the level of a step.
    let theta = (from.position - start.position) * from.speed.signum() + way;
    let rest = grid.up_level(0) - 0.5;
    let longer = (rest - theta).rem_euclid(1.0);
    Ok(speed * speed / (2.0 * (way + longer)))
}
