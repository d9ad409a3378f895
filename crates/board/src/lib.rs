//! Boards: what takes queue items and makes edges.
//!
//! # What is here, top down
//! - [`native`]: the project's own stepgen on the PC, in virtual time
//!
//! # What is not
//! Motion: a board does what was planned and invents nothing. Planning is `pulsetrain-plan`'s, keeping a queue filled the
//! session's in `pulsetrain`.
#![forbid(unsafe_code)]

pub mod native;

pub use native::{Config, Edge, MotorConfig, Native, Observer, ScheduledStep, StopReport, SwitchRefused, Wiring};
