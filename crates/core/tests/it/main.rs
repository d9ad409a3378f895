//! Tests of the crate, in one binary.
#![allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit")]

mod avr_verbs;
mod baked;
mod braking;
mod firmware;
mod pio;
mod service;
mod stepgen;
mod verbs;
mod winch_golden;
mod winch_path;
mod winch_text;
mod wire;
