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

/// [`surely`] looks so many steps ahead at most.
pub const MOST_SURELY: u32 = 256;

/// How many steps, `most` at most, [`expand`](expand()) is sure to take, with 32 fraction bits: for who works them out without
/// looking at each.
///
/// It reckons with the largest change of the interval at each of them, so that there may be more; 0 where it cannot say.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "halves, whose ranges are looked at")]
#[must_use]
pub const fn surely(recurrence: &Recurrence, stretch: &Stretch, most: u32) -> u32 {
    let most = if most < MOST_SURELY { most } else { MOST_SURELY };
    // Whole ticks; add within 64 ticks, add2 within one.
    let interval = (recurrence.interval >> 32) as u32;
    let (add, add2) = ((recurrence.add >> 32) as i32, (recurrence.add2 >> 32) as i32);
    if interval >= 1 << 23 || add.wrapping_add(64) as u32 >= 128 || add2.wrapping_add(1) as u32 >= 2 {
        return 0;
    }
    // 2^-16 ticks, rounded down.
    let (add, add2) = ((recurrence.add >> 16) as i32, (recurrence.add2 >> 16) as i32);
    let (first, last) = (add.unsigned_abs(), (add + add2 * most as i32).unsigned_abs());
    // Of one step, with what was rounded off; then of all, ticks.
    let change = (if first > last { first } else { last }) + most + 1;
    if change >= 1 << 23 {
        return 0;
    }
    let change = ((change * most) >> 16) + 1;
    if interval < stretch.gap + change {
        return 0;
    }
    // The fraction may carry one over.
    let longest = interval + change + 1;
    if most * longest < stretch.ticks {
        return most;
    }
    // A division by shifts: a Cortex-M0+ has none.
    let (mut count, mut bit) = (0, MOST_SURELY / 2);
    while bit != 0 {
        if (count + bit) * longest < stretch.ticks && count + bit <= most {
            count += bit;
        }
        bit /= 2;
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn steady(interval: i64, add: i64) -> Recurrence {
        Recurrence { accumulator: 0, interval: interval << 32, add, add2: 0 }
    }

    #[test]
    fn a_steady_run_is_sure_up_to_the_end() {
        let stretch = |ticks| Stretch { gap: 16, ticks, bits: 0 };
        // 200 ticks, and 2 in case something was rounded off and carried over.
        assert_eq!(surely(&steady(200, 0), &stretch(202 * 100), 128), 99);
        assert_eq!(surely(&steady(200, 0), &stretch(1 << 20), 128), 128);
        assert_eq!(surely(&steady(15, 0), &stretch(1 << 20), 128), 0);
        // A tick less with each step: after 128 steps it would be too soon.
        assert_eq!(surely(&steady(140, -1 << 32), &stretch(1 << 20), 128), 0);
        assert_eq!(surely(&steady(200, -1 << 32), &stretch(1 << 20), 128), 128);
    }

    proptest! {
        #[test]
        fn what_is_sure_is_taken(
            fraction: u32,
            interval in 0i64..1 << 56,
            scale in 8u32..40,
            add in -1i64 << 40..1 << 40,
            add2 in -1i64 << 34..1 << 34,
            gap in 1u32..5000,
            ticks in 1u32..1 << 28,
            most in 1u32..300,
        ) {
            let recurrence =
                Recurrence { accumulator: fraction.into(), interval: interval >> (scale - 8), add: add >> scale, add2: add2 >> scale };
            let stretch = Stretch { gap, ticks, bits: 0 };
            let sure = surely(&recurrence, &stretch, most);
            prop_assert!(sure <= most);
            let mut words = [0; 300];
            let taken = expand::<32>(&mut recurrence.clone(), &mut words[..sure as usize], &stretch);
            prop_assert_eq!(taken, sure);
        }
    }
}
