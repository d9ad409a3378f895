//! The RP2040 of the Raspberry Pi Pico (RP2040 datasheet), one file for each section.
//!
//! - `chip`: what users call; a processor and the system on one clock
//! - `system`: the order of events within a cycle
//! - `fabric`: which memory or peripheral is at which address
//! - `pio`, `dma`, `gpio`, `sio`, `timer`, `uart`, `usb`, `clocks`, `watchdog`: one block each
//! - `xip`, `ssi`, `flash`: flash as memory, the interface to it for commands, the flash chip itself
//!
//! The processor itself is [`crate::arm`].

mod chip;
mod clocks;
mod dma;
mod fabric;
mod flash;
mod gpio;
mod pio;
mod sio;
mod ssi;
mod system;
mod timer;
mod uart;
mod usb;
mod watchdog;
mod xip;

pub use chip::Rp2040;
