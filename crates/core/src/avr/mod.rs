//! Motions in the integers of an 8-bit processor, the Uno's ATmega328P. No value is wider than 40 bits.
//!
//! # What is here
//! - [`Registers`]: the recurrence with 16 fraction bits, laid out for a step engine in assembly
//! - [`verbs`]: orders to motors, which make the same steps as those of [`crate::verbs`]
//!
//! # Ranges
//! An interval has 24 bits of ticks and 16 of fraction, and is positive. For a longer one the sender puts a wait before the step. add and
//! add2 have 32 bits, counts 16. The sender keeps to these ranges. If it does not, registers wrap, and steps come at wrong ticks,
//! though never closer than the shortest interval.
//!
//! # What is not
//! - Pins, timers, and the assembly that reads packed items, which are the firmware's.
//! - The general parts of core, which do not use this module.

mod registers;
pub mod verbs;

pub use registers::Registers;
