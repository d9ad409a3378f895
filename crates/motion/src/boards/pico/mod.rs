//! A Raspberry Pi Pico: RP2040.

mod measured;
mod pins;

use super::profile::{BoardProfile, LineTiming, SegmentTicks};
use pulsetrain_core::boards::pico;
use pulsetrain_core::pio::STEP_DIR_OVERHEAD;

/// A motor's queue is an equal share, up to a limit: with one motor up to eight.
const QUEUE_BYTES: [u32; pico::MAX_MOTORS] = {
    let mut bytes = [0; pico::MAX_MOTORS];
    let mut index = 0;
    while index < bytes.len() {
        let share = pico::QUEUE_BYTES / (index + 1);
        bytes[index] = if share < pico::MAX_QUEUE_BYTES { share as u32 } else { pico::MAX_QUEUE_BYTES as u32 };
        index += 1;
    }
    bytes
};

/// What segments take the processor.
const SEGMENT_TICKS: [SegmentTicks; pico::MAX_MOTORS] = {
    let mut ticks = [SegmentTicks { onward: 0, turning: 0, heard: 0 }; pico::MAX_MOTORS];
    let mut index = 0;
    while index < ticks.len() {
        ticks[index] = SegmentTicks {
            onward: measured::ONWARD[index],
            turning: measured::TURNING[index],
            heard: measured::HEARD[index],
        };
        index += 1;
    }
    ticks
};

/// The Pico.
pub static PICO: BoardProfile = BoardProfile {
    name: "pico",
    former_names: &[],
    about: "Raspberry Pi Pico, RP2040",
    note: "edges come from PIO state machines fed by DMA: exact to the tick. STEP and DIR of a motor are neighbours, and so \
           are IN1 to IN4 of a ULN2003 (GP26 is next to GP22); 3.3 V outputs",
    source: "its firmware on an emulated RP2040: cargo xtask bench pico",
    tick_hz: pico::TICK_HZ as u64,
    registers: pico::REGISTERS,
    max_motors: pico::MAX_MOTORS,
    // The processor's limits. The rules add that of the pulse and three ticks.
    min_interval_ticks: &measured::SHORTEST,
    hardware_timed: true,
    one_timing: true,
    turn_ticks: 0,
    segment_ticks: &SEGMENT_TICKS,
    // The look-ahead; with the longest pulses and set-up, by which a word and a DIR edge begin before their tick, 0.5 ms more for each.
    // A test asks the virtual board.
    horizon_ticks: pico::LOOK_AHEAD + 2 * (pico::MAX_PULSE as u32 + STEP_DIR_OVERHEAD),
    lateness_ticks: 0,
    ram_bytes: Some(264 * 1024),
    flash_bytes: Some(2 * 1024 * 1024),
    queue_bytes: &QUEUE_BYTES,
    // A guess: no random motion was short of plan on a Pico. The processor's limit comes first.
    line: Some(LineTiming {
        delay_us: 15_000,
        delay_byte_us: 0,
        delay_bytes: 130,
        other_bytes_per_s: 1_500,
        frame_share: 1.2,
        // Measured on the virtual Pico's USB: 207 kB/s of plans, of one motor that turns 6000 times a second. USB at full speed takes up to
        // 19 packets of 64 bytes in a millisecond (USB 2.0, table 5-9), but a session has at most 960 bytes on their way.
        usb_bytes_per_s: Some(250_000),
    }),
    pins: 0..=28,
    reserved: &[
        (0..=1, "GPIO 0 and 1 are the serial line"),
        (23..=25, "GPIO 23 to 25 run the Pico's own supply and LED and are not on its header"),
    ],
    analogue: None,
    rules: &pins::PicoPins,
};
