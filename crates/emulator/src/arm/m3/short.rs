//! Instructions of 16 bits. What ARMv6-M has too is decoded by the same decoder (`arm::decode`); CBZ, IT and the masks of
//! CPS are ARMv7-M's alone (ARM DDI 0403E §A5.2).

use super::operation::{Alu, Flags, Index, NONE, Operation, Shift};
use crate::arm::Size;
use crate::arm::cpu::{LR, PC, SP};
use crate::arm::decode::{self, HALF_WORDS};
use std::sync::LazyLock;

/// The operation of each half-word that is no part of a long instruction.
pub(super) static TABLE: LazyLock<Box<[Operation]>> = LazyLock::new(|| {
    let all = (0..=u16::MAX).map(decode).collect::<Box<[Operation]>>();
    assert_eq!(all.len(), HALF_WORDS);
    all
});

/// Data processing that sets flags outside an IT block: a register and an immediate value.
const fn immediate(alu: Alu, d: u8, n: u8, value: u32) -> Operation {
    Operation::Immediate { alu, flags: Flags::OutsideIt, d, n, carry: None, value }
}

/// The same with two registers.
const fn register(alu: Alu, d: u8, n: u8, m: u8) -> Operation {
    Operation::Register { alu, flags: Flags::OutsideIt, d, n, m, shift: Shift::Left, places: 0 }
}

/// A comparison, which sets flags anywhere.
const fn compare(alu: Alu, n: u8, m: u8) -> Operation {
    Operation::Register { alu, flags: Flags::Always, d: NONE, n, m, shift: Shift::Left, places: 0 }
}

const fn shifted(shift: Shift, d: u8, m: u8, places: u8) -> Operation {
    Operation::Register { alu: Alu::Mov, flags: Flags::OutsideIt, d, n: 0, m, shift, places }
}

const fn shift_by(shift: Shift, d: u8, m: u8) -> Operation {
    Operation::ShiftBy { shift, flags: Flags::OutsideIt, d, n: d, m }
}

const fn load(size: Size, t: u8, n: u8, offset: i16) -> Operation {
    Operation::Load { size, signed: false, t, n, index: Index::Offset, offset }
}

const fn store(size: Size, t: u8, n: u8, offset: i16) -> Operation {
    Operation::Store { size, t, n, index: Index::Offset, offset }
}

const fn load_indexed(size: Size, signed: bool, t: u8, n: u8, m: u8) -> Operation {
    Operation::LoadIndexed { size, signed, t, n, m, places: 0 }
}

const fn store_indexed(size: Size, t: u8, n: u8, m: u8) -> Operation {
    Operation::StoreIndexed { size, t, n, m, places: 0 }
}

const SP_NUMBER: u8 = SP as u8;
const SP_AS_BASE: u8 = SP_NUMBER;

fn decode(word: u16) -> Operation {
    use decode::Op as Short;
    match decode::decode(word) {
        Short::Undefined => own(word),
        Short::Wide { .. } => Operation::Undefined,
        Short::Nop => Operation::Nop,
        Short::LslImmediate { d, m, shift } => shifted(Shift::Left, d, m, shift),
        Short::LsrImmediate { d, m, shift } => shifted(Shift::Right, d, m, shift),
        Short::AsrImmediate { d, m, shift } => shifted(Shift::RightSigned, d, m, shift),
        Short::Add { d, n, m } => register(Alu::Add, d, n, m),
        Short::Sub { d, n, m } => register(Alu::Sub, d, n, m),
        Short::AddImmediate { d, n, value } => immediate(Alu::Add, d, n, value.into()),
        Short::SubImmediate { d, n, value } => immediate(Alu::Sub, d, n, value.into()),
        Short::MovImmediate { d, value } => immediate(Alu::Mov, d, 0, value.into()),
        Short::CmpImmediate { n, value } => {
            Operation::Immediate { alu: Alu::Sub, flags: Flags::Always, d: NONE, n, carry: None, value: value.into() }
        }
        Short::And { d, m } => register(Alu::And, d, d, m),
        Short::Eor { d, m } => register(Alu::Eor, d, d, m),
        Short::Lsl { d, m } => shift_by(Shift::Left, d, m),
        Short::Lsr { d, m } => shift_by(Shift::Right, d, m),
        Short::Asr { d, m } => shift_by(Shift::RightSigned, d, m),
        Short::Ror { d, m } => shift_by(Shift::Rotate, d, m),
        Short::Adc { d, m } => register(Alu::Adc, d, d, m),
        Short::Sbc { d, m } => register(Alu::Sbc, d, d, m),
        Short::Tst { n, m } => compare(Alu::And, n, m),
        Short::Rsb { d, m } => immediate(Alu::Rsb, d, m, 0),
        Short::Cmp { n, m } => compare(Alu::Sub, n, m),
        Short::Cmn { n, m } => compare(Alu::Add, n, m),
        Short::Orr { d, m } => register(Alu::Orr, d, d, m),
        Short::Mul { d, m } => Operation::Multiply { flags: Flags::OutsideIt, d, n: m, m: d },
        Short::Bic { d, m } => register(Alu::Bic, d, d, m),
        Short::Mvn { d, m } => register(Alu::Mvn, d, 0, m),
        Short::AddAny { d, m } => Operation::AddAny { d, m },
        Short::MovAny { d, m } => Operation::MovAny { d, m },
        Short::Bx { m } => Operation::BranchExchange { m },
        Short::Blx { m } => Operation::BranchLinkExchange { m },
        Short::LdrLiteral { t, offset } => {
            Operation::LoadLiteral { size: Size::Word, signed: false, t, offset: i16::from(offset) * 4 }
        }
        Short::Str { t, n, m } => store_indexed(Size::Word, t, n, m),
        Short::Strh { t, n, m } => store_indexed(Size::Half, t, n, m),
        Short::Strb { t, n, m } => store_indexed(Size::Byte, t, n, m),
        Short::Ldrsb { t, n, m } => load_indexed(Size::Byte, true, t, n, m),
        Short::Ldr { t, n, m } => load_indexed(Size::Word, false, t, n, m),
        Short::Ldrh { t, n, m } => load_indexed(Size::Half, false, t, n, m),
        Short::Ldrb { t, n, m } => load_indexed(Size::Byte, false, t, n, m),
        Short::Ldrsh { t, n, m } => load_indexed(Size::Half, true, t, n, m),
        Short::StrImmediate { t, n, offset } => store(Size::Word, t, n, offset.into()),
        Short::LdrImmediate { t, n, offset } => load(Size::Word, t, n, offset.into()),
        Short::StrbImmediate { t, n, offset } => store(Size::Byte, t, n, offset.into()),
        Short::LdrbImmediate { t, n, offset } => load(Size::Byte, t, n, offset.into()),
        Short::StrhImmediate { t, n, offset } => store(Size::Half, t, n, offset.into()),
        Short::LdrhImmediate { t, n, offset } => load(Size::Half, t, n, offset.into()),
        Short::StrSp { t, offset } => store(Size::Word, t, SP_AS_BASE, i16::from(offset) * 4),
        Short::LdrSp { t, offset } => load(Size::Word, t, SP_AS_BASE, i16::from(offset) * 4),
        Short::Adr { d, offset } => Operation::Adr { d, offset: i32::from(offset) * 4 },
        Short::AddFromSp { d, offset } => add_to_sp(Alu::Add, d, offset),
        Short::AddSp { words } => add_to_sp(Alu::Add, SP_NUMBER, words),
        Short::SubSp { words } => add_to_sp(Alu::Sub, SP_NUMBER, words),
        Short::Sxth { d, m } => Operation::Extend { signed: true, size: Size::Half, d, m, rotation: 0 },
        Short::Sxtb { d, m } => Operation::Extend { signed: true, size: Size::Byte, d, m, rotation: 0 },
        Short::Uxth { d, m } => Operation::Extend { signed: false, size: Size::Half, d, m, rotation: 0 },
        Short::Uxtb { d, m } => Operation::Extend { signed: false, size: Size::Byte, d, m, rotation: 0 },
        Short::Rev { d, m } => Operation::Reverse { kind: super::operation::Reversal::Bytes, d, m },
        Short::Rev16 { d, m } => Operation::Reverse { kind: super::operation::Reversal::BytesOfHalves, d, m },
        Short::Revsh { d, m } => Operation::Reverse { kind: super::operation::Reversal::BytesOfSignedHalf, d, m },
        Short::Push { list, lr } => {
            let list = u16::from(list) | u16::from(lr) << LR;
            Operation::StoreMultiple { n: SP_AS_BASE, list, before: true, write_back: true }
        }
        Short::Pop { list, pc } => {
            let list = u16::from(list) | u16::from(pc) << PC;
            Operation::LoadMultiple { n: SP_AS_BASE, list, before: false, write_back: true }
        }
        Short::Cps { disable } => Operation::ChangeMasks { set: disable, primask: true, faultmask: false },
        Short::Bkpt => Operation::Breakpoint,
        Short::Wfe => Operation::WaitForEvent,
        Short::Wfi => Operation::WaitForInterrupt,
        Short::Sev => Operation::SendEvent,
        Short::Stm { n, list } => Operation::StoreMultiple { n, list: list.into(), before: false, write_back: true },
        Short::Ldm { n, list } => {
            Operation::LoadMultiple { n, list: list.into(), before: false, write_back: list >> n & 1 == 0 }
        }
        Short::BranchIf { condition, offset } => Operation::BranchIf { condition, offset: i32::from(offset) * 2 },
        Short::Branch { offset } => Operation::Branch { offset: i32::from(offset) * 2 },
        Short::Svc => Operation::SupervisorCall,
    }
}

const fn add_to_sp(alu: Alu, d: u8, words: u8) -> Operation {
    Operation::Immediate { alu, flags: Flags::Never, d, n: SP_NUMBER, carry: None, value: words as u32 * 4 }
}

/// Half-words that ARMv6-M does not have (§A5.2.5).
fn own(word: u16) -> Operation {
    match word {
        // CBZ, CBNZ: i and imm5.
        0xb100..=0xb1ff | 0xb300..=0xb3ff | 0xb900..=0xb9ff | 0xbb00..=0xbbff => Operation::CompareBranch {
            n: (word & 7) as u8,
            nonzero: word & 0x0800 != 0,
            offset: ((word >> 2 & 0x3e) | (word >> 3 & 0x40)) as u8,
        },
        // CPS with any masks; with none it is UNPREDICTABLE.
        0xb660..=0xb67f if word & 0xc == 0 && word & 3 != 0 => {
            Operation::ChangeMasks { set: word & 0x10 != 0, primask: word & 2 != 0, faultmask: word & 1 != 0 }
        }
        // IT. The condition 15, and 14 with anything but `t`, are UNPREDICTABLE.
        0xbf00..=0xbfff if word & 15 != 0 => {
            let (condition, mask) = (word >> 4 & 15, word & 15);
            let always_then = mask.count_ones() == 1;
            if condition == 15 || condition == 14 && !always_then {
                return Operation::Undefined;
            }
            Operation::It { state: word as u8 }
        }
        _ => Operation::Undefined,
    }
}
