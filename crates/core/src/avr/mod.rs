//! What boards have that are short of memory and of bits: nothing wider than 32 bits.
//!
//! # What is here
//! - [`Registers`]: the live recurrence with 16 fraction bits, laid out for a step engine in assembly
//! - [`verbs`]: motors told directly, step for step what [`crate::verbs`] has them do
//!
//! # What fits
//! Intervals are 24.16 ticks, unsigned: 0 < interval < 2^24 ticks at every step, or a dwell goes before. add and add2
//! have 32 bits, counts 16. The sender keeps to it. Registers wrap where it does not, so that the steps
//! come at wrong ticks, but never closer than the gap.
//!
//! # What is not
//! Pins, timers, the step engine that reads packed items: the firmware's.

mod registers;
pub mod verbs;

pub use registers::Registers;
