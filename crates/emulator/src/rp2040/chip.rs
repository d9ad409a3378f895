//! The RP2040 as its users see it: one processor and the system around it on one clock, with reset, pins, serial lines,
//! the USB cable and a debugger's view (RP2040 datasheet §2.1, §2.12).
//!
//! What happens in which order within a cycle is in `system`; what is at which address is in `fabric`. The second
//! processor and the boot ROM are not emulated.

use super::fabric::{Fabric, SRAM, SRAM_BYTES};
use super::system::{CoreBus, System};
use super::watchdog::Cause;
use crate::arm::{Config, Cpu, Fault, Size};
use crate::{ImageTooLarge, Level, LineByte, Observer, UsbState};

/// Address of the vector table at which the program starts (datasheet §2.8.1.3.1): after the 256 bytes of the second
/// stage of boot.
const VECTOR_TABLE: u32 = 0x1000_0100;

/// An RP2040 on a Pico, with its program in 2 MB of flash.
///
/// It starts where the boot ROM and the second stage of boot end: stack pointer and program counter come from the
/// vector table at 0x1000_0100, every peripheral is in reset, and the clock is the ring oscillator's 6.5 MHz.
///
/// ```
/// use pulsetrain_emulator::{GpioEdge, Observer, Rp2040};
///
/// #[derive(Default)]
/// struct Edges(Vec<GpioEdge>);
/// impl Observer for Edges {
///     fn gpio(&mut self, edge: GpioEdge) {
///         self.0.push(edge);
///     }
/// }
///
/// let mut flash = vec![0; 0x100];
/// // Stack pointer, reset vector; wfi and a branch to it.
/// for word in [0x2004_0000u32, 0x1000_0109, 0xe7fd_bf30] {
///     flash.extend(word.to_le_bytes());
/// }
/// let mut chip = Rp2040::new(&flash)?;
/// let mut edges = Edges::default();
/// // What the program could do as well: take IO_BANK0 and the pads out of reset, give GPIO 25 to SIO, raise it.
/// for (address, value) in [(0x4000_f000, 1 << 5 | 1 << 8), (0x4001_40cc, 5), (0xd000_0024, 1 << 25), (0xd000_0014, 1 << 25)] {
///     chip.write(address, value, &mut edges);
/// }
/// assert_eq!((edges.0.len(), edges.0[0].gpio, edges.0[0].level.is_high()), (1, 25, true));
/// # Ok::<(), pulsetrain_emulator::ImageTooLarge>(())
/// ```
#[derive(Clone)]
pub struct Rp2040 {
    cpu: Cpu,
    system: System,
    asleep_cycles: u64,
}

impl Rp2040 {
    /// Size of a Pico's flash, bytes.
    pub const FLASH_BYTES: usize = 2 * 1024 * 1024;
    /// Address of flash.
    pub const FLASH_ADDRESS: u32 = 0x1000_0000;
    /// Address of RAM.
    pub const RAM_ADDRESS: u32 = SRAM;
    /// Size of RAM, bytes.
    pub const RAM_BYTES: usize = SRAM_BYTES;

    /// A chip that has just been powered, at cycle 0. The image is at the beginning of flash; flash beyond its end is
    /// erased.
    ///
    /// # Errors
    /// [`ImageTooLarge`] if the flash cannot hold the image.
    pub fn new(flash: &[u8]) -> Result<Rp2040, ImageTooLarge> {
        if flash.len() > Rp2040::FLASH_BYTES {
            return Err(ImageTooLarge { bytes: flash.len(), limit: Rp2040::FLASH_BYTES });
        }
        let config = Config { vector_table: VECTOR_TABLE, ..Config::default() };
        let mut chip =
            Rp2040 { cpu: Cpu::new(config), system: System::new(flash, Rp2040::FLASH_BYTES), asleep_cycles: 0 };
        chip.start(&mut ());
        Ok(chip)
    }

    fn start(&mut self, observer: &mut impl Observer) {
        self.cpu.reset(&mut CoreBus::new(&mut self.system, observer, 0));
        self.system.schedule();
        self.system.lines_changed = true;
    }

    /// Sets the unique number of the flash chip.
    pub fn set_flash_id(&mut self, id: [u8; 8]) {
        self.system.fabric.xip.flash.id = id;
    }

    /// From now on the flash takes its longest times, 0.4 s to erase a sector and 3 ms to program a page. Without this
    /// call it takes the typical times, 45 ms and 0.4 ms.
    pub fn slow_flash(&mut self) {
        self.system.fabric.xip.flash.be_slow();
    }

    /// Sets the chip's revision that SYSINFO returns: 1 is B0 or B1, 2 is B2. It is 2 at first. Nothing else depends on
    /// it.
    pub fn set_revision(&mut self, revision: u8) {
        self.system.fabric.revision = u32::from(revision) & 15;
    }

    /// Resets the chip in the present cycle, as its RUN pin does. The cycle count goes on; RAM and flash keep their
    /// contents, and pins that [`set_input`](Rp2040::set_input) drives stay driven. The observer sees the pins that
    /// change because the chip no longer drives them.
    pub fn reset(&mut self, observer: &mut impl Observer) {
        self.restart(Cause::Run, observer);
    }

    fn restart(&mut self, cause: Cause, observer: &mut impl Observer) {
        let cycle = self.cpu.cycle();
        self.system.reset = None;
        self.system.fabric.reset(cause, cycle, observer);
        self.system.dma = super::dma::Dma::new();
        self.start(observer);
    }

    /// The cycle in which the next instruction begins. It never decreases.
    pub fn cycle(&self) -> u64 {
        self.cpu.cycle()
    }

    /// Frequency of the present clk_sys, Hz; see [`Observer::clock_frequency`].
    pub fn clock_hz(&self) -> u64 {
        self.system.fabric.clocks.sys_hz()
    }

    /// Runs to the first instruction that begins at or after a cycle. A processor that sleeps takes no computing time,
    /// and neither do state machines that wait or count down.
    pub fn run(&mut self, until_cycle: u64, observer: &mut impl Observer) {
        while self.cpu.cycle() < until_cycle {
            self.turn(until_cycle, observer);
        }
        self.system.advance(self.cpu.cycle(), observer);
    }

    /// Executes one instruction, or makes one part of an exception's entry, or sleeps until the next event (for at most
    /// 65 536 cycles).
    pub fn step(&mut self, observer: &mut impl Observer) {
        let cycle = self.cpu.cycle();
        self.attend(observer);
        if self.idles() {
            self.sleep(cycle + 65_536, observer);
        } else {
            self.cpu.step(&mut CoreBus::new(&mut self.system, observer, 0));
        }
        self.system.advance(self.cpu.cycle(), observer);
    }

    /// Handles events up to the present cycle and resets, and brings the interrupt lines to the processor.
    fn attend(&mut self, observer: &mut impl Observer) {
        self.system.advance(self.cpu.cycle(), observer);
        if let Some(cause) = self.system.reset {
            observer.watchdog_reset(self.cpu.cycle());
            self.restart(cause, observer);
        }
        if self.system.lines_changed {
            self.system.lines_changed = false;
            self.cpu.set_irq_lines(self.system.lines(0));
        }
    }

    fn idles(&self) -> bool {
        self.cpu.is_asleep() || self.cpu.is_locked_up()
    }

    fn sleep(&mut self, until: u64, observer: &mut impl Observer) {
        let from = self.cpu.cycle();
        // An event in one cycle takes effect in the next.
        self.cpu.sleep_until(until.min(self.system.next.saturating_add(1)).max(from + 1));
        if self.cpu.cycle() == from {
            // SysTick has an event in the present cycle.
            self.cpu.step(&mut CoreBus::new(&mut self.system, observer, 0));
        }
        self.asleep_cycles += self.cpu.cycle() - from;
    }

    fn turn(&mut self, until: u64, observer: &mut impl Observer) {
        self.attend(observer);
        if self.idles() {
            self.sleep(until, observer);
            return;
        }
        let mut bus = CoreBus::new(&mut self.system, observer, 0);
        loop {
            self.cpu.step(&mut bus);
            let cycle = self.cpu.cycle();
            let due = bus.system.next < cycle || bus.system.lines_changed || bus.system.reset.is_some();
            if due || cycle >= until || self.cpu.is_asleep() {
                return;
            }
        }
    }

    // The outside: pins, serial lines, the USB cable.

    /// Drives a pin, GPIO 0 to 29, from outside, or no longer (`None`). A pin that nobody drives has its pull-up, or
    /// reads low. Where the chip drives a pin too, the chip's level counts.
    pub fn set_input(&mut self, gpio: u8, level: Option<Level>) {
        let cycle = self.cpu.cycle();
        let changed = self.system.fabric.gpio.set_outside(u32::from(gpio) & 31, level, cycle);
        self.system.fabric.tell(changed, cycle);
        self.system.schedule();
        self.system.lines_changed = true;
    }

    /// The level of a pin as seen from outside.
    pub fn pin(&self, gpio: u8) -> Level {
        Level::from(self.system.fabric.gpio.levels() >> (gpio & 31) & 1 != 0)
    }

    /// Whether the chip drives a pin: it is an output.
    pub fn is_output(&self, gpio: u8) -> bool {
        self.system.fabric.gpio.directions() >> (gpio & 31) & 1 != 0
    }

    /// Puts a character on the line to the receiver of UART 0 or 1. The start bit must not begin before the character
    /// before it has ended, nor before the present cycle. The receiver samples it at the baud rate that the program has
    /// set, if the program has connected a pin to it.
    pub fn receive(&mut self, uart: u8, byte: LineByte) {
        self.system.fabric.uart[usize::from(uart & 1)].receive(byte);
        self.system.schedule();
    }

    /// The cycle by which all characters from [`receive`](Rp2040::receive) have passed. It is the present cycle or an
    /// earlier one if the line is idle.
    pub fn line_idle_from(&self, uart: u8) -> u64 {
        self.system.fabric.uart[usize::from(uart & 1)].line_end()
    }

    /// Whether a UART still sends, or has characters in its buffer.
    pub fn is_transmitting(&self, uart: u8) -> bool {
        self.system.fabric.uart[usize::from(uart & 1)].is_sending()
    }

    /// Plugs in the cable between the USB port and a PC, or pulls it. When the firmware is ready, the PC enumerates and
    /// configures the device: see [`usb_state`](Rp2040::usb_state).
    pub fn usb_plug(&mut self, plugged: bool) {
        let cycle = self.cpu.cycle();
        self.system.fabric.usb.plug(plugged, cycle);
        self.usb_changed();
    }

    /// A program on the PC opens the USB serial port, or closes it. If the port is not there yet, it opens as soon as
    /// it is.
    pub fn usb_open(&mut self, open: bool) {
        let cycle = self.cpu.cycle();
        self.system.fabric.usb.open(open, cycle);
        self.usb_changed();
    }

    /// With `true`, the program on the PC stops reading from the open port and the PC's buffers are full, so that the
    /// PC requests no data from the device. With `false` it reads again.
    pub fn usb_fill(&mut self, is_full: bool) {
        let cycle = self.cpu.cycle();
        self.system.fabric.usb.fill(is_full, cycle);
        self.usb_changed();
    }

    /// The PC sends bytes to the USB serial port from the present cycle on, as fast as bus and device allow. The bytes
    /// wait while the port is not open.
    pub fn usb_send(&mut self, bytes: &[u8]) {
        let cycle = self.cpu.cycle();
        self.system.fabric.usb.send(bytes, cycle);
        self.usb_changed();
    }

    /// The PC clears the halt of an endpoint of the USB serial port (bit 7: towards the PC), whether it is halted or
    /// not. The endpoint goes on with DATA0.
    pub fn usb_clear_halt(&mut self, endpoint: u8) {
        let cycle = self.cpu.cycle();
        self.system.fabric.usb.clear_halt(endpoint, cycle);
        self.usb_changed();
    }

    /// The PC selects a configuration of the USB device. If the device refuses it, nothing changes.
    pub fn usb_try_configuration(&mut self, value: u8) {
        let cycle = self.cpu.cycle();
        self.system.fabric.usb.try_configuration(value, cycle);
        self.usb_changed();
    }

    /// The PC halts an endpoint of the USB serial port (bit 7: towards the PC). No data pass there until the PC
    /// [clears](Rp2040::usb_clear_halt) it.
    pub fn usb_halt(&mut self, endpoint: u8) {
        let cycle = self.cpu.cycle();
        self.system.fabric.usb.halt(endpoint, cycle);
        self.usb_changed();
    }

    /// A string descriptor of the USB device, by its index; `None` if the PC has not read one.
    pub fn usb_text(&self, index: u8) -> Option<String> {
        self.system.fabric.usb.text(index)
    }

    /// Bytes of [`usb_send`](Rp2040::usb_send) that the device has not taken yet.
    pub fn usb_backlog(&self) -> usize {
        self.system.fabric.usb.backlog()
    }

    /// How far the PC has brought the USB device.
    pub fn usb_state(&self) -> UsbState {
        self.system.fabric.usb.state()
    }

    fn usb_changed(&mut self) {
        self.system.schedule();
        self.system.lines_changed = true;
    }

    // For developers, debuggers and tests.

    /// The processor: registers, mode, last fault.
    pub fn cpu(&self) -> &Cpu {
        &self.cpu
    }

    /// The processor, to set its state.
    pub fn cpu_mut(&mut self) -> &mut Cpu {
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

    /// Reads a word as the processor does in the present cycle, but without wait cycles. Reading has its effects, such
    /// as taking a word out of a FIFO. An address where nothing is reads 0.
    pub fn read(&mut self, address: u32, observer: &mut impl Observer) -> u32 {
        self.system.look(address & !3, self.cpu.cycle(), observer)
    }

    /// Writes a word as the processor does in the present cycle, but without wait cycles. The effect is there in the
    /// next cycle. A write to an address where nothing is has no effect.
    pub fn write(&mut self, address: u32, value: u32, observer: &mut impl Observer) {
        self.system.poke(address & !3, value, self.cpu.cycle(), observer);
    }

    /// Reads a word of RAM or flash without any effect; `None` elsewhere.
    pub fn peek(&self, address: u32) -> Option<u32> {
        let fabric = &self.system.fabric;
        match Fabric::sram_offset(address & !3) {
            Some(offset) => fabric.read_sram(offset, Size::Word),
            None => (address >> 24 == 0x10).then(|| fabric.xip.word(address)),
        }
    }

    /// RAM, from [`RAM_ADDRESS`](Rp2040::RAM_ADDRESS).
    pub fn ram(&self) -> &[u8] {
        &self.system.fabric.sram
    }

    /// RAM, to set its contents.
    pub fn ram_mut(&mut self) -> &mut [u8] {
        &mut self.system.fabric.sram
    }

    /// Flash, from [`FLASH_ADDRESS`](Rp2040::FLASH_ADDRESS).
    ///
    /// While a sector is being erased or a page programmed, its bytes are those of the program's last look at the
    /// flash.
    pub fn flash(&self) -> &[u8] {
        self.system.fabric.xip.flash.memory()
    }

    /// Flash, to set its contents. Lines that are already in the cache keep their old contents.
    pub fn flash_mut(&mut self) -> &mut [u8] {
        self.system.fabric.xip.flash.memory_mut()
    }
}
