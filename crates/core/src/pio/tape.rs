//! The tape: a ring of words that wait for the state machine. It knows which places hold words that are not done, and the motor's position
//! and tick at each. The words themselves are in memory that a DMA reads.

use crate::Tick32;

/// Successive words that all count the same: a step forward, a step backward, or none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    /// The number of its first word, wrapping.
    pub first: u32,
    /// The tick at which the word before its first changes the lines.
    pub tick: Tick32,
    /// The position before its first word.
    pub position: i32,
    /// The steps that each of its words counts: 1, 0 or −1.
    pub sign: i32,
}

/// The most words in one run. To find a position, up to so many words are added up.
const LONGEST_RUN: u32 = 256;

/// The book-keeping of a ring of `N` words (a power of two), in up to `RUNS` runs (a power of two).
///
/// The places of a run are free again when this run and the one after it are past.
#[derive(Clone, Debug)]
pub struct Tape<const N: usize, const RUNS: usize> {
    /// The number of words written so far, wrapping.
    written: u32,
    /// The numbers of the newest run and of the oldest that is kept, wrapping.
    last: u32,
    first: u32,
    runs: [Run; RUNS],
}

impl<const N: usize, const RUNS: usize> Tape<N, RUNS> {
    const WORDS: u32 = {
        assert!(N.is_power_of_two() && N <= 1 << 15 && RUNS.is_power_of_two() && RUNS <= 1 << 15);
        #[expect(clippy::cast_possible_truncation, reason = "just checked")]
        let words = N as u32;
        words
    };

    #[expect(clippy::cast_possible_truncation, reason = "checked with N")]
    const MOST: u32 = RUNS as u32;

    /// An empty tape, at tick 0 and position 0: all zeros.
    #[must_use]
    pub const fn new() -> Tape<N, RUNS> {
        let unused = Run { first: 0, tick: Tick32(0), position: 0, sign: 0 };
        Tape { written: 0, last: 0, first: 0, runs: [unused; RUNS] }
    }

    /// An empty tape whose first word comes after `tick`; words are numbered from 0 again.
    pub const fn begin(&mut self, tick: Tick32, position: i32) {
        (self.written, self.last, self.first) = (0, 0, 0);
        self.runs[0] = Run { first: 0, tick, position, sign: 0 };
    }

    /// Adds `tick` to the ticks of all words. It is for the start, which is not known when the tape [begins](Tape::begin) and its first words
    /// are written.
    pub fn set_start(&mut self, tick: Tick32) {
        for run in &mut self.runs {
            run.tick = run.tick.after(tick.0);
        }
    }

    /// The number of words written so far, wrapping.
    #[must_use]
    pub const fn written(&self) -> u32 {
        self.written
    }

    /// Whether `words` more words fit, even if each begins a run.
    #[must_use]
    pub const fn has_room(&self, words: u32) -> bool {
        let runs = Self::MOST - 1 - self.last.wrapping_sub(self.first);
        words <= self.free() && words <= runs
    }

    /// Where the next words go, and how many fit there in a row and in one run.
    #[must_use]
    pub const fn space(&self, sign: i32) -> (usize, usize) {
        let place = self.written & (Self::WORDS - 1);
        let mut len = Self::WORDS - place;
        let last = &self.runs[Self::place(self.last)];
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
    pub fn wrote(&mut self, words: u32, tick: Tick32, position: i32, sign: i32) {
        let last = &self.runs[Self::place(self.last)];
        if last.sign != sign || self.written.wrapping_sub(last.first) >= LONGEST_RUN {
            self.last = self.last.wrapping_add(1);
            self.runs[Self::place(self.last)] = Run { first: self.written, tick, position, sign };
        }
        self.written = self.written.wrapping_add(words);
    }

    /// Notes that time is past `now`: frees the runs that are over. To be called at least once in 2^30 ticks.
    pub fn pass(&mut self, now: Tick32) {
        // The current run stays, and the one before it for `last`, and a wait before that for `apart`.
        while self.last.wrapping_sub(self.first) > 1 {
            let next = &self.runs[Self::place(self.first.wrapping_add(2))];
            // The word before it has changed the lines.
            if now.is_before(next.tick) {
                break;
            }
            self.first = self.first.wrapping_add(1);
        }
    }

    /// The position after the first `words` words (wrapping) have changed the lines.
    #[must_use]
    pub fn position_after(&self, words: u32) -> i32 {
        let run = self.find(|run| !Tick32(words).is_before(Tick32(run.first)));
        let within = words.wrapping_sub(run.first).cast_signed();
        run.position.wrapping_add(run.sign.wrapping_mul(within))
    }

    /// The last of the first `words` words (wrapping, at least 1): when it changed the lines, how long that was after the word before,
    /// and what it counts.
    #[must_use]
    pub fn last(&self, words: u32, overhead: u32, memory: &[u32; N]) -> (Tick32, u32, i32) {
        let last = words.wrapping_sub(1);
        let run = self.find(|run| !Tick32(last).is_before(Tick32(run.first)));
        let (mut tick, mut number) = (run.tick, run.first);
        loop {
            let lasts = self.lasts(number, overhead, memory);
            tick = tick.after(lasts);
            if number == last || number.wrapping_sub(run.first) >= LONGEST_RUN {
                return (tick, lasts, run.sign);
            }
            number = number.wrapping_add(1);
        }
    }

    /// How far apart steps are by tick `now`, when the first `words` words (wrapping, at least 1) have changed the lines, ticks: the last two
    /// of them, or the last and the next, if the one before is forgotten; or the time since the last, if that is longer. Words between steps
    /// are none: a wait is written as several. Of a next step that is not written yet it is known that it comes later than what is.
    #[must_use]
    #[inline(never)]
    pub fn apart(&self, words: u32, now: Tick32, overhead: u32, memory: &[u32; N]) -> u32 {
        let last = words.wrapping_sub(1);
        let run_of = |number: u32| &self.runs[Self::place(number)];
        let mut current = self.last;
        while current != self.first && Tick32(last).is_before(Tick32(run_of(current).first)) {
            current = current.wrapping_sub(1);
        }
        let run = run_of(current);
        // The last step, when it was, and which run it is in, if that is kept.
        let (step, stepped, back) = match run.sign {
            0 => (run.first.wrapping_sub(1), run.tick, 1),
            _ => (last, self.last(words, overhead, memory).0, 0),
        };
        let before = |back: u32| (current.wrapping_sub(self.first) >= back).then(|| run_of(current.wrapping_sub(back)));
        let steps = before(back).filter(|steps| steps.sign != 0);
        let gap = match (steps, before(back + 1)) {
            (Some(steps), _) if step != steps.first => self.lasts(step, overhead, memory),
            (Some(_), Some(Run { sign: 0, tick, .. })) => stepped.since(*tick),
            (Some(_), Some(_)) => self.lasts(step, overhead, memory),
            _ => self.next(current, words, overhead, memory).since(stepped),
        };
        gap.max(now.since(stepped))
    }

    /// The tick of the first step after the first `words` words, the last of which is in run `current`; that of the last word, if no step is
    /// written.
    fn next(&self, current: u32, words: u32, overhead: u32, memory: &[u32; N]) -> Tick32 {
        let mut number = current;
        while number != self.last {
            number = number.wrapping_add(1);
            let run = &self.runs[Self::place(number)];
            if run.sign != 0 {
                return run.tick.after(self.lasts(run.first, overhead, memory));
            }
        }
        self.last(if self.written == 0 { words } else { self.written }, overhead, memory).0
    }

    /// The time from the word before changing the lines to this word changing them, ticks.
    fn lasts(&self, number: u32, overhead: u32, memory: &[u32; N]) -> u32 {
        (memory[(number & (Self::WORDS - 1)) as usize] & super::LONGEST_WAIT).wrapping_add(overhead)
    }

    /// The position at tick `now`, which is not before the last [`pass`](Tape::pass). `memory` holds the words.
    #[must_use]
    pub fn position_at(&self, now: Tick32, overhead: u32, memory: &[u32; N]) -> i32 {
        let run = self.find(|run| !now.is_before(run.tick));
        if run.sign == 0 {
            return run.position;
        }
        let (mut tick, mut number, mut position) = (run.tick, run.first, run.position);
        while number != self.written && number.wrapping_sub(run.first) < LONGEST_RUN {
            tick = tick.after(self.lasts(number, overhead, memory));
            if now.is_before(tick) {
                break;
            }
            position = position.wrapping_add(run.sign);
            number = number.wrapping_add(1);
        }
        position
    }

    /// The newest run that `fits`; the oldest that is kept, if none does.
    fn find(&self, fits: impl Fn(&Run) -> bool) -> &Run {
        let mut number = self.last;
        while number != self.first && !fits(&self.runs[Self::place(number)]) {
            number = number.wrapping_sub(1);
        }
        &self.runs[Self::place(number)]
    }

    /// How many words can be written now.
    const fn free(&self) -> u32 {
        let first = self.runs[Self::place(self.first)].first;
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
