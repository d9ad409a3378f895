//! A DIR line that several motors share, while they brake after a lapse. A planner keeps their steps apart; here, no plan does.
//!
//! The steps of all motors of the line are made in the order of their scheduled ticks; at one tick, in the order of the
//! motors' numbers. A step that is already committed comes first. A step that needs the other level of the line is [put
//! off](crate::Channel::put_off) until the last step has had its pulse and hold, and the line its set-up. The accumulator of its
//! motor does not change.

use crate::Tick32;

/// The state of a shared line.
#[derive(Clone, Copy, Debug)]
pub struct SharedLine {
    apart_ticks: u32,
    level: Option<bool>,
    /// From this tick on a step may need the other level.
    free_from: Option<Tick32>,
}

impl SharedLine {
    /// A line before its first step. `apart_ticks` is the sum of the longest pulse, the longest hold and the longest set-up of its motors.
    #[must_use]
    pub const fn new(apart_ticks: u32) -> SharedLine {
        SharedLine { apart_ticks, level: None, free_from: None }
    }

    /// The earliest tick of a step with the line at `level`; `None` if the line has that level already. A change of level now is in time
    /// only for steps from `soonest` on.
    #[must_use]
    pub fn earliest_step(&self, level: bool, soonest: Tick32) -> Option<Tick32> {
        let turns = self.level != Some(level);
        turns.then(|| self.free_from.map_or(soonest, |open| open.or_later(soonest)))
    }

    /// Notes that time is past `now`. To be called at least once in 2^30 ticks.
    pub fn pass(&mut self, now: Tick32) {
        self.free_from = self.free_from.filter(|open| now.is_before(*open));
    }

    /// Notes that a step was made at `tick` with the line at `level`.
    pub const fn made(&mut self, tick: Tick32, level: bool) {
        (self.level, self.free_from) = (Some(level), Some(tick.after(self.apart_ticks)));
    }
}

/// The motor of a line that steps first. `steps` has each motor's next step, in order of the motors: its tick, and whether it is
/// committed.
pub fn first_motor(steps: impl Iterator<Item = Option<(Tick32, bool)>>) -> Option<usize> {
    let known = steps.enumerate().filter_map(|(motor, step)| step.map(|step| (motor, step)));
    let first = known.reduce(|one, other| {
        let ((_, (tick, committed)), (_, (other_tick, also))) = (one, other);
        let sooner = if committed == also { other_tick.is_before(tick) } else { also };
        if sooner { other } else { one }
    });
    first.map(|(motor, _)| motor)
}
