//! The serial line: USART0 at 8 bits, no parity, one stop bit.
//!
//! # What is here
//! - this file: the receive interrupt (USART_RX), baud rates, bytes to the host
//! - [`receive`]: from bytes to frames
//!
//! The receive interrupt puts bytes into a circular buffer of 128 bytes, half of a page of RAM: so the low byte of an address is enough to point into it.
//! EEARL, which is free while no settings are stored, holds the head. After 14 cycles the interrupt lets the step interrupts in. It cannot nest in
//! itself, because its own enable bit is off meanwhile. The main loop sends bytes to the host when the USART is free.
//!
//! While [`RX_NO_NESTING`](crate::engine::steps::register::RX_NO_NESTING) is set, the interrupt lets nobody in and takes 30 cycles instead of 43. The
//! refill sets it where steps have the time to wait: with one fast motor, or two that the compare hardware steps, and only plain steps in their rings.
//!
//! A byte is lost when two and a third wait in the USART (DS40002061B §20.7.3), or when the main loop is 128 bytes behind. Both are counted, and the
//! frame fails its CRC.

mod receive;

pub(crate) use receive::{LONGEST_BODY, Receiver, Unread};

use crate::engine::regs;
use crate::engine::steps::register;
use core::arch::global_asm;
use pulsetrain_core::wire::Baud;

/// Bytes that may wait to be read.
pub(crate) const WINDOW: u16 = PAGE as u16 - 1;

/// Bytes of the receive page.
pub(crate) const PAGE: u8 = 128;

/// UCSR0B (§20.11.3): receiver and transmitter on; bit 7 is the receive interrupt.
pub(crate) const ON: u8 = 0x18;
pub(crate) const ON_WITH_INTERRUPT: u8 = ON | 0x80;

/// The receive interrupt nests again, until the refill says otherwise: other events than plain steps must be played in time.
#[inline(always)]
pub(crate) fn nest_again() {
    // SAFETY: nobody else writes the bit meanwhile: the refill is kept out, or this is the refill.
    unsafe {
        core::arch::asm!("cbi {}, {}", const register::EECR, const register::RX_NO_NESTING);
    }
}

/// UCSR0B: the transmitter alone.
const CLOSED: u8 = 0x08;

/// The interrupt USART_RX. It lies at its vector (vectors.rs), which saves a jump. Up to the first `pop` no instruction changes a flag.
macro_rules! receive_interrupt {
    () => {
        r#"
    .macro receive_count_lost           // keeps flags and registers
    in r24, {SREG}
    push r24
    lds r24, receive_lost
    inc r24
    sts receive_lost, r24
    pop r24
    out {SREG}, r24
    .endm
    // 4 response                       //                              4
    sbic {EECR}, {RX_NO_NESTING}        // 2 (skips): one more than here in all
    rjmp 5f
    push r24                            // 2                             6
    ldi r24, {ON}                       // 1                             7
    sts {UCSR0B}, r24                   // 2                             9
    sei                                 // 1                            10
    push r30                            // 2: interrupts are let in behind it, after 14
    in r30, {HEAD}                      // 1                            14
    push r31                            // 2                            16
    ldi r31, hi8(receive_page)          // 1                            17
    lds r24, {UCSR0A}                   // 2                            19
    sbrc r24, {OVERRUN}                 // 2 (skips)                    21
    rjmp 3f
1:  lds r24, {UDR0}                     // 2                            23
    st Z+, r24                          // 2                            25
    sbrc r30, {PAGE_BIT}                // 2 (skips)                    27
    rjmp 4f
2:  out {HEAD}, r30                     // 1                            28
    pop r31                             // 2                            30
    pop r30                             // 2                            32
    ldi r24, {ON_WITH_INTERRUPT}        // 1                            33
    cli                                 // 1                            34
    sts {UCSR0B}, r24                   // 2                            36
    pop r24                             // 2                            38
    reti                                // 4                            42, 9 of them closed

    // A byte was lost before this one.
3:  receive_count_lost
    rjmp 1b

    // The end of the page: another lap.
4:  in r24, {SREG}
    push r24
    lds r24, receive_lap
    subi r24, {PAGE}
    sts receive_lap, r24
    pop r24
    out {SREG}, r24
    ldi r30, 0
    rjmp 2b

    // Without nesting: registers are saved where the step interrupts save them.                sbic 1 + rjmp 2: 7
5:  out {SAVE24}, r24                   // 1                             8
    out {SAVE30}, r30                   // 1                             9
    out {SAVE31}, r31                   // 1                            10
    in r30, {HEAD}                      // 1                            11
    ldi r31, hi8(receive_page)          // 1                            12
    lds r24, {UCSR0A}                   // 2                            14
    sbrc r24, {OVERRUN}                 // 2 (skips)                    16
    rjmp 8f
6:  lds r24, {UDR0}                     // 2                            18
    st Z+, r24                          // 2                            20
    sbrc r30, {PAGE_BIT}                // 2 (skips)                    22
    rjmp 9f
7:  out {HEAD}, r30                     // 1                            23
    in r24, {SAVE24}                    // 1                            24
    in r30, {SAVE30}                    // 1                            25
    in r31, {SAVE31}                    // 1                            26
    reti                                // 4                            30
8:  receive_count_lost
    rjmp 6b
9:  lds r24, receive_lap                // 11 more: no flag is touched
    ldi r30, {PAGE}
    sbrc r24, {PAGE_BIT}
    ldi r30, 0
    sts receive_lap, r30
    ldi r30, 0
    rjmp 7b
    "#
    };
}

pub(crate) use receive_interrupt;

global_asm!(
    r#"
    .section .bss.receive_interrupt, "aw", @nobits
    .global receive_lap, receive_lost
receive_lap: .skip 1
receive_lost: .skip 1
    "#
);

/// Opens the line at 115 200 baud.
pub(crate) fn start() {
    regs::EEARL.write(0);
    // 8 data bits, no parity, one stop bit (§20.11.4).
    regs::UCSR0C.write(0x06);
    set_baud(Baud::B115200);
}

/// In place of [`start`] in a program without a line: frees the pins, which the bootloader used. The receive interrupt is enabled, as the refill
/// expects it, but never comes.
pub(crate) fn leave() {
    regs::UCSR0B.write(0x80);
}

/// Changes the baud rate. The last byte must be out. Drop what came in before: [`Receiver::reset`].
#[inline(never)]
pub(crate) fn set_baud(baud: Baud) {
    // Double speed (U2X) always: 16 MHz / 8 / (n + 1). That is exact but for 115 200, which becomes 117 647 (+2.1 %).
    regs::UCSR0A.set(0x02);
    regs::critical(|| regs::UBRR0.write(u16::from(divisor(baud) - 1)));
    open();
}

/// Closes the receiver until [`open`]. What came is dropped (§20.8.6).
pub(crate) fn close() {
    regs::UCSR0B.write(CLOSED);
}

/// Opens the receiver.
pub(crate) fn open() {
    regs::UCSR0B.write(ON_WITH_INTERRUPT);
}

/// Whether the USART takes another byte.
#[inline(always)]
pub(crate) fn can_send() -> bool {
    regs::UCSR0A.read() & 0x20 != 0
}

/// Sends a byte; see [`can_send`].
#[inline(always)]
pub(crate) fn send(byte: u8) {
    regs::UDR0.write(byte);
}

/// The rate is 2 000 000 baud / `divisor`.
const fn divisor(baud: Baud) -> u8 {
    match baud {
        Baud::B115200 => 17,
        Baud::B250k => 8,
        Baud::B500k => 4,
        Baud::B1M => 2,
        Baud::B2M => 1,
    }
}
