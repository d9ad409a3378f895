//! Tests of the crate, in one binary.
#![allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit")]

mod examples;
mod file_errors;
mod formula;
mod laws;
mod machines;
mod oracle;
mod tables;
