//! The motion in the integers of an 8-bit processor, the Uno's ATmega328P: no value is wider than 40 bits.
//!
//! # What is here
//! - [`Registers`]: the live recurrence with 16 fraction bits, laid out for a step engine in assembly
//! - [`verbs`]: orders to motors, step for step what [`crate::verbs`] makes of them
//!
//! # What fits
//! Intervals are 24.16 ticks, unsigned: 0 < interval < 2^24 ticks at every step, or a dwell goes before. add and add2
//! have 32 bits, counts 16. The sender keeps to it. Registers wrap where it does not, so that the steps
//! come at wrong ticks, but never closer than the gap.
//!
//! # What is not
//! - Pins, timers, the assembly that reads packed items: the firmware's.
//! - The general parts of core: these know nothing of this module.

mod registers;
pub mod verbs;

pub use registers::Registers;
