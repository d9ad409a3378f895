//! Faults: what a board does, and what its host reports, when something goes wrong. This test makes the table of
//! docs/faults.md.
//!
//! Each case is a whole run of a short motion like that of `pulsetrain run`, on the virtual Uno or the virtual Pico, in
//! emulated time. A usual run tries some of the places, by a seed that it prints. `PULSETRAIN_ROUNDS=n` tries n times
//! as many, up to all; `PULSETRAIN_FAULT=text` only faults whose names contain the text, if they have more than one
//! place.

mod bench;
mod line;
mod table;
mod text;

use bench::{Bench, Chip, Moved};
use expect_test::expect_file;
use line::{Fault, Mishap, Way};
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_testkit::seed::{rounds, seed};
use pulsetrain_testkit::winch::Wired;
use std::ops::Range;
use std::time::Duration;
use table::Row;

/// The test writes the part of docs/faults.md below this line.
const MARK: &str = "<!-- From here on written by `cargo xtask golden`. -->\n";

/// The seed of the page.
const OWN_SEED: u64 = 1;

/// How much is tried.
#[derive(Clone, Copy)]
struct Tried {
    /// It decides on the first place.
    seed: u64,
    /// Of the bytes of the short session, one in so many of those that [`bytes`] names is tried.
    one_in: u64,
    /// At most so many places of any other fault, in each round.
    most: u64,
}

/// A change waits for these: each kind of fault at a place.
const GATE: Tried = Tried { seed: OWN_SEED, one_in: 96, most: 1 };
/// Those of the page.
const PAGE: Tried = Tried { seed: OWN_SEED, one_in: 1, most: u64::MAX };

/// The rows of both boards.
fn both(tried: Tried) -> [Vec<Row>; 2] {
    std::thread::scope(|scope| {
        let boards = [
            scope.spawn(move || rows(&VirtualUno::new(), &VirtualUno::with_winch(), tried)),
            scope.spawn(move || rows(&VirtualPico::on_usb(), &VirtualPico::on_usb(), tried)),
        ];
        boards.map(|rows| rows.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })
}

/// All kinds of faults, at some of the places.
#[test]
fn each_kind_of_fault_is_met() {
    let page = include_str!("../../../../../docs/faults.md");
    let said = format!("`cargo xtask test` one byte in {})", GATE.one_in);
    assert!(page.contains(&said), "the page has another number");
    let [uno, pico] = both(Tried { seed: seed(OWN_SEED), ..GATE });
    assert_eq!(uno.len(), pico.len());
}

/// Three minutes: each byte of a session, on both boards.
mod long {
    use super::*;

    #[test]
    fn every_fault_is_met_as_docs_faults_md_says() {
        let seed = seed(OWN_SEED);
        let boards = both(Tried { seed, ..PAGE });
        if (seed, rounds()) != (OWN_SEED, 1) || wanted().is_some() {
            // Other places may give other messages, but the behaviour is checked all the same.
            return;
        }
        let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/faults.md");
        let page = std::fs::read_to_string(page).expect("the page is there");
        let (head, _) = page.split_once(MARK).expect("the mark is there");
        expect_file!["../../../../../docs/faults.md"].assert_eq(&format!("{head}{MARK}\n{}", table::markdown(&boards)));
    }
}

/// For a board that plays plans, and a board that reads text.
fn rows<P: Chip + Wired>(fresh: &P, textual: &P, tried: Tried) -> Vec<Row> {
    let bench = Bench::new(fresh.clone());
    let short = Bench::short(fresh.clone());
    let mut rows = bytes(&short, &bench, tried);
    rows.extend(lines(&bench, tried));
    rows.extend(hosts(&bench, tried));
    rows.extend(boards(&bench, tried));
    rows.extend(text::rows(textual, tried));
    rows
}

/// The text in the names of the wanted faults.
fn wanted() -> Option<String> {
    std::env::var("PULSETRAIN_FAULT").ok()
}

/// Some of the places of a fault: `few` times the number of rounds, at even distances, from a place on that depends on
/// the seed. No place of a fault that is not wanted.
fn some(fault: &str, places: u64, few: u64, tried: Tried) -> impl Iterator<Item = u64> + use<> {
    let (seed, few) = (tried.seed, few.min(tried.most));
    let stride = (places / (few * rounds())).max(1);
    let end = if wanted().is_none_or(|wanted| fault.contains(&wanted)) { places } else { 0 };
    (0..end).skip((seed.wrapping_mul(0x9e37_79b9) % stride) as usize).step_by(stride as usize)
}

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// Wrong bytes in both directions: of a short session one in so many of all, each with one of the four faults; and a
/// few of a long session.
fn bytes<P: Chip>(short: &Bench<P>, long: &Bench<P>, tried: Tried) -> Vec<Row> {
    const MISHAPS: [&str; 4] = ["lost", "with a bit changed", "doubled", "swapped with the next"];
    // Fewer of the long session, since its runs take longer.
    let Tried { seed, one_in, .. } = tried;
    let few = 4_u64.div_ceil(one_in);
    let mut rows = Vec::new();
    for (way, name) in [(Way::ToBoard, "to the board"), (Way::ToHost, "to the host")] {
        for (turn, what) in (0..).zip(MISHAPS) {
            let fault = format!("a byte {name} {what}");
            // Their number depends on the firmware's timing.
            let mut row = Row::new(fault.as_str(), P::NAME, "each byte of two sessions", Moved::AsPlanned);
            let (all, places) = (short.line.gone(way), long.line.gone(way));
            let of_short = Tried { seed: seed.wrapping_add(turn), most: u64::MAX, ..tried };
            let of_short = some(&fault, all, all / (one_in * MISHAPS.len() as u64), of_short).map(|at| (short, at));
            for (bench, at) in of_short.chain(some(&fault, places, few, tried).map(|at| (long, at))) {
                let mishap = match what {
                    "lost" => Mishap::Dropped,
                    "with a bit changed" => Mishap::Flipped((seed.wrapping_add(at.wrapping_mul(5)) % 8) as u8),
                    "doubled" => Mishap::Doubled,
                    _ => Mishap::Swapped,
                };
                let fault = Fault::Byte { way, at, mishap };
                row.add(&bench.run(fault).0, fault);
            }
            rows.push(row);
        }
    }
    rows
}

/// Until this time after its first step the host still sends parts of the motion, ms.
const UNTOLD: u64 = 650;
/// From this time on the host has sent the whole motion, ms.
const TOLD: u64 = 1000;
/// While motor a reverses, its segments are so many that its share of an Uno's queue lasts less than 100 ms and the
/// time to catch up.
const DENSE: Range<u64> = 590..770;

/// How the motors move if the host sends nothing for 100 ms from one of these milliseconds on.
fn when_dense<P: Chip>() -> Moved {
    if P::NAME == "uno" { Moved::AsQueued } else { Moved::AsPlanned }
}

/// Tries a fault at some milliseconds of a stretch of the motion, ms from its first step on.
fn at_moments<P: Chip>(
    bench: &Bench<P>,
    row: (String, Range<u64>, Moved),
    few: u64,
    tried: Tried,
    fault: impl Fn(Duration) -> Fault,
) -> Row {
    let (name, stretch, moved) = row;
    let places = stretch.end - stretch.start;
    let places_tried = some(&name, places, few, tried);
    let mut row = Row::new(name, P::NAME, format!("{places} moments, 1 ms apart"), moved);
    for (count, after) in places_tried.enumerate() {
        let at = bench.line.time_of(bench.first) + ms(stretch.start + after);
        try_at(bench, &mut row, fault(at), count == 0);
    }
    row
}

fn try_at<P: Chip>(bench: &Bench<P>, row: &mut Row, fault: Fault, again: bool) {
    let (seen, line) = bench.run(fault);
    row.add(&seen, fault);
    if seen.error.is_some() {
        bench.check_next(&seen, &line, again);
    }
}

/// Faults of the line: silence, noise, cables.
fn lines<P: Chip>(bench: &Bench<P>, tried: Tried) -> Vec<Row> {
    let length = bench.length_ms();
    let silence = |name: &str, lasts: u64, stretch, moved, few| {
        let fault = |from| Fault::Silence { from, lasts: ms(lasts) };
        at_moments(bench, (format!("the line silent for {name}"), stretch, moved), few, tried, fault)
    };
    let mut rows = vec![
        silence("1 ms", 1, 0..length, Moved::AsPlanned, 2),
        silence("100 ms", 100, 0..DENSE.start, Moved::AsPlanned, 4),
        silence("100 ms, while a motor turns", 100, DENSE, when_dense::<P>(), 2),
        silence("100 ms, after that", 100, DENSE.end..length, Moved::AsPlanned, 2),
        silence("1 s", 1000, 0..UNTOLD, Moved::Tail, 2),
        silence("10 s", 10_000, 0..UNTOLD, Moved::Tail, 1),
        silence("good", 1_000_000, 0..UNTOLD, Moved::Tail, 1),
        silence("good, after the whole plan was sent", 1_000_000, TOLD..length, Moved::AsPlanned, 1),
    ];
    let unplugged = |from| Fault::Unplugged { from };
    let name = "the port gone from the computer".to_owned();
    rows.push(at_moments(bench, (name.clone(), 0..UNTOLD, Moved::Tail), 4, tried, unplugged));
    let late = format!("{name}, after the whole plan was sent");
    rows.push(at_moments(bench, (late, TOLD..length, Moved::AsPlanned), 1, tried, unplugged));

    let edges: Vec<u64> =
        bench.ticks().into_iter().filter(|tick| *tick < bench.first + bench.ticks_of(UNTOLD)).collect();
    let name = format!("{name} as a step is made");
    let steps = some(&name, edges.len() as u64, 4, tried);
    let mut row = Row::new(name, P::NAME, format!("{} steps", edges.len()), Moved::Tail);
    for place in steps {
        try_at(bench, &mut row, unplugged(bench.line.time_of(edges[place as usize])), false);
    }
    rows.push(row);

    let burst = |bytes| move |at| Fault::Burst { at, bytes };
    for bytes in [200, 2000] {
        let name = format!("{bytes} bytes of noise");
        rows.push(at_moments(bench, (name, 0..length, Moved::AsPlanned), 2, tried, burst(bytes)));
    }
    let mut row = Row::new("an adapter that stays at 115 200 baud", P::NAME, "once", Moved::AsPlanned);
    row.add(&bench.run(Fault::Stuck).0, Fault::Stuck);
    rows.push(row);
    rows
}

/// Faults of the host, and other programs.
fn hosts<P: Chip>(bench: &Bench<P>, tried: Tried) -> Vec<Row> {
    let length = bench.length_ms();
    let stall = |name: &str, lasts: u64, stretch, moved, few| {
        let fault = |at| Fault::Stall { at, lasts: ms(lasts) };
        at_moments(bench, (format!("the host stalled for {name}"), stretch, moved), few, tried, fault)
    };
    let mut rows = vec![
        stall("1 ms", 1, 0..length, Moved::AsPlanned, 2),
        stall("100 ms", 100, 0..DENSE.start, Moved::AsPlanned, 4),
        stall("100 ms, while a motor turns", 100, DENSE, when_dense::<P>(), 2),
        stall("100 ms, after that", 100, DENSE.end..length, Moved::AsPlanned, 2),
        stall("1 s", 1000, 0..UNTOLD, Moved::Tail, 2),
        stall("10 s", 10_000, 0..UNTOLD, Moved::Tail, 2),
    ];
    let hello = |at| Fault::Hello { at };
    rows.push(at_moments(bench, ("another host says Hello".to_owned(), 0..length, Moved::AsPlanned), 2, tried, hello));
    let opened = |at| Fault::Opened { at };
    let moved = if P::NAME == "uno" { Moved::Halted } else { Moved::AsPlanned };
    rows.push(at_moments(bench, ("another program opens the port".to_owned(), 0..UNTOLD, moved), 2, tried, opened));
    for (look, moved) in [(5, Moved::AsPlanned), (20, Moved::AsPlanned), (1500, Moved::Tail)] {
        let slow = |from| Fault::Slow { from, look: ms(look) };
        let name = format!("a slow host: it looks at the line every {look} ms");
        rows.push(at_moments(bench, (name, 0..UNTOLD / 2, moved), 1, tried, slow));
    }
    rows
}

/// Faults of the board, and of files.
fn boards<P: Chip>(bench: &Bench<P>, tried: Tried) -> Vec<Row> {
    let hung = |at| Fault::Hung { at };
    let name = "its program hangs: the watchdog restarts it after 1 s".to_owned();
    let mut rows = vec![at_moments(bench, (name, 0..UNTOLD, Moved::Halted), 1, tried, hung)];

    let mut row = Row::new("its clock 0.5 % fast, or slow", P::NAME, "both", Moved::AsPlanned);
    for ppm in [5000, -5000] {
        row.add(&bench.run_on(bench.skewed(ppm)), ppm);
    }
    rows.push(row);

    let mut row = Row::new("the motion file written over, and removed", P::NAME, "once", Moved::AsPlanned);
    row.add(&bench.run_without_file(), ());
    rows.push(row);

    let mut row = Row::new("the disk full as the trace is written", P::NAME, "3 sizes", Moved::AsPlanned);
    for bytes in [2000, 5000, 10_000] {
        let (seen, said) = bench.run_on_full_disk(bytes);
        row.add_as(&seen, bytes, &said);
    }
    rows.push(row);
    rows
}
