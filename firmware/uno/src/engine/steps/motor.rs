//! One motor: a queue of packed bytes, the registers of the segment being run, and how far it is planned.
//!
//! What happens once a switch or a fault is here. What happens for every record is in [`load`](super::load), for every batch of steps in
//! [`plan`](super::plan); those are assembly, and know the layout of [`Motor`].
//!
//! The rules are those of `pulsetrain_core::channel::Channel`. Ticks of steps go up, by the step gap at least. If a step is too early it is not made,
//! and the rest of its epoch is dropped. A step of the old epoch at the switch's tick, or later, is not made.

use super::brake::state;
use super::pins::Lines;
use super::plan::FILLER;
use super::times::TIMES;
use crate::ThisProgram;
use crate::engine::memory;
use crate::engine::program::Program;
use pulsetrain_core::avr::Registers;
use pulsetrain_core::{Direction, avr::verbs::Steps};
use pulsetrain_core::{Epoch, Tick32};

/// How many epochs may wait after the one being run: that of the switch that waits, and one that is to replace it.
pub(super) const WAITING_EPOCHS: usize = 2;

// The assembly reaches offsets 0 to 63 from Y.
const _: () = assert!(core::mem::offset_of!(Motor, prechecked) < 64);

/// Bytes of a motor's [`braking`](Motor::braking).
pub(super) const BRAKING: usize = if ThisProgram::LEASES { 4 } else { 0 };

/// Previous count after a reset, as in `pulsetrain_core::packing`.
pub(crate) const COUNT_AT_REST: u16 = 4;

/// The longest interval of an order's steps, ticks: registers have 40 bits and a sign, 16 bits of them fractions.
const LONGEST_INTERVAL: u32 = (1 << 23) - 1;

/// Bit of [`Motor::prechecked`]: all intervals of the segment have the same bits 8 and above of whole ticks.
pub(crate) const HIGH_FIXED: u8 = 0x80;

/// Bits of [`Motor::flags`], by number.
pub(crate) mod flag {
    /// The steps of the segment go backward.
    pub(crate) const BACKWARD: u8 = 0;
    /// The DIR line still has the level for the other direction.
    pub(crate) const TURN: u8 = 1;
    /// The last event was the step at the registers' tick. `horizon`, `last` and `dir_free` must still be worked out from it ([`Motor::settle`]).
    pub(crate) const STEPPED: u8 = 2;
    /// The registers' tick is valid: there was an anchor.
    pub(crate) const ANCHORED: u8 = 3;
    /// The rest of the epoch is not read.
    pub(crate) const UNREADABLE: u8 = 4;
    /// DIR was turned for the next step, so that step will be made in any case.
    pub(crate) const COMMITTED: u8 = 5;
    /// A switch waits.
    pub(crate) const SWITCH: u8 = 6;
    /// Steps are planned one by one: a DIR line is shared, or pulses are too long for an expansion, or a group was put off.
    pub(crate) const SINGLY: u8 = 7;
}

/// Why steps of an epoch were not made. The assembly has these numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum FaultKind {
    /// An interval was too short, a record came too late, or a motion had no anchor.
    Missed = 1,
    /// A check found another position than the sender's.
    Mismatch = 2,
    /// The bytes are no records.
    Bad = 3,
    /// With a lease: an underrun of the queue while the motor was not at rest.
    Underrun = 4,
}

impl FaultKind {
    /// By its number; 0 is none.
    #[inline(always)]
    fn of(number: u8) -> Option<FaultKind> {
        match number {
            0 => None,
            1 => Some(FaultKind::Missed),
            2 => Some(FaultKind::Mismatch),
            4 if ThisProgram::LEASES => Some(FaultKind::Underrun),
            _ => Some(FaultKind::Bad),
        }
    }
}

/// The first fault of an epoch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fault {
    /// Why.
    pub(crate) kind: FaultKind,
    /// The tick of the step that could not be made, or up to which all was well.
    pub(crate) tick: Tick32,
}

#[derive(Clone, Copy)]
#[repr(C)]
pub(super) struct Switch {
    pub(super) epoch: Epoch,
    pub(super) at: Tick32,
}

/// Bytes of an epoch in the queue.
#[derive(Clone, Copy)]
#[repr(C)]
pub(super) struct EpochBytes {
    /// How many.
    pub(super) len: u16,
    pub(super) epoch: Epoch,
}

impl EpochBytes {
    const NONE: EpochBytes = EpochBytes { len: 0, epoch: Epoch(0) };
}

/// Room in a motor's queue, for bytes that become the motor's with [`pushed`](Motor::pushed). The address stays the same if the motor takes bytes off the
/// other end meanwhile.
#[derive(Clone, Copy)]
pub(crate) struct Room {
    at: u16,
    start: u16,
    end: u16,
}

impl Room {
    /// Writes `bytes`, for which the room was asked.
    pub(crate) fn write(self, bytes: &[u8]) {
        memory::fill_queue(self.at, self.start, self.end, bytes);
    }
}

/// One motor. The assembly reaches the first 64 bytes from a pointer.
#[repr(C)]
pub(crate) struct Motor {
    pub(crate) registers: Registers,
    /// Count of steps of the previous segment, from which the next is predicted.
    pub(crate) count: u16,
    pub(crate) flags: u8,
    /// What a step toggles at its tick, and at the end of a short pulse: STEP, or 0 if the pulse is long.
    pub(crate) step: u8,
    pub(crate) step_end: u8,
    pub(crate) dir: u8,
    /// The gain of the packing.
    pub(crate) gain: i8,
    /// Address of the next byte of the queue.
    pub(crate) next: u16,
    /// The queue's memory.
    pub(crate) start: u16,
    pub(crate) end: u16,
    /// The first tick that is not planned: a switch or a step may come there, not before.
    pub(crate) horizon: Tick32,
    /// The tick of the last event: a step, a turn of DIR, or a filler.
    pub(crate) last: Tick32,
    /// DIR may not turn before this tick.
    pub(crate) dir_free: Tick32,
    /// The tick of the switch that waits, or of the end of the lease.
    pub(crate) switch_at: Tick32,
    /// Steps forward minus backward, with all steps of the segment being run.
    pub(crate) position: i32,
    /// The lower bits of the position at the last anchor.
    pub(crate) origin: u16,
    /// The levels of STEP and DIR when all that is planned has been played.
    pub(crate) levels: u8,
    /// The tick of the next step, where motors share DIR lines.
    pub(crate) due: Tick32,
    /// Not 0: when the segment was loaded all its intervals were checked. They are long enough for batches, and shorter than 256 times this, ticks; at most
    /// 7. Its steps need no other check.
    pub(crate) prechecked: u8,

    /// Bytes of the epoch being run, and of those that wait.
    pub(super) epochs: [EpochBytes; 1 + WAITING_EPOCHS],
    /// How many epochs wait.
    pub(super) waiting_epochs: u8,
    pub(super) switch: Switch,
    /// Why steps of the epoch were not made, a [`FaultKind`], or 0.
    pub(super) fault_kind: u8,
    /// [`Fault::tick`]. Before a fault, with a lease: the position at the last anchor, wait or reversal. If that is still the position, the motor has made no
    /// step since it was at rest.
    pub(super) fault_tick: Tick32,
    /// Whether `due` is known.
    pub(crate) is_due: bool,
    /// With leases, how it brakes: bits of [`state`], and the limit as mantissa, exponent and rest level. With zeros it is at rest after one step.
    pub(super) braking: [u8; BRAKING],
    pub(crate) lines: Lines,
}

impl Motor {
    /// No motor: without a queue. It is only asked for the time.
    pub(crate) const NONE: Motor = Motor {
        registers: Registers::new(),
        count: 0,
        flags: 0,
        step: 0,
        step_end: 0,
        dir: 0,
        gain: 0,
        next: 0,
        start: 0,
        end: 0,
        horizon: Tick32(0),
        last: Tick32(0),
        dir_free: Tick32(0),
        switch_at: Tick32(0),
        position: 0,
        origin: 0,
        levels: 0,
        due: Tick32(0),
        prechecked: 0,
        epochs: [EpochBytes::NONE; 1 + WAITING_EPOCHS],
        waiting_epochs: 0,
        switch: Switch { epoch: Epoch(0), at: Tick32(0) },
        fault_kind: 0,
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

    /// Free bytes of the queue.
    #[inline(never)]
    pub(crate) fn room(&self) -> u16 {
        self.end - self.start - self.waiting()
    }

    /// Whether its queue is empty, of all epochs.
    pub(crate) fn is_empty(&self) -> bool {
        self.waiting() == 0
    }

    #[inline(never)]
    fn waiting(&self) -> u16 {
        if self.waiting_epochs == 0 {
            return self.epochs[0].len;
        }
        // Epochs that are not used have no bytes.
        self.epochs.iter().map(|part| part.len).sum()
    }

    /// The epoch that was pushed last.
    #[inline(never)]
    fn newest(&mut self) -> &mut EpochBytes {
        &mut self.epochs[usize::from(self.waiting_epochs) % self.epochs.len()]
    }

    /// Room for `len` bytes of `epoch`, if there is: see [`Motor::pushed`].
    #[inline(never)]
    pub(crate) fn push(&mut self, epoch: Epoch, len: u16) -> Option<Room> {
        let waiting = self.waiting();
        let Motor { start, end, waiting_epochs, .. } = *self;
        if len > end - start - waiting
            || (self.newest().epoch != epoch && usize::from(waiting_epochs) == WAITING_EPOCHS)
        {
            return None;
        }
        Some(Room { at: self.place(waiting), start, end })
    }

    /// The bytes have been written: the motor may read them from now on.
    #[inline(never)]
    pub(crate) fn pushed(&mut self, epoch: Epoch, len: u16) {
        if self.newest().epoch != epoch {
            self.waiting_epochs += 1;
            self.newest().epoch = epoch;
        }
        self.newest().len += len;
    }

    /// Drops the bytes of `epoch`, if they were pushed last. The epoch being run is not dropped.
    pub(crate) fn discard(&mut self, epoch: Epoch) {
        if self.waiting_epochs != 0 && self.newest().epoch == epoch {
            *self.newest() = EpochBytes::NONE;
            self.waiting_epochs -= 1;
        }
    }

    /// The address of a byte, `offset` after the next one.
    fn place(&self, offset: u16) -> u16 {
        let at = self.next + offset;
        if at >= self.end { at - (self.end - self.start) } else { at }
    }

    /// Works out `horizon`, `last` and `dir_free` from the last step, if that was left to do.
    #[inline(never)]
    pub(crate) fn settle(&mut self) {
        if self.has(flag::STEPPED) {
            self.set(flag::STEPPED, false);
            let tick = Tick32(self.registers.tick);
            let times = TIMES.get();
            self.last = tick;
            self.horizon = tick.after(u32::from(times.step_gap));
            self.dir_free = tick.after(u32::from(times.dir_hold));
        }
    }

    /// Nothing is planned before `now`. To be called while nothing is played, at least once in 2^30 ticks.
    #[inline(never)]
    pub(crate) fn rest(&mut self, now: Tick32) {
        self.settle();
        (self.horizon, self.last, self.dir_free) = (now.after(1), now, now);
        self.is_due = false;
    }

    /// After the end of a lease, or a fault: whether bytes of `epoch` are dropped.
    pub(crate) fn drops(&self, epoch: Epoch) -> bool {
        self.has(flag::UNREADABLE) && self.epochs[0].epoch == epoch
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

    /// No steps, no anchor, no prediction; the direction is forward.
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

    /// Drops all plans. The caller takes off the count what was planned and not played: [`Motor::uncount`].
    #[inline(never)]
    pub(crate) fn stop(&mut self) {
        self.restart();
        self.set(flag::COMMITTED, false);
        self.set(flag::SWITCH, false);
        self.epochs.iter_mut().for_each(|part| part.len = 0);
        (self.waiting_epochs, self.is_due) = (0, false);
        self.next = self.start;
    }

    /// Steps forward minus backward that were planned, whether played or not.
    pub(crate) fn planned(&self) -> i32 {
        let left = i32::from(self.registers.left);
        if self.has(flag::BACKWARD) { self.position.wrapping_add(left) } else { self.position.wrapping_sub(left) }
    }

    /// Takes `steps`, planned and not played, off the count. The rest of the segment is dropped.
    pub(crate) fn uncount(&mut self, steps: i16) {
        self.position = self.planned().wrapping_sub(i32::from(steps));
        self.registers.left = 0;
    }

    /// Loads steps that come after all others, as a record with an anchor before it would.
    #[inline(never)]
    pub(crate) fn follow(&mut self, steps: &Steps) {
        // A single step may be further away than registers reach. It does not matter then from where its interval counts.
        let Steps { first, count, .. } = *steps;
        let period = steps.period.min(LONGEST_INTERVAL);
        let backward = steps.direction == Direction::Backward;
        let turns = backward != self.has(flag::BACKWARD);
        // A turn of DIR or a filler before this needs `dir_free` and `last`.
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
        self.prechecked = 0;
        let moved = i32::from(count);
        self.position = self.position.wrapping_add(if backward { -moved } else { moved });
    }

    /// Whether there is nothing to do, now or later, unless more is pushed.
    #[inline(never)]
    pub(crate) fn is_idle(&self) -> bool {
        self.registers.left == 0
            && self.flags & (1 << flag::SWITCH | 1 << flag::COMMITTED) == 0
            && (self.has(flag::UNREADABLE) || self.epochs[0].len == 0)
            && self.braking() & 1 << state::BRAKES == 0
    }

    /// The epoch being run.
    pub(crate) fn epoch(&self) -> Epoch {
        self.epochs[0].epoch
    }

    /// The first fault in it.
    pub(crate) fn fault(&self) -> Option<Fault> {
        FaultKind::of(self.fault_kind).map(|kind| Fault { kind, tick: self.fault_tick })
    }

    #[inline(never)]
    fn fail(&mut self, fault_kind: u8, tick: Tick32) {
        if self.fault_kind == 0 {
            (self.fault_kind, self.fault_tick) = (fault_kind, tick);
        }
        self.uncount(0);
        self.set(flag::ANCHORED, false);
        // After a mismatch an anchor would do, but only the front of an epoch has one.
        self.set(flag::UNREADABLE, true);
    }
}

/// A step cannot be made, or a record not be read, because of a [`FaultKind`].
#[unsafe(no_mangle)]
extern "C" fn steps_fail(motor: &mut Motor, fault_kind: u8, tick: u32) {
    motor.fail(fault_kind, Tick32(tick));
}
