//! The axis: one motor's queue, channel and output together. It returns the motor's edges, no sooner than they are due.
//!
//! Up to a tick, only the events up to that tick are committed, and the step whose DIR edge came by then. So the position always
//! counts the pulses that have begun, and a switch can still replace all later steps.

use crate::channel::{Channel, EventKind};
use crate::output::{Edge, Output};
use crate::queue::Items;
use crate::{Direction, Tick32};

/// One motor. `F` is the number of fraction bits, `Q` its queue: a [`Queue`](crate::Queue), or a host's own.
#[derive(Clone, Debug)]
pub struct Axis<const F: u32, Q> {
    queue: Q,
    channel: Channel<F>,
    output: Output,
    /// The next edge comes at this tick at the earliest.
    not_before: Tick32,
    /// The direction that this motor's last DIR edge set.
    dir_line: Option<Direction>,
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
            not_before: Tick32(0),
            dir_line: None,
            setup_cut_short: false,
        }
    }

    /// The next edge at tick `until` or before.
    pub fn next(&mut self, until: Tick32) -> Option<Edge> {
        let pending = self.output.pending_tick();
        // It looks ahead by as much as a DIR edge may come before its step, so that the edge's tick does not depend on the steps in which
        // `until` advances. It does so during a pulse, too: else a switch that is past would still seem to wait.
        let event = self.channel.peek(&mut self.queue, until.after(self.output.lead_ticks()));
        if let (Some(tick), Output::StepDir(_)) = (pending, &self.output) {
            return if until.is_before(tick) { None } else { self.take_pending() };
        }
        let due = event.map(|event| self.output.due(event));
        if let Some(tick) = pending
            && due.is_none_or(|due| tick.is_before(due))
        {
            return if until.is_before(tick) { None } else { self.take_pending() };
        }
        let (event, due) = (event?, due?);
        if until.is_before(due) {
            return None;
        }
        let tick = due.or_later(self.not_before);
        if let EventKind::Direction(direction) = event.kind {
            let turns = self.dir_line != Some(direction) || self.output.asserts_every_step();
            if tick != due && turns && self.channel.drop_step_if_leased(event, &mut self.queue) {
                return self.next(until);
            }
            self.setup_cut_short |= tick != due && self.dir_line != Some(direction);
            self.dir_line = Some(direction);
        }
        self.channel.take(event);
        self.not_before = tick;
        Some(self.output.apply(event, tick))
    }

    fn take_pending(&mut self) -> Option<Edge> {
        let edge = self.output.take_pending()?;
        self.not_before = edge.tick;
        Some(edge)
    }

    /// Notes that time is past `now`: see [`Channel::pass`].
    pub fn pass(&mut self, now: Tick32) {
        self.channel.pass(now);
        self.not_before = now.after(1);
    }

    /// Makes no further step. A pulse that has begun still ends.
    pub fn stop(&mut self) {
        self.channel.stop(&mut self.queue);
    }

    /// Whether nothing is left to do: no step, no end of a pulse.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.output.pending_tick().is_none() && self.channel.is_idle(&self.queue)
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

    /// Whether a pulse has yet to end, or coils have yet to be released. No step is made before the end of the pulse.
    #[must_use]
    pub const fn has_pending_edge(&self) -> bool {
        self.output.pending_tick().is_some()
    }

    /// The tick of the next step, if it is not after `look`, and whether the step is committed. Switches and the end of a lease up to `look`
    /// take effect. This is for motors that share a DIR line: `look` is the tick up to which any of them looks, with its
    /// [`lead_ticks`](Axis::lead_ticks).
    pub fn scheduled(&mut self, look: Tick32) -> Option<(Tick32, bool)> {
        self.channel.peek(&mut self.queue, look);
        self.channel.scheduled().filter(|(tick, _)| !look.is_before(*tick))
    }

    /// The tick of the first step for which a DIR edge now would be in time.
    #[must_use]
    pub const fn soonest_turn(&self) -> Tick32 {
        self.not_before.after(self.output.lead_ticks())
    }

    /// How far [`next`](Axis::next) looks beyond `until`, ticks: the set-up time of DIR.
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

    /// Whether a DIR edge came less than its set-up before a step, because the plan left no time for it.
    #[must_use]
    pub const fn setup_cut_short(&self) -> bool {
        self.setup_cut_short
    }
}
