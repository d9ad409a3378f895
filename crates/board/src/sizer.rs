//! The room that items take in a board's queue.

use crate::packer::{MAX_LEN, Packer};
use pulsetrain_core::Item;
use pulsetrain_core::packing::{Packing, State};

/// Measures the items of one epoch of one motor, in their order: in bytes for a packed queue, in items for a native board's.
///
/// Each epoch is packed from a reset state, so that its size does not depend on what was sent before.
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
    /// Whether it counts bytes; else places for items.
    counts_bytes: bool,
    /// Room that the epoch itself takes, until the first item is measured.
    head: usize,
}

impl Sizer {
    /// For a queue that has one place for each item.
    #[must_use]
    pub fn items() -> Sizer {
        // With 32 fraction bits every interval can be packed: the packer's result is not used here.
        let packer = Packer::new(Packing { fraction_bits: 32, gain: 0 }, 0);
        Sizer { packer, counts_bytes: false, head: 0 }
    }

    /// For a queue of `capacity` bytes that holds packed items ([`pulsetrain_core::packing`]) with the checks that a [`Remote`](crate::Remote) sends
    /// in between. A short queue gets no checks.
    #[must_use]
    pub fn packed(packing: Packing, capacity: usize) -> Sizer {
        Sizer { packer: Packer::new(packing, capacity), counts_bytes: true, head: 0 }
    }

    /// This sizer, for a queue in which every epoch takes `head` units before its first item.
    #[must_use]
    pub const fn with_head(self, head: usize) -> Sizer {
        Sizer { head, ..self }
    }

    /// The room for the next item of the epoch, in the queue's unit.
    pub fn size(&mut self, item: &Item) -> usize {
        let head = std::mem::take(&mut self.head);
        // An item that cannot be packed is refused by the board. It must not look small here.
        let len = self.packer.pack(item, &mut [0; MAX_LEN]).unwrap_or(MAX_LEN);
        head + if self.counts_bytes { len } else { 1 }
    }

    /// The state from which the packing predicts the next segment.
    #[must_use]
    pub const fn state(&self) -> State {
        self.packer.state()
    }
}
