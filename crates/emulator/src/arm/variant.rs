//! What the processors of this module do not share: the trait that each of them implements.

use super::bus::{Bus, Size};
use super::cpu::Core;
use super::fault::FaultCause;

/// A processor's own instructions, registers and times. What is common to all is in [`Core`].
///
/// It is implemented by [`M0Plus`](super::M0Plus) and [`M3`](super::M3), and cannot be implemented elsewhere.
pub trait Variant: Clone + private::Sealed {
    /// The implemented bits of a priority.
    #[doc(hidden)]
    const PRIORITY_BITS: u8;
    /// The implemented bits of VTOR.
    #[doc(hidden)]
    const VECTOR_TABLE_BITS: u32;
    /// The bits of IPSR.
    #[doc(hidden)]
    const EXCEPTION_BITS: u32;
    /// Cycles of the two parts of an exception's entry: saving the registers, and what then remains to the handler's
    /// first instruction.
    #[doc(hidden)]
    const STACKING: u64;
    #[doc(hidden)]
    const VECTOR: u64;
    /// Cycles from a handler's end to the first instruction of the next, if registers are not restored between them.
    #[doc(hidden)]
    const TAIL_CHAIN: u64;
    /// Whether reading the vector overlaps with saving the registers.
    #[doc(hidden)]
    const READS_VECTOR_EARLY: bool;

    /// Executes the instruction at the program counter.
    #[doc(hidden)]
    fn instruction(core: &mut Core<Self>, bus: &mut impl Bus);

    /// Sets what a reset sets.
    #[doc(hidden)]
    fn reset(core: &mut Core<Self>) {
        let _ = core;
    }

    /// Cycles of restoring the registers when a handler ends. If it returns `Some`, an exception that becomes due
    /// meanwhile is entered without restoring them.
    #[doc(hidden)]
    fn interruptible_return(core: &Core<Self>) -> Option<u64> {
        let _ = core;
        None
    }

    /// Cycles of restoring the registers, where nothing can interrupt that.
    #[doc(hidden)]
    const UNSTACKING: u64;

    /// Bits of XPSR besides N, Z, C, V, T and the exception number.
    #[doc(hidden)]
    fn more_xpsr(core: &Core<Self>) -> u32 {
        let _ = core;
        0
    }

    /// Sets the bits of [`more_xpsr`](Variant::more_xpsr).
    #[doc(hidden)]
    fn set_more_xpsr(core: &mut Core<Self>, xpsr: u32) {
        let _ = (core, xpsr);
    }

    /// Whether the stack pointer is aligned to 8 bytes when registers are saved.
    #[doc(hidden)]
    fn aligns_stack(core: &Core<Self>) -> bool {
        let _ = core;
        true
    }

    /// Waits until the stores that are under way have ended.
    #[doc(hidden)]
    fn settle(core: &mut Core<Self>) {
        let _ = core;
    }

    /// A handler begins.
    #[doc(hidden)]
    fn enter_handler(core: &mut Core<Self>) {
        let _ = core;
    }

    /// Whether EXC_RETURN may select thread mode while other handlers are active (CCR.NONBASETHRDENA).
    #[doc(hidden)]
    fn may_return_early(core: &Core<Self>) -> bool {
        let _ = core;
        false
    }

    /// Notes the cause of a fault in the processor's registers. Returns the exception to be taken, without regard to
    /// whether it can be entered.
    #[doc(hidden)]
    fn fault_exception(core: &mut Core<Self>, cause: FaultCause) -> u32;

    /// Whether the program may access a private register with this size.
    #[doc(hidden)]
    fn may_access(core: &Core<Self>, address: u32, size: Size) -> bool;

    /// The word that a narrow write to a private register makes of it.
    #[doc(hidden)]
    fn widened(core: &mut Core<Self>, address: u32, size: Size, value: u32) -> u32 {
        let _ = (core, address, size);
        value
    }

    /// Reads a private register that only this processor has, at a multiple of 4.
    #[doc(hidden)]
    fn read_own_register(core: &mut Core<Self>, address: u32) -> Option<u32> {
        let _ = (core, address);
        None
    }

    /// Writes such a register. Returns whether there is one.
    #[doc(hidden)]
    fn write_own_register(core: &mut Core<Self>, bus: &mut impl Bus, address: u32, value: u32) -> bool {
        let _ = (core, bus, address, value);
        false
    }
}

pub(super) mod private {
    /// Keeps [`Variant`](super::Variant) to this module.
    pub trait Sealed {}
}
