//! The hot path: compare interrupts, expansion and merge, in assembly with a thin Rust face.

pub mod expand;
pub mod ring;
pub mod merge;
pub mod register;
