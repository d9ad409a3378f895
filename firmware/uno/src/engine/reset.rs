//! How the program begins and ends: the watchdog, and the cause of the last reset.
//!
//! The main loop restarts the watchdog every round. If it does not for a second, the watchdog's interrupt stops all motors at once, leaves a note in RAM,
//! and lets the watchdog reset the chip. A panic, which no input reaches, ends in the same way.
//!
//! Bootloaders clear MCUSR, so that it often says nothing (§11.9.1). The note in RAM survives a reset, but not the loss of power, and so tells the reset
//! line from power-on.

use crate::engine::{memory, regs};
use core::arch::global_asm;
use pulsetrain_core::wire::message::Cause;

/// The note: the program ran before this reset.
const RAN: u8 = 0x5a;
/// The note: the program was ended by the watchdog, or by a panic.
const ENDED: u8 = 0xa6;

// Interrupt WDT (§12.4). Nothing returns from here: 16 ms later the watchdog overflows again and resets the chip (§11.9.2).
global_asm!(
    r#"
    .section .text.watchdog_interrupt, "ax", @progbits
    .global wdt, end_of_program, end_of_program_loop
wdt:
end_of_program:
    cli
    ldi r24, 0
    sts {TIMSK1}, r24
    sts {TCCR1A}, r24
    ldi r24, {ENDED}
    sts reset_note, r24
    sts reset_note+1, r24
    ldi r24, 0x18
    sts {WDTCSR}, r24
    ldi r24, 0x08
    sts {WDTCSR}, r24
end_of_program_loop:
    rjmp end_of_program_loop

    .section .noinit, "aw", @nobits
    .global reset_note
reset_note: .skip 2
    "#,
    TIMSK1 = const 0x6f,
    TCCR1A = const 0x80,
    WDTCSR = const 0x60,
    ENDED = const ENDED,
);

/// Ends the program: motors stop, the watchdog resets the chip.
pub(crate) fn end() -> ! {
    memory::end_of_program()
}

/// The cause of the last reset. Starts the watchdog.
pub(crate) fn begin() -> Cause {
    let flags = regs::MCUSR.read();
    regs::MCUSR.write(0);
    regs::disable_interrupts();
    regs::kick_watchdog();
    // Time-out 1 s, first an interrupt, then a reset. Both writes must be within four cycles (§11.9.2).
    regs::WDTCSR.write(0x18);
    regs::WDTCSR.write(0x4e);
    let note = memory::exchange_reset_note(u16::from_le_bytes([RAN; 2]));
    if flags & 0x08 != 0 || note == u16::from_le_bytes([ENDED; 2]) {
        Cause::Watchdog
    } else if flags & 0x01 != 0 {
        Cause::PowerOn
    } else if flags & 0x04 != 0 {
        Cause::BrownOut
    } else if flags & 0x02 != 0 || note == u16::from_le_bytes([RAN; 2]) {
        Cause::ResetLine
    } else {
        Cause::PowerOn
    }
}
