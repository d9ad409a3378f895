//! What polynomials, sinusoids, formulas and their sums are to 106 bits.

use super::scalar::Scalar;
use super::series::{self, Series};
use super::tree::{Condition, Expression, Function, Operation, Test};
use crate::Time;
use crate::law::accurate::Accurate;
use crate::law::double::{Double, ULP};
use crate::law::joint::Joint;
use std::sync::Arc;

/// Σ factor·term(u + later) + offset: the same θ as the curve that it belongs to, for where f64 is not exact enough.
#[derive(Clone, Debug, PartialEq)]
pub struct Terms {
    terms: Vec<Term>,
    offset: Accurate,
}

#[derive(Clone, Debug, PartialEq)]
struct Term {
    source: Basis,
    factor: Accurate,
    later: Double,
}

#[derive(Clone, Debug, PartialEq)]
enum Basis {
    /// Σ c_k t^k.
    Polynomial(Arc<[Accurate]>),
    /// cos(omega·t + phase).
    Cosine { omega: Accurate, phase: Accurate },
    /// A formula, as it is written: a power keeps its zero, which a sum of harmonics loses. Its branches are decided where t is `middle`.
    Formula { tree: Expression, middle: Accurate },
    /// Others in another time, Σ c_k u^k.
    Warped { terms: Box<Terms>, time: Arc<[Accurate]> },
    /// The angle of a robot's arm, steps, its effector being at these coordinates.
    Joint { joint: Joint, tip: Arc<[Terms; 3]> },
    /// old + weight·(new − old), the weight being Σ c_k u^k.
    Faded { old: Box<Terms>, new: Box<Terms>, weight: Arc<[Accurate]> },
}

/// Value and slope.
type Dual = Series<Accurate, 2>;

impl Terms {
    fn one(source: Basis, factor: Accurate, later: Double) -> Terms {
        Terms { terms: vec![Term { source, factor, later }], offset: Accurate::ZERO }
    }

    /// A window of a formula from `start` to `end`, less `origin`.
    pub(super) fn of_formula(tree: &Expression, start: Time, end: Time, origin: i64) -> Terms {
        let middle = Accurate::of(Double::from(start) + Double::from(end - start) * Double::from(0.5));
        let source = Basis::Formula { tree: tree.clone(), middle };
        let mut terms = Terms::one(source, Accurate::ONE, Double::from(start));
        terms.raise(-Double::from(origin));
        terms
    }

    /// Of a polynomial whose coefficients may be off by three roundings, but where it is at rest at u = 0: there its position is exact.
    pub(crate) fn of_polynomial(c: &[f64]) -> Terms {
        let rests = c.get(1).is_none_or(|&speed| speed == 0.0);
        let coefficient = |(k, &c): (usize, &f64)| {
            let error = if rests && k == 0 { 0.0 } else { 3.0 * ULP * c.abs() };
            Accurate { value: Double::from(c), error }
        };
        let c = c.iter().enumerate().map(coefficient).collect();
        Terms::one(Basis::Polynomial(c), Accurate::ONE, Double::ZERO)
    }

    /// speed·t from `start` on, less `origin`.
    pub(crate) fn of_line(speed: f64, start: Time, origin: i64) -> Terms {
        let line = Basis::Polynomial([Accurate::ZERO, Accurate::from(speed)].into());
        let mut terms = Terms::one(line, Accurate::ONE, Double::from(start));
        terms.raise(-Double::from(origin));
        terms
    }

    /// These terms in another time, Σ c_k u^k.
    pub(crate) fn warped(self, time: [Accurate; 5]) -> Terms {
        Terms::one(Basis::Warped { terms: Box::new(self), time: time.into() }, Accurate::ONE, Double::ZERO)
    }

    /// These terms, which change into others: old + weight·(new − old), the weight being Σ c_k u^k.
    pub(crate) fn faded(self, new: Terms, weight: [Accurate; 6]) -> Terms {
        let (old, new) = (Box::new(self), Box::new(new));
        Terms::one(Basis::Faded { old, new, weight: weight.into() }, Accurate::ONE, Double::ZERO)
    }

    /// The angle of a robot's arm, steps, its effector being at these coordinates.
    pub(crate) fn of_joint(joint: Joint, tip: [Terms; 3]) -> Terms {
        Terms::one(Basis::Joint { joint, tip: Arc::new(tip) }, Accurate::ONE, Double::ZERO)
    }

    /// Of offset + amplitude·cos(omega·u + phase) with just these numbers.
    pub(crate) fn of_cosine(offset: f64, amplitude: f64, omega: f64, phase: f64) -> Terms {
        let source = Basis::Cosine { omega: Accurate::from(omega), phase: Accurate::from(phase) };
        let mut terms = Terms::one(source, Accurate::from(amplitude), Double::ZERO);
        terms.raise(Double::from(offset));
        terms
    }

    /// Both.
    pub(crate) fn and(mut self, other: Terms) -> Terms {
        self.terms.extend(other.terms);
        self.offset = self.offset + other.offset;
        self
    }

    /// Value less `level`, which is the sum of its parts, and slope; what is undefined is not a number.
    pub(crate) fn at(&self, u: f64, level: &[f64]) -> [Accurate; 2] {
        self.along([Accurate::from(u), Accurate::ONE], level)
    }

    fn along(&self, u: Dual, level: &[f64]) -> Dual {
        // The level is subtracted first, which is exact. Near the level the difference is small, and so is its rounding.
        let offset = level.iter().fold(self.offset, |rest, &part| rest - Accurate::from(part));
        let mut sum = [offset, Accurate::ZERO];
        for Term { source, factor, later } in &self.terms {
            let t = [u[0] + Accurate::of(*later), u[1]];
            let own = match source {
                Basis::Polynomial(c) => polynomial(c, &t),
                Basis::Cosine { omega, phase } => series::sin_cos(&[*omega * t[0] + *phase, *omega * t[1]]).1,
                Basis::Formula { tree, middle } => tree.at(&t, *middle),
                Basis::Warped { terms, time } => terms.along(polynomial(time, &t), &[]),
                Basis::Joint { joint, tip } => joint.steps(&tip.each_ref().map(|terms| terms.along(t, &[]))),
                Basis::Faded { old, new, weight } => {
                    let (old, new) = (old.along(t, &[]), new.along(t, &[]));
                    let difference = plus(&new, &old.map(|old| -old));
                    plus(&old, &series::multiply(&polynomial(weight, &t), &difference))
                }
            };
            sum = plus(&sum, &own.map(|own| *factor * own));
        }
        sum
    }

    pub(crate) fn raise(&mut self, steps: Double) {
        self.offset = self.offset + Accurate::exact(steps);
    }

    pub(crate) fn scale(&mut self, by: f64) {
        let by = Accurate::from(by);
        self.offset = self.offset * by;
        self.terms.iter_mut().for_each(|term| term.factor = term.factor * by);
    }

    pub(crate) fn rezero(&mut self, by: Double) {
        self.terms.iter_mut().for_each(|term| term.later = term.later + by);
    }
}

fn polynomial(c: &[Accurate], t: &Dual) -> Dual {
    c.iter().rev().fold([Accurate::ZERO; 2], |sum, &c| plus(&series::multiply(&sum, t), &constant(c)))
}

fn constant(c: Accurate) -> Dual {
    [c, Accurate::ZERO]
}

fn plus(a: &Dual, b: &Dual) -> Dual {
    [a[0] + b[0], a[1] + b[1]]
}

/// A constant whole number that is small enough to be a power.
fn whole(x: &Dual) -> Option<i32> {
    let n = x[0].nearest();
    let is_exact = x[1].is_nothing() && x[0].error == 0.0 && x[0].value.lo == 0.0;
    (is_exact && n.fract() == 0.0 && n.abs() <= 64.0).then_some(n as i32)
}

impl Expression {
    /// Value and slope at `t`, its branches decided at `middle`.
    fn at(&self, t: &Dual, middle: Accurate) -> Dual {
        let of = |node: &Expression| node.at(t, middle);
        match &*self.kind {
            Operation::Number(c) => constant(Accurate::of(*c)),
            Operation::Time => *t,
            Operation::Add(a, b) => plus(&of(a), &of(b)),
            Operation::Subtract(a, b) => plus(&of(a), &of(b).map(|b| -b)),
            Operation::Multiply(a, b) => series::multiply(&of(a), &of(b)),
            Operation::Divide(a, b) => series::divide(&of(a), &of(b)),
            Operation::Power(a, b) => {
                let (base, exponent) = (of(a), of(b));
                match whole(&exponent) {
                    Some(n) => {
                        let power = series::whole_power(&base, n.unsigned_abs());
                        if n < 0 { series::divide(&constant(Accurate::ONE), &power) } else { power }
                    }
                    None => series::exp(&series::multiply(&exponent, &series::ln(&base))),
                }
            }
            Operation::Apply(function, a) => {
                let x = of(a);
                match function {
                    Function::Negative => x.map(|x| -x),
                    Function::Sine => series::sin_cos(&x).0,
                    Function::Cosine => series::sin_cos(&x).1,
                    Function::Exponential => series::exp(&x),
                    Function::Logarithm => series::ln(&x),
                    Function::Root => series::sqrt(&x),
                    Function::Arcsine => series::asin(&x),
                    Function::Arctangent => series::atan(&x),
                    Function::HyperbolicTangent => series::tanh(&x),
                }
            }
            Operation::Floor(a) => constant(Accurate::exact(a.in_middle(middle).floor())),
            Operation::If(condition, a, b) => of(if condition.holds(middle) { a } else { b }),
        }
    }

    fn in_middle(&self, middle: Accurate) -> Double {
        self.at(&constant(middle), middle)[0].value
    }
}

impl Condition {
    /// In the middle of a window, all of which it holds for if there.
    fn holds(&self, middle: Accurate) -> bool {
        match self {
            Condition::Not(inner) => !inner.holds(middle),
            Condition::And(pair) => pair.0.holds(middle) && pair.1.holds(middle),
            Condition::Or(pair) => pair.0.holds(middle) || pair.1.holds(middle),
            Condition::Is(test, node) => {
                let value = node.in_middle(middle).nearest();
                match test {
                    Test::Positive => value > 0.0,
                    Test::NotNegative => value >= 0.0,
                    Test::Zero => value == 0.0,
                }
            }
        }
    }
}

impl Scalar for Accurate {
    fn exact(x: f64) -> Accurate {
        Accurate::from(x)
    }

    fn rounded(x: f64) -> Accurate {
        Accurate { value: Double::from(x), error: ULP * x.abs() }
    }

    fn constant(x: Double) -> Accurate {
        Accurate::of(x)
    }

    fn is_sound(self) -> bool {
        self.is_finite()
    }

    fn sin_cos(self) -> (Accurate, Accurate) {
        Accurate::sin_cos(self)
    }

    fn exp(self) -> Accurate {
        Accurate::exp(self)
    }

    fn ln(self) -> Accurate {
        Accurate::ln(self)
    }

    fn sqrt(self) -> Accurate {
        Accurate::sqrt(self)
    }

    fn asin(self) -> Accurate {
        Accurate::asin(self)
    }

    fn atan(self) -> Accurate {
        Accurate::atan(self)
    }

    fn tanh(self) -> Accurate {
        Accurate::tanh(self)
    }

    fn power(self, exponent: f64) -> Accurate {
        Accurate::power(self, Accurate::from(exponent))
    }
}
