//! The load of a plan on the board's processor.

use pulsetrain_core::Segment;

/// What steps and segments of one motor cost a board's processor, ticks of the motor's share of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Load {
    /// Cost of a step.
    pub step_ticks: u64,
    /// Cost of a segment in the direction of the one before it, without its steps.
    pub onward_ticks: u64,
    /// Cost of a segment in the other direction, without its steps.
    pub turning_ticks: u64,
    /// Additional cost of receiving a segment from the host.
    pub heard_ticks: u64,
    /// How much work on steps and segments may wait, because a board works ahead.
    pub burst_ticks: u64,
    /// How much of all work may wait, because the board has segments long before they are due.
    pub heard_burst_ticks: u64,
}

/// The work that waits for the board's processor, if it had only this motor's share of the time.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Backlog {
    /// Work on steps and segments.
    own: Work,
    /// The same, with the work of receiving them.
    all: Work,
}

/// Work that waits.
#[derive(Clone, Copy, Debug, Default)]
struct Work {
    /// The amount, ticks.
    ticks: i64,
    /// The tick up to which work has been counted.
    seen: i64,
    /// The tick at which waiting began, the number of segments since then, and the cost of them and their steps, ticks.
    since: i64,
    segments: u32,
    taken: i64,
}

/// Segments that are too many for the processor, per tick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Excess {
    /// The rate of the plan.
    pub(crate) asked: f64,
    /// The rate that the processor can do.
    pub(crate) done: f64,
}

impl Backlog {
    /// Adds a segment whose last step is at `tick`.
    ///
    /// # Errors
    /// If more work waits than is allowed.
    pub(crate) fn add(&mut self, load: &Load, segment: &Segment, turns: bool, tick: i64) -> Result<(), Excess> {
        let own = if turns { load.turning_ticks } else { load.onward_ticks };
        let steps = u64::from(segment.count).saturating_mul(load.step_ticks);
        self.own.add(own, steps, tick, load.burst_ticks)?;
        self.all.add(own + load.heard_ticks, steps, tick, load.heard_burst_ticks)
    }
}

impl Work {
    fn add(&mut self, own: u64, steps: u64, tick: i64, burst: u64) -> Result<(), Excess> {
        let [own, steps, burst] = [own, steps, burst].map(|ticks| i64::try_from(ticks).unwrap_or(i64::MAX));
        self.ticks -= (tick - self.seen).saturating_sub(steps).max(0);
        if self.ticks <= 0 {
            // A rest or a slow segment before a fast part cannot be used for the work that comes later.
            *self = Work { since: self.seen.max(tick.saturating_sub(steps).saturating_sub(own)), ..Work::default() };
        }
        self.ticks += own;
        (self.seen, self.segments) = (tick, self.segments + 1);
        self.taken = self.taken.saturating_add(steps).saturating_add(own);
        if self.ticks <= burst.max(own) {
            return Ok(());
        }
        let rate = |ticks: i64| f64::from(self.segments) / ticks.max(1) as f64;
        Err(Excess { asked: rate(tick - self.since), done: rate(self.taken) })
    }
}
