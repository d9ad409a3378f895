//! Tests of the crate, in one binary.
#![allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit")]

mod common;
mod drift;
mod flat;
mod golden;
mod hostile;
mod limits;
mod lorenz;
mod narrow;
mod oracle;
mod properties;
mod shared_dir;
mod tables;
