//! What the user says: motion files, quantities with units, laws, drivers, motors, boards' limits.
//!
//! # What is here
//! - [`mod@file`]: motion files (TOML) with errors that point at the place; [`template`]: one to begin with
//! - [`program`]: what a file comes to, in steps, seconds and nanoseconds; [`Grid`]: θ to step times
//! - [`drivers`], [`boards`]: the tables of drivers' needs and boards' limits; [`electrical`]: what a winding allows;
//!   [`full_steps`]: what a motor makes in a revolution
//! - [`pins`]: which pins of an Uno work together
//! - [`columns`]: CSV files, with columns by their names and units
//! - [`law`]: θ(t) as a stream of analytic pieces; [`machine`]: several motors that draw one figure
//! - [`human`]: numbers as people read them
//! - [`quantity`]: numbers with units; [`time`]: law time, exact
//!
//! # What is not
//! Step times and segments (`pulsetrain-plan`), edges (`pulsetrain-trace`, `pulsetrain-board`).
#![forbid(unsafe_code)]

pub mod boards;
pub mod columns;
pub mod drivers;
pub mod electrical;
pub mod file;
pub mod full_steps;
pub mod grid;
pub mod human;
pub mod law;
pub mod machine;
pub mod pins;
pub mod program;
pub mod quantity;
pub mod template;
pub mod time;

pub use grid::Grid;
pub use law::{Law, LawError};
pub use time::Time;
