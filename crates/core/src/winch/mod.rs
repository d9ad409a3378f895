//! StepperWinch's dialect: text lines from the host, and a path that the board works out itself.
//!
//! # What is here, top down
//! - [`text`]: lines, byte by byte → commands; replies → bytes
//! - [`spacing`]: a millisecond of the path → ticks of its steps
//! - [`path`]: the recurrence of one axis, at 1 kHz
//! - [`number`]: products and decimals without a floating point unit
//!
//! docs/winch.md has the commands and the equations.
//!
//! # What is not
//! Pins, clocks, queues, when to report: the firmware's. The same path as a law on the host is `pulsetrain-motion`'s
//! `law::winch`.

pub mod number;
pub mod path;
pub mod spacing;
