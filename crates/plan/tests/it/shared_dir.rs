//! Motors on one DIR line: opposite steps are kept apart, and the certificates say what that cost.

use proptest::prelude::*;
use pulsetrain_core::{Direction, RegisterWidths};
use pulsetrain_motion::program::{
    BoardLimits, DriverTiming, Limits, Motor, Program, Scale, SharedSteps, Tolerance, Wiring,
};
use pulsetrain_motion::{Grid, Law, Time, boards};
use pulsetrain_plan::{Certificate, Ensemble, Move, Planner, Refused, Settings};

const TICK_HZ: u64 = 16_000_000;

/// A step of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct TimedStep {
    tick: i128,
    direction: Direction,
}

/// Ticks of moves, in wide integers.
#[derive(Default)]
struct LevelReplay {
    accumulator: i128,
    steps: Vec<TimedStep>,
}

impl LevelReplay {
    fn new() -> LevelReplay {
        LevelReplay { accumulator: 1 << 15, ..LevelReplay::default() }
    }

    fn take(&mut self, next: Move) {
        match next {
            Move::Dwell { ticks } => self.accumulator += i128::from(ticks) << 16,
            Move::Run { segment, direction } => {
                let steps = (1..=segment.count).map(|k| (self.accumulator + segment.span(k)) >> 16);
                self.steps.extend(steps.map(|tick| TimedStep { tick, direction }));
                self.accumulator += segment.span(segment.count);
            }
        }
    }
}

fn program(laws: Vec<Law>, timing: DriverTiming) -> Program {
    let motors = laws.into_iter().zip(2..).map(|(law, step)| Motor {
        name: format!("m{step}"),
        law,
        wiring: Wiring::StepDir { step, dir: 8, forward_high: false, enable: None },
        timing,
        limits: Limits { pull_in: 1e6, ..Limits::default() },
        scale: Scale { unit: "rev".into(), steps_per_unit: 200.0, steps_per_rev: 200.0 },
        winding: None,
        driver: None,
    });
    Program {
        board: BoardLimits {
            profile: &boards::NATIVE,
            name: "test".into(),
            tick_hz: TICK_HZ,
            registers: RegisterWidths::NARROW,
            max_motors: 4,
            min_interval_ticks: vec![160],
            hardware_timed: true,
            turn_ticks: 0,
            one_timing: false,
            shared_steps: None,
            segment_ticks: Vec::new(),
        },
        grid: Grid::NEAREST,
        tolerance: Tolerance::Ticks(1.0),
        idle_ms: None,
        motors: motors.collect(),
        machines: Vec::new(),
        queue_parts: Vec::new(),
    }
}

/// Plans the motors together, one move of each in turn.
fn together(program: &Program) -> Result<Vec<(Vec<TimedStep>, Certificate)>, Refused> {
    let mut ensemble = Ensemble::new(program)?;
    let mut replays: Vec<LevelReplay> = program.motors.iter().map(|_| LevelReplay::new()).collect();
    loop {
        let mut moved = false;
        for (motor, replay) in replays.iter_mut().enumerate() {
            if let Some(next) = ensemble.next_move(motor)? {
                replay.take(next);
                moved = true;
            }
        }
        if !moved {
            break;
        }
    }
    Ok(replays.into_iter().enumerate().map(|(motor, replay)| (replay.steps, ensemble.certificate(motor))).collect())
}

/// Plans a motor as if the line were its own.
fn alone(program: &Program, motor: usize) -> (Vec<TimedStep>, Certificate) {
    let motor = &program.motors[motor];
    let mut planner = Planner::new(&motor.law, &Settings::of(program, motor)).unwrap();
    let mut replay = LevelReplay::new();
    while let Some(next) = planner.next_move().unwrap() {
        replay.take(next);
    }
    (replay.steps, planner.certificate().clone())
}

/// Half the swing, steps; period, ms; phase of a delayed start, ms.
fn sweep() -> impl Strategy<Value = Law> {
    (1u64..120, 150u64..1500, 0u64..300, 1u64..3).prop_map(|(swing, period_ms, delay_ms, cycles)| {
        let ms = |n| Time::from_ratio(1, 1000).times(n);
        let sine = Law::sine(0.5 * swing as f64, ms(period_ms), Some(cycles)).unwrap();
        sine.delayed(ms(delay_ms)).unwrap()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn opposite_steps_are_kept_apart_and_nothing_else_moves(
        laws in prop::collection::vec(sweep(), 2..5),
        dir_ns in 200u32..40_000,
        forward in prop::array::uniform4(any::<bool>()),
    ) {
        let timing =
            DriverTiming { pulse_high_ns: 2_000, pulse_low_ns: 2_000, dir_setup_ns: dir_ns, dir_hold_ns: dir_ns / 2 };
        let apart = i128::from(timing.ticks(TICK_HZ).reversal());
        let mut program = program(laws, timing);
        for (motor, forward) in program.motors.iter_mut().zip(forward) {
            if let Wiring::StepDir { forward_high, .. } = &mut motor.wiring {
                *forward_high = forward;
            }
        }
        let plans = match together(&program) {
            Ok(plans) => plans,
            // Steps put off until the next one of their motor: the only reason to refuse these laws.
            Err(refused) => {
                prop_assert_eq!(refused.error.limit(), Some(pulsetrain_plan::error::Limit::Board), "{}", refused);
                return Ok(());
            }
        };
        // Tick, and the level that the step wants.
        let mut line: Vec<(i128, bool)> = Vec::new();
        for (motor, (steps, certificate)) in plans.iter().enumerate() {
            let (planned, own) = alone(&program, motor);
            prop_assert_eq!(steps.len(), planned.len());
            let mut late = Vec::new();
            for (step, planned) in steps.iter().zip(&planned) {
                prop_assert_eq!(step.direction, planned.direction);
                prop_assert!(step.tick >= planned.tick, "{step:?} comes before its time");
                late.extend((step.tick > planned.tick).then_some((step.tick - planned.tick) as u64));
            }
            let longest = late.iter().copied().max().unwrap_or(0);
            prop_assert_eq!(certificate.steps_put_off, late.len() as u64);
            prop_assert_eq!(certificate.longest_put_off_ticks, longest);
            prop_assert_eq!(certificate.bound_ticks, own.bound_ticks + longest as f64);
            prop_assert_eq!((certificate.steps, certificate.position), (own.steps, own.position));
            let shortest = steps.windows(2).map(|pair| pair[1].tick - pair[0].tick).min();
            prop_assert!(shortest.is_none_or(|ticks| ticks >= 160));
            // Inside of a segment an interval is known to the tick.
            let stated = certificate.shortest_interval_ticks.map(i128::from);
            prop_assert_eq!(stated.is_some(), shortest.is_some());
            if let (Some(stated), Some(shortest)) = (stated, shortest) {
                prop_assert!((shortest - 1..=shortest).contains(&stated), "{stated} stated, {shortest} made");
            }
            line.extend(steps.iter().map(|step| (step.tick, (step.direction == Direction::Forward) == forward[motor])));
        }
        line.sort_by_key(|(tick, _)| *tick);
        for pair in line.windows(2) {
            let close = pair[0].1 != pair[1].1 && pair[1].0 - pair[0].0 < apart;
            prop_assert!(!close, "{pair:?} need {apart} ticks");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// A board that makes one step after the other: two motors on one DIR line, and others with lines of their own.
    #[test]
    fn steps_of_all_motors_are_kept_apart_where_the_board_needs_it(laws in prop::collection::vec(sweep(), 2..5)) {
        let program = one_after_the_other(laws);
        let mut all: Vec<(i128, Direction, usize)> = Vec::new();
        for (motor, (steps, certificate)) in together(&program).unwrap().iter().enumerate() {
            let (planned, _) = alone(&program, motor);
            prop_assert_eq!(steps.len(), planned.len());
            prop_assert!(steps.iter().zip(&planned).all(|(step, planned)| step.tick >= planned.tick));
            let late = steps.iter().zip(&planned).filter(|(step, planned)| step.tick > planned.tick).count();
            prop_assert_eq!(certificate.steps_put_off, late as u64);
            all.extend(steps.iter().map(|step| (step.tick, step.direction, motor)));
        }
        check_one_after_the_other(all)?;
    }
}

const ONE_AFTER_THE_OTHER: SharedSteps = SharedSteps { together_ticks: 24, apart_ticks: 244 };

/// On a board that makes one step after the other, with long pulses: motors 0 and 1 on one DIR line, others with lines of their own.
fn one_after_the_other(laws: Vec<Law>) -> Program {
    let timing = DriverTiming { pulse_high_ns: 10_000, pulse_low_ns: 10_000, dir_setup_ns: 5_000, dir_hold_ns: 5_000 };
    let mut program = program(laws, timing);
    program.board.shared_steps = Some(ONE_AFTER_THE_OTHER);
    for (motor, own) in program.motors.iter_mut().zip(10..).skip(2) {
        if let Wiring::StepDir { dir, .. } = &mut motor.wiring {
            *dir = own;
        }
    }
    program
}

/// Steps of such motors are made together or far enough apart.
fn check_one_after_the_other(mut all: Vec<(i128, Direction, usize)>) -> Result<(), TestCaseError> {
    let SharedSteps { together_ticks, apart_ticks } = ONE_AFTER_THE_OTHER;
    all.sort_by_key(|(tick, ..)| *tick);
    let mut levels: Vec<Option<Direction>> = vec![None; 4];
    let mut made = i128::MIN / 2;
    for (tick, direction, motor) in all {
        let turns = levels[motor.max(1)].replace(direction).is_some_and(|before| before != direction);
        let apart = i128::from(apart_ticks) + if turns { 80 } else { 0 };
        let goes_along = !turns && tick <= made + i128::from(together_ticks);
        prop_assert!(goes_along || tick >= made + apart, "motor {motor} at {tick}, {} after", tick - made);
        made = if goes_along { made } else { tick };
    }
    Ok(())
}

/// Two motors that are 80 ticks apart: those of the second wait for those of the first. Where pulses may overlap none does.
#[test]
fn steps_of_one_direction_wait_where_the_board_needs_it_only() {
    let law = Law::speed(1000.0, Some(Time::from_seconds(0.1))).unwrap();
    let timing = DriverTiming { pulse_high_ns: 10_000, pulse_low_ns: 10_000, dir_setup_ns: 5_000, dir_hold_ns: 5_000 };
    let delayed = law.clone().delayed(Time::from_ratio(5, 1_000_000)).unwrap();
    let mut program = program(vec![law, delayed], timing);
    let put_off = |program: &Program| -> Vec<(u64, u64)> {
        let plans = together(program).unwrap();
        plans.iter().map(|(_, plan)| (plan.steps_put_off, plan.longest_put_off_ticks)).collect()
    };
    assert_eq!(put_off(&program), [(0, 0), (0, 0)]);
    program.board.shared_steps = Some(ONE_AFTER_THE_OTHER);
    assert_eq!(put_off(&program), [(0, 0), (100, 164)]);
}

/// A step that is put off comes closer to the next one of its motor; the certificate says how close.
#[test]
fn the_shortest_interval_is_that_of_the_steps_made() {
    let forth = Law::speed(1000.0, Some(Time::from_seconds(0.1))).unwrap();
    let back = Law::speed(-1000.0, Some(Time::from_seconds(0.1))).unwrap();
    let timing =
        DriverTiming { pulse_high_ns: 2_000, pulse_low_ns: 2_000, dir_setup_ns: 200_000, dir_hold_ns: 100_000 };
    let program = program(vec![forth, back.delayed(Time::from_ratio(1, 10_000)).unwrap()], timing);
    for (motor, (steps, certificate)) in together(&program).unwrap().iter().enumerate() {
        let shortest = steps.windows(2).map(|pair| (pair[1].tick - pair[0].tick) as u64).min();
        let (_, own) = alone(&program, motor);
        assert_eq!(own.shortest_interval_ticks, Some(16_000));
        assert_eq!(certificate.shortest_interval_ticks, shortest);
    }
}

/// Where a board has one pulse length, set-up and hold, those of a driver on another line keep steps apart too.
#[test]
fn drivers_of_other_lines_keep_steps_apart() {
    let there = |rate| Law::speed(rate, Some(Time::from_seconds(0.1))).unwrap();
    let short = DriverTiming { pulse_high_ns: 2_000, pulse_low_ns: 5_000, dir_setup_ns: 1_000, dir_hold_ns: 3_000 };
    let long = DriverTiming { pulse_high_ns: 40_000, pulse_low_ns: 60_000, dir_setup_ns: 20_000, dir_hold_ns: 500 };
    let mut program = program(vec![there(1000.0), there(-1000.0), there(100.0)], short);
    program.motors[2].timing = long;
    if let Wiring::StepDir { dir, .. } = &mut program.motors[2].wiring {
        *dir = 9;
    }
    let limits = |program: &Program| {
        let of = |motor| Settings::of(program, motor);
        let pair = |settings: Settings| (settings.min_interval_ticks, settings.reversal_ticks);
        program.motors.iter().map(of).map(pair).collect::<Vec<_>>()
    };
    let shortest_turn = |program: &Program| {
        let plans = together(program).unwrap();
        let mut line: Vec<TimedStep> = plans.into_iter().take(2).flat_map(|(steps, _)| steps).collect();
        line.sort_by_key(|step| step.tick);
        line.windows(2)
            .filter(|pair| pair[0].direction != pair[1].direction)
            .map(|pair| pair[1].tick - pair[0].tick)
            .min()
    };
    // 16 ticks are 1 µs.
    assert_eq!(limits(&program), [(160, 96), (160, 96), (1600, 968)]);
    assert_eq!(shortest_turn(&program), Some(96));
    program.board.one_timing = true;
    assert_eq!(limits(&program), [(720, 1008), (720, 1008), (1600, 1008)]);
    assert_eq!(shortest_turn(&program), Some(1008));
}

/// One motor of a line that ends beside one that goes on for ever: its plan comes to an end.
#[test]
fn a_plan_ends_although_others_on_its_line_do_not() {
    let period = Time::SECOND;
    let laws = vec![Law::sine(10.0, period, None).unwrap(), Law::sine(10.0, period, Some(2)).unwrap()];
    let program =
        program(laws, DriverTiming { pulse_high_ns: 1000, pulse_low_ns: 1000, dir_setup_ns: 200, dir_hold_ns: 200 });
    let mut ensemble = Ensemble::new(&program).unwrap();
    let mut ends = LevelReplay::new();
    while let Some(next) = ensemble.next_move(1).unwrap() {
        ends.take(next);
    }
    assert_eq!(ends.steps.len(), 80);
}

/// A motor that rests for ever on the line of another one: both plans go on, and the other one's steps are those it has alone.
#[test]
fn a_motor_may_rest_for_ever_beside_another() {
    let timing = DriverTiming { pulse_high_ns: 2_000, pulse_low_ns: 2_000, dir_setup_ns: 2_000, dir_hold_ns: 2_000 };
    let rest = Law::speed(0.0, None).unwrap();
    let turns = Law::sine(50.0, Time::from_seconds(0.3), Some(4)).unwrap();
    for laws in [vec![rest.clone(), turns.clone()], vec![turns, rest]] {
        let program = program(laws, timing);
        let mut ensemble = Ensemble::new(&program).unwrap();
        let (moving, resting) = if program.motors[0].law.end().is_some() { (0, 1) } else { (1, 0) };
        assert!(matches!(ensemble.next_move(resting), Ok(Some(Move::Dwell { ticks })) if ticks > TICK_HZ));
        let mut replay = LevelReplay::new();
        while let Some(next) = ensemble.next_move(moving).unwrap() {
            replay.take(next);
        }
        assert_eq!(replay.steps, alone(&program, moving).0);
        assert!(matches!(ensemble.next_move(resting), Ok(Some(Move::Dwell { .. }))));
    }
}

/// One motor of a line that rests for ever beside one that moves: both have their next move at once.
#[test]
fn a_motor_that_rests_for_ever_delays_no_other() {
    let laws = vec![Law::sine(10.0, Time::SECOND, None).unwrap(), Law::speed(0.0, None).unwrap()];
    let timing = DriverTiming { pulse_high_ns: 1000, pulse_low_ns: 1000, dir_setup_ns: 200, dir_hold_ns: 200 };
    let moves = |order: [usize; 2]| {
        let mut ensemble = Ensemble::new(&program(laws.clone(), timing)).unwrap();
        let mut of_mover = LevelReplay::new();
        for motor in order.into_iter().cycle().take(80) {
            let next = ensemble.next_move(motor).unwrap().expect("it has no end");
            match motor {
                0 => of_mover.take(next),
                _ => assert!(matches!(next, Move::Dwell { ticks } if ticks > TICK_HZ * 3600), "{next:?}"),
            }
        }
        of_mover.steps
    };
    let steps = moves([0, 1]);
    assert!(steps.len() >= 40);
    assert_eq!(steps, moves([1, 0]), "whichever is asked first");
}
