//! Text → expression tree. Functions with branches or simple identities are spelled out by the smooth ones here.

use super::FormulaError;
use super::dimension::{Measure, Parameter, Place, Typed, Unit};
use super::tree::{Condition, Expression, Function, LARGEST, Operation, Span, Test, error};
use super::words::{self, FormulaFunction};
use crate::law::double::Double;
use std::sync::Arc;

/// The message about a decimal comma.
pub(super) const POINT: &str = "decimals are written with a point: 0.5";

/// Brackets and signs nest no deeper, and so no text overflows the stack.
const NESTED: u32 = 64;
/// A sum of more terms is added up in halves, so that its tree stays flat.
const FLAT: usize = 32;

const TIMES: &[&str] = &["*", "×", "·", "⋅", "∙", "∗"];
const OVER: &[&str] = &["/", "÷", "∕"];
/// The hyphen, the sign, and what word processors make of them.
pub(super) const MINUS: &[&str] = &["-", "−", "–", "‐", "‑"];
const PLUS: &[&str] = &["+"];
pub(super) const SUPERSCRIPTS: &str = "⁰¹²³⁴⁵⁶⁷⁸⁹";
pub(super) const DEGREES: &[char] = &['°', 'º', '˚'];

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

/// Whether a name goes on with it.
pub(super) fn is_of_name(c: char) -> bool {
    (c.is_alphanumeric() && !SUPERSCRIPTS.contains(c) && !DEGREES.contains(&c)) || c == '_'
}

pub(super) fn begins_name(c: char) -> bool {
    is_of_name(c) && !c.is_numeric()
}

/// The name at the beginning of a text.
pub(super) fn first_word(text: &str) -> &str {
    if text.starts_with(begins_name) { &text[..text.find(|c| !is_of_name(c)).unwrap_or(text.len())] } else { "" }
}

/// What a name stands for in every formula, so that no parameter can have it. `tau` and `e` a parameter may be called: time constants often are.
pub(crate) fn taken(name: &str) -> Option<&'static str> {
    match name {
        "t" => Some("the time"),
        "pi" | "π" => Some("a constant"),
        "and" | "or" => Some("a word that joins conditions"),
        _ if words::function(name).is_some() => Some("a function"),
        _ => None,
    }
}

/// Reads `text`, in which `parameters` are known by name, and whose result is in `unit`.
pub(super) fn parse(text: &str, parameters: &[Parameter], unit: &Unit) -> Result<Parsed, FormulaError> {
    let place = Place { text, unit, parameters, in_trig: false };
    let mut parser = Parser { text, at: 0, depth: 0, place, used: vec![[false; 2]; parameters.len()] };
    if text.trim().is_empty() {
        return Err(error((0, text.len()), "the formula is empty").helped("write, for example: `90*sin(2*pi*0.5*t)`"));
    }
    let term = parser.either()?;
    parser.blank();
    if parser.at < text.len() {
        return Err(parser.unexpected("an operator or the end is expected here"));
    }
    let whole = parser.number(term)?;
    parser.place.result(&whole)?;
    Ok(Parsed { tree: whole.node, used: parser.used })
}

pub(super) fn join(a: Span, b: Span) -> Span {
    (a.0, b.0 + b.1 - a.0)
}

pub(super) struct Parser<'a> {
    pub(super) text: &'a str,
    pub(super) at: usize,
    depth: u32,
    pub(super) place: Place<'a>,
    used: Vec<[bool; 2]>,
}

/// An operation of two expressions.
type Join = fn(Expression, Expression) -> Operation;

/// One of several that are joined left to right: whether it is added (multiplied, or joined) as it is, and what it is.
type Link<T> = (bool, T);

/// Joins `links` left to right; many of them in halves, which changes no value but makes a flat tree. `flip`: the other way round each.
fn joined<T: Clone>(
    links: &[Link<T>],
    flip: bool,
    join: &impl Fn(bool, T, T) -> Result<T, FormulaError>,
) -> Result<Option<T>, FormulaError> {
    if links.len() > FLAT {
        let (left, right) = links.split_at(links.len() / 2);
        let is_direct = right.first().is_none_or(|first| first.0);
        let (left, right) = (joined(left, flip, join)?, joined(right, !is_direct, join)?);
        return left.zip(right).map(|(left, right)| join(is_direct != flip, left, right)).transpose();
    }
    let Some(((_, first), others)) = links.split_first() else { return Ok(None) };
    others
        .iter()
        .try_fold(first.clone(), |so_far, (is_direct, next)| join(*is_direct != flip, so_far, next.clone()))
        .map(Some)
}

impl<'a> Parser<'a> {
    pub(super) fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    pub(super) fn blank(&mut self) {
        self.at = self.text.len() - self.rest().trim_start().len();
    }

    /// Takes `symbol` if it comes next; a word only if it ends there.
    fn take(&mut self, symbol: &str) -> Option<Span> {
        self.blank();
        let after = self.rest().strip_prefix(symbol)?;
        let is_word = symbol.starts_with(|c: char| c.is_alphabetic());
        if is_word && after.starts_with(is_of_name) {
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
            return Err(error(here, format!("the formula is nested more than {NESTED} deep")).helped(
                "brackets, signs and powers within one another count; name parts of it, or add laws up with law.sum",
            ));
        }
        Ok(())
    }

    /// The character that comes next.
    pub(super) fn here(&mut self) -> Span {
        self.blank();
        (self.at, self.rest().chars().next().map_or(0, char::len_utf8))
    }

    /// Whether there is a comma with digits at both sides.
    pub(super) fn is_decimal_comma(&self, at: usize) -> bool {
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
        let first = self.both()?;
        let all = self.conditions(first, &["or", "||"], Parser::both, Condition::Or)?;
        self.depth -= 1;
        Ok(all)
    }

    fn both(&mut self) -> Result<Operand, FormulaError> {
        let first = self.inverted()?;
        self.conditions(first, &["and", "&&"], Parser::inverted, Condition::And)
    }

    /// Conditions that follow `first`, each behind one of the `words`.
    fn conditions(
        &mut self,
        first: Operand,
        words: &[&'static str],
        next: fn(&mut Self) -> Result<Operand, FormulaError>,
        make: fn(Arc<(Condition, Condition)>) -> Condition,
    ) -> Result<Operand, FormulaError> {
        if self.take_any(words).is_none() {
            return Ok(first);
        }
        let mut links = vec![(true, self.truth(first)?)];
        loop {
            let right = next(self)?;
            links.push((true, self.truth(right)?));
            if self.take_any(words).is_none() {
                break;
            }
        }
        let join = |_, (a, from): (Condition, Span), (b, to): (Condition, Span)| {
            let span = join(from, to);
            Ok((make(Arc::new((a, b))).depth_checked(span)?, span))
        };
        let all = joined(&links, false, &join)?;
        all.map(|(condition, span)| Operand::Truth(condition, span))
            .ok_or_else(|| error((0, 0), "a condition is missing"))
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
        loop {
            self.no_foreign_comparison()?;
            let Some(symbol) = self.take_any(&["<=", ">=", "==", "!=", "≤", "≥", "≠", "<", ">"]) else { break };
            let a = self.number(left)?;
            let right = self.sum()?;
            let b = self.number(right)?;
            self.place.alike(&a, &b, "they cannot be compared")?;
            let span = join(a.node.span, b.node.span);
            let difference =
                |x: &Typed, y: &Typed| Expression::new(Operation::Subtract(x.node.clone(), y.node.clone()), span);
            let is = match symbol {
                "<" => Condition::Is(Test::Positive, difference(&b, &a)?),
                "<=" | "≤" => Condition::Is(Test::NotNegative, difference(&b, &a)?),
                ">" => Condition::Is(Test::Positive, difference(&a, &b)?),
                ">=" | "≥" => Condition::Is(Test::NotNegative, difference(&a, &b)?),
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
        self.chain(
            (PLUS, MINUS),
            Parser::product,
            |place, a, b, is_plus| {
                let rule = if is_plus { "they cannot be added" } else { "they cannot be subtracted" };
                let constant = a.measure.constant().zip(b.measure.constant());
                let constant = constant.map(|(a, b)| if is_plus { a + b } else { a - b });
                Ok(place.alike(a, b, rule)?.with_constant(constant))
            },
            (Operation::Add, Operation::Subtract),
        )
    }

    fn product(&mut self) -> Result<Operand, FormulaError> {
        self.chain(
            (TIMES, OVER),
            Parser::factor,
            |place, a, b, is_product| {
                let measure = if is_product { a.measure.times(&b.measure) } else { a.measure.over(&b.measure) };
                let node = a.node.clone().written_at(join(a.node.span, b.node.span));
                place.product(Typed { node, measure }).map(|product| product.measure)
            },
            (Operation::Multiply, Operation::Divide),
        )
    }

    /// A sum or a product: of `next`s with symbols between them, those that join as it is and those that invert.
    fn chain(
        &mut self,
        (direct, inverse): (&[&'static str], &[&'static str]),
        next: fn(&mut Self) -> Result<Operand, FormulaError>,
        measure: impl Fn(&Place, &Typed, &Typed, bool) -> Result<Measure, FormulaError>,
        (join_direct, join_inverse): (Join, Join),
    ) -> Result<Operand, FormulaError> {
        let first = next(self)?;
        let mut links: Vec<Link<Expression>> = Vec::new();
        // What has been read so far: its measure and its place.
        let mut all = first;
        let mut size = 0;
        loop {
            self.no_foreign_operator()?;
            let is_direct = self.take_any(direct).is_some();
            if !is_direct && self.take_any(inverse).is_none() {
                break;
            }
            let a = self.number(all)?;
            if links.is_empty() {
                size = a.node.size();
                links.push((true, a.node.clone()));
            }
            let right = next(self)?;
            let b = self.number(right)?;
            size = b.node.size().saturating_add(size).saturating_add(1);
            if size > LARGEST {
                let nth = links.len() + 1;
                let message =
                    format!("the formula is too long: {LARGEST} operations at most, and this is the {nth}th part");
                return Err(error(b.node.span, message)
                    .helped("make several laws of it, and add them up with law.sum; or write a table"));
            }
            let measure = measure(&self.place, &a, &b, is_direct)?;
            let node = a.node.written_at(join(links[0].1.span, b.node.span));
            links.push((is_direct, b.node));
            all = Operand::Number(Typed { node, measure });
        }
        let join = |is_direct: bool, a: Expression, b: Expression| {
            let span = join(a.span, b.span);
            Expression::new(if is_direct { join_direct(a, b) } else { join_inverse(a, b) }, span)
        };
        match (joined(&links, false, &join)?, all) {
            (Some(node), Operand::Number(all)) => Ok(Operand::Number(Typed { node, ..all })),
            (_, all) => Ok(all),
        }
    }

    fn factor(&mut self) -> Result<Operand, FormulaError> {
        let factor = self.signed()?;
        let (Operand::Number(Typed { node: Expression { span, .. }, .. }) | Operand::Truth(_, span)) = &factor;
        self.no_missing_operator(*span)?;
        Ok(factor)
    }

    /// Signs bind less than powers: -2^2 is -4.
    fn signed(&mut self) -> Result<Operand, FormulaError> {
        let from = self.here();
        let is_minus = self.take_any(MINUS).is_some();
        if !is_minus && self.take_any(PLUS).is_none() {
            return self.power();
        }
        self.descend(from)?;
        let inner = self.signed()?;
        self.depth -= 1;
        let Typed { node, measure } = self.number(inner)?;
        if !is_minus {
            return Ok(Operand::Number(Typed { node, measure }));
        }
        let span = join(from, node.span);
        let node = Expression::new(Operation::Apply(Function::Negative, node), span)?;
        Ok(Operand::Number(Typed { node, measure: measure.negative() }))
    }

    /// To the right first: 2^3^2 is 2^9; the exponent may have a sign.
    fn power(&mut self) -> Result<Operand, FormulaError> {
        let base = self.atom()?;
        let (exponent, is_raised) = match self.superscript()? {
            Some(exponent) => (exponent, true),
            None => match self.take_any(&["^", "**"]) {
                None => return Ok(base),
                Some(symbol) => {
                    self.descend((self.at - symbol.len(), symbol.len()))?;
                    let exponent = self.signed()?;
                    self.depth -= 1;
                    (self.number(exponent)?, false)
                }
            },
        };
        let base = self.number(base)?;
        if is_raised && let Some(again) = self.take_any(&["^", "**"]) {
            let at = (self.at - again.len(), again.len());
            return Err(error(at, "which power comes first?").helped("write it with brackets: `(t^2)^3`, or `t^(2^3)`"));
        }
        let measure = self.place.power(&base, &exponent)?;
        let span = join(base.node.span, exponent.node.span);
        Ok(Operand::Number(Typed { node: Expression::new(Operation::Power(base.node, exponent.node), span)?, measure }))
    }

    /// A raised whole number, as in t².
    fn superscript(&mut self) -> Result<Option<Typed>, FormulaError> {
        let from = self.at;
        let sign = if self.rest().starts_with('⁻') { "-" } else { "" };
        let digits = &self.rest()[if sign.is_empty() { 0 } else { '⁻'.len_utf8() }..];
        let length = digits.find(|c| !SUPERSCRIPTS.contains(c)).unwrap_or(digits.len());
        if length == 0 {
            return Ok(None);
        }
        let digit = |c: char| SUPERSCRIPTS.chars().position(|known| known == c).unwrap_or(0).to_string();
        let number = format!("{sign}{}", digits[..length].chars().map(digit).collect::<String>());
        self.at = self.text.len() - digits.len() + length;
        let span = (from, self.at - from);
        let value = number.parse::<f64>().map_err(|_| error(span, "this is no number that can be used"))?;
        let node = Expression::number(Double::from(value), span);
        Ok(Some(Typed { node, measure: Measure::number(value) }))
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
            Some(c) if begins_name(c) => {
                let length = first_word(self.rest()).len();
                self.at += length;
                self.name((from, length))
            }
            _ => Err(self.no_operand()),
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
        if self.rest().starts_with('(') && words::function(name).is_some() {
            return self.call(name, span);
        }
        let (kind, measure) = if name == "t" {
            (Operation::Time, Measure::TIME)
        } else if let Some(index) = self.place.parameters.iter().position(|known| known.name == name) {
            let in_trig = self.place.in_trig;
            self.used[index][usize::from(in_trig)] = true;
            let parameter = &self.place.parameters[index];
            (Operation::Number(parameter.amount(in_trig).value), Measure::of(index, parameter))
        } else if let Some((_, value)) = words::constant(name) {
            (Operation::Number(*value), Measure::number(value.nearest()))
        } else {
            return Err(self.unknown(name, span));
        };
        Ok(Operand::Number(Typed { node: Expression::new(kind, span)?, measure }))
    }

    fn call(&mut self, name: &str, word: Span) -> Result<Operand, FormulaError> {
        let open = self.expect("(")?;
        let mut terms = Vec::new();
        let outside = self.place.in_trig;
        self.place.in_trig |= matches!(name, "sin" | "cos" | "tan");
        let mut has_decimal_comma = false;
        self.blank();
        while !(terms.is_empty() && self.rest().starts_with(')')) {
            terms.push(self.either()?);
            let Some((comma, _)) = self.take(",") else { break };
            has_decimal_comma |= self.is_decimal_comma(comma);
        }
        self.place.in_trig = outside;
        let close = self.close(open)?;
        let span = join(word, close);
        let Some(row) = words::function(name) else { return Err(self.unknown(name, word)) };
        let (least, most) = row.count;
        if !(least..=most).contains(&terms.len()) {
            return Err(wrong_count(row, terms.len(), has_decimal_comma, span));
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
            ("log10", [x]) => div(&apply(Function::Logarithm, x)?, &apply(Function::Logarithm, &number(10.0))?)?,
            ("log2", [x]) => div(&apply(Function::Logarithm, x)?, &apply(Function::Logarithm, &number(2.0))?)?,
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
            ("min", all) => best(all, &|a, b| branch(at_least(b, a)?, a, b), span)?,
            ("max", all) => best(all, &|a, b| branch(at_least(a, b)?, a, b), span)?,
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

/// That a function has too many or too few arguments.
fn wrong_count(row: &FormulaFunction, count: usize, has_decimal_comma: bool, span: Span) -> FormulaError {
    let FormulaFunction { name, arguments, count: (least, most), example: (example, _), .. } = row;
    let takes = match (*least, *most) {
        (1, 1) => "1 argument".to_owned(),
        (least, most) if least == most => format!("{least} arguments"),
        (least, most) => format!("{least} to {most} arguments"),
    };
    let help = if has_decimal_comma {
        POINT.to_owned()
    } else if matches!(*name, "log" | "ln") && count == 2 {
        "write `ln(x)/ln(b)` for another base, or `log10(x)`, `log2(x)`".to_owned()
    } else {
        format!("write `{name}({arguments})`, as in `{example}`")
    };
    error(span, format!("`{name}` takes {takes}; here are {count}")).helped(help)
}

/// The one of several that wins each comparison of two, in halves: a comparison doubles what is in it.
fn best(
    all: &[Expression],
    of_two: &impl Fn(&Expression, &Expression) -> Result<Expression, FormulaError>,
    span: Span,
) -> Result<Expression, FormulaError> {
    match all {
        [] => Err(error(span, "an argument is missing")),
        [one] => Ok(one.clone()),
        _ => {
            let (left, right) = all.split_at(all.len() / 2);
            of_two(&best(left, of_two, span)?, &best(right, of_two, span)?)
        }
    }
}
