//! Whether a line brings the plans of all motors to the board in time, and how long the board's queues last.
//!
//! A board's queues hold a part of a plan; the rest is sent while the motors move. A session fills a queue as items
//! leave it, and serves the motor whose known plan ends first. So each item has two times. One is the time at which it
//! can be on the board, which is computed here. The other is the time at which it must be there: when the motor has
//! made the last step that the board knew of, because the board's lease must be extended before it ends.
//!
//! Between the two there must be a delay, which grows with the bytes that the board has recently had to read: see
//! [`LineTiming`].

use crate::Move;
use crate::error::PlanError;
use crate::packed::Meter;
use crate::settings::Settings;
use pulsetrain_core::wire::message::QUEUE_PARTS;
#[cfg(doc)]
use pulsetrain_motion::boards::LineTiming;
use pulsetrain_motion::program::Program;
use pulsetrain_motion::whole_power;
use std::collections::VecDeque;

/// A session sends a plan at most this far ahead of the board's time, ms.
pub const AHEAD_MS: u64 = 500;
/// A session keeps one in this many bytes of a queue free, for a change of the plan.
pub const KEPT: usize = 8;
/// Longest wait of one item, ticks: an eighth of what a 32-bit clock can tell apart. A session sends a longer rest as several waits, so that the
/// end of an item is never too far from the board's time.
pub const LONGEST_DWELL_TICKS: u64 = 1 << 28;
/// The window, ms: what the board had to read within it delays the board's answers.
const BUSY_MS: u64 = 10;
/// Bits of a byte on the line.
const BITS: f64 = 10.0;

/// The properties of a line to a board that a plan depends on.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Ticks per second.
    pub tick_hz: u64,
    /// The bytes of each motor's queue that a session fills while the motors move.
    pub queue_bytes: Vec<usize>,
    /// The same for the longest queue that the board can give to a motor, bytes.
    pub longest_queue_bytes: usize,
    /// Time of one byte of a plan on the line, with its share of the frames' overhead, ticks.
    pub byte_ticks: f64,
    /// Time from an item leaving the queue to a lease that includes the item which replaces it, ticks. It is that of a
    /// board with nothing else to read, and does not include the time on the line.
    pub delay_ticks: f64,
    /// Additional delay for each byte of plans within [`busy_ticks`](Line::busy_ticks), ticks.
    pub delay_byte_ticks: f64,
    /// The window of `delay_byte_ticks`, ticks.
    pub busy_ticks: u64,
    /// A session sends an item at most this far ahead of its time, ticks.
    pub ahead_ticks: f64,
}

/// The way by which plans reach a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// A UART, with its baud rate.
    Uart(u32),
    /// The board's own USB.
    Usb,
}

impl Line {
    /// The line to a program's board. `None` if plans do not reach the board over this way.
    #[must_use]
    pub fn of(program: &Program, way: Way) -> Option<Line> {
        let profile = program.board.profile;
        let line = profile.line?;
        let tick_hz = program.board.tick_hz;
        let motors = program.motors.len();
        let queue = *profile.queue_bytes.get(motors - 1).or(profile.queue_bytes.last())? as usize;
        let longest = *profile.queue_bytes.iter().max()? as usize;
        let all_bytes_per_s = match way {
            Way::Uart(baud) => f64::from(baud) / BITS,
            Way::Usb => f64::from(line.usb_bytes_per_s?),
        };
        let bytes_per_s = all_bytes_per_s - f64::from(line.other_bytes_per_s);
        Some(Line {
            tick_hz,
            queue_bytes: vec![queue - queue / KEPT; motors],
            longest_queue_bytes: longest - longest / KEPT,
            byte_ticks: tick_hz as f64 * line.frame_share / bytes_per_s,
            delay_ticks: tick_hz as f64
                * (f64::from(line.delay_us) * 1e-6 + f64::from(line.delay_bytes) / all_bytes_per_s),
            delay_byte_ticks: tick_hz as f64 * f64::from(line.delay_byte_us) * 1e-6,
            busy_ticks: BUSY_MS * tick_hz / 1000,
            ahead_ticks: (AHEAD_MS * tick_hz / 1000) as f64,
        })
    }

    /// The line after the queues have been divided among the motors in these parts.
    #[must_use]
    pub fn with_parts(&self, parts: &[u8]) -> Line {
        let all: usize = self.queue_bytes.iter().sum();
        let queue = |parts: &u8| (all * usize::from(*parts) / usize::from(QUEUE_PARTS)).min(self.longest_queue_bytes);
        Line { queue_bytes: parts.iter().map(queue).collect(), ..self.clone() }
    }
}

/// Checks the plans of all motors against a line.
#[derive(Clone, Debug)]
pub struct Supply {
    line: Line,
    lanes: Vec<Lane>,
    /// Tick and bytes of the items that the board has recently had to read, and the sum of their bytes.
    recent: VecDeque<(u64, usize)>,
    recent_bytes: usize,
    /// The tick at which the line has brought everything that was added.
    brought: f64,
    /// The tick since which the line has had no pause, and the bytes that it has brought since.
    busy_since: f64,
    busy_bytes: usize,
}

/// The part of a motor's plan that is in its queue.
#[derive(Clone, Debug)]
struct Lane {
    meter: Meter,
    /// The bytes of each item, and the tick at which it has left the queue.
    items: VecDeque<(usize, u64)>,
    held: usize,
    /// The tick at which the last item left whose space was needed; `None` as long as there was room for all.
    left: Option<u64>,
    tightest: Option<Refill>,
}

/// The refill of a queue that was the closest to coming too late.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refill {
    /// Time that it took until more was there, s.
    pub needed_s: f64,
    /// Time that there was for it, s.
    pub available_s: f64,
}

impl Supply {
    /// Before the first move of motors with these settings.
    #[must_use]
    pub fn new<'s>(line: Line, motors: impl IntoIterator<Item = &'s Settings>) -> Supply {
        let lane = |settings| Lane {
            meter: Meter::new(settings),
            items: VecDeque::new(),
            held: 0,
            left: None,
            tightest: None,
        };
        let lanes = motors.into_iter().map(lane).collect();
        Supply {
            line,
            lanes,
            recent: VecDeque::new(),
            recent_bytes: 0,
            brought: f64::NEG_INFINITY,
            busy_since: 0.0,
            busy_bytes: 0,
        }
    }

    /// Adds a move of a motor that begins at tick `from`. It must be the motor whose plan ends first.
    ///
    /// # Errors
    /// If the move would reach the board too late.
    pub fn add(&mut self, motor: usize, next: &Move, from: u64) -> Result<(), PlanError> {
        let Line { tick_hz, byte_ticks, ahead_ticks, .. } = self.line;
        let queue_bytes = self.line.queue_bytes[motor];
        let lane = &mut self.lanes[motor];
        let before = lane.meter.bytes();
        lane.meter.add(&beginning(next));
        let bytes = (lane.meter.bytes() - before) as usize;
        while lane.held + bytes > queue_bytes
            && let Some((len, at)) = lane.items.pop_front()
        {
            lane.held -= len;
            lane.left = Some(at);
        }
        lane.held += bytes;
        lane.items.push_back((bytes, from));
        // An item that fits into space that is already free needs no other item to leave. It needs its time on the
        // line.
        let left = lane.left;
        let delay_ticks = self.delay_ticks(from, bytes);
        // Items that fit before the motors move are on the board in time.
        let Some(left) = left else { return Ok(()) };
        let (left, due) = (left as f64, from as f64);
        let begins = left.max(due - ahead_ticks);
        if begins >= self.brought {
            (self.busy_since, self.busy_bytes) = (begins, 0);
        }
        self.busy_bytes += bytes;
        self.brought = self.brought.max(begins) + bytes as f64 * byte_ticks;
        let hz = tick_hz as f64;
        if self.brought + delay_ticks <= due {
            let now = Refill { needed_s: (self.brought + delay_ticks - begins) / hz, available_s: (due - begins) / hz };
            let share = |refill: Refill| refill.needed_s / refill.available_s;
            let tightest = &mut self.lanes[motor].tightest;
            if tightest.is_none_or(|before| share(now) > share(before)) {
                *tightest = Some(now);
            }
            return Ok(());
        }
        let at_s = due / hz;
        // Reports the larger of the two causes: waiting for the line, or the delay.
        let waited = self.brought - left;
        Err(if waited > delay_ticks {
            PlanError::LineTooSlow {
                at_s,
                rate: self.busy_bytes as f64 * hz / (due - delay_ticks - self.busy_since).max(1.0),
                limit: hz / byte_ticks,
            }
        } else {
            PlanError::QueueTooShort { at_s, held_s: (due - left) / hz, needed_s: (waited + delay_ticks) / hz }
        })
    }

    /// The tightest refill of a motor's queue so far. `None` if all of its plan fits into the queue at the beginning.
    #[must_use]
    pub fn tightest(&self, motor: usize) -> Option<Refill> {
        self.lanes[motor].tightest
    }

    /// The delay of an item that begins at tick `from`, which itself adds to the bytes to read.
    fn delay_ticks(&mut self, from: u64, bytes: usize) -> f64 {
        let Line { delay_ticks, delay_byte_ticks, busy_ticks, .. } = self.line;
        self.recent.push_back((from, bytes));
        self.recent_bytes += bytes;
        while let Some((at, len)) = self.recent.front().copied()
            && at + busy_ticks <= from
        {
            self.recent.pop_front();
            self.recent_bytes -= len;
        }
        delay_ticks + self.recent_bytes as f64 * delay_byte_ticks
    }
}

/// The part of a move that must be in the queue when the move begins. The rest of a long wait comes while it lasts.
fn beginning(next: &Move) -> Move {
    match next {
        Move::Dwell { ticks } => Move::Dwell { ticks: (*ticks).min(LONGEST_DWELL_TICKS) },
        Move::Run { .. } => *next,
    }
}

/// How long queues of a given size last: the most bytes that each motor's plan takes within given times.
#[derive(Clone, Debug)]
pub struct Demand {
    tick_hz: u64,
    lanes: Vec<Window>,
}

/// The items of a motor that begin within one of the times.
#[derive(Clone, Debug)]
struct Window {
    meter: Meter,
    /// The tick at which an item begins, and the bytes up to it.
    items: VecDeque<(u64, u64)>,
    /// Items that have been removed from `items`.
    gone: usize,
    /// For each of the times: the first item in it, and the most bytes so far.
    most: Vec<(usize, u64)>,
}

/// The shortest of the [`TIMES`] times, ms. Each is longer than the one before by a constant factor.
const SHORTEST_MS: f64 = 2.0;
const LONGER: f64 = 1.1;
const TIMES: i32 = 50;
/// Smallest queue of a motor, bytes: room for the items of a change. `cargo test -p pulsetrain --test it small_queues`
/// uses about this size.
const MIN_QUEUE: u64 = 48;

impl Demand {
    /// Before the first move of motors with these settings.
    #[must_use]
    pub fn new<'s>(tick_hz: u64, motors: impl IntoIterator<Item = &'s Settings>) -> Demand {
        let window = |settings| Window {
            meter: Meter::new(settings),
            items: VecDeque::new(),
            gone: 0,
            most: vec![(0, 0); TIMES as usize],
        };
        Demand { tick_hz, lanes: motors.into_iter().map(window).collect() }
    }

    /// Adds a move of a motor that begins at tick `from`.
    pub fn add(&mut self, motor: usize, next: &Move, from: u64) {
        let hz = self.tick_hz as f64;
        let Window { meter, items, gone, most } = &mut self.lanes[motor];
        items.push_back((from, meter.bytes()));
        meter.add(&beginning(next));
        for (number, (first, most)) in (0..).zip(most.iter_mut()) {
            let ticks = (SHORTEST_MS * 1e-3 * whole_power(LONGER, number) * hz) as u64;
            while items[*first - *gone].0 + ticks < from {
                *first += 1;
            }
            *most = (*most).max(meter.bytes() - items[*first - *gone].1);
        }
        let oldest = most.iter().map(|(first, _)| *first).min().unwrap_or(*gone);
        items.drain(..oldest - *gone);
        *gone = oldest;
    }

    /// The parts of a line's queues ([`QUEUE_PARTS`]) with which all queues last equally long, and as long as possible.
    /// `None` if they are too short even for the shortest time.
    #[must_use]
    pub fn parts(&self, line: &Line) -> Option<Vec<u8>> {
        let all: usize = line.queue_bytes.iter().sum();
        let needs = |time: usize| self.lanes.iter().map(move |lane| lane.most[time].1.max(MIN_QUEUE));
        let time = (0..TIMES as usize).rev().find(|time| needs(*time).sum::<u64>() <= all as u64)?;
        let sum: u64 = needs(time).sum();
        // Every motor gets at least one part.
        let more = u64::from(QUEUE_PARTS) - self.lanes.len() as u64;
        Some(needs(time).map(|bytes| 1 + (bytes * more / sum) as u8).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use pulsetrain_core::{Direction, Segment};

    const SECOND: u64 = 16_000_000;

    fn line(queue_bytes: usize, byte_ticks: f64, delay_ticks: f64) -> Line {
        let (busy_ticks, ahead_ticks) = (SECOND / 100, SECOND as f64);
        let (queue_bytes, longest_queue_bytes) = (vec![queue_bytes; 4], queue_bytes);
        Line {
            tick_hz: SECOND,
            queue_bytes,
            longest_queue_bytes,
            byte_ticks,
            delay_ticks,
            delay_byte_ticks: 0.0,
            busy_ticks,
            ahead_ticks,
        }
    }

    fn steps(interval: i64) -> Move {
        Move::Run { segment: Segment { count: 1, interval, add: 0, add2: 0 }, direction: Direction::Forward }
    }

    /// Adds steps to all of so many motors, one every `ticks`, whose intervals take as many bytes as they can; gives the bytes of one that is
    /// not the first, and what became of them.
    fn added(line: Line, motors: usize, ticks: u64) -> (usize, Result<(), PlanError>) {
        let settings = vec![Settings::new(SECOND, 16); motors];
        let mut supply = Supply::new(line, &settings);
        for number in 0..2_000u64 {
            for motor in 0..motors {
                // Up and down by turns: none predicts the next.
                let interval = ((ticks as i64) << 16) + if number % 2 == 0 { 9_999_991 } else { -9_999_991 };
                if let Err(error) = supply.add(motor, &steps(interval), number * ticks) {
                    return (supply.lanes[0].items.back().map_or(0, |item| item.0), Err(error));
                }
            }
        }
        (supply.lanes[0].items.back().map_or(0, |item| item.0), Ok(()))
    }

    proptest! {
        #[test]
        fn what_comes_in_time_is_accepted_and_nothing_else(
            queue in 40usize..200, byte in 100.0f64..2000.0, delay_ms in 1.0f64..40.0, more in 0.0f64..3000.0, ticks in 5_000u64..200_000,
            motors in 1usize..4,
        ) {
            let delay = delay_ms * 1e-3 * SECOND as f64;
            let line = Line { delay_byte_ticks: more, ..line(queue, byte, delay) };
            let (bytes, added) = added(line.clone(), motors, ticks);
            // So many bytes of all motors are in as many ticks.
            let read = (motors * bytes) as f64 * more;
            let busy = (line.busy_ticks / ticks) as f64;
            let (delay, least) = (delay + (busy + 1.0) * read, delay + busy * read);
            let held = (queue / bytes) as f64 * ticks as f64;
            let all = motors as f64 * bytes as f64 * byte;
            // A line that brings less than is wanted falls behind without end; one that brings more is a little behind only while the items of a step
            // come one after the other.
            let (provably, never) = (all < 0.99 * ticks as f64 && held > delay + all, all > 1.01 * ticks as f64 || held < least);
            match added {
                Ok(()) => prop_assert!(!never, "{bytes} bytes, held for {held}, {all} for each step"),
                Err(error) => {
                    prop_assert!(!provably, "{bytes} bytes, held for {held}, {all} for each step: {error}");
                    prop_assert!(error.at_s().is_some());
                    if let PlanError::QueueTooShort { held_s, needed_s, .. } = error {
                        prop_assert!(held_s < needed_s);
                    }
                }
            }
        }
    }

    #[test]
    fn a_slow_line_says_what_it_brings() {
        let error =
            added(line(90, 1600.0, 1000.0), 2, 10_000).1.expect_err("two motors take more than the line brings");
        let PlanError::LineTooSlow { rate, limit, .. } = error else { panic!("{error}") };
        assert!(limit == 10_000.0 && rate > limit, "{rate} of {limit}");
    }

    /// Motors whose steps come at different rates, all of them bytes that nothing predicts.
    #[test]
    fn queues_by_need_last_equally_long() {
        let settings = vec![Settings::new(SECOND, 16); 3];
        let mut demand = Demand::new(SECOND, &settings);
        let every = [4_000u64, 16_000, 1_600_000];
        for (motor, ticks) in every.into_iter().enumerate() {
            for number in 0..SECOND / ticks {
                let interval = ((ticks as i64) << 16) + if number % 2 == 0 { 9_999_991 } else { -9_999_991 };
                demand.add(motor, &steps(interval), number * ticks);
            }
        }
        let line = line(99, 1600.0, 1000.0);
        let line = Line { queue_bytes: vec![99; 3], ..line };
        let parts = demand.parts(&line).expect("a few steps have room");
        let [fast, slow, least] = parts[..] else { panic!("{parts:?}") };
        assert!((fast..4 * fast).contains(&(4 * slow + 8)) && parts.iter().sum::<u8>() <= QUEUE_PARTS, "{parts:?}");
        assert!(u64::from(least) * 297 / u64::from(QUEUE_PARTS) + 5 > MIN_QUEUE, "{parts:?}");
        assert_eq!(demand.parts(&Line { queue_bytes: vec![20; 3], ..line }), None);
    }

    /// Long items and short ones by turns: a short one fits where the long one before it was.
    #[test]
    fn what_needs_no_place_takes_its_time_on_the_line() {
        let supplied = |byte_ticks: f64| {
            let mut supply = Supply::new(line(80, byte_ticks, 1000.0), &[Settings::new(SECOND, 16)]);
            for number in 0..2_000u64 {
                let interval = (5_000i64 << 16) + if number % 4 < 2 { 9_999_991 } else { -9_999_991 };
                supply.add(0, &steps(interval), number * 5_000)?;
            }
            Ok::<f64, PlanError>(supply.lanes[0].meter.bytes() as f64 / 2_000.0)
        };
        let bytes = supplied(1.0).unwrap_or_else(|error| panic!("{error}"));
        assert!(supplied(0.95 * 5_000.0 / bytes).is_ok());
        assert!(supplied(1.05 * 5_000.0 / bytes).is_err());
    }

    /// A wait of days takes thousands of records, of which few are in the queue at a time.
    #[test]
    fn a_wait_of_days_comes_in_time() {
        let mut supply = Supply::new(line(80, 1600.0, 16_000.0), &[Settings::new(SECOND, 16)]);
        let mut at = 0;
        for ticks in [SECOND / 1000, 30 * 86_400 * SECOND, SECOND / 1000, 86_400 * SECOND] {
            supply.add(0, &Move::Dwell { ticks }, at).unwrap_or_else(|error| panic!("{error}"));
            at += ticks;
            for _ in 0..20 {
                supply.add(0, &steps(50_000 << 16), at).unwrap_or_else(|error| panic!("{error}"));
                at += 50_000;
            }
        }
    }

    #[test]
    fn a_rest_fills_the_queues_again() {
        let settings = [Settings::new(SECOND, 16)];
        let mut supply = Supply::new(line(80, 1600.0, 16_000.0), &settings);
        let mut at = 0;
        for _ in 0..100 {
            // As many as the queue holds, twice as fast as the line brings them; then a rest in which it does.
            for number in 0..6 {
                let interval = (2_000i64 << 16) + if number % 2 == 0 { 9_999_991 } else { -9_999_991 };
                supply.add(0, &steps(interval), at).unwrap_or_else(|error| panic!("{error}"));
                at += 2_000;
            }
            supply.add(0, &Move::Dwell { ticks: 400_000 }, at).unwrap_or_else(|error| panic!("{error}"));
            at += 400_000;
        }
    }
}
