//! From a millisecond of the path to the ticks of its steps: evenly spaced, anchored to the millisecond.
//!
//! In a slice, of one millisecond, the path has one speed. So its steps are evenly spaced, and the first comes distance / speed after
//! the slice's beginning. Rounding errors do not add up: each slice starts from the path's own position, at a tick that is a
//! multiple of a millisecond's ticks.
//!
//! - [`Slice::steps`]: to the nearest tick, for any clock; two quotients of 34 bits.
//! - [`Slice::train`]: within a tick, for an 8-bit chip with a clock of 16 MHz; one reciprocal of 16 bits.

use super::path::{FASTEST, STEP, Slice};
use crate::Direction;

// A slice is less than 2^34 in units of 2^-16 ticks, and the divisor is less than 2^30: `quotient` needs both.
const _: () = assert!((MAX_TICKS as u64) << 16 < 1 << 34 && (FASTEST as u64) << 16 < 1 << 30);

/// Ticks of a slice: 1 ms at 16 MHz.
pub const TICKS: u16 = 16_000;

/// How far a step's time may be from the exact one, ticks: reciprocal and distance are cut to 16 bits of a slice.
pub const TOLERANCE_TICKS: u8 = 1;

/// The longest slice for [`Slice::steps`], ticks: 1 ms at 131 MHz.
pub const MAX_TICKS: u32 = 1 << 17;

/// The steps of a slice, each exact to 2^-16 tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SliceSteps {
    /// How many: at least 1.
    pub count: u8,
    /// Which way.
    pub direction: Direction,
    /// When the first is due, 2^-16 ticks after the slice's beginning: at most a slice.
    pub first: u64,
    /// From each to the next, 2^-16 ticks; 0 if there is but one.
    pub interval: u64,
}

impl SliceSteps {
    /// The ticks, counted from the slice's beginning, each the nearest one; the last may be the next slice's first.
    pub fn ticks(self) -> impl Iterator<Item = u32> {
        let mut next = self.first + (1 << 15);
        (0..self.count).map(move |_| {
            let [_, _, b2, b3, b4, b5, _, _] = next.to_le_bytes();
            next += self.interval;
            u32::from_le_bytes([b2, b3, b4, b5])
        })
    }
}

/// The steps of a slice, as an 8-bit chip works them out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct Train {
    /// How many: at least 1.
    pub count: u8,
    /// Which way.
    pub backward: bool,
    /// When the first is due, 2^-16 ticks after the slice's beginning: at most [`TICKS`].
    pub first: u32,
    /// From each to the next, 2^-16 ticks; 0 if there is but one.
    pub interval: u32,
}

impl Slice {
    /// When its steps are due, in a millisecond of `ticks` ticks, at most [`MAX_TICKS`]; `None` without steps.
    ///
    /// ```
    /// use pulsetrain_core::winch::path::Slice;
    /// // 3000 steps/s, the first 250 millisteps away: after a twelfth of a millisecond, then one each third of it.
    /// let slice = Slice { count: 3, backward: false, distance: 250 << 16, speed: 3000 << 16 };
    /// let steps = slice.steps(125_000).unwrap();
    /// assert_eq!(steps.ticks().collect::<Vec<_>>(), [10_417, 52_083, 93_750]);
    /// ```
    #[must_use]
    pub fn steps(self, ticks: u32) -> Option<SliceSteps> {
        let Slice { count, backward, distance, speed } = self;
        if count == 0 || speed == 0 {
            return None;
        }
        let part = |millisteps: u32| quotient((u64::from(millisteps) * u64::from(ticks)) << 16, speed);
        let interval = if count > 1 { part(STEP.unsigned_abs()) } else { 0 };
        let direction = if backward { Direction::Backward } else { Direction::Forward };
        Some(SliceSteps { count, direction, first: part(distance), interval })
    }

    /// When its steps are due, within [`TOLERANCE_TICKS`] of the exact times; `None` without steps.
    ///
    /// Two steps, be they of two slices and in opposite directions, are never nearer than the fastest speed has them.
    ///
    /// ```
    /// use pulsetrain_core::winch::path::Slice;
    /// // 4000 steps/s, the first 250 millisteps away: after 1000 ticks, then one each 4000.
    /// let slice = Slice { count: 4, backward: false, distance: 250 << 16, speed: 4000 << 16 };
    /// let train = slice.train().unwrap();
    /// assert!((train.first >> 16).abs_diff(1000) <= 1 && (train.interval >> 16).abs_diff(4000) <= 1);
    /// ```
    #[must_use]
    pub fn train(self) -> Option<Train> {
        let Slice { count, backward, mut distance, mut speed } = self;
        if count == 0 || speed == 0 {
            return None;
        }
        // Speed and distance are cut to 16 significant bits. Below 256 steps/s there is one step at most, and `step` is not used.
        let mut step = 1000u16;
        while speed < 1 << 24 {
            speed <<= 8;
            distance <<= 8;
        }
        while speed < 1 << 31 {
            speed <<= 1;
            distance <<= 1;
            step <<= 1;
        }
        let inverse = reciprocal(upper(speed));
        let first = ticks(upper(distance), inverse);
        let interval = if count > 1 { ticks(step, inverse) } else { 0 };
        Some(Train { count, backward, first, interval })
    }
}

/// `dividend` / `divisor`, rounded down: less than 2^34. `divisor` is less than 2^30.
fn quotient(dividend: u64, divisor: u32) -> u64 {
    let (mut rest, mut quotient, mut bits) = (dividend, 0, 34u32);
    let divisor = u64::from(divisor);
    while bits > 0 {
        bits -= 1;
        let part = divisor << bits;
        quotient <<= 1;
        if rest >= part {
            rest -= part;
            quotient |= 1;
        }
    }
    quotient
}

/// The part of a slice that `distance` takes, 2^-16 ticks.
fn ticks(distance: u16, inverse: u16) -> u32 {
    // Speed ≥ distance, so that this is a fraction, of 32 bits after the doubling.
    let [b0, b1, b2, b3] = (multiply(distance, inverse) << 1).to_le_bytes();
    let below = upper(multiply(u16::from_le_bytes([b0, b1]), TICKS));
    multiply(u16::from_le_bytes([b2, b3]), TICKS) + u32::from(below)
}

/// 2^31 / `value`, rounded down; `value` ≥ 2^15, and for 2^15 itself it is 2^16 − 1.
fn reciprocal(value: u16) -> u16 {
    let (mut rest, mut quotient) = (0x8000u16, 0u16);
    let mut bits = 16u8;
    // 2^31 = 0x8000·2^16 and value ≥ 0x8000: the quotient has 16 bits, but for the smallest.
    if value == 0x8000 {
        return u16::MAX;
    }
    while bits > 0 {
        let carry = rest >= 0x8000;
        rest <<= 1;
        quotient <<= 1;
        if carry || rest >= value {
            rest = rest.wrapping_sub(value);
            quotient |= 1;
        }
        bits -= 1;
    }
    quotient
}

const fn multiply(a: u16, b: u16) -> u32 {
    (a as u32).wrapping_mul(b as u32)
}

const fn upper(value: u32) -> u16 {
    let [_, _, b2, b3] = value.to_le_bytes();
    u16::from_le_bytes([b2, b3])
}
