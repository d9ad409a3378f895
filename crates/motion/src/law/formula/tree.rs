//! The expression tree of a formula, and where its parts are written.

use super::FormulaError;
use crate::law::double::Double;
use std::sync::Arc;

/// The tree is no deeper.
const DEEPEST: u32 = 256;
/// Operations in a formula at most, those that stand for shorthands counted.
pub(super) const LARGEST: u32 = 60_000;

/// Where in the text: byte offset and length.
pub(super) type Span = (usize, usize);

pub(super) fn error(span: Span, message: impl Into<String>) -> FormulaError {
    FormulaError { offset: span.0, length: span.1, message: message.into(), help: String::new() }
}

/// An expression that is a number.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Expression {
    pub(super) kind: Arc<Operation>,
    pub(super) span: Span,
    size: u32,
    depth: u32,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Operation {
    Number(Double),
    Time,
    Add(Expression, Expression),
    Subtract(Expression, Expression),
    Multiply(Expression, Expression),
    Divide(Expression, Expression),
    Power(Expression, Expression),
    Apply(Function, Expression),
    /// The largest whole number that is not larger.
    Floor(Expression),
    If(Condition, Expression, Expression),
}

/// The smooth functions that have Taylor recurrences of their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Function {
    Negative,
    Sine,
    Cosine,
    Exponential,
    Logarithm,
    Root,
    Arcsine,
    Arctangent,
    HyperbolicTangent,
}

/// An expression that is true or false.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Condition {
    Is(Test, Expression),
    Not(Arc<Condition>),
    And(Arc<(Condition, Condition)>),
    Or(Arc<(Condition, Condition)>),
}

/// What is asked of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Test {
    Positive,
    NotNegative,
    Zero,
}

impl Expression {
    pub(super) fn new(kind: Operation, span: Span) -> Result<Expression, FormulaError> {
        let (size, depth) = kind.extent();
        if size > LARGEST {
            return Err(error(span, format!("the formula is too long: {LARGEST} operations at most")));
        }
        if depth > DEEPEST {
            return Err(error(span, format!("the formula is nested more than {DEEPEST} deep")));
        }
        Ok(Expression { kind: Arc::new(kind), span, size, depth })
    }

    /// Whether what it is depends on the time.
    pub(super) fn has_branches(&self) -> bool {
        match &*self.kind {
            Operation::Number(_) | Operation::Time => false,
            Operation::Floor(_) | Operation::If(..) => true,
            Operation::Apply(_, a) => a.has_branches(),
            Operation::Add(a, b)
            | Operation::Subtract(a, b)
            | Operation::Multiply(a, b)
            | Operation::Divide(a, b)
            | Operation::Power(a, b) => a.has_branches() || b.has_branches(),
        }
    }

    /// How many it is made of.
    pub(super) fn size(&self) -> u32 {
        self.size
    }

    /// This expression with its place in the text extended to its brackets.
    pub(super) fn written_at(self, span: Span) -> Expression {
        Expression { span, ..self }
    }

    /// A leaf.
    pub(super) fn number(value: Double, span: Span) -> Expression {
        Expression { kind: Arc::new(Operation::Number(value)), span, size: 1, depth: 1 }
    }
}

impl Operation {
    fn extent(&self) -> (u32, u32) {
        let of = |nodes: &[&Expression]| {
            let size = nodes.iter().fold(1_u32, |sum, n| sum.saturating_add(n.size));
            (size, 1 + nodes.iter().map(|n| n.depth).max().unwrap_or(0))
        };
        match self {
            Operation::Number(_) | Operation::Time => (1, 1),
            Operation::Add(a, b)
            | Operation::Subtract(a, b)
            | Operation::Multiply(a, b)
            | Operation::Divide(a, b)
            | Operation::Power(a, b) => of(&[a, b]),
            Operation::Apply(_, a) | Operation::Floor(a) => of(&[a]),
            Operation::If(condition, a, b) => {
                let (size, depth) = of(&[a, b]);
                let (c_size, c_depth) = condition.extent();
                (size.saturating_add(c_size), depth.max(c_depth + 1))
            }
        }
    }
}

impl Condition {
    fn extent(&self) -> (u32, u32) {
        match self {
            Condition::Is(_, node) => (node.size, node.depth),
            Condition::Not(inner) => {
                let (size, depth) = inner.extent();
                (size, depth + 1)
            }
            Condition::And(pair) | Condition::Or(pair) => {
                let (a, b) = (pair.0.extent(), pair.1.extent());
                (a.0.saturating_add(b.0), a.1.max(b.1) + 1)
            }
        }
    }

    pub(super) fn depth_checked(self, span: Span) -> Result<Condition, FormulaError> {
        let (size, depth) = self.extent();
        if size > LARGEST || depth > DEEPEST {
            return Err(error(span, "the condition is too long, or nested too deep"));
        }
        Ok(self)
    }
}
