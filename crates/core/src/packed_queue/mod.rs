//! A motor's queue of packed items, in memory that all motors share.
//!
//! # What is here, top down
//! - [`PackedQueue`]: packed bytes that wait → items for a channel; checks are compared
//! - [`ByteQueue`]: the bytes themselves, epoch by epoch, in a motor's part of the [`Pool`]
//!
//! # What is not
//! The format of the bytes: [`packing`](crate::packing). A queue of unpacked items: [`queue`](crate::queue). The Uno, whose
//! assembly reads packed bytes from rings of its own.

mod bytes;
mod items;

pub use bytes::{ByteQueue, EPOCHS, Pool, PushRefused};
pub use items::{Fault, PackedItems, PackedQueue};
