//! Settings in the EEPROM, which keeps them without power (DS40002061B §8.4, §8.6): from address 0 on, followed by their CRC.
//!
//! Otherwise the EEPROM's address register holds the head of the receive page and the page of ring B (link.rs, steps/ring.rs), and its data register
//! belongs to the step interrupts. So both are restored, and no motor moves while they are used.

use crate::engine::{clock, link, regs};
use core::arch::global_asm;
use pulsetrain_core::wire::frame::check;
use pulsetrain_core::wire::settings::SETTINGS_LEN;

// store_get: reads r20 bytes of the EEPROM, from address r22 on, to r24:25. Interrupts are off for 16 cycles, during 4 of which the processor is halted.
// store_put: writes r22 to address r24, unless it is there already. It returns when the byte is written, 3.4 ms later. The line is closed and nothing
// moves, so that nobody else uses the address register.
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

/// Reads the settings. `false`, and zeros, if none were stored or they are damaged. No motor may move.
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
    // SAFETY: `into` has so many bytes.
    unsafe { store_get(into.as_mut_ptr(), at, into.len() as u8) }
}

/// Stores `settings`: 3.4 ms for each byte that changes. Bytes that come on the line meanwhile are lost, and the host sends them again. No motor may be
/// powered.
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
        // The clock must be read every 4 ms.
        clock::moment();
    }
}
