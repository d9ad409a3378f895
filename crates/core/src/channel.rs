//! The channel: queue items → events, each a tick and what happens then.
//!
//! Ticks go up strictly from step to step. A step that would break that rule (an interval that is too short, an item
//! that came too late, a motion without an [`Item::Anchor`]) is not made: under a lease the motor brakes, else the
//! channel drops what follows up to the next anchor; [`Channel::missed`] says so. So whatever a queue holds, every step counted can be a pulse.
//!
//! Switches: a step of the old epoch at a tick ≥ `at` is not made, one before is. The new epoch makes no step
//! before `at`.
//!
//! A lease ends a plan in the same way, but then the motor brakes: see [`lease`](crate::lease).

use crate::braking::{Limit, RegisterLimits};
use crate::lease::{ExtendRefused, Lapse, LapseCause, Lease};
use crate::queue::{Epoch, Item, Items, Place};
use crate::{Direction, Recurrence, Segment, Tick32};

/// What happens at a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepEvent {
    /// The scheduled tick: of the step itself, or of the step that a change of direction is for.
    pub tick: Tick32,
    /// What happens.
    pub kind: EventKind,
}

/// What an event is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EventKind {
    /// The next step, at this event's tick, needs the DIR line so.
    Direction(Direction),
    /// One step.
    Step,
}

/// A switch that cannot be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SwitchRefused {
    /// The tick is already committed.
    Late {
        /// The first tick at which a switch would be accepted now.
        horizon: Tick32,
    },
    /// Another waits, for an earlier tick.
    Full,
}

#[derive(Clone, Copy, Debug)]
struct Switch {
    epoch: Epoch,
    at: Tick32,
    /// What begins with it.
    lease: Lease,
    limit: Limit,
    /// The lease lapsed before it: it is not made.
    cancelled: bool,
}

/// What ends the plan that is being followed.
#[derive(Clone, Copy, Debug)]
struct End {
    at: Tick32,
    /// A switch; else the lease is over then.
    is_switch: bool,
}

/// How far a run's next steps may be taken all at once: for the `advance` of [`Channel::take_steps`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ahead {
    /// No step comes sooner after the one before, ticks.
    pub gap: u32,
    /// All of them come less than this after the last step, ticks.
    pub ticks: u32,
    /// Steps at most; not 0, but for a run that has none.
    pub most: u32,
}

/// Expands the items of one motor; `F` is the number of fraction bits, 1..=32.
///
/// What each event asks for stands first: a Cortex-M0+ reaches 124 bytes of a structure by one load.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Channel<const F: u32> {
    recurrence: Recurrence,
    /// The interval before the last step, ticks · 2^F.
    last_interval: i64,
    /// Steps of the segment still to be made.
    left: u32,
    horizon: Tick32,
    gap: u32,
    position: i32,
    /// The tick of the next step, if its direction has been asserted: the step is then committed.
    committed: Option<Tick32>,
    /// Of the switch and the lease: looked at with each event.
    end: Option<End>,
    lapse: Option<Lapse>,
    /// The next step is not made before.
    not_before: Option<Tick32>,
    /// Which way the steps of the segment go.
    direction: Direction,
    /// The direction that the DIR line was last set to.
    facing: Option<Direction>,
    /// Whether the accumulator means anything.
    anchored: bool,
    /// No step has been made since the last anchor, wait or reversal.
    fresh: bool,
    assert_every_step: bool,
    /// The lease is over for this channel: what it makes is its stop.
    braking: bool,
    /// All channels of the machine know of the lapse.
    agreed: bool,
    /// It was in motion when the lease was over.
    moved: bool,
    epoch: Epoch,
    missed: Option<Tick32>,
    lease: Lease,
    /// How hard the motor may brake.
    limit: Limit,
    switch: Option<Switch>,
}

impl<const F: u32> Channel<F> {
    /// A channel at rest at tick 0, position 0, epoch 0.
    ///
    /// Steps closer than `gap` ticks (at least 1) are not made. With `assert_every_step`, as a shared DIR line
    /// needs it, each step is preceded by its direction, not only the first after a change.
    #[must_use]
    pub const fn new(gap: u32, assert_every_step: bool) -> Channel<F> {
        const { assert!(1 <= F && F <= 32) };
        Channel {
            recurrence: Recurrence { accumulator: 0, interval: 0, add: 0, add2: 0 },
            left: 0,
            direction: Direction::Forward,
            facing: None,
            committed: None,
            anchored: false,
            fresh: true,
            last_interval: 0,
            assert_every_step,
            gap: if gap == 0 { 1 } else { gap },
            position: 0,
            horizon: Tick32(0),
            epoch: Epoch(0),
            switch: None,
            end: None,
            missed: None,
            lease: Lease::Off,
            limit: Limit::WITHIN_A_STEP,
            lapse: None,
            agreed: false,
            braking: false,
            moved: false,
            not_before: None,
        }
    }

    /// The next event that is not after `limit`; it stays next until [`take`](Channel::take).
    ///
    /// `limit` goes up from call to call, by less than 2^30 ticks beyond the last [`pass`](Channel::pass).
    pub fn peek(&mut self, items: &mut impl Items, limit: Tick32) -> Option<StepEvent> {
        loop {
            if let Some(tick) = self.committed {
                return Some(StepEvent { tick, kind: EventKind::Step });
            }
            let tick = if self.left > 0 { self.next_tick() } else { self.last_tick() };
            // Before anything else: beyond the limit, ticks may be too far from others to be compared with them.
            let beyond = self.anchored && limit.is_before(tick);
            if let Some(end) = self.end {
                let at_end = self.left == 0 && !self.takes(items);
                if beyond || at_end || (self.anchored && !tick.is_before(end.at)) {
                    if at_end && self.runs_dry(limit, end.at) {
                        self.fail(LapseCause::Underrun, items);
                        continue;
                    }
                    if limit.is_before(end.at) {
                        return None;
                    }
                    if end.is_switch {
                        self.begin(items);
                    } else {
                        let lapse = self.lapse.unwrap_or(Lapse { at: end.at, cause: LapseCause::NotExtended });
                        self.horizon = self.horizon.or_later(end.at);
                        self.brake(lapse, items);
                    }
                    continue;
                }
            }
            if beyond {
                return None;
            }
            if self.left > 0 {
                let mut tick = tick;
                // After a lapse a shared line may have put the step before off, too.
                if self.lapse.is_some() && (self.braking || self.assert_every_step && !self.fresh) {
                    tick = self.possible(tick);
                    if limit.is_before(tick) {
                        return None;
                    }
                }
                if tick.is_before(self.horizon) {
                    self.miss(tick, items);
                    continue;
                }
                let turned = self.facing != Some(self.direction);
                let kind = if turned || self.assert_every_step {
                    EventKind::Direction(self.direction)
                } else {
                    EventKind::Step
                };
                return Some(StepEvent { tick, kind });
            }
            if !self.takes(items) {
                return None;
            }
            if self.anchored
                && let Some(direction) = items.run_direction()
                && let count @ 1.. = items.take_run(self.epoch, direction, &mut self.recurrence)
            {
                self.left = count;
                self.fresh |= direction != self.direction;
                self.direction = direction;
                continue;
            }
            let failed_before = items.has_failed();
            items.end_runs(&self.recurrence);
            match items.take(&self.place()) {
                Some(item) => self.load(item, items),
                None if items.has_failed() && !failed_before && self.is_leased() => {
                    self.fail(LapseCause::BadItem, items)
                }
                None => {}
            }
        }
    }

    /// Commits the event that [`peek`](Channel::peek) gave: a step is counted here.
    pub fn take(&mut self, event: StepEvent) {
        match event.kind {
            EventKind::Direction(direction) => {
                self.facing = Some(direction);
                self.committed = Some(event.tick);
                self.horizon = event.tick.after(1);
            }
            EventKind::Step => {
                self.last_interval = self.recurrence.interval;
                self.recurrence.advance();
                self.left -= 1;
                self.committed = None;
                self.not_before = None;
                self.position = self.position.wrapping_add(self.direction.sign());
                self.horizon = event.tick.after(self.gap);
                self.stepped();
            }
        }
    }

    /// A new channel begins to exist at tick `now`: ticks can be compared within 2^31 only, and tick 0 may be longer ago.
    pub const fn open_from(&mut self, now: Tick32) {
        self.horizon = now;
    }

    /// Notes that time is past `now`. To be called at least once in 2^30 ticks, after all events up to `now` have
    /// been taken.
    pub fn pass(&mut self, now: Tick32) {
        self.horizon = self.horizon.or_later(now.after(1));
        // An accumulator that is left behind would come back as the future.
        if self.left == 0 && matches!(now.since(self.last_tick()), 0x4000_0000..0x8000_0000) {
            self.anchored = false;
            self.fresh = true;
        }
    }

    /// Begins `epoch` at tick `at`, which is less than 2^31 ticks ahead. The rest of the old epoch is dropped then. The new plan holds as long as
    /// `lease` says. `limit` says how hard the motor may brake; without one it keeps the limit that it has. A lapse of the old lease ends here.
    ///
    /// One switch may wait. Another one replaces it at its tick or before.
    ///
    /// # Errors
    /// When `at` lies before the horizon, or after a switch that waits; nothing changes then.
    pub fn schedule_switch(
        &mut self,
        epoch: Epoch,
        at: Tick32,
        lease: Lease,
        limit: Option<Limit>,
    ) -> Result<(), SwitchRefused> {
        self.check_switch(at)?;
        let limit = limit.unwrap_or(self.limit);
        self.switch = Some(Switch { epoch, at, lease, limit, cancelled: false });
        self.note_end();
        Ok(())
    }

    /// Whether [`extend`](Channel::extend) would be right now.
    ///
    /// # Errors
    /// When there is no lease, it has lapsed, or its end would lie before the horizon.
    pub fn check_extend(&self, lease: Lease) -> Result<(), ExtendRefused> {
        let begins = self.switch.is_some_and(|switch| !switch.cancelled && switch.lease != Lease::Off);
        match (self.lapse, lease) {
            _ if begins => {}
            (Some(Lapse { at, .. }), _) => return Err(ExtendRefused::Lapsed { at }),
            (None, _) if self.lease == Lease::Off => return Err(ExtendRefused::Off),
            (None, _) => {}
        }
        match lease {
            Lease::Off => Err(ExtendRefused::Off),
            Lease::Until(at) if at.is_before(self.horizon) => Err(ExtendRefused::Late { horizon: self.horizon }),
            Lease::Until(_) | Lease::Last => Ok(()),
        }
    }

    /// Puts the end of the lease off, or earlier; also of the lease that a switch will begin. What
    /// [`check_extend`](Channel::check_extend) refuses is not for this.
    pub fn extend(&mut self, lease: Lease, limit: Option<Limit>) {
        self.limit = limit.unwrap_or(self.limit);
        if self.lapse.is_none() && self.lease != Lease::Off {
            self.lease = lease;
        }
        if let Some(switch) = self.switch.as_mut().filter(|switch| switch.lease != Lease::Off) {
            switch.lease = lease;
            switch.limit = limit.unwrap_or(switch.limit);
        }
        self.note_end();
    }

    /// The lease is over at `lapse.at`, or was earlier already: all channels of a machine are called so when
    /// [one of them says it](crate::channels::agreed_lapse), or at the horizon when the host says so.
    pub fn lapse_at(&mut self, lapse: Lapse) {
        if let Some(switch) = &mut self.switch {
            if !switch.at.is_before(lapse.at) {
                switch.cancelled = true;
            } else if switch.lease != Lease::Off {
                switch.lease = Lease::Until(lapse.at);
            }
        }
        match &mut self.lapse {
            // Its own fault: now it is known when the others brake.
            Some(own) if !self.agreed && own.cause.is_fault() => *own = lapse,
            Some(own) if !self.braking && lapse.at.is_before(own.at) => *own = lapse,
            Some(own) if lapse.cause.is_fault() => own.cause = lapse.cause,
            Some(_) => {}
            None => self.lapse = Some(lapse),
        }
        self.agreed = true;
        if self.braking {
            self.drop_cancelled();
        }
        self.note_end();
    }

    /// The direction that `event` asks for would come too late for its step. With a lease that has not lapsed, that step is not made, and the
    /// motor brakes; otherwise it is taken as it is, and the answer is `false`.
    pub fn give_up_step(&mut self, event: StepEvent, items: &mut impl Items) -> bool {
        let gives_up = self.is_leased() && self.lapse.is_none();
        if gives_up {
            self.miss(event.tick, items);
        }
        gives_up
    }

    /// When the lease was over, and why.
    #[must_use]
    pub const fn lapse(&self) -> Option<Lapse> {
        self.lapse
    }

    /// Whether its lease is over and not all channels [know](Channel::lapse_at).
    #[must_use]
    pub const fn has_news(&self) -> bool {
        self.lapse.is_some() && !self.agreed
    }

    /// How long its plan holds.
    #[must_use]
    pub const fn lease(&self) -> Lease {
        self.lease
    }

    /// Whether it makes the steps of its stop.
    #[must_use]
    pub const fn is_braking(&self) -> bool {
        self.braking && self.left > 0
    }

    /// Whether the motor was in motion when the lease was over.
    #[must_use]
    pub const fn was_moving(&self) -> bool {
        self.moved
    }

    /// Whether items of `epoch` are worth keeping: after a lapse those of the epoch that was run are not.
    #[must_use]
    pub fn keeps(&self, epoch: Epoch) -> bool {
        self.lapse.is_none() || epoch != self.epoch
    }

    /// The tick that the next step is scheduled for, if it is known, and whether it is committed: for motors that share a DIR line.
    #[must_use]
    pub fn scheduled(&self) -> Option<(Tick32, bool)> {
        (self.left > 0).then(|| (self.next_tick(), self.committed.is_some()))
    }

    /// The next step, which is not committed, is not made before `tick`: another motor needs the DIR line until then. Its accumulator stays.
    /// After a lapse only.
    pub const fn put_off(&mut self, tick: Option<Tick32>) {
        self.not_before = tick;
    }

    /// Whether [`schedule_switch`](Channel::schedule_switch) would accept `at`.
    ///
    /// # Errors
    /// As there.
    pub fn check_switch(&self, at: Tick32) -> Result<(), SwitchRefused> {
        if at.is_before(self.horizon) {
            return Err(SwitchRefused::Late { horizon: self.horizon });
        }
        let waits = self.switch.filter(|switch| !switch.cancelled);
        if waits.is_some_and(|switch| switch.at.is_before(at)) { Err(SwitchRefused::Full) } else { Ok(()) }
    }

    /// Forgets everything that is not yet committed by a pulse: the motor stands where it is, and the count is right.
    pub fn stop(&mut self, items: &mut impl Items) {
        items.clear();
        self.left = 0;
        self.committed = None;
        self.rest();
        self.switch = None;
        self.lease = Lease::Off;
        self.resume();
        self.note_end();
    }

    /// Steps forward minus steps backward that were taken, wrapping.
    #[must_use]
    pub const fn position(&self) -> i32 {
        self.position
    }

    /// The first tick that is not committed: a switch is accepted from there on.
    #[must_use]
    pub const fn horizon(&self) -> Tick32 {
        self.horizon
    }

    /// The epoch being run.
    #[must_use]
    pub const fn epoch(&self) -> Epoch {
        self.epoch
    }

    /// The tick of the first step of this epoch that could not be made.
    #[must_use]
    pub const fn missed(&self) -> Option<Tick32> {
        self.missed
    }

    /// Whether there is nothing to do, now or later, unless more is pushed.
    #[must_use]
    pub fn is_idle(&self, items: &impl Items) -> bool {
        self.is_done() && !self.takes(items)
    }

    /// Whether all items that were taken are done, no switch waits, and the motor is not about to brake.
    #[must_use]
    pub const fn is_done(&self) -> bool {
        let brakes = !self.braking && !self.fresh && (self.lapse.is_some() || matches!(self.lease, Lease::Until(_)));
        self.left == 0 && self.switch.is_none() && !brakes
    }

    /// Where it is, the waits that were loaded included.
    #[must_use]
    pub const fn place(&self) -> Place {
        let sixteenth = (self.recurrence.accumulator << (32 - F) >> 16).to_le_bytes();
        Place {
            position: self.position,
            tick: self.last_tick(),
            fraction: u16::from_le_bytes([sixteenth[0], sixteenth[1]]),
        }
    }

    /// Takes steps of the run that is under way without an event for each, but none after `limit`. `advance` moves the recurrence on by
    /// as many steps as it wants and [`Ahead`] allows, and says how many.
    ///
    /// Gives how many were taken: 0 if the next one goes another way. For callers that have made nothing since the step before.
    pub fn take_steps(&mut self, limit: Tick32, advance: impl FnOnce(&mut Recurrence, Ahead) -> u32) -> u32 {
        if self.committed.is_some() || self.left == 0 || self.facing != Some(self.direction) || self.assert_every_step {
            return 0;
        }
        if self.next_tick().is_before(self.horizon) {
            return 0;
        }
        let end = match self.end {
            Some(end) if !limit.is_before(end.at) => end.at,
            _ => limit.after(1),
        };
        let last = self.last_tick();
        if end.is_before(last) {
            return 0;
        }
        let ahead = Ahead { gap: self.gap, ticks: end.since(last), most: self.left };
        let taken = advance(&mut self.recurrence, ahead).min(self.left);
        if taken > 0 {
            self.took(taken);
            self.horizon = self.last_tick().after(self.gap);
            self.stepped();
        }
        taken
    }

    /// Whether steps up to `limit` are runs one after the other, as far as is known: no switch, no lapse and no other item comes between, and the
    /// step before was the last event.
    pub(crate) fn goes_on(&self, limit: Tick32) -> bool {
        let ends = self.end.is_some_and(|end| !limit.is_before(end.at));
        let steady = self.anchored && self.facing == Some(self.direction) && !self.assert_every_step;
        let last = self.last_tick();
        steady
            && self.committed.is_none()
            && self.lapse.is_none()
            && !ends
            && !limit.is_before(last)
            && self.horizon == last.after(self.gap)
    }

    /// Takes steps of the run that is under way or the one behind it, as [`take_steps`](Channel::take_steps) does. Only if it
    /// [goes on](Channel::goes_on) up to `limit`, and [`went_on`](Channel::went_on) is called before anything else.
    #[inline(always)]
    pub(crate) fn go_on(
        &mut self,
        items: &mut impl Items,
        limit: Tick32,
        advance: impl FnOnce(&mut Recurrence, Ahead) -> u32,
    ) -> u32 {
        if self.left == 0 {
            self.left = items.take_run(self.epoch, self.direction, &mut self.recurrence);
        }
        // Often nothing is due before the limit, and to find that out here is quicker than to call `advance`.
        if limit.is_before(self.next_tick()) {
            return 0;
        }
        let ahead = Ahead { gap: self.gap, ticks: limit.after(1).since(self.last_tick()), most: self.left };
        let taken = advance(&mut self.recurrence, ahead).min(self.left);
        if taken > 0 {
            self.took(taken);
        }
        taken
    }

    /// Counts steps of one run that the recurrence has made.
    #[inline(always)]
    fn took(&mut self, taken: u32) {
        self.left -= taken;
        self.position = match self.direction {
            Direction::Forward => self.position.wrapping_add_unsigned(taken),
            Direction::Backward => self.position.wrapping_sub_unsigned(taken),
        };
        // The interval as it was before the last of them.
        let Recurrence { interval, add, add2, .. } = self.recurrence;
        self.last_interval = interval.wrapping_sub(add.wrapping_sub(add2));
    }

    /// Notes that [`go_on`](Channel::go_on) took steps.
    pub(crate) fn went_on(&mut self) {
        self.horizon = self.last_tick().after(self.gap);
        self.fresh = false;
    }

    /// Whether the next event is a step of the run that is under way, after `limit`, and no switch or lapse comes before.
    #[must_use]
    pub const fn waits_beyond(&self, limit: Tick32) -> bool {
        let ends = match self.end {
            Some(end) => !limit.is_before(end.at),
            None => false,
        };
        self.left > 0 && self.committed.is_none() && !ends && limit.is_before(self.next_tick())
    }

    /// Which way the run that is under way goes.
    #[must_use]
    pub const fn direction(&self) -> Direction {
        self.direction
    }

    /// Corrects the position after a [`stop`](Channel::stop): steps that were taken, but not made.
    pub const fn set_position(&mut self, position: i32) {
        self.position = position;
    }

    fn load(&mut self, item: Item, items: &mut impl Items) {
        match item {
            Item::Anchor { tick } => {
                self.recurrence.accumulator = (u64::from(tick.0) << F) | (1 << (F - 1));
                (self.anchored, self.fresh) = (true, true);
            }
            Item::Dwell { ticks } if self.anchored => {
                self.recurrence.accumulator = self.recurrence.accumulator.wrapping_add(u64::from(ticks) << F);
                self.fresh = true;
            }
            Item::Run { segment, direction } if self.anchored => {
                self.recurrence.load(&segment);
                self.left = segment.count;
                self.fresh |= direction != self.direction;
                self.direction = direction;
            }
            Item::Dwell { .. } => {}
            Item::Run { .. } => self.miss(self.horizon, items),
        }
    }

    /// A step that was due at `tick` cannot be made.
    #[inline(never)]
    fn miss(&mut self, tick: Tick32, items: &mut impl Items) {
        self.missed = self.missed.or(Some(tick));
        // The registers are left as after the run: a queue of packed items needs them to unpack the next one.
        let Recurrence { interval, add, add2, .. } = self.recurrence;
        let count = core::mem::take(&mut self.left);
        self.recurrence.load(&Segment { count, interval, add, add2 }.after(count));
        if self.is_leased() {
            self.fail(LapseCause::StepMissed, items);
        } else {
            self.rest();
        }
    }

    fn begin(&mut self, items: &mut impl Items) {
        let Some(switch) = self.switch.take() else { return };
        items.skip_to(switch.epoch);
        self.epoch = switch.epoch;
        self.left = 0;
        self.rest();
        self.missed = None;
        (self.lease, self.limit) = (switch.lease, switch.limit);
        // A channel that looks further ahead may have found a lapse that is yet to come for this one. Switches that were made since then stand.
        let known = self.lapse.filter(|lapse| self.agreed && !self.braking && switch.at.is_before(lapse.at));
        self.resume();
        (self.lapse, self.agreed) = (known, known.is_some());
        self.horizon = self.horizon.or_later(switch.at);
        self.note_end();
    }

    /// The motor is at rest: it moves again with an anchor.
    const fn rest(&mut self) {
        (self.anchored, self.fresh) = (false, true);
    }

    /// No lapse is known.
    const fn resume(&mut self) {
        (self.lapse, self.agreed, self.not_before) = (None, false, None);
        (self.braking, self.moved) = (false, false);
    }

    const fn is_leased(&self) -> bool {
        !matches!(self.lease, Lease::Off) || self.lapse.is_some()
    }

    /// Notes what ends the plan: after each change of what that hangs on.
    fn note_end(&mut self) {
        let lease = match (self.lapse, self.lease) {
            _ if self.braking => None,
            (Some(lapse), _) => Some(lapse.at),
            (None, Lease::Until(at)) => Some(at),
            (None, Lease::Off | Lease::Last) => None,
        };
        self.end = match (self.switch, lease) {
            (Some(Switch { cancelled: true, .. }) | None, at) => at.map(|at| End { at, is_switch: false }),
            (Some(switch), Some(at)) if at.is_before(switch.at) => Some(End { at, is_switch: false }),
            (Some(switch), _) => Some(End { at: switch.at, is_switch: true }),
        };
    }

    /// Whether something waits that is to be done.
    fn takes(&self, items: &impl Items) -> bool {
        !self.braking && items.has(self.epoch)
    }

    /// With nothing planned: whether the next step, after the same interval as the last one, would come by `limit` and before `end`.
    const fn runs_dry(&self, limit: Tick32, end: Tick32) -> bool {
        if self.braking || self.fresh || !(self.lapse.is_some() || matches!(self.lease, Lease::Until(_))) {
            return false;
        }
        let next = Tick32::of(self.recurrence.accumulator.wrapping_add_signed(self.last_interval) >> F);
        !limit.is_before(next) && next.is_before(end)
    }

    /// The plan cannot be followed: the motor brakes at once, and all other channels are to know.
    #[inline(never)]
    fn fail(&mut self, cause: LapseCause, items: &mut impl Items) {
        if let Some(switch) = &mut self.switch {
            switch.cancelled = true;
        }
        let at = self.lapse.map_or(self.horizon, |lapse| lapse.at);
        self.brake(Lapse { at, cause }, items);
        self.agreed = false;
    }

    /// The lease is over: what waits of its epoch is dropped, and the motor brakes from the step that comes next.
    #[inline(never)]
    fn brake(&mut self, lapse: Lapse, items: &mut impl Items) {
        if self.lapse.is_none() {
            // This channel found it.
            if let Some(switch) = &mut self.switch {
                switch.cancelled |= !switch.at.is_before(lapse.at);
            }
        }
        (self.lapse, self.braking) = (Some(lapse), true);
        let here = self.place();
        items.drop_epoch(self.epoch, &here);
        if let Some(switch) = self.switch.filter(|switch| switch.cancelled) {
            items.drop_epoch(switch.epoch, &here);
        }
        self.drop_cancelled();
        self.note_end();
        let interval = if self.left > 0 { self.recurrence.interval } else { self.last_interval };
        self.left = 0;
        if self.fresh || !self.anchored {
            self.rest();
        } else {
            self.moved = true;
            self.recurrence.interval = interval;
            if self.next_tick().is_before(self.horizon) {
                let open = u64::from(self.horizon.0) << F;
                self.recurrence.accumulator = open.wrapping_sub(interval.cast_unsigned());
            }
            self.slow_down();
        }
    }

    /// Forgets the switch that is not made: its epoch is over.
    fn drop_cancelled(&mut self) {
        if let Some(switch) = self.switch.take_if(|switch| switch.cancelled) {
            self.epoch = switch.epoch;
        }
    }

    /// Loads the next part of the stop.
    #[inline(never)]
    const fn slow_down(&mut self) {
        let interval = self.recurrence.interval;
        match self.limit.next(interval, &const { RegisterLimits::with_fraction_bits(F) }).segment(interval) {
            Some(part) => {
                self.recurrence.load(&part);
                self.left = part.count;
            }
            None => self.rest(),
        }
    }

    /// A step was made.
    fn stepped(&mut self) {
        self.fresh = false;
        if self.braking && self.left == 0 {
            // A part of the stop, or its last step: that has no add.
            if self.recurrence.add == 0 { self.rest() } else { self.slow_down() }
        }
    }

    /// When the next step can be made that is due at `tick`, or was.
    const fn possible(&self, tick: Tick32) -> Tick32 {
        let tick = tick.or_later(self.horizon);
        match self.not_before {
            Some(open) => tick.or_later(open),
            None => tick,
        }
    }

    /// The scheduled tick of the last step, or the end of the wait after it.
    const fn last_tick(&self) -> Tick32 {
        Tick32::of(self.recurrence.accumulator >> F)
    }

    /// The scheduled tick of the next step.
    const fn next_tick(&self) -> Tick32 {
        Tick32::of(self.recurrence.accumulator.wrapping_add_signed(self.recurrence.interval) >> F)
    }
}
