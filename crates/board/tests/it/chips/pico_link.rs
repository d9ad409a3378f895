//! Faults that are particular to the Pico's two lines: a cable that is pulled, and a ring that overflows.

use super::link::{Linked, connected};
use pulsetrain_board::virtual_pico::{PicoPort, VirtualPico};
use pulsetrain_board::{Board, Edge, Port, Remote, Setup};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::Cause;
use pulsetrain_testkit::held::hold_for;
use pulsetrain_testkit::pico::{TICK_HZ, step_dir};
use pulsetrain_testkit::segments::Stream;
use std::time::Duration;

/// The cable is pulled: what is queued is done to its end, counted, and the next host hears why it stopped.
#[test]
fn a_cable_that_is_pulled_is_the_end_of_the_queue() {
    for by_usb in [false, true] {
        let mut board = {
            let port = if by_usb { VirtualPico::on_usb() } else { VirtualPico::new() };
            connected(port, Baud::B1M, 3)
        };
        let mut stream = Stream::on(VirtualPico::CHIP, &board, VirtualPico::LAWS, 1.0, 5, 4 * TICK_HZ);
        let (mut edges, begin) = (Vec::new(), stream.begin);
        let mut observer = |edge: Edge| edges.push(edge);
        let cut = begin + TICK_HZ / 2;
        let ended =
            stream.play(
                &mut board,
                &mut observer,
                |_, board| {
                    if board.now() >= cut { Err("pulled".to_owned()) } else { Ok(()) }
                },
            );
        assert_eq!(ended, Err("pulled".to_owned()));
        // Each gives the other up after 2 s.
        board.port_mut().cut(Duration::from_secs(4));
        let until = board.now() + 5 * TICK_HZ;
        board.advance(until, &mut observer);
        assert!(board.error().is_some(), "the host hears nothing");
        let mut port = board.close();
        // The next program opens the port at 115 200 baud.
        port.set_baud(Baud::B115200).expect("it is there");
        let mut board = Remote::open(port, 8).expect("the host before was silent for too long");
        assert_eq!(board.info().last_stop, Cause::HostLost, "USB {by_usb}");
        let status = board.status().expect("it answers");
        assert!(status.is_idle());
        let (mut dir, mut count) = (false, 0);
        for edge in &edges {
            match edge.line {
                3 => dir = edge.level,
                2 if edge.level => count += if dir { 1 } else { -1 },
                _ => {}
            }
        }
        assert!(
            count > 2000 && count == status.motors.as_slice()[0].position,
            "{count} {:?}",
            status.motors.as_slice()
        );
    }
}

/// More bytes than the ring of the UART holds, while the main loop is held up: what is lost is counted and told, the session goes
/// on; text says that something was lost, and obeys no line that was sewn together.
#[test]
fn a_ring_that_overflows_is_noticed() {
    // 130 ms at 115 200 baud are 1500 bytes; the ring has 1024.
    const HELD: u64 = TICK_HZ / 1000 * 140;
    let mut board = Remote::open(VirtualPico::new(), 7).expect("it answers");
    board.configure(&Setup { pulse_ticks: 250, motors: vec![step_dir(2)], ..Setup::default() }).expect("it takes it");
    board.port_mut().send_on(PicoPort::Uart, &[0; 1500]);
    hold_for(board.port_mut(), HELD);
    let soon = board.now() + TICK_HZ / 20;
    board.advance(soon, &mut |_: Edge| {});
    let lost = board.measures(false).expect("it answers").lost_bytes;
    assert!((1025..=1500).contains(&lost), "{lost} bytes lost");
    // Motors that are armed run dry meanwhile: that is another test's.
    let events = board.events();
    let told: Vec<_> = events.iter().filter(|event| event.cause == Cause::Overrun).map(|event| event.detail).collect();
    assert_eq!(told, [u32::from(lost)]);
    assert_eq!(board.error(), None);

    let mut port = VirtualPico::new();
    let mut heard = Vec::new();
    let run = |port: &mut VirtualPico, heard: &mut Vec<u8>, ms| {
        let until = port.now() + Duration::from_millis(ms);
        while port.now() < until {
            port.receive(until, heard).expect("it is there");
        }
    };
    port.send(b"srate 65535\n").expect("it is there");
    run(&mut port, &mut heard, 50);
    heard.clear();
    // Of these the last, whole, would move; sewn to what is left of another it must not.
    port.send(("version\n".repeat(188) + "a x 5\n").as_bytes()).expect("it is there");
    hold_for(&mut port, HELD);
    run(&mut port, &mut heard, 100);
    port.send(b"\nversion\n").expect("it is there");
    run(&mut port, &mut heard, 100);
    let text = String::from_utf8_lossy(&heard);
    let errors = text.lines().filter(|line| line.starts_with("err noise")).count();
    assert!(errors == 1 && text.ends_with("id StepperWinch Nov 21 2026\r\n"), "{text}");
}
