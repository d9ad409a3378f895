//! The firmware by its own USB port: a PC enumerates it, and the edges are those of the native board.

use pulsetrain_board::virtual_pico::{CYCLES_PER_S, VirtualPico};
use pulsetrain_board::{Board, Link, Port, Setup};
use pulsetrain_core::{Direction, Item, Tick32};
use pulsetrain_emulator::{Observer, Rp2040, UsbState};
use pulsetrain_testkit::Random;
use pulsetrain_testkit::pico::{Pair, TICK_HZ, overhead, random_items, run, step_dir};
use std::time::Duration;

/// Within 300 ms of its start a program has its port open.
#[test]
fn enumerates() {
    let pico = VirtualPico::on_usb();
    assert_eq!(pico.chip().usb_state(), UsbState::Open);
    assert!(pico.chip().cycle() < CYCLES_PER_S * 3 / 10);
}

/// Random plans of one to eight motors.
#[test]
fn random_plans() {
    for motors in [1, 2, 4, 8] {
        let random = &mut Random::new(motors.into());
        let motors = (0..motors).map(|motor: u8| step_dir(2 + 2 * motor)).collect();
        let setup = Setup { pulse_ticks: 125, motors, ..Setup::default() };
        let mut pair = Pair::over(VirtualPico::on_usb(), &setup);
        let from = pair.pico.now() + pair.pico.round_trip() + TICK_HZ / 100;
        for (index, motor) in setup.motors.iter().enumerate() {
            let fastest = u64::from(overhead(&setup, motor)) + 1 + 100 * setup.motors.len() as u64;
            let items = random_items(&setup, motor, random, from, fastest);
            pair.push(index, 1, &items);
        }
        assert_eq!(pair.switch(1, from), Ok(()));
        while !pair.pico.is_idle() {
            assert!(pair.pico.now() < from + 60 * TICK_HZ, "{:?}", pair.pico.events());
            pair.advance(pair.pico.now() + TICK_HZ / 20);
        }
        pair.advance(pair.pico.now() + TICK_HZ / 100);
        let until = pair.native.now();
        pair.compare(until);
        assert!(pair.edges.len() > 1000);
        assert_eq!(pair.pico.positions(), pair.native.positions());
    }
}

/// A session over USB whose motor moves for some 2 s, with questions all the time; `meanwhile` is called every 10 ms, with how
/// often it was before.
fn asked_all_the_time(mut meanwhile: impl FnMut(u32, &mut Pair)) -> Pair {
    let setup = Setup { pulse_ticks: 125, motors: vec![step_dir(2)], ..Setup::default() };
    let mut pair = Pair::over(VirtualPico::on_usb(), &setup);
    let from = pair.pico.now() + pair.pico.round_trip() + TICK_HZ / 100;
    let mut items = vec![Item::Anchor { tick: Tick32::of(from) }];
    items.extend((0..500).map(|number| run(20 + number % 3, 24_000 + 7 * i64::from(number), Direction::Forward)));
    pair.push(0, 1, &items);
    assert_eq!(pair.switch(1, from), Ok(()));
    let mut round = 0;
    while !pair.pico.is_idle() {
        meanwhile(round, &mut pair);
        round += 1;
        for _ in 0..3 {
            pair.pico.status().expect("it answers");
        }
        pair.advance(pair.pico.now() + TICK_HZ / 100);
        assert_eq!(pair.pico.error(), None, "round {round}");
    }
    pair.advance(pair.pico.now() + TICK_HZ / 100);
    let until = pair.native.now();
    pair.compare(until);
    assert!(pair.pico.positions()[0] > 10_000, "{:?}", pair.pico.positions());
    assert_eq!(pair.pico.positions(), pair.native.positions());
    pair
}

/// CLEAR_FEATURE of one endpoint: its toggle begins anew, at the PC as on the board, and no byte is lost either way (USB 2.0
/// §9.4.1, §5.8.5). A configuration that is not there, and an endpoint that is not, are refused, and change nothing.
#[test]
fn endpoints_can_be_cleared_in_a_session() {
    let mut before = None;
    let pair = asked_all_the_time(|round, pair| {
        // The text that a port is greeted with is no frame.
        before.get_or_insert(pair.pico.link().counts().damaged);
        let chip = pair.pico.port_mut().chip_mut();
        match round % 8 {
            0 => chip.usb_clear_halt(0x82),
            2 => chip.usb_clear_halt(0x02),
            3 => chip.usb_clear_halt(0x81),
            4 => [0x02, 0x82, 0x02].into_iter().for_each(|endpoint| chip.usb_clear_halt(endpoint)),
            6 => chip.usb_try_configuration(2),
            _ => {}
        }
        assert_eq!(chip.usb_state(), UsbState::Open);
    });
    let counts = pair.pico.link().counts();
    assert_eq!((counts.repeated, Some(counts.damaged)), (0, before), "{counts:?}");
}

/// Endpoints that are halted and cleared in a session (USB 2.0 §9.4.5, §9.4.9): no byte is lost either way.
#[test]
fn endpoints_can_be_halted_in_a_session() {
    let pair = asked_all_the_time(|round, pair| {
        let chip = pair.pico.port_mut().chip_mut();
        let halted: &[u8] = match round % 8 {
            0 => &[0x82],
            2 => &[0x02],
            4 => &[0x82, 0x02, 0x81],
            _ => &[],
        };
        halted.iter().for_each(|endpoint| chip.usb_halt(*endpoint));
        halted.iter().for_each(|endpoint| chip.usb_clear_halt(*endpoint));
        // There is no such endpoint; endpoint 0 does not halt.
        [0x03, 0x83, 0x00].into_iter().for_each(|endpoint| chip.usb_halt(endpoint));
        assert_eq!(chip.usb_state(), UsbState::Open);
    });
    assert_eq!(pair.pico.link().counts().repeated, 0, "{:?}", pair.pico.link().counts());
}

/// What a halted endpoint does: nothing, for as long as it is; what was to go there goes after that.
#[test]
fn a_halted_endpoint_keeps_what_it_has() {
    let text = |pico: &mut VirtualPico, ms| {
        let until = pico.now() + Duration::from_millis(ms);
        let mut heard = Vec::new();
        while pico.now() < until {
            pico.receive(until, &mut heard).expect("it is there");
        }
        String::from_utf8(heard).expect("text")
    };
    let lines = "version\n".repeat(30);
    let answers = "id StepperWinch Nov 21 2026\r\n".repeat(30);
    let mut pico = VirtualPico::on_usb();
    pico.send(b"srate 65535\n").expect("it is there");
    text(&mut pico, 300);
    for round in 0..3 {
        // To the PC: the board hears, and its answers wait.
        pico.chip_mut().usb_halt(0x82);
        assert_eq!(text(&mut pico, 5), "");
        pico.send(lines.as_bytes()).expect("it is there");
        assert_eq!(text(&mut pico, 50), "", "round {round}");
        pico.chip_mut().usb_clear_halt(0x82);
        assert_eq!(text(&mut pico, 100), answers, "round {round}");
        // To the board: what is sent waits at the PC.
        pico.chip_mut().usb_halt(0x02);
        assert_eq!(text(&mut pico, 5), "");
        pico.send(lines.as_bytes()).expect("it is there");
        assert_eq!(text(&mut pico, 50), "", "round {round}");
        assert_eq!(pico.chip().usb_backlog(), lines.len());
        pico.chip_mut().usb_clear_halt(0x02);
        assert_eq!(text(&mut pico, 100), answers, "round {round}");
    }
}

/// A board that has just started, before a PC asks what it is.
fn plugged_in(change: impl FnOnce(&mut Rp2040)) -> VirtualPico {
    let mut pico = VirtualPico::new();
    change(pico.chip_mut());
    pico.opened().expect("it enumerates")
}

/// The serial number is that of the flash chip, so that two boards can be told apart; a flash that has none gives none.
#[test]
fn two_boards_have_two_serial_numbers() {
    let serial = |id: [u8; 8]| plugged_in(|chip| chip.set_flash_id(id)).chip().usb_text(3);
    assert_eq!(serial([0xe6, 0x61, 0x64, 0x08, 0x43, 0x0f, 0x9a, 0xb0]).as_deref(), Some("E6616408430F9AB0"));
    assert_eq!(serial([1; 8]).as_deref(), Some("0101010101010101"));
    assert_eq!(serial([0xff; 8]), None);
    assert_eq!(serial([0; 8]), None);
}

/// Erratum E5 is not worked around: a chip that has it says so where it is looked for.
#[test]
fn a_chip_before_b2_says_so() {
    let names = |revision| {
        let pico = plugged_in(|chip| chip.set_revision(revision));
        [1, 2].map(|index| pico.chip().usb_text(index).expect("it has a name"))
    };
    assert_eq!(names(2), ["Pulsetrain", "Pico"]);
    assert_eq!(names(1), ["Pulsetrain", "Pico (before B2: see E5)"]);
}

/// When the PC took packets, and their length.
struct Packets(Vec<(u64, usize)>);

impl Observer for Packets {
    fn usb(&mut self, cycle: u64, data: &[u8]) {
        self.0.push((cycle, data.len()));
    }
}

/// Erratum E15: no packet to the PC is begun in the last fifth of a frame.
#[test]
fn no_packet_goes_out_at_the_end_of_a_frame() {
    const FRAME: u64 = CYCLES_PER_S / 1000;
    let mut chip = VirtualPico::on_usb().chip().clone();
    let mut packets = Packets(Vec::new());
    // When frames begin: on a chip of its own, as looking is noticed.
    let mut other = chip.clone();
    let number = |chip: &mut Rp2040| chip.read(0x5011_0048, &mut Packets(Vec::new()));
    let (was, mut began) = (number(&mut other), other.cycle());
    while number(&mut other) == was {
        other.run(other.cycle() + 20, &mut packets);
        began = other.cycle();
    }
    let mut link = Link::new(1);
    link.hello(Duration::ZERO);
    let mut hello = Vec::new();
    link.output(Duration::ZERO, &mut hello);
    for number in 0..800 {
        // At all times of a frame, answered each time.
        chip.usb_send(&hello);
        chip.run(chip.cycle() + FRAME / 7 + number * 311, &mut packets);
    }
    let mut places = [0_u32; 10];
    for (end, bytes) in &packets.0 {
        let place = (end + FRAME - began % FRAME) % FRAME;
        places[(place * 10 / FRAME) as usize] += 1;
        // A full packet and its acknowledgement take 50 µs.
        assert!(place < FRAME * 17 / 20, "{bytes} bytes at {} µs of a frame; {places:?}", place / 125);
    }
    assert!(packets.0.len() > 400 && places[..8].iter().all(|count| *count > 0), "{places:?}");
}
