//! A Pico has two lines at once, its UART and its own USB port, and one session: what is on the other one does not disturb
//! it, and however it ends, the UART is at 115 200 baud again.

use pulsetrain_board::virtual_pico::{PicoPort, VirtualPico};
use pulsetrain_board::{Board, Edge, Lease, Leased, Link, LinkError, Port, PortError, Remote, Setup};
use pulsetrain_core::output::Sequence;
use pulsetrain_core::wire::message::{Cause, flags};
use pulsetrain_core::wire::{Baud, Command};
use pulsetrain_core::{Direction, Entry, Epoch, Item, Tick32};
use pulsetrain_testkit::pico::{TICK_HZ, coils, run, step_dir};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// One line of a Pico that has programs on both.
#[derive(Clone)]
struct Side {
    board: Arc<Mutex<VirtualPico>>,
    line: PicoPort,
}

impl Port for Side {
    fn now(&self) -> Duration {
        self.board.lock().unwrap().now()
    }
    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.board.lock().unwrap().send_on(self.line, bytes);
        Ok(())
    }
    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        self.board.lock().unwrap().receive_on(self.line, until, into);
        Ok(())
    }
    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        // USB has no rate.
        if self.line == PicoPort::Usb { Ok(()) } else { self.board.lock().unwrap().set_baud(baud) }
    }
    fn edges(&mut self, into: &mut Vec<Edge>) {
        self.board.lock().unwrap().edges(into);
    }
}

/// Both lines of a Pico whose USB port is open.
fn sides() -> [Side; 2] {
    let board = Arc::new(Mutex::new(VirtualPico::on_usb()));
    [PicoPort::Uart, PicoPort::Usb].map(|line| Side { board: Arc::clone(&board), line })
}

/// Says on a line what a link has to say, hears what comes, for `ms`.
fn talk(side: &mut Side, link: &mut Link, ms: u64) {
    let until = side.now() + Duration::from_millis(ms);
    let mut bytes = Vec::new();
    while side.now() < until {
        bytes.clear();
        link.output(side.now(), &mut bytes);
        side.send(&bytes).expect("it is there");
        bytes.clear();
        let soon = (side.now() + Duration::from_millis(1)).min(until);
        side.receive(soon, &mut bytes).expect("it is there");
        link.input(&bytes, side.now());
    }
}

fn wait(side: &mut Side, ms: u64) {
    let until = side.now() + Duration::from_millis(ms);
    while side.now() < until {
        side.receive(until, &mut Vec::new()).expect("it is there");
    }
}

fn setup() -> Setup {
    Setup { pulse_ticks: 125, motors: vec![step_dir(2), coils(8, Sequence::Half)], ..Setup::default() }
}

/// Runs a plan of two motors for a second, in an epoch of its own; `meanwhile` every 5 ms. Gives the edges.
fn second_of_motion(board: &mut Remote<Side>, epoch: u8, mut meanwhile: impl FnMut()) -> Vec<(u64, u8, bool)> {
    let from = board.now() + TICK_HZ / 10;
    // Coils are at the same phase after it.
    for (motor, count, ticks) in [(0, 10_000, 12_500), (1, 496, 250_000)] {
        let anchor = Item::Anchor { tick: Tick32::of(from) };
        for item in [anchor, run(count, ticks, Direction::Forward)] {
            board.push(motor, Entry { epoch: Epoch(epoch), item }).expect("there is room");
        }
    }
    assert_eq!(board.switch(Epoch(epoch), from, Lease::Last, &[]), Ok(()));
    let mut edges = Vec::new();
    while board.now() < from + TICK_HZ * 11 / 10 {
        meanwhile();
        let until = board.now() + TICK_HZ / 200;
        board.advance(until, &mut |edge: Edge| {
            if edge.tick >= from && edge.line != 25 {
                edges.push((edge.tick - from, edge.line, edge.level));
            }
        });
    }
    edges
}

/// On either line a session, and on the other what disturbs: Hello of another program, frames of an old session, noise.
#[test]
fn the_other_line_does_not_disturb_a_session() {
    for line in [0, 1] {
        let [uart, usb] = sides();
        let [own, mut other] = if line == 0 { [uart, usb] } else { [usb, uart] };
        // An old session on the other line: its host goes on as if it were there.
        let mut old = Link::new(9);
        old.hello(other.now());
        talk(&mut other, &mut old, 20);
        assert!(old.info().is_some());
        let mut stop = Vec::new();
        old.ask(&Command::StopNow, other.now());
        old.output(other.now(), &mut stop);
        assert!(!stop.is_empty());
        wait(&mut other, 2500);

        let mut board = Remote::open(own, 1).expect("the old host was silent for too long");
        assert_eq!(board.set_baud(Baud::B1M), Ok(Baud::B1M));
        // What was said as text before is no frame.
        let text = board.link().counts().damaged;
        board.configure(&setup()).expect("it takes it");
        board.measures(true).expect("it answers");
        // At the new rate the host asks again until it is heard.
        let before = board.link().counts().repeated;
        // Coils are on from then on.
        second_of_motion(&mut board, 1, || {});
        board.arm().expect("at rest");
        let quiet = second_of_motion(&mut board, 2, || {});
        let steps = quiet.iter().filter(|edge| edge.1 == 2 && edge.2).count();
        assert_eq!(steps, 10_000);

        board.arm().expect("at rest");
        board.events();
        let mut number = 0_u32;
        let mut intruder = Link::new(77);
        intruder.hello(other.now());
        let disturbed = second_of_motion(&mut board, 3, || {
            number += 1;
            match number % 3 {
                0 => other.send(&[0, 7, 0xff, number as u8, 0x55, 0, 0, 1, 0]).expect("it is there"),
                1 => other.send(&stop).expect("it is there"),
                _ => talk(&mut other, &mut intruder, 3),
            }
        });
        assert!(number > 100);
        assert!(disturbed == quiet, "edges differ from those of a quiet line");
        assert!(intruder.info().is_none(), "taken away");
        let counts = board.link().counts();
        assert_eq!((counts.repeated - before, counts.damaged), (0, text), "{counts:?}");
        let causes: Vec<_> = board.events().iter().map(|event| event.cause).collect();
        assert_eq!(causes, [Cause::Finished]);
        assert_eq!(board.measures(false).expect("it answers").damaged_frames, 0);
        // The other program was told why, and has the board as soon as this one is done.
        board.close();
        let board = Remote::open(other, 5).expect("nobody has it");
        assert_eq!(board.info().nonce, 5);
    }
}

#[test]
fn a_program_on_the_other_line_is_told_that_the_board_is_taken() {
    for line in [0, 1] {
        let [uart, usb] = sides();
        let [own, other] = if line == 0 { [uart, usb] } else { [usb, uart] };
        let mut board = Remote::open(own, 1).expect("it answers");
        board.configure(&setup()).expect("it takes it");
        let mut intruder = Link::new(2);
        let mut port = other.clone();
        intruder.hello(port.now());
        while intruder.error().is_none() {
            talk(&mut port, &mut intruder, 100);
            board.status().expect("the session goes on");
        }
        assert_eq!(intruder.error(), Some(LinkError::Taken));
    }
}

/// The host on the UART goes to 2 Mbaud and dies; before its silence is over, another asks over USB.
#[test]
fn the_uart_falls_back_though_somebody_spoke_over_usb() {
    let [uart, mut usb] = sides();
    for round in 0..3 {
        let mut board = Remote::open(uart.clone(), 10 + round).expect("at 115 200 baud");
        assert_eq!(board.set_baud(Baud::B2M), Ok(Baud::B2M));
        drop(board);
        // Its program is gone; the next one opens the adapter at 115 200 baud.
        uart.board.lock().unwrap().set_baud(Baud::B115200).expect("it is there");
        let mut hello = Link::new(20 + round);
        hello.hello(usb.now());
        talk(&mut usb, &mut hello, 1000);
        assert!(hello.info().is_none(), "not yet");
        if round == 0 {
            // The UART's next host.
            wait(&mut usb, 1500);
            continue;
        }
        // USB's: it has the board when the silence is over. The UART is heard at 115 200 baud all the same, and told so.
        let board = Remote::open(usb.clone(), 30 + round).expect("the host was silent for too long");
        let mut intruder = Link::new(40 + round);
        intruder.hello(usb.now());
        let mut line = uart.clone();
        for _ in 0..70 {
            talk(&mut line, &mut intruder, 100);
            if intruder.error().is_some() {
                break;
            }
        }
        // The session over USB was silent meanwhile: the UART's host was turned away first, and has the board then.
        assert!(intruder.info().is_some(), "{:?}", intruder.error());
        drop(board);
        wait(&mut usb, 2500);
    }
}

/// Over USB a rate is agreed on like any, and changes nothing.
#[test]
fn a_rate_agreed_over_usb_is_not_the_uarts() {
    let [uart, usb] = sides();
    let mut board = Remote::open(usb, 1).expect("it answers");
    for baud in [Baud::B250k, Baud::B2M] {
        assert_eq!(board.set_baud(baud), Ok(baud));
        let mut intruder = Link::new(2);
        intruder.hello(uart.now());
        let mut line = uart.clone();
        while intruder.error().is_none() {
            talk(&mut line, &mut intruder, 100);
            board.status().expect("the session goes on");
        }
        assert_eq!(intruder.error(), Some(LinkError::Taken), "heard, and answered, at 115 200 baud");
    }
    board.close();
    assert!(Remote::open(uart, 3).is_ok());
}

/// A program over USB ends without a word while it had something coming; nobody reads its port.
#[test]
fn a_port_that_nobody_reads_does_not_keep_the_board() {
    let [uart, usb] = sides();
    for unplugged in [false, true] {
        let mut board = Remote::open(usb.clone(), 1).expect("it answers");
        board.configure(&setup()).expect("it takes it");
        let from = board.now() + TICK_HZ / 10;
        // Steps, and one that is asked for too late: news of each motor, and more at the end.
        let anchor = Item::Anchor { tick: Tick32::of(from) };
        for motor in 0..2 {
            for item in [anchor, run(100, 125_000, Direction::Forward), anchor, run(1, 125_000, Direction::Forward)] {
                board.push(motor, Entry { epoch: Epoch(1), item }).expect("there is room");
            }
        }
        assert_eq!(board.switch(Epoch(1), from, Lease::Last, &[]), Ok(()));
        drop(board);
        // What the firmware tells from here on stays where it is.
        let mut pico = uart.board.lock().unwrap();
        if unplugged {
            pico.chip_mut().usb_plug(false);
        } else {
            pico.chip_mut().usb_open(false);
        }
        drop(pico);
        let mut line = uart.clone();
        wait(&mut line, 2500);
        let mut board = Remote::open(uart.clone(), 2).expect("its host was silent for too long");
        let status = board.status().expect("it answers");
        assert!(status.is_idle());
        assert!(status.motors.as_slice()[0].position >= 100);
        assert!(status.motors.as_slice()[0].faults & flags::STEP_MISSED != 0);
        board.close();
        let mut pico = uart.board.lock().unwrap();
        pico.chip_mut().usb_plug(true);
        pico.chip_mut().usb_open(true);
        drop(pico);
        wait(&mut line, 500);
    }
    assert!(Remote::open(usb, 3).is_ok(), "the port opens again");
}
