//! The Uno's figures, in cycles of the emulated chip. `cargo xtask bench uno` collects them.
//!
//! Prints a table with tabs between the fields. The first field says whether the row is promised, or is a limit for the
//! table of boards. Arguments:
//! - `hour`: the hour of the sweep article's four motors instead
//! - `figure-2`: only that figure
//! - `rates`: the rates of motions, too
//! - `motions` and a number of seeds: how fast whole motions run, and what `plan` accepts of them
//! - `pulse` and ticks: the rates of variations with such pulses, and their limits
#![allow(clippy::disallowed_methods, reason = "benches open their own files")]

#[path = "../tests/it/common/mod.rs"]
mod common;

use common::motions::{Cell, SORTS, Sort};
use common::rows::{
    CHANGING, COLUMNS, Case, LONGER_PULSES, Row, TUTORIALS, fastest_plateau, hour, rates, tutorial_row, variations,
};
use common::uno::kind_of;
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::boards::uno::PinKind;
use pulsetrain_testkit::TICK_HZ;
use std::thread;

/// How long each rate is tried, s of the board's time. The fastest rate that holds is tried again for longer.
const TRY_S: f64 = 0.4;
const LONG_S: f64 = 4.0;
/// A limit is the fastest rate that held, divided by this margin.
const MARGIN: f64 = 1.025;
/// Limits of the table of boards are tried with this many other random segments, each for this time.
const SEEDS: u64 = 40;
const SEED_S: f64 = 2.0;
/// How long a variation runs.
const SHORT_S: f64 = 1.0;

/// Neighbouring rates of motions differ by this share.
const RUNG: f64 = 0.05;

fn main() {
    if let Some(seeds) = std::env::args().skip_while(|argument| argument != "motions").nth(1) {
        return motions(seeds.parse().expect("a number of seeds"));
    }
    println!("promised\t{}", COLUMNS.join("\t"));
    if std::env::args().any(|argument| argument == "hour") {
        return hour(3600).iter().for_each(|row| println!("{}", line(row)));
    }
    let pulse = std::env::args().skip_while(|argument| argument != "pulse").nth(1);
    let lines = if let Some(ticks) = pulse.and_then(|ticks| ticks.parse().ok()) {
        of_pulse(ticks)
    } else if std::env::args().any(|argument| argument == "figure-2") {
        figure_2()
    } else if std::env::args().any(|argument| argument == "rates") {
        fastest()
    } else {
        figures()
    };
    lines.iter().for_each(|line| println!("{line}"));
}

/// Prints figure 8: whole motions. Each row is printed as soon as it is known.
fn motions(seeds: u64) {
    println!("promised\tfigure\tmotion\tbaud\t1 motor\t2 motors\t3 motors\t4 motors\tthe next rate");
    for baud in [Baud::B1M, Baud::B115200] {
        for sort in SORTS {
            let cells = thread::scope(|scope| {
                let cells = [1, 2, 3, 4].map(|motors| scope.spawn(move || sort.cell(motors, baud, seeds, RUNG)));
                cells.map(|cell| cell.join().expect("a cell of the row"))
            });
            println!("{}", motions_line(&sort, baud, &cells));
        }
    }
}

/// For each cell: the rate that runs and the rate that `plan` accepts, steps/s.
fn motions_line(sort: &Sort, baud: Baud, cells: &[Cell; 4]) -> String {
    let k = |rate: f64| format!("{:.1}", rate / 1e3);
    let texts = cells.iter().map(|cell| format!("{} / {}", k(cell.runs), k(cell.accepted)));
    let next = (1..).zip(cells).filter(|(_, cell)| !cell.why.is_empty());
    let next: Vec<_> = next.map(|(motors, cell)| format!("{motors} motors: {}", cell.why)).collect();
    let texts: Vec<_> = texts.collect();
    format!("false\t8\t{}\t{}\t{}\t{}", sort.name(), baud.rate(), texts.join("\t"), next.join("; "))
}

/// Prints figure 2 alone, with a case on each core.
fn figure_2() -> Vec<String> {
    let rates = rates();
    thread::scope(|scope| {
        let cases = CHANGING.map(|case| {
            scope.spawn({
                let rates = &rates;
                move || line(&case.fastest(rates, TRY_S, LONG_S))
            })
        });
        cases.map(|case| case.join().expect("the row of a case")).into()
    })
}

/// Prints the variations with pulses of so many ticks, with a case on each core, and their limits for the table of
/// boards.
fn of_pulse(ticks: u16) -> Vec<String> {
    let rates = rates();
    let longer = variations().into_iter().filter(|case| case.pulse_ticks == LONGER_PULSES[0]);
    let cases = longer.map(|case| Case { pulse_ticks: ticks, ..case });
    let measured: Vec<(Case, Row)> = thread::scope(|scope| {
        let cases = cases.map(|case| {
            (
                case,
                scope.spawn({
                    let rates = &rates;
                    move || case.fastest(rates, TRY_S, SHORT_S)
                }),
            )
        });
        let cases: Vec<_> = cases.collect();
        cases.into_iter().map(|(case, row)| (case, row.join().expect("the row of a case"))).collect()
    });
    measured.iter().map(|(_, row)| line(row)).chain(limits(&measured)).collect()
}

/// Prints the fastest rates alone.
fn fastest() -> Vec<String> {
    let rates = rates();
    figure_2().into_iter().chain(CHANGING.iter().map(|case| line(&fastest_plateau(case, &rates)))).collect()
}

fn figures() -> Vec<String> {
    let mut lines = Vec::new();
    for tutorial in TUTORIALS {
        lines.push(line(&tutorial_row(tutorial, 1000, true)));
        // The pulses are those of the example files. The longest period runs once.
        if tutorial.0 == (500, 1) {
            continue;
        }
        let own_ns = if tutorial.0 == (1, 10) { 3000 } else { 10_000 };
        lines.push(line(&tutorial_row(tutorial, own_ns, false)));
    }
    let (rates, mut measured) = (rates(), Vec::new());
    let cases = CHANGING.into_iter().map(|case| (case, LONG_S));
    for (case, longer) in cases.chain(variations().into_iter().map(|case| (case, SHORT_S))) {
        let row = case.fastest(&rates, TRY_S, longer);
        lines.push(line(&row));
        measured.push((case, row));
    }
    lines.extend(CHANGING.iter().map(|case| line(&fastest_plateau(case, &rates))));
    lines.extend(limits(&measured));
    lines.extend(CHANGING.iter().map(|case| line(&case.others(SEEDS, SEED_S))));
    for case in CHANGING {
        for share in [0.1, 0.25, 0.5, 1.0] {
            lines.push(line(&Case { figure: 5, ..case }.row(share * case.limit_hz(), SHORT_S)));
        }
    }
    lines
}

/// Prints the limits for the table of boards.
fn limits(measured: &[(Case, Row)]) -> impl Iterator<Item = String> {
    // Motors in phase do not limit the rates, but with them the board commits itself farthest ahead.
    let horizon = measured.iter().filter_map(|(_, row)| row.seen.as_ref()).map(|seen| seen.horizon_ticks).max();
    let limits = measured.iter().filter(|(case, _)| case.is_limit());
    limits.filter_map(move |(case, row)| limit(case, row, horizon.unwrap_or(0)))
}

/// A limit for the table of boards: the board's name, how the edges are made, motors; pulse, shortest interval,
/// lateness and horizon in ticks; bytes of its queues.
fn limit(case: &Case, row: &Row, horizon: u64) -> Option<String> {
    let seen = row.seen.as_ref().filter(|_| !row.verdict.starts_with("FAILS"))?;
    let by = match kind_of(&case.pins[..case.motors]) {
        PinKind::Compare => "compare",
        PinKind::PortD if case.motors == 2 => "pair",
        _ => "software",
    };
    let late = seen.lateness.max_ticks.max(-seen.lateness.min_ticks);
    // A rate slower than the one that held: other random segments, and longer runs, may coincide worse.
    let interval = (MARGIN * TICK_HZ as f64 / row.asked).ceil() as u64;
    Some(format!(
        "limit\tuno\t{by}\t{}\t{}\t{interval}\t{late}\t{}\t{}",
        case.motors, case.pulse_ticks, horizon, seen.queue_bytes
    ))
}

fn line(row: &Row) -> String {
    format!("{}\t{}", row.is_required, row.fields().join("\t"))
}
