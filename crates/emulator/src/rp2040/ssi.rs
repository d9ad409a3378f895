//! The serial interface to the flash chip, for commands of bytes (RP2040 datasheet §4.10). The flash chip is in
//! `flash`.
//!
//! Reading flash as memory is in `xip`. A byte takes no time here: it goes out and its answer comes back within one
//! write.

use super::flash::Flash;
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

/// CTRLR0 as the second stage of boot leaves it: frames of 32 bits, EEPROM read mode.
const FOR_READING: u32 = 31 << 16 | 3 << 8;
/// CTRLR0 for frames of 8 bits with one line each way. Clock phase and polarity do not matter.
const BYTES: u32 = 7 << 16;
const BYTES_MASK: u32 = 3 << 21 | 31 << 16 | 3 << 8 | 3 << 4;

/// Depth of a FIFO, frames (§4.10.4).
const FIFO: usize = 16;

/// Bits of SR.
const NOT_FULL: u32 = 1 << 1 | 1 << 2;
const RECEIVED: u32 = 1 << 3;

#[derive(Clone)]
pub(super) struct Ssi {
    registers: BTreeMap<u32, u32>,
    received: VecDeque<u8>,
    /// Whether an override of the chip select pin holds it low.
    selected: bool,
    /// Whether the interface is set up to read flash as memory.
    reads_in_place: bool,
}

impl Ssi {
    pub(super) fn new() -> Ssi {
        let registers = BTreeMap::from([(at::CTRLR0, FOR_READING), (at::SSIENR, 1)]);
        Ssi { registers, received: VecDeque::new(), selected: false, reads_in_place: true }
    }

    /// Resets the interface to its state after boot. The flash chip keeps its contents.
    pub(super) fn reset(&mut self, flash: &mut Flash, cycle: u64) {
        *self = Ssi::new();
        flash.deselect(cycle);
    }

    /// Whether flash can be read as memory. This is called for every instruction from flash.
    #[inline]
    pub(super) const fn reads_in_place(&self) -> bool {
        self.reads_in_place
    }

    fn register(&self, offset: u32) -> u32 {
        self.registers.get(&offset).copied().unwrap_or(0)
    }

    fn is_enabled(&self) -> bool {
        self.register(at::SSIENR) & 1 != 0
    }

    /// Sets the override of the chip select output (§2.19.6.2, OUTOVER): 2 is low. A rising chip select executes the
    /// command.
    pub(super) fn set_select(&mut self, over: u32, flash: &mut Flash, cycle: u64) {
        self.selected = over == 2;
        if !self.selected {
            flash.deselect(cycle);
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

    pub(super) fn write(&mut self, offset: u32, value: u32, flash: &mut Flash, cycle: u64) {
        match offset {
            at::SSIENR => {
                self.registers.insert(offset, value & 1);
                // Both FIFOs are cleared while the interface is off (§4.10.13).
                if value & 1 == 0 {
                    self.received.clear();
                }
            }
            at::DR0..=at::DR_LAST => self.exchange(value, flash, cycle),
            // The set-up registers cannot be written while the interface is on.
            _ if offset < at::TXFLR && self.is_enabled() => {}
            _ => {
                self.registers.insert(offset, value);
            }
        }
        self.reads_in_place = self.is_enabled() && self.register(at::CTRLR0) & BYTES_MASK != BYTES;
    }

    fn exchange(&mut self, value: u32, flash: &mut Flash, cycle: u64) {
        if !self.is_enabled() || self.register(at::CTRLR0) & BYTES_MASK != BYTES || self.received.len() == FIFO {
            return;
        }
        let answer = flash.exchange(value as u8, cycle);
        if !self.selected {
            // No more data wait, so that the interface raises chip select after each byte.
            flash.deselect(cycle);
        }
        self.received.push_back(answer);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bytes that come back while a command's bytes go out.
    fn answers(ssi: &mut Ssi, flash: &mut Flash, bytes: &[u8]) -> Vec<u32> {
        bytes
            .iter()
            .map(|byte| {
                ssi.write(at::DR0, u32::from(*byte), flash, 0);
                assert_eq!(ssi.read(at::SR) & RECEIVED, RECEIVED);
                ssi.read(at::DR0)
            })
            .collect()
    }

    #[test]
    fn the_number_is_read_as_the_chip_s_datasheet_has_it() {
        let (mut ssi, mut flash) = (Ssi::new(), Flash::new(&[], 4096));
        ssi.write(at::CTRLR0, BYTES, &mut flash, 0);
        assert_eq!(ssi.read(at::CTRLR0), FOR_READING, "while it is on nothing of the set-up changes");
        ssi.write(at::DR0, 0x4b, &mut flash, 0);
        assert_eq!(ssi.read(at::RXFLR), 0, "frames of 32 bits are for reading in place");
        assert!(ssi.reads_in_place());
        ssi.write(at::SSIENR, 0, &mut flash, 0);
        ssi.write(at::CTRLR0, BYTES, &mut flash, 0);
        ssi.write(at::SSIENR, 1, &mut flash, 0);
        assert!(!ssi.reads_in_place());
        let command = [0x4b, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        assert_eq!(answers(&mut ssi, &mut flash, &command), [0xff; 13], "chip select goes up after each byte");
        ssi.set_select(2, &mut flash, 0);
        let number = flash.id.map(u32::from);
        let said = answers(&mut ssi, &mut flash, &command);
        assert_eq!((&said[..5], &said[5..]), (&[0xff; 5][..], &number[..]));
        ssi.set_select(3, &mut flash, 0);
        ssi.set_select(2, &mut flash, 0);
        assert_eq!(answers(&mut ssi, &mut flash, &[0x9f, 0, 0]), [0xff; 3], "another command");
    }
}
