//! Tests of the crate, in one binary.
#![allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit")]

mod bake;
mod bounded;
mod chips;
mod commands;
mod common;
mod control;
mod files;
mod first_motion;
mod flash;
mod formula;
mod helps;
mod json;
mod link;
mod live;
mod live_random;
mod machines;
mod mutants;
mod page;
mod plots;
mod promises;
mod readme;
mod recordings;
mod small_queues;
mod tasks;
mod winch;
mod wiring;
