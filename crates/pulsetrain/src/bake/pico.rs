//! An image of a Pico's flash that plays a motion from power-up on: the committed firmware, and behind it a block that it finds
//! there ([`pulsetrain_core::baked`]).
//!
//! What repeats is cut as for an Uno, in the widest gap between two steps; the wait there is the firmware's to make, so that each
//! turn begins at its own exact time.

use pulsetrain_board::virtual_pico::{self, VirtualPico};
use pulsetrain_board::{RemoteError, Setup, image};
use pulsetrain_core::baked::{FLASH_ROOM, FRACTION_BITS, LONGEST_PIECE, MAGIC, POINTER, Repeats, crc32};
use pulsetrain_core::packing::{MAX_PACKED_LEN, PackError, Packing, State};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::MotorSetup;
use pulsetrain_core::{Direction, Item};
use pulsetrain_motion::Time;
use pulsetrain_motion::program::{Motor, Program};
use pulsetrain_plan::{Ensemble, Move};

use super::table::{self, Cut, Unrolled};
use super::{BakeError, TURNS};
use crate::drive;

/// Where a Pico's flash is (RP2040 datasheet §2.6).
const FLASH_AT: u32 = 0x1000_0000;

/// The boot ROM wants sectors whole, or may leave parts of them as they were (RP2040 datasheet, erratum E14).
const SECTOR: usize = 4096;

/// What reading a segment from the flash takes the firmware beside all else, ticks: some 12 bytes, at 48 each by the command that
/// every flash chip knows (8 bytes: 96 bits, each 4 ticks). (est.)
const READ_TICKS: u32 = 600;

/// Longest wait of one item, ticks.
const LONGEST_DWELL: u64 = 1 << 30;

/// An image of a Pico's flash.
#[derive(Clone, Debug)]
pub struct PicoImage {
    /// From the beginning of the flash on.
    pub flash: Vec<u8>,
    /// Bytes of the motion in it.
    pub block_bytes: usize,
    /// Segments and waits of all motors.
    pub items: usize,
    /// Whether any motor goes on for ever.
    pub endless: bool,
}

impl PicoImage {
    /// Bytes of a Pico's flash that an image may fill; the settings are behind them.
    pub const ROOM: usize = FLASH_ROOM as usize;

    /// The image of a program for the Pico. The committed firmware itself, on the virtual Pico, is asked whether it takes pins and
    /// times.
    ///
    /// # Errors
    /// [`BakeError`]: a motion that is refused, that does not repeat or does not fit, or pins that the firmware refuses.
    pub fn new(program: &Program) -> Result<PicoImage, BakeError> {
        PicoImage::within(program, PicoImage::ROOM)
    }

    /// The same in the first `flash_bytes` of the flash, [`ROOM`](PicoImage::ROOM) at most.
    ///
    /// # Errors
    /// As [`PicoImage::new`].
    pub fn within(program: &Program, flash_bytes: usize) -> Result<PicoImage, BakeError> {
        if program.board.name != "pico" {
            return Err(BakeError::Board { board: program.board.name.clone() });
        }
        drive::connect(VirtualPico::new(), program, Baud::B115200).map_err(Box::new)?;
        let mut program = program.clone();
        for (motors, ticks) in (1..).zip(&mut program.board.segment_ticks) {
            ticks.onward += motors * READ_TICKS;
            ticks.turning += motors * READ_TICKS;
            // From no host.
            ticks.heard = 0;
        }
        let mut flash = firmware()?;
        let at = flash.len();
        let limit = flash_bytes.min(PicoImage::ROOM).saturating_sub(at);
        let setup = drive::setup(&program);
        let streams = streams(&program, &setup, limit)?;
        let block = block(&setup, &streams).ok_or(RemoteError::Nonsense).map_err(Box::new)?;
        if block.len() > limit {
            let whole_s = streams.iter().map(|stream| stream.length_s).fold(0.0, f64::max);
            let bytes = block.len();
            return Err(BakeError::TooLarge {
                board: "a Pico",
                bytes,
                limit,
                fits_s: whole_s * limit as f64 / bytes as f64,
            });
        }
        flash[POINTER..POINTER + 4].copy_from_slice(&(at as u32).to_le_bytes());
        flash.extend(&block);
        flash.resize(flash.len().next_multiple_of(SECTOR), 0xff);
        Ok(PicoImage {
            flash,
            block_bytes: block.len(),
            items: streams.iter().map(|stream| stream.items).sum(),
            endless: streams.iter().any(|stream| stream.repeats.is_some()),
        })
    }

    /// As UF2, which a Pico's drive and `pulsetrain flash` take.
    #[must_use]
    pub fn uf2(&self) -> Vec<u8> {
        image::to_uf2(&self.flash, FLASH_AT, virtual_pico::FAMILY)
    }
}

/// The committed firmware, in whole sectors.
fn firmware() -> Result<Vec<u8>, BakeError> {
    let broken = |error: image::ImageError| BakeError::Player { what: error.to_string() };
    let pieces = image::uf2(virtual_pico::IMAGE, virtual_pico::FAMILY).map_err(broken)?;
    let mut flash = image::flat(&pieces, FLASH_AT, PicoImage::ROOM).map_err(broken)?;
    flash.resize(flash.len().next_multiple_of(SECTOR), 0xff);
    Ok(flash)
}

/// What a block has of a motor.
struct Stream {
    head: Vec<u8>,
    turn: Vec<u8>,
    repeats: Option<Repeats>,
    items: usize,
    /// What of the motion it holds, s.
    length_s: f64,
}

/// The streams of all motors; no plan is unrolled further than `room` bytes can hold.
fn streams(program: &Program, setup: &Setup, room: usize) -> Result<Vec<Stream>, BakeError> {
    let mut ensemble = Ensemble::new(program).map_err(BakeError::Plan)?;
    let motors = program.motors.iter().zip(&setup.motors).enumerate();
    let streams = motors.map(|(index, (motor, wired))| {
        let cycle = table::cycle(program, motor)?;
        let hz = program.board.tick_hz;
        let end = cycle.map(|(from, period)| (from + period.times(TURNS)).ticks(hz).0.max(0).cast_unsigned());
        // A segment has a byte at least.
        let most = room.saturating_mul(if cycle.is_some() { 1 + TURNS as usize } else { 1 });
        let mut plan = Unrolled::new(program.board.fraction_bits);
        while end.is_none_or(|end| plan.tick() <= end) {
            let Some(next) = ensemble.next_move(index).map_err(BakeError::Plan)? else { break };
            plan.push(next);
            if plan.moves() > most {
                let fits_s = plan.tick_of(room) as f64 / hz as f64;
                return Err(BakeError::TooLarge { board: "a Pico", bytes: plan.moves(), limit: room, fits_s });
            }
        }
        stream(&plan, motor, wired, program, cycle)
    });
    streams.collect()
}

/// A motor's plan as bytes; what repeats is cut out of it.
fn stream(
    plan: &Unrolled,
    motor: &Motor,
    wired: &MotorSetup,
    program: &Program,
    cycle: Option<(Time, Time)>,
) -> Result<Stream, BakeError> {
    let hz = program.board.tick_hz;
    let mut head = Pieces::new(wired.gain, Direction::Forward);
    let Some(cycle) = cycle else {
        plan.all().for_each(|next| head.push(&next));
        let length_s = plan.tick() as f64 / hz as f64;
        let (head, items) = head.finish();
        return Ok(Stream { head, turn: Vec::new(), repeats: None, items, length_s });
    };
    let Cut { begin, second, end, .. } = plan.cut(motor, program, cycle)?;
    plan.part(None, second).for_each(|next| head.push(&next));
    let mut turn = Pieces::new(wired.gain, second.way);
    turn.reset();
    plan.part(Some(second), end).for_each(|next| turn.push(&next));
    // From the last step of a turn to the first of the next: the first wait, and what the turn's steps are shorter than a period.
    // 2^-64 s · ticks/s: ticks · 2^-64.
    let wait = cycle.1.raw() * i128::from(hz) + ((second.at - begin.at - (end.at - begin.at)) << (64 - FRACTION_BITS));
    let repeats = Repeats {
        // It is longer than a pulse: see `Unrolled::cut`.
        ticks: (wait >> 64) as u64,
        part: (wait >> 32) as u32,
        rest: wait as u32,
        from: end.way,
        to: second.way,
    };
    let length_s = (cycle.0 + cycle.1).seconds();
    let ((head, first), (turn, then)) = (head.finish(), turn.finish());
    Ok(Stream { head, turn, repeats: Some(repeats), items: first + then, length_s })
}

/// The block of all motors; `None` with more than 8 of them, or more than 2^32 bytes.
fn block(setup: &Setup, streams: &[Stream]) -> Option<Vec<u8>> {
    let motors = setup.motor_bytes();
    let (head, motors) = setup.configuration(&motors)?.to_bytes();
    let mut body = vec![u8::try_from(head.len() + motors.len()).ok()?];
    body.extend(head);
    body.extend(motors);
    for Stream { head, turn, repeats, .. } in streams {
        for part in [head, turn] {
            body.extend(u32::try_from(part.len()).ok()?.to_le_bytes());
        }
        body.extend(Repeats::to_bytes(*repeats));
    }
    body.extend(streams.iter().flat_map(|stream| [&stream.head, &stream.turn]).flatten());
    let len = u32::try_from(pulsetrain_core::baked::HEAD_LEN + body.len()).ok()?;
    Some([&MAGIC[..], &len.to_le_bytes(), &crc32(&body).to_le_bytes(), &body].concat())
}

/// Packed items, in pieces.
struct Pieces {
    packing: Packing,
    state: State,
    bytes: Vec<u8>,
    /// The piece that is being filled.
    piece: Vec<u8>,
    items: usize,
}

impl Pieces {
    fn new(gain: i8, direction: Direction) -> Pieces {
        let packing = Packing { fraction_bits: FRACTION_BITS, gain };
        Pieces { packing, state: State::new(direction), bytes: Vec::new(), piece: Vec::new(), items: 0 }
    }

    fn reset(&mut self) {
        self.pack(|packing, state, out| packing.pack_reset(state, out));
    }

    fn push(&mut self, next: &Move) {
        match *next {
            Move::Dwell { ticks: mut left } => {
                while left > 0 {
                    let ticks = left.min(LONGEST_DWELL) as u32;
                    left -= u64::from(ticks);
                    self.item(&Item::Dwell { ticks });
                }
            }
            Move::Run { segment, direction } => self.item(&Item::Run { segment, direction }),
        }
    }

    fn item(&mut self, item: &Item) {
        self.items += 1;
        self.pack(|packing, state, out| packing.pack(state, item, out));
    }

    fn pack(&mut self, pack: impl FnOnce(&Packing, &mut State, &mut [u8]) -> Result<usize, PackError>) {
        let mut out = [0; MAX_PACKED_LEN];
        let len = pack(&self.packing, &mut self.state, &mut out).expect("planned segments have steps");
        if self.piece.len() + len > LONGEST_PIECE {
            self.flush();
        }
        self.piece.extend(&out[..len]);
    }

    fn flush(&mut self) {
        if !self.piece.is_empty() {
            self.bytes.push(self.piece.len() as u8);
            self.bytes.append(&mut self.piece);
        }
    }

    fn finish(mut self) -> (Vec<u8>, usize) {
        self.flush();
        (self.bytes, self.items)
    }
}
