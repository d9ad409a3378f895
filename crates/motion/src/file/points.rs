//! CSV files of times and positions.

use std::ops::Range;
use std::sync::Arc;

use miette::NamedSource;

use super::laws::{Loader, load};
use super::problem::Problem;
use super::reader::{Node, Noted, Read};

/// Which columns hold the time and the position.
pub(super) enum Columns {
    /// Counted from 0.
    Numbers(usize, usize),
    /// By the header's names.
    Names(String, String),
}

impl Default for Columns {
    fn default() -> Columns {
        Columns::Numbers(0, 1)
    }
}

/// `columns = [1, 2]`, counted from 1, or `columns = ["time", "angle"]`, by the header.
pub(super) fn columns(node: &Node) -> Read<Columns> {
    const EXAMPLE: &str = "columns = [1, 2], or [\"time\", \"angle\"] by the header";
    let list = node.list(EXAMPLE)?;
    let [time, position] = list.as_slice() else {
        return Err(node.note("two columns", "`columns` must list two: time and position", EXAMPLE));
    };
    if let (Some(time), Some(position)) = (time.as_text(), position.as_text()) {
        return Ok(Columns::Names(time.to_owned(), position.to_owned()));
    }
    // Within 1..=1000, so they fit.
    let number = |node: &Node| node.whole(1..=1000, EXAMPLE).map(|n| n as usize - 1);
    Ok(Columns::Numbers(number(time)?, number(position)?))
}

/// Reads times, in units of `seconds`, and positions, in units of `steps`; the first time becomes 0 s.
///
/// Lines that begin with `#` are comments, and a first line that is not of numbers is a header. Fields are parted by
/// tabs, `;` or `,`: whichever of them the first line holds, in this order.
pub(super) fn read(file: &Node, loader: Loader, columns: &Columns, seconds: f64, steps: f64) -> Read<Vec<(f64, f64)>> {
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
        Columns::Numbers(time, position) => Some((*time, *position)),
        Columns::Names(..) => None,
    };
    let mut points: Vec<(f64, f64)> = Vec::new();
    let mut first = true;
    for record in csv.records() {
        let record = record.map_err(|error| {
            let at = error.position().map_or(0, |position| position.byte() as usize);
            wrong(at..at, "here", format!("\"{name}\" is not CSV: {error}"))
        })?;
        let start = record.position().map_or(0, |position| position.byte() as usize).min(text.len());
        let line = start..text[start..].find('\n').map_or(text.len(), |length| start + length);
        let is_header = std::mem::take(&mut first) && record.iter().all(|field| field.parse::<f64>().is_err());
        let Some((time, position)) = places else {
            let Columns::Names(time, position) = columns else { continue };
            let find = |name: &str| {
                record
                    .iter()
                    .position(|field| field == name)
                    .ok_or_else(|| wrong(line.clone(), "the header", format!("the header has no column \"{name}\"")))
            };
            places = Some((find(time)?, find(position)?));
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
        let point = (number(time)? * seconds, number(position)? * steps);
        if points.last().is_some_and(|before| before.0 >= point.0) {
            return Err(wrong(line, "not later than the line before", "times must increase from line to line".into()));
        }
        points.push(point);
    }
    if points.len() < 2 {
        return Err(wrong(0..0, "too short", format!("a table needs two points at least, but has {}", points.len())));
    }
    let zero = points[0].0;
    points.iter_mut().for_each(|point| point.0 -= zero);
    Ok(points)
}
