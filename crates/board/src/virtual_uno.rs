//! The virtual Uno: the firmware's image on an emulated ATmega328P, behind a model of the Uno's USB bridge.
//!
//! It is a [`Port`] in virtual time: time passes only while someone receives, and every edge of a pin is known to the
//! cycle. The bridge is an ATmega16U2 as on the real board: bytes cross USB once a millisecond, then go over the line
//! at the rate that it can make, which at 115 200 baud is as far off as the chip's own.

use crate::bridge::{bit_cycles, cycles, duration, garbled, next_frame};
use crate::{Edge, Port, PortError, VirtualBoard};
use pulsetrain_core::wire::Baud;
use pulsetrain_emulator::{
    Atmega328p, Boot, BootSize, LineByte, Observer, PinEdge, Port as PinPort, ResetCause, UartByte, hex,
};
use std::collections::VecDeque;
use std::time::Duration;

pub use crate::bridge::CYCLES_PER_S;

/// The programs that `cargo xtask firmware uno` built: for plans, for text, for verbs, and for a motion that lies behind it.
const IMAGE: &str = include_str!("../images/uno.hex");
const VERBS: &str = include_str!("../images/uno-verbs.hex");
const WINCH: &str = include_str!("../images/uno-winch.hex");
const BAKED: &str = include_str!("../images/uno-baked.hex");

/// DTR pulls the reset pin low for so long, through 100 nF and 1 kΩ.
const RESET_PULSE: u64 = CYCLES_PER_S / 10_000;

/// From the reset pin's release to the first instruction: 65 ms (DS40002061B, 9.4, SUT = 11).
const START_UP: u64 = CYCLES_PER_S * 65 / 1000;

/// A line that is sampled at a rate further off than this, of 1000, carries nothing.
const RATE_TOLERANCE: u64 = 45;

/// Control register B of Timer1, and its counter (DS40002061B, 31).
const TCCR1B: u16 = 0x81;
const TCNT1: u16 = 0x84;
/// CS12 to CS10: a tick is a cycle, as in the firmware. Bootloaders and the Arduino core divide.
const UNDIVIDED: u8 = 1;

/// What the Arduino IDE locks when it burns a bootloader: programs cannot write it, nor read it.
const LOCKS: u8 = 0xcf;

/// Cycles that the bootloader is run at a time; the fewest that a program takes to its clock's start are more.
const BOOTLOADER_STRIDE: u64 = 64;

/// The committed firmware for plans, as it lies in the flash from address 0 on.
#[must_use]
pub fn image() -> Vec<u8> {
    // Held by a test: the image is committed and whole.
    hex::parse(IMAGE, Atmega328p::FLASH_BYTES).unwrap_or_default()
}

/// The committed firmware that obeys verbs.
#[must_use]
pub fn verbs_image() -> Vec<u8> {
    // As above.
    hex::parse(VERBS, Atmega328p::FLASH_BYTES).unwrap_or_default()
}

/// The committed firmware that knows `StepperWinch`'s text.
#[must_use]
pub fn winch_image() -> Vec<u8> {
    // As above.
    hex::parse(WINCH, Atmega328p::FLASH_BYTES).unwrap_or_default()
}

/// The committed firmware that plays a motion which lies right behind it.
#[must_use]
pub fn baked_image() -> Vec<u8> {
    // As above.
    hex::parse(BAKED, Atmega328p::FLASH_BYTES).unwrap_or_default()
}

/// An Arduino Uno in virtual time.
#[derive(Clone)]
pub struct VirtualUno {
    chip: Atmega328p,
    outside: UnoOutputs,
    /// The cycle of the firmware's tick 0, once its clock runs.
    zero: Option<u64>,
    /// The rate of the bridge, bits a second, and the one that it changes to at a cycle.
    rate: u32,
    next_rate: Option<(u64, u32)>,
    /// Sent by the bridge up to this cycle.
    line_busy: u64,
    /// Where the bootloader begins, word address, if there is one.
    bootloader: Option<u16>,
    /// Of its program nothing is known: all edges count, and tick 0 is the chip's reset.
    foreign: bool,
}

/// Why there cannot be such an Uno.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BootloaderError {
    /// Bootloaders begin where a boot section can (DS40002061B, table 27-7).
    #[error(
        "this is no bootloader of an ATmega328P: its first byte is at {start:#06x}, a boot section begins at 0x7000, \
         0x7800, 0x7c00 or 0x7e00"
    )]
    NotInBootSection {
        /// Address of its first byte.
        start: usize,
    },
    /// The program reaches into it.
    #[error("the program has {bytes} bytes, before the bootloader there is room for {limit}")]
    ImageTooLarge {
        /// Of the program.
        bytes: usize,
        /// Where the bootloader begins.
        limit: usize,
    },
}

/// What leaves the chip, until it is fetched.
#[derive(Clone, Default)]
struct UnoOutputs {
    edges: Vec<PinEdge>,
    bytes: VecDeque<UartByte>,
    /// A reset of its own: its clock begins again.
    reset: bool,
}

impl Observer for UnoOutputs {
    fn pin(&mut self, edge: PinEdge) {
        self.edges.push(edge);
    }

    fn transmit(&mut self, byte: UartByte) {
        self.bytes.push_back(byte);
    }

    fn watchdog_reset(&mut self, _cycle: u64) {
        self.reset = true;
    }
}

impl VirtualUno {
    /// An Uno with the committed firmware for plans that has just been plugged in and opened.
    #[must_use]
    pub fn new() -> VirtualUno {
        VirtualUno::with_image(&image()).expect("no image is larger than what it was parsed for")
    }

    /// The same with the firmware that [obeys verbs](verbs_image).
    #[must_use]
    pub fn with_verbs() -> VirtualUno {
        VirtualUno::with_image(&verbs_image()).expect("no image is larger than what it was parsed for")
    }

    /// The same with the firmware [for text](winch_image).
    #[must_use]
    pub fn with_winch() -> VirtualUno {
        VirtualUno::with_image(&winch_image()).expect("no image is larger than what it was parsed for")
    }

    /// An Uno with any firmware.
    ///
    /// # Errors
    /// When the flash cannot hold it.
    pub fn with_image(image: &[u8]) -> Result<VirtualUno, pulsetrain_emulator::ImageTooLarge> {
        Ok(VirtualUno::plugged_in(Atmega328p::new(image)?, None, false))
    }

    /// An Uno with any program, whatever it does with Timer1: tick 0 is its reset, and each edge is seen from there on.
    ///
    /// # Errors
    /// When the flash cannot hold it.
    ///
    /// ```
    /// use pulsetrain_board::{Port, virtual_uno::VirtualUno};
    /// use std::time::Duration;
    /// // sbi DDRD, 2; sbi PORTD, 2; rjmp .-2
    /// let mut uno = VirtualUno::with_program(&[0x52, 0x9a, 0x5a, 0x9a, 0xff, 0xcf])?;
    /// uno.receive(Duration::from_millis(100), &mut Vec::new()).unwrap();
    /// let mut edges = Vec::new();
    /// uno.edges(&mut edges);
    /// assert_eq!(edges.iter().map(|edge| (edge.line, edge.level)).collect::<Vec<_>>(), [(2, true)]);
    /// # Ok::<(), pulsetrain_emulator::ImageTooLarge>(())
    /// ```
    pub fn with_program(program: &[u8]) -> Result<VirtualUno, pulsetrain_emulator::ImageTooLarge> {
        Ok(VirtualUno::plugged_in(Atmega328p::new(program)?, None, true))
    }

    /// An Uno as it is sold: a bootloader at the end of its flash, which each reset starts and which no program can
    /// overwrite, and a program before it, or none (an empty one).
    ///
    /// # Errors
    /// [`BootloaderError`]: a bootloader for another chip, or a program that reaches into it.
    pub fn with_bootloader(program: &[u8], bootloader: &[u8]) -> Result<VirtualUno, BootloaderError> {
        let start = bootloader.iter().position(|byte| *byte != 0xff).unwrap_or(0);
        let size = match start {
            0x7e00 => BootSize::Words256,
            0x7c00 => BootSize::Words512,
            0x7800 => BootSize::Words1024,
            0x7000 => BootSize::Words2048,
            _ => return Err(BootloaderError::NotInBootSection { start }),
        };
        if program.len() > start {
            return Err(BootloaderError::ImageTooLarge { bytes: program.len(), limit: start });
        }
        let mut flash = bootloader.to_vec();
        flash[..program.len()].copy_from_slice(program);
        let chip = Atmega328p::with_boot(&flash, Boot { size, start: true });
        let mut chip = chip.map_err(|_| BootloaderError::NotInBootSection { start: flash.len() })?;
        chip.set_locks(LOCKS);
        Ok(VirtualUno::plugged_in(chip, Some((start / 2) as u16), false))
    }

    fn plugged_in(chip: Atmega328p, bootloader: Option<u16>, foreign: bool) -> VirtualUno {
        let (outside, rate) = (UnoOutputs::default(), Baud::B115200.rate());
        let mut uno =
            VirtualUno { chip, outside, zero: None, rate, next_rate: None, line_busy: 0, bootloader, foreign };
        uno.reset();
        uno
    }

    /// What DTR does as a program opens the port: the chip starts again. Bytes under way are lost.
    pub fn reset(&mut self) {
        let now = self.chip.cycle();
        let until = now + RESET_PULSE + START_UP;
        self.chip.hold(ResetCause::External, until, &mut self.outside);
        self.outside.bytes.clear();
        self.zero = self.foreign.then_some(now);
        self.line_busy = until;
    }

    /// The chip, to look into.
    #[must_use]
    pub const fn chip(&self) -> &Atmega328p {
        &self.chip
    }

    /// The chip, to drive its pins.
    pub const fn chip_mut(&mut self) -> &mut Atmega328p {
        &mut self.chip
    }

    /// The cycle of the firmware's tick 0; `None` until its clock runs.
    #[must_use]
    pub const fn zero(&self) -> Option<u64> {
        self.zero
    }

    /// The rate of the line at the bridge's end, if it is one of the protocol's; else its first, 115 200 baud.
    #[must_use]
    pub fn baud(&self) -> Baud {
        of_protocol(self.rate)
    }

    /// Changes the rate to any, bits a second (from 1200 on), once all bytes that were handed over are out.
    pub fn set_rate(&mut self, rate: u32) {
        self.next_rate = Some((self.line_busy.max(self.chip.cycle()), rate.max(1200)));
        self.change_rate(self.chip.cycle());
    }

    fn run(&mut self, until: u64) {
        while self.zero.is_none() && self.chip.cycle() < until {
            if self.bootloader.is_some_and(|start| self.chip.pc() >= start) {
                // It has Timer1 for a light. Programs start the clock later than this after it.
                self.chip.run(until.min(self.chip.cycle() + BOOTLOADER_STRIDE), &mut self.outside);
                continue;
            }
            self.chip.step(&mut self.outside);
            // Just started: no instruction is in the middle of a 16-bit register, whose common byte this reads.
            if self.chip.read_data(TCCR1B, &mut ()) & 7 == UNDIVIDED {
                let low = self.chip.read_data(TCNT1, &mut ());
                let high = self.chip.read_data(TCNT1 + 1, &mut ());
                self.zero = Some(self.chip.cycle() - u64::from(u16::from_le_bytes([low, high])));
            }
        }
        self.chip.run(until, &mut self.outside);
        if std::mem::take(&mut self.outside.reset) && !self.foreign {
            self.zero = None;
        }
    }

    /// Takes what has come over USB by `cycle`, if it was sent at the bridge's rate.
    fn fetch(&mut self, cycle: u64, into: &mut Vec<u8>) {
        while let Some(byte) = self.outside.bytes.front().filter(|byte| byte.end_cycle <= cycle).copied() {
            self.outside.bytes.pop_front();
            self.change_rate(byte.end_cycle);
            let (own, theirs) = (bit_cycles(self.rate), u64::from(byte.cycles_per_bit));
            let off = own.abs_diff(theirs) * 1000 / own;
            // At a wrong rate something comes, but not what was sent.
            into.push(if off <= RATE_TOLERANCE { byte.byte() } else { garbled(byte.byte()) });
        }
        self.change_rate(cycle);
    }

    fn change_rate(&mut self, cycle: u64) {
        if let Some((at, rate)) = self.next_rate
            && cycle >= at
        {
            (self.rate, self.next_rate) = (rate, None);
        }
    }
}

impl Default for VirtualUno {
    fn default() -> VirtualUno {
        VirtualUno::new()
    }
}

impl std::fmt::Debug for VirtualUno {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("VirtualUno").field("cycle", &self.chip.cycle()).field("rate", &self.rate).finish()
    }
}

impl VirtualBoard for VirtualUno {
    fn reset(&mut self) {
        VirtualUno::reset(self);
    }

    fn zero(&self) -> Option<u64> {
        self.zero
    }

    fn baud(&self) -> Baud {
        VirtualUno::baud(self)
    }

    fn follow(&mut self, rate: u32) -> Result<(), PortError> {
        if rate != self.next_rate.map_or(self.rate, |(_, rate)| rate) {
            self.set_rate(rate);
        }
        Ok(())
    }
}

impl Port for VirtualUno {
    fn now(&self) -> Duration {
        duration(self.chip.cycle())
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        let rate = self.next_rate.map_or(self.rate, |(_, rate)| rate);
        let (bit, rest) = (bit_cycles(rate), u64::from(of_protocol(rate).stop_bits() - 1));
        let frame = next_frame(self.chip.cycle());
        for byte in bytes {
            let start = self.line_busy.max(frame);
            let byte = LineByte::new(start, *byte, bit as u32 * 256);
            self.line_busy = byte.end_cycle() + bit * rest;
            self.chip.receive(byte);
        }
        Ok(())
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        let until = cycles(until);
        let had = into.len();
        while into.len() == had && self.chip.cycle() < until {
            // Bytes reach the host with the next frame of USB.
            let frame = next_frame(self.chip.cycle());
            self.run(frame.min(until));
            if self.chip.cycle() >= frame {
                self.fetch(frame, into);
            }
        }
        Ok(())
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.set_rate(baud.rate());
        Ok(())
    }

    fn edges(&mut self, into: &mut Vec<Edge>) {
        let Some(zero) = self.zero else { return self.outside.edges.clear() };
        let edges = self.outside.edges.drain(..).filter(|edge| edge.cycle >= zero);
        into.extend(edges.filter_map(|edge| {
            let (tick, level) = (edge.cycle - zero, edge.level.is_high());
            Some(Edge { tick, line: arduino_pin(edge.port, edge.bit)?, level })
        }));
    }
}

/// The protocol's rate of so many bits a second; its first if it has none such.
fn of_protocol(rate: u32) -> Baud {
    Baud::ALL.into_iter().find(|baud| baud.rate() == rate).unwrap_or_default()
}

/// The Uno's number of a pin: 0 to 7 on port D, 8 to 13 on B, A0 to A5 (14 to 19) on C.
const fn arduino_pin(port: PinPort, bit: u8) -> Option<u8> {
    match (port, bit) {
        (PinPort::D, 0..=7) => Some(bit),
        (PinPort::B, 0..=5) => Some(8 + bit),
        (PinPort::C, 0..=5) => Some(14 + bit),
        _ => None,
    }
}
