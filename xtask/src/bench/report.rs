//! Full tables of figures, a file each: docs/benchmarks/*.md. docs/benchmarks.md has what is promised, written by hand.

use super::Row;
use super::peers::{PLANNING, PLANNING_NOTE, SKETCHES, SKETCHES_NOTE};
use crate::command::{Done, Failure, command, output, root};
use std::fs;

/// The report's sections; [`Row::figure`] counts from 1.
const FIGURES: [&str; 5] = [
    "Every step of the tutorial against exact times",
    "Planning with its certificate, one core",
    "Payload of the packed stream",
    "10^8 steps against exact integers",
    "S-curve durations against ruckig's",
];

const PREFACE: &str = "Times are the fastest of several runs. `native`: measured on that machine. `emulated` and \
`hardware` stay empty until a firmware has run there. Bounds are upper ones. What takes how many ns depends on the machine. So the bounds on planning \
are multiples of a yardstick, which is measured in the same run: a piece of work like the planner's (`yardsticks` in `crates/plan/benches/figures.rs`) that calls no \
library of the system.";

/// The host's table.
pub(crate) fn markdown(rows: &[Row]) -> Done<String> {
    let mut lines = vec![
        "# The host: planning".to_owned(),
        String::new(),
        format!("Written by `cargo xtask bench host`; do not edit. {}", machine()?),
        String::new(),
        PREFACE.to_owned(),
    ];
    for (figure, title) in (1..).zip(FIGURES) {
        lines.extend([String::new(), format!("## {figure}. {title}"), String::new()]);
        lines.push(
            "| law | tick rate, Hz | tolerance, ticks | measure | bound | native | emulated | hardware |".to_owned(),
        );
        lines.push("|---|---|---|---|---|---|---|---|".to_owned());
        for row in rows.iter().filter(|row| row.figure == figure) {
            let Row { law, tick_hz, tolerance_ticks, what, .. } = row;
            let bound = row.bound.map_or(String::new(), short);
            let value = if row.is_within() { short(row.value) } else { format!("**{}** (beyond)", short(row.value)) };
            lines.push(format!("| {law} | {tick_hz} | {tolerance_ticks} | {what} | {bound} | {value} | | |"));
        }
    }
    lines.extend(["", "## What others reach", "", PLANNING_NOTE, ""].map(str::to_owned));
    lines.push("| planning, ns/step | ours, proven within 1 tick | Klipper, 25 µs | Klipper, −2.5 to +0.5 ticks | Kalico, 3rd order, ±1.5 ticks |".to_owned());
    lines.push("|---|---|---|---|---|".to_owned());
    lines.extend(PLANNING.map(|row| format!("| {} |", row.join(" | "))));
    lines.extend(["", SKETCHES_NOTE, "", "| system | law | measure | value |", "|---|---|---|---|"].map(str::to_owned));
    lines.extend(SKETCHES.map(|row| format!("| {} |", row.join(" | "))));
    lines.push(String::new());
    Ok(lines.join("\n"))
}

/// Writes a table of figures to its file, docs/benchmarks/NAME.md.
pub(crate) fn write(name: &str, text: &str) -> Done {
    let path = root().join(format!("docs/benchmarks/{name}.md"));
    let written = path.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::write(&path, text));
    written.map_err(|why| Failure::File { path, why })
}

/// Three significant digits, or a few more before the point.
fn short(value: f64) -> String {
    let digits = 2 - value.abs().max(1e-12).log10().floor() as i32;
    if value == 0.0 {
        "0".to_owned()
    } else if digits > 6 {
        format!("{value:.1e}")
    } else {
        format!("{value:.*}", digits.max(0) as usize)
    }
}

/// The processor and the compiler.
pub(super) fn machine() -> Done<String> {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find_map(|line| line.strip_prefix("model name")).and_then(|rest| rest.split(": ").nth(1));
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let compiler = output(command("rustc").arg("--version"))?;
    let model = model.unwrap_or(std::env::consts::ARCH);
    Ok(format!("Obtained on {model}, {cores} cores, {}, with {}.", std::env::consts::OS, compiler.trim()))
}

#[cfg(test)]
mod tests {
    use super::short;

    #[test]
    fn numbers_are_short() {
        let check = |value: f64, expected: &str| assert_eq!(short(value), expected);
        check(0.0906, "0.0906");
        check(11.04, "11.0");
        check(999.6, "1000");
        check(1234.0, "1234");
        check(3.2e-9, "3.2e-9");
        check(0.0, "0");
    }
}
