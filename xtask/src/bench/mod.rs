//! Figures: measured, compared with their bounds, printed, and written to docs/benchmarks/.

pub(crate) mod film;
pub(crate) mod first_run;
pub(crate) mod live;
mod peers;
pub(crate) mod pico;
pub(crate) mod promises;
mod report;
mod table;
pub(crate) mod uno;
pub(crate) mod verbs;
pub(crate) mod winch;

use crate::command::{Done, Failure, cargo, output};
use crate::ruckig;

/// One measurement; an empty text where something does not apply.
struct Row {
    /// Which of the report's figures it belongs to.
    figure: usize,
    law: String,
    tick_hz: String,
    tolerance_ticks: String,
    /// What was measured, with its unit.
    what: String,
    /// The value that it must not exceed.
    bound: Option<f64>,
    value: f64,
}

impl Row {
    fn is_within(&self) -> bool {
        self.bound.is_none_or(|bound| self.value <= bound)
    }
}

/// Measures the host, prints and writes; fails if a bound is broken, after having written.
pub(crate) fn host() -> Done {
    let text = output(&mut cargo("bench --package pulsetrain-plan --bench figures"))?;
    let mut rows = text.lines().filter(|line| line.contains('\t')).map(parse).collect::<Done<Vec<_>>>()?;
    rows.push(elsewhere(
        5,
        "S-curves, 1000 random moves",
        "relative difference to ruckig",
        Some(1e-6),
        ruckig::compare()?,
    ));
    let report = report::markdown(&rows)?;
    print!("{report}");
    report::write("host", &report)?;
    let broken: Vec<_> =
        rows.iter().filter(|row| !row.is_within()).map(|row| format!("{}: {}", row.law, row.what)).collect();
    if broken.is_empty() { Ok(()) } else { Err(Failure::Check(format!("beyond their bounds: {}", broken.join("; ")))) }
}

/// What is measured without a step timer.
fn elsewhere(figure: usize, law: &str, what: &str, bound: Option<f64>, value: f64) -> Row {
    let (law, what) = (law.to_owned(), what.to_owned());
    Row { figure, law, tick_hz: String::new(), tolerance_ticks: String::new(), what, bound, value }
}

/// A line of the bench `figures`.
fn parse(line: &str) -> Done<Row> {
    let bad = || Failure::Check(format!("not a row of figures: {line}"));
    let fields: Vec<_> = line.split('\t').map(str::to_owned).collect();
    let [figure, law, tick_hz, tolerance_ticks, what, bound, value] = fields.try_into().map_err(|_| bad())?;
    let number = |text: &str| text.parse::<f64>().map_err(|_| bad());
    Ok(Row {
        figure: figure.parse().map_err(|_| bad())?,
        bound: if bound.is_empty() { None } else { Some(number(&bound)?) },
        value: number(&value)?,
        law,
        tick_hz,
        tolerance_ticks,
        what,
    })
}
