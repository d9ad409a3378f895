//! Tests of the crate, in one binary.

mod avr_verbs;
mod baked;
mod braking;
mod pio;
mod service;
mod stepgen;
mod verbs;
mod winch_golden;
mod winch_path;
mod winch_text;
mod wire;
