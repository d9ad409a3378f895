//! Sessions on the native board: what it does under them is the plan, tick by tick, or a stop that the host knows.
#![allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit")]

mod control;
mod fade;
mod interleavings;
mod new_board;
mod onward;
mod session;
