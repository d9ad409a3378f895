//! The flash chip on a Pico's board, at the other end of the interface's wires: a Winbond W25Q16JV (datasheet rev. H, §8.2), its
//! commands of one line each way, and how long they take.
//!
//! Here are Write Enable (06h), Write Disable (04h), Read Status Register-1 (05h), Read Data (03h), Page Program (02h), Sector Erase (20h)
//! and Read Unique ID (4Bh); others do nothing. Nothing is protected. What is erased or programmed changes byte by byte over the time that
//! it takes, so that what is left by a supply that fails meanwhile is neither the old nor the new; on a chip it is any mixture.

/// Commands.
mod command {
    pub(super) const PAGE_PROGRAM: u8 = 0x02;
    pub(super) const READ: u8 = 0x03;
    pub(super) const WRITE_DISABLE: u8 = 0x04;
    pub(super) const READ_STATUS: u8 = 0x05;
    pub(super) const WRITE_ENABLE: u8 = 0x06;
    pub(super) const SECTOR_ERASE: u8 = 0x20;
    pub(super) const READ_UNIQUE_ID: u8 = 0x4b;
}

/// Bytes of a command and its address.
const HEAD: usize = 4;
/// Bytes after Read Unique ID of which nothing is said.
const SILENT: usize = 4;

/// Bits of Status Register-1 (§7.1).
const BUSY: u8 = 1 << 0;
const WRITE_ENABLED: u8 = 1 << 1;

/// From one byte that is erased or programmed to the next: all over the place.
const STRIDE: usize = 1237;

const PAGE: usize = 256;
const SECTOR: usize = 4096;

/// What lines say that nobody drives.
const NOTHING: u8 = 0xff;

/// How long a page's programming and a sector's erasure take, µs (§9.6, tPP and tSE): as a rule, and at most.
const TYPICAL_US: [u64; 2] = [400, 45_000];
const LONGEST_US: [u64; 2] = [3_000, 400_000];

#[derive(Clone)]
pub(super) struct Flash {
    memory: Vec<u8>,
    /// The number of the chip.
    pub(super) id: [u8; 8],
    takes_us: [u64; 2],
    /// Cycles a second.
    clock_hz: u64,
    write_enabled: bool,
    /// The first bytes of the command under way, and how many bytes have come so far.
    head: [u8; HEAD],
    sent: usize,
    /// The page that is to be programmed.
    page: [u8; PAGE],
    work: Option<FlashWork>,
}

/// What takes its time.
#[derive(Clone)]
struct FlashWork {
    at: usize,
    /// What is programmed; `None`: a sector is erased.
    page: Option<[u8; PAGE]>,
    began: u64,
    cycles: u64,
    done: usize,
}

impl Flash {
    /// One of a power of two of bytes, erased beyond the image.
    pub(super) fn new(image: &[u8], bytes: usize) -> Flash {
        let mut memory = image.to_vec();
        memory.resize(bytes, 0xff);
        Flash {
            memory,
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
        &mut self.memory
    }

    pub(super) const fn set_clock(&mut self, hz: u64) {
        self.clock_hz = hz;
    }

    /// From now on it takes as long as the datasheet lets it.
    pub(super) const fn be_slow(&mut self) {
        self.takes_us = LONGEST_US;
    }

    /// A byte goes each way.
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
                // Not heard.
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
                // It goes on at the page's beginning.
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

    /// Chip select goes up: what was said is done now.
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

    /// What was done of the work by then.
    pub(super) fn settle(&mut self, cycle: u64) {
        let Some(work) = &mut self.work else { return };
        let len = if work.page.is_some() { PAGE } else { SECTOR };
        let passed = cycle.saturating_sub(work.began);
        let is_over = passed >= work.cycles;
        let until = if is_over { len } else { (len as u64 * passed / work.cycles) as usize };
        for place in (work.done..until).map(|done| done * STRIDE % len) {
            let byte = &mut self.memory[work.at + place];
            // Programming makes zeros of ones, never the reverse.
            *byte = work.page.map_or(0xff, |page| *byte & page[place]);
        }
        work.done = until;
        if is_over {
            (self.work, self.write_enabled) = (None, false);
        }
    }

    /// Whether what is read in place is what it holds.
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

    /// What comes back while a command's bytes go out, from one fall of chip select to its rise.
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
        // Nothing but the status meanwhile.
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
