//! Rows of levels, as logic analysers write them, turned into edges.

use pulsetrain_motion::columns::{Header, Row};

use crate::{Edge, Line, ReadError, Trace};

/// The tick rate of traces from CSV files: a tick is 1 ns, finer than the samples of the analysers.
pub(crate) const TICK_HZ: u64 = 1_000_000_000;

/// A trace that is read row by row.
pub(crate) struct Levels {
    trace: Trace,
    /// For each line, its column, and its level as soon as it is known.
    columns: Vec<(usize, Option<bool>)>,
    /// The time of tick 0, ns.
    start_ns: Option<i64>,
    last_ns: i64,
}

/// Whether a field is a level: 0 or 1, or X for an unknown one.
pub(crate) fn level(field: &[u8]) -> Option<Option<bool>> {
    match field {
        b"0" => Some(Some(false)),
        b"1" => Some(Some(true)),
        b"X" | b"x" => Some(None),
        _ => None,
    }
}

impl Levels {
    /// Channels by their columns and names.
    pub(crate) fn new(header: &Header<'_>, channels: &[(usize, String)]) -> Result<Levels, ReadError> {
        if channels.is_empty() || channels.len() > 256 {
            let found = if channels.is_empty() { "nothing".to_owned() } else { channels.len().to_string() };
            return Err(header.error("1 to 256 channels", found));
        }
        for (k, (column, name)) in channels.iter().enumerate() {
            if channels[..k].iter().any(|(_, other)| other == name) {
                return Err(header.error_in(*column, "channels of different names"));
            }
        }
        let lines = channels.iter().map(|(_, name)| Line::named(name)).collect();
        let columns = channels.iter().map(|(column, _)| (*column, None)).collect();
        let trace = Trace { tick_hz: TICK_HZ, lines, edges: Vec::new() };
        Ok(Levels { trace, columns, start_ns: None, last_ns: i64::MIN })
    }

    /// Adds a row. The levels of the first row are the initial ones. Times before 0 s move the beginning of the trace.
    pub(crate) fn row(&mut self, row: &Row<'_>, time_ns: i64) -> Result<(), ReadError> {
        let first = self.start_ns.is_none();
        let start_ns = *self.start_ns.get_or_insert(time_ns.min(0));
        for (i, (column, known)) in self.columns.iter_mut().enumerate() {
            let level = level(row.get(*column)).ok_or_else(|| row.error(*column, "a level 0, 1 or X"))?;
            let Some(level) = level else { continue };
            if first {
                self.trace.lines[i].initial = level;
            } else if known.unwrap_or(self.trace.lines[i].initial) != level {
                // At most 256 lines; times are in order, so not before the start.
                self.trace.edges.push(Edge { tick: time_ns.abs_diff(start_ns), line: i as u8, level });
            }
            *known = Some(level);
        }
        self.last_ns = time_ns;
        Ok(())
    }

    /// The time of the last row, ns.
    pub(crate) fn last_ns(&self) -> i64 {
        self.last_ns
    }

    pub(crate) fn finish(self) -> Trace {
        self.trace
    }
}
