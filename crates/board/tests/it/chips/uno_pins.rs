//! What the firmware's pins do besides steps: at rest, armed, released; levels; the drivers' enable line.

use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Lease, Leased, Remote, RemoteError, Setup};
use pulsetrain_core::wire::Reason;
use pulsetrain_core::{Entry, Epoch, Item, Tick32};
use pulsetrain_emulator::{Level, Port};
use pulsetrain_testkit::lab::{Lab, uno};
use pulsetrain_testkit::{TICK_HZ, run, uno_setup};

/// Port and bit of a pin by its Arduino number.
fn place(pin: u8) -> (Port, u8) {
    match pin {
        0..=7 => (Port::D, pin),
        8..=13 => (Port::B, pin - 8),
        _ => (Port::C, pin - 14),
    }
}

fn is_output(uno: &VirtualUno, pin: u8) -> bool {
    let (port, bit) = place(pin);
    uno.chip().is_output(port, bit)
}

fn level(uno: &VirtualUno, pin: u8) -> bool {
    let (port, bit) = place(pin);
    uno.chip().pin(port, bit) == Level::High
}

const KINDS: [&[(u8, u8)]; 7] = [
    &[(8, 9)],
    &[(6, 7)],
    &[(9, 8)],
    &[(9, 8), (10, 7)],
    &[(8, 11), (9, 12), (10, 13)],
    &[(2, 5), (3, 6), (4, 7), (12, 13)],
    &[(9, 8), (10, 8), (11, 8), (12, 8)],
];

/// Before a configuration no pin but the serial line's is an output; after it those that it names are, at rest; and those
/// that the next one does not name are none any more.
#[test]
fn pins_are_outputs_when_a_configuration_names_them() {
    for step_low in [false, true] {
        let mut board = Remote::open(VirtualUno::new(), 1).expect("it answers");
        assert!((2..20).all(|pin| !is_output(board.port(), pin)));
        for pins in KINDS {
            let mut setup = uno_setup(pins, 16);
            setup.motors.iter_mut().for_each(|motor| motor.step_low = step_low);
            if step_low && pins.contains(&(10, 7)) {
                // Low pulses are made by software, which needs one port.
                assert!(board.configure(&setup).is_err());
                continue;
            }
            board.configure(&setup).expect("it takes it");
            for pin in 2..20 {
                let named = pins.iter().any(|(step, dir)| *step == pin || *dir == pin);
                assert_eq!(is_output(board.port(), pin), named, "{pins:?}, pin {pin}");
            }
            for (step, dir) in pins {
                assert_eq!((level(board.port(), *step), level(board.port(), *dir)), (step_low, false), "{pins:?}");
            }
        }
    }
}

/// A configuration that no stepgen serves is refused, with the pin, and nothing changes.
#[test]
fn pins_that_do_not_go_together_are_refused() {
    let mut board = Remote::open(VirtualUno::new(), 1).expect("it answers");
    let mut check = |pins: &[(u8, u8)], enable: Option<(u8, bool)>, expected: (Reason, u16)| {
        let setup = Setup { enable, ..uno_setup(pins, 16) };
        let Err(RemoteError::Refused { reason, detail, .. }) = board.configure(&setup) else { panic!("{pins:?}") };
        assert_eq!((reason, detail), expected, "{pins:?}");
        assert!((2..20).all(|pin| !is_output(board.port(), pin)), "{pins:?}");
    };
    check(&[(1, 9)], None, (Reason::Pin, 1));
    check(&[(8, 14)], None, (Reason::Pin, 14));
    check(&[(8, 8)], None, (Reason::PinTaken, 8));
    check(&[(2, 5), (3, 2)], None, (Reason::PinTaken, 2));
    check(&[(2, 5), (8, 6)], None, (Reason::PinMix, 8));
    check(&[(8, 9)], Some((9, true)), (Reason::PinTaken, 9));
    check(&[(8, 9)], Some((20, true)), (Reason::Pin, 20));
}

/// Enable is inactive until the motors are armed, active while they move and so long after, and active again, before the
/// first step, when they are to move again.
#[test]
fn enable_follows_the_motors() {
    for (enable_high, pin) in [(false, 8), (true, 12), (true, 17)] {
        let setup = Setup { enable: Some((pin, enable_high)), idle_ms: Some(100), ..uno_setup(&[(2, 5), (3, 6)], 16) };
        let mut board = Remote::open(VirtualUno::new(), 1).expect("it answers");
        board.configure(&setup).expect("it takes it");
        // Armed, and nothing to do: held, then released.
        assert_eq!(level(board.port(), pin), enable_high, "armed");
        board.advance(board.now() + TICK_HZ / 5, &mut |_: Edge| {});
        assert_eq!(level(board.port(), pin), !enable_high, "idle for 0.2 s");
        let mut edges = Vec::new();
        for epoch in 1..=2 {
            let from = board.now() + board.round_trip() + TICK_HZ / 10;
            for item in [Item::Anchor { tick: Tick32::of(from) }, run(100, 16_000)] {
                board.push(0, Entry { epoch: Epoch(epoch), item }).expect("room");
            }
            board.push(1, Entry { epoch: Epoch(epoch), item: Item::Anchor { tick: Tick32::of(from) } }).expect("room");
            board.switch(Epoch(epoch), from, Lease::Last, &[]).expect("in time");
            edges.clear();
            board.advance(from + 100 * 16_000 + TICK_HZ / 2, &mut |edge: Edge| edges.push(edge));
            let active: Vec<_> = edges.iter().filter(|edge| edge.line == pin).collect();
            let [on, off] = active[..] else { panic!("{active:?}") };
            assert_eq!((on.level, off.level), (enable_high, !enable_high));
            let steps: Vec<u64> = edges.iter().filter(|edge| edge.line == 2).map(|edge| edge.tick).collect();
            let (first, last) = (steps[0], steps[steps.len() - 1]);
            assert_eq!(steps.len(), 200);
            assert!(on.tick < first, "enabled {} ticks after the first step", on.tick - first);
            let held = (off.tick - last) as f64 * 1000.0 / TICK_HZ as f64;
            assert!((98.0..106.0).contains(&held), "released after {held} ms");
        }
        // Without a time it holds.
        board.configure(&Setup { idle_ms: None, ..setup }).expect("it takes it");
        board.advance(board.now() + TICK_HZ, &mut |_: Edge| {});
        assert_eq!(level(board.port(), pin), enable_high, "held");
        board.release().expect("it rests");
        assert_eq!(level(board.port(), pin), !enable_high, "released");
    }
}

/// Beyond what was asked, ticks: 10 µs.
const MOST_EXTRA_TICKS: u64 = 160;

/// Pulses last what was asked, and little more: not the 10 µs of another driver.
#[test]
fn pulses_are_as_long_as_asked() {
    for pins in KINDS {
        for asked in [16, 31, 48, 80, 160, 480] {
            let setup = uno_setup(pins, asked);
            let mut board = uno(&setup);
            let mut lab = Lab::default();
            let from = board.now() + board.round_trip() + TICK_HZ / 100;
            for motor in 0..pins.len() {
                for item in [Item::Anchor { tick: Tick32::of(from + 3000 * motor as u64) }, run(20, 16_000)] {
                    board.push(motor, Entry { epoch: Epoch(1), item }).expect("room");
                }
            }
            board.switch(Epoch(1), from, Lease::Last, &[]).expect("in time");
            board.advance(from + 22 * 16_000, &mut lab);
            assert_eq!(lab.counts(&setup), vec![20; pins.len()], "{pins:?}, {asked}");
            for (step, _) in pins {
                let edges: Vec<_> = lab.edges.iter().filter(|edge| edge.line == *step).collect();
                let widths = edges.chunks(2).map(|pair| pair[1].tick - pair[0].tick);
                let (least, longest) = widths.fold((u64::MAX, 0), |(l, g), width| (width.min(l), width.max(g)));
                assert!(
                    least >= u64::from(asked) && longest <= u64::from(asked) + MOST_EXTRA_TICKS,
                    "{pins:?}, {asked}: {least} to {longest} ticks"
                );
            }
        }
    }
}
