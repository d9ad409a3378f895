//! Plans as packed bytes, in pieces, for images of the Pico and of the Uno. A repeating motion is cut down to its first
//! turn.
//!
//! The cut lies in the widest gap between two steps, as for tables. The wait in that gap is separate from the bytes
//! that repeat, so that each turn begins at its exact time.

use pulsetrain_board::Setup;
use pulsetrain_core::packing::{MAX_PACKED_LEN, PackError, Packing, State};
use pulsetrain_core::{Direction, Item, Segment};
use pulsetrain_motion::Time;
use pulsetrain_motion::program::{Motor, Program};
use pulsetrain_plan::{Ensemble, Move};

use crate::error::BakeError;
use crate::table::{self, Cut, PutOff, TURNS, Turns, Unrolled};

/// The longest wait that one item can hold, ticks.
const LONGEST_DWELL: u64 = 1 << 30;

/// How a board's firmware reads a stream.
#[derive(Clone, Copy)]
pub(super) struct Shape {
    /// The board, with its article.
    pub(super) board: &'static str,
    /// Packed bytes of a piece at most.
    pub(super) piece: usize,
    /// Which waits become pieces of their own.
    pub(super) long: Option<LongWaits>,
    /// Which segments are split into segments of two steps, since the firmware need not plan those step by step. The
    /// ticks do not change.
    pub(super) by_pairs: fn(&Segment) -> bool,
}

/// Waits that become pieces of their own, with a mark in the piece's length.
#[derive(Clone, Copy)]
pub(super) struct LongWaits {
    /// The least wait that becomes such a piece, ticks.
    pub(super) from: u64,
    /// The longest wait of one such piece, ticks.
    pub(super) most: u64,
    /// The mark in the piece's length.
    pub(super) mark: u8,
}

/// A motor's motion in a board's flash.
pub(super) struct Stream {
    /// Pieces that are played once; they include the first step after the first wait.
    pub(super) head: Vec<u8>,
    /// Pieces that are played again and again; they leave that step out.
    pub(super) turn: Vec<u8>,
    pub(super) repeats: Option<Gap>,
    /// Segments and waits.
    pub(super) items: usize,
    /// The time of the motion that the stream holds, s.
    pub(super) length_s: f64,
    pub(super) put_off: PutOff,
}

/// The gap between a turn's last step and the next turn's first one.
#[derive(Clone, Copy)]
pub(super) struct Gap {
    /// Ticks · 2^-64. The gap is longer than a pulse: see `Unrolled::cut`.
    pub(super) wait: i128,
    pub(super) from: Direction,
    pub(super) to: Direction,
}

/// The streams of all motors. No plan is unrolled further than `room` bytes can hold.
pub(super) fn streams(program: &Program, setup: &Setup, room: usize, shape: Shape) -> Result<Vec<Stream>, BakeError> {
    let mut ensemble = Ensemble::new(program).map_err(BakeError::Plan)?;
    let motors = program.motors.iter().zip(&setup.motors).enumerate();
    let (mut streams, mut turns) = (Vec::new(), Vec::new());
    for (index, (motor, wired)) in motors {
        let cycle = table::cycle(program, motor)?;
        let hz = program.board.tick_hz;
        let end = cycle.map(|(from, period)| (from + period.times(TURNS)).ticks(hz).0.max(0).cast_unsigned());
        let most = room.saturating_mul(if cycle.is_some() { 1 + TURNS as usize } else { 1 });
        let pieces = |direction| {
            let packing = Packing { fraction_bits: program.board.registers.fraction_bits, gain: wired.gain };
            Pieces::new(packing, shape, direction)
        };
        let (mut plan, mut packed) = (Unrolled::new(program.board.registers.fraction_bits), pieces(Direction::Forward));
        let mut fits = None;
        while end.is_none_or(|end| plan.tick() <= end) {
            let Some(next) = ensemble.next_move(index).map_err(BakeError::Plan)? else { break };
            packed.push(&next);
            let bytes = packed.bytes.len();
            if bytes > room && fits.is_none() {
                fits = Some(plan.tick() as f64 / hz as f64);
            }
            if let Some(fits_s) = fits.filter(|_| bytes > most) {
                // How many bytes the other motors need is not known yet. They are taken to need as much.
                let fits_s = fits_s / program.motors.len() as f64;
                return Err(BakeError::TooLarge { board: shape.board, bytes, limit: room, fits_s });
            }
            plan.push(next, ensemble.put_off_ticks(index));
        }
        let (stream, again) = stream(&plan, motor, program, cycle, pieces)?;
        streams.push(stream);
        turns.push(again);
    }
    table::check_turns(program, &turns)?;
    Ok(streams)
}

/// A motor's plan as bytes. A repeating plan is cut down to its first turn.
fn stream(
    plan: &Unrolled,
    motor: &Motor,
    program: &Program,
    cycle: Option<(Time, Time)>,
    pieces: impl Fn(Direction) -> Pieces,
) -> Result<(Stream, Option<Turns>), BakeError> {
    let hz = program.board.tick_hz;
    let mut head = pieces(Direction::Forward);
    let Some(cycle) = cycle else {
        plan.all().for_each(|next| head.push(&next));
        let length_s = plan.tick() as f64 / hz as f64;
        let (head, items) = head.finish();
        let put_off = plan.put_off(None);
        return Ok((Stream { head, turn: Vec::new(), repeats: None, items, length_s, put_off }, None));
    };
    let cut = plan.cut(motor, program, cycle)?;
    let Cut { begin, second, end, .. } = cut;
    plan.part(None, second).for_each(|next| head.push(&next));
    let mut turn = pieces(second.way);
    turn.reset();
    plan.part(Some(second), end).for_each(|next| turn.push(&next));
    // The gap from the last step of a turn to the first of the next: the first wait, and the difference between a
    // period and the turn's steps.
    // 2^-64 s · ticks/s: ticks · 2^-64.
    let apart = second.at - begin.at - (end.at - begin.at);
    let wait = cycle.1.raw() * i128::from(hz) + (apart << (64 - program.board.registers.fraction_bits));
    let repeats = Gap { wait, from: end.way, to: second.way };
    let length_s = (cycle.0 + cycle.1).seconds();
    let ((head, first), (turn, then)) = (head.finish(), turn.finish());
    let put_off = plan.put_off(Some(end));
    let stream = Stream { head, turn, repeats: Some(repeats), items: first + then, length_s, put_off };
    Ok((stream, Some(plan.turns(&cut, cycle.1, hz))))
}

/// Packed items, cut into pieces.
pub(super) struct Pieces {
    packing: Packing,
    shape: Shape,
    state: State,
    bytes: Vec<u8>,
    /// The piece that is being filled.
    piece: Vec<u8>,
    items: usize,
}

impl Pieces {
    pub(super) fn new(packing: Packing, shape: Shape, direction: Direction) -> Pieces {
        Pieces { packing, shape, state: State::new(direction), bytes: Vec::new(), piece: Vec::new(), items: 0 }
    }

    pub(super) fn reset(&mut self) {
        self.pack(|packing, state, out| packing.pack_reset(state, out));
    }

    pub(super) fn push(&mut self, next: &Move) {
        match *next {
            Move::Dwell { ticks } => self.dwell(ticks),
            Move::Run { segment, direction } if (self.shape.by_pairs)(&segment) => {
                let mut left = segment;
                while left.count > 0 {
                    let pair = left.truncated(left.count.min(2));
                    left = left.after(pair.count);
                    self.item(&Item::Run { segment: pair, direction });
                }
            }
            Move::Run { segment, direction } => self.item(&Item::Run { segment, direction }),
        }
    }

    pub(super) fn dwell(&mut self, mut left: u64) {
        while left > 0 {
            let long = self.shape.long.filter(|long| left >= long.from);
            let ticks = left.min(long.map_or(LONGEST_DWELL, |long| long.most)) as u32;
            left -= u64::from(ticks);
            match long {
                None => self.item(&Item::Dwell { ticks }),
                Some(LongWaits { mark, .. }) => {
                    self.flush(0);
                    self.item(&Item::Dwell { ticks });
                    self.flush(mark);
                }
            }
        }
    }

    pub(super) fn item(&mut self, item: &Item) {
        self.items += 1;
        self.pack(|packing, state, out| packing.pack(state, item, out));
    }

    fn pack(&mut self, pack: impl FnOnce(&Packing, &mut State, &mut [u8]) -> Result<usize, PackError>) {
        let mut out = [0; MAX_PACKED_LEN];
        let len = pack(&self.packing, &mut self.state, &mut out).expect("planned segments have steps");
        if self.piece.len() + len > self.shape.piece {
            self.flush(0);
        }
        self.piece.extend(&out[..len]);
    }

    fn flush(&mut self, mark: u8) {
        if !self.piece.is_empty() {
            self.bytes.push(self.piece.len() as u8 | mark);
            self.bytes.append(&mut self.piece);
        }
    }

    /// All pieces, and how many items are in them.
    pub(super) fn finish(mut self) -> (Vec<u8>, usize) {
        self.flush(0);
        (self.bytes, self.items)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tick of each step, ticks · 2^-16, and the number of segments that the steps came in.
    fn ticks(shape: Shape, moves: &[Move]) -> (Vec<i64>, usize) {
        let packing = Packing { fraction_bits: 16, gain: 0 };
        let mut pieces = Pieces::new(packing, shape, Direction::Forward);
        moves.iter().for_each(|next| pieces.push(next));
        let (bytes, items) = pieces.finish();
        let (mut bytes, mut all) = (&bytes[..], Vec::new());
        let (mut state, mut at) = (State::new(Direction::Forward), 0);
        while let Some((len, rest)) = bytes.split_first() {
            let (mut piece, behind) = rest.split_at(usize::from(*len));
            bytes = behind;
            while let Some(item) = packing.unpack(&mut state, &mut piece).unwrap() {
                let Item::Run { mut segment, .. } = item else { panic!("{item:?}") };
                while segment.count > 0 {
                    at += segment.interval;
                    all.push(at);
                    segment = segment.after(1);
                }
            }
        }
        (all, items)
    }

    #[test]
    fn pairs_of_a_segments_steps_have_its_ticks() {
        let whole = Shape { board: "a board", piece: 60, long: None, by_pairs: |_| false };
        let pairs = Shape { by_pairs: |segment| segment.add2.unsigned_abs() > 1 << 16, ..whole };
        // A ramp's last segments on an Uno, at 52 837 steps/s, and the segment after them.
        let run = |count, interval, add, add2| Move::Run {
            segment: Segment { count, interval, add, add2 },
            direction: Direction::Forward,
        };
        for count in [4, 5] {
            let moves = [
                run(234, 20_500_000, -3422, 3),
                run(count, 20_111_905, -256_256, 189_368),
                run(21, 19_829_873, 42_464, -7240),
                run(26, 20_036_801, -19_464, 952),
            ];
            let (expected, segments) = ticks(whole, &moves);
            assert_eq!((expected.len(), segments), (281 + count as usize, 4));
            assert_eq!(ticks(pairs, &moves), (expected, 3 + count.div_ceil(2) as usize));
        }
    }
}
