//! Quantities with units, as people write them: "2.5 rev", "90 deg", "100 ms", "4000 step/s", "50 mH".
//!
//! A number without a unit is never a quantity: "5 what?" is the commonest mistake in motion files.

use std::fmt;

use crate::{Time, whole_power};

/// What a quantity measures, before any division by time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Base {
    /// Steps of the driver (microsteps); value in steps.
    Step,
    /// Full steps of the motor; value in full steps.
    FullStep,
    /// Turns; value in revolutions.
    Turn,
    /// Distance along a line; value in mm.
    Length,
    /// Time; value in s.
    Time,
    /// Ticks of the board's step timer; value in ticks.
    Tick,
    /// Cycles of something periodic; Hz is one a second.
    Cycle,
    /// Inductance; value in H.
    Inductance,
    /// Current; value in A.
    Current,
    /// Voltage; value in V.
    Voltage,
}

impl Base {
    /// Whether a motor's position can be measured in it.
    #[must_use]
    pub fn is_position(self) -> bool {
        matches!(self, Base::Step | Base::FullStep | Base::Turn | Base::Length)
    }
}

/// A number with its unit: `value` × base / s^`per_seconds`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantity {
    /// In the unit of `base` per s^`per_seconds`; finite.
    pub value: f64,
    /// What it measures.
    pub base: Base,
    /// 0 for an amount, 1 for a speed or a frequency, 2 for an acceleration, 3 for a jerk.
    pub per_seconds: u8,
    /// The unit's name as written, without the division by time; rates such as rpm have their own.
    pub unit: &'static str,
    /// The number as written.
    pub(crate) number: f64,
    /// What it is divided by, in s^`per_seconds`: 60 of rpm.
    pub(crate) per_s: f64,
    /// The value as written, so that "100 ms" is a tenth of a second exactly.
    exact: Option<Ratio>,
}

/// numerator/denominator in the unit of the base.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Ratio {
    numerator: i64,
    denominator: u64,
}

/// Why a text is no quantity. Offsets and lengths are bytes of that text.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum QuantityError {
    /// It does not begin with a number.
    #[error("{text:?} does not begin with a number")]
    NoNumber {
        /// What was read.
        text: String,
    },
    /// A number without a unit.
    #[error("a bare number: {number} of what?")]
    NoUnit {
        /// The number.
        number: String,
    },
    /// The number is too large for an f64.
    #[error("{number} is out of range")]
    OutOfRange {
        /// The number.
        number: String,
    },
    /// The unit is not known.
    #[error("unknown unit {unit:?}")]
    UnknownUnit {
        /// As written.
        unit: String,
        /// Where it begins.
        offset: usize,
        /// What to write instead, if that can be told: the number with another unit, or another number with its unit.
        meant: Option<String>,
    },
    /// A decimal comma, or digits in groups.
    #[error("{number} is no number here: decimals are written with a point, thousands without a sign")]
    Grouped {
        /// As written.
        number: String,
        /// Where it begins.
        offset: usize,
        /// What to write instead, if the unit is known; either of two where the comma may part thousands.
        meant: Option<String>,
    },
}

impl QuantityError {
    /// What to write instead, if that can be told.
    #[must_use]
    pub fn meant(&self) -> Option<&str> {
        match self {
            QuantityError::UnknownUnit { meant, .. } | QuantityError::Grouped { meant, .. } => meant.as_deref(),
            _ => None,
        }
    }
}

/// (name, base, numerator, denominator): one of the unit is numerator/denominator of the base's.
type UnitRow = (&'static str, Base, u32, u64);

/// Every unit of an amount. rad is apart: its size is irrational.
const UNITS: &[UnitRow] = &[
    ("step", Base::Step, 1, 1),
    ("steps", Base::Step, 1, 1),
    ("microstep", Base::Step, 1, 1),
    ("microsteps", Base::Step, 1, 1),
    ("full-step", Base::FullStep, 1, 1),
    ("full-steps", Base::FullStep, 1, 1),
    ("rev", Base::Turn, 1, 1),
    ("revs", Base::Turn, 1, 1),
    ("turn", Base::Turn, 1, 1),
    ("turns", Base::Turn, 1, 1),
    ("deg", Base::Turn, 1, 360),
    ("°", Base::Turn, 1, 360),
    ("mm", Base::Length, 1, 1),
    ("cm", Base::Length, 10, 1),
    ("m", Base::Length, 1000, 1),
    ("in", Base::Length, 254, 10),
    ("ns", Base::Time, 1, 1_000_000_000),
    ("us", Base::Time, 1, 1_000_000),
    ("µs", Base::Time, 1, 1_000_000),
    ("μs", Base::Time, 1, 1_000_000),
    ("ms", Base::Time, 1, 1000),
    ("s", Base::Time, 1, 1),
    ("min", Base::Time, 60, 1),
    ("h", Base::Time, 3600, 1),
    ("tick", Base::Tick, 1, 1),
    ("ticks", Base::Tick, 1, 1),
    ("uH", Base::Inductance, 1, 1_000_000),
    ("µH", Base::Inductance, 1, 1_000_000),
    ("mH", Base::Inductance, 1, 1000),
    ("H", Base::Inductance, 1, 1),
    ("mA", Base::Current, 1, 1000),
    ("A", Base::Current, 1, 1),
    ("mV", Base::Voltage, 1, 1000),
    ("V", Base::Voltage, 1, 1),
];

/// Units that have the division by time in their name: (name, base, numerator, denominator), per second.
const RATES: &[UnitRow] = &[
    ("rpm", Base::Turn, 1, 60),
    ("mHz", Base::Cycle, 1, 1000),
    ("Hz", Base::Cycle, 1, 1),
    ("kHz", Base::Cycle, 1000, 1),
    ("MHz", Base::Cycle, 1_000_000, 1),
];

/// Other names of units, in small letters: the name, how many of a unit it is, and that unit.
const OTHER_NAMES: &[(&str, f64, &str)] = &[
    ("rps", 1.0, "rev/s"),
    ("r/s", 1.0, "rev/s"),
    ("r/min", 1.0, "rpm"),
    ("dps", 1.0, "deg/s"),
    ("sps", 1.0, "step/s"),
    ("pps", 1.0, "step/s"),
    ("ips", 1.0, "in/s"),
    ("hertz", 1.0, "Hz"),
    ("ghz", 1e9, "Hz"),
    ("sec", 1.0, "s"),
    ("secs", 1.0, "s"),
    ("second", 1.0, "s"),
    ("seconds", 1.0, "s"),
    ("msec", 1.0, "ms"),
    ("msecs", 1.0, "ms"),
    ("millisecond", 1.0, "ms"),
    ("milliseconds", 1.0, "ms"),
    ("usec", 1.0, "us"),
    ("microsecond", 1.0, "us"),
    ("microseconds", 1.0, "us"),
    ("nanosecond", 1.0, "ns"),
    ("nanoseconds", 1.0, "ns"),
    ("mins", 1.0, "min"),
    ("minute", 1.0, "min"),
    ("minutes", 1.0, "min"),
    ("hr", 1.0, "h"),
    ("hrs", 1.0, "h"),
    ("hour", 1.0, "h"),
    ("hours", 1.0, "h"),
    ("d", 24.0, "h"),
    ("day", 24.0, "h"),
    ("days", 24.0, "h"),
    ("week", 168.0, "h"),
    ("weeks", 168.0, "h"),
    ("degree", 1.0, "deg"),
    ("degrees", 1.0, "deg"),
    ("degs", 1.0, "deg"),
    ("º", 1.0, "deg"),
    ("˚", 1.0, "deg"),
    ("grad", 0.9, "deg"),
    ("gon", 0.9, "deg"),
    ("arcmin", 1.0 / 60.0, "deg"),
    ("arcsec", 1.0 / 3600.0, "deg"),
    ("rads", 1.0, "rad"),
    ("radian", 1.0, "rad"),
    ("radians", 1.0, "rad"),
    ("mrad", 0.001, "rad"),
    ("r", 1.0, "rev"),
    ("rot", 1.0, "rev"),
    ("rotation", 1.0, "rev"),
    ("rotations", 1.0, "rev"),
    ("revolution", 1.0, "rev"),
    ("revolutions", 1.0, "rev"),
    ("cycle", 1.0, "rev"),
    ("cycles", 1.0, "rev"),
    ("inch", 1.0, "in"),
    ("inches", 1.0, "in"),
    ("\"", 1.0, "in"),
    ("ft", 304.8, "mm"),
    ("foot", 304.8, "mm"),
    ("feet", 304.8, "mm"),
    ("mil", 0.0254, "mm"),
    ("thou", 0.0254, "mm"),
    ("um", 0.001, "mm"),
    ("µm", 0.001, "mm"),
    ("μm", 0.001, "mm"),
    ("micron", 0.001, "mm"),
    ("microns", 0.001, "mm"),
    ("dm", 100.0, "mm"),
    ("km", 1000.0, "m"),
    ("kilometer", 1000.0, "m"),
    ("kilometers", 1000.0, "m"),
    ("kilometre", 1000.0, "m"),
    ("kilometres", 1000.0, "m"),
    ("nm", 1e-6, "mm"),
    ("millimeter", 1.0, "mm"),
    ("millimeters", 1.0, "mm"),
    ("millimetre", 1.0, "mm"),
    ("millimetres", 1.0, "mm"),
    ("centimeter", 1.0, "cm"),
    ("centimeters", 1.0, "cm"),
    ("centimetre", 1.0, "cm"),
    ("centimetres", 1.0, "cm"),
    ("meter", 1.0, "m"),
    ("meters", 1.0, "m"),
    ("metre", 1.0, "m"),
    ("metres", 1.0, "m"),
    ("pulse", 1.0, "step"),
    ("pulses", 1.0, "step"),
    ("ustep", 1.0, "step"),
    ("usteps", 1.0, "step"),
    ("µstep", 1.0, "step"),
    ("µsteps", 1.0, "step"),
    ("kstep", 1000.0, "step"),
    ("ksteps", 1000.0, "step"),
    ("k step", 1000.0, "step"),
    ("k steps", 1000.0, "step"),
    ("full step", 1.0, "full-step"),
    ("full steps", 1.0, "full-step"),
    ("full_step", 1.0, "full-step"),
    ("full_steps", 1.0, "full-step"),
    ("fullstep", 1.0, "full-step"),
    ("fullsteps", 1.0, "full-step"),
    ("henry", 1.0, "H"),
    ("amp", 1.0, "A"),
    ("amps", 1.0, "A"),
    ("ampere", 1.0, "A"),
    ("amperes", 1.0, "A"),
    ("volt", 1.0, "V"),
    ("volts", 1.0, "V"),
];

/// `key = "amount unit"` as it may be pasted into a motion file: three digits, and none of the spaces and signs that are for people alone.
///
/// All advice that has a quantity in it is written with this, or with [`time_assignment`]: what is printed must parse.
///
/// ```
/// use pulsetrain_motion::quantity::assignment;
/// assert_eq!(assignment("tolerance", 78_040.0, "ticks"), "tolerance = \"78000 ticks\"");
/// ```
#[must_use]
pub fn assignment(key: &str, amount: f64, unit: &str) -> String {
    format!("{key} = \"{}\"", written(amount, unit))
}

/// A key and a time as a line of a motion file, with the unit that suits the time.
///
/// ```
/// use pulsetrain_motion::quantity::time_assignment;
/// assert_eq!(time_assignment("over", 0.0125), "over = \"12.5 ms\"");
/// assert_eq!(time_assignment("ease", 12_000.0), "ease = \"12000 s\"");
/// ```
#[must_use]
pub fn time_assignment(key: &str, seconds: f64) -> String {
    let (per_second, unit) = match seconds {
        s if s >= 0.1 => (1.0, "s"),
        s if s >= 1e-3 => (1e3, "ms"),
        s if s >= 1e-6 => (1e6, "us"),
        _ => (1e9, "ns"),
    };
    assignment(key, seconds * per_second, unit)
}

/// An amount with its unit, to three digits, as [`Quantity::parse`] reads it.
#[must_use]
pub fn written(amount: f64, unit: &str) -> String {
    // Rounded by way of the text; plain decimals then, whatever the size.
    let rounded = format!("{amount:.2e}").parse().unwrap_or(amount);
    format!("{rounded} {unit}")
}

impl Quantity {
    /// Reads a number and its unit, with or without a space between them.
    ///
    /// Speeds, accelerations and jerks are written `rev/s`, `rev/s^2` or `rev/s²`, `rev/s^3` or `rev/s³`; the time
    /// may be any unit of time. Numbers may be grouped with `_`.
    ///
    /// # Errors
    /// [`QuantityError`] for what is not a finite number with a known unit.
    ///
    /// ```
    /// use pulsetrain_motion::quantity::{Base, Quantity, QuantityError};
    /// let speed = Quantity::parse("300 rpm").unwrap();
    /// assert_eq!((speed.value, speed.base, speed.per_seconds), (5.0, Base::Turn, 1));
    /// assert!(matches!(Quantity::parse("300"), Err(QuantityError::NoUnit { .. })));
    /// ```
    pub fn parse(text: &str) -> Result<Quantity, QuantityError> {
        let start = text.len() - text.trim_start().len();
        let length = number_length(&text[start..]);
        let (number, rest) = text[start..].split_at(length);
        let digits = number.replace('_', "").replace(MINUS, "-");
        let Ok(magnitude) = digits.parse::<f64>() else {
            return Err(QuantityError::NoNumber { text: text.trim().to_owned() });
        };
        let unit = rest.trim();
        if unit.is_empty() {
            return Err(QuantityError::NoUnit { number: number.to_owned() });
        }
        let Some(KnownUnit { name, base, per_seconds, per_s, scale }) = find_unit(unit) else {
            if let Some((number, meant)) = grouped(number, rest) {
                return Err(QuantityError::Grouped { number, offset: start, meant });
            }
            let offset = start + length + (rest.len() - rest.trim_start().len());
            return Err(QuantityError::UnknownUnit { unit: unit.to_owned(), offset, meant: meant(&digits, unit) });
        };
        let value = scale.apply(magnitude);
        if !value.is_finite() {
            return Err(QuantityError::OutOfRange { number: number.to_owned() });
        }
        Ok(Quantity { value, base, per_seconds, unit: name, number: magnitude, per_s, exact: scale.exact(&digits) })
    }

    /// The number and the unit of a quantity, as they are written; `None` if there is no number.
    ///
    /// ```
    /// use pulsetrain_motion::quantity::Quantity;
    /// assert_eq!(Quantity::parts(" 0.5 Hz"), Some((0.5, "Hz")));
    /// assert_eq!(Quantity::parts("Hz"), None);
    /// ```
    #[must_use]
    pub fn parts(text: &str) -> Option<(f64, &str)> {
        let text = text.trim();
        let (number, unit) = text.split_at(number_length(text));
        Some((number.replace('_', "").replace(MINUS, "-").parse().ok()?, unit.trim()))
    }

    /// Whether it is written in turns, in any time.
    pub(crate) fn is_in_turns(&self) -> bool {
        self.base == Base::Turn && (self.value * self.per_s / self.number - 1.0).abs() < 1e-9
    }

    /// As a duration, exact to 2^-64 s if it was written as a decimal number of a unit of time; `None` for anything else.
    #[must_use]
    pub fn time(&self) -> Option<Time> {
        if self.base != Base::Time || self.per_seconds != 0 {
            return None;
        }
        Some(
            self.exact.map_or_else(|| Time::from_seconds(self.value), |r| Time::from_ratio(r.numerator, r.denominator)),
        )
    }

    /// The duration of one cycle of a frequency, exact to 2^-64 s if it can be; `None` for anything that is no positive frequency.
    #[must_use]
    pub fn period(&self) -> Option<Time> {
        if self.base != Base::Cycle || self.per_seconds != 1 || self.value <= 0.0 {
            return None;
        }
        let inverse = self.exact.and_then(|r| Some((i64::try_from(r.denominator).ok()?, r.numerator.unsigned_abs())));
        Some(match inverse {
            Some((numerator, denominator)) if numerator < 1 << 62 => Time::from_ratio(numerator, denominator),
            _ => Time::from_seconds(1.0 / self.value),
        })
    }

    /// What it measures, in words: "an angle", "a speed".
    #[must_use]
    pub fn kind(&self) -> Kind {
        Kind { base: self.base, per_seconds: self.per_seconds }
    }
}

/// What a quantity measures, for messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kind {
    /// What it measures, before any division by time.
    pub base: Base,
    /// How often it is divided by time.
    pub per_seconds: u8,
}

impl Kind {
    /// Whether a motor's position can be of it.
    #[must_use]
    pub fn is_position(self) -> bool {
        self.base.is_position() && self.per_seconds == 0
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match (self.base, self.per_seconds) {
            (Base::Time, 0) => "a time",
            (Base::Tick, 0) => "a number of ticks",
            (Base::Cycle, 1) => "a frequency",
            (Base::Inductance, 0) => "an inductance",
            (Base::Current, 0) => "a current",
            (Base::Voltage, 0) => "a voltage",
            (Base::Length, 0) => "a distance",
            (Base::Turn, 0) => "an angle",
            (Base::Step | Base::FullStep, 0) => "a number of steps",
            (base, 1) if base.is_position() => "a speed",
            (base, 2) if base.is_position() => "an acceleration",
            (base, 3) if base.is_position() => "a jerk",
            _ => "a rate",
        };
        f.write_str(name)
    }
}

/// What word processors make of a minus sign.
const MINUS: [char; 2] = ['−', '–'];

/// Bytes of the number at the start of `text`: sign, digits, point, exponent.
fn number_length(text: &str) -> usize {
    if let Some(rest) = text.strip_prefix(MINUS) {
        return text.len() - rest.len() + number_length(rest.trim_start_matches(['+', '-']));
    }
    let bytes = text.as_bytes();
    let digits = |from: usize| bytes[from..].iter().take_while(|b| b.is_ascii_digit() || **b == b'_').count();
    let mut at = usize::from(matches!(bytes.first(), Some(b'+' | b'-')));
    at += digits(at);
    if bytes.get(at) == Some(&b'.') {
        at += 1 + digits(at + 1);
    }
    if matches!(bytes.get(at), Some(b'e' | b'E')) {
        let sign = usize::from(matches!(bytes.get(at + 1), Some(b'+' | b'-')));
        let exponent = digits(at + 1 + sign);
        if exponent > 0 {
            at += 1 + sign + exponent;
        }
    }
    at
}

/// The size of a unit in its base's.
#[derive(Clone, Copy)]
enum UnitSize {
    Ratio { numerator: f64, denominator: f64, exact: Option<(u32, u64)> },
    Radian { denominator: f64 },
}

impl UnitSize {
    fn apply(self, magnitude: f64) -> f64 {
        match self {
            UnitSize::Ratio { numerator, denominator, .. } => magnitude * numerator / denominator,
            UnitSize::Radian { denominator } => magnitude / std::f64::consts::TAU / denominator,
        }
    }

    /// The exact value of a decimal number of this unit, if 62 bits hold it.
    fn exact(self, digits: &str) -> Option<Ratio> {
        let UnitSize::Ratio { exact: Some((numerator, denominator)), .. } = self else { return None };
        let (mantissa, exponent) = match digits.split_once(['e', 'E']) {
            Some((mantissa, exponent)) => (mantissa, exponent.parse::<i32>().ok()?),
            None => (digits, 0),
        };
        let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
        let fraction = fraction.trim_end_matches('0');
        let exponent = exponent.checked_sub(i32::try_from(fraction.len()).ok()?)?;
        let mantissa: i64 = format!("{whole}{fraction}").parse().ok()?;
        let power = 10u64.checked_pow(exponent.unsigned_abs())?;
        let (up, down) = if exponent < 0 { (1, power) } else { (power, 1) };
        let numerator = mantissa.checked_mul(i64::from(numerator))?.checked_mul(i64::try_from(up).ok()?)?;
        let denominator = denominator.checked_mul(down)?;
        (numerator.unsigned_abs() < 1 << 62).then_some(Ratio { numerator, denominator })
    }
}

/// A unit that has been recognised.
struct KnownUnit {
    name: &'static str,
    base: Base,
    per_seconds: u8,
    per_s: f64,
    scale: UnitSize,
}

fn find_unit(unit: &str) -> Option<KnownUnit> {
    let exactly = |&(name, base, n, d): &UnitRow, per_seconds, per_s| {
        let scale = UnitSize::Ratio { numerator: f64::from(n), denominator: d as f64, exact: Some((n, d)) };
        KnownUnit { name, base, per_seconds, per_s, scale }
    };
    let radians = |per_seconds, per_s| KnownUnit {
        name: "rad",
        base: Base::Turn,
        per_seconds,
        per_s,
        scale: UnitSize::Radian { denominator: per_s },
    };
    if let Some(row) = RATES.iter().find(|row| row.0 == unit) {
        return Some(exactly(row, 1, if row.0 == "rpm" { 60.0 } else { 1.0 }));
    }
    let Some((amount, time)) = unit.split_once('/') else {
        if unit == "rad" {
            return Some(radians(0, 1.0));
        }
        return UNITS.iter().find(|row| row.0 == unit).map(|row| exactly(row, 0, 1.0));
    };
    let (amount, time) = (amount.trim_end(), time.trim_start());
    let (time, per_seconds) = [("^2", 2), ("²", 2), ("^3", 3), ("³", 3)]
        .iter()
        .find_map(|&(suffix, power)| Some((time.strip_suffix(suffix)?, power)))
        .unwrap_or((time, 1));
    let &(_, _, n, d) = UNITS.iter().find(|row| row.1 == Base::Time && row.0 == time)?;
    let per_s = whole_power(f64::from(n) / d as f64, i32::from(per_seconds));
    if amount == "rad" {
        return Some(radians(per_seconds, per_s));
    }
    let &(name, base, n, d) = UNITS.iter().find(|row| row.0 == amount && row.1.is_position())?;
    let scale = UnitSize::Ratio { numerator: f64::from(n), denominator: d as f64 * per_s, exact: None };
    Some(KnownUnit { name, base, per_seconds, per_s, scale })
}

/// A number that goes on behind a comma, a blank or an apostrophe, or is a fraction: as it is written, and what to write.
fn grouped(number: &str, rest: &str) -> Option<(String, Option<String>)> {
    let separator = rest.trim_start().chars().next().filter(|c| ",'’/".contains(*c));
    let behind = rest.trim_start().trim_start_matches([',', '\'', '’', '/']).trim_start();
    let length = behind.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(behind.len());
    let (more, unit) = behind.split_at(length);
    if more.is_empty() || !more.starts_with(|c: char| c.is_ascii_digit()) {
        return None;
    }
    let written = format!("{number}{}", &rest[..rest.len() - unit.len()]).trim().to_owned();
    let whole = |number: String| -> Option<String> {
        let text = format!("{number} {}", unit.trim());
        match Quantity::parse(&text) {
            Ok(_) => Some(text),
            Err(error) => error.meant().map(str::to_owned),
        }
    };
    let joined = || format!("{number}{more}").replace([' ', '_'], "");
    let meant = match separator {
        Some('/') => {
            let value = number.parse::<f64>().ok()? / more.parse::<f64>().ok()?;
            whole(rounded(value).to_string())
        }
        // Thousands, perhaps: 1,000 step/s.
        Some(',') if more.len() == 3 && !matches!(number, "0" | "-0") && !number.contains('.') => {
            whole(joined()).zip(whole(format!("{number}.{more}"))).map(|(many, few)| format!("{many}\" or \"{few}"))
        }
        Some(',') => whole(format!("{number}.{more}")),
        _ => whole(joined()),
    };
    Some((written, meant))
}

/// What is probably meant by a number with a unit that is not known: a number with its unit.
fn meant(digits: &str, unit: &str) -> Option<String> {
    let (factor, unit) = known_unit(unit)?;
    let number: f64 = digits.parse().ok()?;
    let number =
        if factor == 1.0 { digits.trim_start_matches('+').to_owned() } else { rounded(number * factor).to_string() };
    Some(format!("{number} {unit}"))
}

/// The unit that is probably meant by one that is not known, and how many of it that is.
fn known_unit(unit: &str) -> Option<(f64, String)> {
    let is_known = |unit: &str| find_unit(unit).is_some();
    let trimmed = unit.trim_end_matches(['.', ',', ';']).trim_end();
    if is_known(trimmed) {
        return Some((1.0, trimmed.to_owned()));
    }
    // Another name of the amount, of the time, or of both: rps, degrees/second.
    let lower = trimmed
        .to_lowercase()
        .replace(" per ", "/")
        .replace("per", "/")
        .replace("s^-", "/s^")
        .replace("s⁻¹", "/s")
        .replace("s⁻²", "/s^2");
    let other = |name: &str| OTHER_NAMES.iter().find(|other| other.0 == name);
    if let Some((_, factor, unit)) = other(&lower) {
        return Some((*factor, (*unit).to_owned()));
    }
    // MM, RPM, Deg: another case alone. Of mHz and MHz both are meant as often.
    let in_other_case: Vec<&str> =
        UNITS.iter().chain(RATES).map(|row| row.0).filter(|name| name.to_lowercase() == lower).collect();
    if let [name] = in_other_case[..] {
        return Some((1.0, name.to_owned()));
    }
    let renamed = |part: &str| other(part).map_or((1.0, part.to_owned()), |other| (other.1, other.2.to_owned()));
    let mut parts = lower.split('/').map(str::trim).filter(|part| !part.is_empty());
    let (mut factor, amount) = renamed(parts.next()?);
    // Times with their powers: mm/s/s, rev/s2, rev/s**2; rpm is divided already.
    let mut powers: Vec<(String, i32)> = Vec::new();
    let (amount, divided) = match amount.split_once('/') {
        Some((amount, time)) => (amount.to_owned(), Some(time.to_owned())),
        None if amount == "rpm" => ("rev".to_owned(), Some("min".to_owned())),
        None => (amount, None),
    };
    powers.extend(divided.map(|time| (time, 1)));
    for part in parts {
        let part = part.replace('²', "2").replace('³', "3");
        let name = part.trim_end_matches(|c: char| c.is_ascii_digit());
        let power = part[name.len()..].parse().unwrap_or(1);
        let (of_time, name) = renamed(name.trim_end_matches(['^', '*']).trim());
        factor /= whole_power(of_time, power);
        powers.push((name, power));
    }
    // In the time that comes last; another one makes another number.
    if let Some((last, _)) = powers.last() {
        let seconds = |time: &str| find_unit(&format!("rev/{time}")).map(|unit| unit.per_s);
        for (time, power) in powers.iter().filter(|(time, _)| time != last) {
            factor *= whole_power(seconds(last)? / seconds(time)?, *power);
        }
        let power: i32 = powers.iter().map(|(_, power)| power).sum();
        let text = if power == 1 { format!("{amount}/{last}") } else { format!("{amount}/{last}^{power}") };
        if is_known(&text) {
            return Some((factor, text));
        }
    } else if is_known(&amount) {
        return Some((factor, amount));
    }
    let has_letters = trimmed.contains(char::is_alphabetic);
    nearest_unit(trimmed).filter(|_| has_letters).map(|unit| (1.0, unit.to_owned()))
}

/// The unit that is probably meant by one that is not known, if it is of the same size.
pub(crate) fn unit_meant(unit: &str) -> Option<String> {
    known_unit(unit).filter(|(factor, _)| *factor == 1.0).map(|(_, unit)| unit)
}

/// To six digits.
fn rounded(number: f64) -> f64 {
    format!("{number:.5e}").parse().unwrap_or(number)
}

fn nearest_unit(unit: &str) -> Option<&'static str> {
    const EXAMPLES: &[&str] =
        &["rad", "rev/s", "step/s", "mm/s", "deg/s", "rev/min", "rev/s^2", "step/s^2", "mm/s^2", "step/s^3"];
    let names = UNITS.iter().chain(RATES).map(|row| row.0).chain(EXAMPLES.iter().copied());
    // A first letter that makes the same unit larger or smaller is no misspelling: ks is not ms.
    let (size, rest) = unit.split_at(unit.chars().next().map_or(0, char::len_utf8));
    let is_scaled = "TGMkhdcmuµμnp".contains(size) && !rest.starts_with(size) && find_unit(rest).is_some();
    nearest(unit, names.filter(|_| !is_scaled))
}

/// The name that a misspelt one is nearest to, if it is near at all.
#[must_use]
pub fn nearest<'a>(written: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    /// A longer word is no misspelt name, and the distance of long ones takes the product of their lengths.
    const MAX_NAME_BYTES: usize = 200;
    if written.len() > MAX_NAME_BYTES {
        return None;
    }
    let lower = written.to_lowercase();
    known
        .into_iter()
        .filter(|name| name.len() <= MAX_NAME_BYTES)
        .map(|name| (strsim::damerau_levenshtein(&lower, &name.to_lowercase()), name))
        .filter(|(distance, name)| *distance <= 1 + name.len().min(lower.len()) / 4)
        // mHz is not MHz.
        .min_by_key(|(distance, name)| (*distance, strsim::damerau_levenshtein(written, name)))
        .map(|(_, name)| name)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[track_caller]
    fn check(text: &str, value: f64, base: Base, per_seconds: u8) {
        let quantity = Quantity::parse(text).unwrap();
        assert_eq!((quantity.base, quantity.per_seconds), (base, per_seconds), "{text}");
        assert!((quantity.value - value).abs() <= 1e-15 * value.abs(), "{text}: {} for {value}", quantity.value);
    }

    #[test]
    fn reads_what_people_write() {
        check("2.5 rev", 2.5, Base::Turn, 0);
        check("90 deg", 0.25, Base::Turn, 0);
        check("-90°", -0.25, Base::Turn, 0);
        check("3.141592653589793 rad", 0.5, Base::Turn, 0);
        check("2 turns", 2.0, Base::Turn, 0);
        check("30 mm", 30.0, Base::Length, 0);
        check("3 s", 3.0, Base::Time, 0);
        check("100 ms", 0.1, Base::Time, 0);
        check("10us", 1e-5, Base::Time, 0);
        check("10 µs", 1e-5, Base::Time, 0);
        check("1.5 min", 90.0, Base::Time, 0);
        check("10 h", 36_000.0, Base::Time, 0);
        check("1 tick", 1.0, Base::Tick, 0);
        check("4_000 step/s", 4000.0, Base::Step, 1);
        check("300 rpm", 5.0, Base::Turn, 1);
        check("20000 step/s^2", 20_000.0, Base::Step, 2);
        check("6e4 mm / min", 1000.0, Base::Length, 1);
        check("7 rev/s³", 7.0, Base::Turn, 3);
        check("360 deg/s²", 1.0, Base::Turn, 2);
        check("2 full-steps", 2.0, Base::FullStep, 0);
        check("2 Hz", 2.0, Base::Cycle, 1);
        check("1 kHz", 1000.0, Base::Cycle, 1);
        check("50mH", 0.05, Base::Inductance, 0);
        check("0.135 A", 0.135, Base::Current, 0);
        check("12 V", 12.0, Base::Voltage, 0);
        check("−90 deg", -0.25, Base::Turn, 0);
        check("–2 rev", -2.0, Base::Turn, 0);
        check("10 μs", 1e-5, Base::Time, 0);
        check("500 mHz", 0.5, Base::Cycle, 1);
        check("3 revs", 3.0, Base::Turn, 0);
        check("60 rev/min", 1.0, Base::Turn, 1);
    }

    #[test]
    fn refuses_with_the_reason() {
        let refused = |text: &str| Quantity::parse(text).unwrap_err();
        assert_eq!(refused("2.5"), QuantityError::NoUnit { number: "2.5".into() });
        assert_eq!(refused("fast"), QuantityError::NoNumber { text: "fast".into() });
        assert_eq!(refused("1e999 s"), QuantityError::OutOfRange { number: "1e999".into() });
        assert_eq!(
            refused(" 2 rve"),
            QuantityError::UnknownUnit { unit: "rve".into(), offset: 3, meant: Some("2 rev".into()) }
        );
        for (text, write) in [
            ("500 mhz", "500 mHz"),
            ("5 khz", "5 kHz"),
            ("5 KHZ", "5 kHz"),
            ("5 HZ", "5 Hz"),
            ("10 rpm/s", "0.166667 rev/s^2"),
            ("10 rpm/min", "10 rev/min^2"),
            ("10 RPM", "10 rpm"),
            ("2 rps", "2 rev/s"),
            ("2 rps/s", "2 rev/s^2"),
            ("90 degrees", "90 deg"),
            ("90 Degrees", "90 deg"),
            ("90DEG", "90 deg"),
            ("90º", "90 deg"),
            ("90 degrees/second", "90 deg/s"),
            ("9 deg per sec", "9 deg/s"),
            ("9 degrees per second", "9 deg/s"),
            ("9 deg/sec^2", "9 deg/s^2"),
            ("9 deg s^-2", "9 deg/s^2"),
            ("3 mm/s/s", "3 mm/s^2"),
            ("3 mm/s2", "3 mm/s^2"),
            ("3 mm/sec²", "3 mm/s^2"),
            ("3 rev/s**3", "3 rev/s^3"),
            ("60 deg/min/s", "1 deg/s^2"),
            ("3 MM", "3 mm"),
            ("3 inch", "3 in"),
            ("3 inches", "3 in"),
            ("3\"", "3 in"),
            ("2 ft", "609.6 mm"),
            ("50 um", "0.05 mm"),
            ("2 hours", "2 h"),
            ("2 Hours", "2 h"),
            ("2 days", "48 h"),
            ("90 minutes", "90 min"),
            ("1.50 seconds", "1.50 s"),
            ("2 S", "2 s"),
            ("2 Sec.", "2 s"),
            ("2 radians", "2 rad"),
            ("2 revolutions", "2 rev"),
            ("2 rotations/minute", "2 rev/min"),
            ("4 k steps/s", "4000 step/s"),
            ("4 ksteps/s", "4000 step/s"),
            ("4 pulses/s", "4 step/s"),
            ("2 full steps", "2 full-step"),
            ("12 volts", "12 V"),
            ("0,5 s", "0.5 s"),
            ("-0,5 degrees", "-0.5 deg"),
            ("1,25 rev/s", "1.25 rev/s"),
            ("1,000 step/s", "1000 step/s\" or \"1.000 step/s"),
            ("4 000 step/s", "4000 step/s"),
            ("4'000 steps/s", "4000 steps/s"),
            ("1/2 rev", "0.5 rev"),
            ("1 km", "1000 m"),
            ("1 km/h", "1000 m/h"),
            ("2 kilometres", "2000 m"),
            ("5 nm", "0.000005 mm"),
            ("1 GHz", "1000000000 Hz"),
            ("1 THz", ""),
            ("3 ks", ""),
            ("3 krev/s", ""),
            ("3 furlongs", ""),
            ("3 //", ""),
            ("3 !", ""),
        ] {
            let error = refused(text);
            let meant = error.meant().unwrap_or_default();
            assert_eq!(meant, write, "{text}");
            for one in meant.split("\" or \"").filter(|one| !one.is_empty()) {
                assert!(Quantity::parse(one).is_ok(), "{text}: {one}");
            }
        }
        assert!(matches!(refused("2 s/s"), QuantityError::UnknownUnit { .. }));
    }

    #[test]
    fn decimal_times_are_exact() {
        let time = |text: &str| Quantity::parse(text).unwrap().time();
        assert_eq!(time("100 ms"), Some(Time::from_ratio(1, 10)));
        assert_eq!(time("0.1 s"), Some(Time::from_ratio(1, 10)));
        assert_eq!(time("1e-1 s"), Some(Time::from_ratio(1, 10)));
        assert_eq!(time("1.5 min"), Some(Time::from_ratio(90, 1)));
        assert_eq!(time("2 rev"), None);
        assert_eq!(Quantity::parse("3 Hz").unwrap().period(), Some(Time::from_ratio(1, 3)));
        assert_eq!(Quantity::parse("0.5 Hz").unwrap().period(), Some(Time::from_ratio(2, 1)));
        assert_eq!(Quantity::parse("0 Hz").unwrap().period(), None);
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(amount in -1e18_f64..1e18, scale in -30_i32..10, unit in "step|rev/s|ticks|us|mm") {
            let amount = amount * 10f64.powi(scale);
            let read = Quantity::parse(&written(amount, &unit)).unwrap();
            let exact = Quantity::parse(&format!("{amount} {unit}")).unwrap();
            prop_assert!((read.value - exact.value).abs() <= 0.005_001 * exact.value.abs());
        }

        #[test]
        fn never_panics(text in "\\PC{0,30}") {
            if let Ok(quantity) = Quantity::parse(&text) {
                prop_assert!(quantity.value.is_finite());
                let _ = (quantity.time(), quantity.period(), quantity.kind().to_string());
            }
        }

        #[test]
        fn exact_time_agrees_with_the_float(mantissa in -1_000_000_000_000i64..1_000_000_000_000, places in 0usize..9, unit in "ns|us|ms|s|min|h") {
            let divisor = 10f64.powi(places as i32);
            let quantity = Quantity::parse(&format!("{:.*} {unit}", places, mantissa as f64 / divisor)).unwrap();
            let time = quantity.time().unwrap().seconds();
            prop_assert!((time - quantity.value).abs() <= 1e-15 * quantity.value.abs() + 1e-19);
        }
    }
}
