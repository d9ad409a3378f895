//! Steps in their places → items of an epoch.
//!
//! An anchor drops the fraction of the accumulator. So the first step after it is said alone, by the interval that
//! leads to its very accumulator, and all that follows goes on with the integers that it has.

use super::timeline::{Placed, tick_of};
use pulsetrain_core::{Item, Moment};
use pulsetrain_plan::LONGEST_WAIT_TICKS;

/// Longest dwell of one item, ticks.
const LONGEST_DWELL_TICKS: i128 = 1 << 30;

/// An item, and the tick at which the board takes it from its queue.
#[derive(Clone, Copy, Debug)]
pub(super) struct Timed {
    pub(super) item: Item,
    pub(super) taken: u64,
}

/// The items of one motor for one epoch.
#[derive(Debug)]
pub(super) struct Items {
    fraction_bits: u32,
    /// The board's accumulator after them.
    accumulator: i128,
    items: Vec<Timed>,
}

impl Items {
    /// An epoch that begins at tick `from`, at least 1.
    ///
    /// The anchor lies one tick before it, so that every interval is positive.
    pub(super) fn new(from: u64, fraction_bits: u32) -> Items {
        let anchor = from - 1;
        let item = Item::Anchor { tick: Moment::of(anchor) };
        let accumulator = (i128::from(anchor) << fraction_bits) + (1 << (fraction_bits - 1));
        Items { fraction_bits, accumulator, items: vec![Timed { item, taken: from }] }
    }

    /// Adds steps, each at its own tick.
    pub(super) fn add(&mut self, placed: &Placed) {
        let Placed { start, segment, direction } = *placed;
        let gap = start - self.accumulator;
        let whole = gap >> self.fraction_bits;
        if gap >= 0 && whole << self.fraction_bits == gap {
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

    pub(super) fn finish(self) -> Vec<Timed> {
        self.items
    }

    fn dwell(&mut self, ticks: i128) {
        let mut left = ticks;
        while left > 0 {
            let part = left.min(LONGEST_DWELL_TICKS);
            self.push(Item::Dwell { ticks: part as u32 });
            self.accumulator += part << self.fraction_bits;
            left -= part;
        }
    }

    fn push(&mut self, item: Item) {
        self.items.push(Timed { item, taken: tick_of(self.accumulator, self.fraction_bits) });
    }
}
