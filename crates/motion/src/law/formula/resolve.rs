//! What a formula is on one window of time: every branch decided, what is a form folded into one.

use super::form::Form;
use super::scalar::Enclosed;
use super::smooth::{Binary, Smooth};
use super::tape::{LocalForm, Tape, Undefined};
use super::tree::{Condition, Expression, Operation, Span, Test};
use crate::Time;
use crate::law::double::Double;
use std::cmp::Ordering;

/// Why a window cannot be taken as it is.
pub(super) enum Stop {
    /// A branch changes there.
    Split(Time),
    /// Something cannot be told or is undefined; in a narrower window it may be.
    Narrow(Undefined),
}

/// A window of time in which branches are decided.
pub(super) struct Resolver {
    pub(super) start: Time,
    pub(super) end: Time,
    /// The window is as narrow as they get: its middle decides.
    pub(super) forced: bool,
}

/// From 2^53 on, f64s are whole numbers, and further on not all of them.
const MOST_WHOLE: f64 = 9_007_199_254_740_992.0;

/// The narrowest window, s.
pub(super) const NARROWEST_S: f64 = 1e-12;

impl Resolver {
    fn span_s(&self) -> f64 {
        (self.end - self.start).seconds()
    }

    /// `node` with its branches decided.
    pub(super) fn resolve(&self, node: &Expression) -> Result<Smooth, Stop> {
        let span = node.span;
        Ok(match &*node.kind {
            Operation::Number(c) => Smooth::Form(Form::constant(*c), span),
            Operation::Time => Smooth::Form(Form::time(), span),
            Operation::Add(a, b) => Smooth::binary(Binary::Add, self.resolve(a)?, self.resolve(b)?, span),
            Operation::Subtract(a, b) => Smooth::binary(Binary::Subtract, self.resolve(a)?, self.resolve(b)?, span),
            Operation::Multiply(a, b) => Smooth::binary(Binary::Multiply, self.resolve(a)?, self.resolve(b)?, span),
            Operation::Divide(a, b) => Smooth::binary(Binary::Divide, self.resolve(a)?, self.resolve(b)?, span),
            Operation::Power(a, b) => Smooth::power(self.resolve(a)?, self.resolve(b)?, span),
            Operation::Apply(function, a) => Smooth::apply(*function, self.resolve(a)?, span),
            Operation::Floor(a) => Smooth::Form(Form::constant(self.floor(&self.resolve(a)?)?), span),
            Operation::If(condition, a, b) => self.resolve(if self.decide(condition)? { a } else { b })?,
        })
    }

    fn decide(&self, condition: &Condition) -> Result<bool, Stop> {
        // Of two conditions one that decides is enough, whatever becomes of the other.
        let joined = |pair: &(Condition, Condition), enough: bool| match (self.decide(&pair.0), self.decide(&pair.1)) {
            (Ok(a), _) if a == enough => Ok(enough),
            (_, Ok(b)) if b == enough => Ok(enough),
            (Ok(_), other) | (other, Ok(_)) => other,
            (stop, _) => stop,
        };
        match condition {
            Condition::Not(inner) => self.decide(inner).map(|truth| !truth),
            Condition::And(pair) => joined(pair, false),
            Condition::Or(pair) => joined(pair, true),
            Condition::Is(test, node) => {
                let sign = self.compare(&self.resolve(node)?, 0.0)?;
                Ok(match test {
                    Test::Positive => sign.is_gt(),
                    Test::NotNegative => sign.is_ge(),
                    Test::Zero => sign.is_eq(),
                })
            }
        }
    }

    /// How `x` compares with `level` in the whole window, its ends apart.
    fn compare(&self, x: &Smooth, level: f64) -> Result<Ordering, Stop> {
        if let Some(c) = x.as_constant() {
            return Ok((c - Double::from(level)).nearest().total_cmp(&0.0));
        }
        let tape = Tape::new(x);
        let forms = tape.forms_since(self.start);
        let value = |u: f64| tape.value(&forms, u) - level;
        let length = self.span_s();
        if self.forced {
            return Ok(value(0.5 * length).total_cmp(&0.0));
        }
        let [range, slope] = self.enclose(&tape, &forms)?;
        if range.low >= level {
            return Ok(Ordering::Greater);
        }
        if range.high <= level {
            return Ok(Ordering::Less);
        }
        if slope.low <= 0.0 && slope.high >= 0.0 {
            let why = "it is not known when this changes its sign";
            return Err(Stop::Narrow(Undefined { span: x.span(), why }));
        }
        // Monotone: at most one change, and one that lies on an end is none.
        let near = slope.magnitude() * NARROWEST_S;
        let (first, last) = (value(0.0), value(length));
        if first * last > 0.0 || last.abs() <= near {
            return Ok(first.total_cmp(&0.0));
        }
        if first.abs() <= near {
            return Ok(last.total_cmp(&0.0));
        }
        let (mut a, mut b) = (0.0, length);
        for _ in 0..100 {
            let middle = 0.5 * (a + b);
            if value(middle) * first > 0.0 { a = middle } else { b = middle }
        }
        Err(Stop::Split(self.start + Time::from_seconds(a)))
    }

    fn floor(&self, x: &Smooth) -> Result<Double, Stop> {
        if let Some(c) = x.as_constant() {
            return Ok(c.floor());
        }
        let tape = Tape::new(x);
        let forms = tape.forms_since(self.start);
        if self.forced {
            return Ok(Double::from(libm::floor(tape.value(&forms, 0.5 * self.span_s()))));
        }
        let [range, _] = self.enclose(&tape, &forms)?;
        let (mut low, mut high) = (range.low, range.high);
        // NaN is none of them.
        if !(low > -MOST_WHOLE && high < MOST_WHOLE) {
            let why = "it is so large that its whole numbers cannot be told apart";
            return Err(Stop::Narrow(Undefined { span: x.span(), why }));
        }
        while high > libm::floor(low) + 1.0 {
            let level = libm::ceil(0.5 * (low + high) - 0.5).max(libm::floor(low) + 1.0);
            match self.compare(x, level)? {
                Ordering::Less => high = high.min(level),
                _ => low = low.max(level),
            }
        }
        Ok(Double::from(libm::floor(low)))
    }

    /// Value and slope over the window.
    fn enclose(&self, tape: &Tape, forms: &[LocalForm]) -> Result<[Enclosed; 2], Stop> {
        tape.run(forms, Enclosed::new(0.0, self.span_s(), 0.0)).map_err(Stop::Narrow)
    }
}

impl Smooth {
    pub(super) fn span(&self) -> Span {
        match self {
            Smooth::Form(_, span) | Smooth::Unary(_, _, span) | Smooth::Binary(_, _, span) => *span,
        }
    }
}
