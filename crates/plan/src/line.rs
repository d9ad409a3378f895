//! What a line brings in time, and what a board's queues hold meanwhile.
//!
//! A board's queues hold a part of a plan; the rest comes while the motors move. A session fills a queue as items leave it, those of the
//! motor that is known least far first. So each item has a time at which it can be with the board, which is worked out here, and one at which it
//! must be there: when the motor has made the last step that the board knew of, as the lease must not end before it is put off.

use crate::Move;
use crate::error::PlanError;
use crate::packed::Meter;
use crate::settings::Settings;
use pulsetrain_motion::boards;
use pulsetrain_motion::program::Program;
use std::collections::VecDeque;

/// So far ahead of the board's time a session hands a plan over, ms.
pub const AHEAD_MS: u64 = 500;
/// One in so many bytes of a queue is kept free by a session, for a change.
pub const KEPT: usize = 8;
/// Bits of a byte on the line.
const BITS: f64 = 10.0;

/// A line to a board, as a plan that goes over it must know it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Ticks per second.
    pub tick_hz: u64,
    /// What a session fills of each motor's queue while the motors move, bytes.
    pub queue_bytes: usize,
    /// What a byte of a plan takes on the line with its share of all frames, ticks.
    pub byte_ticks: f64,
    /// From an item's leaving the queue to a lease that counts on what came in its place, ticks, without the time on the line.
    pub delay_ticks: f64,
    /// So far ahead of its time a session hands an item over, ticks.
    pub ahead_ticks: f64,
}

impl Line {
    /// The line to a program's board at `baud`. `None` where a board takes plans over no line.
    #[must_use]
    pub fn of(program: &Program, baud: u32) -> Option<Line> {
        let row = boards::find(&program.board.name)?;
        let line = row.line?;
        let tick_hz = program.board.tick_hz;
        let queue = *row.queue_bytes.get(program.motors.len() - 1).or(row.queue_bytes.last())? as usize;
        let bytes_per_s = f64::from(baud) / BITS - f64::from(line.other_bytes_per_s);
        Some(Line {
            tick_hz,
            queue_bytes: queue - queue / KEPT,
            byte_ticks: tick_hz as f64 * line.frame_share / bytes_per_s,
            delay_ticks: tick_hz as f64 * (f64::from(line.delay_us) * 1e-6 + f64::from(line.delay_bytes) * BITS / f64::from(baud)),
            ahead_ticks: (AHEAD_MS * tick_hz / 1000) as f64,
        })
    }
}

/// Holds the plans of all motors against a line.
#[derive(Clone, Debug)]
pub struct Supply {
    line: Line,
    lanes: Vec<Lane>,
    /// When the line has brought all that was added, ticks.
    brought: f64,
    /// Since when it has had no pause, and what it has brought since.
    busy_since: f64,
    busy_bytes: usize,
}

/// What of a motor's plan is in its queue.
#[derive(Clone, Debug)]
struct Lane {
    meter: Meter,
    /// Bytes of each item, and the tick at which it has left the queue.
    items: VecDeque<(usize, u64)>,
    held: usize,
}

impl Supply {
    /// Before the first move of motors with these settings.
    #[must_use]
    pub fn new<'s>(line: Line, motors: impl IntoIterator<Item = &'s Settings>) -> Supply {
        let lane = |settings| Lane { meter: Meter::new(settings), items: VecDeque::new(), held: 0 };
        let lanes = motors.into_iter().map(lane).collect();
        Supply { line, lanes, brought: f64::NEG_INFINITY, busy_since: 0.0, busy_bytes: 0 }
    }

    /// Adds a move of a motor that begins at tick `from`: of the motor that is least far.
    ///
    /// # Errors
    /// If the board would not know of it in time.
    pub fn add(&mut self, motor: usize, next: &Move, from: u64) -> Result<(), PlanError> {
        let Line { tick_hz, queue_bytes, byte_ticks, delay_ticks, ahead_ticks } = self.line;
        let lane = &mut self.lanes[motor];
        let before = lane.meter.bytes();
        lane.meter.add(next);
        let bytes = (lane.meter.bytes() - before) as usize;
        let mut left = None;
        while lane.held + bytes > queue_bytes
            && let Some((len, at)) = lane.items.pop_front()
        {
            lane.held -= len;
            left = Some(at);
        }
        lane.held += bytes;
        lane.items.push_back((bytes, from));
        // What there is room for before the motors move is with the board by then.
        let Some(left) = left else { return Ok(()) };
        let (left, due) = (left as f64, from as f64);
        let begins = left.max(due - ahead_ticks);
        if begins >= self.brought {
            (self.busy_since, self.busy_bytes) = (begins, 0);
        }
        self.busy_bytes += bytes;
        self.brought = self.brought.max(begins) + bytes as f64 * byte_ticks;
        if self.brought + delay_ticks <= due {
            return Ok(());
        }
        let hz = tick_hz as f64;
        let at_s = due / hz;
        // Of what there was no time for, the larger part.
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
}
