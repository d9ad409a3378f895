//! A step counted is a pulse made, and the reverse: the firmware's counts at every instant, against its pins.

use pulsetrain_board::{Board, Lease, Leased, Setup};
use pulsetrain_core::wire::message::flags;
use pulsetrain_core::{Direction, Entry, Epoch, Item, Segment, Tick32};
use pulsetrain_testkit::lab::{Lab, said, uno};
use pulsetrain_testkit::{Random, TICK_HZ, uno_setup};

/// One of each kind: port B, port D, both, the compare hardware alone and twice, a shared DIR line.
const KINDS: [&[(u8, u8)]; 7] = [
    &[(8, 9)],
    &[(6, 7)],
    &[(9, 8)],
    &[(9, 8), (10, 7)],
    &[(8, 11), (9, 12), (10, 13)],
    &[(2, 5), (3, 6), (4, 7), (12, 13)],
    &[(9, 8), (10, 8), (11, 8), (12, 8)],
];

/// Ticks between the steps of each kind's motors.
const INTERVALS: [u64; 7] = [900, 900, 2500, 2500, 2500, 3500, 8000];

/// Begins a motion of motors that step `interval` ticks apart, each a little after the one before, forward and, where they
/// have a DIR line of their own, now and then backward.
fn begin(
    setup: &Setup,
    shift: u64,
    interval: u64,
    count: u32,
) -> (pulsetrain_testkit::lab::UnoWithReference, Lab, u64) {
    let mut board = uno(setup);
    let from = board.now() + board.round_trip() + TICK_HZ / 100 + shift;
    let shared = setup.motors.len() == 4 && setup.motors[0].dir_pin == setup.motors[1].dir_pin;
    for motor in 0..setup.motors.len() {
        let mut push = |item| board.push(motor, Entry { epoch: Epoch(1), item }).expect("room");
        push(Item::Anchor { tick: Tick32::of(from) });
        push(Item::Dwell { ticks: 1000 + 97 * motor as u32 });
        let segment = Segment { count, interval: (interval as i64) << 16, add: 0, add2: 0 };
        for turn in 0..3 {
            let direction = if turn == 1 && !shared { Direction::Backward } else { Direction::Forward };
            push(Item::Run { segment, direction });
        }
    }
    board.switch(Epoch(1), from, Lease::Last, &[]).expect("in time");
    (board, Lab::default(), from)
}

/// The immediate stop at each phase of a step, in mid-pulse too: the begin is shifted against the host's clock, by which
/// everything else happens.
fn stops(pins: &[(u8, u8)], pulse_ticks: u16, interval: u64, shift: u64) {
    let mut setup = uno_setup(pins, pulse_ticks);
    for motor in &mut setup.motors {
        motor.forward_high = false;
    }
    let (mut board, mut lab, from) = begin(&setup, shift, interval, 20);
    let stop_at = from - shift + 1000 + 27 * interval;
    let report = board.stop_now(stop_at, &mut lab);
    board.advance(report.tick + TICK_HZ / 50, &mut lab);
    let what = format!("{pins:?}, {pulse_ticks} ticks, shift {shift}");
    println!("{what}: {report:?} {:?}", board.board_mut().events());
    assert_eq!(report.positions, lab.counts(&setup), "{what}");
    assert!(lab.edges.len() > 50, "{what}: nothing moved: {report:?}, asked {stop_at}, {:?}", lab.edges.last());
    // What the pins show after the stop is at most the end of a pulse.
    let after = |edge: &&pulsetrain_board::Edge| edge.tick > report.tick + u64::from(pulse_ticks) + TICK_HZ / 2000;
    assert_eq!(lab.edges.iter().find(after), None, "{what}");
    let status = board.board_mut().status().expect("it answers");
    assert_eq!(said(&mut board), report.positions, "{what}: what it says later");
    assert_eq!(status.head.flags & flags::ARMED, 0, "{what}: still armed");
}

/// All shifts of a step in steps of a few ticks, on one kind of pins.
fn stops_at_every_phase(kind: usize) {
    let interval = INTERVALS[kind];
    for (pulse_ticks, apart) in [(16, 31), (160, 49)] {
        for shift in (0..interval).step_by(apart) {
            stops(KINDS[kind], pulse_ticks, interval, shift);
        }
    }
}

#[test]
fn stops_on_port_b() {
    stops_at_every_phase(0);
}

#[test]
fn stops_on_port_d() {
    stops_at_every_phase(1);
}

#[test]
fn stops_of_the_compare_hardware() {
    stops_at_every_phase(2);
    stops_at_every_phase(3);
}

#[test]
fn stops_of_three_motors_in_one_ring() {
    stops_at_every_phase(4);
}

#[test]
fn stops_of_the_shield() {
    stops_at_every_phase(5);
}

#[test]
fn stops_with_a_shared_dir_line() {
    stops_at_every_phase(6);
}

/// What the status says while motors move is what the pins had shown at some instant since it was asked.
fn counts(kind: usize) {
    let setup = uno_setup(KINDS[kind], 16);
    let interval = INTERVALS[kind];
    let (mut board, mut lab, from) = begin(&setup, 0, interval, 400);
    let random = &mut Random::new(kind as u64);
    let mut answers = Vec::new();
    while board.now() < from + 1200 * interval {
        let until = board.now() + random.below(TICK_HZ / 500);
        board.advance(until, &mut lab);
        let status = board.board_mut().status().expect("it answers");
        answers.push((status.head.tick, status.motors));
    }
    board.advance(from + 1250 * interval, &mut lab);
    let mut counted = 0;
    for (tick, motors) in &answers {
        for (index, motor) in motors.as_slice().iter().enumerate() {
            let shown = lab.counts_between(&setup, index, *tick, tick + LOOK_TICKS);
            assert!(
                shown.contains(&i64::from(motor.position)),
                "{:?}, motor {index}: {} at {tick}, pins {shown:?}",
                KINDS[kind],
                motor.position
            );
            counted += 1;
        }
    }
    assert!(counted > 10, "{counted} counts");
    assert!(answers.iter().any(|(_, motors)| motors.as_slice().iter().any(|motor| motor.position != 0)));
}

/// The board reads its clock for a status so long before it has read the last count, ticks, at most.
const LOOK_TICKS: u64 = 64_000;

#[test]
fn counts_of_one_motor() {
    counts(0);
    counts(1);
}

#[test]
fn counts_of_the_compare_hardware() {
    counts(2);
    counts(3);
}

#[test]
fn counts_of_several_motors() {
    counts(4);
    counts(5);
    counts(6);
}
