//! The protocol between host and board, and the board's side of it.
//!
//! # What is here, top down
//! - [`service`]: the board's side: frames in, replies out, everything else through [`BoardSide`]
//! - [`board_side`]: what a board must be able to do for it
//! - [`message`]: commands, answers, events, byte by byte; [`orders`]: verbs for motors; [`settings`]: what a board
//!   keeps without power
//! - [`outcome`]: how it went, and why it was refused: codes
//! - [`limits`]: the version, the rates of the line, numbers that all of it builds on
//! - [`frame`]: bodies ↔ bytes on the line: COBS, CRC-16, a zero at the end
//!
//! docs/protocol.md says the same in tables, and a test holds the two against each other. Integers are little-endian.
//!
//! # What is not
//! The host's side, with its windows, timeouts and credit: `pulsetrain-board`'s `link`.

pub mod board_side;
pub mod frame;
pub mod limits;
pub mod message;
pub mod orders;
pub mod outcome;
pub mod service;
pub mod settings;

pub use board_side::BoardSide;
pub use frame::{Decoder, Encoder, MAX_BODY, MAX_FRAME};
pub use limits::{Baud, MAX_MOTORS, Millis, VERSION};
pub use message::{Command, MIN_BODY, Reply};
pub use outcome::{Reason, Refusal, Stopped, Switched, Trimmed};
pub use service::Service;
pub use settings::{Settings, Stored};
