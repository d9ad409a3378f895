//! Tests of the crate, in one binary.

mod core_source;
mod dependencies;
mod names;
mod no_clock;
mod tour;
