//! A program's plan, read ahead, and its laws at any tick.

use super::SessionError;
use super::timeline::{Placed, tick_of};
use pulsetrain_core::Direction;
use pulsetrain_motion::Time;
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::program::Program;
use pulsetrain_plan::tail::{Motion, Tail, Told, stop_tails};
use pulsetrain_plan::{Certificate, Ensemble, Move, Start};
use std::collections::VecDeque;

/// The θ that counts of a motor start from: whole steps, and rest.
pub(super) type Datum = (i64, f64);

pub(super) struct Source<'a> {
    program: &'a Program,
    ensemble: Ensemble<'a>,
    /// The board's tick at which the laws' time is 0.
    zero: u64,
    feeds: Vec<Feed<'a>>,
}

struct Feed<'a> {
    cursor: Cursor<'a>,
    datum: Datum,
    /// Of the moves read so far, board ticks · 2^F.
    accumulator: i128,
    ahead: VecDeque<Placed>,
    ended: bool,
}

/// Where a motor's law is, seen from the step that the motor stands on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// θ − count, steps.
    pub(super) off: f64,
    /// steps/s.
    pub(super) speed: f64,
}

/// A motor just before a tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct Standing {
    pub(super) count: i64,
    pub(super) last_step: Option<(u64, Direction)>,
    /// What the board has been told up to there, if an epoch has it.
    pub(super) told: Option<Told>,
}

impl Standing {
    /// The last step, seen from `tick`.
    pub(super) fn last_before(&self, tick: u64) -> Option<(i64, Direction)> {
        self.last_step.map(|(last, direction)| (last.wrapping_sub(tick).cast_signed(), direction))
    }
}

impl<'a> Source<'a> {
    /// A program from the beginning: its laws begin where the motors are, at `counts`.
    pub(super) fn new(program: &'a Program, zero: u64, counts: &[i64]) -> Result<Source<'a>, SessionError> {
        let datums = program.motors.iter().zip(counts).enumerate().map(|(motor, (m, count))| {
            let first = Cursor::new(&m.law).at(Time::ZERO).map_err(|error| SessionError::Law { motor, error })?;
            Ok((first.whole - count, first.fraction))
        });
        let datums = datums.collect::<Result<Vec<_>, SessionError>>()?;
        Ok(Source::assemble(program, Ensemble::new(program)?, zero, datums))
    }

    /// A program that takes over from another, whose datums it keeps.
    pub(super) fn from(
        program: &'a Program,
        zero: u64,
        starts: &[Start],
        datums: Vec<Datum>,
    ) -> Result<Source<'a>, SessionError> {
        Ok(Source::assemble(program, Ensemble::from(program, starts)?, zero, datums))
    }

    fn assemble(program: &'a Program, ensemble: Ensemble<'a>, zero: u64, datums: Vec<Datum>) -> Source<'a> {
        let fraction_bits = program.board.fraction_bits;
        let accumulator = (i128::from(zero) << fraction_bits) + (1 << (fraction_bits - 1));
        let feed = |(motor, datum): (&'a pulsetrain_motion::program::Motor, Datum)| Feed {
            cursor: Cursor::new(&motor.law),
            datum,
            accumulator,
            ahead: VecDeque::new(),
            ended: false,
        };
        let feeds = program.motors.iter().zip(datums).map(feed).collect();
        Source { program, ensemble, zero, feeds }
    }

    pub(super) fn zero(&self) -> u64 {
        self.zero
    }

    pub(super) fn datum(&self, motor: usize) -> Datum {
        self.feeds[motor].datum
    }

    pub(super) fn certificate(&self, motor: usize) -> Certificate {
        self.ensemble.certificate(motor)
    }

    /// Reads ahead from tick `from` up to `limit`, or to `most` segments of a motor. Gives the tick before which all
    /// steps are known, and whether no step is left after that.
    pub(super) fn read_ahead(&mut self, from: u64, limit: u64, most: usize) -> Result<(u64, bool), SessionError> {
        let fraction_bits = self.program.board.fraction_bits;
        let (mut known, mut end, mut over) = (limit, from, true);
        for (motor, feed) in self.feeds.iter_mut().enumerate() {
            let read_to = |feed: &Feed<'_>| tick_of(feed.accumulator, fraction_bits);
            while !feed.ended && read_to(feed) < limit && feed.ahead.len() < most {
                match self.ensemble.next_move(motor)? {
                    Some(Move::Dwell { ticks }) => feed.accumulator += i128::from(ticks) << fraction_bits,
                    Some(Move::Run { segment, direction }) => {
                        let placed = Placed { start: feed.accumulator, segment, direction };
                        feed.accumulator = placed.end();
                        feed.ahead.push_back(placed);
                    }
                    None => feed.ended = true,
                }
            }
            // Behind the last step.
            end = end.max(feed.ahead.back().map_or(0, |placed| tick_of(placed.end(), fraction_bits) + 1));
            over &= feed.ended;
            if !feed.ended && read_to(feed) < limit {
                known = known.min(read_to(feed) + 1);
            }
        }
        Ok(if over && end <= limit { (end, true) } else { (known, false) })
    }

    /// The steps read ahead of a motor that come before `tick`.
    pub(super) fn steps_before(&self, motor: usize, tick: u64) -> Vec<Placed> {
        let fraction_bits = self.program.board.fraction_bits;
        let ahead = self.feeds[motor].ahead.iter();
        ahead.map_while(|placed| placed.split(tick, fraction_bits).0).collect()
    }

    /// Drops the steps before `tick`: they have been sent.
    pub(super) fn drop_before(&mut self, tick: u64) {
        let fraction_bits = self.program.board.fraction_bits;
        for feed in &mut self.feeds {
            while let Some(placed) = feed.ahead.pop_front() {
                if let (_, Some(rest)) = placed.split(tick, fraction_bits) {
                    feed.ahead.push_front(rest);
                    break;
                }
            }
        }
    }

    /// Where the law of a motor that has counted to `count` is at `tick`.
    pub(super) fn place(&mut self, motor: usize, tick: u64, count: i64) -> Result<Place, SessionError> {
        let feed = &mut self.feeds[motor];
        // Ticks of a session stay far below 2^62.
        let at = Time::from_ratio(tick.wrapping_sub(self.zero).cast_signed(), self.program.board.tick_hz);
        let sample = feed.cursor.at(at).map_err(|error| SessionError::Law { motor, error })?;
        let off = (sample.whole - feed.datum.0 - count) as f64 + (sample.fraction - feed.datum.1);
        Ok(Place { off, speed: sample.speed })
    }

    /// The stop tails of all motors from `tick` on, in their places; `brief` as in [`Motion::brief`].
    pub(super) fn tails(
        &mut self,
        tick: u64,
        standing: &[Standing],
        brief: bool,
    ) -> Result<Vec<Vec<Placed>>, SessionError> {
        let mut motions = Vec::with_capacity(standing.len());
        for (motor, stand) in standing.iter().enumerate() {
            let place = self.place(motor, tick, stand.count)?;
            let acceleration = self.certificate(motor).peak_acceleration.0;
            let motion =
                Motion { position: 0, theta: place.off, speed: place.speed, acceleration, told: stand.told, brief };
            motions.push((motion, stand.last_before(tick)));
        }
        let fraction_bits = self.program.board.fraction_bits;
        let start = i128::from(tick) << fraction_bits;
        let tails = stop_tails(self.program, &motions)?;
        let placed = |tail: &Tail| placed(&tail.moves, start + i128::from(tail.start), fraction_bits);
        Ok(tails.iter().map(placed).collect())
    }
}

/// Moves in their places, the first after `start`.
fn placed(moves: &[Move], start: i128, fraction_bits: u32) -> Vec<Placed> {
    let mut accumulator = start;
    let mut steps = Vec::with_capacity(moves.len());
    for next in moves {
        match *next {
            Move::Dwell { ticks } => accumulator += i128::from(ticks) << fraction_bits,
            Move::Run { segment, direction } => {
                steps.push(Placed { start: accumulator, segment, direction });
                accumulator += segment.span(segment.count);
            }
        }
    }
    steps
}
