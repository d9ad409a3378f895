//! An Arduino Due: SAM3X8E. It has limits to plan for, and no firmware.

use super::pins::AnyPins;
use super::profile::BoardProfile;
use pulsetrain_core::RegisterWidths;

const TICK_HZ: u64 = 42_000_000;

const MAX_MOTORS: usize = 8;

/// Steps a second of each of 1 to 8 motors. Klipper's published benchmark of the same chip: 1 273 k steps/s with one motor, 981 k in all with three.
const RATES_HZ: [u64; MAX_MOTORS] = [1_273_000, 490_000, 327_000, 245_000, 196_000, 163_000, 140_000, 122_000];

/// The shortest intervals that these rates allow.
const MIN_INTERVAL_TICKS: [u32; MAX_MOTORS] = {
    let mut ticks = [0; MAX_MOTORS];
    let mut index = 0;
    while index < ticks.len() {
        ticks[index] = TICK_HZ.div_ceil(RATES_HZ[index]) as u32;
        index += 1;
    }
    ticks
};

/// 64 KiB, in equal shares.
const QUEUE_BYTES: [u32; MAX_MOTORS] = {
    let mut bytes = [0; MAX_MOTORS];
    let mut index = 0;
    while index < bytes.len() {
        bytes[index] = 65_536 / (index as u32 + 1);
        index += 1;
    }
    bytes
};

/// The Due.
pub static DUE: BoardProfile = BoardProfile {
    name: "due",
    former_names: &[],
    about: "Arduino Due, SAM3X8E",
    note: "3.3 V outputs: drivers with 5 V inputs may need a level shifter",
    source: "estimate: rates of Klipper on the same chip, as published",
    tick_hz: TICK_HZ,
    registers: RegisterWidths::WIDE,
    max_motors: MAX_MOTORS,
    min_interval_ticks: &MIN_INTERVAL_TICKS,
    hardware_timed: false,
    one_timing: false,
    turn_ticks: 0,
    segment_ticks: &[],
    horizon_ticks: 42_000,
    lateness_ticks: 84,
    ram_bytes: Some(98_304),
    flash_bytes: Some(524_288),
    queue_bytes: &QUEUE_BYTES,
    line: None,
    pins: 0..=53,
    reserved: &[(0..=1, "D0 and D1 are the serial line to the computer")],
    analogue: Some((54, 0)),
    rules: &AnyPins,
};
