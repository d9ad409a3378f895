//! The 64-bit microsecond timer with its four alarms (RP2040 datasheet §4.6). The watchdog's tick generator clocks it.

use super::clocks::Tick;

const NEVER: u64 = u64::MAX;

#[derive(Clone)]
pub(super) struct Timer {
    tick: Tick,
    /// The count at an earlier tick, and the number of that tick.
    base_count: u64,
    base_tick: u64,
    paused: bool,
    alarms: [u32; 4],
    armed: u32,
    /// The high half that reading TIMELR latched (TIMEHR), and the low half that was written ahead of the high one.
    latched_high: u32,
    written_low: u32,
    dbgpause: u32,
    intr: u32,
    inte: u32,
    intf: u32,
    pub(super) next: u64,
}

impl Timer {
    pub(super) fn new() -> Timer {
        Timer {
            tick: Tick::stopped(),
            base_count: 0,
            base_tick: 0,
            paused: false,
            alarms: [0; 4],
            armed: 0,
            latched_high: 0,
            written_low: 0,
            dbgpause: 7,
            intr: 0,
            inte: 0,
            intf: 0,
            next: NEVER,
        }
    }

    /// The count in a cycle.
    fn count(&self, cycle: u64) -> u64 {
        if self.paused {
            self.base_count
        } else {
            self.base_count.wrapping_add(self.tick.ticks(cycle).saturating_sub(self.base_tick))
        }
    }

    /// Resets the timer in a cycle.
    pub(super) fn reset(&mut self, cycle: u64) {
        *self = Timer { tick: self.tick, ..Timer::new() };
        self.rebase(0, cycle);
    }

    fn rebase(&mut self, count: u64, cycle: u64) {
        (self.base_count, self.base_tick) = (count, self.tick.ticks(cycle));
        self.schedule(cycle);
    }

    /// The tick generator has another rate from a cycle on.
    pub(super) fn set_tick(&mut self, tick: Tick, cycle: u64) {
        let count = self.count(cycle);
        self.tick = tick;
        self.rebase(count, cycle);
    }

    /// Computes the cycle in which the next alarm matches.
    fn schedule(&mut self, cycle: u64) {
        self.next = NEVER;
        if self.paused {
            return;
        }
        let count = self.count(cycle);
        for number in (0..4).filter(|number| self.armed >> number & 1 != 0) {
            let left = self.alarms[number].wrapping_sub(count as u32);
            let ticks = self.tick.ticks(cycle) + u64::from(left);
            self.next = self.next.min(self.tick.cycle_of(ticks).max(cycle));
        }
    }

    /// Raises the interrupts of the alarms that are due in a cycle.
    pub(super) fn run(&mut self, cycle: u64) {
        let low = self.count(cycle) as u32;
        for number in 0..4 {
            if self.armed >> number & 1 != 0 && self.alarms[number] == low {
                self.armed &= !(1 << number);
                self.intr |= 1 << number;
            }
        }
        self.schedule(cycle + 1);
    }

    /// The levels of the four interrupt lines, one for each alarm.
    pub(super) fn lines(&self) -> u32 {
        self.intr & self.inte | self.intf
    }

    pub(super) fn read(&mut self, offset: u32, cycle: u64) -> u32 {
        let count = self.count(cycle);
        let high = (count >> 32) as u32;
        match offset {
            0x08 => self.latched_high,
            0x0c => {
                self.latched_high = high;
                count as u32
            }
            0x10..=0x1c => self.alarms[(offset as usize - 0x10) / 4],
            0x20 => self.armed,
            0x24 => high,
            0x28 => count as u32,
            0x2c => self.dbgpause,
            0x30 => u32::from(self.paused),
            0x34 => self.intr,
            0x38 => self.inte,
            0x3c => self.intf,
            0x40 => self.lines(),
            _ => 0,
        }
    }

    pub(super) fn write(&mut self, offset: u32, value: u32, merge: impl Fn(u32) -> u32, cycle: u64) {
        match offset {
            0x00 => self.rebase(u64::from(value) << 32 | u64::from(self.written_low), cycle + 1),
            0x04 => self.written_low = value,
            0x10..=0x1c => {
                let number = (offset as usize - 0x10) / 4;
                self.alarms[number] = merge(self.alarms[number]);
                self.armed |= 1 << number;
            }
            // Writing ones disarms alarms.
            0x20 => self.armed &= !value,
            0x2c => self.dbgpause = merge(self.dbgpause) & 6,
            0x30 => {
                let count = self.count(cycle + 1);
                self.paused = merge(u32::from(self.paused)) & 1 != 0;
                self.rebase(count, cycle + 1);
            }
            0x34 => self.intr &= !value,
            0x38 => self.inte = merge(self.inte) & 15,
            0x3c => self.intf = merge(self.intf) & 15,
            _ => {}
        }
        self.schedule(cycle + 1);
    }
}
