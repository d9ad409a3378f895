//! The serial interface to the flash chip, for commands of bytes (RP2040 datasheet §4.10), and the chip's answers to them
//! (Winbond W25Q16JV, rev. H, §8.2).
//!
//! Reading in place is not here: see `xip`, which takes no notice of how this is set up. A byte is there and back at once.

use std::collections::{BTreeMap, VecDeque};

/// Offsets of registers (§4.10.13).
mod at {
    pub(super) const CTRLR0: u32 = 0x00;
    pub(super) const SSIENR: u32 = 0x08;
    pub(super) const TXFLR: u32 = 0x20;
    pub(super) const RXFLR: u32 = 0x24;
    pub(super) const SR: u32 = 0x28;
    pub(super) const DR0: u32 = 0x60;
    pub(super) const DR_LAST: u32 = 0xec;
}

/// CTRLR0 as the second stage of boot leaves it: frames of 32 bits, read as from an EEPROM.
const FOR_READING: u32 = 31 << 16 | 3 << 8;
/// CTRLR0 of frames of 8 bits, one line each way, whatever clock phase and polarity.
const BYTES: u32 = 7 << 16;
const BYTES_MASK: u32 = 3 << 21 | 31 << 16 | 3 << 8 | 3 << 4;

/// Frames of a FIFO (§4.10.4).
const FIFO: usize = 16;

/// Bits of SR.
const NOT_FULL: u32 = 1 << 1 | 1 << 2;
const RECEIVED: u32 = 1 << 3;

/// Read Unique ID: four bytes follow of which nothing is said, then the number.
const READ_UNIQUE_ID: u8 = 0x4b;
const SILENT: usize = 4;

#[derive(Clone)]
pub(super) struct Ssi {
    registers: BTreeMap<u32, u32>,
    received: VecDeque<u8>,
    /// The number of the flash chip.
    pub(super) id: [u8; 8],
    /// Chip select is held low by its pin's override.
    selected: bool,
    /// The command that is under way, and bytes since then.
    command: Option<(u8, usize)>,
}

impl Ssi {
    pub(super) fn new() -> Ssi {
        let id = *b"\xe6\x60\x58\x38\x83\x2a\x51\x2e";
        let registers = BTreeMap::from([(at::CTRLR0, FOR_READING), (at::SSIENR, 1)]);
        Ssi { registers, received: VecDeque::new(), id, selected: false, command: None }
    }

    /// As after boot; the flash chip stays the same.
    pub(super) fn reset(&mut self) {
        *self = Ssi { id: self.id, ..Ssi::new() };
    }

    fn register(&self, offset: u32) -> u32 {
        self.registers.get(&offset).copied().unwrap_or(0)
    }

    fn is_enabled(&self) -> bool {
        self.register(at::SSIENR) & 1 != 0
    }

    /// The override of the chip select's output (§2.19.6.2, OUTOVER): 2 is low. An edge up ends the chip's command.
    pub(super) fn set_select(&mut self, over: u32) {
        self.selected = over == 2;
        if !self.selected {
            self.command = None;
        }
    }

    pub(super) fn read(&mut self, offset: u32) -> u32 {
        match offset {
            at::TXFLR => 0,
            at::RXFLR => self.received.len() as u32,
            at::SR => NOT_FULL | if self.received.is_empty() { 0 } else { RECEIVED },
            at::DR0..=at::DR_LAST => self.received.pop_front().map_or(0, u32::from),
            _ => self.register(offset),
        }
    }

    pub(super) fn write(&mut self, offset: u32, value: u32) {
        match offset {
            at::SSIENR => {
                self.registers.insert(offset, value & 1);
                // §4.10.13: both FIFOs are cleared while it is off.
                if value & 1 == 0 {
                    self.received.clear();
                }
            }
            at::DR0..=at::DR_LAST => self.exchange(value),
            // Registers of the set-up cannot be written while it is on.
            _ if offset < at::TXFLR && self.is_enabled() => {}
            _ => {
                self.registers.insert(offset, value);
            }
        }
    }

    fn exchange(&mut self, value: u32) {
        if !self.is_enabled() || self.register(at::CTRLR0) & BYTES_MASK != BYTES || self.received.len() == FIFO {
            return;
        }
        let byte = value as u8;
        let answer = match &mut self.command {
            None => {
                self.command = Some((byte, 0));
                0xff
            }
            Some((command, at)) => {
                *at += 1;
                // Without end, as the chip goes on.
                if *command == READ_UNIQUE_ID && *at > SILENT { self.id[(*at - SILENT - 1) % 8] } else { 0xff }
            }
        };
        if !self.selected {
            // The interface lets go of the chip with each byte, as nothing more waits.
            self.command = None;
        }
        self.received.push_back(answer);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What comes back while a command's bytes go out.
    fn answers(ssi: &mut Ssi, bytes: &[u8]) -> Vec<u32> {
        bytes
            .iter()
            .map(|byte| {
                ssi.write(at::DR0, u32::from(*byte));
                assert_eq!(ssi.read(at::SR) & RECEIVED, RECEIVED);
                ssi.read(at::DR0)
            })
            .collect()
    }

    #[test]
    fn the_number_is_read_as_the_chip_s_datasheet_has_it() {
        let mut ssi = Ssi::new();
        ssi.write(at::CTRLR0, BYTES);
        assert_eq!(ssi.read(at::CTRLR0), FOR_READING, "while it is on nothing of the set-up changes");
        ssi.write(at::DR0, 0x4b);
        assert_eq!(ssi.read(at::RXFLR), 0, "frames of 32 bits are for reading in place");
        ssi.write(at::SSIENR, 0);
        ssi.write(at::CTRLR0, BYTES);
        ssi.write(at::SSIENR, 1);
        let command = [0x4b, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(answers(&mut ssi, &command), [0xff; 13], "chip select goes up after each byte");
        ssi.set_select(2);
        let number = ssi.id.map(u32::from);
        let said = answers(&mut ssi, &command);
        assert_eq!((&said[..5], &said[5..]), (&[0xff; 5][..], &number[..]));
        ssi.set_select(3);
        ssi.set_select(2);
        assert_eq!(answers(&mut ssi, &[0x9f, 0, 0]), [0xff; 3], "another command");
    }
}
