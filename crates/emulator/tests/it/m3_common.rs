//! A Cortex-M3 with nothing but memory around it.

use crate::arm_common::{BX_LR, CODE, Memory, RAM, STACK, VECTORS, handler};
use pulsetrain_emulator::arm::{Config, CortexM3, M3Options};

/// Registers that tests of both processors use.
pub(crate) const ISER: u32 = 0xe000_e100;
pub(crate) const ISPR: u32 = 0xe000_e200;
pub(crate) const IPR: u32 = 0xe000_e400;
pub(crate) const CCR: u32 = 0xe000_ed14;
pub(crate) const SHCSR: u32 = 0xe000_ed24;
pub(crate) const CFSR: u32 = 0xe000_ed28;
pub(crate) const HFSR: u32 = 0xe000_ed2c;

/// Where an instruction can be executed aside.
const ASIDE: u32 = RAM + 0xf000;

#[derive(Clone)]
pub(crate) struct M3Bench {
    pub(crate) cpu: CortexM3,
    pub(crate) memory: Memory,
}

impl M3Bench {
    /// A program at `CODE`; each handler is `bx lr`. 45 interrupts, as a SAM3X8E has.
    pub(crate) fn with(code: &[u16]) -> M3Bench {
        M3Bench::with_options(code, M3Options { interrupts: 45, ..M3Options::default() })
    }

    pub(crate) fn with_options(code: &[u16], options: M3Options) -> M3Bench {
        let mut memory = Memory::new();
        memory.set_word(VECTORS, STACK);
        memory.set_word(VECTORS + 4, CODE | 1);
        for exception in 2..64 {
            memory.set_word(VECTORS + 4 * exception, handler(exception) | 1);
            memory.set_code(handler(exception), &[BX_LR]);
        }
        memory.set_code(CODE, code);
        let mut cpu = CortexM3::new(Config { vector_table: VECTORS, ..Config::CORTEX_M3 }, options);
        cpu.reset(&mut memory);
        memory.accesses.clear();
        M3Bench { cpu, memory }
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

    pub(crate) fn run_to(&mut self, cycle: u64) {
        while self.now() < cycle {
            self.step();
        }
    }

    /// The cycles of so many steps.
    pub(crate) fn cycles(&mut self, steps: usize) -> Vec<u32> {
        (0..steps).map(|_| self.step()).collect()
    }

    /// Writes a register; what the program has in its own registers stays.
    pub(crate) fn poke(&mut self, address: u32, value: u32) {
        self.aside(0x6008, address, value); // str r0, [r1]
    }

    pub(crate) fn peek(&mut self, address: u32) -> u32 {
        self.aside(0x6808, address, 0) // ldr r0, [r1]
    }

    fn aside(&mut self, instruction: u16, address: u32, value: u32) -> u32 {
        let saved = [0, 1, 15].map(|number| (number, self.cpu.register(number)));
        let (before, faults) = (self.cpu.instructions(), self.cpu.fault());
        self.memory.set_code(ASIDE, &[instruction]);
        for (number, value) in [(0, value), (1, address), (15, ASIDE)] {
            self.cpu.set_register(number, value);
        }
        self.step();
        assert_eq!((self.cpu.instructions(), self.cpu.fault()), (before + 1, faults), "{address:#x}");
        let result = self.cpu.register(0);
        for (number, value) in saved {
            self.cpu.set_register(number, value);
        }
        result
    }
}
