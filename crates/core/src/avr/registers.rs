//! The recurrence with 16 fraction bits in 21 bytes, in registers of the widths that an 8-bit processor uses. The Uno's
//! assembly does the same computation, and a test compares the two.

use crate::Tick32;

/// The registers of the current segment: a [`Recurrence`](crate::Recurrence) with 16 fraction bits, in fewer bytes.
///
/// On the AVR there is no padding: the offsets are 0, 2, 6, 10, 11, 15, 19, and 21 bytes in all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct Registers {
    /// The fraction of the last step's scheduled tick, 2^-16 ticks.
    pub fraction: u16,
    /// Scheduled tick of the last step, modulo 2^32.
    pub tick: u32,
    /// The lower 32 bits of the interval to the next step, 2^-16 ticks.
    pub interval_low: u32,
    /// The upper 8 bits of the interval.
    pub interval_high: u8,
    /// Change of the interval, 2^-16 ticks.
    pub add: i32,
    /// Change of that, 2^-16 ticks.
    pub add2: i32,
    /// Steps of the segment that are not made yet.
    pub left: u16,
}

impl Registers {
    /// At rest at tick 0.
    #[must_use]
    pub const fn new() -> Registers {
        Registers { fraction: 0, tick: 0, interval_low: 0, interval_high: 0, add: 0, add2: 0, left: 0 }
    }

    /// The scheduled tick of the next step.
    #[must_use]
    pub const fn next_tick(&self) -> Tick32 {
        let [low, high, ticks_low, ticks_mid] = self.interval_low.to_le_bytes();
        let (_, carry) = self.fraction.overflowing_add(u16::from_le_bytes([low, high]));
        let ticks = u32::from_le_bytes([ticks_low, ticks_mid, self.interval_high, 0]);
        Tick32(self.tick.wrapping_add(ticks).wrapping_add(carry as u32))
    }

    /// Moves on to the next step. The caller counts [`left`](Registers::left).
    pub const fn advance(&mut self) {
        let [low, high, ..] = self.interval_low.to_le_bytes();
        self.tick = self.next_tick().0;
        self.fraction = self.fraction.wrapping_add(u16::from_le_bytes([low, high]));
        // The interval has 40 bits, add 32: add's sign fills the upper byte.
        let (sum, carry) = self.interval_low.overflowing_add(self.add.cast_unsigned());
        let sign_byte = if self.add < 0 { 0xff } else { 0 };
        self.interval_low = sum;
        self.interval_high = self.interval_high.wrapping_add(sign_byte).wrapping_add(carry as u8);
        self.add = self.add.wrapping_add(self.add2);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Recurrence;
    use proptest::prelude::*;

    const MASK: u64 = (1 << 40) - 1;

    fn in_21_bytes(recurrence: &Recurrence, left: u16) -> Registers {
        let [f0, f1, t0, t1, t2, t3, ..] = recurrence.accumulator.to_le_bytes();
        let [i0, i1, i2, i3, interval_high, ..] = recurrence.interval.to_le_bytes();
        Registers {
            fraction: u16::from_le_bytes([f0, f1]),
            tick: u32::from_le_bytes([t0, t1, t2, t3]),
            interval_low: u32::from_le_bytes([i0, i1, i2, i3]),
            interval_high,
            add: i32::try_from(recurrence.add).unwrap(),
            add2: i32::try_from(recurrence.add2).unwrap(),
            left,
        }
    }

    proptest! {
        #[test]
        fn they_step_as_the_recurrence_does(
            accumulator: u64, interval in 0i64..1 << 40, add: i32, add2: i32, tame in 0u32..32, steps in 1u16..300,
        ) {
            let (add, add2) = (i64::from(add >> tame), i64::from(add2 >> tame >> tame.min(8)));
            let mut wide = Recurrence { accumulator, interval, add, add2 };
            let mut registers = in_21_bytes(&wide, steps);
            for _ in 0..steps {
                // The step itself must be one that fits; what is left after the last one need not be.
                prop_assume!((0..1 << 40).contains(&wide.interval) && i32::try_from(wide.add).is_ok());
                let next = wide.accumulator.wrapping_add_signed(wide.interval) >> 16;
                prop_assert_eq!(registers.next_tick(), Tick32::of(next));
                wide.advance();
                registers.advance();
                prop_assert_eq!(registers.tick, Tick32::of(wide.accumulator >> 16).0);
                prop_assert_eq!(u64::from(registers.fraction), wide.accumulator & 0xffff);
                let interval = u64::from(registers.interval_high) << 32 | u64::from(registers.interval_low);
                prop_assert_eq!(interval, wide.interval.cast_unsigned() & MASK);
                prop_assert_eq!(i64::from(registers.add).cast_unsigned() << 32, wide.add.cast_unsigned() << 32);
            }
        }
    }
}
