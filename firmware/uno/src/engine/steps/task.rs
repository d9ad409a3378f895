//! The task that keeps the rings filled: it comes again and again, whatever the main loop is doing, and is itself
//! interrupted by steps and by bytes from the line.
//!
//! The overflow of Timer0 calls it (normal mode, DS40002061B §15.7.1, 64 cycles a count), again when a full ring has half of
//! its time left or is down to [`RESERVE`], or a quarter of the time has passed that rings were filled for. Compare matches of Timer1 go
//! before it. It runs with its own interrupt off, so that it does not nest; and not inside the receive interrupt, which would
//! then lose bytes: it comes again until that has ended.
//!
//! What it works on, the [`Stepper`], belongs to whoever holds the [`Guard`]: main takes it with [`lock`], which keeps the task
//! out as long as it lives. Rings last for a while: no guard may be held for longer than about 2000 cycles while motors move (a
//! position, which takes a look at every group, is the longest), but for the four positions of a winch's status (`winch/feed.rs`).

use super::motor::Motor;
use super::ring::{Ring, flags};
use super::stepper::{Stepper, Track};
use super::times::TIMES;
use crate::engine::clock;
use crate::engine::regs;
use crate::engine::tuning::stepper::AHEAD;
use crate::engine::tuning::task::{AGAIN, BATCHES, FAR, NEARLY, RESERVE, RESERVE_MERGED, SOONEST, TURNS};
use core::arch::global_asm;
use core::cell::UnsafeCell;
use core::mem::offset_of;
use core::ops::{Deref, DerefMut};
use pulsetrain_core::avr::Registers;

#[repr(transparent)]
struct Place(UnsafeCell<Stepper>);

// SAFETY: main uses it under a guard, the task while there is none.
unsafe impl Sync for Place {}

/// The assembly knows where it is.
#[unsafe(export_name = "steps_stepper")]
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

/// Keeps the task out until [`let_in`] if motors share DIR lines: it needs much of the stack there, and what main is about to do does, too.
#[inline(always)]
pub(crate) fn keep_out_if_shared() {
    if TIMES.is_shared() {
        regs::TIMSK0.write(0);
    }
    regs::barrier();
}

#[inline(always)]
pub(crate) fn let_in() {
    regs::barrier();
    regs::TIMSK0.write(1);
}

/// Has the task come first, so that rings are full when something begins that keeps it out for long. Not while it is kept out.
pub(crate) fn call() {
    regs::TCNT0.write(u8::MAX);
    // Until it overflows, and the task has said when it comes next: not at once, as when it came inside the receive interrupt.
    while regs::TCNT0.read() >= AGAIN {}
}

/// Starts Timer0, and the task.
pub(crate) fn start() {
    regs::TCNT0.write(SOONEST.wrapping_neg());
    regs::TCCR0B.write(0b011);
    regs::TIMSK0.write(1);
}

global_asm!(
    r#"
    // Goes to \first if that ring is filled less far than the second; one batch is to be made. Both are counted from now: one may be filled 2^15 ticks
    // further than the other.
    .macro which_is_less first
    lds r20, steps_stepper+{AT}
    lds r21, steps_stepper+{AT}+1
    rcall task_ahead
    movw r18, r20
    lds r20, steps_stepper+{AT}+{TRACK_SIZE}
    lds r21, steps_stepper+{AT}+{TRACK_SIZE}+1
    rcall task_ahead
    cp r18, r20
    cpc r19, r21
    ldi r20, 1
    brlo \first
    .endm

    // As the ring's interrupts, in reach of the vectors.
    .text
    .global steps_task_begin, steps_limit, steps_due, steps_absent
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
    lds r24, steps_mode
    dec r24
    brpl .+2
    rjmp 5f
    .irp r, 2,3,4,5,6,7,8,9,10,11,12,13,14,15,16,17,28,29
    push r\r
    .endr
    in r25, {FLAGS}
    andi r25, {STARVED}
    breq 3f
    // Ring A is played no more: the window for it may have let this in instead.
    in r30, {SPL}
    in r31, {SPL}+1
    ldd r24, Z+34
    cpi r24, pm_hi8(ring_b_window)
    brne 18f
    ldd r24, Z+35
    cpi r24, pm_lo8(ring_b_window)
    brne 18f
    ldi r26, 2
    rjmp 10f
18:
    call steps_watch
    // Nothing is planned beyond the limit, which the program's source of steps knows.
3:  call source_limit
    sts steps_times+{LIMIT}, r22
    sts steps_times+{LIMIT}+1, r23
    sts steps_times+{LIMIT}+2, r24
    sts steps_times+{LIMIT}+3, r25
    lds r24, steps_mode
    cpi r24, {APIECE}
    brlo 6f
    breq 7f
    cpi r24, {BOTH}
    breq 8f
    cpi r24, {BESIDE}
    breq 18f
    cpi r24, {FILLED}
    breq 9f
    call ring_shared
    rjmp 9f
18: call ring_beside
    rjmp 9f
6:  call steps_merge_run
    brcs 9f
    call steps_merge_run
    rjmp 9f
    // Two rings, a batch at a time for the one that is filled less far, or for the other if that can have none now (r4 is not negative then).
8:  ldi r24, {TURNS}
13: push r24
    which_is_less 14f
    rcall task_fill_second
    tst r4
    brmi 15f
    ldi r20, 1
    rcall task_fill_first
    rjmp 16f
14: rcall task_fill_first
    tst r4
    brmi 15f
    ldi r20, 1
    rcall task_fill_second
16: tst r4
15: pop r24
    brpl 9f
    dec r24
    brne 13b
    rjmp 9f
7:  ldi r20, {BATCHES}
    rcall task_fill_first
    // A quarter of the time that they are filled for, in counts of 64.
9:  lds r20, steps_stepper+{AT}
    lds r21, steps_stepper+{AT}+1
    rcall task_ahead
    mov r26, r21
    lds r24, steps_mode
    cpi r24, {BOTH}
    brne 4f
    lds r20, steps_stepper+{AT}+{TRACK_SIZE}
    lds r21, steps_stepper+{AT}+{TRACK_SIZE}+1
    rcall task_ahead
    cp r21, r26
    brsh 4f
    mov r26, r21
4:  cpi r26, {SOONEST}
    brsh 4f
    ldi r26, {SOONEST}
    // Or when the program's source of steps is due.
4:  call source_due
    brcc .+2
    rjmp 4f
    lds r25, steps_mode
    // Or, where the only ring is full or reaches far, half of it, or all but the reserve if that is less.
3:
    // Bytes are received at once where rings have nothing but plain steps: of one motor, at intervals of 80 to 128 ticks (the compare register
    // may be written 73 after the match then); or of two that the compare hardware steps, below 256 (and 127).
    sbrs r25, {APIECE_BIT}
    rjmp 20f
    cbi {EECR}, {AT_ONCE}
    lds r24, steps_stepper+{UNLIKE}
    lds r20, steps_times+{PULSE}
    or r24, r20
    lds r20, steps_times+{PULSE}+1
    or r24, r20
    lds r20, steps_motors+{INTERVAL}+3
    or r24, r20
    lds r20, steps_motors+{INTERVAL}+4
    or r24, r20
    brne 20f
    cpi r25, {BOTH}
    breq 18f
    lds r24, steps_motors+{INTERVAL}+2
    subi r24, 80
    cpi r24, 129 - 80
    brlo 19f
    rjmp 20f
18: lds r24, steps_stepper+{EDGE}
    tst r24
    breq 20f
    lds r24, steps_stepper+{TRACK_SIZE}+{UNLIKE}
    lds r20, steps_motors+{MOTOR_SIZE}+{INTERVAL}+3
    or r24, r20
    lds r20, steps_motors+{MOTOR_SIZE}+{INTERVAL}+4
    or r24, r20
    brne 20f
19: sbi {EECR}, {AT_ONCE}
20:
    cpi r25, {BOTH}
    breq 4f
    lds r30, steps_stepper+{TAIL_AT}
    ldi r31, 0
    ld r24, Z
    lds r25, steps_stepper+{HEAD}
    sub r24, r25
    dec r24
    lds r25, steps_mode
    cpi r24, 4 * {NEARLY}
    brlo 21f
    cpi r25, {SHARED}
    breq 4f
    cpi r26, {FAR} >> 8
    brlo 4f
21: ldi r27, {RESERVE_MERGED} >> 8
    cpi r25, {MERGE}
    breq .+2
    ldi r27, {RESERVE} >> 8
    mov r24, r26
    sub r24, r27
    brcs 4f
    cp r24, r27
    brlo 17f
    mov r24, r26
    lsr r24
17: cpi r24, 64
    brlo 3f
    ldi r24, 63
3:  lsl r24
    lsl r24
    cp r24, r26
    brlo 4f
    mov r26, r24
4:
    sbis {FLAGS}, {EXTRA_B}
    rjmp 10f
    // Or five eighths of the time of the small ring beside a merge.
    sbis {FLAGS}, {BESIDE_FLAG}
    rjmp 10f
    lds r20, steps_stepper+{AT}+{TRACK_SIZE}
    lds r21, steps_stepper+{AT}+{TRACK_SIZE}+1
    rcall task_ahead
    cpi r21, 101
    brlo .+2
    ldi r21, 101
    mov r24, r21
    lsr r24
    lsl r21
    add r21, r24
    cpi r21, {SOONEST}
    brsh .+2
    ldi r21, {SOONEST}
    cp r21, r26
    brsh 10f
    mov r26, r21
10: neg r26
    .irp r, 29,28,17,16,15,14,13,12,11,10,9,8,7,6,5,4,3,2
    pop r\r
    .endr
    rjmp 6f
5:  ldi r26, 1                          // nothing plays
6:  out {TCNT0}, r26
    ldi r26, 1
    out {TIFR0}, r26                    // a call that this one was for
    .irp r, 31,30,27,26,23,22,21,20,19,18,1,0
    pop r\r
    .endr
    rjmp 2f
    // Inside the receive interrupt: again in one to two counts, when that has ended.
1:  ldi r24, {AGAIN}
    out {TCNT0}, r24
2:  pop r25
    out {SREG}, r25
    pop r25
    // With others let in: the next call is a thousand cycles away.
    ldi r24, 1
    sts {TIMSK0}, r24
    pop r24
    ret

task_fill_first:
    ldi r24, lo8(steps_stepper+{TRACK})
    ldi r25, hi8(steps_stepper+{TRACK})
    ldi r22, lo8(steps_motors)
    ldi r23, hi8(steps_motors)
    jmp ring_apiece
task_fill_second:
    ldi r24, lo8(steps_stepper+{TRACK}+{TRACK_SIZE})
    ldi r25, hi8(steps_stepper+{TRACK}+{TRACK_SIZE})
    ldi r22, lo8(steps_motors+{MOTOR_SIZE})
    ldi r23, hi8(steps_motors+{MOTOR_SIZE})
    jmp ring_apiece

    // What a source of steps is that knows as much as there is: the limit is {AHEAD} from now.
    // r22 to r25 is the limit; uses all registers.
steps_limit:
    call clock_moment
    ldi r18, {AHEAD} >> 8
    add r23, r18
    adc r24, r1
    adc r25, r1
    // And it is due when the rings are.
steps_due:
    clc
    ret

    // In place of a way to fill rings that a program does not have: nothing that it configures asks for it.
steps_absent:
    jmp end_of_program

    // How far r20:21 is ahead; what would be beyond the limit is past. Interrupts are off for 6 cycles.
task_ahead:
    in r24, {SREG}
    cli
    lds r22, {TCNT1}
    lds r23, {TCNT1}+1
    out {SREG}, r24
    sub r20, r22
    sbc r21, r23
    cpi r21, ({AHEAD} + 8192) >> 8
    brlo 1f
    clr r21
1:  ret
    "#,
    FLAGS = const super::register::GPIOR0,
    STARVED = const super::ring::flags::STARVED,
    AHEAD = const AHEAD,
    LIMIT = const super::times::LIMIT,
    APIECE = const mode::APIECE,
    BOTH = const mode::BOTH,
    TRACK = const offset_of!(Stepper, tracks),
    TRACK_SIZE = const size_of::<Track>(),
    AT = const offset_of!(Stepper, tracks) + offset_of!(Track, at),
    MOTOR_SIZE = const size_of::<Motor>(),
    SOONEST = const SOONEST,
    AGAIN = const AGAIN,
    BATCHES = const BATCHES,
    TURNS = const TURNS,
    MERGE = const mode::MERGE,
    BESIDE = const mode::BESIDE,
    SHARED = const mode::SHARED,
    FILLED = const mode::FILLED,
    EXTRA_B = const flags::EXTRA_B,
    BESIDE_FLAG = const flags::BESIDE,
    SPL = const 0x3d,
    RESERVE_MERGED = const RESERVE_MERGED,
    RESERVE = const RESERVE,
    FAR = const FAR,
    NEARLY = const NEARLY,
    EECR = const super::register::EECR,
    AT_ONCE = const super::register::AT_ONCE,
    INTERVAL = const offset_of!(Motor, registers) + offset_of!(Registers, interval_low),
    APIECE_BIT = const mode::APIECE.trailing_zeros(),
    PULSE = const super::times::PULSE,
    UNLIKE = const offset_of!(Stepper, tracks) + offset_of!(Track, ring) + offset_of!(Ring, unlike),
    EDGE = const offset_of!(Stepper, tracks) + offset_of!(Track, ring) + offset_of!(Ring, edge),
    TAIL_AT = const offset_of!(Stepper, tracks) + offset_of!(Track, ring) + offset_of!(Ring, tail_at),
    HEAD = const offset_of!(Stepper, tracks) + offset_of!(Track, ring) + offset_of!(Ring, head),
    TCNT1 = const super::register::TCNT1,
    SREG = const super::register::SREG,
    TIMSK0 = const super::register::TIMSK0,
    TCNT0 = const super::register::TCNT0,
    TIFR0 = const super::register::TIFR0,
    UCSR0B = const 0xc1,
);

/// What the task fills, as [`steps_mode`](set_mode) says.
pub(crate) mod mode {
    /// Nothing plays.
    pub(crate) const NONE: u8 = 0;
    /// One ring by the merge.
    pub(crate) const MERGE: u8 = 1;
    /// One ring of one motor.
    pub(crate) const APIECE: u8 = 2;
    /// Two of them.
    pub(crate) const BOTH: u8 = 3;
    /// One ring of motors that share DIR lines.
    pub(crate) const SHARED: u8 = 4;
    /// One ring by the merge, which the program's `source_limit` has filled already: where the limit is near, a ring is not full, and a second run
    /// of the merge finds nothing to do. As in all that have lists the bit of [`APIECE`] is not set.
    pub(crate) const FILLED: u8 = 8;
    /// One ring by the merge, and one of one motor. As in all that have lists the bit of [`APIECE`] is not set.
    pub(crate) const BESIDE: u8 = 5;
}

#[unsafe(export_name = "steps_mode")]
static mut MODE: u8 = mode::NONE;

/// From here on the task fills what `mode` says. To be called by who has the stepper.
pub(super) fn set_mode(mode: u8) {
    // SAFETY: one byte; the task is out.
    unsafe { (&raw mut MODE).write_volatile(mode) }
}

/// A ring ran empty.
#[unsafe(no_mangle)]
extern "C" fn steps_watch() {
    // SAFETY: a guard would have kept the task out.
    unsafe { &mut *STEPPER.0.get() }.watch(clock::moment());
}

/// Steps that a motor has made when the first ring was played up to `tail`. For who keeps the task out.
#[unsafe(no_mangle)]
extern "C" fn steps_position(motor: u8, tail: u8) -> i32 {
    // SAFETY: the caller keeps the task out.
    unsafe { &*STEPPER.0.get() }.position(motor, tail)
}
