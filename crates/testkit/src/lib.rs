//! What the tests and benches of several crates share. No program of users has it.
//!
//! # What is here
//! - [`Random`]: the one source of random numbers; [`seed`]: seeds and lengths of random tests
//! - [`model`]: a board behind a serial line, without a chip; [`faulty`]: a line whose frames suffer
//! - [`lab`], [`pico`]: the virtual Uno and Pico beside a native board that is told the same
//! - [`segments`]: random segments near a rate; [`winch`]: paths by text
//! - [`delays`], [`examples`], [`mailbox`], [`held`]: what the Pico's library and verbs are tested with
//! - [`folder`]: a temporary folder
//! - [`limits`]: whether steps keep to a motor's limits
//! - setups of motors, and a few items
#![allow(clippy::missing_panics_doc, clippy::unwrap_used, reason = "a test is to fail there")]
#![allow(
    clippy::should_implement_trait,
    clippy::new_without_default,
    reason = "none is an iterator; a board starts by `new`"
)]
#![allow(missing_docs, reason = "fields of tables of tests")]

pub mod delays;
pub mod examples;
pub mod faulty;
pub mod folder;
pub mod held;
pub mod lab;
pub mod limits;
pub mod mailbox;
pub mod model;
pub mod pico;
mod random;
pub mod seed;
pub mod segments;
pub mod winch;

pub use random::Random;

use pulsetrain_board::{Board, Config, Edge, MotorConfig, Setup, Wiring};
use pulsetrain_core::wire::message::MotorSetup;
use pulsetrain_core::{Direction, Entry, Epoch, Item, Segment, Tick32};

/// Ticks per second of an Uno, and of the model board.
pub const TICK_HZ: u64 = 16_000_000;

/// STEP of motor m is line m, DIR line 16 + m: a model has lines, no pins.
pub fn model_setup(motors: u8) -> Setup {
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
pub fn uno_setup(pins: &[(u8, u8)], pulse_ticks: u16) -> Setup {
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
pub const SETUP_TICKS: u16 = 16;
/// As [`SETUP_TICKS`].
pub const HOLD_TICKS: u16 = 16;

/// The native board of the same motors; its lines are the Uno's pins.
pub fn native_config(setup: &Setup) -> Config {
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
pub fn run(count: u32, interval: i64) -> Item {
    let segment = Segment { count, interval: interval << 16, add: 0, add2: 0 };
    Item::Run { segment, direction: Direction::Forward }
}

/// Items of an epoch that begins at a tick, for motor 0.
pub fn tell(board: &mut impl Board, epoch: u8, from: u64, items: &[Item]) {
    let anchor = Item::Anchor { tick: Tick32::of(from) };
    for item in [anchor].iter().chain(items) {
        board.push(0, Entry { epoch: Epoch(epoch), item: *item }).expect("room");
    }
}

/// Nobody looks.
pub fn unseen(_: Edge) {}
