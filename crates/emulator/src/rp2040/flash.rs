//! The flash chip on a Pico's board: a Winbond W25Q16JV (datasheet rev. H, §8.2), its commands with one line each way,
//! and the time that they take. The interface to it is `ssi`.
//!
//! The commands are Write Enable (06h), Write Disable (04h), Read Status Register-1 (05h), Read Data (03h), Page
//! Program (02h), Sector Erase (20h) and Read Unique ID (4Bh). Other commands do nothing, and no sector is protected.
//! Erasing and programming change one byte after another over their time. So when the supply fails meanwhile, some
//! bytes are old and some new; on a real chip it may be any mixture of bits.

use std::sync::Arc;

/// Command bytes.
mod command {
    pub(super) const PAGE_PROGRAM: u8 = 0x02;
    pub(super) const READ: u8 = 0x03;
    pub(super) const WRITE_DISABLE: u8 = 0x04;
    pub(super) const READ_STATUS: u8 = 0x05;
    pub(super) const WRITE_ENABLE: u8 = 0x06;
    pub(super) const SECTOR_ERASE: u8 = 0x20;
    pub(super) const READ_UNIQUE_ID: u8 = 0x4b;
}

/// Length of a command with its address, bytes.
const HEAD: usize = 4;
/// Dummy bytes after Read Unique ID, before the number comes.
const SILENT: usize = 4;

/// Bits of Status Register-1 (§7.1).
const BUSY: u8 = 1 << 0;
const WRITE_ENABLED: u8 = 1 << 1;

/// Distance from one byte that is erased or programmed to the next, bytes. It is odd, so that the sequence visits every
/// byte of a sector, scattered.
const STRIDE: usize = 1237;

const PAGE: usize = 256;
const SECTOR: usize = 4096;

/// The byte that is read while nothing drives the data line.
const NOTHING: u8 = 0xff;

/// Time to program a page and to erase a sector, µs: typical, and at most (§9.6, tPP and tSE).
const TYPICAL_US: [u64; 2] = [400, 45_000];
const LONGEST_US: [u64; 2] = [3_000, 400_000];

#[derive(Clone)]
pub(super) struct Flash {
    /// Its bytes. Clones of a chip share them until one of them is written, as they are most of what a chip holds.
    memory: Arc<[u8]>,
    /// The chip's unique number.
    pub(super) id: [u8; 8],
    takes_us: [u64; 2],
    /// Frequency of the cycles, Hz.
    clock_hz: u64,
    write_enabled: bool,
    /// The first bytes of the present command, and how many bytes have come.
    head: [u8; HEAD],
    sent: usize,
    /// The data of the page to be programmed.
    page: [u8; PAGE],
    work: Option<FlashWork>,
}

/// An erase or program operation that is running.
#[derive(Clone)]
struct FlashWork {
    at: usize,
    /// The data to be programmed; `None`: a sector is erased.
    page: Option<[u8; PAGE]>,
    began: u64,
    cycles: u64,
    done: usize,
}

impl Flash {
    /// A flash whose size is a power of two bytes, erased beyond the end of the image.
    pub(super) fn new(image: &[u8], bytes: usize) -> Flash {
        let mut memory = image.to_vec();
        memory.resize(bytes, 0xff);
        Flash {
            memory: memory.into(),
            id: *b"\xe6\x60\x58\x38\x83\x2a\x51\x2e",
            takes_us: TYPICAL_US,
            clock_hz: 1,
            write_enabled: false,
            head: [0; HEAD],
            sent: 0,
            page: [0xff; PAGE],
            work: None,
        }
    }

    pub(super) fn memory(&self) -> &[u8] {
        &self.memory
    }

    pub(super) fn memory_mut(&mut self) -> &mut [u8] {
        Arc::make_mut(&mut self.memory)
    }

    pub(super) const fn set_clock(&mut self, hz: u64) {
        self.clock_hz = hz;
    }

    /// From now on operations take their longest times.
    pub(super) const fn be_slow(&mut self) {
        self.takes_us = LONGEST_US;
    }

    /// Exchanges one byte each way.
    pub(super) fn exchange(&mut self, byte: u8, cycle: u64) -> u8 {
        self.settle(cycle);
        let place = self.sent;
        self.sent += 1;
        if let Some(head) = self.head.get_mut(place) {
            *head = byte;
        }
        if place == 0 {
            self.page = [0xff; PAGE];
            if self.work.is_some() && byte != command::READ_STATUS {
                // A busy chip ignores the command.
                self.head[0] = 0;
            }
            return NOTHING;
        }
        match self.head[0] {
            command::READ_STATUS => {
                let busy = if self.work.is_some() { BUSY } else { 0 };
                busy | if self.write_enabled { WRITE_ENABLED } else { 0 }
            }
            command::READ_UNIQUE_ID if place > SILENT => self.id[(place - SILENT - 1) % self.id.len()],
            command::READ if place >= HEAD => {
                let at = (self.address() + place - HEAD) % self.memory.len();
                self.memory[at]
            }
            command::PAGE_PROGRAM if place >= HEAD => {
                // Beyond the end of the page, programming goes on at its beginning.
                self.page[(self.address() + place - HEAD) % PAGE] = byte;
                NOTHING
            }
            _ => NOTHING,
        }
    }

    fn address(&self) -> usize {
        let [_, high, middle, low] = self.head;
        u32::from_be_bytes([0, high, middle, low]) as usize % self.memory.len()
    }

    /// Chip select rises: the command is executed now.
    pub(super) fn deselect(&mut self, cycle: u64) {
        self.settle(cycle);
        let sent = std::mem::take(&mut self.sent);
        match self.head[0] {
            command::WRITE_ENABLE if sent == 1 => self.write_enabled = true,
            command::WRITE_DISABLE if sent == 1 => self.write_enabled = false,
            command::PAGE_PROGRAM if sent > HEAD && self.write_enabled => {
                self.begin(self.address() & !(PAGE - 1), Some(self.page), cycle);
            }
            command::SECTOR_ERASE if sent == HEAD && self.write_enabled => {
                self.begin(self.address() & !(SECTOR - 1), None, cycle);
            }
            _ => {}
        }
    }

    fn begin(&mut self, at: usize, page: Option<[u8; PAGE]>, began: u64) {
        let takes_us = self.takes_us[usize::from(page.is_none())];
        self.work = Some(FlashWork { at, page, began, cycles: takes_us * self.clock_hz / 1_000_000, done: 0 });
    }

    /// Brings the bytes up to what the operation has done by a cycle.
    pub(super) fn settle(&mut self, cycle: u64) {
        let Some(work) = &mut self.work else { return };
        let len = if work.page.is_some() { PAGE } else { SECTOR };
        let passed = cycle.saturating_sub(work.began);
        let is_over = passed >= work.cycles;
        let until = if is_over { len } else { (len as u64 * passed / work.cycles) as usize };
        let memory = Arc::make_mut(&mut self.memory);
        for place in (work.done..until).map(|done| done * STRIDE % len) {
            let byte = &mut memory[work.at + place];
            // Programming turns ones to zeros, never the reverse.
            *byte = work.page.map_or(0xff, |page| *byte & page[place]);
        }
        work.done = until;
        if is_over {
            (self.work, self.write_enabled) = (None, false);
        }
    }

    /// Whether an operation is running, so that flash cannot be read.
    pub(super) const fn is_busy(&self) -> bool {
        self.work.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chip of four sectors whose bytes are all zero; a cycle is a microsecond.
    fn zeros() -> Flash {
        let mut flash = Flash::new(&[0; 4 * SECTOR], 4 * SECTOR);
        flash.set_clock(1_000_000);
        flash
    }

    /// The bytes that come back while a command's bytes go out, from the fall of chip select to its rise.
    fn say(flash: &mut Flash, cycle: u64, bytes: &[u8]) -> Vec<u8> {
        let said = bytes.iter().map(|byte| flash.exchange(*byte, cycle)).collect();
        flash.deselect(cycle);
        said
    }

    fn status(flash: &mut Flash, cycle: u64) -> u8 {
        say(flash, cycle, &[command::READ_STATUS, 0])[1]
    }

    #[test]
    fn a_sector_is_erased_if_that_was_allowed() {
        let mut flash = zeros();
        let erase = [command::SECTOR_ERASE, 0, 0x12, 0x34];
        say(&mut flash, 0, &erase);
        assert_eq!(status(&mut flash, 0), 0, "not enabled");
        say(&mut flash, 0, &[command::WRITE_ENABLE]);
        assert_eq!(status(&mut flash, 0), WRITE_ENABLED);
        say(&mut flash, 0, &[command::WRITE_DISABLE]);
        assert_eq!(status(&mut flash, 0), 0);
        say(&mut flash, 0, &[command::WRITE_ENABLE]);
        say(&mut flash, 10, &erase);
        assert_eq!(status(&mut flash, 45_009), BUSY | WRITE_ENABLED);
        // While it is busy, the chip answers nothing but its status.
        assert_eq!(say(&mut flash, 45_009, &[command::READ, 0, 0, 0, 0])[4], NOTHING);
        assert_eq!(status(&mut flash, 45_010), 0);
        let erased = SECTOR..2 * SECTOR;
        let is_right = |(at, byte): (usize, &u8)| *byte == if erased.contains(&at) { 0xff } else { 0 };
        assert!(flash.memory().iter().enumerate().all(is_right));
    }

    #[test]
    fn a_page_is_programmed_from_ones_to_zeros_and_goes_round() {
        let mut flash = zeros();
        flash.memory_mut()[..PAGE].fill(0xff);
        flash.memory_mut()[1] = 0x0f;
        say(&mut flash, 0, &[command::WRITE_ENABLE]);
        say(&mut flash, 0, &[command::PAGE_PROGRAM, 0, 0, 254, 1, 2, 3, 0x35]);
        assert_eq!(status(&mut flash, 399), BUSY | WRITE_ENABLED);
        assert_eq!(status(&mut flash, 400), 0);
        assert_eq!((flash.memory()[254], flash.memory()[255]), (1, 2));
        assert_eq!(flash.memory()[..3], [3, 0x05, 0xff]);
        assert_eq!(say(&mut flash, 400, &[command::READ, 0, 0, 254, 0, 0, 0])[4..], [1, 2, 0], "on into the next page");
    }

    #[test]
    fn a_supply_that_fails_leaves_neither_the_old_nor_the_new() {
        let mut flash = zeros();
        flash.be_slow();
        say(&mut flash, 0, &[command::WRITE_ENABLE]);
        say(&mut flash, 0, &[command::SECTOR_ERASE, 0, 0, 0]);
        flash.settle(200_000);
        let ones = flash.memory().iter().filter(|byte| **byte == 0xff).count();
        assert_eq!(ones, SECTOR / 2);
    }
}
