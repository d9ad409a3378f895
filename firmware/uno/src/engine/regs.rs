//! The ATmega328P's registers, and the few instructions that Rust has no names for.
//!
//! Sections are those of the data sheet DS40002061B. Everything here is safe to call: no register here moves memory, and a register that an interrupt
//! uses too says so.

use core::arch::asm;

/// A register of 8 bits, by its address in data space (§36, in brackets there).
#[derive(Clone, Copy)]
pub(crate) struct Reg8(u16);

impl Reg8 {
    /// Its value.
    #[inline(always)]
    pub(crate) fn read(self) -> u8 {
        // SAFETY: only the constants below are of this type. Each is a register of this chip, which can always be read.
        unsafe { core::ptr::read_volatile(usize::from(self.0) as *const u8) }
    }

    /// Sets it.
    #[inline(always)]
    pub(crate) fn write(self, value: u8) {
        // SAFETY: as above. No register below changes what memory means to Rust.
        unsafe { core::ptr::write_volatile(usize::from(self.0) as *mut u8, value) }
    }

    /// Sets the bits of `mask`. If an interrupt changes the register too, interrupts must be off.
    #[inline(always)]
    pub(crate) fn set(self, mask: u8) {
        self.write(self.read() | mask);
    }

    /// Clears the bits of `mask`. If an interrupt changes the register too, interrupts must be off.
    #[inline(always)]
    pub(crate) fn clear(self, mask: u8) {
        self.write(self.read() & !mask);
    }
}

/// A register of 16 bits. All of Timer1's share one byte (TEMP, §16.3), so use [`critical`] where an interrupt uses one of them too.
#[derive(Clone, Copy)]
pub(crate) struct Reg16(u16);

impl Reg16 {
    /// Its value: the low byte first, which latches the high one. Interrupts must be off.
    #[inline(always)]
    pub(crate) fn read(self) -> u16 {
        let low = Reg8(self.0).read();
        u16::from_le_bytes([low, Reg8(self.0 + 1).read()])
    }

    /// Its high byte. That needs no critical section: only counters are latched on reading.
    #[inline(always)]
    pub(crate) fn high(self) -> u8 {
        Reg8(self.0 + 1).read()
    }

    /// Sets it: the high byte first, which waits for the low one. Interrupts must be off.
    #[inline(always)]
    pub(crate) fn write(self, value: u16) {
        let [low, high] = value.to_le_bytes();
        Reg8(self.0 + 1).write(high);
        Reg8(self.0).write(low);
    }
}

/// A port of eight pins, by the address of its PORTx (§14.4); DDRx is the one before.
#[derive(Clone, Copy)]
pub(crate) struct Port(u8);

impl Port {
    /// PORTx: the levels of outputs.
    #[inline(always)]
    pub(crate) fn levels(self) -> Reg8 {
        Reg8(u16::from(self.0))
    }

    /// DDRx: which pins are outputs.
    #[inline(always)]
    pub(crate) fn direction(self) -> Reg8 {
        Reg8(u16::from(self.0 - 1))
    }
}

/// No port.
pub(crate) const NO_PORT: Port = Port(0);
/// Port B: pins 8 to 13.
pub(crate) const PORT_B: Port = Port(0x25);
/// Port C: pins A0 to A5.
pub(crate) const PORT_C: Port = Port(0x28);
/// Port D: pins 0 to 7.
pub(crate) const PORT_D: Port = Port(0x2b);

/// §16.11.9: flags of Timer1, cleared by writing ones.
pub(crate) const TIFR1: Reg8 = Reg8(0x36);
/// §8.6.6: general purpose; the [`flags`](crate::engine::steps::ring::flags) of the step interrupts.
pub(crate) const GPIOR0: Reg8 = Reg8(0x3e);
/// §8.6.1: the EEPROM's address; the head of the receive page, except while [`store`](crate::engine::store) runs.
pub(crate) const EEARL: Reg8 = Reg8(0x41);
/// §10.11.1: sleep mode and enable.
pub(crate) const SMCR: Reg8 = Reg8(0x53);
/// §11.9.1: why the chip was reset.
pub(crate) const MCUSR: Reg8 = Reg8(0x54);
/// §7.5.1: the stack pointer. Only read.
pub(crate) const SP: Reg16 = Reg16(0x5d);
/// §7.3.1.
pub(crate) const SREG: Reg8 = Reg8(0x5f);
/// §11.9.2.
pub(crate) const WDTCSR: Reg8 = Reg8(0x60);
/// §16.11.8.
pub(crate) const TIMSK1: Reg8 = Reg8(0x6f);
/// §16.11.1.
pub(crate) const TCCR1A: Reg8 = Reg8(0x80);
/// §16.11.2.
pub(crate) const TCCR1B: Reg8 = Reg8(0x81);
/// §16.11.4.
pub(crate) const TCNT1: Reg16 = Reg16(0x84);
/// §16.11.5.
pub(crate) const OCR1A: Reg16 = Reg16(0x88);
/// §16.11.6.
pub(crate) const OCR1B: Reg16 = Reg16(0x8a);
/// §15.9: Timer0.
pub(crate) const TCCR0B: Reg8 = Reg8(0x45);
pub(crate) const TCNT0: Reg8 = Reg8(0x46);
pub(crate) const TIMSK0: Reg8 = Reg8(0x6e);
/// §20.11: USART0.
pub(crate) const UCSR0A: Reg8 = Reg8(0xc0);
pub(crate) const UCSR0B: Reg8 = Reg8(0xc1);
pub(crate) const UCSR0C: Reg8 = Reg8(0xc2);
pub(crate) const UBRR0: Reg16 = Reg16(0xc4);
pub(crate) const UDR0: Reg8 = Reg8(0xc6);

/// Runs `work` with interrupts off, and restores the flag. `work` adds to the longest time that an interrupt can be kept waiting, so it must be a few
/// instructions only.
#[inline(always)]
pub(crate) fn critical<R>(work: impl FnOnce() -> R) -> R {
    let status = critical_begin();
    let result = work();
    critical_end(status);
    result
}

/// Disables interrupts; gives what [`critical_end`] needs.
#[inline(always)]
pub(crate) fn critical_begin() -> u8 {
    let status = SREG.read();
    // SAFETY: turning interrupts off breaks no rule of Rust's. The block also keeps the compiler from moving memory accesses across it.
    unsafe { asm!("cli") };
    status
}

/// Restores the interrupt flag.
#[inline(always)]
pub(crate) fn critical_end(status: u8) {
    // SAFETY: a barrier for the compiler, no instruction.
    unsafe { asm!("") };
    SREG.write(status);
}

/// The count of Timer1. Interrupts are off for 6 cycles, because all its registers share one byte (§16.3).
#[inline(always)]
pub(crate) fn timer1() -> u16 {
    let (low, high): (u8, u8);
    // SAFETY: reads a counter, and leaves the flags as they were.
    unsafe {
        asm!(
            "in {status}, 0x3f",
            "cli",
            "lds {low}, 0x84",
            "lds {high}, 0x85",
            "out 0x3f, {status}",
            status = out(reg) _,
            low = out(reg) low,
            high = out(reg) high,
            options(nomem, nostack, preserves_flags),
        );
    }
    u16::from_le_bytes([low, high])
}

/// The compiler moves no memory access across this.
#[inline(always)]
pub(crate) fn barrier() {
    // SAFETY: no instruction.
    unsafe { asm!("") };
}

/// Enables interrupts.
#[inline(always)]
pub(crate) fn enable_interrupts() {
    // SAFETY: the interrupts of this firmware touch registers, their own page, and nothing that Rust holds a reference to.
    unsafe { asm!("sei") };
}

/// Disables interrupts.
#[inline(always)]
pub(crate) fn disable_interrupts() {
    // SAFETY: breaks no rule of Rust's.
    unsafe { asm!("cli") };
}

/// Sleeps until an interrupt has run, if [`EEARL`] is `head` and `SMCR` allows it. Interrupts are on afterwards. They are off for 5 cycles, and none can
/// come between the test and the sleep, since `sei` lets one more instruction run (§7.7).
#[inline(always)]
pub(crate) fn sleep_while_head_is(head: u8) {
    // SAFETY: as `enable_interrupts`.
    unsafe {
        asm!(
            "cli",
            "in {now}, {EEARL}",
            "cpse {now}, {head}",
            "rjmp 1f",
            "sei",
            "sleep",
            "1: sei",
            now = out(reg) _,
            head = in(reg) head,
            EEARL = const crate::engine::steps::register::EEARL,
        );
    }
}

/// Reads [`EEARL`] up to 192 times, as long as it is `head`. Gives how many cycles that took, without those of interrupts.
#[inline(always)]
pub(crate) fn watch_while_head_is(head: u8) -> u16 {
    let mut cycles: u16 = 0;
    // SAFETY: reads a register.
    unsafe {
        asm!(
            "1: in {now}, {EEARL}", // 1
            "cp {now}, {head}",     // 1
            "brne 2f",              // 1
            "adiw {cycles}, 8",     // 2
            "cpi {cycles:h}, 6",    // 1
            "brne 1b",              // 2: 8 together
            "2:",
            now = out(reg) _,
            head = in(reg) head,
            cycles = inout(reg_iw) cycles,
            EEARL = const crate::engine::steps::register::EEARL,
        );
    }
    cycles
}

/// A byte of the flash.
#[inline(always)]
pub(crate) fn flash(at: u16) -> u8 {
    let byte;
    // SAFETY: no program of ours changes the flash; every address is one of its 32 KiB.
    unsafe { asm!("lpm {byte}, Z", byte = out(reg) byte, in("Z") at, options(pure, nomem, nostack, preserves_flags)) };
    byte
}

/// Restarts the watchdog.
#[inline(always)]
pub(crate) fn kick_watchdog() {
    // SAFETY: breaks no rule of Rust's.
    unsafe { asm!("wdr") };
}
