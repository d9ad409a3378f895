//! The operations of ARMv7-M (ARM DDI 0403E, chapter A7). Instructions of 16 and of 32 bits that do the same are one
//! operation with other operands.

use crate::arm::Size;

/// When an operation sets the flags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Flags {
    Never,
    Always,
    /// Most instructions of 16 bits: not within an IT block.
    OutsideIt,
}

/// Data processing with two operands. `Mov` and `Mvn` use the second alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Alu {
    And,
    Bic,
    Orr,
    Orn,
    Eor,
    Add,
    Adc,
    Sbc,
    Sub,
    Rsb,
    Mov,
    Mvn,
}

/// Shifts and rotations. A rotation by 0 in an operand is RRX.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shift {
    Left,
    Right,
    RightSigned,
    Rotate,
    /// By one place through C.
    RotateExtended,
}

/// What happens to the base register of a load or store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Index {
    /// The offset is added for the access alone.
    Offset,
    /// The base register gets the address of the access.
    Before,
    /// The access is at the base register's address, which then gets the sum.
    After,
}

/// What is rearranged within a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reversal {
    Bytes,
    BytesOfHalves,
    BytesOfSignedHalf,
    Bits,
    /// Not a reversal: the number of leading zeros.
    LeadingZeros,
}

/// A register number that stands for "none".
pub(super) const NONE: u8 = 15;

/// An operation. The fields are register numbers (`d`, `n`, `m`, `t`, `a`), and offsets in bytes. A destination of 15 in
/// data processing is none: the operation sets flags alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Operation {
    Undefined,
    /// An instruction for a coprocessor; there is none.
    Coprocessor,
    Nop,
    /// DMB and DSB. They wait for the stores that are under way.
    Barrier,
    /// ISB, which also fills the pipeline again.
    InstructionBarrier,
    /// `carry` is what the shifter gives out for C, if it gives anything out.
    Immediate {
        alu: Alu,
        flags: Flags,
        d: u8,
        n: u8,
        carry: Option<bool>,
        value: u32,
    },
    Register {
        alu: Alu,
        flags: Flags,
        d: u8,
        n: u8,
        m: u8,
        shift: Shift,
        places: u8,
    },
    /// `lsl`, `lsr`, `asr`, `ror` by a register.
    ShiftBy {
        shift: Shift,
        flags: Flags,
        d: u8,
        n: u8,
        m: u8,
    },
    /// Any two registers; the destination may be the program counter.
    MovAny {
        d: u8,
        m: u8,
    },
    AddAny {
        d: u8,
        m: u8,
    },
    /// Adds to the program counter, aligned to 4 bytes.
    Adr {
        d: u8,
        offset: i32,
    },
    /// `movt`.
    MovTop {
        d: u8,
        value: u16,
    },
    /// `bits` is the width of the result.
    Saturate {
        signed: bool,
        d: u8,
        n: u8,
        bits: u8,
        shift: Shift,
        places: u8,
    },
    Extract {
        signed: bool,
        d: u8,
        n: u8,
        low: u8,
        width: u8,
    },
    /// `bfi`; of 15 `bfc`.
    Insert {
        d: u8,
        n: u8,
        low: u8,
        width: u8,
    },
    Extend {
        signed: bool,
        size: Size,
        d: u8,
        m: u8,
        rotation: u8,
    },
    Reverse {
        kind: Reversal,
        d: u8,
        m: u8,
    },
    Multiply {
        flags: Flags,
        d: u8,
        n: u8,
        m: u8,
    },
    /// `mla`; `mls` if `subtract`.
    MultiplyAdd {
        subtract: bool,
        d: u8,
        n: u8,
        m: u8,
        a: u8,
    },
    MultiplyLong {
        signed: bool,
        accumulate: bool,
        low: u8,
        high: u8,
        n: u8,
        m: u8,
    },
    Divide {
        signed: bool,
        d: u8,
        n: u8,
        m: u8,
    },
    Load {
        size: Size,
        signed: bool,
        t: u8,
        n: u8,
        index: Index,
        offset: i16,
    },
    LoadIndexed {
        size: Size,
        signed: bool,
        t: u8,
        n: u8,
        m: u8,
        places: u8,
    },
    LoadLiteral {
        size: Size,
        signed: bool,
        t: u8,
        offset: i16,
    },
    Store {
        size: Size,
        t: u8,
        n: u8,
        index: Index,
        offset: i16,
    },
    StoreIndexed {
        size: Size,
        t: u8,
        n: u8,
        m: u8,
        places: u8,
    },
    /// Of 15 from the program counter.
    LoadDouble {
        t: u8,
        t2: u8,
        n: u8,
        index: Index,
        offset: i16,
    },
    StoreDouble {
        t: u8,
        t2: u8,
        n: u8,
        index: Index,
        offset: i16,
    },
    LoadMultiple {
        n: u8,
        list: u16,
        before: bool,
        write_back: bool,
    },
    StoreMultiple {
        n: u8,
        list: u16,
        before: bool,
        write_back: bool,
    },
    LoadExclusive {
        size: Size,
        t: u8,
        n: u8,
        offset: i16,
    },
    StoreExclusive {
        size: Size,
        d: u8,
        t: u8,
        n: u8,
        offset: i16,
    },
    ClearExclusive,
    /// `tbb`, `tbh`.
    TableBranch {
        n: u8,
        m: u8,
        half: bool,
    },
    Branch {
        offset: i32,
    },
    BranchIf {
        condition: u8,
        offset: i32,
    },
    BranchLink {
        offset: i32,
    },
    BranchExchange {
        m: u8,
    },
    BranchLinkExchange {
        m: u8,
    },
    CompareBranch {
        n: u8,
        nonzero: bool,
        offset: u8,
    },
    /// Begins an IT block with this ITSTATE.
    It {
        state: u8,
    },
    /// `cps`.
    ChangeMasks {
        set: bool,
        primask: bool,
        faultmask: bool,
    },
    ReadSpecial {
        d: u8,
        special: u8,
    },
    WriteSpecial {
        n: u8,
        special: u8,
    },
    SupervisorCall,
    Breakpoint,
    SendEvent,
    WaitForEvent,
    WaitForInterrupt,
}

const _: () = assert!(size_of::<Operation>() <= 12);
