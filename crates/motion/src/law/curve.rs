//! The analytic curves that pieces are made of.

/// Taylor coefficients of θ at a point: θ(u₀ + x) = Σ c_k x^k, k = 0..8, in steps per s^k.
pub type Jet = [f64; 8];

/// What is true of a curve's jets everywhere on an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// ≥ |θ⁽⁸⁾(u)|/8! for every u in the interval, steps/s^8.
    pub eighth: f64,
    /// ≥ the rounding error of coefficient k of a jet computed anywhere in the interval, steps/s^k.
    pub rounding: Jet,
}

/// An analytic curve θ(u), u in seconds, θ in steps.
#[derive(Clone, Debug)]
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
    /// All of them together.
    Sum(Vec<Curve>),
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
    },
    /// Half a period of a sinusoid, leaving the turning point (u0, x0) for (u0 + π/omega, x0 + swing).
    Arccosine {
        /// Turning point where the half period begins: time, s.
        u0: f64,
        /// The same: position, steps.
        x0: f64,
        /// Signed distance to the other turning point, steps.
        swing: f64,
        /// rad/s.
        omega: f64,
    },
    /// u = Σ c_k (x − x0)^k with k ≤ 2: intervals linear in the step number (004's ramp).
    Quadratic {
        /// Position of the expansion, steps.
        x0: f64,
        /// Coefficients, s, s/step, s/step².
        c: [f64; 3],
    },
}

/// 2^-53: the relative error of one rounding.
const ULP: f64 = f64::EPSILON / 2.0;

impl Curve {
    /// θ at u, steps.
    #[must_use]
    pub fn value(&self, u: f64) -> f64 {
        match self {
            Curve::Polynomial(c) => c.iter().rev().fold(0.0, |sum, &c| sum * u + c),
            Curve::Cosine { offset, amplitude, omega, phase } => offset + amplitude * libm::cos(omega * u + phase),
            Curve::Sum(curves) => curves.iter().map(|c| c.value(u)).sum(),
        }
    }

    /// The Taylor coefficients at u.
    #[must_use]
    pub fn jet(&self, u: f64) -> Jet {
        let mut jet = [0.0; 8];
        self.add_jet(u, &mut jet);
        jet
    }

    fn add_jet(&self, u: f64, jet: &mut Jet) {
        match self {
            Curve::Polynomial(c) => {
                // Taylor shift by repeated synthetic division.
                let mut c = c.clone();
                for (k, jet) in jet.iter_mut().enumerate().take(c.len()) {
                    for i in (k..c.len() - 1).rev() {
                        c[i] += u * c[i + 1];
                    }
                    *jet += c[k];
                }
            }
            Curve::Cosine { offset, amplitude, omega, phase } => {
                let (sin, cos) = libm::sincos(omega * u + phase);
                jet[0] += offset + amplitude * cos;
                let mut scale = *amplitude;
                for (k, jet) in jet.iter_mut().enumerate().skip(1) {
                    scale *= omega / k as f64;
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
            Curve::Sum(curves) => curves.iter().for_each(|c| c.add_jet(u, jet)),
        }
    }

    /// What holds for every jet taken in `a..=b`.
    #[must_use]
    pub fn bounds(&self, a: f64, b: f64) -> Bounds {
        let reach = a.abs().max(b.abs());
        match self {
            Curve::Polynomial(c) => {
                let mut bounds = Bounds { eighth: 0.0, rounding: [0.0; 8] };
                let majorant: Vec<f64> = c.iter().map(|c| c.abs()).collect();
                let shifted = taylor_shift(&majorant, reach);
                for (k, m) in shifted.iter().enumerate() {
                    if k < 8 {
                        // Each coefficient comes from at most len² products and sums of terms of one sign in the majorant.
                        bounds.rounding[k] = 2.0 * (c.len() + 1) as f64 * ULP * m;
                    }
                }
                // θ⁽⁸⁾/8! on the interval, from the shifted majorant's coefficient of x^8.
                bounds.eighth = shifted.get(8).copied().unwrap_or(0.0) * (1.0 + 64.0 * ULP);
                bounds
            }
            Curve::Cosine { offset, amplitude, omega, phase } => {
                // The argument is rounded twice; sin and cos are within 1 ulp; the scale within 2k roundings.
                let argument = 2.0 * ULP * (omega * reach + phase.abs());
                let mut scale = amplitude.abs();
                let mut bounds = Bounds { eighth: 0.0, rounding: [0.0; 8] };
                bounds.rounding[0] = scale * (argument + 4.0 * ULP) + ULP * (offset.abs() + amplitude.abs());
                for k in 1..8 {
                    scale *= omega / k as f64;
                    bounds.rounding[k] = scale * (argument + (2 * k + 4) as f64 * ULP);
                }
                bounds.eighth = scale * omega / 8.0 * (1.0 + 64.0 * ULP);
                bounds
            }
            Curve::Sum(curves) => {
                let mut sum = Bounds { eighth: 0.0, rounding: [0.0; 8] };
                for curve in curves {
                    let bounds = curve.bounds(a, b);
                    sum.eighth += bounds.eighth;
                    for (total, r) in sum.rounding.iter_mut().zip(bounds.rounding) {
                        *total += r;
                    }
                }
                // The additions themselves round: one for each term, of at most what the terms amount to.
                let swing: f64 = curves.iter().map(|c| c.value(a).abs().max(c.value(b).abs())).sum();
                sum.rounding[0] += curves.len() as f64 * ULP * swing;
                sum
            }
        }
    }
}

fn taylor_shift(c: &[f64], u: f64) -> Vec<f64> {
    let mut c = c.to_vec();
    for k in 0..c.len() {
        for i in (k..c.len() - 1).rev() {
            c[i] += u * c[i + 1];
        }
    }
    c
}
impl Curve {
    /// tmp
    pub fn inverse(&self, from: f64, to: f64) -> Option<Inverse> {
        match self {
            Curve::Cosine { offset, amplitude, omega, phase }
                if *phase == 0.0 && from >= 0.0 && to * omega <= std::f64::consts::PI * (1.0 + 1e-12) =>
            {
                Some(Inverse::Arccosine { u0: 0.0, x0: offset + amplitude, swing: -2.0 * amplitude, omega: *omega })
            }
            Curve::Polynomial(c) if c.len() == 2 => Some(Inverse::Line { u0: 0.0, x0: c[0], speed: c[1] }),
            _ => None,
        }
    }
}
