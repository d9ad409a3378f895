//! Tests of the crate, in one binary.

mod core_source;
mod dependencies;
mod no_clock;
mod tour;
