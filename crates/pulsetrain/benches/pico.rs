//! The Pico's figures, in cycles of the emulated chip: what `cargo xtask bench pico` collects.
//!
//! A table, fields between tabs, the first of which says whether the row is promised, or that it is a limit for the table of
//! boards. With the argument `hour` an hour of 001's four motors, twice, instead.

#[path = "../tests/common/mod.rs"]
mod common;

use common::pico::COILS;
use common::pico_rows::{
    ABOVE, BETWEEN_TURNS, COLUMNS, Case, Row, ULN_MOTORS, promised, rates, sinusoids, start, sweep, uln2003,
};
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_core::output::Sequence;

/// So long each rate is tried, s of the board's time; then the fastest once more, for longer.
const TRY_S: f64 = 0.05;
const LONG_S: f64 = 0.5;
/// Variations run so long.
const SHORT_S: f64 = 0.1;

fn main() {
    println!("promised\t{}", COLUMNS.join("\t"));
    if std::env::args().any(|argument| argument == "hour") {
        return sweep(3600).iter().for_each(|row| show(row, true));
    }
    let pico = VirtualPico::on_usb();
    for case in promised() {
        show(&case.row(&pico, ABOVE * case.required.unwrap_or(0.0), LONG_S), true);
    }
    show(&sinusoids(624e3, 1), true);
    // Each number of motors, for the table of boards.
    for motors in 1..=8 {
        let case = Case::changing(motors, "TMC2209");
        let row = case.fastest(&pico, &rates("TMC2209"), TRY_S, SHORT_S);
        show(&row, false);
        // The speed swings: so long is the interval on the whole.
        limit("SHORTEST", motors, &row, 1);
        let row = Case::turning(motors, "TMC2209").fastest(&pico, &rates("TMC2209"), TRY_S, SHORT_S);
        show(&row, false);
        limit("SEGMENT", motors, &row, BETWEEN_TURNS);
    }
    for motors in 1..=usize::from(ULN_MOTORS) {
        let row = Case { figure: 3, ..Case::changing(motors, COILS) }.fastest(&pico, &rates(COILS), TRY_S, SHORT_S);
        show(&row, false);
        limit("COILS", motors, &row, 1);
    }
    for motors in [1, 2, 4, 8] {
        show(&Case::changing(motors, "A4988").fastest(&pico, &rates("A4988"), TRY_S, SHORT_S), false);
    }
    let eight = Case::changing(8, "TMC2209");
    for case in [
        Case { swing: 0.0, ..eight },
        Case { steps: 60, ..eight },
        Case { steps: 250, ..eight },
        Case { steps: 2000, ..eight },
        Case { turns: 5, ..eight },
        Case { apart: 0.0, ..eight },
    ] {
        show(&case.fastest(&pico, &rates("TMC2209"), TRY_S, SHORT_S), false);
    }
    show(&start().row(&pico, 100e3, SHORT_S), true);
    for sequence in [Sequence::Wave, Sequence::Full, Sequence::Half] {
        for rate in [1000, 50_000] {
            // The first is what 28BYJ-48 motors do at most.
            show(&uln2003(&pico, sequence, rate), rate == 1000);
        }
    }
    sweep(10).iter().for_each(|row| show(row, true));
    for share in [0.0001, 0.1, 0.25, 0.5, 0.75, 1.0] {
        for case in promised() {
            let rate = share * case.required.unwrap_or(0.0);
            show(&Case { figure: 5, required: None, ..case }.row(&pico, rate, SHORT_S), false);
        }
    }
}

/// For the table of boards: what so many steps of each of so many motors take at least, ticks.
fn limit(table: &str, motors: usize, row: &Row, steps: u32) {
    println!("limit\t{table}\t{motors}\t{}", (125e6 * f64::from(steps) / row.reached).ceil());
}

fn show(row: &Row, is_promised: bool) {
    println!("{is_promised}\t{}", row.fields().join("\t"));
}
