//! A motion in a board's flash: its format, and the player that reads its packed bytes, turn by turn.
//!
//! # The block
//! All integers are little-endian. Bytes after the block are ignored.
//!
//! | byte | |
//! |---|---|
//! | 0–3 | `PTB1` |
//! | 4–7 | length of the block, bytes, these eight included |
//! | 8–11 | CRC-32 of bytes 12 to the last ([`crc32`]) |
//! | 12 | n, bytes of the configuration |
//! | 13… | n bytes: the payload of Configure ([`Configuration`]) |
//! | then | 25 bytes for each motor: see [`BakedMotor`] |
//! | then | for each motor its head (made once) and its turn (repeated): pieces, each a byte with its length and as many packed bytes. No item is cut in two |
//!
//! # Phase
//! A turn begins after a step, most often the last step before a turning point. The wait from there to the next step is not stored in
//! the turn: [`Player`] makes it, so that each turn begins exactly a period after the one before. The period is stored to 2^-64
//! ticks, and the part below a fraction bit adds up from turn to turn. So the error stays below 2^-32 ticks for years.

pub mod avr;

use crate::packing::{MAX_PACKED_LEN, Packing, State};
use crate::wire::message::{Command, Configuration, kind};
use crate::{Direction, Item, Segment, Tick32};

/// The place in an image of four bytes that say where its block begins, as an offset into the flash; they are 0 in an image without a
/// motion. In a Pico's image they are a vector that the processor does not use (ARMv6-M, B1.5.3: 7).
pub const POINTER: usize = 0x11c;

/// Bytes of a Pico's flash, of 2 MB, that images and blocks may fill; the two sectors of 4096 bytes behind them are for
/// [`Settings`](crate::wire::Settings).
pub const PROGRAM_FLASH_BYTES: u32 = (2 << 20) - 2 * 4096;

/// Fraction bits of the recurrence of boards that have such blocks, F.
pub const FRACTION_BITS: u32 = 32;

/// The most packed bytes in a piece.
pub const LONGEST_PIECE: usize = 64;
// At most, `Player::next` adds a reset and the step after a wait to what it reads.
const _: () = assert!(2 + MAX_PACKED_LEN <= LONGEST_PIECE);

/// Bytes before those that the CRC covers.
pub const HEAD_LEN: usize = 12;

/// Bytes of a motor's head in a block.
pub const MOTOR_LEN: usize = 25;

/// The first four bytes of a block.
pub const MAGIC: &[u8; 4] = b"PTB1";

/// The longest wait that [`Player`] puts into one item, ticks: ticks of 32 bits can be compared within 2^31 only.
const LONGEST_DWELL: u32 = 1 << 30;

/// CRC-32, reflected polynomial 0xedb88320, first and last all ones, as in Ethernet (IEEE 802.3, 3.2.9).
///
/// ```
/// assert_eq!(pulsetrain_core::baked::crc32(b"123456789"), 0xcbf4_3926);
/// ```
#[must_use]
pub fn crc32(bytes: &[u8]) -> u32 {
    const TABLE: [u32; 16] = {
        let (mut table, mut nibble) = ([0; 16], 0_u32);
        while nibble < 16 {
            let (mut sum, mut bit) = (nibble, 0);
            while bit < 4 {
                sum = if sum & 1 == 1 { sum >> 1 ^ 0xedb8_8320 } else { sum >> 1 };
                bit += 1;
            }
            table[nibble as usize] = sum;
            nibble += 1;
        }
        table
    };
    let nibble = |sum: u32| sum >> 4 ^ TABLE[(sum & 15) as usize];
    !bytes.iter().fold(u32::MAX, |sum, byte| nibble(nibble(sum ^ u32::from(*byte))))
}

/// A block that was checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block<'a> {
    /// Pins and times of all motors.
    pub configuration: Configuration<'a>,
    /// [`BakedMotor`]s, packed, and their pieces.
    motors: &'a [u8],
    pieces: &'a [u8],
}

impl<'a> Block<'a> {
    /// Reads the block at the front of `bytes`; `None` if there is none, or its CRC or a length is wrong.
    #[must_use]
    pub fn read(bytes: &'a [u8]) -> Option<Block<'a>> {
        let (head, _) = bytes.split_first_chunk::<HEAD_LEN>()?;
        let [m0, m1, m2, m3, l0, l1, l2, l3, c0, c1, c2, c3] = *head;
        let len = usize::try_from(u32::from_le_bytes([l0, l1, l2, l3])).ok()?;
        let body = bytes.get(HEAD_LEN..len)?;
        if [m0, m1, m2, m3] != *MAGIC || crc32(body) != u32::from_le_bytes([c0, c1, c2, c3]) {
            return None;
        }
        let (n, rest) = body.split_first()?;
        let (payload, rest) = rest.split_at_checked(usize::from(*n))?;
        let Ok(Command::Configure(configuration)) = Command::decode(kind::CONFIGURE, payload) else { return None };
        let (motors, pieces) = rest.split_at_checked(MOTOR_LEN * configuration.motors().len())?;
        let block = Block { configuration, motors, pieces };
        // The pieces must be as long as the motors' heads and turns together.
        let all = block.lens().try_fold(0, |all: usize, (head, turn)| all.checked_add(head)?.checked_add(turn))?;
        (all <= pieces.len()).then_some(block)
    }

    /// Bytes of each motor's head and turn.
    fn lens(&self) -> impl Iterator<Item = (usize, usize)> + 'a {
        self.motors.as_chunks::<MOTOR_LEN>().0.iter().map(|bytes| {
            let [h0, h1, h2, h3, t0, t1, t2, t3, ..] = *bytes;
            let len = |bytes| usize::try_from(u32::from_le_bytes(bytes)).unwrap_or(usize::MAX);
            (len([h0, h1, h2, h3]), len([t0, t1, t2, t3]))
        })
    }

    /// The motors, in order.
    pub fn motors(&self) -> impl Iterator<Item = BakedMotor<'a>> {
        let mut rest = self.pieces;
        let of = self.motors.as_chunks::<MOTOR_LEN>().0.iter().zip(self.lens()).zip(self.configuration.motors());
        of.map(move |((bytes, (head, turn)), setup)| {
            let mut part = |len| {
                let (part, after) = rest.split_at_checked(len).unwrap_or_default();
                rest = after;
                part
            };
            let (head, turn) = (part(head), part(turn));
            let packing = Packing { fraction_bits: FRACTION_BITS, gain: setup.gain };
            BakedMotor { packing, head, turn, repeats: Repeats::from_bytes(bytes) }
        })
    }
}

/// One motor's motion.
///
/// | byte | |
/// |---|---|
/// | 0–3, 4–7 | length of its head, and of its turn, bytes |
/// | 8 | bit 0: it repeats; bit 1: a turn's last step is backward; bit 2: a turn's first step is backward; others 0 |
/// | 9–16, 17–20 | the wait from a turn's last step to the next turn's first: ticks, and 2^-32 ticks |
/// | 21–24 | the part of this wait below that, 2^-64 ticks |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BakedMotor<'a> {
    /// The parameters of its packed bytes.
    pub packing: Packing,
    /// The pieces that are made once, with the first turn's first step. They follow an anchor.
    pub head: &'a [u8],
    /// The pieces of a turn, without its first step. They begin with the state after a reset.
    pub turn: &'a [u8],
    /// How it repeats; `None` if the motion ends.
    pub repeats: Option<Repeats>,
}

/// What lies between a turn's last step and the next one's first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Repeats {
    /// The wait, whole ticks, less than 2^63.
    pub ticks: u64,
    /// The fraction of the wait, 2^-32 ticks.
    pub part: u32,
    /// The rest of the fraction, 2^-64 ticks. It adds up from turn to turn.
    pub rest: u32,
    /// The direction of a turn's last step.
    pub from: Direction,
    /// The direction of a turn's first step.
    pub to: Direction,
}

impl Repeats {
    /// Bytes 8 to 24 of a motor.
    #[must_use]
    pub fn to_bytes(repeats: Option<Repeats>) -> [u8; MOTOR_LEN - 8] {
        let mut bytes = [0; MOTOR_LEN - 8];
        if let Some(Repeats { ticks, part, rest, from, to }) = repeats {
            let backward = |way| u8::from(way == Direction::Backward);
            bytes[0] = 1 | backward(from) << 1 | backward(to) << 2;
            bytes[1..9].copy_from_slice(&ticks.to_le_bytes());
            bytes[9..13].copy_from_slice(&part.to_le_bytes());
            bytes[13..].copy_from_slice(&rest.to_le_bytes());
        }
        bytes
    }

    fn from_bytes(motor: &[u8; MOTOR_LEN]) -> Option<Repeats> {
        let [_, _, _, _, _, _, _, _, flags, a, b, c, d, e, f, g, h, p0, p1, p2, p3, r0, r1, r2, r3] = *motor;
        let way = |bit: u8| if flags & bit != 0 { Direction::Backward } else { Direction::Forward };
        (flags & 1 != 0).then_some(Repeats {
            ticks: u64::from_le_bytes([a, b, c, d, e, f, g, h]),
            part: u32::from_le_bytes([p0, p1, p2, p3]),
            rest: u32::from_le_bytes([r0, r1, r2, r3]),
            from: way(2),
            to: way(4),
        })
    }
}

/// Returns a motor's packed bytes, piece by piece, without end if the motion repeats.
#[derive(Clone, Debug)]
pub struct Player<'a> {
    motor: BakedMotor<'a>,
    /// The tick of the anchor, which comes first.
    zero: Option<Tick32>,
    /// Then the rest of the wait before a turn: ticks, and 2^-32 ticks.
    wait: Option<(u64, u32)>,
    /// Then these pieces.
    rest: &'a [u8],
    /// These pieces are the head's.
    in_head: bool,
    /// The sum of the waits' parts below 2^-32 ticks, 2^-64 ticks.
    carry: u32,
}

impl<'a> Player<'a> {
    /// A player at the motion's beginning. The motion's time 0 is tick `zero`.
    #[must_use]
    pub const fn new(motor: BakedMotor<'a>, zero: Tick32) -> Player<'a> {
        Player { motor, zero: Some(zero), wait: None, rest: motor.head, in_head: true, carry: 0 }
    }

    /// Whether nothing is left.
    #[must_use]
    pub const fn is_over(&self) -> bool {
        self.zero.is_none() && self.wait.is_none() && self.rest.is_empty() && self.motor.repeats.is_none()
    }

    /// Puts the next packed bytes into the front of `out`, no item cut in two, if `room`, the free bytes of the queue, holds the longest
    /// piece. Returns how many; 0 if it does not, or if nothing is left.
    pub fn next(&mut self, room: usize, out: &mut [u8; LONGEST_PIECE]) -> usize {
        if room < LONGEST_PIECE {
            return 0;
        }
        // Packing cannot fail: `out` holds the longest item.
        let packing = self.motor.packing;
        if let Some(tick) = self.zero.take() {
            return packing.pack(&mut State::default(), &Item::Anchor { tick }, out).unwrap_or(0);
        }
        if self.rest.is_empty() && self.wait.is_none() {
            self.turn();
        }
        if let Some((ticks, part)) = self.wait.take() {
            return self.step_after(ticks, part, out).unwrap_or(0);
        }
        let Some((len, rest)) = self.rest.split_first() else { return 0 };
        // A piece of a valid block is never longer than LONGEST_PIECE. Of another one, no bytes are returned.
        let (piece, rest) = rest.split_at_checked(usize::from(*len)).unwrap_or_default();
        self.rest = rest;
        match out.get_mut(..piece.len()) {
            Some(place) => {
                place.copy_from_slice(piece);
                piece.len()
            }
            None => 0,
        }
    }

    /// Begins the next turn. The head has the first turn's wait and first step.
    fn turn(&mut self) {
        let Some(Repeats { ticks, part, rest, .. }) = self.motor.repeats else { return };
        self.rest = self.motor.turn;
        if !core::mem::replace(&mut self.in_head, false) || self.rest.is_empty() {
            let (carry, over) = self.carry.overflowing_add(rest);
            let (part, more) = part.overflowing_add(u32::from(over));
            self.carry = carry;
            self.wait = Some((ticks + u64::from(more), part));
        }
    }

    /// Packs the first step of a turn, after its wait. Of a wait that is too long for one item, it packs a part.
    fn step_after(&mut self, ticks: u64, part: u32, out: &mut [u8]) -> Option<usize> {
        let Repeats { from, to, .. } = self.motor.repeats?;
        let packing = self.motor.packing;
        let mut state = State::new(from);
        if ticks >= u64::from(LONGEST_DWELL) {
            self.wait = Some((ticks - u64::from(LONGEST_DWELL), part));
            return packing.pack(&mut state, &Item::Dwell { ticks: LONGEST_DWELL }, out).ok();
        }
        let interval = (ticks << 32 | u64::from(part)).cast_signed();
        let step = Item::Run { segment: Segment { count: 1, interval, add: 0, add2: 0 }, direction: to };
        let reset = packing.pack_reset(&mut state, out).ok()?;
        let step = packing.pack(&mut state, &step, out.get_mut(reset..)?).ok()?;
        Some(reset + step)
    }
}
