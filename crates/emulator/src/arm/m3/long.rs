//! Instructions of 32 bits (ARMv7-M ARM DDI 0403E §A5.3). An encoding that the manual calls UNPREDICTABLE is no
//! instruction here, so that a program that has one faults.

use super::operation::{Alu, Flags, Index, NONE, Operation, Reversal, Shift};
use crate::arm::Size;

/// The fields that most encodings have.
#[derive(Clone, Copy)]
struct Encoding {
    first: u16,
    second: u16,
}

impl Encoding {
    /// Bits of the first half-word.
    fn first(self, low: u32, width: u32) -> u8 {
        (self.first >> low & ((1 << width) - 1)) as u8
    }

    fn second(self, low: u32, width: u32) -> u8 {
        (self.second >> low & ((1 << width) - 1)) as u8
    }

    fn n(self) -> u8 {
        self.first(0, 4)
    }

    fn d(self) -> u8 {
        self.second(8, 4)
    }

    fn t(self) -> u8 {
        self.second(12, 4)
    }

    fn m(self) -> u8 {
        self.second(0, 4)
    }

    /// imm3:imm2 of the second half-word.
    fn places(self) -> u8 {
        self.second(12, 3) << 2 | self.second(6, 2)
    }

    /// i:imm3:imm8.
    fn imm12(self) -> u32 {
        u32::from(self.first >> 10 & 1) << 11 | u32::from(self.second(12, 3)) << 8 | u32::from(self.second & 0xff)
    }

    /// S:I1:I2:imm10:imm11:0 of a long branch, with I = NOT (J EOR S) (§A7.7.12, T4).
    fn long_offset(self) -> i32 {
        let bit = |word: u16, at: u32| u32::from(word >> at & 1);
        let s = bit(self.first, 10);
        let (i1, i2) = (1 ^ bit(self.second, 13) ^ s, 1 ^ bit(self.second, 11) ^ s);
        let bits = s << 24 | i1 << 23 | i2 << 22 | self.branch_bits(0x3ff);
        (bits << 7) as i32 >> 7
    }

    /// S:J2:J1:imm6:imm11:0 of a conditional branch (T3).
    fn conditional_offset(self) -> i32 {
        let bit = |word: u16, at: u32| u32::from(word >> at & 1);
        let bits = bit(self.first, 10) << 20
            | bit(self.second, 11) << 19
            | bit(self.second, 13) << 18
            | self.branch_bits(0x3f);
        (bits << 11) as i32 >> 11
    }

    fn branch_bits(self, of_first: u16) -> u32 {
        u32::from(self.first & of_first) << 12 | u32::from(self.second & 0x7ff) << 1
    }
}

/// Whether a register is the stack pointer or the program counter, which most encodings do not allow.
const fn is_special(register: u8) -> bool {
    register == 13 || register == 15
}

fn any_special(registers: &[u8]) -> bool {
    registers.iter().any(|register| is_special(*register))
}

/// Decodes an instruction of two half-words.
pub(super) fn decode(first: u16, second: u16) -> Operation {
    let word = Encoding { first, second };
    let op = match first >> 9 {
        0b111_0100 if first & 0x40 == 0 => multiple(word),
        0b111_0100 => double_and_exclusive(word),
        0b111_0101 => shifted_register(word),
        0b111_1000..=0b111_1011 if second & 0x8000 != 0 => branch_and_control(word),
        0b111_1000 | 0b111_1010 => modified_immediate(word),
        0b111_1001 | 0b111_1011 => plain_immediate(word),
        0b111_1100 => single(word),
        0b111_1101 if first & 0x180 == 0x180 => long_multiply(word),
        0b111_1101 if first & 0x180 == 0x100 => multiply(word),
        0b111_1101 => register(word),
        _ => Some(Operation::Coprocessor),
    };
    op.unwrap_or(Operation::Undefined)
}

/// Load and store multiple (§A5.3.5).
fn multiple(word: Encoding) -> Option<Operation> {
    let (n, list) = (word.n(), word.second);
    let before = match word.first(7, 2) {
        1 => false,
        2 => true,
        _ => return None,
    };
    let write_back = word.first(5, 1) != 0;
    let clash = write_back && list >> n & 1 != 0;
    if n == 15 || list.count_ones() < 2 || list & 1 << 13 != 0 || clash {
        return None;
    }
    if word.first(4, 1) == 0 {
        return (list & 1 << 15 == 0).then_some(Operation::StoreMultiple { n, list, before, write_back });
    }
    (list >> 14 != 3).then_some(Operation::LoadMultiple { n, list, before, write_back })
}

/// Load and store of two words or exclusive, table branch (§A5.3.6).
fn double_and_exclusive(word: Encoding) -> Option<Operation> {
    let (n, t, d) = (word.n(), word.t(), word.d());
    let is_load = word.first(4, 1) != 0;
    let (pre, up, write_back) = (word.first(8, 1) != 0, word.first(7, 1) != 0, word.first(5, 1) != 0);
    if pre || write_back {
        return double(word, pre, up, write_back);
    }
    if !up {
        let offset = i16::from(word.second as u8) * 4;
        return match is_load {
            true if n == 15 || is_special(t) || d != 15 => None,
            true => Some(Operation::LoadExclusive { size: Size::Word, t, n, offset }),
            false if n == 15 || any_special(&[t, d]) || d == n || d == t => None,
            false => Some(Operation::StoreExclusive { size: Size::Word, d, t, n, offset }),
        };
    }
    let kind = word.second(4, 4);
    match (is_load, kind) {
        (true, 0 | 1) if n == 13 || is_special(word.m()) || t != 15 || d != 0 => None,
        (true, 0 | 1) => Some(Operation::TableBranch { n, m: word.m(), half: kind == 1 }),
        (_, 4 | 5) => {
            let size = if kind == 4 { Size::Byte } else { Size::Half };
            let d_low = word.m();
            if n == 15 || is_special(t) || d != 15 {
                None
            } else if is_load {
                (d_low == 15).then_some(Operation::LoadExclusive { size, t, n, offset: 0 })
            } else if is_special(d_low) || d_low == n || d_low == t {
                None
            } else {
                Some(Operation::StoreExclusive { size, d: d_low, t, n, offset: 0 })
            }
        }
        _ => None,
    }
}

fn double(word: Encoding, pre: bool, up: bool, write_back: bool) -> Option<Operation> {
    let (n, t, t2) = (word.n(), word.t(), word.d());
    let distance = i16::from(word.second as u8) * 4;
    let offset = if up { distance } else { -distance };
    let index = match (pre, write_back) {
        (true, false) => Index::Offset,
        (true, true) => Index::Before,
        _ => Index::After,
    };
    let clash = write_back && (n == t || n == t2);
    if any_special(&[t, t2]) || clash {
        return None;
    }
    if word.first(4, 1) == 0 {
        return (n != 15).then_some(Operation::StoreDouble { t, t2, n, index, offset });
    }
    (t != t2 && !(n == 15 && write_back)).then_some(Operation::LoadDouble { t, t2, n, index, offset })
}

/// The operation of §A5.3.1 and §A5.3.11, and its destination: none if it is a comparison.
fn operation(code: u8, n: u8, d: u8, sets: bool) -> Option<(Alu, u8)> {
    let compares = d == 15 && sets;
    let destination = if compares { NONE } else { d };
    let alu = match code {
        0 => Alu::And,
        1 if !compares => Alu::Bic,
        2 if n == 15 && !compares => Alu::Mov,
        2 if !compares => Alu::Orr,
        3 if n == 15 && !compares => Alu::Mvn,
        3 if !compares => Alu::Orn,
        4 => Alu::Eor,
        8 => Alu::Add,
        10 if !compares => Alu::Adc,
        11 if !compares => Alu::Sbc,
        13 => Alu::Sub,
        14 if !compares => Alu::Rsb,
        _ => return None,
    };
    Some((alu, destination))
}

/// Whether the manual allows the registers: the stack pointer only in sums, differences and their comparisons.
fn allows(alu: Alu, d: u8, n: u8, compares: bool) -> bool {
    let from_sp = n == 13 && matches!(alu, Alu::Add | Alu::Sub);
    let n_is_used = !matches!(alu, Alu::Mov | Alu::Mvn);
    let n_is_right = !n_is_used || !is_special(n) || from_sp;
    let d_is_right = compares || !is_special(d) || d == 13 && from_sp;
    n_is_right && d_is_right
}

/// Data processing with a shifted register (§A5.3.11).
fn shifted_register(word: Encoding) -> Option<Operation> {
    let (n, m, d, places) = (word.n(), word.m(), word.d(), word.places());
    let sets = word.first(4, 1) != 0;
    let (alu, destination) = operation(word.first(5, 4), n, d, sets)?;
    let (shift, places) = match word.second(4, 2) {
        0 => (Shift::Left, places),
        1 => (Shift::Right, if places == 0 { 32 } else { places }),
        2 => (Shift::RightSigned, if places == 0 { 32 } else { places }),
        _ if places == 0 => (Shift::RotateExtended, 1),
        _ => (Shift::Rotate, places),
    };
    let compares = d == 15 && sets;
    let is_plain = shift == Shift::Left && places == 0;
    // `mov` may have the stack pointer on one side.
    let moves_sp = alu == Alu::Mov && is_plain && !sets && d != 15 && m != 15 && (d == 13) != (m == 13);
    // The stack pointer can be set from itself and a register that is shifted left by at most 3.
    let shifts_too_far = d == 13 && (shift != Shift::Left || places > 3);
    if !moves_sp && (is_special(m) || !allows(alu, d, n, compares) || shifts_too_far) || word.second & 0x8000 != 0 {
        return None;
    }
    let flags = if sets { Flags::Always } else { Flags::Never };
    Some(Operation::Register { alu, flags, d: destination, n, m, shift, places })
}

/// Data processing with a modified immediate value (§A5.3.1, §A5.3.2).
fn modified_immediate(word: Encoding) -> Option<Operation> {
    let (n, d) = (word.n(), word.d());
    let sets = word.first(4, 1) != 0;
    let (alu, destination) = operation(word.first(5, 4), n, d, sets)?;
    if !allows(alu, d, n, d == 15 && sets) {
        return None;
    }
    let (value, carry) = expand(word.imm12())?;
    let flags = if sets { Flags::Always } else { Flags::Never };
    Some(Operation::Immediate { alu, flags, d: destination, n, carry, value })
}

/// ThumbExpandImm_C (§A5.3.2). A pattern of zeros is UNPREDICTABLE.
fn expand(imm12: u32) -> Option<(u32, Option<bool>)> {
    let byte = imm12 & 0xff;
    match imm12 >> 8 {
        0 => Some((byte, None)),
        1..=3 if byte == 0 => None,
        1 => Some((byte * 0x0001_0001, None)),
        2 => Some((byte * 0x0100_0100, None)),
        3 => Some((byte * 0x0101_0101, None)),
        _ => {
            let value = (0x80 | imm12 & 0x7f).rotate_right(imm12 >> 7);
            Some((value, Some(value >> 31 != 0)))
        }
    }
}

/// Data processing with a plain immediate value (§A5.3.3).
fn plain_immediate(word: Encoding) -> Option<Operation> {
    let (n, d, places) = (word.n(), word.d(), word.places());
    let last = word.second(0, 5);
    let from_sp = n == 13;
    let sum = |alu| Operation::Immediate { alu, flags: Flags::Never, d, n, carry: None, value: word.imm12() };
    let wide_value = (u32::from(n) << 12 | word.imm12()) as u16;
    let shift = if word.first(5, 1) != 0 { Shift::RightSigned } else { Shift::Left };
    // SSAT16 and USAT16 belong to the DSP extension.
    let saturates = !any_special(&[d, n]) && (shift == Shift::Left || places != 0) && word.second & 0x20 == 0;
    let is_field = !is_special(d) && n != 13 && word.second & 0x20 == 0;
    Some(match word.first(4, 5) {
        0b00000 | 0b01010 if is_special(d) && !(d == 13 && from_sp) => return None,
        0b00000 if n == 15 => Operation::Adr { d, offset: word.imm12() as i32 },
        0b00000 => sum(Alu::Add),
        0b01010 if n == 15 => Operation::Adr { d, offset: -(word.imm12() as i32) },
        0b01010 => sum(Alu::Sub),
        0b00100 | 0b01100 if is_special(d) => return None,
        0b00100 => {
            Operation::Immediate { alu: Alu::Mov, flags: Flags::Never, d, n: 0, carry: None, value: wide_value.into() }
        }
        0b01100 => Operation::MovTop { d, value: wide_value },
        0b10000 | 0b10010 if saturates => Operation::Saturate { signed: true, d, n, bits: last + 1, shift, places },
        0b11000 | 0b11010 if saturates => Operation::Saturate { signed: false, d, n, bits: last, shift, places },
        0b10100 | 0b11100 if is_field && n != 15 && places + last < 32 => {
            Operation::Extract { signed: word.first(4, 5) == 0b10100, d, n, low: places, width: last + 1 }
        }
        0b10110 if is_field && last >= places => Operation::Insert { d, n, low: places, width: last + 1 - places },
        _ => return None,
    })
}

/// Branches and control (§A5.3.4).
fn branch_and_control(word: Encoding) -> Option<Operation> {
    let Encoding { first, second } = word;
    match second >> 12 & 5 {
        1 => return Some(Operation::Branch { offset: word.long_offset() }),
        5 => return Some(Operation::BranchLink { offset: word.long_offset() }),
        4 => return None,
        _ => {}
    }
    let condition = word.first(6, 4);
    if condition < 14 {
        return Some(Operation::BranchIf { condition, offset: word.conditional_offset() });
    }
    let special = second as u8;
    match first {
        // Without the DSP extension the mask of MSR is 0b10.
        0xf380..=0xf38f if second & 0xff00 == 0x8800 && !is_special(word.n()) => {
            Some(Operation::WriteSpecial { n: word.n(), special })
        }
        0xf3af if second & 0xff00 == 0x8000 => Some(match special {
            2 => Operation::WaitForEvent,
            3 => Operation::WaitForInterrupt,
            4 => Operation::SendEvent,
            _ => Operation::Nop,
        }),
        0xf3bf => match second {
            0x8f2f => Some(Operation::ClearExclusive),
            0x8f40..=0x8f5f => Some(Operation::Barrier),
            0x8f60..=0x8f6f => Some(Operation::InstructionBarrier),
            _ => None,
        },
        0xf3ef if second & 0xf000 == 0x8000 && !is_special(word.d()) => {
            Some(Operation::ReadSpecial { d: word.d(), special })
        }
        _ => None,
    }
}

/// Load and store of one value, memory hints (§A5.3.7 to §A5.3.10).
fn single(word: Encoding) -> Option<Operation> {
    let (n, t) = (word.n(), word.t());
    let size = match word.first(5, 2) {
        0 => Size::Byte,
        1 => Size::Half,
        2 => Size::Word,
        _ => return None,
    };
    let signed = word.first(8, 1) != 0;
    let is_load = word.first(4, 1) != 0;
    let is_word = size == Size::Word;
    if signed && (is_word || !is_load) {
        return None;
    }
    let distance = (word.second & 0xfff) as i16;
    if is_load && n == 15 {
        let offset = if word.first(7, 1) != 0 { distance } else { -distance };
        return match t {
            15 if !is_word => Some(Operation::Nop),
            13 if !is_word => None,
            _ => Some(Operation::LoadLiteral { size, signed, t, offset }),
        };
    }
    // Loading the program counter is a branch; of less than a word it is a hint.
    if n == 15 || t == 15 && !is_load || t == 13 && !is_word {
        return None;
    }
    let is_hint = is_load && t == 15 && !is_word;
    let (index, offset) = if word.first(7, 1) != 0 {
        (Index::Offset, distance)
    } else if word.second & 0x800 == 0 {
        return match word.second & 0x7c0 {
            0 if is_special(word.m()) => None,
            0 if is_hint => Some(Operation::Nop),
            0 if is_load => Some(Operation::LoadIndexed { size, signed, t, n, m: word.m(), places: word.second(4, 2) }),
            0 => Some(Operation::StoreIndexed { size, t, n, m: word.m(), places: word.second(4, 2) }),
            _ => None,
        };
    } else {
        let distance = distance & 0xff;
        let (pre, up, write_back) = (word.second & 0x400 != 0, word.second & 0x200 != 0, word.second & 0x100 != 0);
        let offset = if up { distance } else { -distance };
        match (pre, write_back) {
            (false, false) => return None,
            // LDRT, STRT: without privileges. The memories here do not tell the difference.
            (true, false) if up && is_special(t) => return None,
            (true, false) => (Index::Offset, offset),
            _ if n == t || is_hint => return None,
            (true, true) => (Index::Before, offset),
            (false, true) => (Index::After, offset),
        }
    };
    Some(match is_load {
        _ if is_hint => Operation::Nop,
        true => Operation::Load { size, signed, t, n, index, offset },
        false => Operation::Store { size, t, n, index, offset },
    })
}

/// Data processing with registers alone (§A5.3.12 to §A5.3.15).
fn register(word: Encoding) -> Option<Operation> {
    let (n, d, m) = (word.n(), word.d(), word.m());
    if word.second >> 12 != 15 || any_special(&[d, m]) {
        return None;
    }
    let (code, kind) = (word.first(4, 4), word.second(4, 4));
    if code < 8 && kind == 0 {
        let shift = [Shift::Left, Shift::Right, Shift::RightSigned, Shift::Rotate][usize::from(code >> 1)];
        let flags = if code & 1 != 0 { Flags::Always } else { Flags::Never };
        return (!is_special(n)).then_some(Operation::ShiftBy { shift, flags, d, n, m });
    }
    if (8..12).contains(&kind) && n == 15 {
        let rotation = 8 * (kind & 3);
        return match code {
            0 | 1 => Some(Operation::Extend { signed: code == 0, size: Size::Half, d, m, rotation }),
            4 | 5 => Some(Operation::Extend { signed: code == 4, size: Size::Byte, d, m, rotation }),
            _ => None,
        };
    }
    let kind = match (code, kind) {
        (9, 8) => Reversal::Bytes,
        (9, 9) => Reversal::BytesOfHalves,
        (9, 10) => Reversal::Bits,
        (9, 11) => Reversal::BytesOfSignedHalf,
        (11, 8) => Reversal::LeadingZeros,
        _ => return None,
    };
    (n == m).then_some(Operation::Reverse { kind, d, m })
}

/// Multiplication (§A5.3.16). What halves, dual products and most significant words need is the DSP extension.
fn multiply(word: Encoding) -> Option<Operation> {
    let (n, m, d, a) = (word.n(), word.m(), word.d(), word.t());
    if any_special(&[n, m, d]) || a == 13 || word.first(4, 3) != 0 {
        return None;
    }
    match word.second(4, 4) {
        0 if a == 15 => Some(Operation::Multiply { flags: Flags::Never, d, n, m }),
        0 => Some(Operation::MultiplyAdd { subtract: false, d, n, m, a }),
        1 if a != 15 => Some(Operation::MultiplyAdd { subtract: true, d, n, m, a }),
        _ => None,
    }
}

/// Long multiplication, and division (§A5.3.17).
fn long_multiply(word: Encoding) -> Option<Operation> {
    let (n, m, low, high) = (word.n(), word.m(), word.t(), word.d());
    if any_special(&[n, m, high]) {
        return None;
    }
    let (code, kind) = (word.first(4, 3), word.second(4, 4));
    match (code, kind) {
        (1 | 3, 15) => (low == 15).then_some(Operation::Divide { signed: code == 1, d: high, n, m }),
        (0 | 2 | 4 | 6, 0) if !is_special(low) && low != high => {
            Some(Operation::MultiplyLong { signed: code & 2 == 0, accumulate: code & 4 != 0, low, high, n, m })
        }
        _ => None,
    }
}
