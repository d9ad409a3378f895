//! The promised rates, run by the program itself on the virtual boards.

use super::table::Table;
use crate::command::Done;

const TITLES: [&str; 1] = ["Promised rates"];

const PREFACE: &str = "Emulated: each row is a motion file that `pulsetrain run` plans, runs and judges on the virtual board with \
the committed image, an Uno at 1 Mbaud, a Pico by its USB; no board was connected. If there are several motors, it runs twice: with all motors \
in phase, and with motors that begin apart from one another. A row holds if each run ends with PASS and no step is lost or added. `latest edge` is the \
largest |edge − scheduled tick| beyond the constant of the pins. The CRC-32 is that of the image's file in `crates/board/images`. A test \
fails if this page, the images and the rates in `crates/pulsetrain/tests/it/common/promises.rs` are not of one state; another runs all rows again.";

/// Writes the page of promises.
pub(crate) fn run() -> Done {
    let (table, _) = Table::measured("promises", "")?;
    let text = format!(
        "# What the boards reach by `run`\n\nWritten by `cargo xtask bench promises`; do not edit. {PREFACE}\n{}",
        table.markdown("Uno and Pico", &TITLES)
    );
    table.finish("promises", &text)
}
