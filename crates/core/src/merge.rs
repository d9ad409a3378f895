//! The merge: puts the edges of all motors into one stream, in order of time. It does not decide when an edge is due.

use crate::Tick32;
use crate::output::Edge;

/// Merges up to `N` (at most 32) streams of edges, each in order, none more than 2^31 ticks from another.
///
/// Edges at one tick come out as one; those that change nothing do not come out at all.
///
/// ```
/// use pulsetrain_core::{Merge, Tick32, output::Edge};
/// let edge = |tick, set, clear| Edge { tick: Tick32(tick), set, clear };
/// let mut streams = [vec![edge(7, 1, 0), edge(9, 0, 1)].into_iter(), vec![edge(7, 2, 0), edge(8, 2, 0)].into_iter()];
/// let mut merge = Merge::<2>::new();
/// merge.reopen();
/// let mut next = || merge.next(|stream| streams[stream].next());
/// assert_eq!(next(), Some(edge(7, 3, 0)));
/// assert_eq!(next(), Some(edge(9, 0, 1))); // line 1 was high at 8 already
/// assert_eq!(next(), None);
/// ```
#[derive(Clone, Debug)]
pub struct Merge<const N: usize> {
    heads: [Option<Edge>; N],
    /// Streams that may still have an edge before `reopen`; bit i is stream i.
    open: u32,
    levels: u32,
}

impl<const N: usize> Merge<N> {
    const ALL: u32 = if N == 32 { u32::MAX } else { (1 << N) - 1 };

    /// All lines low.
    #[must_use]
    pub const fn new() -> Merge<N> {
        const { assert!(N <= 32) };
        Merge { heads: [None; N], open: Self::ALL, levels: 0 }
    }

    /// Asks all streams again: call it when time has passed, or when streams have new steps.
    pub const fn reopen(&mut self) {
        self.open = Self::ALL;
    }

    /// The next edge. `pull(i)` returns the next edge of stream i, or `None` if it has none for now.
    pub fn next(&mut self, mut pull: impl FnMut(usize) -> Option<Edge>) -> Option<Edge> {
        loop {
            let tick = self.earliest(&mut pull)?;
            let before = self.levels;
            for stream in streams(self.open) {
                while let Some(edge) = self.heads[stream]
                    && edge.tick == tick
                {
                    self.levels = (self.levels & !edge.clear) | edge.set;
                    self.heads[stream] = pull(stream);
                }
                if self.heads[stream].is_none() {
                    self.open &= !(1 << stream);
                }
            }
            let changed = before ^ self.levels;
            if changed != 0 {
                return Some(Edge { tick, set: changed & self.levels, clear: changed & before });
            }
        }
    }

    /// The levels of all lines after the last edge that was returned.
    #[must_use]
    pub const fn levels(&self) -> u32 {
        self.levels
    }

    fn earliest(&mut self, pull: &mut impl FnMut(usize) -> Option<Edge>) -> Option<Tick32> {
        let mut earliest: Option<Tick32> = None;
        for stream in streams(self.open) {
            if self.heads[stream].is_none() {
                self.heads[stream] = pull(stream);
            }
            match self.heads[stream] {
                None => self.open &= !(1 << stream),
                Some(edge) if earliest.is_none_or(|tick| edge.tick.is_before(tick)) => earliest = Some(edge.tick),
                Some(_) => {}
            }
        }
        earliest
    }
}

/// The numbers of the bits that are set.
fn streams(mut bits: u32) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        let stream = bits.trailing_zeros();
        bits &= bits.wrapping_sub(1);
        if stream < u32::BITS { usize::try_from(stream).ok() } else { None }
    })
}

impl<const N: usize> Default for Merge<N> {
    fn default() -> Merge<N> {
        Merge::new()
    }
}
