//! How the program begins and ends: the watchdog, and the cause of the last reset.
//!
//! The main loop kicks the watchdog every round. If it does not for half a second, the watchdog resets the chip, with PIO and pads,
//! so that all lines float. A panic or a fault, which no input causes, stops the state machines and then has the watchdog reset the
//! chip.

use crate::regs::{self, Pio};
use core::panic::PanicInfo;
use pulsetrain_core::wire::message::Cause;

/// The watchdog resets the chip after so long, µs: 0.5 s. Its counter goes down by two (erratum E1).
const WATCHDOG_US: u32 = 500_000;

/// Notes for the program that begins next: this one was running; it was ended by a panic or a fault. Only a reset by the watchdog
/// keeps them (§4.7.5).
const NOTE_RUNNING: u32 = 0x50_a6_5e_1e;
const NOTE_FAULT: u32 = 0x50_a6_5e_1f;

/// Why the program began.
pub(crate) fn cause() -> Cause {
    let note = regs::WATCHDOG_SCRATCH0.read();
    regs::WATCHDOG_SCRATCH0.write(0);
    // §2.10.6: bits 8, 16.
    let chip = regs::CHIP_RESET.read();
    // The boot ROM also starts a program that it has just written to the flash by the watchdog: then there is no note.
    if regs::WATCHDOG_REASON.read() & 0b11 != 0 && matches!(note, NOTE_RUNNING | NOTE_FAULT) {
        Cause::Watchdog
    } else if chip & 1 << 16 != 0 {
        Cause::ResetLine
    } else {
        Cause::PowerOn
    }
}

/// Starts the watchdog.
pub(crate) fn start_watchdog() {
    // §2.13.5: all but the oscillators.
    regs::PSM_WDSEL.write(0x1_fffc);
    kick_watchdog();
    regs::WATCHDOG_SCRATCH0.write(NOTE_RUNNING);
    regs::WATCHDOG_CTRL.write(1 << 30);
}

/// To be called more often than twice a second.
#[inline(always)]
pub(crate) fn kick_watchdog() {
    regs::WATCHDOG_LOAD.write(2 * WATCHDOG_US);
}

/// Ends the program: stops the motors, then has the watchdog reset the chip.
fn end() -> ! {
    regs::disable_interrupts();
    for block in 0..2 {
        if regs::RESETS_DONE.read() & regs::reset::PIO[usize::from(block)] != 0 {
            Pio(block).ctrl().write(0);
        }
    }
    regs::WATCHDOG_SCRATCH0.write(NOTE_FAULT);
    regs::WATCHDOG_CTRL.write(1 << 31 | 1 << 30);
    loop {
        core::hint::spin_loop();
    }
}

/// The handler of all faults, and of interrupts that no program has.
#[unsafe(no_mangle)]
extern "C" fn fault() -> ! {
    end()
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    end()
}
