//! Motions that are changed while they run: by a file, knobs, cues, a schedule and any number of clients.
//!
//! # What is here, top down
//! - [`Player`]: the loop of a live motion on a board that may be lost and come back; [`LiveHost`] is what it needs of the program around it
//! - [`RunCommand`], [`Batch`]: what clients ask for; [`RunEvent`]: what they hear
//! - [`hub`]: the clients of a run, and who of them may do what; [`RunInfo`], [`run_line`]: the lines between it and them
//! - [`LiveRun`]: a running motion that takes commands; [`SuspendedRun`]: the same without a board
//! - [`LiveSetpoints`]: the motion as it is wanted: file, knobs, cue
//! - [`CommandQueue`]: what clients ask for, in the order in which the motion does it
//! - [`TypedLine`]: commands as people type them; [`schedule`]: when it runs, by the clock
//! - [`log`]: what was asked and done, for [`log::Replay`]
//!
//! # What is not
//! It starts no thread, reads no clock and opens no file, port or socket: time, files and lines are handed in. Sockets, OSC, MIDI and pages are above it.
#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit"))]
#![forbid(unsafe_code)]

mod command;
mod command_queue;
mod event;
pub mod hub;
pub mod input_line;
mod live_run;
pub mod log;
mod player;
mod run_info;
pub mod run_line;
pub mod schedule;
mod setpoints;
mod typed_line;

pub use command::{Batch, KnobValue, RunCommand};
pub use command_queue::{CommandQueue, CommandSource, MAX_MERGED_COMMANDS, Work};
pub use event::RunEvent;
pub use hub::{ClientKind, JoinError};
pub use live_run::{LiveRun, Publish, StopWaits, SuspendedRun};
pub use player::{FoundBoard, LiveBoard, LiveHost, NoPort, Player, PlayerEnd, PlayerOptions};
pub use run_info::{KinematicsInfo, KnobInfo, MachineInfo, MotorInfo, RunInfo, RunPlace};
pub use run_line::{ControlState, Ending, RunEnded, RunLine};
pub use setpoints::{ChangeRefusal, FileLoader, FileTexts, KnobMove, LiveSetpoints, NamedFiles, NoMotion};
pub use typed_line::{HELP, LineError, MAX_TYPED_LINE_BYTES, TypedLine};
