//! Faults of the processor: their causes, and where one happened (ARMv6-M ARM DDI 0419E §B1.5.9).

use thiserror::Error;

/// Why the processor took a HardFault, or locked up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Error)]
pub enum FaultCause {
    /// What was fetched is no instruction of ARMv6-M.
    #[error("no such instruction")]
    Undefined,
    /// `bkpt`, and no debugger is there.
    #[error("breakpoint without a debugger")]
    Breakpoint,
    /// `svc` where its handler cannot be entered: PRIMASK is set, or the priority not sufficient.
    #[error("svc at a priority that does not let it in")]
    Supervisor,
    /// A branch to an even address: a state that the processor does not have.
    #[error("branch to an even address")]
    NotThumb,
    /// An address that is no multiple of the access's size.
    #[error("unaligned access to {address:#010x}")]
    Unaligned {
        /// Where.
        address: u32,
    },
    /// The bus refused a load or a store.
    #[error("access to {address:#010x}, where nothing answers")]
    Bus {
        /// Where.
        address: u32,
    },
    /// The bus refused an instruction.
    #[error("instruction at {address:#010x}, where nothing answers")]
    Fetch {
        /// Where.
        address: u32,
    },
    /// The vector could not be read.
    #[error("vector at {address:#010x}, where nothing answers")]
    Vector {
        /// Where.
        address: u32,
    },
    /// An exception's registers could not be saved or restored.
    #[error("exception frame at {address:#010x}, where nothing answers")]
    Frame {
        /// Where.
        address: u32,
    },
    /// No exception can return with this value.
    #[error("exception return with {value:#010x}")]
    Return {
        /// EXC_RETURN.
        value: u32,
    },
}

/// A fault, and where it happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Fault {
    /// Why.
    pub cause: FaultCause,
    /// The instruction, or where the processor would have gone on.
    pub pc: u32,
    /// In which cycle.
    pub cycle: u64,
}
