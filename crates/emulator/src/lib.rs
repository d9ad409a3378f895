//! Emulated chips that run firmware images, exact to the cycle by their datasheets.
//!
//! This crate knows nothing of Pulsetrain, so that what it finds out about a firmware does not depend on the code that
//! made the firmware.
//!
//! ```
//! use pulsetrain_emulator::{Atmega328p, Level, Port};
//!
//! // sbi DDRB, 5; sbi PORTB, 5; rjmp to itself: the LED of an Uno goes on, 2 cycles after each sbi began.
//! let words = [0x9a25u16, 0x9a2d, 0xcfff];
//! let image: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
//! let mut chip = Atmega328p::new(&image)?;
//! chip.run(2, &mut ());
//! assert_eq!((chip.is_output(Port::B, 5), chip.pin(Port::B, 5)), (true, Level::Low));
//! chip.run(4, &mut ());
//! assert_eq!(chip.pin(Port::B, 5), Level::High);
//! # Ok::<(), pulsetrain_emulator::ImageTooLarge>(())
//! ```
//!
//! # What is here
//! - [`Atmega328p`]: the processor of the Arduino Uno. All instructions; Timer0, 1 and 2 with their waveforms and
//!   special cases; USART; ports, external and pin change interrupts; watchdog, EEPROM, sleep modes, power reduction,
//!   clock prescaler; self-programming of flash, boot section, lock bits
//! - [`Rp2040`]: the chip of the Raspberry Pi Pico, with one of its processors. Both PIO blocks, DMA, SIO, GPIO, timer,
//!   both UARTs, USB with a PC at the other end of the cable, clocks and PLLs, resets, watchdog, flash with its cache
//! - [`Sam3x8e`]: the chip of the Arduino Due. Timers, pins, the programming port's UART with its DMA, native USB at full
//!   speed with a PC at the other end, clocks, both planes of flash with their controllers and wait states, bus matrix,
//!   resets, watchdog. What no document says of its times is a choice: [`Sam3x8eTiming`]
//! - [`Observer`]: gets everything that leaves a chip, with its cycle: [`PinEdge`], [`GpioEdge`] and [`UartByte`]
//! - [`LineByte`]: a character for a chip's receiver, at any baud rate
//! - [`arm`]: the processors Cortex-M0+ and Cortex-M3 by themselves, without a chip
//! - [`hex`]: Intel HEX; [`image`]: ELF and UF2
//!
//! # What is not
//! ATmega328P: SPI, two-wire, ADC and analogue comparator (their registers only store what is written), Timer2 with a
//! crystal of its own, synchronous and SPI modes of the USART, brown-out by voltage, fuses other than those of the boot
//! section.
//!
//! RP2040: the second processor, the boot ROM, interpolators, PWM, SPI, I2C, ADC, RTC, the waiting of accesses that
//! collide on one memory bank, and flash commands other than those to read, erase a sector, program a page, and return
//! status and number (`docs/emulator.md`).
//!
//! SAM3X8E: the boot ROM, the other serial ports, PWM, ADC, DAC, CAN, Ethernet, memory cards, the DMA controller, the
//! real-time clock and timer, low-power modes, the MPU; of the timers capture and external clocks. Their registers store
//! what is written.
//!
//! Serial lines carry characters, not edges.
//!
//! # Cycles
//! A cycle is a period of the system clock: 62.5 ns on an Uno, unless CLKPR divides it. The cycle of an edge is the first
//! one in which the pin has its new level. An instruction that takes the cycles c to c + n − 1 and writes a port changes
//! the pin in c + n, in which the next instruction begins. A counter that equals OCRnx in cycle c (clk/1) moves the pin
//! and sets the flag in c + 1. An interrupt is entered at the first instruction boundary at or after the cycle in which
//! its flag was set; the instruction at its vector begins 4 cycles later.
//!
//! On a SAM3X8E a cycle is a period of the master clock, and on an RP2040 of clk_sys; [`Observer::clock_frequency`] gets its frequency. State machines,
//! transfers and stores in cycle c use the state at the beginning of c, and their effect is there at the beginning of
//! c + 1.
#![forbid(unsafe_code)]

pub mod arm;
mod avr;
pub mod hex;
pub mod image;
mod observer;
mod pin;
mod rp2040;
mod sam3x8e;
mod serial;
mod usb;

pub use avr::{Atmega328p, Boot, BootSize, ImageTooLarge, Masked, Odd, ResetCause};
pub use observer::Observer;
pub use pin::{GpioEdge, Level, PinEdge, Port};
pub use rp2040::Rp2040;
pub use sam3x8e::{Sam3x8e, Sam3x8eTiming};
pub use serial::{LineByte, UartByte};
pub use usb::UsbState;
