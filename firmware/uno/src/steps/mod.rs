//! Steps: from events to edges on the pins.
//!
//! # What is here, top down
//! - [`stepper`]: the slow engine, which does everything, and says when the fast one may run
//! - [`merge`]: two to four motors in one ring, and [`expand`]: registers → ticks; both the fast engine, in assembly
//! - [`ring`]: groups of edges and the interrupts that play them
//! - [`pins`]: which pins there are, and which of them one stepgen can serve together
//! - [`register`]: addresses, for assembly

pub(crate) mod expand;
mod fill;
mod load;
pub(crate) mod merge;
pub(crate) mod motor;
pub(crate) mod pins;
mod plan;
pub(crate) mod register;
pub(crate) mod ring;
pub(crate) mod stepper;
pub(crate) mod task;
mod times;
