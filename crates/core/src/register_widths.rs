//! How wide the registers of a board's step generator are: what segments must fit in.

/// The widths of the registers in which a board computes its steps.
///
/// They are a fact of its firmware, and so of each board's profile. Info says only the fraction bits (docs/protocol.md); the widths that
/// belong to them are here, and nowhere else: [`with_fraction_bits`](RegisterWidths::with_fraction_bits).
///
/// ```
/// use pulsetrain_core::RegisterWidths;
/// assert_eq!(RegisterWidths::NARROW.max_add(), i64::from(i32::MAX));
/// assert_eq!(RegisterWidths::with_fraction_bits(32), RegisterWidths::WIDE);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RegisterWidths {
    /// Fraction bits of accumulator, interval, add and add2 (F), 1 to 32.
    pub fraction_bits: u32,
    /// Bits of add, with its sign.
    pub add_bits: u32,
    /// A braking motor rests rather than wait 2^`rest_bits` ticks or longer for its next step.
    pub rest_bits: u32,
}

impl RegisterWidths {
    /// Those of an 8-bit processor ([`avr`](crate::avr)): an interval is below 2^24 ticks.
    pub const NARROW: RegisterWidths = RegisterWidths { fraction_bits: 16, add_bits: 32, rest_bits: 23 };
    /// Registers of 64 bits. Intervals end at 2^30 ticks, since ticks on a board wrap.
    pub const WIDE: RegisterWidths = RegisterWidths { fraction_bits: 32, add_bits: 64, rest_bits: 30 };

    /// Those of firmware with so many fraction bits, 1 to 32: 16 and fewer belong to narrow registers.
    #[must_use]
    pub const fn with_fraction_bits(fraction_bits: u32) -> RegisterWidths {
        let widths = if Self::is_narrow(fraction_bits) { Self::NARROW } else { Self::WIDE };
        RegisterWidths { fraction_bits, ..widths }
    }

    /// Whether firmware with so many fraction bits has an add of 32 bits.
    #[must_use]
    pub const fn is_narrow(fraction_bits: u32) -> bool {
        fraction_bits <= Self::NARROW.fraction_bits
    }

    /// The largest add, ticks · 2^F.
    #[must_use]
    pub const fn max_add(self) -> i64 {
        i64::MAX >> (i64::BITS - self.add_bits)
    }

    /// A braking motor rests rather than wait for so long or longer for a step, ticks · 2^F.
    #[must_use]
    pub const fn rest_interval(self) -> i64 {
        1 << (self.rest_bits + self.fraction_bits)
    }
}
