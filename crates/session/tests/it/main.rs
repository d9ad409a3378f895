//! Sessions on the native board: what it does under them is the plan, tick by tick, or a stop that the host knows.

mod control;
mod fade;
mod interleavings;
mod new_board;
mod onward;
mod session;
