//! The items that were sent for a motor, replayed in integers: the tick of each step, and the count at any tick.

use pulsetrain_board::replay::Start;
use pulsetrain_core::{Direction, Item, Segment};
use std::collections::VecDeque;

/// An item, and the time at which it begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Placed {
    /// The accumulator before the item, board ticks · 2^F, not wrapped. For an anchor: the one that it sets.
    pub(crate) start: i128,
    pub(crate) item: Item,
}

impl Placed {
    /// The accumulator after the item.
    pub(crate) fn end(&self, fraction_bits: u32) -> i128 {
        match self.item {
            Item::Run { segment, .. } => self.start + segment.span(segment.count),
            Item::Dwell { ticks } => self.start + (i128::from(ticks) << fraction_bits),
            Item::Anchor { .. } => self.start,
        }
    }

    fn run(&self) -> Option<Steps> {
        match self.item {
            Item::Run { segment, direction } => Some(Steps { start: self.start, segment, direction }),
            Item::Anchor { .. } | Item::Dwell { .. } => None,
        }
    }
}

/// A run, and the time at which it begins.
#[derive(Clone, Copy)]
struct Steps {
    start: i128,
    segment: Segment,
    direction: Direction,
}

impl Steps {
    /// The tick of step `k` (1..=count).
    fn tick(&self, k: u32, fraction_bits: u32) -> u64 {
        tick_of(self.start + self.segment.span(k), fraction_bits)
    }

    /// How many of the steps come before `tick`. Their ticks ascend, so that a binary search finds it.
    fn before(&self, tick: u64, fraction_bits: u32) -> u32 {
        if self.tick(self.segment.count, fraction_bits) < tick {
            return self.segment.count;
        }
        let (mut before, mut not_before) = (0, self.segment.count);
        while not_before - before > 1 {
            let middle = before + (not_before - before) / 2;
            if self.tick(middle, fraction_bits) < tick { before = middle } else { not_before = middle }
        }
        before
    }

    fn signed(&self, count: u32) -> i64 {
        i64::from(self.direction.sign()) * i64::from(count)
    }

    fn placed(&self) -> Placed {
        Placed { start: self.start, item: Item::Run { segment: self.segment, direction: self.direction } }
    }

    /// What is left of the run after `k` steps; `None` if nothing is.
    fn after(&self, k: u32) -> Option<Steps> {
        let left = || Steps { start: self.start + self.segment.span(k), segment: self.segment.after(k), ..*self };
        (k < self.segment.count).then(left)
    }
}

/// The whole ticks of an accumulator; board ticks are never negative.
pub(crate) fn tick_of(accumulator: i128, fraction_bits: u32) -> u64 {
    (accumulator >> fraction_bits) as u64
}

/// A step that was made or will be.
pub(crate) type Step = (u64, Direction);

/// Everything that was sent for a motor. Steps that are long past are forgotten, and only their count is kept.
#[derive(Clone, Debug)]
pub(crate) struct Timeline {
    fraction_bits: u32,
    /// The motor's count before tick `since`.
    count: i64,
    /// Steps before this tick are forgotten.
    since: u64,
    /// The last two of the forgotten steps, the later one first.
    last: [Option<Step>; 2],
    /// The motor's state before the items in `placed`.
    start: Start,
    placed: VecDeque<Placed>,
}

impl Timeline {
    /// A motor that stands at `count`, with nothing known of the time before tick `since`.
    pub(crate) fn new(fraction_bits: u32, count: i64, since: u64) -> Timeline {
        let start = Start::at(since, fraction_bits);
        Timeline { fraction_bits, count, since, last: [None; 2], start, placed: VecDeque::new() }
    }

    /// The count after all steps before `tick`; `None` for ticks that are forgotten.
    pub(crate) fn count_before(&self, tick: u64) -> Option<i64> {
        (tick >= self.since).then(|| {
            let runs = self.placed.iter().filter_map(Placed::run);
            self.count + runs.map(|run| run.signed(run.before(tick, self.fraction_bits))).sum::<i64>()
        })
    }

    /// The last two steps before `tick`, which must not be forgotten; the later one first.
    pub(crate) fn last_before(&self, tick: u64) -> [Option<Step>; 2] {
        let mut found = [None; 2];
        for run in self.placed.iter().rev().filter_map(Placed::run) {
            let before = run.before(tick, self.fraction_bits);
            for k in (1..=before).rev().take(2) {
                let step = Some((run.tick(k, self.fraction_bits), run.direction));
                if found[0].is_some() {
                    found[1] = step;
                    return found;
                }
                found[0] = step;
            }
        }
        if found[0].is_some() { [found[0], self.last[0]] } else { self.last }
    }

    /// The first step at `tick` or later.
    pub(crate) fn first_from(&self, tick: u64) -> Option<Step> {
        let mut runs = self.placed.iter().filter_map(Placed::run);
        runs.find_map(|run| {
            Some((run.after(run.before(tick, self.fraction_bits))?.tick(1, self.fraction_bits), run.direction))
        })
    }

    /// The tick of the last step of all, if one is remembered.
    pub(crate) fn last_tick(&self) -> Option<u64> {
        self.last_before(u64::MAX)[0].map(|(tick, _)| tick)
    }

    /// Appends an item.
    pub(crate) fn push(&mut self, placed: Placed) {
        self.placed.push_back(placed);
    }

    /// Appends a step of which only the tick is known: a step of a stop.
    pub(crate) fn push_step(&mut self, tick: u64, direction: Direction) {
        let half = 1 << (self.fraction_bits - 1);
        let start = self.placed.back().map_or(self.start.accumulator, |placed| placed.end(self.fraction_bits));
        let interval = (i128::from(tick) << self.fraction_bits) + half - start;
        // Steps of a stop are no more than seconds apart.
        let segment = Segment::single(interval as i64);
        self.push(Placed { start, item: Item::Run { segment, direction } });
    }

    /// Drops all steps at `tick` or later.
    pub(crate) fn cut(&mut self, tick: u64) {
        while let Some(placed) = self.placed.pop_back() {
            if let Some(run) = placed.run()
                && let before @ 1.. = run.before(tick, self.fraction_bits)
            {
                self.placed.push_back(Steps { segment: run.segment.truncated(before), ..run }.placed());
                break;
            }
        }
    }

    /// How many items are remembered.
    pub(crate) fn len(&self) -> usize {
        self.placed.len()
    }

    /// How many items begin at `tick` or later.
    pub(crate) fn items_from(&self, tick: u64) -> usize {
        let is_later = |placed: &&Placed| tick_of(placed.start, self.fraction_bits) >= tick;
        self.placed.iter().rev().take_while(is_later).count()
    }

    /// Takes the last `items` items away.
    pub(crate) fn take_back(&mut self, items: usize) -> VecDeque<Placed> {
        self.placed.split_off(self.placed.len() - items.min(self.placed.len()))
    }

    /// Whether the last item makes steps.
    pub(crate) fn ends_with_steps(&self) -> bool {
        self.placed.back().is_some_and(|placed| placed.run().is_some())
    }

    /// The motor's state at `tick`, and the items that were sent for after it.
    pub(crate) fn from(&self, tick: u64) -> (Start, Vec<Item>) {
        let mut start = self.start;
        let mut placed = self.placed.iter();
        let mut items = Vec::new();
        for next in placed.by_ref() {
            let before = advance(&mut start, next, tick, self.fraction_bits);
            if let Some(rest) = next.run().and_then(|run| run.after(before)) {
                items.push(rest.placed().item);
                break;
            }
        }
        items.extend(placed.map(|placed| placed.item));
        (start, items)
    }

    /// Forgets the ticks of the steps before `tick`, but not how many they were.
    pub(crate) fn forget(&mut self, tick: u64) {
        self.since = self.since.max(tick);
        while let Some(placed) = self.placed.pop_front() {
            let Some(run) = placed.run() else {
                if tick_of(placed.end(self.fraction_bits), self.fraction_bits) >= tick {
                    self.placed.push_front(placed);
                    break;
                }
                advance(&mut self.start, &placed, tick, self.fraction_bits);
                continue;
            };
            let before = advance(&mut self.start, &placed, tick, self.fraction_bits);
            self.count += run.signed(before);
            for k in before.saturating_sub(1).max(1)..=before {
                self.last = [Some((run.tick(k, self.fraction_bits), run.direction)), self.last[0]];
            }
            if let Some(rest) = run.after(before) {
                self.placed.push_front(rest.placed());
                break;
            }
        }
    }
}

/// Moves `start` on through the part of an item that comes before `tick`. Returns how many steps that are.
fn advance(start: &mut Start, placed: &Placed, tick: u64, fraction_bits: u32) -> u32 {
    let Some(run) = placed.run() else {
        (start.accumulator, start.fresh) = (placed.end(fraction_bits), true);
        return 0;
    };
    let before = run.before(tick, fraction_bits);
    start.accumulator = run.start + run.segment.span(before);
    if before > 0 {
        start.fresh = false;
        start.direction = run.direction;
        start.interval = run.segment.after(before - 1).interval;
        start.last_step = Some((run.tick(before, fraction_bits), run.direction));
    }
    before
}
