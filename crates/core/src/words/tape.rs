//! The ring that words wait in. The words themselves are in memory that a DMA reads; here is what is known of them.

use crate::Moment;

/// Words one after the other that all count the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    /// Number of its first word, wrapping.
    pub first: u32,
    /// When the lines change in the word before its first.
    pub tick: Moment,
    /// The position before its first word.
    pub position: i32,
    /// What each of its words counts: 1, 0, −1.
    pub sign: i32,
}

/// Words in one run at most: so many are looked at to find a position.
const LONGEST_RUN: u32 = 64;

/// What is known of a ring of `N` words (a power of two), in up to `RUNS` runs (a power of two).
///
/// A word's place is free again once the run that it is in is past.
#[derive(Clone, Debug)]
pub struct Tape<const N: usize, const RUNS: usize> {
    /// Words written so far, wrapping.
    written: u32,
    /// Runs begun so far, and those that are past, wrapping.
    begun: u32,
    past: u32,
    runs: [Run; RUNS],
}

impl<const N: usize, const RUNS: usize> Tape<N, RUNS> {
    const WORDS: u32 = {
        assert!(N.is_power_of_two() && N <= 1 << 16 && RUNS.is_power_of_two() && RUNS <= 1 << 16);
        #[expect(clippy::cast_possible_truncation, reason = "just checked")]
        let words = N as u32;
        words
    };

    #[expect(clippy::cast_possible_truncation, reason = "checked with N")]
    const MOST: u32 = RUNS as u32;

    /// An empty tape, at tick 0 and position 0.
    #[must_use]
    pub const fn new() -> Tape<N, RUNS> {
        let unused = Run { first: 0, tick: Moment(0), position: 0, sign: 0 };
        Tape { written: 0, begun: 1, past: 0, runs: [unused; RUNS] }
    }

    /// An empty tape whose first word comes after `tick`; words are numbered from 0 again.
    pub const fn begin(&mut self, tick: Moment, position: i32) {
        (self.written, self.begun, self.past) = (0, 1, 0);
        self.runs[0] = Run { first: 0, tick, position, sign: 0 };
    }

    /// Sets the tick that the first word comes after, which was not known when the tape [began](Tape::begin) and the words
    /// that are on it were written: ticks are counted from `tick` instead of 0.
    pub fn set_start(&mut self, tick: Moment) {
        let mut number = self.past;
        while number != self.begun {
            let run = &mut self.runs[Self::place(number)];
            run.tick = run.tick.after(tick.0);
            number = number.wrapping_add(1);
        }
    }

    /// Words written so far, wrapping.
    #[must_use]
    pub const fn written(&self) -> u32 {
        self.written
    }

    /// Whether there is room for `words` words, each in a run of its own.
    #[must_use]
    pub const fn has_room(&self, words: u32) -> bool {
        let runs = Self::MOST - self.begun.wrapping_sub(self.past);
        words <= self.free() && words <= runs
    }

    /// Places in a row that may be written, from the next one on, and that one run takes: where, and how many.
    #[must_use]
    pub const fn space(&self, sign: i32) -> (usize, usize) {
        let place = self.written & (Self::WORDS - 1);
        let mut len = Self::WORDS - place;
        let last = &self.runs[Self::place(self.begun.wrapping_sub(1))];
        let used = self.written.wrapping_sub(last.first);
        let of_run = if last.sign == sign && used < LONGEST_RUN { LONGEST_RUN - used } else { LONGEST_RUN };
        if of_run < len {
            len = of_run;
        }
        if self.free() < len {
            len = self.free();
        }
        if !self.has_room(1) {
            len = 0;
        }
        (place as usize, len as usize)
    }

    /// Notes that `words` words were written where [`space`](Tape::space) said; the lines last changed at `tick` and the position
    /// was `position` before them, and each counts `sign`.
    pub fn wrote(&mut self, words: u32, tick: Moment, position: i32, sign: i32) {
        let last = &self.runs[Self::place(self.begun.wrapping_sub(1))];
        if last.sign != sign || self.written.wrapping_sub(last.first) >= LONGEST_RUN {
            self.runs[Self::place(self.begun)] = Run { first: self.written, tick, position, sign };
            self.begun = self.begun.wrapping_add(1);
        }
        self.written = self.written.wrapping_add(words);
    }

    /// Notes that time is past `now`: frees the runs that are over. To be called at least once in 2^30 ticks.
    pub fn pass(&mut self, now: Moment) {
        while self.begun.wrapping_sub(self.past) > 1 {
            let next = &self.runs[Self::place(self.past.wrapping_add(1))];
            // The word before the next run has changed the lines.
            if now.is_before(next.tick) {
                break;
            }
            self.past = self.past.wrapping_add(1);
        }
    }

    /// The position once the first `words` words (wrapping) have changed the lines.
    #[must_use]
    pub fn position_after(&self, words: u32) -> i32 {
        let run = self.find(|run| !Moment(words).is_before(Moment(run.first)));
        let within = words.wrapping_sub(run.first).cast_signed();
        run.position.wrapping_add(run.sign.wrapping_mul(within))
    }

    /// The position at tick `now`, not before the last [`pass`](Tape::pass): steps whose edges are not after it. `memory` is where the
    /// words are.
    #[must_use]
    pub fn position_at(&self, now: Moment, overhead: u32, memory: &[u32; N]) -> i32 {
        let run = self.find(|run| !now.is_before(run.tick));
        if run.sign == 0 {
            return run.position;
        }
        let (mut tick, mut number, mut position) = (run.tick, run.first, run.position);
        while number != self.written && number.wrapping_sub(run.first) < LONGEST_RUN {
            let word = memory[(number & (Self::WORDS - 1)) as usize];
            tick = tick.after((word & super::LONGEST_WAIT).wrapping_add(overhead));
            if now.is_before(tick) {
                break;
            }
            position = position.wrapping_add(run.sign);
            number = number.wrapping_add(1);
        }
        position
    }

    /// The last run that is not past and that `fits`; the first one, if none does.
    fn find(&self, fits: impl Fn(&Run) -> bool) -> &Run {
        let mut number = self.begun.wrapping_sub(1);
        while number != self.past && !fits(&self.runs[Self::place(number)]) {
            number = number.wrapping_sub(1);
        }
        &self.runs[Self::place(number)]
    }

    /// Words that may be written.
    const fn free(&self) -> u32 {
        let first = self.runs[Self::place(self.past)].first;
        Self::WORDS - self.written.wrapping_sub(first)
    }

    const fn place(run: u32) -> usize {
        (run & (Self::MOST - 1)) as usize
    }
}

impl<const N: usize, const RUNS: usize> Default for Tape<N, RUNS> {
    fn default() -> Tape<N, RUNS> {
        Tape::new()
    }
}
