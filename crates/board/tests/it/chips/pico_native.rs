//! The firmware on the emulated chip makes the native board's edges, all of them, tick for tick: random plans, switches, stops.

use pulsetrain_board::{Board, Faults, Setup, SwitchRefused};
use pulsetrain_core::Item;
use pulsetrain_core::output::{HALF_STEPS, Sequence};
use pulsetrain_core::wire::message::{Cause, MotorSetup};
use pulsetrain_testkit::Random;
use pulsetrain_testkit::pico::{Pair, TICK_HZ, coil_levels, coils, overhead, random_items, step_dir};
use pulsetrain_testkit::seed::seeds;

const SEQUENCES: [Sequence; 3] = [Sequence::Wave, Sequence::Full, Sequence::Half];

/// Ways to wire a Pico: the pins of a motor begin at these, C for coils.
fn motors(kind: u64, random: &mut Random) -> Vec<MotorSetup> {
    let sequence = |random: &mut Random| SEQUENCES[random.below(3) as usize];
    match kind {
        0 => vec![step_dir(2)],
        1 => vec![step_dir(27), step_dir(21), step_dir(2)],
        2 => (0..8).map(|motor| step_dir(2 + 2 * motor)).collect(),
        3 => vec![coils([19, 20, 21, 22][random.below(4) as usize], sequence(random))],
        4 => (0..6).map(|motor| coils(2 + 4 * motor, sequence(random))).collect(),
        _ => {
            let mut motors: Vec<_> = (0..4).map(|motor| step_dir(2 + 2 * motor)).collect();
            motors.extend([coils(10, sequence(random)), step_dir(21), coils(14, sequence(random))]);
            motors
        }
    }
}

/// A setup with levels, pulses and DIR times of any kind.
fn random_setup(kind: u64, random: &mut Random) -> Setup {
    let mut setup = Setup {
        // 100 ns to 10 µs, and what the state machine can do beyond.
        pulse_ticks: [0, 3, 13, 125, 250, 1250][random.below(6) as usize],
        setup_ticks: random.below(600) as u16,
        hold_ticks: random.below(600) as u16,
        idle_ms: random.one_in(2).then(|| random.between(1, 40) as u16),
        motors: motors(kind, random),
        ..Setup::default()
    };
    for motor in setup.motors.iter_mut().filter(|motor| motor.coils().is_none()) {
        (motor.forward_high, motor.step_low) = (random.one_in(2), random.one_in(2));
        motor.gain = random.below(5) as i8 - 2;
        if random.one_in(2) {
            (motor.step_pin, motor.dir_pin) = (motor.dir_pin, motor.step_pin);
        }
    }
    setup
}

/// What random plans came to.
#[derive(Default)]
struct Tally {
    edges: usize,
    refused: u32,
    taken: u32,
    /// Runs whose acceleration changes.
    bent: usize,
}

/// Random epochs; switches at random ticks, of which some come too late; at the end rest, or a stop.
fn random_plans(kind: u64, seed: u64, tally: &mut Tally) {
    let random = &mut Random::new(seed.wrapping_add(100 * kind));
    let setup = random_setup(kind, random);
    let mut pair = Pair::new(&setup);
    let push = |pair: &mut Pair, random: &mut Random, epoch: u8, from: u64, tally: &mut Tally| {
        for (index, motor) in setup.motors.iter().enumerate() {
            // One motor by itself as fast as the state machine is, or nearly; several as fast as the processor is.
            let fastest = u64::from(overhead(&setup, motor)) + 1 + 100 * setup.motors.len() as u64;
            let items = random_items(&setup, motor, random, from, fastest);
            let bends = |item: &&Item| matches!(item, Item::Run { segment, .. } if segment.add2 != 0);
            tally.bent += items.iter().filter(bends).count();
            pair.push(index, epoch, &items);
        }
    };
    let from = pair.pico.now() + pair.pico.round_trip() + TICK_HZ / 100;
    push(&mut pair, random, 1, from, tally);
    assert_eq!(pair.switch(1, from), Ok(()));
    let (mut epoch, mut begins) = (1, from);
    for _ in 0..random.between(1, 5) {
        // One switch may wait: the Pico makes it before its tick, the native board at it.
        let until = begins.max(pair.pico.now() + random.below(TICK_HZ / 25));
        pair.advance(until);
        // From the past to a little after it can be taken.
        let reach = if random.one_in(3) { pair.pico.round_trip() / 16 } else { pair.pico.round_trip() };
        let from = pair.pico.now() + random.below(reach);
        push(&mut pair, random, epoch + 1, from, tally);
        match pair.switch(epoch + 1, from) {
            Ok(()) => (epoch, begins, tally.taken) = (epoch + 1, from, tally.taken + 1),
            Err(SwitchRefused::Late { .. }) => tally.refused += 1,
            Err(refused) => panic!("{refused}: {:?}", pair.pico.error()),
        }
    }
    if random.one_in(3) {
        let tick = pair.pico.now() + random.below(TICK_HZ / 20);
        let report = pair.stop_now(tick);
        // Pulses that were begun end.
        pair.advance(report.tick + TICK_HZ / 1000);
        for (motor, position) in setup.motors.iter().zip(&report.positions) {
            let Some(sequence) = motor.coils() else { continue };
            let (first, half_steps) = match sequence {
                Sequence::Wave => (1, 2),
                Sequence::Full => (0, 2),
                Sequence::Half => (0, 1),
            };
            let pattern = HALF_STEPS[(first + half_steps * position).rem_euclid(8) as usize];
            let levels = coil_levels(&pair.edges, motor);
            assert!(levels == pattern || levels == 0, "{levels:04b} at {position}, not {pattern:04b}: {setup:?}");
        }
        let counts = pair.counts();
        for (position, count) in report.positions.iter().zip(&counts) {
            assert!(count.is_none_or(|count| count == *position), "{:?} {counts:?}", report.positions);
        }
        // The machines were halted a little before.
        pair.compare(report.tick - 100);
    } else {
        let patience = pair.pico.now() + 60 * TICK_HZ;
        while !pair.pico.is_idle() {
            assert!(pair.pico.now() < patience, "it does not come to rest: {:?}", pair.pico.events());
            pair.advance(pair.pico.now() + TICK_HZ / 20);
        }
        pair.advance(pair.pico.now() + TICK_HZ / 100);
        let until = pair.native.now();
        pair.compare(until);
        assert!(pair.native.idle());
        assert_eq!(pair.pico.positions(), pair.native.positions());
    }
    let told: Vec<_> = pair.pico.events().into_iter().filter(|event| event.cause != Cause::Finished).collect();
    assert!(told.is_empty(), "{told:?}");
    assert_eq!(pair.pico.error(), None);
    for motor in 0..setup.motors.len() {
        assert_eq!(pair.pico.faults(motor), Faults::default());
    }
    tally.edges += pair.edges.len();
}

fn random_plans_on(kinds: std::ops::Range<u64>) {
    let mut tally = Tally::default();
    for kind in kinds {
        for seed in seeds(1, SEEDS) {
            println!("kind {kind}, seed {seed}");
            random_plans(kind, seed, &mut tally);
        }
    }
    // The comparison was of something, and both answers to a switch were seen.
    let Tally { edges, taken, refused, bent } = tally;
    assert!(edges > 20_000 && taken >= 2 && refused >= 2 && bent > 20, "{edges} {taken} {refused} {bent}");
}

/// Plans of each kind; `PULSETRAIN_ROUNDS` says how many times as many.
const SEEDS: u64 = 2;

#[test]
fn drivers() {
    random_plans_on(0..3);
}

#[test]
fn coils_and_both() {
    random_plans_on(3..6);
}
