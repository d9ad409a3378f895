//! Bytes from a line, of any content, to a board and to a host: both go on, and each speaks in frames that the other takes.
//!
//! The beginning of the input is also sent as a correct frame, so that commands reach the board too.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pulsetrain_board::{Link, Port};
use pulsetrain_core::wire::frame::{Received, Tag};
use pulsetrain_core::wire::{Baud, Command, Decoder, Encoder, MAX_BODY, MAX_FRAME, Reply};
use pulsetrain_testkit::model::ModelPort;
use std::time::Duration;

fuzz_target!(|input: Vec<(bool, Vec<u8>)>| {
    let mut port = ModelPort::new();
    let mut hello = [0; MAX_FRAME];
    let len = Command::Hello { version: 1, nonce: 1 }.encode(0, Tag::NONE, &mut hello).expect("fits");
    send(&mut port, &hello[..len]);

    let mut link = Link::new(1);
    link.hello(Duration::ZERO);
    let (mut from_board, mut from_host) = (Decoder::<MAX_BODY>::new(), Decoder::<MAX_BODY>::new());
    let mut same_rate = true;
    let mut now = Duration::ZERO;
    for (is_body, bytes) in input.iter().take(50) {
        let bytes = &bytes[..bytes.len().min(300)];
        let mut framed = [0; MAX_FRAME];
        let line = if *is_body {
            let mut frame = Encoder::new(&mut framed);
            frame.bytes(bytes);
            let Some(len) = frame.finish(Tag(1)) else { continue };
            &framed[..len]
        } else {
            bytes
        };
        for byte in send(&mut port, line) {
            match from_board.push(byte) {
                Received::More => {}
                Received::Frame(_) => {
                    let body = from_board.body();
                    assert!(Reply::decode(body).is_some(), "a host cannot read {body:02x?}");
                }
                Received::Damaged => assert!(!same_rate, "a board that nobody understands"),
            }
        }
        // The input may contain a Baud command; this port keeps its rate.
        same_rate &= port.board_baud() == Baud::B115200;

        link.input(line, now);
        now += Duration::from_millis(30);
        let mut out = Vec::new();
        link.output(now, &mut out);
        for byte in out {
            match from_host.push(byte) {
                Received::More => {}
                Received::Frame(_) => {
                    let body = from_host.body();
                    assert!(Command::decode(body[1], &body[2..]).is_ok(), "a board cannot read {body:02x?}");
                }
                Received::Damaged => panic!("a host that nobody understands"),
            }
        }
    }
});

/// What the board answers within some milliseconds.
fn send(port: &mut ModelPort, bytes: &[u8]) -> Vec<u8> {
    port.send(bytes).expect("a model's port");
    let until = port.now() + Duration::from_millis(5);
    let mut answer = Vec::new();
    while port.now() < until {
        port.receive(until, &mut answer).expect("a model's port");
    }
    answer
}
