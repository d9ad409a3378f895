//! The ATmega328P's registers, and the few instructions that Rust has no words for.
//!
//! Sections are those of the data sheet DS40002061B. Everything here is safe to call: no register here moves memory, and what
//! the interrupts share is said where it is shared. `unsafe` is needed elsewhere only where assembly is called, or memory at a
//! fixed address used.

use core::arch::asm;

/// A register of 8 bits, by its address in data space (§36, in brackets there).
#[derive(Clone, Copy)]
pub(crate) struct Reg8(u16);

impl Reg8 {
    /// What it holds.
    #[inline(always)]
    pub(crate) fn read(self) -> u8 {
        // SAFETY: only the constants below make one of these; each is a register of this chip, always there to be read.
        unsafe { core::ptr::read_volatile(usize::from(self.0) as *const u8) }
    }

    /// Sets it.
    #[inline(always)]
    pub(crate) fn write(self, value: u8) {
        // SAFETY: as above; no register among the constants below changes what memory means to Rust.
        unsafe { core::ptr::write_volatile(usize::from(self.0) as *mut u8, value) }
    }

    /// Sets the bits of `mask`. Not for registers that an interrupt changes too, unless interrupts are off.
    #[inline(always)]
    pub(crate) fn set(self, mask: u8) {
        self.write(self.read() | mask);
    }

    /// Clears the bits of `mask`. Not for registers that an interrupt changes too, unless interrupts are off.
    #[inline(always)]
    pub(crate) fn clear(self, mask: u8) {
        self.write(self.read() & !mask);
    }
}

/// A register of 16 bits. All of Timer1's share one byte (TEMP, §16.3): reading and writing go through [`free`] where an
/// interrupt uses it too.
#[derive(Clone, Copy)]
pub(crate) struct Reg16(u16);

impl Reg16 {
    /// What it holds: low byte first, which latches the high one. Interrupts must be off.
    #[inline(always)]
    pub(crate) fn read(self) -> u16 {
        let low = Reg8(self.0).read();
        u16::from_le_bytes([low, Reg8(self.0 + 1).read()])
    }

    /// Its high byte, which no other register shares on reading: only counters are latched.
    #[inline(always)]
    pub(crate) fn high(self) -> u8 {
        Reg8(self.0 + 1).read()
    }

    /// Sets it: high byte first, which waits for the low one. Interrupts must be off.
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

/// None: no register is there to be touched.
pub(crate) const NO_PORT: Port = Port(0);
/// Port B: pins 8 to 13.
pub(crate) const PORT_B: Port = Port(0x25);
/// Port C: pins A0 to A5.
pub(crate) const PORT_C: Port = Port(0x28);
/// Port D: pins 0 to 7.
pub(crate) const PORT_D: Port = Port(0x2b);

/// §16.11.9: flags of Timer1, cleared by writing ones.
pub(crate) const TIFR1: Reg8 = Reg8(0x36);
/// §8.6.6: free storage; [`flags`](crate::engine::steps::ring::flags) of the step interrupts.
pub(crate) const GPIOR0: Reg8 = Reg8(0x3e);
/// §8.6.1: the EEPROM's address, free storage but for moments at rest: [`store`](crate::engine::store).
pub(crate) const EEARL: Reg8 = Reg8(0x41);
/// §10.11.1: sleep mode and enable.
pub(crate) const SMCR: Reg8 = Reg8(0x53);
/// §11.9.1: why the chip was reset.
pub(crate) const MCUSR: Reg8 = Reg8(0x54);
/// §7.5.1: the stack pointer. Only to be read.
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

/// Runs `work` with interrupts off, and puts the flag back as it was. What is in `work` counts into the longest time that
/// an interrupt can be kept waiting: a few instructions, no more.
#[inline(always)]
pub(crate) fn free<R>(work: impl FnOnce() -> R) -> R {
    let status = free_begin();
    let result = work();
    free_end(status);
    result
}

/// Interrupts off; what [`free_end`] needs.
#[inline(always)]
pub(crate) fn free_begin() -> u8 {
    let status = SREG.read();
    // SAFETY: turning interrupts off breaks no rule of Rust's. The assembler block also keeps the compiler from moving
    // memory accesses out of the stretch.
    unsafe { asm!("cli") };
    status
}

/// Interrupts as they were.
#[inline(always)]
pub(crate) fn free_end(status: u8) {
    // SAFETY: a barrier for the compiler, no instruction.
    unsafe { asm!("") };
    SREG.write(status);
}

/// Timer1's counter. Interrupts are off for 6 cycles, because they use the byte that all its registers share (§16.3).
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

/// The compiler moves no access to memory across this.
#[inline(always)]
pub(crate) fn barrier() {
    // SAFETY: no instruction.
    unsafe { asm!("") };
}

/// Lets interrupts in.
#[inline(always)]
pub(crate) fn enable_interrupts() {
    // SAFETY: the interrupts of this firmware touch registers, their own page and nothing that Rust holds a reference to.
    unsafe { asm!("sei") };
}

/// Keeps interrupts out from here on.
#[inline(always)]
pub(crate) fn disable_interrupts() {
    // SAFETY: breaks no rule of Rust's.
    unsafe { asm!("cli") };
}

/// Sleeps until an interrupt has run, if [`EEARL`] is `head` and `SMCR` allows it. Interrupts are on afterwards; they are off for
/// 5 cycles, and the sleep itself is one more before any comes in (§7.7): so none can slip in between.
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

/// Looks at [`EEARL`] 192 times, as long as it is `head`, and gives how many cycles that took, those of interrupts not counted.
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

/// The byte of the flash at an address.
#[inline(always)]
pub(crate) fn flash(at: u16) -> u8 {
    let byte;
    // SAFETY: reads what no program of ours changes; every address is one of the flash's 32 KiB.
    unsafe { asm!("lpm {byte}, Z", byte = out(reg) byte, in("Z") at, options(pure, nomem, nostack, preserves_flags)) };
    byte
}

/// Restarts the watchdog's time.
#[inline(always)]
pub(crate) fn kick_watchdog() {
    // SAFETY: breaks no rule of Rust's.
    unsafe { asm!("wdr") };
}
