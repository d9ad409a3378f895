//! Digital CSV as Saleae Logic 2 exports it: `Time [s],Channel 0,Channel 1`, a row for each change, levels 0, 1 or X.
//!
//! Logic 1's `Time[s], Channel 0` is read too, and times in ms, us or ns. Source: Saleae support, "Binary and CSV Export Formats - 2025
//! Update".

use pulsetrain_motion::columns::{CsvTable, Header, Row, Stated, TIME, shown};
use pulsetrain_motion::whole_power;

use crate::levels::{Levels, level};
use crate::{ReadError, Trace};

/// Whether a file's columns are a time and levels: the time has a unit, or the first row's other fields are all levels.
pub(crate) fn is_levels(header: &Header<'_>, first: Option<Row<'_>>) -> bool {
    let Ok(found) = header.find(&[TIME]) else { return false };
    let time = found[0];
    let all = |row: Row<'_>| (0..row.len()).filter(|k| *k != time).all(|k| level(row.get(k)).is_some());
    matches!(header.titles.get(time).map(|title| &title.unit), Some(Stated::Unit(_)))
        || header.width() > 1 && first.is_some_and(all)
}

/// Whether the columns of all rows are a time and levels.
pub(crate) fn has_only_levels(header: &Header<'_>, table: &mut CsvTable<'_>) -> Result<bool, ReadError> {
    let Ok(found) = header.find(&[TIME]) else { return Ok(false) };
    while let Some(row) = table.next()? {
        if (0..header.width()).any(|k| k != found[0] && level(row.get(k)).is_none()) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Reads a capture. The first row has the initial levels of the lines. Its time is tick 0, unless later rows have times
/// from 0 on (after a trigger, times before it are negative).
///
/// # Errors
/// If the header has no time with a unit, a field is no level, time goes back, or times are ISO 8601 timestamps.
pub fn read(bytes: &[u8]) -> Result<Trace, ReadError> {
    let mut table = CsvTable::new(bytes);
    let header = table.header()?;
    if !header.is_there() {
        return Err(header.error("the header `Time [s],Channel 0,…`", "none"));
    }
    let time = header.find(&[TIME])?[0];
    let unit = match &header.titles[time].unit {
        Stated::Unit(unit) if TIME.fits(unit) => unit.unit,
        _ => "",
    };
    // The number of decimal digits from the column's unit to nanoseconds.
    let digits = match unit {
        "s" => 9,
        "ms" => 6,
        "us" | "µs" | "μs" => 3,
        "ns" => 0,
        _ => return Err(header.error_in(time, "the time's unit, as in `Time [s]`: s, ms, us or ns")),
    };
    let channels = header.titles.iter().enumerate().filter(|(column, _)| *column != time);
    let channels: Vec<(usize, String)> = channels.map(|(column, title)| (column, title.text.clone())).collect();
    let mut levels = Levels::new(&header, &channels)?;
    while let Some(row) = table.next()? {
        let time_ns = time_ns(&row, time, digits)?;
        let last_ns = levels.last_ns();
        if time_ns < last_ns {
            return Err(row.error(time, format!("a time not before {} s", last_ns as f64 * 1e-9)));
        }
        levels.row(&row, time_ns)?;
    }
    Ok(levels.finish())
}

/// The time of a row: decimal digits, read exactly to the nearest ns.
fn time_ns(row: &Row<'_>, column: usize, digits: usize) -> Result<i64, ReadError> {
    let expected = "a time, a number";
    let text = row.text(column)?;
    if text.contains('T') && text.contains(':') {
        let found = format!("the ISO 8601 timestamp {}", shown(text.as_bytes()));
        let error = row.error(column, "seconds (export again without \"Use ISO 8601 timestamps\")");
        return Err(ReadError { found, ..error });
    }
    // f64 alone keeps nanoseconds for 104 days, so that whole units and fraction are read separately.
    let (negative, unsigned) = match text.strip_prefix('-') {
        Some(unsigned) => (true, unsigned),
        None => (false, text),
    };
    let (whole, fraction) = unsigned.split_once('.').unwrap_or((unsigned, ""));
    let plain = |text: &str| text.bytes().all(|b| b.is_ascii_digit());
    let magnitude = if !whole.is_empty() && plain(whole) && plain(fraction) {
        let fraction = format!("{fraction:0<digits$}");
        let (kept, cut) = fraction.split_at(digits);
        let round_up = i64::from(cut.bytes().next().is_some_and(|digit| digit >= b'5'));
        format!("{whole}{kept}").parse::<i64>().ok().and_then(|ns| ns.checked_add(round_up))
    } else {
        // A number with an exponent, such as 1e-05.
        let ns = row.number(column, expected)?.abs() * whole_power(10.0, digits as i32);
        (ns < 9e18).then(|| ns.round() as i64)
    };
    let magnitude = magnitude.ok_or_else(|| row.error(column, expected))?;
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
        check("Time [ms],D\n0,0\n1.5,1\n2.0000015,0\n", &[false], &[(1_500_000, 0, true), (2_000_002, 0, false)]);
        check("D;time_us\n0;-1\n1;1e3\n", &[false], &[(1_001_000, 0, true)]);
        check("nanoseconds,D\n0,0\n17,1\n", &[false], &[(17, 0, true)]);
    }

    #[test]
    fn what_is_wrong_is_said_with_its_place() {
        let check = |file: &str, expected: &str| assert_eq!(read(file.as_bytes()).unwrap_err().to_string(), expected);
        check("", "line 1, column 1: expected the header `Time [s],Channel 0,…`, found none");
        check("t,x\n", "line 1, column 1: expected the time's unit, as in `Time [s]`: s, ms, us or ns, found `t`");
        check(
            "t [h],x\n",
            "line 1, column 1: expected the time's unit, as in `Time [s]`: s, ms, us or ns, found `t [h]`",
        );
        check("Time [s]\n", "line 1, column 1: expected 1 to 256 channels, found nothing");
        check("Time [s],D0,D0\n", "line 1, column 13: expected channels of different names, found `D0`");
        check("Time [s],D0\n0.5,2\n", "line 2, column 5: expected a level 0, 1 or X, found `2`");
        check("Time [s],D0\n0.5,1\n0.25,0\n", "line 3, column 1: expected a time not before 0.5 s, found `0.25`");
        check("Time [s],D0\nsoon,1\n", "line 2, column 1: expected a time, a number, found `soon`");
        check(
            "Time [s],D0\n99999999999999999,1\n",
            "line 2, column 1: expected a time, a number, found `99999999999999999`",
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
