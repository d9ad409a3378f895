//! A motor's plan as rows of a table that an Uno's program can play, and the rows that repeat.
//!
//! The repeating part (a turn) begins in the widest gap between two steps, most often at a turning point. The time of
//! the step before that gap is stored separately: each turn adds the period to it, in ticks of 2^-48, so that no rounding
//! error grows over the years. The gap absorbs the difference. Each step of a turn comes a period after its step in the
//! turn before, to within a tick.

use std::collections::VecDeque;

use pulsetrain_core::{Direction, Segment};
use pulsetrain_motion::Time;
use pulsetrain_motion::program::{Motor, Program};
use pulsetrain_motion::time::{MOST_PERIODS, common_period};
use pulsetrain_plan::Move;

use crate::error::BakeError;

/// The longest wait, ticks: the player compares times within half the range of 32 bits.
const LONGEST_WAIT: u64 = 1 << 31;
/// Bits after the point of a period in ticks.
pub const PERIOD_BITS: u32 = 48;

/// A row: `count` steps, or a wait if `count` is 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// Steps, at most 2^15 − 1; 0 is a wait.
    pub count: u16,
    /// The direction of the steps.
    pub backward: bool,
    /// Whole ticks of the interval to the first step, or of the wait.
    pub ticks: u32,
    /// The rest of that interval, ticks · 2^-16.
    pub part: u16,
    /// Added to the interval after each step, ticks · 2^-16.
    pub add: i32,
    /// Added to `add` after each step, ticks · 2^-16.
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

/// A motor's rows. They begin at tick 0, fraction ½.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Table {
    /// The rows in order.
    pub rows: Vec<Row>,
    /// The rows that repeat. `None` of a motion that ends.
    pub turn: Option<Turn>,
    /// Number of steps in the rows.
    pub steps: u64,
    /// The shortest interval between two steps, ticks.
    pub shortest: u64,
    /// The steps that a shared DIR line delays.
    pub put_off: PutOff,
}

/// Steps that come later than their law has them, because motors share a DIR line. Repeated steps count once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PutOff {
    /// Number of delayed steps.
    pub steps: u64,
    /// The longest delay of one step, ticks.
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
    /// The steps of the rows from row `from` on, for a player that begins at `at` (ticks · 2^-16): each with its time
    /// and whether it goes backward.
    pub fn played(&self, from: usize, mut at: u64) -> impl Iterator<Item = (u64, bool)> + '_ {
        self.rows[from..].iter().flat_map(move |row| {
            let (begin, segment) = (at, row.segment());
            at += row.lasts();
            (1..=segment.count).map(move |k| (begin + segment.span(k) as u64, row.backward))
        })
    }

    /// The share of its time that a player needs for these steps, where they are the most work.
    #[must_use]
    pub fn load(&self, work: &Work) -> Load {
        let mut worst = Load { busy: 0.0, steps_per_tick: 0.0 };
        // Time and work of the last steps.
        let mut window: VecDeque<(u64, f64)> = VecDeque::new();
        let (mut at, mut due, mut way) = (0, 0.0, None);
        let again = self.turn.map_or(&[][..], |turn| &self.rows[turn.from..]);
        // A turn that is shorter than the window is repeated until it fills the window.
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

/// The player's work, ticks.
#[derive(Clone, Copy, Debug)]
pub struct Work {
    /// For a step.
    pub step: f64,
    /// For a row, in addition to its steps.
    pub row: f64,
    /// For a reversal of DIR, in addition to the step after it.
    pub turn: f64,
}

/// The stretch of a motor's motion that is the most work for a player.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    /// Work divided by time.
    pub busy: f64,
    /// The step rate there.
    pub steps_per_tick: f64,
}

impl Load {
    /// Number of steps in the stretch that is looked at. Those of four motors are no more than the events that a player
    /// works out ahead. So a stretch with more work than time is no longer than the player's look-ahead.
    const STEPS: usize = 15;
}

/// The rows that repeat for ever.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Turn {
    /// The first row that repeats. The last row of the table is the last that repeats.
    pub from: usize,
    /// When the first turn begins, ticks · 2^-16: the time of the step before it.
    pub base: u64,
    /// Ticks · 2^-[`PERIOD_BITS`].
    pub period: u128,
}

/// A plan, unrolled move by move.
#[derive(Clone, Debug)]
pub struct Unrolled {
    fraction_bits: u32,
    /// The end of the last move, ticks · 2^-F.
    at: i128,
    moves: Vec<Planned>,
    steps: u64,
    /// The time of the last step, ticks · 2^-F.
    last: Option<i128>,
    /// The shortest interval between two steps, ticks · 2^-F.
    shortest: i128,
}

/// A move with its beginning in ticks · 2^-F, the number of steps before it, and the ticks by which a shared DIR line
/// delays it.
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

/// A step of a plan: its time (ticks · 2^-F), its move, its number in that move (from 1 on), and its direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub(super) at: i128,
    number: usize,
    k: u32,
    pub(super) way: Direction,
}

/// A turn that was cut out of a plan.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cut {
    /// The number of the step before the turn, counted from 0, and the number of its steps.
    first: u64,
    turn_steps: u64,
    /// The step before the turn, the turn's first step, and its last.
    pub(super) begin: Step,
    pub(super) second: Step,
    pub(super) end: Step,
    /// From the turn's last step to the next turn's first one, ticks · 2^-F rounded down.
    seam: i128,
}

impl Unrolled {
    /// A plan before its first move.
    #[must_use]
    pub const fn new(fraction_bits: u32) -> Unrolled {
        let at = 1 << (fraction_bits - 1);
        Unrolled { fraction_bits, at, moves: Vec::new(), steps: 0, last: None, shortest: i128::MAX }
    }

    /// The tick at which the last move ends.
    #[must_use]
    pub const fn tick(&self) -> u64 {
        (self.at >> self.fraction_bits) as u64
    }

    /// The number of moves so far.
    #[must_use]
    pub const fn moves(&self) -> usize {
        self.moves.len()
    }

    /// The tick at which a move begins.
    #[must_use]
    pub fn tick_of(&self, number: usize) -> u64 {
        self.moves.get(number).map_or(self.tick(), |planned| (planned.at >> self.fraction_bits) as u64)
    }

    /// The shortest interval between two steps so far, ticks; [`u64::MAX`] if there are none.
    #[must_use]
    pub fn shortest(&self) -> u64 {
        u64::try_from(self.shortest >> self.fraction_bits).unwrap_or(u64::MAX)
    }

    /// Adds the next move of the plan, and the ticks by which a shared DIR line delays it.
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

    /// The plan's steps from one on, counted from 0.
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

    /// Makes the table of the plan. `cycle`: when the motion begins to repeat, and its period.
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

    /// A turn that was cut out, in the player's terms.
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

    /// The steps that a shared DIR line delays, up to and with a step, or all of them.
    pub(super) fn put_off(&self, upto: Option<Step>) -> PutOff {
        let mut put_off = PutOff::default();
        let most = upto.map_or(self.moves.len(), |upto| upto.number + 1);
        self.moves.iter().take(most).for_each(|planned| put_off.add(planned.put_off_ticks));
        put_off
    }

    /// All moves of the plan as rows.
    pub(super) fn all(&self) -> impl Iterator<Item = Move> + '_ {
        self.moves.iter().map(|planned| planned.next)
    }

    /// Cuts the first turn out of a plan that repeats. `from`: when it begins to repeat.
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
        // A step comes again a period later, within both steps' certificates. Where motors share a DIR line a wait for
        // that line comes on top: which of two steps that are due together comes first may differ from period to
        // period.
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
        // Where a turn ends and the next begins, the gap absorbs the shift of the steps before it.
        let seam = second.at - begin.at - (end.at - begin.at - turn);
        let timing = program.timing(motor).ticks(hz);
        let needed = if begin.way == second.way { timing.pulse_high + timing.pulse_low } else { timing.reversal() };
        if seam < i128::from(needed) << bits {
            return Err(BakeError::NotPeriodic { motor: name(), step: turn_steps as usize, after_s, period_s });
        }
        Ok(Cut { first, turn_steps, begin, second, end, seam })
    }

    /// The step before the widest gap of the first period after `from`, and the number of steps in a period. `None` if
    /// a period has no steps.
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

    /// The moves after a step (or from the beginning) up to and with another.
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

/// Collects rows.
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

    /// Waits between two steps are added up.
    fn wait(&mut self, ticks: u64) -> Result<u32, BakeError> {
        self.waited = self.waited.saturating_add(ticks);
        let seconds = |ticks: u64| ticks as f64 / self.hz as f64;
        let (wait_s, limit_s) = (seconds(self.waited), seconds(LONGEST_WAIT));
        let fits = u32::try_from(ticks).ok().filter(|_| self.waited < LONGEST_WAIT);
        fits.ok_or_else(|| BakeError::Wait { motor: self.motor.to_owned(), wait_s, limit_s })
    }

    /// Makes as few rows as the fields allow. A segment whose differences are too large for the fields becomes a row
    /// for each step.
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

/// The tick at which the first `rows` rows of all tables end.
#[must_use]
pub fn tick_of(tables: &[Table], rows: usize) -> u64 {
    let mut begins: Vec<u64> = tables.iter().flat_map(Table::begins).collect();
    begins.sort_unstable();
    begins.get(rows).map_or(u64::MAX, |begin| begin >> 16)
}

/// Turns that are planned of a motion that repeats. More than one is planned, since a turn is compared with the one
/// after it, and the cut may lie anywhere in the first. The tables hold the steps before the first turn, and one turn.
pub(crate) const TURNS: u64 = 3;

/// The limits of a player.
#[derive(Clone, Copy, Debug)]
pub struct Room {
    /// Bytes for all motors' tables.
    pub bytes: usize,
    /// Highest step rate of a motor that steps alone, steps/s.
    pub rate_hz: f64,
}

impl Room {
    /// No limit.
    pub const ANY: Room = Room { bytes: usize::MAX, rate_hz: f64::INFINITY };
}

/// The tables of all motors of a program. An endless law must repeat; its table repeats, too.
///
/// # Errors
/// [`BakeError`]: a motion that is refused or does not repeat, that is too fast or too large, or whose waits are too long.
pub fn tables(program: &Program, room: Room) -> Result<Vec<Table>, BakeError> {
    let hz = program.board.tick_hz as f64;
    let mut ensemble = pulsetrain_plan::Ensemble::new(program).map_err(BakeError::Plan)?;
    let mut tables = Vec::new();
    for (index, motor) in program.motors.iter().enumerate() {
        let cycle = cycle(program, motor)?;
        let end = cycle.map(|(from, period)| {
            let (ticks, _) = (from + period.times(TURNS)).ticks(program.board.tick_hz);
            ticks.max(0).cast_unsigned()
        });
        // More moves have more rows than fit: no plan is unrolled further, however long the motion.
        let most = (room.bytes / Row::BYTES).saturating_mul(if cycle.is_some() { 1 + TURNS as usize } else { 1 });
        let mut plan = Unrolled::new(program.board.registers.fraction_bits);
        while end.is_none_or(|end| plan.tick() <= end) {
            let Some(next) = ensemble.next_move(index).map_err(BakeError::Plan)? else { break };
            plan.push(next, ensemble.put_off_ticks(index));
            let rate_hz = hz / plan.shortest() as f64;
            if rate_hz > room.rate_hz {
                // The law's own peak, as far as it is known, is what the motion must be slowed by.
                let rate_hz = rate_hz.max(ensemble.certificate(index).peak_speed.0);
                return Err(BakeError::TooFast { rate_hz, limit_hz: room.rate_hz });
            }
            if plan.moves() > most {
                let fits_s = plan.tick_of(room.bytes / Row::BYTES) as f64 / hz;
                let bytes = plan.moves() * Row::BYTES;
                return Err(BakeError::TooLarge { board: "an Uno", bytes, limit: room.bytes, fits_s });
            }
        }
        tables.push(plan.table(motor, program, cycle)?);
    }
    let bytes = tables.iter().map(|table| table.rows.len()).sum::<usize>() * Row::BYTES;
    if bytes > room.bytes {
        let fits_s = tick_of(&tables, room.bytes / Row::BYTES) as f64 / hz;
        return Err(BakeError::TooLarge { board: "an Uno", bytes, limit: room.bytes, fits_s });
    }
    check_lines(program, &tables)?;
    Ok(tables)
}

/// When an endless motor begins to repeat, and its period. Motors on one DIR line delay one another's steps, so they
/// repeat only together. `None` of a motor that ends.
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

/// A motor's turn as it is played for ever.
#[derive(Clone, Debug)]
pub(super) struct Turns {
    /// When the first turn begins, and the period, ticks · 2^-16.
    begins: u64,
    period: u64,
    /// The turn's steps from its beginning on: each with its time and whether it goes backward.
    steps: Vec<(u64, bool)>,
}

impl Turns {
    /// The turn's steps, repeated for ever.
    fn played(&self) -> impl Iterator<Item = (u64, bool)> + '_ {
        (0..).flat_map(|turn: u64| {
            let begins = self.begins + turn * self.period;
            self.steps.iter().map(move |(at, backward)| (begins + at, *backward))
        })
    }
}

/// Whether motors that share a DIR line leave it the time to change between their opposite steps, for ever. Each motor
/// repeats a turn of its own, which may begin at another step than its neighbour's.
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

/// [`check_lines`] for turns. `None` stands for a motor that ends.
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
