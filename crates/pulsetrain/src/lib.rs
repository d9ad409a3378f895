//! Pulsetrain's face: the command line, reports and plots, over the crates that do the work.
//!
//! # What is here, top down
//! - [`cli`]: what can be said on the command line, and [`cli::run`], which runs a command in-process
//! - `commands`: one file for each command
//! - [`prepare`]: from a motion file to plans of all motors; [`fit`]: what would fit, where one is refused;
//!   [`estimate`]: what a motion comes to before it is planned, and a question where that is much
//! - [`session`] (`pulsetrain-session`): a program, streamed into a board by lease; stops, pauses and live changes
//! - [`serve`]: virtual boards in real time, for any serial client; `interrupt`: Ctrl-C
//! - [`bake`]: plans that stay on a board, without a host: images for Uno and Pico, Arduino sketches
//! - [`winch`]: boards that work out their path themselves, told in text: scripts, and a console
//! - [`drive`]: plans on the native board, on Unos and Picos; [`record`]: a run as it is seen: files, verdict, picture
//! - [`lateness`]: edges against scheduled ticks; [`figure`]: what machines draw, and how far off it is
//! - [`report`], [`plot`]: what it comes to, as JSON, tables and pictures; [`human`]: numbers as people read them
//! - [`console`]: where a command prints, its progress, its exit code
//!
//! # What is not
//! Motion files and laws (`pulsetrain-motion`), planning (`pulsetrain-plan`), boards (`pulsetrain-board`), the judge
//! (`pulsetrain-trace`).
#![forbid(unsafe_code)]

pub mod bake;
pub mod cli;
mod commands;
pub mod console;
pub mod drive;
pub mod estimate;
pub mod figure;
pub mod fit;
pub mod human;
mod interrupt;
pub mod lateness;
pub mod plot;
pub mod prepare;
pub mod record;
pub mod report;
pub mod serve;
pub mod winch;

pub use pulsetrain_session::{self as session, pause};
