//! Helpers that the tests of sessions and of the chips' figures share with the benches.
#![allow(dead_code, reason = "each test and bench uses some of it")]

pub(crate) mod motion;
pub(crate) mod motions;
pub(crate) mod onward;
pub(crate) mod pico;
pub(crate) mod pico_rows;
pub(crate) mod promises;
pub(crate) mod random;
pub(crate) mod rigs;
pub(crate) mod rows;
pub(crate) mod uno;
