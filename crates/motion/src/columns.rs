//! CSV files: rows with their places, and columns by what the header calls them and in which unit they are.
//!
//! Every CSV that the program takes is read here: tables and paths of motion files, camera tracks, captures, steps.csv.
//! Lines that begin with `#` are comments; rows without a value are left out. Fields are parted by tabs, `;` or `,`: whichever of
//! them the first line that is no comment holds, in this order. What instruments and spreadsheets write in another way, `plain` brings
//! to this form. A decimal comma is read where no comma parts the columns, or in quotes.
//!
//! A header is a first row without a number, perhaps with a row of units below it, or a comment above it that names its columns. A title is a
//! name and perhaps a unit:
//! `time [ms]`, `time (ms)`, `time in ms`, `t / ms`, `time_ms`, `timeMs`, or a unit alone: `ms`. Names in any language and quantities
//! of any kind stand in such files: what is no known name or unit is therefore never read, least of all by its place.
//!
//! ```
//! use pulsetrain_motion::columns::{Role, TIME, CsvTable};
//! let mut table = CsvTable::new(b"i;a [deg];Time [ms]\n0;5;20\n");
//! let header = table.header()?;
//! let angle = Role { what: "the angle", own: None, names: &["a"], is_time: false, example: "angle [deg]" };
//! let found = header.find(&[TIME, angle])?;
//! assert_eq!(found, [2, 1]);
//! assert!(CsvTable::new(b"i,a\n0,5\n").header()?.find(&[TIME, angle]).is_err());
//! # Ok::<(), pulsetrain_motion::columns::ReadError>(())
//! ```

mod plain;

use std::ops::Range;

use csv::{ByteRecord, Reader, ReaderBuilder, Trim};

use crate::law::double::Double;
use crate::quantity::{Base, Quantity};
pub(crate) use plain::has_lone_returns;
pub use plain::{plain, with_line_feeds};

/// Why a file cannot be read, and where.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, column {column}: expected {expected}, found {found}{}", after(.help))]
pub struct ReadError {
    /// From 1.
    pub line: u64,
    /// Byte in the line, from 1.
    pub column: u64,
    /// Bytes of the file, if it is CSV; a byte order mark does not count.
    pub at: Range<usize>,
    /// What would have been right.
    pub expected: String,
    /// What was there, shortened.
    pub found: String,
    /// What the likely cause is; may be empty.
    pub help: &'static str,
}

/// Whether it is a number but for its decimal comma.
pub(crate) fn has_decimal_comma(text: &str) -> bool {
    text.matches(',').count() == 1 && text.replace(',', ".").parse::<f64>().is_ok()
}

/// A number with a decimal point or a decimal comma. A sign for thousands is none: `1.234,5` is no number.
fn number(text: &str) -> Option<f64> {
    let with_point = |text: &str| has_decimal_comma(text).then(|| text.replace(',', ".").parse().ok())?;
    text.parse().ok().or_else(|| with_point(text))
}

/// Reads a time of day, or a date with a time of day, by ISO 8601. Gives seconds, and which of both it was.
pub(crate) fn moment(text: &str) -> Option<(Double, DateForm)> {
    if !text.as_bytes().first()?.is_ascii_digit() || !text.contains(':') {
        return None;
    }
    let datetime: toml_edit::Datetime = text.parse().ok()?;
    let time = datetime.time?;
    let days = datetime.date.map_or(0, |date| days(date.year.into(), date.month.into(), date.day.into()));
    let offset_min = match datetime.offset {
        Some(toml_edit::Offset::Custom { minutes }) => i64::from(minutes),
        _ => 0,
    };
    let second = i64::from(time.hour) * 3600 + i64::from(time.minute) * 60 + i64::from(time.second.unwrap_or(0));
    let whole = days * 86_400 + second - offset_min * 60;
    let fraction = f64::from(time.nanosecond.unwrap_or(0)) / 1e9;
    let form = DateForm { has_date: datetime.date.is_some(), has_offset: datetime.offset.is_some() };
    Some((Double::from(whole) + Double::from(fraction), form))
}

/// Which parts a written moment has, besides the time of day.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct DateForm {
    /// `2026-11-27`
    pub(crate) has_date: bool,
    /// `Z`, or `+01:00`
    pub(crate) has_offset: bool,
}

/// Days from 1970-01-01 to a date. Source: H. Hinnant, "chrono-compatible low-level date algorithms".
fn days(year: i64, month: i64, day: i64) -> i64 {
    // Years begin in March, so that a leap day is their last.
    let year = if month > 2 { year } else { year - 1 };
    let day_of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    let era = year.div_euclid(400);
    let year = year.rem_euclid(400);
    era * 146_097 + year * 365 + year / 4 - year / 100 + day_of_year - 719_468
}

/// A help as it ends a message.
fn after(help: &str) -> String {
    if help.is_empty() { String::new() } else { format!("; {help}") }
}

impl ReadError {
    /// Of a file that is not CSV.
    #[must_use]
    pub fn new(line: u64, column: u64, expected: impl Into<String>, found: impl Into<String>) -> ReadError {
        ReadError { line, column, at: 0..0, expected: expected.into(), found: found.into(), help: "" }
    }

    fn at(bytes: &[u8], at: Range<usize>, expected: impl Into<String>, found: impl Into<String>) -> ReadError {
        let before = &bytes[..at.start.min(bytes.len())];
        let line_start = before.iter().rposition(|b| *b == b'\n').map_or(0, |n| n + 1);
        let line = before.iter().filter(|b| **b == b'\n').count() as u64 + 1;
        ReadError { at, ..ReadError::new(line, (before.len() - line_start) as u64 + 1, expected, found) }
    }
}

/// The bytes as short text for a message.
#[must_use]
pub fn shown(bytes: &[u8]) -> String {
    const MOST: usize = 40;
    if bytes.is_empty() {
        return "nothing".to_owned();
    }
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(MOST)]);
    format!("`{}`{}", text.escape_debug(), if bytes.len() > MOST { "…" } else { "" })
}

/// A column that is wanted.
#[derive(Clone, Copy, Debug)]
pub struct Role<'a> {
    /// In messages: "the time".
    pub what: &'a str,
    /// A name with priority over the others: the motor's.
    pub own: Option<&'a str>,
    /// Names: words in lower case, parted by spaces.
    pub names: &'a [&'a str],
    /// A time, else a motor's position.
    pub is_time: bool,
    /// A title for messages.
    pub example: &'a str,
}

impl Role<'_> {
    /// What is expected of a unit that is not of it.
    #[must_use]
    pub fn units(&self) -> &'static str {
        if self.is_time {
            "a unit of time (ns, us, ms, s, min, h)"
        } else {
            "a unit of position (rev, deg, rad, mm, cm, m, in, step, full-step)"
        }
    }

    /// The unit of the example.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        match Title::parse(self.example, 0..0).unit {
            Stated::Unit(unit) => unit.unit,
            _ => "",
        }
    }

    /// Whether a unit is of it.
    #[must_use]
    pub fn fits(&self, unit: &Quantity) -> bool {
        unit.per_seconds == 0 && if self.is_time { unit.base == Base::Time } else { unit.base.is_position() }
    }
}

/// The column of times.
#[rustfmt::skip]
pub const TIME: Role<'static> = Role {
    what: "the time",
    own: None,
    names: &["t", "time", "times", "timestamp", "time stamp", "elapsed", "elapsed time", "zeit", "temps", "tiempo", "tempo"],
    is_time: true,
    example: "time [s]",
};

/// What columns of a motor's positions are called: angles first.
#[rustfmt::skip]
pub const POSITIONS: &[&str] = &[
    "a", "angle", "angles", "theta", "θ", "ϑ", "phi", "φ", "ϕ", "alpha", "α", "pos", "position", "positions", "rotation", "winkel", "drehwinkel",
    "ángulo", "angulo", "angolo", "posición", "posicion", "posizione",
    "x", "y", "z", "value", "wert", "valeur", "valor",
];

/// The angles among them.
pub const ANGLES: &[&str] = POSITIONS.split_at(POSITIONS.len() - 7).0;

/// Words in names of what is no time or position, whatever its unit: speeds, forces, differences, numbers of rows, lengths of time.
#[rustfmt::skip]
const OTHERS: &[&str] = &[
    "v", "vel", "velocity", "speed", "w", "ω", "omega", "rate", "frequency", "acceleration", "accel", "acc", "jerk",
    "current", "voltage", "power", "force", "torque", "load", "pressure", "temperature", "temp",
    "delta", "diff", "difference", "differenz", "change", "increment", "error", "err", "fehler", "deviation", "std", "noise", "offset",
    "per", "x10", "x100", "x1000", "i", "k", "n", "no", "nr", "num", "number", "id", "idx", "index", "frame", "sample", "row", "line", "count", "counter",
    "duration", "dauer", "delay", "latency", "interval", "period", "exposure", "timeout",
];

/// The speeds among them.
const SPEEDS: &[&str] = OTHERS.split_at(7).0;

/// Words in names of sensors' raw values.
#[rustfmt::skip]
const SENSORS: &[&str] = &[
    "counts", "ticks", "pulses", "encoder", "enc", "adc", "raw", "code", "codes", "lsb", "analog", "a0",
    "volt", "volts", "sensor", "pot", "poti", "potentiometer",
];

/// Words for units that motion files do not know, without the end of their plural.
#[rustfmt::skip]
const WORDS: &[(&str, &[&str])] = &[
    ("ns", &["nanosecond", "nsec", "nano", "nanosekunde", "nanoseconde", "nanosegundo"]),
    ("us", &["microsecond", "usec", "micro", "mikrosekunde", "microseconde", "microsegundo"]),
    ("ms", &["millisecond", "msec", "milli", "millisekunde", "milliseconde", "milisegundo"]),
    ("s", &["second", "sec", "sekunde", "sek", "seconde", "segundo", "seg", "secondi"]),
    ("min", &["minute", "minuto"]),
    ("h", &["hour", "stunde", "heure", "hora"]),
    ("deg", &["deg", "degree", "degré", "grado", "gradi"]),
    ("rad", &["rad", "radian", "radiant", "radián", "radiane"]),
    ("rev", &["revolution", "umdrehung", "vuelta", "giro", "giri"]),
    ("step", &["schritt", "schritte", "paso"]),
    ("mm", &["millimetre", "millimeter", "millimètre", "milímetro"]),
    ("cm", &["centimetre", "centimeter", "zentimeter", "centimètre", "centímetro"]),
    ("in", &["inch"]),
];

/// A unit as headers write it: as motion files do, in any case, or in full.
fn unit(text: &str) -> Option<Quantity> {
    let one = |unit: &str| Quantity::parse(&format!("1 {unit}")).ok();
    // Of the two characters for micro, motion files know the first.
    let text = &text.trim_end_matches('.').replace('μ', "µ");
    let lower = text.to_lowercase();
    let is_word =
        |word: &&str| lower.strip_prefix(word).is_some_and(|plural| ["", "s", "n", "en", "es"].contains(&plural));
    let word = WORDS.iter().find(|(_, words)| words.iter().any(is_word)).map(|(unit, _)| *unit);
    word.and_then(one).or_else(|| one(text)).or_else(|| one(&lower))
}

/// A unit that nothing marks as one: only what means nothing else.
fn unmarked_unit(text: &str) -> Option<Quantity> {
    const OTHER_MEANINGS: &[&str] = &["m", "h", "in", "min", "a", "v", "tick", "ticks", "micro", "milli", "nano"];
    unit(text).filter(|_| !OTHER_MEANINGS.contains(&&*text.to_lowercase()))
}

fn is_separator(c: char) -> bool {
    c.is_whitespace() || "_-.:/".contains(c)
}

/// A name in lower case, its words parted by single spaces: `elapsed time` of `elapsed_time`, `elapsedTime` and `Elapsed-Time`.
fn words(name: &str) -> String {
    let (mut words, mut before) = (String::new(), ' ');
    for c in name.chars() {
        let is_next = !words.is_empty() && !words.ends_with(' ');
        if !is_separator(c) {
            words.push_str(if is_next && c.is_uppercase() && before.is_lowercase() { " " } else { "" });
            words.extend(c.to_lowercase());
        } else if is_next {
            words.push(' ');
        } else if c == '-' && words.is_empty() {
            // `-angle` is another quantity.
            words.push(c);
        }
        before = c;
    }
    words.truncate(words.trim_end().len());
    words
}

/// Whether it is the name of a time or position.
fn is_known(name: &str) -> bool {
    TIME.names.contains(&name) || POSITIONS.contains(&name)
}

/// What a title says of its column's unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stated {
    /// Nothing.
    Nothing,
    /// A unit that is known: one of it.
    Unit(Quantity),
    /// Something that is not known, or may mean something else; perhaps a unit.
    Unclear(Option<Quantity>),
}

/// A column's title.
#[derive(Clone, Debug)]
pub struct Title {
    /// As it is written.
    pub text: String,
    /// Its unit.
    pub unit: Stated,
    /// Where it is written, bytes of the file.
    pub at: Range<usize>,
    /// Without the unit.
    name: String,
}

impl Title {
    fn parse(text: &str, at: Range<usize>) -> Title {
        if text.len() > MAX_TITLE_BYTES {
            return Title { text: text.to_owned(), unit: Stated::Nothing, at, name: String::new() };
        }
        // `grad` alone may be gon as well.
        let is_german = text.to_lowercase().contains("winkel");
        let read = if is_german { text.replace("Grad", "deg").replace("grad", "deg") } else { text.to_owned() };
        let (name, unit) = elapsed(&read).unwrap_or_else(|| name_and_unit(&read));
        Title { text: text.to_owned(), unit, at, name }
    }

    /// Whether it is called so, with or without its unit.
    #[must_use]
    pub fn is_called(&self, name: &str) -> bool {
        self.name == words(name) || self.text.to_lowercase() == name.to_lowercase()
    }

    /// Whether it is called one of those.
    #[must_use]
    pub fn is_one_of(&self, names: &[&str]) -> bool {
        names.iter().any(|name| self.is_called(name))
    }

    /// Whether it may be a sensor's raw values: counts of an encoder, volts of a potentiometer, codes of a converter.
    pub(crate) fn is_of_sensor(&self) -> bool {
        let is_voltage = matches!(self.unit, Stated::Unit(Quantity { base: Base::Voltage, .. }));
        is_voltage || self.name.split(' ').any(|word| SENSORS.contains(&word))
    }

    /// Whether its unit, if it has a known one, is of that.
    fn fits(&self, role: &Role<'_>) -> bool {
        !matches!(&self.unit, Stated::Unit(unit) if !role.fits(unit))
    }

    /// Whether it must be a column's: its name is known, or its unit. `100 ms` is an amount.
    fn is_of_column(&self) -> bool {
        let has_unit = matches!(self.unit, Stated::Unit(_)) && !self.name.starts_with(|c: char| c.is_ascii_digit());
        is_known(&self.name) || has_unit
    }

    /// Whether it is named as something else than a time or a position, or as a difference of two; pandas leaves numbers of rows without a
    /// title.
    fn is_other(&self) -> bool {
        let is_other = |word: &str| OTHERS.contains(&word) || word.strip_prefix(['d', 'δ']).is_some_and(is_known);
        // `angle*100`
        let is_formula = self.name.contains(|c: char| "*×^²³|~!?'".contains(c));
        is_formula || self.name.split(' ').any(is_other) || self.name.is_empty() && self.unit == Stated::Nothing
    }
}

/// `seconds_elapsed`, as loggers of phones call it.
fn elapsed(text: &str) -> Option<(String, Stated)> {
    let name = words(text);
    let unit = unit(name.strip_suffix(" elapsed")?).filter(|unit| TIME.fits(unit))?;
    Some(("elapsed".to_owned(), Stated::Unit(unit)))
}

/// `theta [deg]`, `theta (deg)`, `theta / deg`, `theta in deg`, `theta_deg`, `thetaDeg`, `theta.deg`, `theta deg`, `thetadeg`, `deg`.
fn name_and_unit(text: &str) -> (String, Stated) {
    if let Some((name, written)) = text.rsplit_once(['[', '(']) {
        let written = written.trim_end().trim_end_matches([']', ')']).trim();
        return (words(name), unit(written).map_or(Stated::Unclear(None), Stated::Unit));
    }
    let mut before = ' ';
    for (at, c) in text.char_indices() {
        let (name, written) = text.split_at(at);
        let is_fused = name.chars().count() > 2 && is_known(&name.to_lowercase()) && written.chars().count() > 1;
        let is_camel = c.is_uppercase() && before.is_lowercase();
        if !is_separator(c)
            && (at == 0 || is_separator(before) || c == '°' || is_camel || is_fused)
            && let Some(found) = with_unit(name, written.trim_end())
        {
            return found;
        }
        before = c;
    }
    (words(text), Stated::Nothing)
}

/// The name and the unit of a title that is split before what may be its unit.
fn with_unit(before: &str, written: &str) -> Option<(String, Stated)> {
    let (before, name) = (before.trim_end(), words(before));
    let (rest, last) = name.rsplit_once(' ').unwrap_or(("", &name));
    if ["in", "en"].contains(&last) && !rest.is_empty() {
        return Some((rest.to_owned(), Stated::Unit(unit(written)?)));
    }
    if let Some(before) = before.strip_suffix('/') {
        // Not the last part of `km/h` or `speed rad / sec`.
        let is_name = is_known(&name) || before.ends_with(' ') && !name.contains(' ') && unit(&name).is_none();
        return unit(written).filter(|_| is_name).map(|unit| (name, Stated::Unit(unit)));
    }
    // `steps_per_s`, `rad_s`.
    if ["per", "pro", "par", "por"].contains(&last) || unit(last).is_some() {
        return None;
    }
    // A `step` alone may be a simulation's, and `m` the minute next to `h` and `s`.
    let is_step = name.is_empty() && written.eq_ignore_ascii_case("step");
    if let Some(unit) = unmarked_unit(written).filter(|_| !is_step) {
        return Some((name, Stated::Unit(unit)));
    }
    let is_alone = |unit: &Quantity| name.is_empty() && (TIME.fits(unit) || unit.base.is_position());
    let unit = unit(written).filter(|unit| is_known(&name) || is_alone(unit))?;
    Some((name, Stated::Unclear(Some(unit))))
}

/// What stands above a file's columns.
#[derive(Clone, Debug)]
pub struct Header<'a> {
    /// Of every column; empty if the file has no header.
    pub titles: Vec<Title>,
    /// How many columns the first row has.
    width: usize,
    /// There is no header, but a comment that seems to be one.
    unclear: Option<Range<usize>>,
    /// What parts its columns.
    delimiter: char,
    bytes: &'a [u8],
    at: Range<usize>,
}

impl Header<'_> {
    /// Whether there is one.
    #[must_use]
    pub fn is_there(&self) -> bool {
        !self.titles.is_empty()
    }

    /// The columns of roles, the time first.
    ///
    /// A column is known by its name, else by its unit. Only what has no header goes by its place.
    ///
    /// # Errors
    /// When a role has no column, or could have several.
    pub fn find(&self, roles: &[Role<'_>]) -> Result<Vec<usize>, ReadError> {
        if !self.is_there() {
            if let Some(at) = &self.unclear {
                let found = shown(&self.bytes[at.clone()]);
                let expected = "a header without `#`, or `columns` in the motion file";
                return Err(ReadError::at(self.bytes, at.clone(), expected, found));
            }
            if self.width == roles.len() {
                return Ok((0..roles.len()).collect());
            }
            let whats: Vec<&str> = roles.iter().map(|role| role.what.trim_start_matches("the ")).collect();
            let columns = if self.width == 1 { "column" } else { "columns" };
            let found = format!("{} {columns} and no header", self.width);
            return Err(self.error(format!("{} columns ({}) or a header", roles.len(), whats.join(", ")), found));
        }
        let mut found: Vec<Option<usize>> = Vec::new();
        for role in roles {
            found.push(self.one_of(&format!("for {}", role.what), &self.named(role, roles))?);
        }
        for (k, role) in roles.iter().enumerate() {
            // Of several coordinates a unit does not say which.
            if found[k].is_none() && roles.iter().filter(|other| other.is_time == role.is_time).count() == 1 {
                found[k] = self.one_of(&format!("for {}", role.what), &self.with_unit(role, roles, &found))?;
            }
        }
        if let Some((role, _)) = roles.iter().zip(&found).find(|(_, found)| found.is_none()) {
            if let Some(column) = self.titles.iter().position(|title| title.is_one_of(role.names)) {
                return Err(self.error_in(column, role.units()));
            }
            return Err(self.error(format!("a column `{}`", role.example), self.listed()));
        }
        let found: Vec<usize> = found.into_iter().flatten().collect();
        for (k, column) in found.iter().enumerate() {
            if let Some(other) = found[..k].iter().position(|other| other == column) {
                let expected = format!("a column for {} and one for {}", roles[other].what, roles[k].what);
                return Err(self.error_in(*column, expected));
            }
        }
        Ok(found)
    }

    /// The columns whose name and unit are a role's.
    fn named(&self, role: &Role<'_>, roles: &[Role<'_>]) -> Vec<usize> {
        // A motor may be called `t`.
        let own = role.own.filter(|own| roles.iter().all(|other| !other.names.contains(&&*words(own))));
        let own = own.map(|own| self.all(|title| title.fits(role) && title.is_called(own))).unwrap_or_default();
        if !own.is_empty() {
            return own;
        }
        // If there is a speed, these may be accelerations.
        let has_speed = self.titles.iter().any(|title| SPEEDS.contains(&&*title.name));
        let is_doubtful =
            |title: &Title| has_speed && title.unit == Stated::Nothing && ["a", "alpha", "α"].contains(&&*title.name);
        let named = self.all(|title| title.fits(role) && title.is_one_of(role.names) && !is_doubtful(title));
        // Loggers of phones write a clock's time next to the seconds since the recording began.
        let since_begin: Vec<usize> =
            named.iter().copied().filter(|column| elapsed(&self.titles[*column].text).is_some()).collect();
        if role.is_time && since_begin.len() == 1 {
            let others = || named.iter().filter(|column| !since_begin.contains(column));
            if others().all(|column| self.titles[*column].unit == Stated::Nothing) {
                return since_begin;
            }
        }
        // Of `x`, `y`, `z` and `yaw [deg]` the one with a unit is a motor's position.
        let is_weak = |column: &usize| {
            let title = &self.titles[*column];
            title.unit == Stated::Nothing && role.names.contains(&&*title.name) && !ANGLES.contains(&&*title.name)
        };
        if role.names == POSITIONS && named.len() > 1 && named.iter().all(is_weak) {
            let is_clear = |column: &usize| matches!(self.titles[*column].unit, Stated::Unit(_));
            let with_unit = self.with_unit(role, roles, &[]);
            if with_unit.len() == 1 && with_unit.iter().all(is_clear) {
                return with_unit;
            }
        }
        named
    }

    /// The columns that are known to be a role's: by their names, else by their units.
    fn known(&self, role: &Role<'_>, roles: &[Role<'_>]) -> Vec<usize> {
        let named = self.named(role, roles);
        let is_alone = roles.iter().filter(|other| other.is_time == role.is_time).count() == 1;
        if !named.is_empty() || !is_alone {
            return named;
        }
        let is_clear = |column: &usize| matches!(self.titles[*column].unit, Stated::Unit(_));
        Some(self.with_unit(role, roles, &[])).filter(|columns| columns.iter().all(is_clear)).unwrap_or_default()
    }

    /// The titles by which roles would be found, as a line of the file. They keep the units, and the order, that the header has.
    #[must_use]
    pub fn titles_for(&self, roles: &[Role<'_>]) -> String {
        let known: Vec<Vec<usize>> = roles.iter().map(|role| self.known(role, roles)).collect();
        let mut titles = Vec::new();
        for (role, columns) in roles.iter().zip(&known) {
            let all = 0..self.titles.len();
            let unit = columns.iter().copied().chain(all).find_map(|column| match self.titles[column].unit {
                Stated::Unit(unit) if role.fits(&unit) => Some(unit.unit),
                _ => None,
            });
            let name = role.example.split(" [").next().unwrap_or_default();
            titles.push((columns.first(), format!("{name} [{}]", unit.unwrap_or(role.unit()))));
        }
        // What is not known is where there is room.
        if let ([(a, _), (b, _)], 2) = (titles.as_slice(), self.width)
            && (a.is_some_and(|a| *a == 1) || b.is_some_and(|b| *b == 0))
        {
            titles.reverse();
        }
        let titles: Vec<String> = titles.into_iter().map(|(_, title)| title).collect();
        titles.join(&self.delimiter.to_string())
    }

    /// Columns of other names whose unit says what they are.
    fn with_unit(&self, role: &Role<'_>, roles: &[Role<'_>], found: &[Option<usize>]) -> Vec<usize> {
        let is = |title: &Title| {
            let fits = matches!(&title.unit, Stated::Unit(unit) | Stated::Unclear(Some(unit)) if role.fits(unit));
            fits && !title.is_other() && roles.iter().all(|role| !role.names.contains(&&*title.name))
        };
        self.all(is).into_iter().filter(|column| !found.contains(&Some(*column))).collect()
    }

    fn all(&self, is: impl Fn(&Title) -> bool) -> Vec<usize> {
        (0..self.titles.len()).filter(|column| is(&self.titles[*column])).collect()
    }

    /// The only one of several columns.
    fn one_of(&self, what: &str, columns: &[usize]) -> Result<Option<usize>, ReadError> {
        if columns.len() < 2 {
            return Ok(columns.first().copied());
        }
        let listed: Vec<String> = columns.iter().take(MAX_LISTED).map(|column| self.called(*column)).collect();
        let more = if columns.len() > MAX_LISTED { ", …" } else { "" };
        Err(self.error(format!("one column {what}"), listed.join(" and ") + more))
    }

    /// The columns that the roles' may be, the likeliest first; `may_be` says what a column of unknown name may be by its numbers.
    #[must_use]
    pub fn possible(&self, roles: &[Role<'_>], may_be: impl Fn(usize, &Role<'_>) -> bool) -> Vec<Vec<usize>> {
        const MOST: usize = 64;
        let named: Vec<Vec<usize>> = roles.iter().map(|role| self.known(role, roles)).collect();
        let mut possible = vec![Vec::new()];
        for (role, columns) in roles.iter().zip(&named) {
            let is_free = |column: &usize| {
                let may_fit =
                    |title: &Title| !role.is_time && title.is_of_sensor() || title.fits(role) && !title.is_other();
                let fits = self.titles.get(*column).is_none_or(may_fit);
                fits && may_be(*column, role) && named.iter().all(|columns| !columns.contains(column))
            };
            let free = (0..self.width).filter(is_free).collect();
            let columns: &Vec<usize> = if columns.is_empty() { &free } else { columns };
            let with = |some: &Vec<usize>| {
                let others = columns.iter().filter(|column| !some.contains(column));
                others.take(MOST).map(|column| [some.as_slice(), &[*column]].concat()).collect::<Vec<_>>()
            };
            possible = possible.iter().flat_map(with).take(MOST).collect();
        }
        possible
    }

    /// The column of that name.
    ///
    /// # Errors
    /// When there is none, or several.
    pub fn column(&self, name: &str) -> Result<usize, ReadError> {
        let exact = self.all(|title| title.text.to_lowercase() == name.to_lowercase());
        let columns = if exact.is_empty() { self.all(|title| title.is_called(name)) } else { exact };
        let only = self.one_of(&format!("`{name}`"), &columns)?;
        only.ok_or_else(|| self.error(format!("a column `{name}`"), self.listed()))
    }

    /// "column 2 `t`"
    #[must_use]
    pub fn called(&self, column: usize) -> String {
        match self.titles.get(column).map(|title| title.text.as_str()) {
            None | Some("") => format!("column {}", column + 1),
            Some(text) => format!("column {} {}", column + 1, shown(text.as_bytes())),
        }
    }

    /// Whether a comma is between its columns.
    #[must_use]
    pub fn is_parted_by_commas(&self) -> bool {
        self.delimiter == ','
    }

    /// How many columns the file's first row has.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// That the header as a whole is not what was expected.
    pub fn error(&self, expected: impl Into<String>, found: impl Into<String>) -> ReadError {
        ReadError::at(self.bytes, self.at.clone(), expected, found)
    }

    /// That a column's title is not what was expected.
    pub fn error_in(&self, column: usize, expected: impl Into<String>) -> ReadError {
        let title = self.titles.get(column);
        let at = title.map_or(self.at.clone(), |title| title.at.clone());
        ReadError::at(self.bytes, at, expected, shown(title.map_or(&[], |title| title.text.as_bytes())))
    }

    /// All titles, for messages.
    fn listed(&self) -> String {
        let titles: Vec<String> =
            self.titles.iter().take(MAX_LISTED).map(|title| shown(title.text.as_bytes())).collect();
        let more = if self.titles.len() > MAX_LISTED { ", …" } else { "" };
        if titles.is_empty() { "no header".to_owned() } else { titles.join(", ") + more }
    }
}

/// Columns that messages name.
const MAX_LISTED: usize = 8;
/// Columns of a file that is read. Recordings have some dozens, the logs of cars some hundred.
const MAX_COLUMNS: usize = 1000;
/// A longer title, bytes, names no column and no unit: to find them takes as long as the square of its length.
const MAX_TITLE_BYTES: usize = 300;
/// Lines of comments above a table, and words of each, in which names of columns are looked for.
const MAX_COMMENTS: usize = 200;
const MAX_WORDS: usize = 1000;

/// The rows of a CSV file.
pub struct CsvTable<'a> {
    form: Dialect<'a>,
    reader: Reader<&'a [u8]>,
    row: ByteRecord,
    /// The row was read for the header, but is one of numbers.
    kept: bool,
    /// How many columns the first row has, once it was read.
    width: usize,
}

/// What a file's bytes are to be taken for.
#[derive(Clone, Copy)]
struct Dialect<'a> {
    bytes: &'a [u8],
    comment: u8,
    delimiter: u8,
}

fn form_reader<'a>(form: Dialect<'_>, bytes: &'a [u8]) -> Reader<&'a [u8]> {
    ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(Trim::All)
        .comment(Some(form.comment))
        .delimiter(form.delimiter)
        .from_reader(bytes)
}

impl<'a> CsvTable<'a> {
    /// Of a file whose comments begin with `#`.
    #[must_use]
    pub fn new(bytes: &'a [u8]) -> CsvTable<'a> {
        CsvTable::with_comments(bytes, b'#')
    }

    /// Of a file whose comments begin with another character.
    #[must_use]
    pub fn with_comments(bytes: &'a [u8], comment: u8) -> CsvTable<'a> {
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let mut lines = bytes.split(|b| *b == b'\n').filter(|line| !line.starts_with(&[comment]));
        let first = lines.find(|line| !line.trim_ascii().is_empty()).unwrap_or_default();
        let delimiters = [b'\t', b';'].into_iter().filter(|delimiter| *delimiter != comment);
        let delimiter = delimiters.into_iter().find(|delimiter| first.contains(delimiter)).unwrap_or(b',');
        let form = Dialect { bytes, comment, delimiter };
        CsvTable { form, reader: form_reader(form, bytes), row: ByteRecord::new(), kept: false, width: usize::MAX }
    }

    /// The header; rows come after it. To be asked for first.
    ///
    /// # Errors
    /// As [`CsvTable::next`].
    pub fn header(&mut self) -> Result<Header<'a>, ReadError> {
        self.header_or(|_| false)
    }

    /// The header, which may be a row with numbers if `is_titles` knows it.
    ///
    /// # Errors
    /// As [`CsvTable::next`].
    pub fn header_or(&mut self, is_titles: impl Fn(&[&[u8]]) -> bool) -> Result<Header<'a>, ReadError> {
        let mut header = self.first_row(is_titles)?;
        self.width = header.width;
        self.units_below(&mut header);
        Ok(header)
    }

    /// Reads a second row of titles, if it has units alone.
    fn units_below(&mut self, header: &mut Header<'a>) {
        if self.kept || !header.is_there() {
            return;
        }
        let mut ahead = ByteRecord::new();
        // What is wrong there is an error of the row, once it is read.
        let mut reader =
            form_reader(self.form, self.form.bytes.get(self.reader.position().byte() as usize..).unwrap_or_default());
        while reader.read_byte_record(&mut ahead).is_ok_and(|is_there| is_there) && ahead.iter().all(<[u8]>::is_empty) {
        }
        let units: Vec<Title> = ahead.iter().map(|field| Title::parse(&String::from_utf8_lossy(field), 0..0)).collect();
        if !plain::is_units(&units) {
            return;
        }
        while self.reader.read_byte_record(&mut self.row).is_ok_and(|is_there| is_there)
            && self.row.iter().all(<[u8]>::is_empty)
        {}
        for (title, unit) in header.titles.iter_mut().zip(units) {
            if title.unit == Stated::Nothing && !unit.text.is_empty() {
                *title = Title { unit: unit.unit, ..title.clone() };
            }
        }
    }

    fn first_row(&mut self, is_titles: impl Fn(&[&[u8]]) -> bool) -> Result<Header<'a>, ReadError> {
        let form = self.form;
        let delimiter = char::from(form.delimiter);
        let none = |at, width, unclear| Header { titles: Vec::new(), width, unclear, delimiter, bytes: form.bytes, at };
        let Some(row) = self.next()? else { return Ok(none(0..0, 0, None)) };
        let is_number = |field: &[u8]| std::str::from_utf8(field).is_ok_and(|text| number(text).is_some());
        let (at, filled) = (row.at(), row.fields.iter().rposition(|field| !field.is_empty()).map_or(0, |k| k + 1));
        if !row.fields.iter().any(is_number) || is_titles(&row.fields.iter().collect::<Vec<_>>()) {
            let places = row.places(row.len()).into_iter().enumerate();
            let title = |(k, place)| Title::parse(&String::from_utf8_lossy(row.get(k)), place);
            return Ok(Header { titles: places.map(title).collect(), ..none(at, row.len(), None) });
        }
        let header = match form.comments_above(at.start, filled) {
            Some((titles, at)) if !titles.is_empty() => Header { titles, ..none(at, filled, None) },
            unclear => none(at, filled, unclear.map(|(_, at)| at)),
        };
        self.kept = true;
        Ok(header)
    }

    /// The next row, or `None` at the end.
    ///
    /// # Errors
    /// If it cannot be parted into fields, or has more than the first row.
    #[expect(clippy::should_implement_trait, reason = "a row borrows from the table")]
    pub fn next(&mut self) -> Result<Option<Row<'_>>, ReadError> {
        if std::mem::take(&mut self.kept) {
            return Ok(Some(Row { form: self.form, fields: &self.row }));
        }
        loop {
            match self.reader.read_byte_record(&mut self.row) {
                Ok(true) if self.row.iter().all(<[u8]>::is_empty) => {}
                Ok(true) => break,
                Ok(false) => return Ok(None),
                Err(error) => {
                    let at = error.position().map_or(0, |position| position.byte() as usize);
                    return Err(ReadError::at(self.form.bytes, at..at, "a row of fields", error.to_string()));
                }
            }
        }
        let (row, width) = (Row { form: self.form, fields: &self.row }, self.width);
        if row.len() > MAX_COLUMNS {
            let at = row.begin();
            let expected = format!("{MAX_COLUMNS} columns at most");
            return Err(ReadError::at(self.form.bytes, at..at, expected, format!("{}", row.len())));
        }
        if let Some(extra) = (width..row.len()).find(|k| !row.get(*k).is_empty()) {
            let columns = if width == 1 { "column" } else { "columns" };
            let error = row.error(extra, format!("{width} {columns} as in the first row"));
            let found = format!("{} in column {}", error.found, extra + 1);
            let help = match self.form.delimiter {
                b',' => {
                    "a comma separates columns here: write decimals with a point, 0.5, or separate the columns with `;` or tabs"
                }
                _ => "",
            };
            return Err(ReadError { found, help, ..error });
        }
        Ok(Some(row))
    }
}

impl Dialect<'_> {
    /// The titles in the comments above the first row, of `width` columns, as numpy writes them, and where they stand. No titles if a
    /// comment only seems to name columns.
    fn comments_above(self, row: usize, width: usize) -> Option<(Vec<Title>, Range<usize>)> {
        let mut unclear = None;
        let mut end = row;
        for line in self.bytes[..row].split_inclusive(|b| *b == b'\n').rev().take(MAX_COMMENTS) {
            let start = end - line.len();
            let at = start..start + line.trim_ascii_end().len();
            end = start;
            let Ok(text) = std::str::from_utf8(&self.bytes[at.clone()]) else { continue };
            let Some(text) = text.strip_prefix('#').filter(|_| self.comment == b'#') else { continue };
            for separator in [char::from(self.delimiter), '\t', ';', ',', '|'] {
                if text.matches(separator).count() >= MAX_COLUMNS {
                    continue;
                }
                let titles = titles(text, separator, start + 1);
                if width >= 2 && titles.len() == width && titles.iter().any(Title::is_of_column) {
                    return Some((titles, at));
                }
            }
            if unclear.is_none() && names_columns(text) {
                unclear = Some((Vec::new(), at));
            }
        }
        unclear
    }
}

/// Titles of a line that begins at `start` of the file.
fn titles(line: &str, separator: char, start: usize) -> Vec<Title> {
    let mut from = start;
    let title = |part: &str| {
        let at = from + (part.len() - part.trim_start().len());
        from += part.len() + separator.len_utf8();
        Title::parse(part.trim(), at..at + part.trim().len())
    };
    line.split(separator).map(title).collect()
}

/// Whether a word of a comment is a name or unit of a column. `100 ms` is an amount, and `a` a word.
fn names_columns(comment: &str) -> bool {
    let mut before = "";
    comment.split(|c: char| !c.is_alphanumeric() && c != '°').filter(|word| !word.is_empty()).take(MAX_WORDS).any(
        |word| {
            let is_amount = std::mem::replace(&mut before, word).ends_with(|c: char| c.is_ascii_digit());
            let is_unit = Title::parse(word, 0..0).is_of_column();
            is_unit && !is_amount && (word.chars().count() > 1 || !word.is_ascii())
        },
    )
}

/// One row of a table.
#[derive(Clone, Copy)]
pub struct Row<'t> {
    form: Dialect<'t>,
    fields: &'t ByteRecord,
}

impl<'t> Row<'t> {
    /// How many fields it has.
    #[expect(clippy::len_without_is_empty, reason = "rows without a field are left out")]
    #[must_use]
    pub fn len(&self) -> usize {
        self.fields.len()
    }

    /// The field, empty if the row is too short.
    #[must_use]
    pub fn get(&self, index: usize) -> &'t [u8] {
        self.fields.get(index).unwrap_or_default()
    }

    /// The field as text.
    ///
    /// # Errors
    /// If it is none.
    pub fn text(&self, index: usize) -> Result<&'t str, ReadError> {
        std::str::from_utf8(self.get(index)).map_err(|_| self.error(index, "text in UTF-8"))
    }

    /// The field as whatever its text parses to.
    ///
    /// # Errors
    /// If it does not.
    pub fn parse<T: std::str::FromStr>(&self, index: usize, expected: &str) -> Result<T, ReadError> {
        let text = std::str::from_utf8(self.get(index)).ok();
        text.and_then(|text| text.parse().ok()).ok_or_else(|| self.error(index, expected))
    }

    /// The field as a finite number, with a decimal point or a decimal comma.
    ///
    /// # Errors
    /// If it is none.
    pub fn number(&self, index: usize, expected: &str) -> Result<f64, ReadError> {
        let text = std::str::from_utf8(self.get(index)).unwrap_or_default();
        number(text).filter(|number| number.is_finite()).ok_or_else(|| {
            let is_mixed = text.contains(',') && text.contains('.');
            let help = if is_mixed { "write no sign for thousands: 1234.5, or 1234,5" } else { "" };
            ReadError { help, ..self.error(index, expected) }
        })
    }

    /// Where the row is written, bytes of the file.
    #[must_use]
    pub fn at(&self) -> Range<usize> {
        let start = self.begin();
        start..self.place(self.len().saturating_sub(1)).end
    }

    /// Where a field is written; the row's end if it is too short.
    #[must_use]
    pub fn place(&self, index: usize) -> Range<usize> {
        self.places(index + 1).pop().unwrap_or_default()
    }

    /// Where the first `count` fields are written; the row's end for those that it does not have.
    fn places(&self, count: usize) -> Vec<Range<usize>> {
        let bytes = self.form.bytes;
        let (mut from, mut quoted) = (self.begin(), false);
        let (mut to, mut places) = (from, Vec::new());
        let written = |from: usize, to: usize| {
            let written = &bytes[from..to];
            let from = to - written.trim_ascii_start().len();
            from..from + written.trim_ascii().len()
        };
        while let Some(&byte) = bytes.get(to).filter(|_| places.len() < count) {
            match byte {
                b'"' if quoted || to == from => quoted = !quoted,
                b'\n' | b'\r' if !quoted => break,
                byte if byte == self.form.delimiter && !quoted => {
                    places.push(written(from, to));
                    from = to + 1;
                }
                _ => {}
            }
            to += 1;
        }
        if places.len() < count {
            places.push(written(from, to));
        }
        places.resize(count, to..to);
        places
    }

    /// The row's first byte. The reader's own position is before the comments and empty lines that it left out.
    fn begin(&self) -> usize {
        let bytes = self.form.bytes;
        let mut at = self.fields.position().map_or(0, |position| position.byte() as usize).min(bytes.len());
        loop {
            let line = bytes[at..].split_inclusive(|b| *b == b'\n').next().unwrap_or_default();
            let left_out = line.starts_with(&[self.form.comment]) || line.iter().all(|b| matches!(b, b'\r' | b'\n'));
            if line.is_empty() || !left_out {
                return at;
            }
            at += line.len();
        }
    }

    /// That this field is not what was expected.
    pub fn error(&self, index: usize, expected: impl Into<String>) -> ReadError {
        let error = ReadError::at(self.form.bytes, self.place(index), expected, shown(self.get(index)));
        // A field that is missing would come after one more delimiter.
        ReadError { column: error.column + u64::from(index >= self.len()), ..error }
    }
}
