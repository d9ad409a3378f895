//! Motions that are changed while they run.

mod request;

pub use request::{Happened, KnobInfo, KnobValue, LiveCommand, LiveEvent, Request};
