//! The immediate stop on the virtual Pico, whenever it comes: what it counts is what the pins did. `pico_stop_at.rs` has it in
//! cycle after cycle.

use pulsetrain_board::{Board, Edge, Setup, StopReport};
use pulsetrain_core::output::{HALF_STEPS, Sequence};
use pulsetrain_core::wire::message::{Cause, MotorSetup};
use pulsetrain_core::{Direction, Item, Tick32};
use pulsetrain_testkit::Random;
use pulsetrain_testkit::held::hold_for;
use pulsetrain_testkit::pico::{Pair, TICK_HZ, as_line, coil_levels, coils, pins_of, run, step_dir, stopped_driver};
use pulsetrain_testkit::seed::{rounds, seed};

/// Two drivers and coils, under way: the second driver turns all the time.
fn under_way(pulse_ticks: u16) -> Pair {
    let setup = Setup {
        pulse_ticks,
        setup_ticks: 20,
        hold_ticks: 5,
        motors: vec![step_dir(2), step_dir(10), coils(16, Sequence::Half)],
        ..Setup::default()
    };
    let mut pair = Pair::new(&setup);
    let from = pair.pico.now() + pair.pico.round_trip() + TICK_HZ / 100;
    let word = i64::from(pulse_ticks) + 3;
    pair.push(0, 1, &[Item::Anchor { tick: Tick32::of(from) }, run(1_000_000, 2 * word + 300, Direction::Backward)]);
    let mut turning = vec![Item::Anchor { tick: Tick32::of(from) }];
    for _ in 0..400 {
        turning.push(run(2, 10_000, Direction::Forward));
        turning.push(run(1, 10_000, Direction::Backward));
    }
    pair.push(1, 1, &turning);
    pair.push(2, 1, &[Item::Anchor { tick: Tick32::of(from) }, run(100_000, 19_997, Direction::Forward)]);
    assert_eq!(pair.switch(1, from), Ok(()));
    pair.advance(from + TICK_HZ / 500);
    pair
}

/// What the coils' pins say of the position, modulo 8.
fn phase(edges: &[Edge], motor: &MotorSetup) -> Option<usize> {
    let levels = coil_levels(edges, motor);
    HALF_STEPS.iter().position(|pattern| *pattern == levels)
}

#[test]
fn the_count_is_what_the_pins_did_whenever_it_comes() {
    let random = &mut Random::new(seed(7));
    for pulse_ticks in [13, 200] {
        let mut begun = under_way(pulse_ticks);
        let mut times: Vec<u64> = (0..75 * rounds()).map(|_| random.below(TICK_HZ / 16)).collect();
        times.sort_unstable();
        let began = begun.pico.now();
        for time in times {
            let until = began + time;
            begun.advance(until.saturating_sub(TICK_HZ / 500));
            // The same board again, a moment later.
            let (mut pico, mut edges) = (begun.pico.clone(), begun.edges.clone());
            // Naps and frames of USB have their own rhythm, which a stop would come in.
            hold_for(pico.port_mut(), random.below(10_000));
            let StopReport { tick, positions, uncertain } =
                pico.stop_now(until, &mut |edge: Edge| edges.extend(as_line(&begun.setup, edge)));
            pico.advance(tick + TICK_HZ / 1000, &mut |edge: Edge| edges.extend(as_line(&begun.setup, edge)));
            // The first driver and the coils are faster than their pull-in; the second may have just turned.
            assert!(uncertain[0] && uncertain[2], "{uncertain:?} {positions:?} {tick}");
            let motors = &begun.setup.motors;
            for (motor, position) in motors.iter().zip(&positions).take(2) {
                assert_eq!(stopped_driver(&begun.setup, motor, &edges, tick).position, *position);
            }
            assert_eq!(phase(&edges, &motors[2]), Some(positions[2].rem_euclid(8) as usize));
        }
    }
}

/// Eight drivers at their highest rates: a pulse that the stop catches ends soon after its told length, whoever else is stopped, and however
/// long pulses are.
#[test]
fn a_pulse_that_a_stop_catches_ends_soon_after_its_told_length() {
    let random = &mut Random::new(21);
    // A usual one, 10 µs, and the longest that a Configure takes; `pico_stop_at.rs` has the shortest.
    for (pulse_ticks, interval) in [(13, 200), (1_250, 1_300), (62_500, 62_600)] {
        let motors = (0..8).map(|motor| step_dir(2 + 2 * motor)).collect();
        let setup = Setup { pulse_ticks, setup_ticks: 20, hold_ticks: 5, motors, ..Setup::default() };
        let mut pair = Pair::new(&setup);
        let from = pair.pico.now() + pair.pico.round_trip() + TICK_HZ / 100;
        for motor in 0..8 {
            let items =
                [Item::Anchor { tick: Tick32::of(from) }, run(1_000_000, interval + motor as i64, Direction::Forward)];
            pair.push(motor, 1, &items);
        }
        assert_eq!(pair.switch(1, from), Ok(()));
        pair.advance(from + TICK_HZ / 100);
        let (mut caught, mut longest) = (0, 0);
        for _ in 0..16 {
            let (mut pico, mut edges) = (pair.pico.clone(), pair.edges.clone());
            let until = pico.now() + random.below(TICK_HZ / 200);
            hold_for(pico.port_mut(), random.below(10_000));
            let StopReport { tick, positions, .. } =
                pico.stop_now(until, &mut |edge: Edge| edges.extend(as_line(&setup, edge)));
            pico.advance(tick + TICK_HZ / 500, &mut |edge: Edge| edges.extend(as_line(&setup, edge)));
            for (motor, position) in setup.motors.iter().zip(&positions) {
                let pins = stopped_driver(&setup, motor, &edges, tick);
                assert_eq!(pins.position, *position);
                if let Some((_, beyond)) = pins.caught {
                    (caught, longest) = (caught + 1, beyond.max(longest));
                }
            }
        }
        println!("pulse {pulse_ticks}: {caught} caught, {longest} ticks longer at most");
        assert!(caught > 0, "pulse {pulse_ticks}: no stop came in one");
    }
}

/// No edge is off its tick before a stop, and none comes after it: the Pico's are the first of the native board's, which
/// goes on; but for the end of a pulse, which may be late.
fn assert_first_edges_of(pair: &mut Pair, stop: u64) {
    let Pair { setup, native, edges, wanted, .. } = pair;
    native.advance(stop + TICK_HZ / 100, &mut |edge: Edge| wanted.push(edge));
    for motor in &setup.motors {
        let lines = pins_of(motor);
        let [mut got, mut wanted] = [&*edges, &*wanted]
            .map(|edges| edges.iter().filter(|edge| lines.contains(&edge.line)).copied().collect::<Vec<_>>());
        got.sort_by_key(|edge| (edge.tick, edge.line));
        wanted.sort_by_key(|edge| (edge.tick, edge.line));
        assert!(got.len() > 100 && got.len() < wanted.len(), "{} edges of {}", got.len(), wanted.len());
        for (number, (is, ought)) in got.iter().zip(&wanted).enumerate() {
            let ends_pulse = motor.coils().is_none() && is.line == motor.step_pin && !is.level;
            let same = if ends_pulse && number + 1 == got.len() {
                is.line == ought.line && is.level == ought.level && is.tick >= ought.tick
            } else {
                is == ought && is.tick <= stop
            };
            assert!(same, "edge {number} of {}: {is:?} is not {ought:?}; the stop was at {stop}", got.len());
        }
    }
}

/// The main loop is late: what is played up to the end of what was written is right, and then all is over.
#[test]
fn a_main_loop_that_is_late_plays_nothing_late() {
    let mut stopped = 0;
    for tenths_of_ms in [5, 15, 17, 18, 19, 20, 21, 22, 23, 24, 26, 40] {
        // The third is the fastest; the coils have next to nothing to do.
        let motors = vec![step_dir(2), step_dir(4), step_dir(6), coils(8, Sequence::Full), step_dir(12), step_dir(14)];
        let setup = Setup { pulse_ticks: 125, setup_ticks: 40, motors, ..Setup::default() };
        let mut pair = Pair::new(&setup);
        let from = pair.pico.now() + pair.pico.round_trip() + TICK_HZ / 100;
        for (motor, ticks) in (0..).zip([1000, 40_000, 500, 100_000, 3333, 1111]) {
            let items = [Item::Anchor { tick: Tick32::of(from) }, run(1_000_000, ticks, Direction::Forward)];
            pair.push(motor, 1, &items);
        }
        assert_eq!(pair.switch(1, from), Ok(()));
        pair.advance(from + TICK_HZ / 20);
        pair.pico.events();
        let late = hold_for(pair.pico.port_mut(), tenths_of_ms * TICK_HZ / 10_000);
        let until = late + TICK_HZ / 50;
        pair.pico.advance(until, &mut |edge: Edge| pair.edges.extend(as_line(&setup, edge)));
        if let Some(starved) = pair.pico.events().iter().find(|event| event.cause == Cause::Starved) {
            stopped += 1;
            println!("{tenths_of_ms}: {} after", starved.tick - late);
            // 0.4 ms. A motor may still run dry while others get words, and the event comes when all motors' steps are counted, which takes 0.3 ms.
            assert!(starved.tick < late + 50_000, "{tenths_of_ms}");
            assert_first_edges_of(&mut pair, starved.tick);
            let status = pair.pico.status().expect("it answers");
            let motors = status.motors.as_slice();
            let positions: Vec<_> = motors.iter().map(|motor| Some(i64::from(motor.position))).collect();
            for (position, count) in positions.iter().zip(pair.counts()) {
                assert!(count.is_none() || count == *position, "{positions:?}");
            }
        } else {
            pair.native.advance(until, &mut |edge: Edge| pair.wanted.push(edge));
            pair.compare(until - TICK_HZ / 500);
        }
    }
    assert!((3..=10).contains(&stopped), "{stopped}");
}

/// Eight motors ask for more than the processor does: a state machine runs dry, and all stop at once, with the reason.
#[test]
fn a_processor_that_does_not_keep_up_stops_all() {
    let motors: Vec<_> = (0..8).map(|motor| step_dir(2 + 2 * motor)).collect();
    let setup = Setup { pulse_ticks: 13, motors, ..Setup::default() };
    let mut pair = Pair::new(&setup);
    let from = pair.pico.now() + pair.pico.round_trip() + TICK_HZ / 100;
    for motor in 0..8 {
        pair.push(motor, 1, &[Item::Anchor { tick: Tick32::of(from) }, run(1_000_000, 60, Direction::Forward)]);
    }
    assert_eq!(pair.switch(1, from), Ok(()));
    pair.pico.advance(from + TICK_HZ / 10, &mut |edge: Edge| pair.edges.extend(as_line(&setup, edge)));
    let events = pair.pico.events();
    assert!(events.iter().any(|event| event.cause == Cause::Starved), "{events:?}");
    let status = pair.pico.status().expect("it answers");
    assert!(status.is_idle());
    let positions: Vec<_> = status.motors.as_slice().iter().map(|motor| Some(i64::from(motor.position))).collect();
    assert_eq!(positions, pair.counts());
    assert!(positions.iter().all(|position| *position > Some(1000)), "{positions:?}");
    let starved = events.iter().find(|event| event.cause == Cause::Starved).expect("it is told").tick;
    assert_first_edges_of(&mut pair, starved);
    // It begins again when it is told to.
    pair.pico.arm().expect("at rest");
    assert!(pair.pico.status().expect("it answers").is_idle());
}

/// A stop that comes just after the main loop was held up is heard up to 0.6 ms later than else, at the highest rate that is promised: words
/// come first, but there is no nap among them.
#[test]
fn a_main_loop_that_was_held_up_hears_a_stop_soon() {
    let motors = (0..8).map(|motor| step_dir(2 + 2 * motor)).collect();
    let mut pair = Pair::new(&Setup { pulse_ticks: 13, setup_ticks: 20, motors, ..Setup::default() });
    let from = pair.pico.now() + pair.pico.round_trip() + TICK_HZ / 100;
    for motor in 0..8 {
        pair.push(motor, 1, &[Item::Anchor { tick: Tick32::of(from) }, run(1_000_000, 200, Direction::Forward)]);
    }
    assert_eq!(pair.switch(1, from), Ok(()));
    pair.advance(from + TICK_HZ / 50);
    // The longest of some, after so many tenths of a millisecond.
    let heard_after = |tenths: u64| {
        let waits = (0..8).map(|part| {
            let mut pico = pair.pico.clone();
            pico.advance(pico.now() + part * TICK_HZ / 9000, &mut |_: Edge| {});
            let asked = hold_for(pico.port_mut(), tenths * TICK_HZ / 10_000);
            let (stopped, _) = pico.stop_motors().expect("it stops");
            assert!(pico.events().iter().all(|event| event.cause != Cause::Starved), "{tenths}");
            stopped.tick - asked
        });
        waits.max().expect("some")
    };
    let else_after = heard_after(0);
    for tenths in [3, 6, 9, 12, 14] {
        let after = heard_after(tenths);
        println!("{tenths}: {} µs, else {} µs", after / 125, else_after / 125);
        assert!(after < else_after + TICK_HZ * 6 / 10_000, "{tenths}: {after} ticks, else {else_after}");
    }
}

/// Who is stopped at once is uncertain if its steps were closer than its pull-in: not if they were further apart, also while the motor turns,
/// and on coils. Of steps further apart than words are written ahead, 2.4 ms, the one before is forgotten: they are taken for 1.8 ms at least.
#[test]
fn only_who_was_faster_than_its_pull_in_is_uncertain() {
    for interval in [25_000, 62_500, 125_000, 312_500, 1_250_000, 12_500_000] {
        let slower = if interval < 312_501 { interval * 9 / 10 } else { 208_333 };
        for (pull_in, is_uncertain) in [(slower, false), (interval * 11 / 10, true)] {
            let motors = [step_dir(2), step_dir(4), coils(8, Sequence::Half)];
            let motors = motors.map(|motor| MotorSetup { pull_in_ticks: pull_in, ..motor }).to_vec();
            let mut pair = Pair::new(&Setup { pulse_ticks: 13, setup_ticks: 20, motors, ..Setup::default() });
            let from = pair.pico.now() + pair.pico.round_trip() + TICK_HZ / 100;
            let forward = [Item::Anchor { tick: Tick32::of(from) }, run(1000, interval.into(), Direction::Forward)];
            let turning = [Direction::Forward, Direction::Backward].map(|direction| run(3, interval.into(), direction));
            let turning: Vec<_> = std::iter::once(forward[0]).chain((0..20).flat_map(|_| turning)).collect();
            for (motor, items) in (0..).zip([&forward[..], &turning, &forward]) {
                pair.push(motor, 1, items);
            }
            assert_eq!(pair.switch(1, from), Ok(()));
            // The first interval is behind it.
            pair.advance(from + 5 * u64::from(interval) / 2);
            let begun = pair.pico.now();
            for part in 0..40 {
                pair.pico.advance(begun + part * u64::from(interval) / 9, &mut |_: Edge| {});
                let mut pico = pair.pico.clone();
                let (stopped, _) = pico.stop_motors().expect("it stops");
                let wanted = if is_uncertain { 0b111 } else { 0 };
                assert_eq!(stopped.uncertain, wanted, "{interval} ticks apart, pull-in {pull_in}, part {part}");
            }
        }
    }
}
