//! The Uno's figures, in cycles of the emulated chip: what `cargo xtask bench uno` collects.
//!
//! A table, fields between tabs, the first of which says whether the row is promised. With the argument `hour` the hour of
//! 001's four motors instead.

#[path = "../tests/common/mod.rs"]
mod common;

use common::rows::{COLUMNS, Case, PROMISED, Row, TUTORIALS, hour, rates, tutorial_row, variations};

/// So long each rate is tried, s of the board's time; then the fastest once more, for longer.
const TRY_S: f64 = 0.4;
const LONG_S: f64 = 4.0;
/// Variations run so long.
const SHORT_S: f64 = 1.0;

fn main() {
    println!("promised\t{}", COLUMNS.join("\t"));
    if std::env::args().any(|argument| argument == "hour") {
        return hour(3600).iter().for_each(show);
    }
    for tutorial in TUTORIALS {
        show(&tutorial_row(tutorial, 1000, true));
        // The example files' own pulses; the longest period once is enough.
        if tutorial.0 == (500, 1) {
            continue;
        }
        let own_ns = if tutorial.0 == (1, 10) { 3000 } else { 10_000 };
        show(&tutorial_row(tutorial, own_ns, false));
    }
    let rates = rates();
    for case in PROMISED {
        show(&case.fastest(&rates, TRY_S, LONG_S));
    }
    for case in variations() {
        show(&case.fastest(&rates, TRY_S, SHORT_S));
    }
    for case in PROMISED {
        for share in [0.1, 0.25, 0.5, 1.0] {
            let row = Case { figure: 5, ..case }.row(share * case.required.unwrap_or(0.0), SHORT_S);
            show(&Row { required: String::new(), is_required: false, ..row });
        }
    }
}

fn show(row: &Row) {
    println!("{}\t{}", row.is_required, row.fields().join("\t"));
}
