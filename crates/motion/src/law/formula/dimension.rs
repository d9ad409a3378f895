//! What the parts of a formula measure: angles, lengths, steps or plain numbers; which of them go together, and the message if they do not.
//!
//! Time has no part in it: times are numbers of seconds, frequencies of Hz, and a speed measures what its position does.
//!
//! A quantity has its number here already: factors that convert it by hand are refused. These are 360, 2π and 180/π on angles, and what its number
//! here is of the number as written: n = "30 rpm" is 180 deg/s, and so is not to be divided by 60. What may be a gear is one: 6·n is taken.

use super::FormulaError;
use super::tree::{Expression, Span, error};
use crate::law::double::Double;
use crate::quantity::{Base, written};
use crate::whole_power;
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::fmt;

/// A number, and what it measures.
#[derive(Clone, Debug)]
pub(super) struct Typed {
    pub(super) node: Expression,
    pub(super) measure: Measure,
}

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
    /// What the motor travels in a turn, in this unit, if that measures lengths.
    pub(crate) lead: Option<f64>,
}

/// A named value of `where = { … }`: its number depends on where it is used.
#[derive(Clone, Debug)]
pub(crate) struct Parameter {
    pub(crate) name: String,
    /// As the file has it.
    pub(crate) written: String,
    pub(crate) dimension: Dimension,
    /// How its unit is written; `None` for a plain number.
    pub(crate) scale: Option<WrittenUnit>,
    /// A speed, acceleration or jerk.
    pub(crate) is_rate: bool,
    pub(crate) outside: Amount,
    /// In sin, cos and tan.
    pub(crate) in_trig: Amount,
}

/// How a quantity is written.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WrittenUnit {
    /// The number, without its unit.
    pub(crate) number: f64,
    /// What a rate is divided by, s: 60 of rpm.
    pub(crate) per_s: f64,
    pub(crate) base: Base,
    /// An angle in turns.
    pub(crate) in_turns: bool,
}

/// A number and its unit; no unit if it was given none.
#[derive(Clone, Debug)]
pub(crate) struct Amount {
    pub(crate) value: Double,
    pub(crate) unit: String,
}

/// What is known of an expression, without its value.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measure {
    dimension: Dimension,
    /// Its value, if that is a plain constant.
    constant: Option<f64>,
    /// The numbers that it is multiplied by, as far as they stand there without a unit.
    factor: f64,
    /// The power of pi in the factor.
    pi: f64,
    /// The numbers of the formula's text among them, without pi.
    literals: Few<f64>,
    /// The parameters with a unit that are factors, and their powers.
    uses: Few<(u16, f32)>,
    /// Divided by time.
    is_rate: bool,
    /// An angle that came from asin, acos, atan or atan2.
    is_inverse: bool,
    /// The power of rad in a plain number, if that is known: of pi, tau and asin in rad 1, of 180/pi -1, of 180/pi*asin 0.
    radians: Option<f64>,
    /// `t` is a factor.
    has_time: bool,
    /// A parameter that is a plain number is a factor.
    has_parameter: bool,
    /// A plain number was added to its angle or length.
    has_plain_term: bool,
    /// It is a plain number because angles or lengths cancel.
    is_ratio: bool,
    /// A term of it is 360 times a time.
    has_degrees: bool,
}

/// The first of some factors: a formula that people write has no more in one product.
#[derive(Clone, Copy, Debug)]
struct Few<T> {
    all: [T; 6],
    len: usize,
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

/// Numbers that people write for an angle's: pi over 1, 2 and 1/2, and what degrees and radians are of one another.
const ANGULAR: [(f64, f64); 8] = [
    (PI, 1.0),
    (TAU, 1.0),
    (FRAC_PI_2, 1.0),
    (PI / 180.0, 1.0),
    (180.0 / PI, -1.0),
    (1.0 / PI, -1.0),
    (1.0 / TAU, -1.0),
    (2.0 / PI, -1.0),
];
/// 3.14 and 6.28 are those, too; as a part.
const ROUNDED: f64 = 6e-4;
/// No conversion by hand is less precise, as a part.
const CONVERTED: f64 = 1e-3;
/// A whole number up to this, and one over it, may be a gear.
const LARGEST_GEAR: f64 = 20.0;

/// Whether a number is meant for `x`; signs do not count.
fn is_near(number: f64, x: f64) -> bool {
    (number.abs() / x - 1.0).abs() < CONVERTED
}

fn may_be_gear(literal: f64) -> bool {
    let is_whole = |x: f64| x < LARGEST_GEAR + 0.5 && (x - x.round()).abs() < 1e-9;
    is_whole(literal.abs()) || is_whole(1.0 / literal.abs())
}

impl<T: Copy> Few<T> {
    const fn none(filler: T) -> Few<T> {
        Few { all: [filler; 6], len: 0 }
    }

    fn iter(&self) -> impl Iterator<Item = T> + '_ {
        self.all.iter().take(self.len).copied()
    }

    /// With more of them, as many as there is room for.
    fn and(mut self, more: impl Iterator<Item = T>) -> Few<T> {
        for (place, one) in self.all.iter_mut().skip(self.len).zip(more) {
            *place = one;
            self.len += 1;
        }
        self
    }
}

impl Few<f64> {
    fn product(&self) -> f64 {
        self.iter().product()
    }

    fn has(&self, x: f64) -> bool {
        self.iter().any(|literal| is_near(literal, x))
    }

    /// Whether some of them, with another factor, come to `x`.
    fn some_come_to(&self, x: f64, other: f64) -> bool {
        (0_u32..1 << self.len).any(|chosen| {
            let chosen = self.iter().enumerate().filter(|(k, _)| chosen >> k & 1 == 1);
            is_near(other * chosen.map(|(_, literal)| literal).product::<f64>(), x)
        })
    }
}

impl Dimension {
    pub(crate) const PLAIN: Dimension = Dimension { angle: 0.0, length: 0.0, steps: 0.0 };
    pub(crate) const ANGLE: Dimension = Dimension { angle: 1.0, ..Dimension::PLAIN };
    pub(crate) const LENGTH: Dimension = Dimension { length: 1.0, ..Dimension::PLAIN };
    pub(crate) const STEPS: Dimension = Dimension { steps: 1.0, ..Dimension::PLAIN };

    /// Whether they are equal up to the rounding of fractional powers.
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
        Unit { name: "rad", of: Dimension::PLAIN, steps, per_rad: Double::ONE, lead: None }
    }
}

impl Parameter {
    pub(crate) fn plain(name: &str, value: f64) -> Parameter {
        let amount = Amount { value: Double::from(value), unit: String::new() };
        Parameter {
            name: name.to_owned(),
            written: value.to_string(),
            dimension: Dimension::PLAIN,
            scale: None,
            is_rate: false,
            outside: amount.clone(),
            in_trig: amount,
        }
    }

    /// The parameter with its numbers, without a dimension, for a text whose dimensions have already been checked.
    pub(crate) fn without_dimension(&self) -> Parameter {
        Parameter { dimension: Dimension::PLAIN, scale: None, ..self.clone() }
    }

    /// Its number where that stands.
    pub(super) fn amount(&self, in_trig: bool) -> &Amount {
        if in_trig { &self.in_trig } else { &self.outside }
    }
}

impl Measure {
    /// Of what has no number of its own.
    pub(super) const PLAIN: Measure = Measure {
        dimension: Dimension::PLAIN,
        constant: None,
        factor: 1.0,
        pi: 0.0,
        literals: Few::none(1.0),
        uses: Few::none((0, 0.0)),
        is_rate: false,
        is_inverse: false,
        radians: None,
        has_time: false,
        has_parameter: false,
        has_plain_term: false,
        is_ratio: false,
        has_degrees: false,
    };

    pub(super) const TIME: Measure = Measure { has_time: true, ..Measure::PLAIN };

    /// Of a number in the formula's text.
    pub(super) fn number(value: f64) -> Measure {
        let angular = Measure::known(value);
        let rest = value / libm::pow(PI, angular.pi);
        Measure { literals: angular.literals.and([rest].into_iter()), ..angular }
    }

    /// Of a number, by its value alone.
    fn known(value: f64) -> Measure {
        let plain = Measure { constant: Some(value), factor: value, ..Measure::PLAIN };
        let angular = ANGULAR.iter().find(|(known, _)| (value.abs() / known - 1.0).abs() < ROUNDED);
        angular.map_or(plain, |(_, power)| Measure { pi: *power, radians: Some(*power), ..plain })
    }

    pub(super) fn of(index: usize, parameter: &Parameter) -> Measure {
        let Parameter { dimension, scale, is_rate, outside, .. } = parameter;
        let value = outside.value.nearest();
        let uses = Few::none((0, 0.0)).and(scale.and(u16::try_from(index).ok()).map(|index| (index, 1.0)).into_iter());
        if !dimension.is_plain() {
            return Measure { dimension: *dimension, uses, is_rate: *is_rate, ..Measure::PLAIN };
        }
        if scale.is_some() {
            // Numbers of seconds are factors that are meant.
            return Measure { constant: Some(value), uses, has_parameter: true, ..Measure::PLAIN };
        }
        Measure { has_parameter: true, ..Measure::known(value) }
    }

    /// 0 is 0 in every unit.
    fn fits_all(&self) -> bool {
        self.constant == Some(0.0)
    }

    /// Of the product with the n-th power of another, n = ±1.
    fn product(&self, other: &Measure, n: i32) -> Measure {
        let power = f64::from(n);
        let dimension = self.dimension.times(other.dimension, power);
        let cancels = dimension.is_plain() && !self.dimension.is_plain();
        Measure {
            dimension,
            is_ratio: cancels || self.is_ratio || other.is_ratio,
            constant: self.constant.zip(other.constant).map(|(a, b)| a * whole_power(b, n)),
            factor: self.factor * whole_power(other.factor, n),
            pi: self.pi + power * other.pi,
            literals: self.literals.and(other.literals.iter().map(|literal| whole_power(literal, n))),
            uses: self.uses.and(other.uses.iter().map(|(index, p)| (index, power as f32 * p))),
            is_rate: self.is_rate || other.is_rate,
            is_inverse: self.is_inverse || other.is_inverse,
            radians: match (self.radians, other.radians) {
                (None, None) => None,
                (a, b) => Some(a.unwrap_or(0.0) + power * b.unwrap_or(0.0)),
            },
            has_time: self.has_time || other.has_time,
            has_parameter: self.has_parameter || other.has_parameter,
            has_plain_term: self.has_plain_term || other.has_plain_term,
            has_degrees: self.has_degrees || other.has_degrees,
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
            constant: self.constant.map(|c| libm::pow(c, n)),
            factor: libm::pow(self.factor, n),
            pi: self.pi * n,
            literals: Few::none(1.0).and(self.literals.iter().map(|literal| libm::pow(literal, n))),
            uses: Few::none((0, 0.0)).and(self.uses.iter().map(|(index, power)| (index, power * n as f32))),
            radians: self.radians.map(|radians| radians * n),
            ..*self
        }
    }

    pub(super) fn magnitude(&self) -> Measure {
        Measure { constant: self.constant.map(f64::abs), factor: self.factor.abs(), ..*self }
    }

    /// Of what has this dimension, but another number.
    fn reshaped(&self) -> Measure {
        Measure { constant: None, factor: 1.0, pi: 0.0, literals: Few::none(1.0), ..*self }
    }

    /// The measure of a sum whose parts have one dimension.
    pub(super) fn with_constant(self, constant: Option<f64>) -> Measure {
        let literals = Few::none(1.0).and(constant.into_iter());
        Measure { constant, factor: constant.unwrap_or(1.0), literals, ..self }
    }

    /// Whether a plain number is in degrees: 360 in a turn, and not converted to rad.
    fn is_in_degrees(&self) -> bool {
        self.dimension.is_plain() && self.pi == 0.0 && (self.has_degrees || self.has_time && self.literals.has(360.0))
    }

    /// Whether it is one angle or length over another, but for what makes halves and diameters.
    fn is_bare_ratio(&self) -> bool {
        let factor = self.factor.abs();
        self.is_ratio && self.dimension.is_plain() && [0.25, 0.5, 1.0, 2.0, 4.0].contains(&factor)
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

    /// What a sum, a comparison or a choice between `a` and `b` is; `rule` ends the message if they do not go together.
    pub(super) fn alike(&self, a: &Typed, b: &Typed, rule: &str) -> Result<Measure, FormulaError> {
        let (x, y) = (a.measure, b.measure);
        self.not_converted(a, false)?;
        self.not_converted(b, false)?;
        let both = |dimension| Measure {
            dimension,
            constant: None,
            factor: 1.0,
            pi: 0.0,
            literals: Few::none(1.0),
            uses: x.uses.and(y.uses.iter()),
            is_rate: x.is_rate || y.is_rate,
            is_inverse: x.is_inverse || y.is_inverse,
            // A number next to one in rad is in rad, too; one that is known not to be makes no angle.
            radians: x.radians.zip(y.radians).map(|(a, b)| a.min(b)).or(x.radians).or(y.radians),
            has_time: x.has_time || y.has_time,
            has_parameter: x.has_parameter || y.has_parameter,
            has_plain_term: x.has_plain_term || y.has_plain_term,
            is_ratio: x.is_bare_ratio() || y.is_bare_ratio(),
            has_degrees: x.is_in_degrees() || y.is_in_degrees(),
        };
        if x.dimension.is(y.dimension) || y.fits_all() {
            return Ok(both(x.dimension));
        }
        if x.fits_all() {
            return Ok(both(y.dimension));
        }
        for (plain, other) in [(a, b), (b, a)] {
            if plain.measure.dimension.is_plain() {
                self.plain_next_to(plain, other)?;
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

    /// The measure of several parts that must have one dimension.
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

    /// A plain number that stands next to what has a dimension takes the unit of this place, if there is one.
    fn plain_next_to(&self, plain: &Typed, other: &Typed) -> Result<(), FormulaError> {
        if other.measure.dimension.angle != 0.0 {
            self.not_in_radians(plain)?;
        }
        let (span, dimension) = (plain.node.span, other.measure.dimension);
        let is_arc = self.in_radians() && dimension.length != 0.0;
        if self.has_unit(if is_arc { dimension.without_angle() } else { dimension }) {
            if dimension.angle == 0.0 || self.in_radians() || plain.measure.radians.is_none_or(|n| n < 1.0) {
                return Ok(());
            }
            let unit = self.angle_unit();
            let (plain, angle) = (self.quoted(span), self.quoted(other.node.span));
            let message = format!("{plain} has no unit: next to the angle {angle} it counts as {unit}, the `unit`");
            let help = format!("write it in {unit}, or as a parameter with its own unit, such as \"90 deg\"");
            return Err(error(span, message).helped(help));
        }
        if dimension.is(Dimension::ANGLE) && plain.measure.radians.is_some_and(|n| (n - 1.0).abs() < 1e-9) {
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

    /// The parameters with a unit that are factors, and their powers.
    fn used(&self, measure: &Measure) -> impl Iterator<Item = (&Parameter, f64)> {
        let Measure { uses, .. } = *measure;
        (0..uses.len).filter_map(move |k| {
            let (index, power) = *uses.all.get(k)?;
            Some((self.parameters.get(usize::from(index))?, f64::from(power)))
        })
    }

    /// Whether what holds an angle once converts that by hand.
    fn converts_angle(&self, measure: &Measure) -> bool {
        let Measure { dimension, factor, pi, literals, is_rate, is_inverse, has_time, has_parameter, .. } = *measure;
        let is_arc = dimension.length != 0.0;
        let is_angle = dimension.angle == 1.0 && dimension.steps == 0.0;
        // What asin gives is a plain number where lengths are added up, in degrees or not.
        if !is_angle && !(is_inverse && dimension.is_plain() && (self.in_trig || self.unit.of.is(Dimension::ANGLE))) {
            return false;
        }
        let near = |x: f64| is_near(factor, x);
        let has = |x: f64| near(x) || literals.some_come_to(x, libm::pow(PI, pi));
        let is_literal = |x: f64| is_near(literals.product(), x) || literals.has(x);
        let of_turns =
            |(parameter, power): (&Parameter, f64)| power == 1.0 && parameter.scale.is_some_and(|scale| scale.in_turns);
        // A circumference times turns is one, too.
        let from_turns = pi == 1.0 && self.used(measure).any(of_turns);
        let from_rpm = is_rate && has(PI / 30.0);
        has(180.0 / PI)
            || has(PI / 180.0)
            || is_literal(360.0)
            || is_literal(1.0 / 360.0)
            || if self.in_trig || is_arc {
                near(TAU) || from_rpm || from_turns
            } else if self.in_radians() {
                is_rate && near(TAU) || from_rpm || from_turns
            } else {
                // A peak speed over 2*pi*f is an amplitude: it has a parameter, or no `t`, as its factor.
                let of_speed = near(TAU) || near(1.0 / TAU) || from_turns;
                is_rate && of_speed && has_time && !has_parameter
                    || is_inverse && (pi == -1.0 || near(self.unit.per_rad.nearest()))
            }
    }

    /// Whether an angle is multiplied by what the motor travels in a turn: that is meant for turns.
    fn is_arc_of_lead(&self, measure: &Measure) -> bool {
        let is_lead = |(parameter, power): (&Parameter, f64)| {
            let is_length = parameter.dimension.is(Dimension::LENGTH) && !parameter.is_rate && power == 1.0;
            is_length && self.unit.lead.is_some_and(|lead| is_near(parameter.outside.value.nearest(), lead))
        };
        let Dimension { angle, length, .. } = measure.dimension;
        angle == 1.0 && length == 1.0 && self.used(measure).any(is_lead)
    }

    /// The parameter that these factors convert by hand, from the number as written to the number that formulas have.
    ///
    /// Times and frequencies count only in a function's argument: elsewhere `1000*t/T` may mean 1000 steps in T.
    fn converted_as_written(&self, measure: &Measure, is_argument: bool) -> Option<&Parameter> {
        let Measure { pi, literals, .. } = *measure;
        let used =
            self.used(measure).filter(|(parameter, _)| parameter.dimension.is_plain() == measure.dimension.is_plain());
        let used: Vec<_> = used.filter(|(parameter, _)| is_argument || !parameter.dimension.is_plain()).collect();
        // One over another has no unit left.
        if measure.dimension.is_plain() && used.len() != 1 {
            return None;
        }
        let by_hand = |parameter: &Parameter, power: f64| {
            let Some(WrittenUnit { number, per_s, base, .. }) = parameter.scale else { return false };
            let here = libm::pow((parameter.amount(self.in_trig).value.nearest() / number).abs(), power);
            let is_same = is_near(here, 1.0);
            let makes = |literal: f64| is_near(literal, here) && (base == Base::FullStep || !may_be_gear(literal));
            let is_here = literals.iter().chain([literals.product()]).any(makes)
                || pi != 0.0 && literals.some_come_to(here, libm::pow(PI, pi));
            is_here && !is_same || per_s != 1.0 && literals.has(libm::pow(per_s, -power))
        };
        used.into_iter().find(|(parameter, power)| by_hand(parameter, *power)).map(|(parameter, _)| parameter)
    }

    /// Parameters and angles come in the right unit: a factor that converts them by hand is an error.
    fn not_converted(&self, part: &Typed, is_argument: bool) -> Result<(), FormulaError> {
        let measure = &part.measure;
        if self.in_trig && is_argument && measure.is_in_degrees() {
            let message = format!("{} is in degrees, but sin, cos and tan take rad", self.quoted(part.node.span));
            let help =
                "write 2*pi in place of 360; a number of rad that is meant needs a name, as in where = { w = 360 }";
            return Err(error(part.node.span, message).helped(help));
        }
        if self.is_arc_of_lead(measure) {
            let message = format!(
                "{} is an arc: the angle is in rad, and the motor's `lead` its radius",
                self.quoted(part.node.span)
            );
            let help = "divide by a turn, with where = { turn = \"1 rev\" }; or take the position from an angle alone, with unit = \"rev\"";
            return Err(error(part.node.span, message).helped(help));
        }
        let angle = self.converts_angle(measure);
        let written_by_hand = if angle { None } else { self.converted_as_written(measure, is_argument) };
        if !angle && written_by_hand.is_none() {
            return Ok(());
        }
        let of_angle = || self.used(measure).map(|(parameter, _)| parameter).find(|used| used.dimension.angle != 0.0);
        let (what, help) = match written_by_hand.or_else(of_angle) {
            Some(parameter) if !angle || !measure.is_inverse => {
                let Parameter { name, written: text, .. } = parameter;
                let Amount { value, unit } = parameter.amount(self.in_trig);
                let near = |x: f64| is_near(measure.factor, x);
                let in_hz = if measure.is_rate && (near(TAU) || near(360.0)) {
                    format!(", or give `{name}` in Hz")
                } else {
                    String::new()
                };
                let help = if measure.has_plain_term {
                    format!("of the sum multiply the plain numbers alone, as in 2*pi*t/T - phi{in_hz}")
                } else if measure.pi == 0.0 {
                    format!(
                        "leave the factor out{in_hz}; one that is meant needs a name, as in where = {{ gear = 60 }}"
                    )
                } else {
                    format!("leave the factor out{in_hz}")
                };
                (format!("`{name}` = {text} is {} here already", written(value.nearest(), unit)), help)
            }
            _ => {
                let help =
                    "leave the factor out; for the number of rad divide by an angle, where = { rad = \"1 rad\" }";
                let unit = self.angle_unit();
                (format!("what asin, acos, atan and atan2 give is in {unit} here already"), help.to_owned())
            }
        };
        let message = format!("{} converts by hand: {what}", self.quoted(part.node.span));
        Err(error(part.node.span, message).helped(help))
    }

    /// What a product is, of two numbers or one over the other. A time that is converted by hand stands next to the factor: T/1000, 60*T.
    pub(super) fn product(&self, product: Typed) -> Result<Typed, FormulaError> {
        let Measure { constant, literals, uses, .. } = &product.measure;
        let is_bare = constant.is_some() && literals.len == 1 && uses.iter().all(|(_, power)| power == 1.0);
        if is_bare {
            self.not_converted(&product, true)?;
        }
        Ok(product)
    }

    /// One length over another, or one speed over another, is an angle in rad: it must not be taken for a number of degrees.
    fn not_in_radians(&self, part: &Typed) -> Result<(), FormulaError> {
        let measure = &part.measure;
        if self.in_radians() || !measure.is_bare_ratio() {
            return Ok(());
        }
        let used = || self.used(measure).filter(|(parameter, _)| !parameter.dimension.is_plain());
        // phi/deg is the number of degrees; a length over a circumference is a number of turns.
        let is_unit = |(parameter, power): (&Parameter, f64)| {
            power < 0.0 && !parameter.is_rate && parameter.scale.is_some_and(|scale| scale.number == 1.0)
        };
        let is_of_angles = used().all(|(parameter, _)| parameter.dimension.is(Dimension::ANGLE) && parameter.is_rate);
        if used().any(is_unit) || !(is_of_angles || matches!(self.unit.name, "deg" | "°")) {
            return Ok(());
        }
        let message = format!(
            "{} is one over another of a kind, an angle in rad, but `unit` is \"{}\"",
            self.quoted(part.node.span),
            self.unit.name
        );
        let help = "multiply by an angle, such as rad, with where = { rad = \"1 rad\" }";
        Err(error(part.node.span, message).helped(help))
    }

    /// What must be a plain number; `what` it is.
    pub(super) fn plain(&self, what: &str, part: &Typed) -> Result<(), FormulaError> {
        if part.measure.dimension.is_plain() {
            return self.not_converted(part, true);
        }
        let message = format!("{what} is to be a plain number, but {}", self.is_what(part));
        Err(error(part.node.span, message).helped(if part.measure.is_inverse { INVERSE } else { DIVIDE }))
    }

    /// What sin, cos and tan take.
    pub(super) fn angle(&self, function: &str, part: &Typed) -> Result<(), FormulaError> {
        let inside = Place { in_trig: true, ..*self };
        inside.not_converted(part, true)?;
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
        self.not_converted(part, false)?;
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
            return (None, Measure { radians: Some(1.0), is_inverse: true, ..Measure::PLAIN });
        }
        (Some(self.unit.per_rad), Measure { dimension: Dimension::ANGLE, is_inverse: true, ..Measure::PLAIN })
    }

    /// Whether the whole formula fits its unit.
    pub(super) fn result(&self, whole: &Typed) -> Result<(), FormulaError> {
        let (of, dimension) = (self.unit.of, whole.measure.dimension);
        if of.is_plain() {
            return Ok(());
        }
        self.not_converted(whole, false)?;
        if dimension.is_plain() {
            return self.not_in_radians(whole);
        }
        if whole.measure.fits_all() {
            return Ok(());
        }
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
