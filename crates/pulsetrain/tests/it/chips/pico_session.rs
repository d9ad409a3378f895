//! Sessions on the virtual Pico, its committed firmware over its USB: the pins show the plan, tick by tick, or a
//! planned stop. `session.rs` has the same for the native board.

use crate::common::onward::onward;
use crate::common::random::each;
use proptest::prelude::*;
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::{Board, Edge, Faults, Remote};
use pulsetrain_core::Direction;
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::program::{DriverTiming, Limits, Motor, Program, Scale, Tolerance, Wiring};
use pulsetrain_motion::{Grid, Law, Time, boards};
use pulsetrain_plan::{Ensemble, Move};
use pulsetrain_session::drive::connect;
use pulsetrain_session::{Session, SessionError};

const TICK_HZ: u64 = 125_000_000;
const TIMING: DriverTiming =
    DriverTiming { pulse_high_ns: 1000, pulse_low_ns: 1000, dir_setup_ns: 500, dir_hold_ns: 500 };

type Pico = Session<Remote<VirtualPico>>;

/// STEP of motor m is pin 2 + 2m, DIR the next.
fn motor(index: usize, law: Law, limits: Limits) -> Motor {
    let step = 2 + 2 * u8::try_from(index).unwrap();
    Motor {
        name: format!("m{index}"),
        law,
        wiring: Wiring::StepDir { step, dir: step + 1, forward_high: true, enable: None },
        timing: TIMING,
        limits,
        scale: Scale { unit: "rev".into(), steps_per_unit: 200.0, steps_per_rev: 200.0 },
        winding: None,
        driver: None,
    }
}

fn program(motors: Vec<Motor>) -> Program {
    let row = boards::find("pico").unwrap();
    let mut board = row.limits();
    (board.min_interval_ticks, board.turn_ticks) = (row.shortest_intervals(&motors), row.turn_ticks(&motors));
    let (grid, tolerance) = (Grid::NEAREST, Tolerance::Ticks(1.0));
    Program { board, grid, tolerance, idle_ms: None, motors, machines: Vec::new(), queue_parts: Vec::new() }
}

/// A law without jumps, and its largest acceleration.
fn smooth_law() -> impl Strategy<Value = (Law, f64)> {
    let sine = (2.0..3000.0f64, any::<bool>(), 0.15..0.8f64).prop_map(|(a, negative, period)| {
        let omega = std::f64::consts::TAU / period;
        let amplitude = if negative { -a } else { a };
        (Law::sine(amplitude, Time::from_seconds(period), Some(1)).unwrap(), a * omega * omega)
    });
    let trapezoid = (-900.0..900.0f64, 500.0..30_000.0f64, 20_000.0..400_000.0f64).prop_map(|(distance, speed, a)| {
        (Law::trapezoid(distance + 3.0f64.copysign(distance), speed, a, a).unwrap(), a)
    });
    prop_oneof![sine, trapezoid]
}

fn programs() -> impl Strategy<Value = Program> {
    let limited = (smooth_law(), prop_oneof![Just(0.0), 1.0..200.0f64], 0.0..0.2f64);
    prop::collection::vec(limited, 1..=8).prop_map(|motors| {
        let motor = |(index, ((law, hardest), pull_in, delay)): (usize, ((Law, f64), f64, f64))| {
            let law = law.delayed(Time::from_seconds(delay)).unwrap();
            motor(index, law, Limits { max_speed: None, max_acceleration: Some(hardest * 1.1), pull_in })
        };
        program(motors.into_iter().enumerate().map(motor).collect())
    })
}

/// All steps of a program's plan, replayed in wide integers.
fn planned(program: &Program) -> Option<Vec<Vec<(u64, i64)>>> {
    let mut ensemble = Ensemble::new(program).ok()?;
    let mut all = Vec::new();
    for motor in 0..program.motors.len() {
        let mut accumulator = 1_i128 << 31;
        let mut steps = Vec::new();
        while let Some(next) = ensemble.next_move(motor).ok()? {
            match next {
                Move::Dwell { ticks } => accumulator += i128::from(ticks) << 32,
                Move::Run { segment, direction } => {
                    let sign = if direction == Direction::Forward { 1 } else { -1 };
                    let tick = |k| u64::try_from((accumulator + segment.span(k)) >> 32).unwrap();
                    steps.extend((1..=segment.count).map(|k| (tick(k), sign)));
                    accumulator += segment.span(segment.count);
                }
            }
        }
        all.push(steps);
    }
    Some(all)
}

/// Steps as drivers see them on the pins: tick and direction.
struct Pins {
    levels: u32,
    steps: Vec<Vec<(u64, i64)>>,
}

impl Pins {
    fn new(program: &Program) -> Pins {
        Pins { levels: 0, steps: vec![Vec::new(); program.motors.len()] }
    }

    fn see(&mut self, edge: Edge) {
        let bit = 1 << edge.line;
        self.levels = if edge.level { self.levels | bit } else { self.levels & !bit };
        let motor = usize::from(edge.line / 2).wrapping_sub(1);
        if let Some(steps) = self.steps.get_mut(motor).filter(|_| edge.level && edge.line.is_multiple_of(2)) {
            steps.push((edge.tick, if self.levels >> (edge.line + 1) & 1 == 1 { 1 } else { -1 }));
        }
    }

    fn counted(&self) -> Vec<i64> {
        self.steps.iter().map(|steps| steps.iter().map(|(_, sign)| sign).sum()).collect()
    }
}

fn begin(program: &Program) -> Pico {
    Session::new(connect(VirtualPico::on_usb(), program, Baud::B1M).unwrap(), program.clone()).unwrap()
}

fn ticks(seconds: f64) -> u64 {
    (seconds * TICK_HZ as f64) as u64
}

/// The board's count is what the pins show, and the host's replay agrees, at each step that the board remembers.
fn check_counts(session: &Pico, pins: &Pins) -> Result<(), TestCaseError> {
    let now = session.board().now();
    prop_assert_eq!(session.board().positions(), pins.counted());
    for (motor, steps) in pins.steps.iter().enumerate() {
        prop_assert_eq!(session.board().faults(motor), Faults::default());
        let count: i64 = steps.iter().map(|(_, sign)| sign).sum();
        prop_assert_eq!(session.count_at(motor, now - 1), Some(count), "motor {}", motor);
        let mut count = 0;
        for &(tick, sign) in steps {
            if let Some(before) = session.count_at(motor, tick - 1) {
                prop_assert_eq!(before, count, "motor {} before {}", motor, tick);
                prop_assert_eq!(session.count_at(motor, tick), Some(count + sign), "motor {} at {}", motor, tick);
            }
            count += sign;
        }
    }
    Ok(())
}

/// Lets the board come to rest.
fn run_out(session: &mut Pico, pins: &mut Pins) {
    let end = session.last_step().unwrap_or(0).max(session.board().now()) + TICK_HZ / 100;
    session.board_mut().advance(end, &mut |edge: Edge| pins.see(edge));
    // The board reports it in its next answer.
    while !session.board().is_idle() && session.board().now() < end + TICK_HZ {
        let soon = session.board().now() + TICK_HZ / 100;
        session.board_mut().advance(soon, &mut |edge: Edge| pins.see(edge));
    }
}

/// Each case takes seconds of an emulated chip.
const CASES: u32 = 3;

#[test]
fn epochs_change_no_tick() {
    each(CASES, programs(), |program| {
        let Some(planned) = planned(&program) else { return Err(TestCaseError::reject("no plan")) };
        let mut pins = Pins::new(&program);
        let mut session = begin(&program);
        let report = session.run(&mut |edge: Edge| pins.see(edge), |_| {});
        prop_assert_eq!(&report.failure, &None);
        prop_assert_eq!(&report.counted, &report.replayed);
        run_out(&mut session, &mut pins);
        for (steps, planned) in pins.steps.iter().zip(&planned) {
            let from_zero: Vec<_> = steps.iter().map(|(tick, sign)| (tick - report.zero, *sign)).collect();
            prop_assert_eq!(&from_zero, planned);
        }
        check_counts(&session, &pins)?;
        Ok(())
    });
}

#[test]
fn a_lost_host_is_a_planned_stop() {
    each(CASES, (programs(), 0.0..0.6f64), |(program, lost_s)| {
        prop_assume!(planned(&program).is_some());
        let mut pins = Pins::new(&program);
        let mut session = begin(&program);
        let until = session.zero() + ticks(lost_s);
        prop_assert_eq!(session.advance(until, &mut |edge: Edge| pins.see(edge)), Ok(()));
        // Nothing more is sent: the queues end with their tails.
        run_out(&mut session, &mut pins);
        prop_assert!(session.board().is_idle());
        check_counts(&session, &pins)?;
        // Less than a step from rest, a motor that brakes with acceleration a has run at √(4a) or less since the step
        // before.
        for (steps, motor) in pins.steps.iter().zip(&program.motors) {
            if let [.., before, last] = steps.as_slice()
                && before.1 == last.1
            {
                let speed = TICK_HZ as f64 / (last.0 - before.0) as f64;
                let limit = motor.limits.max_acceleration.unwrap_or(f64::INFINITY);
                let slow = motor.limits.pull_in + 1.05 * (4.0 * limit).sqrt();
                prop_assert!(speed <= slow, "it stops at once from {} steps/s; {} would do", speed, slow);
            }
        }
        Ok(())
    });
}

#[test]
fn stops_pauses_and_changes_keep_the_count() {
    let pauses = prop::collection::vec((0.0..0.3f64, 0.0..0.1f64), 1..3);
    let change = (0.0..0.2f64, 0u64..1_000_000, smooth_law());
    each(CASES, (programs(), pauses, change, 0.0..0.3f64), |(program, pauses, change, stop_s)| {
        prop_assume!(planned(&program).is_some());
        let cell = std::cell::OnceCell::new();
        let mut pins = Pins::new(&program);
        let mut session = begin(&program);
        for (after_s, rest_s) in pauses {
            let until = session.board().now() + ticks(after_s);
            prop_assert_eq!(session.advance(until, &mut |edge: Edge| pins.see(edge)), Ok(()));
            let rests = match session.pause() {
                Ok(rests) => rests,
                // The change is refused: it is over by then, the motor is not at speed yet, or it is too much for one
                // motor.
                Err(SessionError::Late { .. } | SessionError::Waiting { .. } | SessionError::Pause(_)) => continue,
                Err(error) => return Err(TestCaseError::fail(error.to_string())),
            };
            prop_assert_eq!(session.advance(rests, &mut |edge: Edge| pins.see(edge)), Ok(()));
            let halted = pins.counted();
            prop_assert_eq!(session.advance(rests + ticks(rest_s), &mut |edge: Edge| pins.see(edge)), Ok(()));
            prop_assert_eq!(pins.counted(), halted, "at rest");
            match session.resume() {
                Ok(at_speed) => prop_assert!(at_speed > rests),
                Err(SessionError::Pause(_)) => return Ok(()),
                Err(error) => return Err(TestCaseError::fail(error.to_string())),
            }
        }
        let (after_s, ahead, (law, hardest)) = change;
        // The motion has begun, or gone on after a pause, before it is changed.
        let until = session.board().now().max(session.zero() + 1) + ticks(after_s);
        prop_assert_eq!(session.advance(until, &mut |edge: Edge| pins.see(edge)), Ok(()));
        let at = session.earliest() + ahead;
        let mut next = program.clone();
        for (index, motor) in next.motors.iter_mut().enumerate() {
            let state = session.state(index, at).unwrap();
            motor.limits.max_acceleration = None;
            motor.law = onward(state, &law, hardest);
        }
        let next = cell.get_or_init(|| next);
        session.change(at, next.clone()).map_err(|error| TestCaseError::fail(error.to_string()))?;
        prop_assert_eq!(session.zero(), at);
        prop_assert_eq!(session.advance(at + ticks(stop_s), &mut |edge: Edge| pins.see(edge)), Ok(()));
        session.stop().map_err(|error| TestCaseError::fail(error.to_string()))?;
        let report = session.run(&mut |edge: Edge| pins.see(edge), |_| {});
        prop_assert_eq!(&report.failure, &None);
        prop_assert_eq!(&report.counted, &report.replayed);
        run_out(&mut session, &mut pins);
        check_counts(&session, &pins)?;
        Ok(())
    });
}
