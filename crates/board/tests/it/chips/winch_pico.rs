//! What is particular to the Pico's firmware for text: its two lines, its state machines, and its clock, whose ticks wrap soon.

use super::winch::{Winch, enable, follows_paths, on_usb};
use pulsetrain_board::virtual_pico::{PicoPort, VirtualPico};
use pulsetrain_board::{Link, LinkError, Port, Remote, RemoteError, Setup};
use pulsetrain_testkit::held::hold_for;
use pulsetrain_testkit::pico::step_dir;
use pulsetrain_testkit::winch::{Pico, Status, WinchLab};

/// Ticks of a slice.
const SLICE: u64 = Pico::SLICE;

/// Every step on its tick, by both lines.
#[test]
fn four_axes_at_full_speed() {
    let fast = [(5, "l xyza 10000 100000"), (5, "g xyza 2 1"), (5, "v xyza 10000 -9935 9971 -10000")];
    follows_paths::<VirtualPico>(&[&fast, &fast]);
}

/// What comes all at once is answered in order, and nothing is lost, by both lines.
#[test]
fn a_hundred_questions_are_answered_in_order() {
    for mut pico in VirtualPico::labs() {
        let had = pico.lines.len();
        pico.send("ping\n\rversion\n".repeat(100));
        pico.run_ms(500);
        let said: Vec<_> =
            pico.lines[had..].iter().map(|line| line.text.as_str()).filter(|text| !text.starts_with("txyza")).collect();
        assert_eq!(said, ["awake", "id StepperWinch Nov 21 2026"].repeat(100));
    }
}

/// The longest answers to the shortest lines: packet after packet, none is lost.
#[test]
fn each_line_of_a_burst_is_answered() {
    let mut pico = on_usb();
    pico.run_ms(50);
    pico.send("*\n".repeat(400));
    pico.run_ms(500);
    let answers = pico.lines.iter().filter(|line| line.text == "err checksum 0");
    assert_eq!(answers.count(), 400);
}

/// A host that does not read is obeyed all the same, and so is one on the other line; when it reads again it hears whole lines.
#[test]
fn nobody_waits_for_who_does_not_read() {
    let mut port = VirtualPico::on_usb();
    let run = |port: &mut VirtualPico, line, ms| {
        let (until, mut heard) = (port.now() + std::time::Duration::from_millis(ms), Vec::new());
        while port.now() < until {
            port.receive_on(line, until, &mut heard);
        }
        heard
    };
    port.send_on(PicoPort::Usb, b"g xyza 5 1\n");
    run(&mut port, PicoPort::Usb, 10);
    port.chip_mut().usb_fill(true);
    port.send_on(PicoPort::Usb, "nonsense\nd x 10\n".repeat(100).as_bytes());
    port.send_on(PicoPort::Uart, "d y 10\n".repeat(100).as_bytes());
    run(&mut port, PicoPort::Uart, 2500);
    port.chip_mut().usb_fill(false);
    let heard = run(&mut port, PicoPort::Usb, 300);
    let text = String::from_utf8(heard).expect("text");
    let known = |line: &str| line.starts_with("txyza ") || line == "err command 1";
    assert!(text.ends_with("\r\n") && text.lines().all(known), "{text}");
    assert!(text.trim_end().ends_with(" 1000 1000 0 0"), "{text}");
}

/// A main loop that is held up, as nothing of ours does: the axes stop, nobody knows where they stand, and text begins anew.
#[test]
fn a_machine_that_ran_dry_is_a_new_beginning() {
    let mut pico = Pico::new();
    pico.send("g xyza 5 1\nv xyza 1000 2000 3000 -3000\n");
    pico.run_ms(500);
    hold_for(&mut pico.port, 4 * SLICE);
    let held = pico.now();
    pico.run_ms(300);
    assert_eq!(pico.lines.iter().filter(|line| line.text == "awake").count(), 2);
    assert!((0..4).all(|axis| pico.steps(axis).last().is_some_and(|step| step.tick < held)), "all stand");
    assert_eq!(enable(&pico).last().map(|(_, level)| *level), Some(true), "the drivers are off");
    assert_eq!(pico.statuses().last().unwrap().positions, [0; 4]);
    pico.edges.clear();
    pico.lines.clear();
    // Its DIR is low already.
    pico.send("g a 5 1\na a 7\n");
    pico.run_ms(2000);
    assert_eq!(pico.counted(pico.now()), [0, 0, 0, 7]);
    assert_eq!(pico.statuses().last().unwrap().positions, [0, 0, 0, 7]);
}

/// Wherever a Hello comes between the bytes of a command that enables the drivers and its effect, one of both has the board: the
/// command on the UART, Hello over USB.
#[test]
fn hello_in_the_moment_of_a_command() {
    // Who had the board: text, frames.
    let mut had = [0, 0];
    for us in (0..3000).step_by(500) {
        let mut pico = on_usb();
        pico.port.send_on(PicoPort::Uart, b"v x 1000\n");
        let until = pico.port.now() + std::time::Duration::from_micros(us);
        while pico.port.now() < until {
            pico.port.receive(until, &mut Vec::new()).unwrap();
        }
        let opened = Remote::open(pico.port.clone(), 9);
        match opened {
            Err(RemoteError::Link(LinkError::Taken)) => {
                had[0] += 1;
                let mut pico = WinchLab::around(pico.port);
                pico.run_ms(100);
                assert!(!pico.steps(0).is_empty(), "{us} us: text has it");
            }
            Ok(board) => {
                had[1] += 1;
                let mut pico = WinchLab::around(board.port().clone());
                pico.run_ms(100);
                assert_eq!(pico.steps(0).len(), 0, "{us} us: frames have it");
            }
            Err(error) => panic!("{us} us: {error}"),
        }
    }
    assert!(had[0] > 0 && had[1] > 0, "text {}, frames {}", had[0], had[1]);
}

/// What comes of a Hello on a line: why it is refused, if it is.
fn hello_on(port: &mut VirtualPico, line: PicoPort) -> Option<LinkError> {
    let mut link = Link::new(77);
    link.hello(port.now());
    let patience = port.now() + std::time::Duration::from_secs(8);
    let mut heard = Vec::new();
    while link.error().is_none() && link.info().is_none() {
        assert!(port.now() < patience, "no answer on {line:?}");
        heard.clear();
        link.output(port.now(), &mut heard);
        port.send_on(line, &heard);
        heard.clear();
        port.receive_on(line, port.now() + std::time::Duration::from_millis(1), &mut heard);
        link.input(&heard, port.now());
    }
    link.error()
}

/// Frames on one line: text on the other is told so; and while text drives, Hello is refused on both.
#[test]
fn each_line_hears_of_the_other() {
    let mut port = VirtualPico::on_usb();
    let mut lines = [Vec::new(), Vec::new()];
    let run = |port: &mut VirtualPico, lines: &mut [Vec<u8>; 2], ms| {
        let until = port.now() + std::time::Duration::from_millis(ms);
        while port.now() < until {
            let next = (port.now() + std::time::Duration::from_millis(1)).min(until);
            port.receive_on(PicoPort::Usb, next, &mut lines[1]);
            port.receive_on(PicoPort::Uart, next, &mut lines[0]);
        }
    };
    run(&mut port, &mut lines, 210);
    for heard in &lines {
        assert!(heard.starts_with(b"awake\r\ntxyza "), "{}", String::from_utf8_lossy(heard));
    }
    // Axes and settings are the same by both.
    port.send_on(PicoPort::Uart, b"g x 5 1\na x 50\n");
    port.send_on(PicoPort::Usb, b"srate 50\n");
    run(&mut port, &mut lines, 30);
    // Text drives, and what it is told on one line holds frames off on both.
    for line in [PicoPort::Usb, PicoPort::Uart] {
        assert_eq!(hello_on(&mut port.clone(), line), Some(LinkError::Taken), "{line:?}");
    }
    run(&mut port, &mut lines, 1470);
    for heard in &lines {
        let text = String::from_utf8_lossy(heard);
        assert!(text.lines().count() > 25 && text.trim_end().ends_with(" 50 0 0 0"), "{text}");
    }
    port.send_on(PicoPort::Usb, b"enable 0\n");
    run(&mut port, &mut lines, 100);
    // Frames over USB; text on the UART.
    let mut board = Remote::open(port, 9).expect("it is free");
    board.configure(&Setup { pulse_ticks: 125, motors: vec![step_dir(10)], ..Setup::default() }).expect("it takes it");
    let mut port = board.port().clone();
    lines = [Vec::new(), Vec::new()];
    port.send_on(PicoPort::Uart, b"a x 5\nnonsense\n");
    run(&mut port, &mut lines, 100);
    assert_eq!(String::from_utf8_lossy(&lines[0]), "err taken\r\nerr taken\r\n");
}

/// Ticks are 32 bits in most places and wrap after 34.36 s: motion goes on through that, and begins anew after a rest of more than
/// half of it.
#[test]
fn the_clock_wraps() {
    let mut pico = Pico::new();
    // Until its first command it sleeps most of the time.
    pico.run_ms(33_400);
    pico.send("g xyza 2 1\nsrate 50\n");
    pico.run_ms(100);
    pico.send("v xyza 1234 -7 0 0\n");
    pico.run_ms(1500);
    pico.send("v xyza 0 0 0 0\na xyza 2000 -10 10 0\n");
    pico.run_ms(18_500);
    pico.send("a xyza 2100 -110 110 -100\n");
    pico.run_ms(2000);
    let Status { usec, positions } = *pico.statuses().last().unwrap();
    assert!(usec > 54_000_000, "{usec}");
    assert_eq!(positions, [2100, -110, 110, -100]);
    assert_eq!(pico.counted(pico.now()), positions);
    pico.check_positions();
}
