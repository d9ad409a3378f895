//! Flash as memory, with its cache (RP2040 datasheet §2.6.3). Commands to the flash chip are in `ssi`.
//!
//! The cache is the chip's: 16 kB, two ways, lines of 8 bytes, no wait cycles on a hit. The datasheet does not say
//! which way a new line replaces; here it is the one that was used less recently. The cost of a miss depends on how the
//! second stage of boot sets up the flash. Here it is [`MISS`].

use super::flash::Flash;

/// Wait cycles of a miss, for quad reads at half of clk_sys: 8 clocks of address and mode, 4 of turnaround and 16 of
/// data, two cycles each, and 4 cycles in the interface. (est.)
pub(super) const MISS: u32 = 60;
const SETS: usize = 1024;
/// The number of no line: this place in the cache is empty.
const EMPTY: u32 = u32::MAX;

#[derive(Clone)]
pub(super) struct Xip {
    /// The flash chip.
    pub(super) flash: Flash,
    /// The line numbers in each set; the line that was used last comes first.
    sets: Vec<[u32; 2]>,
    /// The line of the last look-up. Most fetches are from it.
    last: u32,
    control: u32,
    hits: u32,
    accesses: u32,
}

impl Xip {
    /// A flash whose size is a power of two bytes, erased beyond the end of the image.
    pub(super) fn new(image: &[u8], bytes: usize) -> Xip {
        Xip {
            flash: Flash::new(image, bytes),
            sets: vec![[EMPTY; 2]; SETS],
            last: EMPTY,
            control: 3,
            hits: 0,
            accesses: 0,
        }
    }

    pub(super) fn flush(&mut self) {
        self.sets.fill([EMPTY; 2]);
        self.last = EMPTY;
    }

    fn offset(&self, address: u32) -> usize {
        address as usize & (self.flash.memory().len() - 1)
    }

    /// Reads a half-word, without wait cycles and without the cache.
    #[inline]
    pub(super) fn half(&self, address: u32) -> u16 {
        let at = self.offset(address & !1);
        let memory = self.flash.memory();
        u16::from_le_bytes([memory[at], memory[at + 1]])
    }

    pub(super) fn word(&self, address: u32) -> u32 {
        u32::from(self.half(address & !3)) | u32::from(self.half(address & !3 | 2)) << 16
    }

    /// Wait cycles of a read. The alias in the address says how it uses the cache: 0x10… fully, 0x11… without filling
    /// it, 0x12… without hits, 0x13… not at all.
    #[inline]
    pub(super) fn waits(&mut self, address: u32) -> u32 {
        let line = (address & 0x00ff_ffff) >> 3;
        if line == self.last && address >> 24 == 0x10 {
            (self.hits, self.accesses) = (self.hits.wrapping_add(1), self.accesses.wrapping_add(1));
            return 0;
        }
        self.look_up(line, address >> 24 & 3)
    }

    fn look_up(&mut self, line: u32, alias: u32) -> u32 {
        let (looks, fills) = if self.control & 1 != 0 { (alias & 2 == 0, alias & 1 == 0) } else { (false, false) };
        self.accesses = self.accesses.wrapping_add(1);
        let set = &mut self.sets[line as usize % SETS];
        let hit = set.contains(&line);
        if hit && looks || fills {
            if set[0] != line {
                set[1] = set[0];
                set[0] = line;
            }
            self.last = line;
        }
        if hit && looks {
            self.hits = self.hits.wrapping_add(1);
            return 0;
        }
        MISS
    }

    /// A write removes the line from the cache (§2.6.3.2).
    pub(super) fn invalidate(&mut self, address: u32) {
        let line = (address & 0x00ff_ffff) >> 3;
        for way in &mut self.sets[line as usize % SETS] {
            if *way == line {
                *way = EMPTY;
            }
        }
        self.last = EMPTY;
    }

    // XIP_CTRL (§2.6.3.6).

    pub(super) fn read(&self, offset: u32) -> u32 {
        match offset {
            0x00 => self.control,
            // A flush takes no time here, and the streaming FIFO is always empty.
            0x08 => 3,
            0x0c => self.hits,
            0x10 => self.accesses,
            _ => 0,
        }
    }

    pub(super) fn write(&mut self, offset: u32, value: u32) {
        match offset {
            0x00 => self.control = value & 0xb,
            0x04 if value & 1 != 0 => self.flush(),
            0x0c => self.hits = 0,
            0x10 => self.accesses = 0,
            _ => {}
        }
        self.last = EMPTY;
    }
}
