//! The analytic curves that pieces are made of.

use super::accurate::Accurate;
use super::double::{Double, ULP};
use super::formula::{Terms, Window};
use super::joint::JointCurve;

/// Taylor coefficients of θ at a point: θ(u₀ + x) = Σ c_k x^k, k = 0..8, in steps per s^k.
pub type Jet = [f64; 8];

/// What is true of a curve's jets everywhere on an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// ≥ |θ⁽⁸⁾(u)|/8! for every u in the interval, steps/s^8.
    pub eighth: f64,
    /// ≥ the rounding error of coefficient k of a jet computed anywhere in the interval, steps/s^k.
    ///
    /// It covers an error of 3 × 2^-53 in each of the curve's own parameters too.
    pub rounding: Jet,
}

impl Bounds {
    /// These bounds and what no coefficient exceeds, of factor·θ + offset.
    pub(super) fn scaled(&self, majorant: Jet, factor: f64, offset: f64) -> (Bounds, Jet) {
        let factor = factor.abs();
        let mut majorant = majorant.map(|m| m * factor);
        // The factor itself, the product with it and the sum with the offset.
        let mut rounding: Jet = std::array::from_fn(|k| self.rounding[k] * factor + 5.0 * ULP * majorant[k]);
        majorant[0] += offset.abs();
        rounding[0] += 5.0 * ULP * majorant[0];
        (Bounds { eighth: self.eighth * factor * (1.0 + 16.0 * ULP), rounding }, majorant)
    }
}

/// An analytic curve θ(u), u in seconds, θ in steps.
#[derive(Clone, Debug, PartialEq)]
pub enum Curve {
    /// Σ c_k u^k: constants, lines, parabolas, cubics, Taylor polynomials.
    Polynomial(Vec<f64>),
    /// offset + amplitude·cos(omega·u + phase); omega > 0, rad/s.
    Cosine {
        /// Middle of the swing, steps.
        offset: f64,
        /// Half the swing, steps; may be negative.
        amplitude: f64,
        /// rad/s, positive.
        omega: f64,
        /// Phase at u = 0, rad.
        phase: f64,
    },
    /// x0 + factor·x with linear·x + quadratic·x² = u − u0: intervals linear in the step number (the maximum-speed article's ramp).
    TimerRamp {
        /// When x is 0, s.
        u0: f64,
        /// θ when x is 0, steps.
        x0: f64,
        /// Steps per x: ±1 unless scaled.
        factor: f64,
        /// s, positive.
        linear: f64,
        /// s.
        quadratic: f64,
    },
    /// One window of a formula.
    Formula(Window),
    /// A robot's arm, whose effector follows three curves.
    Joint(JointCurve),
    /// All of them together.
    Sum(Vec<Curve>),
    /// A curve of which more is known than f64 holds.
    Accurate {
        /// The curve.
        curve: Box<Curve>,
        /// Its terms, to 106 bits.
        terms: Terms,
    },
    /// A curve in another time: curve(Σ c_k u^k).
    Warped {
        /// The curve, against its own time.
        curve: Box<Curve>,
        /// Its own time against u, s/s^k; it does not fall where the curve is used.
        time: [f64; 5],
    },
    /// A curve that changes into another one: old + weight·(new − old).
    Faded {
        /// The curve at weight 0.
        old: Box<Curve>,
        /// The curve at weight 1.
        new: Box<Curve>,
        /// The weight of the new curve: Σ c_k u^k, 1/s^k.
        weight: [f64; 6],
    },
}

/// A curve whose step times have a formula, on one monotone stretch: u(x), x being θ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Inverse {
    /// u = u0 + (x − x0)/speed.
    Line {
        /// A point on the line: time, s.
        u0: f64,
        /// A point on the line: position, steps.
        x0: f64,
        /// steps/s, not 0.
        speed: f64,
    },
    /// θ = x0 + half_acceleration·(u − u0)²; `later` is the branch u ≥ u0.
    Parabola {
        /// Turning point: time, s.
        u0: f64,
        /// Turning point: position, steps.
        x0: f64,
        /// Half the acceleration, steps/s², not 0.
        half_acceleration: f64,
        /// Which side of the turning point.
        later: bool,
        /// How far rounding may have put x0 off, steps; 0 where the law begins or ends at its turning point.
        doubt: f64,
    },
    /// Half a period of a sinusoid, leaving the turning point (u0, x0) for (u0 + π/omega, x0 + swing).
    Arccosine {
        /// Turning point where the half period begins: time, s.
        u0: f64,
        /// Turning point where the half period begins: position, steps.
        x0: f64,
        /// Signed distance to the other turning point, steps.
        swing: f64,
        /// rad/s.
        omega: f64,
        /// How far rounding has put x0 off, steps; 0 for a sine from its bottom.
        doubt: f64,
    },
    /// u = Σ c_k (x − x0)^k with k ≤ 2: intervals linear in the step number (the maximum-speed article's ramp).
    Quadratic {
        /// Position of the expansion, steps.
        x0: f64,
        /// Coefficients, s, s/step, s/step².
        c: [f64; 3],
    },
}

/// Covers the roundings of the bounds' own arithmetic, which is of terms of one sign.
const OUTWARD: f64 = 1.0 + 256.0 * ULP;

/// How far, in parts of it, a stretch may reach over a turning point and still count as one side of it.
const OVERHANG: f64 = 1e-9;

/// A parabola is inverted about its turning point if that is no farther from u = 0 than this, s, or than twice what is used of it.
///
/// Rounding then costs some 4 × 2^-53 of the distance, less than 10^-12 s. Beyond, a series of the curve costs less.
const FARTHEST_TURN_S: f64 = 1024.0;

/// C(½, k), k = 0..=8.
const HALF_CHOOSE: [f64; 9] =
    [1.0, 0.5, -0.125, 0.0625, -0.039_062_5, 0.027_343_75, -0.020_507_812_5, 0.016_113_281_25, -0.013_092_041_015_625];

impl Curve {
    /// A curve that stays at `position`.
    pub(crate) fn constant(position: f64) -> Curve {
        Curve::Polynomial(vec![position])
    }

    /// θ at u, steps.
    #[must_use]
    pub fn value(&self, u: f64) -> f64 {
        match self {
            Curve::Polynomial(c) => c.iter().rev().fold(0.0, |sum, &c| sum * u + c),
            Curve::Cosine { offset, amplitude, omega, phase } => offset + amplitude * libm::cos(omega * u + phase),
            Curve::TimerRamp { u0, x0, factor, linear, quadratic } => {
                let w = u - u0;
                x0 + factor * 2.0 * w / (linear + ramp_root(*linear, *quadratic, w))
            }
            Curve::Formula(window) => window.value(u),
            Curve::Joint(joint) => joint.value(u),
            Curve::Sum(curves) => curves.iter().map(|c| c.value(u)).sum(),
            Curve::Accurate { curve, .. } => curve.value(u),
            Curve::Warped { curve, time } => curve.value(expand::<1>(time.iter().copied(), u)[0]),
            Curve::Faded { old, new, weight } => {
                let from = old.value(u);
                from + expand::<1>(weight.iter().copied(), u)[0] * (new.value(u) - from)
            }
        }
    }

    /// Of a curve that is provably at rest at u = 0: θ there, what it has moved by u, and what rounding does to that, steps.
    ///
    /// Near there this is more exact than the difference of two values.
    #[must_use]
    pub fn moved_from_rest(&self, u: f64) -> Option<(f64, f64, f64)> {
        let Curve::Polynomial(c) = self else { return None };
        let (&[x0, 0.0], rest) = c.split_first_chunk()? else { return None };
        let sum = |c: fn(f64) -> f64, u: f64| rest.iter().rev().fold(0.0, |sum, &own| (sum * u) + c(own)) * u * u;
        let rounding = (2 * c.len() + 5) as f64 * ULP * OUTWARD * sum(f64::abs, u.abs()) + f64::MIN_POSITIVE;
        Some((x0, sum(|c| c, u), rounding))
    }

    /// This curve, with its terms if they are known.
    pub(crate) fn accurate_by(self, terms: Option<Terms>) -> Curve {
        match terms {
            Some(terms) => Curve::Accurate { curve: Box::new(self), terms },
            None => self,
        }
    }

    /// This curve without its terms, in f64 alone.
    pub(crate) fn plain(self) -> Curve {
        match self {
            Curve::Accurate { curve, .. } => *curve,
            plain => plain,
        }
    }

    /// Value less `level` and slope to 106 bits, where more is known than f64 holds.
    fn accurate(&self, u: f64, level: &[f64]) -> Option<[Accurate; 2]> {
        match self {
            Curve::Accurate { terms, .. } => Some(terms.at(u, level)),
            _ => None,
        }
    }

    /// Whether more is known than f64 holds.
    #[must_use]
    pub fn is_accurate(&self) -> bool {
        matches!(self, Curve::Accurate { .. })
    }

    /// θ at u as the exact sum of two numbers, steps: the second is 0 where no more is known than f64 holds.
    #[must_use]
    pub fn split_value(&self, u: f64) -> (f64, f64) {
        self.accurate(u, &[])
            .filter(|[value, _]| value.is_finite())
            .map_or((self.value(u), 0.0), |[Accurate { value, .. }, _]| (value.hi, value.lo))
    }

    /// How far θ at u is beyond `level`, which is the sum of its parts, and how far that may be off, steps; `None` where no more is known
    /// than f64 holds.
    ///
    /// Where a law hardly moves this is more exact than the difference of two values.
    #[must_use]
    pub fn beyond(&self, u: f64, level: [f64; 3]) -> Option<(f64, f64)> {
        if_finite(self.accurate(u, &level)?[0])
    }

    /// The speed at u, and how far that may be off, steps/s; `None` where no more is known than f64 holds.
    #[must_use]
    pub fn accurate_speed(&self, u: f64) -> Option<(f64, f64)> {
        if_finite(self.accurate(u, &[])?[1])
    }

    /// This curve as terms of 106 bits, if it can be had so.
    pub(crate) fn terms(&self) -> Option<Terms> {
        match self {
            Curve::Polynomial(c) => Some(Terms::of_polynomial(c)),
            Curve::Cosine { offset, amplitude, omega, phase } => {
                Some(Terms::of_cosine(*offset, *amplitude, *omega, *phase))
            }
            Curve::Sum(curves) => curves.iter().map(Curve::terms).reduce(|a, b| Some(a?.and(b?)))?,
            Curve::Accurate { terms, .. } => Some(terms.clone()),
            Curve::Formula(_)
            | Curve::Joint(_)
            | Curve::TimerRamp { .. }
            | Curve::Warped { .. }
            | Curve::Faded { .. } => None,
        }
    }

    /// The Taylor coefficients at u.
    #[must_use]
    pub fn jet(&self, u: f64) -> Jet {
        self.taylor(u)
    }

    /// The first N coefficients of [`jet`](Curve::jet).
    pub(super) fn taylor<const N: usize>(&self, u: f64) -> [f64; N] {
        let mut jet = [0.0; N];
        self.add_jet(u, &mut jet);
        jet
    }

    fn add_jet<const N: usize>(&self, u: f64, jet: &mut [f64; N]) {
        match self {
            Curve::Polynomial(c) => {
                let own: [f64; N] = expand(c.iter().copied(), u);
                jet.iter_mut().zip(own).for_each(|(jet, own)| *jet += own);
            }
            Curve::Cosine { offset, amplitude, omega, phase } => {
                let (sin, cos) = libm::sincos(omega * u + phase);
                jet[0] += offset + amplitude * cos;
                let mut scale = *amplitude;
                for (k, jet) in jet.iter_mut().enumerate().skip(1) {
                    scale *= omega * RECIPROCAL[k];
                    // cos → −sin → −cos → sin
                    *jet += scale
                        * match k % 4 {
                            1 => -sin,
                            2 => -cos,
                            3 => sin,
                            _ => cos,
                        };
                }
            }
            Curve::TimerRamp { u0, x0, factor, linear, quadratic } => {
                let w = u - u0;
                let s = ramp_root(*linear, *quadratic, w);
                jet[0] += x0 + factor * 2.0 * w / (linear + s);
                let mut scale = 2.0 * factor / s;
                for (jet, choose) in jet.iter_mut().zip(HALF_CHOOSE).skip(1) {
                    *jet += choose * scale;
                    scale *= 4.0 * quadratic / (s * s);
                }
            }
            Curve::Formula(window) => {
                jet.iter_mut().zip(window.taylor::<N>(u)).for_each(|(jet, own)| *jet += own);
            }
            Curve::Joint(joint) => jet.iter_mut().zip(joint.taylor::<N>(u)).for_each(|(jet, own)| *jet += own),
            Curve::Sum(curves) => curves.iter().for_each(|c| c.add_jet(u, jet)),
            Curve::Accurate { curve, .. } => curve.add_jet(u, jet),
            Curve::Warped { curve, time } => {
                let time: [f64; N] = expand(time.iter().copied(), u);
                let own = composed(&curve.taylor(time[0]), &time);
                jet.iter_mut().zip(own).for_each(|(jet, own)| *jet += own);
            }
            Curve::Faded { old, new, weight } => {
                let (from, to): ([f64; N], [f64; N]) = (old.taylor(u), new.taylor(u));
                let weight: [f64; N] = expand(weight.iter().copied(), u);
                for (k, jet) in jet.iter_mut().enumerate() {
                    *jet += from[k] + (0..=k).map(|i| weight[i] * (to[k - i] - from[k - i])).sum::<f64>();
                }
            }
        }
    }

    /// What holds for every jet taken in `a..=b`.
    #[must_use]
    pub fn bounds(&self, a: f64, b: f64) -> Bounds {
        self.bounds_and_majorant(a, b).0
    }

    /// The bounds, and what no coefficient of a jet in `a..=b` exceeds.
    pub(super) fn bounds_and_majorant(&self, a: f64, b: f64) -> (Bounds, Jet) {
        let reach = a.abs().max(b.abs());
        let mut bounds = Bounds { eighth: 0.0, rounding: [0.0; 8] };
        let mut majorant = [0.0; 8];
        match self {
            Curve::Polynomial(c) => {
                let expanded: [f64; 9] = expand(c.iter().map(|c| c.abs()), reach);
                for k in 0..8 {
                    majorant[k] = expanded[k] * OUTWARD;
                    // A product and a sum for each degree, of terms of one sign in the majorant.
                    bounds.rounding[k] = (2 * c.len() + 5) as f64 * ULP * majorant[k];
                }
                bounds.eighth = expanded[8] * OUTWARD;
            }
            Curve::Cosine { offset, amplitude, omega, phase } => {
                // The argument: omega and phase themselves, the product, the sum; sin and cos are within 1 ulp.
                let argument = 6.0 * ULP * (omega * reach + phase.abs());
                let mut scale = amplitude.abs() * OUTWARD;
                majorant[0] = offset.abs() + scale;
                bounds.rounding[0] = scale * (argument + 7.0 * ULP) + 5.0 * ULP * majorant[0];
                for k in 1..8 {
                    scale *= omega * RECIPROCAL[k];
                    majorant[k] = scale;
                    bounds.rounding[k] = scale * (argument + (6 * k + 7) as f64 * ULP);
                }
                bounds.eighth = scale * omega * RECIPROCAL[8] * OUTWARD;
            }
            Curve::TimerRamp { u0, x0, factor, linear, quadratic } => {
                // s² = linear² + 4·quadratic·w is linear in w: least at one of the ends.
                let far = (a - u0).abs().max((b - u0).abs());
                let s = ramp_root(*linear, *quadratic, a - u0).min(ramp_root(*linear, *quadratic, b - u0));
                let terms = linear * linear + 4.0 * quadratic.abs() * (far + reach + u0.abs());
                let relative = 5.0 * ULP * terms / (s * s) + 2.0 * ULP;
                let x = 2.0 * far / (linear + s) * OUTWARD;
                majorant[0] = x0.abs() + factor.abs() * x;
                // x itself: its slope is 1/s, and w carries the rounding of u − u0.
                let argument = 5.0 * ULP * (far + reach + u0.abs()) / s;
                bounds.rounding[0] = factor.abs() * (x * (relative + 8.0 * ULP) + argument) + 5.0 * ULP * majorant[0];
                let mut scale = 2.0 * factor.abs() / s;
                for k in 1..8 {
                    majorant[k] = HALF_CHOOSE[k].abs() * scale * OUTWARD;
                    bounds.rounding[k] = majorant[k] * (2 * k) as f64 * (relative + 8.0 * ULP);
                    scale *= 4.0 * quadratic.abs() / (s * s);
                }
                // Least s is itself rounded.
                bounds.eighth = HALF_CHOOSE[8].abs() * scale * (1.0 + 16.0 * relative) * OUTWARD;
            }
            Curve::Formula(window) => (bounds, majorant) = window.bounds_and_majorant(),
            Curve::Joint(joint) => (bounds, majorant) = joint.bounds_and_majorant(),
            Curve::Sum(curves) => {
                for curve in curves {
                    let (own, own_majorant) = curve.bounds_and_majorant(a, b);
                    bounds.eighth += own.eighth;
                    for k in 0..8 {
                        bounds.rounding[k] += own.rounding[k];
                        majorant[k] += own_majorant[k];
                    }
                }
                // The additions round too: once for each term, at most of what the terms amount to.
                for (rounding, majorant) in bounds.rounding.iter_mut().zip(majorant) {
                    *rounding += (curves.len() + 1) as f64 * ULP * majorant;
                }
            }
            Curve::Accurate { curve, .. } => return curve.bounds_and_majorant(a, b),
            Curve::Warped { curve, time } => (bounds, majorant) = warped_bounds(curve, time, a, b),
            Curve::Faded { old, new, weight } => (bounds, majorant) = faded_bounds([old, new], weight, a, b),
        }
        // Gradual underflow: far below any step, but a bound is a bound.
        bounds.rounding.iter_mut().for_each(|r| *r = *r * OUTWARD + f64::MIN_POSITIVE);
        (bounds, majorant)
    }

    /// When θ is where, on the stretch `u_a..=u_b` between two turning points; `None` where there is no formula.
    #[must_use]
    pub fn inverse(&self, u_a: f64, u_b: f64) -> Option<Inverse> {
        let middle = 0.5 * (u_a + u_b);
        let overhang = OVERHANG * (u_b - u_a);
        match self {
            Curve::Polynomial(c) => match *c.get(..3.min(c.len()))? {
                _ if c.iter().skip(3).any(|&c| c != 0.0) => None,
                [x0, speed] | [x0, speed, 0.0] if speed != 0.0 => Some(Inverse::Line { u0: 0.0, x0, speed }),
                [c0, c1, half_acceleration] if half_acceleration != 0.0 => {
                    let u0 = -0.5 * c1 / half_acceleration;
                    let later = middle > u0;
                    let over = if later { u0 - u_a } else { u_b - u0 };
                    let drop = half_acceleration * u0 * u0;
                    // Not-a-number is far, too.
                    let near = u0.abs() <= (2.0 * u_a.abs().max(u_b.abs())).max(FARTHEST_TURN_S);
                    (near && over <= overhang).then_some(Inverse::Parabola {
                        u0,
                        x0: c0 - drop,
                        half_acceleration,
                        later,
                        doubt: if u0 == 0.0 { 0.0 } else { ULP * (c0.abs() + 8.0 * drop.abs()) },
                    })
                }
                _ => None,
            },
            Curve::Cosine { offset, amplitude, omega, phase } => {
                if *amplitude == 0.0 {
                    return None;
                }
                let half_periods = ((omega * middle + phase) / std::f64::consts::PI).floor();
                let u0 = (half_periods * std::f64::consts::PI - phase) / omega;
                let x = if half_periods.rem_euclid(2.0) == 0.0 { *amplitude } else { -*amplitude };
                let one_half_period = u_a >= u0 - overhang && u_b <= u0 + std::f64::consts::PI / omega + overhang;
                let x0 = offset + x;
                // What the addition lost, exactly (Knuth's two-sum).
                let back = x0 - offset;
                let doubt = ((offset - (x0 - back)) + (x - back)).abs();
                one_half_period.then_some(Inverse::Arccosine { u0, x0, swing: -2.0 * x, omega: *omega, doubt })
            }
            Curve::TimerRamp { u0, x0, factor, linear, quadratic } => {
                Some(Inverse::Quadratic { x0: *x0, c: [*u0, linear / factor, quadratic / (factor * factor)] })
            }
            Curve::Accurate { curve, .. } => curve.inverse(u_a, u_b),
            Curve::Formula(_) | Curve::Joint(_) | Curve::Sum(_) | Curve::Warped { .. } | Curve::Faded { .. } => None,
        }
    }

    /// Whether it is a window of a formula that is neither a polynomial nor a sum of sinusoids.
    pub(crate) fn is_formula(&self) -> bool {
        match self {
            Curve::Formula(_) => true,
            Curve::Accurate { curve, .. } => curve.is_formula(),
            _ => false,
        }
    }

    /// Whether θ stays where it is.
    pub(crate) fn is_constant(&self) -> bool {
        match self {
            Curve::Polynomial(c) => c.iter().skip(1).all(|&c| c == 0.0),
            Curve::Cosine { amplitude, .. } => *amplitude == 0.0,
            Curve::TimerRamp { factor, .. } => *factor == 0.0,
            Curve::Formula(_) | Curve::Joint(_) | Curve::Faded { .. } => false,
            Curve::Sum(curves) => curves.iter().all(Curve::is_constant),
            Curve::Accurate { curve, .. } | Curve::Warped { curve, .. } => curve.is_constant(),
        }
    }

    /// Adds `steps` to θ.
    pub(crate) fn raise(&mut self, steps: Double) {
        let add = |x: &mut f64| *x = (Double::from(*x) + steps).nearest();
        match self {
            Curve::Polynomial(c) => match c.first_mut() {
                Some(c) => add(c),
                None => c.push(steps.nearest()),
            },
            Curve::Cosine { offset, .. } => add(offset),
            Curve::TimerRamp { x0, .. } => add(x0),
            Curve::Formula(window) => window.raise(steps.nearest()),
            Curve::Joint(joint) => joint.raise(steps),
            Curve::Sum(curves) => match curves.iter_mut().find(|curve| matches!(curve, Curve::Polynomial(_))) {
                Some(curve) => curve.raise(steps),
                None => curves.push(Curve::constant(steps.nearest())),
            },
            Curve::Accurate { curve, terms } => {
                curve.raise(steps);
                terms.raise(steps);
            }
            Curve::Warped { curve, .. } => curve.raise(steps),
            Curve::Faded { old, new, .. } => [old, new].into_iter().for_each(|curve| curve.raise(steps)),
        }
    }

    /// Multiplies θ by `by`.
    pub(crate) fn scale(&mut self, by: f64) {
        match self {
            Curve::Polynomial(c) => c.iter_mut().for_each(|c| *c *= by),
            Curve::Cosine { offset, amplitude, .. } => {
                *offset *= by;
                *amplitude *= by;
            }
            Curve::TimerRamp { x0, factor, .. } => {
                *x0 *= by;
                *factor *= by;
            }
            Curve::Formula(window) => window.scale(by),
            Curve::Joint(joint) => joint.scale(by),
            Curve::Sum(curves) => curves.iter_mut().for_each(|c| c.scale(by)),
            Curve::Accurate { curve, terms } => {
                curve.scale(by);
                terms.scale(by);
            }
            Curve::Warped { curve, .. } => curve.scale(by),
            Curve::Faded { old, new, .. } => [old, new].into_iter().for_each(|curve| curve.scale(by)),
        }
    }

    /// Moves the zero of u `by` seconds later: the new θ(u) is the old θ(u + by).
    pub(crate) fn rezero(&mut self, by: Double) {
        if by == Double::ZERO {
            return;
        }
        match self {
            Curve::Polynomial(c) => {
                shift(c, by);
            }
            Curve::Cosine { omega, phase, .. } => {
                *phase = (Double::from(*phase) + Double::from(*omega) * by).wrapped().nearest();
            }
            Curve::TimerRamp { u0, .. } => *u0 = (Double::from(*u0) - by).nearest(),
            Curve::Formula(window) => window.rezero(by),
            Curve::Joint(joint) => joint.rezero(by),
            Curve::Sum(curves) => curves.iter_mut().for_each(|c| c.rezero(by)),
            Curve::Accurate { curve, terms } => {
                curve.rezero(by);
                terms.rezero(by);
            }
            Curve::Warped { time, .. } => {
                shift(time, by);
            }
            Curve::Faded { old, new, weight } => {
                [old, new].into_iter().for_each(|curve| curve.rezero(by));
                shift(weight, by);
            }
        }
    }
}

/// The number nearest to `x`, and how far that may be off.
fn if_finite(x: Accurate) -> Option<(f64, f64)> {
    x.is_finite().then(|| (x.nearest(), x.error + 2.0 * ULP * x.nearest().abs()))
}

/// The polynomial Σ c_k (u + by)^k in powers of u; its level also to 106 bits.
pub(crate) fn shift(c: &mut [f64], by: Double) -> Double {
    let mut exact: Vec<Double> = c.iter().map(|&c| Double::from(c)).collect();
    for k in 0..c.len() {
        for i in (k..c.len() - 1).rev() {
            exact[i] = exact[i] + by * exact[i + 1];
        }
        c[k] = exact[k].nearest();
    }
    exact.first().copied().unwrap_or(Double::ZERO)
}

/// The first `N` coefficients of Σ c_k (q_1 x + q_2 x² + …)^k, by Horner's rule on truncated series.
fn composed<const N: usize>(c: &[f64; N], q: &[f64; N]) -> [f64; N] {
    let mut sum = [0.0; N];
    for c in c.iter().rev() {
        for k in (1..N).rev() {
            sum[k] = (1..=k).map(|i| q[i] * sum[k - i]).sum();
        }
        sum[0] = *c;
    }
    sum
}

/// As [`Curve::bounds_and_majorant`], of a curve in another time.
///
/// Every coefficient of the composition is a sum of products of the curve's coefficients and the time's, with positive
/// factors: bounds on those give bounds on it, on the eighth from all up to the eighth.
fn warped_bounds(curve: &Curve, time: &[f64; 5], a: f64, b: f64) -> (Bounds, Jet) {
    let reach = a.abs().max(b.abs());
    let mut q: [f64; 9] = expand(time.iter().map(|c| c.abs()), reach);
    q.iter_mut().for_each(|q| *q *= OUTWARD);
    // Of a polynomial of degree 4: see above, and 3 roundings for its own coefficients.
    let relative = 18.0 * ULP;
    let off = relative * q[0];
    let at = |u: f64| expand::<1>(time.iter().copied(), u)[0];
    let (own, inner) = curve.bounds_and_majorant(at(a).min(at(b)) - off, at(a).max(at(b)) + off);
    let mut c = [0.0; 9];
    c[..8].copy_from_slice(&inner);
    c[8] = own.eighth;
    let all = composed(&c, &q);
    // The curve's coefficients: their own roundings, and the time at which they are taken.
    let mut doubts = [0.0; 9];
    for k in 0..8 {
        doubts[k] = own.rounding[k] + (k + 1) as f64 * c[k + 1] * off;
    }
    let doubts = composed(&doubts, &q);
    let mut bounds = Bounds { eighth: all[8] * OUTWARD, rounding: [0.0; 8] };
    let mut majorant = [0.0; 8];
    bounds.rounding[0] = doubts[0] * OUTWARD;
    majorant[0] = all[0];
    for k in 1..8 {
        majorant[k] = all[k] * OUTWARD;
        // Up to 7 factors of the time, each off by `relative`; 8 rounds of 8 products and sums.
        bounds.rounding[k] = doubts[k] * OUTWARD + majorant[k] * (8.0 * relative + 100.0 * ULP);
    }
    (bounds, majorant)
}

/// As [`Curve::bounds_and_majorant`], of old + weight·(new − old).
fn faded_bounds([old, new]: [&Curve; 2], weight: &[f64; 6], a: f64, b: f64) -> (Bounds, Jet) {
    let reach = a.abs().max(b.abs());
    let mut w: [f64; 9] = expand(weight.iter().map(|c| c.abs()), reach);
    w.iter_mut().for_each(|w| *w *= OUTWARD);
    // Of a polynomial of degree 5: a product and a sum for each degree, and 3 roundings for its own coefficients.
    let relative = 20.0 * ULP;
    let ((from, from_majorant), (to, to_majorant)) = (old.bounds_and_majorant(a, b), new.bounds_and_majorant(a, b));
    // The difference of both, its coefficient 8 and its roundings.
    let mut d = [0.0; 9];
    let mut doubt = [0.0; 9];
    for k in 0..8 {
        d[k] = (from_majorant[k] + to_majorant[k]) * OUTWARD;
        doubt[k] = from.rounding[k] + to.rounding[k] + ULP * d[k];
    }
    d[8] = (from.eighth + to.eighth) * OUTWARD;
    let products = |of: &[f64; 9], k: usize| (0..=k).map(|i| w[i] * of[k - i]).sum::<f64>();
    let mut bounds = Bounds { eighth: (from.eighth + products(&d, 8)) * OUTWARD, rounding: [0.0; 8] };
    let mut majorant = [0.0; 8];
    for k in 0..8 {
        let moved = products(&d, k);
        majorant[k] = (from_majorant[k] + moved) * OUTWARD;
        // Up to 8 products and as many sums.
        bounds.rounding[k] =
            from.rounding[k] + products(&doubt, k) + moved * (relative + 20.0 * ULP) + 4.0 * ULP * majorant[k];
    }
    (bounds, majorant)
}

/// 1/k, since a product takes less time than a quotient.
pub(crate) const RECIPROCAL: [f64; 9] =
    [0.0, 1.0, 1.0 / 2.0, 1.0 / 3.0, 1.0 / 4.0, 1.0 / 5.0, 1.0 / 6.0, 1.0 / 7.0, 1.0 / 8.0];

/// √(linear² + 4·quadratic·w), the time per step at w.
fn ramp_root(linear: f64, quadratic: f64, w: f64) -> f64 {
    libm::sqrt((linear * linear + 4.0 * quadratic * w).max(0.0))
}

/// The first `N` Taylor coefficients at u of a polynomial, by Horner's rule on truncated series: nothing is allocated.
fn expand<const N: usize>(c: impl DoubleEndedIterator<Item = f64>, u: f64) -> [f64; N] {
    let mut jet = [0.0; N];
    for (degree, c) in c.rev().enumerate() {
        for k in (1..N.min(degree + 1)).rev() {
            jet[k] = jet[k] * u + jet[k - 1];
        }
        jet[0] = jet[0] * u + c;
    }
    jet
}
