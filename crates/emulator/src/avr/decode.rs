//! The decoder: words of program memory to instructions (AVR instruction set manual DS40002198).
//!
//! Every word has a meaning here: a word that is no instruction of the ATmega328P becomes [`Op::Undefined`]. What
//! instructions do is in `cpu`.

/// One instruction with its operands. Registers are numbers 0 to 31, I/O addresses those of `in` and `out`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Op {
    Nop,
    Undefined,
    Movw {
        d: u8,
        r: u8,
    },
    Muls {
        d: u8,
        r: u8,
    },
    Mulsu {
        d: u8,
        r: u8,
    },
    Fmul {
        d: u8,
        r: u8,
    },
    Fmuls {
        d: u8,
        r: u8,
    },
    Fmulsu {
        d: u8,
        r: u8,
    },
    Mul {
        d: u8,
        r: u8,
    },
    Cpc {
        d: u8,
        r: u8,
    },
    Sbc {
        d: u8,
        r: u8,
    },
    Add {
        d: u8,
        r: u8,
    },
    Cpse {
        d: u8,
        r: u8,
    },
    Cp {
        d: u8,
        r: u8,
    },
    Sub {
        d: u8,
        r: u8,
    },
    Adc {
        d: u8,
        r: u8,
    },
    And {
        d: u8,
        r: u8,
    },
    Eor {
        d: u8,
        r: u8,
    },
    Or {
        d: u8,
        r: u8,
    },
    Mov {
        d: u8,
        r: u8,
    },
    Cpi {
        d: u8,
        k: u8,
    },
    Sbci {
        d: u8,
        k: u8,
    },
    Subi {
        d: u8,
        k: u8,
    },
    Ori {
        d: u8,
        k: u8,
    },
    Andi {
        d: u8,
        k: u8,
    },
    Ldi {
        d: u8,
        k: u8,
    },
    /// Load from Y (`r` 28) or Z (30) plus `q`.
    Ldd {
        d: u8,
        r: u8,
        q: u8,
    },
    Std {
        d: u8,
        r: u8,
        q: u8,
    },
    /// Load through X, Y or Z, with the pointer's decrement before it or increment after it.
    Ld {
        d: u8,
        r: u8,
        step: Step,
    },
    St {
        d: u8,
        r: u8,
        step: Step,
    },
    Lds {
        d: u8,
        address: u16,
    },
    Sts {
        d: u8,
        address: u16,
    },
    Lpm {
        d: u8,
        increment: bool,
    },
    Push {
        d: u8,
    },
    Pop {
        d: u8,
    },
    Com {
        d: u8,
    },
    Neg {
        d: u8,
    },
    Swap {
        d: u8,
    },
    Inc {
        d: u8,
    },
    Dec {
        d: u8,
    },
    Asr {
        d: u8,
    },
    Lsr {
        d: u8,
    },
    Ror {
        d: u8,
    },
    Bset {
        s: u8,
    },
    Bclr {
        s: u8,
    },
    Bst {
        d: u8,
        b: u8,
    },
    Bld {
        d: u8,
        b: u8,
    },
    Adiw {
        d: u8,
        k: u8,
    },
    Sbiw {
        d: u8,
        k: u8,
    },
    In {
        d: u8,
        a: u8,
    },
    Out {
        d: u8,
        a: u8,
    },
    Cbi {
        a: u8,
        b: u8,
    },
    Sbi {
        a: u8,
        b: u8,
    },
    Sbic {
        a: u8,
        b: u8,
    },
    Sbis {
        a: u8,
        b: u8,
    },
    Sbrc {
        d: u8,
        b: u8,
    },
    Sbrs {
        d: u8,
        b: u8,
    },
    Rjmp {
        k: i16,
    },
    Rcall {
        k: i16,
    },
    Jmp {
        address: u16,
    },
    Call {
        address: u16,
    },
    Ijmp,
    Icall,
    Ret,
    Reti,
    Brbs {
        s: u8,
        k: i8,
    },
    Brbc {
        s: u8,
        k: i8,
    },
    Sleep,
    Break,
    Wdr,
    Spm,
}

/// How an indirect access changes its pointer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    Keep,
    Increment,
    Decrement,
}

impl Op {
    /// Whether the instruction takes two words.
    pub(super) const fn is_long(self) -> bool {
        matches!(self, Op::Lds { .. } | Op::Sts { .. } | Op::Jmp { .. } | Op::Call { .. })
    }
}

/// Decodes a word. `next` is the word after it, the second half of a long instruction.
pub(super) const fn decode(word: u16, next: u16) -> Op {
    // Fields that most instructions share.
    let d = ((word >> 4) & 31) as u8;
    let r = ((word & 15) | ((word >> 5) & 16)) as u8;
    let high = 16 + ((word >> 4) & 15) as u8;
    let k = ((word & 15) | ((word >> 4) & 0xf0)) as u8;
    match word >> 12 {
        0x0 => match (word >> 10) & 3 {
            0 => match (word >> 8) & 3 {
                0 if word == 0 => Op::Nop,
                0 => Op::Undefined,
                1 => Op::Movw { d: ((word >> 4) & 15) as u8 * 2, r: (word & 15) as u8 * 2 },
                2 => Op::Muls { d: high, r: 16 + (word & 15) as u8 },
                _ => {
                    let (d, r) = (16 + ((word >> 4) & 7) as u8, 16 + (word & 7) as u8);
                    match word & 0x88 {
                        0x00 => Op::Mulsu { d, r },
                        0x08 => Op::Fmul { d, r },
                        0x80 => Op::Fmuls { d, r },
                        _ => Op::Fmulsu { d, r },
                    }
                }
            },
            1 => Op::Cpc { d, r },
            2 => Op::Sbc { d, r },
            _ => Op::Add { d, r },
        },
        0x1 => match (word >> 10) & 3 {
            0 => Op::Cpse { d, r },
            1 => Op::Cp { d, r },
            2 => Op::Sub { d, r },
            _ => Op::Adc { d, r },
        },
        0x2 => match (word >> 10) & 3 {
            0 => Op::And { d, r },
            1 => Op::Eor { d, r },
            2 => Op::Or { d, r },
            _ => Op::Mov { d, r },
        },
        0x3 => Op::Cpi { d: high, k },
        0x4 => Op::Sbci { d: high, k },
        0x5 => Op::Subi { d: high, k },
        0x6 => Op::Ori { d: high, k },
        0x7 => Op::Andi { d: high, k },
        0x8 | 0xa => {
            let q = ((word & 7) | ((word >> 7) & 0x18) | ((word >> 8) & 0x20)) as u8;
            let r = if word & 8 == 0 { 30 } else { 28 };
            if word & 0x200 == 0 { Op::Ldd { d, r, q } } else { Op::Std { d, r, q } }
        }
        0x9 => nine(word, next, d, r),
        0xb => {
            let a = ((word & 15) | ((word >> 5) & 0x30)) as u8;
            if word & 0x800 == 0 { Op::In { d, a } } else { Op::Out { d, a } }
        }
        // The 12 bits are signed.
        0xc => Op::Rjmp { k: ((word << 4) as i16) >> 4 },
        0xd => Op::Rcall { k: ((word << 4) as i16) >> 4 },
        0xe => Op::Ldi { d: high, k },
        _ => {
            let b = (word & 7) as u8;
            let k = (((word >> 3) & 0x7f) as i8) << 1 >> 1;
            match (word >> 9) & 7 {
                0 | 1 => Op::Brbs { s: b, k },
                2 | 3 => Op::Brbc { s: b, k },
                _ if word & 8 != 0 => Op::Undefined,
                4 => Op::Bld { d, b },
                5 => Op::Bst { d, b },
                6 => Op::Sbrc { d, b },
                _ => Op::Sbrs { d, b },
            }
        }
    }
}

/// Words whose upper four bits are 9: loads and stores, one-operand arithmetic, I/O bits, long jumps.
const fn nine(word: u16, next: u16, d: u8, r: u8) -> Op {
    let (io, bit) = (((word >> 3) & 31) as u8, (word & 7) as u8);
    let wide = (((word & 15) | ((word >> 2) & 0x30)) as u8, 24 + ((word >> 4) & 3) as u8 * 2);
    match (word >> 8) & 15 {
        0 | 1 => match word & 15 {
            0x0 => Op::Lds { d, address: next },
            0x1 => Op::Ld { d, r: 30, step: Step::Increment },
            0x2 => Op::Ld { d, r: 30, step: Step::Decrement },
            0x4 => Op::Lpm { d, increment: false },
            0x5 => Op::Lpm { d, increment: true },
            0x9 => Op::Ld { d, r: 28, step: Step::Increment },
            0xa => Op::Ld { d, r: 28, step: Step::Decrement },
            0xc => Op::Ld { d, r: 26, step: Step::Keep },
            0xd => Op::Ld { d, r: 26, step: Step::Increment },
            0xe => Op::Ld { d, r: 26, step: Step::Decrement },
            0xf => Op::Pop { d },
            _ => Op::Undefined,
        },
        2 | 3 => match word & 15 {
            0x0 => Op::Sts { d, address: next },
            0x1 => Op::St { d, r: 30, step: Step::Increment },
            0x2 => Op::St { d, r: 30, step: Step::Decrement },
            0x9 => Op::St { d, r: 28, step: Step::Increment },
            0xa => Op::St { d, r: 28, step: Step::Decrement },
            0xc => Op::St { d, r: 26, step: Step::Keep },
            0xd => Op::St { d, r: 26, step: Step::Increment },
            0xe => Op::St { d, r: 26, step: Step::Decrement },
            0xf => Op::Push { d },
            _ => Op::Undefined,
        },
        4 | 5 => match word & 15 {
            0x0 => Op::Com { d },
            0x1 => Op::Neg { d },
            0x2 => Op::Swap { d },
            0x3 => Op::Inc { d },
            0x5 => Op::Asr { d },
            0x6 => Op::Lsr { d },
            0x7 => Op::Ror { d },
            0xa => Op::Dec { d },
            // The address bits in the first word are for chips with more than 32 KB of flash; program memory is
            // addressed modulo its size.
            0xc | 0xd => Op::Jmp { address: next },
            0xe | 0xf => Op::Call { address: next },
            0x8 if word & 0x100 == 0 => {
                let s = d & 7;
                if word & 0x80 == 0 { Op::Bset { s } } else { Op::Bclr { s } }
            }
            _ => match word {
                0x9409 => Op::Ijmp,
                0x9508 => Op::Ret,
                0x9509 => Op::Icall,
                0x9518 => Op::Reti,
                0x9588 => Op::Sleep,
                0x9598 => Op::Break,
                0x95a8 => Op::Wdr,
                0x95c8 => Op::Lpm { d: 0, increment: false },
                0x95e8 => Op::Spm,
                _ => Op::Undefined,
            },
        },
        6 => Op::Adiw { d: wide.1, k: wide.0 },
        7 => Op::Sbiw { d: wide.1, k: wide.0 },
        8 => Op::Cbi { a: io, b: bit },
        9 => Op::Sbic { a: io, b: bit },
        10 => Op::Sbi { a: io, b: bit },
        11 => Op::Sbis { a: io, b: bit },
        _ => Op::Mul { d, r },
    }
}
