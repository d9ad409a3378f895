//! ARMv7-M in Unicorn's Cortex-M3 and in ours: every half-word of 16-bit instructions, every form of 32-bit instructions
//! and blocks after IT, from random states; registers, flags, masks and memory compared. Unicorn counts no cycles. And
//! a program of exceptions in QEMU and in ours.
//!
//! Left out:
//! - what acts on more than is compared here: `svc`, `bkpt`, `udf`, `wfi`, `wfe`, `sev`
//! - what the manual (ARM DDI 0403E) calls UNPREDICTABLE; [`Rule`] says what that is in each form
//! - `bxns` and `blxns`, which a Cortex-M3 does not have
//!
//! Where an access finds no memory, or a branch goes where no code can be, both must fault. Named exceptions: STACK and BLOCK
//! are explained in xtask/cross-check/unicorn_m3.py. ALIGN: Unicorn makes accesses of several words, and exclusive ones, at
//! addresses where the manual has them fault (§A3.2.1).

use super::{Comparison, Tools};
use crate::command::{self, Done, Failure};
use crate::random::Random;

const SEED: u64 = 403;
/// Cases of each 16-bit instruction, and of those that compute with two registers.
const OF_NARROW: usize = 1;
const OF_ARITHMETIC: usize = 4;
/// Cases of each form of 32-bit instructions, and of blocks after IT.
const OF_FORM: usize = 100;
const OF_BLOCKS: usize = 4000;
/// Addresses that cases use: words of RAM from here on, behind the code.
const LOWEST: u32 = 0x2001_0000;
const WORDS: u16 = 0x4000;
const NOP: u16 = 0xbf00;

/// What must hold for the fields of a form, or the manual calls it UNPREDICTABLE.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Rule {
    Any,
    /// `i`: a byte that is repeated is not 0.
    Repeated,
    /// `i`: not 0.
    NotZero,
    /// The condition `c` is below 14.
    Condition,
    /// `n` is none of `t` and `u`; `t` is not `u`.
    Apart,
    /// A list `l` of at least two registers, without `n` in it and not with both LR and PC.
    List,
    /// A field from bit `i` on of `w` + 1 bits ends within the word.
    Within,
    /// The highest bit `w` of a field is not below its lowest, `i`.
    Ordered,
    /// `n` and `m` are the same.
    Same,
}

use Rule::{Any, Apart, Condition, List, NotZero, Ordered, Repeated, Same, Within};

/// Forms of 32-bit instructions as the manual prints them (chapter A7). `d`, `n`, `m`, `t`, `u`, `a` are registers that
/// are neither SP nor PC; other letters are any bits.
const FORMS: &[(&str, &str, Rule)] = &[
    ("11101010000 S nnnn 0 iii dddd ii kk mmmm", "and", Any),
    ("11101010000 1 nnnn 0 iii 1111 ii kk mmmm", "tst", Any),
    ("11101010001 S nnnn 0 iii dddd ii kk mmmm", "bic", Any),
    ("11101010010 S nnnn 0 iii dddd ii kk mmmm", "orr", Any),
    ("11101010010 S 1111 0 iii dddd ii kk mmmm", "mov, shifts by a value", Any),
    ("11101010010 0 1111 0 000 1101 00 00 mmmm", "mov to SP", Any),
    ("11101010010 0 1111 0 000 dddd 00 00 1101", "mov from SP", Any),
    ("11101010011 S nnnn 0 iii dddd ii kk mmmm", "orn", Any),
    ("11101010011 S 1111 0 iii dddd ii kk mmmm", "mvn", Any),
    ("11101010100 S nnnn 0 iii dddd ii kk mmmm", "eor", Any),
    ("11101010100 1 nnnn 0 iii 1111 ii kk mmmm", "teq", Any),
    ("11101011000 S nnnn 0 iii dddd ii kk mmmm", "add", Any),
    ("11101011000 S 1101 0 iii dddd ii kk mmmm", "add from SP", Any),
    ("11101011000 S 1101 0 000 1101 kk 00 mmmm", "add to SP", Any),
    ("11101011000 1 nnnn 0 iii 1111 ii kk mmmm", "cmn", Any),
    ("11101011010 S nnnn 0 iii dddd ii kk mmmm", "adc", Any),
    ("11101011011 S nnnn 0 iii dddd ii kk mmmm", "sbc", Any),
    ("11101011101 S nnnn 0 iii dddd ii kk mmmm", "sub", Any),
    ("11101011101 S 1101 0 iii dddd ii kk mmmm", "sub from SP", Any),
    ("11101011101 S 1101 0 000 1101 kk 00 mmmm", "sub to SP", Any),
    ("11101011101 1 nnnn 0 iii 1111 ii kk mmmm", "cmp", Any),
    ("11101011110 S nnnn 0 iii dddd ii kk mmmm", "rsb", Any),
    ("11110 i 00000 S nnnn 0 iii dddd iiiiiiii", "and value", Repeated),
    ("11110 i 00000 1 nnnn 0 iii 1111 iiiiiiii", "tst value", Repeated),
    ("11110 i 00001 S nnnn 0 iii dddd iiiiiiii", "bic value", Repeated),
    ("11110 i 00010 S nnnn 0 iii dddd iiiiiiii", "orr value", Repeated),
    ("11110 i 00010 S 1111 0 iii dddd iiiiiiii", "mov value", Repeated),
    ("11110 i 00011 S nnnn 0 iii dddd iiiiiiii", "orn value", Repeated),
    ("11110 i 00011 S 1111 0 iii dddd iiiiiiii", "mvn value", Repeated),
    ("11110 i 00100 S nnnn 0 iii dddd iiiiiiii", "eor value", Repeated),
    ("11110 i 00100 1 nnnn 0 iii 1111 iiiiiiii", "teq value", Repeated),
    ("11110 i 01000 S nnnn 0 iii dddd iiiiiiii", "add value", Repeated),
    ("11110 i 01000 S 1101 0 iii dddd iiiiiiii", "add value from SP", Repeated),
    ("11110 i 01000 S 1101 0 iii 1101 iiiiiiii", "add value to SP", Repeated),
    ("11110 i 01000 1 nnnn 0 iii 1111 iiiiiiii", "cmn value", Repeated),
    ("11110 i 01010 S nnnn 0 iii dddd iiiiiiii", "adc value", Repeated),
    ("11110 i 01011 S nnnn 0 iii dddd iiiiiiii", "sbc value", Repeated),
    ("11110 i 01101 S nnnn 0 iii dddd iiiiiiii", "sub value", Repeated),
    ("11110 i 01101 S 1101 0 iii dddd iiiiiiii", "sub value from SP", Repeated),
    ("11110 i 01101 S 1101 0 iii 1101 iiiiiiii", "sub value to SP", Repeated),
    ("11110 i 01101 1 nnnn 0 iii 1111 iiiiiiii", "cmp value", Repeated),
    ("11110 i 01110 S nnnn 0 iii dddd iiiiiiii", "rsb value", Repeated),
    ("11110 i 10000 0 nnnn 0 iii dddd iiiiiiii", "addw", Any),
    ("11110 i 10000 0 1101 0 iii 1101 iiiiiiii", "addw to SP", Any),
    ("11110 i 10000 0 1111 0 iii dddd iiiiiiii", "adr", Any),
    ("11110 i 10010 0 iiii 0 iii dddd iiiiiiii", "movw", Any),
    ("11110 i 10101 0 nnnn 0 iii dddd iiiiiiii", "subw", Any),
    ("11110 i 10101 0 1101 0 iii 1101 iiiiiiii", "subw to SP", Any),
    ("11110 i 10101 0 1111 0 iii dddd iiiiiiii", "adr, backwards", Any),
    ("11110 i 10110 0 iiii 0 iii dddd iiiiiiii", "movt", Any),
    ("11110 0 11000 0 nnnn 0 iii dddd ii 0 wwwww", "ssat", Any),
    ("11110 0 11001 0 nnnn 0 iii dddd ii 0 wwwww", "ssat, asr", NotZero),
    ("11110 0 11010 0 nnnn 0 iii dddd ii 0 wwwww", "sbfx", Within),
    ("11110 0 11011 0 nnnn 0 iii dddd ii 0 wwwww", "bfi", Ordered),
    ("11110 0 11011 0 1111 0 iii dddd ii 0 wwwww", "bfc", Ordered),
    ("11110 0 11100 0 nnnn 0 iii dddd ii 0 wwwww", "usat", Any),
    ("11110 0 11101 0 nnnn 0 iii dddd ii 0 wwwww", "usat, asr", NotZero),
    ("11110 0 11110 0 nnnn 0 iii dddd ii 0 wwwww", "ubfx", Within),
    ("11110 i cccc iiiiii 10 i 0 i iiiiiiiiiii", "b, if", Condition),
    ("11110 iiiiiiiiiii 10 i 1 i iiiiiiiiiii", "b", Any),
    ("11110 iiiiiiiiiii 11 i 1 i iiiiiiiiiii", "bl", Any),
    ("11110011100 0 nnnn 1000 1000 00000000", "msr apsr", Any),
    ("11110011100 0 nnnn 1000 1000 00001000", "msr msp", Any),
    ("11110011100 0 nnnn 1000 1000 00001001", "msr psp", Any),
    ("11110011100 0 nnnn 1000 1000 00010000", "msr primask", Any),
    ("11110011100 0 nnnn 1000 1000 00010001", "msr basepri", Any),
    ("11110011100 0 nnnn 1000 1000 00010010", "msr basepri_max", Any),
    ("11110011100 0 nnnn 1000 1000 00010011", "msr faultmask", Any),
    ("11110011111 0 1111 1000 dddd 0000000i", "mrs xpsr", Any),
    ("11110011111 0 1111 1000 dddd 0000100i", "mrs msp, psp", Any),
    ("11110011111 0 1111 1000 dddd 00010000", "mrs primask", Any),
    ("11110011111 0 1111 1000 dddd 00010001", "mrs basepri", Any),
    ("11110011111 0 1111 1000 dddd 00010011", "mrs faultmask", Any),
    ("11110011111 0 1111 1000 dddd 00010100", "mrs control", Any),
    ("1111001110111111 1000111100101111", "clrex", Any),
    ("1111001110111111 100011110100iiii", "dsb", Any),
    ("1111001110111111 100011110101iiii", "dmb", Any),
    ("1111001110111111 1000111101101111", "isb", Any),
    ("1111001110101111 1000000000000000", "nop", Any),
    ("1110100 01 0 W 0 nnnn 0 l 0 lllllllllllll", "stm", List),
    ("1110100 10 0 W 0 nnnn 0 l 0 lllllllllllll", "stmdb", List),
    ("1110100 01 0 W 1 nnnn l l 0 lllllllllllll", "ldm", List),
    ("1110100 10 0 W 1 nnnn l l 0 lllllllllllll", "ldmdb", List),
    ("1110100 10 0 1 0 1101 0 l 0 lllllllllllll", "push", List),
    ("1110100 01 0 1 1 1101 l l 0 lllllllllllll", "pop", List),
    ("1110100 1 U 1 0 0 nnnn tttt uuuu iiiiiiii", "strd", Apart),
    ("1110100 1 U 1 1 0 nnnn tttt uuuu iiiiiiii", "strd, before", Apart),
    ("1110100 0 U 1 1 0 nnnn tttt uuuu iiiiiiii", "strd, after", Apart),
    ("1110100 1 U 1 0 0 1101 tttt uuuu iiiiiiii", "strd from SP", Apart),
    ("1110100 1 U 1 0 1 nnnn tttt uuuu iiiiiiii", "ldrd", Apart),
    ("1110100 1 U 1 1 1 nnnn tttt uuuu iiiiiiii", "ldrd, before", Apart),
    ("1110100 0 U 1 1 1 nnnn tttt uuuu iiiiiiii", "ldrd, after", Apart),
    ("1110100 1 U 1 0 1 1111 tttt uuuu iiiiiiii", "ldrd from PC", Apart),
    ("111010000101 nnnn tttt 1111 iiiiiiii", "ldrex", Any),
    ("111010001101 nnnn tttt 1111 0100 1111", "ldrexb", Any),
    ("111010001101 nnnn tttt 1111 0101 1111", "ldrexh", Any),
    ("111010001101 nnnn 1111 0000 0000 mmmm", "tbb", Any),
    ("111010001101 1111 1111 0000 0000 mmmm", "tbb from PC", Any),
    ("111010001101 nnnn 1111 0000 0001 mmmm", "tbh", Any),
    ("111010001101 1111 1111 0000 0001 mmmm", "tbh from PC", Any),
    ("111110001000 nnnn tttt iiiiiiiiiiii", "strb", Any),
    ("111110001010 nnnn tttt iiiiiiiiiiii", "strh", Any),
    ("111110001100 nnnn tttt iiiiiiiiiiii", "str", Any),
    ("111110001100 1101 tttt iiiiiiiiiiii", "str from SP", Any),
    ("111110000000 nnnn tttt 1 P U 1 iiiiiiii", "strb, indexed", Apart),
    ("111110000010 nnnn tttt 1 P U 1 iiiiiiii", "strh, indexed", Apart),
    ("111110000100 nnnn tttt 1 P U 1 iiiiiiii", "str, indexed", Apart),
    ("111110000100 1101 tttt 1 1 0 1 00000100", "push one", Any),
    ("111110000 kk 0 nnnn tttt 1 1 0 0 iiiiiiii", "str, below", Any),
    ("111110000000 nnnn tttt 000000 kk mmmm", "strb, two registers", Any),
    ("111110000010 nnnn tttt 000000 kk mmmm", "strh, two registers", Any),
    ("111110000100 nnnn tttt 000000 kk mmmm", "str, two registers", Any),
    ("111110000100 nnnn tttt 1110 iiiiiiii", "strt", Any),
    ("111110001001 nnnn tttt iiiiiiiiiiii", "ldrb", Any),
    ("111110001011 nnnn tttt iiiiiiiiiiii", "ldrh", Any),
    ("111110001101 nnnn tttt iiiiiiiiiiii", "ldr", Any),
    ("111110001101 1101 tttt iiiiiiiiiiii", "ldr from SP", Any),
    ("111110011001 nnnn tttt iiiiiiiiiiii", "ldrsb", Any),
    ("111110011011 nnnn tttt iiiiiiiiiiii", "ldrsh", Any),
    ("111110000001 nnnn tttt 1 P U 1 iiiiiiii", "ldrb, indexed", Apart),
    ("111110000011 nnnn tttt 1 P U 1 iiiiiiii", "ldrh, indexed", Apart),
    ("111110000101 nnnn tttt 1 P U 1 iiiiiiii", "ldr, indexed", Apart),
    ("111110010001 nnnn tttt 1 P U 1 iiiiiiii", "ldrsb, indexed", Apart),
    ("111110010011 nnnn tttt 1 P U 1 iiiiiiii", "ldrsh, indexed", Apart),
    ("111110000101 1101 tttt 1 0 1 1 00000100", "pop one", Any),
    ("111110000101 nnnn tttt 1 1 0 0 iiiiiiii", "ldr, below", Any),
    ("111110010001 nnnn tttt 1 1 0 0 iiiiiiii", "ldrsb, below", Any),
    ("111110000101 nnnn tttt 1110 iiiiiiii", "ldrt", Any),
    ("111110000001 nnnn tttt 000000 kk mmmm", "ldrb, two registers", Any),
    ("111110000011 nnnn tttt 000000 kk mmmm", "ldrh, two registers", Any),
    ("111110000101 nnnn tttt 000000 kk mmmm", "ldr, two registers", Any),
    ("111110010001 nnnn tttt 000000 kk mmmm", "ldrsb, two registers", Any),
    ("111110010011 nnnn tttt 000000 kk mmmm", "ldrsh, two registers", Any),
    ("11111000 U 101 1111 tttt iiiiiiiiiiii", "ldr from PC", Any),
    ("11111000 U 001 1111 tttt iiiiiiiiiiii", "ldrb from PC", Any),
    ("11111000 U 011 1111 tttt iiiiiiiiiiii", "ldrh from PC", Any),
    ("11111001 U 001 1111 tttt iiiiiiiiiiii", "ldrsb from PC", Any),
    ("11111001 U 011 1111 tttt iiiiiiiiiiii", "ldrsh from PC", Any),
    ("111110001001 nnnn 1111 iiiiiiiiiiii", "pld", Any),
    ("111110011001 nnnn 1111 iiiiiiiiiiii", "pli", Any),
    ("111110100 kk S nnnn 1111 dddd 0000 mmmm", "shifts by a register", Any),
    ("111110100 00 S 1111 1111 dddd 10 kk mmmm", "sxth, uxth", Any),
    ("111110100 10 S 1111 1111 dddd 10 kk mmmm", "sxtb, uxtb", Any),
    ("111110101001 nnnn 1111 dddd 10 kk mmmm", "rev, rev16, rbit, revsh", Same),
    ("111110101011 nnnn 1111 dddd 1000 mmmm", "clz", Same),
    ("111110110000 nnnn aaaa dddd 0000 mmmm", "mla", Any),
    ("111110110000 nnnn 1111 dddd 0000 mmmm", "mul", Any),
    ("111110110000 nnnn aaaa dddd 0001 mmmm", "mls", Any),
    ("111110111000 nnnn tttt uuuu 0000 mmmm", "smull", Apart),
    ("111110111010 nnnn tttt uuuu 0000 mmmm", "umull", Apart),
    ("111110111100 nnnn tttt uuuu 0000 mmmm", "smlal", Apart),
    ("111110111110 nnnn tttt uuuu 0000 mmmm", "umlal", Apart),
    ("111110111001 nnnn 1111 dddd 1111 mmmm", "sdiv", Any),
    ("111110111011 nnnn 1111 dddd 1111 mmmm", "udiv", Any),
];

/// Exclusive loads, and the stores that follow them with the same `n` and `i`.
const EXCLUSIVE: &[(&str, &str)] = &[
    ("111010000101 nnnn tttt 1111 iiiiiiii", "111010000100 nnnn tttt dddd iiiiiiii"),
    ("111010001101 nnnn tttt 1111 0100 1111", "111010001100 nnnn tttt 1111 0100 dddd"),
    ("111010001101 nnnn tttt 1111 0101 1111", "111010001100 nnnn tttt 1111 0101 dddd"),
];

/// Instructions that load the program counter from the register 2 (or the stack pointer) and an offset.
const LOADED_JUMPS: &[(&str, u32)] = &[
    ("111110001101 0010 1111 000000010000", 16),
    ("111110000101 0010 1111 1 1 1 1 00010000", 16),
    ("111110000101 0010 1111 1 0 1 1 00010000", 0),
    ("111110000101 0010 1111 1 1 0 0 00010000", 0xffff_fff0),
    ("111110000101 0010 1111 000000 00 0011", 8),
    ("111110001101 1111 1111 000000010100", 0),
    ("1110100 01 0 0 1 0010 1 0 0 0000000001011", 12),
    ("1110100 10 0 1 1 0010 1 0 0 0000000001011", 0xffff_fffc),
    ("1110100 01 0 1 1 1101 1 0 0 0000000000011", 8),
    ("1011110100000011 1011111100000000", 8),
];

/// The instruction of a pattern with these values of its letters.
fn word(pattern: &str, mut letters: [u32; 128]) -> [u16; 2] {
    let (mut word, mut places) = (0, 0);
    for c in pattern.bytes().rev().filter(|c| *c != b' ') {
        let bit = match c {
            b'0' | b'1' => u32::from(c - b'0'),
            letter => {
                let value = &mut letters[usize::from(letter)];
                let bit = *value & 1;
                *value >>= 1;
                bit
            }
        };
        word |= bit << places;
        places += 1;
    }
    assert_eq!(places, 32, "{pattern}");
    [(word >> 16) as u16, word as u16]
}

/// Random values of all letters.
fn letters(random: &mut Random) -> [u32; 128] {
    std::array::from_fn(|letter| match letter as u8 {
        b'd' | b'n' | b'm' | b't' | b'u' | b'a' => {
            let register = random.below(14);
            u32::from(if register == 13 { 14 } else { register })
        }
        _ => random.next() as u32,
    })
}

/// A form with random fields that its rule allows.
fn filled(pattern: &str, rule: Rule, random: &mut Random) -> [u16; 2] {
    let width = |letter: char| pattern.chars().filter(|c| *c == letter).count() as u32;
    loop {
        let mut values = letters(random);
        for letter in ['i', 'c', 'w', 'l'] {
            values[letter as usize] &= ((1u64 << width(letter)) - 1) as u32;
        }
        if rule == Same {
            values[usize::from(b'n')] = values[usize::from(b'm')];
        }
        let value = |letter: char| values[letter as usize];
        // The list without its bit 13, which is fixed.
        let list = value('l') & 0x1fff | (value('l') >> 13) << 14;
        let is_in_list = width('n') > 0 && list >> value('n') & 1 != 0;
        let allowed = match rule {
            Any | Same => true,
            Repeated => !(1..=3).contains(&(value('i') >> 8)) || value('i') & 0xff != 0,
            NotZero => value('i') != 0,
            Condition => value('c') < 14,
            Apart => {
                let u = if width('u') > 0 { value('u') } else { 16 };
                value('t') != u && (width('n') == 0 || value('n') != value('t') && value('n') != u)
            }
            List => list.count_ones() >= 2 && !is_in_list && list >> 14 != 3,
            Within => value('i') + value('w') < 32,
            Ordered => value('w') >= value('i'),
        };
        if allowed {
            return word(pattern, values);
        }
    }
}

/// The cases, each with the name of its form.
fn cases(random: &mut Random) -> Vec<(&'static str, String)> {
    let mut cases = Vec::new();
    for word in (0..0xe800_u16).filter(|word| is_compared(*word)) {
        let times = if (0x4000..0x4400).contains(&word) { OF_ARITHMETIC } else { OF_NARROW };
        for _ in 0..times {
            cases.push(("a 16-bit instruction", case(1, &[word], random)));
        }
    }
    for (pattern, name, rule) in FORMS {
        for _ in 0..OF_FORM {
            let code = filled(pattern, *rule, random);
            cases.push((*name, case(1, &code, random)));
        }
    }
    for (pattern, offset) in LOADED_JUMPS {
        for _ in 0..OF_FORM {
            cases.push(("a jump to what is loaded", loaded_jump(pattern, *offset, random)));
        }
    }
    for (load, store) in EXCLUSIVE {
        for _ in 0..OF_FORM {
            cases.push(("strex after ldrex", exclusive(load, store, random)));
        }
    }
    for _ in 0..OF_BLOCKS {
        cases.push(("a block after it", block(random)));
    }
    cases
}

pub(super) fn instructions(tools: &Tools) -> Done<Comparison> {
    let cases = cases(&mut Random::new(SEED));
    let input: String = cases.iter().map(|(_, case)| case.as_str()).collect();
    let ours = tools.ask("thumb2", tools.ours_arm().arg("m3"), &input)?;
    let theirs = tools.ask("thumb2", &mut tools.unicorn()?, &input)?;
    judge(&cases, &ours, &theirs)
}

/// A program that pends, masks and faults at random, and prints each exception with what its handler sees: the order is
/// compared with QEMU's.
pub(super) fn exceptions(tools: &Tools) -> Done<Comparison> {
    let image = tools.compile_arm("exceptions")?;
    let ours = command::output(tools.ours_arm().arg("exceptions").arg(&image))?;
    let theirs = command::output(&mut tools.qemu(&image))?;
    let (ours, theirs): (Vec<_>, Vec<_>) = (ours.lines().collect(), theirs.lines().collect());
    let mut differences = Vec::new();
    if ours.len() != theirs.len() {
        differences.push(format!("{} lines of QEMU, {} of ours", theirs.len(), ours.len()));
    }
    let pairs = ours.iter().zip(&theirs).filter(|(ours, theirs)| ours != theirs);
    differences.extend(pairs.map(|(ours, theirs)| format!("\n  QEMU {theirs}\n  ours {ours}")));
    let entered: usize = ours.iter().map(|line| line.matches('[').count()).sum();
    let compared = format!(
        "{} rounds of random priorities, masks and faults, {entered} exceptions in their order",
        ours.len() - 1
    );
    Ok(Comparison { what: "ARMv7-M exceptions, with QEMU", compared, differences, exceptions: Vec::new() })
}

/// Compares what both sides have answered.
fn judge(cases: &[(&str, String)], ours: &str, theirs: &str) -> Done<Comparison> {
    let (ours, mut theirs): (Vec<_>, Vec<_>) = (ours.lines().collect(), theirs.lines().collect());
    let met = theirs.pop().and_then(|last| last.strip_prefix("met "));
    let times =
        |name: &str| met?.split(' ').find_map(|field| field.strip_prefix(name)?.strip_prefix('=')?.parse().ok());
    let (Some(stack), Some(block)) = (times("STACK"), times("BLOCK")) else {
        return Err(Failure::Check("unicorn_m3.py did not say what it met".into()));
    };
    if ours.len() != cases.len() || theirs.len() != cases.len() {
        let counts = format!("{} cases asked, {} and {} answered", cases.len(), ours.len(), theirs.len());
        return Err(Failure::Check(counts));
    }
    let mut differences = Vec::new();
    let (mut faults, mut unaligned) = (0, 0);
    let mut executed = std::collections::BTreeMap::new();
    for (((name, case), ours), theirs) in cases.iter().zip(&ours).zip(&theirs) {
        let executed = executed.entry(*name).or_insert(0);
        let both_fault = *theirs == "fault" && ["fault", "unaligned"].contains(ours);
        if both_fault {
            faults += 1;
        } else if *ours == "unaligned" {
            unaligned += 1;
        } else if ours != theirs {
            differences.push(format!("{name}, case {}\n  Unicorn {theirs}\n  ours    {ours}", case.trim()));
        } else {
            *executed += 1;
        }
    }
    differences
        .extend(executed.iter().filter(|(_, count)| **count == 0).map(|(name, _)| format!("{name}: never executed")));
    let compared = format!(
        "{} cases (seed {SEED}) of 16-bit instructions, {} forms of 32-bit ones and blocks after it, with each register, mask and byte stored; {faults} of them fault in both",
        cases.len(),
        FORMS.len() + LOADED_JUMPS.len() + EXCLUSIVE.len(),
    );
    Ok(Comparison {
        what: "ARMv7-M instructions, with Unicorn",
        compared,
        differences,
        exceptions: vec![("STACK", stack), ("BLOCK", block), ("ALIGN", unaligned)],
    })
}

fn is_compared(word: u16) -> bool {
    let (d, m) = (word & 7 | word >> 4 & 8, word >> 3 & 15);
    match word >> 8 {
        // ADD: both the program counter; CMP; BX, BLX.
        0x44 => (d, m) != (15, 15),
        0x45 => d != 15 && m != 15 && (d > 7 || m > 7),
        0x47 => m != 15 && word & 7 == 0,
        // PUSH, POP; STM with its base in the list and not first; LDM.
        0xb4 | 0xbc | 0xc8..=0xcf => word & 0xff != 0,
        0xc0..=0xc7 => word & 0xff != 0 && word & ((1 << (word >> 8 & 7)) - 1) == 0,
        // CPS with no masks is UNPREDICTABLE.
        0xb6 => word & 0xffe8 == 0xb660 && word & 4 == 0 && word & 3 != 0,
        // BKPT, IT and hints, UDF, SVC.
        0xbe | 0xbf | 0xde | 0xdf => false,
        _ => true,
    }
}

/// A jump to a word that stands behind the code.
fn loaded_jump(pattern: &str, offset: u32, random: &mut Random) -> String {
    const CODE: u32 = 0x2000_8000;
    const WORD: u32 = 24;
    let mut code = vec![NOP; WORD as usize / 2];
    code[..2].copy_from_slice(&word(pattern, [0; 128]));
    let target = LOWEST + 2 * u32::from(random.below(WORDS)) + 1;
    code.extend([target as u16, (target >> 16) as u16]);
    let base = (CODE + WORD).wrapping_sub(offset);
    case_with(1, &code, &[(2, base), (3, 8), (13, base)], random)
}

/// A store that follows a load of the same address, unless the load has overwritten it.
fn exclusive(load: &str, store: &str, random: &mut Random) -> String {
    let first = letters(random);
    let second = loop {
        let mut second = letters(random);
        for letter in [b'n', b'i'].map(usize::from) {
            second[letter] = first[letter];
        }
        let [d, n, t] = [b'd', b'n', b't'].map(|letter| second[usize::from(letter)]);
        if d != n && d != t {
            break second;
        }
    };
    case(2, &[word(load, first), word(store, second)].concat(), random)
}

/// An IT block with up to four instructions.
fn block(random: &mut Random) -> String {
    let length = 1 + random.below(4);
    let condition = random.below(14);
    // `then` or `else` for each but the first, and a 1 behind the last.
    let mask = (random.below(16) >> (5 - length).min(4) << (5 - length) | 1 << (4 - length)) & 15;
    let mut code = vec![0xbf00 | condition << 4 | mask];
    for _ in 0..length {
        if random.below(2) == 0 {
            code.push(loop {
                let word = random.below(0xb000);
                let is_jump = matches!(word >> 8, 0x44 | 0x46 | 0x47);
                if !is_jump && is_compared(word) {
                    break word;
                }
            });
        } else {
            let (pattern, _, rule) = loop {
                let form = &FORMS[usize::from(random.below(FORMS.len() as u16))];
                // No branches, and nothing that may be one.
                let (pattern, name, _) = form;
                let jumps = ["b", "bl", "b, if", "ldm", "ldmdb", "pop"].contains(name)
                    || name.contains("to PC")
                    || name.contains("to SP")
                    || name.starts_with("tb");
                if !jumps && !pattern.starts_with("1111001") {
                    break form;
                }
            };
            code.extend(filled(pattern, *rule, random));
        }
    }
    case(1 + length, &code, random)
}

/// A case for both sides: the number of instructions, half-words, flags and registers.
fn case(count: u16, code: &[u16], random: &mut Random) -> String {
    case_with(count, code, &[], random)
}

/// The same, with the values of some registers.
fn case_with(count: u16, code: &[u16], registers: &[(usize, u32)], random: &mut Random) -> String {
    let code: Vec<_> = code.iter().chain([&NOP]).map(|half| format!("{half:x}")).collect();
    let mut line = format!("{count:x} {} {:x} ", code.join(","), u32::from(random.below(32)) << 27);
    for number in 0..15 {
        let any = random.next() as u32;
        let address = LOWEST + 4 * u32::from(random.below(WORDS));
        let value = match random.below(8) {
            // The stack pointer is always such an address.
            _ if number == 13 => address,
            // No private registers, and seldom an alias.
            0 => any & 0x5dff_ffff,
            1 => random.pick(&[0, 1, 31, 32, 33, 255, 256, 0x7fff_ffff, 0x8000_0000, u32::MAX]),
            2 | 3 => 4 * u32::from(random.below(64)),
            4 => address + u32::from(random.below(4)),
            _ => address,
        };
        let value = registers.iter().find(|(chosen, _)| *chosen == number).map_or(value, |(_, chosen)| *chosen);
        line += &format!("{value:08x}");
    }
    line + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_is_found() {
        let cases = [("nop", "1 bf00 0\n".to_owned()), ("stm", "1 c003 0\n".to_owned())];
        let found = |ours: &str, theirs: &str| {
            let theirs = format!("{theirs}\nmet STACK=3 BLOCK=0\n");
            let comparison = judge(&cases, ours, &theirs).expect("as many answers as cases");
            (comparison.differences.len(), comparison.exceptions)
        };
        let met = |aligned| vec![("STACK", 3), ("BLOCK", 0), ("ALIGN", aligned)];
        assert_eq!(found("a\nb", "a\nb"), (0, met(0)));
        assert_eq!(found("a\nb", "a\nc").0, 2, "another answer; the form was never executed as there");
        // Both fault: nothing differs, but the form was never executed.
        assert_eq!(found("a\nfault", "a\nfault").0, 1);
        assert_eq!(found("a\nunaligned", "a\nb"), (1, met(1)));
        assert_eq!(found("a\nfault", "a\nb").0, 2);
        assert!(judge(&cases, "a", "a\nmet STACK=0 BLOCK=0").is_err());
        assert!(judge(&cases, "a\nb", "a\nb").is_err(), "it does not say what it met");
    }

    /// A pattern has 32 bits, and what its rule forbids does not come.
    #[test]
    fn forms() {
        let mut random = Random::new(1);
        for (pattern, name, rule) in FORMS {
            for _ in 0..20 {
                let [first, second] = filled(pattern, *rule, &mut random);
                assert!(first >= 0xe800, "{name}");
                if *rule == Condition {
                    assert!(first >> 6 & 15 < 14, "{name}");
                }
                if *rule == List {
                    assert!(second.count_ones() >= 2 && second & 1 << 13 == 0, "{name}");
                }
            }
        }
    }
}
