//! One ring as it is played: checks that its interrupt plays what it should.

use crate::engine::clock::low_half;
use crate::engine::regs::Reg16;
use crate::engine::steps::ring::{Ring, RingName};
use crate::engine::tuning::stepper::{MAX_UNDERRUN, RESTART_DELAY, RETRY};
use crate::engine::{clock, regs};
use pulsetrain_core::Tick32;

/// What went wrong while a ring was played.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RingFault {
    /// A compare match was missed, or the ring was empty for a moment: a group was played so late.
    Late {
        /// Ticks.
        ticks: u16,
    },
    /// The ring was empty for too long while steps were left.
    Underrun,
}

/// A ring and its time; [`one_motor`](crate::engine::steps::one_motor) and others know the layout.
#[repr(C)]
pub(in crate::engine::steps) struct Track {
    pub(in crate::engine::steps) ring: Ring,
    /// Tick of the pending group.
    pub(in crate::engine::steps) at: Tick32,
    /// Ticks between two groups, at least.
    pub(in crate::engine::steps) spacing: u8,
}

impl Track {
    pub(super) const NONE: Track = Track { ring: Ring::NONE, at: Tick32(0), spacing: 0 };

    /// The compare register, and the ring's bit in `TIMSK1` and `TIFR1`.
    #[inline(always)]
    fn compare(&self) -> (Reg16, u8) {
        match self.ring.name() {
            RingName::A => (regs::OCR1A, 1 << 1),
            RingName::B => (regs::OCR1B, 1 << 2),
        }
    }

    /// Sets the next match, to `at` or as soon as possible. Nothing may come between reading the time and setting the register.
    #[inline(never)]
    pub(super) fn resume(&self, at: Option<Tick32>) {
        let (compare, bit) = self.compare();
        regs::critical(|| {
            let at = at.map_or_else(|| clock::read().wrapping_add(RETRY), |at| low_half(at.0));
            compare.write(at);
            regs::TIFR1.write(bit);
        });
        regs::critical(|| {
            regs::GPIOR0.clear(self.ring.underrun_flag());
            regs::TIMSK1.set(bit);
        });
    }

    /// Checks that the interrupt still plays what it should, and repairs what is wrong.
    #[inline(never)]
    pub(super) fn watch(&mut self, now: Tick32, busy: bool) -> Option<RingFault> {
        if regs::GPIOR0.read() & self.ring.underrun_flag() != 0 {
            let (compare, _) = self.compare();
            // The compare register still has the tick of the next group.
            let count = clock::read();
            let late = count.wrapping_sub(compare.read());
            if busy && late >= MAX_UNDERRUN {
                return Some(RingFault::Underrun);
            }
            let empty = self.ring.is_empty();
            if empty && self.ring.pending_begins_pulse() {
                return Some(RingFault::Underrun);
            }
            if empty {
                // From the count just read, not from when the round began.
                self.at = now.after(u32::from(count.wrapping_sub(low_half(now.0)).wrapping_add(RESTART_DELAY)));
            }
            let at = empty.then_some(self.at);
            // The hardware has made the edge of the next group already, and toggles no more. A plain step would not switch toggling on again. So a filler
            // follows it, or it becomes a group that does switch it on.
            if empty && self.ring.pending_is_plain_step() {
                self.push_nothing(self.at.after(u32::from(self.spacing)));
            } else if !empty {
                self.ring.next_match_toggles();
            }
            self.resume(at);
            return busy.then_some(RingFault::Late { ticks: late });
        }
        let (compare, bit) = self.compare();
        // A match lies ahead, or its interrupt has been waiting for some cycles. If it is behind by 512 to 32 767 ticks, it was missed, and would come
        // 65 536 ticks late. Comparing the high bytes tells, with interrupts on.
        let [_, high, ..] = now.0.to_le_bytes();
        if !matches!(high.wrapping_sub(compare.high()), 2..0x80) || regs::TIFR1.read() & bit != 0 {
            return None;
        }
        let late = low_half(now.0).wrapping_sub(regs::critical(|| compare.read()));
        self.resume(None);
        (late != 0).then_some(RingFault::Late { ticks: late })
    }

    /// Whether no group is left to be played but fillers.
    #[inline(never)]
    pub(super) fn is_idle(&self) -> bool {
        self.ring.is_idle()
    }
}
