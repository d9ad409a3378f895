//! The step generator: motors, rings, and which way a ring is filled.
//!
//! | motors | who fills the ring |
//! |---|---|
//! | one, or two on the compare hardware or on PORTD | each has a ring: [`one_motor`](super::one_motor) |
//! | two to four, each with a DIR line of its own | [`merge`](super::merge) |
//! | four on the shield (`Kind::ShieldTwoRings`) | [`merge`](super::merge), and for the motor on PORTB [`shield_b`](super::shield_b) |
//! | motors that share a DIR line | [`shared_dir`](super::shared_dir) |
//!
//! [`refill`] calls them.
//!
//! # Time
//! The newest group of a ring is pending: its tick is fixed, the group after it is not known yet. Groups are at least `spacing` ticks apart. An event that
//! would be nearer is put off, or joins the pending group.
//!
//! # DIR
//! A DIR line turns at the end of a group. That is after the pulse and hold time of every earlier step on that line, and a set-up time before its own
//! step. A planner must leave room for that ([`PulseTiming`]). If it did not, the step is not made.

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
use pulsetrain_core::{Epoch, Tick32};
use timing::PulseTiming;
pub(crate) use track::RingFault;
pub(super) use track::Track;

/// The longest of pulse, set-up and hold, ticks: less than a filler, so that no time before the last event matters.
pub(crate) const LONGEST: u16 = 4_096;
const _: () = assert!(LONGEST < FILLER);

mod timing;

mod track;

/// All motors; the assembly knows where they are.
#[unsafe(export_name = "steps_motors")]
static mut MOTORS: [Motor; MAX_MOTORS] = [const { Motor::NONE }; MAX_MOTORS];

/// The motors of a configuration, and their rings.
pub(crate) struct Stepper {
    pub(super) tracks: [Track; 2],
    /// The merge. [`Stepper::begin`] sets it.
    merge: Option<&'static mut Merge>,
    /// Motors in use: the first ones.
    count: u8,
    /// Two motors or more in one ring, each with a DIR line of its own. The merge fills it.
    merging: bool,
    /// Each motor has a ring of its own.
    own_rings: bool,
    /// The shield's motor on PORTB has a ring of its own, ring B. The others are merged.
    shield_b: bool,
    /// Number of that motor ^ number of the last: it changes places with the last one.
    swap: u8,
    /// Between [`Stepper::start`] and [`Stepper::stop`].
    playing: bool,
    timing: PulseTiming,
    /// GPIOR0: see [`flags`].
    flags: u8,
    fault: Option<RingFault>,
    /// When motors were stopped last. Not on the stack, of which little is left just then.
    halted: Tick32,
    /// The shortest time for which the rings were filled, ticks.
    least_ahead: u16,
}

/// Where the spacing of the first ring is, for assembly.
pub(super) const SPACING: usize = offset_of!(Stepper, tracks) + offset_of!(Track, spacing);

/// Where [`Stepper::swap`] is, for assembly.
pub(super) const SWAP: usize = offset_of!(Stepper, swap);

/// Where [`Stepper::count`] is, for assembly.
pub(super) const COUNT: usize = offset_of!(Stepper, count);

impl Stepper {
    /// Zeros, which take no flash. Call [`Stepper::begin`] before its use.
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
            // All zeros; `start` clears it.
            fault: Some(RingFault::Late { ticks: 0 }),
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
        self.tracks[0].ring.use_page_a();
        self.reset_measures();
    }

    /// How many motors are in use.
    pub(crate) fn count(&self) -> u8 {
        self.count
    }

    /// The motors in use.
    // Not inlined: the end of an iteration is a product, which takes 22 bytes of flash.
    #[inline(never)]
    fn motors(&self) -> slice::Iter<'_, Motor> {
        // SAFETY: only this stepper and the assembly that it calls use them, and neither does as long as this borrow lasts.
        unsafe { slice::from_raw_parts((&raw const MOTORS).cast(), usize::from(self.count)) }.iter()
    }

    /// The motors in use, to be changed.
    #[inline(never)]
    fn motors_mut(&mut self) -> slice::IterMut<'_, Motor> {
        // SAFETY: as `motors`.
        unsafe { slice::from_raw_parts_mut((&raw mut MOTORS).cast(), usize::from(self.count)) }.iter_mut()
    }

    /// Whether a motor has ring B of the shield: it is the last of them all.
    #[inline(always)]
    fn is_shield_b(&self, slot: u8) -> bool {
        self.shield_b && slot + 1 == self.count
    }

    /// Whether ring B of the shield is in use.
    #[inline(always)]
    fn has_shield_b(&self) -> bool {
        self.shield_b
    }

    /// The place of a motor, by its number: the one with ring B of the shield changes places with the last one.
    #[inline(always)]
    fn slot(&self, motor: u8) -> u8 {
        let (swap, last) = (self.swap, MAX_MOTORS as u8 - 1);
        if swap != 0 && (motor == last || motor == last ^ swap) { motor ^ swap } else { motor }
    }

    /// A pointer to a motor, by its number.
    #[inline(never)]
    fn place(&self, motor: u8) -> Option<NonNull<Motor>> {
        let motors = NonNull::new(&raw mut MOTORS)?.cast::<Motor>();
        let slot = self.slot(motor);
        // SAFETY: `count` is no more than there are.
        (motor < self.count).then(|| unsafe { motors.add(usize::from(slot)) })
    }

    /// A motor by its number.
    #[inline(always)]
    pub(crate) fn motor(&self, motor: u8) -> Option<&Motor> {
        // SAFETY: as `motors`.
        self.place(motor).map(|motor| unsafe { motor.as_ref() })
    }

    /// A motor by its number, to be changed.
    #[inline(always)]
    pub(crate) fn motor_mut(&mut self, motor: u8) -> Option<&mut Motor> {
        // SAFETY: as `motors`.
        self.place(motor).map(|mut motor| unsafe { motor.as_mut() })
    }

    /// The place of a motor.
    pub(crate) fn number_of(motor: &Motor) -> u8 {
        let (mut at, mut number) = ((&raw const MOTORS).cast::<Motor>(), 0);
        // A loop, since a division takes more flash.
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

    /// The ring of a motor, to be changed.
    fn track_mut(&mut self, motor: u8) -> &mut Track {
        let own = self.is_shield_b(self.slot(motor)) || self.own_rings && motor != 0;
        let [first, second] = &mut self.tracks;
        if own { second } else { first }
    }

    /// Sets up motors and lines of `configuration`. All motors are at position 0. Nothing may be playing.
    #[inline(never)]
    pub(crate) fn configure(&mut self, layout: &Layout, configuration: &Configuration<'_>, now: Tick32) {
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
        // One ring without lists leaves page B to the queues.
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
                // There are four motors.
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

    /// Starts the rings, a little after `now`. Queues are empty.
    #[inline(never)]
    pub(crate) fn start(&mut self, now: Tick32) {
        let at = now.after(LOOK_AHEAD / 2);
        // Each list of a merge begins with a filler.
        let first = if self.merging { at.after(u32::from(FILLER)) } else { at };
        self.rest(first);
        if self.shield_b {
            // Ring B has no list.
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
            let kinds = (shield_b, !self.timing.two_groups);
            merge.begin(self.tracks[0].ring.name(), merged, kinds, spacing, low_half(first.0));
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

    /// The program may use what lists leave of their page: see [`Merge::share_page`]. To be called right after [`Stepper::start`], with a merge.
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

    /// The immediate stop: plays no group more, and drops all plans. A pulse that has begun still ends.
    ///
    /// Gives, bit by motor, whether it was faster than `pull_in`. [`Stepper::halted`] is the time of the stop.
    #[inline(never)]
    pub(crate) fn stop(&mut self, pull_in: &[u32; MAX_MOTORS]) -> u8 {
        let mut uncertain = 0;
        self.playing = false;
        refill::set_mode(mode::NONE);
        for track in self.tracks_mut() {
            regs::critical(|| track.ring.halt());
        }
        // Now, and not after counting: no step that is due from now on was made.
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
        if ThisProgram::LEASES {
            CurrentLease::end();
        }
        // A pulse of two groups may have begun. No group ends it now, so wait for as long as it lasts.
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

    /// When motors were [stopped](Stepper::stop) last. No step that was due later was made.
    #[inline(always)]
    pub(crate) fn halted(&self) -> Tick32 {
        self.halted
    }

    /// Keeps the motors' times up to date while nothing plays.
    pub(crate) fn rest(&mut self, now: Tick32) {
        let count = self.count;
        // All four, since the merge asks all four.
        self.count = MAX_MOTORS as u8;
        self.motors_mut().for_each(|motor| motor.rest(now));
        self.count = count;
    }

    /// Whether all queues are empty, of all epochs.
    pub(crate) fn is_empty(&self) -> bool {
        self.motors().all(Motor::is_empty)
    }

    /// Whether nothing is left to do: no record, no end of a pulse, no step in a ring, no end of a lease.
    pub(crate) fn is_idle(&self) -> bool {
        !(ThisProgram::LEASES && CurrentLease::get().state == lease::UNTIL)
            && self.motors().all(Motor::is_idle)
            && self.tracks[0].is_idle()
            && !((self.has_shield_b() || self.own_rings && self.count > 1) && !self.tracks[1].is_idle())
            && !(self.merging && self.merge.as_ref().is_some_and(|merge| !merge.is_idle()))
    }

    /// The first tick at which a switch would be accepted.
    #[inline(never)]
    pub(crate) fn horizon(&self) -> Tick32 {
        if self.count == 0 { self.tracks[0].at.after(1) } else { self.first_changeable() }
    }

    /// All motors are to go over to `epoch` at `at`, which is not before the horizon. `false` if a switch waits for an earlier tick.
    #[inline(always)]
    pub(crate) fn switch(&mut self, epoch: Epoch, at: Tick32) -> bool {
        switch::all(epoch, at)
    }

    /// Drops what was pushed last of `epoch`, for all motors.
    pub(crate) fn discard(&mut self, epoch: Epoch) {
        self.motors_mut().for_each(|motor| motor.discard(epoch));
    }

    /// The epoch being run.
    pub(crate) fn epoch(&self) -> Epoch {
        self.motors().next().map_or(Epoch(0), Motor::epoch)
    }

    /// Takes the last fault of the rings.
    pub(crate) fn take_fault(&mut self) -> Option<RingFault> {
        self.fault.take()
    }

    /// The shortest time for which the rings were filled while there was something to do, ticks.
    pub(crate) fn least_ahead(&self) -> u16 {
        self.least_ahead
    }

    /// Resets [`Stepper::least_ahead`].
    pub(crate) fn reset_measures(&mut self) {
        self.least_ahead = u16::MAX;
    }

    /// Low byte of the address of the next group to be played in a motor's ring.
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

    /// Steps of a motor that are counted but were not played when its ring was played up to `tail`, forward minus backward.
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
        // What is still in a list comes after what is in the ring.
        let has_list = self.merging && !self.is_shield_b(self.slot(number));
        if has_list && let Some(merge) = &self.merge {
            let (ticks, Group { at_tick, at_end }) = merge.listed(self.slot(number));
            if at_tick & step != 0 {
                let mut steps = i16::from(ticks);
                if at_end == 0 {
                    // Every other tick ends a pulse, and the last tick does.
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

    /// Checks that the rings are played as they should, and repairs what is wrong. To be called every millisecond.
    #[inline(never)]
    pub(crate) fn watch(&mut self, now: Tick32) {
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

/// The faults of a motor, as [`flags`](pulsetrain_core::wire::message::flags) has them.
pub(crate) fn faults(motor: &Motor) -> u8 {
    use super::motor::FaultKind;
    match motor.fault().map(|fault| fault.kind) {
        None => 0,
        Some(FaultKind::Missed | FaultKind::Underrun) => message::flags::STEP_MISSED,
        Some(FaultKind::Mismatch) => message::flags::CHECK_FAILED,
        Some(FaultKind::Bad) => message::flags::BAD_ITEM,
    }
}
