//! Settings in the EEPROM, which keeps them without power (DS40002061B §8.4, §8.6): from address 0 on, and their CRC behind them.
//!
//! The EEPROM's address register holds the head of the receive page and the page of ring B otherwise (link.rs, steps/ring.rs), its
//! data register is the step interrupts': both are put back, and no motor moves while they are used.

use crate::engine::{clock, link, regs};
use core::arch::global_asm;
use pulsetrain_core::wire::frame::check;
use pulsetrain_core::wire::settings::SETTINGS_LEN;

// store_get: r20 bytes of the EEPROM, from r22 on, to r24:25. Interrupts are off for 16 cycles, 4 of which the processor is
// halted for.
// store_put: r22 to r24, unless it is there already; returns when it is done, 3.4 ms later. Nothing comes from the line, and nothing
// moves, so that nobody else uses the address.
global_asm!(
    r#"
    .section .text.store, "ax", @progbits
    .global store_get, store_put
store_get:
    movw r26, r24
    in r21, {SREG}
1:  cli
    in r18, {EEARL}
    in r19, {EEARH}
    out {EEARH}, r1
    out {EEARL}, r22
    sbi {EECR}, 0                       // EERE
    in r23, {EEDR}
    out {EEARL}, r18
    out {EEARH}, r19
    out {SREG}, r21
    st X+, r23
    inc r22
    dec r20
    brne 1b
    ret
store_put:
    in r18, {EEARL}
    in r19, {EEARH}
    out {EECR}, r1                      // erase and write
    out {EEARH}, r1
    out {EEARL}, r24
    sbi {EECR}, 0
    in r23, {EEDR}
    cp r23, r22
    breq 2f
    out {EEDR}, r22
    in r21, {SREG}
    cli
    sbi {EECR}, 2                       // EEMPE allows EEPE for four cycles
    sbi {EECR}, 1
    out {SREG}, r21
1:  sbic {EECR}, 1
    rjmp 1b
2:  out {EEARL}, r18
    out {EEARH}, r19
    ret
    "#,
    SREG = const crate::engine::steps::register::SREG,
    EECR = const crate::engine::steps::register::EECR,
    EEDR = const crate::engine::steps::register::EEDR,
    EEARL = const crate::engine::steps::register::EEARL,
    EEARH = const crate::engine::steps::register::EEARH,
);

unsafe extern "C" {
    fn store_get(to: *mut u8, at: u8, count: u8);
    safe fn store_put(at: u8, byte: u8);
}

/// What is kept, into `settings`; zeros, and `false`, if nothing was stored, or it was damaged. While no motor moves.
#[inline(never)]
pub(crate) fn read(settings: &mut [u8; SETTINGS_LEN]) -> bool {
    let mut sum = [0; 2];
    get(0, settings);
    get(SETTINGS_LEN as u8, &mut sum);
    let kept = check(settings) == sum;
    if !kept {
        settings.fill(0);
    }
    kept
}

#[inline(always)]
fn get(at: u8, into: &mut [u8]) {
    // SAFETY: so many bytes are there to be written.
    unsafe { store_get(into.as_mut_ptr(), at, into.len() as u8) }
}

/// Keeps `settings`: 3.4 ms for each byte that is another than before. What comes on the line meanwhile is lost; the host sends it
/// again. While no motor is powered.
#[inline(never)]
pub(crate) fn write(settings: &[u8; SETTINGS_LEN]) {
    link::close();
    put(0, settings);
    put(SETTINGS_LEN as u8, &check(settings));
    link::open();
}

#[inline(never)]
fn put(at: u8, bytes: &[u8]) {
    for (at, byte) in (at..).zip(bytes) {
        store_put(at, *byte);
        regs::kick_watchdog();
        // Which must be looked at every 4 ms.
        clock::moment();
    }
}
