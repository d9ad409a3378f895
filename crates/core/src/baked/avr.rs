//! A motion in the flash of the Uno, whose processor has 8 bits. The host works out all that it can beforehand. The player has one
//! addition to do each time that the motion repeats. Larger boards have the format of [`baked`](super).
//!
//! # The block
//! It lies right behind the firmware's image, at an even address. All integers are little-endian.
//!
//! | byte | |
//! |---|---|
//! | 0–3 | `PTU1` |
//! | 4–5 | length of the block, bytes, these six included |
//! | 6–9 | CRC-32 of bytes 10 to the last ([`crc32`](super::crc32)) |
//! | 10 | bit 0: no motor uses pin 13, so that the board's LED may shine; others 0 |
//! | 11 | n, bytes of the configuration |
//! | 12… | n bytes: the payload of Configure ([`Configuration`](crate::wire::message::Configuration)) |
//! | then | 12 bytes for each motor |
//! | then | for each motor its head (made once), its turn (repeated) and two gaps: pieces |
//!
//! The 12 bytes of a motor:
//!
//! | byte | |
//! |---|---|
//! | 0–1, 2–3 | length of its head, and of its turn, bytes |
//! | 4–5, 6–7 | length of the gap, and of the gap that lasts 2^-16 ticks longer, bytes; 0 if the motion does not repeat |
//! | 8–11 | the part of the gap below 2^-16 ticks, in 2^-48 ticks |
//!
//! A piece is a byte and as many packed bytes as its lower 7 bits say; no item is cut in two. Bit 7 marks a long wait, see [`LONG_WAIT`]. A
//! head begins with the anchor, at [`ZERO`]. Turn and gap begin with a reset. A gap is the wait from a turn's last step to the next turn's
//! first step, and that step.
//!
//! # Phase
//! As on larger boards, the part of a gap below a fraction bit adds up from turn to turn. When the sum overflows, the longer gap is
//! played. A period is stored to 2^-48 ticks, so that n turns are off by n · 2^-48 ticks at most: 2^-15 ticks after a year of turns of
//! 3 ms.

/// Fraction bits of the Uno's recurrence, F.
pub const FRACTION_BITS: u32 = 16;

/// The first four bytes of a block, as one number.
pub const MAGIC: u32 = u32::from_le_bytes(*b"PTU1");

/// Bytes before those that the CRC covers.
pub const HEAD_LEN: u16 = 10;

/// Bytes that a block has for each motor, before the pieces.
pub const MOTOR_LEN: u16 = 12;

/// The most packed bytes in a piece. Each of four motors has a queue of 99 bytes, so that two pieces fit in it.
pub const LONGEST_PIECE: usize = 40;
const _: () = assert!(crate::packing::MAX_PACKED_LEN <= LONGEST_PIECE && LONGEST_PIECE < LONG as usize);

/// The tick of the board's clock at which a motion begins: after 0.1 s, when drivers are ready.
pub const ZERO: u32 = 1_600_000;

/// A wait of this many ticks or more is a piece of its own. It is handed over when the queue is empty, and the piece after it shortly before
/// its end (see [`NEAR`]). So all ticks in the queue are within 2^31 of the clock, since the board's ticks have 32 bits.
pub const LONG_WAIT: u32 = 1 << 20;

/// The longest wait in one piece, ticks. A longer one is several pieces.
pub const LONGEST_WAIT: u32 = 1 << 29;

/// How long before the end of a long wait the next piece is handed over, ticks.
pub const NEAR: u32 = 1 << 26;
const _: () = assert!((LONGEST_WAIT as u64) + (NEAR as u64) < 1 << 30);

/// The bit that marks a piece with a long wait.
pub const LONG: u8 = 0x80;

/// The state of a motor's queue when the player is asked for a piece.
#[derive(Clone, Copy, Debug)]
pub struct QueueState {
    /// Free bytes of the queue.
    pub room: u16,
    /// The queue is empty, and its last item ends within [`NEAR`].
    pub near: bool,
}

/// Returns a motor's packed bytes, piece by piece, without end if the motion repeats. Addresses are those of the flash.
#[derive(Clone, Copy, Debug, Default)]
pub struct AvrPlayer {
    /// Addresses: of the turn, of the first gap, of the second (longer) gap, and of its end. The head ends where the turn begins.
    turn: u16,
    gap: u16,
    longer: u16,
    end: u16,
    /// The part of a gap below 2^-16 ticks, in 2^-48 ticks, and the sum of these so far.
    rest: u32,
    carry: u32,
    /// Addresses of the next piece, and of the end of its part.
    next: u16,
    upto: u16,
    /// The last piece was a long wait.
    waits: bool,
}

impl AvrPlayer {
    /// A player at the motion's beginning. `entry` is the address of the motor's 12 bytes, `head` that of its head. `flash` reads the byte at
    /// an address.
    #[must_use]
    pub fn new(entry: u16, head: u16, flash: impl Fn(u16) -> u8 + Copy) -> AvrPlayer {
        let turn = head.wrapping_add(word(entry, flash));
        let gap = turn.wrapping_add(word(entry.wrapping_add(2), flash));
        let longer = gap.wrapping_add(word(entry.wrapping_add(4), flash));
        let end = longer.wrapping_add(word(entry.wrapping_add(6), flash));
        let rest = long(entry.wrapping_add(8), flash);
        AvrPlayer { turn, gap, longer, end, rest, carry: 0, next: head, upto: turn, waits: false }
    }

    /// The address where its last piece ends and the next motor's head begins.
    #[must_use]
    pub const fn end(&self) -> u16 {
        self.end
    }

    /// Whether nothing is left.
    #[must_use]
    pub const fn is_over(&self) -> bool {
        self.next == self.upto && self.gap == self.end
    }

    /// Puts the next packed bytes into the front of `out`, if the queue can take them now. Returns how many; 0 if it cannot, or if nothing is
    /// left.
    pub fn next(&mut self, queue: QueueState, flash: impl Fn(u16) -> u8, out: &mut [u8; LONGEST_PIECE]) -> usize {
        if usize::from(queue.room) < LONGEST_PIECE || self.is_over() || (self.waits && !queue.near) {
            return 0;
        }
        self.waits = false;
        if self.next == self.upto {
            (self.next, self.upto, self.carry) = self.part();
        }
        let head = flash(self.next);
        if head & LONG != 0 {
            // A long wait is handed over only when the queue is empty: the caller asks again.
            self.waits = true;
            if !queue.near {
                return 0;
            }
        }
        let len = usize::from(head & !LONG);
        let mut at = self.next;
        for place in out.iter_mut().take(len) {
            at = at.wrapping_add(1);
            *place = flash(at);
        }
        self.next = at.wrapping_add(1);
        len.min(LONGEST_PIECE)
    }

    /// The part after the one that is over: where it begins and ends, and the new sum of what lies below a gap.
    const fn part(&self) -> (u16, u16, u32) {
        // After the head, or after a gap, comes the turn, unless it is empty: the gap's step may be its only one.
        if self.upto != self.gap && self.turn != self.gap {
            return (self.turn, self.gap, self.carry);
        }
        let (carry, over) = self.carry.overflowing_add(self.rest);
        if over { (self.longer, self.end, carry) } else { (self.gap, self.longer, carry) }
    }
}

/// The two bytes at an address.
#[inline(never)]
fn word(at: u16, flash: impl Fn(u16) -> u8) -> u16 {
    u16::from_le_bytes([flash(at), flash(at.wrapping_add(1))])
}

/// The four bytes at an address.
#[inline(never)]
fn long(at: u16, flash: impl Fn(u16) -> u8) -> u32 {
    let byte = |offset| flash(at.wrapping_add(offset));
    u32::from_le_bytes([byte(0), byte(1), byte(2), byte(3)])
}

/// [`crc32`](super::crc32) of the bytes from an address on, bit by bit: without a table, which would lie in RAM.
fn crc32(from: u16, to: u16, flash: impl Fn(u16) -> u8) -> u32 {
    let (mut sum, mut at) = (u32::MAX, from);
    while at != to {
        sum ^= u32::from(flash(at));
        let mut bits = 8_u8;
        while bits != 0 {
            sum = if sum & 1 == 1 { sum >> 1 ^ 0xedb8_8320 } else { sum >> 1 };
            bits -= 1;
        }
        at = at.wrapping_add(1);
    }
    !sum
}

/// Checks the block at an address, which must end at `limit` or before. Returns the addresses of its byte 10 and of its end; `None` if there
/// is no block, or its CRC is wrong.
#[must_use]
pub fn block(at: u16, limit: u16, flash: impl Fn(u16) -> u8 + Copy) -> Option<(u16, u16)> {
    let len = word(at.wrapping_add(4), flash);
    if long(at, flash) != MAGIC || len <= HEAD_LEN || len > limit.wrapping_sub(at) {
        return None;
    }
    let (from, end) = (at.wrapping_add(HEAD_LEN), at.wrapping_add(len));
    (crc32(from, end, flash) == long(at.wrapping_add(6), flash)).then_some((from, end))
}
