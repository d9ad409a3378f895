//! What the tests and benches of several crates share: boards to test with, faults, random plans and checks. No released program contains it.
//!
//! # What is here, top down
//! - [`lab`], [`pico`]: the virtual Uno and the virtual Pico, each next to a native board that gets the same items, to compare their edges
//! - [`winch`]: a virtual board that gets StepperWinch's text, next to core's paths
//! - [`model`]: a board behind a serial line without an emulated chip, for tests of the link; [`faulty`]: a line that loses and damages frames
//! - [`segments`]: random segments at a given step rate; [`limits`]: whether steps keep to a motor's limits
//! - [`delays`], [`examples`], [`mailbox`], [`held`]: tests of the Pico's verbs and of its library
//! - [`Random`]: the one source of random numbers; [`seed`]: seeds and lengths of random tests; [`folder`]: a temporary folder
//! - setups of motors, and a few items
//!
//! # What is not
//! Expected results. Each test states its own; exact step times are `pulsetrain-oracle`'s.
//!
//! # Example
//! Every random test takes its numbers from a seed that it prints, so that a failure can be repeated:
//! ```
//! use pulsetrain_testkit::{Random, seed};
//!
//! // 7, unless the environment variable PULSETRAIN_SEED has another number.
//! let seed = seed::seed(7);
//! let (mut random, mut repeated) = (Random::new(seed), Random::new(seed));
//! let interval = random.between(100, 200);
//! assert!((100..200).contains(&interval));
//! assert_eq!(repeated.between(100, 200), interval);
//! ```
#![allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit")]
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

/// A setup for the model board. STEP of motor m is line m, and DIR is line 16 + m, as a model has lines instead of pins. Pull-in is 100 steps/s.
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

/// A setup for an Uno with motors on `pins` (STEP, DIR), forward high, with a pull-in rate of 1000 steps/s.
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

/// DIR setup before a step, ticks: 1 µs, which is enough for most drivers.
pub const SETUP_TICKS: u16 = 16;
/// DIR hold after the end of a pulse, ticks: 1 µs, which is enough for most drivers.
pub const HOLD_TICKS: u16 = 16;

/// The configuration of a native board with the motors of a setup. Its lines have the numbers of the Uno's pins.
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

/// `count` steps forward, `interval` ticks apart, for a board with 16 fraction bits.
pub fn run(count: u32, interval: i64) -> Item {
    let segment = Segment { count, interval: interval << 16, add: 0, add2: 0 };
    Item::Run { segment, direction: Direction::Forward }
}

/// Pushes the items of an epoch that begins at tick `from`, for motor 0.
pub fn tell(board: &mut impl Board, epoch: u8, from: u64, items: &[Item]) {
    let anchor = Item::Anchor { tick: Tick32::of(from) };
    for item in [anchor].iter().chain(items) {
        board.push(0, Entry { epoch: Epoch(epoch), item: *item }).expect("room");
    }
}

/// An observer that ignores everything.
pub fn unseen(_: Edge) {}
