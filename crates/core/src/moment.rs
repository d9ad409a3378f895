//! Time on a board: 32 bits that wrap, compared through one function.

/// A tick of a board's step timer, modulo 2^32. It has no `<`: see [`Moment::is_before`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(transparent)]
pub struct Moment(pub u32);

impl Moment {
    /// Whether `self` comes before `other`; right while the two are within 2^31 ticks of each other.
    ///
    /// ```
    /// use pulsetrain_core::Moment;
    /// assert!(Moment(u32::MAX).is_before(Moment(3)));
    /// assert!(!Moment(3).is_before(Moment(3)));
    /// ```
    #[must_use]
    pub const fn is_before(self, other: Moment) -> bool {
        self.0.wrapping_sub(other.0) >= 1 << 31
    }

    /// The later of two moments; right within the same.
    #[must_use]
    pub const fn or_later(self, other: Moment) -> Moment {
        if self.is_before(other) { other } else { self }
    }

    /// The moment `ticks` later.
    #[must_use]
    pub const fn after(self, ticks: u32) -> Moment {
        Moment(self.0.wrapping_add(ticks))
    }

    /// The moment `ticks` earlier.
    #[must_use]
    pub const fn before(self, ticks: u32) -> Moment {
        Moment(self.0.wrapping_sub(ticks))
    }

    /// Ticks from `earlier` to `self`, modulo 2^32.
    #[must_use]
    pub const fn since(self, earlier: Moment) -> u32 {
        self.0.wrapping_sub(earlier.0)
    }

    /// The moment of a tick, counted in 64 bits.
    #[expect(clippy::cast_possible_truncation, reason = "moments wrap; this is where they do")]
    #[must_use]
    pub const fn of(tick: u64) -> Moment {
        Moment(tick as u32)
    }
}
