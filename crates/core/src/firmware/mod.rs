//! What all firmware has in common: the board behind the link, without its hardware.
//!
//! # What is here, top down
//! - [`board`]: [`FirmwareBoard`], the [`BoardSide`](crate::wire::BoardSide) of a board: what is refused and when, what motors follow, what
//!   is reported to the host
//! - [`hardware`]: [`Hardware`], what a firmware writes for it
//! - [`enable`]: the enable line of the drivers
//! - [`events`]: the reports that wait for the host
//!
//! # What is not
//! Ports, frames on the line, and the main loop are each firmware's own. The Uno has a [`BoardSide`](crate::wire::BoardSide) of its own, for
//! want of flash and RAM: 32-bit ticks of events, assembly that reads the frames of plans, orders in another form.

pub mod board;
pub mod enable;
pub mod events;
pub mod hardware;

pub use board::FirmwareBoard;
pub use enable::EnableLine;
pub use events::EventQueue;
pub use hardware::{Halt, Hardware, LeaseReport};
