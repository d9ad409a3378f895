//! StepperWinch's dialect: text lines from the host, and a path that the board works out itself.
//!
//! # What is here, top down
//! - [`session`]: the state of a whole board: paths, drivers, status lines, the deadman
//! - [`text`]: bytes of lines → commands, and the commands' effect on four paths
//! - [`reply`]: replies → bytes
//! - [`verb_lines`]: verbs as lines of text, which StepperWinch does not have
//! - [`spacing`]: a millisecond of a path → ticks of its steps
//! - [`path`]: the recurrence of one axis, at 1 kHz
//! - [`letters`]: the words of commands and replies
//! - [`number`]: products of scaled integers
//!
//! docs/winch.md has the commands and the equations.
//!
//! # What is not
//! Pins, clocks, lines: the board's. The same path as a law on the host is `pulsetrain-motion`'s
//! `law::winch`.

pub mod letters;
pub mod number;
pub mod path;
pub mod reply;
pub mod session;
pub mod spacing;
pub mod text;
pub mod verb_lines;

/// The axes, in the order of their bits, of paths, and of positions in a status.
pub const AXES: [u8; 4] = *b"xyza";
