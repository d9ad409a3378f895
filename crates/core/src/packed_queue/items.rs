//! A queue of packed bytes that gives items to a channel. It compares the checks among them, and does not pass them on.

use super::{ByteQueue, Pool, PushRefused};
use crate::packing::{CHECK_LEN, MAX_CONTINUED_LEN, MAX_PACKED_LEN, Packing, State, Units};
use crate::queue::{Items, Place};
use crate::{Direction, Epoch, Item, Recurrence};

/// What is wrong with packed bytes. The rest of their epoch is dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// They are no packed item.
    BadItem,
    /// A check contradicts the motor's position or time.
    CheckFailed,
}

/// The longest item or check, bytes.
#[expect(clippy::cast_possible_truncation, reason = "checked in the next line")]
const MAX_IN_FRONT: u16 = MAX_PACKED_LEN as u16;
const _: () = assert!(CHECK_LEN <= MAX_PACKED_LEN && MAX_PACKED_LEN < 256);

/// Bytes that must wait before [`Packing::unpack_continued`] takes a run. It is the longest run, so that the function need
/// not look for the end of the bytes.
#[expect(clippy::cast_possible_truncation, reason = "it is 11")]
const CONTINUED_LEN: u16 = MAX_CONTINUED_LEN as u16;

/// How a check begins: control record 5.
const CHECK: [u8; 2] = [0x2f, 0];

/// The first bytes of the control records of two bytes, reversal and reset. Both set the state back to its beginning.
const REVERSE: u8 = 0x07;
const RESET: u8 = 0x0f;

/// A motor's packed bytes in a share of a [`Pool`]. Each method that touches bytes takes that pool, always the same one.
#[derive(Clone, Debug)]
pub struct PackedQueue {
    bytes: ByteQueue,
    packing: Packing,
    /// The packing state of the first epoch.
    state: State,
    /// The channel has the registers of this state: see [`Items::take_run`].
    lent: bool,
    units: Units,
    /// The motor's position at the last anchor.
    anchored_at: i32,
    fault: Option<Fault>,
}

impl PackedQueue {
    /// An empty queue.
    #[must_use]
    pub const fn new(bytes: ByteQueue, packing: Packing) -> PackedQueue {
        let (state, units) = (State::new(Direction::Forward), Units::UNKNOWN);
        PackedQueue { bytes, packing, state, lent: false, units, anchored_at: 0, fault: None }
    }

    /// Appends packed items of `epoch`, none cut in two: all of them or, with an error, none.
    ///
    /// # Errors
    /// Those of [`ByteQueue::push`].
    pub fn push<const N: usize>(&mut self, pool: &mut Pool<N>, epoch: Epoch, packed: &[u8]) -> Result<(), PushRefused> {
        self.bytes.push(pool, epoch, packed)
    }

    /// Drops the items of `epoch` if it is the newest one. It must not be the one that is being run.
    pub fn discard(&mut self, epoch: Epoch) {
        self.bytes.discard(epoch);
    }

    /// Drops the last `len` bytes: see [`ByteQueue::drop_last`].
    pub fn drop_last(&mut self, len: u16) {
        self.bytes.drop_last(len);
    }

    /// Whether `len` bytes of the newest epoch wait.
    #[must_use]
    pub fn can_drop_last(&self, len: u16) -> bool {
        self.bytes.can_drop_last(len)
    }

    /// Free bytes: what the host may still send.
    #[must_use]
    pub const fn room(&self) -> u16 {
        self.bytes.room()
    }

    /// What was wrong with bytes since the queue was last [cleared](Items::clear).
    #[must_use]
    pub const fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Sets [`fault`](PackedQueue::fault) back to `None`.
    pub const fn clear_faults(&mut self) {
        self.fault = None;
    }

    /// The queue with its memory, from which a channel takes items.
    pub const fn items<'a, const N: usize>(&'a mut self, pool: &'a Pool<N>) -> PackedItems<'a, N> {
        PackedItems { packed: self, pool }
    }

    /// Whether `epoch` is the first one and has bytes.
    #[must_use]
    pub const fn has(&self, epoch: Epoch) -> bool {
        self.bytes.waiting(epoch) > 0
    }

    fn take<const N: usize>(&mut self, pool: &Pool<N>, here: &Place) -> Option<Item> {
        let epoch = self.bytes.first()?;
        let len = self.bytes.waiting(epoch).min(MAX_IN_FRONT);
        if let Some(front) = self.bytes.first_in_place(pool, len) {
            if let [c0 @ (REVERSE | RESET), 0, ..] = *front {
                self.begin_again(c0 == REVERSE);
                return None;
            }
            return self.take_from(front, epoch, here);
        }
        let mut front = [0; MAX_PACKED_LEN];
        let front = front.get_mut(..usize::from(len))?;
        self.bytes.copy_first(pool, front);
        self.take_from(front, epoch, here)
    }

    // Inlining would copy its code to each place that calls it.
    #[inline(never)]
    fn take_from(&mut self, front: &[u8], epoch: Epoch, here: &Place) -> Option<Item> {
        let mut rest = front;
        if let [c0, c1, p0, p1, t0, t1, t2, t3, f0, f1, ..] = *rest
            && [c0, c1] == CHECK
        {
            self.consume(CHECK_LEN);
            let moved = here.position.wrapping_sub(self.anchored_at).to_le_bytes();
            let agrees = moved[..2] == [p0, p1]
                && here.tick.0 == u32::from_le_bytes([t0, t1, t2, t3])
                && here.fraction == u16::from_le_bytes([f0, f1]);
            if !agrees {
                self.drop_faulty_epoch(epoch, Fault::CheckFailed);
            }
            return None;
        }
        if let [c0 @ (REVERSE | RESET), 0, ..] = *rest {
            self.begin_again(c0 == REVERSE);
            return None;
        }
        let len = rest.len();
        let unpacked = self.packing.unpack(&mut self.state, &mut rest);
        self.consume(len - rest.len());
        match unpacked {
            Ok(Some(anchor @ Item::Anchor { .. })) => {
                self.anchored_at = here.position;
                Some(anchor)
            }
            Ok(item) => item,
            Err(_) => {
                self.drop_faulty_epoch(epoch, Fault::BadItem);
                None
            }
        }
    }

    /// See [`Items::take_run`].
    #[inline(never)]
    fn take_run<const N: usize>(
        &mut self,
        pool: &Pool<N>,
        epoch: Epoch,
        direction: Direction,
        registers: &mut Recurrence,
    ) -> u32 {
        if self.state.direction != direction || self.bytes.waiting(epoch) < CONTINUED_LEN {
            return 0;
        }
        let front = self.bytes.first_in_place(pool, CONTINUED_LEN).and_then(|front| front.first_chunk());
        let Some(front) = front else { return 0 };
        if !self.lent {
            let State { interval, add, add2, .. } = self.state;
            (registers.interval, registers.add, registers.add2) = (interval, add, add2);
            self.lent = true;
        }
        let previous_count = self.state.previous_count;
        let taken = self.packing.unpack_continued(&mut self.units, previous_count, registers, front);
        let Some((count, taken)) = taken else { return 0 };
        self.state.previous_count = count;
        self.consume(taken);
        count
    }

    /// Does a reversal or a reset.
    fn begin_again(&mut self, reverses: bool) {
        self.consume(2);
        let was = self.state.direction;
        self.state = State::new(if reverses { was.reversed() } else { was });
    }

    /// Sets the packing state to its beginning.
    fn begin(&mut self) {
        (self.state, self.lent) = (State::default(), false);
    }

    fn consume(&mut self, len: usize) {
        // It fits: `len` is at most MAX_PACKED_LEN.
        self.bytes.drop_first(u16::try_from(len).unwrap_or(0));
    }

    fn drop_faulty_epoch(&mut self, epoch: Epoch, fault: Fault) {
        self.fault = self.fault.or(Some(fault));
        self.bytes.drop_first(self.bytes.waiting(epoch));
    }
}

/// A [`PackedQueue`] and its memory.
#[derive(Debug)]
pub struct PackedItems<'a, const N: usize> {
    packed: &'a mut PackedQueue,
    pool: &'a Pool<N>,
}

impl<const N: usize> Items for PackedItems<'_, N> {
    fn has(&self, epoch: Epoch) -> bool {
        self.packed.has(epoch)
    }

    fn take(&mut self, here: &Place) -> Option<Item> {
        self.packed.take(self.pool, here)
    }

    fn take_run(&mut self, epoch: Epoch, direction: Direction, registers: &mut Recurrence) -> u32 {
        self.packed.take_run(self.pool, epoch, direction, registers)
    }

    fn run_direction(&self) -> Option<Direction> {
        Some(self.packed.state.direction)
    }

    fn end_runs(&mut self, registers: &Recurrence) {
        if core::mem::take(&mut self.packed.lent) {
            let Recurrence { interval, add, add2, .. } = *registers;
            let state = &mut self.packed.state;
            (state.interval, state.add, state.add2) = (interval, add, add2);
        }
    }

    fn skip_to(&mut self, epoch: Epoch) {
        self.packed.bytes.skip_to(epoch);
        self.packed.begin();
    }

    fn clear(&mut self) {
        self.packed.bytes.clear();
        self.packed.begin();
    }

    fn drop_epoch(&mut self, epoch: Epoch, _: &Place) {
        let waiting = self.packed.bytes.waiting(epoch);
        if waiting > 0 {
            self.packed.bytes.drop_first(waiting);
        }
    }

    fn has_failed(&self) -> bool {
        self.packed.fault.is_some()
    }
}
