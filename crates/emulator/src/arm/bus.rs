//! What the processor sees of the chip around it.

use thiserror::Error;

/// Width of an access.
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
    pub const fn bytes(self) -> u32 {
        match self {
            Size::Byte => 1,
            Size::Half => 2,
            Size::Word => 4,
        }
    }
}

/// Nobody answers at an address, or what lies there refuses the access: the processor takes a HardFault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Error)]
#[error("nothing answers at address {address:#010x}")]
pub struct BusFault {
    /// Where.
    pub address: u32,
}

/// The memory and the peripherals of a chip, as one of its processors sees them.
///
/// The processor answers 0xe000_0000 to 0xe00f_ffff (SysTick, NVIC, system control) itself; such accesses never come
/// here, nor do unaligned ones, which fault before.
///
/// # Cycles
/// `cycle` is the first cycle in which the data may pass: a read sees what is there in it, a write takes effect at its
/// end, so that `cycle + 1` is the first with the new state. An access over the system bus has its address in the cycle
/// before. If the bus makes the processor wait, it does the access that much later and says so in
/// [`wait_cycles`](Bus::wait_cycles).
pub trait Bus {
    /// Reads; the value is in the lowest bits, the rest is 0.
    ///
    /// # Errors
    /// [`BusFault`]: the instruction does not happen, and the processor takes a HardFault.
    fn read(&mut self, address: u32, size: Size, cycle: u64) -> Result<u32, BusFault>;

    /// Writes the lowest bits of `value`; the rest of it is 0.
    ///
    /// # Errors
    /// As for [`read`](Bus::read).
    fn write(&mut self, address: u32, size: Size, value: u32, cycle: u64) -> Result<(), BusFault>;

    /// The half-word of an instruction, at an even address, that is executed in `cycle`. It is asked for as often as
    /// the instruction is executed: the processor keeps nothing, so that code may change.
    ///
    /// # Errors
    /// As for [`read`](Bus::read).
    fn fetch(&mut self, address: u32, cycle: u64) -> Result<u16, BusFault>;

    /// Cycles that the last access, or fetch, took beyond one without waiting. Asked for once after each.
    fn wait_cycles(&mut self) -> u32 {
        0
    }

    /// Whether the address lies on the single-cycle I/O port (TRM DDI 0484C §1.3), if the chip has one: loads and
    /// stores there take one cycle and not two.
    fn is_io_port(&self, address: u32) -> bool {
        let _ = address;
        false
    }

    /// The processor has executed `sev`: other processors of the chip get it by [`Cpu::event`](super::Cpu::event).
    fn send_event(&mut self) {}

    /// The program has asked for a reset of the chip (AIRCR.SYSRESETREQ).
    fn request_reset(&mut self) {}
}
