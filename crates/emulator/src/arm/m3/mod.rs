//! The Cortex-M3: what it does not share with the other processors (ARMv7-M ARM DDI 0403E; TRM DDI 0337, r2p0).
//!
//! - `operation`, `short`, `long`: operations, and the decoders of instructions of 16 and 32 bits
//! - `execute`, `arithmetic`: what operations do, and their cycles
//! - `memory`: loads and stores: pipelining, the store buffer, unaligned accesses, bit-banding, exclusive access
//! - `system`: its private registers

mod arithmetic;
mod execute;
mod long;
mod memory;
mod operation;
mod short;
mod system;

use super::bus::{Bus, Size};
use super::cpu::{Config, Core};
use super::fault::FaultCause;
use super::nvic::{BUS_FAULT, HARD_FAULT, IRQ, MEMORY_FAULT, USAGE_FAULT, bit};
use super::variant::{Variant, private};
use operation::Operation;

/// A Cortex-M3 processor.
///
/// # Cycles
/// Those of the TRM's table of instructions (DDI 0337). Where it gives a range, this is taken:
///
/// - a branch that is taken fills the pipeline again in [`M3Options::refill`] cycles; the TRM has 1 to 3
/// - `udiv` and `sdiv` take 2 to 12: here 2, and one more for each three places that the quotient may have
/// - `umull` and `smull` take 3 to 5, `umlal` 4 to 7, `smlal` one more at most: here the most, unless both factors have
///   16 bits
/// - `mrs`, `msr` and `cps` take 2 of 1 to 2; an `it` takes 1 (it is never folded)
///
/// An exception's handler begins 12 cycles after it became due; the last instruction before it is not interrupted, also
/// if it is a division or a load of many registers, which the chip abandons or continues later. Restoring registers takes
/// [`M3Options::return_cycles`]; what becomes due meanwhile ends that, and begins 7 cycles after it became due.
///
/// # Example
/// ```
/// use pulsetrain_emulator::arm::{Bus, BusFault, Config, CortexM3, M3Options, Size};
///
/// /// 32 bytes of memory at address 0.
/// struct Memory([u8; 32]);
/// impl Bus for Memory {
///     fn read(&mut self, address: u32, size: Size, _: u64) -> Result<u32, BusFault> {
///         let at = address as usize;
///         let bytes = self.0.get(at..at + size.bytes() as usize).ok_or(BusFault { address })?;
///         Ok(bytes.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte)))
///     }
///     fn write(&mut self, address: u32, _: Size, _: u32, _: u64) -> Result<(), BusFault> {
///         Err(BusFault { address })
///     }
///     fn fetch(&mut self, address: u32, cycle: u64) -> Result<u16, BusFault> {
///         self.read(address, Size::Half, cycle).map(|value| value as u16)
///     }
/// }
///
/// let mut memory = Memory([0; 32]);
/// memory.0[..8].copy_from_slice(&[0x00, 0x10, 0x00, 0x20, 0x09, 0x00, 0x00, 0x00]); // stack pointer, reset vector
/// memory.0[8..16].copy_from_slice(&[0x64, 0x20, 0x07, 0x21, 0xb0, 0xfb, 0xf1, 0xf0]); // movs r0, #100; movs r1, #7; udiv r0, r0, r1
/// let mut cpu = CortexM3::new(Config::CORTEX_M3, M3Options::default());
/// cpu.reset(&mut memory);
/// for _ in 0..3 {
///     cpu.step(&mut memory);
/// }
/// assert_eq!((cpu.register(0), cpu.fault()), (14, None));
/// ```
pub type CortexM3 = Core<M3>;

/// The choices that the Cortex-M3 leaves to the maker of a chip, and what its manual leaves open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct M3Options {
    /// Interrupt lines, at most 48.
    pub interrupts: u32,
    /// Bits of a priority, 3 to 8.
    pub priority_bits: u32,
    /// Cycles in which a branch that is taken fills the pipeline again: 1 to 3 (TRM, table of instructions, P).
    pub refill: u32,
    /// Cycles from the end of the instruction that ends a handler to the next instruction of what was interrupted. Arm
    /// gives no number; its drawings of the time when a return is interrupted, 7 to 18 cycles, mean 12.
    pub return_cycles: u32,
}

impl Default for M3Options {
    /// 32 lines, priorities of 4 bits, 2 cycles to fill the pipeline, 12 to return.
    fn default() -> M3Options {
        M3Options { interrupts: 32, priority_bits: 4, refill: 2, return_cycles: 12 }
    }
}

impl Config {
    /// A Cortex-M3 r2p0 with its vector table at 0 and a reference clock as fast as the processor's.
    pub const CORTEX_M3: Config =
        Config { vector_table: 0, cpuid: 0x412f_c230, systick_calibration: 0, systick_reference: 1 };
}

/// Instructions of 32 bits that were decoded before, by their bits: not by address, so that a program may write code.
const CACHED: usize = 4096;

/// No register was loaded by the instruction before.
const NO_LOAD: u8 = u8::MAX;

/// The part of a Cortex-M3 that other processors do not have.
#[derive(Clone)]
pub struct M3 {
    options: M3Options,
    narrow: &'static [Operation],
    wide: Box<[(u32, Operation)]>,
    /// ITSTATE: 0 outside an IT block.
    it: u8,
    /// APSR.Q: an operation has saturated.
    q: bool,
    /// The address that is marked for exclusive access.
    exclusive: Option<u32>,
    /// The cycle from which the next access may put its address on the bus: the store buffer has one entry.
    bus_free: u64,
    /// The register that the present instruction's predecessor loaded, if it was a single load: the next access can
    /// overlap with it.
    loaded: u8,
    /// The register that the present instruction loads.
    loads: u8,
    registers: system::Registers,
}

impl private::Sealed for M3 {}

impl Variant for M3 {
    /// As many as there can be: [`CortexM3::new`] sets those that the chip has.
    const PRIORITY_BITS: u8 = 0xff;
    /// r2p0: bits 29 to 7.
    const VECTOR_TABLE_BITS: u32 = 0x3fff_ff80;
    const EXCEPTION_BITS: u32 = 0x1ff;
    /// Eight registers at one a cycle; the vector is read at the same time over another bus. In all 12 cycles (TRM,
    /// "Exceptions").
    const STACKING: u64 = 8;
    const VECTOR: u64 = 4;
    /// TRM, "Exceptions".
    const TAIL_CHAIN: u64 = 6;
    const READS_VECTOR_EARLY: bool = true;
    /// [`interruptible_return`](Variant::interruptible_return) counts them.
    const UNSTACKING: u64 = 1;

    #[inline(always)]
    fn instruction(core: &mut Core<Self>, bus: &mut impl Bus) {
        core.execute_next(bus);
    }

    fn reset(core: &mut Core<Self>) {
        core.variant.start();
        let end = IRQ + core.variant.options.interrupts.min(48);
        core.exceptions.interrupts = (u64::MAX >> (64 - end)) & !(bit(IRQ) - 1);
        core.exceptions.enabled &= !(bit(MEMORY_FAULT) | bit(BUS_FAULT) | bit(USAGE_FAULT));
        core.exceptions.priority_bits = priority_mask(core.variant.options.priority_bits);
        core.set_priority_group(0);
    }

    fn interruptible_return(core: &Core<Self>) -> Option<u64> {
        Some(u64::from(core.variant.options.return_cycles.max(1)))
    }

    fn more_xpsr(core: &Core<Self>) -> u32 {
        let it = u32::from(core.variant.it);
        u32::from(core.variant.q) << 27 | (it & 3) << 25 | (it >> 2) << 10
    }

    fn set_more_xpsr(core: &mut Core<Self>, xpsr: u32) {
        core.variant.q = xpsr >> 27 & 1 != 0;
        core.variant.it = ((xpsr >> 25 & 3) | (xpsr >> 8 & 0xfc)) as u8;
    }

    fn aligns_stack(core: &Core<Self>) -> bool {
        core.variant.registers.aligns_stack()
    }

    fn settle(core: &mut Core<Self>) {
        core.cycle = core.cycle.max(core.variant.bus_free);
    }

    fn enter_handler(core: &mut Core<Self>) {
        core.variant.it = 0;
        core.variant.exclusive = None;
        core.variant.loads = NO_LOAD;
    }

    fn may_return_early(core: &Core<Self>) -> bool {
        core.variant.registers.returns_early()
    }

    fn fault_exception(core: &mut Core<Self>, cause: FaultCause) -> u32 {
        let exception = core.variant.registers.note(cause);
        let is_enabled = core.exceptions.enabled & bit(exception) != 0;
        if is_enabled && core.exceptions.group_priority(exception) < core.exceptions.execution_priority() {
            return exception;
        }
        if exception != HARD_FAULT {
            core.variant.registers.note_escalation();
        }
        HARD_FAULT
    }

    fn may_access(core: &Core<Self>, address: u32, size: Size) -> bool {
        let is_narrow = size != Size::Word;
        (core.is_privileged() || core.variant.registers.lets_program_trigger(address))
            && (!is_narrow || system::allows_narrow(address))
    }

    fn widened(core: &mut Core<Self>, address: u32, size: Size, value: u32) -> u32 {
        system::widened(core, address, size, value)
    }

    fn read_own_register(core: &mut Core<Self>, address: u32) -> Option<u32> {
        core.read_m3_register(address)
    }

    fn write_own_register(core: &mut Core<Self>, bus: &mut impl Bus, address: u32, value: u32) -> bool {
        core.write_m3_register(bus, address, value)
    }
}

/// The implemented bits of a priority, at the top of a byte.
fn priority_mask(bits: u32) -> u8 {
    (0xff00_u32 >> bits.clamp(3, 8)) as u8
}

impl M3 {
    fn new(options: M3Options) -> M3 {
        M3 {
            options,
            narrow: &short::TABLE,
            // A word of zeros is no instruction of 32 bits.
            wide: vec![(0, Operation::Undefined); CACHED].into_boxed_slice(),
            it: 0,
            q: false,
            exclusive: None,
            bus_free: 0,
            loaded: NO_LOAD,
            loads: NO_LOAD,
            registers: system::Registers::new(),
        }
    }

    fn start(&mut self) {
        (self.it, self.q, self.exclusive, self.loads) = (0, false, None, NO_LOAD);
        self.registers = system::Registers::new();
    }

    /// Decodes an instruction of 32 bits.
    #[inline]
    fn decode(&mut self, first: u16, second: u16) -> Operation {
        let word = u32::from(first) << 16 | u32::from(second);
        let place = (word ^ word >> 12 ^ word >> 20) as usize % CACHED;
        let (known, op) = self.wide[place];
        if known == word {
            return op;
        }
        let op = long::decode(first, second);
        self.wide[place] = (word, op);
        op
    }
}

impl CortexM3 {
    /// A processor before its reset, at cycle 0: [`reset`](Core::reset) starts it.
    pub fn new(config: Config, options: M3Options) -> CortexM3 {
        let mut core = Core::with(config, M3::new(options));
        M3::reset(&mut core);
        core
    }

    /// Sets the levels of the interrupt lines. A rising line makes its interrupt pending. A line that is still high when
    /// its handler returns makes it pending again (ARMv7-M ARM §B3.4.1). Lines that the chip does not have are ignored.
    #[inline]
    pub fn set_irq_lines(&mut self, levels: u64) {
        self.set_lines(levels & self.exceptions.interrupts >> IRQ);
    }

    /// BASEPRI: what is not more urgent than this is masked, unless it is 0.
    pub fn basepri(&self) -> u8 {
        self.exceptions.basepri
    }

    /// FAULTMASK: whether all exceptions but the NMI are masked.
    pub fn faultmask(&self) -> bool {
        self.exceptions.faultmask
    }

    /// Sets Q and the state of an IT block from the bits of XPSR, besides the flags N, Z, C and V.
    pub fn set_xpsr(&mut self, xpsr: u32) {
        self.set_flags(xpsr);
        M3::set_more_xpsr(self, xpsr);
    }

    /// Stores that are under way end by this cycle.
    pub fn stored_by(&self) -> u64 {
        self.variant.bus_free
    }
}
