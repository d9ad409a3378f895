//! The link to the firmware by a line that has faults: the edges are those of a clean run.

use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Remote};
use pulsetrain_core::wire::Baud;
use pulsetrain_testkit::faulty::{Faulty, Rates};
use pulsetrain_testkit::segments::{Law, Stream};
use pulsetrain_testkit::{TICK_HZ, uno_setup};

/// Streams for 2 s at `rate` steps/s; the line is bad from the beginning of the motion on. Edges from there, and frames that
/// were sent again.
fn stream(baud: Baud, rate: f64, seed: u64, rates: Rates) -> (Vec<(u64, u8, bool)>, u64) {
    let mut board = Remote::open(Faulty::new(VirtualUno::new(), seed), 7).expect("it answers");
    if baud != Baud::B115200 {
        assert_eq!(board.set_baud(baud), Ok(baud));
    }
    board.configure(&uno_setup(&[(8, 9)], 16)).expect("it takes it");
    // The same beginning whatever the line does.
    board.advance(TICK_HZ / 2, &mut |_: Edge| {});
    let mut stream = Stream::new(&board, &[Law::changing(rate)], 1.0, 5, 2 * TICK_HZ);
    let mut edges = Vec::new();
    let begin = stream.begin;
    let mut observer = |edge: Edge| {
        if edge.tick >= begin {
            edges.push((edge.tick - begin, edge.line, edge.level));
        }
    };
    let done = stream.play(&mut board, &mut observer, |_, board| {
        if board.now() >= begin {
            board.port_mut().set(rates);
        }
        board.error().map_or(Ok(()), |error| Err(error.to_string()))
    });
    assert_eq!(done, Ok(()), "seed {seed}, {baud:?}");
    (edges, board.link().counts().repeated)
}

#[test]
fn a_bad_line_changes_no_step() {
    for baud in [Baud::B115200, Baud::B1M] {
        // 2000 steps/s: what the queue holds lasts for hundreds of milliseconds.
        let (clean, _) = stream(baud, 2000.0, 1, Rates::default());
        let steps = clean.iter().filter(|edge| edge.1 == 8 && edge.2).count();
        assert!(steps > 3500, "{steps} steps");
        let mut repeated = 0;
        for seed in 1..=4 {
            let (bad, again) = stream(baud, 2000.0, seed, Rates { drop: 60, flip: 60, delay: 60, duplicate: 60 });
            repeated += again;
            assert_eq!(bad.len(), clean.len(), "seed {seed}, {baud:?}");
            for (bad, clean) in bad.iter().zip(&clean) {
                // The receive interrupt may keep an edge waiting.
                assert!(bad.0.abs_diff(clean.0) <= 60 && bad.1 == clean.1 && bad.2 == clean.2, "{bad:?} {clean:?}");
            }
        }
        assert!(repeated > 10, "{baud:?}: no fault did anything");
    }
}
