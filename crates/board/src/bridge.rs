//! The timing of the Uno's USB bridge, an ATmega16U2: its USB frames, and the baud rates that it can make.

use std::time::Duration;

/// Cycles per second of the Uno's chip; one tick of the firmware's clock is one cycle.
pub const CYCLES_PER_S: u64 = 16_000_000;

/// Cycles in a frame of full-speed USB, 1 ms (USB 2.0, 8.4.3): data cross USB once in each.
const USB_FRAME: u64 = CYCLES_PER_S / 1000;

/// The bridge has a 16 MHz clock too and divides it by 8 and a whole number (ATmega16U2, DS7799, 18.3.1).
const BRIDGE_DIVIDER: u64 = 8;

/// What is received of a byte that was sent at another rate: any wrong byte will do.
pub(crate) const fn garbled(byte: u8) -> u8 {
    byte.rotate_left(3) ^ 0x5a
}

/// The cycle at which the next USB frame after `cycle` begins.
pub(crate) const fn next_frame(cycle: u64) -> u64 {
    (cycle / USB_FRAME + 1) * USB_FRAME
}

/// Cycles of a bit at the rate that the bridge makes when it is set to `rate`, bits a second (1200 or more).
pub(crate) fn bit_cycles(rate: u32) -> u64 {
    let rate = u64::from(rate) * BRIDGE_DIVIDER;
    (CYCLES_PER_S + rate / 2) / rate.max(1) * BRIDGE_DIVIDER
}

/// Cycles as a time, rounded down to nanoseconds.
pub(crate) fn duration(cycle: u64) -> Duration {
    // 62.5 ns each; 2^63 ns are 292 years.
    Duration::from_nanos((u128::from(cycle) * 125 / 2) as u64)
}

/// A time in cycles, rounded up.
pub(crate) fn cycles(time: Duration) -> u64 {
    u64::try_from((time.as_nanos() * 2).div_ceil(125)).unwrap_or(u64::MAX)
}
