//! A motor's plan as rows of a table that an Uno's program can play, and what of it repeats for ever.
//!
//! What repeats begins in the widest gap between two steps, most often at a turning point. The time of the step before that gap is
//! kept apart: each turn adds the period to it, in ticks of 2^-48, so that nothing adds up over the years; the gap takes up what
//! that moves. Step by step a turn is the one before it, put off by the period to within a tick.

use pulsetrain_core::{Direction, Segment};
use pulsetrain_motion::Time;
use pulsetrain_motion::program::{Program, Wiring};
use pulsetrain_plan::Move;

use super::BakeError;

/// The longest wait, ticks: times are compared within half the range of 32 bits.
const LONGEST_WAIT: u64 = 1 << 31;
/// Bits of a tick that the period is told to.
pub const PERIOD_BITS: u32 = 48;

/// A row: `count` steps, or a wait if it is 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// Steps, at most 2^15 − 1; 0: a wait.
    pub count: u16,
    /// Which way they go.
    pub backward: bool,
    /// The interval to the first step, or the wait: ticks.
    pub ticks: u32,
    /// Of the interval: ticks · 2^-16.
    pub part: u16,
    /// Added to the interval after each step, ticks · 2^-16.
    pub add: i32,
    /// Added to that.
    pub add2: i32,
}

impl Row {
    /// Bytes of a row in flash.
    pub const BYTES: usize = 16;
    /// The most steps of a row.
    pub const MOST: u32 = (1 << 15) - 1;
}

/// A motor's rows, from tick 0, fraction ½, on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Table {
    /// In order.
    pub rows: Vec<Row>,
    /// What repeats; `None` of a motion that ends.
    pub turn: Option<Turn>,
    /// Steps of the rows.
    pub steps: u64,
    /// The shortest interval between two steps, ticks.
    pub shortest: u64,
}

/// What repeats for ever.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Turn {
    /// The row that it begins with; the last row ends it.
    pub from: usize,
    /// When the first one begins, ticks · 2^-16: the time of the step before.
    pub base: u64,
    /// Ticks · 2^-[`PERIOD_BITS`].
    pub period: u128,
}

/// A plan, move by move.
#[derive(Clone, Debug)]
pub struct Unrolled {
    fraction_bits: u32,
    /// Ticks · 2^-F.
    at: i128,
    moves: Vec<Move>,
    /// Of each step: its time, ticks · 2^-F; the move; its number in it.
    steps: Vec<(i128, usize, u32)>,
}

impl Unrolled {
    /// Before the first move.
    #[must_use]
    pub const fn new(fraction_bits: u32) -> Unrolled {
        Unrolled { fraction_bits, at: 1 << (fraction_bits - 1), moves: Vec::new(), steps: Vec::new() }
    }

    /// The tick that it has come to.
    #[must_use]
    pub const fn tick(&self) -> u64 {
        (self.at >> self.fraction_bits) as u64
    }

    /// The next move of the plan.
    pub fn push(&mut self, next: Move) {
        match next {
            Move::Dwell { ticks } => self.at += i128::from(ticks) << self.fraction_bits,
            Move::Run { segment, .. } => {
                let number = self.moves.len();
                self.steps.extend((1..=segment.count).map(|k| (self.at + segment.span(k), number, k)));
                self.at += segment.span(segment.count);
            }
        }
        self.moves.push(next);
    }

    /// The table of it. `cycle`: from which time on it repeats, and after which time.
    ///
    /// # Errors
    /// [`BakeError::NotPeriodic`], [`BakeError::Wait`].
    pub fn table(self, motor: &str, program: &Program, cycle: Option<(Time, Time)>) -> Result<Table, BakeError> {
        let hz = program.board.tick_hz;
        let mut rows = Rows { rows: Vec::new(), motor, hz, waited: 0 };
        let shortest = self.steps.windows(2).map(|pair| pair[1].0 - pair[0].0).min().unwrap_or(i128::MAX);
        let shortest = u64::try_from(shortest >> self.fraction_bits).unwrap_or(u64::MAX);
        let Some((from, period)) = cycle else {
            for next in &self.moves {
                rows.push(next)?;
            }
            return Ok(Table { rows: rows.rows, turn: None, steps: self.steps.len() as u64, shortest });
        };
        let bits = self.fraction_bits;
        // 2^-64 s · ticks/s, in ticks · 2^-48.
        let exact = (period.raw() * i128::from(hz)) >> (64 - PERIOD_BITS);
        let (first, turn_steps) = self.gap(from, exact >> (PERIOD_BITS - bits), hz);
        let not_periodic = |step| BakeError::NotPeriodic {
            motor: motor.to_owned(),
            step,
            after_s: from.seconds(),
            period_s: period.seconds(),
        };
        let (Some(first), true) = (first, turn_steps > 0) else { return Err(not_periodic(0)) };
        // Each step a period later is the same, but for what both certificates allow.
        let allowed = (2.0 * program.tolerance.ticks(hz) + 2.0) as i128;
        for step in 1..=turn_steps {
            let (Some(now), Some(later)) = (self.steps.get(first + step), self.steps.get(first + step + turn_steps))
            else {
                break;
            };
            if ((later.0 - now.0 - (exact >> (PERIOD_BITS - bits))) >> bits).abs() > allowed
                || self.way(now.1) != self.way(later.1)
            {
                return Err(not_periodic(step));
            }
        }
        self.part(None, self.steps[first], &mut rows)?;
        let turn_from = rows.rows.len();
        let base = u64::try_from(self.steps[first].0).unwrap_or(0);
        self.part(Some(self.steps[first]), self.steps[first + turn_steps], &mut rows)?;
        let turn = Turn { from: turn_from, base, period: exact.cast_unsigned() };
        Ok(Table { rows: rows.rows, turn: Some(turn), steps: (first + 1 + turn_steps) as u64, shortest })
    }

    /// The step before the widest gap of the first period after `from`, and how many steps a period has.
    fn gap(&self, from: Time, period: i128, hz: u64) -> (Option<usize>, usize) {
        let from = i128::from(from.ticks(hz).0) << self.fraction_bits;
        let widest = (0..self.steps.len().saturating_sub(1))
            .filter(|step| self.steps[*step].0 >= from && self.steps[*step].0 < from + period)
            .max_by_key(|step| self.steps[step + 1].0 - self.steps[*step].0);
        let Some(first) = widest else { return (None, 0) };
        let middle = (self.steps[first].0 + self.steps[first + 1].0) / 2;
        let steps = self.steps[first + 1..].iter().take_while(|step| step.0 < middle + period).count();
        (Some(first), steps)
    }

    fn way(&self, number: usize) -> Option<Direction> {
        match self.moves[number] {
            Move::Run { direction, .. } => Some(direction),
            Move::Dwell { .. } => None,
        }
    }

    /// Rows of what comes after a step (or from the beginning), up to and with another.
    fn part(
        &self,
        after: Option<(i128, usize, u32)>,
        upto: (i128, usize, u32),
        rows: &mut Rows<'_>,
    ) -> Result<(), BakeError> {
        let begin = after.map_or(0, |(_, number, _)| number);
        for number in begin..=upto.1 {
            let Move::Run { segment, direction } = self.moves[number] else {
                rows.push(&self.moves[number])?;
                continue;
            };
            let done = after.filter(|after| after.1 == number).map_or(0, |(_, _, k)| k);
            let end = if number == upto.1 { upto.2 } else { segment.count };
            if end > done {
                rows.run(segment.after(done).truncated(end - done), direction)?;
            }
        }
        Ok(())
    }
}

/// Rows, as they are made.
struct Rows<'a> {
    rows: Vec<Row>,
    motor: &'a str,
    hz: u64,
    /// Ticks since the last step.
    waited: u64,
}

impl Rows<'_> {
    fn push(&mut self, next: &Move) -> Result<(), BakeError> {
        match *next {
            Move::Dwell { ticks } => {
                let ticks = self.wait(ticks)?;
                self.rows.push(Row { count: 0, backward: false, ticks, part: 0, add: 0, add2: 0 });
                Ok(())
            }
            Move::Run { segment, direction } => self.run(segment, direction),
        }
    }

    /// Waits from one step to the next count together.
    fn wait(&mut self, ticks: u64) -> Result<u32, BakeError> {
        self.waited = self.waited.saturating_add(ticks);
        let seconds = |ticks: u64| ticks as f64 / self.hz as f64;
        let (wait_s, limit_s) = (seconds(self.waited), seconds(LONGEST_WAIT));
        let fits = u32::try_from(ticks).ok().filter(|_| self.waited < LONGEST_WAIT);
        fits.ok_or_else(|| BakeError::Wait { motor: self.motor.to_owned(), wait_s, limit_s })
    }

    /// As few rows as the fields hold: a segment whose differences are too large for them goes step by step.
    fn run(&mut self, mut left: Segment, direction: Direction) -> Result<(), BakeError> {
        let backward = direction == Direction::Backward;
        while left.count > 0 {
            let fits = i32::try_from(left.add).ok().zip(i32::try_from(left.add2).ok());
            let (count, (add, add2)) = fits.map_or((1, (0, 0)), |both| (left.count.min(Row::MOST), both));
            let ticks = self.wait((left.interval >> 16).max(0).cast_unsigned())?;
            self.waited = 0;
            let part = (left.interval & 0xffff) as u16;
            self.rows.push(Row { count: count as u16, backward, ticks, part, add, add2 });
            left = left.after(count);
        }
        Ok(())
    }
}

/// Whether any two motors have one DIR line.
#[must_use]
pub fn shares_a_dir_line(program: &Program) -> bool {
    let mut lines: Vec<u8> = program.motors.iter().filter_map(|motor| dir_of(&motor.wiring)).collect();
    let all = lines.len();
    lines.sort_unstable();
    lines.dedup();
    lines.len() < all
}

const fn dir_of(wiring: &Wiring) -> Option<u8> {
    match wiring {
        Wiring::StepDir { dir, .. } => Some(*dir),
        Wiring::Coils { .. } => None,
    }
}

/// The period after which all endless laws repeat together; `None` if there is none.
///
/// # Errors
/// [`BakeError::NoCommonPeriod`].
pub fn common_period(program: &Program) -> Result<Option<Time>, BakeError> {
    /// The most of the longest one's periods that are looked at.
    const MOST: u64 = 64;
    let periods: Vec<Time> =
        program.motors.iter().filter_map(|motor| motor.law.cycle()).map(|(_, period)| period).collect();
    let Some(longest) = periods.iter().max().copied() else { return Ok(None) };
    let fits = |all: Time| {
        periods.iter().all(|period| {
            let times = (all.raw() + period.raw() / 2) / period.raw();
            // Periods such as 1/3 s are rounded to 2^-64 s.
            (all.raw() - times * period.raw()).abs() <= times
        })
    };
    match (1..=MOST).map(|k| longest.times(k)).find(|all| fits(*all)) {
        Some(all) => Ok(Some(all)),
        None => Err(BakeError::NoCommonPeriod { most: MOST }),
    }
}
