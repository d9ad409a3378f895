//! The exact time of a step.

use dashu::base::Abs;
use dashu::float::FBig;
use dashu::float::round::mode::HalfEven;
use dashu::rational::RBig;

/// A real number rounded to `BITS` significant bits.
pub type Real = FBig<HalfEven, 2>;
/// A rational number, exact.
pub type Rational = RBig;

/// Significant bits of every [`Real`] here. A tick of 8 ns in 10 h is bit 43, so that 149 bits stay for its fraction.
pub(crate) const BITS: usize = 192;

/// The number `numerator`/`denominator`.
///
/// # Panics
/// If `denominator` is 0.
#[must_use]
pub fn rational(numerator: i128, denominator: u128) -> Rational {
    Rational::from_parts(numerator.into(), denominator.into())
}

/// `value`, rounded to [`BITS`] bits.
pub(crate) fn real(value: &Rational) -> Real {
    value.to_float::<HalfEven, 2>(BITS).value()
}

/// A step: θ crosses its level.
#[derive(Clone, Debug, PartialEq)]
pub struct Crossing {
    /// The exact time, s.
    pub seconds: Real,
    /// Whether the position counts up.
    pub forward: bool,
}

impl Crossing {
    /// How far `scheduled` is from the exact time, ticks: |scheduled − exact|.
    ///
    /// ```
    /// use pulsetrain_oracle::{Trapezoid, rational};
    /// // A third of a step each second: the first step is due after 3/2 s, the second after 9/2 s.
    /// let law = Trapezoid::constant_speed(rational(1, 3), 2);
    /// let due: Vec<_> = law.crossings(&rational(0, 1)).collect();
    /// assert_eq!(due[0].error_ticks(16_000_000, 24_000_000), 0.0);
    /// assert_eq!(due[1].error_ticks(16_000_000, 72_000_001), 1.0);
    /// ```
    #[must_use]
    pub fn error_ticks(&self, tick_hz: u64, scheduled: u64) -> f64 {
        (&self.seconds * Real::from(tick_hz) - Real::from(scheduled)).abs().to_f64().value()
    }

    /// The tick nearest to the exact time: the best that a plan can do.
    ///
    /// # Panics
    /// If it is beyond 2^63 ticks.
    #[must_use]
    pub fn nearest_tick(&self, tick_hz: u64) -> u64 {
        let ticks = (&self.seconds * Real::from(tick_hz)).to_int().value();
        u64::try_from(ticks).expect("a step time within u64 ticks")
    }
}
