//! Turns each step of a run into a word. This loop limits the step rate. The Pico's firmware repeats it in assembly, and a test compares
//! the two.

use crate::{Recurrence, Tick32};

/// Which steps [`Expand`] may take, and the line bits of their words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Stretch {
    /// The shortest interval between two steps, ticks.
    pub gap: u32,
    /// All steps come less than this after the last step before, ticks; below 2^25.
    pub ticks: u32,
    /// The line bits, the same in all words.
    pub bits: u32,
}

/// Moves a recurrence on by one step for each word, of which there is at least one. It stops before a step that comes too soon or too late.
/// A word is the ticks since the step before, minus the gap, plus the bits. Returns how many words it wrote.
pub type Expand = fn(&mut Recurrence, &mut [u32], &Stretch) -> u32;

/// An [`Expand`] for any processor, with `F` fraction bits.
///
/// ```
/// use pulsetrain_core::Recurrence;
/// use pulsetrain_core::pio::{Stretch, expand};
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
        let tick = |at: &Recurrence| Tick32::of(at.accumulator >> F);
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

/// The most steps that [`unchecked_steps`] looks ahead, so that its products fit in 32 bits.
pub const MAX_UNCHECKED: u32 = 256;

/// The next steps that need no check against a [`Stretch`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unchecked {
    /// How many steps [`expand`](expand()) takes for certain. It may take more.
    pub count: u32,
    /// In all of them add has one sign and is within half a tick, so that its upper half does not change.
    pub small_add: bool,
}

/// How many of the next steps, up to `most`, need no check. A loop without checks is faster. This is for 32 fraction bits.
///
/// It assumes that each interval changes as much as the one that changes most, so that there may be more. If nothing is certain, the
/// count is 0.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "halves, whose ranges are looked at")]
#[must_use]
pub const fn unchecked_steps(recurrence: &Recurrence, stretch: &Stretch, most: u32) -> Unchecked {
    const NOTHING: Unchecked = Unchecked { count: 0, small_add: false };
    let most = if most < MAX_UNCHECKED { most } else { MAX_UNCHECKED };
    // In whole ticks. Only add within 64 ticks and add2 within one are looked at: the products below fit in 32 bits then.
    let interval = (recurrence.interval >> 32) as u32;
    let (add, add2) = ((recurrence.add >> 32) as i32, (recurrence.add2 >> 32) as i32);
    if interval >= 1 << 23 || add.wrapping_add(64) as u32 >= 128 || add2.wrapping_add(1) as u32 >= 2 {
        return NOTHING;
    }
    // In 2^-16 ticks, rounded down, so that `last` may be too small by up to `rounded`.
    let (add, add2, rounded) = ((recurrence.add >> 16) as i32, (recurrence.add2 >> 16) as i32, most + 1);
    let last = add + add2 * most as i32;
    let largest = if add.unsigned_abs() > last.unsigned_abs() { add.unsigned_abs() } else { last.unsigned_abs() };
    // The change of the interval with one step; below, with all steps, in ticks.
    let change = largest + rounded;
    if change >= 1 << 23 {
        return NOTHING;
    }
    // add changes linearly, so that a bound at both ends holds between them.
    let small_add = change < 1 << 15 && ((add >= 0 && last >= 0) || (add < 0 && last < -(rounded as i32)));
    let change = ((change * most) >> 16) + 1;
    if interval < stretch.gap + change {
        return NOTHING;
    }
    // One tick more, since the fraction may carry.
    let longest = interval + change + 1;
    if most * longest < stretch.ticks {
        return Unchecked { count: most, small_add };
    }
    // A division by comparisons, since a Cortex-M0+ has no division.
    let (mut count, mut bit) = (0, MAX_UNCHECKED >> 1);
    while bit != 0 {
        if (count + bit) * longest < stretch.ticks && count + bit <= most {
            count += bit;
        }
        bit >>= 1;
    }
    Unchecked { count, small_add }
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
        let sure = |count, small_add| Unchecked { count, small_add };
        // 200 ticks, and 2 in case something was rounded off and carried over.
        assert_eq!(unchecked_steps(&steady(200, 0), &stretch(202 * 100), 128), sure(99, true));
        assert_eq!(unchecked_steps(&steady(200, 0), &stretch(202 * 128), 128), sure(127, true));
        assert_eq!(unchecked_steps(&steady(200, 0), &stretch(1 << 20), 128), sure(128, true));
        assert_eq!(unchecked_steps(&steady(15, 0), &stretch(1 << 20), 128), sure(0, false));
        // A tick less with each step: after 128 steps it would be too soon.
        assert_eq!(unchecked_steps(&steady(140, -1 << 32), &stretch(1 << 20), 128), sure(0, false));
        assert_eq!(unchecked_steps(&steady(200, -1 << 32), &stretch(1 << 20), 128), sure(128, false));
        assert_eq!(unchecked_steps(&steady(200, -1 << 30), &stretch(1 << 20), 128), sure(128, true));
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
            ticks in 1u32..1 << 25,
            most in 1u32..300,
        ) {
            let recurrence =
                Recurrence { accumulator: fraction.into(), interval: interval >> (scale - 8), add: add >> scale, add2: add2 >> scale };
            let stretch = Stretch { gap, ticks, bits: 0 };
            let sure = unchecked_steps(&recurrence, &stretch, most);
            prop_assert!(sure.count <= most);
            let mut words = [0; 300];
            let mut after = recurrence;
            let taken = expand::<32>(&mut after, &mut words[..sure.count as usize], &stretch);
            prop_assert_eq!(taken, sure.count);
            if sure.small_add {
                let upper = |add: i64| (add >> 31, add >> 32);
                prop_assert_eq!(upper(after.add), upper(recurrence.add));
            }
        }
    }
}
