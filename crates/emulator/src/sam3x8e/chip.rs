//! The SAM3X8E as its users see it: the processor and the system around it on one clock, with reset, pins and a debugger's
//! view.

use super::reset::Cause;
use super::system::{CoreBus, SRAM0_BYTES, SRAM1_BYTES, System};
use super::timing::Sam3x8eTiming;
use crate::arm::{Config, CortexM3, Fault, M3Options, Size};
use crate::{ImageTooLarge, Level, LineByte, Observer, UsbState};

/// The interrupts of the chip (§9).
const INTERRUPTS: u32 = 45;
/// The clock of SysTick's reference: the master clock divided by 8 (§10).
const SYSTICK_REFERENCE: u32 = 8;

/// A SAM3X8E on an Arduino Due, with its program in flash.
///
/// It starts as after power came on, with the bit set that boots from flash: stack pointer and program counter come from
/// the vector table at the beginning of flash, every clock but the slow and the RC oscillator is off, and the watchdog
/// runs.
///
/// ```
/// use pulsetrain_emulator::{GpioEdge, Observer, Sam3x8e, Sam3x8eTiming};
///
/// #[derive(Default)]
/// struct Edges(Vec<GpioEdge>);
/// impl Observer for Edges {
///     fn gpio(&mut self, edge: GpioEdge) {
///         self.0.push(edge);
///     }
/// }
///
/// // Stack pointer, reset vector; wfi and a branch to it.
/// let flash: Vec<u8> = [0x2008_8000u32, 0x0008_0009, 0xe7fd_bf30].iter().flat_map(|word| word.to_le_bytes()).collect();
/// let mut chip = Sam3x8e::new(&flash, Sam3x8eTiming::LIKELY)?;
/// let mut edges = Edges::default();
/// // What the program could do as well: pin 13 of the Due is PB27; an output, which is low, and then high.
/// for (address, value) in [(0x400e_1010, 1 << 27), (0x400e_1030, 1 << 27)] {
///     chip.write(address, value, &mut edges);
/// }
/// assert_eq!(edges.0.iter().map(|edge| (edge.gpio, edge.level.is_high())).collect::<Vec<_>>(), [(59, false), (59, true)]);
/// # Ok::<(), pulsetrain_emulator::ImageTooLarge>(())
/// ```
#[derive(Clone)]
pub struct Sam3x8e {
    cpu: CortexM3,
    system: System,
    asleep_cycles: u64,
}

impl Sam3x8e {
    /// Size of both planes of flash, bytes.
    pub const FLASH_BYTES: usize = 512 * 1024;
    /// Address of flash.
    pub const FLASH_ADDRESS: u32 = 0x0008_0000;
    /// Address from which both RAMs are one piece.
    pub const RAM_ADDRESS: u32 = 0x2007_0000;
    /// Size of both RAMs, bytes.
    pub const RAM_BYTES: usize = SRAM0_BYTES + SRAM1_BYTES;

    /// A chip that has just been powered, at cycle 0. The image is at the beginning of flash; flash beyond its end is
    /// erased.
    ///
    /// # Errors
    /// [`ImageTooLarge`] if the flash cannot hold the image.
    pub fn new(flash: &[u8], timing: Sam3x8eTiming) -> Result<Sam3x8e, ImageTooLarge> {
        if flash.len() > Sam3x8e::FLASH_BYTES {
            return Err(ImageTooLarge { bytes: flash.len(), limit: Sam3x8e::FLASH_BYTES });
        }
        let config = Config { systick_reference: SYSTICK_REFERENCE, ..Config::CORTEX_M3 };
        let options = M3Options {
            interrupts: INTERRUPTS,
            priority_bits: 4,
            refill: timing.refill,
            return_cycles: timing.return_cycles,
        };
        let mut chip =
            Sam3x8e { cpu: CortexM3::new(config, options), system: System::new(flash, timing), asleep_cycles: 0 };
        chip.start(&mut ());
        Ok(chip)
    }

    fn start(&mut self, observer: &mut impl Observer) {
        self.cpu.reset(&mut CoreBus::new(&mut self.system, observer));
        self.system.touch(self.cpu.cycle());
    }

    /// Resets the chip in the present cycle, as its NRST pin does. The cycle count goes on; memories and backup registers
    /// keep their contents, and pins that [`set_input`](Sam3x8e::set_input) drives stay driven. The observer sees the
    /// pins that change because the chip no longer drives them.
    pub fn reset(&mut self, observer: &mut impl Observer) {
        self.restart(Cause::Pin, observer);
    }

    /// Erases flash, lock bits and GPNVM bits, as the ERASE pin does. The next reset boots the ROM, which is not
    /// emulated: the processor then has no program.
    pub fn erase(&mut self) {
        self.system.flash.erase();
    }

    fn restart(&mut self, cause: Cause, observer: &mut impl Observer) {
        self.system.restart(cause, self.cpu.cycle(), observer);
        observer.clock_frequency(self.cpu.cycle(), self.clock_hz());
        self.start(observer);
    }

    /// The cycle in which the next instruction begins. It never decreases.
    pub fn cycle(&self) -> u64 {
        self.cpu.cycle()
    }

    /// Frequency of the present master clock, Hz; see [`Observer::clock_frequency`].
    pub fn clock_hz(&self) -> u64 {
        self.system.pmc.hz()
    }

    /// Runs to the first instruction that begins at or after a cycle. A processor that sleeps takes no computing time.
    pub fn run(&mut self, until_cycle: u64, observer: &mut impl Observer) {
        while self.cpu.cycle() < until_cycle {
            self.turn(until_cycle, observer);
        }
        self.system.advance(self.cpu.cycle(), observer);
    }

    /// Executes one instruction, or makes one part of an exception's entry or return, or sleeps until the next event (for
    /// at most 65 536 cycles).
    pub fn step(&mut self, observer: &mut impl Observer) {
        let cycle = self.cpu.cycle();
        self.attend(observer);
        if self.idles() {
            self.sleep(cycle + 65_536, observer);
        } else {
            self.cpu.step(&mut CoreBus::new(&mut self.system, observer));
        }
        self.system.advance(self.cpu.cycle(), observer);
    }

    /// Handles events up to the present cycle and resets, and brings the interrupt lines to the processor.
    fn attend(&mut self, observer: &mut impl Observer) {
        let cycle = self.cpu.cycle();
        self.system.advance(cycle, observer);
        if let Some(cause) = self.system.reset {
            observer.watchdog_reset(cycle);
            self.restart(cause, observer);
        }
        if self.system.lines_from <= cycle {
            self.system.lines_from = u64::MAX;
            self.cpu.set_irq_lines(self.system.lines(cycle));
        }
    }

    fn idles(&self) -> bool {
        self.cpu.is_asleep() || self.cpu.is_locked_up()
    }

    fn sleep(&mut self, until: u64, observer: &mut impl Observer) {
        let from = self.cpu.cycle();
        // An event in one cycle takes effect in the next.
        let wakes = self.system.next.saturating_add(1).min(self.system.lines_from);
        self.cpu.sleep_until(until.min(wakes).max(from + 1));
        if self.cpu.cycle() == from {
            // SysTick has an event in the present cycle.
            self.cpu.step(&mut CoreBus::new(&mut self.system, observer));
        }
        self.asleep_cycles += self.cpu.cycle() - from;
    }

    fn turn(&mut self, until: u64, observer: &mut impl Observer) {
        self.attend(observer);
        if self.idles() {
            self.sleep(until, observer);
            return;
        }
        let mut bus = CoreBus::new(&mut self.system, observer);
        loop {
            self.cpu.step(&mut bus);
            let cycle = self.cpu.cycle();
            let due = bus.system.next < cycle || bus.system.lines_from <= cycle || bus.system.reset.is_some();
            if due || cycle >= until || self.cpu.is_asleep() {
                return;
            }
        }
    }

    // The outside.

    /// Drives a pin from outside, or no longer (`None`). A pin that nobody drives has its pull-up, or reads low. Where the
    /// chip drives a pin too, the chip's level counts. Pins are numbered by ports: 0 to 31 are PA0 to PA31, 32 to 63 are
    /// those of port B, and so on to 127.
    pub fn set_input(&mut self, pin: u8, level: Option<Level>) {
        self.system.pins.set_outside(pin, level);
        self.system.touch(self.cpu.cycle());
    }

    /// The level of a pin as seen from outside.
    pub fn pin(&self, pin: u8) -> Level {
        self.system.pins.level(pin)
    }

    /// Whether the chip drives a pin: it is an output.
    pub fn is_output(&self, pin: u8) -> bool {
        self.system.pins.is_output(pin)
    }

    /// Puts a character on the line to the UART's receiver. The start bit must not begin before the character before it
    /// has ended, nor before the present cycle. The receiver samples it at the baud rate that the program has set, if the
    /// program has given it its pin.
    pub fn receive(&mut self, byte: LineByte) {
        self.system.uart.receive(byte);
        self.system.schedule();
    }

    /// The cycle by which all characters from [`receive`](Sam3x8e::receive) have passed. It is the present cycle or an
    /// earlier one if the line is idle.
    pub fn line_idle_from(&self) -> u64 {
        self.system.uart.line_end()
    }

    /// Whether the UART still sends, or has characters to send.
    pub fn is_transmitting(&self) -> bool {
        self.system.uart.is_sending()
    }

    /// Plugs in the cable between the native USB port and a PC, or pulls it. When the firmware is ready, the PC enumerates and
    /// configures the device: see [`usb_state`](Sam3x8e::usb_state).
    pub fn usb_plug(&mut self, plugged: bool) {
        let cycle = self.cpu.cycle();
        self.system.usb.plug(plugged, cycle);
        self.usb_changed();
    }

    /// A program on the PC opens the USB serial port, or closes it. If the port is not there yet, it opens as soon as
    /// it is.
    pub fn usb_open(&mut self, open: bool) {
        let cycle = self.cpu.cycle();
        self.system.usb.open(open, cycle);
        self.usb_changed();
    }

    /// With `true`, the program on the PC stops reading from the open port and the PC's buffers are full, so that the
    /// PC requests no data from the device. With `false` it reads again.
    pub fn usb_fill(&mut self, is_full: bool) {
        let cycle = self.cpu.cycle();
        self.system.usb.fill(is_full, cycle);
        self.usb_changed();
    }

    /// The PC sends bytes to the USB serial port from the present cycle on, as fast as bus and device allow. The bytes
    /// wait while the port is not open.
    pub fn usb_send(&mut self, bytes: &[u8]) {
        let cycle = self.cpu.cycle();
        self.system.usb.send(bytes, cycle);
        self.usb_changed();
    }

    /// The PC clears the halt of an endpoint of the USB serial port (bit 7: towards the PC), whether it is halted or
    /// not. The endpoint goes on with DATA0.
    pub fn usb_clear_halt(&mut self, endpoint: u8) {
        let cycle = self.cpu.cycle();
        self.system.usb.clear_halt(endpoint, cycle);
        self.usb_changed();
    }

    /// The PC selects a configuration of the USB device. If the device refuses it, nothing changes.
    pub fn usb_try_configuration(&mut self, value: u8) {
        let cycle = self.cpu.cycle();
        self.system.usb.try_configuration(value, cycle);
        self.usb_changed();
    }

    /// The PC halts an endpoint of the USB serial port (bit 7: towards the PC). No data pass there until the PC
    /// [clears](Sam3x8e::usb_clear_halt) it.
    pub fn usb_halt(&mut self, endpoint: u8) {
        let cycle = self.cpu.cycle();
        self.system.usb.halt(endpoint, cycle);
        self.usb_changed();
    }

    /// A string descriptor of the USB device, by its index; `None` if the PC has not read one.
    pub fn usb_text(&self, index: u8) -> Option<String> {
        self.system.usb.text(index)
    }

    /// Bytes of [`usb_send`](Sam3x8e::usb_send) that the device has not taken yet.
    pub fn usb_backlog(&self) -> usize {
        self.system.usb.backlog()
    }

    /// How far the PC has brought the USB device.
    pub fn usb_state(&self) -> UsbState {
        self.system.usb.state()
    }

    fn usb_changed(&mut self) {
        self.system.schedule();
        self.system.touch(self.cpu.cycle());
    }

    /// Sets the unique number that flash returns.
    pub fn set_unique_id(&mut self, id: [u8; 16]) {
        self.system.flash.id = id;
    }

    /// The contents of both planes of flash.
    pub fn flash(&self) -> &[u8] {
        &self.system.flash.bytes
    }

    // For developers, debuggers and tests.

    /// The processor: registers, mode, last fault.
    pub fn cpu(&self) -> &CortexM3 {
        &self.cpu
    }

    /// The processor, to set its state.
    pub fn cpu_mut(&mut self) -> &mut CortexM3 {
        &mut self.cpu
    }

    /// The last fault of the processor since its reset.
    pub fn fault(&self) -> Option<Fault> {
        self.cpu.fault()
    }

    /// Whether the processor sleeps.
    pub fn is_asleep(&self) -> bool {
        self.cpu.is_asleep()
    }

    /// Cycles that the processor slept or was locked up since power came on.
    pub fn asleep_cycles(&self) -> u64 {
        self.asleep_cycles
    }

    /// Reads a word of memory or a register as the processor does in the present cycle, but without wait cycles. Reading
    /// has its effects, such as clearing flags. An address where nothing is reads 0.
    pub fn read(&mut self, address: u32, observer: &mut impl Observer) -> u32 {
        match self.system.peek(address & !3) {
            Some(value) => value,
            None => self.system.read_register(address & !3, self.cpu.cycle(), observer).unwrap_or(0),
        }
    }

    /// Writes a word of memory or a register in the present cycle. The effect is there in the next cycle. A write to an
    /// address where nothing is has no effect; flash gets the bytes as they are.
    pub fn write(&mut self, address: u32, value: u32, observer: &mut impl Observer) {
        self.write_part(address & !3, Size::Word, value, observer);
    }

    /// Writes a word, or a part of one, as [`write`](Sam3x8e::write) does.
    pub fn write_part(&mut self, address: u32, size: Size, value: u32, observer: &mut impl Observer) {
        let bytes = &value.to_le_bytes()[..size.bytes() as usize];
        if !self.poke(address, bytes) {
            // A write to an address where nothing is has no effect.
            let _ = self.system.write_at(address, size, value, self.cpu.cycle(), observer);
        }
    }

    /// Reads a word of RAM or flash without any effect; `None` elsewhere.
    pub fn peek(&self, address: u32) -> Option<u32> {
        self.system.peek(address & !3)
    }

    /// Writes bytes of RAM or flash, without time, as a debugger does. Returns whether all of them are memory.
    pub fn poke(&mut self, address: u32, bytes: &[u8]) -> bool {
        (address..).zip(bytes).fold(true, |all, (at, byte)| self.system.poke(at, *byte) && all)
    }
}
