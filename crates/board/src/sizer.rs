//! What items take in a board's queue.

use crate::packer::{MAX_LEN, Packer};
use pulsetrain_core::Item;
use pulsetrain_core::packing::{Packing, State};

/// Measures the items of one epoch and one motor, the first one first: what the queue of a board needs to hold them.
///
/// An epoch is packed from a reset state on, so that its size does not depend on what was sent before.
///
/// ```
/// use pulsetrain_board::Sizer;
/// use pulsetrain_core::packing::Packing;
/// use pulsetrain_core::{Direction, Item, Tick32, Segment};
///
/// let anchor = Item::Anchor { tick: Tick32(0) };
/// let segment = Segment { count: 40, interval: 100 << 16, add: 0, add2: 0 };
/// let run = Item::Run { segment, direction: Direction::Forward };
///
/// let mut packed = Sizer::packed(Packing { fraction_bits: 16, gain: 0 }, 800);
/// assert_eq!([packed.size(&anchor), packed.size(&run)], [6, 6]);
/// // The same speed for 40 steps more: the header alone says so.
/// assert_eq!(packed.size(&run), 1);
///
/// let mut items = Sizer::items();
/// assert_eq!([items.size(&anchor), items.size(&run)], [1, 1]);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Sizer {
    packer: Packer,
    /// Whether bytes are counted, or places for items.
    counts_bytes: bool,
    /// What the epoch itself takes, until it is counted.
    head: usize,
}

impl Sizer {
    /// For a queue that has one place for each item.
    #[must_use]
    pub fn items() -> Sizer {
        // Registers of any width.
        let packer = Packer::new(Packing { fraction_bits: 32, gain: 0 }, 0);
        Sizer { packer, counts_bytes: false, head: 0 }
    }

    /// For a queue of `capacity` bytes that holds items as [`pulsetrain_core::packing`] packs them, with checks in between
    /// as a [`Remote`](crate::Remote) sends them: none where there is hardly room for the items.
    #[must_use]
    pub fn packed(packing: Packing, capacity: usize) -> Sizer {
        Sizer { packer: Packer::new(packing, capacity), counts_bytes: true, head: 0 }
    }

    /// The same, of a queue in which every epoch takes `head` for itself, before its first item.
    #[must_use]
    pub const fn with_head(self, head: usize) -> Sizer {
        Sizer { head, ..self }
    }

    /// What the next item of the epoch takes.
    pub fn size(&mut self, item: &Item) -> usize {
        let head = std::mem::take(&mut self.head);
        // What cannot be packed is no step: a board refuses it, and it must not look small.
        let len = self.packer.pack(item, &mut [0; MAX_LEN]).unwrap_or(MAX_LEN);
        head + if self.counts_bytes { len } else { 1 }
    }

    /// What the packed stream predicts of the segment after the items measured so far.
    #[must_use]
    pub const fn state(&self) -> State {
        self.packer.state()
    }
}
