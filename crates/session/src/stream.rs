//! A program's plan as the items of one epoch, sent to the board as its queues have room; and the program's laws at any tick.

use crate::SessionError;
use crate::plans::{Clock, Planned};
use crate::timeline::{Placed, Timeline, tick_of};
use pulsetrain_board::{Board, Sizer};
use pulsetrain_core::{Entry, Epoch, Item, Segment, Tick32};
use pulsetrain_motion::Time;
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::program::Program;
use pulsetrain_plan::line::LONGEST_DWELL_TICKS;
use pulsetrain_plan::{Certificate, Ensemble, LONGEST_WAIT_TICKS, Move, Start};
use std::collections::VecDeque;
use std::sync::Arc;

/// θ where a motor's count is 0: whole steps, and a fraction of a step.
pub(crate) type Datum = (i64, f64);

/// A program's plan on its way to the board.
pub(crate) struct Stream {
    program: Arc<Program>,
    ensemble: Ensemble,
    epoch: Epoch,
    /// The board's tick at which the laws' time is 0.
    zero: u64,
    lanes: Vec<Lane>,
}

/// The items of one motor, and how far they were sent.
struct Lane {
    cursor: Cursor,
    datum: Datum,
    sizer: Sizer,
    /// The motor's time after the items that were sent, ticks · 2^F.
    accumulator: i128,
    /// Whether the last item that was sent is an anchor or a wait.
    waits: bool,
    /// Items that were planned and not sent.
    next: VecDeque<Item>,
    /// What is left of a wait after them, ticks.
    dwell: u64,
    /// The planner has no more moves.
    ended: bool,
    /// How far the motor's moves go, from the laws' time 0 on.
    clock: Clock,
}

/// Where a motor's law is, seen from the step that the motor stands on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LawPlace {
    /// θ − count, steps.
    pub(crate) offset: f64,
    /// steps/s.
    pub(crate) speed: f64,
}

/// How far [`Stream::hand_over`] came.
#[derive(Clone, Debug, Default)]
pub(crate) struct Handed {
    /// The queues may have room for more.
    pub(crate) has_more: bool,
    /// The motor whose plan on the board ends soonest, if that is because its queue is full.
    pub(crate) motor_full: Option<usize>,
}

/// Items of each motor that are sent before the lease is extended, on average: an extension for each item would load the line.
const ITEMS_AT_ONCE: usize = 16;

impl Stream {
    /// A program from its beginning. Its laws begin where the motors are: `counts` is what the board has counted.
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

    /// A program that takes over from another one and keeps its datums, so that θ stays the same.
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
        let fraction_bits = program.board.registers.fraction_bits;
        let lane = |(motor, datum): (usize, Datum)| Lane {
            cursor: Cursor::new(&program.motors[motor].law),
            datum,
            sizer: board.sizer(motor),
            accumulator: (i128::from(zero) << fraction_bits) + (1 << (fraction_bits - 1)),
            waits: true,
            next: VecDeque::from([Item::Anchor { tick: Tick32::of(zero) }]),
            dwell: 0,
            ended: false,
            clock: Clock::new(fraction_bits),
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

    /// What is planned of each motor so far.
    pub(crate) fn planned(&self) -> Vec<Planned> {
        let lanes = self.lanes.iter().enumerate();
        lanes.map(|(motor, lane)| lane.clock.planned(self.certificate(motor), None)).collect()
    }

    pub(crate) fn certificate(&self, motor: usize) -> Certificate {
        self.ensemble.certificate(motor)
    }

    /// How many items are planned and not sent.
    pub(crate) fn unsent(&self) -> usize {
        self.lanes.iter().map(|lane| lane.next.len()).sum()
    }

    /// The motor whose sent plan ends soonest, and the tick of that end: of its last sent step, or of the wait after it. `None` when the whole plan
    /// was sent.
    pub(crate) fn least_handed_over(&self) -> Option<(u64, usize)> {
        let going = self.lanes.iter().enumerate().filter(|(_, lane)| !lane.is_handed_over());
        going.map(|(motor, lane)| (tick_of(lane.accumulator, self.program.board.registers.fraction_bits), motor)).min()
    }

    /// Sends a part of the plan up to tick `until`, always of the motor whose sent plan ends soonest. Leaves `reserved` room in each queue, in the
    /// board's unit.
    pub(crate) fn hand_over<B: Board>(
        &mut self,
        board: &mut B,
        timelines: &mut [Timeline],
        reserved: &[usize],
        until: u64,
    ) -> Result<Handed, SessionError> {
        let fraction_bits = self.program.board.registers.fraction_bits;
        let mut full = vec![false; self.lanes.len()];
        for _ in 0..ITEMS_AT_ONCE * self.lanes.len() {
            let open = (0..self.lanes.len()).filter(|motor| !full[*motor] && !self.lanes[*motor].is_handed_over());
            let least = open.min_by_key(|motor| self.lanes[*motor].accumulator);
            let Some(motor) = least.filter(|motor| tick_of(self.lanes[*motor].accumulator, fraction_bits) < until)
            else {
                return Ok(Handed {
                    has_more: false,
                    motor_full: self.least_handed_over().map(|(_, motor)| motor).filter(|motor| full[*motor]),
                });
            };
            let Some(item) = self.next_item(motor)? else { continue };
            let lane = &mut self.lanes[motor];
            let mut sizer = lane.sizer;
            if board.room(motor) < sizer.size(&item) + reserved[motor]
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
        Ok(Handed { has_more: true, motor_full: None })
    }

    /// Takes items back that were sent for a motor and dropped by the board. They are sent again. `after_steps`: the item before them makes steps.
    pub(crate) fn take_back<B: Board>(&mut self, board: &B, motor: usize, items: &VecDeque<Placed>, after_steps: bool) {
        let Some(first) = items.front() else { return };
        let lane = &mut self.lanes[motor];
        (lane.accumulator, lane.sizer, lane.waits) = (first.start, board.sizer(motor), !after_steps);
        items.iter().rev().for_each(|placed| lane.next.push_front(placed.item));
    }

    /// A motor's first item that was not sent; `None` at its end, or if the next one came out empty.
    fn next_item(&mut self, motor: usize) -> Result<Option<Item>, SessionError> {
        let fraction_bits = self.program.board.registers.fraction_bits;
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
            let next = self.ensemble.next_move(motor)?;
            next.iter().for_each(|next| lane.clock.advance(next, fraction_bits));
            match next {
                Some(Move::Dwell { ticks }) => lane.dwell = ticks,
                Some(Move::Run { segment, direction }) => {
                    let run = |segment| Item::Run { segment, direction };
                    let ticks = segment.interval >> fraction_bits;
                    // A step that waited for a shared DIR line may come after more time than one interval can express: a wait comes first.
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
                    // Without a wait at its end the board would take a motor that is done for one whose plan came too late.
                    if !lane.waits {
                        lane.next.push_back(Item::Dwell { ticks: 0 });
                    }
                }
            }
        }
    }

    /// The law of a motor at `tick`, relative to the step `count` that the motor stands on.
    pub(crate) fn law_at(&mut self, motor: usize, tick: u64, count: i64) -> Result<LawPlace, SessionError> {
        let lane = &mut self.lanes[motor];
        // Ticks of a session stay far below 2^62.
        let at = Time::from_ratio(tick.wrapping_sub(self.zero).cast_signed(), self.program.board.tick_hz);
        let sample = lane.cursor.at(at).map_err(|error| SessionError::Law { motor, error })?;
        let offset = (sample.whole - lane.datum.0 - count) as f64 + (sample.fraction - lane.datum.1);
        Ok(LawPlace { offset, speed: sample.speed })
    }
}

impl Lane {
    /// Whether the whole plan of this motor was sent.
    fn is_handed_over(&self) -> bool {
        self.ended && self.next.is_empty()
    }
}
