//! The slow engine: takes the events of all motors in order of time and makes groups of them.
//!
//! It does everything: any interval, any direction, shared DIR lines, switches. What it costs is a few hundred cycles a
//! step; where nothing but steps follows for a while, the fast engine takes over.
//!
//! # Time
//! The newest group of a ring is pending: its tick is fixed, what it does is not yet. An event half of [`APART`] ticks after
//! it, or less, joins it; one that is further away becomes the next pending group, at least [`APART`] ticks later. While
//! nothing is due, empty groups keep the compare register moving.
//!
//! # DIR
//! A DIR line toggles at the end of a group. It does so after the pulse and hold of every step before that looked at the
//! line, and its set-up before the step that it is for; when there is not enough room between (another motor's group is in
//! the way, an interrupt was kept waiting), the step is late, never the set-up short.

mod lanes;

use super::merge::{LANES, Merge};
use super::pins::{Kind, Layout, Lines, MAX_MOTORS};
use super::ring::{CAPACITY, Group, Name, Ring, flags};
use crate::clock::{self, low_half};
use crate::memory::{Once, Queues};
use crate::regs::{self, Reg16};
use core::mem::MaybeUninit;
use pulsetrain_core::channel::{self, Event};
use pulsetrain_core::narrow::{Bytes, Motor, Reason, Settings};
use pulsetrain_core::wire::message::{self, Configuration};
use pulsetrain_core::{Direction, Epoch, Moment};

/// So late an interrupt may be that was kept waiting, ticks.
const LATE: u8 = 24;
/// Ticks between two groups, at least: from a match until the interrupt has set the next, and the longest time that it can be
/// kept waiting; and the length of the interrupt + 4, so that delays die out.
const APART: u8 = 48;
/// The same where interrupts are longer: with pulses of 1.9 µs.
const APART_LONG: u8 = 60;
/// The shield's, and with pulses of 1.9 µs.
const APART_SHIELD: [u8; 2] = [60, 76];
/// With two of the compare hardware's.
const APART_COMPARE: u8 = 96;
/// Ticks between two steps of a motor with a ring of its own, at least, for the fast engine: alone, and beside another.
const FASTEST: [u16; 2] = [60, 130];
/// Ticks between two groups, at most: the compare register is a quarter of the way round.
const FILLER: u32 = 16_384;
/// From a group's tick to its `fall`, ticks: at least, and at most when an interrupt was kept waiting.
const FALL: [u8; 2] = [16, 48];
/// The same with the compare hardware, where DIR is toggled on a longer way.
const FALL_COMPARE: [u8; 2] = [16, 80];
/// So far ahead a ring is filled while nothing is due, ticks (1.5 ms).
const AHEAD_IDLE: u32 = 24_576;
/// So far ahead it is filled at most, ticks (4 ms).
const AHEAD: u32 = 65_536;
/// A ring is filled when it has room for so many groups.
const ROOM_FOR: u8 = 20;
/// Groups that one call makes at most: other work waits meanwhile.
const BATCH: u8 = 4;
/// A compare that was missed is made so soon, ticks.
const AGAIN: u16 = 48;
/// After the ring ran empty the next group comes so soon, ticks: time enough to fill some more in.
const LEAD: u16 = 800;
/// Steps that come later than this after the ring ran empty are not made any more: the motors stop. 100 µs.
const TOO_LATE: u16 = 1600;

/// The times of a configuration, ticks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Times {
    /// From a step's edge to the end of its pulse, as it is made.
    pulse: u16,
    /// The end of the pulse is a group of its own.
    long: bool,
    /// DIR before the step.
    setup: u16,
    /// DIR after the end of the pulse.
    hold: u16,
    /// Between two groups.
    apart: u8,
    /// Another motor has a ring of its own too.
    beside: bool,
    fall: [u8; 2],
}

impl Times {
    /// From a group that toggles DIR to the step that it is for, at least.
    #[inline(always)]
    fn lead(&self) -> u32 {
        u32::from(self.setup) + u32::from(self.fall[1])
    }

    const NONE: Times = Times { pulse: 16, long: false, setup: 0, hold: 0, apart: APART, beside: false, fall: FALL };

    /// Pulses of so many ticks, or a little longer where that is what an interrupt makes; beyond that by two groups.
    fn of(kind: Kind, configuration: &Configuration<'_>) -> Times {
        // What the interrupt makes without and with its flag, and the distance that takes.
        let ((short, apart), (extra, apart_extra), fall) = match kind {
            Kind::PortD | Kind::PortB => ((16, APART), (31, APART_LONG), FALL),
            Kind::Shield => ((17, APART_SHIELD[0]), (31, APART_SHIELD[1]), FALL),
            Kind::Compare => ((35, APART_COMPARE), (35, APART_COMPARE), FALL_COMPARE),
        };
        let wanted = configuration.pulse_ticks;
        let (mut pulse, mut long, mut apart) = (short, false, apart);
        if wanted > short {
            if wanted <= extra {
                (pulse, apart) = (extra, apart_extra);
            } else {
                // Its first edge may be late, its second never is.
                (pulse, long) = (wanted.saturating_add(u16::from(LATE)).max(u16::from(apart)), true);
            }
        }
        let beside = kind == Kind::Compare && configuration.motors().len() > 1;
        Times { pulse, long, setup: configuration.setup_ticks, hold: configuration.hold_ticks, apart, beside, fall }
    }
}

/// What went wrong in playing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Trouble {
    /// A compare was missed, or the ring was empty for a moment: a group was played so late.
    Late {
        /// Ticks.
        ticks: u16,
    },
    /// The ring was empty for too long while steps were left.
    Starved,
}

/// What a motor wants next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wish {
    /// Nothing that is known.
    Nothing,
    /// The end of its pulse.
    Fall,
    /// A step.
    Step,
    /// Its DIR line so.
    Dir(Direction),
}

/// One motor and its lines.
// The motor last: the processor reaches 64 bytes from a pointer.
#[repr(C)]
pub(crate) struct Axis {
    lines: Lines,
    wish: Wish,
    /// When.
    due: Moment,
    /// DIR stays until then.
    free: Moment,
    /// DIR is set up from then on.
    ready: Moment,
    /// What must be added to the motor's count, because stops left steps unmade.
    made: i32,
    pub(crate) motor: Motor,
}

impl Axis {
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

    /// Finds out what it wants next, if that is not after `limit`.
    #[inline(never)]
    fn look(&mut self, queues: &Queues, limit: Moment, times: &Times) {
        let lead = times.lead();
        let Some(Event { tick, kind }) = self.motor.peek(queues, limit.after(lead + u32::from(times.apart))) else {
            self.wish = Wish::Nothing;
            return;
        };
        match kind {
            channel::Kind::Step => {
                self.wish = Wish::Step;
                self.due = tick;
            }
            channel::Kind::Direction(direction) => {
                self.wish = Wish::Dir(direction);
                let latest = tick.before(lead);
                // A line of its own may turn earlier, so that groups of other motors do not put the step off.
                self.due = if self.lines.shared_dir() { latest } else { latest.before(u32::from(times.apart)) };
            }
        }
    }

    /// Steps that may be made without looking at them, not after `limit` and at least `fastest` ticks apart.
    #[inline(never)]
    fn grant(&mut self, fastest: u16, limit: Moment, times: &Times) -> u8 {
        let free = match self.wish {
            Wish::Nothing => true,
            Wish::Step => !self.due.is_before(self.ready),
            _ => false,
        };
        if !free || times.long {
            return 0;
        }
        // Within what 16 bits tell apart.
        let reach = Moment(self.motor.registers().tick).after(0x7fff);
        self.motor.blind(fastest, if limit.is_before(reach) { limit } else { reach })
    }

    /// Notes that `steps` of them were made; gives the last one's tick.
    #[inline(never)]
    fn took(&mut self, steps: u8, times: &Times) -> Moment {
        self.motor.took(steps);
        self.wish = Wish::Nothing;
        let end = Moment(self.motor.registers().tick);
        self.free = end.after(u32::from(times.pulse) + u32::from(times.hold));
        end
    }

    /// Takes the event that was found.
    fn take(&mut self) {
        let kind = match self.wish {
            Wish::Dir(direction) => channel::Kind::Direction(direction),
            _ => channel::Kind::Step,
        };
        let tick = self.motor.registers().next_tick();
        self.motor.take(Event { tick, kind });
        self.wish = Wish::Nothing;
    }
}

/// One ring and what is known of it.
struct Track {
    ring: Ring,
    /// Tick of the pending group.
    at: Moment,
    /// Lines that are high once the pending group has been played, as bits of a group.
    levels: u8,
}

impl Track {
    const NONE: Track = Track { ring: Ring::new(Name::A), at: Moment(0), levels: 0 };

    /// The compare register, and the ring's bit in `TIMSK1` and `TIFR1`.
    #[inline(always)]
    fn compare(&self) -> (Reg16, u8) {
        match self.ring.name() {
            Name::A => (regs::OCR1A, 1 << 1),
            Name::B => (regs::OCR1B, 1 << 2),
        }
    }

    /// The next match is to be at `at`.
    #[inline(never)]
    fn resume(&self, at: Moment) {
        let (compare, bit) = self.compare();
        regs::free(|| compare.write(low_half(at.0)));
        regs::TIFR1.write(bit);
        regs::free(|| {
            regs::GPIOR0.clear(self.starved_flag());
            regs::TIMSK1.set(bit);
        });
    }

    #[inline(always)]
    fn starved_flag(&self) -> u8 {
        match self.ring.name() {
            Name::A => 1 << flags::STARVED_A,
            Name::B => 1 << flags::STARVED_B,
        }
    }

    /// Publishes the pending group and makes `group` at `tick` the pending one.
    #[inline(never)]
    fn push(&mut self, tick: Moment, group: Group) {
        self.ring.push(low_half(tick.0), group);
        self.at = tick;
    }

    /// Puts `group` at `due`: into the pending group if that is near, not before `open`, and has other lines; else later.
    ///
    /// Gives its tick.
    #[inline(never)]
    fn put(&mut self, due: Moment, open: Moment, group: Group, apart: u8) -> Moment {
        let near = due.before(u32::from(apart / 2)).is_before(self.at);
        let pending = self.ring.pending();
        // An edge of the compare hardware needs a group of its own.
        let taken =
            pending.rise & group.rise | pending.fall & group.fall | self.ring.edge() & (group.rise | group.fall);
        if near && !self.at.is_before(open) && taken == 0 {
            self.ring.amend(group);
        } else {
            self.push(later(due, self.at.after(u32::from(apart))), group);
        }
        self.levels ^= group.rise ^ group.fall;
        self.at
    }

    /// Looks whether the interrupt still plays what it should, and mends it.
    #[inline(never)]
    fn watch(&mut self, now: Moment, busy: bool) -> Option<Trouble> {
        if regs::GPIOR0.read() & self.starved_flag() != 0 {
            let (compare, _) = self.compare();
            // The compare register still has the tick of the group that is next.
            let count = clock::read();
            let late = count.wrapping_sub(compare.read());
            if busy && late >= TOO_LATE {
                return Some(Trouble::Starved);
            }
            // It counts from here on, not from when the round began.
            let now = now.after(u32::from(count.wrapping_sub(low_half(now.0))));
            if self.ring.is_empty() {
                self.at = now.after(u32::from(LEAD));
                self.resume(self.at);
            } else {
                self.resume(now.after(u32::from(AGAIN)));
            }
            return busy.then_some(Trouble::Late { ticks: late });
        }
        let (compare, bit) = self.compare();
        // A match lies ahead, or its interrupt has been kept waiting for some cycles. If it is behind by 512 to 32 767, it
        // was missed and would be found 65 536 ticks later. Whole bytes say that, with interrupts on.
        let [_, high, ..] = now.0.to_le_bytes();
        if !matches!(high.wrapping_sub(compare.high()), 2..0x80) || regs::TIFR1.read() & bit != 0 {
            return None;
        }
        let late = low_half(now.0).wrapping_sub(regs::free(|| compare.read()));
        let again = clock::read().wrapping_add(AGAIN);
        regs::free(|| compare.write(again));
        (late != 0).then_some(Trouble::Late { ticks: late })
    }

    /// Whether no group is left to be played but fillers.
    #[inline(never)]
    fn is_idle(&self) -> bool {
        self.ring.is_idle()
    }
}

/// Room for the motors, apart from what begins with values: those would be kept in flash, too.
static ROOM: Once<[MaybeUninit<Axis>; MAX_MOTORS]> = Once::new([const { MaybeUninit::uninit() }; MAX_MOTORS]);

/// The motors in use.
struct Axes {
    /// Lent by [`Stepper::begin`].
    room: Option<&'static mut [MaybeUninit<Axis>; MAX_MOTORS]>,
    /// So many are there, the first ones.
    count: u8,
}

impl Axes {
    #[inline(never)]
    fn all(&self) -> &[Axis] {
        match &self.room {
            // SAFETY: `push` made so many.
            Some(room) => unsafe { core::slice::from_raw_parts(room.as_ptr().cast(), usize::from(self.count)) },
            None => &[],
        }
    }

    #[inline(never)]
    fn all_mut(&mut self) -> &mut [Axis] {
        match &mut self.room {
            // SAFETY: `push` made so many.
            Some(room) => unsafe { core::slice::from_raw_parts_mut(room.as_mut_ptr().cast(), usize::from(self.count)) },
            None => &mut [],
        }
    }

    /// One more, at position 0, if there is room.
    #[inline(never)]
    fn push(&mut self, lines: Lines, bytes: Bytes, settings: Settings) {
        if let Some(room) = &mut self.room
            && let Some(place) = room.get_mut(usize::from(self.count))
        {
            place.write(Axis {
                lines,
                wish: Wish::Nothing,
                due: Moment(0),
                free: Moment(0),
                ready: Moment(0),
                made: 0,
                motor: Motor::new(bytes, settings),
            });
            self.count += 1;
        }
    }
}

/// All motors of a configuration, and their rings.
pub(crate) struct Stepper {
    tracks: [Track; 2],
    /// The merge, from [`Stepper::begin`] on.
    merge: Option<&'static mut Merge>,
    /// Two motors or more in one ring, each with a DIR line of its own: the merge fills it.
    merging: bool,
    /// Merging: tick of the last that each lane was fed.
    last: [Moment; LANES],
    axes: Axes,
    /// Each motor has a ring of its own.
    apiece: bool,
    shield: bool,
    times: Times,
    /// GPIOR0: see [`flags`].
    flags: u8,
    trouble: Option<Trouble>,
    fewest_groups: u8,
}

impl Stepper {
    /// No motors.
    pub(crate) const fn new() -> Stepper {
        Stepper {
            tracks: [Track::NONE, Track::NONE],
            merge: None,
            merging: false,
            last: [Moment(0); LANES],
            axes: Axes { room: None, count: 0 },
            apiece: false,
            shield: false,
            times: Times::NONE,
            flags: 0,
            trouble: None,
            fewest_groups: u8::MAX,
        }
    }

    /// Takes the merge, and the room for the motors.
    ///
    /// # Safety
    /// Once in a program.
    pub(crate) unsafe fn begin(&mut self) {
        // SAFETY: the caller's promise.
        unsafe {
            self.merge = Some(Merge::take());
            self.axes.room = Some(ROOM.take());
        }
    }

    /// The motors in use.
    pub(crate) fn axes(&self) -> &[Axis] {
        self.axes.all()
    }

    /// A motor by its number.
    #[inline(never)]
    pub(crate) fn axis_mut(&mut self, motor: u8) -> Option<&mut Axis> {
        self.axes.all_mut().get_mut(usize::from(motor))
    }

    /// The rings in use.
    #[inline(never)]
    fn tracks_mut(&mut self) -> &mut [Track] {
        let count = if self.apiece { self.axes.count } else { 1 };
        self.tracks.get_mut(..usize::from(count)).unwrap_or_default()
    }

    /// Motors and lines of `configuration`; all motors at position 0. Not while it plays.
    #[inline(never)]
    pub(crate) fn configure(&mut self, layout: &Layout, configuration: &Configuration<'_>, now: Moment) {
        self.axes.all_mut().iter_mut().for_each(|axis| axis.lines.float());
        let kind = layout.kind;
        self.apiece = kind == Kind::Compare;
        self.shield = kind == Kind::Shield;
        self.times = Times::of(kind, configuration);
        let (always, extra) = match kind {
            Kind::Shield => (1 << flags::EXTRA_A | 1 << flags::SHIELD, 1 << flags::SHIELD_LONG),
            Kind::PortB => (0, 1 << flags::EXTRA_B),
            Kind::PortD => (0, 1 << flags::EXTRA_A),
            Kind::Compare => (0, 0),
        };
        self.flags = if self.times.pulse == 31 { always | extra } else { always };
        let first = if kind == Kind::PortB { Name::B } else { Name::A };
        self.tracks[0].ring = Ring::new(first);
        self.axes.count = 0;
        let motors = configuration.motors();
        let all = motors.len() as u8;
        let gap_ticks = self.times.pulse.saturating_add(1);
        for motor in motors {
            let mut lines = layout.lines(&motor);
            let index = self.axes.count;
            if kind == Kind::Compare {
                let track = &mut self.tracks[usize::from(index & 1)];
                let (name, dir) = if motor.step_pin == 10 {
                    (Name::B, flags::DIR_B_ON_PORTB)
                } else {
                    (Name::A, flags::DIR_A_ON_PORTB)
                };
                let on_portb = motor.dir_pin >= 8;
                track.ring = Ring::hardware(name, on_portb);
                lines.step = track.ring.edge();
                self.flags |= u8::from(on_portb) << dir;
            }
            lines.drive();
            let settings = Settings { gap_ticks, asserts_every_step: lines.shared_dir(), gain: motor.gain };
            self.axes.push(lines, Queues::share(all, index), settings);
        }
        self.merging = self.axes.count > 1 && !self.apiece && !self.axes().iter().any(|axis| axis.lines.shared_dir());
        if self.merging {
            self.tracks[0].ring = Ring::for_merge(first);
            // The merge moves edges by half of that, either way.
            let slack = u16::from(self.times.apart);
            self.times.setup = self.times.setup.saturating_add(slack);
            self.times.hold = self.times.hold.saturating_add(slack);
        }
        self.rest(now);
    }

    /// Begins to play, from a little after `now` on. Queues are empty.
    #[inline(never)]
    pub(crate) fn start(&mut self, now: Moment) {
        let at = now.after(AHEAD_IDLE);
        // The lists of a merge begin with a filler each.
        let first = at.after(FILLER);
        self.rest(if self.merging { first } else { now });
        self.last = [first; LANES];
        self.trouble = None;
        regs::GPIOR0.write(self.flags);
        let Stepper { tracks, axes, merge, .. } = self;
        let [one, two] = tracks;
        (one.at, two.at) = (at, at);
        (one.levels, two.levels) = (0, 0);
        for (motor, axis) in axes.all().iter().enumerate() {
            let track = if self.apiece && motor != 0 { &mut *two } else { &mut *one };
            track.levels |= axis.lines.levels();
        }
        if self.merging
            && let Some(merge) = merge
        {
            merge.begin(one.ring.name(), self.times.apart, low_half(first.0));
        }
        for track in self.tracks_mut() {
            track.ring.clear();
            track.resume(at);
        }
        // Rings wake the processor often enough.
        regs::free(|| regs::TIMSK1.clear(1));
    }

    /// The immediate stop: plays no group more, and forgets all that was to come. A pulse that was begun still ends.
    ///
    /// Gives, bit by motor, whether it was going faster than `pull_in`.
    #[inline(never)]
    pub(crate) fn stop(&mut self, pull_in: &[u32; MAX_MOTORS]) -> u8 {
        let pulse = self.times.pulse;
        let mut uncertain = 0;
        for track in self.tracks_mut() {
            regs::free(|| track.ring.halt());
        }
        for (index, slowest) in (0..self.axes.count).zip(pull_in) {
            let left = self.unplayed(index);
            let Some(axis) = self.axis_mut(index) else { break };
            let going = left != 0 || !axis.motor.is_idle();
            uncertain |= u8::from(going && axis.interval() < *slowest) << index;
            axis.made = axis.made.wrapping_sub(i32::from(left));
            axis.motor.stop();
            axis.wish = Wish::Nothing;
        }
        // A pulse of two groups may be under way: its end is no group's any more.
        if self.times.long {
            for _ in 0..pulse / 4 {
                regs::kick_watchdog();
            }
        }
        self.tracks_mut().iter_mut().for_each(|track| track.ring.clear());
        self.axes().iter().for_each(|axis| axis.lines.rest());
        if let Some(merge) = &mut self.merge {
            merge.clear(0);
        }
        // Timer1's overflow, for a look at the clock, while no ring wakes the processor.
        regs::free(|| regs::TIMSK1.set(1));
        uncertain
    }

    /// Notes that time goes on while nothing plays.
    pub(crate) fn rest(&mut self, now: Moment) {
        for axis in self.axes.all_mut() {
            axis.motor.pass(now);
            (axis.free, axis.ready) = (now, now);
        }
    }

    /// Whether nothing is left to do: no event, no end of a pulse, no step in a ring.
    pub(crate) fn is_idle(&self) -> bool {
        self.axes().iter().all(|axis| axis.wish == Wish::Nothing && axis.motor.is_idle())
            && self.tracks[0].is_idle()
            && !(self.apiece && self.axes.count > 1 && !self.tracks[1].is_idle())
            && !(self.merging && self.merge.as_ref().is_some_and(|merge| !merge.is_idle()))
    }

    /// The first tick at which a switch would be accepted.
    #[inline(never)]
    pub(crate) fn horizon(&self) -> Moment {
        let [first, second] = &self.tracks;
        let mut horizon = first.at;
        if self.apiece && self.axes.count > 1 {
            horizon = later(horizon, second.at);
        }
        for axis in self.axes() {
            horizon = later(horizon, axis.motor.horizon());
        }
        horizon.after(1)
    }

    /// All motors go over to `epoch` at `at`, which is not before the horizon; or none does, because too many wait.
    #[inline(never)]
    pub(crate) fn switch(&mut self, epoch: Epoch, at: Moment) -> bool {
        if self.axes().iter().any(|axis| axis.motor.check_switch(at).is_err()) {
            return false;
        }
        for axis in self.axes.all_mut() {
            // Checked above.
            let _ = axis.motor.schedule_switch(epoch, at);
            // What was looked up may be of the old epoch; the end of a pulse is not.
            if axis.wish != Wish::Fall {
                axis.wish = Wish::Nothing;
            }
        }
        true
    }

    /// Takes back what was pushed last of `epoch`, of all motors.
    pub(crate) fn discard(&mut self, epoch: Epoch) {
        for axis in self.axes.all_mut() {
            axis.motor.discard(epoch);
        }
    }

    /// The epoch being run.
    pub(crate) fn epoch(&self) -> Epoch {
        self.axes().first().map_or(Epoch(0), |axis| axis.motor.epoch())
    }

    /// What went wrong in playing since this was asked last.
    pub(crate) fn trouble(&mut self) -> Option<Trouble> {
        self.trouble.take()
    }

    /// Fewest groups that a ring held while more were to come.
    pub(crate) fn fewest_groups(&self) -> u16 {
        u16::from(self.fewest_groups)
    }

    /// [`Stepper::fewest_groups`] begins anew.
    pub(crate) fn reset_measures(&mut self) {
        self.fewest_groups = u8::MAX;
    }

    /// Steps of a motor that were counted but not played yet, forward minus backward.
    #[inline(never)]
    pub(crate) fn unplayed(&self, motor: u8) -> i16 {
        let [first, second] = &self.tracks;
        let track = if self.apiece && motor != 0 { second } else { first };
        let Some(Axis { lines, .. }) = self.axes().get(usize::from(motor)) else { return 0 };
        let Lines { step, dir, .. } = *lines;
        let (mut levels, mut count) = (track.levels, 0);
        if lines.step_low() {
            levels ^= step;
        }
        if !lines.forward_high() {
            levels ^= dir;
        }
        // What is in no ring yet comes after what is.
        if self.merging
            && let Some(merge) = &self.merge
        {
            let (ticks, Group { rise, fall }) = merge.listed(motor);
            if ticks != 0 {
                levels ^= fall;
                if rise & levels & step != 0 {
                    count = if levels & dir != 0 { i16::from(ticks) } else { -i16::from(ticks) };
                }
                levels ^= rise;
            }
        }
        count + i16::from(track.ring.unplayed(levels, step, dir))
    }

    /// Fills the rings as far as time allows. Whether there is nothing more to do until an interrupt comes.
    #[inline(never)]
    pub(crate) fn run(&mut self, now: Moment, queues: &Queues) -> bool {
        let mut rest = true;
        let Stepper { tracks, axes, merge, last, times, trouble, fewest_groups, .. } = self;
        let mut axes = axes.all_mut();
        for track in tracks {
            let (mine, others) =
                if self.apiece { axes.split_at_mut_checked(1).unwrap_or_default() } else { (axes, &mut [][..]) };
            axes = others;
            let merge = if self.merging { merge.as_deref_mut() } else { None };
            let busy = match &merge {
                Some(merge) => !merge.is_idle(),
                None => mine.iter().any(|axis| axis.wish != Wish::Nothing || axis.motor.registers().left != 0),
            };
            let free = track.ring.free();
            if busy {
                *fewest_groups = (*fewest_groups).min(CAPACITY.wrapping_sub(free));
            }
            if let Some(what) = track.watch(now, busy) {
                *trouble = Some(what);
            }
            if let Some(merge) = merge {
                lanes::fill(merge, last, track, mine, now, queues, times);
            } else if free >= ROOM_FOR {
                // More at once costs less, but the ring must outlast all else that the main loop does.
                rest &= fill(track, mine, now, queues, times);
            }
            if axes.is_empty() {
                break;
            }
        }
        rest
    }
}

/// Fills one ring as far as time allows. Whether there is nothing more to do until one of its groups has been played.
#[inline(never)]
fn fill(track: &mut Track, axes: &mut [Axis], now: Moment, queues: &Queues, times: &Times) -> bool {
    if let [axis] = axes {
        // As long as nothing but steps comes there is nothing to look at.
        let mut went = false;
        while track.ring.free() >= ROOM_FOR && fast(track, axis, now, times) {
            went = true;
            if axis.motor.registers().left == 0 {
                axis.look(queues, track.at.after(FILLER), times);
            }
        }
        if went {
            return false;
        }
    }
    // No further is looked in this call.
    let limit = track.at.after(FILLER);
    for axis in &mut *axes {
        // What is long past must not come back as the future.
        axis.free = later(axis.free, track.at);
        axis.ready = later(axis.ready, track.at);
        if axis.wish == Wish::Nothing {
            axis.motor.pass(track.at);
            axis.look(queues, limit, times);
        }
    }
    for _ in 0..BATCH {
        let ahead = track.at.since(now);
        if track.ring.free() < 2 || (ahead >= AHEAD && ahead < 1 << 31) {
            return true;
        }
        let (index, due) = earliest(axes, limit.after(FILLER));
        if limit.is_before(due) {
            if ahead < AHEAD_IDLE || ahead >= 1 << 31 {
                // Out of the way of what may come soon after it.
                let clear = due.before(2 * u32::from(times.apart));
                track.push(if clear.is_before(limit) { clear } else { limit }, Group::NOTHING);
                return false;
            }
            return true;
        }
        play(track, axes, index, times);
        if let Some(axis) = axes.get_mut(index)
            && axis.wish == Wish::Nothing
        {
            axis.look(queues, limit, times);
        }
    }
    false
}

/// The fast engine of a motor that has a ring of its own: expands steps into it as long as nothing but steps comes.
///
/// Whether it did.
#[inline(never)]
fn fast(track: &mut Track, axis: &mut Axis, now: Moment, times: &Times) -> bool {
    let fastest = FASTEST[usize::from(times.beside)];
    let room = track.ring.free();
    if axis.wish == Wish::Nothing {
        // The pending group is the last step, and there are more.
        let registers = axis.motor.registers();
        if registers.left == 0 || registers.tick != track.at.0 {
            return false;
        }
    } else {
        let far = axis.due.since(track.at);
        if far < u32::from(fastest) || far >= 1 << 15 {
            return false;
        }
    }
    if room < 2 {
        return false;
    }
    let steps = axis.grant(fastest, now.after(AHEAD), times).min(room - 1);
    if steps == 0 {
        return false;
    }
    let step = Group { rise: axis.lines.step, fall: axis.lines.step };
    // SAFETY: `blind` promises so many steps at such intervals, and the ring has room for them.
    unsafe { track.ring.expand(axis.motor.registers_mut(), steps, step) };
    track.at = axis.took(steps, times);
    true
}

/// Whose wish is due first, if any is before `due`; and when.
#[inline(never)]
fn earliest(axes: &[Axis], mut due: Moment) -> (usize, Moment) {
    let (mut first, mut may_wait) = (0, false);
    for (index, axis) in axes.iter().enumerate() {
        // A step looks at its line before another motor may turn it.
        let sooner = axis.due.is_before(due) || (axis.due == due && may_wait);
        if axis.wish != Wish::Nothing && sooner {
            first = index;
            due = axis.due;
            may_wait = matches!(axis.wish, Wish::Dir(_));
        }
    }
    (first, due)
}

/// Makes what motor `index` wants, when it is due or as soon after as it can be.
#[inline(never)]
fn play(track: &mut Track, axes: &mut [Axis], index: usize, times: &Times) {
    if let Some((due, open, group)) = plan(axes, index, track.levels, times) {
        let tick = track.put(due, open, group, times.apart);
        done(axes, index, tick, times);
    }
}

/// When motor `index` can make what it wants, before when it must not, and how. Nothing if its line is right already.
#[inline(never)]
fn plan(axes: &mut [Axis], index: usize, levels: u8, times: &Times) -> Option<(Moment, Moment, Group)> {
    let axis = axes.get_mut(index)?;
    let Lines { step, dir, .. } = axis.lines;
    let due = axis.due;
    let (open, group) = match axis.wish {
        Wish::Nothing => return None,
        Wish::Fall => (due, Group { rise: step, fall: 0 }),
        Wish::Step => (axis.ready, Group { rise: step, fall: if times.long { 0 } else { step } }),
        Wish::Dir(direction) => {
            if (levels & dir != 0) == ((direction == Direction::Forward) == axis.lines.forward_high()) {
                axis.take();
                return None;
            }
            let mut free = axis.free;
            for axis in axes.iter().filter(|axis| axis.lines.dir == dir) {
                free = later(free, axis.free);
            }
            (free.before(u32::from(times.fall[0])), Group { rise: 0, fall: dir })
        }
    };
    Some((later(due, open), open, group))
}

/// Notes that motor `index` makes at `tick` what it wanted.
#[inline(never)]
fn done(axes: &mut [Axis], index: usize, tick: Moment, times: &Times) {
    let Some(axis) = axes.get_mut(index) else { return };
    let dir = axis.lines.dir;
    match axis.wish {
        Wish::Nothing | Wish::Fall => axis.wish = Wish::Nothing,
        Wish::Step => {
            axis.take();
            let end = tick.after(u32::from(times.pulse));
            axis.free = end.after(u32::from(times.hold));
            if times.long {
                axis.wish = Wish::Fall;
                axis.due = end;
            }
        }
        Wish::Dir(_) => {
            axis.take();
            let ready = tick.after(times.lead());
            for axis in axes.iter_mut().filter(|axis| axis.lines.dir == dir) {
                axis.ready = ready;
            }
        }
    }
}

/// The later of two moments.
#[inline(never)]
fn later(one: Moment, other: Moment) -> Moment {
    if one.is_before(other) { other } else { one }
}
