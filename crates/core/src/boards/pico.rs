//! A Raspberry Pi Pico's firmware. Ticks are cycles of 125 MHz.

use crate::RegisterWidths;

/// The board's number in Info.
pub const NUMBER: u8 = 2;
/// Ticks per second; one tick is one cycle of processor, PIO and DMA.
pub const TICK_HZ: u32 = 125_000_000;
/// The registers of its recurrence.
pub const REGISTERS: RegisterWidths = RegisterWidths::WIDE;
/// Motors at most: one for each state machine.
pub const MAX_MOTORS: usize = 8;

/// Bytes of all motors' queues together: what is left of the RAM, and a multiple of [`QUEUE_PARTS`](crate::wire::message::QUEUE_PARTS).
pub const QUEUE_BYTES: usize = 32_768;
/// Bytes of one motor's queue at most: a quarter of all.
pub const MAX_QUEUE_BYTES: usize = 8192;

/// The look-ahead of plans and paths, ticks: 2.4 ms. Words are written so far ahead, and a switch can be no sooner.
pub const LOOK_AHEAD: u32 = 300_000;
const _: () = assert!(LOOK_AHEAD as u64 * 10_000 == TICK_HZ as u64 * 24);
/// The longest pulse and set-up, ticks: 0.5 ms.
pub const MAX_PULSE: u16 = 62_500;

/// Where text and verbs have the axes x, y, z and a, GPIOs of STEP. DIR is the next pin; high is forward.
pub const AXIS_STEP_PINS: [u8; 4] = [2, 4, 6, 8];
/// GPIO of the axes' common enable line; low is on.
pub const AXIS_ENABLE_PIN: u8 = 22;
/// Pulses of the axes: 2 µs; and DIR 5 µs before them, ticks.
pub const AXIS_PULSE_TICKS: u16 = 250;
/// DIR changes so long before a pulse, ticks.
pub const AXIS_SETUP_TICKS: u16 = 625;
