//! The steps that the motors of a run made, step by step: a stop, a pause or a new tempo leaves the plan behind.

use pulsetrain_board::ScheduledStep;

/// The steps that one motor made.
#[derive(Clone, Copy, Debug, Default)]
pub struct RecordedSteps {
    /// Steps in both directions.
    pub steps: u64,
    /// Steps forward minus steps backward.
    pub position: i64,
    /// The lowest and the highest position, steps from the start.
    pub range: (i64, i64),
    /// The shortest interval between two steps of one direction, ticks.
    pub shortest_interval_ticks: Option<u64>,
    last: Option<ScheduledStep>,
}

impl RecordedSteps {
    /// Takes the next step.
    pub fn step(&mut self, step: ScheduledStep) {
        self.steps += 1;
        self.position += i64::from(step.direction.sign());
        self.range = (self.range.0.min(self.position), self.range.1.max(self.position));
        if let Some(last) = self.last.filter(|last| last.direction == step.direction) {
            let interval = step.tick - last.tick;
            self.shortest_interval_ticks =
                Some(self.shortest_interval_ticks.map_or(interval, |shortest| shortest.min(interval)));
        }
        self.last = Some(step);
    }

    /// The tick of the last step. `None` if there was none.
    #[must_use]
    pub fn last_tick(&self) -> Option<u64> {
        self.last.map(|last| last.tick)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulsetrain_core::Direction::{self, Backward, Forward};

    #[test]
    fn steps_are_counted_with_their_range_and_their_shortest_interval() {
        let mut made = RecordedSteps::default();
        let mut take = |steps: &[(u64, Direction)]| {
            for &(tick, direction) in steps {
                made.step(ScheduledStep { motor: 0, tick, direction });
            }
            made
        };
        let first = take(&[(100, Forward)]);
        assert_eq!((first.steps, first.shortest_interval_ticks, first.last_tick()), (1, None, Some(100)));
        // A turn's interval says nothing about a speed.
        let made =
            take(&[(150, Forward), (190, Forward), (200, Backward), (260, Backward), (320, Backward), (380, Backward)]);
        assert_eq!((made.steps, made.position, made.range), (7, -1, (-1, 3)));
        assert_eq!((made.shortest_interval_ticks, made.last_tick()), (Some(40), Some(380)));
    }
}
