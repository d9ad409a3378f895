//! Bytes that the firmware loses are told: in the USART, when nobody takes them, and in the receive page, when the main loop does
//! not come round.

use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Port, Remote};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::Cause;
use pulsetrain_testkit::lab::{SYMBOLS, address};

const SREG: u16 = 0x5f;
const I: u8 = 0x80;

fn opened() -> Remote<VirtualUno> {
    let mut board = Remote::open(VirtualUno::new(), 7).expect("it answers");
    assert_eq!(board.set_baud(Baud::B1M), Ok(Baud::B1M));
    assert_eq!(board.measures(true).expect("it answers").lost_bytes, 0);
    while !board.port().chip().is_asleep() {
        board.port_mut().chip_mut().step(&mut ());
    }
    board
}

/// The board is heard of again and has told of it, with so many bytes.
fn told(mut board: Remote<VirtualUno>, fewest: u16) {
    let until = board.now() + 1_600_000;
    board.advance(until, &mut |_: Edge| {});
    let events = board.events();
    let told = events.iter().find(|event| event.cause == Cause::Overrun);
    assert!(told.is_some_and(|event| event.detail >= u32::from(fewest)), "{events:?}");
    let lost = board.measures(false).expect("it answers").lost_bytes;
    assert!(lost >= fewest, "{lost} bytes");
    assert_eq!(board.error(), None);
}

#[test]
fn what_the_usart_loses_is_told() {
    let mut board = opened();
    let port = board.port_mut();
    port.send(&[0x55; 6]).expect("a virtual port");
    let chip = port.chip_mut();
    // A millisecond of the bridge, and then some.
    let until = chip.cycle() + 18_000;
    while chip.cycle() < until {
        let flags = chip.read_data(SREG, &mut ());
        chip.write_data(SREG, flags & !I, &mut ());
        chip.step(&mut ());
    }
    let flags = chip.read_data(SREG, &mut ());
    chip.write_data(SREG, flags | I, &mut ());
    told(board, 1);
}

#[test]
fn what_the_page_loses_is_told() {
    let forever = address(SYMBOLS, "end_of_program_loop");
    let mut board = opened();
    let port = board.port_mut();
    port.send(&[0x55; 150]).expect("a virtual port");
    let chip = port.chip_mut();
    // Main stands still for two milliseconds; interrupts go on.
    let main = chip.pc();
    chip.set_pc(forever);
    let until = chip.cycle() + 45_000;
    while chip.cycle() < until || chip.pc() != forever {
        chip.step(&mut ());
    }
    chip.set_pc(main);
    told(board, 150);
}
