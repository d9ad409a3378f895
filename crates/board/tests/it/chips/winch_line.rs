//! The Uno's line under text: who has the board when frames come too, bytes that are lost, and lines as fast as the line takes
//! them while four axes run.

use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{LinkError, Port, PortError, Remote, RemoteError};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::Measures;
use pulsetrain_testkit::Random;
use pulsetrain_testkit::lab::address;
use pulsetrain_testkit::seed::{rounds, seed};
use pulsetrain_testkit::winch::Uno;

use std::time::Duration;

/// Words of the table of interrupts' vectors, without the reset's.
const VECTORS: std::ops::Range<u16> = 2..52;

/// Every command, with a value that does no harm.
const VERBS: [&str; 13] = [
    "a x 5",
    "d x 5",
    "v x 5",
    "r x 5",
    "s x 5",
    "g x 1 1",
    "l x 100 100",
    "enable 0",
    "srate 100",
    "deadman 0",
    "strict 0",
    "version",
    "ping",
];

/// Runs the chip alone for so many microseconds.
fn run_us(uno: &mut Uno, us: u64) {
    let until = uno.port.now() + Duration::from_micros(us);
    let mut bytes = Vec::new();
    while uno.port.now() < until {
        uno.port.receive(until, &mut bytes).expect("it is virtual");
    }
    uno.port.edges(&mut uno.edges);
}

/// What the firmware has measured since its start, asked by frames: text must have given the board free.
fn measures(uno: &Uno) -> Measures {
    Remote::open(uno.port.clone(), 5).expect("it is free").measures(false).expect("it answers")
}

/// Where the image has a jump to itself.
fn forever() -> u16 {
    address(include_str!("../../../../../testdata/uno-winch.sym"), "end_of_program_loop")
}

/// The next interrupt takes so many cycles more, and keeps all others out: the processor waits at its vector.
///
/// Not by clearing the flag I at some cycle: what saves the flags just then, and writes them back, would keep it cleared for ever, which
/// nothing real does that holds interrupts out.
fn hold_at_a_vector(uno: &mut Uno, cycles: u64) {
    let forever = forever();
    let chip = uno.port.chip_mut();
    loop {
        let stack = chip.sp();
        chip.step(&mut ());
        if VECTORS.contains(&chip.pc()) && chip.sp() < stack {
            break;
        }
    }
    let vector = chip.pc();
    chip.set_pc(forever);
    let until = chip.cycle() + cycles;
    while chip.cycle() < until {
        chip.step(&mut ());
    }
    assert_eq!(chip.pc(), forever, "no interrupt came between");
    chip.set_pc(vector);
}

/// The main loop stands still, in a loop of its own, as long as `work` takes; interrupts go on. The board is asleep.
fn without_main(uno: &mut Uno, work: impl FnOnce(&mut Uno)) {
    let forever = forever();
    while !uno.port.chip().is_asleep() {
        uno.port.chip_mut().step(&mut ());
    }
    let main = uno.port.chip().pc();
    uno.port.chip_mut().set_pc(forever);
    work(uno);
    while uno.port.chip().pc() != forever {
        uno.port.chip_mut().step(&mut ());
    }
    uno.port.chip_mut().set_pc(main);
}

#[test]
fn text_is_read_from_the_start() {
    // As early as the USART takes a byte: a client that opens the port does not wait.
    let mut uno = Uno { port: VirtualUno::with_winch(), edges: Vec::new(), lines: Vec::new(), partial: Vec::new() };
    while uno.port.zero().is_none() {
        run_us(&mut uno, 50);
    }
    uno.send("version\nd x 5\n");
    uno.run_ms(500);
    let said: Vec<_> = uno.lines.iter().map(|line| &line.text[..]).filter(|text| !text.starts_with("txyza")).collect();
    assert_eq!(said, ["awake", "id StepperWinch Nov 21 2026"]);
    assert!(uno.steps(0).len() > 3);
}

#[test]
fn a_line_that_enables_has_the_board_at_once() {
    // Hello right behind the line, and up to 8 ms later.
    for us in (0..8000).step_by(250) {
        let mut uno = Uno::new();
        uno.run_ms(7);
        uno.send("enable 1\n");
        if us != 0 {
            run_us(&mut uno, us);
        }
        let opened = Remote::open(uno.port.clone(), 9);
        assert!(matches!(opened, Err(RemoteError::Link(LinkError::Taken))), "{us} us: {:?}", opened.map(drop));
    }
}

#[test]
fn lines_before_a_zero_are_obeyed_once() {
    // Fewer than frames take in a round, more, and nearly all that the page has; after frames were seen, too.
    for (lines, quiet) in [(3, false), (10, false), (17, false), (3, true), (10, true), (17, true)] {
        let mut uno = Uno::new();
        uno.send("l x 10000 250000\ng x 5 1\n");
        uno.run_ms(20);
        if quiet {
            uno.send([0]);
            uno.run_ms(5);
        }
        without_main(&mut uno, |uno| {
            uno.send("d x 10\n".repeat(lines));
            uno.send([0]);
            run_us(uno, 2000 + 87 * 7 * (lines as u64 + 2));
        });
        uno.run_ms(3000);
        // A zero makes text mute: it says again what it does from the next command on.
        uno.send("srate 20\n");
        uno.run_ms(60);
        let x = 10 * lines as i32;
        assert_eq!(uno.statuses().last().expect("it tells").positions, [x, 0, 0, 0], "{lines} lines, quiet {quiet}");
    }
}

#[test]
fn behind_a_zero_nothing_is_said_until_a_command() {
    for begun in ["", "d x 10", "g x"] {
        let mut uno = Uno::new();
        uno.send("srate 50\n");
        uno.run_ms(20);
        // As noise would have it, in the middle of a line; what is behind it is no command.
        uno.send(format!("{begun}\0 00\nd y\n"));
        uno.run_ms(20);
        let had = uno.lines.len();
        uno.run_ms(500);
        assert_eq!(uno.lines.len(), had, "{begun:?}: {:?}", uno.lines);
        assert!(!uno.lines.iter().any(|line| line.text.starts_with("err")), "{begun:?}: {:?}", uno.lines);
        assert_eq!(uno.ask("ping", 20), ["awake"], "{begun:?}");
        uno.run_ms(100);
        assert_eq!(uno.statuses().last().expect("it tells").positions, [0; 4], "{begun:?}");
        assert!(uno.lines.len() > had + 1, "{begun:?}: statuses go on");
        assert_eq!(uno.ask("d y", 20), ["err missing 3"], "{begun:?}");
    }
}

/// A board that frames have had for 150 ms, without a word.
fn taken() -> Uno {
    let uno = Uno::new();
    let board = Remote::open(uno.port.clone(), 9).expect("it is free");
    let mut uno = Uno { port: board.port().clone(), ..uno };
    uno.run_ms(150);
    uno
}

#[test]
fn any_line_is_told_that_frames_have_the_board() {
    let taken = taken();
    for line in VERBS.into_iter().chain(["jump", "a xyza 100000 -200000 300000 -400000", &"d".repeat(70)]) {
        let mut uno = taken.clone();
        assert_eq!(uno.ask(line, 30), ["err taken"], "{line:?}");
        // Once; and the next line is told again.
        uno.run_ms(100);
        assert_eq!(uno.ask("ping", 30), ["err taken"], "after {line:?}");
    }
}

/// A port that pauses behind each byte 10 of what is sent: the host's word may be cut anywhere.
struct Halting(VirtualUno, Vec<u8>);

impl Port for Halting {
    fn now(&self) -> Duration {
        self.0.now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        for piece in bytes.split_inclusive(|byte| *byte == b'\n') {
            self.0.send(piece)?;
            if piece.ends_with(b"\n") {
                let until = self.now() + Duration::from_millis(30);
                while self.now() < until {
                    self.0.receive(until, &mut self.1)?;
                }
            }
        }
        Ok(())
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        into.append(&mut self.1);
        self.0.receive(until, into)
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.0.set_baud(baud)
    }
}

#[test]
fn a_frame_that_is_cut_behind_a_byte_10_is_no_text() {
    let mut board = Remote::open(Halting(VirtualUno::with_winch(), Vec::new()), 9).expect("it is free");
    // Sequence numbers and what COBS makes of zeros come to 10 among these, after a silence as well.
    for _ in 0..30 {
        let until = board.port().now() + Duration::from_millis(130);
        while board.port().now() < until {
            board.port_mut().0.receive(until, &mut Vec::new()).expect("it is virtual");
        }
        board.status().expect("it answers");
    }
    let measures = board.measures(false).expect("it answers");
    assert_eq!(measures.damaged_frames, 0);
    assert_eq!(board.error(), None);
}

/// Lines of which some bytes are lost: x moves by whole lines, that is said, and the next line is obeyed.
fn check_lost(uno: &mut Uno, lines: i32, name: &str) {
    uno.run_ms(900);
    let x = uno.statuses().last().expect("it tells").positions[0];
    assert!(x % 100 == 0 && x < 100 * lines, "{name}: {x} of {lines} lines");
    assert!(uno.lines.iter().any(|line| line.text.starts_with("err noise ")), "{name}: {:?}", uno.lines);
    uno.send("d x +100\n");
    uno.run_ms(600);
    assert_eq!(uno.statuses().last().expect("it tells").positions[0], x + 100, "{name}");
}

#[test]
fn a_line_with_a_hole_is_refused() {
    let mut random = Random::new(seed(11));
    for round in 0..6 * rounds() {
        let mut uno = Uno::new();
        uno.send("l x 10000 250000\ng x 5 1\n");
        uno.run_ms(50);
        // Main stands still while more bytes come than the page takes, from anywhere in a line.
        without_main(&mut uno, |uno| {
            uno.send("d x +100\n".repeat(20));
            run_us(uno, 13_000 + random.below(2000));
        });
        check_lost(&mut uno, 20, &format!("page, round {round}"));
    }
}

#[test]
fn bytes_that_the_usart_has_lost_are_told() {
    let mut random = Random::new(seed(12));
    let mut idle = Uno::new();
    idle.send("l x 10000 250000\ng x 5 1\n");
    idle.run_ms(50);
    for round in 0..20 * rounds() {
        let mut uno = idle.clone();
        uno.send("d x +100\n".repeat(20));
        // From before the axis has set out, to where it is under way.
        run_us(&mut uno, 2000 + random.below(12_000));
        // Nobody takes bytes from the USART for half a millisecond.
        hold_at_a_vector(&mut uno, 8000);
        check_lost(&mut uno, 20, &format!("USART, round {round}"));
    }
}

#[test]
fn every_line_of_a_short_burst_is_told() {
    // As many bytes as wait before lines go before answers.
    for line in ["q\n", "q 1\n", "a x y\n", "g x 1 99\n", "a x 7000000000\n", "ping\n"] {
        let mut uno = Uno::new();
        uno.send("srate 1000\n");
        uno.run_ms(300);
        let (had, lines) = (uno.lines.len(), 64 / line.len());
        uno.send(line.repeat(lines));
        uno.run_ms(150);
        let said = uno.lines[had..].iter().filter(|line| !line.text.starts_with("txyza")).count();
        assert_eq!(said, lines, "{line:?}");
        // Of longer ones the last is told, whatever comes of the others.
        uno.send(line.repeat(200));
        uno.send("version\n");
        uno.run_ms(300);
        let last = uno.lines.iter().rfind(|line| !line.text.starts_with("txyza")).expect("it answers");
        assert!(last.text.starts_with("id StepperWinch "), "{line:?}: {last:?}");
    }
}

/// Four axes at full speed.
fn at_full_speed() -> Uno {
    let mut uno = Uno::new();
    uno.send("l xyza 10000 100000\ng xyza 2 1\nv xyza 9999 -9935 9971 -9935\n");
    uno.run_ms(500);
    uno
}

/// Before a flood: all speeds change in each millisecond of the next half second, by 400·2π/e = 924 steps/s at most.
const CHANGE: &str = "g xyza 1 1\nd xyza -400 400 -400 400\n";

/// The same line again and again, as fast as the line takes it, with four axes at full speed; `first` is said just before. All of
/// them are obeyed.
#[track_caller]
fn check_flood(mut uno: Uno, line: &str, status_ms: u32, first: &str) {
    uno.send(format!("srate {status_ms}\n"));
    uno.run_ms(20);
    // 0.3 s of them, or as long as speeds change.
    let bytes = if first.is_empty() { 3500 } else { 6000 };
    let (had, lines) = (uno.lines.len(), bytes / (line.len() + 1));
    uno.send(first);
    uno.send(format!("{line}\n").repeat(lines));
    uno.send("ping\n");
    uno.run_ms(2 + (first.len() + lines * (line.len() + 1) + 5) as u64 * 87 / 1000 + 60);
    let said = uno.lines[had..].iter().map(|line| line.text.clone());
    let said: Vec<_> = said.filter(|text| !text.starts_with("txyza")).collect();
    // At speed to the end, but where it is told otherwise: in 4 ms of each axis.
    let now = uno.now();
    if !line.starts_with('a') && first.is_empty() {
        for axis in 0..4 {
            let steps = uno.steps(axis).iter().filter(|step| step.tick + 64_000 > now).count();
            assert!(steps >= 38, "{line:?}: {steps} steps of axis {axis}");
        }
    }
    uno.check_positions();
    uno.send("v xyza 0 0 0 0\nenable 0\n");
    uno.run_ms(400);
    let measures = measures(&uno);
    println!("{line:?}, status every {status_ms} ms, {first:?} before: {measures:?}");
    assert_eq!((measures.late, measures.starved), (0, 0), "{line:?}: {measures:?}");
    assert!(measures.stack_left >= 40, "{line:?}: {measures:?}");
    assert_eq!(measures.lost_bytes, 0, "{line:?}: {measures:?}");
    // Of answers that come faster than the line takes them some are left out.
    let others = said.iter().filter(|text| *text != "awake" && !text.starts_with("id ")).count();
    assert_eq!((others, said.last().map(|text| &text[..])), (0, Some("awake")), "{line:?}: {said:?}");
}

#[test]
fn any_line_is_obeyed_at_the_full_rate() {
    let fast = at_full_speed();
    for (line, status_ms) in [
        ("d xyza 1 1 1 1", 200),
        ("d x 1", 200),
        ("d x 10", 200),
        ("a xyza 9000000 -9000000 9000000 -9000000", 200),
        ("v x 9999", 200),
        ("v xyza 9999 -9935 9971 -9935", 200),
        ("r xyza 1 1 1 1", 200),
        ("s xyza 0 0 0 0", 200),
        // As clients write it, and as short as it may be.
        ("g a 2.000000 1.000000", 200),
        ("g xyza 2.000000 1.000000", 200),
        ("g xyza 1.999999 1.000001", 200),
        ("g x 2.000 1.000", 200),
        ("g xyza 2.0 1.0", 200),
        ("g x 2.5 1.5", 200),
        ("g a 0.5 0.7", 200),
        ("g a 20 0.07", 200),
        ("g a 2 0.999", 200),
        ("l a 1e4 1e5", 200),
        ("l xyza 1e4 1e5", 200),
        ("enable 1", 200),
        ("deadman 999", 200),
        ("strict 0", 200),
        ("srate 200", 200),
        ("ping", 200),
        ("version", 200),
        ("d x 10", 1),
        ("g xyza 2.000000 1.000000", 1),
        // With as little to read as there can be, gains are the most work for a byte.
        ("g a 2 1", 200),
        ("g a 9 5", 200),
        ("g xyza 2 1", 200),
        ("g xyza 2 1", 1),
    ] {
        check_flood(fast.clone(), line, status_ms, "");
    }
}

#[test]
fn any_line_is_obeyed_at_the_full_rate_while_speeds_change() {
    let fast = at_full_speed();
    for line in ["d a 0", "g a 1 1", "g a 1.5 1", "g xyza 1 1", "g xyza 1.000000 1.000000", "d xyza 0 0 0 0"] {
        check_flood(fast.clone(), line, 200, CHANGE);
    }
}
