//! What motors do that were sent items and whose lease ends at a tick: every step of the plan before it, and of the stop after it.
//!
//! It knows the contract (`pulsetrain_core::lease`, `braking`, `shared_line`) and nothing of a channel: a host trusts its count because
//! both come to the same. Ticks are whole here, of any length.

use crate::ScheduledStep;
use pulsetrain_core::braking::{BrakingPart, Limit, RegisterLimits};
use pulsetrain_core::{Direction, Item, Segment, Tick32};

/// A motor, and what it was sent.
#[derive(Clone, Debug)]
pub struct Sent<'a> {
    /// Where it was before them.
    pub start: Start,
    /// In order; each run can be followed by the board.
    pub items: &'a [Item],
    /// How hard it brakes.
    pub limit: Limit,
    /// Its steps are so far apart at least, ticks: a pulse and one.
    pub gap_ticks: u64,
    /// The DIR line that it shares with others, if it does, by a number below that of the lines, and whether that is high for forward.
    pub line: Option<(usize, bool)>,
}

/// A motor amid its plan, or before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Start {
    /// Its last step, or the end of the wait after it, ticks · 2^F.
    pub accumulator: i128,
    /// An anchor, a wait or a reversal came after its last step.
    pub fresh: bool,
    /// Where it goes, if it is not fresh.
    pub direction: Direction,
    /// What its last step came after, ticks · 2^F: with nothing planned the next one would, too.
    pub interval: i64,
    /// The tick and the direction of its last step, if it made one.
    pub last_step: Option<(u64, Direction)>,
}

impl Start {
    /// A motor at rest whose epoch begins at tick `from`.
    #[must_use]
    pub fn at(from: u64, fraction_bits: u32) -> Start {
        let accumulator = i128::from(from) << fraction_bits;
        Start { accumulator, fresh: true, direction: Direction::Forward, interval: 0, last_step: None }
    }
}

/// Steps in the order in which they are scheduled, those of one tick by motor. Where motors that brake share a DIR line, a step
/// can be made later than one that comes after it here.
#[derive(Clone, Debug)]
pub struct Replay<'a> {
    motors: Vec<Walk<'a>>,
    lines: Vec<Line>,
    fraction_bits: u32,
    registers: RegisterLimits,
    until: Option<u64>,
}

#[derive(Clone, Debug)]
struct Line {
    apart_ticks: u64,
    last: Option<(u64, bool)>,
}

#[derive(Clone, Debug)]
struct Walk<'a> {
    sent: Sent<'a>,
    items: std::slice::Iter<'a, Item>,
    /// Ticks · 2^F.
    accumulator: i128,
    /// What is left of the run that is under way.
    run: Segment,
    direction: Direction,
    fresh: bool,
    last_interval: i64,
    /// When its next step can be made at the earliest, ticks.
    open: u64,
    stop: Stop,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stop {
    NotYet,
    Part,
    LastStep,
    Rest,
}

impl<'a> Replay<'a> {
    /// Motors whose lease ends at `until`; without it the plan goes on to its end. Steps that want one of the lines at different levels are
    /// so many `apart_ticks` from each other: the longest pulse and hold, and the longest setup.
    #[must_use]
    pub fn new(
        motors: impl IntoIterator<Item = Sent<'a>>,
        apart_ticks: &[u64],
        fraction_bits: u32,
        until: Option<u64>,
    ) -> Replay<'a> {
        let walk = |sent: Sent<'a>| Walk {
            items: sent.items.iter(),
            accumulator: sent.start.accumulator,
            run: Segment::default(),
            direction: sent.start.direction,
            fresh: sent.start.fresh,
            last_interval: sent.start.interval,
            open: sent.start.last_step.map_or(0, |(tick, _)| tick + sent.gap_ticks),
            stop: Stop::NotYet,
            sent,
        };
        let motors: Vec<Walk<'a>> = motors.into_iter().map(walk).collect();
        let last_of = |line: usize| {
            let members = motors.iter().filter_map(|walk| Some((walk.sent.line?, walk.sent.start.last_step?)));
            let members = members.filter(|((own, _), _)| *own == line);
            members.map(|((_, high), (tick, direction))| (tick, (direction == Direction::Forward) == high)).max()
        };
        let line = |(line, ticks): (usize, &u64)| Line { apart_ticks: *ticks, last: last_of(line) };
        let lines = apart_ticks.iter().enumerate().map(line).collect();
        Replay { motors, lines, fraction_bits, registers: RegisterLimits::with_fraction_bits(fraction_bits), until }
    }
}

impl Iterator for Replay<'_> {
    type Item = ScheduledStep;

    fn next(&mut self) -> Option<ScheduledStep> {
        let Replay { motors, lines, fraction_bits, registers, until } = self;
        let scheduled = motors.iter_mut().enumerate();
        let scheduled =
            scheduled.filter_map(|(motor, walk)| Some((walk.scheduled(*fraction_bits, registers, *until)?, motor)));
        let (tick, motor) = scheduled.min()?;
        let walk = &mut motors[motor];
        let direction = walk.direction;
        let mut tick = tick;
        let line = walk
            .sent
            .line
            .map(|(line, forward_high)| (&mut lines[line], (direction == Direction::Forward) == forward_high));
        if walk.stop != Stop::NotYet {
            tick = tick.max(walk.open);
            if let Some((Line { apart_ticks, last: Some((last, now)) }, level)) = &line
                && now != level
            {
                tick = tick.max(*last + *apart_ticks);
            }
        }
        if let Some((line, level)) = line {
            line.last = Some((tick, level));
        }
        walk.take(tick, registers);
        Some(ScheduledStep { motor, tick, direction })
    }
}

impl Walk<'_> {
    /// The tick of the next step.
    fn scheduled(&mut self, fraction_bits: u32, registers: &RegisterLimits, until: Option<u64>) -> Option<u64> {
        while self.run.count == 0 && self.stop == Stop::NotYet {
            match self.items.next() {
                Some(item) => self.load(item, fraction_bits),
                None if until.is_some() => self.brake(registers),
                None => return None,
            }
        }
        let tick = |walk: &Self| tick_of(walk.accumulator + i128::from(walk.run.interval), fraction_bits);
        if let Some(until) = until
            && self.stop == Stop::NotYet
            && tick(self) >= until
        {
            self.open = self.open.max(until);
            self.brake(registers);
        }
        (self.run.count > 0).then(|| tick(self))
    }

    fn load(&mut self, item: &Item, fraction_bits: u32) {
        let half = 1 << (fraction_bits - 1);
        match *item {
            Item::Anchor { tick } => {
                self.accumulator = (i128::from(self.near(tick, fraction_bits)) << fraction_bits) + half;
                self.fresh = true;
            }
            Item::Dwell { ticks } => {
                self.accumulator += i128::from(ticks) << fraction_bits;
                self.fresh = true;
            }
            Item::Run { segment, direction } => {
                self.run = segment;
                self.fresh |= direction != self.direction;
                self.direction = direction;
            }
        }
    }

    /// The tick of a moment within 2^31 of where the motor is.
    fn near(&self, moment: Tick32, fraction_bits: u32) -> u64 {
        let here = tick_of(self.accumulator, fraction_bits);
        here.saturating_add_signed(moment.since(Tick32::of(here)).cast_signed().into())
    }

    /// The lease is over, before the next step; with none planned, it would come after the same interval as the last one.
    fn brake(&mut self, registers: &RegisterLimits) {
        let interval = if self.run.count > 0 { self.run.interval } else { self.last_interval };
        if self.fresh {
            (self.run.count, self.stop) = (0, Stop::Rest);
        } else {
            self.slow_down(interval, registers);
        }
    }

    fn slow_down(&mut self, interval: i64, registers: &RegisterLimits) {
        let next = self.sent.limit.next(interval, registers);
        self.run = next.segment(interval).unwrap_or_default();
        self.stop = match next {
            BrakingPart::Rest => Stop::Rest,
            BrakingPart::LastStep => Stop::LastStep,
            BrakingPart::Steps { .. } => Stop::Part,
        };
    }

    /// Makes the next step at `tick`.
    fn take(&mut self, tick: u64, registers: &RegisterLimits) {
        self.last_interval = self.run.interval;
        self.accumulator += i128::from(self.run.interval);
        self.run = self.run.after(1);
        self.fresh = false;
        self.open = tick + self.sent.gap_ticks;
        if self.run.count == 0 {
            match self.stop {
                Stop::Part => self.slow_down(self.run.interval, registers),
                Stop::LastStep => self.stop = Stop::Rest,
                Stop::NotYet | Stop::Rest => {}
            }
        }
    }
}

/// The whole ticks of an accumulator; board ticks are never negative.
fn tick_of(accumulator: i128, fraction_bits: u32) -> u64 {
    (accumulator >> fraction_bits) as u64
}
