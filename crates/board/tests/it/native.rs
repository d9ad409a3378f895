//! The native board: what it counts, what it refuses, and that its edges are the steps that were scheduled.

use proptest::prelude::*;
use pulsetrain_board::native::{ConfigError, Faults, QUEUE_LEN};
use pulsetrain_board::{
    Config, Edge, Lease, Leased, MotorConfig, Native, Observer, ScheduledStep, SwitchRefused, Wiring,
};
use pulsetrain_core::output::Sequence;
use pulsetrain_core::{Direction, Entry, Epoch, Item, Segment, Tick32};

use Direction::{Backward, Forward};

const PULSE: u32 = 6;
const SETUP: u32 = 4;
const PULL_IN: u64 = 500;

fn step_dir(step: u8, dir: u8) -> Wiring {
    Wiring::StepDir { step, dir, forward_high: true, pulse_ticks: PULSE, setup_ticks: SETUP }
}

fn config(fraction_bits: u32, wirings: Vec<Wiring>) -> Config {
    let motors = wirings.into_iter().map(|wiring| MotorConfig { wiring, pull_in_ticks: PULL_IN }).collect();
    Config { fraction_bits, motors }
}

/// Motor m has STEP on line 2m and DIR on line 2m + 1.
fn board(fraction_bits: u32, motors: u8) -> Native {
    Native::new(&config(fraction_bits, (0..motors).map(|m| step_dir(2 * m, 2 * m + 1)).collect())).unwrap()
}

fn push(board: &mut Native, motor: usize, epoch: u8, items: &[Item]) {
    for &item in items {
        board.push(motor, Entry { epoch: Epoch(epoch), item }).unwrap();
    }
}

fn anchor(tick: u64) -> Item {
    Item::Anchor { tick: Tick32::of(tick) }
}

fn run(fraction_bits: u32, count: u32, ticks: u32, direction: Direction) -> Item {
    let interval = i64::from(ticks) << fraction_bits;
    Item::Run { segment: Segment { count, interval, add: 0, add2: 0 }, direction }
}

/// Counts pulses as a driver would, and keeps what was scheduled.
#[derive(Default)]
struct Lab {
    levels: u32,
    counted: Vec<i64>,
    rises: Vec<(usize, u64)>,
    last_tick: u64,
    scheduled: Vec<ScheduledStep>,
}

impl Lab {
    fn new(motors: usize) -> Lab {
        Lab { counted: vec![0; motors], ..Lab::default() }
    }
}

impl Observer for Lab {
    fn edge(&mut self, edge: Edge) {
        assert!(edge.tick >= self.last_tick, "edges are out of order");
        assert_ne!(self.levels >> edge.line & 1 == 1, edge.level, "an edge that is none");
        self.last_tick = edge.tick;
        self.levels ^= 1 << edge.line;
        if edge.line.is_multiple_of(2) && edge.level {
            let motor = usize::from(edge.line / 2);
            self.counted[motor] += if self.levels >> (edge.line + 1) & 1 == 1 { 1 } else { -1 };
            self.rises.push((motor, edge.tick));
        }
    }

    fn step(&mut self, step: ScheduledStep) {
        self.scheduled.push(step);
    }
}

/// Runs of a motor: count, interval in ticks, direction. The first step after each change leaves room for DIR.
fn runs() -> impl Strategy<Value = Vec<(u32, u32, bool)>> {
    prop::collection::vec((1u32..30, (PULSE + SETUP + 1)..900, any::<bool>()), 1..10)
}

fn items(fraction_bits: u32, from: u64, runs: &[(u32, u32, bool)]) -> Vec<Item> {
    let runs = runs
        .iter()
        .map(|&(count, ticks, forward)| run(fraction_bits, count, ticks, if forward { Forward } else { Backward }));
    [anchor(from), Item::Dwell { ticks: 20 }].into_iter().chain(runs).collect()
}

fn expected(from: u64, runs: &[(u32, u32, bool)]) -> Vec<(u64, i64)> {
    let mut tick = from + 20;
    let mut steps = Vec::new();
    for &(count, ticks, forward) in runs {
        for _ in 0..count {
            tick += u64::from(ticks);
            steps.push((tick, if forward { 1 } else { -1 }));
        }
    }
    steps
}

fn position(steps: &[(u64, i64)], until: u64) -> i64 {
    steps.iter().filter(|(tick, _)| *tick <= until).map(|(_, sign)| sign).sum()
}

proptest! {
    #[test]
    fn steps_counted_are_pulses_made_at_every_instant_and_after_every_stop(
        fraction_bits in prop_oneof![Just(16u32), Just(24), Just(32)],
        motors in prop::collection::vec(runs(), 1..4),
        looks in prop::collection::vec(1u64..4000, 0..20),
        then in prop::collection::vec(runs(), 4),
    ) {
        let mut board = board(fraction_bits, motors.len() as u8);
        let mut lab = Lab::new(motors.len());
        for (motor, runs) in motors.iter().enumerate() {
            push(&mut board, motor, 0, &items(fraction_bits, 0, runs));
        }
        let mut now = 0;
        for gap in looks {
            now += gap;
            board.advance(now, &mut lab);
            prop_assert_eq!(&board.positions(), &lab.counted);
            for (runs, position_now) in motors.iter().zip(board.positions()) {
                prop_assert_eq!(position_now, position(&expected(0, runs), now));
            }
        }

        let report = board.stop_now(now + 1, &mut lab);
        prop_assert_eq!(&report.positions, &lab.counted);
        let rises = lab.rises.len();
        board.advance(now + 100, &mut lab);
        prop_assert!(board.idle());
        prop_assert_eq!(lab.rises.len(), rises);
        prop_assert_eq!(&board.positions(), &report.positions);
        for (motor, runs) in motors.iter().enumerate() {
            let steps = expected(0, runs);
            let left = steps.iter().any(|(tick, _)| *tick > report.tick);
            let made: Vec<u64> = steps.iter().map(|(tick, _)| *tick).filter(|tick| *tick <= report.tick).collect();
            let fast = made.last_chunk::<2>().is_some_and(|[before, last]| {
                last - before < PULL_IN && report.tick - last < PULL_IN
            });
            prop_assert_eq!(report.uncertain[motor], left && fast);
        }

        // And on from there.
        let from = now + 200;
        for (motor, runs) in then.iter().enumerate().take(motors.len()) {
            push(&mut board, motor, 0, &items(fraction_bits, from, runs));
        }
        board.advance(from + 1_000_000, &mut lab);
        prop_assert_eq!(&board.positions(), &lab.counted);
        for (motor, runs) in then.iter().enumerate().take(motors.len()) {
            prop_assert_eq!(board.positions()[motor], report.positions[motor] + position(&expected(from, runs), u64::MAX));
            prop_assert_eq!(board.faults(motor), Faults::default());
        }
        prop_assert!(board.idle());

        let mut scheduled: Vec<_> = lab.scheduled.iter().map(|step| (step.motor, step.tick)).collect();
        scheduled.sort_by_key(|&(motor, tick)| (tick, motor));
        prop_assert_eq!(scheduled, lab.rises);
    }

    #[test]
    fn a_switch_is_for_all_motors_or_for_none(
        old in prop::collection::vec(runs(), 3),
        new in prop::collection::vec(runs(), 3),
        now in 0u64..3000,
        ahead in 0u64..3000,
    ) {
        let mut board = board(16, 3);
        let mut lab = Lab::new(3);
        for (motor, runs) in old.iter().enumerate() {
            push(&mut board, motor, 0, &items(16, 0, runs));
        }
        board.advance(now, &mut lab);
        let (at, horizon) = (now + ahead, board.horizon());
        for (motor, runs) in new.iter().enumerate() {
            push(&mut board, motor, 1, &items(16, at, runs));
        }
        let credit: Vec<usize> = (0..3).map(|motor| board.credit(motor)).collect();
        let answer = board.switch(Epoch(1), at, Lease::Last, &[]);
        let accepted = at >= horizon;
        prop_assert_eq!(answer, if accepted { Ok(()) } else { Err(SwitchRefused::Late { horizon }) });
        prop_assert!(horizon <= now + 1 + u64::from(SETUP + PULSE));
        board.advance(1_000_000, &mut lab);
        prop_assert_eq!(&board.positions(), &lab.counted);
        for motor in 0..3 {
            let before = position(&expected(0, &old[motor]), if accepted { at - 1 } else { u64::MAX });
            let after = if accepted { position(&expected(at, &new[motor]), u64::MAX) } else { 0 };
            prop_assert_eq!(board.positions()[motor], before + after);
            prop_assert_eq!(board.epoch(motor), Some(Epoch(u8::from(accepted))));
            prop_assert!(accepted || credit[motor] < QUEUE_LEN && board.credit(motor) == QUEUE_LEN);
        }
    }
}

#[test]
fn days_are_counted_in_ticks() {
    let mut board = board(32, 1);
    let mut lab = Lab::new(1);
    // Ten hours at 125 MHz.
    let step = 10 * 3600 * 125_000_000u64;
    let dwell = 2_000_000_000;
    let mut left = step;
    push(&mut board, 0, 0, &[anchor(0)]);
    while left > dwell {
        push(&mut board, 0, 0, &[Item::Dwell { ticks: dwell as u32 }]);
        left -= dwell;
        board.advance((step - left).saturating_sub(2 * dwell), &mut lab);
    }
    push(&mut board, 0, 0, &[run(32, 1, left as u32, Forward)]);
    board.advance(step - 1, &mut lab);
    assert_eq!(board.positions(), [0]);
    board.advance(step + 1, &mut lab);
    assert_eq!(lab.rises, [(0, step)]);
    assert_eq!(board.now(), step + 2);
}

#[test]
fn a_switch_that_moments_cannot_tell_is_refused() {
    let mut board = board(16, 1);
    board.advance((1 << 33) - 1, &mut |_: Edge| {});
    assert_eq!(board.switch(Epoch(1), (1 << 33) - 1, Lease::Last, &[]), Err(SwitchRefused::Late { horizon: 1 << 33 }));
    let limit = (1 << 33) + (1 << 30);
    assert_eq!(board.switch(Epoch(1), limit, Lease::Last, &[]), Err(SwitchRefused::Early { limit }));
    assert_eq!(board.switch(Epoch(1), 1 << 33, Lease::Last, &[]), Ok(()));
    assert_eq!(board.switch(Epoch(1), limit - 1, Lease::Last, &[]), Err(SwitchRefused::Full));
}

#[test]
fn what_a_plan_does_wrong_is_told() {
    let check = |items: &[Item], expected: Faults, steps: i64| {
        let mut board = board(16, 1);
        let mut lab = Lab::new(1);
        push(&mut board, 0, 0, items);
        board.advance(10_000, &mut lab);
        assert_eq!(board.faults(0), expected, "{items:?}");
        assert_eq!((board.positions(), &lab.counted), (vec![steps], &vec![steps]), "{items:?}");
    };
    check(&[anchor(0), run(16, 5, PULSE + 1, Forward)], Faults::default(), 5);
    check(&[anchor(0), run(16, 5, PULSE, Forward)], Faults { step_missed: true, ..Faults::default() }, 1);
    check(&[run(16, 5, 100, Forward)], Faults { step_missed: true, ..Faults::default() }, 0);
    check(&[anchor(0), run(16, 5, SETUP - 1, Forward)], Faults { step_missed: true, setup_cut_short: true }, 1);
    let turn = [anchor(0), run(16, 1, 100, Forward), run(16, 1, PULSE + SETUP - 1, Backward)];
    check(&turn, Faults { setup_cut_short: true, ..Faults::default() }, 0);
}

#[test]
fn a_queue_gives_back_what_it_cannot_hold() {
    let mut board = board(16, 1);
    let entry = Entry { epoch: Epoch(0), item: anchor(0) };
    for place in 0..QUEUE_LEN {
        assert_eq!(board.credit(0), QUEUE_LEN - place);
        assert_eq!(board.push(0, entry), Ok(()));
    }
    assert_eq!(board.push(0, entry), Err(entry));
    assert_eq!(board.push(1, entry), Err(entry));
    assert_eq!(board.credit(1), 0);
}

#[test]
fn no_board_is_made_that_cannot_be() {
    let check = |fraction_bits, wirings: &[Wiring], expected| {
        let answer = Native::new(&config(fraction_bits, wirings.to_vec()));
        assert_eq!(answer.map(|_| ()), expected, "{wirings:?}");
    };
    let coils = |lines| Wiring::Coils { lines, sequence: Sequence::Half, release_ticks: None };
    let pulse = |pulse_ticks| Wiring::StepDir { step: 0, dir: 1, forward_high: true, pulse_ticks, setup_ticks: SETUP };
    check(16, &[step_dir(9, 8), step_dir(10, 8), coils([0, 1, 2, 3])], Ok(()));
    check(20, &[], Err(ConfigError::FractionBits(20)));
    check(16, &vec![step_dir(0, 1); 17], Err(ConfigError::Motors(17)));
    check(16, &[step_dir(32, 1)], Err(ConfigError::Line(32)));
    check(16, &[step_dir(3, 3)], Err(ConfigError::LineTaken(3)));
    check(16, &[step_dir(0, 1), step_dir(2, 0)], Err(ConfigError::LineTaken(0)));
    check(16, &[coils([1, 2, 3, 1])], Err(ConfigError::LineTaken(1)));
    check(16, &[pulse(0)], Err(ConfigError::Ticks(0)));
    check(16, &[pulse(1 << 29)], Err(ConfigError::Ticks(1 << 29)));
}
