//! Rings that run dry: what the board says that it made is what its pins show, whatever bits of a port its STEP lines are.

use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Remote};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::Cause;
use pulsetrain_testkit::segments::{Law, Stream};
use pulsetrain_testkit::{TICK_HZ, uno_setup};

/// Far more than a board keeps up with, steps/s of all motors together.
const RATE: f64 = 240_000.0;
/// Each with so many random laws.
const SEEDS: u64 = 20;

/// Merged, on one port and on two, also with DIR below STEP; and a ring each.
const PINS: [&[(u8, u8)]; 7] = [
    &[(2, 5), (3, 6), (4, 7)],
    &[(8, 11), (9, 12), (10, 13)],
    &[(2, 5), (3, 6), (4, 7), (12, 13)],
    &[(2, 5), (3, 6)],
    &[(5, 2), (6, 3), (7, 4)],
    &[(13, 8), (12, 9), (11, 10)],
    &[(9, 8), (10, 7)],
];

/// Whether it ran dry.
fn starves(pins: &[(u8, u8)], seed: u64) -> bool {
    let mut board = Remote::open(VirtualUno::new(), 7).expect("it answers");
    board.set_baud(Baud::B1M).expect("it changes");
    board.configure(&uno_setup(pins, 16)).expect("it takes the pins");
    let laws = vec![Law::changing(RATE / pins.len() as f64); pins.len()];
    let mut stream = Stream::new(&board, &laws, 1.0, seed, TICK_HZ / 5);
    let mut counts = vec![0_i64; pins.len()];
    let mut edges = |edge: Edge| {
        if let Some(motor) = pins.iter().position(|(step, _)| *step == edge.line)
            && edge.level
        {
            counts[motor] += 1;
        }
    };
    let lost = |board: &Remote<_>| board.error().map_or(Ok(()), |error| Err(error.to_string()));
    // The board stops on the way, and refuses what comes then.
    stream.play(&mut board, &mut edges, |_, board| lost(board)).expect_err("it is too fast");
    let until = board.now() + TICK_HZ / 10;
    board.advance(until, &mut edges);
    let dry = board.events().iter().any(|event| event.cause == Cause::Starved);
    // What was on its way is refused first.
    let (_, said) = (0..50).find_map(|_| board.stop_motors().ok()).expect("it answers in the end");
    assert_eq!(said, counts, "pins {pins:?}, seed {seed}: what it counted, and the pins");
    dry
}

#[test]
fn what_ran_dry_is_counted() {
    for pins in PINS {
        let dry = (1..=SEEDS).filter(|seed| starves(pins, *seed)).count();
        println!("{pins:?}: {dry} of {SEEDS} ran dry");
        assert!(dry > 0, "{pins:?}");
    }
}
