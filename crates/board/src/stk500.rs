//! An Uno's bootloader, as the host speaks to it: the part of STK500 version 1 (Atmel AVR061) that Optiboot and the older
//! ATmegaBOOT know. Flash alone; what was written is read back.
//!
//! A bootloader listens for a second after a reset: whoever opens the port must have reset the board just before.

use crate::{Port, PortError};
use std::time::Duration;
use thiserror::Error;

/// The rates that bootloaders have, bits a second: Optiboot's, on Unos and newer Nanos, and ATmegaBOOT's, on older Nanos.
pub const RATES: [u32; 2] = [115_200, 57_600];

/// Bytes of an ATmega328P's flash.
pub const FLASH_BYTES: usize = 32 * 1024;

/// Bytes that a program may have: 32 KiB less the bootloader at that rate (Optiboot 512, ATmegaBOOT 2048).
#[must_use]
pub const fn room(rate: u32) -> usize {
    if rate == RATES[0] { FLASH_BYTES - 512 } else { FLASH_BYTES - 2048 }
}

/// Bytes of a page (ATmega328P DS40002061B §28.5).
const PAGE: usize = 128;

/// The ATmega328P's (DS40002061B §28.3), and the ATmega328's, which is the same but for its sleep.
const SIGNATURES: [[u8; 3]; 2] = [[0x1e, 0x95, 0x0f], [0x1e, 0x95, 0x14]];

// Commands and answers (AVR061, chapter 4).
const GET_SYNC: u8 = 0x30;
const ENTER_PROGRAMMING: u8 = 0x50;
const LEAVE_PROGRAMMING: u8 = 0x51;
const LOAD_ADDRESS: u8 = 0x55;
const PROGRAM_PAGE: u8 = 0x64;
const READ_PAGE: u8 = 0x74;
const READ_SIGNATURE: u8 = 0x75;
const END: u8 = 0x20;
const IN_SYNC: u8 = 0x14;
const OK: u8 = 0x10;

/// The first question after a reset: 65 ms of start-up have passed. It waits in the chip's buffer, which has room for no
/// more, while Optiboot blinks (0.4 s); so the next is sent that much later.
const FIRST_ASKED: Duration = Duration::from_millis(120);
const ASKED_AGAIN: Duration = Duration::from_millis(400);
const QUESTIONS: u32 = 4;

/// An answer takes at most so long: a page has 20 ms on the line at 57 600 baud and 9 ms to be erased and written.
const ANSWER: Duration = Duration::from_millis(500);

/// What came in so long after the first answer belongs to no question.
const DRAIN: Duration = Duration::from_millis(20);

/// Why an Uno cannot be programmed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum FlashError {
    /// No bootloader answers at this rate.
    #[error("no bootloader answers at {rate} baud")]
    NoBootloader {
        /// Bits a second.
        rate: u32,
    },
    /// Another chip than an Uno's.
    #[error(
        "this is no Uno: its chip has the signature {:02x} {:02x} {:02x}, an ATmega328P 1e 95 0f", signature[0], signature[1],
        signature[2]
    )]
    OtherChip {
        /// As the bootloader says.
        signature: [u8; 3],
    },
    /// The program does not fit before the bootloader.
    #[error("the program has {bytes} bytes; before the bootloader of {rate} baud there is room for {limit}")]
    TooLarge {
        /// Of the program.
        bytes: usize,
        /// What fits.
        limit: usize,
        /// Bits a second.
        rate: u32,
    },
    /// The program has no bytes.
    #[error("the program is empty")]
    Empty,
    /// The bootloader answered once, and then no more or something else, before anything was written.
    #[error("the bootloader answers no more when it is to begin")]
    NotBegun,
    /// The bootloader answered once, and then no more or something else.
    #[error("the bootloader no longer answers, at address {address:#06x} of the {doing}")]
    LostSync {
        /// Of flash.
        address: usize,
        /// "writing" or "reading back".
        doing: &'static str,
    },
    /// What was read back is something else.
    #[error("at address {address:#06x} the board has {read:#04x}, {written:#04x} was written")]
    Mismatch {
        /// Of flash: the first byte that differs.
        address: usize,
        /// What was written.
        written: u8,
        /// What was read back.
        read: u8,
    },
    /// The port is gone.
    #[error(transparent)]
    Port(#[from] PortError),
}

/// How far it is: bytes written, then bytes read back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Bytes that were written.
    Written(usize),
    /// Bytes that were read back and are right.
    Verified(usize),
}

/// A bootloader that has answered.
#[derive(Debug)]
pub struct Bootloader<P> {
    port: P,
    rate: u32,
}

impl<P: Port> Bootloader<P> {
    /// Finds the bootloader of a board that was reset just now, behind a port that is at `rate`.
    ///
    /// # Errors
    /// [`FlashError::NoBootloader`], [`FlashError::OtherChip`], or the port's.
    pub fn find(port: P, rate: u32) -> Result<Bootloader<P>, FlashError> {
        let mut found = Bootloader { port, rate };
        let began = found.port.now();
        for question in 0..QUESTIONS {
            found.wait(began + FIRST_ASKED + ASKED_AGAIN * question)?;
            found.port.send(&[GET_SYNC, END])?;
            let until = found.port.now() + ASKED_AGAIN;
            let mut answer = Vec::new();
            // What a program said before the reset may come first.
            while !answer.ends_with(&[IN_SYNC, OK]) && found.port.now() < until {
                found.port.receive(until, &mut answer)?;
            }
            if answer.ends_with(&[IN_SYNC, OK]) {
                let drained = found.port.now() + DRAIN;
                found.wait(drained)?;
                found.check_chip()?;
                return Ok(found);
            }
        }
        Err(FlashError::NoBootloader { rate })
    }

    fn check_chip(&mut self) -> Result<(), FlashError> {
        let signature = self.ask(&[READ_SIGNATURE], 3)?.ok_or(FlashError::NoBootloader { rate: self.rate })?;
        let signature = [signature[0], signature[1], signature[2]];
        if SIGNATURES.contains(&signature) { Ok(()) } else { Err(FlashError::OtherChip { signature }) }
    }

    /// Writes a program from address 0 on, reads it back, and starts it. What it does not fill of its last page becomes
    /// erased flash; pages after it stay as they are.
    ///
    /// # Errors
    /// [`FlashError`]: before anything is written [`FlashError::Empty`], [`FlashError::TooLarge`] and [`FlashError::NotBegun`]. After any
    /// other the board has no whole program, and still its bootloader.
    pub fn program(mut self, image: &[u8], mut progress: impl FnMut(Progress)) -> Result<P, FlashError> {
        let limit = room(self.rate);
        if image.is_empty() {
            return Err(FlashError::Empty);
        }
        if image.len() > limit {
            return Err(FlashError::TooLarge { bytes: image.len(), limit, rate: self.rate });
        }
        self.ask(&[ENTER_PROGRAMMING], 0)?.ok_or(FlashError::NotBegun)?;
        for (number, bytes) in image.chunks(PAGE).enumerate() {
            let address = number * PAGE;
            let mut page = [0xff; PAGE];
            page[..bytes.len()].copy_from_slice(bytes);
            self.load_address(address, "writing")?;
            self.at(address, "writing", &[&[PROGRAM_PAGE, 0, PAGE as u8, b'F'], page.as_slice()].concat(), 0)?;
            progress(Progress::Written(address + bytes.len()));
        }
        for (number, bytes) in image.chunks(PAGE).enumerate() {
            let address = number * PAGE;
            self.load_address(address, "reading back")?;
            let read = self.at(address, "reading back", &[READ_PAGE, 0, PAGE as u8, b'F'], PAGE)?;
            if let Some(at) = bytes.iter().zip(&read).position(|(written, read)| written != read) {
                return Err(FlashError::Mismatch { address: address + at, written: bytes[at], read: read[at] });
            }
            progress(Progress::Verified(address + bytes.len()));
        }
        // All is there and right; Optiboot is reset by its watchdog as it says so, and its answer may be lost.
        self.ask(&[LEAVE_PROGRAMMING], 0)?;
        Ok(self.port)
    }

    fn load_address(&mut self, address: usize, doing: &'static str) -> Result<(), FlashError> {
        // In words, low byte first.
        let [low, high, ..] = (address / 2).to_le_bytes();
        self.at(address, doing, &[LOAD_ADDRESS, low, high], 0).map(drop)
    }

    /// Asks, and says where it was if there is no answer.
    fn at(&mut self, address: usize, doing: &'static str, ask: &[u8], bytes: usize) -> Result<Vec<u8>, FlashError> {
        self.ask(ask, bytes)?.ok_or(FlashError::LostSync { address, doing })
    }

    /// A command: the bytes of its answer, or `None` if it is another than there should be.
    fn ask(&mut self, command: &[u8], bytes: usize) -> Result<Option<Vec<u8>>, FlashError> {
        self.port.send(&[command, &[END]].concat())?;
        let mut answer = Vec::new();
        let until = self.port.now() + ANSWER;
        while answer.len() < bytes + 2 && self.port.now() < until {
            self.port.receive(until, &mut answer)?;
        }
        let whole = answer.len() == bytes + 2 && answer[0] == IN_SYNC && answer[bytes + 1] == OK;
        Ok(whole.then(|| answer[1..=bytes].to_vec()))
    }

    /// Lets time pass; what comes meanwhile is nobody's.
    fn wait(&mut self, until: Duration) -> Result<(), FlashError> {
        let mut nobodys = Vec::new();
        while self.port.now() < until {
            self.port.receive(until, &mut nobodys)?;
        }
        Ok(())
    }
}
