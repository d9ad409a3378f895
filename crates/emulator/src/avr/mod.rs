//! The ATmega328P of the Arduino Uno (datasheet DS40002061B), one file for each chapter.
//!
//! - `chip`: what users call; processor and peripherals on one clock
//! - `cpu`, `decode`: instructions
//! - `registers`: the I/O registers by address
//! - `peripherals`: which interrupt is pending, and the time of the next event
//! - `timer`, `timer8`, `timer16`, `usart`, `ports`, `external`, `eeprom`, `spm`, `watchdog`: one peripheral each
//! - `sequence`: the time limit of timed write sequences

mod chip;
mod cpu;
mod decode;
mod eeprom;
mod external;
mod peripherals;
mod ports;
mod registers;
mod sequence;
mod spm;
mod timer;
mod timer16;
mod timer8;
mod usart;
mod watchdog;

pub use chip::{Atmega328p, Boot, BootSize, ImageTooLarge, ResetCause};
pub use cpu::{Masked, Odd};
