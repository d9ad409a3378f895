//! What a plan asks of the board's processor.

use pulsetrain_core::Segment;

/// What steps and segments of one motor take a board's processor, ticks of the motor's share of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Load {
    /// A step.
    pub step_ticks: u64,
    /// A segment that goes the same way as that before it, without its steps.
    pub onward_ticks: u64,
    /// One that turns, likewise.
    pub turning_ticks: u64,
    /// What comes on top for hearing of a segment from the host.
    pub heard_ticks: u64,
    /// So much of steps and segments may be put off, as a board works ahead.
    pub burst_ticks: u64,
    /// So much of all may be put off, since the board has segments long before they are due.
    pub heard_burst_ticks: u64,
}

/// What the board's processor has not come to yet, if it had no more than this motor's share.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Backlog {
    /// Of steps and segments.
    own: Work,
    /// With what hearing of them takes.
    all: Work,
}

/// Work that is put off.
#[derive(Clone, Copy, Debug, Default)]
struct Work {
    /// How much, ticks.
    ticks: i64,
    /// Up to this tick.
    seen: i64,
    /// When it began, segments since then, and what they and their steps take, ticks.
    since: i64,
    segments: u32,
    taken: i64,
}

/// Segments that the processor does not get through, a tick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Excess {
    /// As they come.
    pub(crate) asked: f64,
    /// As the processor does them.
    pub(crate) done: f64,
}

impl Backlog {
    /// Adds a segment whose last step is at `tick`.
    ///
    /// # Errors
    /// If more is put off than may be.
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
            // A rest, or a slow segment, before what comes too fast is no time for that.
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
