//! Live motions: how soon a change comes, how exactly motors follow after many, and what a host takes. `cargo xtask bench live` collects them.
//!
//! Prints a table with tabs between the fields; the first field says whether the row is promised. Arguments: `latency`, `soak` or `load` for a part alone,
//! and `short`, which is for a look at the bench, not for figures.
#![allow(clippy::disallowed_methods, reason = "what a bench measures may differ in the last digit")]

mod latency;
mod load;
mod soak;

/// The columns' titles.
const COLUMNS: [&str; 7] = ["figure", "what", "board", "measured", "bound", "more", "verdict"];

/// One line of the table.
pub(crate) struct Row {
    pub(crate) figure: u8,
    pub(crate) what: String,
    pub(crate) board: &'static str,
    pub(crate) measured: String,
    /// Empty: none is promised.
    pub(crate) bound: String,
    pub(crate) more: String,
    pub(crate) holds: bool,
}

/// STEP and DIR of four motors: an Uno drives all of them only on pins such as those of the CNC shield.
pub(crate) fn pins(board: &str) -> [(u8, u8); 4] {
    if board == "pico" { [(2, 3), (4, 5), (6, 7), (8, 9)] } else { [(2, 5), (3, 6), (4, 7), (12, 13)] }
}

impl Row {
    fn print(&self) {
        let Row { figure, what, board, measured, bound, more, holds } = self;
        let verdict = if *holds { "holds" } else { "broken" };
        println!("{}\t{figure}\t{what}\t{board}\t{measured}\t{bound}\t{more}\t{verdict}", !bound.is_empty());
    }
}

fn main() {
    println!("promised\t{}", COLUMNS.join("\t"));
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect();
    let has = |name: &str| arguments.iter().any(|argument| argument == name);
    let parts = ["latency", "soak", "load"];
    let wants = |part: &str| has(part) || !parts.iter().any(|part| has(part));
    let share = if has("short") { 0.02 } else { 1.0 };
    if wants("latency") {
        for board in ["native", "pico", "uno"] {
            latency::rows(board, share).iter().for_each(Row::print);
        }
    }
    if wants("soak") {
        for (board, seconds) in [("native", 86_400.0), ("pico", 600.0), ("uno", 3600.0)] {
            soak::rows(board, share * seconds).iter().for_each(Row::print);
        }
    }
    if wants("load") {
        load::rows(share).iter().for_each(Row::print);
    }
}
