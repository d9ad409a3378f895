//! What the tests of boards and links share, and the benches of the Uno.
#![allow(dead_code, reason = "each test and bench uses some of it")]

pub(crate) mod delays;
pub(crate) mod examples;
pub(crate) mod lab;
pub(crate) mod mailbox;
pub(crate) mod pico;
pub(crate) mod random;
pub(crate) mod seed;
pub(crate) mod segments;
pub(crate) mod winch;

pub(crate) use random::Random;

use pulsetrain_board::{Board, Config, Edge, MotorConfig, Setup, Wiring};
use pulsetrain_core::wire::message::MotorSetup;
use pulsetrain_core::{Direction, Entry, Epoch, Item, Moment, Segment};

/// Ticks per second of an Uno, and of the model board.
pub(crate) const TICK_HZ: u64 = 16_000_000;

/// STEP of motor m is line m, DIR line 16 + m: a model has lines, no pins.
pub(crate) fn model_setup(motors: u8) -> Setup {
    let motor = |index| MotorSetup {
        step_pin: index,
        dir_pin: 16 + index,
        forward_high: true,
        pull_in_ticks: 160_000,
        ..MotorSetup::default()
    };
    Setup { pulse_ticks: 16, setup_ticks: 8, motors: (0..motors).map(motor).collect(), ..Setup::default() }
}

/// An Uno's motors on `pins` (STEP, DIR), forward high, that may start and stop at 1000 steps/s.
pub(crate) fn uno_setup(pins: &[(u8, u8)], pulse_ticks: u16) -> Setup {
    let motor = |&(step_pin, dir_pin)| MotorSetup {
        step_pin,
        dir_pin,
        forward_high: true,
        pull_in_ticks: 16_000,
        ..MotorSetup::default()
    };
    Setup {
        pulse_ticks,
        setup_ticks: SETUP_TICKS,
        hold_ticks: HOLD_TICKS,
        motors: pins.iter().map(motor).collect(),
        ..Setup::default()
    }
}

/// DIR before a step, and after the end of its pulse: 1 µs each, what most drivers ask for at most.
pub(crate) const SETUP_TICKS: u16 = 16;
/// As [`SETUP_TICKS`].
pub(crate) const HOLD_TICKS: u16 = 16;

/// The native board of the same motors; its lines are the Uno's pins.
pub(crate) fn native_config(setup: &Setup) -> Config {
    let motor = |motor: &MotorSetup| MotorConfig {
        wiring: Wiring::StepDir {
            step: motor.step_pin,
            dir: motor.dir_pin,
            forward_high: motor.forward_high,
            pulse_ticks: u32::from(setup.pulse_ticks).max(1),
            setup_ticks: u32::from(setup.setup_ticks),
        },
        pull_in_ticks: u64::from(motor.pull_in_ticks),
    };
    Config { fraction_bits: 16, motors: setup.motors.iter().map(motor).collect() }
}

/// So many steps forward, `interval` ticks apart.
pub(crate) fn run(count: u32, interval: i64) -> Item {
    let segment = Segment { count, interval: interval << 16, add: 0, add2: 0 };
    Item::Run { segment, direction: Direction::Forward }
}

/// Items of an epoch that begins at a tick, for motor 0.
pub(crate) fn tell(board: &mut impl Board, epoch: u8, from: u64, items: &[Item]) {
    let anchor = Item::Anchor { tick: Moment::of(from) };
    for item in [anchor].iter().chain(items) {
        board.push(0, Entry { epoch: Epoch(epoch), item: *item }).expect("room");
    }
}

/// Nobody looks.
pub(crate) fn unseen(_: Edge) {}
