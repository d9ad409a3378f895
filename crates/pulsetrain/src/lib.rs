//! Pulsetrain drives stepper motors along any motion law, exactly: the command line, and all its crates under one roof for programs that embed it.
//!
//! # What is here, top down
//! - [`cli`]: the command line, and [`cli::run`], which runs a command in-process; `commands`: one file for each command
//! - [`console`]: where a command prints, its progress, its exit code; [`diagnostic`]: errors with their advice; `interrupt`: Ctrl-C
//! - [`load`]: motion files from the disk; [`consent`]: whether a long motion is meant
//! - [`record`]: a run's files, verdict and picture, while it goes on; [`report`]: the same as JSON and tables
//! - [`serve`]: virtual boards in real time, for any serial client
//! - [`winch`]: StepperWinch's text protocol: scripts, and a console
//!
//! # The crates below
//! - [`motion`]: motion files, laws, drivers, limits of boards; [`plan`]: laws to segments, with a proof
//! - [`board`]: boards and links; [`session`]: a program, streamed into a board; [`trace`]: edges, and the verdict on them
//! - [`bake`]: standalone images and sketches; [`plot`]: pictures
#![forbid(unsafe_code)]

mod arguments;
pub mod cli;
mod commands;
pub mod consent;
pub mod console;
pub mod diagnostic;
mod interrupt;
pub mod load;
pub mod record;
pub mod report;
pub mod serve;
pub mod winch;

pub use pulsetrain_bake as bake;
pub use pulsetrain_board as board;
pub use pulsetrain_motion as motion;
pub use pulsetrain_plan as plan;
pub use pulsetrain_plot as plot;
pub use pulsetrain_session as session;
pub use pulsetrain_trace as trace;
