//! Reads TOML with places: every accessor returns a value, or notes a problem that points at its place in the text.
//!
//! Problems are collected, not thrown, so that one run of the reader finds several.

use std::cell::{Cell, RefCell};
use std::ops::{Range, RangeInclusive};
use std::sync::Arc;

use toml_edit::{ArrayOfTables, Item, TableLike, Value};

use super::problem::{BrokenPath, MAX_PROBLEMS, Problem};
use super::source::Source;
use super::table_columns::TableColumns;
use super::winches::Winches;
use crate::Time;
use crate::quantity::{Base, Kind, Quantity, QuantityError, nearest};

/// A problem has been noted; there is no value.
#[derive(Clone, Copy, Debug)]
pub(super) struct Noted;

/// A value, or a problem that has been noted already.
pub(super) type Read<T> = Result<T, Noted>;

/// Longest time that a motion file may name: 2000 years, the range of `Time::ticks`.
const MAX_TIME_S: f64 = 6.0e10;

/// How far something periodic is shifted.
#[derive(Clone, Copy, Debug)]
pub(super) enum PhaseShift {
    Time(Time),
    /// One is a period.
    Turns(f64),
}

impl PhaseShift {
    /// The shift within one period.
    pub(super) fn of(self, period: Time) -> Time {
        let shift = match self {
            PhaseShift::Time(time) => time,
            PhaseShift::Turns(turns) => Time::from_raw(((turns - turns.floor()) * period.raw() as f64).round() as i128),
        };
        Time::from_raw(shift.raw().rem_euclid(period.raw()))
    }
}

/// The text and the problems found in it.
pub(super) struct Reader {
    pub(super) source: Arc<Source>,
    problems: RefCell<Vec<Problem>>,
    /// How many there are beyond those that are kept.
    others: Cell<usize>,
    /// Found motor by motor, judged when all are read.
    pub(super) winches: RefCell<Winches>,
    /// How tables were read.
    pub(super) tables: RefCell<Vec<TableColumns>>,
}

impl Reader {
    pub(super) fn new(source: Arc<Source>) -> Reader {
        Reader {
            source,
            problems: RefCell::default(),
            others: Cell::default(),
            winches: RefCell::default(),
            tables: RefCell::default(),
        }
    }

    /// Notes a problem with one place.
    pub(super) fn note(
        &self,
        at: Range<usize>,
        label: impl Into<String>,
        message: impl Into<String>,
        help: impl Into<String>,
    ) -> Noted {
        self.note_all(vec![(at, label.into())], message, help)
    }

    /// Notes a problem with several places; an empty `help` is none.
    pub(super) fn note_all(
        &self,
        labels: Vec<(Range<usize>, String)>,
        message: impl Into<String>,
        help: impl Into<String>,
    ) -> Noted {
        let help = Some(help.into()).filter(|help| !help.is_empty());
        self.note_problem(Problem::new(&self.source, message.into(), labels, help))
    }

    /// Notes a problem, which may lie in another file. What several motors share is read for each: once is enough.
    pub(super) fn note_problem(&self, problem: Problem) -> Noted {
        let mut problems = self.problems.borrow_mut();
        if problems.len() == MAX_PROBLEMS {
            self.count(1);
        } else if !problems.iter().any(|known| known.repeats(&problem)) {
            problems.push(problem);
        }
        Noted
    }

    /// Whether as many problems are known as are kept.
    fn is_full(&self) -> bool {
        self.problems() >= MAX_PROBLEMS
    }

    /// Counts problems that are not kept.
    fn count(&self, more: usize) {
        self.others.set(self.others.get() + more);
    }

    /// Notes how a table was read. What several motors share is read for each: once is enough.
    pub(super) fn note_table(&self, columns: TableColumns) {
        let mut tables = self.tables.borrow_mut();
        if !tables.contains(&columns) {
            tables.push(columns);
        }
    }

    /// How many problems have been noted.
    pub(super) fn problems(&self) -> usize {
        self.problems.borrow().len()
    }

    /// As [`Problem::point_at`], for the problems after the first `first` ones.
    pub(super) fn move_problems(
        &self,
        first: usize,
        moved: &[(Range<usize>, Range<usize>)],
        cause: Option<Range<usize>>,
    ) {
        for problem in self.problems.borrow_mut().iter_mut().skip(first) {
            problem.point_at(moved, cause.clone());
        }
    }

    /// The problems, and how many there are beyond them.
    pub(super) fn into_problems(self) -> (Vec<Problem>, usize) {
        (self.problems.into_inner(), self.others.get())
    }
}

/// A value of the file and its place.
#[derive(Clone)]
pub(super) struct Node<'a> {
    pub(super) reader: &'a Reader,
    /// What it is called in messages: its key.
    pub(super) key: &'a str,
    /// Where it is written.
    pub(super) at: Range<usize>,
    form: Content<'a>,
}

#[derive(Clone, Copy)]
enum Content<'a> {
    Value(&'a Value),
    Table(&'a dyn TableLike),
    Tables(&'a ArrayOfTables),
}

impl<'a> Content<'a> {
    fn of(value: &'a Value) -> Content<'a> {
        match value {
            Value::InlineTable(table) => Content::Table(table),
            value => Content::Value(value),
        }
    }
}

/// A table of the file.
#[derive(Clone)]
pub(super) struct Section<'a> {
    pub(super) reader: &'a Reader,
    /// What it is called in messages.
    pub(super) name: String,
    /// Where it is written.
    pub(super) at: Range<usize>,
    table: &'a dyn TableLike,
    /// Keys that are there under misspelt names, which were noted.
    misspelt: RefCell<Vec<String>>,
}

impl<'a> Section<'a> {
    /// The file's outermost table.
    pub(super) fn root(reader: &'a Reader, table: &'a dyn TableLike) -> Section<'a> {
        Section { reader, name: "the motion file".to_owned(), at: 0..0, table, misspelt: RefCell::default() }
    }

    /// Notes every key that is not among the `known`.
    pub(super) fn check_keys(&self, known: &[&str]) {
        for (key, _) in self.table.iter().filter(|(key, item)| !item.is_none() && !known.contains(key)) {
            // The names that are near are looked for as long as somebody reads them.
            if self.reader.is_full() {
                self.reader.count(1);
                continue;
            }
            let Some(node) = self.get(key) else { continue };
            let help = match nearest(node.key, known.iter().copied()) {
                Some(near) => {
                    self.misspelt.borrow_mut().push(near.to_owned());
                    format!("did you mean `{near}`?")
                }
                None => format!("known here: {}", known.join(", ")),
            };
            let message = format!("unknown key `{}` in {}", node.key, self.name);
            self.reader.note(self.key_span(node.key), "not known here", message, help);
        }
    }

    /// Everything in the table, in the file's order.
    pub(super) fn nodes(&self) -> Vec<Node<'a>> {
        self.table.iter().filter_map(|(key, _)| self.get(key)).collect()
    }

    /// The value of `key`, if the table has it.
    pub(super) fn get(&self, key: &str) -> Option<Node<'a>> {
        let (key, item) = self.table.get_key_value(key)?;
        let form = match item {
            Item::None => return None,
            Item::Value(value) => Content::of(value),
            Item::Table(table) => Content::Table(table),
            Item::ArrayOfTables(tables) => Content::Tables(tables),
        };
        // Tables that a dotted key or a deeper header implies have no place of their own.
        let at = item.span().filter(|span| !span.is_empty()).or_else(|| key.span()).unwrap_or_else(|| self.at.clone());
        Some(Node { reader: self.reader, key: key.get(), at, form })
    }

    /// The value of `key`; its absence is noted, with an example of what to write, unless it is there under a misspelt name.
    pub(super) fn need(&self, key: &str, example: &str) -> Read<Node<'a>> {
        self.get(key).ok_or_else(|| {
            if self.misspelt.borrow().iter().any(|misspelt| misspelt == key) {
                return Noted;
            }
            let message = format!("{} has no `{key}`", self.name);
            self.reader.note(self.at.clone(), format!("needs `{key}`"), message, format!("add, for example: {example}"))
        })
    }

    /// Where a key is written.
    pub(super) fn key_span(&self, key: &str) -> Range<usize> {
        self.table.get_key_value(key).and_then(|(key, _)| key.span()).unwrap_or_else(|| self.at.clone())
    }
}

impl<'a> Node<'a> {
    /// Notes a problem here.
    pub(super) fn note(&self, label: impl Into<String>, message: impl Into<String>, help: impl Into<String>) -> Noted {
        self.reader.note(self.at.clone(), label, message, help)
    }

    /// What it is in TOML, in words.
    fn form(&self) -> &'static str {
        match self.form {
            Content::Value(Value::String(_)) => "a text",
            Content::Value(Value::Float(number)) if !number.value().is_finite() => "not finite",
            Content::Value(Value::Integer(_) | Value::Float(_)) => "a bare number",
            Content::Value(Value::Boolean(_)) => "true or false",
            Content::Value(Value::Datetime(_)) => "a date",
            Content::Value(Value::Array(_)) | Content::Tables(_) => "a list",
            Content::Value(Value::InlineTable(_)) | Content::Table(_) => "a table",
        }
    }

    /// Notes that it is something else than was wanted.
    pub(super) fn wrong(&self, wanted: &str, example: &str) -> Noted {
        let message = format!("`{}` must be {wanted}, but is {}", self.key, self.form());
        self.note(self.form(), message, format!("write, for example: {example}"))
    }

    /// Notes that a machine's path breaks a limit.
    pub(super) fn note_path(
        &self,
        label: impl Into<String>,
        message: impl Into<String>,
        help: &str,
        path: BrokenPath,
    ) -> Noted {
        let labels = vec![(self.at.clone(), label.into())];
        let problem = Problem::new(&self.reader.source, message.into(), labels, Some(help.to_owned()));
        self.reader.note_problem(problem.of_path(path))
    }

    /// The text, if it is one.
    pub(super) fn as_text(&self) -> Option<&'a str> {
        match self.form {
            Content::Value(value) => value.as_str(),
            _ => None,
        }
    }

    /// The text; anything else is noted.
    pub(super) fn text(&self, example: &str) -> Read<&'a str> {
        self.as_text().ok_or_else(|| self.wrong("a text in quotes", example))
    }

    /// The table, if it is one.
    pub(super) fn section(&self, name: String, known: &[&str], example: &str) -> Read<Section<'a>> {
        let section = self.any_section(name, example)?;
        section.check_keys(known);
        Ok(section)
    }

    /// The table, whatever its keys.
    pub(super) fn any_section(&self, name: String, example: &str) -> Read<Section<'a>> {
        match self.form {
            Content::Table(table) => {
                Ok(Section { reader: self.reader, name, at: self.at.clone(), table, misspelt: RefCell::default() })
            }
            _ => Err(self.wrong("a table", example)),
        }
    }

    /// Whether it is a table.
    pub(super) fn is_table(&self) -> bool {
        matches!(self.form, Content::Table(_))
    }

    /// Whether it is a table that has `key`.
    pub(super) fn has(&self, key: &str) -> bool {
        matches!(self.form, Content::Table(table) if table.contains_key(key))
    }

    /// The members of a list of anything.
    pub(super) fn list(&self, example: &str) -> Read<Vec<Node<'a>>> {
        let member = |at: Option<Range<usize>>, form| Node {
            reader: self.reader,
            key: self.key,
            at: at.unwrap_or_else(|| self.at.clone()),
            form,
        };
        match self.form {
            Content::Value(Value::Array(array)) => {
                Ok(array.iter().map(|value| member(value.span(), Content::of(value))).collect())
            }
            Content::Tables(tables) => {
                Ok(tables.iter().map(|table| member(table.span(), Content::Table(table))).collect())
            }
            _ => Err(self.wrong("a list in brackets", example)),
        }
    }

    /// A whole number, if it is one; also as 1e9.
    pub(super) fn as_whole(&self) -> Option<i64> {
        let Content::Value(value) = self.form else { return None };
        // What an f64 near 2^63 comes to is cut to the range of i64.
        let of_float = |number: &f64| number.fract() == 0.0 && number.abs() < 9.3e18;
        value.as_integer().or_else(|| value.as_float().filter(of_float).map(|number| number as i64))
    }

    /// A whole number within `range`; anything else is noted.
    pub(super) fn whole(&self, range: RangeInclusive<i64>, example: &str) -> Read<i64> {
        let number = self.as_whole().ok_or_else(|| match self.as_number() {
            Some(number) => {
                let message = format!("`{}` must be a whole number, but is {number:?}", self.key);
                self.note("not whole", message, format!("write, for example: {example}"))
            }
            None => self.wrong("a whole number", example),
        })?;
        if range.contains(&number) {
            return Ok(number);
        }
        let (low, high) = (range.start(), range.end());
        let message = match *high {
            i64::MAX => format!("`{}` must be at least {low}, but is {number}", self.key),
            high => format!("`{}` must be from {low} to {high}, but is {number}", self.key),
        };
        Err(self.note("out of range", message, ""))
    }

    /// A bare number, if it is one.
    pub(super) fn as_number(&self) -> Option<f64> {
        match self.form {
            Content::Value(Value::Integer(number)) => Some(*number.value() as f64),
            Content::Value(Value::Float(number)) => Some(*number.value()).filter(|number| number.is_finite()),
            _ => None,
        }
    }

    /// A bare finite number; anything else is noted.
    pub(super) fn number(&self, example: &str) -> Read<f64> {
        self.as_number().ok_or_else(|| self.wrong("a number", example))
    }

    /// A number with its unit; anything else is noted.
    pub(super) fn quantity(&self, example: &str) -> Read<Quantity> {
        let write = format!("write, for example: {} = \"{example}\"", self.key);
        let bare = |number: &str| {
            let unit = example.split_once(' ').map_or(example, |(_, unit)| unit);
            let message = format!("`{}` is a bare number; it needs a unit", self.key);
            self.note("has no unit", message, format!("write, for example: {} = \"{number} {unit}\"", self.key))
        };
        let Some(text) = self.as_text() else {
            return Err(match self.as_number() {
                Some(number) => bare(&number.to_string()),
                None => self.wrong("a number with its unit, in quotes", &format!("{} = \"{example}\"", self.key)),
            });
        };
        Quantity::parse(text).map_err(|error| {
            let help = error.meant().map_or(write, |meant| format!("write {} = \"{meant}\"", self.key));
            match &error {
                QuantityError::UnknownUnit { unit, offset, .. } => {
                    let message = format!("`{}`: unknown unit \"{unit}\"", self.key);
                    self.reader.note(self.inside(*offset, unit.len()), "unknown unit", message, help)
                }
                QuantityError::Grouped { number, offset, .. } => {
                    let message = format!("`{}`: {error}", self.key);
                    self.reader.note(self.inside(*offset, number.len()), "not a number", message, help)
                }
                QuantityError::NoUnit { number } => bare(number),
                QuantityError::NoNumber { .. } | QuantityError::OutOfRange { .. } => {
                    self.note("not a quantity", format!("`{}`: {error}", self.key), help)
                }
            }
        })
    }

    /// Notes that a quantity is of the wrong kind.
    pub(super) fn wrong_kind(&self, wanted: Kind, found: &Quantity, example: &str) -> Noted {
        let message = format!("`{}` must be {wanted}, but this is {}", self.key, found.kind());
        let label = found.kind().to_string();
        let help = match self.as_text().and_then(|text| other_kind(text, wanted, found)) {
            Some(meant) => format!("did you mean {meant}?"),
            None => format!("write, for example: {} = \"{example}\"", self.key),
        };
        self.note(label, message, help)
    }

    /// A quantity of that kind, in its base's unit.
    pub(super) fn measure(&self, base: Base, per_seconds: u8, example: &str) -> Read<f64> {
        let quantity = self.quantity(example)?;
        if (quantity.base, quantity.per_seconds) != (base, per_seconds) {
            return Err(self.wrong_kind(Kind { base, per_seconds }, &quantity, example));
        }
        Ok(quantity.value)
    }

    /// A quantity of that kind that is greater than zero, in its base's unit.
    pub(super) fn positive(&self, base: Base, per_seconds: u8, example: &str) -> Read<f64> {
        let value = self.measure(base, per_seconds, example)?;
        self.above_zero(value)
    }

    /// `value`, which was read here, if it is more than zero.
    pub(super) fn above_zero(&self, value: f64) -> Read<f64> {
        if value > 0.0 {
            return Ok(value);
        }
        Err(self.note("not more than 0", format!("`{}` must be more than 0", self.key), ""))
    }

    /// A time of at least 0 s, exact if it is a decimal number.
    pub(super) fn time(&self, example: &str) -> Read<Time> {
        let quantity = self.quantity(example)?;
        let kind = Kind { base: Base::Time, per_seconds: 0 };
        let time = quantity.time().ok_or_else(|| self.wrong_kind(kind, &quantity, example))?;
        if quantity.value < 0.0 {
            return Err(self.note("before 0 s", format!("`{}` must not be negative", self.key), ""));
        }
        self.in_range(time)
    }

    /// How far something periodic is shifted: a time, or an angle or part of a turn, of which one is the period.
    pub(super) fn phase(&self, example: &str) -> Read<PhaseShift> {
        let quantity = self.quantity(example)?;
        match (quantity.base, quantity.per_seconds) {
            (Base::Turn, 0) => Ok(PhaseShift::Turns(quantity.value)),
            (Base::Time, 0) => self.time(example).map(PhaseShift::Time),
            _ => {
                let message = format!("`{}` must be an angle or a time, but this is {}", self.key, quantity.kind());
                let help = format!("write {0} = \"90 deg\", {0} = \"0.25 turn\" or {0} = \"100 ms\"", self.key);
                Err(self.note(quantity.kind().to_string(), message, help))
            }
        }
    }

    /// A time of more than 0 s.
    pub(super) fn duration(&self, example: &str) -> Read<Time> {
        let time = self.time(example)?;
        self.lasting(time)
    }

    /// `time`, which was read here, if it is more than 0 s.
    pub(super) fn lasting(&self, time: Time) -> Read<Time> {
        if time > Time::ZERO {
            return self.in_range(time);
        }
        Err(self.note("not more than 0 s", format!("`{}` must be more than 0 s", self.key), ""))
    }

    fn in_range(&self, time: Time) -> Read<Time> {
        if time.seconds() <= MAX_TIME_S {
            return Ok(time);
        }
        Err(self.note("too long", format!("`{}` is more than 2000 years", self.key), ""))
    }

    /// The period of a frequency of more than 0 Hz, with the frequency.
    pub(super) fn frequency(&self, example: &str) -> Read<(f64, Time)> {
        let quantity = self.quantity(example)?;
        if (quantity.base, quantity.per_seconds) != (Base::Cycle, 1) {
            return Err(self.wrong_kind(Kind { base: Base::Cycle, per_seconds: 1 }, &quantity, example));
        }
        match quantity.period() {
            Some(period) => Ok((quantity.value, self.lasting(period)?)),
            None => Err(self.note("not more than 0", format!("`{}` must be more than 0 Hz", self.key), "")),
        }
    }

    /// One of several words, whatever its case.
    pub(super) fn word<T: Copy>(&self, words: &[(&str, T)]) -> Read<T> {
        let names = || words.iter().map(|(name, _)| *name);
        let list = names().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(", ");
        let text = self.text(&list)?;
        if let Some((_, value)) = words.iter().find(|(name, _)| name.eq_ignore_ascii_case(text)) {
            return Ok(*value);
        }
        let help = nearest(text, names()).map_or(String::new(), |near| format!("did you mean \"{near}\"?"));
        Err(self.note("not one of them", format!("`{}` must be one of {list}", self.key), help))
    }

    /// The place of bytes `offset..offset + length` of the text that is written here.
    pub(super) fn inside(&self, offset: usize, length: usize) -> Range<usize> {
        let written = self.reader.source.text().get(self.at.clone()).unwrap_or_default();
        // Escapes make the text differ from what is written; then the whole must do.
        let start = self.as_text().filter(|text| offset <= text.len()).and_then(|text| written.find(text));
        match start {
            Some(start) => {
                let text = self.reader.source.text();
                let from = text.floor_char_boundary(self.at.start + start + offset);
                from..text.ceil_char_boundary((from + length.max(1)).min(self.at.end))
            }
            None => self.at.clone(),
        }
    }
}

/// What a quantity of another kind than the wanted one is probably meant for: 5 H are 5 h, 5 m of time are minutes, 30 rpm is 0.5 Hz.
fn other_kind(text: &str, wanted: Kind, found: &Quantity) -> Option<String> {
    let is_wanted = |quantity: &Quantity| quantity.kind() == wanted;
    let number = text.trim().trim_end_matches(|c: char| !(c.is_ascii_digit() || c == '.'));
    match (wanted, found.base) {
        (Kind { base: Base::Time, per_seconds: 0 }, Base::Length) if found.unit == "m" => {
            Some(format!("\"{number} min\", or \"{number} ms\""))
        }
        (Kind { base: Base::Cycle, per_seconds: 1 }, Base::Turn) if found.per_seconds == 1 => {
            Some(format!("\"{} Hz\"", found.value))
        }
        _ => {
            let lower = text.trim().to_lowercase();
            Quantity::parse(&lower)
                .ok()
                .filter(is_wanted)
                .filter(|_| lower != text.trim())
                .map(|_| format!("\"{lower}\""))
        }
    }
}
