//! What boards and PC share, without an allocator, floating point or `unsafe`.
//!
//! ```
//! use pulsetrain_core::{Recurrence, Segment};
//!
//! // Three steps, the first after 100 ticks, with intervals that shrink by 10 ticks; 16 fraction bits, as on an Uno.
//! let segment = Segment { count: 3, interval: 100 << 16, add: -10 << 16, add2: 0 };
//! let mut recurrence = Recurrence { accumulator: 0, interval: 0, add: 0, add2: 0 };
//! recurrence.load(&segment);
//! let ticks = [(); 3].map(|()| {
//!     recurrence.advance();
//!     recurrence.accumulator >> 16
//! });
//! assert_eq!(ticks, [100, 190, 270]);
//! ```
//!
//! # What is here, top down
//! - [`merge`]: edges of all motors in one time-ordered stream, coincident edges in one
//! - [`axis`]: one motor's queue, channel and output together
//! - [`output`]: steps → pin edges: step/dir drivers and coils; pulse width, DIR setup and hold
//! - [`channel`]: queue items → (tick, step or direction change)
//! - [`channels`]: what the channels of one machine agree on: horizon, lapse
//! - [`verbs`]: motors that take orders directly: so many steps, at this period, in this direction
//! - [`pio`]: channel and output → words for the RP2040's state machines (PIO), which make the edges
//! - [`avr`]: registers and verbs in the integers of an 8-bit processor (ATmega328P)
//! - [`baked`]: a motion that lies in a board's flash, and how it is played
//! - [`lease`]: how long a plan holds; [`braking`]: how a board brings a motor to rest by itself
//! - [`shared_line`]: a DIR line of several motors while they brake
//! - [`queue`]: items waiting, each tagged with its epoch
//! - [`packed_queue`]: packed bytes that wait, and the items in them
//! - [`packing`]: segments as few bytes
//! - [`wire`]: frames and messages between host and board, and the board's side of the link
//! - [`firmware`]: the board behind that link, on any hardware
//! - [`segment`]: the recurrence, exact; [`RegisterWidths`]: the registers in which a board has it
//! - [`boards`]: what each board's firmware and the host must agree on
//! - [`tick32`]: wrap-safe time
//!
//! # What is not
//! Hardware registers, clocks, links: firmware's and `pulsetrain-board`'s. Laws and planning: the host's.
#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit"))]
#![no_std]
#![forbid(unsafe_code)]
#![deny(clippy::float_arithmetic)]
#![deny(clippy::cast_possible_truncation)]

pub mod avr;
pub mod axis;
pub mod baked;
pub mod boards;
pub mod braking;
pub mod channel;
pub mod channels;
pub mod firmware;
pub mod lease;
pub mod merge;
pub mod output;
pub mod packed_queue;
pub mod packing;
pub mod pio;
pub mod queue;
mod register_widths;
pub mod segment;
pub mod shared_line;
pub mod tick32;
pub mod verbs;
pub mod winch;
pub mod wire;

pub use axis::Axis;
pub use channel::Channel;
pub use lease::{Lapse, Lease};
pub use merge::Merge;
pub use queue::{Entry, Epoch, Item, Queue};
pub use register_widths::RegisterWidths;
pub use segment::{Direction, Recurrence, Segment};
pub use tick32::Tick32;
