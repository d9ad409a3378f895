//! A program's plan as the items of one epoch, handed to the board as its queues have room; and the program's laws at any tick.

use crate::SessionError;
use crate::timeline::{Placed, Timeline, tick_of};
use pulsetrain_board::{Board, Sizer};
use pulsetrain_core::{Entry, Epoch, Item, Segment, Tick32};
use pulsetrain_motion::Time;
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::program::Program;
use pulsetrain_plan::{Certificate, Ensemble, LONGEST_WAIT_TICKS, Move, Start};
use std::collections::VecDeque;
use std::sync::Arc;

/// Longest wait of one item, ticks. A longer rest is told bit by bit, so that a motor's accumulator never is far from the board's time.
const LONGEST_DWELL_TICKS: u64 = 1 << 28;

/// The θ that counts of a motor start from: whole steps, and rest.
pub(crate) type Datum = (i64, f64);

pub(crate) struct Stream {
    program: Arc<Program>,
    ensemble: Ensemble,
    epoch: Epoch,
    /// The board's tick at which the laws' time is 0.
    zero: u64,
    lanes: Vec<Lane>,
}

/// What a motor is told.
struct Lane {
    cursor: Cursor,
    datum: Datum,
    sizer: Sizer,
    /// After the items that the board was handed, ticks · 2^F.
    accumulator: i128,
    /// Whether the last of them is an anchor or a wait.
    waits: bool,
    /// Items that were planned and not handed over, and the rest of a wait after them, ticks.
    next: VecDeque<Item>,
    dwell: u64,
    ended: bool,
}

/// Where a motor's law is, seen from the step that the motor stands on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    /// θ − count, steps.
    pub(crate) off: f64,
    /// steps/s.
    pub(crate) speed: f64,
}

/// How far a plan was handed over.
#[derive(Clone, Debug, Default)]
pub(crate) struct Handed {
    /// There may be more to hand over at once.
    pub(crate) more: bool,
    /// The motor that is known least far, if it is since its queue is full.
    pub(crate) short: Option<usize>,
}

/// So many items of each motor are handed over at once: then the lease is put off.
const ITEMS_AT_ONCE: usize = 16;

impl Stream {
    /// A program from the beginning: its laws begin where the motors are, at `counts`.
    pub(crate) fn new<B: Board>(
        program: Arc<Program>,
        zero: u64,
        counts: &[i64],
        epoch: Epoch,
        board: &B,
    ) -> Result<Stream, SessionError> {
        let datums = program.motors.iter().zip(counts).enumerate().map(|(motor, (m, count))| {
            let first = Cursor::new(&m.law).at(Time::ZERO).map_err(|error| SessionError::Law { motor, error })?;
            Ok((first.whole - count, first.fraction))
        });
        let datums = datums.collect::<Result<Vec<_>, SessionError>>()?;
        let ensemble = Ensemble::new(&program)?;
        Ok(Stream::assemble(program, ensemble, zero, datums, epoch, board))
    }

    /// A program that takes over from another, whose datums it keeps.
    pub(crate) fn from<B: Board>(
        program: Arc<Program>,
        zero: u64,
        starts: &[Start],
        datums: Vec<Datum>,
        epoch: Epoch,
        board: &B,
    ) -> Result<Stream, SessionError> {
        let ensemble = Ensemble::from(&program, starts)?;
        Ok(Stream::assemble(program, ensemble, zero, datums, epoch, board))
    }

    fn assemble<B: Board>(
        program: Arc<Program>,
        ensemble: Ensemble,
        zero: u64,
        datums: Vec<Datum>,
        epoch: Epoch,
        board: &B,
    ) -> Stream {
        let fraction_bits = program.board.fraction_bits;
        let lane = |(motor, datum): (usize, Datum)| Lane {
            cursor: Cursor::new(&program.motors[motor].law),
            datum,
            sizer: board.sizer(motor),
            accumulator: (i128::from(zero) << fraction_bits) + (1 << (fraction_bits - 1)),
            waits: true,
            next: VecDeque::from([Item::Anchor { tick: Tick32::of(zero) }]),
            dwell: 0,
            ended: false,
        };
        let lanes = datums.into_iter().enumerate().map(lane).collect();
        Stream { program, ensemble, epoch, zero, lanes }
    }

    pub(crate) fn program(&self) -> &Program {
        &self.program
    }

    pub(crate) fn zero(&self) -> u64 {
        self.zero
    }

    pub(crate) fn epoch(&self) -> Epoch {
        self.epoch
    }

    pub(crate) fn datum(&self, motor: usize) -> Datum {
        self.lanes[motor].datum
    }

    pub(crate) fn certificate(&self, motor: usize) -> Certificate {
        self.ensemble.certificate(motor)
    }

    /// The motor that the board knows least far ahead, and up to which tick: that of the last step that it was handed, or of the end
    /// of the wait after it. `None` when all was handed over.
    pub(crate) fn known(&self) -> Option<(u64, usize)> {
        let going = self.lanes.iter().enumerate().filter(|(_, lane)| !lane.is_told());
        going.map(|(motor, lane)| (tick_of(lane.accumulator, self.program.board.fraction_bits), motor)).min()
    }

    /// Hands a portion of the plan over up to tick `until`: the motor that is known least far first. The queues keep so many places free.
    pub(crate) fn hand_over<B: Board>(
        &mut self,
        board: &mut B,
        timelines: &mut [Timeline],
        kept: &[usize],
        until: u64,
    ) -> Result<Handed, SessionError> {
        let fraction_bits = self.program.board.fraction_bits;
        let mut full = vec![false; self.lanes.len()];
        for _ in 0..ITEMS_AT_ONCE * self.lanes.len() {
            let open = (0..self.lanes.len()).filter(|motor| !full[*motor] && !self.lanes[*motor].is_told());
            let least = open.min_by_key(|motor| self.lanes[*motor].accumulator);
            let Some(motor) = least.filter(|motor| tick_of(self.lanes[*motor].accumulator, fraction_bits) < until)
            else {
                return Ok(Handed {
                    more: false,
                    short: self.known().map(|(_, motor)| motor).filter(|motor| full[*motor]),
                });
            };
            let Some(item) = self.next_item(motor)? else { continue };
            let lane = &mut self.lanes[motor];
            let mut sizer = lane.sizer;
            if board.room(motor) < sizer.size(&item) + kept[motor]
                || board.push(motor, Entry { epoch: self.epoch, item }).is_err()
            {
                full[motor] = true;
                continue;
            }
            let placed = Placed { start: lane.accumulator, item };
            lane.next.pop_front();
            lane.sizer = sizer;
            lane.accumulator = placed.end(fraction_bits);
            lane.waits = !matches!(item, Item::Run { .. });
            timelines[motor].push(placed);
        }
        Ok(Handed { more: true, short: None })
    }

    /// The first item that was not handed over.
    fn next_item(&mut self, motor: usize) -> Result<Option<Item>, SessionError> {
        let lane = &mut self.lanes[motor];
        loop {
            if let Some(item) = lane.next.front() {
                return Ok(Some(*item));
            }
            if lane.dwell > 0 {
                let part = lane.dwell.min(LONGEST_DWELL_TICKS);
                lane.dwell -= part;
                lane.next.push_back(Item::Dwell { ticks: part as u32 });
                continue;
            }
            if lane.ended {
                return Ok(None);
            }
            match self.ensemble.next_move(motor)? {
                Some(Move::Dwell { ticks }) => lane.dwell = ticks,
                Some(Move::Run { segment, direction }) => {
                    let run = |segment| Item::Run { segment, direction };
                    let fraction_bits = self.program.board.fraction_bits;
                    let ticks = segment.interval >> fraction_bits;
                    // A step that was put off may come after more than one interval says.
                    if ticks < i64::from(LONGEST_WAIT_TICKS) {
                        lane.next.push_back(run(segment));
                    } else {
                        let wait = ticks - i64::from(LONGEST_WAIT_TICKS) / 2;
                        let first =
                            Segment { interval: segment.interval - (wait << fraction_bits), ..segment.truncated(1) };
                        lane.next.extend([Item::Dwell { ticks: wait as u32 }, run(first)]);
                        if segment.count > 1 {
                            lane.next.push_back(run(segment.after(1)));
                        }
                    }
                }
                None => {
                    lane.ended = true;
                    // A motor that has nothing more to do while others go on has not run dry.
                    if !lane.waits {
                        lane.next.push_back(Item::Dwell { ticks: 0 });
                    }
                }
            }
        }
    }

    /// Where the law of a motor that has counted to `count` is at `tick`.
    pub(crate) fn place(&mut self, motor: usize, tick: u64, count: i64) -> Result<Place, SessionError> {
        let lane = &mut self.lanes[motor];
        // Ticks of a session stay far below 2^62.
        let at = Time::from_ratio(tick.wrapping_sub(self.zero).cast_signed(), self.program.board.tick_hz);
        let sample = lane.cursor.at(at).map_err(|error| SessionError::Law { motor, error })?;
        let off = (sample.whole - lane.datum.0 - count) as f64 + (sample.fraction - lane.datum.1);
        Ok(Place { off, speed: sample.speed })
    }
}

impl Lane {
    /// Whether all was handed over.
    fn is_told(&self) -> bool {
        self.ended && self.next.is_empty()
    }
}
