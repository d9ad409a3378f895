//! Tests of the crate, in one binary.

mod bake;
mod chips;
mod commands;
mod common;
mod first_motion;
mod flash;
mod helps;
mod json;
mod link;
mod machines;
mod mutants;
mod plots;
mod readme;
mod small_queues;
mod winch;
mod wiring;
