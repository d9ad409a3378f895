//! Faults of a processor: their causes, and where one happened (ARMv6-M ARM DDI 0419E §B1.5.9; ARMv7-M ARM DDI 0403E
//! §B1.5.14).

use thiserror::Error;

/// Why the processor took a fault exception, or locked up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Error)]
pub enum FaultCause {
    /// No instruction of the processor.
    #[error("no such instruction")]
    Undefined,
    /// An instruction for a coprocessor, and there is none (Cortex-M3).
    #[error("instruction for a coprocessor that is not there")]
    NoCoprocessor,
    /// A division by 0, with CCR.DIV_0_TRP set (Cortex-M3).
    #[error("division by 0")]
    DivideByZero,
    /// The program executed `bkpt`, and no debugger is connected.
    #[error("breakpoint without a debugger")]
    Breakpoint,
    /// The program executed `svc` where its handler cannot be entered: PRIMASK is set, or SVCall's priority is too low.
    #[error("svc at a priority that does not let it in")]
    Supervisor,
    /// A branch to an even address, which would select a state that the processor does not have.
    #[error("branch to an even address")]
    NotThumb,
    /// An access to an address that is not a multiple of its size, where that is not allowed.
    #[error("unaligned access to {address:#010x}")]
    Unaligned {
        /// The address of the access.
        address: u32,
    },
    /// The bus refused a load or a store.
    #[error("access to {address:#010x}, where nothing answers")]
    Bus {
        /// The address of the access.
        address: u32,
    },
    /// The bus refused the fetch of an instruction.
    #[error("instruction at {address:#010x}, where nothing answers")]
    Fetch {
        /// The address of the instruction.
        address: u32,
    },
    /// An exception's vector could not be read.
    #[error("vector at {address:#010x}, where nothing answers")]
    Vector {
        /// The address of the vector.
        address: u32,
    },
    /// The registers could not be saved or restored at an exception.
    #[error("exception frame at {address:#010x}, where nothing answers")]
    Frame {
        /// The address of the register that failed.
        address: u32,
    },
    /// A handler returned with a value that is no valid EXC_RETURN.
    #[error("exception return with {value:#010x}")]
    Return {
        /// The value.
        value: u32,
    },
}

/// A fault of the processor, and where it happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Fault {
    /// The cause.
    pub cause: FaultCause,
    /// The address of the instruction, or of the one that would have been executed next.
    pub pc: u32,
    /// The cycle in which it happened.
    pub cycle: u64,
}
