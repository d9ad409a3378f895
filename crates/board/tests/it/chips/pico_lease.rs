//! Leases on the Pico: whatever its host extends or not, its pins do what the native board does that is told the same.

use pulsetrain_board::lease::{Lease, LeaseState, Leased};
use pulsetrain_board::{Board, Edge, Setup};
use pulsetrain_core::Direction::Forward;
use pulsetrain_core::braking::Limit;
use pulsetrain_core::lease::LapseCause;
use pulsetrain_core::output::Sequence;
use pulsetrain_core::{Epoch, Item, Tick32};
use pulsetrain_testkit::Random;
use pulsetrain_testkit::pico::{Pair, TICK_HZ, coils, overhead, random_items, run, step_dir};
use pulsetrain_testkit::seed::seeds;

/// One driver; eight; drivers and coils.
fn setup(kind: u64) -> Setup {
    let motors = match kind {
        0 => vec![step_dir(2)],
        1 => (0..8).map(|motor| step_dir(2 + 2 * motor)).collect(),
        _ => vec![step_dir(2), coils(4, Sequence::Half), step_dir(26), coils(10, Sequence::Full)],
    };
    Setup { pulse_ticks: 250, setup_ticks: 400, hold_ticks: 200, motors, ..Setup::default() }
}

/// From 28 000 to 10^7 steps/s².
fn limit(random: &mut Random) -> Limit {
    Limit::new(random.between(128, 256) as u8, random.between(46, 51) as u8, random.below(4) as u8).expect("it is one")
}

/// How a lease ended.
#[derive(Default)]
struct Tally {
    lapsed: u32,
    braked: u32,
    to_the_end: u32,
    extended: u32,
}

/// Random plans and a host that extends their lease some times, and then stops, tells the end, or has the motors brake.
fn random_host(kind: u64, seed: u64, tally: &mut Tally) {
    let random = &mut Random::new(seed.wrapping_add(1000 * kind));
    let setup = setup(kind);
    let mut pair = Pair::new(&setup);
    let from = pair.pico.now() + pair.pico.round_trip() + TICK_HZ / 100;
    for (index, motor) in setup.motors.iter().enumerate() {
        let fastest = u64::from(overhead(&setup, motor)) + 1 + 300 * setup.motors.len() as u64;
        pair.push(index, 1, &random_items(&setup, motor, random, from, fastest));
        // That its motion ends before that of others is said by a wait.
        pair.push_all(index, 1, &[Item::Dwell { ticks: 0 }]);
    }
    let limits: Vec<Limit> = setup.motors.iter().map(|_| limit(random)).collect();
    let mut until = from + random.below(TICK_HZ / 5);
    pair.switch_with(1, from, Lease::Until(until), &limits);
    for _ in 0..random.below(6) {
        let look = pair.pico.now() + random.below(TICK_HZ / 50);
        pair.advance(look);
        let later = until + random.below(TICK_HZ / 10);
        if !pair.extend(Lease::Until(later)) {
            break;
        }
        tally.extended += 1;
        until = later;
    }
    if random.one_in(3) && pair.extend(Lease::Last) {
        tally.to_the_end += 1;
    } else if random.one_in(2) {
        // Amid the motion, if it has not come to its end.
        let look = pair.pico.now().max(from) + random.below(TICK_HZ / 20);
        pair.advance(look);
        pair.brake();
    }
    let deadline = pair.pico.now() + 20 * TICK_HZ;
    while !pair.pico.is_idle() || pair.pico.now() <= until {
        assert!(pair.pico.now() < deadline, "kind {kind}, seed {seed}: it does not come to rest");
        pair.advance(pair.pico.now() + TICK_HZ / 50);
    }
    match pair.native.lease() {
        LeaseState::Lapsed { cause: LapseCause::NotExtended, in_motion: true, .. } => tally.lapsed += 1,
        LeaseState::Lapsed { cause: LapseCause::Ordered, in_motion: true, .. } => tally.braked += 1,
        LeaseState::Lapsed { cause, .. } => assert!(!cause.is_fault(), "kind {kind}, seed {seed}: {cause:?}"),
        LeaseState::Last => {}
        other => panic!("kind {kind}, seed {seed}: {other:?}"),
    }
    pair.compare(pair.pico.now());
    assert_eq!(pair.pico.positions(), pair.native.positions(), "kind {kind}, seed {seed}");
}

#[test]
fn its_pins_brake_as_the_native_board_does() {
    let mut tally = Tally::default();
    for kind in 0..3 {
        for seed in seeds(0, 3) {
            random_host(kind, seed, &mut tally);
        }
    }
    let Tally { lapsed, braked, to_the_end, extended } = tally;
    assert!(lapsed > 1 && braked > 0 && to_the_end > 0 && extended > 5, "{lapsed} {braked} {to_the_end} {extended}");
}

/// The motor whose data came too late brakes at once, and the other with it: none stops dead, and no step is lost.
#[test]
fn a_motor_that_runs_dry_has_all_brake() {
    let setup = Setup { motors: vec![step_dir(2), step_dir(4)], ..setup(0) };
    let mut pair = Pair::new(&setup);
    let from = pair.pico.now() + pair.pico.round_trip() + TICK_HZ / 100;
    // 20 000 steps/s for 20 ms, and for a second; no wait says that the first one's motion ends.
    for (motor, count) in [(0, 400), (1, 20_000)] {
        pair.push_all(motor, 1, &[Item::Anchor { tick: Tick32::of(from) }, run(count, 6250, Forward)]);
    }
    // 400 000 steps/s²: R = 139 754 ticks.
    let limit = Limit::new(136, 49, 0).expect("it is one");
    let until = from + TICK_HZ / 2;
    assert_eq!(pair.pico.switch(Epoch(1), from, Lease::Until(until), &[limit; 2]), Ok(()));
    let mut edges = Vec::new();
    while !pair.pico.is_idle() || pair.pico.now() < until {
        let next = pair.pico.now() + TICK_HZ / 50;
        pair.pico.advance(next, &mut |edge: Edge| edges.push(edge));
    }
    let dry = from + 400 * 6250;
    let LeaseState::Lapsed { at, cause: LapseCause::Underrun, in_motion: true } = pair.pico.lease() else {
        panic!("{:?}", pair.pico.lease())
    };
    assert!(at < dry + TICK_HZ / 200, "all brake soon");
    for (motor, (step_pin, begins)) in [(2, dry), (4, at)].into_iter().enumerate() {
        let steps: Vec<u64> =
            edges.iter().filter(|edge| edge.line == step_pin && edge.level).map(|edge| edge.tick).collect();
        assert_eq!(pair.pico.positions()[motor], steps.len() as i64, "motor {motor}");
        // v²/2a is 500 steps; the rule takes up to twice as many.
        let after = steps.iter().filter(|tick| **tick > begins).count();
        assert!((500..1010).contains(&after), "motor {motor} takes {after} steps to brake");
        let apart = |pair: &[u64]| pair[1] - pair[0];
        assert!(steps.windows(2).map(apart).is_sorted(), "motor {motor} only slows down");
    }
}
