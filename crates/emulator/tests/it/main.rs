//! Tests of the crate, in one binary.
#![allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit")]

mod any_register;
mod arm_common;
mod arm_exceptions;
mod arm_instructions;
mod common;
mod dma;
mod dma_model;
mod due_tape;
mod due_usb;
mod hex;
mod image;
mod instructions;
mod interrupts;
mod m3_common;
mod m3_exceptions;
mod m3_instructions;
mod pico;
mod pio;
mod pio_model;
mod ports;
mod programs;
mod random;
mod rp2040;
mod sam3x8e;
mod self_programming;
mod three_machine_motor;
mod timers;
mod usart;
mod usb;
mod usb_device;
