//! The Uno's USB bridge, an ATmega16U2, as far as time goes: frames of USB, and the rates that it can make.

use std::time::Duration;

/// Cycles per second; one tick of the firmware's clock is one cycle.
pub const CYCLES_PER_S: u64 = 16_000_000;

/// A frame of full-speed USB, 1 ms (USB 2.0, 8.4.3).
const USB_FRAME: u64 = CYCLES_PER_S / 1000;

/// The bridge has a 16 MHz clock too and divides it by 8 and a whole number (ATmega16U2, DS7799, 18.3.1).
const BRIDGE_DIVIDER: u64 = 8;

/// What is read at a wrong rate: something, but not what was sent.
pub(crate) const fn garbled(byte: u8) -> u8 {
    byte.rotate_left(3) ^ 0x5a
}

/// The cycle of the next frame of USB.
pub(crate) const fn next_frame(cycle: u64) -> u64 {
    (cycle / USB_FRAME + 1) * USB_FRAME
}

/// Cycles of a bit at what the bridge makes of a rate in bits a second, 1200 or more.
pub(crate) fn bit_cycles(rate: u32) -> u64 {
    let rate = u64::from(rate) * BRIDGE_DIVIDER;
    (CYCLES_PER_S + rate / 2) / rate.max(1) * BRIDGE_DIVIDER
}

pub(crate) fn duration(cycle: u64) -> Duration {
    // 62.5 ns each; 2^63 ns are 292 years.
    Duration::from_nanos((u128::from(cycle) * 125 / 2) as u64)
}

/// Rounded up.
pub(crate) fn cycles(time: Duration) -> u64 {
    u64::try_from((time.as_nanos() * 2).div_ceil(125)).unwrap_or(u64::MAX)
}
