//! The chip: processor and peripherals on one clock.

use super::fabric::{Fabric, SRAM, SRAM_BYTES};
use super::system::{CoreBus, System};
use super::usb::UsbState;
use super::watchdog::Cause;
use crate::arm::{Config, Cpu, Fault, Size};
use crate::{ImageTooLarge, Level, LineByte, Observer};

/// Where the second stage of boot hands over (datasheet §2.8.1.3.1): behind its own 256 bytes of flash.
const VECTOR_TABLE: u32 = 0x1000_0100;

/// An RP2040 on a Pico, with its program in 2 MB of flash.
///
/// It starts where boot ROM and second stage of boot end: with the vector table at 0x1000_0100, from which stack
/// pointer and program counter come, and with every peripheral in reset, on the ring oscillator's 6.5 MHz.
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
    /// Bytes of a Pico's flash.
    pub const FLASH_BYTES: usize = 2 * 1024 * 1024;
    /// Where flash lies in the address space.
    pub const FLASH_ADDRESS: u32 = 0x1000_0000;
    /// Where RAM lies.
    pub const RAM_ADDRESS: u32 = SRAM;
    /// Bytes of RAM.
    pub const RAM_BYTES: usize = SRAM_BYTES;

    /// A chip that has just been powered, at cycle 0. The image lies at the beginning of flash; what it does not fill is
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

    /// Gives the flash chip its number, which no other has.
    pub fn set_flash_id(&mut self, id: [u8; 8]) {
        self.system.fabric.xip.flash.id = id;
    }

    /// From now on erasing and programming flash takes as long as its datasheet lets it, 0.4 s for a sector and 3 ms for a page; else what
    /// it takes as a rule, 45 ms and 0.4 ms.
    pub fn slow_flash(&mut self) {
        self.system.fabric.xip.flash.be_slow();
    }

    /// Makes it a chip of another revision, as SYSINFO tells it: 1 is B0 or B1, 2, as it is at first, B2. Nothing else is another.
    pub fn set_revision(&mut self, revision: u8) {
        self.system.fabric.revision = u32::from(revision) & 15;
    }

    /// Resets the chip in the present cycle, as its RUN pin does. Cycles go on counting; RAM and flash are kept, and
    /// what the world does to the pins. Pins that fall back are told to the observer.
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

    /// The cycle that comes next. It only ever grows.
    pub fn cycle(&self) -> u64 {
        self.cpu.cycle()
    }

    /// Cycles per second of the present clock; see [`Observer::clock_frequency`].
    pub fn clock_hz(&self) -> u64 {
        self.system.fabric.clocks.sys_hz()
    }

    /// Runs to the first instruction that begins at or after a cycle. A processor that sleeps costs nothing, and
    /// neither do state machines that wait or count down.
    pub fn run(&mut self, until_cycle: u64, observer: &mut impl Observer) {
        while self.cpu.cycle() < until_cycle {
            self.turn(until_cycle, observer);
        }
        self.system.advance(self.cpu.cycle(), observer);
    }

    /// Executes one instruction, or a part of an exception's entry, or sleeps to the next event (for at most 65 536
    /// cycles).
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

    /// Events up to now, resets, interrupt lines.
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
        // What happens in a cycle is seen in the next.
        self.cpu.sleep_until(until.min(self.system.next.saturating_add(1)).max(from + 1));
        if self.cpu.cycle() == from {
            // SysTick wants something now.
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

    // The world.

    /// Drives a pin, GPIO 0 to 29, from outside, or lets it go (`None`): then its pull-up or nothing holds it, which
    /// reads low. A pin that the chip drives too keeps the chip's level.
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

    /// Whether the chip drives a pin.
    pub fn is_output(&self, gpio: u8) -> bool {
        self.system.fabric.gpio.directions() >> (gpio & 31) & 1 != 0
    }

    /// Puts a character on the line to the receiver of UART 0 or 1. It must not begin before the one given last has
    /// ended, nor before the present cycle; it is sampled as the chip does, with its own baud rate, if a pin is
    /// connected to the receiver.
    pub fn receive(&mut self, uart: u8, byte: LineByte) {
        self.system.fabric.uart[usize::from(uart & 1)].receive(byte);
        self.system.schedule();
    }

    /// The cycle by which everything given to [`receive`](Rp2040::receive) has passed; the present one or earlier if
    /// the line is idle.
    pub fn line_idle_from(&self, uart: u8) -> u64 {
        self.system.fabric.uart[usize::from(uart & 1)].line_end()
    }

    /// Whether a UART has something to send.
    pub fn is_transmitting(&self, uart: u8) -> bool {
        self.system.fabric.uart[usize::from(uart & 1)].is_sending()
    }

    /// Plugs a PC into the USB port, or pulls the cable. The PC attaches, enumerates and configures the device when its
    /// firmware is ready for it: [`usb_state`](Rp2040::usb_state).
    pub fn usb_plug(&mut self, plugged: bool) {
        let cycle = self.cpu.cycle();
        self.system.fabric.usb.plug(plugged, cycle);
        self.usb_changed();
    }

    /// A program on the PC opens the USB serial port, or closes it: as soon as there is one.
    pub fn usb_open(&mut self, open: bool) {
        let cycle = self.cpu.cycle();
        self.system.fabric.usb.open(open, cycle);
        self.usb_changed();
    }

    /// The program that has the USB serial port open reads no more, and all that the PC keeps for it is full: the PC asks the device for
    /// nothing, until the program reads again.
    pub fn usb_fill(&mut self, is_full: bool) {
        let cycle = self.cpu.cycle();
        self.system.fabric.usb.fill(is_full, cycle);
        self.usb_changed();
    }

    /// The PC sends bytes to the USB serial port from the present cycle on, as fast as the bus and the device take them.
    /// They wait if the port is not open.
    pub fn usb_send(&mut self, bytes: &[u8]) {
        let cycle = self.cpu.cycle();
        self.system.fabric.usb.send(bytes, cycle);
        self.usb_changed();
    }

    /// The PC clears an endpoint of the USB serial port (bit 7: to the PC), halted or not: it goes on from DATA0.
    pub fn usb_clear_halt(&mut self, endpoint: u8) {
        let cycle = self.cpu.cycle();
        self.system.fabric.usb.clear_halt(endpoint, cycle);
        self.usb_changed();
    }

    /// The PC asks the USB device for a configuration; one that it refuses changes nothing.
    pub fn usb_try_configuration(&mut self, value: u8) {
        let cycle = self.cpu.cycle();
        self.system.fabric.usb.try_configuration(value, cycle);
        self.usb_changed();
    }

    /// The PC halts an endpoint of the USB serial port (bit 7: to the PC): nothing goes there until it is
    /// [cleared](Rp2040::usb_clear_halt).
    pub fn usb_halt(&mut self, endpoint: u8) {
        let cycle = self.cpu.cycle();
        self.system.fabric.usb.halt(endpoint, cycle);
        self.usb_changed();
    }

    /// A text of the USB device, by its index; `None` if the PC was told none.
    pub fn usb_text(&self, index: u8) -> Option<String> {
        self.system.fabric.usb.text(index)
    }

    /// How many of the bytes of [`usb_send`](Rp2040::usb_send) the device has not taken yet.
    pub fn usb_backlog(&self) -> usize {
        self.system.fabric.usb.backlog()
    }

    /// How far the PC has come with the USB device.
    pub fn usb_state(&self) -> UsbState {
        self.system.fabric.usb.state()
    }

    fn usb_changed(&mut self) {
        self.system.schedule();
        self.system.lines_changed = true;
    }

    // For developers, debuggers and tests.

    /// The processor: its registers, its mode, what it faulted on.
    pub fn cpu(&self) -> &Cpu {
        &self.cpu
    }

    /// The processor, to be set up.
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

    /// Cycles slept, or locked up, since power came on.
    pub fn asleep_cycles(&self) -> u64 {
        self.asleep_cycles
    }

    /// Reads a word as the processor would in the present cycle, effects of reading included, but without the bridge's
    /// waiting. An address at which nothing answers reads as 0.
    pub fn read(&mut self, address: u32, observer: &mut impl Observer) -> u32 {
        self.system.look(address & !3, self.cpu.cycle(), observer)
    }

    /// Writes a word as the processor would, in the present cycle, but without the bridge's waiting: its effect is seen
    /// in the next. Nothing happens where nothing answers.
    pub fn write(&mut self, address: u32, value: u32, observer: &mut impl Observer) {
        self.system.poke(address & !3, value, self.cpu.cycle(), observer);
    }

    /// A word of RAM, or of flash, without any effect; `None` elsewhere.
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

    /// RAM, to be filled.
    pub fn ram_mut(&mut self) -> &mut [u8] {
        &mut self.system.fabric.sram
    }

    /// Flash, from [`FLASH_ADDRESS`](Rp2040::FLASH_ADDRESS).
    ///
    /// Where a sector is being erased or a page programmed it is as when the program looked last.
    pub fn flash(&self) -> &[u8] {
        self.system.fabric.xip.flash.memory()
    }

    /// Flash, to be changed. What the cache holds stays.
    pub fn flash_mut(&mut self) -> &mut [u8] {
        self.system.fabric.xip.flash.memory_mut()
    }
}
