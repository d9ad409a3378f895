//! Self-programming (DS40002061B §27): `spm`, SPMCSR, the page buffer, lock bits and what reads fuses.
//!
//! The flash itself is the processor's: [`SelfProgramming::store`] says what is to become of it.

use super::peripherals::OPEN;

/// Words of a page (§28.5).
pub(super) const PAGE_WORDS: u16 = 64;
/// Where the section begins that can be read while the other is written, word address (table 27-8).
pub(super) const NRWW_START: u16 = 0x3800;
/// A page is erased or written, or lock bits are, in at most so long (table 27-5 has 3.7 to 4.5 ms).
const MICROSECONDS: u64 = 4500;

// SPMCSR (§27.9.1).
const SPMIE: u8 = 1 << 7;
const RWWSB: u8 = 1 << 6;
const SIGRD: u8 = 1 << 5;
const RWWSRE: u8 = 1 << 4;
const BLBSET: u8 = 1 << 3;
const PGWRT: u8 = 1 << 2;
const PGERS: u8 = 1 << 1;
const SPMEN: u8 = 1;
/// What may accompany SPMEN, one at a time.
const COMMAND: u8 = SIGRD | RWWSRE | BLBSET | PGWRT | PGERS | SPMEN;

/// Cycles within which `lpm` must follow to read fuses, lock bits or the signature row (§27.8.9 to §27.8.11).
const LPM_OPEN: u64 = 3;

/// Signature of the ATmega328P, at the even addresses of its row (table 28-8, table 27-6).
const SIGNATURE: [u8; 3] = [0x1e, 0x95, 0x0f];

/// `spm` as it is executed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Store {
    /// Z, byte address.
    pub(super) z: u16,
    /// R1:R0.
    pub(super) word: u16,
    /// Whether the instruction lies in the boot section.
    pub(super) from_boot: bool,
    /// Where the boot section begins, word address.
    pub(super) boot: u16,
    /// The cycle in which the instruction begins.
    pub(super) cycle: u64,
    /// The system clock's division.
    pub(super) division: u16,
}

/// What becomes of the flash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum FlashChange {
    /// The page that begins at a word address is erased.
    Erase(u16),
    /// Words are programmed from a word address on: bits can only become 0.
    Write(u16, Box<[u16; PAGE_WORDS as usize]>),
}

#[derive(Clone)]
pub(super) struct SelfProgramming {
    /// SPMIE, SIGRD to SPMEN as they were written last.
    control: u8,
    /// The cycle in which SPMCSR was written last; what is asked for there must come soon.
    asked_at: u64,
    /// When the erasing or writing that runs is done.
    busy_until: Option<u64>,
    /// RWWSB.
    section_busy: bool,
    /// What was loaded into the page buffer: a word can be loaded once.
    buffer: Box<[Option<u16>; PAGE_WORDS as usize]>,
    /// The lock byte (§28.1): bits are cleared, never set.
    pub(super) locks: u8,
}

impl SelfProgramming {
    pub(super) fn new() -> SelfProgramming {
        SelfProgramming {
            control: 0,
            asked_at: 0,
            busy_until: None,
            section_busy: false,
            buffer: Box::new([None; PAGE_WORDS as usize]),
            locks: 0xff,
        }
    }

    /// After a reset. What was being written is taken as written.
    pub(super) fn reset(&mut self) {
        let locks = self.locks;
        *self = SelfProgramming::new();
        self.locks = locks;
    }

    /// Whether the section that may be read while the other is written cannot be read now.
    pub(super) fn blocks(&self) -> bool {
        self.section_busy
    }

    /// Whether `lpm` may mean something else than to read flash.
    pub(super) fn attends(&self) -> bool {
        self.section_busy || self.locks != 0xff || self.control & (SIGRD | BLBSET) != 0
    }

    pub(super) fn read(&self, cycle: u64) -> u8 {
        let command = if self.busy_until.is_some() || self.is_asked(cycle) { self.control & COMMAND } else { 0 };
        self.control & SPMIE | command | if self.section_busy { RWWSB } else { 0 }
    }

    /// `eeprom_busy`: while the EEPROM is written SPMCSR cannot be (§27.8.8).
    pub(super) fn write(&mut self, value: u8, cycle: u64, eeprom_busy: bool) {
        if eeprom_busy {
            return;
        }
        if self.busy_until.is_some() {
            self.control = self.control & !SPMIE | value & SPMIE;
            return;
        }
        self.control = value & (SPMIE | COMMAND);
        self.asked_at = cycle;
        if value & (RWWSRE | SPMEN) == RWWSRE | SPMEN {
            // Written while the buffer is being loaded, it ends that (§27.9.1).
            self.clear_buffer();
        }
    }

    /// Whether `spm` comes soon enough, if it ends with `cycle`.
    fn is_asked(&self, cycle: u64) -> bool {
        self.control & SPMEN != 0 && cycle < self.asked_at + OPEN
    }

    fn clear_buffer(&mut self) {
        self.buffer.fill(None);
    }

    /// The EEPROM is written: what was loaded is lost (§27.8.1).
    pub(super) fn eeprom_written(&mut self) {
        self.clear_buffer();
    }

    /// `spm`: what it changes, and for how many cycles the processor is halted.
    pub(super) fn store(&mut self, store: Store) -> (Option<FlashChange>, u64) {
        if !store.from_boot || self.busy_until.is_some() || !self.is_asked(store.cycle + 1) {
            return (None, 0);
        }
        let at = (store.z >> 1) % (NRWW_START + 0x800);
        let page = at / PAGE_WORDS * PAGE_WORDS;
        let length = MICROSECONDS * 16 / u64::from(store.division);
        let in_boot = at >= store.boot;
        let change = match self.control & COMMAND {
            SPMEN => {
                let cell = &mut self.buffer[usize::from(at % PAGE_WORDS)];
                cell.get_or_insert(store.word);
                // Loading makes the section readable again (§27.9.1).
                self.section_busy = false;
                None
            }
            command if command == PGERS | SPMEN => self.may_write(in_boot).then_some(FlashChange::Erase(page)),
            command if command == PGWRT | SPMEN => {
                let mut words = Box::new([0xffff; PAGE_WORDS as usize]);
                for (word, loaded) in words.iter_mut().zip(&*self.buffer) {
                    *word = loaded.unwrap_or(0xffff);
                }
                self.clear_buffer();
                self.may_write(in_boot).then_some(FlashChange::Write(page, words))
            }
            command if command == BLBSET | SPMEN => {
                // The boot lock bits alone can be changed so: bits 5 to 2 of R0 (§27.8.8).
                self.locks &= store.word.to_le_bytes()[0] | !0x3c;
                self.busy_until = Some(store.cycle + 1 + length);
                return (None, 0);
            }
            command if command == RWWSRE | SPMEN => {
                self.section_busy = false;
                None
            }
            _ => None,
        };
        if change.is_none() {
            self.control &= SPMIE;
            return (None, 0);
        }
        if page >= NRWW_START {
            // Nothing can be read meanwhile: the processor stands still (§27.4.2).
            self.control &= SPMIE;
            return (change, length);
        }
        self.section_busy = true;
        self.busy_until = Some(store.cycle + 1 + length);
        (change, 0)
    }

    /// Boot lock bits keep `spm` out of a section: BLB01 for the application's, BLB11 for its own (table 27-2, 27-3).
    fn may_write(&self, in_boot: bool) -> bool {
        self.locks & if in_boot { 1 << 4 } else { 1 << 2 } != 0
    }

    /// `lpm` at `z` that begins in `cycle`: what it reads if not the flash.
    pub(super) fn load(&mut self, z: u16, fuses: [u8; 3], from_boot: bool, boot: u16, cycle: u64) -> Option<u8> {
        let soon = cycle < self.asked_at + LPM_OPEN && self.busy_until.is_none();
        match self.control & COMMAND {
            command if soon && command == SIGRD | SPMEN => {
                self.control &= SPMIE;
                let at = usize::from(z);
                // Between the signature's bytes lies the calibration of the internal oscillator: taken for 0xff.
                return Some(if at.is_multiple_of(2) { SIGNATURE.get(at / 2).copied().unwrap_or(0xff) } else { 0xff });
            }
            command if soon && command == BLBSET | SPMEN => {
                self.control &= SPMIE;
                let [low, high, extended] = fuses;
                return Some(match z {
                    0 => low,
                    1 => self.locks,
                    2 => extended,
                    _ => high,
                });
            }
            _ => {}
        }
        let at = z >> 1;
        let blocked = self.section_busy && at < NRWW_START;
        // BLB02 and BLB12 keep `lpm` of one section from reading the other.
        let locked = match (from_boot, at >= boot) {
            (true, false) => self.locks & 1 << 3 == 0,
            (false, true) => self.locks & 1 << 5 == 0,
            _ => false,
        };
        (blocked || locked).then_some(0xff)
    }

    /// When what runs is done; else when what was asked for comes too late: SPMEN is clear from then on.
    pub(super) fn next_event(&self) -> u64 {
        let too_late = (self.control & SPMEN != 0).then_some(self.asked_at + OPEN);
        self.busy_until.or(too_late).unwrap_or(u64::MAX)
    }

    pub(super) fn event(&mut self) {
        self.busy_until = None;
        self.control &= SPMIE;
    }

    /// The interrupt asks as long as SPMEN is clear (§27.9.1): not while something is written, nor between the request in SPMCSR and
    /// its `spm`.
    pub(super) fn pending(&self) -> bool {
        self.control & (SPMIE | SPMEN) == SPMIE && self.busy_until.is_none()
    }
}
