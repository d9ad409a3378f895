//! Pulsetrain drives stepper motors along any motion law, exactly: the command line, and all its crates under one roof for programs that embed it.
//!
//! # A program that embeds it
//! A motion is text or types of [`motion`]. It is proven before anything moves; a [`session::drive::Driven`] then streams it into a board,
//! takes commands and tells what happens. Here the board is virtual: the real firmware on an emulated chip. With a port it is
//! `Driven::at(&prepared, Serial::open("/dev/ttyACM0", false)?, Baud::B1M)`. `examples/embed.rs` is a whole program.
//!
//! ```
//! use pulsetrain::board::BoardKind;
//! use pulsetrain::motion::file;
//! use pulsetrain::session::control::{Command, Event};
//! use pulsetrain::session::{drive::Driven, prepare::Prepared};
//! use std::sync::mpsc::channel;
//!
//! let text = r#"
//! board = "uno"
//! tolerance = "1 us"
//! [motor.pendulum]
//! steps_per_rev = 200
//! microsteps = 8
//! driver = "A4988"
//! pins = { step = 8, dir = 9 }
//! forward = "high"
//! max_acceleration = "20 rev/s^2"
//! [[motion]]
//! motor = "pendulum"
//! law.sine = { amplitude = "45 deg", period = "2 s", cycles = 1 }
//! "#;
//! let no_other_file = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
//! let contents = file::read_contents(text, "pendulum", &no_other_file).map_err(|error| error.plain())?;
//! let mut prepared = Prepared::new("pendulum".into(), contents, None)?;
//! let proof = prepared.prove(|_| {})?;
//! assert_eq!((proof[0].certificate.steps, proof[0].certificate.bound_ticks < 16.5), (800, true));
//!
//! let kind = BoardKind::named("uno").ok_or("no firmware for it")?;
//! let mut driven = Driven::on_virtual(kind, &prepared, kind.usual_baud())?;
//! let (commands, receiver) = channel();
//! let mut edges = 0;
//! let ended = driven.run_with(&receiver, &mut |_: pulsetrain::board::Edge| edges += 1, |event| {
//!     if let Event::Status(status) = event && status.at_s > 0.5 {
//!         let _ = commands.send(Command::Stop);
//!     }
//! })?;
//! // The board counted what it made, and every edge of its pins was seen.
//! assert!(ended.stopped && ended.counted[0] > 200 && edges > 400);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # What is here, top down
//! - [`cli`]: the command line, and [`cli::run`], which runs a command in-process; `commands`: one file for each command
//! - [`clean`]: text for terminals, without orders for them
//! - [`console`]: where a command prints, its progress, its exit code; [`diagnostic`]: errors with their advice; `interrupt`: Ctrl-C
//! - [`files`]: files that a command reads and writes: with bounds, and without loss
//! - [`load`]: motion files from the disk; [`consent`]: whether a long motion is meant
//! - [`schema`]: JSON Schemas of what is printed
//! - [`midi`]: MIDI for a live motion
//! - [`osc`]: Open Sound Control for a live motion
//! - [`control_socket`]: a run's hub of clients with their threads, and its socket for `stop`, `status` and other programs
//! - [`page`]: a page in the browser for a motion that runs
//! - [`serve`]: virtual boards in real time, for any serial client
//! - [`winch`]: StepperWinch's text protocol: scripts, and a console
//!
//! # The crates below
//! - [`motion`]: motion files, laws, drivers, limits of boards; [`plan`]: laws to segments, with a proof
//! - [`board`]: boards and links; [`session`]: a program, streamed into a board; [`trace`]: edges, and the verdict on them
//! - [`live`]: motions that are changed while they run: commands and events, knobs, cues, clients, logs, and the loop
//! - [`report`]: a run from its program to its verdict, JSON, text and files, as one call; [`bake`]: standalone images and sketches;
//!   [`plot`]: pictures
#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit"))]
#![forbid(unsafe_code)]

mod access;
mod arguments;
pub mod clean;
pub mod cli;
mod clock;
mod commands;
pub mod consent;
pub mod console;
pub mod control_socket;
pub mod diagnostic;
pub mod files;
mod film;
mod interrupt;
mod last_positions;
pub mod load;
pub mod midi;
pub mod osc;
pub mod page;
pub mod schema;
pub mod serve;
mod way_back;
pub mod winch;

pub use pulsetrain_bake as bake;
pub use pulsetrain_board as board;
pub use pulsetrain_live as live;
pub use pulsetrain_motion as motion;
pub use pulsetrain_plan as plan;
pub use pulsetrain_plot as plot;
pub use pulsetrain_report as report;
pub use pulsetrain_session as session;
pub use pulsetrain_trace as trace;
