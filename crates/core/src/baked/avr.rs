//! A motion in the flash of a board with an 8-bit processor, the Uno. The host works out all that can be worked out beforehand; the
//! player adds one number a turn. It is no format of larger boards: theirs is [`baked`](super).
//!
//! # The block
//! It lies right behind the firmware's image, at an even address. All integers are little-endian.
//!
//! | byte | |
//! |---|---|
//! | 0–3 | `PTU1` |
//! | 4–5 | bytes of the block, these six and all that follow |
//! | 6–9 | CRC-32 of bytes 10 to the last ([`crc32`](super::crc32)) |
//! | 10 | bit 0: pin 13 is nobody's, the board's lamp may shine; others 0 |
//! | 11 | n, bytes of the configuration |
//! | 12… | n bytes: what Configure says ([`Configuration`](crate::wire::message::Configuration)) |
//! | then | 12 bytes for each motor |
//! | then | for each motor its head, its turn and two gaps: pieces |
//!
//! Of a motor:
//!
//! | byte | |
//! |---|---|
//! | 0–1, 2–3 | bytes of its head, and of its turn |
//! | 4–5, 6–7 | bytes of the gap, and of the one that is 2^-16 ticks longer; 0 of a motion that ends |
//! | 8–11 | what of the gap lies below that: ticks · 2^-48 |
//!
//! A piece is a byte and as many packed bytes as its lower 7 bits say, whole items. Bit 7: it waits for long, see [`LONG_WAIT`]. A head
//! begins with the anchor, at [`ZERO`]. Turn and gap begin with a reset; a gap leads from a turn's last step to the next one's first.
//!
//! # Phase
//! As on larger boards, what lies below a fraction bit is carried from turn to turn: that a gap is one of two is all that comes of it.
//! A period is stored to 2^-48 ticks, so that n turns are off by n · 2^-48 ticks at most: in a year of turns of 3 ms that is 2^-15.

/// F of the boards that have such blocks.
pub const FRACTION_BITS: u32 = 16;

/// What a block begins with, in one number.
pub const MAGIC: u32 = u32::from_le_bytes(*b"PTU1");

/// Bytes before those that the CRC is of.
pub const HEAD_LEN: u16 = 10;

/// Bytes of what a block says of a motor.
pub const MOTOR_LEN: u16 = 12;

/// Packed bytes of a piece at most: each of four motors has a queue of 99.
pub const LONGEST_PIECE: usize = 40;
const _: () = assert!(crate::packing::MAX_PACKED_LEN <= LONGEST_PIECE && LONGEST_PIECE < LONG as usize);

/// The tick of the board's clock at which a motion's time is 0: 0.1 s, for drivers to be ready.
pub const ZERO: u32 = 1_600_000;

/// A wait of so many ticks or more is a piece of its own, which is handed over when all before it is done but for steps that lie
/// ready: so that the board, whose ticks have 32 bits, never has to tell two of them apart. What comes after it waits for its end as well,
/// see [`NEAR`].
pub const LONG_WAIT: u32 = 1 << 20;

/// Such a piece says no more than this.
pub const LONGEST_WAIT: u32 = 1 << 29;

/// What comes after a long wait is handed over so many ticks before its end.
pub const NEAR: u32 = 1 << 26;
const _: () = assert!((LONGEST_WAIT as u64) + (NEAR as u64) < 1 << 30);

/// A piece that waits for long.
pub const LONG: u8 = 0x80;

/// Where a motor is when a piece is asked for.
#[derive(Clone, Copy, Debug)]
pub struct QueueState {
    /// Bytes that its queue takes.
    pub room: u16,
    /// There is nothing in the queue, and what was in it last ends within [`NEAR`].
    pub near: bool,
}

/// Gives out a motor's packed bytes, piece by piece, for ever if it repeats. Addresses are the flash's.
#[derive(Clone, Copy, Debug, Default)]
pub struct AvrPlayer {
    /// Where its turn begins, and its head ends; where its first gap begins, and its second; where that ends.
    turn: u16,
    gap: u16,
    longer: u16,
    end: u16,
    /// What lies below a gap, ticks · 2^-48, and what has added up of it.
    rest: u32,
    carry: u32,
    /// What is next, and where the part ends that it belongs to.
    next: u16,
    upto: u16,
    /// What was handed over last waits for long.
    waits: bool,
}

impl AvrPlayer {
    /// From the beginning. `says`: where the block speaks of it; `head`: where its head lies; `flash` gives the byte at an address.
    #[must_use]
    pub fn new(says: u16, head: u16, flash: impl Fn(u16) -> u8 + Copy) -> AvrPlayer {
        let turn = head.wrapping_add(word(says, flash));
        let gap = turn.wrapping_add(word(says.wrapping_add(2), flash));
        let longer = gap.wrapping_add(word(says.wrapping_add(4), flash));
        let end = longer.wrapping_add(word(says.wrapping_add(6), flash));
        let rest = long(says.wrapping_add(8), flash);
        AvrPlayer { turn, gap, longer, end, rest, carry: 0, next: head, upto: turn, waits: false }
    }

    /// Where its last piece ends, and the next motor's head begins.
    #[must_use]
    pub const fn end(&self) -> u16 {
        self.end
    }

    /// Whether nothing is left.
    #[must_use]
    pub const fn is_over(&self) -> bool {
        self.next == self.upto && self.gap == self.end
    }

    /// Puts the next packed bytes into the front of `out`, if the motor is where it takes them; gives their number: 0 if it is not,
    /// or if nothing is left.
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
            // Asked again when it is near, it goes out.
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

    /// What comes after the part that is over: where it begins and ends, and what is carried then.
    const fn part(&self) -> (u16, u16, u32) {
        // After a head or a gap the turn, if it has any step but the gap's.
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

/// The block that lies at an address, below `limit`: where the configuration's length is, and where it ends; `None` if there is none,
/// or if a bit of it is wrong.
#[must_use]
pub fn block(at: u16, limit: u16, flash: impl Fn(u16) -> u8 + Copy) -> Option<(u16, u16)> {
    let len = word(at.wrapping_add(4), flash);
    if long(at, flash) != MAGIC || len <= HEAD_LEN || len > limit.wrapping_sub(at) {
        return None;
    }
    let (from, end) = (at.wrapping_add(HEAD_LEN), at.wrapping_add(len));
    (crc32(from, end, flash) == long(at.wrapping_add(6), flash)).then_some((from, end))
}
