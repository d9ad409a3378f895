//! The ATmega328P.

mod chip;
mod cpu;
mod decode;
mod eeprom;
mod external;
mod peripherals;
mod ports;
mod registers;
mod spm;
mod timer;
mod timer16;
mod timer8;
mod usart;
mod watchdog;

pub use chip::{Atmega328p, Boot, BootSize, ImageTooLarge, ResetCause};
pub use cpu::{Masked, Odd};
