//! The firmware of the Raspberry Pi Pico, and a library for one's own.
//!
//! # What is here, top down
//! - [`firmware`]: the board that hosts drive: start-up and the main loop
//! - [`motors`]: motors for a program of one's own on the Pico, without a host; `examples/` has such programs
//! - `machine`: what the link asks of a board, done on this one
//! - `steps`: from packed bytes to edges on the pins
//! - `winch`: text instead of frames, and motors that follow paths
//! - `talk`: what is heard and said on a way to a host
//! - `link`, `usb`: the serial line, and the serial port over USB: one session, on whichever of them it was begun
//! - `clock`: the chip's clocks, and SysTick extended to 64 bits
//! - `baked`: a motion in the flash, which begins with the board
//! - `store`: settings that are kept without power
//! - `flash`: what is in it, and the number by which two boards are told apart
//! - `reset`: the watchdog, and why the program began
//! - `start`: vectors, and memory that there is one of
//! - `regs`: the registers, and instructions that Rust has no words for
//!
//! # Who makes the edges
//! State machines, which nobody interrupts: each word says how long to wait. The firmware's main loop writes words up to 2.4 ms ahead, motor by
//! motor, and does all else in between. One interrupt, of the DMA, hands on what was written: it must come within the eight
//! words of a FIFO. If the main loop is late by 1.8 ms, or the interrupt by eight words, a state machine runs dry: it gets
//! nothing more, and all motors stop as soon as the main loop sees it. In the library a timer's interrupt does what the main loop
//! does in the firmware, up to 1.9 ms ahead.
//!
//! # What is not
//! Motion, but for the winch's paths and evenly spaced steps: segments come from the host or from the flash, as `pulsetrain_core::packing` has them.
#![no_std]

mod baked;
mod clock;
pub mod firmware;
mod flash;
mod machine;
pub mod motors;
mod port_io;
mod regs;
mod reset;
mod start;
mod steps;
mod store;
mod uart;
mod usb;
mod winch;
