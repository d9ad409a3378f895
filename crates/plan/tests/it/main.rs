//! Tests of the crate, in one binary.

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
