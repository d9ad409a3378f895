//! What the tests of sessions and of the Uno share, with its benches.
#![allow(dead_code, reason = "each test and bench uses some of it")]

#[path = "../../../board/tests/common/mod.rs"]
pub(crate) mod board;
pub(crate) mod motion;
pub(crate) mod pico;
pub(crate) mod pico_rows;
pub(crate) mod rows;
pub(crate) mod uno;
