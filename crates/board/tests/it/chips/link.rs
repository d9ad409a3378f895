//! The link to the firmware by a line that has faults, on each virtual board and each of its lines: the edges are those of a clean run.

use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Remote, Setup, VirtualBoard};
use pulsetrain_core::output::Sequence;
use pulsetrain_core::wire::Baud;
use pulsetrain_testkit::faulty::{Faulty, Rates};
use pulsetrain_testkit::pico::{coils, step_dir};
use pulsetrain_testkit::seed::seeds;
use pulsetrain_testkit::segments::{Chip, Law, Stream};
use pulsetrain_testkit::uno_setup;

/// An edge: its tick from the beginning of the motion on, its line, its level.
type Made = (u64, u8, bool);

/// A board, with a motion that its queues hold for hundreds of milliseconds at any rate of its line.
pub(super) trait Linked: VirtualBoard + Clone {
    const CHIP: Chip;
    /// The speeds of its motors.
    const LAWS: &[Law];
    /// An edge may come so much earlier or later than in a clean run, ticks.
    const OFF: u64;

    /// A fresh board at each of its lines, with the rates that are tried there.
    fn lines() -> Vec<(Self, Baud)>;

    fn setup() -> Setup;

    /// Whether a line is a motor's.
    fn is_motors(line: u8) -> bool;

    /// A motion of 2 s was made.
    fn check_clean(edges: &[Made]);
}

impl Linked for VirtualUno {
    const CHIP: Chip = Chip::UNO;
    const LAWS: &[Law] = &[Law::changing(2000.0)];
    // The receive interrupt may keep an edge waiting.
    const OFF: u64 = 60;

    fn lines() -> Vec<(VirtualUno, Baud)> {
        [Baud::B115200, Baud::B1M].map(|baud| (VirtualUno::new(), baud)).into()
    }

    fn setup() -> Setup {
        uno_setup(&[(8, 9)], 16)
    }

    fn is_motors(_line: u8) -> bool {
        true
    }

    fn check_clean(edges: &[Made]) {
        let steps = edges.iter().filter(|edge| edge.1 == 8 && edge.2).count();
        assert!(steps > 3500, "{steps} steps");
    }
}

impl Linked for VirtualPico {
    /// Segments of some 50 ms at the speed of these tests.
    const CHIP: Chip = Chip { least_steps: 100, ..Chip::PICO };
    /// A driver and coils.
    const LAWS: &[Law] = &[Law::changing(4000.0), Law::changing(700.0)];
    const OFF: u64 = 0;

    fn lines() -> Vec<(VirtualPico, Baud)> {
        let uart = [Baud::B115200, Baud::B1M].map(|baud| (VirtualPico::new(), baud));
        uart.into_iter().chain([(VirtualPico::on_usb(), Baud::B1M)]).collect()
    }

    fn setup() -> Setup {
        Setup { pulse_ticks: 250, motors: vec![step_dir(2), coils(22, Sequence::Half)], ..Setup::default() }
    }

    /// Not that of the gate.
    fn is_motors(line: u8) -> bool {
        line != 25
    }

    fn check_clean(edges: &[Made]) {
        let steps = edges.iter().filter(|edge| edge.1 == 2 && edge.2).count();
        let patterns = edges.iter().filter(|edge| edge.1 != 2 && edge.1 != 3).count();
        assert!(steps > 6500 && patterns > 1000, "{steps} steps, {patterns} edges of coils");
    }
}

/// A board that is configured, at the end of a line without faults.
pub(super) fn connected<P: Linked>(port: P, baud: Baud, seed: u64) -> Remote<Faulty<P>> {
    let mut board = Remote::open(Faulty::new(port, seed), 7).expect("it answers");
    if baud != Baud::B115200 {
        assert_eq!(board.set_baud(baud), Ok(baud));
    }
    board.configure(&P::setup()).expect("it takes it");
    // The same beginning whatever the line does.
    board.advance(P::CHIP.tick_hz / 2, &mut |_: Edge| {});
    board
}

/// Streams for 2 s; the line is bad from the beginning of the motion on. Edges from there, and frames that were sent again.
fn stream<P: Linked>(port: P, baud: Baud, seed: u64, rates: Rates) -> (Vec<Made>, u64) {
    let mut board = connected(port, baud, seed);
    let mut stream = Stream::on(P::CHIP, &board, P::LAWS, 1.0, 5, 2 * P::CHIP.tick_hz);
    let (mut edges, begin) = (Vec::new(), stream.begin);
    let mut observer = |edge: Edge| {
        if edge.tick >= begin && P::is_motors(edge.line) {
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
    edges.sort_unstable();
    (edges, board.link().counts().repeated)
}

fn keeps_edges<P: Linked>() {
    for (place, (port, baud)) in P::lines().into_iter().enumerate() {
        let (clean, _) = stream(port.clone(), baud, 1, Rates::default());
        P::check_clean(&clean);
        let mut repeated = 0;
        for seed in seeds(1, 1) {
            let rates = Rates { drop: 60, flip: 60, delay: 60, duplicate: 60 };
            let (bad, again) = stream(port.clone(), baud, seed, rates);
            repeated += again;
            assert_eq!(bad.len(), clean.len(), "line {place}, seed {seed}, {baud:?}");
            for (bad, clean) in bad.iter().zip(&clean) {
                let is_same = bad.0.abs_diff(clean.0) <= P::OFF && (bad.1, bad.2) == (clean.1, clean.2);
                assert!(is_same, "line {place}, seed {seed}, {baud:?}: {bad:?}, not {clean:?}");
            }
        }
        assert!(repeated > 3, "line {place}, {baud:?}: no fault did anything");
    }
}

#[test]
fn a_bad_line_changes_no_edge() {
    keeps_edges::<VirtualUno>();
    keeps_edges::<VirtualPico>();
}
