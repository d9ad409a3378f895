//! A motion file whose values may be changed before it is read: for motions that are changed while they run.
//!
//! A changed file is read by the same reader as any other. A value that was changed has no place of its own in the text; problems with it point
//! at its key.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use toml_edit::{ArrayOfTables, Document, Item, Table, TableLike, Value};

use super::problem::FileError;
use super::source::Source;
use super::{Contents, NEW, contents_of, read_with, syntax};
use crate::boards::{self, BoardProfile};
use crate::quantity::{Quantity, nearest};

/// A motion file, parsed, whose parameters and cues can be set.
#[derive(Clone, Debug)]
pub struct Sheet {
    source: Arc<Source>,
    table: Table,
    /// Whether anything was changed: then knobs and cues are known, and are not read again.
    is_changed: bool,
    /// The boards that the file may name.
    boards: Cow<'static, [&'static BoardProfile]>,
}

/// A number in a motor's law, by its name.
#[derive(Clone, Debug, PartialEq)]
pub struct SheetParameter {
    /// MOTOR.KEY, where MOTOR may also be a machine. If the motor's laws have the key several times, a number follows, from 1: `wheel.period.2`.
    pub name: String,
    /// What is written.
    pub value: ParameterValue,
    place: SheetPlace,
}

/// The value of a parameter, as it is written.
#[derive(Clone, Debug, PartialEq)]
pub enum ParameterValue {
    /// A whole number without a unit.
    Whole(i64),
    /// A number without a unit.
    Number(f64),
    /// A number with its unit.
    Quantity(String),
}

impl ParameterValue {
    /// The number and the unit, as they are written; the unit of a bare number is empty.
    #[must_use]
    pub fn parts(&self) -> (f64, &str) {
        match self {
            ParameterValue::Whole(number) => (*number as f64, ""),
            ParameterValue::Number(number) => (*number, ""),
            ParameterValue::Quantity(text) => Quantity::parts(text).unwrap_or((f64::NAN, "")),
        }
    }

    fn of(value: &Value) -> Option<ParameterValue> {
        match value {
            Value::Integer(number) => Some(ParameterValue::Whole(*number.value())),
            Value::Float(number) => Some(ParameterValue::Number(*number.value())),
            Value::String(text) => {
                let text = text.value();
                Quantity::parse(text).is_ok().then(|| ParameterValue::Quantity(text.clone()))
            }
            _ => None,
        }
    }

    fn value(&self) -> Value {
        match self {
            ParameterValue::Whole(number) => (*number).into(),
            ParameterValue::Number(number) => (*number).into(),
            ParameterValue::Quantity(text) => text.as_str().into(),
        }
    }
}

/// The way to a parameter from the file's root.
#[derive(Clone, Debug, PartialEq)]
struct SheetPlace {
    /// Which `[[motion]]`.
    row: usize,
    /// The motor or machine.
    owner: String,
    /// From there on.
    way: Vec<Step>,
}

#[derive(Clone, Debug, PartialEq)]
enum Step {
    Key(String),
    Index(usize),
}

/// A motion file has no parameter of that name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no `{name}`")]
pub struct UnknownParameter {
    /// The name.
    pub name: String,
    /// A name that is there, and may be meant.
    pub meant: Option<String>,
}

/// Keys of laws whose texts are never quantities, even if they look so.
const TEXTS: [&str; 5] = ["theta", "unit", "file", "axis", "commands"];

impl Sheet {
    /// Parses a motion file, whose text `read` gives.
    ///
    /// # Errors
    /// [`FileError`] if it cannot be read, or is no TOML.
    pub fn open(path: &Path, read: super::ReadText<'_>) -> Result<Sheet, FileError> {
        let (name, text) = super::open(path, read)?;
        Sheet::parse(&text, &name)
    }

    /// Parses a motion file's text; `name` is what messages call it. Nothing but its syntax is checked.
    ///
    /// ```
    /// use pulsetrain_motion::file::{ParameterValue, Sheet};
    /// let text = "[[motion]]\nmotor = \"wheel\"\nlaw.sine = { amplitude = \"2 rev\", period = \"1 s\" }";
    /// let sheet = Sheet::parse(text, "my.toml").map_err(|error| error.plain())?;
    /// let names: Vec<String> = sheet.parameters().into_iter().map(|parameter| parameter.name).collect();
    /// assert_eq!(names, ["wheel.amplitude", "wheel.period"]);
    /// let wider = sheet.with("wheel.amplitude", &ParameterValue::Quantity("3 rev".into()))?;
    /// assert_eq!(wider.parameters()[0].value.parts(), (3.0, "rev"));
    /// assert_eq!(sheet.with("wheel.amplitud", &ParameterValue::Whole(1)).unwrap_err().meant.as_deref(), Some("wheel.amplitude"));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`FileError`] if it is no TOML, or empty.
    pub fn parse(text: &str, name: &str) -> Result<Sheet, FileError> {
        // A byte order mark is no part of the text, and would shift every place.
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let source = Arc::new(Source::new(name, text));
        match Document::parse(text) {
            Ok(document) if document.as_table().is_empty() => {
                Err(FileError::whole(&source, format!("{name} is empty"), Some(NEW.to_owned())))
            }
            Ok(document) => {
                let boards = Cow::Borrowed(boards::BUILT_IN);
                Ok(Sheet { table: document.into_table(), source, is_changed: false, boards })
            }
            Err(error) => read_with(&source, &Table::new(), |root| Err(syntax::note(root.reader, text, &error))),
        }
    }

    /// The file for these boards instead of [this project's](boards::BUILT_IN): a program may have boards of its own.
    #[must_use]
    pub fn with_boards(self, boards: Vec<&'static BoardProfile>) -> Sheet {
        Sheet { boards: Cow::Owned(boards), ..self }
    }

    /// The file's outermost table.
    pub(super) fn table(&self) -> &Table {
        &self.table
    }

    /// The text that was parsed.
    #[must_use]
    pub fn source(&self) -> &Arc<Source> {
        &self.source
    }

    /// Reads the file as it is now; `load` gives the text of the files that it names. Knobs and cues are those of the unchanged file: a changed one
    /// gives none.
    ///
    /// # Errors
    /// [`FileError`] with every problem found.
    pub fn contents(&self, load: &dyn Fn(&Path) -> io::Result<String>) -> Result<Contents, FileError> {
        if !self.is_changed {
            return read_with(&self.source, &self.table, |root| contents_of(root, &self.table, load, &self.boards));
        }
        let mut table = self.table.clone();
        table.remove("live");
        table.remove("cue");
        read_with(&self.source, &table, |root| contents_of(root, &table, load, &self.boards))
    }

    /// Every number in the motors' laws, in the file's order.
    #[must_use]
    pub fn parameters(&self) -> Vec<SheetParameter> {
        parameters(&self.table)
    }

    /// The parameter of that name.
    ///
    /// # Errors
    /// If there is none.
    pub fn parameter(&self, name: &str) -> Result<SheetParameter, UnknownParameter> {
        parameter(&self.table, name)
    }

    /// The file with another value of a parameter.
    ///
    /// # Errors
    /// If there is no such parameter.
    pub fn with(&self, name: &str, value: &ParameterValue) -> Result<Sheet, UnknownParameter> {
        let mut table = self.table.clone();
        set(&mut table, name, value)?;
        Ok(Sheet { source: Arc::clone(&self.source), table, is_changed: true, boards: self.boards.clone() })
    }

    /// The file with the motions of a cue in the place of those of the same motors.
    #[must_use]
    pub fn with_cue(&self, number: usize) -> Sheet {
        let mut table = self.table.clone();
        let rows = cue_motions(&table, number);
        replace_motions(&mut table, rows);
        Sheet { source: Arc::clone(&self.source), table, is_changed: true, boards: self.boards.clone() }
    }
}

/// Every number in the motors' laws.
pub(super) fn parameters(root: &Table) -> Vec<SheetParameter> {
    let mut found: Vec<(String, String, ParameterValue, SheetPlace)> = Vec::new();
    for (row, motion) in rows(root.get("motion")).into_iter().enumerate() {
        let Some(law) = motion.get("law").or_else(|| motion.get("path")) else { continue };
        let key = if motion.contains_key("law") { "law" } else { "path" };
        for owner in owners(motion) {
            let mut walk = Walk { row, owner: &owner, way: vec![Step::Key(key.to_owned())], found: &mut found };
            walk.item(key, law);
        }
    }
    let names: Vec<String> = found.iter().map(|(owner, key, ..)| format!("{owner}.{key}")).collect();
    // How many there are of a name, and how many were numbered.
    let mut counts: BTreeMap<&str, (usize, usize)> = BTreeMap::new();
    for name in &names {
        counts.entry(name).or_default().0 += 1;
    }
    let numbered = found.into_iter().zip(&names).map(|((_, _, value, place), name)| {
        let (count, before) = counts.entry(name).or_default();
        *before += 1;
        let name = if *count == 1 { name.clone() } else { format!("{name}.{before}") };
        SheetParameter { name, value, place }
    });
    numbered.collect()
}

/// The parameter of that name.
pub(super) fn parameter(root: &Table, name: &str) -> Result<SheetParameter, UnknownParameter> {
    let parameters = parameters(root);
    match parameters.iter().find(|parameter| parameter.name == name) {
        Some(parameter) => Ok(parameter.clone()),
        None => {
            let meant = nearest(name, parameters.iter().map(|parameter| parameter.name.as_str()));
            Err(UnknownParameter { name: name.to_owned(), meant: meant.map(str::to_owned) })
        }
    }
}

/// Where the key of a parameter is written, bytes.
pub(super) fn key_span(root: &Table, name: &str) -> Option<Range<usize>> {
    let SheetPlace { row, way, .. } = parameter(root, name).ok()?.place;
    let (last, before) = way.split_last()?;
    let mut here = Inside::Table(rows(root.get("motion")).into_iter().nth(row)?);
    for step in before {
        here = here.step(step)?;
    }
    match (here, last) {
        (Inside::Table(table), Step::Key(key)) => table.get_key_value(key)?.0.span(),
        _ => None,
    }
}

/// A part of a law on the way to a parameter.
enum Inside<'a> {
    Table(&'a dyn TableLike),
    Tables(&'a ArrayOfTables),
    List(&'a toml_edit::Array),
}

impl<'a> Inside<'a> {
    fn step(self, step: &Step) -> Option<Inside<'a>> {
        match (self, step) {
            (Inside::Table(table), Step::Key(key)) => match table.get(key)? {
                Item::ArrayOfTables(tables) => Some(Inside::Tables(tables)),
                Item::Value(Value::Array(list)) => Some(Inside::List(list)),
                item => item.as_table_like().map(Inside::Table),
            },
            (Inside::Tables(tables), Step::Index(index)) => Some(Inside::Table(tables.get(*index)?)),
            (Inside::List(list), Step::Index(index)) => Some(Inside::Table(list.get(*index)?.as_inline_table()?)),
            _ => None,
        }
    }
}

/// Gives a parameter another value.
pub(super) fn set(root: &mut Table, name: &str, value: &ParameterValue) -> Result<(), UnknownParameter> {
    let SheetParameter { place: SheetPlace { mut row, owner, way }, .. } = parameter(root, name)?;
    let unknown = || UnknownParameter { name: name.to_owned(), meant: None };
    // A motion of several motors becomes one of each, so that the others keep theirs.
    if let Some(motions) = motions_mut(root)
        && let Some(shared) = motions.get(row).filter(|motion| motion.contains_key("motors"))
    {
        let (shared, motors) = (shared.clone(), owners(shared));
        motions.remove(row);
        for (offset, motor) in motors.iter().enumerate() {
            let mut own = shared.clone();
            own.remove("motors");
            own.insert("motor", Item::Value(motor.as_str().into()));
            motions.insert(row + offset, own);
        }
        row += motors.iter().position(|motor| *motor == owner).unwrap_or_default();
    }
    let motions = motions_mut(root).ok_or_else(unknown)?;
    let mut here: &mut dyn TableLike = motions.get_mut(row).ok_or_else(unknown)?;
    let (last, before) = way.split_last().ok_or_else(unknown)?;
    let mut steps = before.iter();
    while let Some(step) = steps.next() {
        let Step::Key(key) = step else { return Err(unknown()) };
        let item = here.get_mut(key).ok_or_else(unknown)?;
        let mut indices = Vec::new();
        while let [Step::Index(index), ..] = steps.as_slice() {
            indices.push(*index);
            steps.next();
        }
        here = match indices.as_slice() {
            [] => item.as_table_like_mut().ok_or_else(unknown)?,
            [index] => match item {
                Item::ArrayOfTables(tables) => tables.get_mut(*index).ok_or_else(unknown)?,
                item => {
                    let member = item.as_array_mut().and_then(|array| array.get_mut(*index));
                    member.and_then(Value::as_inline_table_mut).ok_or_else(unknown)?
                }
            },
            _ => return Err(unknown()),
        };
    }
    let Step::Key(key) = last else { return Err(unknown()) };
    *here.get_mut(key).ok_or_else(unknown)? = Item::Value(value.value());
    Ok(())
}

/// The motions of a cue.
pub(super) fn cue_motions(root: &Table, number: usize) -> Vec<Table> {
    let cue = rows(root.get("cue")).into_iter().nth(number);
    cue.map(|cue| owned_rows(cue.get("motion"))).unwrap_or_default()
}

/// Puts motions in the place of those of the same motors and machines.
pub(super) fn replace_motions(root: &mut Table, new: Vec<Table>) {
    let named: Vec<String> = new.iter().flat_map(|row| owners(row)).collect();
    let mut kept: Vec<Table> = Vec::new();
    for mut motion in owned_rows(root.get("motion")) {
        let all = owners(&motion);
        let left: Vec<&String> = all.iter().filter(|owner| !named.contains(owner)).collect();
        if left.is_empty() {
            continue;
        }
        if left.len() < all.len() {
            let left = left.into_iter().map(|name| Value::from(name.as_str()));
            motion.insert("motors", Item::Value(Value::Array(left.collect())));
        }
        kept.push(motion);
    }
    let mut motions = ArrayOfTables::new();
    kept.into_iter().chain(new).for_each(|motion| motions.push(motion));
    match root.get_mut("motion") {
        Some(item) => *item = Item::ArrayOfTables(motions),
        None => drop(root.insert("motion", Item::ArrayOfTables(motions))),
    }
}

/// The tables of a list, or the one table in its place.
fn rows(item: Option<&Item>) -> Vec<&dyn TableLike> {
    match item {
        Some(Item::ArrayOfTables(tables)) => tables.iter().map(|table| table as &dyn TableLike).collect(),
        Some(Item::Value(Value::Array(array))) => {
            array.iter().filter_map(Value::as_inline_table).map(|table| table as &dyn TableLike).collect()
        }
        Some(item) => item.as_table_like().into_iter().collect(),
        None => Vec::new(),
    }
}

fn owned_rows(item: Option<&Item>) -> Vec<Table> {
    let Some(item) = item else { return Vec::new() };
    match item.clone() {
        Item::Table(table) => vec![table],
        Item::Value(Value::InlineTable(table)) => vec![table.into_table()],
        other => other.into_array_of_tables().map(|tables| tables.into_iter().collect()).unwrap_or_default(),
    }
}

/// The file's motions, as a list whatever they were written as.
fn motions_mut(root: &mut Table) -> Option<&mut ArrayOfTables> {
    let item = root.get_mut("motion")?;
    if !item.is_array_of_tables() {
        let mut motions = ArrayOfTables::new();
        owned_rows(Some(item)).into_iter().for_each(|motion| motions.push(motion));
        *item = Item::ArrayOfTables(motions);
    }
    item.as_array_of_tables_mut()
}

/// The motors, or the machine, of a motion.
pub(super) fn owners(motion: &dyn TableLike) -> Vec<String> {
    let named = |key: &str| motion.get(key).and_then(Item::as_str).map(str::to_owned);
    if let Some(motors) = motion.get("motors").and_then(Item::as_array) {
        return motors.iter().filter_map(Value::as_str).map(str::to_owned).collect();
    }
    named("motor").or_else(|| named("machine")).into_iter().collect()
}

/// A walk through a law.
struct Walk<'a> {
    row: usize,
    owner: &'a str,
    way: Vec<Step>,
    found: &'a mut Vec<(String, String, ParameterValue, SheetPlace)>,
}

impl Walk<'_> {
    fn item(&mut self, key: &str, item: &Item) {
        match item {
            Item::Value(value) => self.value(key, value),
            Item::Table(table) => self.table(table),
            Item::ArrayOfTables(tables) => {
                for (index, table) in tables.iter().enumerate() {
                    self.way.push(Step::Index(index));
                    self.table(table);
                    self.way.pop();
                }
            }
            Item::None => {}
        }
    }

    fn table(&mut self, table: &dyn TableLike) {
        for (key, item) in table.iter().filter(|(key, _)| !TEXTS.contains(key)) {
            self.way.push(Step::Key(key.to_owned()));
            self.item(key, item);
            self.way.pop();
        }
    }

    fn value(&mut self, key: &str, value: &Value) {
        match value {
            Value::InlineTable(table) => self.table(table),
            Value::Array(array) => {
                for (index, member) in array.iter().enumerate() {
                    let Value::InlineTable(table) = member else { continue };
                    self.way.push(Step::Index(index));
                    self.table(table);
                    self.way.pop();
                }
            }
            value => {
                let Some(value) = ParameterValue::of(value) else { return };
                let place = SheetPlace { row: self.row, owner: self.owner.to_owned(), way: self.way.clone() };
                self.found.push((self.owner.to_owned(), key.to_owned(), value, place));
            }
        }
    }
}
