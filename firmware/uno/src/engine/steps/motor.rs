//! One motor: a queue of packed bytes, the registers of the segment being run, and what it has promised so far.
//!
//! What is done once a switch or a fault is here; what is done for every record in [`load`](super::load), for every batch of
//! steps in [`plan`](super::plan). Those are assembly and know the layout of [`Motor`].
//!
//! The rules are those of `pulsetrain_core::channel::Channel`: ticks go up strictly, by at least the gap; a step that cannot be
//! made is not made, and what follows of its epoch is dropped; a step of the old epoch at a tick ≥ the switch's is not made.

use super::brake::state;
use super::pins::Lines;
use super::plan::FILLER;
use super::times::TIMES;
use crate::Uses;
use crate::engine::memory;
use crate::engine::program::Program;
use pulsetrain_core::avr::Registers;
use pulsetrain_core::{Direction, avr::verbs::StepRow};
use pulsetrain_core::{Epoch, Tick32};

/// How many epochs may wait behind the one being run: that of the switch that waits, and one that is to replace it.
pub(super) const PARTS: usize = 2;

/// Bytes of a motor's [`braking`](Motor::braking).
pub(super) const BRAKING: usize = if Uses::LEASES { 4 } else { 0 };

/// Previous count after a reset, as in `pulsetrain_core::packing`.
pub(crate) const COUNT_AT_REST: u16 = 4;

/// The longest interval of a step that verbs make, ticks: registers have 40 bits and a sign.
const LONGEST_INTERVAL: u32 = (1 << 23) - 1;

/// Bit of [`Motor::sure`]: bit 8 of whole ticks, and those above it, are the same of all intervals of the segment.
pub(crate) const EVEN: u8 = 0x80;

/// Bits of [`Motor::flags`], by number.
pub(crate) mod flag {
    /// The segment's steps go backward.
    pub(crate) const BACKWARD: u8 = 0;
    /// The DIR line does not say so yet.
    pub(crate) const TURN: u8 = 1;
    /// The last thing that was done was the step at the registers' tick: horizon, last and free follow from it.
    pub(crate) const STEPPED: u8 = 2;
    /// The accumulator means something.
    pub(crate) const ANCHORED: u8 = 3;
    /// No more of the epoch is read.
    pub(crate) const UNREADABLE: u8 = 4;
    /// DIR was turned for the next step, which is made whatever comes.
    pub(crate) const COMMITTED: u8 = 5;
    /// A switch waits.
    pub(crate) const SWITCH: u8 = 6;
    /// StepRow are to be looked at one by one: the line of DIR is shared, pulses are longer than an expansion makes them, or a group was put
    /// off.
    pub(crate) const SINGLY: u8 = 7;
}

/// Why steps of an epoch were not made; the numbers are the assembly's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Reason {
    /// An interval was too short, an item came too late, or a motion had no anchor.
    Missed = 1,
    /// A check found the motor elsewhere than the sender thought.
    Mismatch = 2,
    /// The bytes are no items, or say what does not fit.
    Bad = 3,
    /// With a lease: it had nothing more to do, and was not at rest.
    Dry = 4,
}

impl Reason {
    /// By its number; 0 is none.
    #[inline(always)]
    fn of(number: u8) -> Option<Reason> {
        match number {
            0 => None,
            1 => Some(Reason::Missed),
            2 => Some(Reason::Mismatch),
            4 if Uses::LEASES => Some(Reason::Dry),
            _ => Some(Reason::Bad),
        }
    }
}

/// What first went wrong in an epoch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fault {
    /// What.
    pub(crate) reason: Reason,
    /// Of the step that could not be made; otherwise the scheduled tick up to which all was well.
    pub(crate) tick: Tick32,
}

#[derive(Clone, Copy)]
#[repr(C)]
pub(super) struct Switch {
    pub(super) epoch: Epoch,
    pub(super) at: Tick32,
}

/// What waits of an epoch.
#[derive(Clone, Copy)]
#[repr(C)]
pub(super) struct Part {
    /// Bytes.
    pub(super) len: u16,
    pub(super) epoch: Epoch,
}

impl Part {
    const NONE: Part = Part { len: 0, epoch: Epoch(0) };
}

/// Room in a motor's queue. Bytes of it are nobody else's until they are said to be [`pushed`](Motor::pushed): where they go
/// stays the same, whatever is taken off the front meanwhile.
#[derive(Clone, Copy)]
pub(crate) struct Room {
    at: u16,
    start: u16,
    end: u16,
}

impl Room {
    /// Writes `bytes`, as many as there is room for.
    pub(crate) fn write(self, bytes: &[u8]) {
        memory::fill_queue(self.at, self.start, self.end, bytes);
    }
}

/// One motor. The first 64 bytes are the assembly's, which reaches them from a pointer.
#[repr(C)]
pub(crate) struct Motor {
    pub(crate) registers: Registers,
    /// StepRow of the segment before.
    pub(crate) count: u16,
    pub(crate) flags: u8,
    /// What a step toggles at its tick, and at the end of a short pulse: STEP, or 0 if the pulse is long.
    pub(crate) step: u8,
    pub(crate) step_fall: u8,
    pub(crate) dir: u8,
    /// The packing's gain.
    pub(crate) gain: i8,
    /// Address of the next byte of the queue.
    pub(crate) next: u16,
    /// The queue's memory.
    pub(crate) start: u16,
    pub(crate) end: u16,
    /// The first tick that is not promised to anything: switches are taken from here on, and steps made.
    pub(crate) horizon: Tick32,
    /// Of the last thing that was done: a step, a turn of DIR, or nothing.
    pub(crate) last: Tick32,
    /// DIR stays until then.
    pub(crate) free: Tick32,
    /// When it goes over: the tick of the switch that waits, or of the end of the lease.
    pub(crate) switch_at: Tick32,
    /// StepRow forward minus backward, those of the segment being run included.
    pub(crate) position: i32,
    /// The lower bits of it at the last anchor.
    pub(crate) origin: u16,
    /// The levels of STEP and DIR once all that was planned has been played.
    pub(crate) levels: u8,
    /// The next step's tick, where steps are looked at one by one.
    pub(crate) due: Tick32,
    /// More than zero: all intervals of the segment are those of [`plan`](super::plan)'s fast path, and shorter than 256 times
    /// this, ticks; at most 7.
    pub(crate) sure: u8,

    /// What waits of the epoch being run, and of those behind it.
    pub(super) parts: [Part; 1 + PARTS],
    /// How many there are behind it.
    pub(super) behind: u8,
    pub(super) switch: Switch,
    /// Why steps of the epoch were not made, as a [`Reason`], or 0.
    pub(super) reason: u8,
    /// [`Fault::tick`]. Before that, with a lease, the position at the last anchor, wait or reversal: no step has come after it if that is the position
    /// still.
    pub(super) fault_tick: Tick32,
    /// Whether `due` is known.
    pub(crate) is_due: bool,
    /// With leases, how it brakes: bits of [`state`], and the limit: mantissa, exponent and rest level. At zeros it rests after one step.
    pub(super) braking: [u8; BRAKING],
    pub(crate) lines: Lines,
}

impl Motor {
    /// None: it has no queue, and is never asked for anything but the time.
    pub(crate) const NONE: Motor = Motor {
        registers: Registers::new(),
        count: 0,
        flags: 0,
        step: 0,
        step_fall: 0,
        dir: 0,
        gain: 0,
        next: 0,
        start: 0,
        end: 0,
        horizon: Tick32(0),
        last: Tick32(0),
        free: Tick32(0),
        switch_at: Tick32(0),
        position: 0,
        origin: 0,
        levels: 0,
        due: Tick32(0),
        sure: 0,
        parts: [Part::NONE; 1 + PARTS],
        behind: 0,
        switch: Switch { epoch: Epoch(0), at: Tick32(0) },
        reason: 0,
        fault_tick: Tick32(0),
        is_due: false,
        braking: [0; BRAKING],
        lines: Lines::NONE,
    };

    #[inline(always)]
    pub(crate) fn has(&self, flag: u8) -> bool {
        self.flags & 1 << flag != 0
    }

    #[inline(always)]
    pub(crate) fn set(&mut self, flag: u8, on: bool) {
        if on {
            self.flags |= 1 << flag;
        } else {
            self.flags &= !(1 << flag);
        }
    }

    /// Bytes that the queue takes yet.
    #[inline(never)]
    pub(crate) fn room(&self) -> u16 {
        self.end - self.start - self.waiting()
    }

    /// Whether its queue holds nothing, of whatever epoch.
    pub(crate) fn is_empty(&self) -> bool {
        self.waiting() == 0
    }

    #[inline(never)]
    fn waiting(&self) -> u16 {
        if self.behind == 0 {
            return self.parts[0].len;
        }
        // There is nothing in those that are not used.
        self.parts.iter().map(|part| part.len).sum()
    }

    /// The epoch that was pushed last.
    #[inline(never)]
    fn newest(&mut self) -> &mut Part {
        &mut self.parts[usize::from(self.behind) % self.parts.len()]
    }

    /// Where `len` more bytes of `epoch` are to be written, if there is room for them: see [`Motor::pushed`].
    #[inline(never)]
    pub(crate) fn push(&mut self, epoch: Epoch, len: u16) -> Option<Room> {
        let waiting = self.waiting();
        let Motor { start, end, behind, .. } = *self;
        if len > end - start - waiting || (self.newest().epoch != epoch && usize::from(behind) == PARTS) {
            return None;
        }
        Some(Room { at: self.place(waiting), start, end })
    }

    /// They have been written: they are the motor's from now on.
    #[inline(never)]
    pub(crate) fn pushed(&mut self, epoch: Epoch, len: u16) {
        if self.newest().epoch != epoch {
            self.behind += 1;
            self.newest().epoch = epoch;
        }
        self.newest().len += len;
    }

    /// Takes back the bytes of `epoch` if they were pushed last. Not for the epoch being run.
    pub(crate) fn discard(&mut self, epoch: Epoch) {
        if self.behind != 0 && self.newest().epoch == epoch {
            *self.newest() = Part::NONE;
            self.behind -= 1;
        }
    }

    /// Where the byte `offset` behind the next one is.
    fn place(&self, offset: u16) -> u16 {
        let at = self.next + offset;
        if at >= self.end { at - (self.end - self.start) } else { at }
    }

    /// Horizon, last and free, if they were left to follow from the last step.
    #[inline(never)]
    pub(crate) fn settle(&mut self) {
        if self.has(flag::STEPPED) {
            self.set(flag::STEPPED, false);
            let tick = Tick32(self.registers.tick);
            let times = TIMES.get();
            self.last = tick;
            self.horizon = tick.after(u32::from(times.gap));
            self.free = tick.after(u32::from(times.keep));
        }
    }

    /// Nothing is planned before `now`: to be called while nothing is played, at least once in 2^30 ticks.
    #[inline(never)]
    pub(crate) fn rest(&mut self, now: Tick32) {
        self.settle();
        (self.horizon, self.last, self.free) = (now.after(1), now, now);
        self.is_due = false;
    }

    /// After a lapse, or a fault: what comes of the epoch being run is not kept.
    pub(crate) fn drops(&self, epoch: Epoch) -> bool {
        self.has(flag::UNREADABLE) && self.parts[0].epoch == epoch
    }

    /// The bits of its braking [`state`].
    #[inline(always)]
    fn braking(&self) -> u8 {
        self.braking.first().copied().unwrap_or(0)
    }

    #[inline(always)]
    fn set_braking(&mut self, state: u8) {
        if let Some(place) = self.braking.first_mut() {
            *place = state;
        }
    }

    /// Without steps, anchor and prediction; the direction is forward.
    fn restart(&mut self) {
        self.settle();
        self.uncount(0);
        let Registers { fraction, tick, .. } = self.registers;
        self.registers = Registers { fraction, tick, ..Registers::new() };
        self.count = COUNT_AT_REST;
        if self.has(flag::BACKWARD) {
            self.flags ^= 1 << flag::BACKWARD | 1 << flag::TURN;
        }
        self.set(flag::ANCHORED, false);
        self.set(flag::UNREADABLE, false);
        self.set_braking(0);
    }

    /// Forgets all that was to come. What was planned and never played is the caller's to take off the count: [`Motor::uncount`].
    #[inline(never)]
    pub(crate) fn stop(&mut self) {
        self.restart();
        self.set(flag::COMMITTED, false);
        self.set(flag::SWITCH, false);
        self.parts.iter_mut().for_each(|part| part.len = 0);
        (self.behind, self.is_due) = (0, false);
        self.next = self.start;
    }

    /// StepRow forward minus backward that were planned, played or not.
    pub(crate) fn planned(&self) -> i32 {
        let left = i32::from(self.registers.left);
        if self.has(flag::BACKWARD) { self.position.wrapping_add(left) } else { self.position.wrapping_sub(left) }
    }

    /// Takes steps that were planned and not played off the count. The rest of the segment is dropped.
    pub(crate) fn uncount(&mut self, steps: i16) {
        self.position = self.planned().wrapping_sub(i32::from(steps));
        self.registers.left = 0;
    }

    /// Takes on steps that come after all it has done: as a record of the queue would have it, with an anchor before it.
    #[inline(never)]
    pub(crate) fn follow(&mut self, steps: &StepRow) {
        // One step alone may be further away than registers reach; from where its interval counts does not matter.
        let StepRow { first, count, .. } = *steps;
        let period = steps.period.min(LONGEST_INTERVAL);
        let backward = steps.direction == Direction::Backward;
        let turns = backward != self.has(flag::BACKWARD);
        // What follows from the step before must be known if it turns round, or if there is room for a filler before this.
        if turns || first.since(Tick32(self.registers.tick)) >= u32::from(FILLER) {
            self.settle();
        }
        if turns {
            self.flags ^= 1 << flag::BACKWARD | 1 << flag::TURN;
        }
        self.set(flag::ANCHORED, true);
        let [p0, p1, p2, _] = period.to_le_bytes();
        self.registers = Registers {
            fraction: 0x8000,
            tick: first.before(period).0,
            interval_low: u32::from_le_bytes([0, 0, p0, p1]),
            interval_high: p2,
            left: count,
            ..Registers::new()
        };
        self.sure = 0;
        let moved = i32::from(count);
        self.position = self.position.wrapping_add(if backward { -moved } else { moved });
    }

    /// Whether there is nothing to do, now or later, unless more is pushed.
    #[inline(never)]
    pub(crate) fn is_idle(&self) -> bool {
        self.registers.left == 0
            && self.flags & (1 << flag::SWITCH | 1 << flag::COMMITTED) == 0
            && (self.has(flag::UNREADABLE) || self.parts[0].len == 0)
            && self.braking() & 1 << state::BRAKES == 0
    }

    /// The epoch being run.
    pub(crate) fn epoch(&self) -> Epoch {
        self.parts[0].epoch
    }

    /// What first went wrong in it.
    pub(crate) fn fault(&self) -> Option<Fault> {
        Reason::of(self.reason).map(|reason| Fault { reason, tick: self.fault_tick })
    }

    #[inline(never)]
    fn fail(&mut self, reason: u8, tick: Tick32) {
        if self.reason == 0 {
            (self.reason, self.fault_tick) = (reason, tick);
        }
        self.uncount(0);
        self.set(flag::ANCHORED, false);
        // After a mismatch, an anchor would do; there is none but at the front of an epoch.
        self.set(flag::UNREADABLE, true);
    }
}

/// A step cannot be made, or a record not be read, for a [`Reason`].
#[unsafe(no_mangle)]
extern "C" fn steps_fail(motor: &mut Motor, reason: u8, tick: u32) {
    motor.fail(reason, Tick32(tick));
}
