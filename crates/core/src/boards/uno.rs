//! An Arduino Uno's firmware. Ticks are cycles of 16 MHz.

use crate::RegisterWidths;

/// The board's number in Info.
pub const NUMBER: u8 = 1;
/// Ticks per second; one tick is one processor cycle.
pub const TICK_HZ: u32 = 16_000_000;
/// The registers of its recurrence.
pub const REGISTERS: RegisterWidths = RegisterWidths::NARROW;
/// Motors, at most.
pub const MAX_MOTORS: usize = 4;
/// Bytes of all motors' queues.
pub const QUEUE_BYTES: usize = 376;
/// Bytes that a motor's queue has in addition if no other motor needs the second ring's memory.
pub const RING_BYTES: usize = 256;

/// STEP pins whose edges the compare hardware makes, bit by pin.
pub const COMPARE_STEP_PINS: u16 = 0x0600;
/// STEP and DIR pins of one port, PORTD, bit by pin.
pub const PORT_D_PINS: u16 = 0x00fc;
/// The same of PORTB.
pub const PORT_B_PINS: u16 = 0x3f00;
/// STEP and DIR of the only motor that may be on PORTB when others are on PORTD: the fourth of a CNC shield. They belong together.
pub const SHIELD_MOTOR: (u8, u8) = (12, 13);

/// Latency of an edge that an interrupt makes, at most, ticks.
pub const LATENCY: u8 = 24;
/// The same where the merge moves it too, or another ring's interrupt may come first.
pub const LATENCY_MERGED: u8 = 60;
/// Ticks between two groups, at least: from a match until the interrupt has set the next, and the longest time that it can be
/// kept waiting; and the length of the interrupt + 4, so that delays die out.
pub const SPACING: u8 = 48;
/// The shield's: with the short pulse, and with pulses of 1.9 µs.
pub const SPACING_SHIELD: [u8; 2] = [60, 76];
/// With the compare hardware, or with two rings on PORTD, where the other's interrupt may come first.
pub const SPACING_TWO_RINGS: u8 = 96;
/// With two motors of the compare hardware. The interrupt switches toggling on and off after a match, and must have done so before the next match,
/// or the pin has the wrong level from then on. Until then there may come: two stretches with interrupts off (engine/mod.rs), the other ring's longer
/// path and the instruction after it, and the way to the register.
pub const SPACING_TWO_COMPARE: u8 = 171;
/// From a group's tick to its second write, ticks, when no interrupt was kept waiting.
pub const END_DELAY: u8 = 16;
/// Edge tick − scheduled tick of a STEP edge that is not delayed, ticks: by the compare hardware.
pub const EDGE_DELAY_COMPARE: u32 = 1;
/// On PORTD.
pub const EDGE_DELAY_PORT_D: u32 = 17;
/// On PORTB.
pub const EDGE_DELAY_PORT_B: u32 = 19;
/// On the shield's pins.
pub const EDGE_DELAY_SHIELD: u32 = 17;
/// The longest pulse that one interrupt begins and ends, ticks. A longer one is ended by a group of its own.
pub const MAX_SHORT_PULSE: u16 = 31;
