//! Words for the RP2040's PIO, whose state machines make a motor's edges: each word is a wait, and what the lines do after it.
//!
//! # What is here, top down
//! - [`Words`]: channel and output of one motor → words, up to a tick
//! - [`expand()`]: a run's steps, one word each: the loop that has to be fast
//! - [`Tape`]: the ring that words wait in, and what was counted where in it
//!
//! A state machine takes one word after the other, and each lasts as long as it says: the ticks of all edges follow from
//! the tick at which the first word begins. It must never run out of words. A word is
//!
//! | step/dir: bits | | coils: bits | |
//! |---|---|---|---|
//! | 0–24 | wait x | 0–24 | wait x |
//! | 25–26 | the lines then | 25–31 | the lines then, of which four are the coils |
//! | 27–28 | the lines a pulse later | | |
//!
//! and its lines change x + [`Words::overhead`] ticks after those of the word before.
//!
//! # What is not
//! - Hardware registers: a board's own. Its DMA takes words from a tape, its clock says how far.
//! - The general parts of core: these know nothing of words.

mod expand;
mod tape;
mod writer;

pub use expand::{Expand, MOST_UNCHECKED, Stretch, Unchecked, expand, unchecked_steps};
pub use tape::{Run, Tape};
pub use writer::{Filled, Words};

/// The longest wait of one word, and the bits that it is in.
pub const LONGEST_WAIT: u32 = (1 << WAIT_BITS) - 1;

/// Bits of the wait: it lasts 268 ms at 125 MHz, and the lines of coils may lie seven apart.
const WAIT_BITS: u32 = 25;

/// The lines as a word has them first.
#[must_use]
pub const fn lines(word: u32) -> u32 {
    word >> WAIT_BITS
}

/// What a word of coils lasts beyond its wait, ticks: `out`, the loop's last round, `out`.
pub const COILS_OVERHEAD: u32 = 3;

/// What a word of step/dir lasts beyond wait and pulse, ticks: `out`, the loop's last round, `out`.
pub const STEP_DIR_OVERHEAD: u32 = 3;

/// The shortest pulse, ticks: `out`, `mov`, one round of a loop.
pub const SHORTEST_PULSE: u32 = 3;
