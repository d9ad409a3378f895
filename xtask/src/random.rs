//! Random numbers that are equal on every machine.

/// SplitMix64. Source: Steele, Lea, Flood, OOPSLA 2014.
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Random {
        Random(seed)
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In [0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// 10^x, x in `low..high`.
    pub(crate) fn decades(&mut self, low: f64, high: f64) -> f64 {
        10_f64.powf(low + (high - low) * self.unit())
    }

    /// In `0..bound`; the bias is below 2^-32 as `bound` is small.
    pub(crate) fn below(&mut self, bound: u16) -> u16 {
        (((self.next() >> 32) * u64::from(bound)) >> 32) as u16
    }

    /// In `low..=high`.
    pub(crate) fn between(&mut self, low: u16, high: u16) -> u16 {
        (u64::from(low) + (((self.next() >> 32) * (u64::from(high) - u64::from(low) + 1)) >> 32)) as u16
    }

    /// True once in `times`.
    pub(crate) fn once_in(&mut self, times: u16) -> bool {
        self.below(times) == 0
    }

    /// One of `items`, which must not be empty.
    pub(crate) fn pick<T: Copy>(&mut self, items: &[T]) -> T {
        items[usize::from(self.below(items.len() as u16))]
    }
}
