//! Steps: from records to edges on the pins.
//!
//! # Words
//! - A **batch** is steps that are planned and expanded together. An **event** is anything else that a motor does: a single step, a turn of DIR,
//!   or a **filler**, which does nothing but keep the compare register moving.
//! - A **group** is one entry of a ring: what an interrupt toggles at a tick, and at the end of a pulse.
//! - The **limit** is the tick up to which motors may be planned: 3 ms from now, or less. A motor's **horizon** is the first tick that it has not planned.
//!
//! # What is here, top down
//! - [`stepper`]: motors, rings, and which way a ring is filled; [`refill`]: the interrupt that fills them
//! - [`motor`]: one motor, its queue and its plans; [`times`]: the times of a configuration
//! - [`load`]: records of the queue → registers; [`plan`]: what a motor does next; [`expand`]: registers → ticks
//! - [`brake`]: what a motor does at the end of the lease
//! - [`one_motor`]: a ring of one motor; [`merge`]: two to four motors in one ring; [`shield_b`]: ring B of the shield; [`shared_dir`]: motors that
//!   share DIR lines
//! - [`put`]: one event into a ring
//! - [`ring`]: groups, and the interrupts that play them
//! - [`plan_frames`]: frames that change plans: Switch, Extend, Trim, Brake
//! - [`switch`]: from one epoch to another
//! - [`pins`]: which pins can be used together, and how
//! - [`register`]: addresses, for assembly
//!
//! The order of the modules below is that of the functions in the image.

mod shield_b;

pub(crate) mod brake;
pub(crate) mod expand;

mod one_motor;

mod load;
pub(crate) mod merge;
pub(crate) mod motor;

pub(crate) mod plan_frames;

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
