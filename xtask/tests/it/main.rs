//! Tests of the crate, in one binary.
#![allow(clippy::disallowed_methods, reason = "tests open their own files")]

mod core_source;
mod dependencies;
mod names;
mod no_clock;
mod tour;
