//! Bodies ↔ bytes on the line. What is in a body is [`message`](super::message)'s.
//!
//! | bytes | |
//! |---|---|
//! | 1 | the length n of the body, 1 ≤ n ≤ [`MAX_BODY`], times 2, plus its parity: an even number of ones |
//! | n + 1 | the body, COBS-encoded: no zero in it |
//! | 1 | 1, then bits 15–9 of the CRC |
//! | 1 | 1, then bits 8–2 of the CRC |
//! | 1 | 1, then five bits [`Tag`], then bits 1–0 of the CRC |
//! | 1 | 0 |
//!
//! The CRC (polynomial 0x1021, first 0xffff, nothing reflected) goes over the *encoded* bytes, the length first, and then over
//! the tag: so it finds what was changed before anything is made of it, and every change of 1 to 3 bits that leaves the
//! zeros where they are. A change that makes or breaks a zero cuts a frame or joins two: the length is then
//! wrong by two bits at least. The leading ones of the three bytes keep zeros out of them.

/// The longest body.
pub const MAX_BODY: usize = 80;

/// The longest frame, with its zero.
pub const MAX_FRAME: usize = framed_len(MAX_BODY);

// The length has seven bits; COBS needs no second code byte.
const _: () = assert!(MAX_BODY < 128);

/// Bytes on the line of a body of `len` bytes.
#[must_use]
pub const fn framed_len(len: usize) -> usize {
    1 + len + 1 + 3 + 1
}

/// Which session a frame belongs to, 0 to 31; 0 before there is one.
///
/// A frame of another session is dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Tag(pub u8);

impl Tag {
    /// Of Hello and its answer, and of what a board says while nobody has taken it.
    pub const NONE: Tag = Tag(0);

    /// The one for the next session: 1 to 31, then 1 again.
    #[must_use]
    pub const fn next(self) -> Tag {
        Tag(if self.0 >= 31 { 1 } else { self.0 + 1 })
    }
}

/// A CRC-16 so far, in two registers of an 8-bit chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Sum {
    high: u8,
    low: u8,
}

impl Sum {
    const START: Sum = Sum { high: 0xff, low: 0xff };

    /// One more byte, by shifts: some 20 cycles on an AVR, and no table in RAM.
    #[inline(always)]
    const fn with(self, byte: u8) -> Sum {
        let mut x = self.high ^ byte;
        x ^= x >> 4;
        // x·2^12 + x·2^5 + x.
        let x16 = x << 4;
        Sum { high: self.low ^ x16 ^ (x >> 3), low: (x16 << 1) ^ x }
    }

    /// The same where speed does not matter, but room does.
    #[inline(never)]
    const fn with_one(self, byte: u8) -> Sum {
        self.with(byte)
    }
}

/// CRC-16 over one more byte: polynomial 0x1021, nothing reflected.
///
/// ```
/// use pulsetrain_core::wire::frame::crc;
/// assert_eq!(b"123456789".iter().fold(0xffff, |sum, byte| crc(sum, *byte)), 0x29b1);
/// ```
#[must_use]
pub const fn crc(sum: u16, byte: u8) -> u16 {
    let [high, low] = sum.to_be_bytes();
    let Sum { high, low } = Sum { high, low }.with(byte);
    u16::from_be_bytes([high, low])
}

/// The CRC-16 of all of `bytes`, its high byte first.
#[inline(never)]
#[must_use]
pub fn check(bytes: &[u8]) -> [u8; 2] {
    let one = if cfg!(feature = "quick") { Sum::with } else { Sum::with_one };
    let Sum { high, low } = bytes.iter().fold(Sum::START, |sum, byte| one(sum, *byte));
    [high, low]
}

/// The byte before a body of `len` bytes: an even number of ones.
const fn length_byte(len: u8) -> u8 {
    let mut odd = len ^ (len >> 4);
    odd ^= odd >> 2;
    odd ^= odd >> 1;
    len << 1 | odd & 1
}

/// The three bytes after a body, `sum` being that of its encoded bytes.
const fn trailer(sum: Sum, tag: Tag) -> [u8; 3] {
    let Sum { high, low } = sum.with_one(tag.0 & 31);
    [0x80 | (high >> 1), 0x80 | (high << 6) & 0x40 | (low >> 2), 0x80 | (tag.0 & 31) << 2 | low & 3]
}

/// Writes one frame into a buffer, byte by byte.
#[derive(Debug)]
pub struct Encoder<'a> {
    out: &'a mut [u8],
    /// Bytes of the body; 255 once they are too many for `out`.
    len: u8,
}

/// Where the body begins: the length and the code of the first run come before it.
const BODY_AT: usize = 2;

impl<'a> Encoder<'a> {
    /// A frame into the front of `out`, which has no more than 256 bytes: no frame is as long.
    #[must_use]
    pub fn new(out: &'a mut [u8]) -> Encoder<'a> {
        debug_assert!(out.len() <= 256, "room for a frame, not for {} bytes", out.len());
        Encoder { out, len: 0 }
    }

    /// One byte of the body.
    // Small on a board, where it is called from everywhere.
    #[inline(never)]
    pub fn u8(&mut self, byte: u8) {
        let Some(place) = self.out.get_mut(BODY_AT + usize::from(self.len)) else {
            self.len = u8::MAX;
            return;
        };
        *place = byte;
        self.len = self.len.wrapping_add(1);
    }

    /// Bytes of the body.
    #[inline(never)]
    pub fn bytes(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.u8(*byte);
        }
    }

    /// Two bytes of the body.
    #[inline(never)]
    pub fn u16(&mut self, value: u16) {
        if cfg!(feature = "quick") {
            let at = BODY_AT + usize::from(self.len);
            if let Some(places) = self.out.get_mut(at..at + 2) {
                places.copy_from_slice(&value.to_le_bytes());
                self.len += 2;
                return;
            }
        }
        let [low, high] = value.to_le_bytes();
        self.u8(low);
        self.u8(high);
    }

    /// Four bytes of the body.
    #[inline(never)]
    pub fn u32(&mut self, value: u32) {
        let [a, b, c, d] = value.to_le_bytes();
        self.u16(u16::from_le_bytes([a, b]));
        self.u16(u16::from_le_bytes([c, d]));
    }

    /// Eight bytes of the body.
    #[inline(always)]
    pub fn u64(&mut self, value: u64) {
        self.bytes(&value.to_le_bytes());
    }

    /// Ends the frame and gives its length; `None` when the body is empty or longer than [`MAX_BODY`], or `out` too short.
    pub fn finish(self, tag: Tag) -> Option<usize> {
        let len = usize::from(self.len);
        if len == 0 || len > MAX_BODY {
            return None;
        }
        let (body, end) = self.out.split_at_mut_checked(BODY_AT + len)?;
        let end = end.first_chunk_mut::<4>()?;
        let (first, coded) = body.split_first_mut()?;
        *first = length_byte(self.len);
        // A zero is thought before the body. Each becomes the way to the next, the last the way to the end.
        *coded.first_mut()? = 0;
        let mut run = 1;
        for place in coded.iter_mut().rev() {
            if *place == 0 {
                *place = run;
                run = 0;
            }
            run += 1;
        }
        let [high, low] = check(body);
        let [a, b, c] = trailer(Sum { high, low }, tag);
        *end = [a, b, c, 0];
        Some(framed_len(len))
    }
}

/// What a byte from the line completed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// Nothing yet.
    More,
    /// A frame whose CRC is right: [`Decoder::body`] has it until the next byte comes.
    Frame(Tag),
    /// Something that is no frame. A lone zero is nothing, not damage: it ends whatever noise there was before.
    Damaged,
}

/// Takes frames from a line, decoding each in place: `N` bytes, the longest body that it takes, and a few more.
#[derive(Clone, Debug)]
pub struct Decoder<const N: usize = MAX_BODY> {
    body: [u8; N],
    /// Bytes of the body so far.
    len: u8,
    /// The last three bytes: the trailer, if a zero follows.
    late: [u8; 3],
    at: u8,
    /// The length byte.
    said: u8,
    /// Bytes that the run being read still has.
    run: u8,
    sum: Sum,
}

/// What comes out of `late` next, by how many bytes came: nothing for three bytes, the length, the code of the first run, the
/// body; or more than a frame has, and all is noise up to the next zero.
mod at {
    pub(super) const START: u8 = 0;
    pub(super) const LENGTH: u8 = 3;
    pub(super) const FIRST: u8 = 4;
    pub(super) const BODY: u8 = 5;
    pub(super) const TOO_LONG: u8 = 6;
}

impl<const N: usize> Decoder<N> {
    /// Between two frames.
    #[must_use]
    pub const fn new() -> Decoder<N> {
        const { assert!(N <= MAX_BODY) };
        Decoder { body: [0; N], len: 0, late: [0; 3], at: at::START, said: 0, run: 0, sum: Sum::START }
    }

    /// Takes one byte.
    pub fn push(&mut self, byte: u8) -> Received {
        if byte == 0 {
            return self.end();
        }
        if self.at == at::BODY {
            self.go_on(&[byte]);
            return Received::More;
        }
        let [ready, second, third] = self.late;
        self.late = [second, third, byte];
        match self.at {
            at::LENGTH => (self.said, self.sum, self.len) = (ready, Sum::START.with_one(ready), 0),
            at::FIRST => (self.run, self.sum) = (ready - 1, self.sum.with_one(ready)),
            at::TOO_LONG => return Received::More,
            _ => {}
        }
        self.at += 1;
        Received::More
    }

    /// Takes bytes up to the end of a frame, or of something that is none; gives how many, and what they completed.
    pub fn feed(&mut self, bytes: &[u8]) -> (usize, Received) {
        let mut rest = bytes;
        loop {
            if self.at == at::BODY {
                rest = self.go_on(rest);
            }
            let Some((byte, after)) = rest.split_first() else { return (bytes.len(), Received::More) };
            rest = after;
            let received = self.push(*byte);
            if received != Received::More {
                return (bytes.len() - rest.len(), received);
            }
        }
    }

    /// Takes bytes of a body up to a zero, or as many as it may have; gives the others.
    ///
    /// Nearly all bytes come through here, so that all is in registers: some 45 cycles a byte on an AVR.
    fn go_on<'a>(&mut self, bytes: &'a [u8]) -> &'a [u8] {
        let [mut first, mut second, mut third] = self.late;
        let (mut sum, mut run) = (self.sum, self.run);
        let places = self.body.get_mut(usize::from(self.len)..).unwrap_or_default();
        let mut taken = 0u8;
        for (&byte, place) in bytes.iter().zip(places) {
            if byte == 0 {
                break;
            }
            sum = sum.with(first);
            // The code of a run stands for the zero before it.
            *place = if run == 0 { 0 } else { first };
            run = if run == 0 { first } else { run } - 1;
            (first, second, third) = (second, third, byte);
            taken += 1;
        }
        self.late = [first, second, third];
        (self.sum, self.run, self.len) = (sum, run, self.len + taken);
        let rest = bytes.get(usize::from(taken)..).unwrap_or_default();
        if rest.first().is_some_and(|byte| *byte != 0) {
            self.at = at::TOO_LONG;
        }
        rest
    }

    /// The body of the frame that was completed last.
    #[must_use]
    pub fn body(&self) -> &[u8] {
        self.body.get(..usize::from(self.len)).unwrap_or_default()
    }

    /// Forgets what came since the last zero, as after a change of rate.
    pub fn reset(&mut self) {
        (self.at, self.len) = (at::START, 0);
    }

    fn end(&mut self) -> Received {
        let at = core::mem::replace(&mut self.at, at::START);
        if at == at::START {
            return Received::More;
        }
        let tag = Tag(self.late[2] >> 2 & 31);
        let whole = at == at::BODY && self.run == 0 && self.said == length_byte(self.len);
        if whole && self.late == trailer(self.sum, tag) {
            Received::Frame(tag)
        } else {
            self.len = 0;
            Received::Damaged
        }
    }
}

impl<const N: usize> Default for Decoder<N> {
    fn default() -> Decoder<N> {
        Decoder::new()
    }
}
