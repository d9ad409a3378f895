//! Addresses of the registers that the hot path uses (ATmega328P DS40002061B §30).

macro_rules! addresses {
    ($($(#[$meta:meta])* $name:ident = $address:literal;)*) => { $($(#[$meta])* pub(crate) const $name: u8 = $address;)* };
}

// In the I/O space: `in` and `out` reach them; data address 0x20 higher.
addresses! {
    /// Toggles PORTB's pins when written.
    PINB = 0x03;
    /// Levels of PORTB's outputs.
    PORTB = 0x05;
    /// Toggles PORTD's pins when written.
    PIND = 0x09;
    /// Timer 0's flags, cleared by writing ones.
    TIFR0 = 0x15;
    /// Timer 1's flags, cleared by writing ones.
    TIFR1 = 0x16;
    /// Free storage, bit-addressable.
    GPIOR0 = 0x1e;
    /// EEPROM control; where nothing is kept there, [`RX_NO_NESTING`] is free storage, bit-addressable.
    EECR = 0x1f;
    /// EEPROM data; free storage but for moments at rest.
    EEDR = 0x20;
    /// EEPROM address, low byte; free storage but for moments at rest.
    EEARL = 0x21;
    /// EEPROM address, high byte: two bits (1024 bytes of EEPROM); free storage but for moments at rest.
    EEARH = 0x22;
    /// Timer 0's counter: when the task comes again.
    TCNT0 = 0x26;
    /// Timer 0's compare A; free storage.
    OCR0A = 0x27;
    /// Timer 0's compare B; free storage.
    OCR0B = 0x28;
    /// Free storage.
    GPIOR1 = 0x2a;
    /// Free storage.
    GPIOR2 = 0x2b;
    /// Status.
    SREG = 0x3f;
}

/// Bit of EECR: EEPM0 (§8.6.3), which says nothing as long as no byte is written. While it is set the receive interrupt
/// lets nobody in.
pub(crate) const RX_NO_NESTING: u8 = 4;

// Beyond it, by data address: `lds` and `sts`.
addresses! {
    /// Timer 0's interrupt mask.
    TIMSK0 = 0x6e;
    /// Timer 1's interrupt mask.
    TIMSK1 = 0x6f;
    /// Timer 1: compare output modes.
    TCCR1A = 0x80;
    /// Timer 1: force output compare.
    TCCR1C = 0x82;
    /// Timer 1's counter, low byte.
    TCNT1 = 0x84;
    /// Compare A, low byte.
    OCR1A = 0x88;
    /// Compare B, low byte.
    OCR1B = 0x8a;
}

/// The data address of a register of the I/O space.
#[inline(always)]
pub(crate) const fn io(register: u8) -> *mut u8 {
    core::ptr::without_provenance_mut(register as usize + 0x20)
}

/// A register by its data address.
#[inline(always)]
pub(crate) const fn data(register: u8) -> *mut u8 {
    core::ptr::without_provenance_mut(register as usize)
}
