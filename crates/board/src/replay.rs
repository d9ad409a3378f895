//! The steps of motors whose lease ends at a known tick: those of the plan before it, and those of the stop after it.
//!
//! A host uses it to know where the motors of a lost board came to rest. It follows the rules of `pulsetrain_core::lease`, `braking` and
//! `shared_line`, but shares no code with the channels that run on a board: tests compare the two. Ticks have 64 bits here.

use crate::ScheduledStep;
use pulsetrain_core::braking::{BrakingPart, Limit, RegisterLimits};
use pulsetrain_core::{Direction, Item, Segment, Tick32};

/// A motor, and the items that were sent for it.
#[derive(Clone, Debug)]
pub struct Sent<'a> {
    /// The motor's state before the items.
    pub start: Start,
    /// The items, in order. The board must be able to follow each run.
    pub items: &'a [Item],
    /// How hard the motor may brake.
    pub limit: Limit,
    /// Least ticks between two of its steps: a pulse and one tick more.
    pub gap_ticks: u64,
    /// The index of the DIR line that the motor shares with others, and whether that line is high for forward; `None` for a line of its own.
    pub line: Option<(usize, bool)>,
}

/// The state of a motor in its plan, or before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Start {
    /// The time of its last step, or of the end of the wait after it, ticks · 2^F.
    pub accumulator: i128,
    /// Whether an anchor, a wait or a reversal came after its last step. If its lease ends then, it rests at once.
    pub fresh: bool,
    /// Its direction, if it is not fresh.
    pub direction: Direction,
    /// The interval before its last step, ticks · 2^F. With no further item, the stop begins from this interval.
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

/// An iterator over the steps, in the order of their scheduled ticks, and by motor within a tick. Motors that brake and share a DIR line may wait for
/// it: their steps are made later than scheduled, so that the given ticks may descend there.
#[derive(Clone, Debug)]
pub struct Replay<'a> {
    motors: Vec<Walk<'a>>,
    lines: Vec<DirLine>,
    fraction_bits: u32,
    registers: RegisterLimits,
    until: Option<u64>,
}

/// A DIR line that motors share.
#[derive(Clone, Debug)]
struct DirLine {
    /// Least ticks between two steps that need it at different levels.
    apart_ticks: u64,
    /// The last step of its motors: its tick, and the line's level.
    last: Option<(u64, bool)>,
}

/// A motor on its way through its items.
#[derive(Clone, Debug)]
struct Walk<'a> {
    sent: Sent<'a>,
    items: std::slice::Iter<'a, Item>,
    /// The time of its last step or wait, ticks · 2^F.
    accumulator: i128,
    /// What is left of the current run, of the plan or of the stop.
    run: Segment,
    direction: Direction,
    fresh: bool,
    last_interval: i64,
    /// The earliest tick of its next step.
    open: u64,
    stop: Stop,
}

/// How far a motor's stop is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stop {
    /// The motor follows its plan.
    NotYet,
    /// It brakes, and a part of the stop will follow the current run.
    Part,
    /// The current run is the last step of the stop.
    LastStep,
    /// It rests.
    Rest,
}

impl<'a> Replay<'a> {
    /// Replays motors whose lease ends at `until`; without that tick the plan goes on to its end. `apart_ticks` has for each shared DIR line the least
    /// ticks between two steps that need it at different levels: the longest pulse, hold and setup of its motors.
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
        let line = |(line, ticks): (usize, &u64)| DirLine { apart_ticks: *ticks, last: last_of(line) };
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
            if let Some((DirLine { apart_ticks, last: Some((last, now)) }, level)) = &line
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
    /// The tick for which the next step is scheduled; `None` if there is none.
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

    /// A 32-bit tick in 64 bits: the one within 2^31 of the motor's own time.
    fn near(&self, tick: Tick32, fraction_bits: u32) -> u64 {
        let here = tick_of(self.accumulator, fraction_bits);
        here.saturating_add_signed(tick.since(Tick32::of(here)).cast_signed().into())
    }

    /// Begins the stop, as the lease ends before the next step. Without a planned step, the motor brakes from the interval of its last one.
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
