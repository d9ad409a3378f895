//! Power management: oscillators, PLLs, the master clock, the peripherals' clocks (Atmel-11057C §28), and the slow clock.
//!
//! A board has a crystal of 12 MHz, as an Arduino Due does. Frequencies are exact, and each source takes the time to its
//! ready flag that the program has set.
//!
//! Not emulated: programmable clock outputs, clock failure, fast start-up, and waiting for a source that was selected
//! before it is ready (the master clock then stays).

/// Frequencies, Hz.
const SLOW_HZ: u64 = 32_768;
const CRYSTAL_HZ: u64 = 12_000_000;
const UTMI_HZ: u64 = 480_000_000;

/// PMC_SR (§28).
mod sr {
    pub(super) const CRYSTAL: u32 = 1;
    pub(super) const PLLA: u32 = 1 << 1;
    pub(super) const MASTER: u32 = 1 << 3;
    pub(super) const UTMI: u32 = 1 << 6;
    pub(super) const MAIN_SELECTED: u32 = 1 << 16;
    pub(super) const RC: u32 = 1 << 17;
}

/// CKGR_MOR (§28).
mod mor {
    pub(super) const CRYSTAL: u32 = 1;
    pub(super) const BYPASS: u32 = 1 << 1;
    pub(super) const RC: u32 = 1 << 3;
    pub(super) const SELECTS_CRYSTAL: u32 = 1 << 24;
    pub(super) const KEY: u32 = 0x37;
    pub(super) const STORED: u32 = 0x0300_ff7b;
}

const UTMI_ENABLE: u32 = 1 << 16;
/// PMC_MCKR: halves of the PLLs.
const PLLA_HALF: u32 = 1 << 12;
const UTMI_HALF: u32 = 1 << 13;
/// The peripherals that there are, by number.
const PERIPHERALS: u64 = (1 << 45) - 1;

/// Ticks of the slow clock as cycles of the master clock, whose frequency changes.
#[derive(Clone, Copy, Debug)]
pub(super) struct SlowClock {
    ticks: u64,
    since: u64,
    hz: u64,
}

impl SlowClock {
    fn new(hz: u64) -> SlowClock {
        SlowClock { ticks: 0, since: 0, hz }
    }

    /// Ticks since the beginning.
    pub(super) fn ticks(&self, cycle: u64) -> u64 {
        self.ticks + cycle.saturating_sub(self.since) * SLOW_HZ / self.hz
    }

    /// The cycle of a tick that is still to come.
    pub(super) fn cycle_of(&self, tick: u64) -> u64 {
        self.since + (tick.saturating_sub(self.ticks) * self.hz).div_ceil(SLOW_HZ)
    }

    /// Cycles of a tick.
    pub(super) fn period(&self) -> u64 {
        (self.hz / SLOW_HZ).max(1)
    }

    fn set_hz(&mut self, hz: u64, cycle: u64) {
        *self = SlowClock { ticks: self.ticks(cycle), since: cycle, hz };
    }
}

#[derive(Clone)]
pub(super) struct Pmc {
    system: u32,
    peripherals: u64,
    utmi: u32,
    main: u32,
    plla: u32,
    master: u32,
    usb: u32,
    outputs: [u32; 3],
    mask: u32,
    /// The slow tick from which crystal, PLLA and the UTMI's PLL are ready.
    crystal_from: u64,
    plla_from: u64,
    utmi_from: u64,
    pub(super) slow: SlowClock,
    hz: u64,
}

impl Pmc {
    /// After a reset the master clock is the RC oscillator's 4 MHz (§28).
    pub(super) fn new() -> Pmc {
        let hz = 4_000_000;
        Pmc {
            system: 1,
            peripherals: 0,
            utmi: 0x1020_0800 & !UTMI_ENABLE,
            main: mor::RC,
            plla: 0x3f00,
            master: 1,
            usb: 0,
            outputs: [0; 3],
            mask: 0,
            crystal_from: 0,
            plla_from: 0,
            utmi_from: 0,
            slow: SlowClock::new(hz),
            hz,
        }
    }

    /// Resets the controller. The slow clock goes on.
    pub(super) fn reset(&mut self, cycle: u64) {
        let slow = self.slow;
        *self = Pmc { slow, ..Pmc::new() };
        self.slow.set_hz(self.hz, cycle);
    }

    /// Frequency of the master clock, Hz.
    pub(super) fn hz(&self) -> u64 {
        self.hz
    }

    /// The peripherals that have their clock, by number.
    pub(super) fn enabled(&self) -> u64 {
        self.peripherals
    }

    /// Whether the USB's PLL runs and is locked.
    pub(super) fn utmi_runs(&self, cycle: u64) -> bool {
        self.utmi & UTMI_ENABLE != 0 && self.slow.ticks(cycle) >= self.utmi_from
    }

    fn main_hz(&self) -> u64 {
        if self.main & mor::SELECTS_CRYSTAL != 0 {
            return CRYSTAL_HZ;
        }
        match self.main >> 4 & 7 {
            0 => 4_000_000,
            1 => 8_000_000,
            _ => 12_000_000,
        }
    }

    fn plla_hz(&self) -> u64 {
        let (multiplier, divider) = (u64::from(self.plla >> 16 & 0x7ff), u64::from(self.plla & 0xff));
        if multiplier == 0 { 0 } else { (self.main_hz() * (multiplier + 1)).checked_div(divider).unwrap_or(0) }
    }

    /// The frequency that PMC_MCKR selects; 0 if its source does not run.
    fn selected_hz(&self) -> u64 {
        let half = |bit: u32| if self.master & bit != 0 { 2 } else { 1 };
        let source = match self.master & 3 {
            0 => SLOW_HZ,
            1 => self.main_hz(),
            2 => self.plla_hz() / half(PLLA_HALF),
            _ if self.utmi & UTMI_ENABLE != 0 => UTMI_HZ / half(UTMI_HALF),
            _ => 0,
        };
        match self.master >> 4 & 7 {
            7 => source / 3,
            power => source >> power,
        }
    }

    /// Takes over a new frequency. Returns whether there is one.
    fn change(&mut self, cycle: u64) -> bool {
        let hz = self.selected_hz();
        if hz == 0 || hz == self.hz {
            return false;
        }
        self.hz = hz;
        self.slow.set_hz(hz, cycle);
        true
    }

    fn status(&self, cycle: u64) -> u32 {
        let now = self.slow.ticks(cycle);
        let when = |condition, bit| if condition { bit } else { 0 };
        let crystal = self.main & (mor::CRYSTAL | mor::BYPASS) != 0 && now >= self.crystal_from;
        when(crystal, sr::CRYSTAL)
            | when(self.plla_hz() != 0 && now >= self.plla_from, sr::PLLA)
            | sr::MASTER
            | when(self.utmi_runs(cycle), sr::UTMI)
            | sr::MAIN_SELECTED
            | when(self.main & mor::RC != 0, sr::RC)
            | self.system & 0x700
    }

    pub(super) fn line_asserted(&self, cycle: u64) -> bool {
        self.mask != 0 && self.status(cycle) & self.mask != 0
    }

    pub(super) fn read(&self, offset: u32, cycle: u64) -> u32 {
        match offset {
            0x08 => self.system,
            0x18 => self.peripherals as u32,
            0x1c => self.utmi,
            0x20 => self.main,
            // MAINFRDY, and the main clock's periods in 16 of the slow clock's.
            0x24 => 1 << 16 | (self.main_hz() * 16 / SLOW_HZ) as u32,
            0x28 => self.plla,
            0x30 => self.master,
            0x38 => self.usb,
            0x40 | 0x44 | 0x48 => self.outputs[(offset as usize - 0x40) / 4],
            0x68 => self.status(cycle),
            0x6c => self.mask,
            0x108 => (self.peripherals >> 32) as u32,
            _ => 0,
        }
    }

    /// Writes a register. Returns whether the master clock has another frequency from the next cycle on.
    pub(super) fn write(&mut self, offset: u32, value: u32, cycle: u64) -> bool {
        let now = self.slow.ticks(cycle);
        match offset {
            0x00 => self.system |= value & 0x720,
            0x04 => self.system &= !(value & 0x720),
            // System peripherals have their clock always; the first eight numbers cannot be written.
            0x10 => self.peripherals |= u64::from(value & !0xff) & PERIPHERALS,
            0x14 => self.peripherals &= !u64::from(value),
            0x100 => self.peripherals |= u64::from(value) << 32 & PERIPHERALS,
            0x104 => self.peripherals &= !(u64::from(value) << 32),
            0x1c => {
                self.utmi = value;
                self.utmi_from = now + u64::from(value >> 20 & 15) * 8;
            }
            0x20 if value >> 16 & 0xff == mor::KEY => {
                if value & !self.main & mor::CRYSTAL != 0 {
                    self.crystal_from = now + u64::from(value >> 8 & 0xff) * 8;
                }
                self.main = value & mor::STORED;
            }
            0x28 => {
                self.plla = value & 0x07ff_3fff;
                self.plla_from = now + u64::from(value >> 8 & 0x3f);
            }
            0x30 => self.master = value & 0x3073,
            0x38 => self.usb = value & 0xf01,
            0x40 | 0x44 | 0x48 => self.outputs[(offset as usize - 0x40) / 4] = value,
            0x60 => self.mask |= value,
            0x64 => self.mask &= !value,
            _ => return false,
        }
        matches!(offset, 0x1c..=0x30) && self.change(cycle + 1)
    }
}
