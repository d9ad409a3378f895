//! What the user says: motion files, quantities with units, laws, drivers, motors, boards' limits.
//!
//! # What is here
//! - [`time`]: law time, exact
//! - [`law`]: θ(t) as a stream of analytic pieces
//!
//! # What is not
//! Step times and segments (`pulsetrain-plan`), edges (`pulsetrain-trace`, `pulsetrain-board`).
#![forbid(unsafe_code)]

pub mod grid;
pub mod law;
pub mod program;
pub mod time;

pub use grid::Grid;
pub use law::{Law, LawError};
pub use time::Time;
