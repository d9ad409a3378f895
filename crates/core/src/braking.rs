//! Braking: the one motion that a board makes by itself, and that its host works out in advance.
//!
//! # The contract
//! A motor brakes from the interval that its next step would have come after: I, ticks · 2^F. A [`Limit`] says how hard it may
//! brake. The rule gives parts: so many steps, the interval of each longer than the one before by the same `add`; then
//! the next part from the interval that was reached, until the motor rests. All is integers: whoever knows I, the limit and the
//! board's [`RegisterLimits`] knows the tick of every step of the stop.
//!
//! Let R = M · 2^(E−7) be the interval from which a motor may come to rest within one step (R = hz · 2^F / √(2a) for a limit of a
//! steps/s², rounded up), e the number of I's leading bit, and X its upper eight bits. With d = 2(E − e) and p = 181 · X
//! the level m is
//!
//! | | p / 2^8 ≥ M | p / 2^7 ≥ M | else |
//! |---|---|---|---|
//! | X ≥ M | d − 1 | d | d |
//! | X < M | | d + 1 | d + 2 |
//!
//! - m ≤ L, the limit's rest level: one step more after I, and rest.
//! - Else 2^min(m − 2, 7) steps, at least one; add = I / 2^(m+1) rounded down, at least 1, and no more than the board's registers hold.
//! - Intervals of the registers' [longest](RegisterLimits::longest) or more are rest at once: 2^23 ticks on an Uno, 0.52 s. A part makes the
//!   interval 1.25 times as long at most, and an Uno's registers hold 2^24 ticks.
//!
//! # Why it is within the limit
//! 181/128 is a little less than √2, and what X leaves out of I only makes I longer. So **2^m · I² ≥ R²**: m is never too
//! small. `levels_are_never_too_low` tries all mantissas of I and R with all differences of their exponents, in exact integers.
//! The speed goes from 1/I to 1/(I + add) in the time between the middles of the two intervals, which is a deceleration of
//!
//! 2·add / (I · (I + add) · (2I + add)) ≤ add/I³ ≤ 1/(2^(m+1) · I²) ≤ 1/(2R²),
//!
//! and that is the limit. Within a part I grows while add stays, and the next part has a level of its own.
//!
//! # Where it does not hold
//! Where I / 2^(m+1) is less than 1, add is 1 all the same, so that a stop ends. Then the deceleration is v³/(hz · 2^F): with 16
//! fraction bits at 16 MHz and 160 000 steps/s it is 3900 steps/s². A host refuses limits below that.
//!
//! # What it costs
//! A stop takes 1.39 to 2.00 times the v²/2a steps of an ideal one; `crates/core/tests/it/braking.rs` prints it. No division, one multiplication of
//! two bytes a part. Where registers hold an add of 31 bits, 2^15 ticks with 16 fraction bits, a stop that is slower
//! than that at its end takes longer: [`RegisterWidths`]. How much longer depends on hz: it is the host's to see to.

use crate::{RegisterWidths, Segment};
use core::cmp::Reverse;

/// Most steps of one part, as a power of two.
const LONGEST_PART: u32 = 7;

/// The largest exponent of a limit: intervals up to there, and what the rule adds to them, fit in 63 bits.
pub const LARGEST_EXPONENT: u8 = 61;

/// How hard a motor may brake.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limit {
    mantissa: u8,
    exponent: u8,
    rest_level: u8,
}

impl Limit {
    /// A motor that may stop within one step, whatever its speed.
    pub const WITHIN_A_STEP: Limit = Limit { mantissa: 128, exponent: 0, rest_level: u8::MAX };

    /// The rest interval `mantissa` · 2^(`exponent` − 7), ticks · 2^F, and the level at which the motor is slow enough to stop.
    /// `None` for a mantissa below 128 or an exponent above [`LARGEST_EXPONENT`].
    #[must_use]
    pub const fn new(mantissa: u8, exponent: u8, rest_level: u8) -> Option<Limit> {
        if mantissa < 128 || exponent > LARGEST_EXPONENT {
            return None;
        }
        Some(Limit { mantissa, exponent, rest_level })
    }

    /// M: the leading eight bits of the rest interval.
    #[must_use]
    pub const fn mantissa(&self) -> u8 {
        self.mantissa
    }

    /// E: the number of its leading bit.
    #[must_use]
    pub const fn exponent(&self) -> u8 {
        self.exponent
    }

    /// L.
    #[must_use]
    pub const fn rest_level(&self) -> u8 {
        self.rest_level
    }

    /// The one of two limits with which a motor brakes harder.
    ///
    /// ```
    /// use pulsetrain_core::braking::Limit;
    /// let (hard, soft) = (Limit::new(250, 31, 0).unwrap(), Limit::new(221, 32, 0).unwrap());
    /// assert_eq!((soft.harder(hard), hard.harder(soft)), (hard, hard));
    /// ```
    #[must_use]
    pub fn harder(self, other: Limit) -> Limit {
        let rank = |limit: Limit| (limit.exponent, limit.mantissa, Reverse(limit.rest_level));
        if rank(self) <= rank(other) { self } else { other }
    }

    /// The level m of an interval, ticks · 2^F: 2^m · `interval`² is at least the square of the rest interval.
    #[must_use]
    pub const fn level(&self, interval: u64) -> i32 {
        if interval == 0 {
            return i32::MAX;
        }
        let leading = u64::BITS - 1 - interval.leading_zeros();
        let upper = if leading >= 7 { interval >> (leading - 7) } else { interval << (7 - leading) };
        let product = 181 * upper;
        let twice = 2 * (self.exponent as i32 - leading.cast_signed());
        let mantissa = self.mantissa as u64;
        if upper >= mantissa {
            if product >> 8 >= mantissa { twice - 1 } else { twice }
        } else if product >> 7 >= mantissa {
            twice + 1
        } else {
            twice + 2
        }
    }

    /// How a motor goes on whose next step would come after `interval`, ticks · 2^F.
    ///
    /// ```
    /// use pulsetrain_core::braking::{Limit, BrakingPart, RegisterLimits};
    /// // 16 MHz, 16 fraction bits, 10 000 steps/s²: R = 113 138 ticks.
    /// let limit = Limit::new(221, 32, 0).unwrap();
    /// let registers = RegisterLimits::with_fraction_bits(16);
    /// // From 8000 steps/s, 2000 ticks: level 12.
    /// assert_eq!(limit.next(2000 << 16, &registers), BrakingPart::Steps { count: 128, add: 16_000 });
    /// assert_eq!(limit.next(120_000 << 16, &registers), BrakingPart::LastStep);
    /// assert_eq!(limit.next(1 << 39, &registers), BrakingPart::Rest);
    /// ```
    #[must_use]
    pub const fn next(&self, interval: i64, registers: &RegisterLimits) -> BrakingPart {
        if interval <= 0 || interval >= registers.longest {
            return BrakingPart::Rest;
        }
        let level = self.level(interval.cast_unsigned());
        if level <= self.rest_level as i32 {
            return BrakingPart::LastStep;
        }
        // Above the rest level, which is not negative.
        let level = level.cast_unsigned();
        let add = if level < 62 { interval >> (level + 1) } else { 0 };
        let add = if add < 1 { 1 } else { add };
        let add = if add > registers.most_add { registers.most_add } else { add };
        let part = level.saturating_sub(2);
        let count = 1 << if part < LONGEST_PART { part } else { LONGEST_PART };
        BrakingPart::Steps { count, add }
    }
}

/// How a braking motor goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BrakingPart {
    /// It rests where it is.
    Rest,
    /// One step more after the interval, and rest.
    LastStep,
    /// A part of the stop, the first step after the interval.
    Steps {
        /// How many.
        count: u32,
        /// What the interval grows by after each, ticks · 2^F.
        add: i64,
    },
}

impl BrakingPart {
    /// The steps as a segment that begins with `interval`; `None` at rest.
    #[must_use]
    pub const fn segment(self, interval: i64) -> Option<Segment> {
        match self {
            BrakingPart::Rest => None,
            BrakingPart::LastStep => Some(Segment::single(interval)),
            BrakingPart::Steps { count, add } => Some(Segment { count, interval, add, add2: 0 }),
        }
    }
}

/// What a board's registers hold, as far as braking needs it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RegisterLimits {
    most_add: i64,
    longest: i64,
}

impl RegisterLimits {
    /// Those of registers with these widths.
    #[must_use]
    pub const fn of(widths: RegisterWidths) -> RegisterLimits {
        RegisterLimits { most_add: widths.max_add(), longest: widths.rest_interval() }
    }

    /// Those of [firmware with so many fraction bits](RegisterWidths::with_fraction_bits).
    #[must_use]
    pub const fn with_fraction_bits(fraction_bits: u32) -> RegisterLimits {
        RegisterLimits::of(RegisterWidths::with_fraction_bits(fraction_bits))
    }

    /// The largest add, ticks · 2^F.
    #[must_use]
    pub const fn most_add(&self) -> i64 {
        self.most_add
    }

    /// A motor rests rather than wait for so long or longer for a step, ticks · 2^F.
    #[must_use]
    pub const fn longest(&self) -> i64 {
        self.longest
    }
}
