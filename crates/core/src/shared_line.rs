//! A DIR line that several motors share, while they brake after a lapse. Then no plan keeps their steps apart.
//!
//! The steps of all motors of the line are made in the order of their scheduled ticks; at one tick, in the order of the
//! motors' numbers. A step that is already committed comes first. A step that needs the other level of the line is [put
//! off](crate::Channel::put_off) until the last step has had its pulse and hold time and the line its setup time. This
//! does not change the accumulator of its motor.

use crate::Tick32;

/// The state of such a line. It keeps steps apart that need different levels.
#[derive(Clone, Copy, Debug)]
pub struct SharedLine {
    apart_ticks: u32,
    level: Option<bool>,
    /// From when on it can be needed at the other level.
    open: Option<Tick32>,
}

impl SharedLine {
    /// A line on which no step was made. `apart_ticks`: the longest pulse and hold of its motors, and the longest setup.
    #[must_use]
    pub const fn new(apart_ticks: u32) -> SharedLine {
        SharedLine { apart_ticks, level: None, open: None }
    }

    /// From when on a step can be made with the line at `level`, if it must be turned for that. No
    /// turn that is not made yet can serve a step before `soonest`.
    #[must_use]
    pub fn open(&self, level: bool, soonest: Tick32) -> Option<Tick32> {
        let turns = self.level != Some(level);
        turns.then(|| self.open.map_or(soonest, |open| open.or_later(soonest)))
    }

    /// Notes that time is past `now`. To be called at least once in 2^30 ticks.
    pub fn pass(&mut self, now: Tick32) {
        self.open = self.open.filter(|open| now.is_before(*open));
    }

    /// A step was made at `tick` with the line at `level`.
    pub const fn made(&mut self, tick: Tick32, level: bool) {
        (self.level, self.open) = (Some(level), Some(tick.after(self.apart_ticks)));
    }
}

/// Of the next steps of a line's motors, each with its tick and whether it is committed, in order of the motors: which one goes first.
pub fn first(steps: impl Iterator<Item = Option<(Tick32, bool)>>) -> Option<usize> {
    let known = steps.enumerate().filter_map(|(motor, step)| step.map(|step| (motor, step)));
    let first = known.reduce(|one, other| {
        let ((_, (tick, committed)), (_, (other_tick, also))) = (one, other);
        let sooner = if committed == also { other_tick.is_before(tick) } else { also };
        if sooner { other } else { one }
    });
    first.map(|(motor, _)| motor)
}
