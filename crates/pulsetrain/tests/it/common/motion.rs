//! Whole motions on virtual boards: planned, streamed by a session, every step and edge compared with the law.

use super::uno::{Mark, Seen, idle_round};
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Observer, Port, Remote, ScheduledStep, WithReference};
use pulsetrain_core::Direction;
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::Cause;
use pulsetrain_motion::boards::uno::PinKind;
use pulsetrain_motion::program::Motor;
use pulsetrain_session::control::Ended;
use pulsetrain_session::control::Event;
use pulsetrain_session::drive::{Driven, connect_as};
use pulsetrain_session::lateness::{Lateness, Meter};
use pulsetrain_session::prepare::Prepared;
use pulsetrain_trace::Line;
use pulsetrain_trace::crossing::Crossings;
use pulsetrain_trace::verdict::{EdgeJudge, Options};
use std::collections::VecDeque;

/// If a step is farther from its time than this, ticks, a shared DIR line has delayed it: certificates are far smaller.
const PUT_OFF_TICKS: f64 = 20.0;
/// The phase is measured over this many steps.
const PHASE_STEPS: usize = 500;
/// If the law only touches a step's level, the step may come within this many ticks of the touch, or not at all.
const TOUCH_TICKS: f64 = 50_000.0;

/// Compares one motor's scheduled steps with its law, by the judge's crossings.
pub(crate) struct Schedule {
    crossings: Crossings,
    pub(crate) steps: u64,
    /// Largest |scheduled − exact| of steps without a delay by a DIR line, ticks.
    pub(crate) largest: f64,
    /// Scheduled − exact of the last such steps, ticks.
    recent: VecDeque<f64>,
    pub(crate) put_off: u64,
    /// The certificate, ticks.
    pub(crate) longest_put_off: f64,
    /// Steps that the law does not want, or steps of the law that are missing.
    pub(crate) wrong: u64,
}

impl Schedule {
    fn new(prepared: &Prepared, motor: &Motor) -> Schedule {
        let crossings = Crossings::new(&motor.law, prepared.program.grid, prepared.program.board.tick_hz);
        Schedule {
            crossings,
            steps: 0,
            largest: 0.0,
            recent: VecDeque::new(),
            put_off: 0,
            longest_put_off: 0.0,
            wrong: 0,
        }
    }

    fn step(&mut self, tick: u64, forward: bool) {
        self.steps += 1;
        loop {
            let Ok(Some(crossing)) = self.crossings.advance() else {
                self.wrong += 1;
                return;
            };
            let late = (tick as i64 - crossing.at.tick) as f64 - crossing.at.fraction;
            if crossing.optional {
                let made = crossing.forward == forward && late.abs() < TOUCH_TICKS;
                self.crossings.settle(made);
                if !made {
                    continue;
                }
            }
            self.wrong += u64::from(crossing.forward != forward);
            // A difference that f64 cannot resolve counts for neither side.
            let late = late.signum() * (late.abs() - crossing.uncertainty_ticks).max(0.0);
            if late.abs() > PUT_OFF_TICKS {
                self.put_off += 1;
                self.longest_put_off = self.longest_put_off.max(late);
            } else {
                self.largest = self.largest.max(late.abs());
                if self.recent.len() == PHASE_STEPS {
                    self.recent.pop_front();
                }
                self.recent.push_back(late);
            }
            return;
        }
    }

    /// The remaining phase error: the mean of scheduled − exact over the last steps, ticks.
    pub(crate) fn phase(&self) -> f64 {
        self.recent.iter().sum::<f64>() / self.recent.len().max(1) as f64
    }

    /// Number of steps that the law wants and that were not scheduled.
    fn missing(&mut self) -> u64 {
        let mut missing = 0;
        while let Ok(Some(crossing)) = self.crossings.advance() {
            missing += u64::from(!crossing.optional);
        }
        missing
    }
}

/// A motion as the board made it.
pub(crate) struct Made {
    pub(crate) seen: Seen,
    /// One for each motor.
    pub(crate) schedules: Vec<Schedule>,
    /// The proven bound of |scheduled − exact| of all motors, ticks.
    pub(crate) certificate_ticks: f64,
    /// The law's fastest speed, steps/s.
    pub(crate) peak_rate: f64,
}

impl Made {
    /// Largest |scheduled − exact| of all motors, ticks.
    pub(crate) fn largest(&self) -> f64 {
        self.schedules.iter().map(|schedule| schedule.largest).fold(0.0, f64::max)
    }
}

struct Look<'a, 's> {
    judge: EdgeJudge<'a>,
    schedules: &'s mut Vec<Schedule>,
    meter: Meter,
    /// For each line: the motor whose STEP it is.
    steppers: Vec<Option<usize>>,
    /// Last rising edge of each motor.
    last: Vec<u64>,
    shortest: u64,
    backwards: u64,
}

impl Observer for Look<'_, '_> {
    fn edge(&mut self, edge: Edge) {
        let line = edge.line;
        if let Some(Some(motor)) = self.steppers.get(usize::from(line)).copied() {
            if edge.level {
                self.meter.edge(motor, edge.tick);
                self.last[motor] = edge.tick;
            } else if self.last[motor] != 0 {
                self.shortest = self.shortest.min(edge.tick - self.last[motor]);
            }
        }
        let edge = pulsetrain_trace::Edge { tick: edge.tick, line, level: edge.level };
        self.backwards += u64::from(self.judge.push(edge).is_err());
    }

    fn step(&mut self, step: ScheduledStep) {
        self.meter.scheduled(step.motor, step.tick);
        self.schedules[step.motor].step(step.tick, step.direction == Direction::Forward);
    }
}

fn stepper(line: &Line, motors: &[Motor]) -> Option<usize> {
    motors.iter().position(|motor| line.names.contains(&format!("{}.step", motor.name)))
}

/// The result for edges and steps of a motion, on any board.
pub(crate) struct Followed {
    pub(crate) lateness: Lateness,
    /// One for each motor.
    pub(crate) schedules: Vec<Schedule>,
    /// The proven bound of |scheduled − exact| of all motors, ticks.
    pub(crate) certificate_ticks: f64,
    /// The law's fastest speed, steps/s.
    pub(crate) peak_rate: f64,
    /// Shortest pulse on the pins, ticks.
    pub(crate) shortest_pulse: u64,
    /// The first fault. Empty if there is none.
    pub(crate) trouble: String,
}

impl Followed {
    /// Largest |scheduled − exact| of all motors, ticks.
    pub(crate) fn largest(&self) -> f64 {
        self.schedules.iter().map(|schedule| schedule.largest).fold(0.0, f64::max)
    }
}

/// Runs a motion in constant memory. Compares its steps with the law, and its edges, `constant` ticks later, with the
/// steps. Calls `watch` with the time that is reached, s.
///
/// # Errors
/// If it cannot begin, because the plan is refused. Later faults are in [`Followed::trouble`].
pub(crate) fn follow<P: Port>(
    prepared: &Prepared,
    driven: &mut Driven<WithReference<Remote<P>>>,
    constant: u32,
    late_ticks: f64,
    mut watch: impl FnMut(f64),
) -> Result<Followed, String> {
    let program = &prepared.program;
    let planned = prepared.plan(|_| {}).map_err(|error| error.to_string())?;
    let certificate_ticks = planned.iter().map(|motor| motor.certificate.bound_ticks).fold(0.0, f64::max);
    let peak_rate = planned.iter().map(|motor| motor.certificate.peak_speed.0).fold(0.0, f64::max);
    let options = Options {
        constant_ticks: constant.into(),
        bound_ticks: Some(certificate_ticks + late_ticks),
        ..Options::default()
    };
    let judge = EdgeJudge::new(program.board.tick_hz, &driven.lines, program, &options).map_err(|e| e.to_string())?;
    let mut schedules: Vec<_> = program.motors.iter().map(|motor| Schedule::new(prepared, motor)).collect();
    let mut look = Look {
        judge,
        schedules: &mut schedules,
        meter: Meter::new(program.motors.len(), constant.into()),
        steppers: driven.lines.iter().map(|line| stepper(line, &program.motors)).collect(),
        last: vec![0; program.motors.len()],
        shortest: u64::MAX,
        backwards: 0,
    };
    let ended: Result<Ended, _> = driven.run(&mut look, |event| {
        if let Event::Progress { at_s } = event {
            watch(at_s);
        }
    });
    let Look { judge, meter, shortest, backwards, .. } = look;
    let verdict = judge.finish().map_err(|error| error.to_string())?;
    let lateness: Lateness = meter.finish();
    let wrong: u64 = schedules.iter_mut().map(|schedule| schedule.wrong + schedule.missing()).sum();
    let largest = schedules.iter().map(|schedule| schedule.largest).fold(0.0, f64::max);
    let events = driven.board_mut().events();
    let event = events.iter().find(|event| event.cause != Cause::Finished);
    // Only the first fault matters: later ones follow from it.
    let trouble = if let Some(event) = event {
        format!("{:?} ({})", event.cause, event.detail)
    } else if let Err(error) = ended {
        error.to_string()
    } else if wrong > 0 {
        format!("{wrong} steps scheduled that the law does not want, or the other way round")
    } else if largest > certificate_ticks {
        format!("scheduled {largest:.2} ticks off, certificate {certificate_ticks:.2}")
    } else if let Some(failure) = verdict.failures.first() {
        failure.to_string()
    } else if backwards > 0 {
        format!("{backwards} edges before the one before")
    } else {
        String::new()
    };
    Ok(Followed { lateness, schedules, certificate_ticks, peak_rate, shortest_pulse: shortest, trouble })
}

/// Runs a motion on the virtual Uno at 1 Mbaud, in constant memory. Calls `watch` with the time that is reached, s.
///
/// # Errors
/// If it cannot begin, because the plan is refused or the queue is too short. Later faults are in [`Seen::trouble`].
pub(crate) fn make(prepared: &Prepared, late_ticks: f64, watch: impl FnMut(f64)) -> Result<Made, String> {
    make_at(prepared, Baud::B1M, late_ticks, watch)
}

/// Runs a motion on the virtual Uno at another rate of the line.
///
/// # Errors
/// As [`make`].
pub(crate) fn make_at(
    prepared: &Prepared,
    baud: Baud,
    late_ticks: f64,
    watch: impl FnMut(f64),
) -> Result<Made, String> {
    let kind = PinKind::of(&prepared.program.motors).map_err(|error| error.to_string())?;
    let mut driven = Driven::with(prepared, |program| connect_as(VirtualUno::new(), program, baud, 1))
        .map_err(|error| error.to_string())?;
    let idle_round = idle_round(driven.board_mut().port());
    let began = Mark::of(driven.board_mut().port());
    driven.board_mut().port_mut().chip_mut().forget_masked();
    let followed = follow(prepared, &mut driven, kind.constant_ticks(), late_ticks, watch)?;
    let board = driven.board_mut();
    let load = Mark::of(board.port()).load(began, idle_round);
    let stack_left = board.measures(false).map_or(0, |measures| measures.stack_left);
    let Followed { lateness, schedules, certificate_ticks, peak_rate, shortest_pulse, trouble } = followed;
    let seen = Seen {
        rates: Vec::new(),
        lateness,
        load,
        horizon_ticks: 0,
        queue_bytes: board.info().pool,
        shortest_pulse,
        stack_left,
        masked_cycles: board.port().chip().longest_masked().cycles,
        trouble,
    };
    Ok(Made { seen, schedules, certificate_ticks, peak_rate })
}
