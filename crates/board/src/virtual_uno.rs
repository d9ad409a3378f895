//! The virtual Uno: the firmware's image on an emulated ATmega328P, behind a model of the Uno's USB bridge.
//!
//! It is a [`Port`] in virtual time: time passes only in [`Port::receive`], and every edge of a pin is known to the cycle. The bridge is an
//! ATmega16U2 as on the real board: bytes cross USB once a millisecond, then go over the line at the rate that the bridge can make. At 115 200 baud
//! that rate is as far off as the chip's own.

use crate::bridge::{Bridge, ToHost, bit_cycles, cycles, duration, garbled, next_frame};
use crate::{Edge, Port, PortError, VirtualBoard};
use pulsetrain_core::wire::Baud;
use pulsetrain_emulator::{
    Atmega328p, Boot, BootSize, LineByte, Observer, PinEdge, Port as PinPort, ResetCause, UartByte, hex,
};
use std::collections::VecDeque;
use std::sync::OnceLock;
use std::time::Duration;

pub use crate::bridge::CYCLES_PER_S;

// The programs that `cargo xtask firmware uno` built: for plans, verbs, text, and a baked motion that is stored after the program.
const IMAGE: &str = include_str!("../images/uno.hex");
const VERBS: &str = include_str!("../images/uno-verbs.hex");
const WINCH: &str = include_str!("../images/uno-winch.hex");
const BAKED: &str = include_str!("../images/uno-baked.hex");

/// Cycles for which DTR pulls the reset pin low, through 100 nF and 1 kΩ: 100 µs.
const RESET_PULSE: u64 = CYCLES_PER_S / 10_000;

/// Cycles from the reset pin's release to the first instruction: 65 ms (DS40002061B, 9.4, SUT = 11).
const START_UP: u64 = CYCLES_PER_S * 65 / 1000;

/// Thousandths by which the rates of the two ends may differ. With a larger difference, bytes are received wrong.
const RATE_TOLERANCE: u64 = 45;

/// Control register B of Timer1, and its counter (DS40002061B, 31).
const TCCR1B: u16 = 0x81;
const TCNT1: u16 = 0x84;
/// CS12 to CS10 for a timer tick of one cycle, as the firmware sets it. Bootloaders and the Arduino core use a divider: so this shows that the firmware
/// has started its clock.
const UNDIVIDED: u8 = 1;

/// The lock bits that the Arduino IDE sets when it burns a bootloader: programs can neither write nor read it.
const LOCKS: u8 = 0xcf;

/// Cycles that the bootloader runs at a time. Fewer than any program needs to start its clock, so that this start is not missed.
const BOOTLOADER_STRIDE: u64 = 64;

/// The committed firmware for plans, as flash has it from address 0.
#[must_use]
pub fn image() -> Vec<u8> {
    // This cannot fail: a test checks that the image is committed and complete.
    hex::parse(IMAGE, Atmega328p::FLASH_BYTES).unwrap_or_default()
}

/// The committed firmware that obeys verbs.
#[must_use]
pub fn verbs_image() -> Vec<u8> {
    // As above.
    hex::parse(VERBS, Atmega328p::FLASH_BYTES).unwrap_or_default()
}

/// The committed firmware that obeys `StepperWinch`'s text.
#[must_use]
pub fn winch_image() -> Vec<u8> {
    // As above.
    hex::parse(WINCH, Atmega328p::FLASH_BYTES).unwrap_or_default()
}

/// The committed firmware that plays a baked motion, which is stored right after it in flash.
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
    /// The rate of the bridge, bits a second.
    rate: u32,
    /// A change of that rate: the cycle, and the new rate.
    next_rate: Option<(u64, u32)>,
    /// The cycle up to which the bridge is busy sending.
    line_busy: u64,
    /// What the bridge holds back.
    to_host: ToHost,
    /// The word address at which the bootloader begins, if there is one.
    bootloader: Option<u16>,
    /// Whether the program is not this project's firmware: then all edges are reported, and tick 0 is the chip's reset.
    foreign: bool,
}

/// Why an Uno cannot have a bootloader and a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BootloaderError {
    /// The bootloader does not begin at the start of a boot section (DS40002061B, table 27-7).
    #[error(
        "this is no bootloader of an ATmega328P: its first byte is at {start:#06x}, a boot section begins at 0x7000, \
         0x7800, 0x7c00 or 0x7e00"
    )]
    NotInBootSection {
        /// Address of its first byte.
        start: usize,
    },
    /// The program reaches into the bootloader.
    #[error("the program has {bytes} bytes, before the bootloader there is room for {limit}")]
    ImageTooLarge {
        /// Bytes of the program.
        bytes: usize,
        /// Where the bootloader begins.
        limit: usize,
    },
}

/// Edges and bytes from the chip that nobody has taken yet.
#[derive(Clone, Default)]
struct UnoOutputs {
    edges: Vec<PinEdge>,
    bytes: VecDeque<UartByte>,
    /// Whether the chip's watchdog has reset it, so that its clock starts again.
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
        static NEW: OnceLock<VirtualUno> = OnceLock::new();
        NEW.get_or_init(|| VirtualUno::with_committed(&image())).clone()
    }

    /// As [`new`](VirtualUno::new), with the firmware that [obeys verbs](verbs_image).
    #[must_use]
    pub fn with_verbs() -> VirtualUno {
        static NEW: OnceLock<VirtualUno> = OnceLock::new();
        NEW.get_or_init(|| VirtualUno::with_committed(&verbs_image())).clone()
    }

    /// As [`new`](VirtualUno::new), with the firmware [for text](winch_image).
    #[must_use]
    pub fn with_winch() -> VirtualUno {
        static NEW: OnceLock<VirtualUno> = OnceLock::new();
        NEW.get_or_init(|| VirtualUno::with_committed(&winch_image())).clone()
    }

    /// Its image is parsed and decoded once in a process: clones are cheaper.
    fn with_committed(image: &[u8]) -> VirtualUno {
        VirtualUno::with_image(image).expect("no image is larger than what it was parsed for")
    }

    /// An Uno with an image of this project's firmware.
    ///
    /// # Errors
    /// When the flash cannot hold it.
    pub fn with_image(image: &[u8]) -> Result<VirtualUno, pulsetrain_emulator::ImageTooLarge> {
        Ok(VirtualUno::plugged_in(Atmega328p::new(image)?, None, false))
    }

    /// An Uno with any program, whatever that does with Timer1. Tick 0 is the reset, and every edge after it is reported.
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

    /// An Uno as it is sold: with a bootloader at the end of its flash, which every reset starts and no program can overwrite. `program` may be empty.
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
        let to_host = ToHost::default();
        let mut uno =
            VirtualUno { chip, outside, zero: None, rate, next_rate: None, line_busy: 0, to_host, bootloader, foreign };
        uno.reset();
        uno
    }

    /// Does what DTR does when a program opens the port: resets the chip. Bytes on their way are lost.
    pub fn reset(&mut self) {
        let now = self.chip.cycle();
        let until = now + RESET_PULSE + START_UP;
        self.chip.hold(ResetCause::External, until, &mut self.outside);
        self.outside.bytes.clear();
        self.to_host.clear();
        self.zero = self.foreign.then_some(now);
        self.line_busy = until;
    }

    /// The chip, to read its registers and memory.
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

    /// The rate of the line at the bridge's end. If the protocol does not have that rate: 115 200 baud.
    #[must_use]
    pub fn baud(&self) -> Baud {
        of_protocol(self.rate)
    }

    /// Changes the bridge's rate to any rate of 1200 bits a second or more, once all bytes that were sent to it are out.
    pub fn set_rate(&mut self, rate: u32) {
        self.next_rate = Some((self.line_busy.max(self.chip.cycle()), rate.max(1200)));
        self.change_rate(self.chip.cycle());
    }

    fn run(&mut self, until: u64) {
        while self.zero.is_none() && self.chip.cycle() < until {
            if self.bootloader.is_some_and(|start| self.chip.pc() >= start) {
                // The bootloader uses Timer1 for its light. A program starts its clock later than one stride after the bootloader.
                self.chip.run(until.min(self.chip.cycle() + BOOTLOADER_STRIDE), &mut self.outside);
                continue;
            }
            self.chip.step(&mut self.outside);
            // The clock was just started, so no instruction is between the two halves of a 16-bit access, which this read would disturb.
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

    /// Takes the bytes that the bridge hands over with the frame of USB at `cycle`; those that were sent at a wrong rate are received wrong.
    fn fetch(&mut self, cycle: u64, into: &mut Vec<u8>) {
        while let Some(byte) = self.outside.bytes.front().filter(|byte| byte.end_cycle <= cycle).copied() {
            self.outside.bytes.pop_front();
            self.change_rate(byte.end_cycle);
            let (own, theirs) = (bit_cycles(self.rate), u64::from(byte.cycles_per_bit));
            let off = own.abs_diff(theirs) * 1000 / own;
            // At a wrong rate another byte is received.
            let heard = if off <= RATE_TOLERANCE { byte.byte() } else { garbled(byte.byte()) };
            self.to_host.say(byte.end_cycle, heard);
        }
        self.change_rate(cycle);
        self.to_host.hand_over(cycle, into);
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

    fn set_client_rate(&mut self, rate: u32) -> Result<(), PortError> {
        if rate != self.next_rate.map_or(self.rate, |(_, rate)| rate) {
            self.set_rate(rate);
        }
        Ok(())
    }

    fn set_bridge(&mut self, bridge: Bridge) -> bool {
        self.to_host = ToHost::through(bridge);
        true
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

/// The protocol's rate of so many bits a second; 115 200 baud if it does not have that rate.
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
