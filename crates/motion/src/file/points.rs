//! CSV files of times and positions.

use std::ops::Range;
use std::sync::Arc;

use miette::NamedSource;

use super::laws::{Loader, load};
use super::problem::Problem;
use super::reader::{Node, Noted, Read};

/// Which columns hold the time and the positions.
pub(super) enum Columns {
    /// Counted from 0.
    Numbers(Vec<usize>),
    /// By the header's names.
    Names(Vec<String>),
}

impl Columns {
    /// The first ones, of a time and so many positions.
    pub(super) fn first(positions: usize) -> Columns {
        Columns::Numbers((0..=positions).collect())
    }
}

/// `columns = [1, 2]`, counted from 1, or `columns = ["time", "angle"]`, by the header; of a time and so many positions.
pub(super) fn columns(node: &Node, positions: usize) -> Read<Columns> {
    let (example, wanted) = match positions {
        1 => ("columns = [1, 2], or [\"time\", \"angle\"] by the header", "two: time and position"),
        2 => ("columns = [1, 2, 3], or [\"time\", \"x\", \"y\"] by the header", "three: time, x and y"),
        _ => ("columns = [1, 2, 3, 4], or [\"time\", \"x\", \"y\", \"z\"] by the header", "four: time, x, y and z"),
    };
    let list = node.list(example)?;
    if list.len() != positions + 1 {
        return Err(node.note("not as many", format!("`columns` must list {wanted}"), example));
    }
    if list.iter().all(|node| node.as_text().is_some()) {
        return Ok(Columns::Names(list.iter().filter_map(Node::as_text).map(str::to_owned).collect()));
    }
    // Within 1..=1000, so they fit.
    let numbers: Read<Vec<usize>> =
        list.iter().map(|node| node.whole(1..=1000, example).map(|n| n as usize - 1)).collect();
    Ok(Columns::Numbers(numbers?))
}

/// Rows of a CSV file.
pub(super) struct Points {
    /// Time, s, from the first row on, and positions.
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

/// Reads times, in units of `seconds`, and positions, each in units of its `steps`; the first time becomes 0 s.
///
/// Lines that begin with `#` are comments, and a first line that is not of numbers is a header. Fields are parted by
/// tabs, `;` or `,`: whichever of them the first line holds, in this order.
pub(super) fn read(file: &Node, loader: Loader, columns: &Columns, seconds: f64, steps: &[f64]) -> Read<Points> {
    let text = load(file, loader)?;
    let name = file.as_text().unwrap_or_default();
    let source = Arc::new(NamedSource::new(name, text));
    let text = source.inner();
    let wrong = |at: Range<usize>, label: &str, message: String| -> Noted {
        let labels = vec![(at, label.to_owned())];
        file.reader.note_problem(Problem::new(&source, message, labels, None))
    };
    let first = text.lines().find(|line| !line.starts_with('#')).unwrap_or_default();
    let delimiter = [b'\t', b';'].into_iter().find(|delimiter| first.as_bytes().contains(delimiter)).unwrap_or(b',');
    let mut csv = csv::ReaderBuilder::new()
        .delimiter(delimiter)
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .comment(Some(b'#'))
        .from_reader(text.as_bytes());
    let mut places = match columns {
        Columns::Numbers(numbers) => Some(numbers.clone()),
        Columns::Names(_) => None,
    };
    let mut points = Points { rows: Vec::new(), places: Vec::new(), source: Arc::clone(&source) };
    let mut first = true;
    for record in csv.records() {
        let record = record.map_err(|error| {
            let at = error.position().map_or(0, |position| position.byte() as usize);
            wrong(at..at, "here", format!("\"{name}\" is not CSV: {error}"))
        })?;
        let start = record.position().map_or(0, |position| position.byte() as usize).min(text.len());
        let line = start..text[start..].find('\n').map_or(text.len(), |length| start + length);
        let is_header = std::mem::take(&mut first) && record.iter().all(|field| field.parse::<f64>().is_err());
        let Some(places) = &places else {
            let Columns::Names(names) = columns else { continue };
            let find = |name: &str| {
                record
                    .iter()
                    .position(|field| field == name)
                    .ok_or_else(|| wrong(line.clone(), "the header", format!("the header has no column \"{name}\"")))
            };
            places = Some(names.iter().map(|name| find(name)).collect::<Read<_>>()?);
            continue;
        };
        if is_header {
            continue;
        }
        let number = |column: usize| {
            let Some(field) = record.get(column) else {
                let message = format!("this line has {} columns, but column {} is wanted", record.len(), column + 1);
                return Err(wrong(line.clone(), "too few columns", message));
            };
            let value = field.parse::<f64>().ok().filter(|value| value.is_finite());
            value.ok_or_else(|| {
                // Quotes may keep it from being found as it stands.
                let at = text[line.clone()]
                    .find(field)
                    .map_or(line.clone(), |at| line.start + at..line.start + at + field.len());
                wrong(at, "not a number", format!("\"{field}\" is not a number"))
            })
        };
        let values = places.iter().map(|column| number(*column)).collect::<Read<Vec<f64>>>()?;
        let Some((time, positions)) = values.split_first() else { continue };
        let time = time * seconds;
        if points.rows.last().is_some_and(|before| before.0 >= time) {
            return Err(wrong(line, "not later than the line before", "times must increase from line to line".into()));
        }
        points.rows.push((time, positions.iter().zip(steps).map(|(position, steps)| position * steps).collect()));
        points.places.push(line);
    }
    let rows = &mut points.rows;
    if rows.len() < 2 {
        return Err(wrong(0..0, "too short", format!("a table needs two points at least, but has {}", rows.len())));
    }
    let zero = rows[0].0;
    rows.iter_mut().for_each(|row| row.0 -= zero);
    Ok(points)
}
