//! Loads and stores of the Cortex-M3, and their cycles (TRM DDI 0337, "Load/store timings").
//!
//! A load takes 2 cycles, its address in the first and its data in the second. It takes 1 if the instruction before was a
//! load too, of a register that is not part of the address. A store takes 1: its data pass during the next instruction,
//! which waits for them only if it loads or stores too. Within an instruction with many registers there is one in each
//! cycle.

use super::{CortexM3, NO_LOAD};
use crate::arm::bus::{Bus, Size};
use crate::arm::cpu::is_private;
use crate::arm::fault::FaultCause;

/// An address, and the registers from which it was computed.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub(super) address: u32,
    pub(super) registers: u16,
}

/// The bit that a word of a bit-band alias stands for: the address of its word, and its place there (TRM, "Bit-banding").
fn bit_band(address: u32) -> Option<(u32, u32)> {
    let region = address & 0xfe00_0000;
    if region != 0x2200_0000 && region != 0x4200_0000 {
        return None;
    }
    let offset = address & 0x01ff_ffff;
    Some(((address & 0xf000_0000) + (offset >> 5 & !3), offset >> 2 & 31))
}

impl CortexM3 {
    /// Begins an instruction that loads: returns the cycle in which the first data may pass.
    #[inline(always)]
    fn load_begins(&self, place: Place) -> u64 {
        let loaded = self.variant.loaded;
        let overlaps = loaded != NO_LOAD && place.registers >> loaded & 1 == 0;
        if overlaps { self.cycle } else { self.cycle.max(self.variant.bus_free) + 1 }
    }

    /// An instruction's only load.
    #[inline(always)]
    pub(super) fn load_one(&mut self, bus: &mut impl Bus, place: Place, size: Size) -> Result<u32, FaultCause> {
        let began = self.cycle;
        self.cycle = self.load_begins(place);
        let value = self.load_data(bus, place.address, size);
        if value.is_err() {
            self.cycle = began;
        }
        value
    }

    /// An instruction's only store. `indexed`: its address is the sum of two registers, which takes a cycle more unless
    /// the instruction before was a load.
    #[inline(always)]
    pub(super) fn store_one(
        &mut self,
        bus: &mut impl Bus,
        address: u32,
        size: Size,
        value: u32,
        indexed: bool,
    ) -> Result<(), FaultCause> {
        let began = self.cycle;
        let address_cycle = self.cycle.max(self.variant.bus_free);
        self.cycle = address_cycle + 1;
        if let Err(cause) = self.store_data(bus, address, size, value) {
            self.cycle = began;
            return Err(cause);
        }
        if !is_private(address) {
            // The data pass while the next instruction is executed.
            self.variant.bus_free = self.cycle - 1;
            self.cycle = address_cycle + 1 + u64::from(indexed && self.variant.loaded == NO_LOAD);
        }
        Ok(())
    }

    /// Begins an instruction with many loads or stores.
    pub(super) fn begin_many(&mut self) {
        self.cycle = self.cycle.max(self.variant.bus_free) + 1;
    }

    /// One word of many. It must be aligned, whatever CCR says.
    pub(super) fn load_word(&mut self, bus: &mut impl Bus, address: u32) -> Result<u32, FaultCause> {
        if address & 3 != 0 {
            return Err(FaultCause::Unaligned { address });
        }
        self.load_data(bus, address, Size::Word)
    }

    /// One word of many.
    pub(super) fn store_word(&mut self, bus: &mut impl Bus, address: u32, value: u32) -> Result<(), FaultCause> {
        if address & 3 != 0 {
            return Err(FaultCause::Unaligned { address });
        }
        self.store_data(bus, address, Size::Word, value)
    }

    /// The data of a load, from the present cycle on. Then `cycle` is the one after them.
    #[inline(always)]
    fn load_data(&mut self, bus: &mut impl Bus, address: u32, size: Size) -> Result<u32, FaultCause> {
        if address & (size.bytes() - 1) != 0 || address >> 28 >= 0xe || is_alias(address) {
            return self.load_specially(bus, address, size);
        }
        let value = bus.read(address, size, self.cycle).map_err(|fault| FaultCause::Bus { address: fault.address })?;
        self.cycle += u64::from(bus.wait_cycles()) + 1;
        Ok(value)
    }

    #[inline(always)]
    pub(super) fn store_data(
        &mut self,
        bus: &mut impl Bus,
        address: u32,
        size: Size,
        value: u32,
    ) -> Result<(), FaultCause> {
        if address & (size.bytes() - 1) != 0 || address >> 28 >= 0xe || is_alias(address) {
            return self.store_specially(bus, address, size, value);
        }
        bus.write(address, size, value, self.cycle).map_err(|fault| FaultCause::Bus { address: fault.address })?;
        self.cycle += u64::from(bus.wait_cycles()) + 1;
        Ok(())
    }

    /// Loads from the private registers, from bit-band aliases, and unaligned ones.
    #[cold]
    fn load_specially(&mut self, bus: &mut impl Bus, address: u32, size: Size) -> Result<u32, FaultCause> {
        if address & (size.bytes() - 1) != 0 {
            self.check_unaligned(address)?;
            let mut value = 0;
            for (part, bytes) in parts(address, size) {
                value |= self.load_data(bus, part, bytes)? << (8 * part.wrapping_sub(address));
            }
            return Ok(value);
        }
        if is_private(address) {
            let value = self.read_private(address, size)?;
            self.cycle += 1;
            return Ok(value);
        }
        if let Some((word, place)) = bit_band(address) {
            return Ok(self.load_data(bus, word, Size::Word)? >> place & 1);
        }
        let value = bus.read(address, size, self.cycle).map_err(|fault| FaultCause::Bus { address: fault.address })?;
        self.cycle += u64::from(bus.wait_cycles()) + 1;
        Ok(value)
    }

    #[cold]
    fn store_specially(&mut self, bus: &mut impl Bus, address: u32, size: Size, value: u32) -> Result<(), FaultCause> {
        if address & (size.bytes() - 1) != 0 {
            self.check_unaligned(address)?;
            for (part, bytes) in parts(address, size) {
                let shifted = value >> (8 * part.wrapping_sub(address));
                self.store_data(bus, part, bytes, shifted & mask(bytes))?;
            }
            return Ok(());
        }
        if is_private(address) {
            self.write_private(bus, address, size, value)?;
            self.cycle += 1;
            return Ok(());
        }
        if let Some((word, place)) = bit_band(address) {
            // The bus is held while the word is read, changed and written.
            let old = self.load_data(bus, word, Size::Word)?;
            return self.store_data(bus, word, Size::Word, old & !(1 << place) | (value & 1) << place);
        }
        bus.write(address, size, value, self.cycle).map_err(|fault| FaultCause::Bus { address: fault.address })?;
        self.cycle += u64::from(bus.wait_cycles()) + 1;
        Ok(())
    }

    /// Whether an unaligned access is possible: not with CCR.UNALIGN_TRP, nor to private registers (§A3.2.1).
    fn check_unaligned(&self, address: u32) -> Result<(), FaultCause> {
        if self.variant.registers.traps_unaligned() || is_private(address) {
            return Err(FaultCause::Unaligned { address });
        }
        Ok(())
    }
}

#[inline(always)]
fn is_alias(address: u32) -> bool {
    matches!(address >> 25, 0x11 | 0x21)
}

/// The bits of a value of this size.
pub(super) fn mask(size: Size) -> u32 {
    match size {
        Size::Byte => 0xff,
        Size::Half => 0xffff,
        Size::Word => u32::MAX,
    }
}

/// The aligned accesses of which an unaligned one is made: bytes at odd addresses, else half-words.
fn parts(address: u32, size: Size) -> impl Iterator<Item = (u32, Size)> {
    let mut at = 0;
    std::iter::from_fn(move || {
        let left = size.bytes() - at;
        if left == 0 {
            return None;
        }
        let part = address.wrapping_add(at);
        let bytes = if part & 1 != 0 || left == 1 { Size::Byte } else { Size::Half };
        at += bytes.bytes();
        Some((part, bytes))
    })
}
