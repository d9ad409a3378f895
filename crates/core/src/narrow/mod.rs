//! The stepgen for an 8-bit chip: the ticks of [`Channel<16>`](crate::Channel), with nothing wider than 32 bits.
//!
//! # What is here, top down
//! - [`Motor`]: one motor: bytes → events, like [`Channel<16>`](crate::Channel) behind
//!   [`Packing`](crate::packing::Packing), event for event
//! - [`Bytes`]: its packed items, in its part of the [`Pool`] that all motors share
//! - [`verbs`]: motors told directly, step for step what [`crate::verbs`] has them do
//! - [`Registers`]: the live recurrence; laid out for a step engine in assembly
//!
//! # What fits
//! Intervals are 24.16 ticks, unsigned: 0 < interval < 2^24 ticks at every step, or a dwell goes before. add and add2
//! have 32 bits, counts 16. The sender keeps to it. Registers wrap where it does not, so that the steps
//! come at wrong ticks, but never closer than the gap.
//!
//! # What is not
//! Pins, timers, the fast step engine: the firmware's.

mod bytes;
mod motor;
mod registers;
mod unpack;
pub mod verbs;

pub use bytes::{Bytes, EPOCHS, Pool, PushRefused};
pub use motor::{BLIND_STEPS, Fault, Motor, Reason, SLOWEST_BLIND, SWITCHES, Settings};
pub use registers::Registers;
