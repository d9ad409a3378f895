//! Expressions without branches: what a formula is on one window of time.

use super::form::Form;
use super::tree::{Function, Span};
use crate::law::double::Double;

/// An expression without branches.
#[derive(Clone, Debug)]
pub(super) enum Smooth {
    Form(Form, Span),
    Unary(Unary, Box<Smooth>, Span),
    Binary(Binary, Box<(Smooth, Smooth)>, Span),
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Unary {
    Scale(f64),
    Offset(f64),
    Reciprocal,
    WholePower(u32),
    Power(f64),
    Apply(Function),
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Binary {
    Add,
    Subtract,
    Multiply,
    Divide,
}

impl Smooth {
    pub(super) fn as_constant(&self) -> Option<Double> {
        match self {
            Smooth::Form(form, _) => form.as_constant(),
            _ => None,
        }
    }

    pub(super) fn unary(op: Unary, x: Smooth, span: Span) -> Smooth {
        Smooth::Unary(op, Box::new(x), span)
    }

    pub(super) fn apply(function: Function, x: Smooth, span: Span) -> Smooth {
        if let Smooth::Form(form, _) = &x
            && let Some(form) = form.clone().applied(function).filter(Form::is_finite)
        {
            return Smooth::Form(form, span);
        }
        match function {
            Function::Negative => Smooth::unary(Unary::Scale(-1.0), x, span),
            _ => Smooth::unary(Unary::Apply(function), x, span),
        }
    }

    pub(super) fn binary(op: Binary, a: Smooth, b: Smooth, span: Span) -> Smooth {
        if let (Smooth::Form(x, _), Smooth::Form(y, _)) = (&a, &b) {
            let form = match op {
                Binary::Add => Some(x.clone().plus(y.clone())),
                Binary::Subtract => Some(x.clone().plus(y.clone().times(-Double::ONE))),
                Binary::Multiply => x.product(y),
                Binary::Divide => y.as_constant().and_then(|y| x.clone().divided(y)),
            };
            if let Some(form) = form.filter(Form::is_finite) {
                return Smooth::Form(form, span);
            }
        }
        let constant = |x: &Smooth| x.as_constant().map(Double::nearest);
        match (op, constant(&a), constant(&b)) {
            (Binary::Add, Some(c), _) => Smooth::unary(Unary::Offset(c), b, span),
            (Binary::Add, _, Some(c)) => Smooth::unary(Unary::Offset(c), a, span),
            (Binary::Subtract, _, Some(c)) => Smooth::unary(Unary::Offset(-c), a, span),
            (Binary::Multiply, Some(c), _) => Smooth::unary(Unary::Scale(c), b, span),
            (Binary::Multiply, _, Some(c)) => Smooth::unary(Unary::Scale(c), a, span),
            _ => Smooth::Binary(op, Box::new((a, b)), span),
        }
    }

    pub(super) fn power(a: Smooth, b: Smooth, span: Span) -> Smooth {
        let Some(exponent) = b.as_constant() else {
            // a^b = exp(b·ln a)
            let product = Smooth::binary(Binary::Multiply, b, Smooth::apply(Function::Logarithm, a, span), span);
            return Smooth::apply(Function::Exponential, product, span);
        };
        if let Smooth::Form(form, _) = &a
            && let Some(form) = form.power(exponent).filter(Form::is_finite)
        {
            return Smooth::Form(form, span);
        }
        let n = exponent.nearest();
        if n.fract() != 0.0 || n.abs() > 64.0 {
            return Smooth::unary(Unary::Power(n), a, span);
        }
        let power = Smooth::unary(Unary::WholePower(n.abs() as u32), a, span);
        if n < 0.0 { Smooth::unary(Unary::Reciprocal, power, span) } else { power }
    }
}
