//! Steps in their places → items of an epoch.
//!
//! A plan that goes on begins with the accumulator that it had at the step before, where 16 bits say that and it is not older than
//! [`RESUMED_WITHIN`]. An anchor would drop the fraction: after one, the
//! first step is said alone, by the interval that leads to its very accumulator, and all that follows goes on with the integers
//! that it has.

use super::timeline::{Placed, tick_of};
use pulsetrain_board::Sizer;
use pulsetrain_core::{Item, Moment, RESUMED_WITHIN};
use pulsetrain_plan::LONGEST_WAIT_TICKS;
use pulsetrain_plan::tail::Told;

/// Longest dwell of one item, ticks.
const LONGEST_DWELL_TICKS: i128 = 1 << 30;

/// An item, the tick at which the board takes it from its queue, and what it takes there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Timed {
    pub(super) item: Item,
    pub(super) taken: u64,
    pub(super) size: usize,
}

/// The items of one motor for one epoch.
#[derive(Debug)]
pub(super) struct Items {
    fraction_bits: u32,
    sizer: Sizer,
    /// The same, before the first item.
    fresh: Sizer,
    /// The board's accumulator after them.
    accumulator: i128,
    items: Vec<Timed>,
}

impl Items {
    /// An epoch that begins at tick `from`, at least 1.
    ///
    /// The anchor lies one tick before it, so that every interval is positive.
    pub(super) fn new(from: u64, fraction_bits: u32, mut sizer: Sizer) -> Items {
        let (anchor, fresh) = (from - 1, sizer);
        let item = Item::Anchor { tick: Moment::of(anchor) };
        let accumulator = (i128::from(anchor) << fraction_bits) + (1 << (fraction_bits - 1));
        let first = Timed { item, taken: from, size: sizer.size(&item) };
        Items { fraction_bits, sizer, fresh, accumulator, items: vec![first] }
    }

    /// Adds steps, each at its own tick.
    pub(super) fn add(&mut self, placed: &Placed) {
        let Placed { start, segment, direction } = *placed;
        self.resume(start);
        let gap = start - self.accumulator;
        let whole = gap >> self.fraction_bits;
        // A step that was put off may come after more than one interval says.
        let short = segment.interval >> self.fraction_bits < i64::from(LONGEST_WAIT_TICKS);
        if gap >= 0 && whole << self.fraction_bits == gap && short {
            self.dwell(whole);
            self.push(Item::Run { segment, direction });
        } else {
            let mut interval = i128::from(segment.interval) + gap;
            let longest = i128::from(LONGEST_WAIT_TICKS);
            if interval >> self.fraction_bits >= longest {
                let ticks = (interval >> self.fraction_bits) - longest / 2;
                self.dwell(ticks);
                interval -= ticks << self.fraction_bits;
            }
            // Below the longest interval now.
            let first = pulsetrain_core::Segment { interval: interval as i64, ..segment.truncated(1) };
            self.push(Item::Run { segment: first, direction });
            self.accumulator += interval;
            if segment.count > 1 {
                self.push(Item::Run { segment: segment.after(1), direction });
            }
        }
        self.accumulator = placed.end();
    }

    /// What the board knows after these items, at the beginning of a tail.
    pub(super) fn told(&self, tick: u64) -> Option<Told> {
        let accumulator = self.accumulator - (i128::from(tick) << self.fraction_bits);
        Some(Told { accumulator: i64::try_from(accumulator).ok()?, state: self.sizer.state() })
    }

    pub(super) fn finish(self) -> Vec<Timed> {
        self.items
    }

    /// An epoch that begins amid steps begins with their accumulator, if 16 bits say its fraction.
    fn resume(&mut self, start: i128) {
        let [Timed { item: item @ Item::Anchor { .. }, size, .. }] = self.items.as_mut_slice() else { return };
        let tick = start >> self.fraction_bits;
        let fraction = (start - (tick << self.fraction_bits)) << 16 >> self.fraction_bits;
        let behind = (self.accumulator >> self.fraction_bits) - tick;
        let is_whole = fraction << self.fraction_bits >> 16 == start - (tick << self.fraction_bits);
        if start == self.accumulator || !(0..i128::from(RESUMED_WITHIN)).contains(&behind) || !is_whole {
            return;
        }
        let Ok(at) = u64::try_from(tick) else { return };
        *item = Item::Resume { tick: Moment::of(at), fraction: fraction as u16 };
        self.sizer = self.fresh;
        *size = self.sizer.size(item);
        self.accumulator = start;
    }

    fn dwell(&mut self, ticks: i128) {
        let mut left = ticks;
        if let ([Timed { item: Item::Anchor { tick }, .. }], 1..=LONGEST_DWELL_TICKS) =
            (self.items.as_mut_slice(), left)
        {
            // As good as a wait after it, and shorter.
            *tick = tick.after(left as u32);
            self.accumulator += left << self.fraction_bits;
            return;
        }
        while left > 0 {
            let part = left.min(LONGEST_DWELL_TICKS);
            self.push(Item::Dwell { ticks: part as u32 });
            self.accumulator += part << self.fraction_bits;
            left -= part;
        }
    }

    fn push(&mut self, item: Item) {
        // Not before the epoch begins, whose accumulator may be older.
        let taken = tick_of(self.accumulator, self.fraction_bits).max(self.items[0].taken);
        self.items.push(Timed { item, taken, size: self.sizer.size(&item) });
    }
}
