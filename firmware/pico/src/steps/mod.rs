//! Steps: from packed bytes to edges on the pins.
//!
//! # What is here, top down
//! - [`stepper`]: all motors: writes their words, starts and stops them together
//! - [`pins`]: which pins a configuration takes, and whether PIO can drive them
//! - [`expand`]: the steps of a run, one word each, in assembly
//! - [`feed`]: a DMA channel for each motor, from its words to its state machine
//! - [`pio`]: the state machines and their programs
//!
//! Motor m has state machine m mod 4 of block m / 4 and DMA channel m: with up to four motors the second block is free.

pub(crate) mod expand;
pub(crate) mod feed;
pub(crate) mod pins;
pub(crate) mod pio;
pub(crate) mod stepper;

pub(crate) use pulsetrain_core::boards::pico::MAX_MOTORS as MOTORS;

/// Words of a motor's ring: 8 KiB, and aligned to that, as the DMA wraps addresses at a power of two. 2.4 ms at 850 000 steps/s.
pub(crate) const RING_WORDS: usize = 2048;
