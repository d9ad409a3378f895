//! One or two motors on pins 9 and 10, whose edges the compare hardware makes: however their groups fall together, each edge comes on its tick, and
//! no level is ever the wrong way round. And one of these pins beside another, where software makes the edges.
//!
//! The motors turn as soon as a planner may have them turn, and where the compare register is moved on between two steps
//! (`FILLER` in firmware/uno/src/engine/steps/plan.rs): there groups are closest. They do so in step, or nearly, so that one's interrupt keeps the other's
//! waiting.

use pulsetrain_board::{Board, Faults, Lease, Leased};
use pulsetrain_core::wire::message::Cause;
use pulsetrain_core::{Direction, Entry, Epoch, Item, Segment, Tick32};
use pulsetrain_testkit::lab::{EXACT, Lab, SOFTWARE, Timing, said, uno};
use pulsetrain_testkit::{Random, TICK_HZ, uno_setup};

/// Pins of motors (STEP, DIR), and how far their edges may be from their ticks.
const PINS: [(&[(u8, u8)], Timing); 7] = [
    (&[(9, 8)], EXACT),
    (&[(10, 7)], EXACT),
    (&[(9, 8), (10, 13)], EXACT),
    (&[(9, 2), (10, 7)], EXACT),
    (&[(10, 8), (9, 3)], EXACT),
    (&[(9, 8), (11, 12)], SOFTWARE),
    (&[(10, 13), (8, 12)], SOFTWARE),
];

/// How far the compare register is moved on, ticks: `FILLER` in firmware/uno/src/bin/uno/main.rs.
const FILLER: u64 = 16_384;

/// After a turn the first step comes so long after the last one, at least, with one motor and with two: what the boards' table has for the compare
/// hardware (`TURN_TICKS_BY_COMPARE` in crates/motion/src/boards/uno/timing.rs).
const TURN: [u64; 2] = [192, 342];

/// Ticks of a plan's parts: from the last step before a turn to the first after it, so many steps of that interval, and so on.
fn parts(random: &mut Random, least: u64) -> Vec<(u64, u32, i64)> {
    let part = |random: &mut Random| {
        let turn = match random.below(4) {
            // As soon as may be.
            0 => least + random.below(60),
            // The turn, or the step, comes soon after the compare register was moved on.
            1 => FILLER * random.between(1, 3) + 150 + random.below(350),
            2 => FILLER * random.between(1, 3) + [240, 340][random.below(2) as usize] + random.below(20),
            _ => least + random.below(60_000),
        };
        let interval = if random.one_in(3) { FILLER as i64 + 100 + random.below(400) as i64 } else { 3200 };
        (turn, random.between(5, 8) as u32, interval)
    };
    (0..random.between(20, 30)).map(|_| part(random)).collect()
}

fn turns_of(pins: &[(u8, u8)], timing: Timing, seed: u64) -> (usize, bool) {
    let random = &mut Random::new(seed);
    let pulse = [2, 16, 31, 80][random.below(4) as usize];
    let setup = uno_setup(pins, pulse);
    // Software, and pulses that are two edges of the hardware's, want more room for a turn.
    let room = u64::from(setup.pulse_ticks) + u64::from(setup.hold_ticks) + u64::from(setup.setup_ticks);
    let extra = if timing.late == 0 && pulse <= 31 { 0 } else { room + 400 };
    let mut board = uno(&setup);
    let mut lab = Lab::default();
    let parts = parts(random, TURN[pins.len() - 1]);
    // Nearly in step: one's interrupt comes before the other's, with it or behind it.
    let behind = if random.one_in(3) { random.below(240) } else { random.below(10) };
    let from = board.now() + board.round_trip() + TICK_HZ / 20;
    let mut pending: Vec<Vec<Item>> = Vec::new();
    for motor in 0..pins.len() as u64 {
        let mut direction = Direction::Forward;
        let mut items = vec![Item::Anchor { tick: Tick32::of(from) }];
        items.push(Item::Dwell { ticks: (20_000 + behind * motor) as u32 });
        for (turn, count, interval) in &parts {
            // A run begins an interval after what was before.
            let (first, turn) = (interval << 16, (turn + extra) as i64);
            if turn > *interval {
                items.push(Item::Dwell { ticks: (turn - interval) as u32 });
                let segment = Segment { count: *count, interval: first, add: 0, add2: 0 };
                items.push(Item::Run { segment, direction });
            } else {
                let one = Segment { count: 1, interval: turn << 16, add: 0, add2: 0 };
                items.push(Item::Run { segment: one, direction });
                let rest = Segment { count: count - 1, interval: first, add: 0, add2: 0 };
                items.push(Item::Run { segment: rest, direction });
            }
            direction = direction.reversed();
        }
        items.reverse();
        pending.push(items);
    }
    let fill = |board: &mut pulsetrain_testkit::lab::UnoWithReference, pending: &mut Vec<Vec<Item>>| {
        for (motor, items) in pending.iter_mut().enumerate() {
            while let Some(item) = items.last() {
                if board.room(motor) < 20 || board.push(motor, Entry { epoch: Epoch(1), item: *item }).is_err() {
                    break;
                }
                items.pop();
            }
        }
    };
    fill(&mut board, &mut pending);
    assert_eq!(board.switch(Epoch(1), from, Lease::Last, &[]), Ok(()));
    let patience = board.now() + 20 * TICK_HZ;
    while pending.iter().any(|items| !items.is_empty()) || !board.is_idle() {
        assert!(board.now() < patience, "it does not come to rest");
        let until = board.now() + TICK_HZ / 500;
        board.advance(until, &mut lab);
        if board.board_mut().error().is_some() {
            break;
        }
        fill(&mut board, &mut pending);
    }
    let until = board.now() + TICK_HZ / 500;
    board.advance(until, &mut lab);
    let told = board.board_mut().events();
    // Both turn so often here that a ring may run dry.
    let ran_dry = board.board_mut().final_report().expect("it answers").last_stop == Cause::Starved;
    if !ran_dry {
        assert!(board.record_is_complete(), "the native board took something else");
        assert!(told.iter().all(|event| event.cause == Cause::Finished), "{told:?}");
        lab.check(&setup, timing, None);
        assert!((0..pins.len()).all(|motor| board.faults(motor) == Faults::default()));
    }
    // This also holds each pulse against its active level.
    assert_eq!(said(&mut board), lab.counts(&setup), "what it counted, and the pins");
    (lab.steps.len(), ran_dry)
}

/// On each of these pins.
const SEEDS: u64 = 36;

#[test]
fn pulses_stay_upright_however_motors_turn() {
    let mut failed = Vec::new();
    for (pins, timing) in PINS {
        let (mut steps, mut dry) = (0, 0);
        for seed in 1..=SEEDS {
            println!("{pins:?}, seed {seed}");
            match std::panic::catch_unwind(|| turns_of(pins, timing, seed)) {
                Ok((made, ran_dry)) => (steps, dry) = (steps + made, dry + u64::from(ran_dry)),
                Err(_) => failed.push((pins, seed)),
            }
        }
        println!("{pins:?}: {steps} steps, {dry} ran dry");
        assert!(dry <= SEEDS / 10, "{pins:?}: {dry} ran dry");
    }
    assert!(failed.is_empty(), "{} of {}: {failed:?}", failed.len(), PINS.len() as u64 * SEEDS);
}
