//! The RP2040 of the Raspberry Pi Pico.

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
pub use usb::UsbState;
