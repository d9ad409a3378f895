//! A branch-free formula as a flat list of operations on a stack, and its windows in time.

use super::form::Form;
use super::scalar::{Enclosed, Scalar};
use super::series::{self, Series};
use super::smooth::{Binary, Smooth, Unary};
use super::tree::{Function, Span};
use crate::Time;
use crate::law::curve::{Bounds, Jet};
use crate::law::double::{Double, ULP};
use std::collections::BTreeMap;
use std::sync::Arc;

#[derive(Clone, Copy, Debug)]
enum Op {
    /// Pushes one of the forms.
    Push(usize),
    /// Changes the topmost series.
    Unary(Unary),
    /// Takes two series and leaves one.
    Binary(Binary),
    /// Keeps the topmost series at a place, since the formula has the same part again.
    Keep(usize),
    /// Pushes a series that was kept.
    Recall(usize),
}

/// The operations, and where in the text each comes from.
#[derive(Debug)]
pub(super) struct Tape {
    ops: Vec<(Op, Span)>,
    forms: Vec<Form>,
    /// The highest that the stack grows.
    depth: usize,
}

/// A form in the time since a window's zero.
#[derive(Debug)]
pub(super) struct LocalForm {
    polynomial: Vec<f64>,
    /// Amplitude, omega, phase.
    harmonics: Vec<[f64; 3]>,
}

/// Stacks of up to this many series need no allocation.
const SHALLOW: usize = 8;
/// At most so many parts that a formula has again are kept. The formula of a robot's arm has each coordinate three times.
const MOST_REPEATED: usize = 8;

/// The parts of an expression. Equal parts are one entry.
#[derive(Default)]
struct Parts {
    parts: Vec<Part>,
    /// Each part's place in `parts`, by its operation and operands as numbers.
    known: BTreeMap<Vec<u64>, usize>,
}

struct Part {
    op: Op,
    span: Span,
    operands: Vec<usize>,
    /// In how many other parts it is.
    uses: usize,
    /// Where its series is kept, once that was worked out.
    kept: Option<usize>,
}

/// An operation without a result.
pub(super) struct Undefined {
    pub(super) span: Span,
    pub(super) why: &'static str,
}

impl Tape {
    pub(super) fn new(smooth: &Smooth) -> Tape {
        let mut tape = Tape { ops: Vec::new(), forms: Vec::new(), depth: 0 };
        let mut parts = Parts::default();
        let root = parts.add(smooth, &mut tape.forms);
        tape.depth = tape.push(&mut parts, root, &mut 0);
        tape
    }

    /// Adds the operations of a part; returns the stack that they need.
    fn push(&mut self, parts: &mut Parts, part: usize, kept: &mut usize) -> usize {
        let Part { op, span, uses, kept: place, .. } = parts.parts[part];
        if let Some(place) = place {
            self.ops.push((Op::Recall(place), span));
            return 1;
        }
        let mut depth = 1;
        for k in 0..parts.parts[part].operands.len() {
            depth = depth.max(k + self.push(parts, parts.parts[part].operands[k], kept));
        }
        self.ops.push((op, span));
        if uses > 1 && *kept < MOST_REPEATED {
            self.ops.push((Op::Keep(*kept), span));
            parts.parts[part].kept = Some(*kept);
            *kept += 1;
        }
        depth
    }

    /// The leaves in the time since `zero`.
    pub(super) fn forms_since(&self, zero: Time) -> Vec<LocalForm> {
        self.forms.iter().map(|form| LocalForm::new(&form.since(zero))).collect()
    }

    pub(super) fn value(&self, forms: &[LocalForm], u: f64) -> f64 {
        self.run::<f64, 1>(forms, u).map_or(f64::NAN, |[value]| value)
    }

    /// The first N Taylor coefficients at u, over the u that the scalar stands for.
    pub(super) fn run<S: Scalar, const N: usize>(&self, forms: &[LocalForm], u: S) -> Result<Series<S, N>, Undefined> {
        let zero = series::constant(S::exact(0.0));
        let kept = &mut [zero; MOST_REPEATED];
        if self.depth <= SHALLOW {
            self.run_on(forms, u, &mut [zero; SHALLOW], kept)
        } else {
            self.run_on(forms, u, &mut vec![zero; self.depth], kept)
        }
    }

    fn run_on<S: Scalar, const N: usize>(
        &self,
        forms: &[LocalForm],
        u: S,
        stack: &mut [Series<S, N>],
        kept: &mut [Series<S, N>; MOST_REPEATED],
    ) -> Result<Series<S, N>, Undefined> {
        let mut height = 0;
        for &(op, span) in &self.ops {
            match op {
                Op::Push(form) => {
                    stack[height] = forms[form].series(u);
                    height += 1;
                }
                Op::Unary(op) => stack[height - 1] = op.of(&stack[height - 1]),
                Op::Binary(op) => {
                    height -= 1;
                    stack[height - 1] = op.of(&stack[height - 1], &stack[height]);
                }
                Op::Keep(place) => kept[place] = stack[height - 1],
                Op::Recall(place) => {
                    stack[height] = kept[place];
                    height += 1;
                }
            }
            if !stack[height - 1].iter().all(|c| c.is_sound()) {
                return Err(Undefined { span, why: op.complaint() });
            }
        }
        Ok(stack[0])
    }
}

impl Parts {
    /// The place of an expression's part, which is added if it is new.
    fn add(&mut self, smooth: &Smooth, forms: &mut Vec<Form>) -> usize {
        let (op, operands, mut numbers) = match smooth {
            Smooth::Form(form, _) => (Op::Push(forms.len()), Vec::new(), form.numbers()),
            Smooth::Unary(op, x, _) => (Op::Unary(*op), vec![self.add(x, forms)], op.numbers().to_vec()),
            Smooth::Binary(op, pair, _) => {
                let operands = vec![self.add(&pair.0, forms), self.add(&pair.1, forms)];
                (Op::Binary(*op), operands, vec![*op as u64])
            }
        };
        numbers.extend(operands.iter().map(|part| *part as u64));
        // Forms have no operands, unary operations one and binary ones two.
        numbers.push(operands.len() as u64);
        if let Some(part) = self.known.get(&numbers) {
            return *part;
        }
        if let Smooth::Form(form, _) = smooth {
            forms.push(form.clone());
        }
        operands.iter().for_each(|part| self.parts[*part].uses += 1);
        self.known.insert(numbers, self.parts.len());
        self.parts.push(Part { op, span: smooth.span(), operands, uses: 0, kept: None });
        self.parts.len() - 1
    }
}

impl Op {
    /// What is wrong where this operation has no result.
    fn complaint(self) -> &'static str {
        match self {
            Op::Unary(Unary::Apply(Function::Root)) => "the root of what is not positive has no speed or no value",
            Op::Unary(Unary::Apply(Function::Logarithm)) => "the logarithm of what is not positive",
            Op::Unary(Unary::Apply(Function::Arcsine)) => {
                "the arcsine of what is not within -1 and 1 has no speed or no value"
            }
            Op::Unary(Unary::Power(_)) => "a broken power of what is not positive",
            Op::Unary(Unary::Reciprocal) | Op::Binary(Binary::Divide) => "a division by 0",
            _ => "it is too large for a number",
        }
    }
}

impl Unary {
    /// Which operation it is, and with which constant.
    fn numbers(self) -> [u64; 2] {
        match self {
            Unary::Scale(c) => [0, c.to_bits()],
            Unary::Offset(c) => [1, c.to_bits()],
            Unary::Reciprocal => [2, 0],
            Unary::WholePower(n) => [3, n.into()],
            Unary::Power(exponent) => [4, exponent.to_bits()],
            Unary::Apply(function) => [5, function as u64],
        }
    }

    fn of<S: Scalar, const N: usize>(self, x: &Series<S, N>) -> Series<S, N> {
        match self {
            Unary::Scale(c) => {
                let c = S::rounded(c);
                x.map(|x| c * x)
            }
            Unary::Offset(c) => {
                let mut sum = *x;
                sum[0] = sum[0] + S::rounded(c);
                sum
            }
            Unary::Reciprocal => series::divide(&series::constant(S::exact(1.0)), x),
            Unary::WholePower(n) => series::whole_power(x, n),
            Unary::Power(exponent) => series::power(x, exponent),
            Unary::Apply(function) => match function {
                Function::Negative => x.map(|x| -x),
                Function::Sine => series::sin_cos(x).0,
                Function::Cosine => series::sin_cos(x).1,
                Function::Exponential => series::exp(x),
                Function::Logarithm => series::ln(x),
                Function::Root => series::sqrt(x),
                Function::Arcsine => series::asin(x),
                Function::Arctangent => series::atan(x),
                Function::HyperbolicTangent => series::tanh(x),
            },
        }
    }
}

impl Binary {
    fn of<S: Scalar, const N: usize>(self, a: &Series<S, N>, b: &Series<S, N>) -> Series<S, N> {
        match self {
            Binary::Add => std::array::from_fn(|k| a[k] + b[k]),
            Binary::Subtract => std::array::from_fn(|k| a[k] - b[k]),
            Binary::Multiply => series::multiply(a, b),
            Binary::Divide => series::divide(a, b),
        }
    }
}

impl LocalForm {
    fn new(form: &Form) -> LocalForm {
        LocalForm {
            polynomial: form.polynomial.iter().map(|c| c.nearest()).collect(),
            harmonics: form
                .harmonics
                .iter()
                .map(|h| [h.amplitude.nearest(), h.omega.nearest(), h.phase.nearest()])
                .collect(),
        }
    }

    fn series<S: Scalar, const N: usize>(&self, u: S) -> Series<S, N> {
        let mut sum = series::constant(S::exact(0.0));
        for (degree, &c) in self.polynomial.iter().rev().enumerate() {
            for k in (1..N.min(degree + 1)).rev() {
                sum[k] = sum[k] * u + sum[k - 1];
            }
            sum[0] = sum[0] * u + S::rounded(c);
        }
        for &[amplitude, omega, phase] in &self.harmonics {
            let omega = S::rounded(omega);
            let (sin, cos) = (omega * u + S::rounded(phase)).sin_cos();
            let mut scale = S::rounded(amplitude);
            for (k, sum) in sum.iter_mut().enumerate() {
                if k > 0 {
                    scale = scale * omega * series::reciprocal(k);
                }
                // cos → −sin → −cos → sin
                *sum = match k % 4 {
                    0 => *sum + scale * cos,
                    1 => *sum - scale * sin,
                    2 => *sum - scale * cos,
                    _ => *sum + scale * sin,
                };
            }
        }
        sum
    }
}

/// A formula on one window of time, as a curve: factor·formula(u + later) + offset.
#[derive(Clone, Debug)]
pub struct Window {
    shared: Arc<Shared>,
    factor: f64,
    offset: f64,
    later: f64,
}

impl PartialEq for Window {
    /// Windows that were made apart are not compared: they count as different.
    fn eq(&self, other: &Window) -> bool {
        let numbers = |window: &Window| [window.factor, window.offset, window.later];
        Arc::ptr_eq(&self.shared, &other.shared) && numbers(self) == numbers(other)
    }
}

#[derive(Debug)]
struct Shared {
    tape: Arc<Tape>,
    forms: Vec<LocalForm>,
    bounds: Bounds,
    majorant: Jet,
}

/// How much larger than what is met at three points the bound of the eighth derivative may be.
const LOOSEST: f64 = 16.0;
/// What the eighth derivative may amount to over the window, steps, for its bound not to matter.
const NEGLIGIBLE_STEPS: f64 = 1e-9;

impl Window {
    /// From `start` on for `length` seconds, with enclosures that are tight enough to plan with.
    pub(super) fn new(tape: &Arc<Tape>, start: Time, length: f64) -> Result<Window, Undefined> {
        let forms = tape.forms_since(start);
        // The error is that of a sum that shifts the window's zero.
        let hull: Series<Enclosed, 9> = tape.run(&forms, Enclosed::new(0.0, length, 4.0 * ULP * length))?;
        let root = tape.ops.last().map_or((0, 0), |op| op.1);
        if hull[0].magnitude() > crate::law::FARTHEST {
            return Err(Undefined { span: root, why: "it is beyond 1e15 steps" });
        }
        let eighth = hull[8].magnitude();
        let met = [0.0, 0.5 * length, length].into_iter().fold(0.0, |most: f64, u| {
            let met = tape.run::<f64, 9>(&forms, u).map_or(f64::NAN, |series| series[8].abs());
            most.max(met)
        });
        let over = length * length;
        if eighth > LOOSEST * met && eighth * (over * over) * (over * over) > NEGLIGIBLE_STEPS {
            return Err(Undefined { span: root, why: "its derivatives grow without bound" });
        }
        let bounds = Bounds { eighth, rounding: std::array::from_fn(|k| hull[k].error) };
        let majorant = std::array::from_fn(|k| hull[k].magnitude());
        let shared = Arc::new(Shared { tape: Arc::clone(tape), forms, bounds, majorant });
        Ok(Window { shared, factor: 1.0, offset: 0.0, later: 0.0 })
    }

    /// How fast it swings in its `length` seconds, as if it were a sinusoid, rad/s: its speed's seventh derivative over its speed.
    pub(super) fn fastest(&self, length: f64) -> f64 {
        let Shared { bounds, majorant, .. } = &*self.shared;
        if bounds.eighth * libm::pow(length, 8.0) <= NEGLIGIBLE_STEPS {
            return 0.0;
        }
        libm::pow(40_320.0 * bounds.eighth / (majorant[1] + f64::MIN_POSITIVE), 1.0 / 7.0)
    }

    pub(crate) fn value(&self, u: f64) -> f64 {
        self.factor * self.shared.tape.value(&self.shared.forms, u + self.later) + self.offset
    }

    /// The first N Taylor coefficients.
    pub(crate) fn taylor<const N: usize>(&self, u: f64) -> [f64; N] {
        let Ok(mut jet) = self.shared.tape.run::<f64, N>(&self.shared.forms, u + self.later) else {
            return [f64::NAN; N];
        };
        jet.iter_mut().for_each(|c| *c *= self.factor);
        jet[0] += self.offset;
        jet
    }

    /// What holds on the whole window.
    pub(crate) fn bounds_and_majorant(&self) -> (Bounds, Jet) {
        self.shared.bounds.scaled(self.shared.majorant, self.factor, self.offset)
    }

    pub(crate) fn raise(&mut self, steps: f64) {
        self.offset += steps;
    }

    pub(crate) fn scale(&mut self, by: f64) {
        self.factor *= by;
        self.offset *= by;
    }

    pub(crate) fn rezero(&mut self, by: Double) {
        self.later = (Double::from(self.later) + by).nearest();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::{Curve, Law};

    /// The window of a formula in its first moments.
    fn window(text: &str) -> Window {
        let law = Law::formula(text, &[], 1.0, Some(Time::from_seconds(0.1))).unwrap();
        let mut curve = law.pieces().next().unwrap().unwrap().curve;
        while let Curve::Accurate { curve: inner, .. } = curve {
            curve = *inner;
        }
        let Curve::Formula(window) = curve else { panic!("{text} has a form") };
        window
    }

    #[test]
    fn equal_parts_are_worked_out_once() {
        let window = window("(t*sin(t))^2 + exp(t*sin(t)) + atan(t)*exp(t*sin(t))");
        let count = |is: fn(&Op) -> bool| window.shared.tape.ops.iter().filter(|(op, _)| is(op)).count();
        assert_eq!(count(|op| matches!(op, Op::Push(_))), 2);
        assert_eq!(count(|op| matches!(op, Op::Unary(Unary::Apply(Function::Exponential)))), 1);
        assert_eq!(count(|op| matches!(op, Op::Recall(_))), 3);
        for u in [0.0, 0.01, 0.03] {
            let x: f64 = u * f64::sin(u);
            let wanted = x * x + x.exp() + u.atan() * x.exp();
            assert!((window.value(u) - wanted).abs() < 1e-14, "at {u}");
        }
    }

    /// Parts beyond those that are kept are worked out again.
    #[test]
    fn any_number_of_parts_may_be_repeated() {
        let part = |k: usize| format!("exp(sin({k}*t))");
        let text: Vec<String> = (1..=2 * MOST_REPEATED).map(|k| format!("{0}*atan({0})", part(k))).collect();
        let window = window(&text.join(" + "));
        for u in [0.0, 0.01, 0.03] {
            let part = |k: usize| f64::exp(f64::sin(k as f64 * u));
            let wanted: f64 = (1..=2 * MOST_REPEATED).map(|k| part(k) * part(k).atan()).sum();
            assert!((window.value(u) - wanted).abs() < 1e-12, "at {u}");
        }
    }
}
