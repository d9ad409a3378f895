//! The serial line: USART0 at 8 bits, no parity, one stop bit.
//!
//! Bytes from the host are taken by an interrupt into a page of 256 bytes, so that the low byte of an address is all there
//! is to a ring. It lets the step interrupts in after 13 cycles: its own enable bit is off meanwhile, so that it cannot
//! nest in itself. Bytes to the host are handed over by the main loop when the USART is free.
//!
//! | register | holds |
//! |---|---|
//! | TCNT0 | low byte of the address for the next byte that comes |
//! | EEARL | r24 of whoever was interrupted |
//!
//! A frame whose bytes were lost, here or in the USART (two bytes and one on its way, DS40002061B §20.7.3), fails its CRC.

use crate::{memory, regs};
use core::arch::global_asm;
use pulsetrain_core::wire::Baud;

/// Bytes that may wait to be read.
pub(crate) const WINDOW: u16 = 255;

/// UCSR0B (§20.11.3): receiver and transmitter on; bit 7 is the receive interrupt.
const ON: u8 = 0x18;
const ON_WITH_INTERRUPT: u8 = ON | 0x80;

// The vector is USART_RX (§12.4). No flag is touched before the registers are back.
global_asm!(
    r#"
    .section .text.receive_interrupt, "ax", @progbits
    .global __vector_18
__vector_18:                    // 4 response + 3 jump           7
    out {SAVE24}, r24           // 1                             8
    ldi r24, {ON}               // 1                             9
    sts {UCSR0B}, r24           // 2                            11
    sei                         // 1                            12
    push r30                    // 2: interrupts are let in after its start, 13 at the latest here
    push r31                    // 2                            16
    lds r24, {UDR0}             // 2                            18
    in r30, {HEAD}              // 1                            19
    ldi r31, hi8(receive_page)  // 1                            20
    st Z+, r24                  // 2                            22
    out {HEAD}, r30             // 1                            23
    pop r31                     // 2                            25
    pop r30                     // 2                            27
    ldi r24, {ON_WITH_INTERRUPT} // 1                           28
    cli                         // 1                            29
    sts {UCSR0B}, r24           // 2                            31
    in r24, {SAVE24}            // 1                            32
    reti                        // 4                            36, 8 of them closed
    "#,
    SAVE24 = const 0x21,
    HEAD = const 0x26,
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
    /// The line at 115 200 baud.
    pub(crate) fn start() -> Link {
        regs::TCCR0B.write(0);
        regs::TCNT0.write(0);
        let mut link = Link { tail: 0, most_unread: 0 };
        // 8 data bits, no parity, one stop bit (§20.11.4).
        regs::UCSR0C.write(0x06);
        link.set_baud(Baud::B115200);
        link
    }

    /// Changes the rate; the last byte must be out (see [`Link::is_quiet`]). What came in before is dropped.
    pub(crate) fn set_baud(&mut self, baud: Baud) {
        regs::UCSR0B.write(0);
        // Double speed (U2X) throughout: 16 MHz / 8 / (n + 1), exact but for 115 200, which becomes 117 647 (+2.1 %).
        regs::UCSR0A.write(0x42);
        regs::free(|| regs::UBRR0.write(u16::from(divisor(baud) - 1)));
        self.tail = regs::TCNT0.read();
        regs::UCSR0B.write(ON_WITH_INTERRUPT);
    }

    /// Whether all that was sent has left the pin.
    pub(crate) fn is_quiet(&self) -> bool {
        // TXC0 is set when the shift register is empty (§20.11.2) and cleared by `send`.
        regs::UCSR0A.read() & 0x60 == 0x60
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
        // Writing a one clears TXC0; U2X stays.
        regs::UCSR0A.write(0x42);
    }

    /// Whether bytes wait.
    #[inline(always)]
    pub(crate) fn has_unread(&self) -> bool {
        regs::TCNT0.read() != self.tail
    }

    /// The next byte from the host.
    #[inline(always)]
    pub(crate) fn receive(&mut self) -> Option<u8> {
        let unread = regs::TCNT0.read().wrapping_sub(self.tail);
        if unread == 0 {
            return None;
        }
        self.most_unread = self.most_unread.max(unread);
        let byte = memory::received(self.tail);
        self.tail = self.tail.wrapping_add(1);
        Some(byte)
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
