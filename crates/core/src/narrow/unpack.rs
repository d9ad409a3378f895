//! [`packing`](crate::packing) for [`Registers`]: the prediction is what the registers hold after the last step.

use super::bytes::{Bytes, Pool, WINDOW};
use super::registers::{Registers, sign_byte};
use crate::packing::Control;
use crate::{Direction, Epoch};

/// What has been taken off the queue.
pub(super) enum Record {
    /// A segment is in the registers.
    Run,
    /// The accumulator is to be set to this tick + ½.
    Anchor(u32),
    /// So many ticks are to be waited.
    Dwell(u32),
    /// Where the sender thinks that the motor is.
    Check { position: u16, tick: u32, fraction: u16 },
    /// Only the prediction has changed.
    Prediction,
}

/// What the queue has next.
pub(super) enum Found {
    Record(Record),
    /// No whole record.
    Nothing,
    /// No record begins so, or it says what does not fit.
    Bad,
}

/// What is remembered beside the registers: the rest of [`State`](crate::packing::State).
#[derive(Clone, Debug)]
pub(super) struct Unpacker {
    previous_count: u16,
    /// Clamped to where it matters.
    gain: i8,
    /// Of the segments that follow.
    pub(super) direction: Direction,
}

/// As [`packing::COUNT_AFTER_EXACT`](crate::packing::COUNT_AFTER_EXACT).
const COUNT_AFTER_EXACT: u16 = 255;
const _: () = assert!(COUNT_AFTER_EXACT as u32 == crate::packing::COUNT_AFTER_EXACT);

/// Previous count after a reset.
const COUNT_AT_REST: u16 = 4;

impl Unpacker {
    pub(super) const fn new(gain: i8) -> Unpacker {
        // Beyond these, `unit_shift` gives 16 for the longest and 0 for the shortest count.
        let gain = if gain > 18 {
            18
        } else if gain < -43 {
            -43
        } else {
            gain
        };
        Unpacker { previous_count: COUNT_AT_REST, gain, direction: Direction::Forward }
    }

    /// As an epoch begins.
    pub(super) fn restart(&mut self, registers: &mut Registers) {
        self.direction = Direction::Forward;
        self.reset(registers);
    }

    fn reset(&mut self, registers: &mut Registers) {
        self.previous_count = COUNT_AT_REST;
        registers.interval_low = 0;
        registers.interval_high = 0;
        registers.add = 0;
        registers.add2 = 0;
    }

    /// Takes the next record of `epoch`, if it is there whole. No steps may be left in the registers.
    pub(super) fn next<const N: usize>(
        &mut self,
        registers: &mut Registers,
        bytes: &mut Bytes,
        pool: &Pool<N>,
        epoch: Epoch,
    ) -> Found {
        let have = u8::try_from(bytes.waiting(epoch)).unwrap_or(u8::MAX);
        if have == 0 {
            return Found::Nothing;
        }
        let header = bytes.first(pool);
        let mut len = 1;
        let n = self.previous_count;
        let more = match header & 7 {
            0 => n.checked_add(n >> 1),
            1 => n.checked_add(n >> 2),
            2 => n.checked_add(n >> 3),
            3 => Some(n),
            4 => Some(n - (n >> 3)),
            5 => Some(n - (n >> 2)),
            6 => Some(n - (n >> 1)),
            _ => {
                if have < 2 {
                    return Found::Nothing;
                }
                match bytes.byte(pool, 1) {
                    0 => return self.control(header >> 3, have, registers, bytes, pool),
                    0xff => {
                        if have < 4 {
                            return Found::Nothing;
                        }
                        len = 4;
                        Some(u16::from_le_bytes([bytes.byte(pool, 2), bytes.byte(pool, 3)]))
                    }
                    count => {
                        len = 2;
                        Some(u16::from(count))
                    }
                }
            }
        };
        let count = match more {
            None | Some(0) => return Found::Bad,
            Some(count) => count,
        };

        let widths = Widths::of(header, count);
        let said = len;
        len += widths.interval + widths.add + widths.add2;
        if have < len {
            return Found::Nothing;
        }
        match bytes.window(pool, said, len) {
            Some(corrections) => self.correct(registers, corrections, widths.interval, widths.add, widths.add2),
            None => self.correct_in_two(registers, bytes, pool, said, len, widths),
        }
        bytes.consume(len);
        registers.left = count;
        self.previous_count = count;
        Found::Record(Record::Run)
    }

    /// [`correct`](Unpacker::correct), with corrections that may lie at both ends of the queue's share.
    #[cold]
    #[inline(never)]
    fn correct_in_two<const N: usize>(
        &self,
        registers: &mut Registers,
        bytes: &Bytes,
        pool: &Pool<N>,
        from: u8,
        to: u8,
        widths: Widths,
    ) {
        let corrections = in_one_piece(bytes, pool, from, to);
        self.correct(registers, &corrections, widths.interval, widths.add, widths.add2);
    }

    /// Adds the corrections, which have these widths.
    #[inline(never)]
    fn correct(&self, registers: &mut Registers, corrections: &[u8; WINDOW], interval: u8, add: u8, add2: u8) {
        let bits = bits(self.previous_count);
        let mut finer = bits + self.gain;
        let mut at = 0;
        if interval > 0 {
            let exponent = exponent(finer + 2);
            // 16 bits go no further than 16 to the left, and 24 bits no further than 8.
            if interval < 3 || (interval == 3 && exponent <= 8) {
                let value = correction(corrections, 0, interval, exponent);
                registers.lengthen(value.cast_unsigned(), sign_byte(value));
            } else {
                lengthen_by_long(registers, corrections, interval, exponent);
            }
            at = interval;
        }
        if add > 0 {
            let value = correction(corrections, at, add, exponent(finer + bits - 2));
            registers.add = registers.add.wrapping_add(value);
            at += add;
        }
        if add2 > 0 {
            finer += bits + bits;
            let value = correction(corrections, at, add2, exponent(finer - 5));
            registers.add2 = registers.add2.wrapping_add(value);
        }
    }

    /// A control record, of which header and 0 have been read.
    #[cold]
    #[inline(never)]
    fn control<const N: usize>(
        &mut self,
        control: u8,
        have: u8,
        registers: &mut Registers,
        bytes: &mut Bytes,
        pool: &Pool<N>,
    ) -> Found {
        const REVERSE: u8 = Control::Reverse as u8;
        const RESET: u8 = Control::Reset as u8;
        const DWELL: u8 = Control::Dwell as u8;
        const ANCHOR: u8 = Control::Anchor as u8;
        const EXACT: u8 = Control::Exact as u8;
        const CHECK: u8 = Control::Check as u8;
        let mut len = match control {
            REVERSE | RESET => 2,
            DWELL | ANCHOR => 6,
            EXACT => 4,
            CHECK => 10,
            _ => return Found::Bad,
        };
        let mut widths = [0; 4];
        if control == EXACT && have >= 4 {
            let [said, wide] = [2, 3].map(|offset| bytes.byte(pool, offset));
            widths = [wide >> 4, said & 15, said >> 4, wide & 15];
            let [count, registers @ ..] = widths;
            if !(1..=4).contains(&count) || registers.iter().any(|&width| width > 8) {
                return Found::Bad;
            }
            len += widths.iter().sum::<u8>();
        }
        if have < len {
            return Found::Nothing;
        }
        if len == 2 {
            if control == REVERSE {
                self.direction = self.direction.reversed();
            }
            self.reset(registers);
            bytes.consume(len);
            return Found::Record(Record::Prediction);
        }
        let record: [u8; LONGEST] = in_one_piece(bytes, pool, 2, len);
        let mut rest = &record[..];
        let record = match control {
            DWELL => Record::Dwell(u32::from_le_bytes(take(&mut rest))),
            ANCHOR => Record::Anchor(u32::from_le_bytes(take(&mut rest))),
            CHECK => {
                let position = u16::from_le_bytes(take(&mut rest));
                let tick = u32::from_le_bytes(take(&mut rest));
                Record::Check { position, tick, fraction: u16::from_le_bytes(take(&mut rest)) }
            }
            _ => {
                let [_, _] = take(&mut rest);
                let [count_width, interval_width, add_width, add2_width] = widths;
                let [low, high, 0, 0, ..] = part(&mut rest, count_width, 0) else { return Found::Bad };
                let count = u16::from_le_bytes([low, high]);
                if count == 0 || (count < 2 && add_width > 0) || (count < 3 && add2_width > 0) {
                    return Found::Bad;
                }
                let [a, b, c, d, high, 0, 0, 0] = part(&mut rest, interval_width, 0xff) else { return Found::Bad };
                let low = u32::from_le_bytes([a, b, c, d]);
                let (mut add, mut add2) = (registers.add, registers.add2);
                let said = [(&mut add, add_width), (&mut add2, add2_width)];
                for (register, width) in said.into_iter().take(usize::from(count - 1)) {
                    let [a, b, c, d, beyond @ ..] = part(&mut rest, width, 0xff);
                    *register = i32::from_le_bytes([a, b, c, d]);
                    if beyond != [sign_byte(*register); 4] {
                        return Found::Bad;
                    }
                }
                (registers.interval_low, registers.interval_high) = (low, high);
                (registers.add, registers.add2) = (add, add2);
                registers.left = count;
                self.previous_count = count.max(COUNT_AFTER_EXACT);
                Record::Run
            }
        };
        bytes.consume(len);
        Found::Record(record)
    }
}

/// Bits of `count`.
const fn bits(count: u16) -> i8 {
    let [low, high] = count.to_le_bytes();
    let (mut bits, mut rest) = if high == 0 { (0, low) } else { (8, high) };
    if rest >= 16 {
        bits += 4;
        rest >>= 4;
    }
    while rest != 0 {
        bits += 1;
        rest >>= 1;
    }
    bits
}

/// How far a correction is to be shifted to the left: 16 − `shift`, that being held in 0..=16.
const fn exponent(shift: i8) -> u8 {
    if shift <= 0 {
        16
    } else if shift >= 16 {
        0
    } else {
        16 - shift.cast_unsigned()
    }
}

/// Bytes of the corrections: 0, 1, 2, 3 or 5.
#[derive(Clone, Copy)]
struct Widths {
    interval: u8,
    add: u8,
    add2: u8,
}

impl Widths {
    const fn of(header: u8, count: u16) -> Widths {
        let narrow = header >> 3 & 3;
        let wide = if narrow == 3 { 5 } else { narrow + 1 };
        let mut widths = Widths { interval: narrow, add: narrow, add2: narrow };
        if header & 0x20 != 0 {
            widths.interval = wide;
        }
        if header & 0x40 != 0 {
            widths.add = wide;
        }
        if header & 0x80 != 0 {
            widths.add2 = wide;
        }
        if count < 3 {
            widths.add2 = 0;
            if count < 2 {
                widths.add = 0;
            }
        }
        widths
    }
}

/// The longest record, an exact segment, without header and 0.
const LONGEST: usize = 30;

/// The bytes from `from` to `to` of the record in front, which may lie at both ends of the queue's share.
#[cold]
#[inline(never)]
fn in_one_piece<const N: usize, const LEN: usize>(bytes: &Bytes, pool: &Pool<N>, from: u8, to: u8) -> [u8; LEN] {
    let mut record = [0; LEN];
    for (place, offset) in record.iter_mut().zip(from..to) {
        *place = bytes.byte(pool, offset);
    }
    record
}

/// The correction of `width` (1, 2, 3 or 5) bytes at `at`, shifted to the left by `exponent` (0..=16), modulo 2^32.
#[inline(never)]
fn correction(corrections: &[u8; WINDOW], at: u8, width: u8, exponent: u8) -> i32 {
    let byte = |offset: u8| corrections[usize::from(at + offset) % WINDOW];
    let mut value = if width == 1 {
        i32::from(i8::from_le_bytes([byte(0)]))
    } else if width == 2 {
        i32::from(i16::from_le_bytes([byte(0), byte(1)]))
    } else {
        four_bytes(corrections, at, width)
    };
    // First by whole bytes, which costs next to nothing, then bit by bit.
    let mut exponent = exponent;
    if exponent >= 8 {
        value <<= 8;
        exponent -= 8;
        if exponent >= 8 {
            return value << 8;
        }
    }
    value << (exponent & 7)
}

/// The lower four bytes of a correction of `width` (3 or 5) bytes at `at`.
#[cold]
#[inline(never)]
fn four_bytes(corrections: &[u8; WINDOW], at: u8, width: u8) -> i32 {
    let byte = |offset: u8| corrections[usize::from(at + offset) % WINDOW];
    let high = match (width, byte(2)) {
        (3, 0..0x80) => 0,
        (3, _) => 0xff,
        _ => byte(3),
    };
    i32::from_le_bytes([byte(0), byte(1), byte(2), high])
}

/// Adds the interval's correction of `width` (3 or 5) bytes, shifted to the left by `exponent` (0..=16).
#[cold]
#[inline(never)]
fn lengthen_by_long(registers: &mut Registers, corrections: &[u8; WINDOW], width: u8, exponent: u8) {
    let value = four_bytes(corrections, 0, width);
    let (mut low, mut high) = (value.cast_unsigned(), sign_byte(value));
    if width > 3 {
        high = corrections[4];
    }
    let mut bits = exponent;
    while bits >= 8 {
        [_, _, _, high] = low.to_le_bytes();
        low <<= 8;
        bits -= 8;
    }
    while bits > 0 {
        high = high << 1 | u8::from(low >= 1 << 31);
        low <<= 1;
        bits -= 1;
    }
    registers.lengthen(low, high);
}

/// `width` (0 to 8) bytes of an exact segment, extended: by 0, or by their sign where `signed` has its bits set.
fn part(rest: &mut &[u8], width: u8, signed: u8) -> [u8; 8] {
    let (mut value, mut fill) = ([0; 8], 0);
    for (index, byte) in (0..).zip(&mut value) {
        if index < width {
            [*byte] = take(rest);
            fill = if *byte >= 0x80 { signed } else { 0 };
        } else {
            *byte = fill;
        }
    }
    value
}

/// The next bytes. There are enough of them: said so, there is no code for a panic.
fn take<const N: usize>(rest: &mut &[u8]) -> [u8; N] {
    let (bytes, after) = rest.split_first_chunk().unwrap_or((&[0; N], &[]));
    *rest = after;
    *bytes
}
