//! The merge: edges of all motors in one time-ordered stream.

use crate::Moment;
use crate::output::Edge;

/// Merges up to `N` (at most 32) streams of edges, each in order, none more than 2^31 ticks from another.
///
/// Edges at one tick come out as one; those that change nothing do not come out at all.
///
/// ```
/// use pulsetrain_core::{Merge, Moment, output::Edge};
/// let edge = |tick, set, clear| Edge { tick: Moment(tick), set, clear };
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
    /// Streams that had nothing to give since `reopen`; bit i is stream i.
    dry: u32,
    levels: u32,
}

impl<const N: usize> Merge<N> {
    /// All lines low.
    #[must_use]
    pub const fn new() -> Merge<N> {
        const { assert!(N <= 32) };
        Merge { heads: [None; N], dry: 0, levels: 0 }
    }

    /// Asks streams again that had nothing to give: when there is more to come, or time went on.
    pub const fn reopen(&mut self) {
        self.dry = 0;
    }

    /// The next edge; `pull(i)` gives the next of stream i, or `None` if it has none for now.
    pub fn next(&mut self, mut pull: impl FnMut(usize) -> Option<Edge>) -> Option<Edge> {
        loop {
            let tick = self.earliest(&mut pull)?;
            let before = self.levels;
            for (stream, head) in self.heads.iter_mut().enumerate() {
                while let Some(edge) = *head
                    && edge.tick == tick
                {
                    self.levels = (self.levels & !edge.clear) | edge.set;
                    *head = pull(stream);
                    if head.is_none() {
                        self.dry |= 1 << stream;
                    }
                }
            }
            let changed = before ^ self.levels;
            if changed != 0 {
                return Some(Edge { tick, set: changed & self.levels, clear: changed & before });
            }
        }
    }

    /// The levels of all lines after the last edge that came out.
    #[must_use]
    pub const fn levels(&self) -> u32 {
        self.levels
    }

    fn earliest(&mut self, pull: &mut impl FnMut(usize) -> Option<Edge>) -> Option<Moment> {
        let mut earliest: Option<Moment> = None;
        for (stream, head) in self.heads.iter_mut().enumerate() {
            if head.is_none() && self.dry & (1 << stream) == 0 {
                *head = pull(stream);
                if head.is_none() {
                    self.dry |= 1 << stream;
                }
            }
            if let Some(edge) = head
                && earliest.is_none_or(|tick| edge.tick.is_before(tick))
            {
                earliest = Some(edge.tick);
            }
        }
        earliest
    }
}

impl<const N: usize> Default for Merge<N> {
    fn default() -> Merge<N> {
        Merge::new()
    }
}
