//! Times that no document gives: they are a choice of whoever makes a chip, so that a program can be measured with the
//! likely and with the pessimistic ones.

/// What accesses and branches of a [`Sam3x8e`](crate::Sam3x8e) take. The datasheet has none of these numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sam3x8eTiming {
    /// Cycles that a store to a peripheral waits at the bridge to it. The store buffer hides them unless another access
    /// follows.
    pub store_waits: u32,
    /// Cycles that a load from a peripheral waits.
    pub load_waits: u32,
    /// Cycles in which the processor fills its pipeline after a branch (TRM DDI 0337: 1 to 3).
    pub refill: u32,
    /// Cycles of the return from an exception.
    pub return_cycles: u32,
    /// Whether flash reads the next line while the processor executes the present one, as the datasheet's "sequential
    /// code read optimization" says (§18); else each new line costs all wait states.
    pub reads_ahead: bool,
}

impl Sam3x8eTiming {
    /// The likely numbers.
    pub const LIKELY: Sam3x8eTiming =
        Sam3x8eTiming { store_waits: 1, load_waits: 2, refill: 2, return_cycles: 10, reads_ahead: true };
    /// The largest numbers that are plausible: what a program keeps to with these, it keeps to.
    pub const PESSIMISTIC: Sam3x8eTiming =
        Sam3x8eTiming { store_waits: 2, load_waits: 3, refill: 3, return_cycles: 12, reads_ahead: false };
}

impl Default for Sam3x8eTiming {
    fn default() -> Sam3x8eTiming {
        Sam3x8eTiming::LIKELY
    }
}
