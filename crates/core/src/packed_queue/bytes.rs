//! A ring of waiting bytes, which remembers how many belong to which epoch. It does not know what the bytes mean.

use crate::Epoch;

/// How many epochs may wait in one motor's queue, the one being run included.
pub const EPOCHS: usize = 3;

/// The memory of all motors' queues; each has its share.
#[derive(Clone, Debug)]
pub struct Pool<const N: usize>([u8; N]);

impl<const N: usize> Pool<N> {
    /// Memory for up to 65 535 bytes.
    #[must_use]
    pub const fn new() -> Pool<N> {
        const { assert!(4 <= N && N <= 0xffff) };
        Pool([0; N])
    }

    /// An empty queue in the share of motor number `motor` of `motors` (1 to 4). All shares have the same size.
    ///
    /// Another `motor` has no room at all.
    #[expect(clippy::cast_possible_truncation, reason = "N is checked in `new`")]
    #[must_use]
    pub const fn share(motors: u8, motor: u8) -> ByteQueue {
        // In a constant the compiler does the division, which a chip has not.
        let each = match motors {
            1 => N as u16,
            2 => const { (N / 2) as u16 },
            3 => const { (N / 3) as u16 },
            4 => const { (N / 4) as u16 },
            _ => 0,
        };
        match motor {
            0 => ByteQueue::new(0, each),
            1 if motors > 1 => ByteQueue::new(each, each),
            2 if motors > 2 => ByteQueue::new(each << 1, each),
            3 if motors > 3 => ByteQueue::new((each << 1) + each, each),
            _ => ByteQueue::new(0, 0),
        }
    }

    /// An empty queue in `len` bytes from `start` on; it has no room if they are not all within the pool.
    #[must_use]
    pub const fn part(start: u16, len: u16) -> ByteQueue {
        if start as usize + len as usize <= N { ByteQueue::new(start, len) } else { ByteQueue::new(0, 0) }
    }
}

impl<const N: usize> Default for Pool<N> {
    fn default() -> Pool<N> {
        Pool::new()
    }
}

/// Why a queue does not take bytes. It has not changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PushRefused {
    /// There is not enough room.
    NoRoom {
        /// Free bytes.
        free: u16,
    },
    /// [`EPOCHS`] other epochs wait already.
    TooManyEpochs,
}

/// How many bytes of an epoch wait.
#[derive(Clone, Copy, Debug)]
struct EpochBytes {
    epoch: Epoch,
    len: u16,
}

/// A ring of bytes in a share of a [`Pool`]. Every method that touches bytes must get the same pool.
#[derive(Clone, Debug)]
pub struct ByteQueue {
    /// The share.
    start: u16,
    end: u16,
    /// The place of the first waiting byte.
    next: u16,
    /// Bytes waiting.
    len: u16,
    /// The waiting epochs, in order. The first may have no bytes left.
    parts: [EpochBytes; EPOCHS],
    /// How many.
    epochs: u8,
}

impl ByteQueue {
    const fn new(start: u16, len: u16) -> ByteQueue {
        let unused = EpochBytes { epoch: Epoch(0), len: 0 };
        ByteQueue { start, end: start + len, next: start, len: 0, parts: [unused; EPOCHS], epochs: 0 }
    }

    /// Appends `bytes` of `epoch`: all of them or, with an error, none.
    ///
    /// # Errors
    /// When there is no room.
    ///
    /// ```
    /// use pulsetrain_core::Epoch;
    /// use pulsetrain_core::packed_queue::{Pool, PushRefused};
    /// let mut pool = Pool::<8>::new();
    /// let mut queue = Pool::<8>::share(2, 1);
    /// assert_eq!(queue.push(&mut pool, Epoch(0), &[1, 2, 3]), Ok(()));
    /// assert_eq!(queue.push(&mut pool, Epoch(1), &[4, 5]), Err(PushRefused::NoRoom { free: 1 }));
    /// queue.skip_to(Epoch(1));
    /// assert_eq!(queue.room(), 4);
    /// ```
    pub fn push<const N: usize>(&mut self, pool: &mut Pool<N>, epoch: Epoch, bytes: &[u8]) -> Result<(), PushRefused> {
        let free = self.room();
        let len = match u16::try_from(bytes.len()) {
            Ok(0) => return Ok(()),
            Ok(len) if len <= free => len,
            _ => return Err(PushRefused::NoRoom { free }),
        };
        let part = self.part_for(epoch).ok_or(PushRefused::TooManyEpochs)?;
        part.len += len;
        let at = self.place(self.len);
        // Copied in two pieces at most, since the ring's end may be between them: a processor of 32 bits copies four bytes at a time.
        let (first, rest) = bytes.split_at_checked(usize::from(self.end - at)).unwrap_or((bytes, &[]));
        for (piece, at) in [(first, at), (rest, self.start)] {
            let at = usize::from(at);
            // The place is always within the pool. `get_mut` avoids the code for a panic.
            if let Some(places) = pool.0.get_mut(at..at + piece.len()) {
                places.copy_from_slice(piece);
            }
        }
        self.len += len;
        Ok(())
    }

    /// Free bytes: what the host may still send.
    #[must_use]
    pub const fn room(&self) -> u16 {
        self.end - self.start - self.len
    }

    /// Its size, bytes.
    #[must_use]
    pub const fn capacity(&self) -> u16 {
        self.end - self.start
    }

    /// Drops epochs until `epoch` is the first one; all, if `epoch` does not wait.
    pub fn skip_to(&mut self, epoch: Epoch) {
        while self.epochs > 0 && (self.parts[0].epoch != epoch || self.parts[0].len == 0) {
            self.drop_front();
        }
    }

    /// Drops the bytes of `epoch` if it is the newest one: call it after a switch that was refused.
    pub fn discard(&mut self, epoch: Epoch) {
        if let Some(part) = self.newest()
            && part.epoch == epoch
        {
            self.len -= part.len;
            self.epochs -= 1;
        }
    }

    /// Drops the last `len` bytes, if that many of the newest epoch wait; else nothing changes.
    ///
    /// ```
    /// use pulsetrain_core::Epoch;
    /// use pulsetrain_core::packed_queue::Pool;
    /// let mut pool = Pool::<8>::new();
    /// let mut queue = Pool::<8>::share(1, 0);
    /// queue.push(&mut pool, Epoch(0), &[1, 2, 3]).unwrap();
    /// assert!(!queue.can_drop_last(4));
    /// queue.drop_last(2);
    /// assert_eq!(queue.room(), 7);
    /// ```
    pub fn drop_last(&mut self, len: u16) {
        if !self.can_drop_last(len) {
            return;
        }
        let last = usize::from(self.epochs).wrapping_sub(1);
        if let Some(part) = self.parts.get_mut(last) {
            part.len -= len;
            self.len -= len;
            self.epochs -= u8::from(part.len == 0);
        }
    }

    /// Whether `len` bytes of the newest epoch are waiting.
    #[must_use]
    pub fn can_drop_last(&self, len: u16) -> bool {
        len <= self.newest().map_or(0, |part| part.len)
    }

    /// Drops everything.
    pub const fn clear(&mut self) {
        self.len = 0;
        self.epochs = 0;
    }

    /// How many bytes of `epoch` wait, if it is the first one.
    pub(crate) const fn waiting(&self, epoch: Epoch) -> u16 {
        if self.epochs > 0 && self.parts[0].epoch.0 == epoch.0 { self.parts[0].len } else { 0 }
    }

    /// The first epoch, if it has bytes.
    pub(crate) const fn first(&self) -> Option<Epoch> {
        if self.epochs > 0 && self.parts[0].len > 0 { Some(self.parts[0].epoch) } else { None }
    }

    /// The first `len` bytes, in their place; `None` if the end of the ring is between them. At least `len` bytes wait.
    pub(crate) fn first_in_place<'a, const N: usize>(&self, pool: &'a Pool<N>, len: u16) -> Option<&'a [u8]> {
        let end = self.next + len;
        if end > self.end {
            return None;
        }
        pool.0.get(usize::from(self.next)..usize::from(end))
    }

    /// Copies the first bytes to fill `out`. At least that many wait.
    pub(crate) fn copy_first<const N: usize>(&self, pool: &Pool<N>, out: &mut [u8]) {
        let to_end = usize::from(self.end - self.next).min(out.len());
        let (first, rest) = out.split_at_mut(to_end);
        for (part, at) in [(first, self.next), (rest, self.start)] {
            let at = usize::from(at);
            // The place is always within the pool. `get` avoids the code for a panic.
            if let Some(bytes) = pool.0.get(at..at + part.len()) {
                part.copy_from_slice(bytes);
            }
        }
    }

    /// Drops the first `len` bytes. At least that many of the first epoch wait.
    pub(crate) fn drop_first(&mut self, len: u16) {
        self.next = self.place(len);
        self.len -= len;
        self.parts[0].len -= len;
    }

    fn drop_front(&mut self) {
        let len = self.parts[0].len;
        self.next = self.place(len);
        self.len -= len;
        self.parts.copy_within(1.., 0);
        self.epochs -= 1;
    }

    fn newest(&self) -> Option<EpochBytes> {
        let last = usize::from(self.epochs).checked_sub(1)?;
        self.parts.get(last).copied()
    }

    /// The entry that counts the bytes of `epoch`, a new one if need be; `None` if there are too many epochs.
    fn part_for(&mut self, epoch: Epoch) -> Option<&mut EpochBytes> {
        if self.newest().is_none_or(|newest| newest.epoch != epoch) {
            if self.epochs > 0 && self.parts[0].len == 0 {
                self.drop_front();
            }
            *self.parts.get_mut(usize::from(self.epochs))? = EpochBytes { epoch, len: 0 };
            self.epochs += 1;
        }
        self.parts.get_mut(usize::from(self.epochs).wrapping_sub(1))
    }

    /// The place of the byte `offset` (at most the share) after the first one.
    const fn place(&self, offset: u16) -> u16 {
        let place = self.next + offset;
        if place >= self.end { place - (self.end - self.start) } else { place }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::collections::VecDeque;
    use std::vec;
    use std::vec::Vec;

    #[test]
    fn shares_are_equal_and_apart() {
        for motors in 1..=4 {
            let mut end = 0;
            for motor in 0..motors {
                let share = Pool::<641>::share(motors, motor);
                assert_eq!(share.start, end);
                assert_eq!(share.capacity(), 641 / u16::from(motors));
                end = share.end;
            }
            assert!(end <= 641);
            assert_eq!(Pool::<641>::share(motors, motors).capacity(), 0);
        }
        assert_eq!(Pool::<641>::share(5, 0).room(), 0);
    }

    #[test]
    fn epochs_are_limited() {
        let mut pool = Pool::<16>::new();
        let mut bytes = Pool::<16>::share(1, 0);
        for epoch in 0..3 {
            assert_eq!(bytes.push(&mut pool, Epoch(epoch), &[epoch]), Ok(()));
        }
        assert_eq!(bytes.push(&mut pool, Epoch(4), &[4]), Err(PushRefused::TooManyEpochs));
        assert_eq!(bytes.room(), 13);
        // An epoch that was read to its end makes way for another, but not while it is the newest.
        bytes.drop_first(1);
        assert_eq!(bytes.push(&mut pool, Epoch(4), &[4]), Ok(()));
        bytes.skip_to(Epoch(4));
        assert_eq!((bytes.waiting(Epoch(4)), bytes.room()), (1, 15));
    }

    #[derive(Clone, Debug)]
    enum Action {
        Push { epoch: u8, len: usize },
        Read(u16),
        SkipTo(u8),
        Discard(u8),
        DropLast(u16),
        Clear,
    }

    fn action() -> impl Strategy<Value = Action> {
        prop_oneof![
            6 => (0u8..4, 0usize..20).prop_map(|(epoch, len)| Action::Push { epoch, len }),
            6 => (1u16..20).prop_map(Action::Read),
            1 => (0u8..5).prop_map(Action::SkipTo),
            1 => (0u8..4).prop_map(Action::Discard),
            2 => (0u16..20).prop_map(Action::DropLast),
            1 => Just(Action::Clear),
        ]
    }

    proptest! {
        #[test]
        fn they_come_out_as_they_went_in(
            actions in prop::collection::vec(action(), 0..100), motors in 1u8..=4, motor in 0u8..4,
        ) {
            prop_assume!(motor < motors);
            let mut pool = Pool::<73>::new();
            let mut bytes = Pool::<73>::share(motors, motor);
            let mut model: VecDeque<(u8, u8)> = VecDeque::new();
            let mut number = 0u8;
            for action in actions {
                match action {
                    Action::Push { epoch, len } => {
                        let new: Vec<u8> = (0..len).map(|_| { number = number.wrapping_add(1); number }).collect();
                        let free = usize::from(bytes.capacity()) - model.len();
                        match bytes.push(&mut pool, Epoch(epoch), &new) {
                            Ok(()) => model.extend(new.iter().map(|&byte| (epoch, byte))),
                            Err(PushRefused::NoRoom { free: said }) => {
                                prop_assert!(len > free);
                                prop_assert_eq!(usize::from(said), free);
                            }
                            Err(PushRefused::TooManyEpochs) => {
                                let mut epochs: Vec<u8> = model.iter().map(|&(epoch, _)| epoch).collect();
                                epochs.dedup();
                                prop_assert!(epochs.len() == EPOCHS);
                                prop_assert_ne!(epochs.last(), Some(&epoch));
                            }
                        }
                    }
                    Action::Read(most) => {
                        let front = model.front().map_or(0, |&(epoch, _)| epoch);
                        let len = bytes.waiting(Epoch(front)).min(most);
                        let mut read = vec![0; len.into()];
                        bytes.copy_first(&pool, &mut read);
                        if let Some(in_place) = bytes.first_in_place(&pool, len) {
                            prop_assert_eq!(in_place, &read);
                        }
                        for byte in read {
                            prop_assert_eq!(Some((front, byte)), model.pop_front());
                        }
                        if len > 0 {
                            bytes.drop_first(len);
                        }
                    }
                    Action::SkipTo(epoch) => {
                        bytes.skip_to(Epoch(epoch));
                        while model.front().is_some_and(|front| front.0 != epoch) {
                            model.pop_front();
                        }
                    }
                    Action::Discard(epoch) => {
                        bytes.discard(Epoch(epoch));
                        while model.back().is_some_and(|back| back.0 == epoch) {
                            model.pop_back();
                        }
                    }
                    Action::DropLast(len) => {
                        let newest = model.back().map(|back| back.0);
                        let waiting = model.iter().rev().take_while(|byte| Some(byte.0) == newest).count();
                        prop_assert_eq!(bytes.can_drop_last(len), usize::from(len) <= waiting);
                        bytes.drop_last(len);
                        if usize::from(len) <= waiting {
                            model.truncate(model.len() - usize::from(len));
                        }
                    }
                    Action::Clear => {
                        bytes.clear();
                        model.clear();
                    }
                }
                prop_assert_eq!(usize::from(bytes.room()), usize::from(bytes.capacity()) - model.len());
            }
        }
    }
}
