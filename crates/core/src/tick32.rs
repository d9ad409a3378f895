//! Time on a board: ticks of 32 bits that wrap. They have no `<`; one function compares them, within 2^31 ticks. Hosts count in 64 bits.

/// A tick of a board's step timer, modulo 2^32. It has no `<`: see [`Tick32::is_before`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(transparent)]
pub struct Tick32(pub u32);

impl Tick32 {
    /// Whether `self` comes before `other`; right while the two are within 2^31 ticks of each other.
    ///
    /// ```
    /// use pulsetrain_core::Tick32;
    /// assert!(Tick32(u32::MAX).is_before(Tick32(3)));
    /// assert!(!Tick32(3).is_before(Tick32(3)));
    /// ```
    #[must_use]
    pub const fn is_before(self, other: Tick32) -> bool {
        self.0.wrapping_sub(other.0) >= 1 << 31
    }

    /// The later of two ticks; right within the same.
    #[must_use]
    pub const fn or_later(self, other: Tick32) -> Tick32 {
        if self.is_before(other) { other } else { self }
    }

    /// The tick `ticks` later.
    #[must_use]
    pub const fn after(self, ticks: u32) -> Tick32 {
        Tick32(self.0.wrapping_add(ticks))
    }

    /// The tick `ticks` earlier.
    #[must_use]
    pub const fn before(self, ticks: u32) -> Tick32 {
        Tick32(self.0.wrapping_sub(ticks))
    }

    /// Ticks from `earlier` to `self`, modulo 2^32.
    #[must_use]
    pub const fn since(self, earlier: Tick32) -> u32 {
        self.0.wrapping_sub(earlier.0)
    }

    /// The lower half of a tick that is counted in 64 bits.
    #[expect(clippy::cast_possible_truncation, reason = "ticks on a board wrap; this is where they do")]
    #[must_use]
    pub const fn of(tick: u64) -> Tick32 {
        Tick32(tick as u32)
    }
}
