//! Double-double arithmetic: 106 bits, for what must stay exact over days (phases, whole steps, constants).
//!
//! Source: T. J. Dekker, "A floating-point technique for extending the available precision", Numer. Math. 18 (1971).

use crate::Time;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// 2^-53: the relative error of one rounding.
pub(crate) const ULP: f64 = f64::EPSILON / 2.0;

/// `hi` + `lo`, |lo| ≤ ½ ulp(hi).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Double {
    pub(crate) hi: f64,
    pub(crate) lo: f64,
}

impl Double {
    pub(crate) const ZERO: Double = Double { hi: 0.0, lo: 0.0 };
    pub(crate) const ONE: Double = Double { hi: 1.0, lo: 0.0 };
    pub(crate) const TAU: Double = Double { hi: std::f64::consts::TAU, lo: 2.449_293_598_294_706_4e-16 };
    pub(crate) const PI: Double = Double { hi: std::f64::consts::PI, lo: 1.224_646_799_147_353_2e-16 };
    pub(crate) const E: Double = Double { hi: std::f64::consts::E, lo: 1.445_646_891_729_250_2e-16 };

    /// The exact sum of two f64.
    fn sum(a: f64, b: f64) -> Double {
        let hi = a + b;
        let b_part = hi - a;
        Double { hi, lo: (a - (hi - b_part)) + (b - b_part) }
    }

    /// A decimal number to 106 bits; `None` for one of more than 30 digits, or with a larger power of ten.
    ///
    /// A number that an f64 holds exactly has no low part.
    pub(crate) fn decimal(text: &str) -> Option<Double> {
        let (mantissa, exponent) = match text.find(['e', 'E']) {
            Some(at) => (&text[..at], text[at + 1..].parse::<i32>().ok()?),
            None => (text, 0),
        };
        let (whole, broken) = mantissa.split_once('.').unwrap_or((mantissa, ""));
        let digits = || whole.bytes().chain(broken.bytes());
        let exponent = exponent.checked_sub(i32::try_from(broken.len()).ok()?)?;
        if digits().count() > 30 || exponent.abs() > 30 || !digits().all(|digit| digit.is_ascii_digit()) {
            return None;
        }
        // Below 2^100, and so is the power of ten: both are exact.
        let number =
            digits().fold(Double::ZERO, |sum, digit| sum * Double::from(10.0) + Double::from(f64::from(digit - b'0')));
        let power = (0..exponent.abs()).fold(Double::ONE, |power, _| power * Double::from(10.0));
        Some(if exponent < 0 { number / power } else { number * power })
    }

    /// The exact product of two f64.
    fn product(a: f64, b: f64) -> Double {
        let hi = a * b;
        Double { hi, lo: libm::fma(a, b, -hi) }
    }

    /// The nearest f64.
    pub(crate) fn nearest(self) -> f64 {
        self.hi
    }

    pub(crate) fn is_finite(self) -> bool {
        self.hi.is_finite() && self.lo.is_finite()
    }

    /// Times 2^`doublings`.
    pub(crate) fn scaled(self, doublings: i32) -> Double {
        Double { hi: libm::scalbn(self.hi, doublings), lo: libm::scalbn(self.lo, doublings) }
    }

    /// The nearest whole number and what is left, −½ to ½; `None` beyond ±2^62.
    pub(crate) fn split(self) -> Option<(i64, Double)> {
        if self.hi.is_nan() || self.hi.abs() >= 4.6e18 {
            return None;
        }
        let whole = libm::round(self.hi);
        let rest = (self.hi - whole) + self.lo;
        let carry = libm::round(rest);
        Some((whole as i64 + carry as i64, self - Double::from(whole) - Double::from(carry)))
    }

    /// The largest whole number that is not larger.
    pub(crate) fn floor(self) -> Double {
        let whole = libm::floor(self.hi);
        // If the high part is whole, the low part decides.
        if whole == self.hi { Double::sum(whole, libm::floor(self.lo)) } else { Double::from(whole) }
    }

    /// The angle less whole turns, rad, within ±π.
    pub(crate) fn wrapped(self) -> Double {
        let turns = libm::round(self.hi / Double::TAU.hi);
        self - Double::TAU * Double::from(turns)
    }
}

impl From<f64> for Double {
    fn from(x: f64) -> Double {
        Double { hi: x, lo: 0.0 }
    }
}

impl From<i64> for Double {
    fn from(n: i64) -> Double {
        // 2^63 itself is the one f64 that the cast back would clip.
        let hi = n as f64;
        Double::sum(hi, (i128::from(n) - hi as i128) as f64)
    }
}

impl From<Time> for Double {
    /// Seconds; exact to 2^-106 of the value.
    fn from(t: Time) -> Double {
        const STEP: f64 = 1.0 / 18_446_744_073_709_551_616.0;
        let hi = t.raw() as f64;
        Double::sum(hi * STEP, (t.raw() - hi as i128) as f64 * STEP)
    }
}

impl Add for Double {
    type Output = Double;
    fn add(self, other: Double) -> Double {
        let s = Double::sum(self.hi, other.hi);
        let t = Double::sum(self.lo, other.lo);
        let s = Double::sum(s.hi, s.lo + t.hi);
        Double::sum(s.hi, s.lo + t.lo)
    }
}

impl Neg for Double {
    type Output = Double;
    fn neg(self) -> Double {
        Double { hi: -self.hi, lo: -self.lo }
    }
}

impl Sub for Double {
    type Output = Double;
    fn sub(self, other: Double) -> Double {
        self + -other
    }
}

impl Mul for Double {
    type Output = Double;
    fn mul(self, other: Double) -> Double {
        let p = Double::product(self.hi, other.hi);
        Double::sum(p.hi, p.lo + (self.hi * other.lo + self.lo * other.hi))
    }
}

impl Div for Double {
    type Output = Double;
    fn div(self, other: Double) -> Double {
        let quotient = self.hi / other.hi;
        let rest = self - other * Double::from(quotient);
        Double::sum(quotient, rest.hi / other.hi)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constants_are_within_2_to_the_minus_100() {
        // π to 40 digits, from any table; the difference must vanish in 106 bits.
        let digits: [f64; 5] = [3.0, 14_159_265.0, 35_897_932.0, 38_462_643.0, 38_327_950.0];
        let pi = digits.iter().rev().fold(Double::ZERO, |sum, &d| sum / Double::from(1e8) + Double::from(d));
        assert!((pi - Double::PI).hi.abs() < 1e-30, "{:e}", (pi - Double::PI).hi);
        assert!((pi + pi - Double::TAU).hi.abs() < 1e-30);
    }

    #[test]
    fn decimals_keep_what_an_f64_drops() {
        for (text, times, whole) in [("0.1", 10.0, 1.0), ("12.34", 50.0, 617.0), ("3e-7", 1e7, 3.0), (".7", 10.0, 7.0)]
        {
            let left = Double::decimal(text).unwrap() * Double::from(times) - Double::from(whole);
            assert!(left.hi.abs() < 1e-29, "{text}: {left:?}");
        }
        assert_eq!(Double::decimal("0.375e2"), Some(Double::from(37.5)));
        assert_eq!(Double::decimal("1e31"), None);
        assert_eq!(Double::decimal(&"3".repeat(31)), None);
    }

    #[test]
    fn a_phase_after_a_year_keeps_its_digits() {
        // 7 rad/s for 10^7 s + 2^-40 s.
        let t = Time::from_seconds(1e7) + Time::from_raw(1 << 24);
        let wrapped = (Double::from(7.0) * Double::from(t)).wrapped();
        let whole = (Double::from(7e7)).wrapped();
        assert_eq!((wrapped - whole).nearest(), 7.0 / f64::powi(2.0, 40));
    }
}
