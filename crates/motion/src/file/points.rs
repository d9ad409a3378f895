//! CSV files of times and positions.

use std::ops::Range;
use std::sync::Arc;

use super::context::{Context, load, position_unit, time_unit};
use super::problem::Problem;
use super::reader::{Node, Noted, Read, Section};
use super::source::Source;
use super::table_columns::{ColumnUse, TableColumns};
use crate::columns::{
    CsvTable, Header, POINT, POSITIONS, ReadError, Role, Row, Stated, TIME, has_decimal_comma, shown,
};
use crate::quantity::{Base, Quantity, nearest};

/// The keys of a table, of laws as of paths.
pub(super) const KEYS: &[&str] = &["file", "time", "unit", "columns", "interpolation"];

/// A column as a motion file chooses it.
enum Choice {
    /// From 0.
    Number(usize),
    /// By the header.
    Name(String),
}

/// The key `columns`: `[1, 2]` counts from 1, `["time", "angle"]` names titles in the header. It selects a time and
/// `positions` positions.
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
        Some(name) => Ok(Choice::Name(name.to_owned())),
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
    source: Arc<Source>,
}

impl Points {
    /// Notes a problem with a row.
    pub(super) fn wrong(&self, file: &Node, row: usize, label: &str, message: String, help: &str) -> Noted {
        let labels = vec![(self.places.get(row).cloned().unwrap_or(0..0), label.to_owned())];
        file.reader.note_problem(Problem::new(&self.source, message, labels, Some(help.to_owned())))
    }
}

/// A file that is being read, and what the motion file says of it.
struct TableReader<'a> {
    file: Node<'a>,
    source: Arc<Source>,
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
    let source = Arc::new(Source::new(file.as_text().unwrap_or_default(), text));
    TableReader { file, source, time: time?, unit: unit?, choices: choices? }.points(p, contexts)
}

impl<'a> TableReader<'a> {
    fn points(&self, p: &Section<'a>, contexts: &[Context]) -> Read<Points> {
        let mut table = CsvTable::new(self.source.text().as_bytes());
        let header = table.header().map_err(|error| self.note(&error, ""))?;
        let positions = contexts.iter().enumerate().map(|(k, context)| role(context, k, contexts.len()));
        let roles: Vec<Role<'_>> = [TIME].into_iter().chain(positions).collect();
        let found = self.columns(&header, &roles)?;
        let (seconds, time_unit) = self.seconds(&header, &roles, found[0])?;
        let mut scales = Vec::new();
        let used = |what: &str, column, unit| ColumnUse { what: what.to_owned(), column: header.called(column), unit };
        let mut columns = vec![used("time", found[0], time_unit)];
        for (k, (context, column)) in contexts.iter().zip(&found[1..]).enumerate() {
            let (one, node, unit) = self.position(p, &header, &roles, (k + 1, *column))?;
            scales.push(context.steps_in(&node, &one)?);
            let what = match (contexts.len(), one.base) {
                (1, Base::Turn) => "angle",
                (1, _) => "position",
                _ => roles[k + 1].what,
            };
            columns.push(used(what, *column, unit));
        }
        let mut points = Points { rows: Vec::new(), places: Vec::new(), source: Arc::clone(&self.source) };
        while let Some(row) = table.next().map_err(|error| self.note(&error, ""))? {
            self.row(&row, (&header, &roles), &found, (seconds, &scales), &mut points)?;
        }
        let rows = &mut points.rows;
        if rows.len() < 2 {
            let message = format!("a table needs two points at least, but has {}", rows.len());
            return Err(self.problem(0..0, "too short", message, ""));
        }
        let zero = rows[0].0;
        // Seconds since 1970 reach 1e11 in the year 5138.
        let is_stated =
            self.time.is_some() || header.titles.get(found[0]).is_some_and(|title| title.unit != Stated::Nothing);
        if zero.abs() >= 1e11 && !is_stated {
            let unit =
                [(1e14, "ms"), (1e17, "us")].iter().find(|(end, _)| zero.abs() < *end).map_or("ns", |(_, unit)| unit);
            let message = format!("{} begins at {zero}: a date of a clock, but not in s", header.called(found[0]));
            let help = format!("if it counts {unit}, write: time = \"{unit}\"");
            return Err(self.problem(points.places[0].clone(), "in another unit", message, &help));
        }
        rows.iter_mut().for_each(|row| row.0 -= zero);
        let unused = (0..header.titles.len()).filter(|column| !found.contains(column));
        let unused = unused.map(|column| header.called(column)).collect();
        let file = self.source.name().to_owned();
        self.file.reader.note_table(TableColumns { file, columns, unused });
        Ok(points)
    }

    /// Reads one row.
    fn row(
        &self,
        row: &Row<'_>,
        (header, roles): (&Header<'_>, &[Role<'_>]),
        found: &[usize],
        (seconds, scales): (f64, &[f64]),
        points: &mut Points,
    ) -> Read<()> {
        let number = |column: &usize| {
            row.number(*column, "a number").map_err(|error| {
                let is_clock = *column == found[0] && row.get(*column).contains(&b':');
                let found = format!("{} in {}", error.found, header.called(*column));
                let help = if is_clock { "times are numbers: count seconds from the first row" } else { "" };
                self.note(&ReadError { found, ..error }, help)
            })
        };
        let values = found.iter().map(number).collect::<Read<Vec<f64>>>()?;
        let Some((time, positions)) = values.split_first() else { return Ok(()) };
        if let Some(before) = points.rows.last().map(|before| before.0).filter(|before| *before >= time * seconds) {
            let column = header.called(found[0]);
            let message =
                format!("times must increase from line to line, but {column} has {time} after {}", before / seconds);
            let is_guess = self.choices.is_none() && !header.is_there();
            let help = if is_guess { self.offered(header, roles) } else { String::new() };
            return Err(self.problem(row.place(found[0]), "not later than the line before", message, &help));
        }
        points
            .rows
            .push((time * seconds, positions.iter().zip(scales).map(|(position, steps)| position * steps).collect()));
        points.places.push(row.at());
        Ok(())
    }

    /// Which columns hold what: as the motion file says, else as the header does.
    fn columns(&self, header: &Header<'_>, roles: &[Role<'_>]) -> Read<Vec<usize>> {
        let Some((node, choices)) = &self.choices else {
            return header.find(roles).map_err(|error| self.note(&error, &self.offered(header, roles)));
        };
        let column = |choice: &Choice| match choice {
            Choice::Number(column) => Ok(*column),
            Choice::Name(name) => header.column(name).map_err(|error| {
                let is_chosen =
                    |text: &str| choices.iter().any(|other| matches!(other, Choice::Name(name) if name == text));
                let titles = header.titles.iter().map(|title| title.text.as_str()).filter(|text| !is_chosen(text));
                // Of one letter every other is near.
                let near = nearest(name, titles).filter(|_| name.chars().count() > 1);
                self.note(&error, &near.map_or_else(String::new, |near| format!("did you mean \"{near}\"?")))
            }),
        };
        let columns = choices.iter().map(column).collect::<Read<Vec<usize>>>()?;
        // Names were read off the header; numbers may be counted wrongly.
        let counted = choices.iter().all(|choice| matches!(choice, Choice::Number(_)));
        let mut positions = columns[1..].iter().filter_map(|column| header.titles.get(*column));
        let time = positions.find(|title| title.is_one_of(TIME.names));
        if let Some(named) = time.filter(|_| counted && !header.possible(roles, |_, _| true).contains(&columns)) {
            let place = self.place(node);
            let time = match header.titles.get(columns[0]).map(|title| title.text.as_bytes()) {
                None | Some([]) => header.called(columns[0]),
                Some(text) => shown(text),
            };
            let named_time = shown(named.text.as_bytes());
            let message =
                format!("`columns` ({place}) makes {time} the time, but the header says that {named_time} is the time");
            return Err(self.problem(named.at.clone(), "the time", message, &self.offered(header, roles)));
        }
        Ok(columns)
    }

    /// Seconds in the unit of times, and the unit.
    fn seconds(&self, header: &Header<'_>, roles: &[Role<'_>], column: usize) -> Read<(f64, String)> {
        match (self.stated(header, roles, (0, column), self.time.is_some())?, &self.time) {
            (Some(one), Some((node, seconds))) if one.value != *seconds => {
                Err(self.contradiction(header, column, node, &one))
            }
            (Some(one), _) => Ok((one.value, one.unit.to_owned())),
            (None, Some((node, seconds))) => Ok((*seconds, node.as_text().unwrap_or_default().to_owned())),
            (None, None) => Ok((1.0, "s".to_owned())),
        }
    }

    /// One of the unit of a role's column of positions, where that is said, and the unit's name.
    fn position(
        &self,
        p: &Section<'a>,
        header: &Header<'_>,
        roles: &[Role<'_>],
        (role, column): (usize, usize),
    ) -> Read<(Quantity, Node<'a>, String)> {
        match (self.stated(header, roles, (role, column), self.unit.is_some())?, &self.unit) {
            (Some(one), Some((node, wanted))) if (one.base, one.value) != (wanted.base, wanted.value) => {
                Err(self.contradiction(header, column, node, &one))
            }
            (Some(one), given) => {
                let mut node = given.as_ref().map_or(&self.file, |(node, _)| node).clone();
                node.key = "unit";
                Ok((one, node, one.unit.to_owned()))
            }
            (None, _) => {
                let node = p.need("unit", "unit = \"deg\"")?;
                let text = node.as_text().unwrap_or_default().trim().to_owned();
                Ok((position_unit(&node)?, node, text))
            }
        }
    }

    /// The unit that the header gives a role's column; where it is not clear the motion file may give it, which has then to name the columns.
    fn stated(
        &self,
        header: &Header<'_>,
        roles: &[Role<'_>],
        (role, column): (usize, usize),
        is_given: bool,
    ) -> Read<Option<Quantity>> {
        match header.titles.get(column).map(|title| title.unit) {
            None | Some(Stated::Nothing) => Ok(None),
            Some(Stated::Unit(one)) if roles[role].fits(&one) => Ok(Some(one)),
            Some(Stated::Unclear(_)) if is_given && self.choices.is_some() => Ok(None),
            stated => {
                let is_known = matches!(stated, Some(Stated::Unit(_)));
                let help = if is_known { String::new() } else { self.offered(header, roles) };
                Err(self.note(&header.error_in(column, roles[role].units()), &help))
            }
        }
    }

    /// The help that says what to write for columns that are in doubt.
    fn offered(&self, header: &Header<'_>, roles: &[Role<'_>]) -> String {
        const MOST: usize = 2;
        if header.width() < roles.len() {
            return "columns are parted by tabs, `;` or `,`".to_owned();
        }
        if header.titles.iter().any(|title| has_decimal_comma(&title.text)) {
            return POINT.to_owned();
        }
        // A column that does not grow is no time. If another column grows by fractions, a column that counts by 1 is
        // the row number.
        let numbers: Vec<Vec<f64>> = (0..header.width()).map(|column| self.numbers(column)).collect();
        let all = |column: usize, is: fn(f64) -> bool| numbers[column].windows(2).all(|pair| is(pair[1] - pair[0]));
        let grows = |column: usize| all(column, |step| step > 0.0);
        let has_fractions =
            (0..header.width()).any(|k| grows(k) && numbers[k].iter().any(|number| number.fract() != 0.0));
        let may_be = |column: usize, role: &Role<'_>| {
            let numbers_rows = has_fractions && all(column, |step| step == 1.0);
            !numbers[column].is_empty() && !numbers_rows && (!role.is_time || grows(column))
        };
        let possible = header.possible(roles, may_be);
        let offers: Vec<String> =
            possible.iter().take(MOST).map(|columns| self.offer(header, roles, columns)).collect();
        if offers.is_empty() {
            let titles = header.titles_for(roles);
            return format!("if they are there under other names, call them so in the header: {titles}");
        }
        offers.join("\n")
    }

    fn offer(&self, header: &Header<'_>, roles: &[Role<'_>], columns: &[usize]) -> String {
        let (mut keys, mut is) = (Vec::new(), Vec::new());
        for (role, column) in roles.iter().zip(columns) {
            let (key, given) = match role.is_time {
                true => ("time", self.time.as_ref().map(|(node, _)| node)),
                false => ("unit", self.unit.as_ref().map(|(node, _)| node)),
            };
            let given = given.and_then(Node::as_text);
            let stated = header.titles.get(*column).map_or(Stated::Nothing, |title| title.unit);
            let unit = match stated {
                Stated::Unit(one) => one.unit,
                Stated::Unclear(Some(one)) if given.is_none() && role.fits(&one) => one.unit,
                _ => given.unwrap_or(role.unit()),
            };
            let is_said = matches!(stated, Stated::Unit(_));
            let value = format!("{key} = \"{unit}\"");
            if (given.is_some() || !is_said) && given != Some(unit) && !keys.contains(&value) {
                keys.push(value);
            }
            let unit = if is_said { String::new() } else { format!(" in {unit}") };
            is.push(format!("{} is {}{unit}", header.called(*column), role.what));
        }
        let last = is.pop().unwrap_or_default();
        let numbers: Vec<String> = columns.iter().map(|column| (column + 1).to_string()).collect();
        keys.insert(0, format!("columns = [{}]", numbers.join(", ")));
        format!("if {} and {last}, write: {}", is.join(", "), keys.join(", "))
    }

    /// A column's first numbers; none if it has anything else.
    fn numbers(&self, column: usize) -> Vec<f64> {
        const MOST: usize = 1000;
        let mut table = CsvTable::new(self.source.text().as_bytes());
        let mut numbers = Vec::new();
        if table.header().is_err() {
            return numbers;
        }
        while numbers.len() < MOST
            && let Ok(Some(row)) = table.next()
        {
            let Ok(number) = row.number(column, "") else { return Vec::new() };
            numbers.push(number);
        }
        numbers
    }

    /// Notes that the header gives another unit than the motion file.
    fn contradiction(&self, header: &Header<'_>, column: usize, node: &Node, one: &Quantity) -> Noted {
        let (key, place) = (node.key, self.place(node));
        let wanted = node.as_text().unwrap_or_default();
        let unit = one.unit;
        let message = format!("{} is in {unit}, but {place} says {key} = \"{wanted}\"", header.called(column));
        let at = header.titles.get(column).map_or(0..0, |title| title.at.clone());
        let help = format!("if the header is right, write: {key} = \"{unit}\"");
        self.problem(at, "another unit", message, &help)
    }

    /// Where a value of the motion file is written.
    fn place(&self, node: &Node) -> String {
        let source = &node.reader.source;
        let (line, column) = source.place(node.at.start);
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
    Role { what, own: Some(context.motor), names, is_time: false, example }
}
