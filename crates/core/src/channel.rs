//! The channel: queue items → events, each a tick and what happens then.
//!
//! Each step comes at a later tick than the one before. A step that cannot be made (its interval is too short, its item
//! came too late, no [`Item::Anchor`] says where it counts from) is left out. Under a lease the motor then brakes. Without one
//! the channel drops everything up to the next anchor. [`Channel::missed`] has the tick. So every step that is counted can be a
//! pulse, whatever the queue holds.
//!
//! A switch at tick `at` ends the old epoch: its steps before `at` are made, its later ones are not. The new epoch makes no
//! step before `at`.
//!
//! The end of a lease ends a plan in the same way, but then the motor brakes: see [`lease`](crate::lease).

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
    /// The DIR line takes this level, for the step at this event's tick.
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
    /// Another switch waits, for an earlier tick.
    Full,
}

#[derive(Clone, Copy, Debug)]
struct Switch {
    epoch: Epoch,
    at: Tick32,
    /// The lease of the new plan, and how hard the motor may brake in it.
    lease: Lease,
    brake_limit: Limit,
    /// The switch is not made, because the lease lapsed before it.
    cancelled: bool,
}

/// Where the current plan ends, as far as is known now.
#[derive(Clone, Copy, Debug)]
struct PlanEnd {
    at: Tick32,
    /// A switch ends it; otherwise the end of the lease does.
    is_switch: bool,
}

/// How many steps of a run may be taken at once: for the `advance` of [`Channel::take_steps`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepBudget {
    /// The shortest interval between two steps, ticks.
    pub gap: u32,
    /// All of them come less than this after the last step, ticks.
    pub ticks: u32,
    /// The most steps that may be taken. It is 0 only if the run has no step left.
    pub max_steps: u32,
}

/// Expands the items of one motor; `F` is the number of fraction bits, 1..=32.
///
/// The fields that every event reads come first: a Cortex-M0+ reaches only the first 124 bytes of a structure with one load.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Channel<const F: u32> {
    recurrence: Recurrence,
    /// The interval before the last step, ticks · 2^F.
    last_interval: i64,
    /// Steps of the current segment that are not made yet.
    steps_left: u32,
    horizon: Tick32,
    /// The shortest interval between two steps, ticks.
    gap: u32,
    position: i32,
    /// The tick of the next step, if DIR has been set for it: that step will be made in any case.
    committed: Option<Tick32>,
    /// Worked out from `switch`, `lease` and `lapse` when they change, because every event reads it.
    plan_end: Option<PlanEnd>,
    lapse: Option<Lapse>,
    /// The next step is not made before this tick, because another motor needs the DIR line.
    not_before: Option<Tick32>,
    /// The direction of the current segment's steps.
    direction: Direction,
    /// The direction that the DIR line was last set to.
    dir_line: Option<Direction>,
    /// An anchor has set the accumulator, so that its tick counts.
    anchored: bool,
    /// The motor may rest at once: no step has been made since the last anchor, wait or reversal.
    can_rest: bool,
    assert_every_step: bool,
    /// The lease is over for this channel. All that it makes now is its braking ramp.
    braking: bool,
    /// All channels of the machine know of the lapse, and from which tick on they brake.
    lapse_is_agreed: bool,
    /// The motor was in motion when the lease was over.
    moved_at_lapse: bool,
    epoch: Epoch,
    missed: Option<Tick32>,
    lease: Lease,
    /// How hard the motor may brake.
    brake_limit: Limit,
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
            steps_left: 0,
            direction: Direction::Forward,
            dir_line: None,
            committed: None,
            anchored: false,
            can_rest: true,
            last_interval: 0,
            assert_every_step,
            gap: if gap == 0 { 1 } else { gap },
            position: 0,
            horizon: Tick32(0),
            epoch: Epoch(0),
            switch: None,
            plan_end: None,
            missed: None,
            lease: Lease::Off,
            brake_limit: Limit::WITHIN_A_STEP,
            lapse: None,
            lapse_is_agreed: false,
            braking: false,
            moved_at_lapse: false,
            not_before: None,
        }
    }

    /// The next event at tick `until` or before. It remains the next one until [`take`](Channel::take) commits it.
    ///
    /// `until` never goes back from call to call. It is less than 2^30 ticks after the last [`pass`](Channel::pass).
    pub fn peek(&mut self, items: &mut impl Items, until: Tick32) -> Option<StepEvent> {
        loop {
            if let Some(tick) = self.committed {
                return Some(StepEvent { tick, kind: EventKind::Step });
            }
            let tick = if self.steps_left > 0 { self.next_tick() } else { self.last_tick() };
            // This comes first: a tick beyond `until` may be more than 2^31 from others, and then it cannot be compared with them.
            let beyond = self.anchored && until.is_before(tick);
            if let Some(end) = self.plan_end {
                let at_end = self.steps_left == 0 && !self.has_items(items);
                if beyond || at_end || (self.anchored && !tick.is_before(end.at)) {
                    if at_end && self.underruns(until, end.at) {
                        self.lapse_by_fault(LapseCause::Underrun, items);
                        continue;
                    }
                    if until.is_before(end.at) {
                        return None;
                    }
                    if end.is_switch {
                        self.make_switch(items);
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
            if self.steps_left > 0 {
                let mut tick = tick;
                // After a lapse, a shared DIR line may have delayed the step before this one, too.
                if self.lapse.is_some() && (self.braking || self.assert_every_step && !self.can_rest) {
                    tick = self.earliest_tick(tick);
                    if until.is_before(tick) {
                        return None;
                    }
                }
                if tick.is_before(self.horizon) {
                    self.miss_step(tick, items);
                    continue;
                }
                let turned = self.dir_line != Some(self.direction);
                let kind = if turned || self.assert_every_step {
                    EventKind::Direction(self.direction)
                } else {
                    EventKind::Step
                };
                return Some(StepEvent { tick, kind });
            }
            if !self.has_items(items) {
                return None;
            }
            if self.anchored
                && let Some(direction) = items.run_direction()
                && let count @ 1.. = items.take_run(self.epoch, direction, &mut self.recurrence)
            {
                self.steps_left = count;
                self.can_rest |= direction != self.direction;
                self.direction = direction;
                continue;
            }
            let failed_before = items.has_failed();
            items.end_runs(&self.recurrence);
            match items.take(&self.place()) {
                Some(item) => self.load(item, items),
                None if items.has_failed() && !failed_before && self.is_leased() => {
                    self.lapse_by_fault(LapseCause::BadItem, items)
                }
                None => {}
            }
        }
    }

    /// Commits the event that [`peek`](Channel::peek) returned. A step is counted here.
    pub fn take(&mut self, event: StepEvent) {
        match event.kind {
            EventKind::Direction(direction) => {
                self.dir_line = Some(direction);
                self.committed = Some(event.tick);
                self.horizon = event.tick.after(1);
            }
            EventKind::Step => {
                self.last_interval = self.recurrence.interval;
                self.recurrence.advance();
                self.steps_left -= 1;
                self.committed = None;
                self.not_before = None;
                self.position = self.position.wrapping_add(self.direction.sign());
                self.horizon = event.tick.after(self.gap);
                self.after_step();
            }
        }
    }

    /// Sets the time at which a new channel starts. Its tick 0 may be more than 2^31 ticks ago, and then it cannot be compared with `now`.
    pub const fn start_at(&mut self, now: Tick32) {
        self.horizon = now;
    }

    /// Notes that time is past `now`. Call it at least once in 2^30 ticks, after all events up to `now` have been taken: older
    /// ticks could be mistaken for later ones.
    pub fn pass(&mut self, now: Tick32) {
        self.horizon = self.horizon.or_later(now.after(1));
        // If the accumulator stayed this far behind, its tick would soon look like one in the future.
        if self.steps_left == 0 && matches!(now.since(self.last_tick()), 0x4000_0000..0x8000_0000) {
            self.anchored = false;
            self.can_rest = true;
        }
    }

    /// Begins `epoch` at tick `at`, which is less than 2^31 ticks ahead. The rest of the old epoch is dropped then. The new plan is valid as
    /// long as `lease` says. `limit` says how hard the motor may brake; with `None` it keeps its limit. If the old lease had lapsed, the motor
    /// moves again from here.
    ///
    /// One switch may wait. A second one replaces it, if its tick is the same or earlier.
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
        let brake_limit = limit.unwrap_or(self.brake_limit);
        self.switch = Some(Switch { epoch, at, lease, brake_limit, cancelled: false });
        self.update_plan_end();
        Ok(())
    }

    /// Whether [`extend`](Channel::extend) may be called with `lease` now.
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

    /// Moves the end of the lease, later or earlier; also that of a lease that a waiting switch will begin. Call
    /// [`check_extend`](Channel::check_extend) first.
    pub fn extend(&mut self, lease: Lease, limit: Option<Limit>) {
        self.brake_limit = limit.unwrap_or(self.brake_limit);
        if self.lapse.is_none() && self.lease != Lease::Off {
            self.lease = lease;
        }
        if let Some(switch) = self.switch.as_mut().filter(|switch| switch.lease != Lease::Off) {
            switch.lease = lease;
            switch.brake_limit = limit.unwrap_or(switch.brake_limit);
        }
        self.update_plan_end();
    }

    /// Ends the lease at `lapse.at`, if it has not ended earlier. The owner calls this for all channels of a machine: when
    /// [one of them has lapsed](crate::channels::agreed_lapse), or at the horizon when the host orders all motors to brake.
    pub fn lapse_at(&mut self, lapse: Lapse) {
        if let Some(switch) = &mut self.switch {
            if !switch.at.is_before(lapse.at) {
                switch.cancelled = true;
            } else if switch.lease != Lease::Off {
                switch.lease = Lease::Until(lapse.at);
            }
        }
        match &mut self.lapse {
            // This channel's own fault: it braked at once, and now it learns from which tick on the others brake.
            Some(own) if !self.lapse_is_agreed && own.cause.is_fault() => *own = lapse,
            Some(own) if !self.braking && lapse.at.is_before(own.at) => *own = lapse,
            Some(own) if lapse.cause.is_fault() => own.cause = lapse.cause,
            Some(_) => {}
            None => self.lapse = Some(lapse),
        }
        self.lapse_is_agreed = true;
        if self.braking {
            self.drop_cancelled();
        }
        self.update_plan_end();
    }

    /// Call this when the DIR edge of `event` would come too late for its step. Under a lease that has not lapsed the step is dropped and the
    /// motor brakes. Otherwise nothing changes and the result is `false`: make the step with a set-up that is cut short.
    pub fn drop_step_if_leased(&mut self, event: StepEvent, items: &mut impl Items) -> bool {
        let gives_up = self.is_leased() && self.lapse.is_none();
        if gives_up {
            self.miss_step(event.tick, items);
        }
        gives_up
    }

    /// When the lease was over, and why.
    #[must_use]
    pub const fn lapse(&self) -> Option<Lapse> {
        self.lapse
    }

    /// Whether its lease is over, and the other channels have not [been told](Channel::lapse_at) yet.
    #[must_use]
    pub const fn has_unreported_lapse(&self) -> bool {
        self.lapse.is_some() && !self.lapse_is_agreed
    }

    /// How long its plan is valid.
    #[must_use]
    pub const fn lease(&self) -> Lease {
        self.lease
    }

    /// Whether it makes the steps of its braking ramp.
    #[must_use]
    pub const fn is_braking(&self) -> bool {
        self.braking && self.steps_left > 0
    }

    /// Whether the motor was in motion when the lease was over.
    #[must_use]
    pub const fn was_moving(&self) -> bool {
        self.moved_at_lapse
    }

    /// Whether items of `epoch` may be queued. After a lapse, those of the epoch that was run are refused: they would never be made.
    #[must_use]
    pub fn accepts(&self, epoch: Epoch) -> bool {
        self.lapse.is_none() || epoch != self.epoch
    }

    /// The tick of the next step, if it is known, and whether the step is committed. Motors that share a DIR line ask for it.
    #[must_use]
    pub fn scheduled(&self) -> Option<(Tick32, bool)> {
        (self.steps_left > 0).then(|| (self.next_tick(), self.committed.is_some()))
    }

    /// Delays the next step, which is not committed yet, to `tick` or later: another motor needs the DIR line until then. The accumulator
    /// does not change, so the steps after it are not delayed. This has an effect only after a lapse.
    pub const fn put_off(&mut self, tick: Option<Tick32>) {
        self.not_before = tick;
    }

    /// Whether [`schedule_switch`](Channel::schedule_switch) would accept `at`.
    ///
    /// # Errors
    /// Those of `schedule_switch`.
    pub fn check_switch(&self, at: Tick32) -> Result<(), SwitchRefused> {
        if at.is_before(self.horizon) {
            return Err(SwitchRefused::Late { horizon: self.horizon });
        }
        let waits = self.switch.filter(|switch| !switch.cancelled);
        if waits.is_some_and(|switch| switch.at.is_before(at)) { Err(SwitchRefused::Full) } else { Ok(()) }
    }

    /// Stops at once: forgets every step whose pulse has not begun. The motor stands where it is, and the count is right.
    pub fn stop(&mut self, items: &mut impl Items) {
        items.clear();
        self.steps_left = 0;
        self.committed = None;
        self.set_at_rest();
        self.switch = None;
        self.lease = Lease::Off;
        self.forget_lapse();
        self.update_plan_end();
    }

    /// Steps forward minus steps backward that were taken, wrapping.
    #[must_use]
    pub const fn position(&self) -> i32 {
        self.position
    }

    /// The first tick that is not committed. A switch is accepted at this tick or later.
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
        self.is_done() && !self.has_items(items)
    }

    /// Whether all items that were taken are done, no switch waits, and the motor is not about to brake.
    #[must_use]
    pub const fn is_done(&self) -> bool {
        let brakes = !self.braking && !self.can_rest && (self.lapse.is_some() || matches!(self.lease, Lease::Until(_)));
        self.steps_left == 0 && self.switch.is_none() && !brakes
    }

    /// The position, and the tick of the last step or of the end of the wait after it.
    #[must_use]
    pub const fn place(&self) -> Place {
        let sixteenth = (self.recurrence.accumulator << (32 - F) >> 16).to_le_bytes();
        Place {
            position: self.position,
            tick: self.last_tick(),
            fraction: u16::from_le_bytes([sixteenth[0], sixteenth[1]]),
        }
    }

    /// Takes steps of the current run, none after `limit`, without an event for each. `advance` moves the recurrence on by as many steps
    /// as it likes within its [`StepBudget`], and returns how many.
    ///
    /// Returns how many steps were taken. It is 0 if the next step needs an event of its own, such as a change of DIR. The last thing that
    /// the caller made must be the step before.
    pub fn take_steps(&mut self, limit: Tick32, advance: impl FnOnce(&mut Recurrence, StepBudget) -> u32) -> u32 {
        if self.committed.is_some()
            || self.steps_left == 0
            || self.dir_line != Some(self.direction)
            || self.assert_every_step
        {
            return 0;
        }
        if self.next_tick().is_before(self.horizon) {
            return 0;
        }
        let end = match self.plan_end {
            Some(end) if !limit.is_before(end.at) => end.at,
            _ => limit.after(1),
        };
        let last = self.last_tick();
        if end.is_before(last) {
            return 0;
        }
        let ahead = StepBudget { gap: self.gap, ticks: end.since(last), max_steps: self.steps_left };
        let taken = advance(&mut self.recurrence, ahead).min(self.steps_left);
        if taken > 0 {
            self.count_steps(taken);
            self.horizon = self.last_tick().after(self.gap);
            self.after_step();
        }
        taken
    }

    /// Whether nothing but steps of runs can come up to `limit`: no switch, no end of a lease, no change of DIR. The last event was a step.
    pub(crate) fn is_run_until(&self, limit: Tick32) -> bool {
        let ends = self.plan_end.is_some_and(|end| !limit.is_before(end.at));
        let steady = self.anchored && self.dir_line == Some(self.direction) && !self.assert_every_step;
        let last = self.last_tick();
        steady
            && self.committed.is_none()
            && self.lapse.is_none()
            && !ends
            && !limit.is_before(last)
            && self.horizon == last.after(self.gap)
    }

    /// Takes steps of the current run, or of the run that continues it, as [`take_steps`](Channel::take_steps) does, but with fewer checks.
    /// [`is_run_until`](Channel::is_run_until) must hold for `limit`, and the next call of another method must be
    /// [`end_run_steps`](Channel::end_run_steps).
    #[inline(always)]
    pub(crate) fn take_run_steps(
        &mut self,
        items: &mut impl Items,
        limit: Tick32,
        advance: impl FnOnce(&mut Recurrence, StepBudget) -> u32,
    ) -> u32 {
        if self.steps_left == 0 {
            self.steps_left = items.take_run(self.epoch, self.direction, &mut self.recurrence);
        }
        // Often nothing is due before the limit. To find that out here takes less time than to call `advance`.
        if limit.is_before(self.next_tick()) {
            return 0;
        }
        let ahead =
            StepBudget { gap: self.gap, ticks: limit.after(1).since(self.last_tick()), max_steps: self.steps_left };
        let taken = advance(&mut self.recurrence, ahead).min(self.steps_left);
        if taken > 0 {
            self.count_steps(taken);
        }
        taken
    }

    /// Counts steps of one run that the recurrence has made.
    #[inline(always)]
    fn count_steps(&mut self, taken: u32) {
        self.steps_left -= taken;
        self.position = match self.direction {
            Direction::Forward => self.position.wrapping_add_unsigned(taken),
            Direction::Backward => self.position.wrapping_sub_unsigned(taken),
        };
        // The interval before the last of these steps: one application of the recurrence back.
        let Recurrence { interval, add, add2, .. } = self.recurrence;
        self.last_interval = interval.wrapping_sub(add.wrapping_sub(add2));
    }

    /// Notes that [`take_run_steps`](Channel::take_run_steps) took steps.
    pub(crate) fn end_run_steps(&mut self) {
        self.horizon = self.last_tick().after(self.gap);
        self.can_rest = false;
    }

    /// Whether the next event is a step of the current run, later than `limit`, with no switch or lapse before it.
    #[must_use]
    pub const fn waits_beyond(&self, limit: Tick32) -> bool {
        let ends = match self.plan_end {
            Some(end) => !limit.is_before(end.at),
            None => false,
        };
        self.steps_left > 0 && self.committed.is_none() && !ends && limit.is_before(self.next_tick())
    }

    /// The direction of the current run.
    #[must_use]
    pub const fn direction(&self) -> Direction {
        self.direction
    }

    /// Corrects the position after a [`stop`](Channel::stop), by the steps that were taken but not made.
    pub const fn set_position(&mut self, position: i32) {
        self.position = position;
    }

    fn load(&mut self, item: Item, items: &mut impl Items) {
        match item {
            Item::Anchor { tick } => {
                self.recurrence.accumulator = (u64::from(tick.0) << F) | (1 << (F - 1));
                (self.anchored, self.can_rest) = (true, true);
            }
            Item::Dwell { ticks } if self.anchored => {
                self.recurrence.accumulator = self.recurrence.accumulator.wrapping_add(u64::from(ticks) << F);
                self.can_rest = true;
            }
            Item::Run { segment, direction } if self.anchored => {
                self.recurrence.load(&segment);
                self.steps_left = segment.count;
                self.can_rest |= direction != self.direction;
                self.direction = direction;
            }
            Item::Dwell { .. } => {}
            Item::Run { .. } => self.miss_step(self.horizon, items),
        }
    }

    /// The step that was due at `tick` cannot be made: drops it and the rest of its run.
    #[inline(never)]
    fn miss_step(&mut self, tick: Tick32, items: &mut impl Items) {
        self.missed = self.missed.or(Some(tick));
        // The registers are set as if the run had been made, because packed items are unpacked relative to them.
        let Recurrence { interval, add, add2, .. } = self.recurrence;
        let count = core::mem::take(&mut self.steps_left);
        self.recurrence.load(&Segment { count, interval, add, add2 }.after(count));
        if self.is_leased() {
            self.lapse_by_fault(LapseCause::StepMissed, items);
        } else {
            self.set_at_rest();
        }
    }

    fn make_switch(&mut self, items: &mut impl Items) {
        let Some(switch) = self.switch.take() else { return };
        items.skip_to(switch.epoch);
        self.epoch = switch.epoch;
        self.steps_left = 0;
        self.set_at_rest();
        self.missed = None;
        (self.lease, self.brake_limit) = (switch.lease, switch.brake_limit);
        // Another channel, which looks further ahead, may have reported a lapse later than this switch. That lapse is still to come.
        let known = self.lapse.filter(|lapse| self.lapse_is_agreed && !self.braking && switch.at.is_before(lapse.at));
        self.forget_lapse();
        (self.lapse, self.lapse_is_agreed) = (known, known.is_some());
        self.horizon = self.horizon.or_later(switch.at);
        self.update_plan_end();
    }

    /// The motor is at rest. Only an anchor starts it again.
    const fn set_at_rest(&mut self) {
        (self.anchored, self.can_rest) = (false, true);
    }

    /// Forgets the lapse and all that came of it.
    const fn forget_lapse(&mut self) {
        (self.lapse, self.lapse_is_agreed, self.not_before) = (None, false, None);
        (self.braking, self.moved_at_lapse) = (false, false);
    }

    const fn is_leased(&self) -> bool {
        !matches!(self.lease, Lease::Off) || self.lapse.is_some()
    }

    /// Works out `plan_end`. Call it after each change of `switch`, `lease`, `lapse` or `braking`.
    fn update_plan_end(&mut self) {
        let lease = match (self.lapse, self.lease) {
            _ if self.braking => None,
            (Some(lapse), _) => Some(lapse.at),
            (None, Lease::Until(at)) => Some(at),
            (None, Lease::Off | Lease::Last) => None,
        };
        self.plan_end = match (self.switch, lease) {
            (Some(Switch { cancelled: true, .. }) | None, at) => at.map(|at| PlanEnd { at, is_switch: false }),
            (Some(switch), Some(at)) if at.is_before(switch.at) => Some(PlanEnd { at, is_switch: false }),
            (Some(switch), _) => Some(PlanEnd { at: switch.at, is_switch: true }),
        };
    }

    /// Whether an item waits that the channel will take.
    fn has_items(&self, items: &impl Items) -> bool {
        !self.braking && items.has(self.epoch)
    }

    /// For a channel with nothing planned: whether the motor would have stepped again by `limit` and before `end` if it kept its speed. Then
    /// its plan came too late. It must brake before that step is due.
    const fn underruns(&self, limit: Tick32, end: Tick32) -> bool {
        if self.braking || self.can_rest || !(self.lapse.is_some() || matches!(self.lease, Lease::Until(_))) {
            return false;
        }
        let next = Tick32::of(self.recurrence.accumulator.wrapping_add_signed(self.last_interval) >> F);
        !limit.is_before(next) && next.is_before(end)
    }

    /// The plan cannot be followed. This motor brakes at once; the owner tells the other channels.
    #[inline(never)]
    fn lapse_by_fault(&mut self, cause: LapseCause, items: &mut impl Items) {
        if let Some(switch) = &mut self.switch {
            switch.cancelled = true;
        }
        let at = self.lapse.map_or(self.horizon, |lapse| lapse.at);
        self.brake(Lapse { at, cause }, items);
        self.lapse_is_agreed = false;
    }

    /// The lease is over: drops the waiting items of its epoch. The motor brakes, beginning with the next step.
    #[inline(never)]
    fn brake(&mut self, lapse: Lapse, items: &mut impl Items) {
        if self.lapse.is_none() {
            // This channel is the first to find the lapse.
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
        self.update_plan_end();
        let interval = if self.steps_left > 0 { self.recurrence.interval } else { self.last_interval };
        self.steps_left = 0;
        if self.can_rest || !self.anchored {
            self.set_at_rest();
        } else {
            self.moved_at_lapse = true;
            self.recurrence.interval = interval;
            if self.next_tick().is_before(self.horizon) {
                let open = u64::from(self.horizon.0) << F;
                self.recurrence.accumulator = open.wrapping_sub(interval.cast_unsigned());
            }
            self.load_braking_part();
        }
    }

    /// Forgets a cancelled switch. Its epoch counts as the one that was run, so that its late items are refused, too.
    fn drop_cancelled(&mut self) {
        if let Some(switch) = self.switch.take_if(|switch| switch.cancelled) {
            self.epoch = switch.epoch;
        }
    }

    /// Loads the next segment of the braking ramp.
    #[inline(never)]
    const fn load_braking_part(&mut self) {
        let interval = self.recurrence.interval;
        match self.brake_limit.next(interval, &const { RegisterLimits::with_fraction_bits(F) }).segment(interval) {
            Some(part) => {
                self.recurrence.load(&part);
                self.steps_left = part.count;
            }
            None => self.set_at_rest(),
        }
    }

    /// Call it after each step.
    fn after_step(&mut self) {
        self.can_rest = false;
        if self.braking && self.steps_left == 0 {
            // A segment of the braking ramp ended. The last one has no add.
            if self.recurrence.add == 0 { self.set_at_rest() } else { self.load_braking_part() }
        }
    }

    /// The earliest tick for a step that is due at `tick`, if it may come late.
    const fn earliest_tick(&self, tick: Tick32) -> Tick32 {
        let tick = tick.or_later(self.horizon);
        match self.not_before {
            Some(open) => tick.or_later(open),
            None => tick,
        }
    }

    /// The scheduled tick of the last step, or of the end of the wait after it.
    const fn last_tick(&self) -> Tick32 {
        Tick32::of(self.recurrence.accumulator >> F)
    }

    /// The scheduled tick of the next step.
    const fn next_tick(&self) -> Tick32 {
        Tick32::of(self.recurrence.accumulator.wrapping_add_signed(self.recurrence.interval) >> F)
    }
}
