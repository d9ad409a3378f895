//! Every instruction of ARMv6-M: encoding, result, flags, accesses and cycles against a second statement of the manual
//! (ARM DDI 0419E chapter A6; cycles: TRM DDI 0484C table 3-1): encodings as the manual prints them, arithmetic in wide
//! integers.

use crate::arm_common::{Access, Bench, CODE, IO_PORT, RAM, RAM_BYTES, SLOW};
use crate::random::Random;
use pulsetrain_emulator::arm::{FaultCause, Size};
use std::sync::OnceLock;

/// Encodings as the manual prints them, the more special ones first; cycles of those that do not depend on anything.
const TABLE: &[Row] = &[
    ("000 00 iiiii mmm ddd", "lsl", 1),
    ("000 01 iiiii mmm ddd", "lsr", 1),
    ("000 10 iiiii mmm ddd", "asr", 1),
    ("000 11 0 0 mmm nnn ddd", "add", 1),
    ("000 11 0 1 mmm nnn ddd", "sub", 1),
    ("000 11 1 0 iii nnn ddd", "add", 1),
    ("000 11 1 1 iii nnn ddd", "sub", 1),
    ("001 00 ddd iiiiiiii", "mov", 1),
    ("001 01 ddd iiiiiiii", "cmp", 1),
    ("001 10 ddd iiiiiiii", "add", 1),
    ("001 11 ddd iiiiiiii", "sub", 1),
    ("010000 0000 mmm ddd", "and", 1),
    ("010000 0001 mmm ddd", "eor", 1),
    ("010000 0010 mmm ddd", "lsl", 1),
    ("010000 0011 mmm ddd", "lsr", 1),
    ("010000 0100 mmm ddd", "asr", 1),
    ("010000 0101 mmm ddd", "adc", 1),
    ("010000 0110 mmm ddd", "sbc", 1),
    ("010000 0111 mmm ddd", "ror", 1),
    ("010000 1000 mmm ddd", "tst", 1),
    ("010000 1001 mmm ddd", "rsb", 1),
    ("010000 1010 mmm ddd", "cmp", 1),
    ("010000 1011 mmm ddd", "cmn", 1),
    ("010000 1100 mmm ddd", "orr", 1),
    ("010000 1101 mmm ddd", "mul", 1),
    ("010000 1110 mmm ddd", "bic", 1),
    ("010000 1111 mmm ddd", "mvn", 1),
    ("010001 00 D mmmm ddd", "add any", 1),
    ("010001 01 D mmmm ddd", "cmp any", 1),
    ("010001 10 D mmmm ddd", "mov any", 1),
    ("010001 11 0 mmmm xxx", "bx", 2),
    ("010001 11 1 mmmm xxx", "blx", 2),
    ("01001 ddd iiiiiiii", "ldr pc", 2),
    ("0101 000 mmm nnn ddd", "str", 2),
    ("0101 001 mmm nnn ddd", "strh", 2),
    ("0101 010 mmm nnn ddd", "strb", 2),
    ("0101 011 mmm nnn ddd", "ldrsb", 2),
    ("0101 100 mmm nnn ddd", "ldr", 2),
    ("0101 101 mmm nnn ddd", "ldrh", 2),
    ("0101 110 mmm nnn ddd", "ldrb", 2),
    ("0101 111 mmm nnn ddd", "ldrsh", 2),
    ("011 0 0 iiiii nnn ddd", "str", 2),
    ("011 0 1 iiiii nnn ddd", "ldr", 2),
    ("011 1 0 iiiii nnn ddd", "strb", 2),
    ("011 1 1 iiiii nnn ddd", "ldrb", 2),
    ("1000 0 iiiii nnn ddd", "strh", 2),
    ("1000 1 iiiii nnn ddd", "ldrh", 2),
    ("1001 0 ddd iiiiiiii", "str sp", 2),
    ("1001 1 ddd iiiiiiii", "ldr sp", 2),
    ("1010 0 ddd iiiiiiii", "adr", 1),
    ("1010 1 ddd iiiiiiii", "add from sp", 1),
    ("1011 0000 0 iiiiiii", "add sp", 1),
    ("1011 0000 1 iiiiiii", "sub sp", 1),
    ("1011 0010 00 mmm ddd", "sxth", 1),
    ("1011 0010 01 mmm ddd", "sxtb", 1),
    ("1011 0010 10 mmm ddd", "uxth", 1),
    ("1011 0010 11 mmm ddd", "uxtb", 1),
    ("1011 0 10 R llllllll", "push", 1),
    ("1011 0110 011 i 0010", "cps", 1),
    ("1011 1010 00 mmm ddd", "rev", 1),
    ("1011 1010 01 mmm ddd", "rev16", 1),
    ("1011 1010 11 mmm ddd", "revsh", 1),
    ("1011 1 10 R llllllll", "pop", 1),
    ("1011 1110 xxxxxxxx", "bkpt", 1),
    ("1011 1111 0010 0000", "wfe", 2),
    ("1011 1111 0011 0000", "wfi", 2),
    ("1011 1111 0100 0000", "sev", 1),
    ("1011 1111 xxxx 0000", "nop", 1),
    ("1100 0 nnn llllllll", "stm", 1),
    ("1100 1 nnn llllllll", "ldm", 1),
    ("1101 1110 xxxxxxxx", "udf", 1),
    ("1101 1111 xxxxxxxx", "svc", 1),
    ("1101 cccc iiiiiiii", "b if", 1),
    ("11100 iiiiiiiiiii", "b", 2),
];

type Row = (&'static str, &'static str, u64);

/// The bits of a word that stand under a letter.
fn field(pattern: &str, letter: char, word: u16) -> u32 {
    let bits = pattern.chars().filter(|c| *c != ' ');
    bits.enumerate().filter(|(_, c)| *c == letter).fold(0, |all, (at, _)| all << 1 | u32::from(word >> (15 - at) & 1))
}

/// The row of the table that a word is in.
fn find(word: u16) -> Option<&'static Row> {
    static ALL: OnceLock<Vec<Option<&'static Row>>> = OnceLock::new();
    ALL.get_or_init(|| (0..=u16::MAX).map(search).collect())[usize::from(word)]
}

fn search(word: u16) -> Option<&'static Row> {
    TABLE.iter().find(|(pattern, ..)| {
        let bits = pattern.chars().filter(|c| *c != ' ');
        assert_eq!(bits.clone().count(), 16, "{pattern}");
        bits.enumerate().all(|(at, c)| match c {
            '0' => word >> (15 - at) & 1 == 0,
            '1' => word >> (15 - at) & 1 == 1,
            _ => true,
        })
    })
}

impl Random {
    /// What registers hold: anything, addresses, small numbers, the ends of ranges.
    fn value(&mut self) -> u32 {
        let x = self.next();
        match self.next() % 8 {
            0 => x,
            1 => x % 40,
            2 => [0, 1, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 0xff, 0x100][x as usize % 7],
            3 => SLOW + x % RAM_BYTES / 4 * 4,
            4 => IO_PORT + x % RAM_BYTES / 4 * 4,
            5 => RAM + x % RAM_BYTES,
            _ => RAM + x % RAM_BYTES / 4 * 4,
        }
    }
}

/// What a program sees of the processor.
#[derive(Clone, Debug, PartialEq, Eq)]
struct State {
    r: [u32; 16],
    n: bool,
    z: bool,
    c: bool,
    v: bool,
    primask: bool,
    cycles: u64,
    accesses: Vec<Access>,
    fault: Option<FaultCause>,
    asleep: bool,
    /// An even address was branched to.
    arm: bool,
}

impl State {
    fn of(bench: &Bench) -> State {
        let flags = bench.cpu.xpsr();
        State {
            r: std::array::from_fn(|number| bench.cpu.register(number)),
            n: flags >> 31 & 1 == 1,
            z: flags >> 30 & 1 == 1,
            c: flags >> 29 & 1 == 1,
            v: flags >> 28 & 1 == 1,
            primask: bench.cpu.primask(),
            cycles: bench.now(),
            accesses: bench.memory.accesses.clone(),
            fault: bench.cpu.fault().map(|fault| fault.cause),
            asleep: bench.cpu.is_asleep(),
            arm: flags >> 24 & 1 == 0,
        }
    }

    fn result(&mut self, d: usize, value: u32) {
        self.n = value >= 1 << 31;
        self.z = value == 0;
        self.r[d] = value;
    }

    /// Flags of a sum or difference, from integers that cannot overflow: V is that the signed result is out of range,
    /// C that the unsigned sum is, or that a difference borrows nothing.
    fn arithmetic(&mut self, a: u32, b: u32, sign: i64, carry: i64) -> u32 {
        let unsigned = i64::from(a) + sign * i64::from(b) + carry;
        let signed = i64::from(a as i32) + sign * i64::from(b as i32) + carry;
        self.c = if sign > 0 { unsigned >= 1 << 32 } else { unsigned >= 0 };
        self.v = i32::try_from(signed).is_err();
        let result = unsigned.rem_euclid(1 << 32) as u32;
        (self.n, self.z) = (result >= 1 << 31, result == 0);
        result
    }

    /// One place at a time, the bit that falls out being the carry.
    fn shift(&mut self, name: &str, mut value: u32, places: u32) -> u32 {
        for _ in 0..places {
            let (top, lowest) = (value >= 1 << 31, value % 2 == 1);
            let above = match name {
                "asr" => top,
                "ror" => lowest,
                _ => false,
            };
            self.c = if name == "lsl" { top } else { lowest };
            value = if name == "lsl" { value.wrapping_mul(2) } else { value / 2 + (u32::from(above) << 31) };
        }
        value
    }

    /// Where an access is in memory, how long it waits, whether it is at the I/O port.
    fn place(address: u32, size: u32) -> Result<(usize, u64, bool), FaultCause> {
        if !address.is_multiple_of(size) {
            return Err(FaultCause::Unaligned { address });
        }
        let places = [(RAM, 0, false), (IO_PORT, 0, true), (SLOW, 3, false)];
        let found = places.into_iter().find(|(base, ..)| (*base..base + RAM_BYTES).contains(&address));
        found.map(|(base, waits, port)| ((address - base) as usize, waits, port)).ok_or(FaultCause::Bus { address })
    }

    /// A load or store in `self.cycles`, which it takes; more if it waits.
    fn access(&mut self, address: u32, size: Size, written: Option<u32>, memory: &[u8]) -> Result<u32, FaultCause> {
        let (at, waits, _) = State::place(address, size.bytes())?;
        self.accesses.push(Access { cycle: self.cycles, address, size, written });
        self.cycles += 1 + waits;
        let bytes = size.bytes() as usize;
        let value = (0..bytes).map(|byte| u32::from(memory[at + byte]) << (8 * byte)).sum();
        Ok(value)
    }

    /// Executes one instruction.
    fn execute(&mut self, word: u16, memory: &[u8]) {
        let (before, pc) = (self.clone(), self.r[15]);
        self.r[15] = pc + 2;
        if let Err(cause) = self.instruction(word, pc, memory) {
            // Registers that were loaded before the fault may have changed; the base has not.
            let base = find(word).map(|(pattern, ..)| field(pattern, 'n', word) as usize);
            if let Some(base) = base.filter(|_| word >> 12 == 12) {
                self.r[base] = before.r[base];
            }
            self.r[13] = before.r[13];
            self.r[15] = pc;
            self.fault = Some(cause);
        }
    }

    fn instruction(&mut self, word: u16, pc: u32, memory: &[u8]) -> Result<(), FaultCause> {
        let &(pattern, name, cycles) = find(word).ok_or(FaultCause::Undefined)?;
        let get = |letter| field(pattern, letter, word);
        let immediate = pattern.contains('i');
        let register = |letter| get(letter) as usize;
        let (d, m) = (register('d') + 8 * register('D'), register('m'));
        let n = if pattern.contains('n') { register('n') } else { d };
        let i = get('i');
        let read = |state: &State, number: usize| if number == 15 { pc + 4 } else { state.r[number] };
        let (a, b) = (read(self, n), if immediate { i } else { read(self, m) });
        let carry = i64::from(self.c);
        let began = self.cycles;
        match name {
            "lsl" | "lsr" | "asr" | "ror" if immediate => {
                let places = if i == 0 && name != "lsl" { 32 } else { i };
                let value = self.shift(name, self.r[m], places);
                self.result(d, value);
            }
            "lsl" | "lsr" | "asr" | "ror" => {
                let value = self.shift(name, a, b % 256);
                self.result(d, value);
            }
            "add" => self.r[d] = self.arithmetic(a, b, 1, 0),
            "adc" => self.r[d] = self.arithmetic(a, b, 1, carry),
            "sub" => self.r[d] = self.arithmetic(a, b, -1, 0),
            "sbc" => self.r[d] = self.arithmetic(a, b, -1, carry - 1),
            "rsb" => self.r[d] = self.arithmetic(0, b, -1, 0),
            "cmp" | "cmp any" => {
                self.arithmetic(a, b, -1, 0);
            }
            "cmn" => {
                self.arithmetic(a, b, 1, 0);
            }
            "mov" => self.result(d, b),
            "and" => self.result(d, a & b),
            "eor" => self.result(d, a ^ b),
            "orr" => self.result(d, a | b),
            "bic" => self.result(d, a - (a & b)),
            "mvn" => self.result(d, u32::MAX - b),
            "mul" => self.result(d, (u64::from(a) * u64::from(b) % (1 << 32)) as u32),
            "tst" => {
                let kept = self.r[0];
                self.result(0, a & b);
                self.r[0] = kept;
            }
            "add any" | "mov any" => {
                let value = if name == "mov any" { b } else { a.wrapping_add(b) };
                self.r[d] = match d {
                    13 => value / 4 * 4,
                    15 => value / 2 * 2,
                    _ => value,
                };
                self.cycles += u64::from(d == 15);
            }
            "bx" | "blx" => {
                if name == "blx" {
                    self.r[14] = pc + 3;
                }
                self.r[15] = b / 2 * 2;
                self.arm = b.is_multiple_of(2);
            }
            "adr" => self.r[d] = (pc + 4) / 4 * 4 + 4 * i,
            "add from sp" => self.r[d] = self.r[13].wrapping_add(4 * i),
            "add sp" => self.r[13] = self.r[13].wrapping_add(4 * i),
            "sub sp" => self.r[13] = self.r[13].wrapping_sub(4 * i),
            "sxth" => self.r[d] = (i64::from(b % 65_536) - if b & 0x8000 != 0 { 65_536 } else { 0 }) as u32,
            "sxtb" => self.r[d] = (i64::from(b % 256) - if b & 0x80 != 0 { 256 } else { 0 }) as u32,
            "uxth" => self.r[d] = b % 65_536,
            "uxtb" => self.r[d] = b % 256,
            "rev" | "rev16" | "revsh" => {
                let [b0, b1, b2, b3] = b.to_le_bytes();
                let sign = if b0 >= 128 { 255 } else { 0 };
                self.r[d] = u32::from_le_bytes(match name {
                    "rev" => [b3, b2, b1, b0],
                    "rev16" => [b1, b0, b3, b2],
                    _ => [b1, b0, sign, sign],
                });
            }
            "cps" => self.primask = i == 1,
            "b" => {
                self.r[15] =
                    pc.wrapping_add(4).wrapping_add_signed(2 * if i >= 1024 { i as i32 - 2048 } else { i as i32 })
            }
            "b if" => {
                let holds = match get('c') {
                    0 => self.z,
                    1 => !self.z,
                    2 => self.c,
                    3 => !self.c,
                    4 => self.n,
                    5 => !self.n,
                    6 => self.v,
                    7 => !self.v,
                    8 => self.c && !self.z,
                    9 => !self.c || self.z,
                    10 => self.n == self.v,
                    11 => self.n != self.v,
                    12 => !self.z && self.n == self.v,
                    _ => self.z || self.n != self.v,
                };
                if holds {
                    self.r[15] = pc.wrapping_add(4).wrapping_add_signed(2 * i32::from(i as u8 as i8));
                    self.cycles += 1;
                }
            }
            "push" | "stm" | "pop" | "ldm" => return self.multiple(word, memory),
            "nop" | "sev" | "svc" => {}
            "wfe" | "wfi" => self.asleep = true,
            "bkpt" => return Err(FaultCause::Breakpoint),
            "udf" => return Err(FaultCause::Undefined),
            _ => {
                let size = match name.trim_start_matches("ldr").trim_start_matches("str") {
                    "b" | "sb" => Size::Byte,
                    "h" | "sh" => Size::Half,
                    _ => Size::Word,
                };
                let base = match name {
                    "ldr pc" => (pc + 4) / 4 * 4,
                    "ldr sp" | "str sp" => self.r[13],
                    _ => self.r[n],
                };
                let address = base.wrapping_add(if immediate { i * size.bytes() } else { self.r[m] });
                let (_, _, port) = State::place(address, size.bytes())?;
                self.cycles += u64::from(!port);
                if name.starts_with("str") {
                    let mask = (1_u64 << (8 * size.bytes())) - 1;
                    self.access(address, size, Some((u64::from(self.r[d]) & mask) as u32), memory)?;
                } else {
                    let value = self.access(address, size, None, memory)?;
                    self.r[d] = match name {
                        "ldrsb" => (i64::from(value) - if value >= 128 { 256 } else { 0 }) as u32,
                        "ldrsh" => (i64::from(value) - if value >= 32_768 { 65_536 } else { 0 }) as u32,
                        _ => value,
                    };
                }
                let waits = State::place(address, size.bytes())?.1;
                assert_eq!(self.cycles - began, if port { 1 } else { cycles } + waits, "table 3-1");
                return Ok(());
            }
        }
        self.cycles += cycles;
        Ok(())
    }

    /// `push`, `pop`, `stm`, `ldm`: 1 + N cycles; 3 + N with the program counter in the list.
    fn multiple(&mut self, word: u16, memory: &[u8]) -> Result<(), FaultCause> {
        let &(pattern, name, _) = find(word).expect("a row");
        let (list, extra) = (field(pattern, 'l', word), field(pattern, 'R', word) == 1);
        let base = if name == "push" || name == "pop" { 13 } else { field(pattern, 'n', word) as usize };
        let mut registers: Vec<usize> = (0..8).filter(|number| list >> number & 1 == 1).collect();
        if extra {
            registers.push(if name == "push" { 14 } else { 15 });
        }
        let bytes = 4 * registers.len() as u32;
        let start = if name == "push" { self.r[13].wrapping_sub(bytes) } else { self.r[base] };
        let before = self.clone();
        self.cycles += 1;
        for (at, number) in registers.iter().enumerate() {
            let address = start.wrapping_add(4 * at as u32);
            if name == "push" || name == "stm" {
                self.access(address, Size::Word, Some(before.r[*number]), memory)?;
            } else {
                self.r[*number] = self.access(address, Size::Word, None, memory)?;
            }
        }
        match name {
            "push" => self.r[13] = start,
            "ldm" if registers.contains(&base) => {}
            _ => self.r[base] = start.wrapping_add(bytes),
        }
        if name == "pop" && extra {
            self.cycles += 2;
            self.arm = self.r[15].is_multiple_of(2);
            self.r[15] = self.r[15] / 2 * 2;
        }
        Ok(())
    }
}

/// A processor in memory with something in each place; cases put back what they change.
struct Cases {
    fresh: Bench,
    bench: Bench,
    random: Random,
    differences: Vec<String>,
}

impl Cases {
    fn new(seed: u64) -> Cases {
        let mut fresh = Bench::with(&[]);
        for (at, byte) in fresh.memory.bytes.iter_mut().enumerate() {
            *byte = ((at as u32).wrapping_mul(0x9e37_79b1) >> 24) as u8;
        }
        Cases { bench: fresh.clone(), fresh, random: Random::new(seed), differences: Vec::new() }
    }

    /// Executes code from random registers and flags, and what `expect` makes of the state before it.
    fn check(&mut self, code: &[u16], expect: impl FnOnce(&mut State, &[u8])) {
        let Cases { fresh, bench, random, .. } = self;
        bench.cpu = fresh.cpu.clone();
        for number in 0..15 {
            bench.cpu.set_register(number, random.value());
        }
        bench.cpu.set_flags(random.next());
        bench.memory.set_code(CODE, code);
        let mut expected = State::of(bench);
        expect(&mut expected, &bench.memory.bytes);
        bench.step();
        let mut found = State::of(bench);
        for access in bench.memory.accesses.drain(..) {
            let at = access.address as usize % RAM_BYTES as usize;
            let end = at + access.size.bytes() as usize;
            bench.memory.bytes[at..end].copy_from_slice(&fresh.memory.bytes[at..end]);
        }
        if expected.fault.is_some() {
            // How long a faulting instruction takes is not documented.
            (expected.cycles, found.cycles) = (0, 0);
            // The processor's own registers have tests of their own.
            if matches!(expected.fault, Some(FaultCause::Bus { address }) if address >> 20 == 0xe00) {
                return;
            }
        }
        if expected != found {
            let name = find(code[0]);
            self.differences.push(format!("{code:04x?} {name:?}\nexpected {expected:x?}\nfound    {found:x?}"));
        }
    }

    fn end(self) {
        let first = self.differences.iter().take(3).map(String::as_str).collect::<Vec<_>>().join("\n");
        assert!(self.differences.is_empty(), "{} differences\n{first}", self.differences.len());
    }
}

/// All half-words that are instructions of their own, each from several states.
#[test]
fn half_words() {
    let mut cases = Cases::new(1);
    for word in 0..=0xe7ff_u16 {
        // Arithmetic in two registers: what it does is decided by their values, so more of them.
        let states = if (0x4000..0x4800).contains(&word) { 60 } else { 8 };
        for _ in 0..states {
            cases.check(&[word], |state, memory| state.execute(word, memory));
        }
    }
    cases.end();
}

/// A6.7.13: `bl` adds 25 bits with their sign, in 3 cycles.
#[test]
fn branch_with_link() {
    let mut cases = Cases::new(2);
    for _ in 0..5000 {
        // -16 777 216 to 16 777 214.
        let offset = (cases.random.next() as i32 >> 8) * 2;
        let bits = offset as u32;
        let (s, i1, i2) = (bits >> 24 & 1, bits >> 23 & 1, bits >> 22 & 1);
        let (j1, j2) = (u32::from(i1 == s), u32::from(i2 == s));
        let first = 0xf000 | s << 10 | bits >> 12 & 0x3ff;
        let second = 0xd000 | j1 << 13 | j2 << 11 | bits >> 1 & 0x7ff;
        cases.check(&[first as u16, second as u16], |state, _| {
            state.r[14] = CODE + 5;
            state.r[15] = (CODE + 4).wrapping_add_signed(offset);
            state.cycles += 3;
        });
    }
    cases.end();
}

/// A5.3: of all that begins with 0b111, only `bl`, `mrs`, `msr` and the barriers are instructions.
#[test]
fn wide_words() {
    let mut cases = Cases::new(3);
    for first in 0xe800..=0xffff_u16 {
        for _ in 0..20 {
            let second = cases.random.next() as u16;
            let is_bl = first >> 11 == 0b11110 && second & 0xd000 == 0xd000;
            let is_special = matches!(first, 0xf380..=0xf38f | 0xf3ef) && second & 0xd000 == 0x8000;
            let is_barrier = first == 0xf3bf && matches!(second, 0x8f40..=0x8f6f);
            if !is_bl && !is_special && !is_barrier {
                cases.check(&[first, second], |state, _| state.fault = Some(FaultCause::Undefined));
            }
        }
    }
    for second in 0x8f40..=0x8f6f {
        cases.check(&[0xf3bf, second], |state, _| {
            state.r[15] += 4;
            state.cycles += 3;
        });
    }
    cases.end();
}

/// B5.1.1, B5.2.2, B5.2.3: flags, exception number, stack pointers, masks; 3 cycles each.
#[test]
fn special_registers() {
    let (apsr, ipsr, xpsr, msp, psp, primask, control) = (0, 5, 3, 8, 9, 16, 20);
    let mut bench = Bench::with(&[]);
    let mut run = |code: [u16; 2], r0: u32| {
        bench.memory.set_code(CODE, &code);
        bench.cpu.set_register(15, CODE);
        bench.cpu.set_register(0, r0);
        assert_eq!(bench.step(), 3);
        bench.cpu.register(0)
    };
    let msr = |special: u16| [0xf380, 0x8800 | special];
    let mrs = |special: u16| [0xf3ef, 0x8000 | special];
    run(msr(apsr), 0xa5ff_ffff);
    assert_eq!(run(mrs(apsr), 0), 0xa000_0000);
    assert_eq!(run(mrs(xpsr), 0), 0xa000_0000, "the T bit reads 0");
    assert_eq!(run(mrs(ipsr), 7), 0);
    run(msr(ipsr), u32::MAX);
    assert_eq!(run(mrs(xpsr), 0), 0xa000_0000, "IPSR cannot be written");
    run(msr(psp), 0x2000_4007);
    assert_eq!(run(mrs(psp), 0), 0x2000_4004, "bits 0 and 1 of a stack pointer are 0");
    run(msr(msp), 0x2000_5000);
    assert_eq!(run(mrs(msp), 0), 0x2000_5000);
    run(msr(control), 2);
    assert_eq!(run(mrs(control), 0), 2);
    run(msr(primask), u32::MAX);
    assert_eq!(run(mrs(primask), 0), 1);
    run(msr(primask), 0);

    run(msr(psp), 0x2000_4800);
    // In the thread without privileges only the flags can be written, and masks and stack pointers read 0.
    run(msr(control), 3);
    run(msr(primask), 1);
    run(msr(msp), 0x2000_6000);
    run(msr(control), 0);
    run(msr(apsr), 0x1000_0000);
    assert_eq!(run(mrs(control), 0), 3);
    assert_eq!((run(mrs(primask), 9), run(mrs(msp), 9), run(mrs(psp), 9)), (0, 0, 0));
    assert_eq!(run(mrs(apsr), 0), 0x1000_0000);
    assert!(!bench.cpu.primask());
    assert_eq!((bench.cpu.msp(), bench.cpu.psp(), bench.cpu.register(13)), (0x2000_5000, 0x2000_4800, 0x2000_4800));
}
