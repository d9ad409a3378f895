//! The winch's figures: StepperWinch's text on the Uno's firmware, on the emulated chip.

use super::report;
use crate::command::{Done, Failure, cargo, output};

const PREFACE: &str = "Emulated: the committed image on the ATmega328P of `crates/emulator`, 16 MHz, 115 200 baud; no board was \
connected. Load is the share of all cycles in interrupts: those of the steps, the line, and the task that works out paths and puts \
their steps in order. Steps against the path are edges against the times of exactly even steps, less the board's constant. A \
line's effect is the beginning of the millisecond of the path that obeys it. The original is the StepperWinch sketch, on an \
emulated ATmega328P too.";

/// What the original does, by the first two fields of a row.
const ORIGINAL: [(&str, &str, &str); 7] = [
    ("load, 4 axes", "0 steps/s each", "31 %"),
    ("load, 4 axes", "4000 steps/s each", "36 %"),
    ("load, 4 axes", "10000 steps/s each", "79.5 %"),
    ("intervals against the exact one", "1234 steps/s, 4 axes", "±1.16 ms"),
    ("intervals against the exact one", "4000 steps/s, 4 axes", "±100 µs, 200 and 300 µs in turn"),
    ("commands obeyed", "`d x 10`, 3000 back to back, the other axes at 10000 steps/s", "9 of 100, idle"),
    ("steps against the path", "1234 steps/s, 4 axes", "0.08 % slow"),
];

/// Measures, prints and writes. Fails if a bound is broken, but only after writing.
pub(crate) fn run() -> Done {
    let text = output(&mut cargo("bench --package pulsetrain --bench winch"))?;
    let rows: Vec<Vec<&str>> =
        text.lines().filter(|line| line.contains('\t')).map(|line| line.split('\t').collect()).collect();
    if rows.is_empty() {
        return Err(Failure::Check("the bench printed no table".to_owned()));
    }
    let mut section = format!("# The winch, emulated\n\nWritten by `cargo xtask bench winch`. {PREFACE}\n\n");
    section.push_str("| measure | at | value | the original | |\n|---|---|---|---|---|\n");
    let mut broken = Vec::new();
    for row in &rows {
        let [what, at, value, fails] = row[..] else { return Err(Failure::Check(format!("not a row: {row:?}"))) };
        let original = ORIGINAL.iter().find(|known| (known.0, known.1) == (what, at)).map_or("", |known| known.2);
        section.push_str(&format!("| {what} | {at} | {value} | {original} | {fails} |\n"));
        if !fails.is_empty() {
            broken.push(format!("{what}, {at}: {value}"));
        }
    }
    print!("{section}");
    report::write("winch", &section)?;
    if broken.is_empty() { Ok(()) } else { Err(Failure::Check(format!("not as asked for: {}", broken.join("; ")))) }
}
