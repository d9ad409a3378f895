//! Figures of verbs: MOVE, SPEED and DIRECTION on the Pico's firmware and library, on the emulated chip.

use super::report;
use crate::command::{Done, Failure, cargo, output};

const PREFACE: &str = "Emulated: the committed images on the RP2040 of `crates/emulator`, 125 MHz; no board was connected. A delay is \
counted from the last bit of the order on the UART, at 2 Mbaud, to the first step that is other than it would have been; what is asked \
for is six steps or 2 ms, whichever is longer. Load is the share of all cycles in which the processor does not sleep. The original is \
the driver and the demo of the Pico plotter (docs/sources.md); what it does was seen in `crates/emulator/tests/it/three_machine_motor.rs`, or is its \
author's figure.";

/// What the original does, by the beginning of a row.
const ORIGINAL: [(&str, &str, &str); 4] = [
    ("from SPEED", "", "7 steps"),
    ("from DIRECTION", "", "6 to 13 half steps, and one is lost"),
    ("share of the processor", "lorenz", "0.23 %: DMA does the rest"),
    ("cycles in 1/50 s", "lorenz", "5 740"),
];

/// Measures, prints and writes. Fails if a bound is broken, but only after writing.
pub(crate) fn run() -> Done {
    let text = output(&mut cargo("bench --package pulsetrain-board --bench verbs"))?;
    let rows: Vec<Vec<&str>> =
        text.lines().filter(|line| line.contains('\t')).map(|line| line.split('\t').collect()).collect();
    if rows.is_empty() {
        return Err(Failure::Check("the bench printed no table".to_owned()));
    }
    let mut section = format!("# Verbs, emulated\n\nWritten by `cargo xtask bench verbs`. {PREFACE}\n\n");
    section.push_str("| measure | at | value | the original | |\n|---|---|---|---|---|\n");
    let mut broken = Vec::new();
    for row in &rows {
        let [what, at, value, fails] = row[..] else { return Err(Failure::Check(format!("not a row: {row:?}"))) };
        let known = |known: &&(&str, &str, &str)| what.starts_with(known.0) && at.starts_with(known.1);
        let original = ORIGINAL.iter().find(known).map_or("", |known| known.2);
        section.push_str(&format!("| {what} | {at} | {value} | {original} | {fails} |\n"));
        if !fails.is_empty() {
            broken.push(format!("{what}, {at}: {value}"));
        }
    }
    print!("{section}");
    report::write("verbs", &section)?;
    if broken.is_empty() { Ok(()) } else { Err(Failure::Check(format!("not as asked for: {}", broken.join("; ")))) }
}
