//! Boards that read StepperWinch's text: scripts that run and are judged, and a console for people.
//!
//! # What is here, top down
//! - [`run`]: runs a script on a board, and judges, draws and writes down the run
//! - `terminal`: a person's screen and keys; [`console`]: connects a person with a board; `mirror`: a model of the board,
//!   which knows when the axes rest
//! - [`script`]: timed lines, from a file
//! - [`talk`]: lines to a board and from it
//!
//! # What is not
//! The meaning of the text (`pulsetrain-core`), and whether the edges follow it (`pulsetrain_trace::winch`).

pub mod console;
mod mirror;
pub mod run;
pub mod script;
pub mod talk;
pub(crate) mod terminal;
