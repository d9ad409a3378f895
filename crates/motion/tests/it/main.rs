//! Tests of the crate, in one binary.

mod examples;
mod file_errors;
mod formula;
mod laws;
mod machines;
mod oracle;
mod tables;
