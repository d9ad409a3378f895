//! The integers that a board was given, replayed: which step comes when, and what a motor has counted by then.

use pulsetrain_core::{Direction, Segment};
use std::collections::VecDeque;

/// A segment in its place in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Placed {
    /// The accumulator before its first step, board ticks · 2^F, with all its high bits.
    pub(super) start: i128,
    pub(super) segment: Segment,
    pub(super) direction: Direction,
}

impl Placed {
    /// The accumulator after its last step.
    pub(super) fn end(&self) -> i128 {
        self.start + self.segment.span(self.segment.count)
    }

    /// The scheduled tick of step `k` (1..=count).
    fn tick(&self, k: u32, fraction_bits: u32) -> u64 {
        tick_of(self.start + self.segment.span(k), fraction_bits)
    }

    fn last_tick(&self, fraction_bits: u32) -> u64 {
        self.tick(self.segment.count, fraction_bits)
    }

    /// How many of its steps come before `tick`; steps come in order.
    fn steps_before(&self, tick: u64, fraction_bits: u32) -> u32 {
        if self.last_tick(fraction_bits) < tick {
            return self.segment.count;
        }
        let (mut before, mut not_before) = (0, self.segment.count);
        while not_before - before > 1 {
            let middle = before + (not_before - before) / 2;
            if self.tick(middle, fraction_bits) < tick { before = middle } else { not_before = middle }
        }
        before
    }

    /// The steps before `tick`, and those from there on: the same ticks, the same integers.
    pub(super) fn split(self, tick: u64, fraction_bits: u32) -> (Option<Placed>, Option<Placed>) {
        let k = self.steps_before(tick, fraction_bits);
        let before = Placed { segment: self.segment.truncated(k), ..self };
        let after = Placed { start: before.end(), segment: self.segment.after(k), ..self };
        ((k > 0).then_some(before), (k < self.segment.count).then_some(after))
    }
}

/// The whole ticks of an accumulator; board ticks are never negative.
pub(super) fn tick_of(accumulator: i128, fraction_bits: u32) -> u64 {
    (accumulator >> fraction_bits) as u64
}

/// All steps that a motor will make if nothing more is sent; those long past are only counted.
#[derive(Clone, Debug)]
pub(super) struct Timeline {
    fraction_bits: u32,
    /// Count before `since`, and the last step before it.
    count: i64,
    since: u64,
    last: Option<(u64, Direction)>,
    placed: VecDeque<Placed>,
}

impl Timeline {
    /// A motor that stands at `count` and was not looked at before tick `since`.
    pub(super) fn new(fraction_bits: u32, count: i64, since: u64) -> Timeline {
        Timeline { fraction_bits, count, since, last: None, placed: VecDeque::new() }
    }

    /// The count after all steps before `tick`; `None` for ticks that are forgotten.
    pub(super) fn count_before(&self, tick: u64) -> Option<i64> {
        (tick >= self.since).then(|| {
            let steps = self.placed.iter().map(|placed| signed_steps(placed, tick, self.fraction_bits));
            self.count + steps.sum::<i64>()
        })
    }

    /// The last step before `tick`, which must not be forgotten.
    pub(super) fn last_before(&self, tick: u64) -> Option<(u64, Direction)> {
        let before = |placed: &Placed| match placed.steps_before(tick, self.fraction_bits) {
            0 => None,
            k => Some((placed.tick(k, self.fraction_bits), placed.direction)),
        };
        self.placed.iter().rev().find_map(before).or(self.last)
    }

    /// The tick of the last step of all, if one is remembered.
    pub(super) fn last_tick(&self) -> Option<u64> {
        self.placed.back().map(|placed| placed.last_tick(self.fraction_bits)).or(self.last.map(|(tick, _)| tick))
    }

    /// Replaces the steps from `tick` on.
    pub(super) fn replace(&mut self, tick: u64, steps: &[Placed]) {
        while let Some(placed) = self.placed.pop_back() {
            if let (Some(before), _) = placed.split(tick, self.fraction_bits) {
                self.placed.push_back(before);
                break;
            }
        }
        self.placed.extend(steps);
    }

    /// Forgets which steps came before `tick`; how many they were stays known.
    pub(super) fn forget(&mut self, tick: u64) {
        while let Some(placed) = self.placed.pop_front() {
            let (before, after) = placed.split(tick, self.fraction_bits);
            if let Some(before) = before {
                self.count += signed_steps(&before, u64::MAX, self.fraction_bits);
                self.last = Some((before.last_tick(self.fraction_bits), before.direction));
            }
            if let Some(after) = after {
                self.placed.push_front(after);
                break;
            }
        }
        self.since = self.since.max(tick);
    }
}

fn signed_steps(placed: &Placed, tick: u64, fraction_bits: u32) -> i64 {
    i64::from(placed.direction.sign()) * i64::from(placed.steps_before(tick, fraction_bits))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const F: u32 = 16;

    /// Segments with all three differences, whose intervals stay between 1 and some 5000 ticks.
    fn segment() -> impl Strategy<Value = (Segment, bool)> {
        (1u32..200, 200i64..2000, -60_000i64..60_000, -300i64..300, any::<bool>()).prop_map(
            |(count, ticks, add, add2, forward)| {
                let segment = Segment { count, interval: (ticks << F) + 12_345, add, add2 };
                (segment, forward)
            },
        )
    }

    proptest! {
        #[test]
        fn cut_anywhere_it_counts_the_same_steps(
            segments in prop::collection::vec(segment(), 1..6),
            cuts in prop::collection::vec(0u64..1_000_000, 1..8),
        ) {
            let mut start = (1_i128 << F) * 1000 + (1 << (F - 1));
            let mut placed = Vec::new();
            let mut steps = Vec::new();
            for (segment, forward) in segments {
                let direction = if forward { Direction::Forward } else { Direction::Backward };
                let here = Placed { start, segment, direction };
                steps.extend((1..=segment.count).map(|k| (here.tick(k, F), i64::from(direction.sign()))));
                start = here.end();
                placed.push(here);
            }
            let expected = |tick: u64| steps.iter().filter(|(t, _)| *t < tick).map(|(_, sign)| sign).sum::<i64>();
            let mut timeline = Timeline::new(F, 0, 0);
            timeline.replace(0, &placed);
            for cut in cuts {
                prop_assert_eq!(timeline.count_before(cut), Some(expected(cut)));
                let last = steps.iter().rev().find(|(t, _)| *t < cut).map(|(t, _)| *t);
                prop_assert_eq!(timeline.last_before(cut).map(|(t, _)| t), last);
                let mut forgetful = timeline.clone();
                forgetful.forget(cut);
                prop_assert_eq!(forgetful.count_before(cut.wrapping_sub(1)).is_some(), cut == 0);
                prop_assert_eq!(forgetful.count_before(u64::MAX >> 1), timeline.count_before(u64::MAX >> 1));
                // What is cut off and put back is as it was.
                let rest: Vec<Placed> = placed.iter().filter_map(|p| p.split(cut, F).1).collect();
                timeline.replace(cut, &rest);
                prop_assert_eq!(timeline.count_before(u64::MAX >> 1), Some(expected(u64::MAX)));
            }
        }
    }
}
