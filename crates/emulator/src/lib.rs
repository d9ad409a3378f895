//! Emulated chips that run firmware images, exact to the cycle by their datasheets. Knows nothing of Pulsetrain: what
//! it says of a firmware must be independent of it.
//!
//! # What is here
//! - [`Atmega328p`]: the processor of the Arduino Uno. All instructions; Timer0, 1 and 2 with their waveforms and
//!   traps; USART; ports, external and pin change interrupts; watchdog, EEPROM, sleep modes, power reduction, clock
//!   prescaler; self-programming of flash, boot section, lock bits
//! - [`Rp2040`]: the chip of the Raspberry Pi Pico, one of its processors. Both PIO blocks, DMA, SIO, GPIO, timer, both
//!   UARTs, USB with a PC at its other end, clocks and PLLs, resets, watchdog, flash in place with its cache
//! - [`Observer`]: what leaves a chip, stamped with its cycle: [`PinEdge`], [`GpioEdge`] and [`UartByte`]
//! - [`LineByte`]: what someone else sends to it, at a speed of their own
//! - [`arm`]: the Cortex-M0+, apart from any chip
//! - [`hex`]: Intel HEX; [`image`]: ELF and UF2
//!
//! # What is not
//! ATmega328P: SPI, two-wire, ADC, analogue comparator (their registers keep what is written), Timer2 with a crystal of its own,
//! synchronous and SPI modes of the USART, brown-out by voltage, fuses but for the boot section.
//!
//! RP2040: the second processor, the boot ROM, interpolators, PWM, SPI, I2C, ADC, RTC, writing to flash, who waits when
//! two want the same memory bank (`docs/emulator.md`).
//!
//! Serial pins are told as characters, not as edges.
//!
//! # Cycles
//! A cycle is a period of the system clock: 62.5 ns on an Uno, unless CLKPR divides it. An edge's cycle is the first in
//! which the pin has its new level. A port written by an instruction that occupies cycles c to c + n − 1 changes in
//! c + n, at which the next instruction begins; a compare match with a counter that equals OCRnx in cycle c (clk/1)
//! moves the pin and sets the flag in c + 1. An interrupt is entered at the first instruction boundary at or after the
//! cycle in which its flag was set; its vector's instruction begins 4 cycles later.
//!
//! On an RP2040 a cycle is a period of clk_sys, whose frequency [`Observer::clock_frequency`] tells. What a state
//! machine, a transfer or a store does in cycle c reads what was there when c began, and is there when c + 1 begins.
#![forbid(unsafe_code)]

pub mod arm;
mod avr;
pub mod hex;
pub mod image;
mod observer;
mod pin;
mod rp2040;
mod serial;

pub use avr::{Atmega328p, Boot, BootSize, ImageTooLarge, Masked, Odd, ResetCause};
pub use observer::Observer;
pub use pin::{GpioEdge, Level, PinEdge, Port};
pub use rp2040::{Rp2040, UsbState};
pub use serial::{LineByte, UartByte};
