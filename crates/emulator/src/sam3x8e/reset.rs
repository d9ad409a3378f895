//! The reset controller, the watchdog, the backup registers and the chip's number (Atmel-11057C §12, §15, §17, §29).

use super::pmc::SlowClock;

const NEVER: u64 = u64::MAX;
const KEY: u32 = 0xa5;

/// CHIPID_CIDR of a SAM3X8E, as real boards have it (bossac knows boards by it).
pub(super) const CHIP_ID: u32 = 0x285e_0a60;

/// Why the chip was reset (RSTC_SR.RSTTYP).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cause {
    PowerUp = 0,
    Watchdog = 2,
    Software = 3,
    Pin = 4,
}

#[derive(Clone, Debug)]
pub(super) struct ResetController {
    cause: Cause,
    /// A low NRST was seen.
    pin_seen: bool,
    mode: u32,
}

impl ResetController {
    pub(super) fn new(cause: Cause) -> ResetController {
        // URSTEN is set: NRST resets the chip.
        ResetController { cause, pin_seen: cause == Cause::Pin, mode: 1 }
    }

    pub(super) fn read(&mut self, offset: u32) -> u32 {
        match offset {
            // NRSTL: the pin is high.
            0x04 => u32::from(std::mem::take(&mut self.pin_seen)) | (self.cause as u32) << 8 | 1 << 16,
            0x08 => self.mode,
            _ => 0,
        }
    }

    /// Writes a register. Returns whether the program requests a reset: of the processor and of the peripherals, which
    /// are reset together.
    pub(super) fn write(&mut self, offset: u32, value: u32) -> bool {
        if value >> 24 != KEY {
            return false;
        }
        match offset {
            0x00 => return value & 0b101 != 0,
            0x08 => self.mode = value & 0xf11,
            _ => {}
        }
        false
    }
}

/// WDT_MR (§15).
mod mode {
    pub(super) const VALUE: u32 = 0xfff;
    pub(super) const FAULT_INTERRUPT: u32 = 1 << 12;
    pub(super) const RESETS: u32 = 1 << 13;
    pub(super) const DISABLED: u32 = 1 << 15;
    pub(super) const AT_RESET: u32 = 0x3fff_2fff;
}

/// WDT_SR: underflow, error.
const UNDERFLOW: u32 = 1;
const ERROR: u32 = 1 << 1;

/// Slow ticks of one count.
const TICKS_OF_COUNT: u64 = 128;

/// The watchdog. It runs after each reset, and its mode can be written once.
#[derive(Clone, Debug)]
pub(super) struct Watchdog {
    mode: u32,
    written: bool,
    status: u32,
    /// The slow tick at which it was started again.
    since: u64,
    pub(super) next: u64,
}

impl Watchdog {
    pub(super) fn new(slow: &SlowClock, cycle: u64) -> Watchdog {
        let mut watchdog =
            Watchdog { mode: mode::AT_RESET, written: false, status: 0, since: slow.ticks(cycle), next: NEVER };
        watchdog.schedule(slow);
        watchdog
    }

    pub(super) fn schedule(&mut self, slow: &SlowClock) {
        let counts = u64::from(self.mode & mode::VALUE) + 1;
        let is_on = self.mode & mode::DISABLED == 0 && self.status & UNDERFLOW == 0;
        self.next = if is_on { slow.cycle_of(self.since + counts * TICKS_OF_COUNT) } else { NEVER };
    }

    /// It has run out. Returns whether it resets the chip.
    pub(super) fn run_out(&mut self) -> bool {
        self.status |= UNDERFLOW;
        self.next = NEVER;
        self.mode & mode::RESETS != 0
    }

    pub(super) fn line_asserted(&self) -> bool {
        self.status != 0 && self.mode & mode::FAULT_INTERRUPT != 0
    }

    pub(super) fn read(&mut self, offset: u32) -> u32 {
        match offset {
            0x04 => self.mode,
            0x08 => std::mem::take(&mut self.status),
            _ => 0,
        }
    }

    /// Writes a register. Returns whether that resets the chip: a restart that comes too early is an error (§15, WDD).
    pub(super) fn write(&mut self, offset: u32, value: u32, slow: &SlowClock, cycle: u64) -> bool {
        let mut resets = false;
        match offset {
            0x00 if value >> 24 == KEY && value & 1 != 0 && self.mode & mode::DISABLED == 0 => {
                let passed = (slow.ticks(cycle) - self.since) / TICKS_OF_COUNT;
                let left = u64::from(self.mode & mode::VALUE).saturating_sub(passed);
                if left > u64::from(self.mode >> 16 & mode::VALUE) {
                    self.status |= ERROR;
                    resets = self.mode & mode::RESETS != 0;
                } else {
                    self.since = slow.ticks(cycle);
                }
            }
            0x04 if !self.written => {
                self.mode = value & 0x3fff_ffff;
                self.written = true;
                self.since = slow.ticks(cycle);
            }
            _ => {}
        }
        self.schedule(slow);
        resets
    }
}
