//! Every instruction: its encoding, result, flags and cycles against a second statement of the instruction set manual
//! (DS40002198): encodings as the manual prints them, arithmetic in wide integers.

use crate::common::Bench;
use crate::random::Random;
use pulsetrain_emulator::Atmega328p;
use std::sync::OnceLock;

/// Encodings as the manual prints them, the more special ones first; cycles where nothing is skipped and no branch is
/// taken.
const TABLE: &[Row] = &[
    ("0000 0000 0000 0000", "nop", 1),
    ("0000 0001 dddd rrrr", "movw", 1),
    ("0000 0010 dddd rrrr", "muls", 2),
    ("0000 0011 0ddd 0rrr", "mulsu", 2),
    ("0000 0011 0ddd 1rrr", "fmul", 2),
    ("0000 0011 1ddd 0rrr", "fmuls", 2),
    ("0000 0011 1ddd 1rrr", "fmulsu", 2),
    ("0000 01rd dddd rrrr", "cpc", 1),
    ("0000 10rd dddd rrrr", "sbc", 1),
    ("0000 11rd dddd rrrr", "add", 1),
    ("0001 00rd dddd rrrr", "cpse", 1),
    ("0001 01rd dddd rrrr", "cp", 1),
    ("0001 10rd dddd rrrr", "sub", 1),
    ("0001 11rd dddd rrrr", "adc", 1),
    ("0010 00rd dddd rrrr", "and", 1),
    ("0010 01rd dddd rrrr", "eor", 1),
    ("0010 10rd dddd rrrr", "or", 1),
    ("0010 11rd dddd rrrr", "mov", 1),
    ("0011 kkkk dddd kkkk", "cpi", 1),
    ("0100 kkkk dddd kkkk", "sbci", 1),
    ("0101 kkkk dddd kkkk", "subi", 1),
    ("0110 kkkk dddd kkkk", "ori", 1),
    ("0111 kkkk dddd kkkk", "andi", 1),
    ("10q0 qq0d dddd 1qqq", "ldd y", 2),
    ("10q0 qq0d dddd 0qqq", "ldd z", 2),
    ("10q0 qq1d dddd 1qqq", "std y", 2),
    ("10q0 qq1d dddd 0qqq", "std z", 2),
    ("1001 000d dddd 0000", "lds", 2),
    ("1001 000d dddd 0001", "ld z+", 2),
    ("1001 000d dddd 0010", "ld -z", 2),
    ("1001 000d dddd 0100", "lpm z", 3),
    ("1001 000d dddd 0101", "lpm z+", 3),
    ("1001 000d dddd 1001", "ld y+", 2),
    ("1001 000d dddd 1010", "ld -y", 2),
    ("1001 000d dddd 1100", "ld x", 2),
    ("1001 000d dddd 1101", "ld x+", 2),
    ("1001 000d dddd 1110", "ld -x", 2),
    ("1001 000d dddd 1111", "pop", 2),
    ("1001 001d dddd 0000", "sts", 2),
    ("1001 001d dddd 0001", "st z+", 2),
    ("1001 001d dddd 0010", "st -z", 2),
    ("1001 001d dddd 1001", "st y+", 2),
    ("1001 001d dddd 1010", "st -y", 2),
    ("1001 001d dddd 1100", "st x", 2),
    ("1001 001d dddd 1101", "st x+", 2),
    ("1001 001d dddd 1110", "st -x", 2),
    ("1001 001d dddd 1111", "push", 2),
    ("1001 0100 0sss 1000", "bset", 1),
    ("1001 0100 1sss 1000", "bclr", 1),
    ("1001 0100 0000 1001", "ijmp", 2),
    ("1001 0101 0000 1000", "ret", 4),
    ("1001 0101 0000 1001", "icall", 3),
    ("1001 0101 0001 1000", "reti", 4),
    ("1001 0101 1000 1000", "sleep", 1),
    ("1001 0101 1001 1000", "break", 1),
    ("1001 0101 1010 1000", "wdr", 1),
    ("1001 0101 1100 1000", "lpm", 3),
    ("1001 0101 1110 1000", "spm", 1),
    ("1001 010d dddd 0000", "com", 1),
    ("1001 010d dddd 0001", "neg", 1),
    ("1001 010d dddd 0010", "swap", 1),
    ("1001 010d dddd 0011", "inc", 1),
    ("1001 010d dddd 0101", "asr", 1),
    ("1001 010d dddd 0110", "lsr", 1),
    ("1001 010d dddd 0111", "ror", 1),
    ("1001 010d dddd 1010", "dec", 1),
    ("1001 010k kkkk 110k", "jmp", 3),
    ("1001 010k kkkk 111k", "call", 4),
    ("1001 0110 kkdd kkkk", "adiw", 2),
    ("1001 0111 kkdd kkkk", "sbiw", 2),
    ("1001 1000 aaaa abbb", "cbi", 2),
    ("1001 1001 aaaa abbb", "sbic", 1),
    ("1001 1010 aaaa abbb", "sbi", 2),
    ("1001 1011 aaaa abbb", "sbis", 1),
    ("1001 11rd dddd rrrr", "mul", 2),
    ("1011 0aad dddd aaaa", "in", 1),
    ("1011 1aad dddd aaaa", "out", 1),
    ("1100 kkkk kkkk kkkk", "rjmp", 2),
    ("1101 kkkk kkkk kkkk", "rcall", 3),
    ("1110 kkkk dddd kkkk", "ldi", 1),
    ("1111 00kk kkkk ksss", "brbs", 1),
    ("1111 01kk kkkk ksss", "brbc", 1),
    ("1111 100d dddd 0bbb", "bld", 1),
    ("1111 101d dddd 0bbb", "bst", 1),
    ("1111 110d dddd 0bbb", "sbrc", 1),
    ("1111 111d dddd 0bbb", "sbrs", 1),
];

/// The bits of a word that stand under a letter.
fn field(pattern: &str, letter: char, word: u16) -> u32 {
    let bits = pattern.chars().filter(|c| *c != ' ');
    bits.enumerate().filter(|(_, c)| *c == letter).fold(0, |all, (at, _)| all << 1 | u32::from(word >> (15 - at) & 1))
}

type Row = (&'static str, &'static str, u64);

/// The row of the table that a word is in.
fn find(word: u16) -> Option<&'static Row> {
    static ALL: OnceLock<Vec<Option<&'static Row>>> = OnceLock::new();
    ALL.get_or_init(|| (0..=u16::MAX).map(search).collect())[usize::from(word)]
}

fn search(word: u16) -> Option<&'static Row> {
    TABLE.iter().find(|(pattern, ..)| {
        let bits = pattern.chars().filter(|c| *c != ' ');
        bits.enumerate().all(|(at, c)| match c {
            '0' => word >> (15 - at) & 1 == 0,
            '1' => word >> (15 - at) & 1 == 1,
            _ => true,
        })
    })
}

/// What a program sees of the chip; RAM from 0x100.
#[derive(Clone, PartialEq, Eq)]
struct State {
    r: [u8; 32],
    c: bool,
    z: bool,
    n: bool,
    v: bool,
    s: bool,
    h: bool,
    t: bool,
    i: bool,
    pc: i32,
    sp: u16,
    cycles: u64,
    ram: Vec<u8>,
}

impl State {
    fn flag(&mut self, number: u32) -> &mut bool {
        let flags =
            [&mut self.c, &mut self.z, &mut self.n, &mut self.v, &mut self.s, &mut self.h, &mut self.t, &mut self.i];
        flags.into_iter().nth(number as usize).expect("eight flags")
    }

    fn sreg(&mut self) -> u8 {
        (0..8).fold(0, |all, number| all | u8::from(*self.flag(number)) << number)
    }

    fn pair(&self, low: usize) -> u16 {
        u16::from(self.r[low]) + 256 * u16::from(self.r[low + 1])
    }

    fn set_pair(&mut self, low: usize, value: i64) {
        self.r[low] = value.rem_euclid(256) as u8;
        self.r[low + 1] = value.div_euclid(256).rem_euclid(256) as u8;
    }

    fn result(&mut self, value: u8) {
        self.n = value >= 128;
        self.z = value == 0;
        self.s = self.n != self.v;
    }

    /// Flags of a sum or difference, from integers that cannot overflow: V is that the signed result is out of range,
    /// C that the unsigned one is, H the same for the lower four bits.
    fn arithmetic(&mut self, a: u8, b: u8, carry: bool, subtract: bool, keep_zero: bool) -> u8 {
        let sign = if subtract { -1 } else { 1 };
        let exact = |x: i32, y: i32| x + sign * (y + i32::from(carry));
        let unsigned = exact(a.into(), b.into());
        let signed = exact((a as i8).into(), (b as i8).into());
        let half = exact((a % 16).into(), (b % 16).into());
        self.c = !(0..256).contains(&unsigned);
        self.h = !(0..16).contains(&half);
        self.v = !(-128..128).contains(&signed);
        let (zero, result) = (self.z, unsigned.rem_euclid(256) as u8);
        self.result(result);
        self.z &= zero || !keep_zero;
        result
    }

    fn read(&self, address: u16) -> u8 {
        match address {
            0..32 => self.r[usize::from(address)],
            0x100..0x900 => self.ram[usize::from(address - 0x100)],
            _ => panic!("the states keep away from {address:#x}"),
        }
    }

    fn write(&mut self, address: u16, value: u8) {
        self.ram[usize::from(address - 0x100)] = value;
    }

    fn push(&mut self, value: i32) {
        self.write(self.sp, value as u8);
        self.sp -= 1;
    }

    fn pop(&mut self) -> i32 {
        self.sp += 1;
        self.read(self.sp).into()
    }

    fn skip(&mut self, so: bool, next: u16) {
        if so {
            let long = matches!(find(next), Some((_, "lds" | "sts" | "jmp" | "call", _)));
            let words = if long { 2 } else { 1 };
            self.pc += words;
            self.cycles += words as u64;
        }
    }

    /// Executes one instruction; `next` is the word behind it.
    fn execute(&mut self, word: u16, next: u16, flash: &[u8]) {
        let Some(&(pattern, name, cycles)) = find(word) else {
            (self.pc, self.cycles) = (self.pc + 1, self.cycles + 1);
            return;
        };
        let get = |letter| field(pattern, letter, word);
        let signed = |letter, bits: u32| ((get(letter) << (32 - bits)) as i32) >> (32 - bits);
        self.pc += 1;
        self.cycles += cycles;
        let wide_registers = pattern.contains("d dddd");
        let d = match name {
            "movw" => 2 * get('d') as usize,
            "adiw" | "sbiw" => 24 + 2 * get('d') as usize,
            _ if wide_registers => get('d') as usize,
            _ => 16 + get('d') as usize,
        };
        let r = match name {
            "movw" => 2 * get('r') as usize,
            "muls" | "mulsu" | "fmul" | "fmuls" | "fmulsu" => 16 + get('r') as usize,
            _ => get('r') as usize,
        };
        let (k, s, b, q) = (get('k') as u8, get('s'), get('b'), get('q') as u16);
        let rd = self.r.get(d).copied().unwrap_or(0);
        let rr = self.r[r % 32];
        let pointer = match name.chars().find(|c| matches!(c, 'x' | 'y' | 'z')) {
            Some('x') => 26,
            Some('y') => 28,
            _ => 30,
        };
        let address = self.pair(pointer);
        match name {
            "nop" | "break" | "wdr" | "spm" | "sleep" => {}
            "movw" => self.set_pair(d, self.pair(r).into()),
            "mul" | "muls" | "mulsu" | "fmul" | "fmuls" | "fmulsu" => {
                let a = if name.contains("muls") { i64::from(rd as i8) } else { rd.into() };
                let b = if name.ends_with("muls") { i64::from(rr as i8) } else { rr.into() };
                let product = (a * b).rem_euclid(65_536);
                self.c = product >= 32_768;
                let product = if name.starts_with('f') { product * 2 % 65_536 } else { product };
                self.z = product == 0;
                self.set_pair(0, product);
            }
            "add" => self.r[d] = self.arithmetic(rd, rr, false, false, false),
            "adc" => self.r[d] = self.arithmetic(rd, rr, self.c, false, false),
            "sub" => self.r[d] = self.arithmetic(rd, rr, false, true, false),
            "subi" => self.r[d] = self.arithmetic(rd, k, false, true, false),
            "sbc" => self.r[d] = self.arithmetic(rd, rr, self.c, true, true),
            "sbci" => self.r[d] = self.arithmetic(rd, k, self.c, true, true),
            "cp" => {
                self.arithmetic(rd, rr, false, true, false);
            }
            "cpi" => {
                self.arithmetic(rd, k, false, true, false);
            }
            "cpc" => {
                self.arithmetic(rd, rr, self.c, true, true);
            }
            "neg" => self.r[d] = self.arithmetic(0, rd, false, true, false),
            "and" | "andi" | "or" | "ori" | "eor" | "com" => {
                let other = if name.ends_with('i') { k } else { rr };
                self.r[d] = match &name[..2] {
                    "an" => rd & other,
                    "or" => rd | other,
                    "eo" => rd ^ other,
                    _ => 255 - rd,
                };
                self.c |= name == "com";
                self.v = false;
                self.result(self.r[d]);
            }
            "inc" | "dec" => {
                let exact = if name == "inc" { rd as i8 as i32 + 1 } else { rd as i8 as i32 - 1 };
                self.r[d] = exact as u8;
                self.v = !(-128..128).contains(&exact);
                self.result(self.r[d]);
            }
            "asr" | "lsr" | "ror" => {
                let above = match name {
                    "asr" => rd >= 128,
                    "lsr" => false,
                    _ => self.c,
                };
                self.r[d] = rd / 2 + 128 * u8::from(above);
                self.c = rd % 2 == 1;
                self.v = (self.r[d] >= 128) != self.c;
                self.result(self.r[d]);
            }
            "swap" => self.r[d] = rd % 16 * 16 + rd / 16,
            "mov" => self.r[d] = rr,
            "ldi" => self.r[d] = k,
            "adiw" | "sbiw" => {
                let sign = if name == "adiw" { 1 } else { -1 };
                let pair = self.pair(d);
                let exact = i64::from(pair) + sign * i64::from(k);
                self.c = !(0..65_536).contains(&exact);
                self.v = !(-32_768..32_768).contains(&(i64::from(pair as i16) + sign * i64::from(k)));
                self.set_pair(d, exact);
                self.n = self.pair(d) >= 32_768;
                self.z = self.pair(d) == 0;
                self.s = self.n != self.v;
            }
            "bset" => *self.flag(s) = true,
            "bclr" => *self.flag(s) = false,
            "bst" => self.t = rd >> b & 1 == 1,
            "bld" => self.r[d] = rd & !(1 << b) | u8::from(self.t) << b,
            "brbs" | "brbc" => {
                if *self.flag(s) == (name == "brbs") {
                    self.pc += signed('k', 7);
                    self.cycles += 1;
                }
            }
            "cpse" => self.skip(rd == rr, next),
            "sbrc" => self.skip(rd >> b & 1 == 0, next),
            "sbrs" => self.skip(rd >> b & 1 == 1, next),
            "ldd y" | "ldd z" => self.r[d] = self.read(address + q),
            "std y" | "std z" => self.write(address + q, rd),
            "lds" => {
                self.pc += 1;
                self.r[d] = self.read(next);
            }
            "sts" => {
                self.pc += 1;
                self.write(next, rd);
            }
            "lpm" => self.r[0] = flash[usize::from(address) % flash.len()],
            "push" => self.push(rd.into()),
            "pop" => self.r[d] = self.pop() as u8,
            "rjmp" => self.pc += signed('k', 12),
            "rcall" => {
                let back = self.pc;
                self.push(back);
                self.push(back >> 8);
                self.pc += signed('k', 12);
            }
            "jmp" => self.pc = next.into(),
            "call" => {
                let back = self.pc + 1;
                self.push(back);
                self.push(back >> 8);
                self.pc = next.into();
            }
            "ijmp" => self.pc = address.into(),
            "icall" => {
                let back = self.pc;
                self.push(back);
                self.push(back >> 8);
                self.pc = address.into();
            }
            "ret" | "reti" => {
                self.pc = self.pop() * 256;
                self.pc += self.pop();
                self.i |= name == "reti";
            }
            // Loads and stores that move their pointer.
            _ => {
                let at = if name.contains('-') { address - 1 } else { address };
                if name.contains('-') {
                    self.set_pair(pointer, at.into());
                } else if name.contains('+') {
                    self.set_pair(pointer, i64::from(at) + 1);
                }
                match &name[..2] {
                    "ld" => self.r[d] = self.read(at),
                    "st" => self.write(at, rd),
                    "lp" => self.r[d] = flash[usize::from(address) % flash.len()],
                    _ => panic!("{name} is missing"),
                }
            }
        }
        self.pc = self.pc.rem_euclid(16_384);
    }
}

impl Random {
    /// A byte; the ends of the range are likely.
    fn byte(&mut self) -> u8 {
        let n = self.next();
        match n >> 16 & 7 {
            0 => 0,
            1 => 0xff,
            2 => 0x80,
            3 => 0x7f,
            _ => n as u8,
        }
    }

    fn state(&mut self) -> State {
        let mut r = [0; 32];
        r.fill_with(|| self.byte());
        // Pointers into RAM, with room for displacements.
        for high in [27, 29, 31] {
            r[high] = 2 + (self.next() % 6) as u8;
        }
        let flags = self.next();
        let mut bits = (0..8).map(|bit| flags >> bit & 1 == 1);
        let mut flag = || bits.next().expect("eight flags");
        let ram = (0..2048).map(|n| (n * 7 + n / 256) as u8).collect();
        State {
            r,
            c: flag(),
            z: flag(),
            n: flag(),
            v: flag(),
            s: flag(),
            h: flag(),
            t: flag(),
            i: flag(),
            pc: 0,
            sp: 0x300 + (self.next() % 0x400) as u16,
            cycles: 0,
            ram,
        }
    }
}

fn load(chip: &mut Atmega328p, state: &mut State) {
    for (number, value) in state.r.into_iter().enumerate() {
        chip.set_register(number as u8, value);
    }
    let [low, high] = state.sp.to_le_bytes();
    chip.write_data(0x5e, high, &mut ());
    chip.write_data(0x5d, low, &mut ());
    chip.write_data(0x5f, state.sreg(), &mut ());
    for (at, byte) in state.ram.iter().enumerate() {
        if chip.ram()[at] != *byte {
            chip.write_data(0x100 + at as u16, *byte, &mut ());
        }
    }
    chip.set_pc(state.pc as u16);
}

fn compare(chip: &Atmega328p, began: u64, expected: &mut State, word: u16) {
    let name = find(word).map_or("undefined", |found| found.1);
    let registers: Vec<_> = (0..32).map(|number| chip.register(number)).collect();
    assert_eq!(registers, expected.r, "{word:#06x} {name}: registers");
    assert_eq!(format!("{:08b}", chip.sreg()), format!("{:08b}", expected.sreg()), "{word:#06x} {name}: SREG");
    assert_eq!(i32::from(chip.pc()), expected.pc, "{word:#06x} {name}: pc");
    assert_eq!(chip.sp(), expected.sp, "{word:#06x} {name}: sp");
    assert_eq!(chip.cycle() - began, expected.cycles, "{word:#06x} {name}: cycles");
    assert!(chip.ram() == expected.ram.as_slice(), "{word:#06x} {name}: RAM");
}

/// Instructions whose effect is beyond registers and RAM; they have tests of their own.
fn is_io(word: u16) -> bool {
    matches!(find(word), Some((_, "in" | "out" | "sbi" | "cbi" | "sbic" | "sbis", _)))
}

#[test]
fn every_word() {
    let mut random = Random::new(0x2026_1121);
    let (mut executed, mut undefined) = (0, 0);
    for first in (0..=0xffffu32).step_by(8192) {
        // Each word, and behind it a RAM address; that is `movw` or a multiplication as an instruction.
        let words: Vec<u16> = (first..first + 8192).map(|word| word as u16).collect();
        let next = |word: u16| 0x120 + word % 0x500;
        let flash: Vec<u8> = words.iter().flat_map(|&word| crate::common::image(&[word, next(word)])).collect();
        let mut chip = Atmega328p::new(&flash).expect("it fits");
        for (index, &word) in words.iter().enumerate() {
            if is_io(word) {
                continue;
            }
            // Where there are more states than words of the kind, more of them.
            let times = if word & 0xff == 0 || word >> 8 == 0x94 || word >> 8 == 0x95 { 8 } else { 2 };
            for _ in 0..times {
                let mut state = random.state();
                state.pc = 2 * index as i32;
                load(&mut chip, &mut state);
                let (began, odd) = (chip.cycle(), chip.odd().undefined);
                chip.step(&mut ());
                state.execute(word, next(word), &flash);
                compare(&chip, began, &mut state, word);
                assert_eq!(chip.odd().undefined - odd, u64::from(find(word).is_none()), "{word:#06x}");
                executed += 1;
                undefined += u64::from(find(word).is_none());
            }
        }
    }
    assert!(executed > 100_000 && undefined > 1000, "{executed} executed, {undefined} undefined");
}

/// All operands and carries of the eight-bit arithmetic.
#[test]
fn arithmetic_on_all_operands() {
    // add, adc, sub, sbc, and, or, eor, cp, cpc r16, r17; then one operand: com, neg, inc, dec, asr, lsr, ror.
    let words = [
        0x0f01, 0x1f01, 0x1b01, 0x0b01, 0x2301, 0x2b01, 0x2701, 0x1701, 0x0701, 0x9f01, 0x0201, 0x0301, 0x0309, 0x0381,
        0x0389, 0x9500, 0x9501, 0x9503, 0x950a, 0x9505, 0x9506, 0x9507,
    ];
    let flash = crate::common::image(&words);
    let mut chip = Atmega328p::new(&flash).expect("it fits");
    let mut state = Random::new(7).state();
    load(&mut chip, &mut state);
    for a in 0..=255 {
        for b in 0..=255 {
            for carry_and_zero in 0..4 {
                (state.r[16], state.r[17], state.pc) = (a, b, 0);
                chip.set_register(16, a);
                chip.set_register(17, b);
                chip.set_pc(0);
                for word in words {
                    (state.c, state.z) = (carry_and_zero & 1 != 0, carry_and_zero & 2 != 0);
                    chip.write_data(0x5f, state.sreg(), &mut ());
                    chip.step(&mut ());
                    state.execute(word, 0, &flash);
                    let same =
                        [0, 1, 16, 17].into_iter().all(|number| chip.register(number) == state.r[usize::from(number)]);
                    assert!(same && chip.sreg() == state.sreg(), "{word:#06x} of {a} and {b}: {:08b}", chip.sreg());
                }
            }
        }
    }
}

/// Skipping takes 2 cycles over one word, 3 over two (the manual's cpse, sbrc, sbrs, sbic, sbis).
#[test]
fn skips() {
    // cpse r0, r0; sbrc r0, 0; sbic GPIOR0, 0; sbrs r1, 0; sbis GPIOR0, 1; sbrs r0, 0 does not skip.
    for (skip, skips) in
        [(0x1000, true), (0xfc00, true), (0x99f0, true), (0xfe10, true), (0x9bf1, true), (0xfe00, false)]
    {
        for (next, words) in [(0x0000, 1), (0x9000, 2), (0x9200, 2), (0x940c, 2), (0x940e, 2), (0x940d, 2)] {
            let mut bench = Bench::with(&[skip, next]);
            bench.chip.set_register(1, 1);
            bench.set(0x3e, 2);
            bench.chip.step(&mut bench.seen);
            let skipped = if skips { words } else { 0 };
            assert_eq!((u64::from(bench.chip.pc()), bench.now()), (1 + skipped, 1 + skipped), "{skip:#x} {next:#x}");
        }
    }
}

/// in, out, sbi, cbi on a register without side effects, at its I/O and its data address.
#[test]
fn general_purpose_registers() {
    // ldi r16, 0x5a; out GPIOR0, r16; sbi GPIOR0, 0; cbi GPIOR0, 1; in r17, GPIOR0; lds r18, 0x3e; sts 0x4b, r18; in r19, GPIOR2
    let words = [0xe50a, 0xbb0e, 0x9af0, 0x98f1, 0xb31e, 0x9120, 0x003e, 0x9320, 0x004b, 0xb53b];
    let mut bench = Bench::with(&words);
    bench.run(1 + 1 + 2 + 2 + 1 + 2 + 2 + 1);
    assert_eq!((bench.chip.register(17), bench.chip.register(18), bench.chip.register(19)), (0x59, 0x59, 0x59));
    assert_eq!((bench.now(), bench.chip.pc()), (12, 10));
}

/// Beyond RAM: reads 0, writes nothing, is counted.
#[test]
fn beyond_ram() {
    // ldi r16, 0xff; lds r16, 0x900; sts 0x900, r16
    let mut bench = Bench::with(&[0xef0f, 0x9100, 0x0900, 0x9300, 0x0900]);
    bench.run(5);
    assert_eq!((bench.chip.register(16), bench.chip.odd().outside), (0, 2));
}
