//! StepperWinch's dialect: text lines from the host, and a path that the board works out itself.
//!
//! # What is here, top down
//! - [`session`]: what lines ask of a whole board, and what time brings
//! - [`text`]: bytes of lines → commands, and these done to four paths
//! - [`reply`]: replies → bytes
//! - [`verb_lines`]: lines that order motors directly: an addition to StepperWinch's
//! - [`spacing`]: a millisecond of a path → ticks of its steps
//! - [`path`]: the recurrence of one axis, at 1 kHz
//! - [`letters`]: the texts of both
//! - [`number`]: products without a floating point unit
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
