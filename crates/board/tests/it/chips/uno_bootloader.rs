//! Real bootloaders on the virtual Uno, which others wrote: those of Debian's arduino-core-avr. `cargo xtask test` installs it, builds
//! Optiboot from its source, and runs these.

#![cfg(target_os = "linux")]

use pulsetrain_board::stk500::{Bootloader, FlashError, RATES};
use pulsetrain_board::virtual_uno::{self, BootloaderError, VirtualUno};
use pulsetrain_board::{Board, Port, Remote};
use pulsetrain_emulator::{Atmega328p, hex};
use std::time::Duration;

/// Of older Nanos, 2048 bytes, 57 600 baud.
const OLD: &str = "/usr/share/arduino/hardware/arduino/avr/bootloaders/atmega/ATmegaBOOT_168_atmega328.hex";

fn bootloader(path: &str) -> Vec<u8> {
    let text = std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{path}: {error}; run cargo xtask test"));
    hex::parse(&text, Atmega328p::FLASH_BYTES).expect("it is whole")
}

fn optiboot() -> Vec<u8> {
    bootloader(
        &std::env::var("PULSETRAIN_OPTIBOOT").expect("run `cargo xtask test`: it builds Optiboot, and says where"),
    )
}

fn flash(uno: &VirtualUno, bytes: usize) -> Vec<u8> {
    (0..bytes as u16).map(|at| uno.chip().flash_byte(at)).collect()
}

#[test]
fn optiboot_writes_the_firmware_and_starts_it() {
    let uno = VirtualUno::with_bootloader(&[], &optiboot()).expect("it is for this chip");
    let image = virtual_uno::image();
    let found = Bootloader::find(uno, RATES[0]).expect("it answers");
    let mut uno = found.program(&image, |_| {}).expect("nothing is wrong");
    assert_eq!(flash(&uno, image.len()), image);
    // From the watchdog's reset on it is an Uno with the firmware.
    uno.reset();
    let mut board = Remote::open(uno, 7).expect("the firmware answers");
    assert_eq!(board.info().board, 1);
    let now = board.now();
    board.advance(now + 16_000, &mut |_| {});
    assert_eq!(board.error(), None);
}

#[test]
fn left_alone_it_starts_the_program_after_a_second() {
    let image = virtual_uno::image();
    let mut uno = VirtualUno::with_bootloader(&image, &optiboot()).expect("it is for this chip");
    let mut said = Vec::new();
    uno.receive(Duration::from_millis(1000), &mut said).expect("it is there");
    assert_eq!((said.as_slice(), uno.zero()), (&[][..], None), "the bootloader waits");
    while uno.zero().is_none() && uno.now() < Duration::from_secs(3) {
        let until = uno.now() + Duration::from_millis(10);
        uno.receive(until, &mut said).expect("it is there");
    }
    assert!((1000..2000).contains(&uno.now().as_millis()), "{:?}", uno.now());
}

#[test]
fn the_bootloader_cannot_be_overwritten() {
    let optiboot = optiboot();
    let uno = VirtualUno::with_bootloader(&[], &optiboot).expect("it is for this chip");
    let mut uno = Bootloader::find(uno, RATES[0]).expect("it answers").program(&[0; 128], |_| {}).expect("it fits");
    uno.reset();
    // A host that knows no limit sends the bootloader's own pages, and one below, word addresses 0x3f00, 0x3f40 and 0x3ec0.
    let mut ask = |bytes: &[u8]| {
        uno.send(bytes).expect("it is there");
        let (mut answer, until) = (Vec::new(), uno.now() + Duration::from_millis(900));
        while answer.len() < 2 && uno.now() < until {
            uno.receive(until, &mut answer).expect("it is there");
        }
        answer
    };
    assert_eq!(ask(&[0x30, 0x20]), [0x14, 0x10], "it is in step");
    for (low, high) in [(0x00, 0x3f), (0x40, 0x3f), (0xc0, 0x3e)] {
        assert_eq!(ask(&[0x55, low, high, 0x20]), [0x14, 0x10]);
        let page = [&[0x64, 0, 128, b'F'], [0xa5; 128].as_slice(), &[0x20]].concat();
        assert_eq!(ask(&page), [0x14, 0x10], "it does not know that it was refused");
    }
    let read = flash(&uno, 32_768);
    assert_eq!(read[0x7d80..0x7e00], [0xa5; 128], "pages are written so");
    assert_eq!(read[0x7e00..], optiboot[0x7e00..], "the lock bits keep its own");
    uno.reset();
    assert!(Bootloader::find(uno, RATES[0]).is_ok(), "and it still answers");
}

#[test]
fn the_older_bootloader_answers_at_its_own_rate() {
    let old = bootloader(OLD);
    let new = || VirtualUno::with_bootloader(&[], &old).expect("it is for this chip");
    assert_eq!(Bootloader::find(new(), RATES[0]).unwrap_err(), FlashError::NoBootloader { rate: 115_200 });
    let slow = || {
        let mut uno = new();
        uno.set_rate(RATES[1]);
        Bootloader::find(uno, RATES[1]).expect("it answers")
    };
    let image: Vec<u8> = (0..3000u32).map(|at| (at * 11) as u8).collect();
    let uno = slow().program(&image, |_| {}).expect("nothing is wrong");
    assert_eq!(flash(&uno, image.len()), image);
    // Its section is larger, so that less is left for a program. The firmware fits.
    assert!(virtual_uno::image().len() <= 30_720);
    let image = vec![0x5a; 30_721];
    let refused = slow().program(&image, |_| {}).unwrap_err();
    assert_eq!(refused, FlashError::TooLarge { bytes: image.len(), limit: 30_720, rate: 57_600 });
}

#[test]
fn what_is_no_bootloader_is_refused() {
    assert_eq!(
        VirtualUno::with_bootloader(&[], &[0; 512]).unwrap_err(),
        BootloaderError::NotInBootSection { start: 0 },
        "a program"
    );
    let mut small = vec![0xff; 0x8000];
    small[0x7e00] = 0;
    assert_eq!(
        VirtualUno::with_bootloader(&[0; 0x7e01], &small).unwrap_err(),
        BootloaderError::ImageTooLarge { bytes: 0x7e01, limit: 0x7e00 }
    );
}
