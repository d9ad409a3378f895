//! Polynomials plus sinusoids of t, with coefficients of 106 bits: what most formulas come down to.

use super::tree::Function;
use crate::Time;
use crate::law::Curve;
use crate::law::double::Double;

/// Σ c_k t^k + Σ amplitude·cos(omega·t + phase).
#[derive(Clone, Debug, Default)]
pub(super) struct Form {
    pub(super) polynomial: Vec<Double>,
    pub(super) harmonics: Vec<Harmonic>,
}

/// omega > 0, rad/s.
#[derive(Clone, Copy, Debug)]
pub(super) struct Harmonic {
    pub(super) amplitude: Double,
    pub(super) omega: Double,
    pub(super) phase: Double,
}

const HIGHEST_DEGREE: usize = 16;
const MOST_HARMONICS: usize = 64;

impl Form {
    pub(super) fn constant(c: Double) -> Form {
        Form { polynomial: vec![c], harmonics: Vec::new() }
    }

    /// The value of a form without t.
    pub(super) fn as_constant(&self) -> Option<Double> {
        let still = self.harmonics.is_empty() && self.polynomial.iter().skip(1).all(|c| c.hi == 0.0);
        still.then(|| self.polynomial.first().copied().unwrap_or(Double::ZERO))
    }

    /// θ = t.
    pub(super) fn time() -> Form {
        Form { polynomial: vec![Double::ZERO, Double::ONE], harmonics: Vec::new() }
    }

    /// Whether it is a constant speed, or none.
    pub(super) fn is_line(&self) -> bool {
        self.harmonics.is_empty() && self.polynomial.iter().skip(2).all(|c| c.hi == 0.0)
    }

    /// To a constant power, if that is a form.
    pub(super) fn power(&self, exponent: Double) -> Option<Form> {
        let n = exponent.nearest();
        if n.fract() == 0.0 && n.abs() <= HIGHEST_DEGREE as f64 {
            let power = (0..n.abs() as usize).try_fold(Form::constant(Double::ONE), |p, _| p.product(self))?;
            return if n < 0.0 { Form::constant(Double::ONE).divided(power.as_constant()?) } else { Some(power) };
        }
        self.as_constant().map(|base| Form::constant(Double::from(libm::pow(base.nearest(), n))))
    }

    pub(super) fn is_finite(&self) -> bool {
        self.polynomial.iter().all(|c| c.is_finite())
            && self.harmonics.iter().all(|h| h.amplitude.is_finite() && h.omega.is_finite() && h.phase.is_finite())
    }

    /// The function of it, if that is a form.
    pub(super) fn applied(self, function: Function) -> Option<Form> {
        if function == Function::Negative {
            return Some(self.times(-Double::ONE));
        }
        if let Some(c) = self.as_constant() {
            let c = c.nearest();
            let value = match function {
                Function::Negative => -c,
                Function::Sine => libm::sin(c),
                Function::Cosine => libm::cos(c),
                Function::Exponential => libm::exp(c),
                Function::Logarithm => libm::log(c),
                Function::Root => libm::sqrt(c),
                Function::Arcsine => libm::asin(c),
                Function::Arctangent => libm::atan(c),
                Function::HyperbolicTangent => libm::tanh(c),
            };
            return Some(Form::constant(Double::from(value)));
        }
        if !self.is_line() || !matches!(function, Function::Sine | Function::Cosine) {
            return None;
        }
        let (mut phase, mut omega) = (self.polynomial[0], self.polynomial[1]);
        // sin x = cos(x − π/2)
        if function == Function::Sine {
            phase = phase - Double::PI * Double::from(0.5);
        }
        if omega.hi < 0.0 {
            (phase, omega) = (-phase, -omega);
        }
        let harmonic = Harmonic { amplitude: Double::ONE, omega, phase };
        Some(Form { polynomial: Vec::new(), harmonics: vec![harmonic] })
    }

    pub(super) fn plus(mut self, other: Form) -> Form {
        self.polynomial.resize(self.polynomial.len().max(other.polynomial.len()), Double::ZERO);
        for (sum, c) in self.polynomial.iter_mut().zip(other.polynomial) {
            *sum = *sum + c;
        }
        self.harmonics.extend(other.harmonics);
        self
    }

    pub(super) fn times(mut self, by: Double) -> Form {
        self.polynomial.iter_mut().for_each(|c| *c = *c * by);
        self.harmonics.iter_mut().for_each(|h| h.amplitude = h.amplitude * by);
        self
    }

    pub(super) fn divided(mut self, by: Double) -> Option<Form> {
        self.polynomial.iter_mut().for_each(|c| *c = *c / by);
        self.harmonics.iter_mut().for_each(|h| h.amplitude = h.amplitude / by);
        self.is_finite().then_some(self)
    }

    /// The product, if that is a form.
    pub(super) fn product(&self, other: &Form) -> Option<Form> {
        if let Some(c) = other.as_constant() {
            return Some(self.clone().times(c));
        }
        if let Some(c) = self.as_constant() {
            return Some(other.clone().times(c));
        }
        if self.harmonics.is_empty() && other.harmonics.is_empty() {
            let degree = self.polynomial.len() + other.polynomial.len() - 2;
            if degree > HIGHEST_DEGREE {
                return None;
            }
            let mut c = vec![Double::ZERO; degree + 1];
            for (i, &a) in self.polynomial.iter().enumerate() {
                for (j, &b) in other.polynomial.iter().enumerate() {
                    c[i + j] = c[i + j] + a * b;
                }
            }
            return Some(Form { polynomial: c, harmonics: Vec::new() });
        }
        // cos a·cos b = ½cos(a + b) + ½cos(a − b), and constants; t·cos is no form.
        let level = |form: &Form| Form { polynomial: form.polynomial.clone(), harmonics: Vec::new() }.as_constant();
        let (mine, others) = (level(self)?, level(other)?);
        let mut product = Form { polynomial: vec![mine * others], harmonics: Vec::new() };
        product.harmonics.extend(self.harmonics.iter().map(|h| h.times(others)));
        product.harmonics.extend(other.harmonics.iter().map(|h| h.times(mine)));
        for a in &self.harmonics {
            for b in &other.harmonics {
                let amplitude = a.amplitude * b.amplitude * Double::from(0.5);
                product.harmonics.push(Harmonic { amplitude, omega: a.omega + b.omega, phase: a.phase + b.phase });
                let (omega, phase) = (a.omega - b.omega, a.phase - b.phase);
                if omega.hi == 0.0 {
                    let still = amplitude * Double::from(libm::cos(phase.nearest()));
                    product.polynomial[0] = product.polynomial[0] + still;
                } else {
                    let side = Double::from(libm::copysign(1.0, omega.hi));
                    product.harmonics.push(Harmonic { amplitude, omega: omega * side, phase: phase * side });
                }
            }
        }
        (product.harmonics.len() <= MOST_HARMONICS).then_some(product)
    }

    /// This form with its time counted from `zero`.
    pub(super) fn since(&self, zero: Time) -> Form {
        let by = Double::from(zero);
        let mut polynomial = self.polynomial.clone();
        for k in 0..polynomial.len() {
            for i in (k..polynomial.len() - 1).rev() {
                polynomial[i] = polynomial[i] + by * polynomial[i + 1];
            }
        }
        let harmonics = self.harmonics.iter().map(|h| Harmonic { phase: (h.phase + h.omega * by).wrapped(), ..*h });
        Form { polynomial, harmonics: harmonics.collect() }
    }

    /// The curve since `zero` but for its level at `zero`, which keeps 106 bits.
    pub(super) fn curve_since(&self, zero: Time) -> (Curve, Double) {
        let mut local = self.since(zero);
        let level = local.polynomial.first_mut().map_or(Double::ZERO, |c| std::mem::replace(c, Double::ZERO));
        let cosine = |h: &Harmonic| Curve::Cosine {
            offset: 0.0,
            amplitude: h.amplitude.nearest(),
            omega: h.omega.nearest(),
            phase: h.phase.nearest(),
        };
        let polynomial = Curve::Polynomial(local.polynomial.iter().map(|c| c.nearest()).collect());
        let curve = match local.harmonics.as_slice() {
            [] => polynomial,
            [harmonic] if polynomial.is_constant() => cosine(harmonic),
            harmonics => Curve::Sum(std::iter::once(polynomial).chain(harmonics.iter().map(cosine)).collect()),
        };
        (curve, level)
    }

    /// All its numbers. Forms with equal numbers are equal.
    pub(super) fn numbers(&self) -> Vec<u64> {
        let harmonics = self.harmonics.iter().flat_map(|h| [h.amplitude, h.omega, h.phase]);
        let numbers = self.polynomial.iter().copied().chain(harmonics).flat_map(|c| [c.hi.to_bits(), c.lo.to_bits()]);
        std::iter::once(self.polynomial.len() as u64).chain(numbers).collect()
    }

    /// The highest angular frequency, rad/s; 0 if there is none.
    pub(super) fn fastest(&self) -> f64 {
        self.harmonics.iter().fold(0.0, |w, h| w.max(h.omega.nearest()))
    }
}

impl Harmonic {
    fn times(self, by: Double) -> Harmonic {
        Harmonic { amplitude: self.amplitude * by, ..self }
    }
}
