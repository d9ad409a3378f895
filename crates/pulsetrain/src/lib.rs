//! Pulsetrain's face: the session that streams a motion into a board.
#![forbid(unsafe_code)]

pub mod session;
