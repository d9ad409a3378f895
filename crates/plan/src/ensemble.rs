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
/// Motors that share a DIR line are planned together. Reading far ahead for one of them keeps the moves of the others
/// in memory.
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

// A plan may be made on another thread than the one that read the file.
const _: () = {
    const fn is_send<T: Send + 'static>() {}
    is_send::<Ensemble>();
    is_send::<Planner>();
};

/// The state of a motor when a plan begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Where the law goes on.
    pub origin: Origin,
    /// The tick of its last step, relative to the beginning of the plan (so negative), and the step's direction.
    pub last_step: Option<(i64, Direction)>,
}

struct MotorPlan {
    plan: Source,
    settings: Settings,
}

enum Source {
    /// A motor with a DIR line of its own.
    Alone(Box<Planner>),
    /// A motor whose steps must keep a distance from those of others: its group, its place in the group, and the cost
    /// of its moves after delays.
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

    /// Prepares to plan motors that have already moved. Each motor goes on from its element of `starts`.
    ///
    /// A first step that is too close to the motor's last step is delayed, and counted in the certificate.
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
                // A motor with its own DIR line is a group of one: its first steps must keep a distance from those
                // before the plan. Where the board makes all steps one after the other, all motors are one group.
                let is_one = steps.is_some();
                let known = groups.iter().position(|(p, _)| is_one || (pin.is_some() && *p == pin));
                let group = known.unwrap_or_else(|| {
                    groups.push((pin, SharedDir::new(settings.registers.fraction_bits, steps)));
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
    /// If the law breaks or leaves a limit. Of motors that share a DIR line, the earliest error counts.
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

    /// The delay of the last [`next_move`](Ensemble::next_move) of a motor, ticks, because another motor used the
    /// shared DIR line. A delayed move is one step; all others have 0.
    #[must_use]
    pub fn put_off_ticks(&self, motor: usize) -> u64 {
        match &self.motors[motor].plan {
            Source::Alone(_) => 0,
            Source::Shared(group, place, _) => self.groups[*group].put_off_ticks(*place),
        }
    }

    /// What is proven of a motor's moves. It may include moves that [`next_move`](Ensemble::next_move) has not returned
    /// yet.
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

    /// The limits that a motor's plan keeps.
    #[must_use]
    pub fn settings(&self, motor: usize) -> &Settings {
        &self.motors[motor].settings
    }
}

/// The motor's DIR pin, if another motor has it too.
fn shared_dir_pin(program: &Program, index: usize) -> Option<u8> {
    let own = &program.motors[index];
    let Wiring::StepDir { dir, .. } = own.wiring else { return None };
    program.motors.iter().any(|other| other.shares_dir_with(own)).then_some(dir)
}
