//! Everything but the processor, on one clock: what is at which address (Atmel-11057C §9), what an access costs, and
//! the order of events within a cycle.
//!
//! What happens in cycle t uses the state at the beginning of t, and its effect is there in t + 1. Within a cycle timers,
//! flash, watchdog and serial lines come first; the processor's access comes last.

use super::flash::{BOOTS_FLASH, BOOTS_PLANE_1, Flash, PLANE_BYTES};
use super::pio::{Output, Pins};
use super::pmc::Pmc;
use super::reset::{CHIP_ID, Cause, ResetController, Watchdog};
use super::tc::{TimerClocks, Timers};
use super::timing::Sam3x8eTiming;
use super::uart::Uart;
use super::uotghs::{Uotghs, Usb};
use crate::Observer;
use crate::arm::{Bus, BusFault, Size};
use std::collections::BTreeMap;

const NEVER: u64 = u64::MAX;

/// Memories.
const FLASH: u32 = 0x0008_0000;
const SRAM0: u32 = 0x2000_0000;
pub(super) const SRAM0_BYTES: usize = 64 * 1024;
const SRAM1: u32 = 0x2008_0000;
pub(super) const SRAM1_BYTES: usize = 32 * 1024;
const SRAM_END: u32 = 0x2010_0000;
/// The banks of USB's endpoints.
const USB_BANKS: u32 = 0x2018_0000;
const USB_BANKS_END: u32 = USB_BANKS + 10 * 0x8000;

/// Peripherals.
const TC0: u32 = 0x4008_0000;
const TC2: u32 = 0x4008_8000;
const UOTGHS: u32 = 0x400a_c000;
const MATRIX: u32 = 0x400e_0400;
const PMC: u32 = 0x400e_0600;
const UART: u32 = 0x400e_0800;
const CHIPID: u32 = 0x400e_0940;
const EEFC0: u32 = 0x400e_0a00;
const EEFC1: u32 = 0x400e_0c00;
const PIOA: u32 = 0x400e_0e00;
const PIOD: u32 = 0x400e_1400;
const SYSTEM: u32 = 0x400e_1a00;

/// Numbers of peripherals, which are those of their interrupts (§9).
mod id {
    pub(super) const WATCHDOG: u32 = 4;
    pub(super) const PMC: u32 = 5;
    pub(super) const EEFC0: u32 = 6;
    pub(super) const UART: u32 = 8;
    pub(super) const PIOA: u32 = 11;
    pub(super) const TC0: u32 = 27;
    pub(super) const UOTGHS: u32 = 40;
}

/// Slaves of the bus matrix (§9, table of slaves).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Slave {
    Sram0 = 0,
    Sram1 = 1,
    Flash = 3,
    UsbBanks = 4,
    LowBridge = 7,
    HighBridge = 8,
}

/// The bus matrix (§21): its registers. While a slave has no default master, an access costs a cycle more.
#[derive(Clone, Debug)]
struct Matrix {
    masters: [u32; 6],
    slaves: [u32; 9],
    remap: u32,
    /// CCFG_SYSIO: PC0 is ERASE.
    system_io: u32,
}

impl Matrix {
    fn new() -> Matrix {
        Matrix { masters: [0; 6], slaves: [0x10; 9], remap: 0, system_io: 0 }
    }

    fn waits(&self, slave: Slave) -> u32 {
        u32::from(self.slaves[slave as usize] >> 16 & 3 == 0)
    }

    fn register(&mut self, offset: u32) -> Option<&mut u32> {
        match offset {
            0x00..0x18 => Some(&mut self.masters[offset as usize / 4]),
            0x40..0x64 => Some(&mut self.slaves[(offset as usize - 0x40) / 4]),
            0x100 => Some(&mut self.remap),
            0x114 => Some(&mut self.system_io),
            _ => None,
        }
    }
}

/// Fetching from SRAM, over the system bus: a word in two cycles, and not one directly after another (TRM DDI 0337,
/// "System bus").
#[derive(Clone, Copy, Debug)]
struct SystemFetch {
    word: u32,
    ready: u64,
}

#[derive(Clone)]
pub(super) struct System {
    sram0: Vec<u8>,
    sram1: Vec<u8>,
    pub(super) flash: Flash,
    pub(super) timers: Timers,
    pub(super) pins: Pins,
    pub(super) pmc: Pmc,
    pub(super) uart: Uart,
    pub(super) usb: Usb,
    matrix: Matrix,
    pub(super) resets: ResetController,
    pub(super) watchdog: Watchdog,
    /// GPBR: they survive a reset.
    backup: [u32; 8],
    /// What was written to peripherals that are not emulated.
    plain: BTreeMap<u32, u32>,
    pub(super) timing: Sam3x8eTiming,
    system_fetch: SystemFetch,
    /// The cycle of the next event.
    pub(super) next: u64,
    /// The cycle from which an interrupt line may have another level; `NEVER`: none has.
    pub(super) lines_from: u64,
    /// Why the chip must be reset.
    pub(super) reset: Option<Cause>,
}

impl System {
    pub(super) fn new(image: &[u8], timing: Sam3x8eTiming) -> System {
        let pmc = Pmc::new();
        let mut system = System {
            sram0: vec![0; SRAM0_BYTES],
            sram1: vec![0; SRAM1_BYTES],
            flash: Flash::new(image),
            timers: Timers::new(),
            pins: Pins::new(),
            uart: Uart::new(),
            usb: Usb::new(Uotghs::new()),
            matrix: Matrix::new(),
            resets: ResetController::new(Cause::PowerUp),
            watchdog: Watchdog::new(&pmc.slow, 0),
            pmc,
            backup: [0; 8],
            plain: BTreeMap::new(),
            timing,
            system_fetch: SystemFetch { word: u32::MAX, ready: 0 },
            next: NEVER,
            lines_from: 0,
            reset: None,
        };
        system.clocks_changed(0);
        system
    }

    /// Resets all but memories, backup registers, and what drives the pins from outside.
    pub(super) fn restart(&mut self, cause: Cause, cycle: u64, observer: &mut impl Observer) {
        self.flash.reset();
        self.pmc.reset(cycle);
        self.timers = Timers::new();
        self.pins.reset(cycle, observer);
        self.uart.reset(cycle);
        self.usb.reset(cycle);
        self.matrix = Matrix::new();
        self.resets = ResetController::new(cause);
        self.watchdog = Watchdog::new(&self.pmc.slow, cycle);
        self.plain.clear();
        self.reset = None;
        self.clocks_changed(cycle);
        self.touch(cycle);
    }

    /// Passes the clocks on to who uses them.
    fn clocks_changed(&mut self, cycle: u64) {
        let enabled = (self.pmc.enabled() >> id::TC0) as u32 & 0x1ff;
        self.timers.set_clocks(TimerClocks { enabled, slow_cycles: self.pmc.slow.period() }, cycle);
        self.pins.set_clocks((self.pmc.enabled() >> id::PIOA) as u32 & 15);
        self.watchdog.schedule(&self.pmc.slow);
        self.connect_uart(cycle);
        self.usb.set_clock(self.pmc.hz(), cycle);
        self.clock_usb(cycle);
        self.schedule();
    }

    fn connect_uart(&mut self, cycle: u64) {
        let clocked = self.pmc.enabled() >> id::UART & 1 != 0;
        self.uart.connect(clocked, self.pins.connects_uart(), cycle);
    }

    /// USB has its clock when the UTMI's PLL is locked.
    fn clock_usb(&mut self, cycle: u64) {
        let clocked = self.pmc.enabled() >> id::UOTGHS & 1 != 0 && self.pmc.utmi_runs(cycle);
        self.usb.set_clocked(clocked, cycle);
    }

    /// The UART's DMA moves what it can (§26).
    fn move_bytes(&mut self, cycle: u64) {
        while let Some(address) = self.uart.fetches() {
            let word = self.peek(address & !3).unwrap_or(0);
            self.uart.put((word >> (8 * (address & 3))) as u8, cycle);
        }
        while let Some((address, byte)) = self.uart.stores() {
            if let Some((bytes, at)) = self.sram_mut(address) {
                bytes[at] = byte;
            }
        }
    }

    /// Handles all events in the cycles before this one.
    #[inline]
    pub(super) fn advance(&mut self, before: u64, observer: &mut impl Observer) {
        while self.next < before {
            self.cycle(self.next, observer);
        }
    }

    fn cycle(&mut self, now: u64, observer: &mut impl Observer) {
        if self.timers.next == now {
            let channels = self.timers.run(now);
            self.timer_outputs(channels, now + 1, observer);
        }
        if self.flash.next == now {
            self.flash.run(now);
        }
        if self.uart.next == now {
            self.uart.run(now, observer);
            self.move_bytes(now + 1);
        }
        if self.usb.next == now {
            self.usb.run(now, observer);
        }
        if self.watchdog.next == now && self.watchdog.run_out() {
            self.reset = Some(Cause::Watchdog);
        }
        self.touch(now + 1);
        self.schedule();
    }

    /// Some channels of the timers drive their pins.
    fn timer_outputs(&mut self, channels: u32, cycle: u64, observer: &mut impl Observer) {
        for channel in (0..9).filter(|channel| channels >> channel & 1 != 0) {
            let (a, b) = self.timers.outputs(channel);
            self.pins.output(Output::TioA(channel), a, cycle, observer);
            self.pins.output(Output::TioB(channel), b, cycle, observer);
        }
    }

    /// The interrupt lines may have other levels from a cycle on.
    pub(super) fn touch(&mut self, cycle: u64) {
        self.lines_from = self.lines_from.min(cycle);
    }

    pub(super) fn schedule(&mut self) {
        self.next =
            self.timers.next.min(self.flash.next).min(self.uart.next).min(self.usb.next).min(self.watchdog.next);
    }

    /// The levels of the interrupt lines.
    pub(super) fn lines(&self, cycle: u64) -> u64 {
        u64::from(self.watchdog.line_asserted()) << id::WATCHDOG
            | u64::from(self.pmc.line_asserted(cycle)) << id::PMC
            | u64::from(self.flash.line_asserted(0, cycle)) << id::EEFC0
            | u64::from(self.flash.line_asserted(1, cycle)) << (id::EEFC0 + 1)
            | u64::from(self.uart.line_asserted()) << id::UART
            | self.pins.lines() << id::PIOA
            | self.timers.lines() << id::TC0
            | u64::from(self.usb.line_asserted()) << id::UOTGHS
    }

    // Memories.

    /// The memory at an address of SRAM. SRAM0 repeats up to SRAM1, so that the two are one piece from 0x2007_0000 on.
    #[inline]
    fn sram(&self, address: u32) -> Option<(&[u8], usize)> {
        match address {
            SRAM0..SRAM1 => Some((&self.sram0, (address as usize) % SRAM0_BYTES)),
            SRAM1..SRAM_END => Some((&self.sram1, (address as usize) % SRAM1_BYTES)),
            _ => None,
        }
    }

    #[inline]
    fn sram_mut(&mut self, address: u32) -> Option<(&mut [u8], usize)> {
        match address {
            SRAM0..SRAM1 => Some((&mut self.sram0, (address as usize) % SRAM0_BYTES)),
            SRAM1..SRAM_END => Some((&mut self.sram1, (address as usize) % SRAM1_BYTES)),
            _ => None,
        }
    }

    /// The place of an address in flash: there, or at 0, which shows the plane that the chip boots from (§9.1.3).
    #[inline]
    fn flash_offset(&self, address: u32) -> Option<u32> {
        match address {
            FLASH..0x0010_0000 => Some(address - FLASH),
            0..FLASH if self.flash.gpnvm & BOOTS_FLASH != 0 => {
                let plane = if self.flash.gpnvm & BOOTS_PLANE_1 != 0 { PLANE_BYTES as u32 } else { 0 };
                Some(address % PLANE_BYTES as u32 + plane)
            }
            _ => None,
        }
    }

    /// Reads a word of memory without any effect; `None` where there is no memory.
    pub(super) fn peek(&self, address: u32) -> Option<u32> {
        if let Some(offset) = self.flash_offset(address) {
            return Some(self.flash.value(offset, Size::Word));
        }
        let (bytes, at) = self.sram(address)?;
        Some(value_of(bytes, at, Size::Word))
    }

    /// Writes a byte of SRAM or flash, without time; `false` where there is none.
    pub(super) fn poke(&mut self, address: u32, byte: u8) -> bool {
        if let Some(offset) = self.flash_offset(address) {
            self.flash.bytes[offset as usize] = byte;
            return true;
        }
        let Some((bytes, at)) = self.sram_mut(address) else { return false };
        bytes[at] = byte;
        true
    }

    // Accesses of the processor.

    /// Reads. `cycle` is the first in which the data may pass. Returns the value and the wait cycles.
    #[inline]
    fn read(
        &mut self,
        address: u32,
        size: Size,
        cycle: u64,
        observer: &mut impl Observer,
    ) -> Result<(u32, u32), BusFault> {
        if let Some((bytes, at)) = self.sram(address) {
            let value = value_of(bytes, at, size);
            let waits = self.matrix.waits(if address < SRAM1 { Slave::Sram0 } else { Slave::Sram1 });
            self.hold_system_fetch();
            return Ok((value, waits));
        }
        if let Some(offset) = self.flash_offset(address) {
            let slow = self.matrix.waits(Slave::Flash);
            return Ok(self.flash.read(offset, size, cycle, slow));
        }
        self.hold_system_fetch();
        if let USB_BANKS..USB_BANKS_END = address {
            self.advance(cycle, observer);
            let waits = self.matrix.waits(Slave::UsbBanks);
            return Ok((self.usb.read_fifo(address - USB_BANKS, size), waits));
        }
        let waits = self.timing.load_waits + self.bridge_waits(address);
        let word = self.read_register(address & !3, cycle + u64::from(waits), observer)?;
        Ok((word >> (8 * (address & 3)) & mask(size), waits))
    }

    /// Writes. Returns the wait cycles.
    #[inline]
    fn write(
        &mut self,
        address: u32,
        size: Size,
        value: u32,
        cycle: u64,
        observer: &mut impl Observer,
    ) -> Result<u32, BusFault> {
        if let Some((bytes, at)) = self.sram_mut(address) {
            bytes[at..at + size.bytes() as usize].copy_from_slice(&value.to_le_bytes()[..size.bytes() as usize]);
            self.hold_system_fetch();
            return Ok(self.matrix.waits(if address < SRAM1 { Slave::Sram0 } else { Slave::Sram1 }));
        }
        if let Some(offset) = self.flash_offset(address) {
            self.flash.write(offset, size, value);
            return Ok(0);
        }
        self.hold_system_fetch();
        let waits = match address {
            USB_BANKS..USB_BANKS_END => self.matrix.waits(Slave::UsbBanks),
            _ => self.timing.store_waits + self.bridge_waits(address),
        };
        self.write_at(address, size, value, cycle + u64::from(waits), observer)?;
        Ok(waits)
    }

    /// Writes to what is no memory, without wait cycles.
    pub(super) fn write_at(
        &mut self,
        address: u32,
        size: Size,
        value: u32,
        at: u64,
        observer: &mut impl Observer,
    ) -> Result<(), BusFault> {
        if let USB_BANKS..USB_BANKS_END = address {
            self.advance(at + 1, observer);
            self.usb.write_fifo(address - USB_BANKS, size, value);
            return Ok(());
        }
        self.write_register(address & !3, value << (8 * (address & 3)), at, observer)
    }

    fn bridge_waits(&self, address: u32) -> u32 {
        self.matrix.waits(if address >= 0x400e_0000 { Slave::LowBridge } else { Slave::HighBridge })
    }

    /// An access to data over the system bus delays the next fetch there.
    #[inline]
    fn hold_system_fetch(&mut self) {
        self.system_fetch.ready += 1;
    }

    /// Reads the half-word of an instruction. Returns it with the wait cycles.
    #[inline]
    fn fetch(&mut self, address: u32, cycle: u64) -> Result<(u16, u32), BusFault> {
        if let Some(offset) = self.flash_offset(address) {
            let slow = self.matrix.waits(Slave::Flash);
            return Ok(self.flash.fetch(offset, cycle, self.timing.reads_ahead, slow));
        }
        let Some((bytes, at)) = self.sram(address) else { return Err(BusFault { address }) };
        let half = value_of(bytes, at, Size::Half) as u16;
        let SystemFetch { word, ready } = self.system_fetch;
        if address / 4 == word {
            return Ok((half, u32::try_from(ready.saturating_sub(cycle)).unwrap_or(0)));
        }
        let ready = if address / 4 == word.wrapping_add(1) { (ready + 2).max(cycle) } else { cycle + 1 };
        self.system_fetch = SystemFetch { word: address / 4, ready };
        Ok((half, (ready - cycle) as u32))
    }

    /// Reads a register without wait cycles, in a cycle.
    pub(super) fn read_register(
        &mut self,
        address: u32,
        at: u64,
        observer: &mut impl Observer,
    ) -> Result<u32, BusFault> {
        self.advance(at, observer);
        let value = match address {
            TC0..0x4008_c000 => self.timers.read(((address - TC0) >> 14) as usize, address & 0x3fff, at),
            MATRIX..PMC => self.matrix.register(address - MATRIX).map_or(0, |register| *register),
            PMC..UART => self.pmc.read(address - PMC, at),
            CHIPID => CHIP_ID,
            UART..CHIPID => self.uart.read(address - UART),
            UOTGHS..0x400b_0000 => {
                self.clock_usb(at);
                self.usb.read(address - UOTGHS, at)
            }
            USB_BANKS..USB_BANKS_END => self.usb.read_fifo(address - USB_BANKS, Size::Word),
            EEFC0..PIOA => {
                let number = usize::from(address >= EEFC1);
                self.flash.read_register(number, address & 0x1ff, at)
            }
            PIOA..0x400e_1600 => self.pins.read(((address - PIOA) >> 9) as usize, (address - PIOA) & 0x1ff),
            SYSTEM..0x400e_1ac0 => self.read_system(address - SYSTEM),
            _ if is_plain(address) => self.plain.get(&address).copied().unwrap_or(0),
            _ => return Err(BusFault { address }),
        };
        // A read may clear a flag.
        self.touch(at + 1);
        self.schedule();
        Ok(value)
    }

    fn read_system(&mut self, offset: u32) -> u32 {
        match offset {
            0x00..0x10 => self.resets.read(offset),
            0x50..0x60 => self.watchdog.read(offset - 0x50),
            0x90..0xb0 => self.backup[(offset as usize - 0x90) / 4],
            _ => self.plain.get(&(SYSTEM + offset)).copied().unwrap_or(0),
        }
    }

    /// Writes a register without wait cycles; the effect is there in the next cycle.
    fn write_register(
        &mut self,
        address: u32,
        value: u32,
        at: u64,
        observer: &mut impl Observer,
    ) -> Result<(), BusFault> {
        self.advance(at + 1, observer);
        match address {
            TC0..0x4008_c000 => {
                let block = ((address - TC0) >> 14) as usize;
                self.timers.write(block, address & 0x3fff, value, at);
                self.timer_outputs(7 << (3 * block), at + 1, observer);
            }
            MATRIX..PMC => {
                if let Some(register) = self.matrix.register(address - MATRIX) {
                    *register = value;
                }
            }
            UART..CHIPID => {
                self.uart.write(address - UART, value, at);
                self.move_bytes(at + 1);
            }
            UOTGHS..0x400b_0000 => {
                self.clock_usb(at);
                self.usb.write(address - UOTGHS, value, at);
            }
            PMC..UART => {
                if self.pmc.write(address - PMC, value, at) {
                    observer.clock_frequency(at + 1, self.pmc.hz());
                }
                self.clocks_changed(at + 1);
            }
            EEFC0..PIOA => {
                let number = usize::from(address >= EEFC1);
                self.flash.write_register(number, address & 0x1ff, value, at, self.pmc.hz());
            }
            PIOA..0x400e_1600 => {
                self.pins.write(((address - PIOA) >> 9) as usize, (address - PIOA) & 0x1ff, value, at, observer);
                self.connect_uart(at + 1);
            }
            SYSTEM..0x400e_1ac0 => self.write_system(address - SYSTEM, value, at),
            _ if is_plain(address) => {
                self.plain.insert(address, value);
            }
            _ => return Err(BusFault { address }),
        }
        self.touch(at + 1);
        self.schedule();
        Ok(())
    }

    fn write_system(&mut self, offset: u32, value: u32, at: u64) {
        match offset {
            0x00..0x10 => {
                if self.resets.write(offset, value) {
                    self.reset = Some(Cause::Software);
                }
            }
            0x50..0x60 => {
                if self.watchdog.write(offset - 0x50, value, &self.pmc.slow, at) {
                    self.reset = Some(Cause::Watchdog);
                }
            }
            0x90..0xb0 => self.backup[(offset as usize - 0x90) / 4] = value,
            _ => {
                self.plain.insert(SYSTEM + offset, value);
            }
        }
    }
}

const _: () = assert!(TC2 + 0x4000 == 0x4008_c000 && PIOD + 0x200 == 0x400e_1600);

/// Whether there is a peripheral that is not emulated.
fn is_plain(address: u32) -> bool {
    matches!(address, 0x4000_0000..0x400d_0000 | 0x400e_0000..0x400e_2600)
}

#[inline]
fn value_of(bytes: &[u8], at: usize, size: Size) -> u32 {
    match (size, bytes.get(at..at + size.bytes() as usize)) {
        (Size::Byte, Some(&[a])) => a.into(),
        (Size::Half, Some(&[a, b])) => u16::from_le_bytes([a, b]).into(),
        (Size::Word, Some(&[a, b, c, d])) => u32::from_le_bytes([a, b, c, d]),
        _ => 0,
    }
}

fn mask(size: Size) -> u32 {
    match size {
        Size::Byte => 0xff,
        Size::Half => 0xffff,
        Size::Word => u32::MAX,
    }
}

/// The system as the processor sees it.
pub(super) struct CoreBus<'a, O> {
    pub(super) system: &'a mut System,
    observer: &'a mut O,
    waits: u32,
}

impl<'a, O: Observer> CoreBus<'a, O> {
    pub(super) fn new(system: &'a mut System, observer: &'a mut O) -> Self {
        CoreBus { system, observer, waits: 0 }
    }
}

impl<O: Observer> Bus for CoreBus<'_, O> {
    #[inline]
    fn read(&mut self, address: u32, size: Size, cycle: u64) -> Result<u32, BusFault> {
        let (value, waits) = self.system.read(address, size, cycle, self.observer)?;
        self.waits = waits;
        Ok(value)
    }

    #[inline]
    fn write(&mut self, address: u32, size: Size, value: u32, cycle: u64) -> Result<(), BusFault> {
        self.waits = self.system.write(address, size, value, cycle, self.observer)?;
        Ok(())
    }

    #[inline]
    fn fetch(&mut self, address: u32, cycle: u64) -> Result<u16, BusFault> {
        let (half, waits) = self.system.fetch(address, cycle)?;
        self.waits = waits;
        Ok(half)
    }

    fn read_vector(&mut self, address: u32, cycle: u64) -> Result<u32, BusFault> {
        let Some(offset) = self.system.flash_offset(address) else { return self.read(address, Size::Word, cycle) };
        let (_, waits) = self.system.fetch(address, cycle)?;
        self.waits = waits;
        Ok(self.system.flash.value(offset, Size::Word))
    }

    #[inline]
    fn wait_cycles(&mut self) -> u32 {
        std::mem::take(&mut self.waits)
    }

    fn request_reset(&mut self) {
        self.system.reset = Some(Cause::Software);
    }
}
