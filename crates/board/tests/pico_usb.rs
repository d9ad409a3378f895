//! The firmware by its own USB port: a PC enumerates it, and the edges are those of the native board.

mod common;

use common::Random;
use common::pico::{Pair, TICK_HZ, overhead, random_items, step_dir};
use pulsetrain_board::virtual_pico::{CYCLES_PER_S, VirtualPico};
use pulsetrain_board::{Board, Setup};
use pulsetrain_emulator::UsbState;

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
        let from = pair.pico.now() + pair.pico.lead() + TICK_HZ / 100;
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
