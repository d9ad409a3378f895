//! The virtual Pico: the firmware's image on an emulated RP2040, behind a model of a USB adapter on its UART, or on its own
//! USB port.
//!
//! It is a [`Port`] in virtual time: time passes only in [`Port::receive`], and every edge of a pin is known to the cycle. Through the adapter,
//! bytes cross USB once a millisecond, then go over the line at its rate. On the Pico's own port they go as fast as the bus and the
//! firmware allow; a program gets them at the end of each USB frame.

use crate::{Edge, Port, PortError, VirtualBoard};
use pulsetrain_core::wire::Baud;
use pulsetrain_emulator::{GpioEdge, LineByte, Observer, Rp2040, UartByte, UsbState, image};
use std::collections::VecDeque;
use std::sync::OnceLock;
use std::time::Duration;

/// The firmware that `cargo xtask firmware pico` built, as a Pico's drive takes it (UF2).
pub const IMAGE: &[u8] = include_bytes!("../images/pico.uf2");

/// The RP2040's family number in UF2 files (github.com/microsoft/uf2, families).
pub const FAMILY: u32 = 0xe48b_ff56;

/// Cycles per second; one tick of the firmware's clock is one cycle.
pub const CYCLES_PER_S: u64 = 125_000_000;

/// Cycles in a frame of full-speed USB, 1 ms (USB 2.0, 8.4.3).
const USB_FRAME: u64 = CYCLES_PER_S / 1000;

/// Thousandths by which the rates of the two ends may differ. With a larger difference, bytes are received wrong.
const RATE_TOLERANCE: u64 = 45;

/// Cycles within which the firmware must start its clock (0.4 s). If it has not, it is not this project's.
const START_UP: u64 = 50_000_000;

/// Cycles within which the PC must have enumerated the device and opened its port (1 s). If it has not, the image has no USB serial port.
const ENUMERATION: u64 = CYCLES_PER_S;

/// Period of SysTick, cycles: a 24-bit counter that counts down.
const SYSTICK: u32 = 1 << 24;

/// Why the virtual Pico cannot run an image.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PicoError {
    /// The image is no UF2 file for a Pico.
    #[error(transparent)]
    Image(#[from] image::ImageError),
    /// The image is too large for the flash.
    #[error(transparent)]
    TooLarge(#[from] pulsetrain_emulator::ImageTooLarge),
    /// The image does not start the clock: it is not this project's firmware.
    #[error("the image does not start the board's clock within {START_UP} cycles; the program is at {pc:#010x}")]
    NoClock {
        /// The program counter then.
        pc: u32,
    },
    /// The PC cannot open its USB serial port.
    #[error("the USB serial port is not open within {ENUMERATION} cycles: {state:?}")]
    NoUsb {
        /// How far the enumeration came.
        state: UsbState,
    },
}

/// The two ports of a Pico; it has both at the same time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PicoPort {
    /// UART0 on GPIO 0 and 1, through a USB adapter.
    Uart,
    /// Its own USB port.
    Usb,
}

/// A Raspberry Pi Pico in virtual time.
#[derive(Clone)]
pub struct VirtualPico {
    chip: Rp2040,
    outside: PicoOutputs,
    /// The port that its [`Port`] implementation uses.
    line: PicoPort,
    /// The cycle of the firmware's tick 0.
    zero: u64,
    /// The rate of the adapter, and a change of it: the cycle and the new rate.
    baud: Baud,
    next_baud: Option<(u64, Baud)>,
    /// The cycle up to which the adapter is busy sending.
    line_busy: u64,
}

/// Edges and bytes from the chip that nobody has taken yet.
#[derive(Clone, Default)]
struct PicoOutputs {
    edges: Vec<GpioEdge>,
    bytes: VecDeque<UartByte>,
    /// Bytes that the PC has received over USB, and the cycle of each.
    packets: VecDeque<(u64, Vec<u8>)>,
}

impl Observer for PicoOutputs {
    fn gpio(&mut self, edge: GpioEdge) {
        self.edges.push(edge);
    }

    fn transmit(&mut self, byte: UartByte) {
        self.bytes.push_back(byte);
    }

    fn usb(&mut self, cycle: u64, data: &[u8]) {
        self.packets.push_back((cycle, data.to_vec()));
    }
}

impl VirtualPico {
    /// A Pico with the committed firmware that has just started.
    #[must_use]
    pub fn new() -> VirtualPico {
        // It boots once in a process.
        static BOOTED: OnceLock<VirtualPico> = OnceLock::new();
        let boot = || VirtualPico::with_image(IMAGE).expect("the committed image runs: a test holds it");
        BOOTED.get_or_init(boot).clone()
    }

    /// A Pico with the committed firmware, whose USB serial port has just been opened.
    #[must_use]
    pub fn on_usb() -> VirtualPico {
        static OPENED: OnceLock<VirtualPico> = OnceLock::new();
        let open = || VirtualPico::new().opened().expect("the committed image enumerates: a test holds it");
        OPENED.get_or_init(open).clone()
    }

    /// This Pico, used through its own USB port: plugs it in and waits until the port is open.
    ///
    /// # Errors
    /// [`PicoError::NoUsb`] if the firmware has no USB serial port.
    pub fn opened(mut self) -> Result<VirtualPico, PicoError> {
        self.line = PicoPort::Usb;
        self.chip.usb_plug(true);
        self.chip.usb_open(true);
        let end = self.chip.cycle() + ENUMERATION;
        while self.chip.usb_state() != UsbState::Open {
            if self.chip.cycle() >= end {
                return Err(PicoError::NoUsb { state: self.chip.usb_state() });
            }
            self.chip.run(self.next_frame(), &mut self.outside);
        }
        Ok(self)
    }

    /// A Pico with an image of this project's firmware (a UF2 file), whose clock has just started.
    ///
    /// # Errors
    /// [`PicoError`] if it is no UF2 file for a Pico, is too large, or does not start the clock.
    pub fn with_image(uf2: &[u8]) -> Result<VirtualPico, PicoError> {
        VirtualPico::with_flash(&image::flat(&image::uf2(uf2, FAMILY)?, Rp2040::FLASH_ADDRESS, Rp2040::FLASH_BYTES)?)
    }

    /// A Pico with the given bytes at the beginning of its flash: an image, or the whole flash of another Pico. Its clock has just started.
    ///
    /// # Errors
    /// As [`VirtualPico::with_image`].
    pub fn with_flash(flash: &[u8]) -> Result<VirtualPico, PicoError> {
        let mut pico = VirtualPico {
            chip: Rp2040::new(flash)?,
            outside: PicoOutputs::default(),
            line: PicoPort::Uart,
            zero: 0,
            baud: Baud::B115200,
            next_baud: None,
            line_busy: 0,
        };
        while pico.chip.cpu().systick_value() == 0 {
            if pico.chip.cycle() >= START_UP {
                return Err(PicoError::NoClock { pc: pico.chip.cpu().pc() });
            }
            pico.chip.step(&mut pico.outside);
        }
        let ticks = pico.chip.cpu().systick_value().wrapping_neg() & (SYSTICK - 1);
        pico.zero = pico.chip.cycle() - u64::from(ticks);
        Ok(pico)
    }

    /// The chip, to read its registers and memory.
    #[must_use]
    pub const fn chip(&self) -> &Rp2040 {
        &self.chip
    }

    /// The chip, to drive its pins.
    pub const fn chip_mut(&mut self) -> &mut Rp2040 {
        &mut self.chip
    }

    /// The cycle of the firmware's tick 0.
    #[must_use]
    pub const fn zero(&self) -> u64 {
        self.zero
    }

    /// The rate of the line at the adapter's end.
    #[must_use]
    pub const fn baud(&self) -> Baud {
        self.baud
    }

    /// Sends bytes on one of its two ports.
    pub fn send_on(&mut self, line: PicoPort, bytes: &[u8]) {
        if line == PicoPort::Usb {
            self.chip.usb_send(bytes);
            return;
        }
        let baud = self.next_baud.map_or(self.baud, |(_, baud)| baud);
        let frame = self.next_frame();
        for byte in bytes {
            let start = self.line_busy.max(frame);
            let byte = LineByte::new(start, *byte, bit_256(baud) as u32);
            self.line_busy = byte.end_cycle() + u64::from(baud.stop_bits() - 1) * bit_256(baud) / 256;
            self.chip.receive(0, byte);
        }
    }

    /// Lets time pass until `until`, or until bytes have come on one of its two ports, and appends those to `into`. Bytes on the other port wait.
    pub fn receive_on(&mut self, line: PicoPort, until: Duration, into: &mut Vec<u8>) {
        let until = u64::try_from(until.as_nanos().div_ceil(8)).unwrap_or(u64::MAX).saturating_add(self.zero);
        let had = into.len();
        // Bytes may have come while time passed for the other port.
        self.fetch(line, self.next_frame() - USB_FRAME, into);
        while into.len() == had && self.chip.cycle() < until {
            // Bytes reach the host with the next USB frame.
            let frame = self.next_frame();
            self.chip.run(frame.min(until), &mut self.outside);
            if self.chip.cycle() >= frame {
                self.fetch(line, frame, into);
            }
        }
    }

    /// Takes the bytes that have come on a port by `cycle`; those that the adapter got at a wrong rate are received wrong.
    fn fetch(&mut self, line: PicoPort, cycle: u64, into: &mut Vec<u8>) {
        if line == PicoPort::Usb {
            while let Some((_, packet)) = self.outside.packets.pop_front_if(|(end, _)| *end <= cycle) {
                into.extend(packet);
            }
            return;
        }
        while let Some(byte) = self.outside.bytes.pop_front_if(|byte| byte.end_cycle <= cycle) {
            if byte.uart != 0 {
                continue;
            }
            self.change_rate(byte.end_cycle);
            let (own, theirs) = (bit_256(self.baud) / 256, u64::from(byte.cycles_per_bit));
            let off = own.abs_diff(theirs) * 1000 / own;
            // At a wrong rate another byte is received.
            into.push(if off <= RATE_TOLERANCE { byte.byte() } else { byte.byte().rotate_left(3) ^ 0x5a });
        }
        self.change_rate(cycle);
    }

    fn change_rate(&mut self, cycle: u64) {
        if let Some((at, baud)) = self.next_baud
            && cycle >= at
        {
            (self.baud, self.next_baud) = (baud, None);
        }
    }

    /// The cycle at which the next USB frame begins.
    fn next_frame(&self) -> u64 {
        ((self.chip.cycle() - self.zero) / USB_FRAME + 1) * USB_FRAME + self.zero
    }
}

impl Default for VirtualPico {
    fn default() -> VirtualPico {
        VirtualPico::new()
    }
}

impl std::fmt::Debug for VirtualPico {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("VirtualPico").field("cycle", &self.chip.cycle()).field("baud", &self.baud).finish()
    }
}

impl VirtualBoard for VirtualPico {
    fn cycles_per_s(&self) -> u64 {
        CYCLES_PER_S
    }

    fn traced(&self) -> std::ops::RangeInclusive<u8> {
        2..=28
    }

    /// Closes and opens its own USB port: the firmware notices that by DTR, but is not reset. An adapter on the UART has no effect at all.
    fn reset(&mut self) {
        if self.line == PicoPort::Usb {
            for open in [false, true] {
                self.outside.packets.clear();
                self.chip.usb_open(open);
                let end = self.chip.cycle() + ENUMERATION;
                while (self.chip.usb_state() == UsbState::Open) != open && self.chip.cycle() < end {
                    self.chip.run(self.next_frame(), &mut self.outside);
                }
            }
        }
    }

    /// Always known, as the port's time begins with the firmware's clock.
    fn zero(&self) -> Option<u64> {
        Some(0)
    }

    fn baud(&self) -> Baud {
        self.baud
    }
}

impl Port for VirtualPico {
    fn now(&self) -> Duration {
        Duration::from_nanos((self.chip.cycle() - self.zero) * 8)
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.send_on(self.line, bytes);
        Ok(())
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        self.receive_on(self.line, until, into);
        Ok(())
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.next_baud = Some((self.line_busy.max(self.chip.cycle()), baud));
        self.change_rate(self.chip.cycle());
        Ok(())
    }

    fn edges(&mut self, into: &mut Vec<Edge>) {
        let zero = self.zero;
        let edges = self.outside.edges.drain(..).filter(|edge| edge.cycle >= zero);
        into.extend(edges.map(|edge| Edge { tick: edge.cycle - zero, line: edge.gpio, level: edge.level.is_high() }));
    }
}

/// The length of a bit, 1/256 cycles.
fn bit_256(baud: Baud) -> u64 {
    (CYCLES_PER_S * 256 + u64::from(baud.rate()) / 2) / u64::from(baud.rate())
}
