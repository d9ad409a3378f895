//! The interface between the processor and the chip around it (AHB-Lite and the I/O port; TRM DDI 0484C §1.3). The chip
//! implements it.

use thiserror::Error;

/// Width of one access.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Size {
    /// 8 bits.
    Byte,
    /// 16 bits; the address is a multiple of 2.
    Half,
    /// 32 bits; the address is a multiple of 4.
    Word,
}

impl Size {
    /// 1, 2 or 4.
    #[inline]
    pub const fn bytes(self) -> u32 {
        match self {
            Size::Byte => 1,
            Size::Half => 2,
            Size::Word => 4,
        }
    }
}

/// No memory or register is at the address, or it refuses the access. The processor takes a HardFault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Error)]
#[error("nothing answers at address {address:#010x}")]
pub struct BusFault {
    /// The address of the access.
    pub address: u32,
}

/// The memory and the peripherals of a chip, as one of its processors sees them.
///
/// The processor handles the addresses 0xe000_0000 to 0xe00f_ffff (SysTick, NVIC, system control) itself, so that such
/// accesses do not come here. Unaligned accesses do not either: they fault before.
///
/// # Cycles
/// `cycle` is the first cycle in which the data may pass. A read returns the state in that cycle. A write takes effect
/// at its end, so that `cycle + 1` is the first cycle with the new state. An access over the system bus has its address
/// in the cycle before. If the bus makes the processor wait, it makes the access that much later, and returns the
/// number of cycles from [`wait_cycles`](Bus::wait_cycles).
pub trait Bus {
    /// Reads. The value is in the lowest bits of the result; the other bits are 0.
    ///
    /// # Errors
    /// [`BusFault`]: the instruction has no effect, and the processor takes a HardFault.
    fn read(&mut self, address: u32, size: Size, cycle: u64) -> Result<u32, BusFault>;

    /// Writes the lowest bits of `value`; its other bits are 0.
    ///
    /// # Errors
    /// As for [`read`](Bus::read).
    fn write(&mut self, address: u32, size: Size, value: u32, cycle: u64) -> Result<(), BusFault>;

    /// Reads the half-word of an instruction, at an even address, that is executed in `cycle`. The processor keeps no
    /// copy of it and calls this each time that the instruction is executed, so that code may change.
    ///
    /// # Errors
    /// As for [`read`](Bus::read).
    fn fetch(&mut self, address: u32, cycle: u64) -> Result<u16, BusFault>;

    /// Reads an exception's vector. A Cortex-M3 does that over the bus for instructions (TRM DDI 0337, "ICode bus").
    ///
    /// # Errors
    /// As for [`read`](Bus::read).
    fn read_vector(&mut self, address: u32, cycle: u64) -> Result<u32, BusFault> {
        self.read(address, Size::Word, cycle)
    }

    /// Wait cycles of the last access or fetch. The processor calls this once after each of them.
    fn wait_cycles(&mut self) -> u32 {
        0
    }

    /// Whether the address belongs to the single-cycle I/O port (TRM DDI 0484C §1.3), if the chip has one. Loads and
    /// stores there take one cycle instead of two.
    fn is_io_port(&self, address: u32) -> bool {
        let _ = address;
        false
    }

    /// The processor has executed `sev`. The chip passes the event to its other processors with
    /// [`Cpu::event`](super::Cpu::event).
    fn send_event(&mut self) {}

    /// The program has requested a reset of the chip (AIRCR.SYSRESETREQ).
    fn request_reset(&mut self) {}
}
