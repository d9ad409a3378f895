//! The queue of a motor: items that wait, each with its epoch. [`Items`] is the interface through which a channel takes items. [`Queue`] holds
//! unpacked items, [`packed_queue`](crate::packed_queue) packed ones.

use crate::{Direction, Recurrence, Segment, Tick32};

/// A numbered generation of the plan; the numbers wrap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[repr(transparent)]
pub struct Epoch(pub u8);

impl Epoch {
    /// The generation after this one.
    #[must_use]
    pub const fn next(self) -> Epoch {
        Epoch(self.0.wrapping_add(1))
    }
}

/// One thing that a motor is to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Item {
    /// Sets the accumulator to `tick` + ½. It is the first item of every epoch.
    Anchor {
        /// Less than 2^31 ticks ahead when it is reached.
        tick: Tick32,
    },
    /// Steps.
    Run {
        /// Their recurrence.
        segment: Segment,
        /// Which way they count.
        direction: Direction,
    },
    /// A wait without steps; the accumulator keeps its fraction.
    Dwell {
        /// Whole ticks, less than 2^31.
        ticks: u32,
    },
}

/// An item and its epoch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The generation of the plan that `item` belongs to.
    pub epoch: Epoch,
    /// What to do.
    pub item: Item,
}

/// Where a channel will be when it has done all items that it took.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// Steps forward minus steps backward, wrapping.
    pub position: i32,
    /// The accumulator's tick.
    pub tick: Tick32,
    /// The accumulator's fraction, 2^-16 ticks.
    pub fraction: u16,
}

/// A source of items for a channel. The items of an epoch come after those of the epoch before.
pub trait Items {
    /// Whether the first waiting item is of `epoch`.
    fn has(&self, epoch: Epoch) -> bool;

    /// Takes the first item; `None` if the waiting bytes are no item. `here` is where the channel will be then.
    fn take(&mut self, here: &Place) -> Option<Item>;

    /// Takes the first item straight into `registers`, if it is a run of `epoch` in `direction`, and returns its steps. `registers` are as after
    /// the run before. Returns 0 if there is something else, or a run that needs [`take`](Items::take).
    ///
    /// It exists because nearly all items of a fast motion are such runs, and an [`Item`] is large. The queue may keep its packing state in
    /// `registers` alone: it gets them back with the next call, or by [`end_runs`](Items::end_runs).
    fn take_run(&mut self, _epoch: Epoch, _direction: Direction, _registers: &mut Recurrence) -> u32 {
        0
    }

    /// The direction in which [`take_run`](Items::take_run) may take a run; `None` if it takes none.
    fn run_direction(&self) -> Option<Direction> {
        None
    }

    /// Gives back `registers`, as they are after the last run of [`take_run`](Items::take_run). The channel calls this before `take`.
    fn end_runs(&mut self, _registers: &Recurrence) {}

    /// Drops items until one of `epoch` is the first; all, if none of `epoch` waits.
    fn skip_to(&mut self, epoch: Epoch);

    /// Drops everything.
    fn clear(&mut self);

    /// Drops the first items as long as they are of `epoch`. `here` is where the channel is.
    fn drop_epoch(&mut self, epoch: Epoch, here: &Place) {
        while self.has(epoch) {
            self.take(here);
        }
    }

    /// Whether bytes that were no item have been found. What followed them in their epoch is dropped.
    fn has_failed(&self) -> bool {
        false
    }
}

impl<const N: usize> Items for Queue<N> {
    fn has(&self, epoch: Epoch) -> bool {
        self.front().is_some_and(|entry| entry.epoch == epoch)
    }

    fn take(&mut self, _: &Place) -> Option<Item> {
        self.pop().map(|entry| entry.item)
    }

    fn skip_to(&mut self, epoch: Epoch) {
        Queue::skip_to(self, epoch);
    }

    fn clear(&mut self) {
        Queue::clear(self);
    }
}

/// A ring of `N` entries.
#[derive(Clone, Debug)]
pub struct Queue<const N: usize> {
    entries: [Entry; N],
    first: usize,
    len: usize,
}

impl<const N: usize> Queue<N> {
    /// An empty queue.
    #[must_use]
    pub const fn new() -> Queue<N> {
        // All zeros, so that a static queue takes no bytes in an image.
        let unused = Entry { epoch: Epoch(0), item: Item::Anchor { tick: Tick32(0) } };
        Queue { entries: [unused; N], first: 0, len: 0 }
    }

    /// Appends `entry`.
    ///
    /// # Errors
    /// A full queue hands it back.
    ///
    /// ```
    /// use pulsetrain_core::queue::{Entry, Epoch, Item, Queue};
    /// let mut queue = Queue::<1>::new();
    /// let entry = Entry { epoch: Epoch(0), item: Item::Dwell { ticks: 5 } };
    /// assert_eq!(queue.push(entry), Ok(()));
    /// assert_eq!(queue.push(entry), Err(entry));
    /// ```
    pub const fn push(&mut self, entry: Entry) -> Result<(), Entry> {
        if self.len == N {
            return Err(entry);
        }
        self.entries[self.index(self.len)] = entry;
        self.len += 1;
        Ok(())
    }

    /// The first entry, which stays in the queue.
    #[must_use]
    pub const fn front(&self) -> Option<&Entry> {
        if self.len == 0 { None } else { Some(&self.entries[self.first]) }
    }

    /// Takes the first entry.
    pub const fn pop(&mut self) -> Option<Entry> {
        if self.len == 0 {
            return None;
        }
        let entry = self.entries[self.first];
        self.first = self.index(1);
        self.len -= 1;
        Some(entry)
    }

    /// Drops entries until one of `epoch` is the first; all, if there is none.
    pub fn skip_to(&mut self, epoch: Epoch) {
        while self.front().is_some_and(|entry| entry.epoch != epoch) {
            self.pop();
        }
    }

    /// Drops the last entries as long as they are of `epoch`: call it after a switch that was refused.
    pub fn discard(&mut self, epoch: Epoch) {
        while self.len > 0 && self.entries[self.index(self.len - 1)].epoch == epoch {
            self.len -= 1;
        }
    }

    /// Drops everything.
    pub const fn clear(&mut self) {
        self.len = 0;
    }

    /// Entries waiting.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.len
    }

    /// Whether nothing waits.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Free places: what the host may still send.
    #[must_use]
    pub const fn credit(&self) -> usize {
        N - self.len
    }

    /// The place of the entry `offset` (at most `N`) places after the first one.
    const fn index(&self, offset: usize) -> usize {
        let index = self.first + offset;
        if index >= N { index - N } else { index }
    }
}

impl<const N: usize> Default for Queue<N> {
    fn default() -> Queue<N> {
        Queue::new()
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::collections::VecDeque;
    use std::vec::Vec;

    fn entry(epoch: u8, ticks: u32) -> Entry {
        Entry { epoch: Epoch(epoch), item: Item::Dwell { ticks } }
    }

    #[test]
    fn a_refused_epoch_is_taken_back_whole() {
        let mut queue = Queue::<4>::new();
        for (epoch, ticks) in [(0, 1), (0, 2), (1, 3), (1, 4)] {
            queue.push(entry(epoch, ticks)).unwrap();
        }
        queue.discard(Epoch(1));
        assert_eq!(queue.credit(), 2);
        queue.skip_to(Epoch(0));
        assert_eq!(queue.pop(), Some(entry(0, 1)));
        queue.skip_to(Epoch(9));
        assert!(queue.is_empty());
    }

    proptest! {
        #[test]
        fn it_is_a_queue(actions in prop::collection::vec(prop::option::of(0u8..3), 0..200)) {
            let mut queue = Queue::<5>::new();
            let mut model = VecDeque::new();
            for (ticks, action) in (0u32..).zip(actions) {
                match action {
                    Some(epoch) => {
                        let new = entry(epoch, ticks);
                        if model.len() == 5 {
                            prop_assert_eq!(queue.push(new), Err(new));
                        } else {
                            prop_assert_eq!(queue.push(new), Ok(()));
                            model.push_back(new);
                        }
                    }
                    None => prop_assert_eq!(queue.pop(), model.pop_front()),
                }
                prop_assert_eq!(queue.front(), model.front());
                prop_assert_eq!(queue.credit(), 5 - model.len());
            }
            let rest: Vec<_> = core::iter::from_fn(|| queue.pop()).collect();
            prop_assert_eq!(rest, Vec::from(model));
        }
    }
}
