//! The channel: queue items → events, each a tick and what happens then.
//!
//! Ticks go up strictly from step to step. A step that would break that rule (an interval that is too short, an item
//! that came too late, a motion without an [`Item::Anchor`]) is not made: the channel drops what follows up to the next
//! anchor and says so in [`Channel::missed`]. So whatever a queue holds, every step counted can be a pulse.
//!
//! Switches: a step of the old epoch at a tick ≥ `at` is not made, one before is. The new epoch makes no step
//! before `at`.

use crate::queue::{Epoch, Item, Items, Place};
use crate::words::{Expand, LONGEST_WAIT, Stretch};
use crate::{Direction, Moment, Recurrence};

/// What happens at a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event {
    /// The scheduled tick: of the step itself, or of the step that a change of direction is for.
    pub tick: Moment,
    /// What happens.
    pub kind: Kind,
}

/// What an event is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
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
        horizon: Moment,
    },
    /// [`SWITCHES`] earlier ones are still waiting.
    Full,
}

/// How many switches may wait, one after the other.
pub const SWITCHES: usize = 4;

#[derive(Clone, Copy, Debug)]
struct Switch {
    epoch: Epoch,
    at: Moment,
}

/// Expands the items of one motor; `F` is the number of fraction bits, 1..=32.
#[derive(Clone, Debug)]
pub struct Channel<const F: u32> {
    recurrence: Recurrence,
    /// Steps of the segment still to be made.
    left: u32,
    /// Which way they go.
    direction: Direction,
    /// What the DIR line was last asked to say.
    facing: Option<Direction>,
    /// Whether the next step's direction has been asserted: the step is then committed.
    committed: bool,
    /// Whether the accumulator means anything.
    anchored: bool,
    assert_every_step: bool,
    gap: u32,
    position: i32,
    horizon: Moment,
    epoch: Epoch,
    switches: [Option<Switch>; SWITCHES],
    missed: Option<Moment>,
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
            committed: false,
            anchored: false,
            assert_every_step,
            gap: if gap == 0 { 1 } else { gap },
            position: 0,
            horizon: Moment(0),
            epoch: Epoch(0),
            switches: [None; SWITCHES],
            missed: None,
        }
    }

    /// The next event that is not after `limit`; it stays next until [`take`](Channel::take).
    ///
    /// `limit` goes up from call to call, by less than 2^30 ticks beyond the last [`pass`](Channel::pass).
    pub fn peek(&mut self, items: &mut impl Items, limit: Moment) -> Option<Event> {
        loop {
            let tick = if self.left > 0 { self.next_tick() } else { self.last_tick() };
            if self.committed {
                return Some(Event { tick, kind: Kind::Step });
            }
            // Before anything else: beyond the limit, ticks may be too far from others to be compared with them.
            let beyond = self.anchored && limit.is_before(tick);
            if let Some(switch) = self.switches[0] {
                let at_end = self.left == 0 && !items.wait(self.epoch);
                if beyond || at_end || (self.anchored && !tick.is_before(switch.at)) {
                    if limit.is_before(switch.at) {
                        return None;
                    }
                    self.begin(switch, items);
                    continue;
                }
            }
            if beyond {
                return None;
            }
            if self.left > 0 {
                if tick.is_before(self.horizon) {
                    self.miss(tick);
                    continue;
                }
                let turned = self.facing != Some(self.direction);
                let kind = if turned || self.assert_every_step { Kind::Direction(self.direction) } else { Kind::Step };
                return Some(Event { tick, kind });
            }
            if !items.wait(self.epoch) {
                return None;
            }
            if let Some(item) = items.take(&self.place()) {
                self.load(item);
            }
        }
    }

    /// Commits the event that [`peek`](Channel::peek) gave: a step is counted here.
    pub fn take(&mut self, event: Event) {
        match event.kind {
            Kind::Direction(direction) => {
                self.facing = Some(direction);
                self.committed = true;
                self.horizon = event.tick.after(1);
            }
            Kind::Step => {
                self.recurrence.advance();
                self.left -= 1;
                self.committed = false;
                self.position = self.position.wrapping_add(self.direction.sign());
                self.horizon = event.tick.after(self.gap);
            }
        }
    }

    /// A new channel begins to exist at tick `now`: ticks are told apart within 2^31, and its own beginning may be longer ago.
    pub const fn open_from(&mut self, now: Moment) {
        self.horizon = now;
    }

    /// Notes that time is past `now`. To be called at least once in 2^30 ticks, after all events up to `now` have
    /// been taken.
    pub fn pass(&mut self, now: Moment) {
        let open = now.after(1);
        if self.horizon.is_before(open) {
            self.horizon = open;
        }
        // An accumulator that is left behind would come back as the future.
        if self.left == 0 && matches!(now.since(self.last_tick()), 0x4000_0000..0x8000_0000) {
            self.anchored = false;
        }
    }

    /// At tick `at` (less than 2^31 ahead), what is left of the old epoch is to be dropped and `epoch` begun.
    ///
    /// Switches still waiting at `at` or later are replaced, earlier ones stay.
    ///
    /// # Errors
    /// When `at` lies before the horizon or too many wait; nothing changes then.
    pub fn schedule_switch(&mut self, epoch: Epoch, at: Moment) -> Result<(), SwitchRefused> {
        let place = self.place_of_switch(at)?;
        for later in self.switches.iter_mut().skip(place) {
            *later = None;
        }
        self.switches[place] = Some(Switch { epoch, at });
        Ok(())
    }

    /// Whether [`schedule_switch`](Channel::schedule_switch) would accept `at`.
    ///
    /// # Errors
    /// As there.
    pub fn check_switch(&self, at: Moment) -> Result<(), SwitchRefused> {
        self.place_of_switch(at).map(|_| ())
    }

    /// Forgets everything that is not yet committed by a pulse: the motor stands where it is, and the count is right.
    pub fn stop(&mut self, items: &mut impl Items) {
        items.clear();
        self.left = 0;
        self.committed = false;
        self.anchored = false;
        self.switches = [None; SWITCHES];
    }

    /// Steps forward minus steps backward that were taken, wrapping.
    #[must_use]
    pub const fn position(&self) -> i32 {
        self.position
    }

    /// The first tick that is not committed: a switch is accepted from there on.
    #[must_use]
    pub const fn horizon(&self) -> Moment {
        self.horizon
    }

    /// The epoch being run.
    #[must_use]
    pub const fn epoch(&self) -> Epoch {
        self.epoch
    }

    /// The tick of the first step that this epoch asked for and that could not be made.
    #[must_use]
    pub const fn missed(&self) -> Option<Moment> {
        self.missed
    }

    /// Whether there is nothing to do, now or later, unless more is pushed.
    #[must_use]
    pub fn is_idle(&self, items: &impl Items) -> bool {
        self.is_done() && !items.wait(self.epoch)
    }

    /// Whether all items that were taken are done, and no switch waits.
    #[must_use]
    pub const fn is_done(&self) -> bool {
        self.left == 0 && self.switches[0].is_none()
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

    /// Takes steps of the run that is under way without an event for each: as many as `words` has room for, but none after
    /// `limit`. Who works them out is `expand`: [`words::expand`](crate::words::expand()), or what a board has that does the
    /// same.
    ///
    /// A step that comes d ticks after the one before is written as d − the channel's gap + `bits`. Gives how many were
    /// taken: 0 if the next one goes another way. For who has made nothing since the step before.
    pub fn take_steps(&mut self, limit: Moment, bits: u32, words: &mut [u32], expand: Expand) -> u32 {
        if self.committed || self.left == 0 || self.facing != Some(self.direction) || self.assert_every_step {
            return 0;
        }
        if self.next_tick().is_before(self.horizon) {
            return 0;
        }
        let end = match self.switches[0] {
            Some(switch) if !limit.is_before(switch.at) => switch.at,
            _ => limit.after(1),
        };
        let last = self.last_tick();
        let left = usize::try_from(self.left).unwrap_or(usize::MAX);
        let room = words.len().min(left);
        let Some(words) = words.get_mut(..room) else { return 0 };
        if room == 0 || end.is_before(last) {
            return 0;
        }
        let stretch = Stretch { gap: self.gap, ticks: end.since(last).min(LONGEST_WAIT), bits };
        let taken = expand(&mut self.recurrence, words, &stretch).min(self.left);
        if taken > 0 {
            self.left -= taken;
            let moved = taken.cast_signed();
            self.position = match self.direction {
                Direction::Forward => self.position.wrapping_add(moved),
                Direction::Backward => self.position.wrapping_sub(moved),
            };
            self.horizon = self.last_tick().after(self.gap);
        }
        taken
    }

    /// Whether the next event is a step of the run that is under way, after `limit`, and no switch comes before.
    #[must_use]
    pub const fn waits_beyond(&self, limit: Moment) -> bool {
        let switches = match self.switches[0] {
            Some(switch) => !limit.is_before(switch.at),
            None => false,
        };
        self.left > 0 && !self.committed && !switches && limit.is_before(self.next_tick())
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

    fn load(&mut self, item: Item) {
        match item {
            Item::Anchor { tick } => {
                self.recurrence.accumulator = (u64::from(tick.0) << F) | (1 << (F - 1));
                self.anchored = true;
            }
            Item::Resume { tick, fraction } => {
                self.recurrence.accumulator = (u64::from(tick.0) << F) | (u64::from(fraction) << F >> 16);
                self.anchored = true;
            }
            Item::Dwell { ticks } if self.anchored => {
                self.recurrence.accumulator = self.recurrence.accumulator.wrapping_add(u64::from(ticks) << F);
            }
            Item::Run { segment, direction } if self.anchored => {
                self.recurrence.load(&segment);
                self.left = segment.count;
                self.direction = direction;
            }
            Item::Dwell { .. } => {}
            Item::Run { .. } => self.miss(self.horizon),
        }
    }

    fn miss(&mut self, tick: Moment) {
        self.missed = self.missed.or(Some(tick));
        self.left = 0;
        self.anchored = false;
    }

    fn begin(&mut self, switch: Switch, items: &mut impl Items) {
        items.skip_to(switch.epoch);
        self.epoch = switch.epoch;
        self.left = 0;
        self.anchored = false;
        self.missed = None;
        if self.horizon.is_before(switch.at) {
            self.horizon = switch.at;
        }
        self.switches.rotate_left(1);
        self.switches[SWITCHES - 1] = None;
    }

    fn place_of_switch(&self, at: Moment) -> Result<usize, SwitchRefused> {
        if at.is_before(self.horizon) {
            return Err(SwitchRefused::Late { horizon: self.horizon });
        }
        let earlier = self.switches.iter().flatten().take_while(|switch| switch.at.is_before(at)).count();
        if earlier == SWITCHES { Err(SwitchRefused::Full) } else { Ok(earlier) }
    }

    /// The scheduled tick of the last step, or the end of the wait after it.
    const fn last_tick(&self) -> Moment {
        Moment::of(self.recurrence.accumulator >> F)
    }

    /// The scheduled tick of the next step.
    const fn next_tick(&self) -> Moment {
        Moment::of(self.recurrence.accumulator.wrapping_add_signed(self.recurrence.interval) >> F)
    }
}
