//! Text → expression tree. Functions with branches or simple identities are spelled out by the smooth ones here.

use super::FormulaError;
use super::dimension::{Measure, Parameter, Place, Typed, Unit};
use super::tree::{Condition, Expression, Function, Operation, Span, Test, error};
use crate::law::double::Double;
use std::sync::Arc;

/// The message about a decimal comma.
const POINT: &str = "decimals are written with a point: 0.5";

/// Brackets and signs nest no deeper, and so no text overflows the stack.
const NESTED: u32 = 64;

/// The name of a constant that is written as its Greek letter.
fn in_letters(word: &str) -> &str {
    match word {
        "π" => "pi",
        "τ" => "tau",
        _ => word,
    }
}

enum Operand {
    Number(Typed),
    Truth(Condition, Span),
}

/// A formula that has been read.
pub(super) struct Parsed {
    pub(super) tree: Expression,
    /// Of each parameter, whether it stands outside of sin, cos and tan, and whether in them.
    pub(super) used: Vec<[bool; 2]>,
}

const FUNCTIONS: [(&str, usize); 28] = [
    ("sin", 1),
    ("cos", 1),
    ("tan", 1),
    ("asin", 1),
    ("acos", 1),
    ("atan", 1),
    ("atan2", 2),
    ("sinh", 1),
    ("cosh", 1),
    ("tanh", 1),
    ("exp", 1),
    ("ln", 1),
    ("log", 1),
    ("sqrt", 1),
    ("pow", 2),
    ("hypot", 2),
    ("abs", 1),
    ("sign", 1),
    ("min", 2),
    ("max", 2),
    ("clamp", 3),
    ("floor", 1),
    ("ceil", 1),
    ("round", 1),
    ("mod", 2),
    ("if", 3),
    ("piecewise", 0),
    ("not", 1),
];

const CONSTANTS: [(&str, Double); 3] = [("pi", Double::PI), ("tau", Double::TAU), ("e", Double::E)];

/// What a name stands for in every formula, so that no parameter can have it. `tau` and `e` a parameter may be called: time constants often are.
pub(crate) fn taken(name: &str) -> Option<&'static str> {
    match name {
        "t" => Some("the time"),
        "pi" => Some("a constant"),
        "and" | "or" => Some("a word that joins conditions"),
        _ if FUNCTIONS.iter().any(|known| known.0 == name) => Some("a function"),
        _ => None,
    }
}

/// Reads `text`, in which `parameters` are known by name, and whose result is in `unit`.
pub(super) fn parse(text: &str, parameters: &[Parameter], unit: &Unit) -> Result<Parsed, FormulaError> {
    let place = Place { text, unit, parameters, in_trig: false };
    let mut parser = Parser { text, at: 0, depth: 0, place, used: vec![[false; 2]; parameters.len()] };
    let term = parser.either()?;
    parser.blank();
    if parser.at < text.len() {
        return Err(parser.unexpected("an operator or the end is expected here"));
    }
    let whole = parser.number(term)?;
    parser.place.result(&whole)?;
    Ok(Parsed { tree: whole.node, used: parser.used })
}

fn join(a: Span, b: Span) -> Span {
    (a.0, b.0 + b.1 - a.0)
}

struct Parser<'a> {
    text: &'a str,
    at: usize,
    depth: u32,
    place: Place<'a>,
    used: Vec<[bool; 2]>,
}

impl<'a> Parser<'a> {
    fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    fn blank(&mut self) {
        self.at = self.text.len() - self.rest().trim_start().len();
    }

    /// Takes `symbol` if it comes next; a word only if it ends there.
    fn take(&mut self, symbol: &str) -> Option<Span> {
        self.blank();
        let after = self.rest().strip_prefix(symbol)?;
        let is_word = symbol.starts_with(|c: char| c.is_alphabetic());
        if is_word && after.starts_with(|c: char| c.is_alphanumeric() || c == '_') {
            return None;
        }
        let span = (self.at, symbol.len());
        self.at += symbol.len();
        Some(span)
    }

    fn take_any(&mut self, symbols: &[&'static str]) -> Option<&'static str> {
        symbols.iter().copied().find(|symbol| self.take(symbol).is_some())
    }

    fn expect(&mut self, symbol: &str) -> Result<Span, FormulaError> {
        self.take(symbol).ok_or_else(|| error(self.here(), format!("`{symbol}` is expected here")))
    }

    /// One level further in; the caller comes back out.
    fn descend(&mut self, here: Span) -> Result<(), FormulaError> {
        self.depth += 1;
        if self.depth > NESTED {
            return Err(error(here, format!("the formula is nested more than {NESTED} deep")));
        }
        Ok(())
    }

    /// The character that comes next.
    fn here(&mut self) -> Span {
        self.blank();
        (self.at, self.rest().chars().next().map_or(0, char::len_utf8))
    }

    /// That something else should come next.
    fn unexpected(&mut self, message: &str) -> FormulaError {
        let here = self.here();
        let help = if self.is_decimal_comma(here.0) { POINT.to_owned() } else { String::new() };
        FormulaError { help, ..error(here, message) }
    }

    /// Whether there is a comma with digits at both sides.
    fn is_decimal_comma(&self, at: usize) -> bool {
        let bytes = self.text.as_bytes();
        let is_digit = |byte: Option<&u8>| byte.is_some_and(u8::is_ascii_digit);
        bytes.get(at) == Some(&b',') && at > 0 && is_digit(bytes.get(at - 1)) && is_digit(bytes.get(at + 1))
    }

    /// The bracket that closes the one at `open`.
    fn close(&mut self, open: Span) -> Result<Span, FormulaError> {
        match self.take(")") {
            Some(close) => Ok(close),
            None if self.rest().is_empty() => Err(error(open, "this bracket is never closed")),
            None => Err(self.unexpected("an operator or `)` is expected here")),
        }
    }

    /// That a `*` is missing behind a factor, if a name or a bracket comes next.
    fn check_no_factor(&mut self, left: Span) -> Result<(), FormulaError> {
        let (here, rest) = (self.here(), self.rest());
        let word = &rest[..rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len())];
        let is_factor = word.starts_with(|c: char| c.is_alphabetic() || c == '_') && !matches!(word, "and" | "or");
        if !is_factor && !rest.starts_with('(') {
            return Ok(());
        }
        let bracket = if rest[word.len()..].trim_start().starts_with('(') { "(…)" } else { "" };
        let left = &self.text[left.0..left.0 + left.1];
        Err(error(here, format!("a `*` is missing here: write `{left}*{}{bracket}`", in_letters(word))))
    }

    fn number(&self, term: Operand) -> Result<Typed, FormulaError> {
        match term {
            Operand::Number(number) => Ok(number),
            Operand::Truth(_, span) => {
                Err(error(span, "a number is expected, but this is a condition: use if(…, …, …)"))
            }
        }
    }

    fn truth(&self, term: Operand) -> Result<(Condition, Span), FormulaError> {
        match term {
            Operand::Truth(condition, span) => Ok((condition, span)),
            Operand::Number(number) => {
                Err(error(number.node.span, "a condition is expected, such as t < 2, but this is a number"))
            }
        }
    }

    /// or
    fn either(&mut self) -> Result<Operand, FormulaError> {
        let here = self.here();
        self.descend(here)?;
        let mut left = self.both()?;
        while self.take_any(&["or", "||"]).is_some() {
            let (a, from) = self.truth(left)?;
            let right = self.both()?;
            let (b, to) = self.truth(right)?;
            let span = join(from, to);
            left = Operand::Truth(Condition::Or(Arc::new((a, b))).depth_checked(span)?, span);
        }
        self.depth -= 1;
        Ok(left)
    }

    fn both(&mut self) -> Result<Operand, FormulaError> {
        let mut left = self.inverted()?;
        while self.take_any(&["and", "&&"]).is_some() {
            let (a, from) = self.truth(left)?;
            let right = self.inverted()?;
            let (b, to) = self.truth(right)?;
            let span = join(from, to);
            left = Operand::Truth(Condition::And(Arc::new((a, b))).depth_checked(span)?, span);
        }
        Ok(left)
    }

    fn inverted(&mut self) -> Result<Operand, FormulaError> {
        self.blank();
        // `!=` is no negation. `not(` is handled like `!`.
        let bang = self.rest().starts_with('!') && !self.rest().starts_with("!=");
        let from = if bang { self.take("!") } else { self.take("not") };
        let Some(from) = from else { return self.comparison() };
        self.descend(from)?;
        let inner = self.inverted()?;
        self.depth -= 1;
        let (condition, to) = self.truth(inner)?;
        let span = join(from, to);
        Ok(Operand::Truth(Condition::Not(Arc::new(condition)).depth_checked(span)?, span))
    }

    fn comparison(&mut self) -> Result<Operand, FormulaError> {
        let first = self.sum()?;
        let mut chain: Option<(Condition, Span)> = None;
        let mut left = first;
        while let Some(symbol) = self.take_any(&["<=", ">=", "==", "!=", "<", ">"]) {
            let a = self.number(left)?;
            let right = self.sum()?;
            let b = self.number(right)?;
            self.place.alike(&a, &b, "they cannot be compared")?;
            let span = join(a.node.span, b.node.span);
            let difference =
                |x: &Typed, y: &Typed| Expression::new(Operation::Subtract(x.node.clone(), y.node.clone()), span);
            let is = match symbol {
                "<" => Condition::Is(Test::Positive, difference(&b, &a)?),
                "<=" => Condition::Is(Test::NotNegative, difference(&b, &a)?),
                ">" => Condition::Is(Test::Positive, difference(&a, &b)?),
                ">=" => Condition::Is(Test::NotNegative, difference(&a, &b)?),
                "==" => Condition::Is(Test::Zero, difference(&a, &b)?),
                _ => Condition::Not(Arc::new(Condition::Is(Test::Zero, difference(&a, &b)?))),
            };
            chain = Some(match chain {
                None => (is, span),
                Some((before, from)) => (Condition::And(Arc::new((before, is))).depth_checked(span)?, join(from, span)),
            });
            left = Operand::Number(b);
        }
        Ok(chain.map_or(left, |(condition, span)| Operand::Truth(condition, span)))
    }

    fn sum(&mut self) -> Result<Operand, FormulaError> {
        let mut left = self.product()?;
        while let Some(symbol) = self.take_any(&["+", "-"]) {
            let a = self.number(left)?;
            let right = self.product()?;
            let b = self.number(right)?;
            let is_sum = symbol == "+";
            let rule = if is_sum { "they cannot be added" } else { "they cannot be subtracted" };
            let constant = a.measure.constant().zip(b.measure.constant());
            let constant = constant.map(|(a, b)| if is_sum { a + b } else { a - b });
            let measure = self.place.alike(&a, &b, rule)?.with_constant(constant);
            let (a, b) = (a.node, b.node);
            let span = join(a.span, b.span);
            let kind = if is_sum { Operation::Add(a, b) } else { Operation::Subtract(a, b) };
            left = Operand::Number(Typed { node: Expression::new(kind, span)?, measure });
        }
        Ok(left)
    }

    fn product(&mut self) -> Result<Operand, FormulaError> {
        let mut left = self.factor()?;
        while let Some(symbol) = self.take_any(&["*", "/"]) {
            let a = self.number(left)?;
            let right = self.factor()?;
            let b = self.number(right)?;
            let is_product = symbol == "*";
            let measure = if is_product { a.measure.times(&b.measure) } else { a.measure.over(&b.measure) };
            let (a, b) = (a.node, b.node);
            let span = join(a.span, b.span);
            let kind = if is_product { Operation::Multiply(a, b) } else { Operation::Divide(a, b) };
            left = Operand::Number(self.place.product(Typed { node: Expression::new(kind, span)?, measure })?);
        }
        Ok(left)
    }

    fn factor(&mut self) -> Result<Operand, FormulaError> {
        let factor = self.signed()?;
        let (Operand::Number(Typed { node: Expression { span, .. }, .. }) | Operand::Truth(_, span)) = &factor;
        self.check_no_factor(*span)?;
        Ok(factor)
    }

    /// Signs bind less than powers: -2^2 is -4.
    fn signed(&mut self) -> Result<Operand, FormulaError> {
        self.blank();
        let from = self.at;
        let Some(symbol) = self.take_any(&["-", "+"]) else { return self.power() };
        self.descend((from, 1))?;
        let inner = self.signed()?;
        self.depth -= 1;
        let Typed { node, measure } = self.number(inner)?;
        if symbol == "+" {
            return Ok(Operand::Number(Typed { node, measure }));
        }
        let span = join((from, 1), node.span);
        let node = Expression::new(Operation::Apply(Function::Negative, node), span)?;
        Ok(Operand::Number(Typed { node, measure: measure.negative() }))
    }

    /// To the right first: 2^3^2 is 2^9; the exponent may have a sign.
    fn power(&mut self) -> Result<Operand, FormulaError> {
        let base = self.atom()?;
        if self.take("^").is_none() {
            return Ok(base);
        }
        let base = self.number(base)?;
        let exponent = self.signed()?;
        let exponent = self.number(exponent)?;
        let measure = self.place.power(&base, &exponent)?;
        let span = join(base.node.span, exponent.node.span);
        Ok(Operand::Number(Typed { node: Expression::new(Operation::Power(base.node, exponent.node), span)?, measure }))
    }

    fn atom(&mut self) -> Result<Operand, FormulaError> {
        self.blank();
        let from = self.at;
        if let Some(open) = self.take("(") {
            let inner = self.either()?;
            let close = self.close(open)?;
            let span = join(open, close);
            return Ok(match inner {
                Operand::Number(Typed { node, measure }) => {
                    Operand::Number(Typed { node: node.written_at(span), measure })
                }
                Operand::Truth(condition, _) => Operand::Truth(condition, span),
            });
        }
        match self.rest().chars().next() {
            Some(c) if c.is_ascii_digit() || c == '.' => self.literal(),
            Some(c) if c.is_alphabetic() || c == '_' => {
                let length =
                    self.rest().find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(self.rest().len());
                self.at += length;
                self.name((from, length))
            }
            _ => Err(error(self.here(), "a number, a name or a bracket is expected here")),
        }
    }

    fn literal(&mut self) -> Result<Operand, FormulaError> {
        let bytes = self.rest().as_bytes();
        let digits = |from: usize| bytes[from.min(bytes.len())..].iter().take_while(|b| b.is_ascii_digit()).count();
        let mut length = digits(0);
        if bytes.get(length) == Some(&b'.') {
            length += 1;
            length += digits(length);
        }
        if matches!(bytes.get(length), Some(b'e' | b'E')) {
            let sign = usize::from(matches!(bytes.get(length + 1), Some(b'+' | b'-')));
            let exponent = digits(length + 1 + sign);
            if exponent > 0 {
                length += 1 + sign + exponent;
            }
        }
        let span = (self.at, length);
        let text = &self.rest()[..length];
        let value = text.parse().ok().filter(|x: &f64| x.is_finite());
        let value = value.ok_or_else(|| error(span, "this is no number that can be used"))?;
        self.at += length;
        let exact = Double::decimal(text).unwrap_or(Double::from(value));
        let node = Expression::new(Operation::Number(exact), span)?;
        Ok(Operand::Number(Typed { node, measure: Measure::number(value) }))
    }

    fn name(&mut self, span: Span) -> Result<Operand, FormulaError> {
        let name = &self.text[span.0..span.0 + span.1];
        self.blank();
        if self.rest().starts_with('(') && FUNCTIONS.iter().any(|f| f.0 == name) {
            return self.call(name, span);
        }
        let (kind, measure) = if name == "t" {
            (Operation::Time, Measure::TIME)
        } else if let Some(index) = self.place.parameters.iter().position(|known| known.name == name) {
            let in_trig = self.place.in_trig;
            self.used[index][usize::from(in_trig)] = true;
            let parameter = &self.place.parameters[index];
            (Operation::Number(parameter.amount(in_trig).value), Measure::of(index, parameter))
        } else if let Some((_, value)) = CONSTANTS.iter().find(|(known, _)| *known == name) {
            (Operation::Number(*value), Measure::number(value.nearest()))
        } else {
            return Err(self.unknown(name, span));
        };
        Ok(Operand::Number(Typed { node: Expression::new(kind, span)?, measure }))
    }

    fn unknown(&self, name: &str, span: Span) -> FormulaError {
        if FUNCTIONS.iter().any(|f| f.0 == name) {
            return error(span, format!("`{name}` is a function: its arguments go in brackets"));
        }
        let parameters = || self.place.parameters.iter().map(|parameter| parameter.name.as_str());
        let known = FUNCTIONS.iter().map(|f| f.0).chain(CONSTANTS.iter().map(|c| c.0)).chain(parameters());
        let lower = in_letters(name).to_lowercase();
        let nearest = known.map(|k| (strsim::damerau_levenshtein(&k.to_lowercase(), &lower), k)).min();
        let message = match nearest {
            Some((distance, known)) if distance == 0 || distance <= 2 && distance < name.chars().count() => {
                format!("`{name}` is unknown; did you mean `{known}`?")
            }
            _ => format!("`{name}` is unknown: the time is `t`, other names must be parameters"),
        };
        let parameters: Vec<String> = parameters().map(|name| format!("`{name}`")).collect();
        let help = match parameters.as_slice() {
            [] => String::new(),
            parameters => format!("parameters here: {}", parameters.join(", ")),
        };
        FormulaError { help, ..error(span, message) }
    }

    fn call(&mut self, name: &str, word: Span) -> Result<Operand, FormulaError> {
        let open = self.expect("(")?;
        let mut terms = Vec::new();
        let outside = self.place.in_trig;
        self.place.in_trig |= matches!(name, "sin" | "cos" | "tan");
        let mut has_decimal_comma = false;
        loop {
            terms.push(self.either()?);
            let Some((comma, _)) = self.take(",") else { break };
            has_decimal_comma |= self.is_decimal_comma(comma);
        }
        self.place.in_trig = outside;
        let close = self.close(open)?;
        let span = join(word, close);
        let arity = FUNCTIONS.iter().find(|f| f.0 == name).map_or(0, |f| f.1);
        if arity != 0 && terms.len() != arity {
            let given = terms.len();
            let help = if has_decimal_comma { POINT.to_owned() } else { String::new() };
            let message = format!("`{name}` takes {arity} argument(s); here are {given}");
            return Err(FormulaError { help, ..error(span, message) });
        }
        self.shorthand(name, terms, span)
    }

    fn shorthand(&mut self, name: &str, terms: Vec<Operand>, span: Span) -> Result<Operand, FormulaError> {
        let make = |kind| Expression::new(kind, span);
        let number = |x: f64| Expression::number(Double::from(x), span);
        let apply = |f, x: &Expression| make(Operation::Apply(f, x.clone()));
        let add = |a: Expression, b: Expression| make(Operation::Add(a, b));
        let sub = |a: &Expression, b: &Expression| make(Operation::Subtract(a.clone(), b.clone()));
        let div = |a: &Expression, b: &Expression| make(Operation::Divide(a.clone(), b.clone()));
        let branch = |c: Condition, a: &Expression, b: &Expression| make(Operation::If(c, a.clone(), b.clone()));
        let negative = |x: &Expression| apply(Function::Negative, x);
        let at_least = |a: &Expression, b: &Expression| Ok(Condition::Is(Test::NotNegative, sub(a, b)?));
        let magnitude = |x: &Expression| branch(Condition::Is(Test::NotNegative, x.clone()), x, &negative(x)?);
        let half_turn = Expression::number(Double::PI, span);
        let quarter = Expression::number(Double::PI * Double::from(0.5), span);

        if name == "if" || name == "piecewise" {
            if terms.len().is_multiple_of(2) {
                return Err(error(span, "`piecewise` takes condition, value, …, and a value for all other times"));
            }
            let mut terms = terms.into_iter().rev();
            let otherwise = terms.next().ok_or_else(|| error(span, "`piecewise` needs a value"))?;
            let mut values = vec![self.number(otherwise)?];
            let mut node = values[0].node.clone();
            while let (Some(value), Some(condition)) = (terms.next(), terms.next()) {
                let (condition, _) = self.truth(condition)?;
                let value = self.number(value)?;
                node = branch(condition, &value.node, &node)?;
                values.push(value);
            }
            let values: Vec<&Typed> = values.iter().rev().collect();
            let measure = self.place.all_alike(&values, &format!("`{name}` gives values of one kind"))?;
            return Ok(Operand::Number(Typed { node, measure }));
        }
        if name == "not" {
            let mut terms = terms;
            let (condition, _) = self.truth(terms.remove(0))?;
            return Ok(Operand::Truth(Condition::Not(Arc::new(condition)).depth_checked(span)?, span));
        }
        let arguments: Vec<Typed> = terms.into_iter().map(|t| self.number(t)).collect::<Result<_, _>>()?;
        let (factor, measure) = self.measure(name, &arguments)?;
        let arguments: Vec<Expression> = arguments.into_iter().map(|argument| argument.node).collect();
        let node = match (name, arguments.as_slice()) {
            ("sin", [x]) => apply(Function::Sine, x)?,
            ("cos", [x]) => apply(Function::Cosine, x)?,
            ("tan", [x]) => div(&apply(Function::Sine, x)?, &apply(Function::Cosine, x)?)?,
            ("asin", [x]) => apply(Function::Arcsine, x)?,
            ("acos", [x]) => sub(&quarter, &apply(Function::Arcsine, x)?)?,
            ("atan", [x]) => apply(Function::Arctangent, x)?,
            ("atan2", [y, x]) => {
                let flat = apply(Function::Arctangent, &div(y, x)?)?;
                let upright = apply(Function::Arctangent, &div(x, y)?)?;
                let up = Condition::Is(Test::NotNegative, y.clone());
                let turned = branch(up.clone(), &add(flat.clone(), half_turn.clone())?, &sub(&flat, &half_turn)?)?;
                let flat = branch(Condition::Is(Test::NotNegative, x.clone()), &flat, &turned)?;
                let upright = sub(&branch(up, &quarter, &negative(&quarter)?)?, &upright)?;
                branch(at_least(&magnitude(x)?, &magnitude(y)?)?, &flat, &upright)?
            }
            ("sinh" | "cosh", [x]) => {
                let rising = apply(Function::Exponential, x)?;
                let falling = apply(Function::Exponential, &negative(x)?)?;
                let twice = if name == "sinh" { sub(&rising, &falling)? } else { add(rising, falling)? };
                div(&twice, &number(2.0))?
            }
            ("tanh", [x]) => apply(Function::HyperbolicTangent, x)?,
            ("exp", [x]) => apply(Function::Exponential, x)?,
            ("ln" | "log", [x]) => apply(Function::Logarithm, x)?,
            ("sqrt", [x]) => apply(Function::Root, x)?,
            ("pow", [x, y]) => make(Operation::Power(x.clone(), y.clone()))?,
            ("hypot", [x, y]) => {
                let square = |x: &Expression| make(Operation::Power(x.clone(), number(2.0)));
                apply(Function::Root, &add(square(x)?, square(y)?)?)?
            }
            ("abs", [x]) => magnitude(x)?,
            ("sign", [x]) => {
                let not_positive = branch(Condition::Is(Test::Zero, x.clone()), &number(0.0), &number(-1.0))?;
                branch(Condition::Is(Test::Positive, x.clone()), &number(1.0), &not_positive)?
            }
            ("min", [a, b]) => branch(at_least(b, a)?, a, b)?,
            ("max", [a, b]) => branch(at_least(a, b)?, a, b)?,
            ("clamp", [x, low, high]) => {
                let raised = branch(at_least(x, low)?, x, low)?;
                branch(at_least(high, &raised)?, &raised, high)?
            }
            ("floor", [x]) => make(Operation::Floor(x.clone()))?,
            ("ceil", [x]) => negative(&make(Operation::Floor(negative(x)?))?)?,
            ("round", [x]) => make(Operation::Floor(add(x.clone(), number(0.5))?))?,
            ("mod", [x, m]) => {
                let whole = make(Operation::Floor(div(x, m)?))?;
                sub(x, &make(Operation::Multiply(m.clone(), whole))?)?
            }
            _ => return Err(error(span, format!("`{name}` is unknown"))),
        };
        let node = match factor {
            Some(factor) => make(Operation::Multiply(Expression::number(factor, span), node))?,
            None => node,
        };
        Ok(Operand::Number(Typed { node, measure }))
    }

    /// What a function of numbers gives, and by which factor its value comes in this place's unit.
    fn measure(&self, name: &str, arguments: &[Typed]) -> Result<(Option<Double>, Measure), FormulaError> {
        let place = &self.place;
        let all: Vec<&Typed> = arguments.iter().collect();
        let measure = match (name, arguments) {
            ("sin" | "cos" | "tan", [x]) => {
                place.angle(name, x)?;
                Measure::PLAIN
            }
            ("asin" | "acos" | "atan", [x]) => {
                place.plain(&format!("the argument of `{name}`"), x)?;
                return Ok(place.inverse());
            }
            ("atan2", _) => {
                place.all_alike(&all, "`atan2` takes two of one kind")?;
                return Ok(place.inverse());
            }
            ("sqrt", [x]) => x.measure.power(0.5),
            ("pow", [base, exponent]) => place.power(base, exponent)?,
            ("abs", [x]) => x.measure.magnitude(),
            ("hypot" | "min" | "max" | "clamp" | "mod", _) => {
                place.all_alike(&all, &format!("`{name}` takes values of one kind"))?
            }
            ("floor" | "ceil" | "round", [x]) => place.countable(name, x)?,
            ("sign", _) => Measure::PLAIN,
            (_, [x]) => {
                place.plain(&format!("the argument of `{name}`"), x)?;
                Measure::PLAIN
            }
            _ => Measure::PLAIN,
        };
        Ok((None, measure))
    }
}
