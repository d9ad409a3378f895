//! An Arduino Uno: ATmega328P.

mod measured;
mod pins;
mod timing;

pub use pins::{PinKind, Stray, UnoPinsError};

use super::profile::{BoardProfile, LineTiming};
use pulsetrain_core::boards::uno;

/// Bytes of all motors' queues.
const QUEUE_BYTES: u32 = uno::QUEUE_BYTES as u32;

/// The Uno.
pub static UNO: BoardProfile = BoardProfile {
    name: "uno",
    former_names: &["uno-stream"],
    about: "Arduino Uno, ATmega328P",
    note: "one or two motors with STEP on pins 9 and 10 are timed by the compare hardware: no lateness",
    source: "its firmware on an emulated ATmega328P: cargo xtask bench uno",
    tick_hz: uno::TICK_HZ as u64,
    registers: uno::REGISTERS,
    max_motors: uno::MAX_MOTORS,
    // With pulses of 1 µs. The rules have those of longer pulses.
    min_interval_ticks: &[
        measured::BY_SOFTWARE[0][0],
        measured::BY_SOFTWARE[1][0],
        measured::BY_SOFTWARE[2][0],
        measured::BY_SOFTWARE[3][0],
    ],
    hardware_timed: false,
    one_timing: true,
    turn_ticks: timing::TURN_TICKS[0],
    segment_ticks: &[],
    horizon_ticks: measured::HORIZON,
    lateness_ticks: measured::LATENESS,
    ram_bytes: Some(2_048),
    flash_bytes: Some(32_256),
    // One motor alone also has the memory of the second ring. A test asks the virtual board.
    queue_bytes: &[QUEUE_BYTES + uno::RING_BYTES as u32, QUEUE_BYTES / 2, QUEUE_BYTES / 3, QUEUE_BYTES / 4],
    // Fitted to motions that ran without these limits. At 1 000 000 baud: 1000 of `cargo xtask accept --board uno --seed 20`, and 1541 of sinusoids, in
    // phase and not, of one to four motors at 5 to 60 Hz. At 115 200 baud: 500 of seed 8, and four of seed 62 that starved with a shorter delay. The queue of
    // every motion that was stopped for lack of plan lasted less than this; so did the queues of three in a thousand random motions that ran.
    line: Some(LineTiming {
        delay_us: 700,
        delay_byte_us: 100,
        delay_bytes: 290,
        other_bytes_per_s: 2_300,
        frame_share: 1.33,
        usb_bytes_per_s: None,
    }),
    pins: 0..=19,
    reserved: &[(0..=1, "D0 and D1 are the serial line to the computer")],
    analogue: Some((14, 6)),
    rules: &timing::UnoPins,
};
