//! The Pico's figures, in cycles of the emulated chip. `cargo xtask bench pico` collects them.
//!
//! Prints a table with tabs between the fields. The first field says whether the row is promised, or is a limit for the
//! table of boards. With the argument `hour` it prints an hour of the sweep article's four motors, twice; with a number
//! behind `hour`, that many seconds.
#![allow(clippy::disallowed_methods, reason = "benches open their own files")]

#[path = "../tests/it/common/mod.rs"]
mod common;

use common::pico::COILS;
use common::pico_rows::{
    ABOVE, BETWEEN_TURNS, COLUMNS, Case, IN_SHORT, Row, ULN_MOTORS, promised, rates, sinusoids, start, sweep, uln2003,
};
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_core::output::Sequence;

/// How long each rate is tried, s of the board's time. The fastest rate that holds is tried again for longer.
const TRY_S: f64 = 0.05;
/// Figures that are promised, and limits that hold for ever.
const LONG_S: f64 = 0.5;
/// Variations; and how fast the board is while its queues last, which are full at the beginning.
const SHORT_S: f64 = 0.1;

fn main() {
    println!("promised\t{}", COLUMNS.join("\t"));
    let mut arguments = std::env::args();
    if arguments.any(|argument| argument == "hour") {
        let seconds = arguments.find_map(|argument| argument.parse().ok()).unwrap_or(3600);
        return sweep(seconds).iter().for_each(|row| show(row, true));
    }
    let pico = VirtualPico::on_usb();
    for case in promised() {
        show(&case.row(&pico, ABOVE * case.required.unwrap_or(0.0), LONG_S), true);
    }
    show(&sinusoids(624e3, 1), true);
    // For the table of boards, with each number of motors.
    for motors in 1..=8 {
        limit("SHORTEST", motors, shortest(1, LONG_S, Case::changing(motors, "TMC2209")));
        let queued_and_heard = |steps, case| [SHORT_S, LONG_S].map(|seconds| shortest(steps, seconds, case));
        let [onward, onward_heard] = queued_and_heard(IN_SHORT, Case::short(motors, "TMC2209"));
        let [turning, turning_heard] = queued_and_heard(BETWEEN_TURNS, Case::turning(motors, "TMC2209"));
        limit("ONWARD", motors, onward);
        limit("TURNING", motors, turning);
        limit("HEARD", motors, (onward_heard - onward).max(turning_heard - turning).max(0.0));
    }
    for motors in 1..=usize::from(ULN_MOTORS) {
        limit("COILS", motors, shortest(1, LONG_S, Case { figure: 3, ..Case::changing(motors, COILS) }));
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
            // The first rate is the highest of 28BYJ-48 motors.
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

/// The least time on average that a number of steps of each motor takes, ticks, when speeds and lengths swing, over a
/// run of the given length.
fn shortest(steps: u32, seconds: f64, case: Case) -> f64 {
    let row = case.fastest(&VirtualPico::on_usb(), &rates(case.driver), TRY_S, seconds);
    show(&row, false);
    assert!(row.holds(), "no rate holds, so there is no limit to print");
    125e6 * f64::from(steps) / row.reached
}

/// Prints a limit for the table of boards.
fn limit(table: &str, motors: usize, ticks: f64) {
    println!("limit\t{table}\t{motors}\t{}", ticks.ceil());
}

fn show(row: &Row, is_promised: bool) {
    println!("{is_promised}\t{}", row.fields().join("\t"));
}
