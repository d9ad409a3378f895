//! All motors of a program: their plans, and the order of steps on shared DIR lines.

use crate::certificate::Certificate;
use crate::error::Refused;
use crate::planner::{Origin, Planner};
use crate::settings::Settings;
use crate::shared_dir::SharedDir;
use crate::{Move, packed::Meter};
use pulsetrain_core::Direction;
use pulsetrain_motion::Law;
use pulsetrain_motion::program::{Program, Wiring};

/// The plans of all motors of a program, as streams of moves.
///
/// Motors that share a DIR line are planned together: reading far ahead for one of them makes the moves of the
/// others wait in memory.
///
/// ```
/// # let text = pulsetrain_motion::template::motion_file("example");
/// # let no_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
/// let program = pulsetrain_motion::file::read(&text, "example.toml", &no_files).unwrap();
/// let mut ensemble = pulsetrain_plan::Ensemble::new(&program).unwrap();
/// while let Some(_move) = ensemble.next_move(0).unwrap() {}
/// assert!(ensemble.certificate(0).steps > 0);
/// ```
pub struct Ensemble {
    motors: Vec<MotorPlan>,
    groups: Vec<SharedDir>,
}

// A plan may be worked out on another thread than the one that read the file.
const _: () = {
    const fn is_send<T: Send + 'static>() {}
    is_send::<Ensemble>();
    is_send::<Planner>();
};

/// Where a motor is when a plan begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Where its law goes on.
    pub origin: Origin,
    /// The tick of its last step, relative to that of the beginning (so negative), and the step's direction.
    pub last_step: Option<(i64, Direction)>,
}

struct MotorPlan {
    plan: Source,
    settings: Settings,
}

enum Source {
    /// A motor with a DIR line of its own.
    Alone(Box<Planner>),
    /// One whose steps are kept apart from those of others: which group, which member of it, and what its moves cost after steps were put off.
    Shared(usize, usize, Meter),
}

impl Ensemble {
    /// Prepares to plan all motors of a program.
    ///
    /// # Errors
    /// If the tolerance is below what can be proven.
    pub fn new(program: &Program) -> Result<Ensemble, Refused> {
        Ensemble::slowed(program, 1.0)
    }

    /// Prepares to plan all motors of a program whose laws are `factor` times slower.
    ///
    /// # Errors
    /// As [`Ensemble::new`].
    pub fn slowed(program: &Program, factor: f64) -> Result<Ensemble, Refused> {
        Ensemble::assemble(program, factor, program.motors.iter().map(|motor| (&motor.law, None)))
    }

    /// Prepares to plan motors that have moved already: each goes on from its start; there is one for each motor.
    ///
    /// A first step too close to the last one before is put off, and counted in the certificate.
    ///
    /// # Errors
    /// If the tolerance is below what can be proven.
    pub fn from(program: &Program, starts: &[Start]) -> Result<Ensemble, Refused> {
        let laws = program.motors.iter().map(|motor| &motor.law);
        Ensemble::assemble(program, 1.0, laws.zip(starts.iter().map(Some)))
    }

    fn assemble<'a>(
        program: &Program,
        slower: f64,
        laws: impl Iterator<Item = (&'a Law, Option<&'a Start>)>,
    ) -> Result<Ensemble, Refused> {
        let mut motors = Vec::with_capacity(program.motors.len());
        let mut groups: Vec<(Option<u8>, SharedDir)> = Vec::new();
        let steps = program.board.shared_steps;
        for (index, (motor, (law, start))) in program.motors.iter().zip(laws).enumerate() {
            let settings = Settings::of(program, motor).slowed(slower);
            let planner = match start {
                None => Planner::new(law, &settings),
                Some(start) => Planner::from(start.origin, law, &settings),
            };
            let planner = planner.map_err(|error| Refused { motor: index, error })?;
            let pin = shared_dir_pin(program, index);
            let plan = if pin.is_none() && start.is_none() && steps.is_none() {
                Source::Alone(Box::new(planner))
            } else {
                // A motor with a line of its own is a group of one: its steps must keep clear of those before.
                // Where the board makes all steps one after the other, all motors are one group.
                let is_one = steps.is_some();
                let known = groups.iter().position(|(p, _)| is_one || (pin.is_some() && *p == pin));
                let group = known.unwrap_or_else(|| {
                    groups.push((pin, SharedDir::new(settings.fraction_bits, steps)));
                    groups.len() - 1
                });
                let timing = program.timing(motor).ticks(program.board.tick_hz);
                let last_step = start.and_then(|start| start.last_step);
                let place = groups[group].1.join(index, planner, &settings, &timing, &motor.wiring, last_step);
                Source::Shared(group, place, Meter::new(&settings))
            };
            motors.push(MotorPlan { plan, settings });
        }
        Ok(Ensemble { motors, groups: groups.into_iter().map(|(_, group)| group).collect() })
    }

    /// The next move of a motor; `None` at the end of its law.
    ///
    /// # Errors
    /// Where a law breaks or leaves a limit; of motors that share a DIR line, whichever comes first.
    pub fn next_move(&mut self, motor: usize) -> Result<Option<Move>, Refused> {
        match &mut self.motors[motor].plan {
            Source::Alone(planner) => planner.next_move().map_err(|error| Refused { motor, error }),
            Source::Shared(group, place, meter) => {
                let next = self.groups[*group].next_move(*place)?;
                if let Some(next) = &next {
                    meter.add(next);
                }
                Ok(next)
            }
        }
    }

    /// By how many ticks the last [`next_move`](Ensemble::next_move) of a motor was put off, since another motor had the shared DIR line: it is
    /// one step then, and 0 of all others.
    #[must_use]
    pub fn put_off_ticks(&self, motor: usize) -> u64 {
        match &self.motors[motor].plan {
            Source::Alone(_) => 0,
            Source::Shared(group, place, _) => self.groups[*group].put_off_ticks(*place),
        }
    }

    /// What is proven of a motor's moves; it may be ahead of those given out.
    #[must_use]
    pub fn certificate(&self, motor: usize) -> Certificate {
        match &self.motors[motor].plan {
            Source::Alone(planner) => planner.certificate().clone(),
            Source::Shared(group, place, meter) => {
                let certificate = self.groups[*group].certificate(*place);
                Certificate { bytes: meter.bytes(), segments: meter.segments(), ..certificate }
            }
        }
    }

    /// What a motor's plan keeps to.
    #[must_use]
    pub fn settings(&self, motor: usize) -> &Settings {
        &self.motors[motor].settings
    }
}

/// The motor's DIR pin, if another motor has the same.
fn shared_dir_pin(program: &Program, index: usize) -> Option<u8> {
    let own = &program.motors[index];
    let Wiring::StepDir { dir, .. } = own.wiring else { return None };
    program.motors.iter().any(|other| other.shares_dir_with(own)).then_some(dir)
}
