//! The plans of all motors side by side, held against every limit and against the line.

use pulsetrain_motion::program::Program;
use pulsetrain_motion::{Law, Time};
use std::sync::Arc;

use pulsetrain_plan::{
    Certificate, Ensemble, Line, Move, PlanError, Planner, Refill, Refused, Settings, Supply, stopping,
};

/// A motor's plan, in figures.
#[derive(Clone, Debug)]
pub struct Planned {
    /// What is proven.
    pub certificate: Certificate,
    /// The tick of the last step.
    pub last_tick: u64,
    /// The lowest and the highest position, steps from the start.
    pub range: (i64, i64),
    /// The refill of its queue that is the closest to coming too late. `None` without a line, or if the queue takes the whole plan.
    pub tightest: Option<Refill>,
}

/// Moves that are planned before progress is reported.
pub(crate) const MOVES_AT_ONCE: u32 = 256;
/// Moves that are planned to see whether board and line keep up with a change or a higher tempo: at most some 8 ms of work for all rates that are
/// tried. A wait after a wait counts as many moves.
pub(crate) const TRIED_MOVES: u32 = 6_000;

/// The moves of all motors, those of the motor that is least far first.
pub struct Plans {
    program: Arc<Program>,
    pub(crate) ensemble: Ensemble,
    supply: Option<Supply>,
    clocks: Vec<Clock>,
}

/// How far a motor's moves go.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clock {
    tick: u64,
    /// In units of 2^-F tick.
    fraction: i128,
    last_step: u64,
    position: i64,
    range: (i64, i64),
    ended: bool,
}

impl Plans {
    /// Prepares to plan all motors of a program; their plans are held against the line, if there is one.
    ///
    /// # Errors
    /// As [`Ensemble::new`].
    pub fn new(program: Arc<Program>, line: Option<&Line>) -> Result<Plans, Refused> {
        Plans::slowed(program, line, 1.0)
    }

    /// The same of laws that are `factor` times slower.
    ///
    /// # Errors
    /// As [`Ensemble::new`].
    pub fn slowed(program: Arc<Program>, line: Option<&Line>, factor: f64) -> Result<Plans, Refused> {
        let clocks = vec![Clock::new(program.board.registers.fraction_bits); program.motors.len()];
        let ensemble = Ensemble::slowed(&program, factor)?;
        let supply =
            line.map(|line| Supply::new(line.clone(), (0..clocks.len()).map(|motor| ensemble.settings(motor))));
        Ok(Plans { program, ensemble, supply, clocks })
    }

    /// The motor that is least far, and to which tick; `None` when all have ended.
    #[must_use]
    fn least_far(&self) -> Option<(usize, u64)> {
        let going = self.clocks.iter().enumerate().filter(|(_, clock)| !clock.ended);
        going.map(|(motor, clock)| (motor, clock.tick)).min_by_key(|(_, tick)| *tick)
    }

    /// The next move of the motor that is least far, and the tick at which it begins; `None` when all have ended.
    ///
    /// # Errors
    /// As [`Ensemble::next_move`], and where the line does not bring them in time.
    pub(crate) fn next_move(&mut self) -> Result<Option<(usize, u64, Move)>, Refused> {
        while let Some((motor, _)) = self.least_far() {
            let clock = &mut self.clocks[motor];
            match self.ensemble.next_move(motor)? {
                Some(next) => {
                    let from = clock.tick;
                    let added = self.supply.as_mut().map_or(Ok(()), |supply| supply.add(motor, &next, from));
                    added.map_err(|error| Refused { motor, error })?;
                    clock.advance(&next, self.program.board.registers.fraction_bits);
                    return Ok(Some((motor, from, next)));
                }
                None => clock.ended = true,
            }
        }
        Ok(None)
    }

    /// Plans all that is left; `watch` hears how far the plan is, s.
    ///
    /// # Errors
    /// When a plan would break a limit, or the board could not brake the motors.
    pub fn run(mut self, mut watch: impl FnMut(f64)) -> Result<Vec<Planned>, Refused> {
        while self.plan_some(f64::INFINITY, MOVES_AT_ONCE)? {
            watch(self.planned_s().unwrap_or_default());
        }
        self.brake()?;
        Ok(self.finish())
    }

    /// Plans up to `until_s`, or `moves` moves if those are fewer. Returns false when the whole motion is planned.
    ///
    /// # Errors
    /// As [`Plans::run`].
    pub(crate) fn plan_some(&mut self, until_s: f64, moves: u32) -> Result<bool, Refused> {
        for _ in 0..moves {
            if self.planned_s().is_some_and(|planned_s| planned_s >= until_s) {
                break;
            }
            if self.next_move()?.is_none() {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// How far all motors are planned, s; `None` when the whole motion is.
    pub(crate) fn planned_s(&self) -> Option<f64> {
        self.least_far().map(|(_, tick)| tick as f64 / self.program.board.tick_hz as f64)
    }

    /// Checks that the board can brake the motors as their limits want it, from what was planned.
    ///
    /// # Errors
    /// [`PlanError::BrakesTooHard`].
    pub(crate) fn brake(&self) -> Result<(), Refused> {
        self.program.motors.iter().enumerate().try_for_each(|(index, motor)| {
            let peaks = self.ensemble.certificate(index);
            stopping(&peaks, &motor.limits, &self.program.board)
                .map(drop)
                .map_err(|error| Refused { motor: index, error })
        })
    }

    /// The figures of every motor's plan.
    #[must_use]
    pub(crate) fn finish(&self) -> Vec<Planned> {
        let motors = self.clocks.iter().enumerate();
        let tightest = |motor| self.supply.as_ref().and_then(|supply| supply.tightest(motor));
        motors.map(|(motor, clock)| clock.planned(self.ensemble.certificate(motor), tightest(motor))).collect()
    }
}

impl Clock {
    pub(crate) fn new(fraction_bits: u32) -> Clock {
        Clock { tick: 0, fraction: 1 << (fraction_bits - 1), last_step: 0, position: 0, range: (0, 0), ended: false }
    }

    /// The figures of the moves so far.
    pub(crate) fn planned(&self, certificate: Certificate, tightest: Option<Refill>) -> Planned {
        Planned { certificate, last_tick: self.last_step, range: self.range, tightest }
    }

    pub(crate) fn advance(&mut self, next: &Move, fraction_bits: u32) {
        match next {
            Move::Dwell { ticks } => self.tick += ticks,
            Move::Run { segment, direction } => {
                // A run goes one way: its ends are its extremes.
                self.position += i64::from(direction.sign()) * i64::from(segment.count);
                self.range = (self.range.0.min(self.position), self.range.1.max(self.position));
                let fixed = (i128::from(self.tick) << fraction_bits) + self.fraction + segment.span(segment.count);
                self.tick = (fixed >> fraction_bits) as u64;
                self.fraction = fixed & ((1 << fraction_bits) - 1);
                self.last_step = self.tick;
            }
        }
    }
}

/// Plans a law by itself; nothing is kept but what is proven.
///
/// # Errors
/// When that breaks one of `settings`: the first it meets.
pub fn planned(law: &Law, settings: &Settings) -> Result<Certificate, PlanError> {
    let mut planner = Planner::new(law, settings)?;
    while planner.next_move()?.is_some() {}
    Ok(planner.certificate().clone())
}

/// The same, for its errors alone.
///
/// # Errors
/// As [`planned`].
pub fn walk(law: &Law, settings: &Settings) -> Result<(), PlanError> {
    planned(law, settings).map(drop)
}

/// Whether a law's plan keeps to `settings` up to some time, by itself.
#[must_use]
pub fn fits_until(law: &Law, settings: &Settings, until: Time) -> bool {
    let Ok(mut planner) = Planner::new(law, settings) else { return false };
    let (mut clock, last_tick) =
        (Clock::new(settings.registers.fraction_bits), until.seconds() * settings.tick_hz as f64);
    while (clock.tick as f64) < last_tick {
        match planner.next_move() {
            Ok(Some(next)) => clock.advance(&next, settings.registers.fraction_bits),
            Ok(None) => break,
            Err(_) => return false,
        }
    }
    true
}

/// Whether a law's plan keeps to `settings`, by itself.
#[must_use]
pub fn fits(law: &Law, settings: &Settings) -> bool {
    walk(law, settings).is_ok()
}

/// Whether the plans of all motors keep to every limit, and come over the line in time, if their laws are `factor` times slower.
#[must_use]
pub fn all_fit(program: &Program, line: Option<&Line>, factor: f64) -> bool {
    Plans::slowed(Arc::new(program.clone()), line, factor).and_then(|plans| plans.run(|_| {})).is_ok()
}
