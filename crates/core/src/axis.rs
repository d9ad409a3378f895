//! The axis: one motor's queue, channel and output together. It returns the motor's edges, no sooner than they are due.
//!
//! Nothing after the tick that is asked for is committed but the step that a DIR edge was made for. So at any tick the
//! position counts the pulses that were begun, and all else can still be switched away.

use crate::channel::{Channel, EventKind};
use crate::output::{Edge, Output};
use crate::queue::Items;
use crate::{Direction, Tick32};

/// One motor: `F` fraction bits, and what its items wait in: a [`Queue`](crate::Queue), or what a host has in its place.
#[derive(Clone, Debug)]
pub struct Axis<const F: u32, Q> {
    queue: Q,
    channel: Channel<F>,
    output: Output,
    /// No edge may be before it.
    open: Tick32,
    /// The level of the DIR line that this motor asked for last.
    facing: Option<Direction>,
    setup_cut_short: bool,
}

impl<const F: u32, Q: Items> Axis<F, Q> {
    /// A motor at rest at tick 0 and position 0.
    #[must_use]
    pub const fn new(output: Output, queue: Q) -> Axis<F, Q> {
        Axis {
            queue,
            channel: Channel::new(output.gap_ticks(), output.asserts_every_step()),
            output,
            open: Tick32(0),
            facing: None,
            setup_cut_short: false,
        }
    }

    /// The next edge that comes not after `until`.
    pub fn next(&mut self, until: Tick32) -> Option<Edge> {
        let owed = self.output.owed();
        // As far as a DIR edge may come before its step, so that its tick does not hang on how `until` moves on. Also in mid-pulse:
        // switches that are past must not look as if they waited.
        let event = self.channel.peek(&mut self.queue, until.after(self.output.lead_ticks()));
        if let (Some(tick), Output::StepDir(_)) = (owed, &self.output) {
            return if until.is_before(tick) { None } else { self.settle() };
        }
        let due = event.map(|event| self.output.due(event));
        if let Some(tick) = owed
            && due.is_none_or(|due| tick.is_before(due))
        {
            return if until.is_before(tick) { None } else { self.settle() };
        }
        let (event, due) = (event?, due?);
        if until.is_before(due) {
            return None;
        }
        let tick = due.or_later(self.open);
        if let EventKind::Direction(direction) = event.kind {
            let turns = self.facing != Some(direction) || self.output.asserts_every_step();
            if tick != due && turns && self.channel.give_up_step(event, &mut self.queue) {
                return self.next(until);
            }
            self.setup_cut_short |= tick != due && self.facing != Some(direction);
            self.facing = Some(direction);
        }
        self.channel.take(event);
        self.open = tick;
        Some(self.output.apply(event, tick))
    }

    fn settle(&mut self) -> Option<Edge> {
        let edge = self.output.settle()?;
        self.open = edge.tick;
        Some(edge)
    }

    /// Notes that time is past `now`: see [`Channel::pass`].
    pub fn pass(&mut self, now: Tick32) {
        self.channel.pass(now);
        self.open = now.after(1);
    }

    /// Makes no step more; a pulse that was begun still ends.
    pub fn stop(&mut self) {
        self.channel.stop(&mut self.queue);
    }

    /// Whether nothing is left to do: no step, no end of a pulse.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.output.owed().is_none() && self.channel.is_idle(&self.queue)
    }

    /// The channel: position, horizon, epoch.
    #[must_use]
    pub const fn channel(&self) -> &Channel<F> {
        &self.channel
    }

    /// Mutable access to the channel, for its lease.
    pub const fn channel_mut(&mut self) -> &mut Channel<F> {
        &mut self.channel
    }

    /// Whether a pulse is under way, or coils are to be released. No step is taken before that is done.
    #[must_use]
    pub const fn owes(&self) -> bool {
        self.output.owed().is_some()
    }

    /// The next step, if it is scheduled up to `look`, and whether it is committed; goes over and lapses up to there. For motors that
    /// share a DIR line: `look` is as far as any of them looks, its own [lead](Axis::lead_ticks) included.
    pub fn scheduled(&mut self, look: Tick32) -> Option<(Tick32, bool)> {
        self.channel.peek(&mut self.queue, look);
        self.channel.scheduled().filter(|(tick, _)| !look.is_before(*tick))
    }

    /// The first step that a DIR edge can still come its set-up before.
    #[must_use]
    pub const fn soonest_turn(&self) -> Tick32 {
        self.open.after(self.output.lead_ticks())
    }

    /// So far beyond `until` [`next`](Axis::next) looks, ticks.
    #[must_use]
    pub const fn lead_ticks(&self) -> u32 {
        self.output.lead_ticks()
    }

    /// The items waiting.
    #[must_use]
    pub const fn queue(&self) -> &Q {
        &self.queue
    }

    /// Mutable access to the queue, to add items or remove some.
    pub const fn queue_mut(&mut self) -> &mut Q {
        &mut self.queue
    }

    /// Whether a DIR edge could not come its set-up before the step: the plan left no room for it.
    #[must_use]
    pub const fn setup_cut_short(&self) -> bool {
        self.setup_cut_short
    }
}
