//! The bus fabric: which memory or peripheral is at which address (RP2040 datasheet §2.2), with the registers of
//! RESETS, PSM and SYSINFO. The DMA controller is not here, because it uses the fabric as the processors do.
//!
//! Conflicts are not emulated: two accesses to one memory bank, or to one bus, both pass at once. Accesses wait at the
//! bridge to the slow peripherals ([`APB_READ_WAITS`], [`APB_WRITE_WAITS`]) and at flash (`xip`).

use super::clocks::Clocks;
use super::gpio::{Gpio, function};
use super::pio::Pio;
use super::sio::Sio;
use super::ssi::Ssi;
use super::timer::Timer;
use super::uart::Uart;
use super::usb::{Controller, Usb};
use super::watchdog::{Cause, Watchdog};
use super::xip::Xip;
use crate::Observer;
use crate::arm::{BusFault, Size};
use std::collections::BTreeMap;

/// Wait cycles of the bridge to the slow peripherals (§2.1.3: a read takes 3 cycles, a write 4).
pub(super) const APB_READ_WAITS: u32 = 2;
pub(super) const APB_WRITE_WAITS: u32 = 3;

pub(super) const SRAM: u32 = 0x2000_0000;
pub(super) const SRAM_BYTES: usize = 264 * 1024;
/// Size of the four large banks, bytes. At [`SRAM`], successive words are in successive banks.
const STRIPED_BYTES: u32 = 256 * 1024;
/// Address at which the four large banks follow one another.
const SRAM_BANKS: u32 = 0x2100_0000;

// Addresses of peripherals: their upper bits.
const XIP_CTRL: u32 = 0x1400_0000;
const SYSINFO: u32 = 0x4000_0000;
const CLOCKS: u32 = 0x4000_8000;
const RESETS: u32 = 0x4000_c000;
const PSM: u32 = 0x4001_0000;
const IO_BANK0: u32 = 0x4001_4000;
/// Control of the chip select pin of the flash.
const QSPI_SS_CTRL: u32 = 0x4001_800c;
const PADS_BANK0: u32 = 0x4001_c000;
const XOSC: u32 = 0x4002_4000;
const PLL_SYS: u32 = 0x4002_8000;
const PLL_USB: u32 = 0x4002_c000;
const UART0: u32 = 0x4003_4000;
const UART1: u32 = 0x4003_8000;
const TIMER: u32 = 0x4005_4000;
const WATCHDOG: u32 = 0x4005_8000;
const ROSC: u32 = 0x4006_0000;
/// The USB controller's memory, which it shares with the processor; then its registers.
const USB_DPRAM: u32 = 0x5010_0000;
const USB_DPRAM_BYTES: u32 = 4096;
const USB: u32 = 0x5011_0000;
const PIO0: u32 = 0x5020_0000;
const PIO1: u32 = 0x5030_0000;

/// The bit of processor 0 in the power-on state machine's registers.
const PSM_PROC0: u32 = 1 << 15;

/// Bits of RESETS (§2.14.3).
mod reset {
    pub(super) const DMA: u32 = 1 << 2;
    pub(super) const IO_BANK0: u32 = 1 << 5;
    pub(super) const PADS_BANK0: u32 = 1 << 8;
    pub(super) const PIO0: u32 = 1 << 10;
    pub(super) const PIO1: u32 = 1 << 11;
    pub(super) const PLL_SYS: u32 = 1 << 12;
    pub(super) const PLL_USB: u32 = 1 << 13;
    pub(super) const TIMER: u32 = 1 << 21;
    pub(super) const UART0: u32 = 1 << 22;
    pub(super) const UART1: u32 = 1 << 23;
    pub(super) const USB: u32 = 1 << 24;
    pub(super) const ALL: u32 = 0x01ff_ffff;
}

/// The transfers that the DMA may make with a peripheral.
pub(super) struct Credit {
    /// Whether the DMA reads from the peripheral; else it writes.
    pub(super) reads: bool,
    /// Transfers that may be under way now, and those that may be as soon as the DMA knows of the latest changes.
    pub(super) now: u8,
    pub(super) soon: u8,
}

/// How a write changes a register: address bits 12 and 13 select write, toggle, set or clear (§2.1.2).
pub(super) fn merging(address: u32, value: u32) -> impl Fn(u32) -> u32 {
    move |old| match address >> 12 & 3 {
        0 => value,
        1 => old ^ value,
        2 => old | value,
        _ => old & !value,
    }
}

#[derive(Clone)]
pub(super) struct Fabric {
    pub(super) sram: Vec<u8>,
    pub(super) xip: Xip,
    pub(super) ssi: Ssi,
    /// The chip's revision: 1 is B0 or B1, 2 is B2.
    pub(super) revision: u32,
    pub(super) pio: [Pio; 2],
    pub(super) gpio: Gpio,
    pub(super) sio: Sio,
    pub(super) timer: Timer,
    pub(super) watchdog: Watchdog,
    pub(super) uart: [Uart; 2],
    pub(super) usb: Usb,
    pub(super) clocks: Clocks,
    /// RESETS: the peripherals that are held in reset.
    resets: u32,
    /// Whether the DMA controller was put into reset.
    pub(super) reset_dma: bool,
    /// DREQs that came up outside the cycle of their peripheral.
    pub(super) requests: u64,
    /// Registers that only store what is written: what is behind them is not emulated.
    plain: BTreeMap<u32, u32>,
}

impl Fabric {
    pub(super) fn new(image: &[u8], flash_bytes: usize) -> Fabric {
        let (mut xip, clocks) = (Xip::new(image, flash_bytes), Clocks::new());
        xip.flash.set_clock(clocks.sys_hz());
        Fabric {
            sram: vec![0; SRAM_BYTES],
            xip,
            ssi: Ssi::new(),
            revision: 2,
            pio: [Pio::new(), Pio::new()],
            gpio: Gpio::new(),
            sio: Sio::new(),
            timer: Timer::new(),
            watchdog: Watchdog::new(),
            uart: [Uart::new(0), Uart::new(1)],
            usb: Usb::new(Controller::new()),
            clocks,
            resets: reset::ALL,
            reset_dma: false,
            requests: 0,
            plain: BTreeMap::new(),
        }
    }

    /// Resets the whole chip. Memory keeps its contents.
    pub(super) fn reset(&mut self, cause: Cause, cycle: u64, observer: &mut impl Observer) {
        self.hold(reset::ALL, cycle);
        self.resets = reset::ALL;
        self.sio = Sio::new();
        self.xip.flush();
        self.ssi.reset(&mut self.xip.flash, cycle);
        self.watchdog.reset(cause);
        self.clocks = Clocks::new();
        self.plain.clear();
        self.clocks_changed(cycle, observer);
        observer.clock_frequency(cycle, self.clocks.sys_hz());
        self.drive(cycle, observer);
    }

    /// Puts peripherals into reset.
    fn hold(&mut self, bits: u32, cycle: u64) {
        if bits & reset::DMA != 0 {
            self.reset_dma = true;
        }
        if bits & reset::IO_BANK0 != 0 {
            self.gpio.reset_bank();
        }
        if bits & reset::PADS_BANK0 != 0 {
            self.gpio.reset_pads();
        }
        for (bit, pio) in [reset::PIO0, reset::PIO1].into_iter().zip(&mut self.pio) {
            if bits & bit != 0 {
                *pio = Pio::new();
            }
        }
        for (bit, which) in [(reset::PLL_SYS, 0), (reset::PLL_USB, 1)] {
            if bits & bit != 0 {
                self.clocks.reset_pll(which);
            }
        }
        for (bit, uart) in [reset::UART0, reset::UART1].into_iter().zip(&mut self.uart) {
            if bits & bit != 0 {
                uart.reset();
            }
        }
        if bits & reset::TIMER != 0 {
            self.timer.reset(cycle);
        }
        if bits & reset::USB != 0 {
            self.usb.reset(cycle);
        }
    }

    fn is_held(&self, bit: u32) -> bool {
        self.resets & bit != 0
    }

    /// Whether the DMA controller is in reset.
    pub(super) fn dma_is_held(&self) -> bool {
        self.is_held(reset::DMA)
    }

    /// The bit of RESETS for the peripheral at an address; 0 if it has none.
    fn reset_bit(base: u32) -> u32 {
        match base {
            IO_BANK0 => reset::IO_BANK0,
            PADS_BANK0 => reset::PADS_BANK0,
            PLL_SYS => reset::PLL_SYS,
            PLL_USB => reset::PLL_USB,
            UART0 => reset::UART0,
            UART1 => reset::UART1,
            TIMER => reset::TIMER,
            USB => reset::USB,
            PIO0 => reset::PIO0,
            PIO1 => reset::PIO1,
            _ => 0,
        }
    }

    /// The cycle of the next event, that of the PIO blocks left out.
    pub(super) fn next_slow(&self) -> u64 {
        let uarts = self.uart[0].next.min(self.uart[1].next);
        self.timer.next.min(self.watchdog.next).min(uarts).min(self.usb.next).min(self.clocks.next)
    }

    /// Handles the events of the slow peripherals that are due in a cycle. Returns whether the watchdog has run out.
    pub(super) fn run_slow(&mut self, cycle: u64, observer: &mut impl Observer) -> bool {
        if self.timer.next <= cycle {
            self.timer.run(cycle);
        }
        for number in 0..2 {
            if self.uart[number].next <= cycle && self.uart[number].run(cycle, observer) {
                self.requests |= 3 << (20 + 2 * number);
            }
        }
        self.usb.run(cycle, observer);
        if self.clocks.next <= cycle {
            self.clocks_changed(cycle, observer);
        }
        self.watchdog.next <= cycle
    }

    /// Whether the watchdog may reset the processor (§2.13.5, PSM WDSEL). In the emulator this resets the whole chip.
    pub(super) fn watchdog_resets(&self) -> bool {
        self.plain_register(PSM | 8) & PSM_PROC0 != 0
    }

    /// Brings the frequencies from a cycle on to the peripherals, if they have changed.
    fn clocks_changed(&mut self, cycle: u64, observer: &mut impl Observer) {
        if let Some(hz) = self.clocks.refresh(cycle) {
            observer.clock_frequency(cycle, hz);
        }
        if let Some(tick) = self.clocks.tick(self.watchdog.tick_cycles(), cycle) {
            self.timer.set_tick(tick, cycle);
            self.watchdog.set_tick(tick, cycle);
        }
        let (peri, sys) = (self.clocks.peri_hz(cycle), self.clocks.sys_hz());
        for uart in &mut self.uart {
            uart.set_clocks(peri, sys, cycle);
        }
        self.usb.set_clock(sys, cycle);
        self.xip.flash.set_clock(sys);
    }

    /// Brings the outputs of the peripherals to the pins, from a cycle on.
    pub(super) fn drive(&mut self, cycle: u64, observer: &mut impl Observer) {
        self.gpio.sio.levels = self.sio.out;
        self.gpio.sio.directions = self.sio.out_enable;
        for block in 0..2 {
            self.gpio.pio[block].levels = self.pio[block].levels();
            self.gpio.pio[block].directions = self.pio[block].directions();
        }
        let changed = self.gpio.update(cycle, observer);
        self.tell(changed, cycle);
    }

    /// Reports changed inputs to the peripherals.
    pub(super) fn tell(&mut self, changed: u32, cycle: u64) {
        if changed != 0 {
            for pio in &mut self.pio {
                pio.pins_changed(changed, cycle);
            }
        }
    }

    /// Connects the UARTs to the pins that select them (§2.19.2): every fourth pin is the TX or RX of one of them.
    fn connect_uarts(&mut self, cycle: u64) {
        const TX: [u32; 2] = [1 << 0 | 1 << 12 | 1 << 16 | 1 << 28, 1 << 4 | 1 << 8 | 1 << 20 | 1 << 24];
        let pins = self.gpio.pins_of(function::UART);
        for (uart, tx) in self.uart.iter_mut().zip(TX) {
            uart.connect([pins & tx != 0, pins & tx << 1 != 0], cycle);
        }
        // TX is high all the time, because the observer gets characters instead of edges.
        (self.gpio.uart.levels, self.gpio.uart.directions) = (u32::MAX, TX[0] | TX[1]);
    }

    /// The transfers that the DMA may make, by DREQ number (§2.5.3.1, table of DREQs).
    pub(super) fn credit(&self, request: u32, cycle: u64) -> Credit {
        match request {
            0..=15 => {
                let (pio, number) = (&self.pio[(request / 8) as usize], (request % 8) as usize);
                let (now, soon) = pio.credit(number, cycle);
                Credit { reads: number >= 4, now, soon }
            }
            20..=23 => {
                let reads = request & 1 != 0;
                let now = self.uart[(request as usize - 20) / 2].credit(reads);
                Credit { reads, now, soon: now }
            }
            // Peripherals that are not emulated never request a transfer.
            _ => Credit { reads: false, now: 0, soon: 0 },
        }
    }

    /// Wait cycles of a read at an address.
    pub(super) fn read_waits(&mut self, address: u32) -> u32 {
        match address >> 28 {
            4 => APB_READ_WAITS,
            1 if address < XIP_CTRL => self.xip.waits(address),
            _ => 0,
        }
    }

    /// Wait cycles of a write at an address.
    pub(super) fn write_waits(&self, address: u32) -> u32 {
        if address >> 28 == 4 { APB_WRITE_WAITS } else { 0 }
    }

    /// Whether the address is an RX FIFO of a PIO block, and if so, whether a word is in it.
    pub(super) fn pio_word(&self, address: u32) -> Option<bool> {
        let block = usize::from(address & !0x3fff == PIO1);
        (address & !0x3fff | 0x10_0000 == PIO1).then(|| self.pio[block].has_word(address & 0xffc)).flatten()
    }

    /// Reads an empty RX FIFO, which returns 0 and sets a flag.
    pub(super) fn pio_underflow(&mut self, address: u32) -> u32 {
        self.pio[usize::from(address & !0x3fff == PIO1)].underflow(address & 0xffc);
        0
    }

    /// The offset in RAM of an address.
    #[inline]
    pub(super) fn sram_offset(address: u32) -> Option<usize> {
        let offset = address.wrapping_sub(SRAM);
        if offset < SRAM_BYTES as u32 {
            return Some(offset as usize);
        }
        let offset = address.wrapping_sub(SRAM_BANKS);
        (offset < STRIPED_BYTES).then(|| {
            let (bank, within) = (offset >> 16, offset & 0xffff);
            (((within & !3) << 2) + bank * 4 + (within & 3)) as usize
        })
    }

    /// The offset in the USB controller's memory of an address.
    fn usb_memory(address: u32) -> Option<u32> {
        Some(address.wrapping_sub(USB_DPRAM)).filter(|offset| *offset < USB_DPRAM_BYTES)
    }

    #[inline]
    pub(super) fn read_sram(&self, offset: usize, size: Size) -> Option<u32> {
        Some(match size {
            Size::Word => u32::from_le_bytes(*self.sram.get(offset..)?.first_chunk()?),
            Size::Half => u16::from_le_bytes(*self.sram.get(offset..)?.first_chunk()?).into(),
            Size::Byte => (*self.sram.get(offset)?).into(),
        })
    }

    #[inline]
    pub(super) fn write_sram(&mut self, offset: usize, size: Size, value: u32) {
        let bytes = size.bytes() as usize;
        if let Some(into) = self.sram.get_mut(offset..offset + bytes) {
            into.copy_from_slice(&value.to_le_bytes()[..bytes]);
        }
    }

    /// Reads in a cycle, after the wait cycles.
    pub(super) fn read(&mut self, address: u32, size: Size, cycle: u64) -> Result<u32, BusFault> {
        if let Some(value) = Fabric::sram_offset(address).and_then(|offset| self.read_sram(offset, size)) {
            return Ok(value);
        }
        if let Some(offset) = Fabric::usb_memory(address) {
            let held = self.is_held(reset::USB);
            return Ok(if held { 0 } else { self.usb.read_memory(offset, size) });
        }
        let word = match address >> 24 {
            // The boot ROM is not emulated: it reads as zeros.
            0x00 if address < 0x4000 => 0,
            0x10..=0x13 => {
                if self.flash_is_there(cycle) {
                    self.xip.word(address)
                } else {
                    u32::MAX
                }
            }
            0x14 => self.xip.read(address & 0xfc),
            0x18 => self.ssi.read(address & 0xfc),
            0x40 | 0x50 => self.read_register(address, cycle)?,
            _ => return Err(BusFault { address }),
        };
        Ok(lane(word, address, size))
    }

    /// Whether flash can be read in place now. While it executes a command or is busy, it reads as ones, because
    /// nothing drives the lines. This holds here for lines in the cache too.
    #[inline]
    pub(super) fn flash_is_there(&mut self, cycle: u64) -> bool {
        self.xip.flash.settle(cycle);
        self.ssi.reads_in_place() && !self.xip.flash.is_busy()
    }

    fn read_register(&mut self, address: u32, cycle: u64) -> Result<u32, BusFault> {
        let (base, offset) = (address & !0x3fff, address & 0xffc);
        if self.is_held(Fabric::reset_bit(base)) {
            return Ok(0);
        }
        Ok(match base {
            SYSINFO => match offset {
                // CHIP_ID: RP2040. PLATFORM: an ASIC.
                0x00 => self.revision << 28 | 0x2927,
                0x04 => 2,
                _ => 0,
            },
            CLOCKS => self.clocks.read(offset),
            RESETS => match offset {
                0x0 => self.resets,
                0x8 => !self.resets & reset::ALL,
                _ => self.plain_register(base | offset),
            },
            PSM => match offset {
                // Everything is powered.
                0xc => 0x1_ffff,
                _ => self.plain_register(base | offset),
            },
            IO_BANK0 => self.gpio.read(offset),
            PADS_BANK0 => self.gpio.read_pad(offset),
            XOSC => self.clocks.read_xosc(offset, cycle),
            PLL_SYS => self.clocks.read_pll(0, offset, cycle),
            PLL_USB => self.clocks.read_pll(1, offset, cycle),
            UART0 | UART1 => self.uart[usize::from(base == UART1)].read(offset),
            TIMER => self.timer.read(offset, cycle),
            USB => self.usb.read(offset, cycle),
            WATCHDOG => self.watchdog.read(offset, cycle),
            ROSC => self.clocks.read_rosc(offset, cycle),
            PIO0 | PIO1 => self.pio[usize::from(base == PIO1)].read(offset, cycle),
            _ if is_plain(address) => self.plain_register(base | offset),
            _ => return Err(BusFault { address }),
        })
    }

    fn plain_register(&self, register: u32) -> u32 {
        self.plain.get(&register).copied().unwrap_or(0)
    }

    /// Writes in a cycle, after the wait cycles. The effect is there in the next cycle.
    pub(super) fn write(
        &mut self,
        address: u32,
        size: Size,
        value: u32,
        cycle: u64,
        observer: &mut impl Observer,
    ) -> Result<(), BusFault> {
        if let Some(offset) = Fabric::sram_offset(address) {
            self.write_sram(offset, size, value);
            return Ok(());
        }
        if let Some(offset) = Fabric::usb_memory(address) {
            if !self.is_held(reset::USB) {
                self.usb.write_memory(offset, size, value, cycle);
            }
            return Ok(());
        }
        let value = replicate(value, size);
        match address >> 24 {
            0x10 => self.xip.invalidate(address),
            0x14 => self.xip.write(address & 0xfc, value),
            0x18 => self.ssi.write(address & 0xfc, value, &mut self.xip.flash, cycle),
            0x40 | 0x50 => self.write_register(address, value, cycle, observer)?,
            _ => return Err(BusFault { address }),
        }
        Ok(())
    }

    fn write_register(
        &mut self,
        address: u32,
        value: u32,
        cycle: u64,
        observer: &mut impl Observer,
    ) -> Result<(), BusFault> {
        let (base, offset) = (address & !0x3fff, address & 0xffc);
        if self.is_held(Fabric::reset_bit(base)) {
            return Ok(());
        }
        let merge = merging(address, value);
        match base {
            CLOCKS => {
                self.clocks.write(offset, merge);
                self.clocks_changed(cycle + 1, observer);
            }
            RESETS if offset == 0 => {
                let wanted = merge(self.resets) & reset::ALL;
                self.hold(wanted & !self.resets, cycle + 1);
                self.resets = wanted;
                self.connect_uarts(cycle + 1);
                self.clocks_changed(cycle + 1, observer);
                self.drive(cycle + 1, observer);
            }
            IO_BANK0 => {
                self.gpio.write(offset, value, merge);
                self.connect_uarts(cycle + 1);
                self.drive(cycle + 1, observer);
            }
            PADS_BANK0 => {
                self.gpio.write_pad(offset, merge);
                self.drive(cycle + 1, observer);
            }
            XOSC => {
                self.clocks.write_xosc(offset, merge, cycle);
                self.clocks_changed(cycle + 1, observer);
            }
            PLL_SYS | PLL_USB => {
                self.clocks.write_pll(usize::from(base == PLL_USB), offset, merge, cycle);
                self.clocks_changed(cycle + 1, observer);
            }
            UART0 | UART1 => {
                let number = usize::from(base == UART1);
                self.uart[number].write(offset, value, merge, cycle);
                self.requests |= 3 << (20 + 2 * number);
            }
            TIMER => self.timer.write(offset, value, merge, cycle),
            USB => self.usb.write(offset, value, merge, cycle),
            WATCHDOG => {
                self.watchdog.write(offset, value, merge, cycle);
                self.clocks_changed(cycle + 1, observer);
            }
            ROSC => self.clocks.write_rosc(offset, merge),
            PIO0 | PIO1 => {
                let block = usize::from(base == PIO1);
                let effects = self.pio[block].write(offset, value, merge, cycle);
                self.requests |= u64::from(effects.requests) << (8 * block);
            }
            SYSINFO => {}
            _ if is_plain(address) => {
                let register = self.plain.entry(base | offset).or_insert(0);
                *register = merge(*register);
                if base | offset == QSPI_SS_CTRL {
                    self.ssi.set_select(*register >> 8 & 3, &mut self.xip.flash, cycle);
                }
            }
            _ => return Err(BusFault { address }),
        }
        Ok(())
    }

    /// The levels of a processor's interrupt lines, without those of the DMA (§2.3.2).
    pub(super) fn lines(&self, core: usize) -> u32 {
        self.timer.lines()
            | u32::from(self.usb.line_asserted()) << 5
            | self.pio[0].lines() << 7
            | self.pio[1].lines() << 9
            | u32::from(self.gpio.line(core)) << 13
            | u32::from(self.sio.line(core)) << (15 + core)
            | u32::from(self.uart[0].line_asserted()) << 20
            | u32::from(self.uart[1].line_asserted()) << 21
    }
}

/// Whether nothing at the address is emulated, or only a part.
fn is_plain(address: u32) -> bool {
    matches!(address, 0x4000_0000..0x4007_4000 | 0x5010_0000..0x5050_0000)
}

/// The bytes of a word that a narrow read returns.
pub(super) fn lane(word: u32, address: u32, size: Size) -> u32 {
    match size {
        Size::Word => word,
        Size::Half => word >> ((address & 2) * 8) & 0xffff,
        Size::Byte => word >> ((address & 3) * 8) & 0xff,
    }
}

/// A narrow write to a register writes the whole word, with the data repeated (§2.1.4).
pub(super) fn replicate(word: u32, size: Size) -> u32 {
    match size {
        Size::Byte => (word & 0xff) * 0x0101_0101,
        Size::Half => (word & 0xffff) * 0x0001_0001,
        Size::Word => word,
    }
}
