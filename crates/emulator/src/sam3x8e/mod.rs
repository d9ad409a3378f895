//! The SAM3X8E of the Arduino Due (Atmel-11057C, 23 March 2015, whose sections are named), one file for each block.
//!
//! - `chip`: what users call; the processor and the system on one clock
//! - `system`: which memory or peripheral is at which address, what an access costs, the order of events in a cycle
//! - `timing`: times that no document gives
//! - `tc`, `pio`, `pmc`, `flash`, `uart`: timers, pins, clocks, flash with its controllers, the programming port's UART
//!   with its DMA
//! - `uotghs`: USB; the PC at the other end of the cable is in `crate::usb`
//! - `reset`: reset controller, watchdog, chip number
//!
//! The processor itself is [`crate::arm`].

mod chip;
mod flash;
mod pio;
mod pmc;
mod reset;
mod system;
mod tc;
mod timing;
mod uart;
mod uotghs;

pub use chip::Sam3x8e;
pub use timing::Sam3x8eTiming;
