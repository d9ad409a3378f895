//! A motion is planned once for its proof, before anything moves, and once more while it streams.

use pulsetrain_motion::Time;
use pulsetrain_plan::{Demand, PlanError, Refused};

use crate::estimate::{Estimate, Task};
use crate::fit;
use crate::plans::{Planned, Plans};
use crate::prepare::{Prepared, Refusal, cut};

impl Prepared {
    /// Plans all motors to their end, and keeps of the plan what it proves. `watch` gets how far it is, s.
    ///
    /// Where equal parts of the board's queues are too short, each motor gets the part that its plan needs.
    ///
    /// # Errors
    /// When a plan would break a limit: with what would fit.
    pub fn prove(&mut self, mut watch: impl FnMut(f64)) -> Result<Vec<Planned>, Refusal> {
        let refused = match self.plan(&mut watch) {
            Ok(planned) => return Ok(planned),
            Err(refused) => refused,
        };
        if matches!(refused.error, PlanError::QueueTooShort { .. })
            && let Some(shared) = self.with_queues_by_need()
            && let Ok(planned) = shared.plan(watch)
        {
            *self = shared;
            return Ok(planned);
        }
        Err(self.refuse(refused))
    }

    /// The same with the queues as they are.
    ///
    /// # Errors
    /// When a plan would break a limit.
    pub fn plan(&self, watch: impl FnMut(f64)) -> Result<Vec<Planned>, Refused> {
        Plans::new(&self.program, self.line.as_ref())?.run(watch)
    }

    /// With queues that last equally long for all motors; `None` if there is no line, or no use in it.
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
