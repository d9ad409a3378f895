//! The step generator: rings, motors, and who fills what.
//!
//! | motors | who fills |
//! |---|---|
//! | one, or two on the compare hardware or on PORTD | each its own ring: [`fill`](super::fill) |
//! | two to four with DIR lines of their own | the merge: [`merge`](super::merge) |
//! | `Kind::Beside` | the merge, and for the motor on PORTB [`beside`](super::beside) |
//! | motors that share a DIR line | one step after the other: [`shared`](super::shared) |
//!
//! [`task`] calls them.
//!
//! # Time
//! The newest group of a ring is pending: its tick is fixed, what follows is not. Groups are at least `apart` ticks from each
//! other; what would be nearer is put off, or joins the group that is there.
//!
//! # DIR
//! A DIR line toggles at the end of a group, after the pulse and hold of every step before that looked at the line, and its
//! set-up before the step that it is for. Planners leave room for that ([`Spacing`]); where they did not, the step is not made.

use super::beside;
use super::brake::{Lease, lease};
use super::merge::Merge;
use super::motor::{COUNT_AT_REST, Motor, flag};
use super::pins::{Kind, Layout, Lines, MAX_MOTORS};
use super::plan::FILLER;
use super::ring::{Group, Name, Ring, flags};
use super::switch;
use super::task::{self, mode};
use super::times::{TIMES, Times};
use crate::Uses;
use crate::engine::clock::{self, low_half};
use crate::engine::memory;
use crate::engine::program::Program;
use crate::engine::regs::{self, Reg16};
use crate::engine::tuning::stepper::{
    AGAIN, AHEAD, APART as APART_SHORT, APART_BESIDE, APART_BESIDE_MERGE, APART_LONG, APART_OF_BESIDE, APART_SHIELD,
    APART_TWO_COMPARE, EARLY, FALL, FALL_BESIDE, FALL_COMPARE, FASTEST, LATE, LATE_MOVED, LEAD, PULSE_BESIDE, STEPS,
    TOO_LATE,
};
use core::mem::offset_of;
use core::ptr::NonNull;
use core::slice;
use pulsetrain_core::wire::message::{self, Configuration};
use pulsetrain_core::{Epoch, Tick32};

/// The longest of pulse, set-up and hold, ticks: less than a filler, so that what is past need not be remembered longer.
pub(crate) const LONGEST: u16 = 4_096;

/// What a configuration asks of the spacing of groups.
#[derive(Clone, Copy)]
struct Spacing {
    /// The interrupt's pulse is the one of 1.9 µs.
    extra: bool,
    /// The end of the pulse is a group of its own.
    long: bool,
    /// Between two groups, ticks.
    apart: u8,
}

impl Spacing {
    const NONE: Spacing = Spacing { extra: false, long: false, apart: 0 };

    /// Pulses of as many ticks as are asked for, or a little longer where that is what an interrupt makes; beyond that by
    /// two groups. And the times that follow.
    fn of(kind: Kind, configuration: &Configuration<'_>, merging: bool, shared: bool) -> (Spacing, Times) {
        let beside = configuration.motors().len() > 1;
        // What the interrupt makes without and with its flag, and the distance that takes.
        let ((short, apart), (extra, apart_extra), fall) = match kind {
            Kind::TwoOnD => ((16, APART_BESIDE), (16, APART_BESIDE), FALL),
            Kind::PortD | Kind::PortB => ((16, APART_SHORT), (31, APART_LONG), FALL),
            Kind::Shield => ((17, APART_SHIELD[0]), (31, APART_SHIELD[1]), FALL),
            Kind::Beside => ((PULSE_BESIDE, APART_BESIDE_MERGE), (PULSE_BESIDE, APART_BESIDE_MERGE), FALL_BESIDE),
            Kind::Compare => {
                let apart = if beside { APART_TWO_COMPARE } else { APART_BESIDE };
                ((35, apart), (35, apart), FALL_COMPARE)
            }
        };
        let wanted = configuration.pulse_ticks;
        let late = if merging || kind == Kind::TwoOnD { LATE_MOVED } else { LATE };
        let mut spacing = Spacing { extra: false, long: false, apart };
        let (mut pulse, mut made) = (0, short);
        if wanted > short {
            if wanted <= extra {
                (spacing.extra, spacing.apart, made) = (true, apart_extra, extra);
            } else {
                spacing.long = true;
                // Its first edge may be late, where the hardware does not make it; merged, its second may be early.
                let more = match kind {
                    Kind::Compare => 0,
                    _ if merging => late + apart,
                    _ => late,
                };
                pulse = (wanted + u16::from(more)).max(u16::from(apart));
                made = pulse;
            }
        }
        let apart = u16::from(spacing.apart);
        // The merge moves edges by half of that, either way; with a ring beside by 24 and 54.
        let slack = if merging { apart } else { 0 };
        let lead = configuration.setup_ticks + u16::from(fall + late) + slack;
        // An expansion counts the long pulse in 8 bits, and does not know the hardware's.
        let singly = spacing.long && (kind == Kind::Compare || pulse > 255);
        let fastest = if singly {
            u16::MAX
        } else if merging {
            apart
        } else {
            if beside { FASTEST[1] } else { FASTEST[0] }
        };
        let times = Times {
            limit: Tick32(0),
            gap: made + 1,
            keep: (made + configuration.hold_ticks + u16::from(late) + slack).max(apart),
            lead: lead.max(apart),
            early: lead.max(apart) + EARLY.max(apart),
            fastest: fastest.max(made.saturating_add(if spacing.long { apart } else { 0 })),
            pulse,
            most: if spacing.long { STEPS / 2 } else { STEPS },
            shared,
            only_steps: 0,
        };
        (spacing, times)
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

/// One ring and what is known of it; [`fill`](super::fill) knows the layout.
#[repr(C)]
pub(super) struct Track {
    pub(super) ring: Ring,
    /// Tick of the pending group.
    pub(super) at: Tick32,
    /// Ticks between two groups, at least.
    pub(super) apart: u8,
}

impl Track {
    const NONE: Track = Track { ring: Ring::NONE, at: Tick32(0), apart: 0 };

    /// The compare register, and the ring's bit in `TIMSK1` and `TIFR1`.
    #[inline(always)]
    fn compare(&self) -> (Reg16, u8) {
        match self.ring.name() {
            Name::A => (regs::OCR1A, 1 << 1),
            Name::B => (regs::OCR1B, 1 << 2),
        }
    }

    /// The next match is to be at `at`, or as soon as can be. Nothing may come between the time that is read and what is set by it.
    #[inline(never)]
    fn resume(&self, at: Option<Tick32>) {
        let (compare, bit) = self.compare();
        regs::free(|| {
            let at = at.map_or_else(|| clock::read().wrapping_add(AGAIN), |at| low_half(at.0));
            compare.write(at);
            regs::TIFR1.write(bit);
        });
        regs::free(|| {
            regs::GPIOR0.clear(self.ring.starved());
            regs::TIMSK1.set(bit);
        });
    }

    /// Looks whether the interrupt still plays what it should, and mends it.
    #[inline(never)]
    fn watch(&mut self, now: Tick32, busy: bool) -> Option<Trouble> {
        if regs::GPIOR0.read() & self.ring.starved() != 0 {
            let (compare, _) = self.compare();
            // The compare register still has the tick of the group that is next.
            let count = clock::read();
            let late = count.wrapping_sub(compare.read());
            if busy && late >= TOO_LATE {
                return Some(Trouble::Starved);
            }
            let empty = self.ring.is_empty();
            if empty && self.ring.waits_in_pulse() {
                return Some(Trouble::Starved);
            }
            if empty {
                // It counts from here on, not from when the round began.
                self.at = now.after(u32::from(count.wrapping_sub(low_half(now.0)).wrapping_add(LEAD)));
            }
            let at = empty.then_some(self.at);
            // The hardware has made the edge of the group that waits, and toggles no more. A plain step does not say that it does again: another
            // group follows it, or it becomes one that does.
            if empty && self.ring.waits_plainly() {
                self.push_nothing(self.at.after(u32::from(self.apart)));
            } else if !empty {
                self.ring.unplain();
            }
            self.resume(at);
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
        self.resume(None);
        (late != 0).then_some(Trouble::Late { ticks: late })
    }

    /// Whether no group is left to be played but fillers.
    #[inline(never)]
    fn is_idle(&self) -> bool {
        self.ring.is_idle()
    }
}

/// All motors; the assembly knows where they are.
#[unsafe(export_name = "steps_motors")]
static mut MOTORS: [Motor; MAX_MOTORS] = [const { Motor::NONE }; MAX_MOTORS];

/// All motors of a configuration, and their rings.
pub(crate) struct Stepper {
    pub(super) tracks: [Track; 2],
    /// The merge, from [`Stepper::begin`] on.
    merge: Option<&'static mut Merge>,
    /// The motors in use are the first ones.
    count: u8,
    /// Two motors or more in one ring, each with a DIR line of its own: the merge fills it.
    merging: bool,
    /// Each motor has a ring of its own.
    apiece: bool,
    /// One motor has a ring of its own beside the merge of the others.
    beside: bool,
    /// Its number ^ that of the last one: it changes places with that.
    swap: u8,
    /// Between [`Stepper::start`] and [`Stepper::stop`].
    playing: bool,
    spacing: Spacing,
    /// GPIOR0: see [`flags`].
    flags: u8,
    trouble: Option<Trouble>,
    /// When motors were stopped last. Not on the stack, which is short just then.
    halted: Tick32,
    /// How far ahead the rings were filled, ticks, at least.
    least_ahead: u16,
}

/// Where the distance of two groups of the first ring is.
pub(super) const APART: usize = offset_of!(Stepper, tracks) + offset_of!(Track, apart);

/// Where [`Stepper::swap`] is.
pub(super) const SWAP: usize = offset_of!(Stepper, swap);

/// Where [`Stepper::count`] is.
pub(super) const COUNT: usize = offset_of!(Stepper, count);

impl Stepper {
    /// No motors; zeros, which take no flash. [`Stepper::begin`] comes before its use.
    pub(crate) const fn new() -> Stepper {
        Stepper {
            tracks: [Track::NONE, Track::NONE],
            merge: None,
            count: 0,
            merging: false,
            apiece: false,
            beside: false,
            swap: 0,
            playing: false,
            spacing: Spacing::NONE,
            flags: 0,
            // `start` forgets it; it is zeros.
            trouble: Some(Trouble::Late { ticks: 0 }),
            halted: Tick32(0),
            least_ahead: 0,
        }
    }

    /// Takes the merge.
    ///
    /// # Safety
    /// Once in a program.
    pub(crate) unsafe fn begin(&mut self) {
        // SAFETY: the caller's promise.
        self.merge = Some(unsafe { Merge::take() });
        self.tracks[0].ring.alone();
        self.reset_measures();
    }

    /// How many motors are in use.
    pub(crate) fn count(&self) -> u8 {
        self.count
    }

    /// The motors in use.
    // The end of an iteration is worked out here, once for all loops: a product takes 22 bytes of the flash.
    #[inline(never)]
    fn motors(&self) -> slice::Iter<'_, Motor> {
        // SAFETY: only this stepper and the assembly that it calls use them; as long as this borrow lasts, neither does.
        unsafe { slice::from_raw_parts((&raw const MOTORS).cast(), usize::from(self.count)) }.iter()
    }

    /// The same, to be changed.
    #[inline(never)]
    fn motors_mut(&mut self) -> slice::IterMut<'_, Motor> {
        // SAFETY: as `motors`.
        unsafe { slice::from_raw_parts_mut((&raw mut MOTORS).cast(), usize::from(self.count)) }.iter_mut()
    }

    /// Whether a motor has a ring of its own beside a merge: the last of them all.
    #[inline(always)]
    fn is_beside(&self, slot: u8) -> bool {
        self.beside && slot + 1 == self.count
    }

    /// Whether any does.
    #[inline(always)]
    fn has_beside(&self) -> bool {
        self.beside
    }

    /// Where a motor is among all, by its number: the one beside a merge changes places with the last one.
    #[inline(always)]
    fn slot(&self, motor: u8) -> u8 {
        let (swap, last) = (self.swap, MAX_MOTORS as u8 - 1);
        if swap != 0 && (motor == last || motor == last ^ swap) { motor ^ swap } else { motor }
    }

    /// Where a motor is, by its number.
    #[inline(never)]
    fn place(&self, motor: u8) -> Option<NonNull<Motor>> {
        let motors = NonNull::new(&raw mut MOTORS)?.cast::<Motor>();
        let slot = self.slot(motor);
        // SAFETY: there are as many and more.
        (motor < self.count).then(|| unsafe { motors.add(usize::from(slot)) })
    }

    /// A motor by its number.
    #[inline(always)]
    pub(crate) fn motor(&self, motor: u8) -> Option<&Motor> {
        // SAFETY: as `motors`.
        self.place(motor).map(|motor| unsafe { motor.as_ref() })
    }

    /// The same, to be changed.
    #[inline(always)]
    pub(crate) fn motor_mut(&mut self, motor: u8) -> Option<&mut Motor> {
        // SAFETY: as `motors`.
        self.place(motor).map(|mut motor| unsafe { motor.as_mut() })
    }

    /// The number of a motor, by where it is.
    pub(crate) fn number_of(motor: &Motor) -> u8 {
        let (mut at, mut number) = ((&raw const MOTORS).cast::<Motor>(), 0);
        // Without a division: there are four at most.
        while number < MAX_MOTORS as u8 - 1 && !core::ptr::eq(at, motor) {
            (at, number) = (at.wrapping_add(1), number + 1);
        }
        number
    }

    /// The rings in use.
    #[inline(never)]
    fn tracks_mut(&mut self) -> slice::IterMut<'_, Track> {
        let count = if self.has_beside() {
            2
        } else if self.apiece {
            self.count
        } else {
            1
        };
        self.tracks.get_mut(..usize::from(count)).unwrap_or_default().iter_mut()
    }

    /// The ring of a motor.
    fn track(&self, motor: u8) -> &Track {
        let [first, second] = &self.tracks;
        if self.is_beside(self.slot(motor)) || self.apiece && motor != 0 { second } else { first }
    }

    /// The same, to be changed.
    fn track_mut(&mut self, motor: u8) -> &mut Track {
        let own = self.is_beside(self.slot(motor)) || self.apiece && motor != 0;
        let [first, second] = &mut self.tracks;
        if own { second } else { first }
    }

    /// Motors and lines of `configuration`; all motors at position 0. Not while it plays.
    #[inline(never)]
    pub(crate) fn configure(&mut self, layout: &Layout, configuration: &Configuration<'_>, now: Tick32) {
        self.motors().for_each(|motor| motor.lines.float());
        let kind = layout.kind;
        let motors = configuration.motors();
        let all = motors.len() as u8;
        let shared = layout.is_shared();
        self.apiece = matches!(kind, Kind::Compare | Kind::TwoOnD);
        self.merging = all > 1 && !self.apiece && !shared;
        let (spacing, times) = Spacing::of(kind, configuration, self.merging, shared);
        let singly = times.fastest == u16::MAX;
        self.spacing = spacing;
        TIMES.set(times);
        (self.beside, self.swap) = (kind == Kind::Beside, 0);
        let (always, extra) = match kind {
            Kind::Beside => (1 << flags::EXTRA_B | 1 << flags::BESIDE, 0),
            Kind::Shield => (1 << flags::EXTRA_A | 1 << flags::SHIELD, 1 << flags::SHIELD_LONG),
            Kind::PortB => (0, 1 << flags::EXTRA_B),
            Kind::PortD | Kind::TwoOnD => (1 << flags::B_ON_PORTD, 1 << flags::EXTRA_A),
            Kind::Compare => (0, 0),
        };
        self.flags = if spacing.extra { always | extra } else { always };
        let first = if kind == Kind::PortB { Name::B } else { Name::A };
        self.tracks[0].ring.plain(first);
        self.tracks[1].ring.second_on_portd();
        self.count = MAX_MOTORS as u8;
        self.motors_mut().for_each(|motor| *motor = Motor::NONE);
        self.count = all;
        // With one ring, and no lists, page B is free.
        let (mut queue, bytes) = memory::queue_memory(all == 1 || shared);
        for (index, setup) in (0u8..).zip(motors) {
            let mut lines = layout.lines(&setup);
            if kind == Kind::Compare {
                let track = self.track_mut(index);
                let (name, dir) = if setup.step_pin == 10 {
                    (Name::B, flags::DIR_B_ON_PORTB)
                } else {
                    (Name::A, flags::DIR_A_ON_PORTB)
                };
                let on_portb = setup.dir_pin >= 8;
                track.ring.hardware(name, on_portb);
                lines.step = track.ring.edge();
                self.flags |= u8::from(on_portb) << dir;
            }
            if kind == Kind::Beside && setup.step_pin >= 8 {
                // There are four.
                self.swap = index ^ (MAX_MOTORS as u8 - 1);
                self.tracks[1].ring.beside_lists();
            }
            lines.drive();
            let (start, end) = (queue, queue + memory::queue_len(bytes, all, setup.queue_parts));
            queue = end;
            if let Some(motor) = self.motor_mut(index) {
                motor.lines = lines;
                (motor.step, motor.dir) = (lines.step, lines.dir);
                motor.step_fall = if spacing.long { 0 } else { lines.step };
                motor.gain = setup.gain.clamp(-43, 18);
                motor.count = COUNT_AT_REST;
                (motor.start, motor.end, motor.next) = (start, end, start);
                motor.set(flag::SINGLY, shared || singly);
            }
        }
        if !self.apiece || all == 1 {
            self.tracks[0].ring.alone();
        }
        self.rest(now);
    }

    /// Begins to play, from a little after `now` on. Queues are empty.
    #[inline(never)]
    pub(crate) fn start(&mut self, now: Tick32) {
        let at = now.after(AHEAD / 2);
        // The lists of a merge begin with a filler each.
        let first = if self.merging { at.after(u32::from(FILLER)) } else { at };
        self.rest(first);
        if self.beside {
            // It has no list.
            self.motors_mut().next_back().into_iter().for_each(|motor| motor.rest(at));
        }
        self.trouble = None;
        regs::GPIOR0.write(self.flags);
        crate::engine::link::let_others_in();
        for motor in self.motors_mut() {
            let lines = motor.lines;
            motor.levels = lines.levels();
            let forward = (motor.levels & lines.dir != 0) == lines.forward_high();
            motor.set(flag::TURN, !forward);
        }
        let apart = self.spacing.apart;
        let beside = self.has_beside();
        let merged = self.count - u8::from(beside);
        if self.merging
            && let Some(merge) = &mut self.merge
        {
            merge.begin(self.tracks[0].ring.name(), merged, beside, apart, low_half(first.0));
        }
        for index in 0..self.count {
            let motor = self.motor(index);
            let step = motor.map_or(Group::NOTHING, |motor| Group { rise: motor.step, fall: motor.step_fall });
            self.track_mut(index).ring.serve(step);
        }
        for track in self.tracks_mut() {
            (track.at, track.apart) = (at, apart);
            track.ring.clear();
            track.resume(Some(at));
        }
        if self.has_beside() {
            self.tracks[1].apart = APART_OF_BESIDE;
            beside::set_motor(&raw mut MOTORS, self.count - 1);
        }
        self.playing = true;
        task::set_mode(match (self.merging, self.apiece || self.count == 1, self.count) {
            (true, ..) if self.has_beside() => mode::BESIDE,
            (true, ..) => mode::MERGE,
            (_, true, 1) => mode::APIECE,
            (_, true, _) => mode::BOTH,
            _ => mode::SHARED,
        });
    }

    /// What lists leave of their page is the program's from now on: see [`Merge::leave_room`]. It has just been started, with a merge.
    #[inline(always)]
    pub(crate) fn leave_room(&mut self) {
        if let Some(merge) = &mut self.merge {
            merge.leave_room();
        }
    }

    /// From now on the program's `source_limit` calls the merge, if there is one: [`mode::FILLED`].
    #[inline(always)]
    pub(crate) fn is_filled(&self) {
        if self.merging {
            task::set_mode(mode::FILLED);
        }
    }

    /// The immediate stop: plays no group more, and forgets all that was to come. A pulse that was begun still ends.
    ///
    /// Gives, bit by motor, whether it was going faster than `pull_in`; [`Stepper::halted`] when that was.
    #[inline(never)]
    pub(crate) fn stop(&mut self, pull_in: &[u32; MAX_MOTORS]) -> u8 {
        let mut uncertain = 0;
        self.playing = false;
        task::set_mode(mode::NONE);
        for track in self.tracks_mut() {
            regs::free(|| track.ring.halt());
        }
        // Here, and not when all is counted: what was due since then was not made.
        self.halted = clock::moment();
        for (index, slowest) in (0..self.count).zip(pull_in) {
            let left = self.unplayed(index, self.tail_of(index));
            let Some(motor) = self.motor_mut(index) else { break };
            let going = left != 0 || !motor.is_idle();
            let interval = motor.registers.next_tick().since(Tick32(motor.registers.tick));
            uncertain |= u8::from(going && interval < *slowest) << index;
            motor.uncount(left);
            motor.stop();
        }
        if Uses::LEASES {
            Lease::end();
        }
        // A pulse of two groups may be under way: its end is no group's any more.
        if self.spacing.long {
            for _ in 0..TIMES.get().pulse / 4 {
                regs::kick_watchdog();
            }
        }
        self.tracks_mut().for_each(|track| track.ring.clear());
        self.motors().for_each(|motor| motor.lines.rest());
        if let Some(merge) = &mut self.merge {
            merge.clear(0);
        }
        uncertain
    }

    /// When motors were [stopped](Stepper::stop) last: nothing that was due since then was made.
    #[inline(always)]
    pub(crate) fn halted(&self) -> Tick32 {
        self.halted
    }

    /// Notes that time goes on while nothing plays.
    pub(crate) fn rest(&mut self, now: Tick32) {
        let count = self.count;
        // The merge asks all four.
        self.count = MAX_MOTORS as u8;
        self.motors_mut().for_each(|motor| motor.rest(now));
        self.count = count;
    }

    /// Whether no motor's queue holds anything, of whatever epoch.
    pub(crate) fn is_empty(&self) -> bool {
        self.motors().all(Motor::is_empty)
    }

    /// Whether nothing is left to do: no event, no end of a pulse, no step in a ring, no end of a lease.
    pub(crate) fn is_idle(&self) -> bool {
        !(Uses::LEASES && Lease::get().state == lease::UNTIL)
            && self.motors().all(Motor::is_idle)
            && self.tracks[0].is_idle()
            && !((self.has_beside() || self.apiece && self.count > 1) && !self.tracks[1].is_idle())
            && !(self.merging && self.merge.as_ref().is_some_and(|merge| !merge.is_idle()))
    }

    /// The first tick at which a switch would be accepted.
    #[inline(never)]
    pub(crate) fn horizon(&self) -> Tick32 {
        if self.count == 0 { self.tracks[0].at.after(1) } else { self.first_open() }
    }

    /// All motors go over to `epoch` at `at`, which is not before the horizon; or none does, because a switch waits for an earlier tick.
    #[inline(always)]
    pub(crate) fn switch(&mut self, epoch: Epoch, at: Tick32) -> bool {
        switch::all(epoch, at)
    }

    /// Takes back what was pushed last of `epoch`, of all motors.
    pub(crate) fn discard(&mut self, epoch: Epoch) {
        self.motors_mut().for_each(|motor| motor.discard(epoch));
    }

    /// The epoch being run.
    pub(crate) fn epoch(&self) -> Epoch {
        self.motors().next().map_or(Epoch(0), Motor::epoch)
    }

    /// What went wrong in playing since this was asked last.
    pub(crate) fn trouble(&mut self) -> Option<Trouble> {
        self.trouble.take()
    }

    /// How far ahead the rings were filled, ticks, at least, while there was something to do.
    pub(crate) fn least_ahead(&self) -> u16 {
        self.least_ahead
    }

    /// [`Stepper::least_ahead`] begins anew.
    pub(crate) fn reset_measures(&mut self) {
        self.least_ahead = u16::MAX;
    }

    /// Where the ring of a motor is played: low byte of the address of the next group.
    pub(crate) fn tail_of(&self, motor: u8) -> u8 {
        self.track(motor).ring.tail()
    }

    /// Steps that a motor has made, forward minus backward, when its ring was played up to `tail`.
    #[inline(never)]
    pub(crate) fn position(&self, motor: u8, tail: u8) -> i32 {
        let unplayed = self.unplayed(motor, tail);
        let motor = self.motor(motor);
        motor.map_or(0, |motor| motor.planned().wrapping_sub(i32::from(unplayed)))
    }

    /// Steps of a motor that were counted but not played yet, forward minus backward, when its ring was played up to `tail`.
    #[inline(never)]
    fn unplayed(&self, number: u8, tail: u8) -> i16 {
        let Some(Motor { lines, levels, .. }) = self.motor(number) else { return 0 };
        let Lines { step, dir, .. } = *lines;
        let (mut levels, mut count) = (*levels, 0);
        if lines.step_low() {
            levels ^= step;
        }
        if !lines.forward_high() {
            levels ^= dir;
        }
        // What is in no ring yet comes after what is.
        let has_list = self.merging && !self.is_beside(self.slot(number));
        if has_list && let Some(merge) = &self.merge {
            let (ticks, Group { rise, fall }) = merge.listed(self.slot(number));
            if rise & step != 0 {
                let mut steps = i16::from(ticks);
                if fall == 0 {
                    // Every other tick ends a pulse, the last one does.
                    levels ^= if ticks & 1 == 0 { 0 } else { step };
                    steps /= 2;
                }
                count = if levels & dir != 0 { steps } else { -steps };
            } else if ticks != 0 {
                levels ^= fall & dir;
            }
        }
        count + i16::from(self.track(number).ring.unplayed(tail, levels, step, dir))
    }

    /// Looks whether the rings are played as they should, and mends it. To be called every millisecond.
    #[inline(never)]
    pub(crate) fn watch(&mut self, now: Tick32) {
        let busy = !self.is_idle();
        let mut trouble = None;
        let mut least = self.least_ahead;
        for track in self.tracks_mut() {
            trouble = track.watch(now, busy).or(trouble);
            let ahead = track.at.since(now);
            if busy && ahead >> 16 == 0 {
                least = least.min(low_half(ahead));
            }
        }
        self.least_ahead = least;
        self.trouble = trouble.or(self.trouble);
    }
}

/// As [`flags`](pulsetrain_core::wire::message::flags) has the faults of a motor.
pub(crate) fn faults(motor: &Motor) -> u8 {
    use super::motor::Reason;
    match motor.fault().map(|fault| fault.reason) {
        None => 0,
        Some(Reason::Missed | Reason::Dry) => message::flags::STEP_MISSED,
        Some(Reason::Mismatch) => message::flags::CHECK_FAILED,
        Some(Reason::Bad) => message::flags::BAD_ITEM,
    }
}
