//! From a motion file to a motion that can be planned: chooses the board, gives endless laws an end, plans, and says what would fit.

use pulsetrain_board::BoardKind;
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::file::{Contents, TableColumns};
use pulsetrain_motion::law::{Cursor, Law};
use pulsetrain_motion::pins::PinsError;
use pulsetrain_motion::program::{BoardError, Limits, Program};
use pulsetrain_motion::{Grid, LawError, Time, boards};
use pulsetrain_plan::SOFTEST_STOP_S;
use pulsetrain_plan::{
    Certificate, Demand, Ensemble, Line, Move, PlanError, Planner, Refused, Settings, Supply, Way, stopping,
};

use crate::estimate::{Estimate, Task};
use crate::fit;
use crate::pause::{self, Easing, PauseError, Paused};

/// Seconds of an endless motion that are planned if the user gives no length: enough to see it, short enough to wait for.
pub const DEFAULT_LENGTH_S: f64 = 10.0;

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
        let Contents { mut program, tables } = contents;
        if let Some(row) = board.and_then(boards::find) {
            program = program.with_board(row.board).map_err(|error| Refusal::Board { file: file.clone(), error })?;
        }
        if let Some(row) = boards::find(&program.board.name) {
            let refuse = |error: PinsError| Refusal::Pins { file: file.clone(), advice: error.advice(), error };
            row.pin_kind(&program.motors).map_err(refuse)?;
            program.board.min_interval_ticks = row.shortest_intervals(&program.motors);
            program.board.turn_ticks = row.turn_ticks(&program.motors);
            program.board.shared_steps = row.shared_steps(&program.motors);
        }
        Ok(Prepared { file, program, cut: None, pause: None, line: None, tables })
    }

    /// Cuts the laws after `length`. Without one, only endless laws are cut: after [`DEFAULT_LENGTH_S`], but not before the finite laws end.
    ///
    /// # Errors
    /// When a law cannot be evaluated before the cut.
    pub fn ending(self, length: Option<Time>) -> Result<Prepared, Refusal> {
        let Prepared { file, mut program, line, tables, .. } = self;
        let cut =
            cut(&mut program, length).map_err(|(motor, error)| Refusal::Law { file: file.clone(), motor, error })?;
        Ok(Prepared { file, program, cut, pause: None, line, tables })
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
        if self.end_s() <= at.seconds() {
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

    /// Plans all motors side by side, and keeps only the figures. `watch` gets the time up to which the plan has come, s.
    ///
    /// # Errors
    /// When a plan would break a limit, with advice on what would fit.
    pub fn plan(&self, watch: impl FnMut(f64)) -> Result<Vec<Planned>, Refusal> {
        self.try_plan(watch).map_err(|refused| self.refuse(refused))
    }

    /// As [`Prepared::plan`]. If equal parts of the board's queues are too short, each motor gets a part by what its plan needs.
    ///
    /// # Errors
    /// As [`Prepared::plan`].
    pub fn plan_by_need(&mut self, mut watch: impl FnMut(f64)) -> Result<Vec<Planned>, Refusal> {
        let refused = match self.try_plan(&mut watch) {
            Ok(planned) => return Ok(planned),
            Err(refused) => refused,
        };
        if matches!(refused.error, PlanError::QueueTooShort { .. })
            && let Some(shared) = self.with_queues_by_need()
            && let Ok(planned) = shared.try_plan(watch)
        {
            *self = shared;
            return Ok(planned);
        }
        Err(self.refuse(refused))
    }

    fn try_plan(&self, watch: impl FnMut(f64)) -> Result<Vec<Planned>, Refused> {
        Plans::new(&self.program, self.line.as_ref())?.run(watch)
    }

    /// This motion, with queues that last equally long for all motors. `None` if there is no line, one motor only, or no better way to share.
    fn with_queues_by_need(&self) -> Option<Prepared> {
        let line = self.line.as_ref()?;
        let motors = self.program.motors.len();
        if motors < 2 {
            return None;
        }
        let mut plans = Plans::new(&self.program, None).ok()?;
        let mut demand =
            Demand::new(self.program.board.tick_hz, (0..motors).map(|motor| plans.ensemble.settings(motor)));
        while let Some((motor, from, next)) = plans.next_move().ok()? {
            demand.add(motor, &next, from);
        }
        let mut shared = self.clone();
        shared.program.queue_parts = demand.parts(line)?;
        shared.line = Some(line.with_parts(&shared.program.queue_parts));
        Some(shared)
    }

    /// Plans as much of the beginning as takes 0.2 s at most, so that an error there is found before a long plan.
    ///
    /// # Errors
    /// As [`Prepared::plan`].
    pub fn begins(&self) -> Result<(), Refusal> {
        /// Estimated planning time, s: too short to be noticed.
        const MOST_S: f64 = 0.2;
        let planning_s = Estimate::of(self, Some(Time::SECOND), Task::Plan).planning_s;
        let length = Time::from_seconds((MOST_S / planning_s).min(1.0));
        // The whole motion may be right even if it cannot be cut or stopped there.
        let Ok(begun) = self.clone().ending(Some(length)) else { return Ok(()) };
        let is_of_motion = |refused: &Refused| refused.error.at_s().is_some_and(|at_s| at_s < length.seconds());
        match begun.try_plan(|_| {}) {
            Err(refused) if is_of_motion(&refused) => Err(self.refuse(refused)),
            _ => Ok(()),
        }
    }

    /// A refused plan, with names and with advice for the user.
    #[must_use]
    pub fn refuse(&self, refused: Refused) -> Refusal {
        // Advice needs laws that end. If a law cannot be cut, that is the problem to report.
        let mut ended = self.clone();
        let advice = match cut(&mut ended.program, None) {
            Ok(now) => {
                ended.cut = ended.cut.or(now);
                fit::advice(&ended, &ended.program.motors[refused.motor], &refused.error)
            }
            Err((motor, error)) => format!("{motor}: {error}"),
        };
        let motor = self.program.motors[refused.motor].name.clone();
        Refusal::Plan { file: self.file.clone(), motor, error: refused.error, advice }
    }

    /// When the last law ends, s.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.program.motors.iter().filter_map(|motor| motor.law.end()).map(Time::seconds).fold(0.0, f64::max)
    }
}

/// The figures of a motor's plan.
#[derive(Clone, Debug)]
pub struct Planned {
    /// What is proven of the plan: steps, shortest interval, highest speed and acceleration.
    pub certificate: Certificate,
    /// The tick of the last step.
    pub last_tick: u64,
}

/// The [usual rate](BoardKind::usual_baud) of the line to the board of that name; 1 Mbaud for a board without a firmware.
#[must_use]
pub fn usual_baud(board: &str) -> Baud {
    BoardKind::named(board).map_or(Baud::B1M, BoardKind::usual_baud)
}

/// The line by which plans usually come to a board: its own USB, or a UART at its [usual rate](usual_baud).
#[must_use]
pub fn usual_line(program: &Program) -> Option<Line> {
    Line::of(program, Way::Usb).or_else(|| Line::of(program, Way::Uart(usual_baud(&program.board.name).rate())))
}

/// The moves of all motors, in the order of the ticks at which they begin.
pub struct Plans<'a> {
    program: &'a Program,
    ensemble: Ensemble,
    supply: Option<Supply>,
    clocks: Vec<Clock>,
}

/// Up to which time a motor is planned.
#[derive(Clone, Copy, Debug)]
struct Clock {
    tick: u64,
    /// The part of a tick after `tick`, in units of 2^-F tick.
    fraction: i128,
    last_step: u64,
    ended: bool,
}

impl<'a> Plans<'a> {
    /// Prepares to plan all motors of a program. If there is a line, their plans must come over it in time.
    ///
    /// # Errors
    /// As [`Ensemble::new`].
    pub fn new(program: &'a Program, line: Option<&Line>) -> Result<Plans<'a>, Refused> {
        Plans::slowed(program, line, 1.0)
    }

    /// As [`Plans::new`], with laws that are `factor` times slower.
    ///
    /// # Errors
    /// As [`Ensemble::new`].
    pub fn slowed(program: &'a Program, line: Option<&Line>, factor: f64) -> Result<Plans<'a>, Refused> {
        let clocks = vec![Clock::new(program.board.fraction_bits); program.motors.len()];
        let ensemble = Ensemble::slowed(program, factor)?;
        let supply =
            line.map(|line| Supply::new(line.clone(), (0..clocks.len()).map(|motor| ensemble.settings(motor))));
        Ok(Plans { program, ensemble, supply, clocks })
    }

    /// The motor that is planned least far, and up to which tick; `None` when all have ended.
    #[must_use]
    fn least_far(&self) -> Option<(usize, u64)> {
        let going = self.clocks.iter().enumerate().filter(|(_, clock)| !clock.ended);
        going.map(|(motor, clock)| (motor, clock.tick)).min_by_key(|(_, tick)| *tick)
    }

    /// The next move of the motor that is planned least far, and the tick at which it begins; `None` when all have ended.
    ///
    /// # Errors
    /// As [`Ensemble::next_move`], and where the line would not bring a move in time.
    fn next_move(&mut self) -> Result<Option<(usize, u64, Move)>, Refused> {
        while let Some((motor, _)) = self.least_far() {
            let clock = &mut self.clocks[motor];
            match self.ensemble.next_move(motor)? {
                Some(next) => {
                    let from = clock.tick;
                    let added = self.supply.as_mut().map_or(Ok(()), |supply| supply.add(motor, &next, from));
                    added.map_err(|error| Refused { motor, error })?;
                    clock.advance(&next, self.program.board.fraction_bits);
                    return Ok(Some((motor, from, next)));
                }
                None => clock.ended = true,
            }
        }
        Ok(None)
    }

    /// Plans all that is left. `watch` gets the time up to which the plan has come, s.
    ///
    /// # Errors
    /// When a plan would break a limit, or the board could not brake the motors.
    pub fn run(mut self, mut watch: impl FnMut(f64)) -> Result<Vec<Planned>, Refused> {
        let mut moves: u32 = 0;
        while let Some((_, from, _)) = self.next_move()? {
            moves = moves.wrapping_add(1);
            if moves.is_multiple_of(256) {
                watch(from as f64 / self.program.board.tick_hz as f64);
            }
        }
        self.brake()?;
        Ok(self.finish())
    }

    /// Checks that the board can brake each motor within its limits, from the speeds that were planned.
    ///
    /// # Errors
    /// [`PlanError::BrakesTooHard`].
    fn brake(&self) -> Result<(), Refused> {
        self.program.motors.iter().enumerate().try_for_each(|(index, motor)| {
            let peaks = self.ensemble.certificate(index);
            stopping(&peaks, &motor.limits, &self.program.board)
                .map(drop)
                .map_err(|error| Refused { motor: index, error })
        })
    }

    /// The figures of every motor's plan.
    #[must_use]
    fn finish(&self) -> Vec<Planned> {
        let motors = self.clocks.iter().enumerate();
        motors
            .map(|(motor, clock)| Planned { certificate: self.ensemble.certificate(motor), last_tick: clock.last_step })
            .collect()
    }
}

impl Clock {
    fn new(fraction_bits: u32) -> Clock {
        Clock { tick: 0, fraction: 1 << (fraction_bits - 1), last_step: 0, ended: false }
    }

    fn advance(&mut self, next: &Move, fraction_bits: u32) {
        match next {
            Move::Dwell { ticks } => self.tick += ticks,
            Move::Run { segment, .. } => {
                let fixed = (i128::from(self.tick) << fraction_bits) + self.fraction + segment.span(segment.count);
                self.tick = (fixed >> fraction_bits) as u64;
                self.fraction = fixed & ((1 << fraction_bits) - 1);
                self.last_step = self.tick;
            }
        }
    }
}

/// Plans a single law and keeps only what is proven of the plan.
///
/// # Errors
/// The first limit of `settings` that the plan breaks.
pub fn planned(law: &Law, settings: &Settings) -> Result<Certificate, PlanError> {
    let mut planner = Planner::new(law, settings)?;
    while planner.next_move()?.is_some() {}
    Ok(planner.certificate().clone())
}

/// As [`planned`], for its errors alone.
///
/// # Errors
/// As [`planned`].
pub fn walk(law: &Law, settings: &Settings) -> Result<(), PlanError> {
    planned(law, settings).map(drop)
}

/// Whether the plan of a single law keeps to `settings` up to the time `until`.
#[must_use]
pub fn fits_until(law: &Law, settings: &Settings, until: Time) -> bool {
    let Ok(mut planner) = Planner::new(law, settings) else { return false };
    let (mut clock, last_tick) = (Clock::new(settings.fraction_bits), until.seconds() * settings.tick_hz as f64);
    while (clock.tick as f64) < last_tick {
        match planner.next_move() {
            Ok(Some(next)) => clock.advance(&next, settings.fraction_bits),
            Ok(None) => break,
            Err(_) => return false,
        }
    }
    true
}

/// Whether the plan of a single law keeps to `settings`.
#[must_use]
pub fn fits(law: &Law, settings: &Settings) -> bool {
    walk(law, settings).is_ok()
}

/// Whether the plans of all motors keep to every limit, and come over the line in time, if their laws are `factor` times slower.
#[must_use]
pub fn all_fit(program: &Program, line: Option<&Line>, factor: f64) -> bool {
    Plans::slowed(program, line, factor).and_then(|plans| plans.run(|_| {})).is_ok()
}

/// When each motor's law ends; `None` for an endless law.
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

/// Cuts the laws as [`Prepared::ending`] says.
fn cut(program: &mut Program, length: Option<Time>) -> Result<Option<Cut>, (String, LawError)> {
    let ends = ends(program);
    let Some(at) = cut_at(&ends, length) else { return Ok(None) };
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
    let Ok(Easing { after, over }) = pause::quickest_halt(&machine, at, 1.0) else { return false };
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
