//! What comes over a line: packed steps, frames, StepperWinch's text.

use crate::decoded;
use pulsetrain_board::{Link, Port};
use pulsetrain_core::packing::{MAX_PACKED_LEN, Packing, State};
use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::path::{FASTEST, Path};
use pulsetrain_core::winch::reply::{LONGEST, LineReply};
use pulsetrain_core::winch::spacing;
use pulsetrain_core::winch::text::{Heard, LineCommand, LineReader};
use pulsetrain_core::wire::frame::{Received, Tag};
use pulsetrain_core::wire::{Baud, Command, Decoder, Encoder, MAX_BODY, MAX_FRAME, Reply};
use pulsetrain_core::{Item, Segment};
use pulsetrain_testkit::model::ModelPort;
use std::time::Duration;

#[allow(
    dead_code,
    unused_imports,
    unreachable_pub,
    clippy::disallowed_methods,
    reason = "the rest is for the tests of the board"
)]
#[path = "../../board/tests/it/chips/winch_avr.rs"]
mod winch_avr;

/// A packed stream of any content: the decoder takes it or refuses it, and what it takes can be packed again.
pub(crate) fn packing(input: &[u8]) {
    let Some((fraction_bits, gain, mut bytes)) = decoded::<(u8, i8, &[u8])>(input) else { return };
    let packing = Packing { fraction_bits: u32::from(fraction_bits % 33), gain };
    let mut state = State::default();
    loop {
        let before = state;
        let Ok(Some(item)) = packing.unpack(&mut state, &mut bytes) else { break };
        let (mut sender, mut receiver) = (before, before);
        let mut packed = [0; MAX_PACKED_LEN];
        let len = packing.pack(&mut sender, &item, &mut packed).expect("an item that was unpacked can be packed");
        let again =
            packing.unpack(&mut receiver, &mut &packed[..len]).expect("an item that was packed can be unpacked");
        assert_eq!(again.map(as_run), Some(as_run(item)));
        assert_eq!(sender, receiver);
    }
}

/// The segment without the differences that none of its steps uses: those are not packed.
fn as_run(item: Item) -> Item {
    match item {
        Item::Run { segment, direction } => {
            let Segment { count, add, add2, .. } = segment;
            let (add, add2) = (if count > 1 { add } else { 0 }, if count > 2 { add2 } else { 0 });
            Item::Run { segment: Segment { add, add2, ..segment }, direction }
        }
        Item::Anchor { .. } | Item::Dwell { .. } => item,
    }
}

/// Bytes from a line, of any content, to a board and to a host: both go on, and each speaks in frames that the other takes.
///
/// The beginning of the input is also sent as a correct frame, so that commands reach the board too.
pub(crate) fn wire(input: &[u8]) {
    let Some(input) = decoded::<Vec<(bool, Vec<u8>)>>(input) else { return };
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
}

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

/// Bytes of any content to the text reader and to four paths: nothing breaks, limits hold, and the next line is read.
pub(crate) fn winch(input: &[u8]) {
    let Some((strict, bytes)) = decoded::<(bool, Vec<u8>)>(input) else { return };
    let mut reader = LineReader::new();
    reader.set_strict(strict);
    let mut paths = [const { Path::new() }; 4];
    for byte in bytes.iter().take(2000) {
        match reader.push::<InMemory>(*byte) {
            Heard::Nothing => continue,
            Heard::Command(_) => reader.obey(&mut paths),
            Heard::Refused(refusal) => {
                let mut line = [0; LONGEST];
                let len = usize::from(LineReply::Refused(refusal).write::<InMemory>(&mut line));
                assert!(line[..len].ends_with(b"\r\n") && line[..len].is_ascii());
            }
        }
        for path in &mut paths {
            for _ in 0..20 {
                let made = path.made();
                let slice = path.tick();
                assert!(path.speed().unsigned_abs() <= u32::from(FASTEST) << 16);
                assert_eq!(path.made().wrapping_sub(made).unsigned_abs(), u32::from(slice.count));
                if let Some(train) = slice.train() {
                    let last = train.first + u32::from(train.count - 1) * train.interval;
                    assert!(last >> 16 <= u32::from(spacing::TICKS) + 1, "{slice:?} {train:?}");
                }
            }
        }
    }
    reader.push::<InMemory>(b'\n');
    // The line has a checksum, because a strict reader demands one from every line after the first that had one.
    let heard = b"ping*10\n".iter().map(|byte| reader.push::<InMemory>(*byte)).last();
    assert_eq!(heard, Some(Heard::Command(LineCommand::Ping)));
}

/// Bytes of any content to the Uno's reader of lines, in assembly on the emulated chip, and to core's: both must read the
/// same commands. The fuzzer is guided by the coverage of core and the emulator.
pub(crate) fn winch_uno(input: &[u8]) {
    let Some((strict, bytes)) = decoded::<(bool, &[u8])>(input) else { return };
    let mut readers = winch_avr::Readers::new(strict);
    // Zeros belong to binary frames; a line of text has none.
    let bytes: Vec<u8> = bytes.iter().copied().filter(|byte| *byte != 0).take(600).collect();
    for line in bytes.split_inclusive(|byte| *byte == b'\n') {
        readers.push(line);
    }
}
