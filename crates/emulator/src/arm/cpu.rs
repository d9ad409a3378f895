//! What all processors have, and what their users call: registers, steps, cycle count, and the Cortex-M0+'s loads and
//! stores on the bus (TRM DDI 0484C).
//!
//! Instructions are in `execute`, exceptions in `exception` and `nvic`, the private registers in `system`.

use super::bus::{Bus, Size};
use super::fault::{Fault, FaultCause};
use super::m0plus::M0Plus;
use super::nvic::{Exceptions, Sleep};
use super::systick::SysTick;
use super::variant::Variant;

pub(super) const SP: usize = 13;
pub(super) const LR: usize = 14;
pub(super) const PC: usize = 15;

/// The choices that the processor leaves to the maker of a chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Config {
    /// VTOR after a reset: the address of the vector table, which begins with the initial stack pointer. A multiple of
    /// 256.
    pub vector_table: u32,
    /// The value of CPUID.
    pub cpuid: u32,
    /// The value of SYST_CALIB.
    pub systick_calibration: u32,
    /// Processor cycles from one tick of SysTick's reference clock to the next (CLKSOURCE 0).
    pub systick_reference: u32,
}

impl Default for Config {
    /// A Cortex-M0+ r0p1 with its vector table at 0 and a reference clock as fast as the processor's.
    fn default() -> Config {
        Config { vector_table: 0, cpuid: 0x410c_c601, systick_calibration: 0, systick_reference: 1 }
    }
}

/// What the processor executes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Mode {
    /// The program outside handlers.
    Thread,
    /// The handler of an exception.
    Handler,
}

/// A Cortex-M0+ processor.
pub type Cpu = Core<M0Plus>;

/// A processor: what the Cortex-M0+ and the Cortex-M3 have in common, and with `V` the rest of one of them.
///
/// ```
/// use pulsetrain_emulator::arm::{Bus, BusFault, Config, Cpu, Size};
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
/// memory.0[8..12].copy_from_slice(&[0x2a, 0x20, 0x40, 0x43]); // movs r0, #42; muls r0, r0, r0
/// let mut cpu = Cpu::new(Config::default());
/// cpu.reset(&mut memory);
/// assert_eq!((cpu.register(13), cpu.pc()), (0x2000_1000, 8));
/// assert_eq!(cpu.step(&mut memory) + cpu.step(&mut memory), 2);
/// assert_eq!((cpu.register(0), cpu.fault()), (1764, None));
/// ```
#[derive(Clone)]
pub struct Core<V: Variant> {
    /// R0 to R12, the stack pointer in use (13), LR (14). Element 15 is not used: `pc` has the program counter.
    pub(super) registers: [u32; 16],
    /// Address of the next instruction, or of the one that is being executed now.
    pub(super) pc: u32,
    pub(super) n: bool,
    pub(super) z: bool,
    pub(super) c: bool,
    pub(super) v: bool,
    /// EPSR.T. Without it the next instruction faults.
    pub(super) thumb: bool,
    /// The stack pointer that is not in use.
    pub(super) other_sp: u32,
    /// CONTROL.SPSEL: thread mode uses the process stack. In handler mode it is false.
    pub(super) process_stack: bool,
    /// CONTROL.nPRIV: thread mode has no privileges.
    pub(super) unprivileged: bool,
    pub(super) cycle: u64,
    pub(super) instructions: u64,
    /// The cycle up to which instructions can be executed without a look at exceptions and SysTick.
    pub(super) attention: u64,
    pub(super) exceptions: Exceptions,
    pub(super) systick: SysTick,
    pub(super) config: Config,
    /// What other processors do not have.
    pub(super) variant: V,
}

impl<V: Variant> Core<V> {
    pub(super) fn with(config: Config, variant: V) -> Core<V> {
        Core {
            registers: [0; 16],
            pc: 0,
            n: false,
            z: false,
            c: false,
            v: false,
            thumb: true,
            other_sp: 0,
            process_stack: false,
            unprivileged: false,
            cycle: 0,
            instructions: 0,
            attention: 0,
            exceptions: Exceptions::new(config.vector_table, V::PRIORITY_BITS),
            systick: SysTick::new(config.systick_reference, config.systick_calibration),
            config,
            variant,
        }
    }

    /// Resets the processor in the present cycle: it reads stack pointer and program counter from the vector table
    /// (ARMv6-M ARM §B1.5.5, ARMv7-M ARM §B1.5.5). Interrupt lines keep their levels, and the cycle count goes on. The processor faults if
    /// the table cannot be read or the reset vector is even: see [`fault`](Core::fault).
    pub fn reset(&mut self, bus: &mut impl Bus) {
        let table = self.config.vector_table;
        self.registers[..SP].fill(0);
        self.registers[LR] = u32::MAX;
        (self.n, self.z, self.c, self.v) = (false, false, false, false);
        (self.process_stack, self.unprivileged) = (false, false);
        self.exceptions.reset(table);
        self.systick.reset(self.cycle);
        V::reset(self);
        let mut read = |address| bus.read(address, Size::Word, self.cycle);
        let vectors = read(table).and_then(|sp| Ok((sp, read(table.wrapping_add(4))?)));
        match vectors {
            Ok((sp, start)) => {
                self.registers[SP] = sp & !3;
                self.pc = start & !1;
                self.thumb = start & 1 != 0;
            }
            Err(fault) => self.lock_up(FaultCause::Vector { address: fault.address }),
        }
        self.refresh();
    }

    /// Makes one step, and returns its cycles, at least 1. A step is an instruction, or one part of an exception
    /// (stacking the registers, reading the vector), or one cycle of sleep or lock-up.
    #[inline]
    pub fn step(&mut self, bus: &mut impl Bus) -> u32 {
        let began = self.cycle;
        if began < self.attention || !self.attend(bus) {
            V::instruction(self, bus);
        }
        (self.cycle - began) as u32
    }

    /// The cycle in which the next step begins.
    #[inline]
    pub fn cycle(&self) -> u64 {
        self.cycle
    }

    /// Instructions executed so far, those that faulted included.
    pub fn instructions(&self) -> u64 {
        self.instructions
    }

    /// Reads a register: R0 to R12, the stack pointer in use (13), LR (14), or the address of the next instruction
    /// (15).
    ///
    /// # Panics
    /// If there is no such register.
    pub fn register(&self, number: usize) -> u32 {
        if number == PC { self.pc } else { self.registers[number] }
    }

    /// Sets a register, numbered as in [`register`](Core::register). Stack pointer and program counter are aligned.
    ///
    /// # Panics
    /// If there is no such register.
    pub fn set_register(&mut self, number: usize, value: u32) {
        match number {
            PC => self.pc = value & !1,
            SP => self.registers[SP] = value & !3,
            _ => self.registers[number] = value,
        }
    }

    /// The address of the next instruction.
    pub fn pc(&self) -> u32 {
        self.pc
    }

    /// XPSR: flags, T bit and exception number; of a Cortex-M3 also Q and the state of its IT block.
    pub fn xpsr(&self) -> u32 {
        self.apsr() | u32::from(self.thumb) << 24 | self.exceptions.current() | V::more_xpsr(self)
    }

    /// Sets the flags N, Z, C and V from bits 31 to 28. The other bits are ignored.
    pub fn set_flags(&mut self, apsr: u32) {
        self.n = apsr >> 31 & 1 != 0;
        self.z = apsr >> 30 & 1 != 0;
        self.c = apsr >> 29 & 1 != 0;
        self.v = apsr >> 28 & 1 != 0;
    }

    /// Whether a handler runs, or the program.
    pub fn mode(&self) -> Mode {
        if self.exceptions.current() == 0 { Mode::Thread } else { Mode::Handler }
    }

    /// The main stack pointer.
    pub fn msp(&self) -> u32 {
        if self.process_stack { self.other_sp } else { self.registers[SP] }
    }

    /// The process stack pointer.
    pub fn psp(&self) -> u32 {
        if self.process_stack { self.registers[SP] } else { self.other_sp }
    }

    /// PRIMASK: whether interrupts are masked.
    pub fn primask(&self) -> bool {
        self.exceptions.primask
    }

    /// Sets the processor cycles from one tick of SysTick's reference clock to the next; 0 counts as 1.
    pub fn set_systick_reference(&mut self, cycles: u32) {
        self.count_systick(self.cycle);
        self.systick.set_reference(cycles);
        self.refresh();
    }

    /// SysTick's current value (SYST_CVR) in the present cycle. Reading it has no effect.
    pub fn systick_value(&self) -> u32 {
        self.systick.value_in(self.cycle)
    }

    /// The cycle in which SysTick next raises its exception, if it is set to do so.
    #[inline]
    pub fn next_own_event(&self) -> Option<u64> {
        self.systick.next()
    }

    /// Whether the processor sleeps in `wfi` or `wfe`, or because of sleep on exit. Its steps are then single cycles.
    #[inline]
    pub fn is_asleep(&self) -> bool {
        self.exceptions.sleep != Sleep::Awake && !self.wakes()
    }

    /// Moves a sleeping or locked-up processor forward to a cycle, but not past the next SysTick exception. A processor
    /// that is awake stays where it is.
    pub fn sleep_until(&mut self, cycle: u64) {
        if self.is_asleep() || self.is_locked_up() {
            let end = self.next_own_event().map_or(cycle, |event| cycle.min(event));
            self.cycle = self.cycle.max(end);
        }
    }

    /// Whether a fault within a fault has locked up the processor. Only a reset or an NMI ends the lock-up.
    #[inline]
    pub fn is_locked_up(&self) -> bool {
        self.exceptions.locked_up
    }

    /// The last fault since the reset.
    pub fn fault(&self) -> Option<Fault> {
        self.exceptions.fault
    }

    pub(super) fn apsr(&self) -> u32 {
        u32::from(self.n) << 31 | u32::from(self.z) << 30 | u32::from(self.c) << 29 | u32::from(self.v) << 28
    }

    pub(super) fn is_privileged(&self) -> bool {
        !self.unprivileged || self.mode() == Mode::Handler
    }

    /// Selects the process stack pointer, or the main one.
    pub(super) fn use_process_stack(&mut self, process: bool) {
        if self.process_stack != process {
            self.process_stack = process;
            std::mem::swap(&mut self.registers[SP], &mut self.other_sp);
        }
    }

    /// An instruction's only load: two cycles, or one on the I/O port.
    #[inline]
    pub(super) fn load(&mut self, bus: &mut impl Bus, address: u32, size: Size) -> Result<u32, FaultCause> {
        if !bus.is_io_port(address) {
            self.cycle += 1;
        }
        self.load_next(bus, address, size)
    }

    /// One load of several, whose address is already on the bus: one cycle.
    #[inline]
    pub(super) fn load_next(&mut self, bus: &mut impl Bus, address: u32, size: Size) -> Result<u32, FaultCause> {
        if address & (size.bytes() - 1) != 0 {
            return Err(FaultCause::Unaligned { address });
        }
        let value = if is_private(address) {
            self.read_private(address, size)?
        } else {
            let value =
                bus.read(address, size, self.cycle).map_err(|fault| FaultCause::Bus { address: fault.address })?;
            self.cycle += u64::from(bus.wait_cycles());
            value
        };
        self.cycle += 1;
        Ok(value)
    }

    /// An instruction's only store: two cycles, or one on the I/O port.
    #[inline]
    pub(super) fn store(&mut self, bus: &mut impl Bus, address: u32, size: Size, value: u32) -> Result<(), FaultCause> {
        if !bus.is_io_port(address) {
            self.cycle += 1;
        }
        self.store_next(bus, address, size, value)
    }

    /// One store of several, whose address is already on the bus: one cycle.
    #[inline]
    pub(super) fn store_next(
        &mut self,
        bus: &mut impl Bus,
        address: u32,
        size: Size,
        value: u32,
    ) -> Result<(), FaultCause> {
        if address & (size.bytes() - 1) != 0 {
            return Err(FaultCause::Unaligned { address });
        }
        if is_private(address) {
            self.write_private(bus, address, size, value)?;
        } else {
            bus.write(address, size, value, self.cycle).map_err(|fault| FaultCause::Bus { address: fault.address })?;
            self.cycle += u64::from(bus.wait_cycles());
        }
        self.cycle += 1;
        Ok(())
    }
}

/// Whether the address belongs to the private peripheral bus (ARMv6-M ARM §B3.1): 0xe000_0000 to 0xe00f_ffff.
#[inline]
pub(super) fn is_private(address: u32) -> bool {
    address >> 20 == 0xe00
}
