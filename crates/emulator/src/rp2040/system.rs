//! Everything except the processors, on one clock: the order of events within a cycle (RP2040 datasheet §2.1).
//!
//! What happens in cycle t uses the state at the beginning of t, and its effect is there in t + 1. Within a cycle the
//! state machines come first, then the DMA, then the slow peripherals; the processor's access comes last.

use super::dma::Dma;
use super::fabric::{APB_WRITE_WAITS, Fabric, SRAM, lane, merging, replicate};
use super::pio::Pio;
use super::watchdog::Cause;
use crate::Observer;
use crate::arm::{Bus, BusFault, Size};

const NEVER: u64 = u64::MAX;
const DMA: u32 = 0x5000_0000;
const SIO: u32 = 0xd000_0000;

#[derive(Clone)]
pub(super) struct System {
    pub(super) fabric: Fabric,
    pub(super) dma: Dma,
    /// The cycle of the next event.
    pub(super) next: u64,
    /// Whether an interrupt line may have changed.
    pub(super) lines_changed: bool,
    /// Why the chip must be reset, if the watchdog or the program has requested it.
    pub(super) reset: Option<Cause>,
}

impl System {
    pub(super) fn new(image: &[u8], flash_bytes: usize) -> System {
        System {
            fabric: Fabric::new(image, flash_bytes),
            dma: Dma::new(),
            next: NEVER,
            lines_changed: true,
            reset: None,
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
        let mut pins = false;
        for block in 0..2 {
            if self.fabric.pio[block].next == now {
                let effects = self.fabric.pio[block].run(now, &self.fabric.gpio.inputs);
                pins |= effects.pins;
                self.lines_changed |= self.fabric.pio[block].interrupts();
                if effects.requests != 0 {
                    self.dma.requested(u64::from(effects.requests) << (8 * block), now);
                }
            }
        }
        if self.dma.next == now {
            self.dma.run(now, &mut self.fabric, observer);
            self.lines_changed |=
                std::mem::take(&mut self.dma.lines_changed) | self.fabric.pio.iter().any(Pio::interrupts);
            self.after_write(now);
        }
        if self.fabric.next_slow() == now {
            if self.fabric.run_slow(now, observer) {
                if self.fabric.watchdog_resets() {
                    self.reset = Some(Cause::RanOut);
                }
                self.fabric.watchdog.next = NEVER;
            }
            self.lines_changed = true;
            self.after_write(now);
        }
        if pins {
            self.fabric.drive(now + 1, observer);
            self.lines_changed |= self.fabric.gpio.interrupts();
        }
        self.schedule();
    }

    /// Passes on the effects of a write on other blocks: DREQs, a reset of the DMA, a forced watchdog reset.
    fn after_write(&mut self, cycle: u64) {
        let requests = std::mem::take(&mut self.fabric.requests);
        if requests != 0 {
            self.dma.requested(requests, cycle);
        }
        if std::mem::take(&mut self.fabric.reset_dma) {
            self.dma = Dma::new();
        }
        if self.fabric.watchdog.triggered() && self.fabric.watchdog_resets() {
            self.reset = Some(Cause::Forced);
        }
    }

    pub(super) fn schedule(&mut self) {
        let pio = self.fabric.pio[0].next.min(self.fabric.pio[1].next);
        self.next = pio.min(self.dma.next).min(self.fabric.next_slow());
    }

    /// The levels of a processor's interrupt lines (§2.3.2).
    pub(super) fn lines(&self, core: usize) -> u32 {
        self.fabric.lines(core) | self.dma.lines() << 11
    }

    /// Reads as a processor does. `cycle` is the first in which the data may pass. Returns the value and the wait
    /// cycles.
    #[inline]
    pub(super) fn read(
        &mut self,
        core: usize,
        address: u32,
        size: Size,
        cycle: u64,
        observer: &mut impl Observer,
    ) -> Result<(u32, u32), BusFault> {
        if let Some(offset) = Fabric::sram_offset(address) {
            self.advance(cycle, observer);
            return self.fabric.read_sram(offset, size).map(|value| (value, 0)).ok_or(BusFault { address });
        }
        self.read_slowly(core, address, size, cycle, observer)
    }

    fn read_slowly(
        &mut self,
        core: usize,
        address: u32,
        size: Size,
        cycle: u64,
        observer: &mut impl Observer,
    ) -> Result<(u32, u32), BusFault> {
        let waits = self.fabric.read_waits(address);
        Ok((self.read_at(core, address, size, cycle + u64::from(waits), observer)?, waits))
    }

    /// Reads a word without wait cycles. An address where nothing is reads 0.
    pub(super) fn look(&mut self, address: u32, cycle: u64, observer: &mut impl Observer) -> u32 {
        match Fabric::sram_offset(address) {
            Some(offset) => {
                self.advance(cycle, observer);
                self.fabric.read_sram(offset, Size::Word).unwrap_or(0)
            }
            None => self.read_at(0, address, Size::Word, cycle, observer).unwrap_or(0),
        }
    }

    fn read_at(
        &mut self,
        core: usize,
        address: u32,
        size: Size,
        at: u64,
        observer: &mut impl Observer,
    ) -> Result<u32, BusFault> {
        self.advance(at, observer);
        let value = if address & 0xf000_0000 == SIO {
            let inputs = self.fabric.gpio.inputs.seen(at, 0);
            let word = self.fabric.sio.read(core, address & 0xffc, inputs, at);
            lane(word, address, size)
        } else if address & 0xffff_c000 == DMA {
            if self.fabric.dma_is_held() { 0 } else { lane(self.dma.read(address & 0xffc), address, size) }
        } else if let Some(has_word) = self.fabric.pio_word(address) {
            // In this cycle the state machine still sees the word that is being read, and a word that it pushes now is
            // too late for this read.
            self.advance(at + 1, observer);
            if has_word { self.fabric.read(address, size, at)? } else { self.fabric.pio_underflow(address) }
        } else {
            self.fabric.read(address, size, at)?
        };
        // A read may take a word, clear a flag or wake a state machine.
        self.lines_changed = true;
        self.schedule();
        Ok(value)
    }

    /// Writes as a processor does. Returns the wait cycles.
    #[inline]
    pub(super) fn write(
        &mut self,
        core: usize,
        address: u32,
        size: Size,
        value: u32,
        cycle: u64,
        observer: &mut impl Observer,
    ) -> Result<u32, BusFault> {
        if let Some(offset) = Fabric::sram_offset(address) {
            self.advance(cycle + 1, observer);
            self.fabric.write_sram(offset, size, value);
            return Ok(0);
        }
        self.write_slowly(core, address, size, value, cycle, observer)
    }

    fn write_slowly(
        &mut self,
        core: usize,
        address: u32,
        size: Size,
        value: u32,
        cycle: u64,
        observer: &mut impl Observer,
    ) -> Result<u32, BusFault> {
        let waits = if address >> 28 == 4 { APB_WRITE_WAITS } else { 0 };
        self.write_at(core, address, size, value, cycle + u64::from(waits), observer)?;
        Ok(waits)
    }

    /// Writes a word without wait cycles.
    pub(super) fn poke(&mut self, address: u32, value: u32, cycle: u64, observer: &mut impl Observer) {
        // A write to an address where nothing is has no effect.
        let _ = self.write_at(0, address, Size::Word, value, cycle, observer);
    }

    fn write_at(
        &mut self,
        core: usize,
        address: u32,
        size: Size,
        value: u32,
        at: u64,
        observer: &mut impl Observer,
    ) -> Result<(), BusFault> {
        self.advance(at + 1, observer);
        if address & 0xf000_0000 == SIO {
            let word = replicate(value, size);
            if self.fabric.sio.write(core, address & 0xffc, word, at) {
                self.fabric.drive(at + 1, observer);
            }
        } else if address & 0xffff_c000 == DMA {
            if !self.fabric.dma_is_held() {
                let word = replicate(value, size);
                self.dma.write(address & 0xffc, word, merging(address, word), at);
            }
        } else {
            self.fabric.write(address, size, value, at, observer)?;
        }
        self.after_write(at);
        self.lines_changed = true;
        self.schedule();
        Ok(())
    }

    /// Reads the half-word of an instruction. Returns it with the wait cycles.
    #[inline]
    pub(super) fn fetch(&mut self, address: u32, cycle: u64) -> Result<(u16, u32), BusFault> {
        let offset = address.wrapping_sub(SRAM) as usize;
        if let Some(&[low, high]) = self.fabric.sram.get(offset..offset + 2) {
            return Ok((u16::from_le_bytes([low, high]), 0));
        }
        match address >> 24 {
            0x10..=0x13 => {
                let waits = self.fabric.xip.waits(address);
                // All ones is no instruction: a program that leaves RAM while flash is busy faults.
                let is_there = self.fabric.flash_is_there(cycle + u64::from(waits));
                Ok((if is_there { self.fabric.xip.half(address) } else { u16::MAX }, waits))
            }
            _ => Err(BusFault { address }),
        }
    }
}

/// The system as one of the processors sees it.
pub(super) struct CoreBus<'a, O> {
    pub(super) system: &'a mut System,
    pub(super) observer: &'a mut O,
    pub(super) core: usize,
    waits: u32,
    /// Whether the processor has executed `sev`.
    pub(super) sent_event: bool,
}

impl<'a, O: Observer> CoreBus<'a, O> {
    pub(super) fn new(system: &'a mut System, observer: &'a mut O, core: usize) -> Self {
        CoreBus { system, observer, core, waits: 0, sent_event: false }
    }
}

impl<O: Observer> Bus for CoreBus<'_, O> {
    #[inline]
    fn read(&mut self, address: u32, size: Size, cycle: u64) -> Result<u32, BusFault> {
        let (value, waits) = self.system.read(self.core, address, size, cycle, self.observer)?;
        self.waits = waits;
        Ok(value)
    }

    #[inline]
    fn write(&mut self, address: u32, size: Size, value: u32, cycle: u64) -> Result<(), BusFault> {
        self.waits = self.system.write(self.core, address, size, value, cycle, self.observer)?;
        Ok(())
    }

    #[inline]
    fn fetch(&mut self, address: u32, cycle: u64) -> Result<u16, BusFault> {
        let (half, waits) = self.system.fetch(address, cycle)?;
        self.waits = waits;
        Ok(half)
    }

    #[inline]
    fn wait_cycles(&mut self) -> u32 {
        std::mem::take(&mut self.waits)
    }

    #[inline]
    fn is_io_port(&self, address: u32) -> bool {
        address >> 28 == 0xd
    }

    fn send_event(&mut self) {
        self.sent_event = true;
    }

    fn request_reset(&mut self) {
        self.system.reset = Some(Cause::Program);
    }
}
