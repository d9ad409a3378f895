//! CSV files: rows with their places, and columns by what the header calls them and in which unit they are.
//!
//! Every CSV that the program takes is read here: tables and paths of motion files, camera tracks, captures, steps.csv.
//! Lines that begin with `#` are comments; rows without a value are left out. Fields are parted by tabs, `;` or `,`: whichever of
//! them the first line that is no comment holds, in this order.
//!
//! A header is a first row without a number, or the comment just above it if that names its columns. A title is a name and
//! perhaps a unit: `time [ms]`, `time (ms)`, `time in ms`, `t / ms`, `time_ms`, or a unit alone: `ms`.
//!
//! ```
//! use pulsetrain_motion::columns::{Measure, Role, TIME, Table};
//! let mut table = Table::new(b"i;a [deg];Time [ms]\n0;5;20\n");
//! let header = table.header()?;
//! let angle = Role { what: "the angle", own: None, names: &["a"], measure: Measure::Position, example: "angle [deg]" };
//! let found = header.find(&[TIME, angle])?;
//! assert_eq!((found[0].column, found[1].column), (2, 1));
//! assert!(Table::new(b"i,a\n0,5\n").header()?.find(&[TIME, angle]).is_err());
//! # Ok::<(), pulsetrain_motion::columns::ReadError>(())
//! ```

use std::ops::Range;

use csv::{ByteRecord, Reader, ReaderBuilder, Trim};

use crate::quantity::{Base, Quantity};

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

/// What a column's unit must be of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measure {
    /// Of time.
    Time,
    /// Of a motor's position: an angle, a length, steps.
    Position,
}

impl Measure {
    /// What is expected of a unit that is not of it.
    #[must_use]
    pub fn units(self) -> &'static str {
        match self {
            Measure::Time => "a unit of time (ns, us, ms, s, min, h)",
            Measure::Position => "a unit of position (rev, deg, rad, mm, cm, m, in, step, full-step)",
        }
    }

    /// Whether a unit is of it.
    #[must_use]
    pub fn fits(self, unit: &Unit) -> bool {
        match self {
            Measure::Time => unit.one.base == Base::Time && unit.one.per_seconds == 0,
            Measure::Position => unit.one.base.is_position() && unit.one.per_seconds == 0,
        }
    }
}

/// A column that is wanted.
#[derive(Clone, Copy, Debug)]
pub struct Role<'a> {
    /// In messages: "the time".
    pub what: &'a str,
    /// A name that goes before the others: the motor's.
    pub own: Option<&'a str>,
    /// Names, in lower case.
    pub names: &'a [&'a str],
    /// What its unit is of.
    pub measure: Measure,
    /// A title for messages.
    pub example: &'a str,
}

/// The column of times.
pub const TIME: Role<'static> = Role {
    what: "the time",
    own: None,
    names: &["t", "time", "timestamp", "zeit"],
    measure: Measure::Time,
    example: "time [s]",
};

/// What columns of a motor's positions are called, in lower case: angles first.
pub const POSITIONS: &[&str] =
    &["a", "angle", "theta", "θ", "phi", "φ", "alpha", "α", "pos", "position", "rotation", "winkel", "x", "y", "z"];

/// The angles among them.
pub const ANGLES: &[&str] = POSITIONS.split_at(POSITIONS.len() - 3).0;

/// Names of columns that count rows: never times or positions, unless the user says so. A title may end in one: `frame_no`.
const COUNTS: &[&str] = &[
    "", "i", "k", "n", "no", "nr", "num", "number", "#", "id", "idx", "index", "frame", "sample", "row", "count",
    "line",
];

/// Names of other quantities, and what a title of one ends in: never taken for a time or position by their place alone.
const OTHERS: &[&str] = &[
    "v",
    "w",
    "ω",
    "omega",
    "speed",
    "velocity",
    "vel",
    "rate",
    "rpm",
    "rps",
    "dps",
    "hz",
    "frequency",
    "acceleration",
    "accel",
    "acc",
    "jerk",
    "current",
    "voltage",
    "power",
    "force",
    "torque",
    "load",
    "pressure",
    "temperature",
    "temp",
    "error",
];

/// A unit of a header.
#[derive(Clone, Debug, PartialEq)]
pub struct Unit {
    /// As it is written.
    pub text: String,
    /// One of it.
    pub one: Quantity,
}

/// Words for units that motion files do not know.
const WORDS: &[(&str, &str)] = &[
    ("nanosecond", "ns"),
    ("microsecond", "us"),
    ("usec", "us"),
    ("millisecond", "ms"),
    ("msec", "ms"),
    ("second", "s"),
    ("sec", "s"),
    ("minute", "min"),
    ("hour", "h"),
    ("degree", "deg"),
    ("radian", "rad"),
    ("revolution", "rev"),
    ("millimetre", "mm"),
    ("millimeter", "mm"),
    ("centimetre", "cm"),
    ("centimeter", "cm"),
    ("inch", "in"),
    ("inche", "in"),
];

impl Unit {
    /// A unit as headers write it: as motion files do, in any case, or in full.
    fn parse(text: &str) -> Option<Unit> {
        let one = |unit: &str| Quantity::parse(&format!("1 {unit}")).ok();
        let lower = text.to_lowercase();
        let word = lower.strip_suffix('s').unwrap_or(&lower);
        let word = WORDS.iter().find(|(long, _)| *long == word).map(|(_, short)| *short);
        let one = word.and_then(one).or_else(|| one(text)).or_else(|| one(&lower))?;
        Some(Unit { text: text.to_owned(), one })
    }

    /// The same, of a word that is not marked as a unit: only what means nothing else.
    fn unmarked(text: &str) -> Option<Unit> {
        const OTHER_MEANINGS: &[&str] = &["m", "h", "in", "min", "a", "v", "tick", "ticks"];
        Unit::parse(text).filter(|unit| unit.one.per_seconds == 0 && !OTHER_MEANINGS.contains(&&*text.to_lowercase()))
    }
}

/// What a title says of its column's unit.
#[derive(Clone, Debug, PartialEq)]
pub enum Stated {
    /// Nothing.
    Nothing,
    /// A unit that is known.
    Unit(Unit),
    /// Another, as it is written.
    Unknown(String),
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
    /// Without the unit, in lower case.
    name: String,
    /// The name's last word: of `frame_no` and `frameNo` it is `no`.
    word: String,
}

impl Title {
    fn parse(text: &str, at: Range<usize>) -> Title {
        let (name, unit) = name_and_unit(text);
        Title { text: text.to_owned(), unit, at, name: name.trim().to_lowercase(), word: last_word(name) }
    }

    /// Whether it is called so, with or without its unit; in lower case.
    #[must_use]
    pub fn is_called(&self, name: &str) -> bool {
        self.name == name || self.text.to_lowercase() == name
    }

    /// Whether its unit, if it has a known one, is of that.
    fn fits(&self, measure: Measure) -> bool {
        match &self.unit {
            Stated::Unit(unit) => measure.fits(unit),
            Stated::Nothing | Stated::Unknown(_) => true,
        }
    }

    fn counts_rows(&self) -> bool {
        // `x_n` may be a position.
        let ends_so = self.word.len() > 1 && COUNTS.contains(&&*self.word);
        self.unit == Stated::Nothing && (ends_so || COUNTS.contains(&&*self.name))
    }

    /// Whether it may be a time or position by its place: it has no unit and is no other quantity.
    fn is_plain(&self) -> bool {
        let is_rate = |unit: &str| Unit::parse(unit).is_some_and(|unit| unit.one.per_seconds != 0);
        let other = OTHERS.contains(&&*self.word) || self.name.rsplit(['_', ' ']).next().is_some_and(is_rate);
        self.unit == Stated::Nothing && !other
    }
}

/// In lower case; without the number that tells several such columns apart.
fn last_word(name: &str) -> String {
    let name = name.trim_end_matches(|c: char| !c.is_alphabetic());
    let (mut start, mut before) = (0, ' ');
    for (at, c) in name.char_indices() {
        if !c.is_alphanumeric() {
            start = at + c.len_utf8();
        } else if c.is_uppercase() && before.is_lowercase() {
            start = at;
        }
        before = c;
    }
    name[start..].to_lowercase()
}

/// `theta [deg]`, `theta (deg)`, `theta / deg`, `theta in deg`, `theta_deg`, `theta deg`, `deg`.
fn name_and_unit(text: &str) -> (&str, Stated) {
    if let Some((name, unit)) = text.split_once(['[', '(']) {
        let unit = unit.trim_end().trim_end_matches([']', ')']).trim();
        let known = Unit::parse(unit).map_or_else(|| Stated::Unknown(unit.to_owned()), Stated::Unit);
        return (name, known);
    }
    let marked = |separator: &str| {
        let (name, unit) = text.split_once(separator)?;
        Some((name, Stated::Unit(Unit::parse(unit.trim())?)))
    };
    let suffix = |separator: char| {
        let (name, unit) = text.rsplit_once(separator)?;
        Some((name, Stated::Unit(Unit::unmarked(unit)?)))
    };
    let alone = || {
        // `s` alone may be a way as well.
        let unit = Unit::unmarked(text).filter(|_| !text.eq_ignore_ascii_case("s"))?;
        Some(("", Stated::Unit(unit)))
    };
    let found = marked(" / ").or_else(|| marked(" in ")).or_else(alone).or_else(|| suffix('_')).or_else(|| suffix(' '));
    found.unwrap_or((text, Stated::Nothing))
}

/// The column that a role was found in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Found {
    /// From 0.
    pub column: usize,
    /// Its place says so, not its title.
    pub by_place: bool,
}

/// What stands above a file's columns.
#[derive(Clone, Debug)]
pub struct Header<'a> {
    /// Of every column; empty if the file has no header.
    pub titles: Vec<Title>,
    /// How many columns the first row has.
    width: usize,
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
    /// A column is known by its name, else by its unit. What neither says, its place may: two columns without a header, or with
    /// names that say nothing, are time and position; beside a time the one column that is left is the position.
    ///
    /// # Errors
    /// When a role has no column, or could have several.
    pub fn find(&self, roles: &[Role<'_>]) -> Result<Vec<Found>, ReadError> {
        if !self.is_there() {
            if self.width == roles.len() {
                return Ok((0..roles.len()).map(|column| Found { column, by_place: true }).collect());
            }
            let whats: Vec<&str> = roles.iter().map(|role| role.what.trim_start_matches("the ")).collect();
            let columns = if self.width == 1 { "column" } else { "columns" };
            let found = format!("{} {columns} and no header", self.width);
            return Err(self.error(format!("{} columns ({}) or a header", roles.len(), whats.join(", ")), found));
        }
        let mut found: Vec<Option<Found>> = vec![None; roles.len()];
        for (role, found) in roles.iter().zip(&mut found) {
            *found = self.one_of(role, self.named(role, roles))?;
        }
        self.by_unit(roles, &mut found)?;
        self.by_place(roles, &mut found);
        let missing = roles.iter().zip(&found).find(|(_, found)| found.is_none());
        if let Some((role, _)) = missing {
            let is_called = |title: &Title| role.names.iter().any(|name| title.is_called(name));
            if let Some(column) = self.titles.iter().position(is_called) {
                return Err(self.error_in(column, role.measure.units()));
            }
            return Err(self.error(format!("a column `{}`", role.example), self.listed()));
        }
        let found: Vec<Found> = found.into_iter().flatten().collect();
        for (k, first) in found.iter().enumerate() {
            if let Some(other) = found[..k].iter().position(|other| other.column == first.column) {
                let expected = format!("a column for {} and one for {}", roles[other].what, roles[k].what);
                return Err(self.error_in(first.column, expected));
            }
        }
        Ok(found)
    }

    /// The columns whose name and unit are a role's.
    fn named(&self, role: &Role<'_>, roles: &[Role<'_>]) -> Vec<usize> {
        let called = |names: &[&str]| -> Vec<usize> {
            let is = |title: &Title| title.fits(role.measure) && names.iter().any(|name| title.is_called(name));
            (0..self.titles.len()).filter(|column| is(&self.titles[*column])).collect()
        };
        let own = role.own.map(str::to_lowercase);
        // A motor may be called `t`.
        let own = own.filter(|own| roles.iter().all(|other| !other.names.contains(&&**own)));
        let own = own.map(|own| called(&[&own])).unwrap_or_default();
        if own.is_empty() { called(role.names) } else { own }
    }

    /// Columns of other names whose unit tells what they are.
    fn by_unit(&self, roles: &[Role<'_>], found: &mut [Option<Found>]) -> Result<(), ReadError> {
        for (k, role) in roles.iter().enumerate() {
            let like = |other: usize| other != k && found[other].is_none() && roles[other].measure == role.measure;
            if found[k].is_some() || (0..roles.len()).any(like) {
                continue;
            }
            let fits = |title: &Title| matches!(&title.unit, Stated::Unit(unit) if role.measure.fits(unit));
            let free = self.free(roles, found).into_iter().filter(|column| fits(&self.titles[*column])).collect();
            found[k] = self.one_of(role, free)?;
        }
        Ok(())
    }

    /// What is left, if it can be one thing alone.
    fn by_place(&self, roles: &[Role<'_>], found: &mut [Option<Found>]) {
        let free: Vec<usize> = self.free(roles, found).into_iter().filter(|k| self.titles[*k].is_plain()).collect();
        let missing: Vec<usize> = (0..roles.len()).filter(|k| found[*k].is_none()).collect();
        let there = |column| Some(Found { column, by_place: true });
        match (missing.as_slice(), free.as_slice()) {
            // A time must be called so beside a column that is called a position: it might be a frame's number or a force.
            (&[k], &[column]) if roles.len() == 2 && roles[k].measure == Measure::Position => found[k] = there(column),
            ([0, 1], [0, 1]) if roles.len() == 2 && self.titles.len() == 2 => {
                (found[0], found[1]) = (there(0), there(1))
            }
            _ => {}
        }
    }

    /// Columns that nothing has been found in, and whose names say nothing.
    fn free(&self, roles: &[Role<'_>], found: &[Option<Found>]) -> Vec<usize> {
        let taken = |column| found.iter().flatten().any(|found| found.column == column);
        let says = |title: &Title| {
            let is_unit = title.name.is_empty() && title.unit != Stated::Nothing;
            let counts = title.counts_rows() || !is_unit && COUNTS.contains(&&*title.name);
            counts || roles.iter().any(|role| role.names.contains(&&*title.name))
        };
        (0..self.titles.len()).filter(|column| !taken(*column) && !says(&self.titles[*column])).collect()
    }

    /// The only one of several columns.
    fn one_of(&self, role: &Role<'_>, columns: Vec<usize>) -> Result<Option<Found>, ReadError> {
        match columns.as_slice() {
            [] => Ok(None),
            &[column] => Ok(Some(Found { column, by_place: false })),
            several => {
                let listed: Vec<String> = several.iter().map(|column| self.called(*column)).collect();
                Err(self.error(format!("one column for {}", role.what), listed.join(" and ")))
            }
        }
    }

    /// The columns that the roles' would be if all that is in doubt were as it most often is; none if their units say otherwise.
    #[must_use]
    pub fn likely(&self, roles: &[Role<'_>]) -> Vec<usize> {
        let mut likely: Vec<usize> = Vec::new();
        for role in roles {
            let named = if self.is_there() { self.named(role, roles) } else { Vec::new() };
            let counts = |column: &usize| self.titles.get(*column).is_some_and(Title::counts_rows);
            let belongs = |column: &usize| {
                let others = roles.iter().filter(|other| other.what != role.what);
                self.is_there() && others.clone().any(|other| self.named(other, roles).contains(column))
            };
            let rest = (0..self.width).filter(|column| !counts(column) && !belongs(column));
            let next = named.into_iter().chain(rest).chain(0..self.width).find(|column| !likely.contains(column));
            likely.extend(next);
        }
        let fit = |(role, column): (&Role<'_>, &usize)| self.titles.get(*column).is_none_or(|t| t.fits(role.measure));
        if likely.len() == roles.len() && roles.iter().zip(&likely).all(fit) { likely } else { Vec::new() }
    }

    /// The column of that name, in lower case.
    ///
    /// # Errors
    /// When there is none, or several.
    pub fn column(&self, name: &str) -> Result<usize, ReadError> {
        let exactly = |title: &Title| title.text.to_lowercase() == name;
        let called = |title: &Title| title.is_called(name);
        let all = |is: &dyn Fn(&Title) -> bool| -> Vec<usize> {
            (0..self.titles.len()).filter(|column| is(&self.titles[*column])).collect()
        };
        let exact = all(&exactly);
        let columns = if exact.is_empty() { all(&called) } else { exact };
        match columns.as_slice() {
            &[column] => Ok(column),
            [] => Err(self.error(format!("a column `{name}`"), self.listed())),
            several => {
                let listed: Vec<String> = several.iter().map(|column| self.called(*column)).collect();
                Err(self.error(format!("one column `{name}`"), listed.join(" and ")))
            }
        }
    }

    /// "column 2 `t`"
    #[must_use]
    pub fn called(&self, column: usize) -> String {
        match self.titles.get(column).map(|title| title.text.as_str()) {
            None | Some("") => format!("column {}", column + 1),
            Some(text) => format!("column {} {}", column + 1, shown(text.as_bytes())),
        }
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
        const MOST: usize = 8;
        let titles: Vec<String> = self.titles.iter().take(MOST).map(|title| shown(title.text.as_bytes())).collect();
        let more = if self.titles.len() > MOST { ", …" } else { "" };
        if titles.is_empty() { "no header".to_owned() } else { titles.join(", ") + more }
    }
}

/// The rows of a CSV file.
pub struct Table<'a> {
    form: Form<'a>,
    reader: Reader<&'a [u8]>,
    row: ByteRecord,
    /// The row was read for the header, but is one of numbers.
    kept: bool,
    /// How many columns the first row has, once it was read.
    width: usize,
}

/// What a file's bytes are to be taken for.
#[derive(Clone, Copy)]
struct Form<'a> {
    bytes: &'a [u8],
    comment: u8,
    delimiter: u8,
}

impl<'a> Table<'a> {
    /// Of a file whose comments begin with `#`.
    #[must_use]
    pub fn new(bytes: &'a [u8]) -> Table<'a> {
        Table::with_comments(bytes, b'#')
    }

    /// Of a file whose comments begin with another character.
    #[must_use]
    pub fn with_comments(bytes: &'a [u8], comment: u8) -> Table<'a> {
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let mut lines = bytes.split(|b| *b == b'\n').filter(|line| !line.starts_with(&[comment]));
        let first = lines.find(|line| !line.trim_ascii().is_empty()).unwrap_or_default();
        let delimiters = [b'\t', b';'].into_iter().filter(|delimiter| *delimiter != comment);
        let delimiter = delimiters.into_iter().find(|delimiter| first.contains(delimiter)).unwrap_or(b',');
        let reader = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .trim(Trim::All)
            .comment(Some(comment))
            .delimiter(delimiter)
            .from_reader(bytes);
        Table {
            form: Form { bytes, comment, delimiter },
            reader,
            row: ByteRecord::new(),
            kept: false,
            width: usize::MAX,
        }
    }

    /// The header; rows come after it. To be asked for first.
    ///
    /// # Errors
    /// As [`Table::next`].
    pub fn header(&mut self) -> Result<Header<'a>, ReadError> {
        self.header_or(|_| false)
    }

    /// The header, which may be a row with numbers if `is_titles` knows it.
    ///
    /// # Errors
    /// As [`Table::next`].
    pub fn header_or(&mut self, is_titles: impl Fn(&[&[u8]]) -> bool) -> Result<Header<'a>, ReadError> {
        let header = self.first_row(is_titles)?;
        self.width = header.width;
        Ok(header)
    }

    fn first_row(&mut self, is_titles: impl Fn(&[&[u8]]) -> bool) -> Result<Header<'a>, ReadError> {
        let form = self.form;
        let none = |at, width| Header { titles: Vec::new(), width, bytes: form.bytes, at };
        let Some(row) = self.next()? else { return Ok(none(0..0, 0)) };
        let is_number = |field: &[u8]| std::str::from_utf8(field).is_ok_and(|text| text.parse::<f64>().is_ok());
        let (at, filled) = (row.at(), row.fields.iter().rposition(|field| !field.is_empty()).map_or(0, |k| k + 1));
        if !row.fields.iter().any(is_number) || is_titles(&row.fields.iter().collect::<Vec<_>>()) {
            let title = |k: usize| Title::parse(&String::from_utf8_lossy(row.get(k)), row.place(k));
            return Ok(Header { titles: (0..row.len()).map(title).collect(), width: row.len(), bytes: form.bytes, at });
        }
        let header = form.comment_above(at.start, filled).unwrap_or_else(|| none(at, filled));
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
        if let Some(extra) = (width..row.len()).find(|k| !row.get(*k).is_empty()) {
            let columns = if width == 1 { "column" } else { "columns" };
            let error = row.error(extra, format!("{width} {columns} as in the first row"));
            let found = format!("{} in column {}", error.found, extra + 1);
            let help = match self.form.delimiter {
                b',' => "numbers need a decimal point: a comma parts columns",
                _ => "",
            };
            return Err(ReadError { found, help, ..error });
        }
        Ok(Some(row))
    }
}

impl<'a> Form<'a> {
    /// A header in the comment just above the first row, as numpy writes it; of as many columns as that row has.
    fn comment_above(self, row: usize, width: usize) -> Option<Header<'a>> {
        let end = self.bytes[..row].trim_ascii_end().len();
        let start = self.bytes[..end].iter().rposition(|b| *b == b'\n').map_or(0, |n| n + 1);
        let text = std::str::from_utf8(&self.bytes[start..end]).ok()?;
        let titles = text.strip_prefix(char::from(self.comment))?;
        let mut from = start + 1;
        let title = |part: &str| {
            let at = from + (part.len() - part.trim_start().len());
            from += part.len() + 1;
            Title::parse(part.trim(), at..at + part.trim().len())
        };
        let titles: Vec<Title> = titles.split(char::from(self.delimiter)).map(title).collect();
        // `100 ms` is an amount.
        let has_unit = |title: &Title| {
            matches!(title.unit, Stated::Unit(_)) && !title.name.starts_with(|c: char| c.is_ascii_digit())
        };
        let known =
            |title: &Title| TIME.names.contains(&&*title.name) || POSITIONS.contains(&&*title.name) || has_unit(title);
        let is_header = self.comment == b'#' && width >= 2 && titles.len() == width && titles.iter().any(known);
        is_header.then_some(Header { titles, width, bytes: self.bytes, at: start..end })
    }
}

/// One row of a table.
#[derive(Clone, Copy)]
pub struct Row<'t> {
    form: Form<'t>,
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

    /// The field as a finite number.
    ///
    /// # Errors
    /// If it is none.
    pub fn number(&self, index: usize, expected: &str) -> Result<f64, ReadError> {
        let number: f64 = self.parse(index, expected)?;
        if number.is_finite() { Ok(number) } else { Err(self.error(index, expected)) }
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
        let bytes = self.form.bytes;
        let (mut from, mut field, mut quoted) = (self.begin(), 0, false);
        let mut to = from;
        while let Some(&byte) = bytes.get(to) {
            match byte {
                b'"' if quoted || to == from => quoted = !quoted,
                b'\n' | b'\r' if !quoted => break,
                byte if byte == self.form.delimiter && !quoted => {
                    if field == index {
                        break;
                    }
                    (field, from) = (field + 1, to + 1);
                }
                _ => {}
            }
            to += 1;
        }
        if field < index {
            return to..to;
        }
        let written = &bytes[from..to];
        let from = to - written.trim_ascii_start().len();
        from..from + written.trim_ascii().len()
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
