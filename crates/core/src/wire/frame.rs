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
//! The CRC (polynomial 0x1021, first 0xffff, nothing reflected) covers the *encoded* bytes, beginning with the length, and then the
//! tag. So a change on the line is found before the body is decoded. The CRC finds every change of 1 to 3 bits that leaves the
//! zeros where they are. A change that makes or removes a zero cuts a frame or joins two; then the length differs in two bits at
//! least, and its parity or the count shows it. The leading ones of the three bytes keep zeros out of them.

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
    /// The tag of Hello and its answer, and of all that a board sends while no host has taken it.
    pub const NONE: Tag = Tag(0);

    /// The next session's tag: 1 to 31, then 1 again.
    #[must_use]
    pub const fn next(self) -> Tag {
        Tag(if self.0 >= 31 { 1 } else { self.0 + 1 })
    }
}

/// The CRC-16 of the bytes so far, in two registers of an 8-bit chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Sum {
    high: u8,
    low: u8,
}

impl Sum {
    const START: Sum = Sum { high: 0xff, low: 0xff };

    /// Adds one byte. It uses shifts, some 20 cycles on an AVR, because a table would take RAM.
    #[inline(always)]
    const fn with(self, byte: u8) -> Sum {
        let mut x = self.high ^ byte;
        x ^= x >> 4;
        // x·2^12 + x·2^5 + x.
        let x16 = x << 4;
        Sum { high: self.low ^ x16 ^ (x >> 3), low: (x16 << 1) ^ x }
    }

    /// [`with`](Sum::with) as a call, where its size matters more than its speed.
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
    /// Bytes of the body so far; 255 once they do not fit in `out`.
    len: u8,
}

/// Where the body begins in a frame: after the length and the first COBS code.
const BODY_AT: usize = 2;

impl<'a> Encoder<'a> {
    /// Begins a frame at the front of `out`, which has 256 bytes at most: no frame is longer, and `len` is a byte.
    #[must_use]
    pub fn new(out: &'a mut [u8]) -> Encoder<'a> {
        debug_assert!(out.len() <= 256, "room for a frame, not for {} bytes", out.len());
        Encoder { out, len: 0 }
    }

    /// One byte of the body.
    // It is not inlined: a board's program calls it from many places, and is short of flash.
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

    /// Ends the frame and returns its length; `None` if the body is empty or longer than [`MAX_BODY`], or `out` too short.
    pub fn finish(self, tag: Tag) -> Option<usize> {
        let len = usize::from(self.len);
        if len == 0 || len > MAX_BODY {
            return None;
        }
        let (body, end) = self.out.split_at_mut_checked(BODY_AT + len)?;
        let end = end.first_chunk_mut::<4>()?;
        let (first, coded) = body.split_first_mut()?;
        *first = length_byte(self.len);
        // COBS, from the end to the front: each zero is replaced by its distance to the next zero, the last by its distance to the end.
        // The byte before the body counts as a zero, too.
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
    /// Something that is no frame. A lone zero does not count as damage.
    Damaged,
}

/// Takes frames from a line and decodes them as they come. `N` is the length of the longest body that it takes, bytes.
#[derive(Clone, Debug)]
pub struct Decoder<const N: usize = MAX_BODY> {
    body: [u8; N],
    /// Bytes of the body so far.
    len: u8,
    /// The last three bytes, which are held back: they are the trailer if a zero follows.
    late: [u8; 3],
    at: u8,
    /// The frame's first byte, which has its length.
    length_byte: u8,
    /// Bytes up to the next code of COBS.
    run: u8,
    sum: Sum,
}

/// What the next byte out of `late` is. It goes by the number of bytes received: nothing for three bytes, then the length, the first
/// code, the body. If there are more than a frame has, all is noise up to the next zero.
mod at {
    pub(super) const START: u8 = 0;
    pub(super) const LENGTH: u8 = 3;
    pub(super) const FIRST: u8 = 4;
    pub(super) const BODY: u8 = 5;
    pub(super) const TOO_LONG: u8 = 6;
}

impl<const N: usize> Decoder<N> {
    /// A decoder that waits for a frame.
    #[must_use]
    pub const fn new() -> Decoder<N> {
        const { assert!(N <= MAX_BODY) };
        Decoder { body: [0; N], len: 0, late: [0; 3], at: at::START, length_byte: 0, run: 0, sum: Sum::START }
    }

    /// Takes one byte.
    pub fn push(&mut self, byte: u8) -> Received {
        if byte == 0 {
            return self.end();
        }
        if self.at == at::BODY {
            self.take_body(&[byte]);
            return Received::More;
        }
        let [ready, second, third] = self.late;
        self.late = [second, third, byte];
        match self.at {
            at::LENGTH => (self.length_byte, self.sum, self.len) = (ready, Sum::START.with_one(ready), 0),
            at::FIRST => (self.run, self.sum) = (ready - 1, self.sum.with_one(ready)),
            at::TOO_LONG => return Received::More,
            _ => {}
        }
        self.at += 1;
        Received::More
    }

    /// Takes bytes up to the end of a frame, or of something that is none. Returns how many it took, and what they completed.
    pub fn feed(&mut self, bytes: &[u8]) -> (usize, Received) {
        let mut rest = bytes;
        loop {
            if self.at == at::BODY {
                rest = self.take_body(rest);
            }
            let Some((byte, after)) = rest.split_first() else { return (bytes.len(), Received::More) };
            rest = after;
            let received = self.push(*byte);
            if received != Received::More {
                return (bytes.len() - rest.len(), received);
            }
        }
    }

    /// Takes bytes of a body, up to a zero or to the body's greatest length. Returns the bytes that are left.
    ///
    /// Nearly all bytes come through here, so its state is in local variables, which become registers: some 45 cycles a byte on an AVR.
    fn take_body<'a>(&mut self, bytes: &'a [u8]) -> &'a [u8] {
        let [mut first, mut second, mut third] = self.late;
        let (mut sum, mut run) = (self.sum, self.run);
        let places = self.body.get_mut(usize::from(self.len)..).unwrap_or_default();
        let mut taken = 0u8;
        for (&byte, place) in bytes.iter().zip(places) {
            if byte == 0 {
                break;
            }
            sum = sum.with(first);
            // A code of COBS stands in the place of a zero.
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

    /// Forgets the bytes since the last zero: call it after a change of rate.
    pub fn reset(&mut self) {
        (self.at, self.len) = (at::START, 0);
    }

    fn end(&mut self) -> Received {
        let at = core::mem::replace(&mut self.at, at::START);
        if at == at::START {
            return Received::More;
        }
        let tag = Tag(self.late[2] >> 2 & 31);
        let whole = at == at::BODY && self.run == 0 && self.length_byte == length_byte(self.len);
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
