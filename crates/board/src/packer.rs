//! Packs the items of one epoch of one motor into bytes, with checks in between.

use pulsetrain_core::packing::{CHECK_LEN, Check, MAX_PACKED_LEN, PackError, Packing, State};
use pulsetrain_core::{Item, Tick32};

/// Bytes of the longest item with a check before it.
pub(crate) const MAX_LEN: usize = CHECK_LEN + MAX_PACKED_LEN;

// An item and its check fit in one frame of every board.
const _: () = assert!(MAX_LEN + 3 <= pulsetrain_core::wire::MIN_BODY);

/// Bytes after which a check goes before the next steps: about one check in a frame, so that a damaged item is noticed soon.
const CHECK_EVERY: usize = 64;

/// Bytes of a queue from which checks are sent. A shorter queue has no room for them: it holds a few frames, and an epoch's anchor is a check too.
const CHECK_BYTES: usize = 256;

/// Packs an epoch from its beginning.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Packer {
    packing: Packing,
    state: State,
    /// The board's accumulator after the packed items, ticks · 2^F, wrapping.
    accumulator: u64,
    /// Steps forward minus backward since the anchor, wrapping.
    moved: u16,
    /// Bytes since the last check.
    unchecked: usize,
    /// Whether the queue is long enough for checks.
    checks: bool,
}

impl Packer {
    /// For a queue of `capacity` bytes.
    pub(crate) fn new(packing: Packing, capacity: usize) -> Packer {
        let checks = capacity >= CHECK_BYTES;
        Packer { packing, state: State::default(), accumulator: 0, moved: 0, unchecked: 0, checks }
    }

    /// Packs `item` into the front of `out`, after a check if one is due. Returns the number of bytes.
    ///
    /// # Errors
    /// When the item has no steps; nothing changes then.
    pub(crate) fn pack(&mut self, item: &Item, out: &mut [u8; MAX_LEN]) -> Result<usize, PackError> {
        let mut len = 0;
        let is_run = matches!(item, Item::Run { .. });
        if is_run && self.checks && self.unchecked >= CHECK_EVERY {
            len = self.packing.pack_check(&self.check(), out)?;
        }
        let item_len = self.packing.pack(&mut self.state, item, &mut out[len..])?;
        self.unchecked = if len > 0 { item_len } else { self.unchecked + item_len };
        match *item {
            Item::Anchor { tick } => {
                (self.accumulator, self.moved) = (u64::from(tick.0) << self.bits() | (1 << self.bits()) >> 1, 0);
            }
            Item::Dwell { ticks } => {
                self.accumulator = self.accumulator.wrapping_add(u64::from(ticks) << self.bits());
            }
            Item::Run { segment, direction } => {
                // The board's accumulator and counts have fewer bits and wrap, so these may wrap too.
                self.accumulator = self.accumulator.wrapping_add(segment.span(segment.count) as u64);
                self.moved = self.moved.wrapping_add((segment.count as u16).wrapping_mul(direction.sign() as u16));
            }
        }
        Ok(len + item_len)
    }

    /// The tick of the accumulator after the packed items.
    pub(crate) fn tick(&self) -> Tick32 {
        Tick32::of(self.accumulator >> self.bits())
    }

    /// Fraction bits of the accumulator (F).
    const fn bits(&self) -> u32 {
        self.packing.fraction_bits
    }

    /// The state from which the packing predicts the next segment.
    pub(crate) const fn state(&self) -> State {
        self.state
    }

    fn check(&self) -> Check {
        let fraction = self.accumulator << (32 - self.bits()) >> 16;
        Check { position: self.moved, tick: self.tick(), fraction: fraction as u16 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use pulsetrain_core::channel::Channel;
    use pulsetrain_core::packed_queue::{PackedQueue, Pool};
    use pulsetrain_core::{Direction, Epoch, Segment};

    const PACKING: Packing = Packing { fraction_bits: 16, gain: 0 };

    fn item() -> impl Strategy<Value = Item> {
        let segment = (1u32..400, 200i64..2000, 0i64..65_536, -400i64..400, -2i64..2, any::<bool>());
        let run = segment.prop_map(|(count, ticks, fraction, add, add2, forward)| Item::Run {
            segment: Segment { count, interval: (ticks << 16) + fraction, add: add * 16, add2: add2 * 16 },
            direction: if forward { Direction::Forward } else { Direction::Backward },
        });
        prop_oneof![9 => run, 1 => (1000u32..100_000).prop_map(|ticks| Item::Dwell { ticks })]
    }

    proptest! {
        /// A board finds every check right, and does nothing after one that it finds wrong.
        #[test]
        fn boards_agree_with_checks(items in prop::collection::vec(item(), 20..60), wrong in any::<prop::sample::Index>()) {
            let mut packer = Packer::new(PACKING, CHECK_BYTES);
            let mut packed = Vec::new();
            let mut checks = Vec::new();
            let (mut steps, mut moved) = (0, 0);
            for item in [Item::Anchor { tick: Tick32(1000) }].iter().chain(&items) {
                let before = packer;
                let mut bytes = [0; MAX_LEN];
                let len = packer.pack(item, &mut bytes).unwrap();
                if packer.unchecked <= before.unchecked {
                    checks.push((packed.len(), moved));
                }
                packed.extend_from_slice(&bytes[..len]);
                if let Item::Run { segment, direction } = item {
                    steps += segment.count;
                    moved += segment.count as i32 * direction.sign();
                }
            }
            prop_assert!(checks.len() >= packed.len() / (CHECK_EVERY + MAX_LEN), "{} checks in {} bytes", checks.len(), packed.len());
            let (position, fault) = run(&packed, steps);
            prop_assert_eq!((position, fault), (moved, false));

            // One bit of a check's content.
            if !checks.is_empty() {
                let (at, moved) = checks[wrong.index(checks.len())];
                packed[at + 2 + wrong.index(CHECK_LEN - 2)] ^= 1 << wrong.index(8);
                prop_assert_eq!(run(&packed, steps), (moved, true));
            }
        }
    }

    /// Follows the packed items to their end. Returns the motor's position, and whether a check failed.
    fn run(packed: &[u8], steps: u32) -> (i32, bool) {
        let mut pool = Pool::<4096>::new();
        let mut queue = PackedQueue::new(Pool::<4096>::share(1, 0), PACKING);
        queue.push(&mut pool, Epoch(0), packed).unwrap();
        let mut channel = Channel::<16>::new(1, false);
        let mut now = Tick32(0);
        // A step and a change of direction at most in each round.
        for _ in 0..4 * steps + 1000 {
            match channel.peek(&mut queue.items(&pool), now.after(1 << 20)) {
                Some(event) => channel.take(event),
                None => {
                    now = now.after(1 << 16);
                    channel.pass(now);
                }
            }
        }
        (channel.position(), queue.fault().is_some())
    }
}
