//! The decoder: half-words to operations (ARMv6-M ARM DDI 0419E, chapter A5). What operations do is in `execute`.
//!
//! All 65 536 half-words are decoded once, into a table that all processors share. Nothing is stored for an address, so
//! that a program may write, move and overwrite code.

use std::sync::LazyLock;

/// An instruction, or the first half-word of a long one. The fields are register numbers (`d`, `n`, `m`, `t`) and
/// immediate values as the encoding holds them, unless a field's comment says otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Op {
    /// No instruction of ARMv6-M.
    Undefined,
    Nop,
    LslImmediate {
        d: u8,
        m: u8,
        shift: u8,
    },
    /// The shift is 1 to 32.
    LsrImmediate {
        d: u8,
        m: u8,
        shift: u8,
    },
    /// The shift is 1 to 32.
    AsrImmediate {
        d: u8,
        m: u8,
        shift: u8,
    },
    Add {
        d: u8,
        n: u8,
        m: u8,
    },
    Sub {
        d: u8,
        n: u8,
        m: u8,
    },
    AddImmediate {
        d: u8,
        n: u8,
        value: u8,
    },
    SubImmediate {
        d: u8,
        n: u8,
        value: u8,
    },
    MovImmediate {
        d: u8,
        value: u8,
    },
    CmpImmediate {
        n: u8,
        value: u8,
    },
    And {
        d: u8,
        m: u8,
    },
    Eor {
        d: u8,
        m: u8,
    },
    Lsl {
        d: u8,
        m: u8,
    },
    Lsr {
        d: u8,
        m: u8,
    },
    Asr {
        d: u8,
        m: u8,
    },
    Adc {
        d: u8,
        m: u8,
    },
    Sbc {
        d: u8,
        m: u8,
    },
    Ror {
        d: u8,
        m: u8,
    },
    Tst {
        n: u8,
        m: u8,
    },
    /// Negation.
    Rsb {
        d: u8,
        m: u8,
    },
    /// Any two registers.
    Cmp {
        n: u8,
        m: u8,
    },
    Cmn {
        n: u8,
        m: u8,
    },
    Orr {
        d: u8,
        m: u8,
    },
    Mul {
        d: u8,
        m: u8,
    },
    Bic {
        d: u8,
        m: u8,
    },
    Mvn {
        d: u8,
        m: u8,
    },
    /// Any two registers; sets no flags.
    AddAny {
        d: u8,
        m: u8,
    },
    /// Any two registers; sets no flags.
    MovAny {
        d: u8,
        m: u8,
    },
    Bx {
        m: u8,
    },
    Blx {
        m: u8,
    },
    /// The offset is in words.
    LdrLiteral {
        t: u8,
        offset: u8,
    },
    Str {
        t: u8,
        n: u8,
        m: u8,
    },
    Strh {
        t: u8,
        n: u8,
        m: u8,
    },
    Strb {
        t: u8,
        n: u8,
        m: u8,
    },
    Ldrsb {
        t: u8,
        n: u8,
        m: u8,
    },
    Ldr {
        t: u8,
        n: u8,
        m: u8,
    },
    Ldrh {
        t: u8,
        n: u8,
        m: u8,
    },
    Ldrb {
        t: u8,
        n: u8,
        m: u8,
    },
    Ldrsh {
        t: u8,
        n: u8,
        m: u8,
    },
    /// The offset is in bytes.
    StrImmediate {
        t: u8,
        n: u8,
        offset: u8,
    },
    /// The offset is in bytes.
    LdrImmediate {
        t: u8,
        n: u8,
        offset: u8,
    },
    StrbImmediate {
        t: u8,
        n: u8,
        offset: u8,
    },
    LdrbImmediate {
        t: u8,
        n: u8,
        offset: u8,
    },
    /// The offset is in bytes.
    StrhImmediate {
        t: u8,
        n: u8,
        offset: u8,
    },
    /// The offset is in bytes.
    LdrhImmediate {
        t: u8,
        n: u8,
        offset: u8,
    },
    /// The offset is in words.
    StrSp {
        t: u8,
        offset: u8,
    },
    /// The offset is in words.
    LdrSp {
        t: u8,
        offset: u8,
    },
    /// The offset is in words.
    Adr {
        d: u8,
        offset: u8,
    },
    /// The offset is in words.
    AddFromSp {
        d: u8,
        offset: u8,
    },
    /// The offset is in words.
    AddSp {
        words: u8,
    },
    /// The offset is in words.
    SubSp {
        words: u8,
    },
    Sxth {
        d: u8,
        m: u8,
    },
    Sxtb {
        d: u8,
        m: u8,
    },
    Uxth {
        d: u8,
        m: u8,
    },
    Uxtb {
        d: u8,
        m: u8,
    },
    Rev {
        d: u8,
        m: u8,
    },
    Rev16 {
        d: u8,
        m: u8,
    },
    Revsh {
        d: u8,
        m: u8,
    },
    Push {
        list: u8,
        lr: bool,
    },
    Pop {
        list: u8,
        pc: bool,
    },
    /// `cpsid i` if `disable` is true, else `cpsie i`.
    Cps {
        disable: bool,
    },
    Bkpt,
    Wfe,
    Wfi,
    Sev,
    Stm {
        n: u8,
        list: u8,
    },
    Ldm {
        n: u8,
        list: u8,
    },
    /// The offset is in half-words.
    BranchIf {
        condition: u8,
        offset: i8,
    },
    /// The offset is in half-words.
    Branch {
        offset: i16,
    },
    Svc,
    /// The first half-word of a long instruction.
    Wide {
        first: u16,
    },
}

const _: () = assert!(size_of::<Op>() == 4);

/// An instruction of two half-words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WideOp {
    Undefined,
    /// The offset is in bytes.
    Bl {
        offset: i32,
    },
    Mrs {
        d: u8,
        special: u8,
    },
    Msr {
        n: u8,
        special: u8,
    },
    /// DSB, DMB and ISB. They do nothing here, because all accesses of an instruction are complete when it ends.
    Barrier,
}

pub(super) const HALF_WORDS: usize = 1 << 16;

/// The operation of each half-word.
pub(super) static TABLE: LazyLock<Box<[Op; HALF_WORDS]>> = LazyLock::new(|| {
    let mut table = Box::new([Op::Undefined; HALF_WORDS]);
    for (word, op) in (0..=u16::MAX).zip(table.iter_mut()) {
        *op = decode(word);
    }
    table
});

pub(super) fn decode(word: u16) -> Op {
    // The register field whose lowest bit is at `at`.
    let low = |at: u32| (word >> at & 7) as u8;
    let five = (word >> 6 & 31) as u8;
    let byte = word as u8;
    let (d, n, m, high) = (low(0), low(3), low(6), low(8));
    match word >> 11 {
        0b00000 => Op::LslImmediate { d, m: n, shift: five },
        0b00001 => Op::LsrImmediate { d, m: n, shift: if five == 0 { 32 } else { five } },
        0b00010 => Op::AsrImmediate { d, m: n, shift: if five == 0 { 32 } else { five } },
        0b00011 => match word >> 9 & 3 {
            0 => Op::Add { d, n, m },
            1 => Op::Sub { d, n, m },
            2 => Op::AddImmediate { d, n, value: m },
            _ => Op::SubImmediate { d, n, value: m },
        },
        0b00100 => Op::MovImmediate { d: high, value: byte },
        0b00101 => Op::CmpImmediate { n: high, value: byte },
        0b00110 => Op::AddImmediate { d: high, n: high, value: byte },
        0b00111 => Op::SubImmediate { d: high, n: high, value: byte },
        0b01000 if word & 0x0400 == 0 => data_processing(word >> 6 & 15, d, n),
        0b01000 => special(word),
        0b01001 => Op::LdrLiteral { t: high, offset: byte },
        0b01010 | 0b01011 => match word >> 9 & 7 {
            0 => Op::Str { t: d, n, m },
            1 => Op::Strh { t: d, n, m },
            2 => Op::Strb { t: d, n, m },
            3 => Op::Ldrsb { t: d, n, m },
            4 => Op::Ldr { t: d, n, m },
            5 => Op::Ldrh { t: d, n, m },
            6 => Op::Ldrb { t: d, n, m },
            _ => Op::Ldrsh { t: d, n, m },
        },
        0b01100 => Op::StrImmediate { t: d, n, offset: five * 4 },
        0b01101 => Op::LdrImmediate { t: d, n, offset: five * 4 },
        0b01110 => Op::StrbImmediate { t: d, n, offset: five },
        0b01111 => Op::LdrbImmediate { t: d, n, offset: five },
        0b10000 => Op::StrhImmediate { t: d, n, offset: five * 2 },
        0b10001 => Op::LdrhImmediate { t: d, n, offset: five * 2 },
        0b10010 => Op::StrSp { t: high, offset: byte },
        0b10011 => Op::LdrSp { t: high, offset: byte },
        0b10100 => Op::Adr { d: high, offset: byte },
        0b10101 => Op::AddFromSp { d: high, offset: byte },
        0b10110 | 0b10111 => miscellaneous(word),
        0b11000 => Op::Stm { n: high, list: byte },
        0b11001 => Op::Ldm { n: high, list: byte },
        0b11010 | 0b11011 => match (word >> 8 & 15) as u8 {
            14 => Op::Undefined,
            15 => Op::Svc,
            condition => Op::BranchIf { condition, offset: byte as i8 },
        },
        0b11100 => Op::Branch { offset: (word << 5) as i16 >> 5 },
        // 0b11101 and 0b11111 begin long instructions that ARMv6-M does not have.
        _ => Op::Wide { first: word },
    }
}

/// Data processing (A5.2.2).
fn data_processing(code: u16, d: u8, m: u8) -> Op {
    match code {
        0 => Op::And { d, m },
        1 => Op::Eor { d, m },
        2 => Op::Lsl { d, m },
        3 => Op::Lsr { d, m },
        4 => Op::Asr { d, m },
        5 => Op::Adc { d, m },
        6 => Op::Sbc { d, m },
        7 => Op::Ror { d, m },
        8 => Op::Tst { n: d, m },
        9 => Op::Rsb { d, m },
        10 => Op::Cmp { n: d, m },
        11 => Op::Cmn { n: d, m },
        12 => Op::Orr { d, m },
        13 => Op::Mul { d, m },
        14 => Op::Bic { d, m },
        _ => Op::Mvn { d, m },
    }
}

/// Special data instructions, branch and exchange (A5.2.3).
fn special(word: u16) -> Op {
    let m = (word >> 3 & 15) as u8;
    let d = (word & 7 | word >> 4 & 8) as u8;
    match word >> 8 & 3 {
        0 => Op::AddAny { d, m },
        1 => Op::Cmp { n: d, m },
        2 => Op::MovAny { d, m },
        _ if word & 0x80 == 0 => Op::Bx { m },
        _ => Op::Blx { m },
    }
}

/// Miscellaneous 16-bit instructions (A5.2.5).
fn miscellaneous(word: u16) -> Op {
    let (d, m) = ((word & 7) as u8, (word >> 3 & 7) as u8);
    let list = word as u8;
    match (word >> 8 & 15, word >> 6 & 3) {
        (0b0000, 0 | 1) => Op::AddSp { words: list & 0x7f },
        (0b0000, _) => Op::SubSp { words: list & 0x7f },
        (0b0010, 0) => Op::Sxth { d, m },
        (0b0010, 1) => Op::Sxtb { d, m },
        (0b0010, 2) => Op::Uxth { d, m },
        (0b0010, _) => Op::Uxtb { d, m },
        (0b0100, _) => Op::Push { list, lr: false },
        (0b0101, _) => Op::Push { list, lr: true },
        (0b0110, _) if word & 0xffef == 0xb662 => Op::Cps { disable: word & 0x10 != 0 },
        (0b1010, 0) => Op::Rev { d, m },
        (0b1010, 1) => Op::Rev16 { d, m },
        (0b1010, 3) => Op::Revsh { d, m },
        (0b1100, _) => Op::Pop { list, pc: false },
        (0b1101, _) => Op::Pop { list, pc: true },
        (0b1110, _) => Op::Bkpt,
        (0b1111, _) if word & 15 == 0 => hint(word >> 4 & 15),
        _ => Op::Undefined,
    }
}

/// Hints (A5.2.5). `yield` and hints that are not allocated do nothing.
fn hint(code: u16) -> Op {
    match code {
        2 => Op::Wfe,
        3 => Op::Wfi,
        4 => Op::Sev,
        _ => Op::Nop,
    }
}

/// Decodes a long instruction (A5.3).
pub(super) fn decode_wide(first: u16, second: u16) -> WideOp {
    match (first, second) {
        (0xf000..=0xf7ff, _) if second & 0xd000 == 0xd000 => WideOp::Bl { offset: bl_offset(first, second) },
        (0xf3ef, _) if second & 0xf000 == 0x8000 => WideOp::Mrs { d: (second >> 8 & 15) as u8, special: second as u8 },
        (0xf380..=0xf38f, _) if second & 0xff00 == 0x8800 => {
            WideOp::Msr { n: (first & 15) as u8, special: second as u8 }
        }
        (0xf3bf, 0x8f40..=0x8f6f) => WideOp::Barrier,
        _ => WideOp::Undefined,
    }
}

/// The offset of BL in bytes (A6.7.13): S, I1, I2, imm10, imm11, 0, with I = NOT (J EOR S).
fn bl_offset(first: u16, second: u16) -> i32 {
    let bit = |word: u16, at: u32| u32::from(word >> at & 1);
    let s = bit(first, 10);
    let i1 = 1 ^ bit(second, 13) ^ s;
    let i2 = 1 ^ bit(second, 11) ^ s;
    let bits = s << 24 | i1 << 23 | i2 << 22 | u32::from(first & 0x3ff) << 12 | u32::from(second & 0x7ff) << 1;
    (bits << 7) as i32 >> 7
}
