//! A run's steps, one word each.

use crate::{Moment, Recurrence};

/// Up to where steps are worked out, and what their words say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Stretch {
    /// No step is sooner after the one before, ticks.
    pub gap: u32,
    /// All come within less than that, ticks; below 2^25.
    pub ticks: u32,
    /// What the lines do: in all words.
    pub bits: u32,
}

/// Moves a recurrence on by as many steps as there are words, at least one; stops before the first that comes too soon or too
/// late. Step by step it writes the ticks since the one before − the gap + the bits. Gives how many it wrote.
pub type Expand = fn(&mut Recurrence, &mut [u32], &Stretch) -> u32;

/// The [`Expand`] of any machine, for `F` fraction bits.
///
/// ```
/// use pulsetrain_core::Recurrence;
/// use pulsetrain_core::words::{Stretch, expand};
/// let mut recurrence = Recurrence { accumulator: 1 << 31, interval: 100 << 32, add: 10 << 32, add2: 0 };
/// let mut words = [0; 4];
/// let taken = expand::<32>(&mut recurrence, &mut words, &Stretch { gap: 13, ticks: 330, bits: 0xa << 25 });
/// assert_eq!((taken, words), (2, [0x1400_0057, 0x1400_0061, 0, 0]));
/// assert_eq!(recurrence.accumulator, (210 << 32) + (1 << 31));
/// ```
pub fn expand<const F: u32>(recurrence: &mut Recurrence, words: &mut [u32], stretch: &Stretch) -> u32 {
    let mut left = stretch.ticks;
    let mut taken = 0;
    for word in words {
        let mut next = *recurrence;
        next.advance();
        let tick = |at: &Recurrence| Moment::of(at.accumulator >> F);
        let ticks = tick(&next).since(tick(recurrence));
        if ticks < stretch.gap || ticks >= left {
            break;
        }
        left -= ticks;
        *word = (ticks - stretch.gap).wrapping_add(stretch.bits);
        *recurrence = next;
        taken += 1;
    }
    taken
}
