//! Every opcode from random states: registers, SREG, PC, SP, memory and cycles after it, in simavr and in ours. Then every instruction of the
//! Uno's images once more, with the words that follow it there: its operand, and what a skip skips.
//!
//! Names and encodings: AVR Instruction Set Manual DS40002198, section 5. Left out:
//! - SLEEP, BREAK, SPM: they act on what is not compared here.
//! - I/O registers but GPIOR0 to GPIOR2, SPL, SPH and SREG: reading or writing others acts on peripherals.
//! - What the manual calls undefined: a pointer register as operand of its own LD, ST or LPM with increment or decrement.
//! - Addresses beyond the chip's memories.
//!
//! Where simavr 1.6 is not the manual's:
//! - SKIP: it takes some words of one-word instructions (ADIW and SBIW that end in 12 or 14) for JMP or CALL when it
//!   skips them, and JMP and CALL beyond 64 K words for one word; the manual, CPSE, SBRC, SBRS, SBIC, SBIS: a two-word
//!   instruction takes one word and one cycle more, others do not. PC and cycles alone are then ours.

use super::{Comparison, Tools};
use crate::command::{Done, Failure};
use crate::firmware;
use crate::random::Random;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

const SEED: u64 = 328;
/// Cases of each opcode.
const OF_OPCODE: usize = 2;
/// Cases of each mnemonic, at least.
const OF_MNEMONIC: usize = 400;

/// Mask, the bits under it, and the mnemonic.
const ENCODINGS: [(u16, u16, &str); 99] = [
    (0xffff, 0x0000, "NOP"),
    (0xff00, 0x0100, "MOVW"),
    (0xff00, 0x0200, "MULS"),
    (0xff88, 0x0300, "MULSU"),
    (0xff88, 0x0308, "FMUL"),
    (0xff88, 0x0380, "FMULS"),
    (0xff88, 0x0388, "FMULSU"),
    (0xfc00, 0x0400, "CPC"),
    (0xfc00, 0x0800, "SBC"),
    (0xfc00, 0x0c00, "ADD"),
    (0xfc00, 0x1000, "CPSE"),
    (0xfc00, 0x1400, "CP"),
    (0xfc00, 0x1800, "SUB"),
    (0xfc00, 0x1c00, "ADC"),
    (0xfc00, 0x2000, "AND"),
    (0xfc00, 0x2400, "EOR"),
    (0xfc00, 0x2800, "OR"),
    (0xfc00, 0x2c00, "MOV"),
    (0xf000, 0x3000, "CPI"),
    (0xf000, 0x4000, "SBCI"),
    (0xf000, 0x5000, "SUBI"),
    (0xf000, 0x6000, "ORI"),
    (0xf000, 0x7000, "ANDI"),
    (0xd208, 0x8000, "LDD Z+q"),
    (0xd208, 0x8008, "LDD Y+q"),
    (0xd208, 0x8200, "STD Z+q"),
    (0xd208, 0x8208, "STD Y+q"),
    (0xfe0f, 0x9000, "LDS"),
    (0xfe0f, 0x9001, "LD Z+"),
    (0xfe0f, 0x9002, "LD -Z"),
    (0xfe0f, 0x9004, "LPM Z"),
    (0xfe0f, 0x9005, "LPM Z+"),
    (0xfe0f, 0x9009, "LD Y+"),
    (0xfe0f, 0x900a, "LD -Y"),
    (0xfe0f, 0x900c, "LD X"),
    (0xfe0f, 0x900d, "LD X+"),
    (0xfe0f, 0x900e, "LD -X"),
    (0xfe0f, 0x900f, "POP"),
    (0xfe0f, 0x9200, "STS"),
    (0xfe0f, 0x9201, "ST Z+"),
    (0xfe0f, 0x9202, "ST -Z"),
    (0xfe0f, 0x9209, "ST Y+"),
    (0xfe0f, 0x920a, "ST -Y"),
    (0xfe0f, 0x920c, "ST X"),
    (0xfe0f, 0x920d, "ST X+"),
    (0xfe0f, 0x920e, "ST -X"),
    (0xfe0f, 0x920f, "PUSH"),
    (0xfe0f, 0x9400, "COM"),
    (0xfe0f, 0x9401, "NEG"),
    (0xfe0f, 0x9402, "SWAP"),
    (0xfe0f, 0x9403, "INC"),
    (0xfe0f, 0x9405, "ASR"),
    (0xfe0f, 0x9406, "LSR"),
    (0xfe0f, 0x9407, "ROR"),
    (0xfe0f, 0x940a, "DEC"),
    (0xff8f, 0x9408, "BSET"),
    (0xff8f, 0x9488, "BCLR"),
    (0xffff, 0x9409, "IJMP"),
    (0xffff, 0x9509, "ICALL"),
    (0xffff, 0x9508, "RET"),
    (0xffff, 0x9518, "RETI"),
    (0xffff, 0x95a8, "WDR"),
    (0xffff, 0x95c8, "LPM"),
    // A longer address would lie beyond the flash.
    (0xffff, 0x940c, "JMP"),
    (0xffff, 0x940e, "CALL"),
    (0xff00, 0x9600, "ADIW"),
    (0xff00, 0x9700, "SBIW"),
    (0xfff8, 0x98f0, "CBI"),
    (0xfff8, 0x99f0, "SBIC"),
    (0xfff8, 0x9af0, "SBI"),
    (0xfff8, 0x9bf0, "SBIS"),
    (0xfc00, 0x9c00, "MUL"),
    (0xfe0f, 0xb20e, "IN"),
    (0xfe0f, 0xb40a, "IN"),
    (0xfe0f, 0xb40b, "IN"),
    (0xfe0f, 0xb60d, "IN"),
    (0xfe0f, 0xb60e, "IN"),
    (0xfe0f, 0xb60f, "IN"),
    (0xfe0f, 0xba0e, "OUT"),
    (0xfe0f, 0xbc0a, "OUT"),
    (0xfe0f, 0xbc0b, "OUT"),
    (0xfe0f, 0xbe0d, "OUT"),
    (0xfe0f, 0xbe0e, "OUT"),
    (0xfe0f, 0xbe0f, "OUT"),
    (0xf000, 0xc000, "RJMP"),
    (0xf000, 0xd000, "RCALL"),
    (0xf000, 0xe000, "LDI"),
    (0xfc07, 0xf000, "BRBS C"),
    (0xfc07, 0xf001, "BRBS Z"),
    (0xfc04, 0xf004, "BRBS S to I"),
    (0xfc06, 0xf002, "BRBS N, V"),
    (0xfc07, 0xf400, "BRBC C"),
    (0xfc07, 0xf401, "BRBC Z"),
    (0xfc04, 0xf404, "BRBC S to I"),
    (0xfc06, 0xf402, "BRBC N, V"),
    (0xfe08, 0xf800, "BLD"),
    (0xfe08, 0xfa00, "BST"),
    (0xfe08, 0xfc00, "SBRC"),
    (0xfe08, 0xfe00, "SBRS"),
];

/// simavr's register file, I/O registers that are plain memory, SRAM.
const REGISTERS: u16 = 32;
const PLAIN_IO: [u16; 3] = [0x3e, 0x4a, 0x4b];
const SRAM_FIRST: u16 = 0x100;
const SRAM_LAST: u16 = 0x8ff;
const FLASH_WORDS: u16 = 0x4000;
/// Words of two-word instructions, for skips to jump over.
const LONG: [u16; 4] = [0x9000, 0x9200, 0x940c, 0x940e];

pub(super) fn compare(tools: &Tools) -> Done<Comparison> {
    let mut random = Random::new(SEED);
    let mut opcodes: BTreeMap<&str, Vec<u16>> = BTreeMap::new();
    for opcode in 0..=u16::MAX {
        if let Some(mnemonic) = mnemonic(opcode).filter(|mnemonic| !is_undefined(mnemonic, opcode)) {
            opcodes.entry(mnemonic).or_default().push(opcode);
        }
    }
    let mut cases = Vec::new();
    let mut input = String::new();
    for (mnemonic, opcodes) in &opcodes {
        let each = OF_OPCODE.max(OF_MNEMONIC.div_ceil(opcodes.len()));
        for &opcode in opcodes.iter().flat_map(|opcode| std::iter::repeat_n(opcode, each)) {
            let case = Case::random(mnemonic, opcode, &mut random);
            cases.push((*mnemonic, case.write(&mut input)));
        }
    }
    let mut of_images = BTreeSet::new();
    for image in firmware::PROGRAMS {
        let words = words_of(tools, image)?;
        of_images.extend(words.windows(3).map(|words| [words[0], words[1], words[2]]));
    }
    // Constants between them are compared as instructions, too, though nobody executes them.
    let before = cases.len();
    for words in of_images {
        let Some(mnemonic) = mnemonic(words[0]).filter(|mnemonic| !is_undefined(mnemonic, words[0])) else { continue };
        if is_plain(mnemonic, words[1]) {
            let case = Case { words, ..Case::random(mnemonic, words[0], &mut random) };
            cases.push((mnemonic, case.write(&mut input)));
        }
    }
    let of_images = cases.len() - before;
    let theirs = tools.ask("instructions", tools.simavr().arg("instructions"), &input)?;
    let ours = tools.ask("instructions", tools.ours().arg("instructions"), &input)?;
    let (theirs, ours): (Vec<_>, Vec<_>) = (theirs.lines().collect(), ours.lines().collect());
    if theirs.len() != cases.len() || ours.len() != cases.len() {
        let (asked, theirs, ours) = (cases.len(), theirs.len(), ours.len());
        return Err(Failure::Check(format!("{asked} instructions asked, {theirs} and {ours} answered")));
    }
    let mut differences = Vec::new();
    let mut skips = 0;
    let answers = theirs.iter().zip(&ours);
    for ((mnemonic, case), (theirs, ours)) in cases.iter().zip(answers).filter(|(_, (theirs, ours))| theirs != ours) {
        if is_misjudged_skip(mnemonic, case) && but_pc_and_cycles(theirs) == but_pc_and_cycles(ours) {
            skips += 1;
        } else {
            differences.push(format!("{mnemonic}\n    case   {case}\n    simavr {theirs}\n    ours   {ours}"));
        }
    }
    let compared = format!(
        "{} cases (seed {SEED}) of {} opcodes, {} forms of instructions; {of_images} of these with the words that follow in the Uno's {} images",
        cases.len(),
        opcodes.values().map(Vec::len).sum::<usize>(),
        opcodes.len(),
        firmware::PROGRAMS.len()
    );
    Ok(Comparison { what: "instructions, with simavr", compared, differences, exceptions: vec![("SKIP", skips)] })
}

/// The contents of the flash of one of the Uno's images.
fn words_of(tools: &Tools, image: &str) -> Done<Vec<u16>> {
    let bytes = tools.flash_of(&format!("{}/{image}.hex", firmware::IMAGES))?;
    Ok(bytes.chunks_exact(2).map(|word| u16::from_le_bytes([word[0], word[1]])).collect())
}

/// Whether both sides have memory or code at an address that is an operand in a word of its own.
fn is_plain(mnemonic: &str, operand: u16) -> bool {
    match mnemonic {
        "LDS" | "STS" => {
            operand < REGISTERS || PLAIN_IO.contains(&operand) || (SRAM_FIRST..SRAM_LAST).contains(&operand)
        }
        "JMP" | "CALL" => operand < FLASH_WORDS,
        _ => true,
    }
}

fn mnemonic(opcode: u16) -> Option<&'static str> {
    ENCODINGS.iter().find(|(mask, bits, _)| opcode & mask == *bits).map(|(_, _, mnemonic)| *mnemonic)
}

/// Whether a pointer is changed by an instruction that also uses it as operand. Source: DS40002198, LD, ST and LPM:
/// "the result is undefined".
fn is_undefined(mnemonic: &str, opcode: u16) -> bool {
    let operand = opcode >> 4 & 31;
    mnemonic.contains(['+', '-'])
        && !mnemonic.contains("+q")
        && pointer(mnemonic).is_some_and(|low| operand == low || operand == low + 1)
}

/// The low register of the pointer that an instruction of this name uses.
fn pointer(mnemonic: &str) -> Option<u16> {
    match mnemonic {
        "IJMP" | "ICALL" | "LPM" => Some(30),
        _ => mnemonic
            .split_once(' ')
            .and_then(|(name, operand)| {
                let uses = ["LD", "LDD", "ST", "STD", "LPM"].contains(&name);
                [("X", 26), ("Y", 28), ("Z", 30)].into_iter().find(|(letter, _)| uses && operand.contains(letter))
            })
            .map(|(_, low)| low),
    }
}

/// Whether simavr counts the words of a skipped instruction wrongly.
fn is_misjudged_skip(mnemonic: &str, case: &str) -> bool {
    let skips = ["CPSE", "SBRC", "SBRS", "SBIC", "SBIS"].contains(&mnemonic);
    let next = case.split(' ').nth(4).and_then(|word| u16::from_str_radix(word, 16).ok()).unwrap_or(0);
    let is_long = next & 0xfc0f == 0x9000 || next & 0xfe0c == 0x940c;
    let to_simavr = [0x9000, 0x9200, 0x940c, 0x940e].contains(&(next & 0xfc0f));
    skips && is_long != to_simavr
}

/// An answer without its first and fourth fields.
fn but_pc_and_cycles(answer: &str) -> Vec<&str> {
    answer.split(' ').enumerate().filter(|(index, _)| ![0, 3].contains(index)).map(|(_, field)| field).collect()
}

/// A state, and the words at its PC.
struct Case {
    pc: u16,
    sreg: u16,
    sp: u16,
    words: [u16; 3],
    registers: [u8; 32],
}

impl Case {
    fn random(mnemonic: &str, opcode: u16, random: &mut Random) -> Case {
        let mut registers = [0; 32];
        for register in &mut registers {
            // Values at which carry, sign and zero change come too seldom by chance.
            let corner = random.once_in(4);
            *register = if corner { random.pick(&[0, 1, 0x7f, 0x80, 0xfe, 0xff]) } else { random.next() as u8 };
        }
        let next =
            if random.once_in(3) { random.pick(&LONG) | random.below(32) << 4 & 0x1f0 } else { random.next() as u16 };
        let mut words = [opcode, next, random.next() as u16];
        match mnemonic {
            "LDS" | "STS" => words[1] = address(random, REGISTERS),
            "JMP" | "CALL" => words[1] = random.below(FLASH_WORDS),
            _ => {}
        }
        if let Some(low) = pointer(mnemonic) {
            let value = match mnemonic {
                "IJMP" | "ICALL" => random.below(FLASH_WORDS),
                "LPM" | "LPM Z" | "LPM Z+" => random.below(2 * FLASH_WORDS - 1),
                // The manual does not describe a step into the pointer itself.
                _ if mnemonic.contains('-') => address(random, 26) + 1,
                _ if mnemonic.contains("+q") => {
                    let q = opcode >> 8 & 0x20 | opcode >> 7 & 0x18 | opcode & 7;
                    let wanted = address(random, REGISTERS);
                    if wanted >= q { wanted - q } else { SRAM_FIRST + wanted }
                }
                _ => address(random, 26),
            };
            [registers[usize::from(low)], registers[usize::from(low) + 1]] = value.to_le_bytes();
        }
        if opcode & 0xfe0f == 0xbe0e {
            // SPH has no more bits than the memory needs.
            registers[usize::from(opcode >> 4 & 31)] &= 7;
        }
        let sp = loop {
            let sp = random.between(SRAM_FIRST + 0x100, SRAM_LAST - 0x10);
            // RET takes its address from memory: it must lie in the flash.
            if u16::from(pattern(sp + 1)) < FLASH_WORDS >> 8 {
                break sp;
            }
        };
        let pc = random.between(FLASH_WORDS / 4, FLASH_WORDS / 4 * 3);
        Case { pc, sreg: random.below(256), sp, words, registers }
    }

    /// Writes the state as the harnesses read it (xtask/cross-check/simavr.c), and gives it.
    fn write(&self, into: &mut String) -> String {
        let begin = into.len();
        let Case { pc, sreg, sp, words: [first, second, third], registers } = self;
        // Writing to a String cannot fail.
        let _ = write!(into, "{pc:04x} {sreg:02x} {sp:04x} {first:04x} {second:04x} {third:04x} ");
        for register in registers {
            let _ = write!(into, "{register:02x}");
        }
        let line = into[begin..].to_owned();
        into.push('\n');
        line
    }
}

/// An address of data memory that is plain memory on both sides: mostly SRAM, else a register below `registers`, or a
/// GPIOR.
fn address(random: &mut Random, registers: u16) -> u16 {
    match random.below(8) {
        0 => random.below(registers),
        1 => random.pick(&PLAIN_IO),
        _ => random.between(SRAM_FIRST, SRAM_LAST),
    }
}

/// What both harnesses fill memory with.
fn pattern(address: u16) -> u8 {
    (u32::from(address).wrapping_mul(0x9e37_79b1) >> 24) as u8
}
