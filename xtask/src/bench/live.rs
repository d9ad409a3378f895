//! Live motions: how soon a change comes, how exactly motors follow after many changes, what a host takes.

use super::table::Table;
use crate::command::Done;

/// Titles of the figures, from 1 on.
const TITLES: [&str; 3] = [
    "From a client's event to the first tick of the motors' change",
    "A change each second, for hours",
    "What `pulsetrain live` takes of a computer",
];

const PREFACE: &str = "No board was connected: `pico` and `uno` are the committed images on the emulated chips, `native` is this computer's own step \
generator. Figure 1 is of processes in real time, so it depends on the computer and on what else it does: event sent to event \
heard by this computer's clock, and from there to the first tick of the change by the board's. Figure 2 is in the board's time: each scheduled step \
is held against a sweep whose periods are counted apart from the program, and each edge of STEP is counted. Figure 3: the board is another process behind a \
pseudo-terminal; processor time and memory are those of `pulsetrain live` alone, as Linux counts them.";

/// All figures. It takes a quarter of an hour.
pub(crate) fn run() -> Done {
    let (table, _) = Table::measured("live", "")?;
    let text = format!(
        "# Live motions\n\nWritten by `cargo xtask bench live`. {}\n\n{PREFACE}\n{}",
        super::report::machine()?,
        table.markdown("Live", &TITLES)
    );
    table.finish("live", &text)
}
