//! Numbers as people read them: three digits, units that fit, digits in groups.

use crate::whole_power;

/// `value` with `digits` significant digits, without trailing zeros, whole parts of five digits and more in groups of
/// three: "0.41", "62.5", "12 566".
#[must_use]
pub fn significant(value: f64, digits: usize) -> String {
    if value == 0.0 {
        return "0".into();
    }
    if !value.is_finite() {
        return value.to_string();
    }
    // The exponent is taken after rounding, so that 999.96 with four digits is 1000.
    let scientific = format!("{value:.*e}", digits.saturating_sub(1));
    let (_, exponent) = scientific.split_once('e').unwrap_or((&scientific, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    if !(-6..16).contains(&exponent) {
        return scientific.strip_prefix('-').map_or_else(|| scientific.clone(), |rest| format!("−{rest}"));
    }
    let decimals = (digits as i32 - 1 - exponent).max(0) as usize;
    let unit = whole_power(10.0, (exponent - digits as i32 + 1).max(0));
    let text = format!("{:.decimals$}", (value / unit).round_ties_even() * unit);
    let text = if decimals > 0 { format!("{value:.decimals$}") } else { text };
    grouped(if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text })
}

/// Puts a space between every three digits of a whole part of five digits or more.
fn grouped(number: &str) -> String {
    let (sign, number) = number.strip_prefix('-').map_or(("", number), |rest| ("−", rest));
    let (whole, fraction) = number.split_once('.').map_or((number, None), |(whole, fraction)| (whole, Some(fraction)));
    let mut text = String::from(sign);
    for (i, digit) in whole.chars().enumerate() {
        if i > 0 && whole.len() > 4 && (whole.len() - i).is_multiple_of(3) {
            text.push(' ');
        }
        text.push(digit);
    }
    if let Some(fraction) = fraction {
        text.push('.');
        text.push_str(fraction);
    }
    text
}

/// A whole number: "8000", "12 566".
#[must_use]
pub fn count(number: i128) -> String {
    grouped(&number.to_string())
}

/// A time in the unit that fits: "62.5 ns", "0.41 µs", "79.6 µs", "12.7 ms", "1.5 s".
#[must_use]
pub fn seconds(seconds: f64) -> String {
    seconds_to(seconds, 3)
}

/// A time in the unit that suits it, with `digits` significant digits.
#[must_use]
pub fn seconds_to(seconds: f64, digits: usize) -> String {
    let (factor, unit) = time_unit(seconds);
    format!("{} {unit}", significant(seconds * factor, digits))
}

/// The unit that fits a time of this many seconds, and how many of it make a second.
#[must_use]
pub fn time_unit(seconds: f64) -> (f64, &'static str) {
    match seconds.abs() {
        0.0 => (1.0, "s"),
        s if s < 1e-7 => (1e9, "ns"),
        s if s < 1e-3 => (1e6, "µs"),
        s if s < 1.0 => (1e3, "ms"),
        _ => (1.0, "s"),
    }
}

/// A long time in the unit that fits, with two digits: "40 s", "12 min", "3.5 h", "5 days", "32 years".
#[must_use]
pub fn long_time(seconds: f64) -> String {
    let (factor, unit) = match seconds {
        s if s < 90.0 => return seconds_to(s, 2),
        s if s < 5400.0 => (60.0, "min"),
        s if s < 172_800.0 => (3600.0, "h"),
        s if s < 63_115_200.0 => (86_400.0, "days"),
        _ => (31_557_600.0, "years"),
    };
    format!("{} {unit}", significant(seconds / factor, 2))
}

/// A size of files, with two digits: "310 MB", "1.2 GB".
#[must_use]
pub fn bytes(bytes: f64) -> String {
    let (factor, unit) = match bytes {
        b if b >= 995e9 => (1e12, "TB"),
        b if b >= 995e6 => (1e9, "GB"),
        b if b >= 995e3 => (1e6, "MB"),
        _ => (1e3, "kB"),
    };
    format!("{} {unit}", significant(bytes / factor, 2))
}

/// A quantity that spans decades, with k, M or G: "126 k steps/s", "16 MHz".
#[must_use]
pub fn scaled(value: f64, unit: &str) -> String {
    let (factor, prefix) = match value.abs() {
        v if v >= 999.5e6 => (1e9, "G"),
        v if v >= 999.5e3 => (1e6, "M"),
        v if v >= 9.995e3 => (1e3, "k"),
        _ => (1.0, ""),
    };
    // "16 MHz", but "126 k steps/s": the prefix belongs to units, not to words.
    let space = if prefix.is_empty() || unit == "Hz" { "" } else { " " };
    format!("{} {prefix}{space}{unit}", significant(value / factor, 3))
}

/// A firmware's version: "0.1.0".
#[must_use]
pub fn version([major, minor, patch]: [u8; 3]) -> String {
    format!("{major}.{minor}.{patch}")
}

/// A unit of position as it stands beside a number: "steps", whatever the file calls them.
#[must_use]
pub fn unit(name: &str) -> &str {
    if name == "step" { "steps" } else { name }
}

/// Columns of text, two spaces apart; the first is left-aligned, the others right-aligned.
#[derive(Debug, Default)]
pub struct Table {
    rows: Vec<Vec<String>>,
    left: Vec<usize>,
}

impl Table {
    /// A table with these headings.
    #[must_use]
    pub fn new<const N: usize>(headings: [&str; N]) -> Table {
        Table { rows: vec![headings.map(String::from).to_vec()], left: vec![0] }
    }

    /// Aligns these columns to the left instead.
    #[must_use]
    pub fn left(mut self, columns: &[usize]) -> Table {
        self.left = columns.to_vec();
        self
    }

    /// Adds a row.
    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(cells.into_iter().collect());
    }
}

impl std::fmt::Display for Table {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        let width = |column: usize| {
            self.rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..columns).map(width).collect();
        for row in &self.rows {
            let mut line = String::new();
            for (column, cell) in row.iter().enumerate() {
                let pad = " ".repeat(widths[column] - cell.chars().count());
                line.push_str("  ");
                if self.left.contains(&column) {
                    line.push_str(cell);
                    line.push_str(&pad);
                } else {
                    line.push_str(&pad);
                    line.push_str(cell);
                }
            }
            writeln!(f, "{}", line.trim_end())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_round_once_and_group() {
        let check = |value: f64, digits, expected: &str| assert_eq!(significant(value, digits), expected);
        check(0.0, 3, "0");
        check(62.5, 3, "62.5");
        check(0.4123, 3, "0.412");
        check(9.999, 3, "10");
        check(999.96, 4, "1000");
        check(12_566.37, 3, "12 600");
        check(12_566.37, 8, "12 566.37");
        check(-1_234_567.0, 9, "−1 234 567");
        check(1.0e-9, 3, "1.00e-9");
        check(-1.0e-9, 3, "−1.00e-9");
    }

    #[test]
    fn times_take_the_unit_that_fits() {
        let check = |s: f64, expected: &str| assert_eq!(seconds(s), expected);
        check(62.5e-9, "62.5 ns");
        check(0.41e-6, "0.41 µs");
        check(79.577e-6, "79.6 µs");
        check(1.125e-3, "1.12 ms");
        check(1.5, "1.5 s");
        check(0.0, "0 s");
    }

    #[test]
    fn rates_take_a_prefix() {
        let check = |value: f64, unit: &str, expected: &str| assert_eq!(scaled(value, unit), expected);
        check(126_000.0, "steps/s", "126 k steps/s");
        check(12_566.4, "steps/s", "12.6 k steps/s");
        check(800.0, "steps/s", "800 steps/s");
        check(16e6, "Hz", "16 MHz");
        check(999_999.0, "steps/s", "1 M steps/s");
    }

    #[test]
    fn long_times_and_sizes_take_the_unit_that_fits() {
        let check = |seconds: f64, expected: &str| assert_eq!(long_time(seconds), expected);
        check(42.4, "42 s");
        check(0.05, "50 ms");
        check(600.0, "10 min");
        check(7000.0, "1.9 h");
        check(1e6, "12 days");
        check(1e9, "32 years");
        check(1e30, "3.2e22 years");
        assert_eq!(
            [bytes(1.0e4), bytes(3.14e8), bytes(2.4e9), bytes(5e19)],
            ["10 kB", "310 MB", "2.4 GB", "50 000 000 TB"]
        );
    }

    #[test]
    fn columns_line_up() {
        let mut table = Table::new(["motor", "steps"]);
        table.row(["x".into(), "8000".into()]);
        assert_eq!(table.to_string(), "  motor  steps\n  x       8000\n");
    }
}
