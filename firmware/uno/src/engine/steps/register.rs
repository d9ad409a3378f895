//! Addresses of the registers that the hot path uses (ATmega328P DS40002061B §30).

macro_rules! addresses {
    ($($(#[$meta:meta])* $name:ident = $address:literal;)*) => { $($(#[$meta])* pub(crate) const $name: u8 = $address;)* };
}

// In the I/O space, for `in` and `out`; the data address is 0x20 higher.
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
    /// General purpose, bit-addressable: the flags of the step interrupts.
    GPIOR0 = 0x1e;
    /// EEPROM control, bit-addressable. While no settings are stored it has a free bit: [`RX_NO_NESTING`].
    EECR = 0x1f;
    /// EEPROM data; general purpose while no settings are stored.
    EEDR = 0x20;
    /// EEPROM address, low byte; general purpose while no settings are stored.
    EEARL = 0x21;
    /// EEPROM address, high byte (two bits, for 1024 bytes); general purpose while no settings are stored.
    EEARH = 0x22;
    /// Timer 0's counter: its overflow is the refill interrupt.
    TCNT0 = 0x26;
    /// Timer 0's compare A; general purpose, since Timer 0 does not use it.
    OCR0A = 0x27;
    /// Timer 0's compare B; general purpose.
    OCR0B = 0x28;
    /// General purpose.
    GPIOR1 = 0x2a;
    /// General purpose.
    GPIOR2 = 0x2b;
    /// Status.
    SREG = 0x3f;
}

/// Bit of EECR: EEPM0 (§8.6.3), which means nothing as long as no byte is written. While it is set the receive interrupt lets nobody in.
pub(crate) const RX_NO_NESTING: u8 = 4;

// By data address, for `lds` and `sts`.
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

/// A register's data address as a pointer.
#[inline(always)]
pub(crate) const fn data(register: u8) -> *mut u8 {
    core::ptr::without_provenance_mut(register as usize)
}
