//! The Uno's figures, in cycles of the emulated chip: what `cargo xtask bench uno` collects.
//!
//! A table, fields between tabs, the first of which says whether the row is promised, or that it is a limit for the table of
//! boards. With the argument `hour` the hour of 001's four motors instead; with `rates` the fastest rates that are promised alone.

#[path = "../tests/it/common/mod.rs"]
mod common;

use common::rows::{COLUMNS, Case, PROMISED, Row, TUTORIALS, fastest_plateau, hour, rates, tutorial_row, variations};
use common::uno::kind_of;
use pulsetrain_motion::pins::PinKind;
use pulsetrain_testkit::TICK_HZ;
use pulsetrain_testkit::lab::Image;
use std::thread;

/// So long each rate is tried, s of the board's time; then the fastest once more, for longer.
const TRY_S: f64 = 0.4;
const LONG_S: f64 = 4.0;
/// Limits are so much slower than the fastest rate that held.
const MARGIN: f64 = 1.025;
/// With so many other random segments what is promised is tried again, for so long each.
const SEEDS: u64 = 40;
const SEED_S: f64 = 2.0;
/// Variations run so long.
const SHORT_S: f64 = 1.0;

fn main() {
    println!("promised\t{}", COLUMNS.join("\t"));
    if std::env::args().any(|argument| argument == "hour") {
        return hour(3600).iter().for_each(|row| println!("{}", line(row)));
    }
    let is_short = std::env::args().any(|argument| argument == "rates");
    // An image to a core.
    let lines = thread::scope(|scope| {
        let images =
            Image::ALL.map(|image| scope.spawn(move || if is_short { fastest(image) } else { figures(image) }));
        images.map(|image| image.join().expect("the figures of an image"))
    });
    lines.iter().flatten().for_each(|line| println!("{line}"));
}

/// What is promised of one of the images.
fn promised(image: Image) -> [Case; PROMISED.len()] {
    PROMISED.map(|case| case.on(image))
}

/// The fastest rates alone.
fn fastest(image: Image) -> Vec<String> {
    let (rates, cases) = (rates(), promised(image));
    let streamed = cases.iter().map(|case| case.fastest(&rates, TRY_S, LONG_S));
    streamed.chain(cases.iter().map(|case| fastest_plateau(case, &rates))).map(|row| line(&row)).collect()
}

fn figures(image: Image) -> Vec<String> {
    let mut lines = Vec::new();
    // What the tutorial asks for either image does: it is shown of the one that is there from the start.
    for tutorial in TUTORIALS.into_iter().filter(|_| image == Image::Plain) {
        lines.push(line(&tutorial_row(tutorial, 1000, true)));
        // The example files' own pulses; the longest period once is enough.
        if tutorial.0 == (500, 1) {
            continue;
        }
        let own_ns = if tutorial.0 == (1, 10) { 3000 } else { 10_000 };
        lines.push(line(&tutorial_row(tutorial, own_ns, false)));
    }
    let (rates, cases) = (rates(), promised(image));
    let mut measured = Vec::new();
    for case in cases.into_iter().chain(variations(image)) {
        let longer = if case.required.is_some() { LONG_S } else { SHORT_S };
        let row = case.fastest(&rates, TRY_S, longer);
        lines.push(line(&row));
        measured.push((case, row));
    }
    lines.extend(cases.iter().map(|case| line(&fastest_plateau(case, &rates))));
    // Motors in phase set no limit to rates, but the board commits itself farthest ahead with them.
    let horizon = measured.iter().filter_map(|(_, row)| row.seen.as_ref()).map(|seen| seen.horizon_ticks).max();
    let limits = measured.iter().filter(|(case, _)| case.is_limit());
    lines.extend(limits.filter_map(|(case, row)| limit(case, row, horizon.unwrap_or(0))));
    // What is promised is to hold whatever the segments.
    let others = cases.iter().filter(|case| case.image == Image::Stream);
    lines.extend(others.map(|case| line(&case.others(SEEDS, SEED_S))));
    for case in cases {
        for share in [0.1, 0.25, 0.5, 1.0] {
            let row = Case { figure: 5, ..case }.row(share * case.required.unwrap_or(0.0), SHORT_S);
            lines.push(line(&Row { required: String::new(), is_required: false, ..row }));
        }
    }
    lines
}

/// What the table of boards says of it: the board's name, how the edges are made, motors, pulse, shortest interval, lateness and
/// horizon, ticks; bytes of its queues.
fn limit(case: &Case, row: &Row, horizon: u64) -> Option<String> {
    // It may be less than what is promised, and is the limit all the same.
    let seen = row.seen.as_ref().filter(|_| !row.verdict.starts_with("FAILS"))?;
    let by = match kind_of(&case.pins[..case.motors]) {
        PinKind::Compare => "compare",
        PinKind::PortD if case.motors == 2 => "pair",
        _ => "software",
    };
    let late = seen.lateness.max_ticks.max(-seen.lateness.min_ticks);
    // A step of the ladder slower than what held: other random segments, and longer runs, may come together worse.
    let interval = (MARGIN * TICK_HZ as f64 / row.asked).ceil() as u64;
    Some(format!(
        "limit\t{}\t{by}\t{}\t{}\t{interval}\t{late}\t{}\t{}",
        case.image.board(),
        case.motors,
        case.pulse_ticks,
        horizon,
        seen.queue_bytes
    ))
}

fn line(row: &Row) -> String {
    format!("{}\t{}", row.is_required, row.fields().join("\t"))
}
