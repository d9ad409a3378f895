//! CSV files of times and positions.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use miette::NamedSource;

use super::laws::{Context, load, position_unit, time_unit};
use super::problem::Problem;
use super::reader::{Node, Noted, Read, Section};
use crate::columns::{Found, Header, Measure, POSITIONS, ReadError, Role, Row, Stated, TIME, Table, shown};
use crate::quantity::{Base, Quantity};

/// The keys of a table, of laws as of paths.
pub(super) const KEYS: &[&str] = &["file", "time", "unit", "columns", "interpolation"];

/// How the columns of a CSV file were read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TableColumns {
    /// As the motion file calls it.
    pub file: String,
    /// Time first.
    pub columns: Vec<ColumnUse>,
    /// The others.
    pub unused: Vec<String>,
}

/// How one column was read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ColumnUse {
    /// "time", "angle", "position", "x".
    pub what: String,
    /// "column 2 `t`"
    pub column: String,
    /// As it is written.
    pub unit: String,
    /// Nothing but its place says what it is.
    pub by_place: bool,
}

/// `path.csv: time = column 2 `t`, s; angle = column 3 `a`, deg; column 1 `i` is not used`
impl fmt::Display for TableColumns {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.file)?;
        for (k, ColumnUse { what, column, unit, by_place }) in self.columns.iter().enumerate() {
            let comma = if k > 0 { "; " } else { "" };
            write!(f, "{comma}{what} = {column}{}, {unit}", if *by_place { " (by its place)" } else { "" })?;
        }
        match self.unused.as_slice() {
            [] => Ok(()),
            [one] => write!(f, "; {one} is not used"),
            several => write!(f, "; {} are not used", several.join(", ")),
        }
    }
}

/// A column as a motion file chooses it.
enum Choice {
    /// From 0.
    Number(usize),
    /// By the header.
    Name(String),
}

/// `columns = [1, 2]`, counted from 1, or `columns = ["time", "angle"]`, by the header; of a time and so many positions.
fn choices(node: &Node, positions: usize) -> Read<Vec<Choice>> {
    let (example, wanted) = match positions {
        1 => ("columns = [1, 2], or [\"time\", \"angle\"] by the header", "two: time and position"),
        2 => ("columns = [1, 2, 3], or [\"time\", \"x\", \"y\"] by the header", "three: time, x and y"),
        _ => ("columns = [1, 2, 3, 4], or [\"time\", \"x\", \"y\", \"z\"] by the header", "four: time, x, y and z"),
    };
    let list = node.list(example)?;
    if list.len() != positions + 1 {
        return Err(node.note("not as many", format!("`columns` must list {wanted}"), example));
    }
    let choice = |node: &Node| match node.as_text() {
        Some(name) => Ok(Choice::Name(name.to_lowercase())),
        // Within 1..=1000, so it fits.
        None => node.whole(1..=1000, example).map(|n| Choice::Number(n as usize - 1)),
    };
    list.iter().map(choice).collect()
}

/// Rows of a CSV file.
pub(super) struct Points {
    /// Time, s, from the first row on, and positions, steps.
    pub(super) rows: Vec<(f64, Vec<f64>)>,
    /// Where each row is written.
    places: Vec<Range<usize>>,
    source: Arc<NamedSource<String>>,
}

impl Points {
    /// Notes a problem with a row.
    pub(super) fn wrong(&self, file: &Node, row: usize, label: &str, message: String, help: &str) -> Noted {
        let labels = vec![(self.places.get(row).cloned().unwrap_or(0..0), label.to_owned())];
        file.reader.note_problem(Problem::new(&self.source, message, labels, Some(help.to_owned())))
    }
}

/// A file that is being read, and what the motion file says of it.
struct Reading<'a> {
    file: Node<'a>,
    source: Arc<NamedSource<String>>,
    time: Option<(Node<'a>, f64)>,
    unit: Option<(Node<'a>, Quantity)>,
    choices: Option<(Node<'a>, Vec<Choice>)>,
}

/// Reads the file of a table: times and the positions of `contexts`; the first time becomes 0 s.
pub(super) fn read<'a>(p: &Section<'a>, contexts: &[Context]) -> Read<Points> {
    let file = p.need("file", "file = \"path.csv\"")?;
    let choices = p.get("columns").map(|node| Ok((node.clone(), choices(&node, contexts.len())?))).transpose();
    let time = p.get("time").map(|node| Ok((node.clone(), time_unit(&node)?))).transpose();
    let unit = p.get("unit").map(|node| Ok((node.clone(), position_unit(&node)?))).transpose();
    let text = load(&file, contexts[0].load)?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text).to_owned();
    let source = Arc::new(NamedSource::new(file.as_text().unwrap_or_default(), text));
    Reading { file, source, time: time?, unit: unit?, choices: choices? }.points(p, contexts)
}

impl<'a> Reading<'a> {
    fn points(&self, p: &Section<'a>, contexts: &[Context]) -> Read<Points> {
        let mut table = Table::new(self.source.inner().as_bytes());
        let header = table.header().map_err(|error| self.note(&error, ""))?;
        let positions = contexts.iter().enumerate().map(|(k, context)| role(context, k, contexts.len()));
        let roles: Vec<Role<'_>> = [TIME].into_iter().chain(positions).collect();
        let found = self.columns(&header, &roles)?;
        let (seconds, time_unit) = self.seconds(&header, &roles, found[0].column)?;
        let mut scales = Vec::new();
        let mut columns = vec![self.used("time".to_owned(), &header, found[0], time_unit)];
        for ((context, role), found) in contexts.iter().zip(&roles[1..]).zip(&found[1..]) {
            let (one, node, unit) = self.position(p, &header, &roles, role, found.column)?;
            scales.push(context.steps_in(&node, &one)?);
            let what = match (contexts.len(), one.base) {
                (1, Base::Turn) => "angle",
                (1, _) => "position",
                _ => role.what,
            };
            columns.push(self.used(what.to_owned(), &header, *found, unit));
        }
        let mut points = Points { rows: Vec::new(), places: Vec::new(), source: Arc::clone(&self.source) };
        while let Some(row) = table.next().map_err(|error| self.note(&error, ""))? {
            self.row(&row, &header, &found, (seconds, &scales), &mut points)?;
        }
        let rows = &mut points.rows;
        if rows.len() < 2 {
            let message = format!("a table needs two points at least, but has {}", rows.len());
            return Err(self.problem(0..0, "too short", message, ""));
        }
        let zero = rows[0].0;
        rows.iter_mut().for_each(|row| row.0 -= zero);
        let unused = (0..header.titles.len()).filter(|column| found.iter().all(|found| found.column != *column));
        let unused = unused.map(|column| header.called(column)).collect();
        let file = self.source.name().to_owned();
        self.file.reader.told(TableColumns { file, columns, unused });
        Ok(points)
    }

    /// Reads one row.
    fn row(
        &self,
        row: &Row<'_>,
        header: &Header<'_>,
        found: &[Found],
        (seconds, scales): (f64, &[f64]),
        points: &mut Points,
    ) -> Read<()> {
        let number = |found: &Found| {
            row.number(found.column, "a number").map_err(|error| {
                let found = format!("{} in {}", error.found, header.called(found.column));
                self.note(&ReadError { found, ..error }, "")
            })
        };
        let values = found.iter().map(number).collect::<Read<Vec<f64>>>()?;
        let Some((time, positions)) = values.split_first() else { return Ok(()) };
        if let Some(before) = points.rows.last().map(|before| before.0).filter(|before| *before >= time * seconds) {
            let column = header.called(found[0].column);
            let message =
                format!("times must increase from line to line, but {column} has {time} after {}", before / seconds);
            let is_guess = found[0].by_place && found.len() == 2;
            let help = if is_guess { offered(header, &[found[1].column, found[0].column]) } else { String::new() };
            return Err(self.problem(row.place(found[0].column), "not later than the line before", message, &help));
        }
        points
            .rows
            .push((time * seconds, positions.iter().zip(scales).map(|(position, steps)| position * steps).collect()));
        points.places.push(row.at());
        Ok(())
    }

    /// Which columns hold what: as the motion file says, else as the header does.
    fn columns(&self, header: &Header<'_>, roles: &[Role<'_>]) -> Read<Vec<Found>> {
        let Some((node, choices)) = &self.choices else {
            return header.find(roles).map_err(|error| self.note(&error, &offered(header, &header.likely(roles))));
        };
        let column = |choice: &Choice| match choice {
            Choice::Number(column) => Ok(*column),
            Choice::Name(name) => header.column(name).map_err(|error| self.note(&error, "")),
        };
        let columns = choices.iter().map(column).collect::<Read<Vec<usize>>>()?;
        let found = columns.iter().map(|&column| Found { column, by_place: false }).collect::<Vec<_>>();
        let is_named = |column: usize, names: &[&str]| {
            header.titles.get(column).is_some_and(|title| names.iter().any(|name| title.is_called(name)))
        };
        // Whoever writes names has read them.
        let counted = choices.iter().all(|choice| matches!(choice, Choice::Number(_)));
        let swapped = columns[1..].iter().position(|column| is_named(*column, TIME.names));
        let right = header.likely(roles);
        if let Some(k) = swapped.filter(|_| counted && right != columns) {
            let place = self.place(node);
            let named = &header.titles[columns[k + 1]];
            let time = match header.titles.get(columns[0]).map(|title| title.text.as_bytes()) {
                None | Some([]) => header.called(columns[0]),
                Some(text) => shown(text),
            };
            let named_time = shown(named.text.as_bytes());
            let message =
                format!("`columns` ({place}) makes {time} the time, but the header says that {named_time} is the time");
            return Err(self.problem(named.at.clone(), "the time", message, &offered(header, &right)));
        }
        Ok(found)
    }

    /// Seconds in the unit of times, and the unit.
    fn seconds(&self, header: &Header<'_>, roles: &[Role<'_>], column: usize) -> Read<(f64, String)> {
        match (self.stated(header, roles, column, Measure::Time, self.time.is_some())?, &self.time) {
            (Some((text, one)), Some((node, seconds))) if one.value != *seconds => {
                Err(self.contradiction(header, column, node, one.unit, &text))
            }
            (Some((text, one)), _) => Ok((one.value, text)),
            (None, Some((node, seconds))) => Ok((*seconds, node.as_text().unwrap_or_default().to_owned())),
            (None, None) => Ok((1.0, "s".to_owned())),
        }
    }

    /// One of the unit of a column of positions, where that is said, and the unit's name.
    fn position(
        &self,
        p: &Section<'a>,
        header: &Header<'_>,
        roles: &[Role<'_>],
        role: &Role<'_>,
        column: usize,
    ) -> Read<(Quantity, Node<'a>, String)> {
        match (self.stated(header, roles, column, role.measure, self.unit.is_some())?, &self.unit) {
            (Some((text, one)), Some((node, wanted))) => {
                if (one.base, one.value) != (wanted.base, wanted.value) {
                    return Err(self.contradiction(header, column, node, one.unit, &text));
                }
                Ok((one, node.clone(), text))
            }
            (Some((text, one)), None) => {
                let mut node = self.file.clone();
                node.key = "unit";
                Ok((one, node, text))
            }
            (None, _) => {
                let node = p.need("unit", "unit = \"deg\"")?;
                let text = node.as_text().unwrap_or_default().trim().to_owned();
                Ok((position_unit(&node)?, node, text))
            }
        }
    }

    /// The unit that the header gives a column; an unknown one may be given by the motion file, which has then to name the columns.
    fn stated(
        &self,
        header: &Header<'_>,
        roles: &[Role<'_>],
        column: usize,
        measure: Measure,
        is_given: bool,
    ) -> Read<Option<(String, Quantity)>> {
        match header.titles.get(column).map(|title| &title.unit) {
            None | Some(Stated::Nothing) => Ok(None),
            Some(Stated::Unit(unit)) if measure.fits(unit) => Ok(Some((unit.text.clone(), unit.one))),
            Some(Stated::Unknown(_)) if is_given && self.choices.is_some() => Ok(None),
            stated => {
                let help = offered(header, &header.likely(roles));
                let help = if is_given && matches!(stated, Some(Stated::Unknown(_))) { help } else { String::new() };
                Err(self.note(&header.error_in(column, measure.units()), &help))
            }
        }
    }

    /// Notes that the header gives another unit than the motion file.
    fn contradiction(&self, header: &Header<'_>, column: usize, node: &Node, unit: &str, text: &str) -> Noted {
        let (key, place) = (node.key, self.place(node));
        let wanted = node.as_text().unwrap_or_default();
        let message = format!("{} is in {text}, but {place} says {key} = \"{wanted}\"", header.called(column));
        let at = header.titles.get(column).map_or(0..0, |title| title.at.clone());
        let help = format!("if the header is right, write: {key} = \"{unit}\"");
        self.problem(at, "another unit", message, &help)
    }

    fn used(&self, what: String, header: &Header<'_>, found: Found, unit: String) -> ColumnUse {
        // Without a header there is nothing else to go by.
        let by_place = found.by_place && header.is_there();
        ColumnUse { what, column: header.called(found.column), unit, by_place }
    }

    /// Where a value of the motion file is written.
    fn place(&self, node: &Node) -> String {
        let source = &node.reader.source;
        let (line, column) = Problem::new(source, String::new(), vec![(node.at.clone(), String::new())], None).place();
        format!("{}:{line}:{column}", source.name())
    }

    fn note(&self, error: &ReadError, help: &str) -> Noted {
        let message = format!("expected {}, found {}", error.expected, error.found);
        let help = if help.is_empty() { error.help } else { help };
        self.problem(error.at.clone(), "here", message, help)
    }

    fn problem(&self, at: Range<usize>, label: &str, message: String, help: &str) -> Noted {
        let help = Some(help.to_owned()).filter(|help| !help.is_empty());
        self.file.reader.note_problem(Problem::new(&self.source, message, vec![(at, label.to_owned())], help))
    }
}

/// What the position of a motor is called, or a coordinate of a path: one of `count`.
fn role<'a>(context: &'a Context<'_>, k: usize, count: usize) -> Role<'a> {
    let (what, names, example): (_, &[&str], _) = match (count, k) {
        (1, _) => ("the position", POSITIONS, "angle [deg]"),
        (_, 0) => ("x", &["x"], "x [mm]"),
        (_, 1) => ("y", &["y"], "y [mm]"),
        _ => ("z", &["z"], "z [mm]"),
    };
    Role { what, own: Some(context.motor), names, measure: Measure::Position, example }
}

/// The help that names columns, time first, if they are known.
fn offered(header: &Header<'_>, columns: &[usize]) -> String {
    let Some(time) = columns.first() else { return String::new() };
    let numbers: Vec<String> = columns.iter().map(|column| (column + 1).to_string()).collect();
    format!("if {} is the time, write: columns = [{}]", header.called(*time), numbers.join(", "))
}
