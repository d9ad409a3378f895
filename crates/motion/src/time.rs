//! Law time: exact, so that days lose no precision.

use std::ops::{Add, Sub};

/// A time or duration in law seconds: fixed point, 64 bits after the point (5.4e-20 s).
///
/// Range ±2^63 s. 10^9 periods of 0.1 s add up to an error below 6e-11 s, a thousandth of an Uno's tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Time(i128);

impl Time {
    /// Zero.
    pub const ZERO: Time = Time(0);
    /// Beyond every motion: an endless law's end.
    pub const MAX: Time = Time(i128::MAX / 4);
    /// One second.
    pub const SECOND: Time = Time(1 << 64);

    /// The nearest `Time` to `seconds`; not-a-number and what lies outside the range become [`Time::MAX`] or its negative.
    #[must_use]
    pub fn from_seconds(seconds: f64) -> Time {
        const SCALE: f64 = 18_446_744_073_709_551_616.0;
        if seconds.is_nan() || seconds >= 9.0e18 {
            return Time::MAX;
        }
        if seconds <= -9.0e18 {
            return Time(-Time::MAX.0);
        }
        // Whole seconds and fraction apart: f64 × 2^64 is exact, the cast rounds toward zero only below 2^-64.
        let whole = seconds.trunc();
        Time(((whole as i128) << 64) + ((seconds - whole) * SCALE).round() as i128)
    }

    /// `numerator`/`denominator` seconds, rounded down to 2^-64 s.
    ///
    /// # Panics
    /// If `denominator` is 0 or `numerator` is 2^62 or more in magnitude.
    #[must_use]
    pub fn from_ratio(numerator: i64, denominator: u64) -> Time {
        assert!(denominator != 0 && numerator.unsigned_abs() < 1 << 62);
        Time((i128::from(numerator) << 64).div_euclid(i128::from(denominator)))
    }

    /// The nearest f64, seconds.
    #[must_use]
    pub fn seconds(self) -> f64 {
        const STEP: f64 = 1.0 / 18_446_744_073_709_551_616.0;
        self.0 as f64 * STEP
    }

    /// In units of 2^-64 s.
    #[must_use]
    pub const fn raw(self) -> i128 {
        self.0
    }

    /// The time 2^-64 s before it: the last one that an interval has which ends here.
    #[must_use]
    pub(crate) fn before(self) -> Time {
        self - Time(1)
    }

    /// From units of 2^-64 s.
    #[must_use]
    pub const fn from_raw(raw: i128) -> Time {
        Time(raw)
    }

    /// `self` × `factor`, saturating at [`Time::MAX`].
    #[must_use]
    pub fn times(self, factor: u64) -> Time {
        Time(self.0.saturating_mul(i128::from(factor)).clamp(-Time::MAX.0, Time::MAX.0))
    }

    /// `self` / `divisor`, rounded down.
    #[must_use]
    pub fn divided_by(self, divisor: u64) -> Time {
        Time(self.0.div_euclid(i128::from(divisor)))
    }

    /// Whole ticks at `tick_hz`, and the fraction of a tick in [0, 1). `self` must be within ±2^36 s (2000 years).
    #[must_use]
    pub fn ticks(self, tick_hz: u64) -> (i64, f64) {
        const STEP: f64 = 1.0 / 18_446_744_073_709_551_616.0;
        let scaled = self.0.saturating_mul(i128::from(tick_hz));
        let fraction = (scaled & ((1 << 64) - 1)) as f64 * STEP;
        ((scaled >> 64) as i64, fraction)
    }
}

/// How fast a law's time runs, as a multiple of the usual rate: 0 is a halt. A whole number of 2^-16, so that times stay exact.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Rate(u32);

impl Rate {
    /// A halt.
    pub const ZERO: Rate = Rate(0);
    /// The usual rate.
    pub const ONE: Rate = Rate(1 << Rate::BITS);
    /// The highest rate.
    pub const MAX: Rate = Rate(10 << Rate::BITS);
    const BITS: u32 = 16;

    /// The nearest rate to `rate`; `None` if that is not 0 to 10.
    ///
    /// ```
    /// use pulsetrain_motion::time::Rate;
    /// assert_eq!(Rate::of(0.5).map(Rate::get), Some(0.5));
    /// assert_eq!(Rate::of(10.1), None);
    /// assert_eq!(Rate::of(f64::NAN), None);
    /// ```
    #[must_use]
    pub fn of(rate: f64) -> Option<Rate> {
        (0.0..=Rate::MAX.get()).contains(&rate).then(|| Rate((rate * f64::from(Rate::ONE.0)).round() as u32))
    }

    /// The rate as a number, exactly.
    #[must_use]
    pub fn get(self) -> f64 {
        f64::from(self.0) / f64::from(Rate::ONE.0)
    }

    /// How far the law's time gets within `time`, rounded down to 2^-64 s.
    #[must_use]
    pub fn of_law(self, time: Time) -> Time {
        // The last bits apart: 2^62 s times 10 would not fit.
        let (whole, part) = (time.0 >> Rate::BITS, time.0 & ((1 << Rate::BITS) - 1));
        let rate = i128::from(self.0);
        Time(whole.saturating_mul(rate)) + Time((part * rate) >> Rate::BITS)
    }

    /// How long the law's time takes to get `time` further, rounded down to 2^-64 s; [`Time::MAX`] at a halt.
    #[must_use]
    pub fn to_pass(self, time: Time) -> Time {
        if self.0 == 0 {
            return Time::MAX;
        }
        let rate = i128::from(self.0);
        let (whole, rest) = (time.0.div_euclid(rate), time.0.rem_euclid(rate));
        Time(whole.saturating_mul(1 << Rate::BITS)) + Time((rest << Rate::BITS) / rate)
    }
}

/// The most of the longest period's turns in which [`common_period`] looks.
pub const MOST_PERIODS: u64 = 64;

/// The time after which all of some periods are over together; `None` if that is longer than [`MOST_PERIODS`] of the longest one.
///
/// ```
/// use pulsetrain_motion::{Time, time::common_period};
/// let periods = [2.0, 3.0].map(Time::from_seconds);
/// assert_eq!(common_period(&periods), Some(Time::from_seconds(6.0)));
/// assert_eq!(common_period(&[1.0, 1.001].map(Time::from_seconds)), None);
/// ```
#[must_use]
pub fn common_period(periods: &[Time]) -> Option<Time> {
    let longest = periods.iter().max().copied().unwrap_or(Time::ZERO);
    let fits = |all: Time| {
        periods.iter().all(|period| {
            let times = (all.raw() + period.raw() / 2) / period.raw();
            // Periods such as 1/3 s are rounded to 2^-64 s.
            (all.raw() - times * period.raw()).abs() <= times
        })
    };
    (1..=MOST_PERIODS).map(|k| longest.times(k)).find(|all| fits(*all))
}

impl Add for Time {
    type Output = Time;
    fn add(self, other: Time) -> Time {
        Time(self.0.saturating_add(other.0).clamp(-Time::MAX.0, Time::MAX.0))
    }
}

impl Sub for Time {
    type Output = Time;
    fn sub(self, other: Time) -> Time {
        Time(self.0.saturating_sub(other.0).clamp(-Time::MAX.0, Time::MAX.0))
    }
}
