//! The Uno's table in short: emulated cycles are the same everywhere, so that a reviewer sees what a change costs.
//!
//! `cargo xtask golden` writes it anew, `cargo xtask bench uno` the whole of it.

use crate::common::rows::{Case, PROMISED, Row, fastest_plateau, tutorial_row};
use expect_test::expect_file;
use std::fmt::Write as _;

/// A stream of each kind of pins, s.
const SHORT_S: f64 = 0.1;

fn write(table: &mut String, row: &Row) {
    let Row { law, pins, rate, verdict, .. } = row;
    let verdict = if verdict.is_empty() { "holds" } else { verdict };
    let _ = write!(table, "{law:62} {pins:20} {rate:12}");
    if let Some(seen) = &row.seen {
        let late = &seen.lateness;
        let _ = write!(
            table,
            " {:5} {:4} {:3} {:3} {:3} {:3} {:5.1} {:5.1} {:4} {:4}",
            late.edges,
            late.lost + late.extra,
            late.min_ticks,
            late.p50_ticks,
            late.p99_ticks,
            late.max_ticks,
            100.0 * seen.load.awake,
            100.0 * seen.load.busy,
            seen.masked_cycles,
            seen.stack_left,
        );
    }
    let _ = writeln!(table, "  {verdict}");
}

#[test]
fn the_unos_table() {
    let mut table = String::new();
    let _ = writeln!(
        table,
        "{:62} {:20} {:12} {:>5} {:>4} {:>3} {:>3} {:>3} {:>3} {:>5} {:>5} {:>4} {:>4}  verdict",
        "law", "pins", "steps/s", "edges", "lost", "min", "p50", "p99", "max", "awake", "busy", "cli", "stack"
    );
    for period in [((10, 1), (8, 9)), ((4, 5), (8, 9)), ((1, 10), (9, 8))] {
        write(&mut table, &tutorial_row(period, 1000, true));
    }
    for case in PROMISED {
        for (share, turns) in [(0.25, 0), (0.1, 5), (1.0, 0)] {
            write(&mut table, &Case { turns, ..case }.row(share * case.required.unwrap_or(0.0), SHORT_S));
        }
    }
    expect_file!["golden/uno.txt"].assert_eq(&table);
}

/// Four motors that go over to new epochs while they are fast: their lists are full, or nearly so, when a switch waits.
#[test]
fn four_motors_stay_fast_on_the_shield() {
    let case = PROMISED[6];
    for rate in [11e3, 12.5e3, 13e3, 15e3] {
        let row = fastest_plateau(&case, &[rate]);
        assert_eq!(row.verdict, "", "{rate} steps/s");
    }
}
