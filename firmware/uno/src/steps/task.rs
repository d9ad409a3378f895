//! The task that keeps the rings filled: it comes again and again, whatever the main loop is doing, and is itself
//! interrupted by steps and by bytes from the line.
//!
//! The overflow of Timer0 calls it (normal mode, DS40002061B §15.7.1, 64 cycles a count), again when a quarter of the time has
//! passed that the rings were filled for: the rest is left for whatever keeps the task waiting. Compare matches of Timer1 go
//! before it. It runs with its own interrupt off, so that it does not nest; and not inside the receive interrupt, which would
//! then lose bytes: it comes back a little later.
//!
//! What it works on, the [`Stepper`], belongs to whoever holds the [`Guard`]: main takes it with [`lock`], which keeps the task
//! out as long as it lives. Rings last for a while: no guard may be held for longer than about 2000 cycles while motors move (a
//! position, which takes a look at every group, is the longest).

use super::stepper::Stepper;
use crate::winch::feed;
use crate::{clock, regs};
use core::arch::global_asm;
use core::cell::UnsafeCell;
use core::ops::{Deref, DerefMut};

/// Counts of 64 cycles until the next call, at least. At most it is 255: a quarter of what Timer1 counts.
const SOONEST: u8 = 4;

/// The same while the winch drives, at most: a call works out one slice, and takes most of one.
const SLICES: u8 = 64;

struct Place(UnsafeCell<Stepper>);

// SAFETY: main uses it under a guard, the task while there is none.
unsafe impl Sync for Place {}

static STEPPER: Place = Place(UnsafeCell::new(Stepper::new()));

/// Keeps the task out as long as it lives.
pub(crate) struct Out {
    /// The mask register as it was: the task may be out already.
    before: u8,
}

/// Keeps the task out.
#[inline(always)]
pub(crate) fn keep_out() -> Out {
    let before = regs::TIMSK0.read();
    regs::TIMSK0.write(0);
    regs::barrier();
    Out { before }
}

impl Drop for Out {
    #[inline(always)]
    fn drop(&mut self) {
        regs::barrier();
        regs::TIMSK0.write(self.before);
    }
}

/// The stepper, as main's alone.
pub(crate) struct Guard(#[expect(dead_code, reason = "kept as long as the guard lives")] Out);

/// Takes the stepper. Main must not hold two guards at once.
#[inline(always)]
pub(crate) fn lock() -> Guard {
    Guard(keep_out())
}

impl Deref for Guard {
    type Target = Stepper;

    #[inline(always)]
    fn deref(&self) -> &Stepper {
        // SAFETY: the task is out, and main has one guard at a time.
        unsafe { &*STEPPER.0.get() }
    }
}

impl DerefMut for Guard {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut Stepper {
        // SAFETY: as `deref`.
        unsafe { &mut *STEPPER.0.get() }
    }
}

/// Starts Timer0, and the task.
pub(crate) fn start() {
    regs::TCNT0.write(SOONEST.wrapping_neg());
    regs::TCCR0B.write(0b011);
    regs::TIMSK0.write(1);
}

global_asm!(
    r#"
    // As the ring's interrupts, in reach of the vectors.
    .text
    .global steps_task_begin
    // From the vector, which has put r24 onto the stack, after 8 cycles. No flag is touched.
steps_task_begin:
    ldi r24, 0                          // 1                             9
    sts {TIMSK0}, r24                   // 2                            11
    sei                                 // 1                            12
    nop                                 // 1: others are let in behind it, after 13
    push r25
    in r25, {SREG}
    push r25
    lds r24, {UCSR0B}
    sbrs r24, 7
    rjmp 1f
    .irp r, 0,1,18,19,20,21,22,23,26,27,30,31
    push r\r
    .endr
    clr r1
    call steps_refill
    .irp r, 31,30,27,26,23,22,21,20,19,18,1,0
    pop r\r
    .endr
    rjmp 2f
    // Inside the receive interrupt: again in one to two counts.
1:  ldi r24, 254
    out {TCNT0}, r24
2:  pop r25
    out {SREG}, r25
    pop r25
    // With others let in: the next call is a thousand cycles away.
    ldi r24, 1
    sts {TIMSK0}, r24
    pop r24
    ret
    "#,
    SREG = const super::register::SREG,
    TIMSK0 = const 0x6e,
    TCNT0 = const super::register::TCNT0,
    UCSR0B = const 0xc1,
);

/// What the interrupt calls.
#[unsafe(no_mangle)]
extern "C" fn steps_refill() {
    // SAFETY: a guard would have kept this out.
    let stepper = unsafe { &mut *STEPPER.0.get() };
    // A quarter of it, in counts of 64.
    let [_, high] = stepper.refill(clock::moment()).to_le_bytes();
    let mut counts = high.max(SOONEST);
    if feed::drives() && counts > SLICES {
        counts = SLICES;
    }
    regs::TCNT0.write(counts.wrapping_neg());
}
