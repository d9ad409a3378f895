//! Tests of the crate, in one binary.

mod baked;
mod braking;
mod narrow_verbs;
mod service;
mod stepgen;
mod verbs;
mod winch_golden;
mod winch_path;
mod winch_text;
mod wire;
mod words;
