//! The board's side.
