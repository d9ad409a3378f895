//! Words for the RP2040's PIO, whose state machines make a motor's edges. A word is a wait, and the levels of the lines after it.
//!
//! # What is here, top down
//! - [`WordWriter`]: channel and output of one motor → words, up to a tick
//! - [`expand()`]: a run's steps, one word each: the loop that has to be fast
//! - [`Tape`]: the ring in which words wait, with the motor's position at each
//!
//! A state machine takes one word after the other. The ticks of all edges follow from the tick at which the first word begins, and from
//! how long each word lasts. So it must never run out of words. A word is
//!
//! | step/dir: bits | | coils: bits | |
//! |---|---|---|---|
//! | 0–24 | wait x | 0–24 | wait x |
//! | 25–26 | the lines then | 25–31 | the lines then, of which four are the coils |
//! | 27–28 | the lines a pulse later | | |
//!
//! and its lines change x + [`WordWriter::overhead`] ticks after those of the word before.
//!
//! # What is not
//! - Hardware registers, which are the firmware's. Its DMA takes words from a tape; its clock tells how far it is.
//! - The general parts of core, which do not know words.

mod expand;
mod tape;
mod writer;

pub use expand::{Expand, MAX_UNCHECKED, Stretch, Unchecked, expand, unchecked_steps};
pub use tape::{Run, Tape};
pub use writer::{Filled, WordWriter};

/// The longest wait of one word, ticks; also the mask of its bits.
pub const LONGEST_WAIT: u32 = (1 << WAIT_BITS) - 1;

/// Bits of the wait. It lasts up to 268 ms at 125 MHz. The other 7 bits of a word are for lines, so that the four pins of coils may lie within
/// seven.
const WAIT_BITS: u32 = 25;

/// The levels of the lines right after the wait of `word`.
#[must_use]
pub const fn lines(word: u32) -> u32 {
    word >> WAIT_BITS
}

/// How much longer a word of coils lasts than its wait, ticks: `out`, the loop's last round, `out`.
pub const COILS_OVERHEAD: u32 = 3;

/// How much longer a word of step/dir lasts than its wait and its pulse, ticks: `out`, the loop's last round, `out`.
pub const STEP_DIR_OVERHEAD: u32 = 3;

/// The shortest pulse, ticks: `out`, `mov`, one round of a loop.
pub const SHORTEST_PULSE: u32 = 3;
