//! Steps: from events to edges on the pins.
//!
//! # What is here, top down
//! - [`stepper`]: motors, rings, and who fills what; [`task`]: when
//! - [`motor`]: one motor, its queue and what it has promised; [`times`]: what a configuration asks of all
//! - [`load`]: records of the queue → registers; [`plan`]: what a motor does next; [`expand`]: registers → ticks
//! - [`brake`]: what a motor does whose lease is over
//! - [`fill`]: a ring of one motor; [`merge`]: two to four motors in one ring; `beside`: one beside a merge; [`shared`]: motors
//!   that share DIR lines
//! - [`put`]: one thing into a ring
//! - [`ring`]: groups of edges and the interrupts that play them
//! - [`orders`]: what a host says of plans beside their data
//! - [`switch`]: from one epoch to another
//! - [`pins`]: which pins there are, and which of them one stepgen can set_step together
//! - [`register`]: addresses, for assembly

mod shield_b;

pub(crate) mod brake;
pub(crate) mod expand;

mod one_motor;

mod load;
pub(crate) mod merge;
pub(crate) mod motor;
pub(crate) mod orders;
pub(crate) mod pins;
pub(crate) mod plan;
mod put;
pub(crate) mod register;
pub(crate) mod ring;
mod shared_dir;
pub(crate) mod stepper;
mod switch;

pub(crate) mod refill;

pub(crate) mod times;
