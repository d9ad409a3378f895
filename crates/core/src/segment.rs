//! The segment: steps whose ticks follow one integer recurrence, and the recurrence itself.
//!
//! All quantities are fixed-point ticks with the board's F fraction bits (Uno 16, Pico 32).
//! Nothing is ever rounded: step k of a segment has the tick ⌊acc + k·I + C(k,2)·a + C(k,3)·b⌋.

/// Which way a step counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Direction {
    /// The position counts up.
    Forward,
    /// The position counts down.
    Backward,
}

impl Direction {
    /// +1 or −1.
    #[must_use]
    pub const fn sign(self) -> i32 {
        match self {
            Direction::Forward => 1,
            Direction::Backward => -1,
        }
    }

    /// The other way.
    #[must_use]
    pub const fn reversed(self) -> Direction {
        match self {
            Direction::Forward => Direction::Backward,
            Direction::Backward => Direction::Forward,
        }
    }
}

/// `count` steps; the first comes `interval` after the step (or dwell) before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Segment {
    /// Number of steps, at least 1.
    pub count: u32,
    /// Interval before the first step, ticks · 2^F; positive.
    pub interval: i64,
    /// Added to the interval after each step, ticks · 2^F.
    pub add: i64,
    /// Added to `add` after each step, ticks · 2^F.
    pub add2: i64,
}

impl Segment {
    /// One step after `interval` (ticks · 2^F).
    #[must_use]
    pub const fn single(interval: i64) -> Segment {
        Segment { count: 1, interval, add: 0, add2: 0 }
    }

    /// How far the accumulator moves over the first `k` steps, ticks · 2^F, exact.
    ///
    /// `k` ≤ 2^32; the result of any segment that a planner certifies fits.
    #[must_use]
    pub const fn span(&self, k: u32) -> i128 {
        let k = k as i128;
        let pairs = k * (k - 1) / 2;
        // C(k,3) = C(k,2)·(k−2)/3, and the product of three consecutive numbers divides by 3.
        let triples = pairs * (k - 2) / 3;
        k * self.interval as i128 + pairs * self.add as i128 + triples * self.add2 as i128
    }

    /// The segment without its first `k` steps (`k` ≤ `count`); its steps keep their ticks.
    ///
    /// With `k` = `count` the registers as they stand after the last step; they wrap like a board's.
    #[must_use]
    pub const fn after(&self, k: u32) -> Segment {
        Segment {
            count: self.count - k,
            interval: self.interval.wrapping_add(times(self.add, k)).wrapping_add(times_pairs(self.add2, k)),
            add: self.add.wrapping_add(times(self.add2, k)),
            add2: self.add2,
        }
    }

    /// The first `k` steps (1 ≤ `k` ≤ `count`).
    ///
    /// ```
    /// use pulsetrain_core::Segment;
    /// let segment = Segment { count: 40, interval: 100 << 16, add: 5, add2: 1 };
    /// assert_eq!(segment.truncated(3), Segment { count: 3, interval: 100 << 16, add: 5, add2: 1 });
    /// ```
    #[must_use]
    pub const fn truncated(&self, k: u32) -> Segment {
        Segment { count: k, ..*self }
    }
}

/// `value` · `k`, wrapping; for a Cortex-M0+ in products of 16 bits if `k` has no more: it multiplies 32 bits in one cycle, 64 in 57.
#[expect(clippy::cast_possible_truncation, reason = "halves")]
const fn times(value: i64, k: u32) -> i64 {
    if k >= 1 << 16 {
        return value.wrapping_mul(k as i64);
    }
    let (low, high) = (value.cast_unsigned(), value.cast_unsigned() >> 32);
    let (low, high) = ((low & 0xffff_ffff) as u32, high as u32);
    let (first, second) = ((low & 0xffff) * k, (low >> 16) * k);
    let product = (first as u64).wrapping_add((second as u64) << 16).wrapping_add((high.wrapping_mul(k) as u64) << 32);
    product.cast_signed()
}

/// `value` · C(`k`,2), wrapping.
const fn times_pairs(value: i64, k: u32) -> i64 {
    if k >= 1 << 16 {
        let k = k as u64;
        return value.wrapping_mul(((k * (k - 1)) >> 1).cast_signed());
    }
    // Of two numbers in a row one is even.
    let (half, other) = if k & 1 == 0 { (k >> 1, k.saturating_sub(1)) } else { (k >> 1, k) };
    times(times(value, half), other)
}

/// The live registers of a segment being run: a wrapping accumulator of 64 − F tick bits and F fraction bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(C)]
pub struct Recurrence {
    /// Scheduled time of the last step, ticks · 2^F, wrapping.
    pub accumulator: u64,
    /// Interval to the next step, ticks · 2^F.
    pub interval: i64,
    /// Change of the interval, ticks · 2^F.
    pub add: i64,
    /// Change of that, ticks · 2^F.
    pub add2: i64,
}

impl Recurrence {
    /// Sets the three differences; the accumulator, fraction included, stays.
    pub const fn load(&mut self, segment: &Segment) {
        self.interval = segment.interval;
        self.add = segment.add;
        self.add2 = segment.add2;
    }

    /// Advances to the next step. The tick of that step is `accumulator >> F`.
    pub const fn advance(&mut self) {
        self.accumulator = self.accumulator.wrapping_add_signed(self.interval);
        self.interval = self.interval.wrapping_add(self.add);
        self.add = self.add.wrapping_add(self.add2);
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Products by halves are those of the recurrence: step by step, and in wide integers.
        #[test]
        fn registers_after_steps_are_the_recurrence_s(
            interval: i64, add: i64, add2: i64, count in prop_oneof![0u32..70, 0u32..1 << 17, any::<u32>()],
        ) {
            let segment = Segment { count: u32::MAX, interval, add, add2 };
            let after = segment.after(count);
            let n = i128::from(count);
            let pairs = n * (n - 1) / 2;
            let low = |wide: i128| i64::from_le_bytes(*wide.to_le_bytes().first_chunk().unwrap());
            prop_assert_eq!(after.add, low(i128::from(add) + n * i128::from(add2)));
            let (first, second) = (n * i128::from(add), low(i128::from(low(pairs)) * i128::from(add2)));
            prop_assert_eq!(after.interval, low(i128::from(interval) + i128::from(low(first)) + i128::from(second)));
            if count < 1000 {
                let mut recurrence = Recurrence::default();
                recurrence.load(&segment);
                (0..count).for_each(|_| recurrence.advance());
                prop_assert_eq!((recurrence.interval, recurrence.add), (after.interval, after.add));
            }
        }
    }
}
