//! Boards that speak StepperWinch's text: scripts that are run and judged, and a console for people.
//!
//! # What is here, top down
//! - [`run`]: a script on a board, as it is judged, drawn and written down
//! - [`console`]: a board and a person; `terminal`: that person's screen and keys; `mirror`: whether a
//!   board that was told so is at rest
//! - [`script`]: timed lines, from a file
//! - [`talk`]: lines to a board and from it
//!
//! # What is not
//! What the text means (`pulsetrain-core`), and whether the edges follow it (`pulsetrain_trace::winch`).

pub mod console;
mod mirror;
pub mod run;
pub mod script;
pub mod talk;
pub(crate) mod terminal;
