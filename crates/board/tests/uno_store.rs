//! Settings that an Uno keeps without power, on the emulated chip: its EEPROM.

mod common;

use common::winch::{ENABLE, Uno};
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Port, Remote, RemoteError};
use pulsetrain_core::wire::settings::SETTINGS_LEN;
use pulsetrain_core::wire::{Reason, Settings};
use std::time::Duration;

/// With the CRC.
const KEPT: usize = SETTINGS_LEN + 2;

const SETTINGS: Settings = Settings { deadman_ms: 400, idle_ms: 250, silence_ms: 600, vmax: 500_000, amax: 4_000_000 };

/// A board that keeps `settings`, at its next start.
fn started_anew(settings: Settings) -> VirtualUno {
    let mut remote = Remote::open(VirtualUno::new(), 1).expect("a board");
    remote.store(&settings).expect("it keeps them");
    with_eeprom(remote.close().chip().eeprom())
}

/// A chip with that EEPROM, and no power until now.
fn with_eeprom(eeprom: &[u8]) -> VirtualUno {
    let mut uno = VirtualUno::new();
    uno.chip_mut().eeprom_mut().copy_from_slice(eeprom);
    uno
}

/// Levels of ENABLE, and when, ticks.
fn enables(uno: &Uno) -> Vec<(u64, bool)> {
    uno.edges.iter().filter(|edge| edge.line == ENABLE).map(|edge| (edge.tick, edge.level)).collect()
}

#[test]
fn settings_are_kept_without_power() {
    let mut remote = Remote::open(VirtualUno::new(), 1).expect("a board");
    assert_eq!(remote.stored(), Ok(None), "an erased EEPROM");
    let began = remote.port().now();
    remote.store(&SETTINGS).expect("it keeps them");
    let took = remote.port().now() - began;
    assert!(took > Duration::from_millis(16 * 3), "{took:?}");
    assert_eq!(remote.stored(), Ok(Some(SETTINGS)));
    // What is there already is not written again.
    let began = remote.port().now();
    remote.store(&SETTINGS).expect("it keeps them");
    let took = remote.port().now() - began;
    assert!(took < Duration::from_millis(10), "{took:?}");
    // All the rest of the EEPROM is somebody else's.
    let mut uno = remote.close();
    assert!(uno.chip().eeprom()[KEPT..].iter().all(|byte| *byte == 0xff));
    uno.reset();
    let eeprom = uno.chip().eeprom().to_vec();
    for uno in [uno, with_eeprom(&eeprom)] {
        let mut remote = Remote::open(uno, 2).expect("a board");
        assert_eq!(remote.stored(), Ok(Some(SETTINGS)));
        remote.store(&Settings::default()).expect("it keeps them");
        assert_eq!(remote.stored(), Ok(Some(Settings::default())));
    }
}

#[test]
fn one_wrong_bit_is_as_if_nothing_were_kept() {
    let mut remote = Remote::open(VirtualUno::new(), 1).expect("a board");
    remote.store(&SETTINGS).expect("it keeps them");
    for bit in 0..8 * KEPT {
        let mut flip = || remote.port_mut().chip_mut().eeprom_mut()[bit / 8] ^= 1 << (bit % 8);
        flip();
        assert_eq!(remote.stored(), Ok(None), "bit {bit}");
        let mut flip = || remote.port_mut().chip_mut().eeprom_mut()[bit / 8] ^= 1 << (bit % 8);
        flip();
    }
    assert_eq!(remote.stored(), Ok(Some(SETTINGS)));
    // Nor is a memory of nothing but zeros.
    remote.port_mut().chip_mut().eeprom_mut().fill(0);
    assert_eq!(remote.stored(), Ok(None));
}

#[test]
fn nothing_is_written_while_motors_are_powered() {
    let setup = common::uno_setup(&[(8, 9)], 16);
    let mut remote = Remote::open(VirtualUno::new(), 1).expect("a board");
    remote.configure(&setup).expect("it can");
    let refused =
        |result: Result<(), RemoteError>| matches!(result, Err(RemoteError::Refused { reason: Reason::Moving, .. }));
    assert!(refused(remote.store(&SETTINGS)));
    assert!(refused(remote.stored().map(drop)));
    remote.release().expect("they rest");
    remote.store(&SETTINGS).expect("it keeps them");
}

#[test]
fn text_begins_with_their_limits_deadman_and_idle() {
    let mut uno = Uno::around(started_anew(SETTINGS));
    uno.run_ms(80);
    assert_eq!(uno.lines[0].text, "awake");
    uno.say("g x 5 1");
    uno.say("v x 3000");
    uno.run_ms(300);
    let steps = uno.steps(0);
    let shortest = steps.windows(2).map(|pair| pair[1].tick - pair[0].tick).min().expect("it moves");
    assert!((31_900..32_100).contains(&shortest), "500 steps/s: {shortest} ticks");
    // 125 ms to get there; without limits it is half of that speed sooner.
    let ramp = steps[31].tick - steps[0].tick;
    assert!((100..140).contains(&(ramp / 16_000)), "{ramp} ticks for 31 steps");
    // Deadman: 400 ms after the last line all axes stop; 250 ms after that the drivers are off.
    uno.run_ms(1000);
    let steps = uno.steps(0);
    let last = steps.last().expect("it moved").tick;
    let off = enables(&uno);
    let levels: Vec<bool> = off.iter().map(|(_, level)| *level).collect();
    assert_eq!(levels, [true, false, true], "an output, on, off");
    let idle_ms = (off[2].0 - last) / 16_000;
    assert!((250..300).contains(&idle_ms), "{off:?}, the last step at {last}");
    // The next command that moves switches them on.
    uno.say("d x 10");
    uno.run_ms(60);
    assert_eq!(enables(&uno).len(), 4);
    uno.check_positions();
}

#[test]
fn a_host_is_lost_after_their_silence() {
    // How long it takes until another host has the board, which it asks for every now and then, when the first says nothing any more.
    let taken_after = |settings: Settings| {
        let mut remote = Remote::open(started_anew(settings), 1).expect("a board");
        remote.configure(&common::uno_setup(&[(8, 9)], 16)).expect("it can");
        let port = remote.port().clone();
        let began = port.now();
        let next = Remote::open(port, 2).expect("the first is lost by then");
        (next.port().now() - began).as_millis()
    };
    let (stored, without) = (taken_after(SETTINGS), taken_after(Settings { silence_ms: 0, ..SETTINGS }));
    assert!((590..900).contains(&stored), "{stored} ms");
    assert!((1990..2300).contains(&without), "{without} ms");
}
