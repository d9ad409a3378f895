//! The firmware of the Raspberry Pi Pico, and a library for a program of one's own.
//!
//! # What is here, top down
//! - [`firmware`]: the board that hosts drive: start-up and the main loop
//! - [`motors`]: motors for a program of one's own on the Pico, without a host; `examples/` has such programs
//! - `machine`: the board behind the link: does what the host asks of it
//! - `steps`: from packed bytes to edges on the pins
//! - `winch`: text instead of frames, and motors that follow paths
//! - `port_io`: the bytes of one port to a host, in both directions
//! - `uart`, `usb`: the two ports: the serial line, and the serial port over USB. A session is on the one where it was opened
//! - `clock`: the chip's clocks, and the board's: SysTick extended to 64 bits
//! - `baked`: a motion in the flash, which begins at power-up
//! - `store`: settings that are kept without power
//! - `flash`: reading and writing the flash, and its chip's number, by which a computer knows this board
//! - `reset`: the watchdog, and why the program began
//! - `start`: vectors, the copy to RAM, and cells for statics
//! - `regs`: the registers, and instructions that Rust has no functions for
//!
//! # Who makes the edges
//! PIO's state machines, which nothing interrupts: each word says how long to wait. The firmware's main loop writes words up to 2.4
//! ms ahead, motor by motor, and does everything else in between. One interrupt, the DMA's, hands written words over: it must come
//! within the eight words of a FIFO. If the main loop is late by 1.8 ms, or the interrupt by eight words, a state machine runs dry:
//! it gets no more words, and all motors stop as soon as the main loop sees it. In the library a timer's interrupt does what the
//! main loop does in the firmware, up to 1.9 ms ahead.
//!
//! # What is not
//! Motions, but for the winch's paths and the evenly spaced steps of verbs: segments come from the host or from the flash, packed
//! as in `pulsetrain_core::packing`.
#![no_std]

mod baked;
mod board;
mod clock;
pub mod firmware;
mod flash;
mod hardware;
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
