//! What the parts of a formula measure: angles, lengths, steps or plain numbers; which of them go together, and what is said if not.
//!
//! Time has no part in it: times are numbers of seconds, frequencies of Hz, and a speed measures what its position does.

use super::FormulaError;
use super::parse::{Span, Typed, error};
use crate::law::double::Double;
use std::f64::consts::{PI, TAU};
use std::fmt;

/// Powers of an angle, of a length and of a number of steps; all 0 for a plain number.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Dimension {
    angle: f64,
    length: f64,
    /// Of a motor whose steps are both an angle and a length.
    steps: f64,
}

/// The unit of a formula's result.
#[derive(Clone, Debug)]
pub(crate) struct Unit {
    pub(crate) name: &'static str,
    /// What it measures. Steps of a motor with a lead measure both angles and lengths; a plain unit takes all.
    pub(crate) of: Dimension,
    /// Steps in one of it.
    pub(crate) steps: f64,
    /// What a radian comes to outside of sin, cos and tan: in this unit if that measures angles, else 1.
    pub(crate) per_rad: Double,
}

/// A named value of `where = { … }`: its number depends on where it is used.
#[derive(Clone, Debug)]
pub(crate) struct Parameter {
    pub(crate) name: String,
    /// As the file has it.
    pub(crate) written: String,
    pub(crate) dimension: Dimension,
    /// A speed, acceleration or jerk.
    pub(crate) is_rate: bool,
    pub(crate) outside: Amount,
    /// In sin, cos and tan.
    pub(crate) in_trig: Amount,
}

/// A number and its unit; no unit if it was given none.
#[derive(Clone, Debug)]
pub(crate) struct Amount {
    pub(crate) value: Double,
    pub(crate) unit: String,
}

/// What is known of an expression besides its value.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measure {
    dimension: Dimension,
    /// Its value, if that is a plain constant.
    constant: Option<f64>,
    /// The numbers that it is multiplied by, as far as they stand there without a unit.
    factor: f64,
    /// The power of pi in the factor.
    pi: f64,
    /// The parameter that its angle comes from, the first of them.
    parameter: Option<usize>,
    /// Divided by time.
    is_rate: bool,
    /// An angle that came from asin, acos, atan or atan2.
    is_inverse: bool,
    /// The power of rad in a plain number, as far as it is known: of pi, tau and asin in rad 1, of 180/pi -1.
    radians: f64,
    /// `t` is a factor.
    has_time: bool,
    /// A parameter that is a plain number is a factor.
    has_parameter: bool,
    /// A plain number was added to its angle or length.
    has_plain_term: bool,
}

/// Where in a formula an expression stands: that gives plain numbers their unit.
#[derive(Clone, Copy)]
pub(super) struct Place<'a> {
    pub(super) text: &'a str,
    pub(super) unit: &'a Unit,
    pub(super) parameters: &'a [Parameter],
    pub(super) in_trig: bool,
}

const DIVIDE: &str = "To get a plain number, divide by a unit: write `phi/rad` or `x/mm`, with where = { rad = \"1 rad\", mm = \"1 mm\" }";
const INVERSE: &str = "asin, acos, atan and atan2 return an angle. For a plain number of radians write `asin(x)/rad`, with where = { rad = \"1 rad\" }";
const ONE_FACTOR: &str = "A product may hold one angle or one length. All other factors must be plain numbers.";

impl Dimension {
    pub(crate) const PLAIN: Dimension = Dimension { angle: 0.0, length: 0.0, steps: 0.0 };
    pub(crate) const ANGLE: Dimension = Dimension { angle: 1.0, ..Dimension::PLAIN };
    pub(crate) const LENGTH: Dimension = Dimension { length: 1.0, ..Dimension::PLAIN };
    pub(crate) const STEPS: Dimension = Dimension { steps: 1.0, ..Dimension::PLAIN };

    /// Whether they are the same but for the rounding of broken powers.
    pub(crate) fn is(self, other: Dimension) -> bool {
        let same = |a: f64, b: f64| (a - b).abs() < 1e-9;
        same(self.angle, other.angle) && same(self.length, other.length) && same(self.steps, other.steps)
    }

    fn is_plain(self) -> bool {
        self.is(Dimension::PLAIN)
    }

    /// Of the product with the n-th power of another.
    fn times(self, other: Dimension, n: f64) -> Dimension {
        Dimension {
            angle: self.angle + n * other.angle,
            length: self.length + n * other.length,
            steps: self.steps + n * other.steps,
        }
    }

    fn without_angle(self) -> Dimension {
        Dimension { angle: 0.0, ..self }
    }

    fn is_position(self) -> bool {
        [Dimension::ANGLE, Dimension::LENGTH, Dimension::STEPS].into_iter().any(|one| self.is(one))
    }
}

/// "an angle", "a length squared", "angle^0.5·length".
impl fmt::Display for Dimension {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let powers = [("an angle", self.angle), ("a length", self.length), ("a number of steps", self.steps)];
        let parts: Vec<_> = powers.into_iter().filter(|(_, n)| n.abs() >= 1e-9).collect();
        let is = |n: f64, power: f64| (n - power).abs() < 1e-9;
        match parts.as_slice() {
            [] => f.write_str("a plain number"),
            [(name, n)] if is(*n, 1.0) => f.write_str(name),
            [(name, n)] if is(*n, 2.0) => write!(f, "{name} squared"),
            [(name, n)] if is(*n, -1.0) => write!(f, "one over {name}"),
            [(a, 1.0), (b, 1.0)] => write!(f, "{a} times {b}"),
            [(a, 1.0), (b, -1.0)] | [(b, -1.0), (a, 1.0)] => write!(f, "{a} over {b}"),
            _ => {
                for (k, (name, n)) in parts.iter().enumerate() {
                    let name = name.rsplit(' ').next().unwrap_or(name);
                    write!(f, "{}{name}^{n}", if k > 0 { "·" } else { "" })?;
                }
                Ok(())
            }
        }
    }
}

impl Unit {
    /// Of a formula whose parameters are plain numbers, and its angles in radians.
    pub(crate) fn plain(steps: f64) -> Unit {
        Unit { name: "rad", of: Dimension::PLAIN, steps, per_rad: Double::ONE }
    }
}

impl Parameter {
    pub(crate) fn plain(name: &str, value: f64) -> Parameter {
        let amount = Amount { value: Double::from(value), unit: String::new() };
        Parameter {
            name: name.to_owned(),
            written: value.to_string(),
            dimension: Dimension::PLAIN,
            is_rate: false,
            outside: amount.clone(),
            in_trig: amount,
        }
    }

    /// With the same numbers, for a text whose dimensions have been looked at before it was put together.
    pub(crate) fn without_dimension(&self) -> Parameter {
        Parameter { dimension: Dimension::PLAIN, ..self.clone() }
    }
}

impl Measure {
    /// Of what has no number of its own.
    pub(super) const PLAIN: Measure = Measure {
        dimension: Dimension::PLAIN,
        constant: None,
        factor: 1.0,
        pi: 0.0,
        parameter: None,
        is_rate: false,
        is_inverse: false,
        radians: 0.0,
        has_time: false,
        has_parameter: false,
        has_plain_term: false,
    };

    pub(super) const TIME: Measure = Measure { has_time: true, ..Measure::PLAIN };

    pub(super) fn number(value: f64) -> Measure {
        Measure { constant: Some(value), factor: value, ..Measure::PLAIN }
    }

    /// pi and tau.
    pub(super) fn angular(value: f64) -> Measure {
        Measure { pi: 1.0, radians: 1.0, ..Measure::number(value) }
    }

    pub(super) fn of(index: usize, parameter: &Parameter) -> Measure {
        let Parameter { dimension, is_rate, outside, .. } = parameter;
        let value = outside.value.nearest();
        if !dimension.is_plain() {
            return Measure {
                dimension: *dimension,
                parameter: Some(index).filter(|_| dimension.angle != 0.0),
                is_rate: *is_rate,
                ..Measure::PLAIN
            };
        }
        // Numbers of seconds are factors that are meant.
        let factor = if outside.unit.is_empty() { value } else { 1.0 };
        Measure { constant: Some(value), factor, has_parameter: true, ..Measure::PLAIN }
    }

    /// 0 is 0 in every unit.
    fn fits_all(&self) -> bool {
        self.constant == Some(0.0)
    }

    /// Of the product with the n-th power of another, n = ±1.
    fn product(&self, other: &Measure, n: i32) -> Measure {
        let power = f64::from(n);
        Measure {
            dimension: self.dimension.times(other.dimension, power),
            constant: self.constant.zip(other.constant).map(|(a, b)| a * b.powi(n)),
            factor: self.factor * other.factor.powi(n),
            pi: self.pi + power * other.pi,
            parameter: self.parameter.or(other.parameter),
            is_rate: self.is_rate || other.is_rate,
            is_inverse: self.is_inverse || other.is_inverse,
            radians: self.radians + power * other.radians,
            has_time: self.has_time || other.has_time,
            has_parameter: self.has_parameter || other.has_parameter,
            has_plain_term: self.has_plain_term || other.has_plain_term,
        }
    }

    pub(super) fn times(&self, other: &Measure) -> Measure {
        self.product(other, 1)
    }

    pub(super) fn over(&self, other: &Measure) -> Measure {
        self.product(other, -1)
    }

    pub(super) fn negative(&self) -> Measure {
        Measure { constant: self.constant.map(|c| -c), factor: -self.factor, ..*self }
    }

    pub(super) fn power(&self, n: f64) -> Measure {
        Measure {
            dimension: Dimension::PLAIN.times(self.dimension, n),
            constant: self.constant.map(|c| c.powf(n)),
            factor: self.factor.powf(n),
            pi: self.pi * n,
            radians: self.radians * n,
            ..*self
        }
    }

    pub(super) fn magnitude(&self) -> Measure {
        Measure { constant: self.constant.map(f64::abs), factor: self.factor.abs(), ..*self }
    }

    /// Of what has this dimension, but another number.
    fn reshaped(&self) -> Measure {
        Measure { constant: None, factor: 1.0, pi: 0.0, ..*self }
    }

    /// Of a sum, if both have the same dimension.
    pub(super) fn with_constant(self, constant: Option<f64>) -> Measure {
        Measure { constant, factor: constant.unwrap_or(1.0), ..self }
    }

    pub(super) fn constant(&self) -> Option<f64> {
        self.constant
    }
}

impl Place<'_> {
    fn in_radians(&self) -> bool {
        self.in_trig || self.unit.per_rad == Double::ONE
    }

    /// Whether a plain number has a unit here as what is of that dimension.
    fn has_unit(&self, dimension: Dimension) -> bool {
        let of = self.unit.of;
        let angle = self.in_trig || of.is(Dimension::ANGLE) || of.is(Dimension::STEPS);
        let length = of.is(Dimension::LENGTH) || of.is(Dimension::STEPS);
        (dimension.angle == 0.0 || angle) && (dimension.length == 0.0 || length)
    }

    fn angle_unit(&self) -> &str {
        if self.in_radians() { "rad" } else { self.unit.name }
    }

    /// The text at a place, not too much of it.
    fn quoted(&self, span: Span) -> String {
        const MOST: usize = 40;
        let text = self.text.get(span.0..span.0 + span.1).unwrap_or_default();
        let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        match text.char_indices().nth(MOST) {
            Some((end, _)) => format!("`{}…`", &text[..end]),
            None => format!("`{text}`"),
        }
    }

    /// "`x` is a length".
    fn is_what(&self, part: &Typed) -> String {
        format!("{} is {}", self.quoted(part.node.span), part.measure.dimension)
    }

    /// What a sum, a comparison or a choice between `a` and `b` is; `rule` ends what is said if they do not go together.
    pub(super) fn alike(&self, a: &Typed, b: &Typed, rule: &str) -> Result<Measure, FormulaError> {
        let (x, y) = (a.measure, b.measure);
        self.not_converted(a)?;
        self.not_converted(b)?;
        let both = |dimension| Measure {
            dimension,
            constant: None,
            factor: 1.0,
            pi: x.pi.max(y.pi),
            parameter: x.parameter.or(y.parameter),
            is_rate: x.is_rate || y.is_rate,
            is_inverse: x.is_inverse || y.is_inverse,
            // A number beside one in rad is in rad, too; what holds 1/rad makes no angle.
            radians: if x.radians.min(y.radians) < 0.0 { x.radians.min(y.radians) } else { x.radians.max(y.radians) },
            has_time: x.has_time || y.has_time,
            has_parameter: x.has_parameter || y.has_parameter,
            has_plain_term: x.has_plain_term || y.has_plain_term,
        };
        if x.dimension.is(y.dimension) || y.fits_all() {
            return Ok(both(x.dimension));
        }
        if x.fits_all() {
            return Ok(both(y.dimension));
        }
        for (plain, other) in [(a, b), (b, a)] {
            if plain.measure.dimension.is_plain() {
                self.plain_beside(plain, other)?;
                return Ok(Measure { has_plain_term: true, ..both(other.measure.dimension) });
            }
        }
        // An arc is a length: its angle in rad does not count.
        let arc = self.in_radians() && x.dimension.length != 0.0;
        if arc && x.dimension.without_angle().is(y.dimension.without_angle()) {
            return Ok(both(x.dimension.without_angle()));
        }
        for (steps, other) in [(x.dimension, y.dimension), (y.dimension, x.dimension)] {
            if steps.is(Dimension::STEPS) && other.is_position() {
                return Ok(both(other));
            }
        }
        let message = format!("{}, but {}: {rule}", self.is_what(a), self.is_what(b));
        Err(error(b.node.span, message).helped(DIVIDE))
    }

    /// The same of several.
    pub(super) fn all_alike(&self, parts: &[&Typed], rule: &str) -> Result<Measure, FormulaError> {
        let Some((first, others)) = parts.split_first() else { return Ok(Measure::PLAIN) };
        let mut all = Typed { node: first.node.clone(), measure: first.measure };
        for other in others {
            let was_plain = all.measure.dimension.is_plain();
            all.measure = self.alike(&all, other, rule)?;
            if was_plain {
                all.node = other.node.clone();
            }
        }
        Ok(all.measure)
    }

    /// A plain number that stands beside what has a dimension takes the unit of this place, if there is one.
    fn plain_beside(&self, plain: &Typed, other: &Typed) -> Result<(), FormulaError> {
        let (span, dimension) = (plain.node.span, other.measure.dimension);
        let is_arc = self.in_radians() && dimension.length != 0.0;
        if self.has_unit(if is_arc { dimension.without_angle() } else { dimension }) {
            if dimension.angle == 0.0 || self.in_radians() || plain.measure.pi < 1.0 {
                return Ok(());
            }
            let unit = self.angle_unit();
            let (plain, angle) = (self.quoted(span), self.quoted(other.node.span));
            let message = format!("{plain} beside the angle {angle} is a number of {unit}, as `unit` says");
            let help = format!("write it in {unit}, or as a parameter with its own unit, such as \"90 deg\"");
            return Err(error(span, message).helped(help));
        }
        if dimension.is(Dimension::ANGLE) && (plain.measure.radians - 1.0).abs() < 1e-9 {
            return Ok(());
        }
        let message = format!(
            "{} has no unit, but {}: `unit` is \"{}\", and so does not say which",
            self.quoted(span),
            self.is_what(other),
            self.unit.name
        );
        Err(error(span, message)
            .helped("give it as a parameter with its unit, such as where = { x = \"5 mm\", phi = \"90 deg\" }"))
    }

    /// An angle must not be converted by hand where it comes in the right unit by itself.
    fn not_converted(&self, part: &Typed) -> Result<(), FormulaError> {
        let Measure { dimension, factor, pi, parameter, is_rate, is_inverse, has_time, has_parameter, .. } =
            part.measure;
        // 57.3, 0.01745 and 6.28 are meant, too.
        let near = |x: f64| (factor.abs() / x - 1.0).abs() < 1e-3;
        let is_arc = dimension.length != 0.0;
        let by_degrees = near(180.0 / PI) || near(PI / 180.0) || near(1.0 / 360.0);
        let from_rpm = is_rate && near(PI / 30.0);
        let converted = by_degrees
            || near(360.0)
            || if self.in_trig || is_arc {
                near(TAU) || from_rpm
            } else if self.in_radians() {
                is_rate && near(TAU) || from_rpm
            } else {
                // A peak speed over 2*pi*f is an amplitude: it has a parameter, or no `t`, as its factor.
                is_rate && (near(TAU) || near(1.0 / TAU)) && has_time && !has_parameter
                    || is_inverse && (pi == -1.0 || near(self.unit.per_rad.nearest()))
            };
        if !converted || dimension.angle != 1.0 || dimension.steps != 0.0 {
            return Ok(());
        }
        let (span, unit) = (part.node.span, self.angle_unit());
        let (what, help) = match parameter.and_then(|index| self.parameters.get(index)) {
            Some(Parameter { name, written, .. }) if !is_inverse => {
                let in_hz = if is_rate && (near(TAU) || near(360.0)) {
                    format!(", or give `{name}` in Hz")
                } else {
                    String::new()
                };
                let help = if part.measure.has_plain_term {
                    format!("of the sum multiply the plain numbers alone, as in 2*pi*t/T - phi{in_hz}")
                } else {
                    format!("leave the factor out{in_hz}")
                };
                (format!("`{name}` = {written}"), help)
            }
            _ => {
                let help =
                    "leave the factor out; for the number of rad divide by an angle, where = { rad = \"1 rad\" }";
                ("what asin, acos, atan and atan2 give".to_owned(), help.to_owned())
            }
        };
        let message = format!("{} converts an angle by hand: {what} is in {unit} here already", self.quoted(span));
        Err(error(span, message).helped(help))
    }

    /// What must be a plain number; `what` it is.
    pub(super) fn plain(&self, what: &str, part: &Typed) -> Result<(), FormulaError> {
        if part.measure.dimension.is_plain() {
            return Ok(());
        }
        let message = format!("{what} is to be a plain number, but {}", self.is_what(part));
        Err(error(part.node.span, message).helped(if part.measure.is_inverse { INVERSE } else { DIVIDE }))
    }

    /// What sin, cos and tan take.
    pub(super) fn angle(&self, function: &str, part: &Typed) -> Result<(), FormulaError> {
        let inside = Place { in_trig: true, ..*self };
        inside.not_converted(part)?;
        let dimension = part.measure.dimension;
        if dimension.is_plain() || dimension.is(Dimension::ANGLE) {
            return Ok(());
        }
        let message = format!("`{function}` takes an angle, or a plain number in rad, but {}", self.is_what(part));
        let help = if dimension.is(Dimension::LENGTH) {
            "divide the length by a length, such as the radius"
        } else if dimension.is(Dimension::STEPS) {
            "give an angle in rev, deg or rad: of this motor a step is both an angle and a length"
        } else {
            ONE_FACTOR
        };
        Err(error(part.node.span, message).helped(help))
    }

    /// What floor, ceil and round take: they count whole ones of the motion's unit, or plain numbers.
    pub(super) fn countable(&self, function: &str, part: &Typed) -> Result<Measure, FormulaError> {
        self.not_converted(part)?;
        let dimension = part.measure.dimension;
        if dimension.is_plain() || !self.in_trig && dimension.is_position() && self.has_unit(dimension) {
            return Ok(part.measure.reshaped());
        }
        let message = format!("`{function}` takes a plain number here, but {}", self.is_what(part));
        let help = "divide by what is to be counted, such as a parameter of \"1 rev\"";
        Err(error(part.node.span, message).helped(help))
    }

    pub(super) fn power(&self, base: &Typed, exponent: &Typed) -> Result<Measure, FormulaError> {
        self.plain("an exponent", exponent)?;
        match exponent.measure.constant() {
            Some(n) => Ok(base.measure.power(n)),
            None if base.measure.dimension.is_plain() => Ok(Measure::PLAIN),
            None => {
                let message = format!(
                    "{}: its power must be a number, but {} changes",
                    self.is_what(base),
                    self.quoted(exponent.node.span)
                );
                Err(error(exponent.node.span, message).helped(DIVIDE))
            }
        }
    }

    /// What asin, acos, atan and atan2 give: the factor that makes it one of this place, and what it is.
    pub(super) fn inverse(&self) -> (Option<Double>, Measure) {
        if self.in_radians() {
            return (None, Measure { radians: 1.0, ..Measure::PLAIN });
        }
        (Some(self.unit.per_rad), Measure { dimension: Dimension::ANGLE, is_inverse: true, ..Measure::PLAIN })
    }

    /// Whether the whole formula fits its unit.
    pub(super) fn result(&self, whole: &Typed) -> Result<(), FormulaError> {
        let (of, dimension) = (self.unit.of, whole.measure.dimension);
        if of.is_plain() || dimension.is_plain() || whole.measure.fits_all() {
            return Ok(());
        }
        self.not_converted(whole)?;
        // An angle times a length is an arc.
        let is_arc = of.is(Dimension::LENGTH) && dimension.without_angle().is(of);
        if dimension.is(of) || is_arc || of.is(Dimension::STEPS) && dimension.is_position() {
            return Ok(());
        }
        let message = format!("it comes to {dimension}, but `unit` is \"{}\", which is {of}", self.unit.name);
        let help = if of.is(Dimension::LENGTH) && dimension.is(Dimension::ANGLE) {
            "give amplitudes as lengths, or multiply by a radius: an angle times a length is an arc"
        } else if dimension.is(Dimension::LENGTH) {
            "give amplitudes as angles, or say unit = \"mm\" for a motor with a `lead`"
        } else if whole.measure.is_inverse {
            INVERSE
        } else {
            ONE_FACTOR
        };
        Err(error(whole.node.span, message).helped(help))
    }
}
