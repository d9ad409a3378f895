//! A motion is planned once for its proof, before anything moves, and once more while it streams.

use std::sync::Arc;

use pulsetrain_motion::Time;
use pulsetrain_plan::{Demand, PlanError, Refused};

use crate::estimate::{self, Estimate, Task};
use crate::fit;
use crate::plans::{MOVES_AT_ONCE, Planned, Plans};
use crate::prepare::{Prepared, Refusal, cut};

/// Seconds of planning that the first step may wait for.
const MOST_WAIT_S: f64 = 0.1;
/// Seconds of a long motion that are proven before its first step.
const FIRST_S: f64 = 10.0;
/// Seconds of one that takes so long to plan that even those would take too long, as formulas of thousands of terms do.
const SHORTEST_FIRST_S: f64 = 2.0;

/// What is proven of a motion before its first step.
#[derive(Clone, Debug)]
pub struct Proof {
    /// The figures of each motor's plan, as far as it was planned.
    pub planned: Vec<Planned>,
    /// Whether that is the whole motion.
    pub is_whole: bool,
    /// Up to when it is proven, s.
    pub until_s: f64,
}

impl Prepared {
    /// Plans all motors to their end, and keeps of the plan what it proves. `watch` gets how far it is, s.
    ///
    /// Where equal parts of the board's queues are too short, each motor gets the part that its plan needs.
    ///
    /// # Errors
    /// When a plan would break a limit: with what would fit.
    pub fn prove(&mut self, mut watch: impl FnMut(f64)) -> Result<Vec<Planned>, Refusal> {
        self.with_queues(f64::INFINITY, |prepared| prepared.plan(&mut watch))
    }

    /// As [`Prepared::prove`], but plans only a beginning of a motion that takes long to plan, or that has no end: as much as the first step may wait
    /// for. The rest is for [`Driven::proving`](crate::drive::Driven::proving).
    ///
    /// The beginning is 10 s or more; 2 s or more if the first step would wait for longer than 0.1 s. Of laws that repeat it has two periods if that does not take long: such laws are then known to keep
    /// the motors' limits for all time.
    ///
    /// # Errors
    /// As [`Prepared::prove`].
    pub fn prove_first(&mut self, mut watch: impl FnMut(f64)) -> Result<Proof, Refusal> {
        let planning_s = Estimate::of(self, Some(Time::from_seconds(self.end_s())), Task::Plan).planning_s;
        if !self.is_endless() && planning_s <= MOST_WAIT_S {
            return Ok(Proof { planned: self.prove(watch)?, is_whole: true, until_s: f64::INFINITY });
        }
        let second_s = estimate::second_s(self);
        let cycles = self.program.motors.iter().filter_map(|motor| motor.law.cycle());
        let until_s = cycles.map(|(from, period)| (from + period.times(2)).seconds()).fold(FIRST_S, f64::max);
        let until_s = until_s.min((MOST_WAIT_S / second_s).max(SHORTEST_FIRST_S));
        let planned = self.with_queues(until_s, |prepared| {
            let mut plans = prepared.plans()?;
            while plans.planned_s().is_some_and(|planned_s| planned_s < until_s)
                && plans.plan_some(until_s, MOVES_AT_ONCE)?
            {
                watch(plans.planned_s().unwrap_or_default());
            }
            plans.brake()?;
            Ok(plans.finish())
        })?;
        Ok(Proof { planned, is_whole: false, until_s })
    }

    /// Proves with equal parts of the queues; if they are too short, with parts by what the motors need up to `until_s`.
    fn with_queues<T>(
        &mut self,
        until_s: f64,
        mut prove: impl FnMut(&Prepared) -> Result<T, Refused>,
    ) -> Result<T, Refusal> {
        let refused = match prove(self) {
            Ok(proven) => return Ok(proven),
            Err(refused) => refused,
        };
        if matches!(refused.error, PlanError::QueueTooShort { .. })
            && let Some(shared) = self.with_queues_by_need(until_s)
            && let Ok(proven) = prove(&shared)
        {
            *self = shared;
            return Ok(proven);
        }
        Err(self.refuse(refused))
    }

    /// The same with the queues as they are.
    ///
    /// # Errors
    /// When a plan would break a limit.
    pub fn plan(&self, watch: impl FnMut(f64)) -> Result<Vec<Planned>, Refused> {
        self.plans()?.run(watch)
    }

    pub(crate) fn plans(&self) -> Result<Plans, Refused> {
        Plans::new(Arc::new(self.program.clone()), self.line.as_ref())
    }

    /// With queues that last equally long for all motors up to `until_s`; `None` if there is no line, or no use in it.
    fn with_queues_by_need(&self, until_s: f64) -> Option<Prepared> {
        let line = self.line.as_ref()?;
        let motors = self.program.motors.len();
        if motors < 2 {
            return None;
        }
        let mut plans = Plans::new(Arc::new(self.program.clone()), None).ok()?;
        let mut demand =
            Demand::new(self.program.board.tick_hz, (0..motors).map(|motor| plans.ensemble.settings(motor)));
        let until = until_s * self.program.board.tick_hz as f64;
        while let Some((motor, from, next)) = plans.next_move().ok()?.filter(|(_, from, _)| (*from as f64) < until) {
            demand.add(motor, &next, from);
        }
        let mut shared = self.clone();
        shared.program.queue_parts = demand.parts(line)?;
        shared.line = Some(line.with_parts(&shared.program.queue_parts));
        Some(shared)
    }

    /// Plans as much of the beginning as takes no time: an error there need not wait for a long plan.
    ///
    /// # Errors
    /// As [`Prepared::prove`].
    pub fn prove_beginning(&self) -> Result<(), Refusal> {
        /// So much planning takes no time, s.
        const MOST_S: f64 = 0.2;
        let planning_s = Estimate::of(self, Some(Time::SECOND), Task::Plan).planning_s;
        let length = Time::from_seconds((MOST_S / planning_s).min(1.0));
        // A motion that cannot be cut there, or stopped, may still be right.
        let Ok(beginning) = self.clone().ending(Some(length)) else { return Ok(()) };
        let is_of_motion = |refused: &Refused| refused.error.at_s().is_some_and(|at_s| at_s < length.seconds());
        match beginning.plan(|_| {}) {
            Err(refused) if is_of_motion(&refused) => Err(self.refuse(refused)),
            _ => Ok(()),
        }
    }

    /// A plan's refusal with the motor's name and with what would fit.
    #[must_use]
    pub fn refuse(&self, refused: Refused) -> Refusal {
        // What would fit is looked for in laws that end. A law that cannot be cut has a problem of its own.
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
}
