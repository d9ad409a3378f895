//! The AVR processor: registers, flags, stack and all instructions with their cycles (AVR instruction set manual
//! DS40002198, the column AVRe+, 16-bit program counter).
//!
//! An instruction that begins in cycle c and takes n cycles ends with cycle c + n − 1; the next instruction begins in
//! c + n. `in`, `sbis` and `sbic` read in cycle c; loads and stores use the data bus in their second cycle (DS40002061B
//! figure 8-4). A value that an instruction writes is there from cycle c + n on.
//!
//! The I/O registers are not here: [`Io`] is the way to them. `decode` turns words into instructions.

use super::decode::{Op, Step, decode};
use super::spm::FlashChange;

/// Bits of SREG.
pub(super) mod flag {
    pub(in crate::avr) const C: u8 = 1;
    pub(in crate::avr) const Z: u8 = 1 << 1;
    pub(in crate::avr) const N: u8 = 1 << 2;
    pub(in crate::avr) const V: u8 = 1 << 3;
    pub(in crate::avr) const S: u8 = 1 << 4;
    pub(in crate::avr) const H: u8 = 1 << 5;
    pub(in crate::avr) const T: u8 = 1 << 6;
    pub(in crate::avr) const I: u8 = 1 << 7;
}
use flag::{C, H, I, N, S, T, V, Z};

/// Sizes of flash (bytes, words) and RAM (bytes), and the addresses of RAM (DS40002061B §8).
pub(super) const FLASH_BYTES: usize = 32 * 1024;
pub(super) const FLASH_WORDS: usize = FLASH_BYTES / 2;
const PAGE_WORDS: usize = super::spm::PAGE_WORDS as usize;
pub(super) const RAM_START: u16 = 0x100;
pub(super) const RAM_BYTES: usize = 2048;
pub(super) const RAM_END: u16 = RAM_START + RAM_BYTES as u16 - 1;

const PC_MASK: u16 = FLASH_WORDS as u16 - 1;
const SPL: u16 = 0x5d;
const SPH: u16 = 0x5e;
const SREG: u16 = 0x5f;
const IO_START: u16 = 0x20;

/// The I/O registers at data addresses 0x20 to 0xff, without the stack pointer and SREG, which the processor itself
/// has.
pub(super) trait Io {
    /// The byte at a data address, read in `cycle`.
    fn read(&mut self, address: u16, cycle: u64) -> u8;
    /// Writes the byte at a data address; the write takes effect in `cycle`.
    fn write(&mut self, address: u16, value: u8, cycle: u64);
    /// Writes one bit, as `sbi` and `cbi` do; the write takes effect in `cycle`.
    fn write_bit(&mut self, address: u16, bit: u8, value: bool, cycle: u64);
    /// The cycle of the next peripheral event, such as a timer's compare match.
    fn next(&self) -> u64;
    /// Whether an enabled interrupt is pending.
    fn waits(&self) -> bool;
    /// Executes `wdr`: restarts the watchdog.
    fn watchdog(&mut self, cycle: u64);
    /// Executes `sleep`, which begins in `cycle`. Returns whether the processor stops.
    fn sleep(&mut self, cycle: u64) -> bool;
    /// Executes `spm` at word address `pc`, which begins in `cycle`, with Z and R1:R0. Returns what changes in flash.
    fn store_program_memory(&mut self, pc: u16, z: u16, word: u16, cycle: u64) -> Option<FlashChange>;
    /// Executes `lpm` at word address `pc`, which begins in `cycle`, with Z. Returns the byte if it does not come from
    /// flash.
    fn load_program_memory(&mut self, pc: u16, z: u16, cycle: u64) -> Option<u8>;
    /// Whether the section that a word address lies in is being written, so that no instruction can be read from it.
    fn program_blocked(&self, pc: u16) -> bool;
}

/// What a program did that is probably a mistake.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Odd {
    /// Words executed that are no instructions of the ATmega328P. Each takes one cycle and does nothing.
    pub undefined: u64,
    /// Word address of the last such word.
    pub last_undefined: u16,
    /// Accesses to data addresses beyond RAM. They read 0 and write nothing.
    pub outside: u64,
    /// The program counter at the last such access: at the instruction or just after it, word address.
    pub last_outside: u16,
}

/// A stretch of time with interrupts off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Masked {
    /// Its length, cycles: from the cycle in which I became 0 to the one in which I became 1.
    pub cycles: u64,
    /// The program counter at its beginning: the instruction after `cli`, or an interrupt's vector. Word address.
    pub from: u16,
}

#[derive(Clone)]
pub(super) struct Cpu {
    pub(super) registers: [u8; 32],
    pub(super) sreg: u8,
    pub(super) sp: u16,
    /// Word address of the next instruction.
    pub(super) pc: u16,
    pub(super) cycle: u64,
    /// The cycle of the next event. Instructions that begin before it need no look at the peripherals.
    pub(super) horizon: u64,
    /// After `sei` and `reti` one more instruction is executed before an interrupt (DS40002061B §7.7).
    pub(super) shadow: bool,
    pub(super) asleep: bool,
    pub(super) ram: Box<[u8; RAM_BYTES]>,
    flash: Box<[u16; FLASH_WORDS]>,
    program: Box<[Op; FLASH_WORDS]>,
    pub(super) lowest_sp: u16,
    pub(super) masked: Masked,
    masked_since: u64,
    masked_from: u16,
    pub(super) odd: Odd,
}

impl Cpu {
    pub(super) fn new(image: &[u8]) -> Cpu {
        let mut flash = Box::new([0xffff; FLASH_WORDS]);
        for (word, bytes) in flash.iter_mut().zip(image.chunks(2)) {
            *word = u16::from_le_bytes([bytes[0], bytes.get(1).copied().unwrap_or(0xff)]);
        }
        let mut program = Box::new([Op::Undefined; FLASH_WORDS]);
        for (at, op) in program.iter_mut().enumerate() {
            *op = decode(flash[at], flash[(at + 1) % FLASH_WORDS]);
        }
        Cpu {
            registers: [0; 32],
            sreg: 0,
            sp: RAM_END,
            pc: 0,
            cycle: 0,
            horizon: 0,
            shadow: false,
            asleep: false,
            ram: Box::new([0; RAM_BYTES]),
            flash,
            program,
            lowest_sp: RAM_END,
            masked: Masked::default(),
            masked_since: 0,
            masked_from: 0,
            odd: Odd::default(),
        }
    }

    /// Resets the processor: the stack pointer goes to the end of RAM (§7.5.1) and interrupts are off. Registers and
    /// RAM keep their values.
    pub(super) fn reset(&mut self, pc: u16) {
        self.sreg &= I;
        self.pc = pc;
        self.set_interrupts(false);
        self.sp = RAM_END;
        self.shadow = false;
        self.asleep = false;
        self.horizon = 0;
    }

    /// A byte of program memory.
    pub(super) fn flash_byte(&self, address: u16) -> u8 {
        let [low, high] = self.flash[usize::from(address >> 1) % FLASH_WORDS].to_le_bytes();
        if address & 1 == 0 { low } else { high }
    }

    pub(super) fn interrupts(&self) -> bool {
        self.sreg & I != 0
    }

    /// The longest stretch with interrupts off so far, the present one included.
    pub(super) fn longest_masked(&self) -> Masked {
        let open = Masked { cycles: self.cycle - self.masked_since, from: self.masked_from };
        if !self.interrupts() && open.cycles > self.masked.cycles { open } else { self.masked }
    }

    /// Forgets the longest stretch with interrupts off. A stretch that runs now counts from the present cycle.
    pub(super) fn forget_masked(&mut self) {
        self.masked = Masked::default();
        (self.masked_since, self.masked_from) = (self.cycle, self.pc);
    }

    /// Sets or clears I. `pc` and `cycle` must already be those of the next instruction.
    fn set_interrupts(&mut self, on: bool) {
        match (self.interrupts(), on) {
            (false, true) => {
                let cycles = self.cycle - self.masked_since;
                if cycles > self.masked.cycles {
                    self.masked = Masked { cycles, from: self.masked_from };
                }
                self.sreg |= I;
                self.shadow = true;
                self.horizon = 0;
            }
            (true, false) => {
                (self.masked_since, self.masked_from) = (self.cycle, self.pc);
                self.sreg &= !I;
            }
            _ => {}
        }
    }

    /// Enters an interrupt in 4 cycles: the program counter is pushed, I is cleared, and execution goes on at the
    /// vector (§7.7.1).
    pub(super) fn interrupt(&mut self, vector: u16, io: &mut impl Io) {
        self.push_pc(self.pc, io);
        self.pc = vector & PC_MASK;
        // The entry's own cycles count as interrupts off.
        self.set_interrupts(false);
        self.cycle += 4;
    }

    /// Changes the flash as `spm` demands, and decodes what changed.
    fn program(&mut self, change: Option<FlashChange>) {
        let (from, words) = match change {
            None => return,
            Some(FlashChange::Erase(from)) => (from, [0xffff; PAGE_WORDS]),
            Some(FlashChange::Write(from, words)) => {
                let from = from & PC_MASK;
                (from, std::array::from_fn(|at| words[at] & self.flash[usize::from(from) + at]))
            }
        };
        let from = usize::from(from & PC_MASK);
        self.flash[from..from + PAGE_WORDS].copy_from_slice(&words);
        // The word before the page too: it may be the first of a two-word instruction.
        for at in (from + FLASH_WORDS - 1..).take(PAGE_WORDS + 1).map(|at| at % FLASH_WORDS) {
            self.program[at] = decode(self.flash[at], self.flash[(at + 1) % FLASH_WORDS]);
        }
    }

    /// Executes one word of a section that is being written, where every word reads as 0xffff.
    pub(super) fn blocked(&mut self, io: &mut impl Io) {
        self.instruction(Op::Undefined, io);
    }

    /// Executes instructions up to the first that begins at or after the horizon.
    pub(super) fn execute(&mut self, io: &mut impl Io) {
        while self.cycle < self.horizon {
            let op = self.program[usize::from(self.pc & PC_MASK)];
            self.instruction(op, io);
        }
    }

    #[inline(always)]
    fn instruction(&mut self, op: Op, io: &mut impl Io) {
        let here = self.pc;
        let mut pc = here.wrapping_add(1);
        let mut cycles = 1;
        match op {
            Op::Nop | Op::Break => {}
            Op::Undefined => {
                self.odd.undefined += 1;
                self.odd.last_undefined = here & PC_MASK;
            }
            Op::Movw { d, r } => self.set_pair(d, self.pair(r)),
            Op::Mul { d, r } => {
                cycles = 2;
                self.product(u16::from(self.get(d)) * u16::from(self.get(r)), 0);
            }
            Op::Muls { d, r } => {
                cycles = 2;
                self.product(signed(self.get(d)).wrapping_mul(signed(self.get(r))), 0);
            }
            Op::Mulsu { d, r } => {
                cycles = 2;
                self.product(signed(self.get(d)).wrapping_mul(self.get(r).into()), 0);
            }
            Op::Fmul { d, r } => {
                cycles = 2;
                self.product(u16::from(self.get(d)) * u16::from(self.get(r)), 1);
            }
            Op::Fmuls { d, r } => {
                cycles = 2;
                self.product(signed(self.get(d)).wrapping_mul(signed(self.get(r))), 1);
            }
            Op::Fmulsu { d, r } => {
                cycles = 2;
                self.product(signed(self.get(d)).wrapping_mul(self.get(r).into()), 1);
            }
            Op::Add { d, r } => self.add(d, self.get(r), 0),
            Op::Adc { d, r } => self.add(d, self.get(r), self.sreg & C),
            Op::Sub { d, r } => {
                let result = self.subtract(self.get(d), self.get(r));
                self.set(d, result);
            }
            Op::Subi { d, k } => {
                let result = self.subtract(self.get(d), k);
                self.set(d, result);
            }
            Op::Sbc { d, r } => {
                let result = self.subtract_carry(self.get(d), self.get(r));
                self.set(d, result);
            }
            Op::Sbci { d, k } => {
                let result = self.subtract_carry(self.get(d), k);
                self.set(d, result);
            }
            Op::Cp { d, r } => {
                self.subtract(self.get(d), self.get(r));
            }
            Op::Cpi { d, k } => {
                self.subtract(self.get(d), k);
            }
            Op::Cpc { d, r } => {
                self.subtract_carry(self.get(d), self.get(r));
            }
            Op::And { d, r } => self.logic(d, self.get(d) & self.get(r)),
            Op::Andi { d, k } => self.logic(d, self.get(d) & k),
            Op::Or { d, r } => self.logic(d, self.get(d) | self.get(r)),
            Op::Ori { d, k } => self.logic(d, self.get(d) | k),
            Op::Eor { d, r } => self.logic(d, self.get(d) ^ self.get(r)),
            Op::Mov { d, r } => self.set(d, self.get(r)),
            Op::Ldi { d, k } => self.set(d, k),
            Op::Com { d } => {
                self.logic(d, !self.get(d));
                self.sreg |= C;
            }
            Op::Neg { d } => {
                let result = self.subtract(0, self.get(d));
                self.set(d, result);
            }
            Op::Swap { d } => self.set(d, self.get(d).rotate_left(4)),
            Op::Inc { d } => {
                let result = self.get(d).wrapping_add(1);
                self.set(d, result);
                self.flags(V | N | S | Z, sign(result, result == 0x80));
            }
            Op::Dec { d } => {
                let result = self.get(d).wrapping_sub(1);
                self.set(d, result);
                self.flags(V | N | S | Z, sign(result, result == 0x7f));
            }
            Op::Asr { d } => self.shift_right(d, self.get(d) & 0x80),
            Op::Lsr { d } => self.shift_right(d, 0),
            Op::Ror { d } => self.shift_right(d, (self.sreg & C) << 7),
            Op::Adiw { d, k } => {
                cycles = 2;
                let (before, result) = (self.pair(d), self.pair(d).wrapping_add(k.into()));
                self.set_pair(d, result);
                self.wide(result, !before & result & 0x8000 != 0, !result & before & 0x8000 != 0);
            }
            Op::Sbiw { d, k } => {
                cycles = 2;
                let (before, result) = (self.pair(d), self.pair(d).wrapping_sub(k.into()));
                self.set_pair(d, result);
                self.wide(result, before & !result & 0x8000 != 0, result & !before & 0x8000 != 0);
            }
            Op::Bset { s } => {
                if s == 7 {
                    (self.pc, self.cycle) = (pc, self.cycle + 1);
                    self.set_interrupts(true);
                    return;
                }
                self.sreg |= 1 << s;
            }
            Op::Bclr { s } => {
                if s == 7 {
                    (self.pc, self.cycle) = (pc, self.cycle + 1);
                    self.set_interrupts(false);
                    return;
                }
                self.sreg &= !(1 << s);
            }
            Op::Bst { d, b } => self.flags(T, if self.get(d) >> b & 1 != 0 { T } else { 0 }),
            Op::Bld { d, b } => {
                let bit = (self.sreg >> 6 & 1) << b;
                self.set(d, self.get(d) & !(1 << b) | bit);
            }
            Op::Brbs { s, k } => {
                let taken = self.sreg >> s & 1;
                pc = pc.wrapping_add_signed(i16::from(k) * i16::from(taken));
                cycles += u64::from(taken);
            }
            Op::Brbc { s, k } => {
                let taken = !self.sreg >> s & 1;
                pc = pc.wrapping_add_signed(i16::from(k) * i16::from(taken));
                cycles += u64::from(taken);
            }
            Op::Cpse { d, r } => cycles += self.skip(&mut pc, self.get(d) == self.get(r)),
            Op::Sbrc { d, b } => cycles += self.skip(&mut pc, self.get(d) >> b & 1 == 0),
            Op::Sbrs { d, b } => cycles += self.skip(&mut pc, self.get(d) >> b & 1 != 0),
            Op::Sbic { a, b } => {
                let value = self.io_read(u16::from(a) + IO_START, self.cycle, io);
                cycles += self.skip(&mut pc, value >> b & 1 == 0);
            }
            Op::Sbis { a, b } => {
                let value = self.io_read(u16::from(a) + IO_START, self.cycle, io);
                cycles += self.skip(&mut pc, value >> b & 1 != 0);
            }
            Op::In { d, a } => {
                let value = self.io_read(u16::from(a) + IO_START, self.cycle, io);
                self.set(d, value);
            }
            Op::Out { d, a } => {
                (self.pc, self.cycle) = (pc, self.cycle + 1);
                self.io_write(u16::from(a) + IO_START, self.get(d), io);
                return;
            }
            Op::Sbi { a, b } => {
                (self.pc, self.cycle) = (pc, self.cycle + 2);
                self.io_write_bit(u16::from(a) + IO_START, b, true, io);
                return;
            }
            Op::Cbi { a, b } => {
                (self.pc, self.cycle) = (pc, self.cycle + 2);
                self.io_write_bit(u16::from(a) + IO_START, b, false, io);
                return;
            }
            Op::Ldd { d, r, q } => {
                cycles = 2;
                let value = self.load(self.pair(r).wrapping_add(q.into()), io);
                self.set(d, value);
            }
            Op::Ld { d, r, step } => {
                cycles = 2;
                let address = self.pointer(r, step);
                let value = self.load(address, io);
                self.set(d, value);
            }
            Op::Lds { d, address } => {
                cycles = 2;
                pc = pc.wrapping_add(1);
                let value = self.load(address, io);
                self.set(d, value);
            }
            Op::Std { d, r, q } => {
                (self.pc, self.cycle) = (pc, self.cycle + 2);
                self.store(self.pair(r).wrapping_add(q.into()), self.get(d), io);
                return;
            }
            Op::St { d, r, step } => {
                let value = self.get(d);
                let address = self.pointer(r, step);
                (self.pc, self.cycle) = (pc, self.cycle + 2);
                self.store(address, value, io);
                return;
            }
            Op::Sts { d, address } => {
                (self.pc, self.cycle) = (pc.wrapping_add(1), self.cycle + 2);
                self.store(address, self.get(d), io);
                return;
            }
            Op::Lpm { d, increment } => {
                cycles = 3;
                let address = self.pair(30);
                let special = io.load_program_memory(here & PC_MASK, address, self.cycle);
                let value = special.unwrap_or_else(|| self.flash_byte(address));
                if increment {
                    self.set_pair(30, address.wrapping_add(1));
                }
                self.set(d, value);
            }
            Op::Push { d } => {
                (self.pc, self.cycle) = (pc, self.cycle + 2);
                self.push(self.get(d), io);
                return;
            }
            Op::Pop { d } => {
                cycles = 2;
                let value = self.pop(io);
                self.set(d, value);
            }
            Op::Rjmp { k } => {
                cycles = 2;
                pc = pc.wrapping_add_signed(k);
            }
            Op::Jmp { address } => {
                cycles = 3;
                pc = address;
            }
            Op::Ijmp => {
                cycles = 2;
                pc = self.pair(30);
            }
            Op::Rcall { k } => {
                cycles = 3;
                self.push_pc(pc, io);
                pc = pc.wrapping_add_signed(k);
            }
            Op::Icall => {
                cycles = 3;
                self.push_pc(pc, io);
                pc = self.pair(30);
            }
            Op::Call { address } => {
                cycles = 4;
                self.push_pc(pc.wrapping_add(1), io);
                pc = address;
            }
            Op::Ret => {
                cycles = 4;
                pc = self.pop_pc(io);
            }
            Op::Reti => {
                self.pc = self.pop_pc(io) & PC_MASK;
                self.cycle += 4;
                self.set_interrupts(true);
                // `reti` sets `shadow` even if I was 1 already: one instruction of the main program comes before the
                // next interrupt.
                self.shadow = true;
                self.horizon = 0;
                return;
            }
            Op::Sleep => {
                self.asleep = io.sleep(self.cycle + 1);
                self.horizon = 0;
            }
            Op::Wdr => {
                (self.pc, self.cycle) = (pc, self.cycle + 1);
                io.watchdog(self.cycle);
                self.look(io);
                return;
            }
            Op::Spm => {
                let change = io.store_program_memory(here & PC_MASK, self.pair(30), self.pair(0), self.cycle);
                self.program(change);
                self.horizon = 0;
            }
        }
        self.pc = pc & PC_MASK;
        self.cycle += cycles;
    }

    fn get(&self, register: u8) -> u8 {
        self.registers[usize::from(register & 31)]
    }

    fn set(&mut self, register: u8, value: u8) {
        self.registers[usize::from(register & 31)] = value;
    }

    fn pair(&self, low: u8) -> u16 {
        u16::from_le_bytes([self.get(low), self.get(low + 1)])
    }

    fn set_pair(&mut self, low: u8, value: u16) {
        let [l, h] = value.to_le_bytes();
        self.set(low, l);
        self.set(low + 1, h);
    }

    /// The address of an indirect access. `step` changes the pointer before or after it.
    fn pointer(&mut self, low: u8, step: Step) -> u16 {
        let address = self.pair(low);
        match step {
            Step::Keep => address,
            Step::Increment => {
                self.set_pair(low, address.wrapping_add(1));
                address
            }
            Step::Decrement => {
                self.set_pair(low, address.wrapping_sub(1));
                address.wrapping_sub(1)
            }
        }
    }

    /// Replaces the flags of `mask` by `value`.
    fn flags(&mut self, mask: u8, value: u8) {
        self.sreg = self.sreg & !mask | value;
    }

    fn add(&mut self, d: u8, k: u8, carry: u8) {
        let a = self.get(d);
        let result = a.wrapping_add(k).wrapping_add(carry);
        let carries = a & k | (a | k) & !result;
        let overflow = (a ^ result) & (k ^ result) & 0x80 != 0;
        self.set(d, result);
        self.flags(H | S | V | N | Z | C, sign(result, overflow) | carries >> 7 | carries << 2 & H);
    }

    fn subtract(&mut self, a: u8, k: u8) -> u8 {
        let result = a.wrapping_sub(k);
        self.flags(H | S | V | N | Z | C, difference(a, k, result));
        result
    }

    /// As [`subtract`](Cpu::subtract), with the borrow. Z can become 0 here, never 1.
    fn subtract_carry(&mut self, a: u8, k: u8) -> u8 {
        let result = a.wrapping_sub(k).wrapping_sub(self.sreg & C);
        let flags = difference(a, k, result);
        let zero = flags & self.sreg & Z;
        self.flags(H | S | V | N | Z | C, flags & !Z | zero);
        result
    }

    fn logic(&mut self, d: u8, result: u8) {
        self.set(d, result);
        self.flags(S | V | N | Z, sign(result, false));
    }

    fn shift_right(&mut self, d: u8, top: u8) {
        let before = self.get(d);
        let result = before >> 1 | top;
        self.set(d, result);
        let carry = before & 1;
        // V is N xor C.
        self.flags(S | V | N | Z | C, sign(result, (result >> 7) ^ carry != 0) | carry);
    }

    fn wide(&mut self, result: u16, overflow: bool, carry: bool) {
        let [low, high] = result.to_le_bytes();
        let zero = if result == 0 { Z } else { 0 };
        let flags = sign(high | u8::from(low != 0), overflow) & !Z;
        self.flags(S | V | N | Z | C, flags | zero | u8::from(carry));
    }

    fn product(&mut self, product: u16, shift: u8) {
        // The fractional products shift left by one; C is bit 15 before the shift.
        let result = product << shift;
        self.set_pair(0, result);
        let zero = if result == 0 { Z } else { 0 };
        self.flags(Z | C, zero | (product >> 15) as u8);
    }

    /// Moves `pc` behind the next instruction if `skip` is true. Returns the extra cycles.
    fn skip(&self, pc: &mut u16, skip: bool) -> u64 {
        if !skip {
            return 0;
        }
        let words = if self.program[usize::from(*pc & PC_MASK)].is_long() { 2 } else { 1 };
        *pc = pc.wrapping_add(words);
        words.into()
    }

    /// Reads data memory in the present cycle, between two instructions.
    pub(super) fn peek(&mut self, address: u16, io: &mut impl Io) -> u8 {
        match address {
            IO_START..RAM_START => self.io_read(address, self.cycle, io),
            _ => self.load(address, io),
        }
    }

    /// Writes data memory in the present cycle, between two instructions.
    pub(super) fn poke(&mut self, address: u16, value: u8, io: &mut impl Io) {
        self.store(address, value, io);
    }

    /// A load's access to data memory, in the second cycle of the present instruction.
    fn load(&mut self, address: u16, io: &mut impl Io) -> u8 {
        match self.ram.get(usize::from(address.wrapping_sub(RAM_START))) {
            Some(byte) => *byte,
            None if address < IO_START => self.get(address as u8),
            None if address < RAM_START => self.io_read(address, self.cycle + 1, io),
            None => {
                self.outside();
                0
            }
        }
    }

    /// A store's access to data memory. `pc` and `cycle` must already be those of the next instruction.
    fn store(&mut self, address: u16, value: u8, io: &mut impl Io) {
        match self.ram.get_mut(usize::from(address.wrapping_sub(RAM_START))) {
            Some(byte) => *byte = value,
            None if address < IO_START => self.set(address as u8, value),
            None if address < RAM_START => self.io_write(address, value, io),
            None => self.outside(),
        }
    }

    #[cold]
    fn outside(&mut self) {
        self.odd.outside += 1;
        self.odd.last_outside = self.pc & PC_MASK;
    }

    fn io_read(&mut self, address: u16, cycle: u64, io: &mut impl Io) -> u8 {
        match address {
            SPL => self.sp.to_le_bytes()[0],
            SPH => self.sp.to_le_bytes()[1],
            SREG => self.sreg,
            _ => {
                let value = io.read(address, cycle);
                self.look(io);
                value
            }
        }
    }

    fn io_write(&mut self, address: u16, value: u8, io: &mut impl Io) {
        match address {
            // Programs write SPH first and SPL second. Between the two the stack pointer is half old and half new, so
            // that only a write of SPL counts for the lowest value.
            SPL => {
                self.sp = self.sp & 0xff00 | u16::from(value);
                self.lowest_sp = self.lowest_sp.min(self.sp);
            }
            SPH => self.sp = self.sp & 0xff | u16::from(value & 0x0f) << 8,
            SREG => {
                self.set_interrupts(value & I != 0);
                self.sreg = value;
            }
            _ => {
                io.write(address, value, self.cycle);
                self.look(io);
            }
        }
    }

    fn io_write_bit(&mut self, address: u16, bit: u8, value: bool, io: &mut impl Io) {
        io.write_bit(address, bit, value, self.cycle);
        self.look(io);
    }

    /// Takes over the time of the next event after an access to I/O, which may have made it earlier.
    fn look(&mut self, io: &impl Io) {
        self.horizon = if io.waits() && self.interrupts() { 0 } else { self.horizon.min(io.next()) };
    }

    /// Pushes a byte. The stack pointer has 12 bits.
    fn push(&mut self, value: u8, io: &mut impl Io) {
        self.store(self.sp, value, io);
        self.sp = self.sp.wrapping_sub(1) & 0x0fff;
        self.lowest_sp = self.lowest_sp.min(self.sp);
    }

    fn pop(&mut self, io: &mut impl Io) -> u8 {
        self.sp = self.sp.wrapping_add(1) & 0x0fff;
        self.load(self.sp, io)
    }

    /// Pushes the lower byte of the program counter first, so that it lies at the higher address.
    fn push_pc(&mut self, pc: u16, io: &mut impl Io) {
        let [low, high] = (pc & PC_MASK).to_le_bytes();
        self.push(low, io);
        self.push(high, io);
    }

    fn pop_pc(&mut self, io: &mut impl Io) -> u16 {
        let high = self.pop(io);
        let low = self.pop(io);
        u16::from_le_bytes([low, high])
    }
}

/// A byte with its sign extended to 16 bits.
const fn signed(byte: u8) -> u16 {
    byte as i8 as u16
}

/// The flags N, Z, V, and S = N xor V of a result.
const fn sign(result: u8, overflow: bool) -> u8 {
    let n = result >> 7;
    let v = overflow as u8;
    ((result == 0) as u8) << 1 | n << 2 | v << 3 | (n ^ v) << 4
}

/// The flags of a − k. `result` may be less by a borrow.
const fn difference(a: u8, k: u8, result: u8) -> u8 {
    let borrows = !a & k | (!a | k) & result;
    let overflow = (a ^ k) & (a ^ result) & 0x80 != 0;
    sign(result, overflow) | borrows >> 7 | borrows << 2 & H
}
