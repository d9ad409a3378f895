//! Writes an Uno's flash through its bootloader: the part of STK500 version 1 (Atmel AVR061) that Optiboot and the older ATmegaBOOT know. What was
//! written is read back.
//!
//! A bootloader listens for about a second after a reset, so the board must have been reset just before.

use crate::{Port, PortError};
use std::time::Duration;
use thiserror::Error;

/// The rates of bootloaders, bits a second: of Optiboot, on Unos and newer Nanos, and of ATmegaBOOT, on older Nanos.
pub const RATES: [u32; 2] = [115_200, 57_600];

/// Bytes of an ATmega328P's flash.
pub const FLASH_BYTES: usize = 32 * 1024;

/// Bytes that a program may have: 32 KiB less the bootloader of that rate (Optiboot 512, ATmegaBOOT 2048).
#[must_use]
pub const fn room(rate: u32) -> usize {
    if rate == RATES[0] { FLASH_BYTES - 512 } else { FLASH_BYTES - 2048 }
}

/// Bytes of a page (ATmega328P DS40002061B §28.5).
const PAGE: usize = 128;

/// The signatures of the ATmega328P (DS40002061B §28.3) and of the ATmega328, which differs only in its sleep modes.
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

/// From the reset to the first request: the chip's start-up takes 65 ms.
const FIRST_REQUEST: Duration = Duration::from_millis(120);
/// From one request to the next. Optiboot blinks for 0.4 s before it reads, and the chip's receive buffer has room for one request only.
const REQUEST_EVERY: Duration = Duration::from_millis(400);
/// Requests before the search is given up: a bootloader listens for about a second.
const REQUESTS: u32 = 4;

/// How long an answer may take. A page takes 20 ms on the line at 57 600 baud, and 9 ms to be erased and written; the rest is for USB.
const ANSWER: Duration = Duration::from_millis(500);

/// For this long after the first answer, bytes are dropped: they answer an earlier request.
const DRAIN: Duration = Duration::from_millis(20);

/// Why an Uno cannot be programmed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum FlashError {
    /// No bootloader answered at this rate.
    #[error("no bootloader answers at {rate} baud")]
    NoBootloader {
        /// Bits a second.
        rate: u32,
    },
    /// The chip is not an Uno's.
    #[error(
        "this is no Uno: its chip has the signature {:02x} {:02x} {:02x}, an ATmega328P 1e 95 0f", signature[0], signature[1],
        signature[2]
    )]
    OtherChip {
        /// The signature that the bootloader reported.
        signature: [u8; 3],
    },
    /// The program is too long to fit before the bootloader.
    #[error("the program has {bytes} bytes; before the bootloader of {rate} baud there is room for {limit}")]
    TooLarge {
        /// Bytes of the program.
        bytes: usize,
        /// Bytes that fit.
        limit: usize,
        /// The rate of the bootloader, bits a second.
        rate: u32,
    },
    /// The program has no bytes.
    #[error("the program is empty")]
    Empty,
    /// The bootloader answered once, and then not or wrongly, before anything was written.
    #[error("the bootloader answers no more when it is to begin")]
    NotBegun,
    /// The bootloader stopped answering, or answered wrongly, while flash was written or read back.
    #[error("the bootloader no longer answers, at address {address:#06x} of the {doing}")]
    LostSync {
        /// The address in flash.
        address: usize,
        /// "writing" or "reading back".
        doing: &'static str,
    },
    /// A byte that was read back differs from what was written.
    #[error("at address {address:#06x} the board has {read:#04x}, {written:#04x} was written")]
    Mismatch {
        /// The address in flash of the first byte that differs.
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

/// The progress of programming: first writing, then reading back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// How many bytes were written.
    Written(usize),
    /// How many bytes were read back and are right.
    Verified(usize),
}

/// A bootloader that has answered, at the other end of a port.
#[derive(Debug)]
pub struct Bootloader<P> {
    port: P,
    rate: u32,
}

impl<P: Port> Bootloader<P> {
    /// Finds the bootloader of a board that was reset just before. The port must be at `rate`, bits a second.
    ///
    /// # Errors
    /// [`FlashError::NoBootloader`], [`FlashError::OtherChip`], or the port's.
    pub fn find(port: P, rate: u32) -> Result<Bootloader<P>, FlashError> {
        let mut found = Bootloader { port, rate };
        let began = found.port.now();
        for request in 0..REQUESTS {
            found.wait(began + FIRST_REQUEST + REQUEST_EVERY * request)?;
            found.port.send(&[GET_SYNC, END])?;
            let until = found.port.now() + REQUEST_EVERY;
            let mut answer = Vec::new();
            // Bytes that a program sent before the reset may come first.
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

    /// Writes a program from address 0, reads it back, and starts it. The rest of its last page becomes erased flash; later pages are not changed.
    ///
    /// # Errors
    /// [`FlashError::Empty`], [`FlashError::TooLarge`] and [`FlashError::NotBegun`] come before anything is written. After any other error the board has
    /// no complete program, but still its bootloader.
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
        // The answer does not matter: everything is written and right, and Optiboot's reset by its watchdog may cut the answer off.
        self.ask(&[LEAVE_PROGRAMMING], 0)?;
        Ok(self.port)
    }

    fn load_address(&mut self, address: usize, doing: &'static str) -> Result<(), FlashError> {
        // In words, low byte first.
        let [low, high, ..] = (address / 2).to_le_bytes();
        self.at(address, doing, &[LOAD_ADDRESS, low, high], 0).map(drop)
    }

    /// Sends a command, and turns a missing or wrong answer into an error with the address.
    fn at(&mut self, address: usize, doing: &'static str, ask: &[u8], bytes: usize) -> Result<Vec<u8>, FlashError> {
        self.ask(ask, bytes)?.ok_or(FlashError::LostSync { address, doing })
    }

    /// Sends a command. Returns the `bytes` bytes of its answer, or `None` if the answer is missing or wrong.
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

    /// Waits until a time of the port, and drops the bytes that come meanwhile.
    fn wait(&mut self, until: Duration) -> Result<(), FlashError> {
        let mut dropped = Vec::new();
        while self.port.now() < until {
            self.port.receive(until, &mut dropped)?;
        }
        Ok(())
    }
}
