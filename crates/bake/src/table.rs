//! A motor's plan as rows of a table that an Uno's program can play, and what of it repeats for ever.
//!
//! What repeats begins in the widest gap between two steps, most often at a turning point. The time of the step before that gap is
//! kept apart: each turn adds the period to it, in ticks of 2^-48, so that nothing adds up over the years; the gap takes up what
//! that moves. Step by step a turn is the one before it, put off by the period to within a tick.

use std::collections::VecDeque;

use pulsetrain_core::{Direction, Segment};
use pulsetrain_motion::Time;
use pulsetrain_motion::program::{Motor, Program};
use pulsetrain_motion::time::{MOST_PERIODS, common_period};
use pulsetrain_plan::Move;

use crate::BakeError;

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

    fn segment(&self) -> Segment {
        let interval = i64::from(self.ticks) << 16 | i64::from(self.part);
        Segment { count: self.count.into(), interval, add: self.add.into(), add2: self.add2.into() }
    }

    /// Ticks · 2^-16.
    fn lasts(&self) -> u64 {
        let segment = self.segment();
        if self.count == 0 { u64::from(self.ticks) << 16 } else { segment.span(segment.count) as u64 }
    }
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
    /// What of the steps was put off.
    pub put_off: PutOff,
}

/// Steps that come later than their law has them, since motors share a DIR line; what repeats counts once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PutOff {
    /// How many.
    pub steps: u64,
    /// The longest that one waits, ticks.
    pub longest_ticks: u64,
}

impl PutOff {
    fn add(&mut self, ticks: u64) {
        self.steps += u64::from(ticks > 0);
        self.longest_ticks = self.longest_ticks.max(ticks);
    }
}

impl std::iter::Sum for PutOff {
    fn sum<I: Iterator<Item = PutOff>>(all: I) -> PutOff {
        all.fold(PutOff::default(), |sum, one| PutOff {
            steps: sum.steps + one.steps,
            longest_ticks: sum.longest_ticks.max(one.longest_ticks),
        })
    }
}

impl Table {
    /// Steps of the rows from one on, as a player makes them that begins at `at` (ticks · 2^-16): when, and whether backward.
    pub fn played(&self, from: usize, mut at: u64) -> impl Iterator<Item = (u64, bool)> + '_ {
        self.rows[from..].iter().flat_map(move |row| {
            let (begin, segment) = (at, row.segment());
            at += row.lasts();
            (1..=segment.count).map(move |k| (begin + segment.span(k) as u64, row.backward))
        })
    }

    /// How much of its time a player is busy with these steps where they are the most work.
    #[must_use]
    pub fn load(&self, work: &Work) -> Load {
        let mut worst = Load { busy: 0.0, steps_per_tick: 0.0 };
        // Time and work of the last steps.
        let mut window: VecDeque<(u64, f64)> = VecDeque::new();
        let (mut at, mut due, mut way) = (0, 0.0, None);
        let again = self.turn.map_or(&[][..], |turn| &self.rows[turn.from..]);
        // Short turns as often as they fill the window.
        let steps: usize = again.iter().map(|row| usize::from(row.count)).sum();
        let times = 1 + 2 * Load::STEPS / steps.max(1);
        for row in self.rows.iter().chain(std::iter::repeat_n(again, times).flatten()) {
            due += work.row;
            let segment = row.segment();
            for k in 1..=segment.count {
                let turns = way.replace(row.backward).is_some_and(|way| way != row.backward);
                due += work.step + if turns { work.turn } else { 0.0 };
                window.push_back((at + segment.span(k) as u64, std::mem::take(&mut due)));
                if window.len() > Load::STEPS {
                    let (began, _) = window.pop_front().unwrap_or_default();
                    let ticks = (at + segment.span(k) as u64 - began) as f64 / 65_536.0;
                    let busy = window.iter().map(|(_, work)| work).sum::<f64>() / ticks;
                    if busy > worst.busy {
                        worst = Load { busy, steps_per_tick: Load::STEPS as f64 / ticks };
                    }
                }
            }
            at += row.lasts();
        }
        worst
    }

    /// When each row begins, ticks · 2^-16.
    fn begins(&self) -> impl Iterator<Item = u64> + '_ {
        self.rows.iter().scan(0, |at, row| Some(std::mem::replace(at, *at + row.lasts())))
    }
}

/// What a player has to do, ticks.
#[derive(Clone, Copy, Debug)]
pub struct Work {
    /// For a step.
    pub step: f64,
    /// For a row, beside its steps.
    pub row: f64,
    /// For a turn of DIR, beside the step after it.
    pub turn: f64,
}

/// How busy a player is with a motor where it is busiest.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    /// Work by time.
    pub busy: f64,
    /// How fast the steps are there.
    pub steps_per_tick: f64,
}

impl Load {
    /// Steps that are looked at together. Those of four motors are no more than the events that a player works out ahead: a stretch
    /// with more work than time is no longer than what lies ready.
    const STEPS: usize = 15;
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
    moves: Vec<Planned>,
    steps: u64,
    /// Of the last step, ticks · 2^-F.
    last: Option<i128>,
    /// Between two steps, ticks · 2^-F.
    shortest: i128,
}

/// A move, where it begins: ticks · 2^-F, steps before it, and by how many ticks it was put off.
#[derive(Clone, Debug)]
struct Planned {
    at: i128,
    before: u64,
    next: Move,
    put_off_ticks: u64,
}

impl Planned {
    const fn steps(&self) -> u32 {
        match self.next {
            Move::Run { segment, .. } => segment.count,
            Move::Dwell { .. } => 0,
        }
    }
}

/// A step of a plan: when (ticks · 2^-F), in which move, which one of its steps (from 1 on), which way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub(super) at: i128,
    number: usize,
    k: u32,
    pub(super) way: Direction,
}

/// Where a turn is cut out of a plan.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    /// The number of the step before it, counted from 0, and how many steps it has.
    first: u64,
    turn_steps: u64,
    /// The step before it, its own first one, and its last.
    pub(super) begin: Step,
    pub(super) second: Step,
    pub(super) end: Step,
    /// From its last step to the next turn's first one, ticks · 2^-F rounded down.
    seam: i128,
}

impl Unrolled {
    /// Before the first move.
    #[must_use]
    pub const fn new(fraction_bits: u32) -> Unrolled {
        let at = 1 << (fraction_bits - 1);
        Unrolled { fraction_bits, at, moves: Vec::new(), steps: 0, last: None, shortest: i128::MAX }
    }

    /// The tick that it has come to.
    #[must_use]
    pub const fn tick(&self) -> u64 {
        (self.at >> self.fraction_bits) as u64
    }

    /// How many moves it has.
    #[must_use]
    pub const fn moves(&self) -> usize {
        self.moves.len()
    }

    /// The tick that a move begins at.
    #[must_use]
    pub fn tick_of(&self, number: usize) -> u64 {
        self.moves.get(number).map_or(self.tick(), |planned| (planned.at >> self.fraction_bits) as u64)
    }

    /// The shortest interval between two steps so far, ticks; [`u64::MAX`] if there are none.
    #[must_use]
    pub fn shortest(&self) -> u64 {
        u64::try_from(self.shortest >> self.fraction_bits).unwrap_or(u64::MAX)
    }

    /// The next move of the plan, and by how many ticks it was put off.
    pub fn push(&mut self, next: Move, put_off_ticks: u64) {
        let planned = Planned { at: self.at, before: self.steps, next, put_off_ticks };
        match next {
            Move::Dwell { ticks } => self.at += i128::from(ticks) << self.fraction_bits,
            Move::Run { segment, .. } => {
                for k in 1..=segment.count {
                    let at = self.at + segment.span(k);
                    self.shortest = self.last.map_or(self.shortest, |last| self.shortest.min(at - last));
                    self.last = Some(at);
                }
                self.steps += u64::from(segment.count);
                self.at += segment.span(segment.count);
            }
        }
        self.moves.push(planned);
    }

    /// Its steps from one on, counted from 0.
    fn steps_from(&self, first: u64) -> impl Iterator<Item = Step> + '_ {
        let begin = self.moves.partition_point(|planned| planned.before + u64::from(planned.steps()) <= first);
        self.moves.iter().enumerate().skip(begin).flat_map(move |(number, planned)| {
            let done = first.saturating_sub(planned.before) as u32;
            let run = match planned.next {
                Move::Run { segment, direction } => Some((segment, direction)),
                Move::Dwell { .. } => None,
            };
            run.into_iter().flat_map(move |(segment, way)| {
                let at = move |k| planned.at + segment.span(k);
                (done + 1..=segment.count).map(move |k| Step { at: at(k), number, k, way })
            })
        })
    }

    /// The table of it. `cycle`: from which time on it repeats, and after which time.
    ///
    /// # Errors
    /// [`BakeError::NotPeriodic`], [`BakeError::NoStep`], [`BakeError::Wait`].
    pub fn table(self, motor: &Motor, program: &Program, cycle: Option<(Time, Time)>) -> Result<Table, BakeError> {
        let mut rows = Rows { rows: Vec::new(), motor: &motor.name, hz: program.board.tick_hz, waited: 0 };
        let Some(cycle) = cycle else {
            for next in self.all() {
                rows.push(&next)?;
            }
            let (shortest, put_off) = (self.shortest(), self.put_off(None));
            return Ok(Table { rows: rows.rows, turn: None, steps: self.steps, shortest, put_off });
        };
        let Cut { first, begin, end, seam, turn_steps, .. } = self.cut(motor, program, cycle)?;
        for next in self.part(None, begin) {
            rows.push(&next)?;
        }
        let turn_from = rows.rows.len();
        let base = u64::try_from(begin.at).unwrap_or(0);
        for next in self.part(Some(begin), end) {
            rows.push(&next)?;
        }
        let shortest = self.shortest().min((seam >> self.fraction_bits) as u64);
        // 2^-64 s · ticks/s, in ticks · 2^-48.
        let exact = (cycle.1.raw() * i128::from(program.board.tick_hz)) >> (64 - PERIOD_BITS);
        let turn = Turn { from: turn_from, base, period: exact.cast_unsigned() };
        let put_off = self.put_off(Some(end));
        Ok(Table { rows: rows.rows, turn: Some(turn), steps: first + 1 + turn_steps, shortest, put_off })
    }

    /// A turn that was cut out, as it is played.
    pub(super) fn turns(&self, cut: &Cut, period: Time, hz: u64) -> Turns {
        let ticks = |at: i128| ((at << 16) >> self.fraction_bits).cast_unsigned() as u64;
        let steps = self.steps_from(cut.first + 1).take(cut.turn_steps as usize);
        Turns {
            begins: ticks(cut.begin.at),
            // 2^-64 s · ticks/s, in ticks · 2^-16.
            period: ((period.raw() * i128::from(hz)) >> 48).cast_unsigned() as u64,
            steps: steps.map(|step| (ticks(step.at - cut.begin.at), step.way == Direction::Backward)).collect(),
        }
    }

    /// What was put off of it, up to and with a step, or of all of it.
    pub(super) fn put_off(&self, upto: Option<Step>) -> PutOff {
        let mut put_off = PutOff::default();
        let most = upto.map_or(self.moves.len(), |upto| upto.number + 1);
        self.moves.iter().take(most).for_each(|planned| put_off.add(planned.put_off_ticks));
        put_off
    }

    /// All its moves.
    pub(super) fn all(&self) -> impl Iterator<Item = Move> + '_ {
        self.moves.iter().map(|planned| planned.next)
    }

    /// Where the first turn is cut out of a plan that repeats from a time on, after another.
    ///
    /// # Errors
    /// [`BakeError::NotPeriodic`], [`BakeError::NoStep`].
    pub(super) fn cut(&self, motor: &Motor, program: &Program, (from, period): (Time, Time)) -> Result<Cut, BakeError> {
        let hz = program.board.tick_hz;
        let bits = self.fraction_bits;
        // 2^-64 s · ticks/s.
        let turn = (period.raw() * i128::from(hz)) >> (64 - bits);
        let (after_s, period_s) = (from.seconds(), period.seconds());
        let name = || motor.name.clone();
        let no_step = || BakeError::NoStep { motor: name(), after_s, period_s };
        let (first, turn_steps) = self.gap(from, turn, hz).ok_or_else(no_step)?;
        // Each step a period later is the same, but for what both certificates allow, and for a wait for a shared DIR line: which of two steps that
        // are due together comes first may be another in each period.
        let allowed = (2.0 * program.tolerance.ticks(hz) + 2.0) as i128;
        let put_off = |step: Step| i128::from(self.moves[step.number].put_off_ticks);
        let pairs = self.steps_from(first + 1).zip(self.steps_from(first + 1 + turn_steps)).take(turn_steps as usize);
        let is_same = |(now, later): (Step, Step)| {
            let apart = ((later.at - now.at - turn) >> bits).abs();
            apart <= allowed + put_off(now) + put_off(later) && now.way == later.way
        };
        if let Some(step) =
            pairs.map(is_same).chain([false]).position(|same| !same).filter(|n| *n < turn_steps as usize)
        {
            return Err(BakeError::NotPeriodic { motor: name(), step: step + 1, after_s, period_s });
        }
        let mut ends = self.steps_from(first);
        let (begin, second) = ends.next().zip(ends.next()).ok_or_else(no_step)?;
        let end = self.steps_from(first + turn_steps).next().ok_or_else(no_step)?;
        // Where a turn ends and the next begins the gap takes up what the steps before it were moved.
        let seam = second.at - begin.at - (end.at - begin.at - turn);
        let timing = program.timing(motor).ticks(hz);
        let needed = if begin.way == second.way { timing.pulse_high + timing.pulse_low } else { timing.reversal() };
        if seam < i128::from(needed) << bits {
            return Err(BakeError::NotPeriodic { motor: name(), step: turn_steps as usize, after_s, period_s });
        }
        Ok(Cut { first, turn_steps, begin, second, end, seam })
    }

    /// The step before the widest gap of the first period after `from`, and how many steps a period has; `None` if it has none.
    fn gap(&self, from: Time, period: i128, hz: u64) -> Option<(u64, u64)> {
        let from = i128::from(from.ticks(hz).0) << self.fraction_bits;
        let pairs = (0..).zip(self.steps_from(0).zip(self.steps_from(1)));
        let of_period =
            pairs.skip_while(|(_, (step, _))| step.at < from).take_while(|(_, (step, _))| step.at < from + period);
        let widest = of_period.max_by_key(|(_, (step, next))| next.at - step.at);
        let (first, (step, next)) = widest?;
        let middle = i128::midpoint(step.at, next.at);
        let steps = self.steps_from(first + 1).take_while(|step| step.at < middle + period).count() as u64;
        (steps > 0).then_some((first, steps))
    }

    /// The moves of what comes after a step (or from the beginning), up to and with another.
    pub(super) fn part(&self, after: Option<Step>, upto: Step) -> impl Iterator<Item = Move> + '_ {
        let begin = after.map_or(0, |after| after.number);
        (begin..=upto.number).filter_map(move |number| {
            let Move::Run { segment, direction } = self.moves[number].next else {
                return Some(self.moves[number].next);
            };
            let done = after.filter(|after| after.number == number).map_or(0, |after| after.k);
            let end = if number == upto.number { upto.k } else { segment.count };
            (end > done).then(|| Move::Run { segment: segment.after(done).truncated(end - done), direction })
        })
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

/// The tick up to which so many rows of all tables last.
#[must_use]
pub fn tick_of(tables: &[Table], rows: usize) -> u64 {
    let mut begins: Vec<u64> = tables.iter().flat_map(Table::begins).collect();
    begins.sort_unstable();
    begins.get(rows).map_or(u64::MAX, |begin| begin >> 16)
}

/// From when on an endless motor repeats, and after which time; with others on its DIR line only together with them, since they put
/// its steps off. `None` of a motor that ends.
///
/// # Errors
/// [`BakeError::Endless`], [`BakeError::NoCommonPeriod`].
pub fn cycle(program: &Program, motor: &Motor) -> Result<Option<(Time, Time)>, BakeError> {
    if motor.law.end().is_some() {
        return Ok(None);
    }
    let line = program.motors.iter().filter(|other| std::ptr::eq(*other, motor) || other.shares_dir_with(motor));
    let (mut from, mut periods) = (Time::ZERO, Vec::new());
    for member in line {
        let endless = || BakeError::Endless { motor: member.name.clone() };
        from = from.max(match member.law.end() {
            Some(end) => end,
            None => {
                let (begins, period) = member.law.cycle().ok_or_else(endless)?;
                periods.push(period);
                begins
            }
        });
    }
    let common = common_period(&periods).ok_or(BakeError::NoCommonPeriod { most: MOST_PERIODS })?;
    Ok(Some((from, common)))
}

/// A motor's turn, as what is played for ever.
#[derive(Clone, Debug)]
pub(super) struct Turns {
    /// When the first one begins, and after how long it comes again, ticks · 2^-16.
    begins: u64,
    period: u64,
    /// Its steps, from where it begins on: when, and whether backward.
    steps: Vec<(u64, bool)>,
}

impl Turns {
    /// Its steps for ever.
    fn played(&self) -> impl Iterator<Item = (u64, bool)> + '_ {
        (0..).flat_map(|turn: u64| {
            let begins = self.begins + turn * self.period;
            self.steps.iter().map(move |(at, backward)| (begins + at, *backward))
        })
    }
}

/// Whether motors that share a DIR line leave it the time to turn between their opposite steps, for ever: each repeats its own turn of
/// the plan, which began at another step than its neighbour's.
///
/// # Errors
/// [`BakeError::Meet`].
pub fn check_lines(program: &Program, tables: &[Table]) -> Result<(), BakeError> {
    let turns = tables.iter().map(|table| {
        let Turn { from, base, period } = table.turn?;
        let steps = table.played(from, 0).collect();
        Some(Turns { begins: base, period: (period >> (PERIOD_BITS - 16)) as u64, steps })
    });
    check_turns(program, &turns.collect::<Vec<_>>())
}

/// The same of turns; `None` of a motor that ends.
///
/// # Errors
/// [`BakeError::Meet`].
pub(super) fn check_turns(program: &Program, turns: &[Option<Turns>]) -> Result<(), BakeError> {
    for (index, first) in program.motors.iter().enumerate() {
        let with = |other: &Motor| other.shares_dir_with(first);
        if program.motors[..index].iter().any(with) {
            continue;
        }
        let on_line = program.motors.iter().zip(turns).skip(index);
        let line: Vec<_> = on_line.filter(|(motor, _)| std::ptr::eq(*motor, first) || with(motor)).collect();
        if line.len() > 1 {
            check_line(program, &line)?;
        }
    }
    Ok(())
}

fn check_line(program: &Program, line: &[(&Motor, &Option<Turns>)]) -> Result<(), BakeError> {
    // Times in turns may be a tick off, each.
    const ROUNDING: u64 = 2;
    let timings = || line.iter().map(|(motor, _)| program.timing(motor).ticks(program.board.tick_hz));
    let hold = timings().map(|timing| timing.pulse_high + timing.dir_hold).max().unwrap_or(0);
    let setup = timings().map(|timing| timing.dir_setup).max().unwrap_or(0);
    let needed = (hold + setup).saturating_sub(ROUNDING);
    let turns = || line.iter().filter_map(|(_, turns)| turns.as_ref());
    let Some(begin) = turns().map(|turns| turns.begins).max() else { return Ok(()) };
    let period = turns().map(|turns| turns.period).max().unwrap_or(0);
    let end = begin + period + (needed << 16);
    let mut played: Vec<_> = turns()
        .map(|turns| {
            turns.played().skip_while(move |(at, _)| *at <= begin).take_while(move |(at, _)| *at <= end).peekable()
        })
        .collect();
    let mut last: Option<(u64, bool)> = None;
    loop {
        let next = played.iter_mut().filter_map(|steps| Some((steps.peek()?.0, steps)));
        let Some((_, first)) = next.min_by_key(|(at, _)| *at) else { return Ok(()) };
        let Some((at, backward)) = first.next() else { return Ok(()) };
        if let Some((before, _)) = last.filter(|(before, way)| *way != backward && (at >> 16) - (before >> 16) < needed)
        {
            let motors = line.iter().map(|(motor, _)| motor.name.as_str()).collect::<Vec<_>>().join(", ");
            return Err(BakeError::Meet { motors, apart_ticks: (at >> 16) - (before >> 16), needed_ticks: needed });
        }
        last = Some((at, backward));
    }
}
