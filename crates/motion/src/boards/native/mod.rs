//! This computer, in virtual time.

use super::pins::AnyPins;
use super::profile::BoardProfile;
use pulsetrain_core::RegisterWidths;

/// The native board.
pub static NATIVE: BoardProfile = BoardProfile {
    name: "native",
    former_names: &[],
    about: "this computer, in virtual time: the same stepgen as the firmware's",
    note: "runs any motion without hardware; pins are names only",
    source: "by definition: a board in virtual time",
    tick_hz: 125_000_000,
    registers: RegisterWidths::WIDE,
    max_motors: 8,
    min_interval_ticks: &[50],
    hardware_timed: true,
    one_timing: false,
    turn_ticks: 0,
    segment_ticks: &[],
    horizon_ticks: 0,
    lateness_ticks: 0,
    ram_bytes: None,
    flash_bytes: None,
    queue_bytes: &[],
    line: None,
    pins: 0..=31,
    reserved: &[],
    analogue: None,
    rules: &AnyPins,
};
