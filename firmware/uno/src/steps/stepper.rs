//! The slow engine: takes the events of all motors in order of time and makes groups of them.
//!
//! It does everything: any interval, any direction, shared DIR lines, switches. What it costs is a few hundred cycles a
//! step; where nothing but steps follows for a while the fast engine takes over.
//!
//! # Time
//! The newest group of the ring is pending: its tick is fixed, what it does is not yet. An event within [`NEAR`] ticks of it joins
//! it; one that is further away becomes the next pending group, at least [`APART`] ticks later. While nothing is due,
//! empty groups keep the compare register moving.
//!
//! # DIR
//! A DIR line toggles at the end of a group, [`FALL`] ticks after its tick. It does so after the pulse and hold of every
//! step before that looked at the line, and its set-up before the step that it is for; when there is not enough room between
//! (another motor's group is in the way), the step is late, never the set-up short.

use super::pins::{Kind, Layout, Lines, MAX_MOTORS};
use super::ring::{Group, Name, Ring, flags};
use crate::clock::low_half;
use crate::memory::Queues;
use crate::regs::{self, Reg16};
use pulsetrain_core::channel::{self, Event};
use pulsetrain_core::narrow::{Motor, Reason, Settings};
use pulsetrain_core::wire::message::{self, Configuration};
use pulsetrain_core::{Direction, Epoch, Moment};

/// Ticks between two groups, at least: the longest interrupt and the longest time that it can be kept waiting.
const APART: u32 = 56;
/// The same with pulses of 1.9 µs.
const APART_LONG: u32 = 72;
/// Ticks between two groups, at most: the compare register is a quarter of the way round.
const FILLER: u32 = 16_384;
/// From a group's tick to its `fall`, ticks.
const FALL: u32 = 16;
/// So far ahead the ring is filled while nothing is due, ticks (1.5 ms).
const AHEAD_IDLE: u32 = 24_576;
/// So far ahead it is filled at most, ticks (4 ms).
const AHEAD: u32 = 65_536;
/// A compare that was missed is made so soon, ticks.
const AGAIN: u16 = 40;
/// Groups that one call makes at most: other work waits meanwhile.
const BATCH: u8 = 8;

/// The times of a configuration, ticks.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Times {
    /// From a step's edge to the end of its pulse, as it is made.
    pub(crate) pulse: u16,
    /// The end of the pulse is a group of its own.
    pub(crate) long: bool,
    /// DIR before the step.
    pub(crate) setup: u16,
    /// DIR after the end of the pulse.
    pub(crate) hold: u16,
    /// Between two groups.
    apart: u8,
}

impl Times {
    /// The pulse of `wanted` ticks or longer that a group can make; else two groups make it.
    pub(crate) fn of(wanted: u16, setup: u16, hold: u16) -> Times {
        match wanted {
            0..=16 => Times { pulse: 16, long: false, setup, hold, apart: APART as u8 },
            17..=31 => Times { pulse: 31, long: false, setup, hold, apart: APART_LONG as u8 },
            _ => Times { pulse: wanted.max(APART as u16), long: true, setup, hold, apart: APART as u8 },
        }
    }
}

/// What went wrong in playing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Trouble {
    /// A compare was missed and made so late.
    Late { ticks: u16 },
    /// The ring ran empty.
    Starved,
}

/// One motor and its lines.
pub(crate) struct Axis {
    pub(crate) motor: Motor,
    lines: Lines,
    /// What comes next, as far as it was looked for.
    next: Option<Event>,
    /// When the pulse being made ends.
    fall: Option<Moment>,
    /// DIR stays until then.
    free: Moment,
    /// DIR is set up from then on.
    ready: Moment,
    /// What must be added to the motor's count, because stops left steps unmade.
    made: i32,
}

impl Axis {
    const NONE: Axis = Axis {
        motor: Motor::new(Queues::share(0, 0), Settings { gap_ticks: 1, asserts_every_step: false, gain: 0 }),
        lines: Lines::NONE,
        next: None,
        fall: None,
        free: Moment(0),
        ready: Moment(0),
        made: 0,
    };

    /// Steps forward minus backward that were taken from the queue, whether played or not yet.
    pub(crate) fn position(&self) -> i32 {
        self.motor.position().wrapping_add(self.made)
    }

    /// Whole ticks from the step before to the next one; after a segment, as it would go on.
    fn interval(&self) -> u32 {
        let registers = self.motor.registers();
        registers.next_tick().since(Moment(registers.tick))
    }

    /// As [`flags`](pulsetrain_core::wire::message::flags) has them.
    pub(crate) fn faults(&self) -> u8 {
        match self.motor.fault().map(|fault| fault.reason) {
            None => 0,
            Some(Reason::Missed) => message::flags::STEP_MISSED,
            Some(Reason::Mismatch) => message::flags::CHECK_FAILED,
            Some(Reason::Bad) => message::flags::BAD_ITEM,
        }
    }
}

/// What a motor wants next.
#[derive(Clone, Copy)]
enum Wish {
    /// The end of its pulse.
    Fall,
    /// A step.
    Step,
    /// Its DIR line so.
    Dir(Direction),
}

/// All motors of a configuration whose edges software makes, and their ring.
pub(crate) struct Stepper {
    ring: Ring,
    axes: [Axis; MAX_MOTORS],
    count: u8,
    times: Times,
    /// Tick of the pending group.
    at: Moment,
    /// Lines that are high once the pending group has been played.
    levels: u8,
    /// GPIOR0: see [`flags`].
    flags: u8,
    trouble: Option<Trouble>,
    fewest_groups: u8,
}

impl Stepper {
    /// The motors in use.
    pub(crate) fn axes(&self) -> &[Axis] {
        self.axes.get(..usize::from(self.count)).unwrap_or_default()
    }

    /// A motor by its number.
    pub(crate) fn axis_mut(&mut self, motor: u8) -> Option<&mut Axis> {
        if motor < self.count { self.axes.get_mut(usize::from(motor)) } else { None }
    }

    /// No motors.
    pub(crate) const fn new() -> Stepper {
        Stepper {
            ring: Ring::new(Name::A),
            axes: [const { Axis::NONE }; MAX_MOTORS],
            count: 0,
            times: Times { pulse: 16, long: false, setup: 0, hold: 0, apart: APART as u8 },
            at: Moment(0),
            levels: 0,
            flags: 0,
            trouble: None,
            fewest_groups: u8::MAX,
        }
    }

    /// Motors and lines of `configuration`; all motors at position 0. Not while it plays.
    #[inline(never)]
    pub(crate) fn configure(&mut self, layout: &Layout, times: Times, configuration: &Configuration<'_>, now: Moment) {
        for axis in self.axes() {
            axis.lines.float();
        }
        self.ring = Ring::new(if layout.kind == Kind::PortB { Name::B } else { Name::A });
        self.ring.clear();
        self.count = 0;
        self.times = times;
        self.flags = match (layout.kind, times.pulse == 31) {
            (Kind::Shield, long) => 1 << flags::EXTRA_A | 1 << flags::SHIELD | u8::from(long) << flags::SHIELD_LONG,
            (Kind::PortB, true) => 1 << flags::EXTRA_B,
            (Kind::PortD, true) => 1 << flags::EXTRA_A,
            _ => 0,
        };
        let motors = configuration.motors();
        let all = motors.len() as u8;
        for ((axis, lines), motor) in self.axes.iter_mut().zip(layout.lines()).zip(motors) {
            let settings = Settings {
                gap_ticks: times.pulse.saturating_add(1),
                asserts_every_step: lines.shared_dir(),
                gain: motor.gain,
            };
            *axis = Axis { motor: Motor::new(Queues::share(all, self.count), settings), lines: *lines, ..Axis::NONE };
            self.count += 1;
            lines.drive();
        }
        self.rest(now);
    }

    /// Begins to play, from a little after `now` on. Queues are empty.
    #[inline(never)]
    pub(crate) fn start(&mut self, now: Moment) {
        let (compare, bit) = self.compare();
        regs::free(|| regs::TIMSK1.clear(bit));
        self.rest(now);
        self.ring.clear();
        self.levels = self.lines_high();
        self.at = now.after(AHEAD_IDLE);
        self.trouble = None;
        regs::GPIOR0.write(self.flags);
        regs::free(|| compare.write(low_half(self.at.0)));
        regs::TIFR1.write(bit);
        regs::free(|| regs::TIMSK1.set(bit));
    }

    /// The immediate stop: plays no group more, and forgets all that was to come. A pulse that was begun still ends.
    ///
    /// Gives, bit by motor, whether it was going faster than `pull_in`.
    #[inline(never)]
    pub(crate) fn stop(&mut self, pull_in: &[u32; MAX_MOTORS]) -> u8 {
        let (_, bit) = self.compare();
        regs::free(|| regs::TIMSK1.clear(bit));
        let unplayed = self.unplayed();
        let mut uncertain = 0;
        for (index, ((axis, left), slowest)) in self.axes.iter_mut().zip(unplayed).zip(pull_in).enumerate() {
            if index < usize::from(self.count) {
                let going = axis.interval() < *slowest;
                uncertain |= u8::from(going && (left != 0 || !axis.motor.is_idle())) << index;
                axis.made = axis.made.wrapping_sub(left);
                axis.motor.stop();
                axis.next = None;
                axis.fall = None;
            }
        }
        // A pulse of two groups may be under way: its end is no group's any more.
        for axis in self.axes() {
            if (self.lines_high() & axis.lines.step != 0) != axis.lines.step_low() {
                for _ in 0..self.times.pulse / 8 {
                    regs::kick_watchdog();
                }
                axis.lines.rest();
            }
        }
        self.ring.clear();
        self.levels = self.lines_high();
        uncertain
    }

    /// Notes that time goes on while nothing plays.
    pub(crate) fn rest(&mut self, now: Moment) {
        let count = usize::from(self.count);
        for axis in self.axes.iter_mut().take(count) {
            axis.motor.pass(now);
            (axis.free, axis.ready) = (now, now);
        }
    }

    /// The compare register of the ring, and its bit in `TIMSK1` and `TIFR1`.
    fn compare(&self) -> (Reg16, u8) {
        match self.ring.name() {
            Name::A => (regs::OCR1A, 1 << 1),
            Name::B => (regs::OCR1B, 1 << 2),
        }
    }

    /// Levels of the lines as bits of a group.
    fn lines_high(&self) -> u8 {
        match self.ring.name() {
            Name::B => regs::PORTB.read(),
            Name::A if self.flags & 1 << flags::SHIELD != 0 => {
                regs::PORTD.read() & 0xfc | regs::PORTB.read() >> 4 & 0x03
            }
            Name::A => regs::PORTD.read(),
        }
    }

    /// Whether nothing is left to do: no event, no end of a pulse, no step in the ring.
    pub(crate) fn is_idle(&self) -> bool {
        let done = |axis: &Axis| axis.next.is_none() && axis.fall.is_none() && axis.motor.is_idle();
        self.axes().iter().all(done) && self.ring.newest_first().all(|group| group == Group::NOTHING)
    }

    /// The first tick at which a switch would be accepted.
    #[inline(never)]
    pub(crate) fn horizon(&self) -> Moment {
        let open = self.at.after(1);
        self.axes().iter().fold(open, |horizon, axis| later(horizon, axis.motor.horizon()))
    }

    /// All motors go over to `epoch` at `at`, which is not before the horizon; or none does, because too many wait.
    #[inline(never)]
    pub(crate) fn switch(&mut self, epoch: Epoch, at: Moment) -> bool {
        if self.axes().iter().any(|axis| axis.motor.check_switch(at).is_err()) {
            return false;
        }
        let count = usize::from(self.count);
        for axis in self.axes.iter_mut().take(count) {
            // Checked above. What was looked up may be of the old epoch.
            let _ = axis.motor.schedule_switch(epoch, at);
            axis.next = None;
        }
        true
    }

    /// The epoch being run.
    pub(crate) fn epoch(&self) -> Epoch {
        self.axes().first().map_or(Epoch(0), |axis| axis.motor.epoch())
    }

    /// What went wrong in playing since this was asked last.
    pub(crate) fn trouble(&mut self) -> Option<Trouble> {
        self.trouble.take()
    }

    /// Fewest groups that the ring held while more were to come.
    pub(crate) fn fewest_groups(&self) -> u16 {
        u16::from(self.fewest_groups)
    }

    /// [`Stepper::fewest_groups`] begins anew.
    pub(crate) fn reset_measures(&mut self) {
        self.fewest_groups = u8::MAX;
    }

    /// Looks whether the interrupt still plays what it should.
    #[inline(never)]
    fn watch(&mut self, now: Moment) {
        let (compare, bit) = self.compare();
        if regs::GPIOR0.read() & (1 << flags::STARVED_A | 1 << flags::STARVED_B) != 0 {
            self.trouble = Some(Trouble::Starved);
            let _ = now;
            return;
        }
        let missed = regs::free(|| {
            let late = regs::TCNT1.read().wrapping_sub(compare.read());
            // Behind the counter, and no interrupt waits to run: it would be found 65 536 ticks later.
            if late.cast_signed() > 0 && regs::TIFR1.read() & bit == 0 {
                compare.write(regs::TCNT1.read().wrapping_add(AGAIN));
                late + AGAIN
            } else {
                0
            }
        });
        if missed != 0 {
            self.trouble = Some(Trouble::Late { ticks: missed });
        }
    }

    /// Fills the ring as far as time allows.
    #[inline(never)]
    pub(crate) fn run(&mut self, now: Moment, queues: &Queues) {
        self.watch(now);
        let count = usize::from(self.count);
        for axis in self.axes.iter_mut().take(count) {
            if axis.next.is_none() {
                axis.motor.pass(self.at);
            }
            // What is long past must not come back as the future.
            if axis.free.is_before(self.at) {
                axis.free = self.at;
            }
            if axis.ready.is_before(self.at) {
                axis.ready = self.at;
            }
        }
        for _ in 0..BATCH {
            let ahead = self.at.since(now);
            if self.ring.free() < 2 || (ahead >= AHEAD && ahead < 1 << 31) {
                return;
            }
            let limit = self.at.after(FILLER);
            match self.earliest(queues) {
                Some((motor, wish, due)) if !limit.is_before(due) => self.play(motor, wish, due),
                _ if ahead >= AHEAD_IDLE && ahead < 1 << 31 => return,
                _ => {
                    self.push(limit, Group::NOTHING);
                }
            }
        }
    }

    /// Whose wish is due first, and when.
    #[inline(never)]
    fn earliest(&mut self, queues: &Queues) -> Option<(u8, Wish, Moment)> {
        let lead = u32::from(self.times.setup) + FALL + APART;
        let limit = self.at.after(FILLER + lead);
        let (setup, count) = (u32::from(self.times.setup), self.count);
        let mut earliest: Option<(u8, Wish, Moment)> = None;
        for (index, axis) in (0..count).zip(self.axes.iter_mut()) {
            let (wish, due) = if let Some(fall) = axis.fall {
                (Wish::Fall, fall)
            } else {
                if axis.next.is_none() {
                    axis.next = axis.motor.peek(queues, limit);
                }
                match axis.next {
                    None => continue,
                    Some(Event { tick, kind: channel::Kind::Step }) => (Wish::Step, tick),
                    Some(Event { tick, kind: channel::Kind::Direction(direction) }) => {
                        let latest = tick.before(setup + FALL);
                        // A line of its own may turn earlier, so that groups of other motors do not put it off.
                        let due = if axis.lines.shared_dir() { latest } else { latest.before(APART) };
                        (Wish::Dir(direction), due)
                    }
                }
            };
            // A step looks at its line before another motor may turn it.
            let sooner = |(_, other, first): (u8, Wish, Moment)| {
                due.is_before(first) || (due == first && matches!(other, Wish::Dir(_)))
            };
            if earliest.is_none_or(sooner) {
                earliest = Some((index, wish, due));
            }
        }
        earliest
    }

    /// Makes what motor `index` wants at `due`, or as soon after as it can be.
    #[inline(never)]
    fn play(&mut self, index: u8, wish: Wish, due: Moment) {
        let Some(axis) = self.axes.get_mut(usize::from(index)) else { return };
        let lines = axis.lines;
        let pulse = u32::from(self.times.pulse);
        match wish {
            Wish::Fall => {
                axis.fall = None;
                self.put(due, due, Group { rise: lines.step, fall: 0 });
            }
            Wish::Step => {
                let Some(event) = axis.next.take() else { return };
                axis.motor.take(event);
                let ready = axis.ready;
                let due = later(due, ready);
                let tick = if self.times.long {
                    self.put(due, ready, Group { rise: lines.step, fall: 0 })
                } else {
                    self.put(due, ready, Group { rise: lines.step, fall: lines.step })
                };
                if let Some(axis) = self.axes.get_mut(usize::from(index)) {
                    axis.free = tick.after(pulse + u32::from(self.times.hold));
                    if self.times.long {
                        axis.fall = Some(tick.after(pulse));
                    }
                }
            }
            Wish::Dir(direction) => {
                let Some(event) = axis.next.take() else { return };
                axis.motor.take(event);
                let high = (direction == Direction::Forward) == lines.forward_high();
                if (self.levels & lines.dir != 0) == high {
                    return;
                }
                let free = self.line_free(lines.dir).before(FALL);
                let tick = self.put(later(due, free), free, Group { rise: 0, fall: lines.dir });
                let ready = tick.after(FALL + u32::from(self.times.setup));
                for axis in self.axes.iter_mut().filter(|axis| axis.lines.dir == lines.dir) {
                    axis.ready = ready;
                }
            }
        }
    }

    /// Until when the line `dir` must stay, for all motors that look at it.
    fn line_free(&self, dir: u8) -> Moment {
        let mut free = self.at.before(FALL);
        for axis in self.axes().iter().filter(|axis| axis.lines.dir == dir) {
            free = later(free, axis.free);
        }
        free
    }

    /// Puts `group` at `due`: into the pending group if that is near, not before `open`, and has other lines; else later.
    ///
    /// Gives its tick.
    #[inline(never)]
    fn put(&mut self, due: Moment, open: Moment, group: Group) -> Moment {
        let apart = u32::from(self.times.apart);
        let near = due.before(apart / 2).is_before(self.at);
        let pending = self.ring.pending();
        if near && !self.at.is_before(open) && pending.rise & group.rise == 0 && pending.fall & group.fall == 0 {
            self.ring.amend(group);
        } else {
            self.push(later(due, self.at.after(apart)), group);
        }
        self.levels ^= group.rise ^ group.fall;
        self.at
    }

    /// Publishes the pending group and makes `group` at `tick` the pending one.
    #[inline]
    fn push(&mut self, tick: Moment, group: Group) {
        self.ring.push(low_half(tick.0), group);
        self.at = tick;
    }

    /// Steps that were counted but whose groups were not played yet, forward minus backward, of each motor.
    pub(crate) fn unplayed(&self) -> [i32; MAX_MOTORS] {
        let mut unplayed = [0; MAX_MOTORS];
        let mut levels = self.levels;
        // From the newest group back to the next one to be played.
        for group in self.ring.newest_first() {
            levels ^= group.fall;
            for (count, axis) in unplayed.iter_mut().zip(self.axes()) {
                let Lines { step, dir, .. } = axis.lines;
                let active = (levels & step != 0) != axis.lines.step_low();
                if group.rise & step != 0 && active {
                    let forward = (levels & dir != 0) == axis.lines.forward_high();
                    *count += if forward { 1 } else { -1 };
                }
            }
            levels ^= group.rise;
        }
        unplayed
    }
}

/// The later of two moments.
fn later(one: Moment, other: Moment) -> Moment {
    if one.is_before(other) { other } else { one }
}
