//! Steps: from packed bytes to edges on the pins.
//!
//! # What is here, top down
//! - [`stepper`]: all motors: filling their tapes, starting and stopping together
//! - [`pins`]: which pins a configuration takes, and whether PIO can have them so
//! - [`expand`]: a run's steps, one word each, in assembly
//! - [`feed`]: from a tape to a state machine: a DMA channel for each motor
//! - [`pio`]: the state machines and their programs
//!
//! Motor m has state machine m mod 4 of block m / 4 and DMA channel m: up to four motors leave the second block alone.

pub(crate) mod expand;
pub(crate) mod feed;
pub(crate) mod pins;
pub(crate) mod pio;
pub(crate) mod stepper;

/// Motors at most: one for each state machine.
pub(crate) const MOTORS: usize = 8;

/// Words of a motor's ring: 8 KiB, at a multiple of that.
pub(crate) const RING_WORDS: usize = 2048;
