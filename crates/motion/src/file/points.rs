//! CSV files of times and positions.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use super::context::{Context, TOO_LARGE, load, position_unit, time_unit};
use super::problem::Problem;
use super::reader::{Node, Noted, Read, Section};
use super::source::Source;
use super::table_columns::{ColumnDistance, ColumnUse, Smoothing, TableColumns, Wraps};
use crate::columns::{
    CsvTable, DateForm, Header, POSITIONS, ReadError, Role, Row, Stated, TIME, Title, moment, plain, shown,
    with_line_feeds,
};
use crate::human;
use crate::law::double::Double;
use crate::law::{CUT_OFF, Interpolation, Law, LawError};
use crate::quantity::{Base, Quantity, nearest};

/// The keys of a table of a path.
pub(super) const KEYS: &[&str] = &["file", "time", "unit", "columns", "interpolation", "smooth"];
/// The keys of a motor's table.
pub(super) const LAW_KEYS: &[&str] = &["file", "time", "unit", "columns", "interpolation", "smooth", "wraps"];

/// The byte order mark, which is no part of the text.
const MARK: char = '\u{feff}';

/// Rows of a file, at most: what is made of them fits into 400 MB of memory.
const MOST_ROWS: usize = 2_000_000;

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
    /// s, from the first row on.
    times: Vec<f64>,
    /// Of each column of positions, steps.
    columns: Vec<Vec<f64>>,
    /// Where each row is written: files are far smaller than 4 GB.
    places: Vec<Range<u32>>,
    /// The unit of each column, without the number of `unit = "0.15 deg"`, and steps in one of it.
    units: Vec<(&'static str, f64)>,
    source: Arc<Source>,
    read_as: TableColumns,
}

impl Points {
    /// Notes a problem with a row.
    pub(super) fn wrong(&self, file: &Node, row: usize, label: &str, message: String, help: &str) -> Noted {
        let labels = vec![(self.place(row), label.to_owned())];
        file.reader.note_problem(Problem::new(&self.source, message, labels, Some(help.to_owned())))
    }

    fn place(&self, row: usize) -> Range<usize> {
        self.places.get(row).map_or(0..0, |place| place.start as usize..place.end as usize)
    }

    /// The position of every row, column by column.
    pub(super) fn positions(&self) -> impl Iterator<Item = Vec<f64>> {
        (0..self.times.len()).map(|row| self.columns.iter().map(|column| column[row]).collect())
    }

    /// The law of each column, smoothed if the motion file says so. Notes how the table was read.
    pub(super) fn laws(&self, p: &Section, made: impl Fn(Result<Law, LawError>) -> Read<Law>) -> Read<Vec<Law>> {
        let interpolation = p.get("interpolation").map_or(Ok(Interpolation::Monotone), |node| {
            node.word(&[("monotone", Interpolation::Monotone), ("linear", Interpolation::Linear)])
        });
        let smooth = p.get("smooth").map(|node| Ok((node.duration("50 ms")?, node))).transpose();
        let (interpolation, smooth) = (interpolation?, smooth?);
        let law = |column: &Vec<f64>| {
            let rows: Vec<(f64, f64)> = self.times.iter().copied().zip(column.iter().copied()).collect();
            made(Law::table(&rows, interpolation))
        };
        let laws = self.columns.iter().map(law).collect::<Read<Vec<Law>>>()?;
        let mut read_as = self.read_as.clone();
        let laws = match smooth {
            None => laws,
            Some((over, node)) => {
                let smoothed = laws.iter().map(|law| law.smoothed(over)).collect::<Option<Vec<Law>>>();
                let smoothed = smoothed.ok_or_else(|| self.cannot_smooth(&node, over.seconds()))?;
                let distance = |(law, (column, (unit, scale))): (&Law, (&ColumnUse, &(&str, f64)))| {
                    let distance = law.tables().first()?.distance();
                    let (what, unit) = (column.what.clone(), (*unit).to_owned());
                    let [largest, rms] = [distance.largest, distance.rms].map(|steps| steps / scale.abs());
                    Some(ColumnDistance { what, largest, at_s: distance.at_s, rms, unit })
                };
                let columns = read_as.columns[1..].iter().zip(&self.units);
                let distances = smoothed.iter().zip(columns).filter_map(distance).collect();
                read_as.smoothing = Some(Smoothing { over, cut_off_hz: CUT_OFF / over.seconds(), distances });
                smoothed
            }
        };
        p.reader.note_table(read_as);
        Ok(laws)
    }

    fn cannot_smooth(&self, node: &Node, over_s: f64) -> Noted {
        let lasts_s = self.times.last().copied().unwrap_or_default();
        if over_s > lasts_s {
            let message = format!("`smooth` is {over_s} s, but the recording lasts {lasts_s} s");
            return node.note("too long", message, "write, for example: smooth = \"50 ms\"");
        }
        let message = format!("`smooth` is {over_s} s: far too short for how far apart the rows are");
        node.note("too short", message, "leave it out, or make it as long as a few rows take")
    }
}

/// A file that is being read, and what the motion file says of it.
struct TableReader<'a, 't> {
    file: Node<'a>,
    source: Arc<Source>,
    /// The source in the form that is read.
    plain: Cow<'t, [u8]>,
    time: Option<(Node<'a>, f64)>,
    unit: Option<(Node<'a>, Quantity)>,
    choices: Option<(Node<'a>, Vec<Choice>)>,
    /// After how many steps the positions start again, as the motion file writes it.
    wraps: Option<(f64, String)>,
    /// Whether rows of one time are averaged: they are if the table is smoothed.
    averages: bool,
}

/// One of the unit of a table's positions: `"deg"`, or `"0.15 deg"` if 1 in the file is that much.
fn one_in_file(node: &Node) -> Read<Quantity> {
    let text = node.as_text().unwrap_or_default();
    match Quantity::parse(text) {
        Ok(one) if one.base.is_position() && one.per_seconds == 0 => match one.number == 0.0 {
            false => Ok(one),
            true => Err(node.note(
                "nothing",
                format!("`unit` is \"{text}\": then all positions are 0"),
                "write, for example: unit = \"0.15 deg\"",
            )),
        },
        _ => position_unit(node),
    }
}

/// Reads the file of a table: times and the positions of `contexts`; the first time becomes 0 s.
pub(super) fn read<'a>(p: &Section<'a>, contexts: &[Context]) -> Read<Points> {
    let file = p.need("file", "file = \"path.csv\"")?;
    let choices = p.get("columns").map(|node| Ok((node.clone(), choices(&node, contexts.len())?))).transpose();
    let time = p.get("time").map(|node| Ok((node.clone(), time_unit(&node)?))).transpose();
    let unit = p.get("unit").map(|node| Ok((node.clone(), one_in_file(&node)?))).transpose();
    let wraps = p.get("wraps").map(|node| wraps(&node, &contexts[0])).transpose();
    let mut text = load(&file, contexts[0].load)?;
    if text.starts_with(MARK) {
        text.drain(..MARK.len_utf8());
    }
    let text = with_line_feeds(text);
    let lines = text.bytes().filter(|byte| *byte == b'\n').count();
    if lines > MOST_ROWS {
        let message = format!(
            "\"{}\" has {} lines; {} is the most that is read",
            file.as_text().unwrap_or_default(),
            human::count(lines as i128),
            human::count(MOST_ROWS as i128)
        );
        return Err(file.note("too long", message, TOO_LARGE));
    }
    let source = Arc::new(Source::new(file.as_text().unwrap_or_default(), text));
    let plain = plain(source.text());
    let (choices, averages) = (choices?, p.get("smooth").is_some());
    TableReader { file, source: Arc::clone(&source), plain, time: time?, unit: unit?, choices, wraps: wraps?, averages }
        .points(p, contexts)
}

/// After how many steps positions start again: `wraps = "360 deg"`.
fn wraps(node: &Node, context: &Context) -> Read<(f64, String)> {
    // It is no position of the motion: reports keep the table's unit.
    let steps = match Quantity::parse(node.as_text().unwrap_or_default()) {
        Ok(after) if after.base.is_position() && after.per_seconds == 0 => {
            after.value * context.gearing.steps_per(node, after.base)?
        }
        _ => context.gearing.steps(node, 0, "360 deg")?,
    };
    if steps.is_infinite() {
        return Err(node.note(
            "out of range",
            "`wraps` is out of range".to_owned(),
            "write, for example: wraps = \"360 deg\"",
        ));
    }
    if steps > 0.0 {
        return Ok((steps, node.as_text().unwrap_or_default().trim().to_owned()));
    }
    Err(node.note("not above 0", "`wraps` must be more than 0".to_owned(), "write, for example: wraps = \"360 deg\""))
}

impl<'a> TableReader<'a, '_> {
    fn points(&self, p: &Section<'a>, contexts: &[Context]) -> Read<Points> {
        let mut table = CsvTable::new(&self.plain);
        let header = table.header().map_err(|error| self.note(&error, ""))?;
        let positions = contexts.iter().enumerate().map(|(k, context)| role(context, k, contexts.len()));
        let roles: Vec<Role<'_>> = [TIME].into_iter().chain(positions).collect();
        let found = self.columns(&header, &roles)?;
        let (seconds, time_unit, form) = self.seconds(&header, &roles, found[0])?;
        let (mut units, mut scales) = (Vec::new(), Vec::new());
        let used = |what: &str, column, unit| ColumnUse { what: what.to_owned(), column: header.called(column), unit };
        let mut columns = vec![used("time", found[0], time_unit)];
        for (k, (context, column)) in contexts.iter().zip(&found[1..]).enumerate() {
            let (one, node, unit) = self.position(p, &header, &roles, (k + 1, *column))?;
            let steps = context.steps_in(&node, &one)?;
            scales.push(steps);
            units.push((one.unit, steps / one.number));
            let what = match (contexts.len(), one.base) {
                (1, Base::Turn) => "angle",
                (1, _) => "position",
                _ => roles[k + 1].what,
            };
            columns.push(used(what, *column, unit));
        }
        let unused = (0..header.titles.len()).filter(|column| !found.contains(column));
        let unused = unused.map(|column| header.called(column)).collect();
        let file = self.source.name().to_owned();
        let wraps = self.wraps.as_ref().map(|(_, after)| Wraps { after: after.clone(), times: 0 });
        let read_as =
            TableColumns { file, columns, unused, rows_left_out: 0, rows_averaged: 0, wraps, smoothing: None };
        let empty = vec![Vec::new(); scales.len()];
        let source = Arc::clone(&self.source);
        let points = Points { times: Vec::new(), columns: empty, places: Vec::new(), units, source, read_as };
        let mut rows =
            Rows { points, scales, found: &found, seconds, form, first: None, comma: None, turns: 0.0, of_time: 1 };
        while let Some(row) = table.next().map_err(|error| self.note(&error, ""))? {
            self.row(&row, (&header, &roles), &mut rows)?;
        }
        let Rows { points, first, .. } = rows;
        if points.times.len() < 2 {
            let without = match points.read_as.rows_left_out {
                0 => String::new(),
                rows => format!("; rows without a position: {rows}"),
            };
            let message = format!("a table needs two points at least, but has {}{without}", points.times.len());
            return Err(self.problem(0..0, "too short", message, ""));
        }
        // Seconds since 1970 reach 1e11 in the year 5138.
        let is_stated =
            self.time.is_some() || header.titles.get(found[0]).is_some_and(|title| title.unit != Stated::Nothing);
        let zero = first.map_or(0.0, Double::nearest);
        if zero.abs() >= 1e11 && !is_stated {
            let unit =
                [(1e14, "ms"), (1e17, "us")].iter().find(|(end, _)| zero.abs() < *end).map_or("ns", |(_, unit)| unit);
            let message = format!("{} begins at {zero}: a date of a clock, but not in s", header.called(found[0]));
            let help = format!("if it counts {unit}, write: time = \"{unit}\"");
            return Err(self.problem(points.place(0), "in another unit", message, &help));
        }
        Ok(points)
    }

    /// Reads one row.
    fn row(&self, row: &Row<'_>, (header, roles): (&Header<'_>, &[Role<'_>]), rows: &mut Rows<'_>) -> Read<()> {
        let Rows { points, scales, found, .. } = rows;
        if found[1..].iter().any(|column| *column < header.width() && is_gap(row.get(*column))) {
            points.read_as.rows_left_out += 1;
            return Ok(());
        }
        let wrong = |column: usize, error: ReadError, help: &str| {
            let found = format!("{} in {}", error.found, header.called(column));
            self.note(&ReadError { found, ..error }, help)
        };
        let number = |column: usize| row.number(column, "a number");
        let time = match rows.form {
            None => number(found[0]).map(|time| exact(row.get(found[0]), time)).map_err(|error| {
                let is_clock = row.get(found[0]).contains(&b':');
                let help = if is_clock {
                    "a date is written like 2026-11-27T10:00:00.5; or count seconds from the first row"
                } else {
                    ""
                };
                wrong(found[0], error, help)
            })?,
            Some(form) => match row.text(found[0]).ok().and_then(moment) {
                Some((time, as_first)) if as_first == form => time,
                _ => return Err(wrong(found[0], row.error(found[0], "a time as in the first row"), "")),
            },
        };
        let positions = found[1..].iter().map(|column| number(*column).map_err(|error| wrong(*column, error, "")));
        let positions = positions.collect::<Read<Vec<f64>>>()?;
        for column in *found {
            let field = row.get(*column);
            let is_comma = field.contains(&b',');
            if !(is_comma || field.contains(&b'.')) || rows.form.is_some() && *column == found[0] {
                continue;
            }
            if *rows.comma.get_or_insert(is_comma) != is_comma {
                let message = format!(
                    "{} has {}, but numbers above it are written with a decimal {}",
                    header.called(*column),
                    shown(field),
                    if is_comma { "point" } else { "comma" }
                );
                let help =
                    "write all numbers with a decimal point, or all with a decimal comma; a sign for thousands is none";
                return Err(self.problem(row.place(*column), "written in another way", message, help));
            }
        }
        let time_s = (time - *rows.first.get_or_insert(time)).nearest() * rows.seconds;
        let mut positions: Vec<f64> = positions.iter().zip(scales).map(|(position, scale)| position * *scale).collect();
        if let (Some((steps, _)), Some(before)) = (&self.wraps, points.columns[0].last()) {
            let turns = ((before - positions[0]) / steps).round();
            if let Some(wraps) = points.read_as.wraps.as_mut().filter(|_| turns != rows.turns) {
                (wraps.times, rows.turns) = (wraps.times + 1, turns);
            }
            positions[0] += turns * steps;
        }
        if self.averages && points.times.last() == Some(&time_s) {
            let before = f64::from(rows.of_time);
            rows.of_time += 1;
            points.read_as.rows_averaged += 1;
            for (column, position) in points.columns.iter_mut().zip(positions) {
                if let Some(mean) = column.last_mut() {
                    *mean += (position - *mean) / (before + 1.0);
                }
            }
            return Ok(());
        }
        rows.of_time = 1;
        if points.times.last().is_some_and(|before| *before >= time_s) {
            let column = header.called(found[0]);
            let before_s = points.times.last().copied().unwrap_or_default();
            let has = match (rows.form, rows.first) {
                (None, Some(first)) => {
                    let before = first + Double::from(before_s / rows.seconds);
                    format!("{} after {}", time.nearest(), before.nearest())
                }
                _ => format!("{} after a later or equal time", shown(row.get(found[0]))),
            };
            let message = format!("times must increase from line to line, but {column} has {has}");
            let is_guess = self.choices.is_none() && !header.is_there();
            let help = if is_guess {
                self.offered(header, roles)
            } else if points.times.last() == Some(&time_s) {
                "with smooth = \"50 ms\" rows of one time are averaged; or take out one of the two lines".to_owned()
            } else {
                "sort the lines by time, or take out one of the two".to_owned()
            };
            return Err(self.problem(row.place(found[0]), "not later than the line before", message, &help));
        }
        points.times.push(time_s);
        for (column, position) in points.columns.iter_mut().zip(positions) {
            column.push(position);
        }
        let at = row.at();
        points.places.push(at.start as u32..at.end as u32);
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
    fn seconds(&self, header: &Header<'_>, roles: &[Role<'_>], column: usize) -> Read<(f64, String, Option<DateForm>)> {
        if let Some(form) = self.moments(column) {
            if let Some((node, _)) = &self.time {
                let message = format!("{} holds times of day, which have no unit", header.called(column));
                return Err(node.note("a unit", message, "leave `time` out"));
            }
            let is = if form.has_date { "date and time" } else { "time of day" };
            return Ok((1.0, is.to_owned(), Some(form)));
        }
        match (self.stated(header, roles, (0, column), self.time.is_some())?, &self.time) {
            (Some(one), Some((node, seconds))) if one.value != *seconds => {
                Err(self.contradiction(header, column, node, &one))
            }
            (Some(one), _) => Ok((one.value, one.unit.to_owned(), None)),
            (None, Some((node, seconds))) => Ok((*seconds, node.as_text().unwrap_or_default().to_owned(), None)),
            (None, None) => Ok((1.0, "s".to_owned(), None)),
        }
    }

    /// How a column's first row writes moments, if it does.
    fn moments(&self, column: usize) -> Option<DateForm> {
        let mut table = CsvTable::new(&self.plain);
        table.header().ok()?;
        let row = table.next().ok()??;
        moment(row.text(column).ok()?).map(|(_, form)| form)
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
                Ok((one_in_file(&node)?, node, text))
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
            Some(Stated::Unit(one)) if is_given && self.choices.is_some() && one.base == Base::Voltage => Ok(None),
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
            return "columns are separated by tabs, `;` or `,`".to_owned();
        }
        if !header.is_there() && header.is_parted_by_commas() && header.width() == 2 * roles.len() {
            return "if these are decimal commas, separate the columns with `;` or tabs, or write decimals with a point: 0.5".to_owned();
        }
        // A column that does not grow is no time. If another column grows by fractions, a column that counts by 1 is
        // the row number.
        let numbers = self.numbers(header.width());
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
        let is_sensor = |columns: &Vec<usize>| {
            columns[1..].iter().any(|column| header.titles.get(*column).is_some_and(Title::is_of_sensor))
        };
        let what_one_is = "if 1 in the file is not 1 of that unit, write what it is: unit = \"0.15 deg\"";
        let more = possible.iter().take(MOST).any(is_sensor) && self.unit.is_none();
        offers.join("\n") + &if more { format!("\n{what_one_is}") } else { String::new() }
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
                Stated::Unit(one) if role.fits(&one) => one.unit,
                Stated::Unclear(Some(one)) if given.is_none() && role.fits(&one) => one.unit,
                _ => given.unwrap_or(role.unit()),
            };
            let is_said = matches!(stated, Stated::Unit(one) if role.fits(&one));
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

    /// Each column's first numbers; none if it has anything else.
    fn numbers(&self, width: usize) -> Vec<Vec<f64>> {
        const MOST: usize = 1000;
        let mut table = CsvTable::new(&self.plain);
        let mut numbers: Vec<Option<Vec<f64>>> = vec![Some(Vec::new()); width];
        if table.header().is_ok() {
            for _ in 0..MOST {
                let Ok(Some(row)) = table.next() else { break };
                for (column, numbers) in numbers.iter_mut().enumerate() {
                    let Some(known) = numbers else { continue };
                    match row.number(column, "") {
                        Ok(number) => known.push(number),
                        Err(_) => *numbers = None,
                    }
                }
            }
        }
        numbers.into_iter().map(Option::unwrap_or_default).collect()
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

/// What the rows of a file are read into.
struct Rows<'c> {
    points: Points,
    /// The columns that are read, the time first.
    found: &'c [usize],
    /// In one of the unit of times.
    seconds: f64,
    /// How moments are written, if times are.
    form: Option<DateForm>,
    /// The first time.
    first: Option<Double>,
    /// Whether decimals are written with a comma, once that is seen.
    comma: Option<bool>,
    /// Steps in one of each column of positions.
    scales: Vec<f64>,
    /// How often the positions have started again, upwards less downwards.
    turns: f64,
    /// How many rows have the last time.
    of_time: u32,
}

/// Whether a field says that there is no value.
fn is_gap(field: &[u8]) -> bool {
    field.is_empty() || [&b"nan"[..], b"na", b"n/a", b"null", b"none"].iter().any(|gap| field.eq_ignore_ascii_case(gap))
}

/// A number that was read as `near`, with the digits that an f64 has no room for: a clock counts ns from 1970.
fn exact(field: &[u8], near: f64) -> Double {
    if near < 1e6 {
        return Double::from(near);
    }
    let text = std::str::from_utf8(field).unwrap_or_default().replace(',', ".");
    Double::decimal(&text).unwrap_or(Double::from(near))
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
