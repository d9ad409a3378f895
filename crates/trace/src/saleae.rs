//! Digital CSV as Saleae Logic 2 exports it: `Time [s],Channel 0,Channel 1`, a row for each change, levels 0, 1 or X.
//!
//! Logic 1's `Time[s], Channel 0` is read too. Source: Saleae support, "Binary and CSV Export Formats - 2025 Update".

use crate::table::{ReadError, Row, Table, shown};
use crate::{Edge, Line, Trace};

/// The tick of the trace that is read: 1 ns, finer than any of the analysers' samples.
pub const TICK_HZ: u64 = 1_000_000_000;

/// Whether the first column's title is this format's.
pub(crate) fn is_time_column(title: &[u8]) -> bool {
    let title: Vec<u8> = title.iter().filter(|b| !b.is_ascii_whitespace()).map(u8::to_ascii_lowercase).collect();
    title == b"time[s]"
}

/// Reads a capture; the first row is the lines' initial levels, and its time is where ticks begin unless times from 0 on
/// say otherwise (after a trigger they are negative before it).
///
/// # Errors
/// If the header or a level is another, time goes back, or is an ISO 8601 timestamp.
pub fn read(bytes: &[u8]) -> Result<Trace, ReadError> {
    let mut table = Table::new(bytes);
    let Some(header) = table.next()? else {
        return Err(ReadError::new(1, 1, "the header `Time [s],Channel 0,…`", "nothing"));
    };
    if !is_time_column(header.get(0)) {
        return Err(header.error(0, "the column `Time [s]`"));
    }
    if header.len() < 2 || header.len() > 257 {
        return Err(header.error(1, "1 to 256 channels"));
    }
    let mut lines = Vec::new();
    for column in 1..header.len() {
        lines.push(Line::named(header.text(column)?));
    }
    let mut levels = vec![None; lines.len()];
    let mut edges = Vec::new();
    let mut start: Option<i64> = None;
    let mut last = i64::MIN;
    while let Some(row) = table.next()? {
        let time_ns = time_ns(&row)?;
        if time_ns < last {
            return Err(row.error(0, format!("a time not before {} s", last as f64 * 1e-9)));
        }
        last = time_ns;
        let first = start.is_none();
        let start = *start.get_or_insert(time_ns.min(0));
        for (i, known) in levels.iter_mut().enumerate() {
            let level = match row.get(i + 1) {
                b"0" => false,
                b"1" => true,
                b"X" | b"x" => continue,
                _ => return Err(row.error(i + 1, "a level 0, 1 or X")),
            };
            if first {
                lines[i].initial = level;
            } else if known.unwrap_or(lines[i].initial) != level {
                // At most 256 lines; times are in order, so not before the start.
                edges.push(Edge { tick: time_ns.abs_diff(start), line: i as u8, level });
            }
            *known = Some(level);
        }
    }
    Ok(Trace { tick_hz: TICK_HZ, lines, edges })
}

/// The row's time: decimal digits, read exactly to the nearest ns.
fn time_ns(row: &Row<'_>) -> Result<i64, ReadError> {
    let expected = "a time in seconds";
    let text = row.text(0)?;
    if text.contains('T') && text.contains(':') {
        let found = format!("the ISO 8601 timestamp {}", shown(text.as_bytes()));
        return Err(ReadError::new(row.line(), 1, "seconds (export again without \"Use ISO 8601 timestamps\")", found));
    }
    // An f64 keeps ns for 104 days alone: whole seconds and fraction go apart.
    let (negative, digits) = match text.strip_prefix('-') {
        Some(digits) => (true, digits),
        None => (false, text),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let plain = |text: &str| text.bytes().all(|b| b.is_ascii_digit());
    let magnitude = if !whole.is_empty() && plain(whole) && plain(fraction) {
        let nine = format!("{fraction:0<9}");
        let round_up = i64::from(nine.as_bytes().get(9).is_some_and(|digit| *digit >= b'5'));
        let below = nine[..9].parse::<i64>().ok();
        let seconds = whole.parse::<i64>().ok().and_then(|s| s.checked_mul(1_000_000_000));
        seconds.zip(below).and_then(|(s, ns)| s.checked_add(ns + round_up))
    } else {
        // 1e-05 and the like.
        let seconds = row.number(0, expected)?;
        (seconds.abs() < 9e9).then(|| (seconds.abs() * 1e9).round() as i64)
    };
    let magnitude = magnitude.ok_or_else(|| row.error(0, expected))?;
    Ok(if negative { -magnitude } else { magnitude })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn both_generations() {
        let check = |file: &str, initial: &[bool], edges: &[(u64, u8, bool)]| {
            let trace = read(file.as_bytes()).unwrap();
            assert_eq!(trace.lines.iter().map(|l| l.initial).collect::<Vec<_>>(), initial, "{file}");
            let got: Vec<_> = trace.edges.iter().map(|e| (e.tick, e.line, e.level)).collect();
            assert_eq!(got, edges, "{file}");
        };
        check(
            "Time [s],Channel 0,Channel 1\n0.000000000,0,1\n0.000100125,1,1\n0.000102125,0,0\n",
            &[false, true],
            &[(100_125, 0, true), (102_125, 0, false), (102_125, 1, false)],
        );
        check("Time[s], Channel 0\r\n-0.5, 0\r\n1e-05, 1\r\n", &[false], &[(500_010_000, 0, true)]);
        check(
            "Time [s],D\n-1.0,X\n2,1\n4000000.0000000015,0\n",
            &[false],
            &[(3_000_000_000, 0, true), (4_000_001_000_000_002, 0, false)],
        );
        check("Time [s],D\n", &[false], &[]);
    }

    #[test]
    fn what_is_wrong_is_said_with_its_place() {
        let check = |file: &str, expected: &str| assert_eq!(read(file.as_bytes()).unwrap_err().to_string(), expected);
        check("", "line 1, column 1: expected the header `Time [s],Channel 0,…`, found nothing");
        check("t,x\n", "line 1, column 1: expected the column `Time [s]`, found `t`");
        check("Time [s]\n", "line 1, column 10: expected 1 to 256 channels, found nothing");
        check("Time [s],D0\n0.5,2\n", "line 2, column 5: expected a level 0, 1 or X, found `2`");
        check("Time [s],D0\n0.5,1\n0.25,0\n", "line 3, column 1: expected a time not before 0.5 s, found `0.25`");
        check("Time [s],D0\nsoon,1\n", "line 2, column 1: expected a time in seconds, found `soon`");
        check(
            "Time [s],D0\n99999999999999999,1\n",
            "line 2, column 1: expected a time in seconds, found `99999999999999999`",
        );
        check(
            "Time [s],D0\n2026-11-21T10:00:00.000000000+00:00,1\n",
            "line 2, column 1: expected seconds (export again without \"Use ISO 8601 timestamps\"), \
             found the ISO 8601 timestamp `2026-11-21T10:00:00.000000000+00:00`",
        );
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let _ = read(&bytes);
            let mut file = b"Time [s],Channel 0,Channel 1\n".to_vec();
            file.extend(&bytes);
            let _ = read(&file);
        }

        #[test]
        fn any_text_of_numbers_is_read_or_refused(rows in "([-+]?[0-9]{1,12}[.e,]?[0-9]{0,12},[01X]\n){0,9}") {
            let _ = read(format!("Time [s],Channel 0\n{rows}").as_bytes());
        }
    }
}
