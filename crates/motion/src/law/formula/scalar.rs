//! The numbers that Taylor recurrences run on: plain ones, and ones that know their range and their rounding error.

use crate::law::double::{Double, ULP};
use std::ops::{Add, Div, Mul, Neg, Sub};

/// What a Taylor recurrence needs of a number.
pub(in crate::law) trait Scalar:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// An f64 as it is.
    fn exact(x: f64) -> Self;
    /// The f64 nearest to what is meant, once rounded.
    fn rounded(x: f64) -> Self;
    /// A constant of 106 bits.
    fn constant(x: Double) -> Self;
    /// Whether it can be used for further computation. An f64 always can.
    fn is_sound(self) -> bool;
    fn sin_cos(self) -> (Self, Self);
    fn exp(self) -> Self;
    fn ln(self) -> Self;
    fn sqrt(self) -> Self;
    fn asin(self) -> Self;
    fn atan(self) -> Self;
    fn tanh(self) -> Self;
    /// To a power that is a constant, of a positive number.
    fn power(self, exponent: f64) -> Self;
}

impl Scalar for f64 {
    fn exact(x: f64) -> f64 {
        x
    }
    fn rounded(x: f64) -> f64 {
        x
    }
    fn constant(x: Double) -> f64 {
        x.nearest()
    }
    fn is_sound(self) -> bool {
        true
    }
    fn sin_cos(self) -> (f64, f64) {
        libm::sincos(self)
    }
    fn exp(self) -> f64 {
        libm::exp(self)
    }
    fn ln(self) -> f64 {
        libm::log(self)
    }
    fn sqrt(self) -> f64 {
        libm::sqrt(self)
    }
    fn asin(self) -> f64 {
        libm::asin(self)
    }
    fn atan(self) -> f64 {
        libm::atan(self)
    }
    fn tanh(self) -> f64 {
        libm::tanh(self)
    }
    fn power(self, exponent: f64) -> f64 {
        libm::pow(self, exponent)
    }
}

/// A number over a whole stretch of time: the exact value is always in `low..=high`, and the value that the same
/// recurrence computes in f64 is always within `error` of it. What is undefined somewhere is not a number.
///
/// Every operation rounds outward, by one unit in the last place for + − × ÷ √ and by four for the functions, whose
/// errors in `libm` are below one (FreeBSD's msun).
#[derive(Clone, Copy, Debug)]
pub(in crate::law) struct Enclosed {
    pub(in crate::law) low: f64,
    pub(in crate::law) high: f64,
    pub(in crate::law) error: f64,
}

/// Added to errors, and to bounds at 0: far below any step, and far enough above what a processor is slow with.
const SMALLEST_BOUND: f64 = 1e-280;
/// Units in the last place that the functions are widened by.
const SLACK: f64 = 8.0 * ULP;

impl Enclosed {
    pub(in crate::law) fn new(low: f64, high: f64, error: f64) -> Enclosed {
        Enclosed { low, high, error }
    }

    const UNDEFINED: Enclosed = Enclosed { low: f64::NAN, high: f64::NAN, error: f64::NAN };

    /// The largest magnitude.
    pub(in crate::law) fn magnitude(self) -> f64 {
        self.low.abs().max(self.high.abs())
    }

    /// One operation's result in `low..=high` whose operands' errors make `carried`: rounds outward.
    fn result(low: f64, high: f64, carried: f64) -> Enclosed {
        let low = if low.abs() < SMALLEST_BOUND { low - SMALLEST_BOUND } else { low.next_down() };
        let high = if high.abs() < SMALLEST_BOUND { high + SMALLEST_BOUND } else { high.next_up() };
        let magnitude = low.abs().max(high.abs()) + carried;
        Enclosed { low, high, error: (carried + ULP * magnitude) * (1.0 + 8.0 * ULP) + SMALLEST_BOUND }
    }

    /// Whether it is 0, and is computed as 0.
    fn is_nothing(self) -> bool {
        self.low == 0.0 && self.high == 0.0 && self.error == 0.0
    }

    /// The enclosure of a result of a `libm` function.
    fn function(low: f64, high: f64, carried: f64) -> Enclosed {
        let (low, high) = (low - SLACK * low.abs(), high + SLACK * high.abs());
        let magnitude = low.abs().max(high.abs()) + carried;
        let error = (carried + 2.0 * ULP * magnitude) * (1.0 + 8.0 * ULP) + SMALLEST_BOUND;
        Enclosed { low: low - SMALLEST_BOUND, high: high + SMALLEST_BOUND, error }
    }

    /// `f`, rising, whose slope is `slope` at most.
    fn rising(self, f: impl Fn(f64) -> f64, slope: f64) -> Enclosed {
        Enclosed::function(f(self.low), f(self.high), self.error * slope * (1.0 + 16.0 * ULP))
    }

    /// Whether `at` + 2πk is in the range, or so near that it cannot be told.
    fn may_meet(self, at: f64) -> bool {
        let turn = |x: f64| (x - at) / std::f64::consts::TAU;
        let near = 1e-12 * (1.0 + self.magnitude());
        (turn(self.low) - near).ceil() <= (turn(self.high) + near).floor()
    }
}

impl Add for Enclosed {
    type Output = Enclosed;
    fn add(self, other: Enclosed) -> Enclosed {
        // Nothing is rounded then.
        if other.is_nothing() {
            return self;
        }
        if self.is_nothing() {
            return other;
        }
        Enclosed::result(self.low + other.low, self.high + other.high, self.error + other.error)
    }
}

impl Neg for Enclosed {
    type Output = Enclosed;
    fn neg(self) -> Enclosed {
        Enclosed { low: -self.high, high: -self.low, error: self.error }
    }
}

impl Sub for Enclosed {
    type Output = Enclosed;
    fn sub(self, other: Enclosed) -> Enclosed {
        self + -other
    }
}

impl Mul for Enclosed {
    type Output = Enclosed;
    fn mul(self, other: Enclosed) -> Enclosed {
        // The series of polynomials are mostly zeros.
        if (self.is_nothing() && other.is_sound()) || (other.is_nothing() && self.is_sound()) {
            return Enclosed::exact(0.0);
        }
        let products = [self.low * other.low, self.low * other.high, self.high * other.low, self.high * other.high];
        let Some((low, high)) = range(products) else { return Enclosed::UNDEFINED };
        let carried = self.error * other.magnitude() + other.error * self.magnitude() + self.error * other.error;
        Enclosed::result(low, high, carried)
    }
}

impl Div for Enclosed {
    type Output = Enclosed;
    fn div(self, other: Enclosed) -> Enclosed {
        let smallest = if other.low > 0.0 { other.low } else { -other.high } - other.error;
        if smallest.is_nan() || smallest <= 0.0 {
            return Enclosed::UNDEFINED;
        }
        let quotients = [self.low / other.low, self.low / other.high, self.high / other.low, self.high / other.high];
        let Some((low, high)) = range(quotients) else { return Enclosed::UNDEFINED };
        let carried = (self.error + low.abs().max(high.abs()) * other.error) / smallest;
        Enclosed::result(low, high, carried * (1.0 + 8.0 * ULP))
    }
}

/// The least and the greatest of four values; `None` if one of them is not a number. Most of the time for reading a robot's motion is spent here.
fn range([a, b, c, d]: [f64; 4]) -> Option<(f64, f64)> {
    let less = |a: f64, b: f64| if a < b { a } else { b };
    let more = |a: f64, b: f64| if a > b { a } else { b };
    let is_number = !(a.is_nan() | b.is_nan() | c.is_nan() | d.is_nan());
    is_number.then(|| (less(less(a, b), less(c, d)), more(more(a, b), more(c, d))))
}

impl Scalar for Enclosed {
    fn exact(x: f64) -> Enclosed {
        Enclosed::new(x, x, 0.0)
    }

    fn rounded(x: f64) -> Enclosed {
        let error = 2.0 * ULP * x.abs();
        Enclosed::new((x - error).next_down(), (x + error).next_up(), error)
    }

    fn constant(x: Double) -> Enclosed {
        Enclosed::rounded(x.nearest())
    }

    fn is_sound(self) -> bool {
        self.low.is_finite() && self.high.is_finite() && self.error.is_finite()
    }

    fn sin_cos(self) -> (Enclosed, Enclosed) {
        if !self.is_sound() {
            return (Enclosed::UNDEFINED, Enclosed::UNDEFINED);
        }
        let range = |f: fn(f64) -> f64, top: f64| {
            let (a, b) = (f(self.low), f(self.high));
            let high = if self.may_meet(top) { 1.0 } else { a.max(b) };
            let low = if self.may_meet(top + std::f64::consts::PI) { -1.0 } else { a.min(b) };
            Enclosed::function(low, high, self.error)
        };
        (range(libm::sin, std::f64::consts::FRAC_PI_2), range(libm::cos, 0.0))
    }

    fn exp(self) -> Enclosed {
        self.rising(libm::exp, libm::exp(self.high + self.error))
    }

    fn ln(self) -> Enclosed {
        let smallest = self.low - self.error;
        if smallest > 0.0 { self.rising(libm::log, 1.0 / smallest) } else { Enclosed::UNDEFINED }
    }

    fn sqrt(self) -> Enclosed {
        let smallest = self.low - self.error;
        if smallest > 0.0 { self.rising(libm::sqrt, 0.5 / libm::sqrt(smallest)) } else { Enclosed::UNDEFINED }
    }

    fn asin(self) -> Enclosed {
        let most = self.magnitude() + self.error;
        // 1 − x² as a product, which keeps its digits near 1.
        let root = libm::sqrt((1.0 - most) * (1.0 + most));
        if root > 0.0 { self.rising(libm::asin, 1.0 / root) } else { Enclosed::UNDEFINED }
    }

    fn atan(self) -> Enclosed {
        self.rising(libm::atan, 1.0)
    }

    fn tanh(self) -> Enclosed {
        self.rising(libm::tanh, 1.0)
    }

    fn power(self, exponent: f64) -> Enclosed {
        let smallest = self.low - self.error;
        if smallest.is_nan() || smallest <= 0.0 {
            return Enclosed::UNDEFINED;
        }
        let slope = |x: f64| (exponent * libm::pow(x, exponent - 1.0)).abs();
        let steepest = slope(smallest).max(slope(self.high + self.error));
        let (a, b) = (libm::pow(self.low, exponent), libm::pow(self.high, exponent));
        Enclosed::function(a.min(b), a.max(b), self.error * steepest * (1.0 + 16.0 * ULP))
    }
}
