//! Motions that are changed while they run.
//!
//! - [`Line`]: what people type; [`Request`], [`Happened`]: the same as values
//! - [`Desk`]: the motion as it is wanted: file, knobs, cues
//! - `incoming`: what clients ask, in the order in which it is obeyed
//! - [`Show`]: a running motion that obeys
//! - `nearest`: the value nearest to a wanted one that motors and board can follow
//! - [`schedule`]: when it runs, by the clock
//! - [`watch`]: the motion file and those that it names, which may change on the disk
//! - [`log`]: what was asked and done, for [`log::Replay`]

mod desk;
pub(crate) mod incoming;
mod line;
pub mod log;
mod nearest;
pub mod schedule;
pub(crate) mod screen;
mod show;
pub mod watch;

pub use crate::control_socket::{Happened, KnobInfo, KnobValue, LiveCommand, LiveEvent, Request, Together};
pub use desk::{ChangeRefusal, Desk, FileTexts, NoMotion, Turn};
pub use line::{HELP, LONGEST_LINE, Line, LineError};
pub use show::{Show, StopWaits, SuspendedShow, Tell};
