//! The watchdog (DS40002061B §11.8, §11.9). Its oscillator has 128 kHz, which is 125 cycles of a 16 MHz clock; the
//! spread of a real oscillator is not emulated.

const WDIF: u8 = 1 << 7;
const WDIE: u8 = 1 << 6;
const WDCE: u8 = 1 << 4;
const WDE: u8 = 1 << 3;
const PRESCALER: u8 = 0b10_0111;

use super::sequence::OPEN;

/// What happens at a time-out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TimeOut {
    Interrupt,
    Reset,
}

#[derive(Clone)]
pub(super) struct Watchdog {
    /// WDTCSR without WDCE.
    control: u8,
    /// The first cycle in which it is too late to change WDE and the prescaler.
    open_until: u64,
    /// The cycle of the time-out; MAX while the watchdog is off.
    due: u64,
    /// Cycles of the system clock in one cycle of the watchdog's oscillator, in 1/256.
    cycles_256: u64,
    /// How often the program executed `wdr` since power came on.
    feeds: u64,
}

impl Watchdog {
    pub(super) fn new() -> Watchdog {
        Watchdog { control: 0, open_until: 0, due: u64::MAX, cycles_256: 125 * 256, feeds: 0 }
    }

    /// Resets the watchdog. `forced` is WDRF: it keeps the watchdog on, with the shortest time (§11.9.2).
    pub(super) fn reset(&mut self, cycle: u64, forced: bool) {
        *self = Watchdog { feeds: self.feeds, ..Watchdog::new() };
        self.control = if forced { WDE } else { 0 };
        self.restart(cycle);
    }

    /// The system clock is now the oscillator's, divided by `division`.
    pub(super) fn set_division(&mut self, division: u16, cycle: u64) {
        let left = self.due.saturating_sub(cycle);
        let before = self.cycles_256;
        self.cycles_256 = 125 * 256 / u64::from(division);
        if self.due != u64::MAX {
            self.due = cycle + left * self.cycles_256 / before;
        }
    }

    /// Executes `wdr`.
    pub(super) fn feed(&mut self, cycle: u64) {
        self.feeds += 1;
        self.restart(cycle);
    }

    /// How often the program executed `wdr` since power came on.
    pub(super) fn feeds(&self) -> u64 {
        self.feeds
    }

    /// Starts a full period: after `wdr`, or after a change of the settings.
    fn restart(&mut self, cycle: u64) {
        // Table 11-2: from 2048 to 1024 K cycles, doubled at each step. Reserved values count as the longest.
        let prescaler = (self.control & 7 | self.control >> 2 & 8).min(9);
        let period = (2048 << prescaler) * self.cycles_256 / 256;
        self.due = if self.control & (WDE | WDIE) != 0 { cycle + period } else { u64::MAX };
    }

    pub(super) fn read(&self, cycle: u64) -> u8 {
        self.control | if cycle < self.open_until { WDCE } else { 0 }
    }

    /// Writes WDTCSR. `forced` is WDRF: while it is 1, WDE cannot become 0.
    pub(super) fn write(&mut self, value: u8, cycle: u64, forced: bool) {
        let open = cycle < self.open_until;
        let before = self.control;
        let mut control = self.control & (WDIF | WDE | PRESCALER) | value & WDIE;
        if value & WDIF != 0 {
            control &= !WDIF;
        }
        if open && value & WDCE == 0 {
            control = control & !(WDE | PRESCALER) | value & (WDE | PRESCALER);
        }
        // WDE can be set at any time, and cleared only within the timed sequence.
        control |= value & WDE | if forced { WDE } else { 0 };
        self.control = control;
        if value & (WDCE | WDE) == WDCE | WDE {
            self.open_until = cycle + OPEN;
        } else if open {
            self.open_until = 0;
        }
        if (before ^ control) & (WDE | WDIE | PRESCALER) != 0 {
            let was_on = before & (WDE | WDIE) != 0;
            let still = (before ^ control) & PRESCALER == 0 && was_on && control & (WDE | WDIE) != 0;
            if !still {
                self.restart(cycle);
            }
        }
    }

    pub(super) fn next_event(&self) -> u64 {
        self.due
    }

    /// Whether its interrupt is pending.
    pub(super) fn pending(&self) -> bool {
        self.control & (WDIF | WDIE) == WDIF | WDIE
    }

    /// The interrupt is entered. In interrupt and reset mode the next time-out resets the chip (§11.8).
    pub(super) fn acknowledge(&mut self) {
        self.control &= !WDIF;
        if self.control & WDE != 0 {
            self.control &= !WDIE;
        }
    }

    /// Handles the time-out in `cycle`.
    pub(super) fn event(&mut self, cycle: u64) -> TimeOut {
        let outcome = if self.control & WDIE != 0 { TimeOut::Interrupt } else { TimeOut::Reset };
        self.control |= WDIF;
        self.restart(cycle);
        outcome
    }
}
