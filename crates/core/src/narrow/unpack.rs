//! [`packing`](crate::packing) for [`Registers`]: the prediction is what the registers hold after the last step.

use super::bytes::{Bytes, Pool, Reader};
use super::registers::{Registers, sign_byte};
use crate::packing::Control;
use crate::{Direction, Epoch};

/// What has been taken off the queue.
pub(super) enum Record {
    /// A segment is in the registers.
    Run,
    /// The accumulator is to be set to this tick and fraction.
    Anchor { tick: u32, fraction: u16 },
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

    #[inline(never)]
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
        // No record is longer than 32 bytes.
        let have = u8::try_from(bytes.waiting(epoch)).unwrap_or(u8::MAX);
        if have == 0 {
            return Found::Nothing;
        }
        let mut reader = bytes.reader(pool);
        let header = reader.byte();
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
                match reader.byte() {
                    0 => return self.control(header >> 3, have, reader, registers, bytes),
                    0xff => {
                        if have < 4 {
                            return Found::Nothing;
                        }
                        len = 4;
                        Some(u16::from_le_bytes([reader.byte(), reader.byte()]))
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

        let narrow = header >> 3 & 3;
        let wide = if narrow == 3 { 5 } else { narrow + 1 };
        let interval_width = if header & 0x20 != 0 { wide } else { narrow };
        let mut add_width = if header & 0x40 != 0 { wide } else { narrow };
        let mut add2_width = if header & 0x80 != 0 { wide } else { narrow };
        if count < 3 {
            add2_width = 0;
            if count < 2 {
                add_width = 0;
            }
        }
        len += interval_width + add_width + add2_width;
        if have < len {
            return Found::Nothing;
        }

        let [interval_exponent, add_exponent, add2_exponent] = self.exponents();
        if interval_width > 0 {
            let (low, high) = correction(&mut reader, interval_width, interval_exponent);
            registers.lengthen(low, high);
        }
        if add_width > 0 {
            let (low, _) = correction(&mut reader, add_width, add_exponent);
            registers.add = registers.add.wrapping_add(low.cast_signed());
        }
        if add2_width > 0 {
            let (low, _) = correction(&mut reader, add2_width, add2_exponent);
            registers.add2 = registers.add2.wrapping_add(low.cast_signed());
        }
        bytes.consume(len, reader.at);
        registers.left = count;
        self.previous_count = count;
        Found::Record(Record::Run)
    }

    /// A control record, of which header and 0 have been read.
    #[inline(never)]
    fn control<const N: usize>(
        &mut self,
        control: u8,
        have: u8,
        mut reader: Reader<'_, N>,
        registers: &mut Registers,
        bytes: &mut Bytes,
    ) -> Found {
        const REVERSE: u8 = Control::Reverse as u8;
        const RESET: u8 = Control::Reset as u8;
        const DWELL: u8 = Control::Dwell as u8;
        const ANCHOR: u8 = Control::Anchor as u8;
        const EXACT: u8 = Control::Exact as u8;
        const CHECK: u8 = Control::Check as u8;
        const RESUME: u8 = Control::Resume as u8;
        const SLOW: u8 = Control::Slow as u8;
        if control >= SLOW {
            return self.slow(control - SLOW, reader.at, registers, bytes);
        }
        let mut len = match control {
            REVERSE | RESET => 2,
            DWELL | ANCHOR => 6,
            EXACT => 4,
            CHECK => 10,
            RESUME => 8,
            _ => return Found::Bad,
        };
        if have < len {
            return Found::Nothing;
        }
        let record = match control {
            REVERSE => {
                self.direction = self.direction.reversed();
                self.reset(registers);
                Record::Prediction
            }
            RESET => {
                self.reset(registers);
                Record::Prediction
            }
            DWELL => Record::Dwell(reader.word()),
            ANCHOR => Record::Anchor { tick: reader.word(), fraction: 1 << 15 },
            RESUME => {
                let tick = reader.word();
                Record::Anchor { tick, fraction: u16::from_le_bytes([reader.byte(), reader.byte()]) }
            }
            CHECK => {
                let position = u16::from_le_bytes([reader.byte(), reader.byte()]);
                let tick = reader.word();
                Record::Check { position, tick, fraction: u16::from_le_bytes([reader.byte(), reader.byte()]) }
            }
            _ => {
                let (said, wide) = (reader.byte(), reader.byte());
                let (interval, add, add2, count) = (said & 15, said >> 4, wide & 15, wide >> 4);
                if !(1..=4).contains(&count) || interval > 8 || add > 8 || add2 > 8 {
                    return Found::Bad;
                }
                len += count + interval + add + add2;
                if have < len {
                    return Found::Nothing;
                }
                // Before anything is changed: with fewer than three steps not all fields are said.
                let (Some((count, 0)), Some((low, high))) =
                    (part(&mut reader, count, 0, 0), part(&mut reader, interval, 0xff, 0))
                else {
                    return Found::Bad;
                };
                let count = match u16::try_from(count) {
                    Err(_) | Ok(0) => return Found::Bad,
                    Ok(1) if add > 0 || add2 > 0 => return Found::Bad,
                    Ok(2) if add2 > 0 => return Found::Bad,
                    Ok(count) => count,
                };
                let (mut next, mut after) = (registers.add, registers.add2);
                if count > 1 {
                    match difference(&mut reader, add) {
                        Some(value) => next = value,
                        None => return Found::Bad,
                    }
                    if count > 2 {
                        match difference(&mut reader, add2) {
                            Some(value) => after = value,
                            None => return Found::Bad,
                        }
                    }
                }
                (registers.interval_low, registers.interval_high) = (low, high);
                (registers.add, registers.add2) = (next, after);
                registers.left = count;
                self.previous_count = count.max(COUNT_AFTER_EXACT);
                Record::Run
            }
        };
        bytes.consume(len, reader.at);
        Found::Record(record)
    }

    /// Slows down within 2^`m` steps, m at most 15: the record ends at `end`.
    fn slow(&mut self, m: u8, end: u16, registers: &mut Registers, bytes: &mut Bytes) -> Found {
        let (mut low, mut high) = (registers.interval_low, registers.interval_high);
        let mut bits = m + 1;
        while bits > 0 {
            low = low >> 1 | u32::from(high & 1) << 31;
            high >>= 1;
            bits -= 1;
        }
        // t − t/8, of 40 bits.
        let eighth = low >> 3 | u32::from(high & 7) << 29;
        let (add, borrow) = low.overflowing_sub(eighth);
        let beyond = high.wrapping_sub(high >> 3).wrapping_sub(borrow as u8);
        if beyond != 0 || add >= 1 << 31 {
            return Found::Bad;
        }
        registers.add = add.cast_signed();
        registers.add2 = 0;
        registers.left = 1 << m;
        self.previous_count = registers.left;
        bytes.consume(2, end);
        Found::Record(Record::Run)
    }

    /// How far corrections are to be shifted to the left: 16 − [`unit_shift`](crate::packing::unit_shift).
    #[inline(never)]
    fn exponents(&self) -> [u8; 3] {
        let [low, high] = self.previous_count.to_le_bytes();
        let (mut bits, mut rest) = if high == 0 { (0i8, low) } else { (8, high) };
        while rest != 0 {
            bits += 1;
            rest >>= 1;
        }
        let finer = bits + self.gain;
        [exponent(finer + 2), exponent(finer + bits - 2), exponent(finer + bits + bits - 5)]
    }
}

/// 16 − `shift`, that being held in 0..=16.
const fn exponent(shift: i8) -> u8 {
    if shift <= 0 {
        16
    } else if shift >= 16 {
        0
    } else {
        16 - shift.cast_unsigned()
    }
}

/// `width` (1, 2, 3 or 5) bytes of two's complement, shifted to the left by `exponent` (0..=16): 40 bits.
fn correction<const N: usize>(reader: &mut Reader<'_, N>, width: u8, exponent: u8) -> (u32, u8) {
    let first = reader.byte();
    let (mut low, mut high);
    if width == 1 {
        high = extension(first);
        low = u32::from_le_bytes([first, high, high, high]);
    } else {
        let second = reader.byte();
        if width == 2 {
            high = extension(second);
            low = u32::from_le_bytes([first, second, high, high]);
        } else {
            let third = reader.byte();
            if width == 3 {
                high = extension(third);
                low = u32::from_le_bytes([first, second, third, high]);
            } else {
                low = u32::from_le_bytes([first, second, third, reader.byte()]);
                high = reader.byte();
            }
        }
    }
    // First by whole bytes, which costs next to nothing, then bit by bit.
    let mut bits = exponent;
    while bits >= 8 {
        let [a, b, c, d] = low.to_le_bytes();
        high = d;
        low = u32::from_le_bytes([0, a, b, c]);
        bits -= 8;
    }
    while bits > 0 {
        high = high << 1 | (low >= 1 << 31) as u8;
        low <<= 1;
        bits -= 1;
    }
    (low, high)
}

/// `width` (0 to 8) bytes of an exact segment, extended: by 0, or by their sign where `signed` has its bits set. 40 bits,
/// if what is beyond says nothing new: it is 0, or their sign where `rest` has its bits set.
#[inline(never)]
fn part<const N: usize>(reader: &mut Reader<'_, N>, width: u8, signed: u8, rest: u8) -> Option<(u32, u8)> {
    let (mut low, mut high, mut fill, mut fits) = (0u32, 0, 0, true);
    let mut index = 0;
    while index < 8 {
        let byte = if index < width {
            let byte = reader.byte();
            fill = extension(byte) & signed;
            byte
        } else {
            fill
        };
        if index < 5 {
            // In from above, down by a byte each time.
            let [_, b, c, d] = low.to_le_bytes();
            low = u32::from_le_bytes([b, c, d, high]);
            high = byte;
        } else {
            fits &= byte == extension(high) & rest;
        }
        index += 1;
    }
    fits.then_some((low, high))
}

/// The same, if 32 bits are enough.
fn difference<const N: usize>(reader: &mut Reader<'_, N>, width: u8) -> Option<i32> {
    let (low, high) = part(reader, width, 0xff, 0xff)?;
    (high == sign_byte(low.cast_signed())).then_some(low.cast_signed())
}

/// What extends a number to the left that ends with `byte`.
const fn extension(byte: u8) -> u8 {
    if byte >= 0x80 { 0xff } else { 0 }
}
