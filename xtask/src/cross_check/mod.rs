//! The emulator against what others wrote: of the AVR, simavr for instructions and programs, avr8js for timers; of the
//! Cortex-M0+, rp2040js; of the Cortex-M3, Unicorn and
//! QEMU.
//!
//! # What is here
//! - [`programs`]: C programs, each byte of output with its cycle
//! - [`instructions`]: every opcode from random states
//! - [`timers`]: random timer programs, each edge and each reading with its cycle
//! - [`arm`]: half-words of ARMv6-M from random states; a program and firmware, every instruction; a USB device
//! - [`thumb2`]: every form of instruction of ARMv7-M from random states; a program of exceptions
//! - [`tools`]: the sides, built and installed; each reads cases and prints a line for what happened
//!
//! # What is not
//! Interrupts, the UART's timing, sleep, the watchdog, EEPROM: simavr and avr8js are not the chip there
//! (docs/emulator.md). The emulator's own tests hold these against the datasheet. What an
//! exception of the Cortex-M0+ takes: rp2040js has no time for it. Cycles of the Cortex-M3: neither
//! Unicorn nor QEMU counts any.

mod arm;
mod instructions;
mod programs;
mod thumb2;
mod timers;
mod tools;

use crate::command::{Done, Failure};
use tools::Tools;

/// The result of one comparison.
struct Comparison {
    what: &'static str,
    compared: String,
    /// Unexplained differences, in words.
    differences: Vec<String>,
    /// Where the other side is known to differ from the chip: the name of the difference, and how often it was met.
    exceptions: Vec<(&'static str, usize)>,
}

/// Number of differences that are printed for each comparison. The others are only counted.
const SHOWN: usize = 20;

/// Makes all comparisons, and prints a table. Fails if any difference is unexplained.
pub(crate) fn run() -> Done {
    let tools = Tools::prepare()?;
    let outcomes = [
        programs::compare(&tools)?,
        instructions::compare(&tools)?,
        timers::compare(&tools)?,
        arm::instructions(&tools)?,
        arm::program(&tools)?,
        arm::firmware(&tools)?,
        arm::usb(&tools)?,
        thumb2::instructions(&tools)?,
        thumb2::exceptions(&tools)?,
    ];
    let mut unexplained = 0;
    for outcome in &outcomes {
        for difference in outcome.differences.iter().take(SHOWN) {
            println!("{}: {difference}", outcome.what);
        }
        unexplained += outcome.differences.len();
    }
    println!("\n{:<36}{:>11}  compared", "cross-check of the emulator", "differences");
    for outcome in &outcomes {
        println!("{:<36}{:>11}  {}", outcome.what, outcome.differences.len(), outcome.compared);
        for (name, met) in &outcome.exceptions {
            println!("{:<36}{:>11}  named exception {name}: met {met} times", "", "");
        }
    }
    match unexplained {
        0 => Ok(()),
        _ => Err(Failure::Check(format!("{unexplained} differences between the emulator and others"))),
    }
}
