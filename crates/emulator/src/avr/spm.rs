//! Self-programming (DS40002061B §27): `spm`, SPMCSR, the page buffer, the lock bits, and `lpm` where it reads fuses,
//! lock bits or the signature.
//!
//! The flash itself belongs to the processor (`cpu`): [`SelfProgramming::store`] returns what is to change there.

use super::sequence::OPEN;

/// Words of a page (§28.5).
pub(super) const PAGE_WORDS: u16 = 64;
/// Word address of the no-read-while-write section. The section before it cannot be read while it is being written
/// (table 27-8).
pub(super) const NRWW_START: u16 = 0x3800;
/// Longest time of erasing or writing a page, or writing lock bits, µs (table 27-5: 3.7 to 4.5 ms).
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
/// The bits of SPMCSR that select a command. The valid values are SPMEN alone and SPMEN with one other bit.
const COMMAND: u8 = SIGRD | RWWSRE | BLBSET | PGWRT | PGERS | SPMEN;

/// Cycles within which `lpm` must follow to read fuses, lock bits or the signature row (§27.8.9 to §27.8.11).
const LPM_OPEN: u64 = 3;

/// Signature of the ATmega328P, at the even addresses of its row (table 28-8, table 27-6).
const SIGNATURE: [u8; 3] = [0x1e, 0x95, 0x0f];

/// The operands and circumstances of one `spm`.
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

/// A change of the flash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum FlashChange {
    /// The page that begins at a word address is erased.
    Erase(u16),
    /// The page that begins at a word address is programmed: a bit can only become 0.
    Write(u16, Box<[u16; PAGE_WORDS as usize]>),
}

#[derive(Clone)]
pub(super) struct SelfProgramming {
    /// SPMIE, and the command bits SIGRD to SPMEN, as last written.
    control: u8,
    /// The cycle in which SPMCSR was last written. `spm` or `lpm` must follow soon.
    asked_at: u64,
    /// The cycle in which the present erase or write is done.
    busy_until: Option<u64>,
    /// RWWSB: the read-while-write section is being written, or was written and not enabled again.
    section_busy: bool,
    /// The page buffer (`None`: erased). Each word can be loaded once.
    buffer: Box<[Option<u16>; PAGE_WORDS as usize]>,
    /// The lock byte (§28.1): `spm` can clear its bits, never set them.
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

    /// A reset. A write that runs is taken to be complete.
    pub(super) fn reset(&mut self) {
        let locks = self.locks;
        *self = SelfProgramming::new();
        self.locks = locks;
    }

    /// Whether the read-while-write section cannot be read now.
    pub(super) fn blocks(&self) -> bool {
        self.section_busy
    }

    /// Whether `lpm` may have to return something else than the byte in flash.
    pub(super) fn attends(&self) -> bool {
        self.section_busy || self.locks != 0xff || self.control & (SIGRD | BLBSET) != 0
    }

    pub(super) fn read(&self, cycle: u64) -> u8 {
        let command = if self.busy_until.is_some() || self.is_asked(cycle) { self.control & COMMAND } else { 0 };
        self.control & SPMIE | command | if self.section_busy { RWWSB } else { 0 }
    }

    /// Writes SPMCSR. While the EEPROM is being written (`eeprom_busy`), SPMCSR cannot be written (§27.8.8).
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
            // RWWSRE with SPMEN clears the page buffer if it is being loaded (§27.9.1).
            self.clear_buffer();
        }
    }

    /// Whether an `spm` that ends with `cycle` comes soon enough after the write of SPMCSR.
    fn is_asked(&self, cycle: u64) -> bool {
        self.control & SPMEN != 0 && cycle < self.asked_at + OPEN
    }

    fn clear_buffer(&mut self) {
        self.buffer.fill(None);
    }

    /// A write to the EEPROM clears the page buffer (§27.8.1).
    pub(super) fn eeprom_written(&mut self) {
        self.clear_buffer();
    }

    /// Executes `spm`. Returns the change of the flash, and for how many cycles the processor is halted.
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
                // Loading the buffer enables the read-while-write section again (§27.9.1).
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
                // `spm` can change the boot lock bits alone: bits 5 to 2 of R0 (§27.8.8).
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
            // The no-read-while-write section halts the processor while it is written (§27.4.2).
            self.control &= SPMIE;
            return (change, length);
        }
        self.section_busy = true;
        self.busy_until = Some(store.cycle + 1 + length);
        (change, 0)
    }

    /// Whether the boot lock bits allow `spm` to write: BLB01 for the application section, BLB11 for the boot section
    /// (tables 27-2, 27-3).
    fn may_write(&self, in_boot: bool) -> bool {
        self.locks & if in_boot { 1 << 4 } else { 1 << 2 } != 0
    }

    /// Executes `lpm` at `z`, which begins in `cycle`. Returns the byte if it does not come from flash.
    pub(super) fn load(&mut self, z: u16, fuses: [u8; 3], from_boot: bool, boot: u16, cycle: u64) -> Option<u8> {
        let soon = cycle < self.asked_at + LPM_OPEN && self.busy_until.is_none();
        match self.control & COMMAND {
            command if soon && command == SIGRD | SPMEN => {
                self.control &= SPMIE;
                let at = usize::from(z);
                // The odd addresses hold calibration bytes of the internal oscillator; here they read as 0xff.
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
        // BLB02 and BLB12: `lpm` in one section cannot read the other.
        let locked = match (from_boot, at >= boot) {
            (true, false) => self.locks & 1 << 3 == 0,
            (false, true) => self.locks & 1 << 5 == 0,
            _ => false,
        };
        (blocked || locked).then_some(0xff)
    }

    /// The time of the next event: the end of the present write, or else the cycle in which SPMEN clears because no
    /// `spm` came.
    pub(super) fn next_event(&self) -> u64 {
        let too_late = (self.control & SPMEN != 0).then_some(self.asked_at + OPEN);
        self.busy_until.or(too_late).unwrap_or(u64::MAX)
    }

    pub(super) fn event(&mut self) {
        self.busy_until = None;
        self.control &= SPMIE;
    }

    /// Whether the interrupt is pending: as long as SPMEN is 0 (§27.9.1). It is not pending during a write, nor between
    /// the write of SPMCSR and its `spm`.
    pub(super) fn pending(&self) -> bool {
        self.control & (SPMIE | SPMEN) == SPMIE && self.busy_until.is_none()
    }
}
