//! The board's clock: Timer1 at 16 MHz, extended to 64 bits. It must be read at least once in 65 536 ticks (4.1 ms), or a wrap is missed.

use crate::engine::regs;
use crate::engine::steps::refill;
use core::arch::global_asm;
use pulsetrain_core::Tick32;

pub(crate) use pulsetrain_core::boards::uno::TICK_HZ;

// clock_moment: gives the lower half of the clock in r22 to r25, as C does. When Timer1 shows less than last time, it has wrapped.
// Interrupts are off for 6 cycles, since all registers of Timer1 share one byte for their high halves (DS40002061B §16.3).
// clock_moment_alone: the same for main; it keeps the refill interrupt out.
global_asm!(
    r#"
    .section .bss.clock, "aw", @nobits
    .global clock
clock: .skip 8                          // little-endian

    .section .text.clock_moment, "ax", @progbits
    .global clock_moment, clock_moment_alone
clock_moment_alone:
    lds r30, {TIMSK0}
    push r30
    sts {TIMSK0}, r1
    rcall clock_moment
    pop r30
    sts {TIMSK0}, r30
    ret
clock_moment:
    in r18, 0x3f
    cli
    lds r22, {TCNT1}
    lds r23, {TCNT1}+1
    out 0x3f, r18
    lds r18, clock
    lds r19, clock+1
    lds r24, clock+2
    lds r25, clock+3
    sts clock, r22
    sts clock+1, r23
    cp r22, r18
    cpc r23, r19
    brcc 2f
    adiw r24, 1
    sts clock+2, r24
    sts clock+3, r25
    brcc 2f
    ldi r30, lo8(clock+4)
    ldi r31, hi8(clock+4)
1:  ld r18, Z                           // the upper half, once in four minutes
    subi r18, -1
    st Z+, r18
    breq 1b                             // ends: it would take 9000 years to wrap
2:  ret
    "#,
    TCNT1 = const crate::engine::steps::register::TCNT1,
    TIMSK0 = const crate::engine::steps::register::TIMSK0,
);

unsafe extern "C" {
    safe fn clock_moment_alone() -> u32;
    #[link_name = "clock"]
    static mut CLOCK: u64;
}

/// Starts Timer1 at tick 0: normal mode, no prescaler, output pins not connected (DS40002061B §16.11.1-2).
pub(crate) fn start() {
    regs::TCCR1B.write(0);
    regs::TCCR1A.write(0);
    regs::TIMSK1.write(0);
    regs::critical(|| regs::TCNT1.write(0));
    regs::TCCR1B.write(1);
}

/// Ticks since start-up, modulo 2^32.
#[inline(always)]
pub(crate) fn moment() -> Tick32 {
    Tick32(clock_moment_alone())
}

/// Ticks since start-up.
#[inline(never)]
pub(crate) fn now() -> u64 {
    let _out = refill::block();
    moment();
    // SAFETY: only `clock_moment` writes it, and the refill interrupt, which calls it too, is kept out.
    unsafe { CLOCK }
}

/// The count of Timer1 at a tick.
#[inline(always)]
pub(crate) const fn low_half(moment: u32) -> u16 {
    let [b0, b1, _, _] = moment.to_le_bytes();
    u16::from_le_bytes([b0, b1])
}

/// The count of Timer1 now.
#[inline(always)]
pub(crate) fn read() -> u16 {
    regs::timer1()
}
