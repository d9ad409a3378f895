//! Pulsetrain's face: the command line, reports and plots, over the crates that do the work.
#![forbid(unsafe_code)]

pub mod cli;
mod commands;
pub mod console;
pub mod drive;
pub mod fit;
pub mod human;
pub mod plot;
pub mod prepare;
pub mod record;
pub mod report;
