//! A processor with nothing but memory around it, which writes down each access.
#![allow(dead_code, reason = "each test uses its part")]

use pulsetrain_emulator::arm::{Bus, BusFault, Config, Cpu, Size};

pub(crate) const RAM: u32 = 0x2000_0000;
pub(crate) const RAM_BYTES: u32 = 0x1_0000;
/// Where single-cycle peripherals lie; here memory that repeats.
pub(crate) const IO_PORT: u32 = 0xd000_0000;
/// Where memory takes three cycles more.
pub(crate) const SLOW: u32 = 0x4000_0000;
const SLOW_WAITS: u32 = 3;

/// A load or store: cycle, address, size, and what was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Access {
    pub(crate) cycle: u64,
    pub(crate) address: u32,
    pub(crate) size: Size,
    pub(crate) written: Option<u32>,
}

/// Memory at `RAM`, seen at `IO_PORT` and `SLOW` too; elsewhere nothing.
#[derive(Clone)]
pub(crate) struct Memory {
    pub(crate) bytes: Vec<u8>,
    pub(crate) accesses: Vec<Access>,
    pub(crate) events: u32,
    pub(crate) resets: u32,
    waits: u32,
}

impl Memory {
    pub(crate) fn new() -> Memory {
        Memory { bytes: vec![0; RAM_BYTES as usize], accesses: Vec::new(), events: 0, resets: 0, waits: 0 }
    }

    fn range(&mut self, address: u32, size: Size) -> Result<std::ops::Range<usize>, BusFault> {
        let base = [RAM, IO_PORT, SLOW].into_iter().find(|base| address.wrapping_sub(*base) < RAM_BYTES);
        let base = base.ok_or(BusFault { address })?;
        self.waits = if base == SLOW { SLOW_WAITS } else { 0 };
        let at = (address - base) as usize;
        Ok(at..at + size.bytes() as usize)
    }

    pub(crate) fn word(&self, address: u32) -> u32 {
        let at = (address - RAM) as usize;
        u32::from_le_bytes(self.bytes[at..at + 4].try_into().expect("four bytes"))
    }

    pub(crate) fn set_word(&mut self, address: u32, value: u32) {
        let at = (address - RAM) as usize;
        self.bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
    }

    pub(crate) fn set_code(&mut self, address: u32, code: &[u16]) {
        let at = (address - RAM) as usize;
        for (place, word) in self.bytes[at..].chunks_mut(2).zip(code) {
            place.copy_from_slice(&word.to_le_bytes());
        }
    }
}

impl Bus for Memory {
    fn read(&mut self, address: u32, size: Size, cycle: u64) -> Result<u32, BusFault> {
        let range = self.range(address, size)?;
        self.accesses.push(Access { cycle, address, size, written: None });
        Ok(self.bytes[range].iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte)))
    }

    fn write(&mut self, address: u32, size: Size, value: u32, cycle: u64) -> Result<(), BusFault> {
        let range = self.range(address, size)?;
        self.accesses.push(Access { cycle, address, size, written: Some(value) });
        for (byte, new) in self.bytes[range].iter_mut().zip(value.to_le_bytes()) {
            *byte = new;
        }
        Ok(())
    }

    fn fetch(&mut self, address: u32, _: u64) -> Result<u16, BusFault> {
        let range = self.range(address, Size::Half)?;
        Ok(u16::from_le_bytes([self.bytes[range.start], self.bytes[range.start + 1]]))
    }

    fn wait_cycles(&mut self) -> u32 {
        std::mem::take(&mut self.waits)
    }

    fn is_io_port(&self, address: u32) -> bool {
        address >> 28 == IO_PORT >> 28
    }

    fn send_event(&mut self) {
        self.events += 1;
    }

    fn request_reset(&mut self) {
        self.resets += 1;
    }
}

/// The vector table, the program, the handlers, the stacks' ends.
pub(crate) const VECTORS: u32 = RAM;
pub(crate) const CODE: u32 = RAM + 0x1000;
pub(crate) const HANDLERS: u32 = RAM + 0x2000;
pub(crate) const STACK: u32 = RAM + 0x8000;
pub(crate) const PROCESS_STACK: u32 = RAM + 0xa000;

/// The handler of an exception; 256 bytes for each.
pub(crate) const fn handler(exception: u32) -> u32 {
    HANDLERS + 0x100 * exception
}

/// A processor in memory, at the beginning of a program.
#[derive(Clone)]
pub(crate) struct Bench {
    pub(crate) cpu: Cpu,
    pub(crate) memory: Memory,
}

impl Bench {
    /// A program at `CODE`; each handler is `bx lr`.
    pub(crate) fn with(code: &[u16]) -> Bench {
        let mut memory = Memory::new();
        memory.set_word(VECTORS, STACK);
        memory.set_word(VECTORS + 4, CODE | 1);
        for exception in 2..48 {
            memory.set_word(VECTORS + 4 * exception, handler(exception) | 1);
            memory.set_code(handler(exception), &[BX_LR]);
        }
        memory.set_code(CODE, code);
        let mut cpu = Cpu::new(Config { vector_table: VECTORS, ..Config::default() });
        cpu.reset(&mut memory);
        memory.accesses.clear();
        Bench { cpu, memory }
    }

    pub(crate) fn step(&mut self) -> u32 {
        self.cpu.step(&mut self.memory)
    }

    pub(crate) fn now(&self) -> u64 {
        self.cpu.cycle()
    }

    /// Steps until an address is next; the cycle.
    pub(crate) fn reach(&mut self, address: u32) -> u64 {
        for _ in 0..10_000 {
            if self.cpu.pc() == address {
                return self.now();
            }
            self.step();
        }
        panic!("{address:#x} was not reached; {:x?}", self.cpu.fault());
    }

    /// Steps to a cycle, or to the end of the step that is over it.
    pub(crate) fn run_to(&mut self, cycle: u64) {
        while self.now() < cycle {
            self.step();
        }
    }

    /// Writes a register, in the two cycles of a store; what the program has in its own registers stays.
    pub(crate) fn poke(&mut self, address: u32, value: u32) {
        self.aside(0x6008, address, value); // str r0, [r1]
    }

    /// Reads a register, in the two cycles of a load.
    pub(crate) fn peek(&mut self, address: u32) -> u32 {
        self.aside(0x6808, address, 0) // ldr r0, [r1]
    }

    fn aside(&mut self, instruction: u16, address: u32, value: u32) -> u32 {
        let saved = [0, 1, 15].map(|number| (number, self.cpu.register(number)));
        self.memory.set_code(ASIDE, &[instruction]);
        for (number, value) in [(0, value), (1, address), (15, ASIDE)] {
            self.cpu.set_register(number, value);
        }
        assert_eq!(self.step(), 2, "{address:#x}: {:x?}", self.cpu.fault());
        let result = self.cpu.register(0);
        for (number, value) in saved {
            self.cpu.set_register(number, value);
        }
        result
    }
}

/// Where an instruction can be executed aside.
const ASIDE: u32 = RAM + 0xf000;

pub(crate) const NOP: u16 = 0xbf00;
pub(crate) const BX_LR: u16 = 0x4770;
