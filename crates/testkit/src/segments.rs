//! Random segments like those of a planner, and a stream of them into a board.

use super::{Random, TICK_HZ, pico};
use pulsetrain_board::{Lease, Leased, Observer, SwitchRefused};
use pulsetrain_core::packing::{MAX_PACKED_LEN, Packing, State};
use pulsetrain_core::{Direction, Entry, Epoch, Item, Recurrence, Segment, Tick32};
use std::collections::VecDeque;

/// The board that segments are for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chip {
    /// Ticks per second.
    pub tick_hz: u64,
    /// Fraction bits of an interval (F).
    pub fraction_bits: u32,
    /// Least steps of a segment; it has at most twice as many.
    pub least_steps: u32,
    /// The most times that a segment may have the steps of the one before. A reversal resets the units in which segments are packed, so a planner begins
    /// with short ones after it.
    pub growth: u32,
    /// The shortest first interval after a reversal, ticks.
    pub turn_ticks: f64,
}

impl Chip {
    /// An Uno, with a pulse, DIR hold and DIR setup of 1 µs each.
    pub const UNO: Chip = Chip { tick_hz: TICK_HZ, fraction_bits: 16, least_steps: 40, growth: 20, turn_ticks: 400.0 };

    /// A Pico, with segments as a planner makes them at 100 000 steps/s or more.
    pub const PICO: Chip =
        Chip { tick_hz: pico::TICK_HZ, fraction_bits: 32, least_steps: 500, growth: 2, turn_ticks: 3000.0 };

    /// Units of an interval in a tick.
    fn ticks(&self) -> f64 {
        (1_u64 << self.fraction_bits) as f64
    }
}

/// The speed of a motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Law {
    /// Mean steps per second.
    pub rate: f64,
    /// The part by which the interval of a segment may differ from the mean, either way.
    pub swing: f64,
    /// One segment in this many begins with a reversal; 0 for none.
    pub turns: u64,
}

impl Law {
    /// A speed that varies by ±10 %.
    pub const fn changing(rate: f64) -> Law {
        Law { rate, swing: 0.1, turns: 0 }
    }

    /// A constant speed.
    pub const fn constant(rate: f64) -> Law {
        Law { rate, swing: 0.0, turns: 0 }
    }
}

/// A source of random segments, which also computes the tick of each step, in wide integers.
#[derive(Clone, Debug)]
pub struct Source {
    chip: Chip,
    law: Law,
    random: Random,
    packing: Packing,
    state: State,
    recurrence: Recurrence,
    /// The tick of the last step, or of the beginning.
    tick: u64,
    direction: Direction,
    interval: f64,
    /// The ticks of the steps so far; a test removes those that it has checked.
    pub due: VecDeque<u64>,
    /// An item that the board had no room for.
    ahead: Option<Item>,
    /// No segment begins after it.
    end: u64,
    /// Packed bytes of the segments so far.
    pub packed: usize,
}

impl Source {
    /// From tick `start` to about tick `end`.
    pub fn new(chip: Chip, law: Law, seed: u64, start: u64, end: u64) -> Source {
        let fraction = chip.fraction_bits;
        Source {
            chip,
            law,
            random: Random::new(seed),
            packing: Packing { fraction_bits: fraction, gain: 0 },
            state: State::default(),
            recurrence: Recurrence {
                accumulator: start << fraction | 1 << (fraction - 1),
                interval: 0,
                add: 0,
                add2: 0,
            },
            tick: start,
            direction: Direction::Forward,
            interval: chip.tick_hz as f64 / law.rate,
            due: VecDeque::new(),
            ahead: Some(Item::Anchor { tick: Tick32::of(start) }),
            end,
            packed: 0,
        }
    }

    /// The tick of the last step so far.
    pub fn tick(&self) -> u64 {
        self.tick
    }

    /// The next item; nothing after the end.
    fn item(&mut self) -> Option<Item> {
        if self.ahead.is_some() {
            return self.ahead.take();
        }
        if self.tick() >= self.end {
            return None;
        }
        let chip = self.chip;
        let steps = chip.least_steps + self.random.below(u64::from(chip.least_steps) + 1) as u32;
        let steady = chip.tick_hz as f64 / self.law.rate;
        let goal = steady * (1.0 + self.law.swing * (2.0 * self.random.fraction() - 1.0));
        if self.random.one_in(self.law.turns) {
            self.direction = self.direction.reversed();
            self.state = State::new(self.direction);
            self.interval = self.interval.max(chip.turn_ticks);
        }
        let count = steps.min(chip.growth.saturating_mul(self.state.previous_count));
        let n = f64::from(count);
        let add = 1.3 * (goal - self.interval) / n;
        let add2 = -2.0 * (add * n - (goal - self.interval)) / (n * n);
        let units = self.packing.units(self.state.previous_count);
        let near = |wanted: f64, predicted: i64, unit: i64| {
            predicted + ((wanted * chip.ticks() - predicted as f64) / unit as f64).round() as i64 * unit
        };
        let segment = Segment {
            count,
            interval: near(self.interval, self.state.interval, units[0]),
            add: near(add, self.state.add, units[1]),
            add2: near(add2, self.state.add2, units[2]),
        };
        let item = Item::Run { segment, direction: self.direction };
        self.packed += self.packing.pack(&mut self.state, &item, &mut [0; MAX_PACKED_LEN]).expect("steps");
        self.recurrence.load(&segment);
        for _ in 0..count {
            self.recurrence.advance();
            // The accumulator has only the low bits of the ticks.
            let now = Tick32::of(self.recurrence.accumulator >> chip.fraction_bits);
            self.tick += u64::from(now.since(Tick32::of(self.tick)));
            self.due.push_back(self.tick);
        }
        self.interval = self.recurrence.interval as f64 / chip.ticks();
        Some(item)
    }
}

/// A stream of segments for all motors, pushed as they fit, without a session: only the board is tested.
#[derive(Clone, Debug)]
pub struct Stream {
    chip: Chip,
    pub sources: Vec<Source>,
    epoch: Epoch,
    /// The tick at which the epoch begins.
    pub begin: u64,
    switched: bool,
}

impl Stream {
    /// A stream for an Uno; see [`on`](Stream::on).
    pub fn new(board: &impl Leased, laws: &[Law], apart: f64, seed: u64, ticks: u64) -> Stream {
        Stream::on(Chip::UNO, board, laws, apart, seed, ticks)
    }

    /// A stream of `laws` for `ticks`, which begins soon after the board can have it. Motor m begins `apart` · m / motors of an interval after motor 0.
    pub fn on(chip: Chip, board: &impl Leased, laws: &[Law], apart: f64, seed: u64, ticks: u64) -> Stream {
        let begin = board.now() + board.round_trip() + chip.tick_hz / 10;
        let motors = laws.len() as f64;
        let sources = (0_u64..).zip(laws).map(|(index, law)| {
            let offset = apart * chip.tick_hz as f64 / law.rate * index as f64 / motors;
            // Motors in phase get the same seed, so that all make the same steps.
            let seed = if apart == 0.0 { seed } else { seed + 977 * index };
            let start = begin + chip.tick_hz / 2000 + offset as u64;
            Source::new(chip, *law, seed, start, start + ticks)
        });
        Stream { chip, sources: sources.collect(), epoch: board.epoch().next(), begin, switched: false }
    }

    /// Pushes the items that fit, and switches the board to the epoch in time.
    ///
    /// # Errors
    /// As [`Leased::switch`].
    pub fn feed(&mut self, board: &mut impl Leased) -> Result<(), SwitchRefused> {
        let mut pushed = true;
        while pushed {
            pushed = false;
            for (index, source) in self.sources.iter_mut().enumerate() {
                let Some(item) = source.item() else { continue };
                match board.push(index, Entry { epoch: self.epoch, item }) {
                    Ok(()) => pushed = true,
                    Err(entry) => source.ahead = Some(entry.item),
                }
            }
        }
        if !self.switched && board.now() + board.round_trip() * 3 / 2 > self.begin {
            board.switch(self.epoch, self.begin, Lease::Last, &[])?;
            self.switched = true;
        }
        Ok(())
    }

    /// Whether all items have been pushed.
    pub fn is_sent(&self) -> bool {
        self.sources.iter().all(|source| source.ahead.is_none() && source.tick() >= source.end)
    }

    /// The tick of the last step of all.
    pub fn last(&self) -> u64 {
        self.sources.iter().map(Source::tick).max().unwrap_or(0)
    }

    /// Plays the whole stream, to 1 ms after the last step. `look` is called every half millisecond, and may end it with an error.
    ///
    /// # Errors
    /// As [`Leased::switch`], or the error of `look`.
    pub fn play<B: Leased>(
        &mut self,
        board: &mut B,
        observer: &mut impl Observer,
        mut look: impl FnMut(&mut Stream, &mut B) -> Result<(), String>,
    ) -> Result<(), String> {
        while !self.is_sent() || board.now() <= self.last() + self.chip.tick_hz / 1000 {
            self.feed(board).map_err(|refused| format!("the switch is refused: {refused}"))?;
            board.advance(board.now() + self.chip.tick_hz / 2000, observer);
            look(self, board)?;
        }
        Ok(())
    }
}
