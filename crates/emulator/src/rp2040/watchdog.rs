//! The watchdog with its scratch registers, and the tick generator that clocks it and the timer (RP2040 datasheet
//! §4.7).

use super::clocks::Tick;

const NEVER: u64 = u64::MAX;

const ENABLE: u32 = 1 << 30;
const TRIGGER: u32 = 1 << 31;
const PAUSES: u32 = 7 << 24;
/// TICK: cycles of clk_ref in a tick, and whether ticks come.
const TICK_ENABLE: u32 = 1 << 9;
const TICK_RUNNING: u32 = 1 << 10;

/// Why the chip was reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cause {
    /// The RUN pin was low.
    Run,
    /// The watchdog's counter reached 0.
    RanOut,
    /// The program wrote the watchdog's TRIGGER.
    Forced,
    /// The program wrote SYSRESETREQ.
    Program,
}

#[derive(Clone)]
pub(super) struct Watchdog {
    ctrl: u32,
    /// The counter at a tick. It loses two in each tick (erratum RP2040-E1).
    load: u32,
    loaded_tick: u64,
    reason: u32,
    scratch: [u32; 8],
    tick_register: u32,
    tick: Tick,
    pub(super) next: u64,
}

impl Watchdog {
    pub(super) fn new() -> Watchdog {
        Watchdog {
            ctrl: PAUSES,
            load: 0,
            loaded_tick: 0,
            reason: 0,
            scratch: [0; 8],
            tick_register: TICK_ENABLE,
            tick: Tick::stopped(),
            next: NEVER,
        }
    }

    /// Resets the watchdog. REASON tells whether the watchdog was the cause; the scratch registers keep their values
    /// unless it was RUN.
    pub(super) fn reset(&mut self, cause: Cause) {
        let (reason, scratch) = match cause {
            Cause::Run => (0, [0; 8]),
            Cause::RanOut => (1, self.scratch),
            Cause::Forced => (2, self.scratch),
            Cause::Program => (0, self.scratch),
        };
        *self = Watchdog { scratch, reason, ..Watchdog::new() };
    }

    /// Cycles of clk_ref in a tick; `None` while no ticks come.
    pub(super) fn tick_cycles(&self) -> Option<u32> {
        (self.tick_register & TICK_ENABLE != 0 && self.tick_register & 0x1ff != 0).then_some(self.tick_register & 0x1ff)
    }

    pub(super) fn set_tick(&mut self, tick: Tick, cycle: u64) {
        let left = self.left(cycle);
        self.tick = tick;
        (self.load, self.loaded_tick) = (left, tick.ticks(cycle));
        self.schedule();
    }

    fn left(&self, cycle: u64) -> u32 {
        if self.ctrl & ENABLE == 0 {
            return self.load;
        }
        let passed = self.tick.ticks(cycle).saturating_sub(self.loaded_tick).saturating_mul(2);
        self.load.saturating_sub(u32::try_from(passed).unwrap_or(u32::MAX))
    }

    fn schedule(&mut self) {
        self.next = if self.ctrl & ENABLE == 0 {
            NEVER
        } else {
            self.tick.cycle_of(self.loaded_tick + u64::from(self.load.div_ceil(2)))
        };
    }

    /// Whether the program requests a reset with TRIGGER, which clears itself.
    pub(super) fn triggered(&mut self) -> bool {
        let triggered = self.ctrl & TRIGGER != 0;
        self.ctrl &= !TRIGGER;
        triggered
    }

    pub(super) fn read(&self, offset: u32, cycle: u64) -> u32 {
        match offset {
            0x00 => self.ctrl & !0x00ff_ffff | self.left(cycle) & 0x00ff_ffff,
            0x08 => self.reason,
            0x0c..=0x28 => self.scratch[(offset as usize - 0x0c) / 4],
            0x2c => self.tick_register | if self.tick_cycles().is_some() { TICK_RUNNING } else { 0 },
            _ => 0,
        }
    }

    pub(super) fn write(&mut self, offset: u32, value: u32, merge: impl Fn(u32) -> u32, cycle: u64) {
        match offset {
            0x00 => {
                let left = self.left(cycle + 1);
                self.ctrl = merge(self.ctrl) & (PAUSES | ENABLE | TRIGGER);
                (self.load, self.loaded_tick) = (left, self.tick.ticks(cycle + 1));
            }
            0x04 => (self.load, self.loaded_tick) = (value & 0x00ff_ffff, self.tick.ticks(cycle + 1)),
            0x0c..=0x28 => {
                let scratch = &mut self.scratch[(offset as usize - 0x0c) / 4];
                *scratch = merge(*scratch);
            }
            0x2c => self.tick_register = merge(self.tick_register) & 0x3ff,
            _ => {}
        }
        self.schedule();
    }
}
