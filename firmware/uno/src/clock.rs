//! The board's clock: Timer1 at 16 MHz, extended to 64 bits by looking at it often enough.

use crate::regs;
use pulsetrain_core::Moment;

/// Ticks per second; one tick is one processor cycle.
pub(crate) const TICK_HZ: u32 = 16_000_000;

/// Counts the wraps of Timer1. It must be asked at least once in 65 536 ticks (4.1 ms).
pub(crate) struct Clock {
    /// The last reading.
    low: u32,
    /// Wraps of `low`.
    high: u32,
}

impl Clock {
    /// Not started.
    pub(crate) const fn new() -> Clock {
        Clock { low: 0, high: 0 }
    }

    /// Starts Timer1 at tick 0: normal mode, undivided, pins free (DS40002061B §16.11.1-2).
    pub(crate) fn start(&mut self) {
        regs::TCCR1B.write(0);
        regs::TCCR1A.write(0);
        regs::TIMSK1.write(0);
        regs::free(|| regs::TCNT1.write(0));
        regs::TCCR1B.write(1);
    }

    /// Ticks since start-up.
    #[inline(never)]
    pub(crate) fn now(&mut self) -> u64 {
        self.moment();
        u64::from(self.high) << 32 | u64::from(self.low)
    }

    /// The same, modulo 2^32.
    #[inline(always)]
    pub(crate) fn moment(&mut self) -> Moment {
        // The lower half of `low` is what Timer1 said last time.
        let passed = read().wrapping_sub(low_half(self.low));
        let (now, wrapped) = self.low.overflowing_add(u32::from(passed));
        self.low = now;
        if wrapped {
            self.high = self.high.wrapping_add(1);
        }
        Moment(now)
    }
}

/// What Timer1 says at a moment.
#[inline(always)]
pub(crate) const fn low_half(moment: u32) -> u16 {
    let [b0, b1, _, _] = moment.to_le_bytes();
    u16::from_le_bytes([b0, b1])
}

/// Timer1 as it stands. Interrupts are off for 6 cycles, because they use the byte that all its registers share.
#[inline(always)]
pub(crate) fn read() -> u16 {
    regs::timer1()
}
