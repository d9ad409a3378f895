//! Numbers of 106 bits, each with a bound on its error: for places where a law moves by less than f64 resolves.

use super::double::{Double, ULP};
use crate::whole_power;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// A number, and a bound on what rounding has put it off by; what is undefined is not a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Accurate {
    pub(crate) value: Double,
    pub(crate) error: f64,
}

/// Relative errors of operations on [`Double`]s: 3, 7 and 15 × 2^-106 and a little, here the next power of two.
///
/// Source: M. Joldes, J.-M. Muller, V. Popescu, "Tight and rigorous error bounds for basic building blocks of double-word arithmetic",
/// ACM TOMS 44 (2017), algorithms 6, 11 and 17.
const SUM: f64 = 4.0 * ULP * ULP;
const PRODUCT: f64 = 8.0 * ULP * ULP;
const QUOTIENT: f64 = 32.0 * ULP * ULP;
/// Relative error of a function, and of a value that a few operations have rounded to a [`Double`].
const STEP: f64 = 64.0 * ULP * ULP;
/// Added to every error, and far below any step: products that small lose their lower halves.
const SMALLEST_ERROR: f64 = 1e-280;
/// Covers the roundings of the errors' own arithmetic.
const OUTWARD: f64 = 1.0 + 16.0 * ULP;
/// Beyond, an angle is not known to a turn, rad.
const FARTHEST_ANGLE: f64 = 1e15;
const HALF_PI: Double = Double { hi: std::f64::consts::FRAC_PI_2, lo: 6.123_233_995_736_766e-17 };
const LN_2: Double = Double { hi: std::f64::consts::LN_2, lo: 2.319_046_813_846_299_6e-17 };

impl Accurate {
    pub(crate) const ZERO: Accurate = Accurate::exact(Double::ZERO);
    pub(crate) const ONE: Accurate = Accurate::exact(Double::ONE);
    const UNDEFINED: Accurate = Accurate { value: Double { hi: f64::NAN, lo: f64::NAN }, error: f64::NAN };

    pub(crate) const fn exact(value: Double) -> Accurate {
        Accurate { value, error: 0.0 }
    }

    /// A constant: what an f64 holds is exact.
    pub(crate) fn of(value: Double) -> Accurate {
        if value.lo == 0.0 { Accurate::exact(value) } else { Accurate::rounded(value) }
    }

    /// What a [`Double`] was rounded to once.
    pub(crate) fn rounded(value: Double) -> Accurate {
        Accurate { value, error: STEP * value.hi.abs() }
    }

    /// The nearest f64.
    pub(crate) fn nearest(self) -> f64 {
        self.value.nearest()
    }

    pub(crate) fn is_finite(self) -> bool {
        self.value.is_finite() && self.error.is_finite()
    }

    /// Whether it is 0, and known to be.
    pub(crate) fn is_nothing(self) -> bool {
        self.value.hi == 0.0 && self.error == 0.0
    }

    fn result(value: Double, carried: f64, relative: f64) -> Accurate {
        Accurate { value, error: (carried + relative * value.hi.abs()) * OUTWARD + SMALLEST_ERROR }
    }

    /// `value` of a function that its argument's error puts off by `carried`, and roundings by some of `size` and its own.
    fn function(value: Double, carried: f64, size: f64) -> Accurate {
        Accurate::result(value, carried + 8.0 * STEP * (size + value.hi.abs()), 0.0)
    }

    /// What may be added to its magnitude.
    fn most(self) -> f64 {
        self.value.hi.abs() * (1.0 + 2.0 * ULP) + self.error
    }

    pub(crate) fn sin_cos(self) -> (Accurate, Accurate) {
        let size = self.value.hi.abs();
        if size.is_nan() || size > FARTHEST_ANGLE {
            return (Accurate::UNDEFINED, Accurate::UNDEFINED);
        }
        let quarters = libm::round(self.value.hi / HALF_PI.hi);
        let rest = if quarters == 0.0 { self.value } else { self.value - HALF_PI * Double::from(quarters) };
        let (sin, cos) = sin_cos_near(rest);
        let (sin, cos) = match quarters.rem_euclid(4.0) as u8 {
            0 => (sin, cos),
            1 => (cos, -sin),
            2 => (-sin, -cos),
            _ => (-cos, sin),
        };
        // The slope is 1 at most; the reduction is off by roundings of the angle.
        let of = |value| Accurate::function(value, self.error, size);
        (of(sin), of(cos))
    }

    pub(crate) fn exp(self) -> Accurate {
        let x = self.value;
        let doublings = libm::round(x.hi / LN_2.hi);
        if doublings.is_nan() || doublings.abs() > 1000.0 || self.error > 0.1 {
            return Accurate::UNDEFINED;
        }
        let rest = x - LN_2 * Double::from(doublings);
        // Σ rest^k/k!, from the last: 0.35^25/25! is below 2^-120.
        let sum = (1..=25).rev().fold(Double::ONE, |sum, k| Double::ONE + sum * rest / Double::from(f64::from(k)));
        let value = sum.scaled(doublings as i32);
        Accurate::function(value, 1.1 * self.error * value.hi, value.hi * (1.0 + x.hi.abs()))
    }

    pub(crate) fn ln(self) -> Accurate {
        let smallest = self.value.hi * (1.0 - 2.0 * ULP) - self.error;
        if smallest.is_nan() || smallest <= 0.0 {
            return Accurate::UNDEFINED;
        }
        let first = Double::from(libm::log(self.value.hi));
        let back = Accurate::exact(-first).exp();
        // ln x = first + ln(1 + d), d some 10^-13 at most: its third power is nothing.
        let d = self.value * back.value - Double::ONE;
        let value = first + d - d * d * Double::from(0.5);
        Accurate::function(value, self.error / smallest, 2.0 + value.hi.abs())
    }

    pub(crate) fn sqrt(self) -> Accurate {
        let smallest = self.value.hi * (1.0 - 2.0 * ULP) - self.error;
        if smallest.is_nan() || smallest <= 0.0 {
            return Accurate::UNDEFINED;
        }
        let first = Double::from(libm::sqrt(self.value.hi));
        let value = first + (self.value - first * first) / (first + first);
        Accurate::function(value, self.error * 0.5 / libm::sqrt(smallest), value.hi)
    }

    pub(crate) fn asin(self) -> Accurate {
        let most = self.most();
        let root = libm::sqrt((1.0 - most) * (1.0 + most));
        if root.is_nan() || root <= 0.0 {
            return Accurate::UNDEFINED;
        }
        let first = Double::from(libm::asin(self.value.hi));
        let (sin, cos) = sin_cos_near_half(first);
        // sin(first + d) = x: d = m + tan/2·m² + …, m being what is missing over the cosine.
        let m = (self.value - sin) / cos;
        let value = first + m + sin / cos * m * m * Double::from(0.5);
        let cut = whole_power(m.hi.abs(), 3) * (1.0 + 3.0 / (cos.hi * cos.hi));
        Accurate::function(value, self.error / root + cut, 1.0 + 4.0 / cos.hi.abs())
    }

    pub(crate) fn atan(self) -> Accurate {
        if self.value.hi.is_nan() {
            return Accurate::UNDEFINED;
        }
        let first = Double::from(libm::atan(self.value.hi));
        let (sin, cos) = sin_cos_near_half(first);
        // tan(atan x − first), which is some 2^-53: its third power is nothing.
        let d = (self.value * cos - sin) / (cos + self.value * sin);
        Accurate::function(first + d, self.error, 2.0)
    }

    pub(crate) fn tanh(self) -> Accurate {
        let x = self.value.hi;
        if x.is_nan() {
            return Accurate::UNDEFINED;
        }
        if x.abs() > 40.0 {
            return Accurate::function(Double::from(libm::copysign(1.0, x)), self.error, 1.0);
        }
        let square = Accurate::exact(self.value + self.value).exp().value;
        let value = Double::ONE - Double::from(2.0) / (square + Double::ONE);
        Accurate::function(value, self.error, 8.0 * (1.0 + x.abs()))
    }

    /// To a power, of a positive number.
    pub(crate) fn power(self, exponent: Accurate) -> Accurate {
        (exponent * self.ln()).exp()
    }
}

/// Both of an angle of half a quarter turn at most, to some 10 roundings of each.
fn sin_cos_near(x: Double) -> (Double, Double) {
    let square = x * x;
    // Nested, from the last: 1 − x²/(k(k + 1))·(…); 0.8^31/31! is below 2^-120.
    let nested = |first: u32| {
        (0..15).rev().fold(Double::ONE, |sum, k| {
            let k = f64::from(first + 2 * k);
            Double::ONE - sum * square / Double::from(k * (k + 1.0))
        })
    };
    (x * nested(2), nested(1))
}

/// Sine and cosine of at most a quarter turn.
fn sin_cos_near_half(x: Double) -> (Double, Double) {
    if x.hi.abs() < 0.8 {
        return sin_cos_near(x);
    }
    let side = libm::copysign(1.0, x.hi);
    let (sin, cos) = sin_cos_near(HALF_PI - x * Double::from(side));
    (cos * Double::from(side), sin)
}

impl Add for Accurate {
    type Output = Accurate;
    fn add(self, other: Accurate) -> Accurate {
        if other.is_nothing() {
            return self;
        }
        if self.is_nothing() {
            return other;
        }
        let value = self.value + other.value;
        if self.value.lo == 0.0 && other.value.lo == 0.0 {
            // Two halves hold the sum of two f64.
            return Accurate { value, error: (self.error + other.error) * OUTWARD };
        }
        Accurate::result(value, self.error + other.error, SUM)
    }
}

impl Neg for Accurate {
    type Output = Accurate;
    fn neg(self) -> Accurate {
        Accurate { value: -self.value, ..self }
    }
}

impl Sub for Accurate {
    type Output = Accurate;
    fn sub(self, other: Accurate) -> Accurate {
        self + -other
    }
}

impl Mul for Accurate {
    type Output = Accurate;
    fn mul(self, other: Accurate) -> Accurate {
        if (self.is_nothing() && other.is_finite()) || (other.is_nothing() && self.is_finite()) {
            return Accurate::ZERO;
        }
        let carried = self.error * other.most() + other.error * self.value.hi.abs() * (1.0 + 2.0 * ULP);
        Accurate::result(self.value * other.value, carried, PRODUCT)
    }
}

impl Div for Accurate {
    type Output = Accurate;
    fn div(self, other: Accurate) -> Accurate {
        let smallest = other.value.hi.abs() * (1.0 - 2.0 * ULP) - other.error;
        if smallest.is_nan() || smallest <= 0.0 {
            return Accurate::UNDEFINED;
        }
        let value = self.value / other.value;
        Accurate::result(value, (self.error + value.hi.abs() * (1.0 + 2.0 * ULP) * other.error) / smallest, QUOTIENT)
    }
}

impl From<f64> for Accurate {
    fn from(x: f64) -> Accurate {
        Accurate::exact(Double::from(x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dashu::base::Abs;
    use dashu::float::FBig;
    use dashu::float::round::mode::HalfEven;
    use proptest::prelude::*;

    type Wide = FBig<HalfEven, 2>;

    fn wide(x: Double) -> Wide {
        let part = |x: f64| Wide::try_from(x).unwrap().with_precision(300).value();
        part(x.hi) + part(x.lo)
    }

    /// The exact result is within the error, and the error is some 2^-90 of what went in and came out.
    #[track_caller]
    fn check(what: &str, is: Accurate, exact: &Wide, size: f64) {
        let off = (wide(is.value) - exact).abs().to_f64().value();
        assert!(off <= is.error, "{what}: {off:e} off, {:e} promised", is.error);
        assert!(
            is.error <= 1e-26 * (size + is.nearest().abs()) + 1e-279,
            "{what}: no more than {:e} promised",
            is.error
        );
    }

    proptest! {
        #[test]
        fn functions_are_within_their_errors(hi in -1.0..1.0f64, lo in -0.5..0.5f64, scale in -40..9i32) {
            let number = |hi: f64| Double { hi, lo: lo * ULP * hi.abs() };
            let x = number(libm::scalbn(hi, scale));
            let (of, exact, size) = (Accurate::exact(x), wide(x), 1.0 + x.hi.abs());
            let (sin, cos) = exact.sin_cos();
            check("sin", of.sin_cos().0, &sin, x.hi.abs());
            check("cos", of.sin_cos().1, &cos, size);
            check("atan", of.atan(), &exact.atan(), size);
            check("tanh", of.tanh(), &exact.tanh(), size);
            if x.hi.abs() < 700.0 {
                check("exp", of.exp(), &exact.exp(), of.exp().nearest() * size);
            }
            let positive = number(libm::scalbn(hi.abs() + 1e-9, scale));
            let (of, exact) = (Accurate::exact(positive), wide(positive));
            check("ln", of.ln(), &exact.ln(), 1.0);
            check("sqrt", of.sqrt(), &exact.sqrt(), 0.0);
            check("power", of.power(Accurate::from(1.7)), &(exact.ln() * Wide::try_from(1.7).unwrap()).exp(), of.nearest().powf(1.7) * 100.0);
            let inside = number(hi * (1.0 - libm::scalbn(1.0, -30)));
            let (of, exact) = (Accurate::exact(inside), wide(inside));
            check("asin", of.asin(), &exact.asin(), 1e6);
        }

        #[test]
        fn sums_and_products_are_within_their_errors(a in -1e3..1e3f64, b in 0.1..1e3f64, c in -1.0..1.0f64, d in -1.0..1.0f64) {
            let [x, y] = [Double { hi: a, lo: c * ULP * a.abs() * 0.5 }, Double { hi: b, lo: d * ULP * b * 0.5 }];
            let [of, by] = [Accurate::rounded(x), Accurate::rounded(y)];
            // As far off as they may be.
            let [wide_x, wide_y] = [(x, of), (y, by)].map(|(x, of)| wide(x) + Wide::try_from(of.error * 0.99).unwrap());
            check("+", of + by, &(&wide_x + &wide_y), a.abs() + b);
            check("-", of - by, &(&wide_x - &wide_y), a.abs() + b);
            check("*", of * by, &(&wide_x * &wide_y), 0.0);
            check("/", of / by, &(&wide_x / &wide_y), 0.0);
        }
    }

    #[test]
    fn what_is_undefined_is_no_number() {
        let [zero, two] = [0.0, 2.0].map(Accurate::from);
        for undefined in [
            two / zero,
            zero.ln(),
            zero.sqrt(),
            two.asin(),
            Accurate::from(1e300).exp(),
            Accurate::from(1e300).sin_cos().0,
        ] {
            assert!(!undefined.is_finite(), "{undefined:?}");
        }
    }
}
