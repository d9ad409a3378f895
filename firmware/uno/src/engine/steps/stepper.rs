//! The step generator: rings, motors, and who fills what.
//!
//! | motors | who fills |
//! |---|---|
//! | one, or two on the compare hardware or on PORTD | each its own ring: [`fill`](super::one_motor) |
//! | two to four with DIR lines of their own | the merge: [`merge`](super::merge) |
//! | `Kind::ShieldTwoRings` | the merge, and for the motor on PORTB [`beside`](super::shield_b) |
//! | motors that share a DIR line | one step after the other: [`shared`](super::shared_dir) |
//!
//! [`task`] calls them.
//!
//! # Time
//! The newest group of a ring is pending: its tick is fixed, what follows is not. Groups are at least `spacing` ticks from each
//! other; what would be nearer is put off, or joins the group that is there.
//!
//! # DIR
//! A DIR line toggles at the end of a group, after the pulse and hold of every step before that looked at the line, and its
//! set-up before the step that it is for. Planners leave room for that ([`PulseTiming`]); where they did not, the step is not made.

use crate::ThisProgram;
use crate::engine::clock::low_half;
use crate::engine::program::Program;
use crate::engine::steps::brake::{CurrentLease, lease};
use crate::engine::steps::merge::Merge;
use crate::engine::steps::motor::{COUNT_AT_REST, Motor, flag};
use crate::engine::steps::pins::{Kind, Layout, Lines, MAX_MOTORS};
use crate::engine::steps::plan::FILLER;
use crate::engine::steps::refill::mode;
use crate::engine::steps::ring::{Group, RingName, flags};
use crate::engine::steps::times::TIMES;
use crate::engine::steps::{refill, shield_b, switch};
use crate::engine::tuning::stepper::{LOOK_AHEAD, SPACING_SHIELD_B};
use crate::engine::{clock, memory, regs};
use core::mem::offset_of;
use core::ptr::NonNull;
use core::slice;
use pulsetrain_core::wire::message;
use pulsetrain_core::wire::message::Configuration;
use pulsetrain_core::{Epoch, Moment};
use timing::PulseTiming;
pub(crate) use track::RingFault;
pub(super) use track::Track;

/// The longest of pulse, set-up and hold, ticks: less than a filler, so that what is past need not be remembered longer.
pub(crate) const LONGEST: u16 = 4_096;

mod timing;

mod track;

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
    own_rings: bool,
    /// One motor has a ring of its own beside the merge of the others.
    shield_b: bool,
    /// Its number ^ that of the last one: it changes places with that.
    swap: u8,
    /// Between [`Stepper::start`] and [`Stepper::stop`].
    playing: bool,
    timing: PulseTiming,
    /// GPIOR0: see [`flags`].
    flags: u8,
    fault: Option<RingFault>,
    /// When motors were stopped last. Not on the stack, which is short just then.
    halted: Moment,
    /// How far ahead the rings were filled, ticks, at least.
    least_ahead: u16,
}

/// Where the distance of two groups of the first ring is.
pub(super) const SPACING: usize = offset_of!(Stepper, tracks) + offset_of!(Track, spacing);

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
            own_rings: false,
            shield_b: false,
            swap: 0,
            playing: false,
            timing: PulseTiming::NONE,
            flags: 0,
            // `start` forgets it; it is zeros.
            fault: Some(RingFault::Late { ticks: 0 }),
            halted: Moment(0),
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
        self.tracks[0].ring.use_page_a();
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
    fn is_shield_b(&self, slot: u8) -> bool {
        self.shield_b && slot + 1 == self.count
    }

    /// Whether any does.
    #[inline(always)]
    fn has_shield_b(&self) -> bool {
        self.shield_b
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
        let count = if self.has_shield_b() {
            2
        } else if self.own_rings {
            self.count
        } else {
            1
        };
        self.tracks.get_mut(..usize::from(count)).unwrap_or_default().iter_mut()
    }

    /// The ring of a motor.
    fn track(&self, motor: u8) -> &Track {
        let [first, second] = &self.tracks;
        if self.is_shield_b(self.slot(motor)) || self.own_rings && motor != 0 { second } else { first }
    }

    /// The same, to be changed.
    fn track_mut(&mut self, motor: u8) -> &mut Track {
        let own = self.is_shield_b(self.slot(motor)) || self.own_rings && motor != 0;
        let [first, second] = &mut self.tracks;
        if own { second } else { first }
    }

    /// Motors and lines of `configuration`; all motors at position 0. Not while it plays.
    #[inline(never)]
    pub(crate) fn configure(&mut self, layout: &Layout, configuration: &Configuration<'_>, now: Moment) {
        self.motors().for_each(|motor| motor.lines.float());
        let kind = layout.kind;
        let motors = configuration.motors();
        let all = motors.len() as u8;
        let shared = layout.is_shared();
        self.own_rings = matches!(kind, Kind::Compare | Kind::PortDTwoRings);
        self.merging = all > 1 && !self.own_rings && !shared;
        let (timing, times) = PulseTiming::of(kind, configuration, self.merging, shared);
        let singly = times.min_interval == u16::MAX;
        self.timing = timing;
        TIMES.set(times);
        (self.shield_b, self.swap) = (kind == Kind::ShieldTwoRings, 0);
        let (always, stretched) = match kind {
            Kind::ShieldTwoRings => (1 << flags::NOT_PLAIN_B | 1 << flags::SHIELD_B, 0),
            Kind::Shield => (1 << flags::NOT_PLAIN_A | 1 << flags::SHIELD, 1 << flags::SHIELD_STRETCHED),
            Kind::PortB => (0, 1 << flags::NOT_PLAIN_B),
            Kind::PortD | Kind::PortDTwoRings => (1 << flags::B_ON_PORTD, 1 << flags::NOT_PLAIN_A),
            Kind::Compare => (0, 0),
        };
        self.flags = if timing.stretched { always | stretched } else { always };
        let first = if kind == Kind::PortB { RingName::B } else { RingName::A };
        self.tracks[0].ring.software(first);
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
                    (RingName::B, flags::DIR_B_ON_PORTB)
                } else {
                    (RingName::A, flags::DIR_A_ON_PORTB)
                };
                let on_portb = setup.dir_pin >= 8;
                track.ring.hardware(name, on_portb);
                lines.step = track.ring.compare_bit();
                self.flags |= u8::from(on_portb) << dir;
            }
            if kind == Kind::ShieldTwoRings && setup.step_pin >= 8 {
                // There are four.
                self.swap = index ^ (MAX_MOTORS as u8 - 1);
                self.tracks[1].ring.after_lists();
            }
            lines.drive();
            let (start, end) = (queue, queue + memory::queue_len(bytes, all, setup.queue_parts));
            queue = end;
            if let Some(motor) = self.motor_mut(index) {
                motor.lines = lines;
                (motor.step, motor.dir) = (lines.step, lines.dir);
                motor.step_end = if timing.two_groups { 0 } else { lines.step };
                motor.gain = setup.gain.clamp(-43, 18);
                motor.count = COUNT_AT_REST;
                (motor.start, motor.end, motor.next) = (start, end, start);
                motor.set(flag::SINGLY, shared || singly);
            }
        }
        if !self.own_rings || all == 1 {
            self.tracks[0].ring.use_page_a();
        }
        self.rest(now);
    }

    /// Begins to play, from a little after `now` on. Queues are empty.
    #[inline(never)]
    pub(crate) fn start(&mut self, now: Moment) {
        let at = now.after(LOOK_AHEAD / 2);
        // The lists of a merge begin with a filler each.
        let first = if self.merging { at.after(u32::from(FILLER)) } else { at };
        self.rest(first);
        if self.shield_b {
            // It has no list.
            self.motors_mut().next_back().into_iter().for_each(|motor| motor.rest(at));
        }
        self.fault = None;
        regs::GPIOR0.write(self.flags);
        crate::engine::link::nest_again();
        for motor in self.motors_mut() {
            let lines = motor.lines;
            motor.levels = lines.levels();
            let forward = (motor.levels & lines.dir != 0) == lines.forward_high();
            motor.set(flag::TURN, !forward);
        }
        let spacing = self.timing.spacing;
        let shield_b = self.has_shield_b();
        let merged = self.count - u8::from(shield_b);
        if self.merging
            && let Some(merge) = &mut self.merge
        {
            merge.begin(self.tracks[0].ring.name(), merged, shield_b, spacing, low_half(first.0));
        }
        for index in 0..self.count {
            let motor = self.motor(index);
            let step = motor.map_or(Group::NOTHING, |motor| Group { at_tick: motor.step, at_end: motor.step_end });
            self.track_mut(index).ring.set_step(step);
        }
        for track in self.tracks_mut() {
            (track.at, track.spacing) = (at, spacing);
            track.ring.clear();
            track.resume(Some(at));
        }
        if self.has_shield_b() {
            self.tracks[1].spacing = SPACING_SHIELD_B;
            shield_b::set_motor(&raw mut MOTORS, self.count - 1);
        }
        self.playing = true;
        refill::set_mode(match (self.merging, self.own_rings || self.count == 1, self.count) {
            (true, ..) if self.has_shield_b() => mode::MERGE_AND_B,
            (true, ..) => mode::MERGE,
            (_, true, 1) => mode::ONE_RING,
            (_, true, _) => mode::TWO_RINGS,
            _ => mode::SHARED,
        });
    }

    /// What lists leave of their page is the program's from now on: see [`Merge::share_page`]. It has just been started, with a merge.
    #[inline(always)]
    pub(crate) fn share_list_page(&mut self) {
        if let Some(merge) = &mut self.merge {
            merge.share_page();
        }
    }

    /// From now on the program's `source_limit` calls the merge, if there is one: [`mode::MERGED_BY_SOURCE`].
    #[inline(always)]
    pub(crate) fn merge_by_source(&self) {
        if self.merging {
            refill::set_mode(mode::MERGED_BY_SOURCE);
        }
    }

    /// The immediate stop: plays no group more, and forgets all that was to come. A pulse that was begun still ends.
    ///
    /// Gives, bit by motor, whether it was going faster than `pull_in`; [`Stepper::halted`] when that was.
    #[inline(never)]
    pub(crate) fn stop(&mut self, pull_in: &[u32; MAX_MOTORS]) -> u8 {
        let mut uncertain = 0;
        self.playing = false;
        refill::set_mode(mode::NONE);
        for track in self.tracks_mut() {
            regs::critical(|| track.ring.halt());
        }
        // Here, and not when all is counted: what was due since then was not made.
        self.halted = clock::moment();
        for (index, slowest) in (0..self.count).zip(pull_in) {
            let left = self.unplayed(index, self.tail_of(index));
            let Some(motor) = self.motor_mut(index) else { break };
            let going = left != 0 || !motor.is_idle();
            let interval = motor.registers.next_tick().since(Moment(motor.registers.tick));
            uncertain |= u8::from(going && interval < *slowest) << index;
            motor.uncount(left);
            motor.stop();
        }
        if ThisProgram::LEASES {
            CurrentLease::end();
        }
        // A pulse of two groups may be under way: its end is no group's any more.
        if self.timing.two_groups {
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
    pub(crate) fn halted(&self) -> Moment {
        self.halted
    }

    /// Notes that time goes on while nothing plays.
    pub(crate) fn rest(&mut self, now: Moment) {
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
        !(ThisProgram::LEASES && CurrentLease::get().state == lease::UNTIL)
            && self.motors().all(Motor::is_idle)
            && self.tracks[0].is_idle()
            && !((self.has_shield_b() || self.own_rings && self.count > 1) && !self.tracks[1].is_idle())
            && !(self.merging && self.merge.as_ref().is_some_and(|merge| !merge.is_idle()))
    }

    /// The first tick at which a switch would be accepted.
    #[inline(never)]
    pub(crate) fn horizon(&self) -> Moment {
        if self.count == 0 { self.tracks[0].at.after(1) } else { self.first_changeable() }
    }

    /// All motors go over to `epoch` at `at`, which is not before the horizon; or none does, because a switch waits for an earlier tick.
    #[inline(always)]
    pub(crate) fn switch(&mut self, epoch: Epoch, at: Moment) -> bool {
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
    pub(crate) fn take_fault(&mut self) -> Option<RingFault> {
        self.fault.take()
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
        let has_list = self.merging && !self.is_shield_b(self.slot(number));
        if has_list && let Some(merge) = &self.merge {
            let (ticks, Group { at_tick, at_end }) = merge.listed(self.slot(number));
            if at_tick & step != 0 {
                let mut steps = i16::from(ticks);
                if at_end == 0 {
                    // Every other tick ends a pulse, the last one does.
                    levels ^= if ticks & 1 == 0 { 0 } else { step };
                    steps /= 2;
                }
                count = if levels & dir != 0 { steps } else { -steps };
            } else if ticks != 0 {
                levels ^= at_end & dir;
            }
        }
        count + i16::from(self.track(number).ring.unplayed(tail, levels, step, dir))
    }

    /// Looks whether the rings are played as they should, and mends it. To be called every millisecond.
    #[inline(never)]
    pub(crate) fn watch(&mut self, now: Moment) {
        let busy = !self.is_idle();
        let mut fault = None;
        let mut least = self.least_ahead;
        for track in self.tracks_mut() {
            fault = track.watch(now, busy).or(fault);
            let ahead = track.at.since(now);
            if busy && ahead >> 16 == 0 {
                least = least.min(low_half(ahead));
            }
        }
        self.least_ahead = least;
        self.fault = fault.or(self.fault);
    }
}

/// As [`flags`](pulsetrain_core::wire::message::flags) has the faults of a motor.
pub(crate) fn faults(motor: &Motor) -> u8 {
    use super::motor::FaultKind;
    match motor.fault().map(|fault| fault.kind) {
        None => 0,
        Some(FaultKind::Missed | FaultKind::Underrun) => message::flags::STEP_MISSED,
        Some(FaultKind::Mismatch) => message::flags::CHECK_FAILED,
        Some(FaultKind::Bad) => message::flags::BAD_ITEM,
    }
}
