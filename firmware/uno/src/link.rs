//! The serial line: USART0 at 8 bits, no parity, one stop bit.
//!
//! Bytes from the host are taken by an interrupt into half a page of 256 bytes, so that the low byte of an address is
//! all there is to a ring; EEARL, which is of no other use here, holds that of the place for the next byte. The interrupt lets the step
//! interrupts in after 15 cycles: its own enable bit is off meanwhile, so that it cannot nest in itself. Bytes to the host
//! are handed over by the main loop when the USART is free.
//!
//! A frame whose bytes were lost, here or in the USART (two bytes and one on its way, DS40002061B §20.7.3), fails its CRC.

use crate::{memory, regs};
use core::arch::global_asm;
use pulsetrain_core::wire::Baud;

/// Bytes that may wait to be read.
pub(crate) const WINDOW: u16 = PAGE as u16 - 1;

/// Bytes that the receive page has.
const PAGE: u8 = 128;

/// UCSR0B (§20.11.3): receiver and transmitter on; bit 7 is the receive interrupt.
const ON: u8 = 0x18;
const ON_WITH_INTERRUPT: u8 = ON | 0x80;

// The vector is USART_RX (§12.4). No flag is touched before the registers are back.
global_asm!(
    r#"
    .section .text.receive_interrupt, "ax", @progbits
    .global __vector_18
__vector_18:                    // 4 response + 3 jump           7
    push r24                    // 2                             9
    ldi r24, {ON}               // 1                            10
    sts {UCSR0B}, r24           // 2                            12
    sei                         // 1                            13
    push r30                    // 2: interrupts are let in behind it, after 15
    push r31                    // 2                            17
    lds r24, {UDR0}             // 2                            19
    in r30, {HEAD}              // 1                            20
    ldi r31, hi8(receive_page)  // 1                            21
    st Z+, r24                  // 2                            23
    sbrc r30, 7                 // 1 or 2: half a page, and no flag is touched
    ldi r30, 0                  // 1                            25
    out {HEAD}, r30             // 1                            26
    pop r31                     // 2                            28
    pop r30                     // 2                            30
    ldi r24, {ON_WITH_INTERRUPT} // 1                           31
    cli                         // 1                            32
    sts {UCSR0B}, r24           // 2                            34
    pop r24                     // 2                            36
    reti                        // 4                            40, 9 of them closed
    "#,
    HEAD = const crate::steps::register::EEARL,
    ON = const ON,
    ON_WITH_INTERRUPT = const ON_WITH_INTERRUPT,
    UCSR0B = const 0xc1,
    UDR0 = const 0xc6,
);

/// The line, as the main loop sees it.
pub(crate) struct Link {
    /// Low byte of the address of the next byte to be read.
    tail: u8,
    /// Most bytes that waited.
    pub(crate) most_unread: u8,
}

impl Link {
    /// Not started.
    pub(crate) const fn new() -> Link {
        Link { tail: 0, most_unread: 0 }
    }

    /// Opens the line at 115 200 baud.
    pub(crate) fn start(&mut self) {
        regs::EEARL.write(0);
        // 8 data bits, no parity, one stop bit (§20.11.4).
        regs::UCSR0C.write(0x06);
        self.set_baud(Baud::B115200);
    }

    /// Changes the rate; the last byte must be out. What came in before is dropped.
    pub(crate) fn set_baud(&mut self, baud: Baud) {
        // Double speed (U2X) throughout: 16 MHz / 8 / (n + 1), exact but for 115 200, which becomes 117 647 (+2.1 %).
        regs::UCSR0A.set(0x02);
        regs::free(|| regs::UBRR0.write(u16::from(divisor(baud) - 1)));
        self.tail = regs::EEARL.read();
        regs::UCSR0B.write(ON_WITH_INTERRUPT);
    }

    /// Whether the USART takes another byte.
    #[inline(always)]
    pub(crate) fn can_send(&self) -> bool {
        regs::UCSR0A.read() & 0x20 != 0
    }

    /// Hands over a byte; see [`Link::can_send`].
    #[inline(always)]
    pub(crate) fn send(&mut self, byte: u8) {
        regs::UDR0.write(byte);
    }

    /// Sleeps until an interrupt has run, unless bytes wait.
    #[inline(always)]
    pub(crate) fn sleep(&self) {
        regs::sleep_while_head_is(self.tail);
    }

    /// Bytes from the host, up to the end of the page, and `most`.
    #[inline(always)]
    pub(crate) fn unread(&mut self, most: u8) -> &'static [u8] {
        let unread = regs::EEARL.read().wrapping_sub(self.tail) & (PAGE - 1);
        self.most_unread = self.most_unread.max(unread);
        memory::received(self.tail, unread.min(PAGE - self.tail).min(most))
    }

    /// So many of them were read.
    #[inline(always)]
    pub(crate) fn read(&mut self, count: u8) {
        self.tail = (self.tail + count) & (PAGE - 1);
    }
}

/// 2 000 000 / `divisor` baud.
const fn divisor(baud: Baud) -> u8 {
    match baud {
        Baud::B115200 => 17,
        Baud::B250k => 8,
        Baud::B500k => 4,
        Baud::B1M => 2,
        Baud::B2M => 1,
    }
}
