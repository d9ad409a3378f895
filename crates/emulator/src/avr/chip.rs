//! The ATmega328P as its users see it: the processor (`cpu`) and the peripherals (`peripherals`) on one clock, with
//! reset, pins, serial line and a debugger's view (DS40002061B §11, §27, §28).
//!
//! What an instruction or a peripheral does is in the other files. The memory that a programmer reaches over SPI is not
//! here: tests set flash, EEPROM and lock bits directly.

use super::cpu::{Cpu, FLASH_BYTES, Io, Masked, Odd};
use super::eeprom;
use super::peripherals::Peripherals;
use super::registers::Bus;
use crate::{Level, LineByte, Observer, Port};
use thiserror::Error;

/// Why the chip was reset: bits of MCUSR (DS40002061B §11.9.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ResetCause {
    /// Power came on.
    PowerOn,
    /// The reset pin was pulled low: on an Uno by the button, or by DTR when a PC opens the port.
    External,
    /// The supply fell below its limit.
    BrownOut,
    /// The watchdog ran out.
    Watchdog,
}

impl ResetCause {
    const fn bit(self) -> u8 {
        match self {
            ResetCause::PowerOn => 1,
            ResetCause::External => 1 << 1,
            ResetCause::BrownOut => 1 << 2,
            ResetCause::Watchdog => 1 << 3,
        }
    }
}

/// The boot section, and whether the chip starts in it (BOOTSZ, BOOTRST; tables 27-7, 12-5).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Boot {
    /// The size of the section at the end of flash.
    pub size: BootSize,
    /// Whether a reset begins there, and not at 0.
    pub start: bool,
}

/// The size of the boot section, words (table 27-7).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BootSize {
    /// 256 words: from word 0x3f00, as on the Uno.
    #[default]
    Words256,
    /// 512 words.
    Words512,
    /// 1024 words.
    Words1024,
    /// 2048 words.
    Words2048,
}

impl Boot {
    const fn section(self) -> u16 {
        match self.size {
            BootSize::Words256 => 0x3f00,
            BootSize::Words512 => 0x3e00,
            BootSize::Words1024 => 0x3c00,
            BootSize::Words2048 => 0x3800,
        }
    }

    /// The fuse bytes low, high and extended: those of an Uno, with this BOOTSZ and BOOTRST (§28.2). A bit that is 0 is
    /// programmed.
    const fn fuses(self) -> [u8; 3] {
        let size = match self.size {
            BootSize::Words256 => 0b110,
            BootSize::Words512 => 0b100,
            BootSize::Words1024 => 0b010,
            BootSize::Words2048 => 0b000,
        };
        [0xff, 0xd8 | size | !self.start as u8, 0xfd]
    }
}

/// An image that the flash cannot hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("the image has {bytes} bytes, the flash {limit}")]
pub struct ImageTooLarge {
    /// Bytes of the image.
    pub bytes: usize,
    /// Bytes of flash.
    pub limit: usize,
}

/// An ATmega328P with its program.
///
/// ```
/// use pulsetrain_emulator::{Atmega328p, Observer, PinEdge};
///
/// #[derive(Default)]
/// struct Edges(Vec<u64>);
/// impl Observer for Edges {
///     fn pin(&mut self, edge: PinEdge) {
///         self.0.push(edge.cycle);
///     }
/// }
///
/// // sbi DDRB, 0; loop: sbi PINB, 0; rjmp loop: a pin that toggles every 4 cycles.
/// let words = [0x9a20u16, 0x9a18, 0xcffe];
/// let image: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
/// let mut chip = Atmega328p::new(&image)?;
/// let mut edges = Edges::default();
/// chip.run(16, &mut edges);
/// assert_eq!(edges.0, [4, 8, 12, 16]);
///
/// assert!(Atmega328p::new(&[0; 32 * 1024 + 1]).is_err());
/// # Ok::<(), pulsetrain_emulator::ImageTooLarge>(())
/// ```
#[derive(Clone)]
pub struct Atmega328p {
    cpu: Cpu,
    peripherals: Peripherals,
    boot: Boot,
    asleep_cycles: u64,
}

impl Atmega328p {
    /// Bytes of program memory.
    pub const FLASH_BYTES: usize = FLASH_BYTES;
    /// Bytes of EEPROM.
    pub const EEPROM_BYTES: usize = eeprom::BYTES;

    /// A chip that has just been powered, at cycle 0. Flash beyond the end of the image is erased (0xff). The program
    /// starts at address 0.
    ///
    /// # Errors
    /// [`ImageTooLarge`] if the flash cannot hold the image.
    pub fn new(flash: &[u8]) -> Result<Atmega328p, ImageTooLarge> {
        Atmega328p::with_boot(flash, Boot::default())
    }

    /// As [`new`](Atmega328p::new), with the fuses of a boot section.
    ///
    /// # Errors
    /// [`ImageTooLarge`] if the flash cannot hold the image.
    pub fn with_boot(flash: &[u8], boot: Boot) -> Result<Atmega328p, ImageTooLarge> {
        if flash.len() > FLASH_BYTES {
            return Err(ImageTooLarge { bytes: flash.len(), limit: FLASH_BYTES });
        }
        let peripherals = Peripherals::new(boot.section(), boot.fuses());
        let mut chip = Atmega328p { cpu: Cpu::new(flash), peripherals, boot, asleep_cycles: 0 };
        chip.reset(ResetCause::PowerOn, &mut ());
        Ok(chip)
    }

    /// Resets the chip in the present cycle. The cycle count goes on; RAM, registers, flash and EEPROM keep their
    /// contents, and pins that [`set_input`](Atmega328p::set_input) drives stay driven. A real chip starts some time
    /// later (65 ms on an Uno): call [`hold`](Atmega328p::hold) to add that time. The observer sees the pins that
    /// change because the chip no longer drives them.
    pub fn reset(&mut self, cause: ResetCause, observer: &mut impl Observer) {
        self.peripherals.reset(cause.bit(), self.cpu.cycle, observer);
        self.cpu.reset(if self.boot.start { self.boot.section() } else { 0 });
    }

    /// Holds the chip in reset until a cycle, as a reset pin does that is kept low. The program starts in that cycle.
    pub fn hold(&mut self, cause: ResetCause, until_cycle: u64, observer: &mut impl Observer) {
        self.reset(cause, observer);
        self.cpu.cycle = self.cpu.cycle.max(until_cycle);
        self.peripherals.reset(cause.bit(), self.cpu.cycle, observer);
        self.cpu.reset(self.cpu.pc);
    }

    /// The cycle in which the next instruction begins. It never decreases.
    pub fn cycle(&self) -> u64 {
        self.cpu.cycle
    }

    /// Runs to the first instruction that begins at or after a cycle. Cycles in which the processor sleeps take no
    /// computing time.
    pub fn run(&mut self, until_cycle: u64, observer: &mut impl Observer) {
        while self.cpu.cycle < until_cycle {
            self.turn(until_cycle, false, observer);
        }
        self.peripherals.advance(self.cpu.cycle, observer);
    }

    /// Executes one instruction, or enters one interrupt, or sleeps until the next event (for at most 65 536 cycles).
    pub fn step(&mut self, observer: &mut impl Observer) {
        self.turn(self.cpu.cycle + 65_536, true, observer);
        self.peripherals.advance(self.cpu.cycle, observer);
    }

    /// One round of the main loop: due events, then waking up, then an interrupt, else instructions up to the next
    /// event.
    fn turn(&mut self, until: u64, single: bool, observer: &mut impl Observer) {
        let Atmega328p { cpu, peripherals, .. } = self;
        peripherals.advance(cpu.cycle, observer);
        if peripherals.watchdog_reset {
            observer.watchdog_reset(cpu.cycle);
            self.reset(ResetCause::Watchdog, observer);
            return;
        }
        if peripherals.halt != 0 {
            cpu.cycle += std::mem::take(&mut peripherals.halt);
            return;
        }
        let waits = peripherals.waiting != 0 && cpu.interrupts();
        if cpu.asleep {
            let from = cpu.cycle;
            if waits {
                cpu.asleep = false;
                cpu.shadow = false;
                cpu.cycle += peripherals.wake(cpu.cycle);
            } else {
                cpu.cycle = peripherals.next.min(until);
            }
            self.asleep_cycles += cpu.cycle - from;
            return;
        }
        let shadow = std::mem::take(&mut cpu.shadow);
        if waits && !shadow {
            let section = if peripherals.vectors_in_boot_section() { self.boot.section() } else { 0 };
            let vector = section + peripherals.acknowledge();
            cpu.interrupt(vector, &mut Bus { peripherals, observer });
            return;
        }
        let writing = peripherals.programming.blocks();
        cpu.horizon = if single || waits || writing { cpu.cycle + 1 } else { until.min(peripherals.next) };
        let mut bus = Bus { peripherals, observer };
        if writing && bus.program_blocked(cpu.pc) { cpu.blocked(&mut bus) } else { cpu.execute(&mut bus) }
    }

    // The outside: pins and the serial line.

    /// Drives a pin from outside, or no longer (`None`). A pin that nobody drives has its pull-up, or reads low. Where
    /// the chip drives a pin too, the chip's level counts.
    pub fn set_input(&mut self, port: Port, bit: u8, level: Option<Level>) {
        self.peripherals.ports.set_outside(port, bit, level, self.cpu.cycle);
        self.peripherals.pin_changes();
        self.peripherals.refresh();
    }

    /// The level of a pin as seen from outside.
    pub fn pin(&self, port: Port, bit: u8) -> Level {
        Level::from(self.peripherals.ports.level(port) >> (bit & 7) & 1 != 0)
    }

    /// Whether the chip drives a pin: it is an output.
    pub fn is_output(&self, port: Port, bit: u8) -> bool {
        self.peripherals.ports.is_output(port, bit)
    }

    /// Puts a character on the line to RXD. The start bit must not begin before the character before it has ended, nor
    /// before the present cycle. The receiver samples it at the baud rate that the program has set.
    pub fn receive(&mut self, byte: LineByte) {
        self.peripherals.usart.receive(byte);
        self.peripherals.refresh();
    }

    /// The cycle by which all characters from [`receive`](Atmega328p::receive) have passed. It is the present cycle or
    /// an earlier one if the line is idle.
    pub fn line_idle_from(&self) -> u64 {
        self.peripherals.usart.line_end()
    }

    /// Whether the transmitter still sends, or has a character in its buffer.
    pub fn is_transmitting(&self) -> bool {
        self.peripherals.usart.is_sending()
    }

    // For developers, debuggers and tests.

    /// The program counter, word address.
    pub fn pc(&self) -> u16 {
        self.cpu.pc
    }

    /// Sets the program counter; word address, modulo the flash.
    pub fn set_pc(&mut self, pc: u16) {
        self.cpu.pc = pc & 0x3fff;
    }

    /// The stack pointer.
    pub fn sp(&self) -> u16 {
        self.cpu.sp
    }

    /// The status register SREG: the flags and I.
    pub fn sreg(&self) -> u8 {
        self.cpu.sreg
    }

    /// Register 0 to 31.
    pub fn register(&self, number: u8) -> u8 {
        self.cpu.registers[usize::from(number & 31)]
    }

    /// Sets register 0 to 31.
    pub fn set_register(&mut self, number: u8, value: u8) {
        self.cpu.registers[usize::from(number & 31)] = value;
    }

    /// Reads a byte of data memory as `lds` does. Reading has its effects: UDR0 loses a character, TEMP changes.
    pub fn read_data(&mut self, address: u16, observer: &mut impl Observer) -> u8 {
        self.cpu.peek(address, &mut Bus { peripherals: &mut self.peripherals, observer })
    }

    /// Writes a byte of data memory as `sts` would, in the present cycle.
    pub fn write_data(&mut self, address: u16, value: u8, observer: &mut impl Observer) {
        self.cpu.poke(address, value, &mut Bus { peripherals: &mut self.peripherals, observer });
    }

    /// RAM, from data address 0x100.
    pub fn ram(&self) -> &[u8] {
        &self.cpu.ram[..]
    }

    /// A byte of program memory, byte address modulo the flash.
    pub fn flash_byte(&self, address: u16) -> u8 {
        self.cpu.flash_byte(address)
    }

    /// The EEPROM.
    pub fn eeprom(&self) -> &[u8] {
        &self.peripherals.eeprom.bytes[..]
    }

    /// The EEPROM, to set its contents.
    pub fn eeprom_mut(&mut self) -> &mut [u8] {
        &mut self.peripherals.eeprom.bytes[..]
    }

    /// Whether the processor sleeps.
    pub fn is_asleep(&self) -> bool {
        self.cpu.asleep
    }

    /// Cycles that the processor slept since power came on, with the start-up times after each sleep.
    pub fn asleep_cycles(&self) -> u64 {
        self.asleep_cycles
    }

    /// How often the program executed `wdr` since power came on. Most programs do so once in every pass of their main
    /// loop.
    pub fn watchdog_feeds(&self) -> u64 {
        self.peripherals.watchdog.feeds()
    }

    /// The lowest value that the stack pointer had since power came on; bytes above it were stack.
    pub fn lowest_sp(&self) -> u16 {
        self.cpu.lowest_sp
    }

    /// The longest stretch with interrupts off, the present one included. The start-up code counts too, unless
    /// [`forget_masked`](Atmega328p::forget_masked) was called after it.
    pub fn longest_masked(&self) -> Masked {
        self.cpu.longest_masked()
    }

    /// Forgets the longest stretch with interrupts off. A stretch that runs now counts from the present cycle.
    pub fn forget_masked(&mut self) {
        self.cpu.forget_masked();
    }

    /// What the program did that is probably a mistake, such as reading beyond RAM.
    pub fn odd(&self) -> Odd {
        self.cpu.odd
    }

    /// The lock byte (§28.1): a bit that is 0 locks. To erase the chip, as a programmer does, set it to 0xff with
    /// [`set_locks`](Atmega328p::set_locks).
    pub fn locks(&self) -> u8 {
        self.peripherals.programming.locks
    }

    /// Sets the lock byte, as a programmer does. An Uno has 0xcf: `spm` cannot write the boot section, and `lpm` in the
    /// application section cannot read it.
    pub fn set_locks(&mut self, locks: u8) {
        self.peripherals.programming.locks = locks;
    }

    /// How often `spm` was executed. Outside the boot section the instruction does nothing.
    pub fn spm_count(&self) -> u64 {
        self.peripherals.spm
    }
}
