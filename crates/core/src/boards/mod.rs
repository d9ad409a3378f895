//! What the firmware of each board and the host that plans for it must agree on: one file for each board.
//!
//! Firmware computes with these numbers, and the host's limits follow from them (`pulsetrain_motion::boards`). So they are written once.
//! Which measurement shows that a number is right is said where the firmware uses it.

pub mod pico;
pub mod uno;
