//! The refill interrupt, TIMER0_OVF: it keeps the rings filled, whatever the main loop is doing. Step interrupts and the receive interrupt interrupt it.
//!
//! Timer0 counts every 64 cycles (normal mode, DS40002061B §15.7.1), and each refill sets when it overflows next: when a quarter of the time has
//! passed that the rings are filled for; or, with a ring that is full, when half of its time is left, or [`RESERVE`]. Its own interrupt is off while it
//! runs, so that it does not nest. It does not run inside the receive interrupt, which would lose bytes, but comes again until that has ended.
//!
//! It works on the [`Stepper`]. Main gets that from [`lock`], and the [`Guard`] keeps the refill out as long as it lives. Rings last for a while, so no
//! guard may be held for longer than about 2000 cycles while motors move. The longest is a position, which looks at every group of a ring; the four
//! positions of a winch's status take longer (`winch/obey.rs`).

use super::brake;
use super::motor::{Motor, flag};
use super::ring::{GROUPS, Ring, flags};
use super::stepper::{Stepper, Track};
use super::times::TIMES;
use crate::engine::clock;
use crate::engine::regs;
use crate::engine::tuning::refill::{
    BATCHES, FAR_AHEAD, FULL_FROM, MIN_PERIOD, RESERVE, RESERVE_MERGED, RETRY, SOONER_BEFORE_SWITCH, TURNS,
};
use crate::engine::tuning::stepper::LOOK_AHEAD;
use core::arch::global_asm;
use core::cell::UnsafeCell;
use core::mem::offset_of;
use core::ops::{Deref, DerefMut};
use pulsetrain_core::avr::Registers;

#[repr(transparent)]
struct StepperCell(UnsafeCell<Stepper>);

// SAFETY: main uses it under a guard, and the refill while there is no guard.
unsafe impl Sync for StepperCell {}

/// The assembly knows where it is.
#[unsafe(export_name = "steps_stepper")]
static STEPPER: StepperCell = StepperCell(UnsafeCell::new(Stepper::new()));

/// Keeps the refill out as long as it lives.
pub(crate) struct RefillBlocked {
    /// TIMSK0 as it was: the refill may be out already.
    before: u8,
}

/// Keeps the refill out.
#[inline(always)]
pub(crate) fn block() -> RefillBlocked {
    let before = regs::TIMSK0.read();
    regs::TIMSK0.write(0);
    regs::barrier();
    RefillBlocked { before }
}

impl Drop for RefillBlocked {
    #[inline(always)]
    fn drop(&mut self) {
        regs::barrier();
        regs::TIMSK0.write(self.before);
    }
}

/// The stepper, for main alone.
pub(crate) struct Guard(#[expect(dead_code, reason = "kept as long as the guard lives")] RefillBlocked);

/// Takes the stepper. Main must not hold two guards at once.
#[inline(always)]
pub(crate) fn lock() -> Guard {
    Guard(block())
}

impl Deref for Guard {
    type Target = Stepper;

    #[inline(always)]
    fn deref(&self) -> &Stepper {
        // SAFETY: the refill is out, and main has one guard at a time.
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

/// Keeps the refill out until [`allow`] if motors share DIR lines. It needs much stack then, and so does what main is about to do.
#[inline(always)]
pub(crate) fn block_if_shared() {
    if TIMES.is_shared() {
        regs::TIMSK0.write(0);
    }
    regs::barrier();
}

#[inline(always)]
pub(crate) fn allow() {
    regs::barrier();
    regs::TIMSK0.write(1);
}

/// Runs the refill now, so that rings are full before something keeps it out for long. It must not be kept out already.
pub(crate) fn run_now() {
    regs::TCNT0.write(u8::MAX);
    // Until Timer0 has overflowed and the refill has set it again. If the refill came inside the receive interrupt, it set it to `RETRY` first.
    while regs::TCNT0.read() >= RETRY {}
}

/// Starts Timer0, and with it the refill.
pub(crate) fn start() {
    regs::TCNT0.write(MIN_PERIOD.wrapping_neg());
    regs::TCCR0B.write(0b011);
    regs::TIMSK0.write(1);
}

global_asm!(
    r#"
    // Goes to \first, with one batch in r20, if ring A is filled less far than ring B. Both times are counted from now, since they may be 2^15 ticks apart.
    .macro goto_if_less_filled first
    lds r20, steps_stepper+{AT}
    lds r21, steps_stepper+{AT}+1
    rcall ticks_ahead
    movw r18, r20
    lds r20, steps_stepper+{AT}+{TRACK_SIZE}
    lds r21, steps_stepper+{AT}+{TRACK_SIZE}+1
    rcall ticks_ahead
    cp r18, r20
    cpc r19, r21
    ldi r20, 1
    brlo \first
    .endm

    // In this section, like the step interrupts, it is in reach of the vectors.
    .text
    .global timer0_ovf, steps_limit, steps_due, steps_absent
    // From the vector, which has pushed r24; 8 cycles have passed. No flag is changed up to `push r25`.
timer0_ovf:
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
    andi r25, {UNDERRUN}
    breq 3f
    // On the shield, ring B's interrupt may have been waiting for ring A's, and let this one in instead, since ring A ran empty. Return at once then: was
    // the program interrupted at `timer1_compb_window`?
    in r30, {SPL}
    in r31, {SPL}+1
    ldd r24, Z+34
    cpi r24, pm_hi8(timer1_compb_window)
    brne 18f
    ldd r24, Z+35
    cpi r24, pm_lo8(timer1_compb_window)
    brne 18f
    ldi r26, 2
    rjmp 10f
18:
    call steps_underrun
    // Ask the program how far motions are known.
3:  call source_limit
    sts steps_times+{LIMIT}, r22
    sts steps_times+{LIMIT}+1, r23
    sts steps_times+{LIMIT}+2, r24
    sts steps_times+{LIMIT}+3, r25
    lds r24, steps_mode
    cpi r24, {ONE_RING}
    brlo 6f
    breq 7f
    cpi r24, {TWO_RINGS}
    breq 8f
    cpi r24, {MERGE_AND_B}
    breq 18f
    cpi r24, {MERGED_BY_SOURCE}
    breq 9f
    call ring_fill_shared
    rjmp 9f
18: call ring_fill_shield
    rjmp 9f
6:  call steps_merge_run
    brcs 9f
    call steps_merge_run
    rjmp 9f
    // Two rings: a batch for the one that is filled less far, or for the other if that has no room or no steps (r4 is not negative then).
8:  ldi r24, {TURNS}
13: push r24
    goto_if_less_filled 14f
    rcall refill_second
    tst r4
    brmi 15f
    ldi r20, 1
    rcall refill_first
    rjmp 16f
14: rcall refill_first
    tst r4
    brmi 15f
    ldi r20, 1
    rcall refill_second
16: tst r4
15: pop r24
    brpl 9f
    dec r24
    brne 13b
    rjmp 9f
7:  ldi r20, {BATCHES}
    rcall refill_first
    // Next refill: after a quarter of the time that the rings are filled for, counts of 64 cycles.
9:  lds r20, steps_stepper+{AT}
    lds r21, steps_stepper+{AT}+1
    rcall ticks_ahead
    mov r26, r21
    lds r24, steps_mode
    cpi r24, {TWO_RINGS}
    brne 4f
    lds r20, steps_stepper+{AT}+{TRACK_SIZE}
    lds r21, steps_stepper+{AT}+{TRACK_SIZE}+1
    rcall ticks_ahead
    cp r21, r26
    brsh 4f
    mov r26, r21
4:  cpi r26, {MIN_PERIOD}
    brsh 4f
    ldi r26, {MIN_PERIOD}
    // Or when the program wants it.
4:  call source_due
    brcc .+2
    rjmp 4f
    lds r25, steps_mode
    // Or, with one ring that is full or reaches far, after half of that time, or when only the reserve is left, if that is sooner.
3:
    // The receive interrupt need not nest where rings have nothing but plain steps: with one motor at intervals of 80 to 128 ticks (the compare register
    // is written 73 ticks after the match at worst), or with two that the compare hardware steps, at intervals up to 255 ticks.
    sbrs r25, {OWN_RING_BIT}
    rjmp 20f
    cbi {EECR}, {RX_NO_NESTING}
    lds r24, steps_stepper+{UNPRIMED}
    lds r20, steps_times+{PULSE}
    or r24, r20
    lds r20, steps_times+{PULSE}+1
    or r24, r20
    lds r20, steps_motors+{INTERVAL}+3
    or r24, r20
    lds r20, steps_motors+{INTERVAL}+4
    or r24, r20
    brne 20f
    cpi r25, {TWO_RINGS}
    breq 18f
    lds r24, steps_motors+{INTERVAL}+2
    subi r24, 80
    cpi r24, 129 - 80
    brlo 19f
    rjmp 20f
18: lds r24, steps_stepper+{COMPARE_BIT}
    tst r24
    breq 20f
    lds r24, steps_stepper+{TRACK_SIZE}+{UNPRIMED}
    lds r20, steps_motors+{MOTOR_SIZE}+{INTERVAL}+3
    or r24, r20
    lds r20, steps_motors+{MOTOR_SIZE}+{INTERVAL}+4
    or r24, r20
    brne 20f
19: sbi {EECR}, {RX_NO_NESTING}
20:
    cpi r25, {TWO_RINGS}
    breq 4f
    // Sooner if merged motors wait for a switch: all their lists end at its tick, and should be full before. Not if they wait for the end of the lease.
    sbrs r25, {MERGED_BIT}
    rjmp 21f
    lds r24, steps_motors+{MOTOR_FLAGS}
    lds r20, steps_motors+{MOTOR_SIZE}+{MOTOR_FLAGS}
    or r24, r20
    lds r20, steps_motors+{BRAKING_STATE}
    sbrs r24, {SWITCH}
    rjmp 21f
    sbrc r20, {END_NEXT}
    rjmp 21f
    .rept {SOONER_BEFORE_SWITCH}
    lsr r26
    .endr
    cpi r26, {MIN_PERIOD}
    brsh .+2
    ldi r26, {MIN_PERIOD}
    rjmp 4f
21:
    lds r30, steps_stepper+{TAIL_AT}
    ldi r31, 0
    ld r24, Z
    lds r25, steps_stepper+{HEAD}
    sub r24, r25
    dec r24
    lds r25, steps_mode
    cpi r24, 4 * ({GROUPS} - {FULL_FROM})
    brlo 22f
    cpi r25, {SHARED}
    breq 4f
    cpi r26, {FAR_AHEAD} >> 8
    brlo 4f
22: ldi r27, {RESERVE_MERGED} >> 8
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
    sbis {FLAGS}, {NOT_PLAIN_B}
    rjmp 10f
    // Or after five eighths of the time of ring B of the shield, which is short.
    sbis {FLAGS}, {SHIELD_B}
    rjmp 10f
    lds r20, steps_stepper+{AT}+{TRACK_SIZE}
    lds r21, steps_stepper+{AT}+{TRACK_SIZE}+1
    rcall ticks_ahead
    cpi r21, 101
    brlo .+2
    ldi r21, 101
    mov r24, r21
    lsr r24
    lsl r21
    add r21, r24
    cpi r21, {MIN_PERIOD}
    brsh .+2
    ldi r21, {MIN_PERIOD}
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
1:  ldi r24, {RETRY}
    out {TCNT0}, r24
2:  pop r25
    out {SREG}, r25
    pop r25
    // Enabled while others may still come in: Timer0 does not overflow in this count.
    ldi r24, 1
    sts {TIMSK0}, r24
    pop r24
    ret

refill_first:
    ldi r24, lo8(steps_stepper+{TRACK})
    ldi r25, hi8(steps_stepper+{TRACK})
    ldi r22, lo8(steps_motors)
    ldi r23, hi8(steps_motors)
    jmp ring_fill_one
refill_second:
    ldi r24, lo8(steps_stepper+{TRACK}+{TRACK_SIZE})
    ldi r25, hi8(steps_stepper+{TRACK}+{TRACK_SIZE})
    ldi r22, lo8(steps_motors+{MOTOR_SIZE})
    ldi r23, hi8(steps_motors+{MOTOR_SIZE})
    jmp ring_fill_one

    // The limit of a program whose motions are known as far as there are any: {LOOK_AHEAD} from now.
    // Gives it in r22 to r25; uses all registers.
steps_limit:
    call clock_moment
    ldi r18, {LOOK_AHEAD} >> 8
    add r23, r18
    adc r24, r1
    adc r25, r1
    // Such a program has no wish when the next refill is to come.
steps_due:
    clc
    ret

    // In place of a routine that a program does not support. No configuration that it accepts comes here.
steps_absent:
    jmp end_of_program

    // How far the tick r20:21 is ahead of now. Beyond the limit it must be past, and 0 is returned. Interrupts are off for 6 cycles.
ticks_ahead:
    in r24, {SREG}
    cli
    lds r22, {TCNT1}
    lds r23, {TCNT1}+1
    out {SREG}, r24
    sub r20, r22
    sbc r21, r23
    cpi r21, ({LOOK_AHEAD} + 8192) >> 8
    brlo 1f
    clr r21
1:  ret
    "#,
    FLAGS = const super::register::GPIOR0,
    UNDERRUN = const super::ring::flags::UNDERRUN,
    LOOK_AHEAD = const LOOK_AHEAD,
    LIMIT = const super::times::LIMIT,
    ONE_RING = const mode::ONE_RING,
    TWO_RINGS = const mode::TWO_RINGS,
    TRACK = const offset_of!(Stepper, tracks),
    TRACK_SIZE = const size_of::<Track>(),
    AT = const offset_of!(Stepper, tracks) + offset_of!(Track, at),
    MOTOR_SIZE = const size_of::<Motor>(),
    MIN_PERIOD = const MIN_PERIOD,
    RETRY = const RETRY,
    BATCHES = const BATCHES,
    TURNS = const TURNS,
    MERGE = const mode::MERGE,
    MERGE_AND_B = const mode::MERGE_AND_B,
    MERGED_BIT = const mode::MERGE.trailing_zeros(),
    MOTOR_FLAGS = const offset_of!(Motor, flags),
    SWITCH = const flag::SWITCH,
    SOONER_BEFORE_SWITCH = const SOONER_BEFORE_SWITCH,
    BRAKING_STATE = const offset_of!(Motor, epochs) + brake::STATE,
    END_NEXT = const brake::state::END_NEXT,
    SHARED = const mode::SHARED,
    MERGED_BY_SOURCE = const mode::MERGED_BY_SOURCE,
    NOT_PLAIN_B = const flags::NOT_PLAIN_B,
    SHIELD_B = const flags::SHIELD_B,
    SPL = const 0x3d,
    RESERVE_MERGED = const RESERVE_MERGED,
    RESERVE = const RESERVE,
    FAR_AHEAD = const FAR_AHEAD,
    GROUPS = const GROUPS,
    FULL_FROM = const FULL_FROM,
    EECR = const super::register::EECR,
    RX_NO_NESTING = const super::register::RX_NO_NESTING,
    INTERVAL = const offset_of!(Motor, registers) + offset_of!(Registers, interval_low),
    OWN_RING_BIT = const mode::ONE_RING.trailing_zeros(),
    PULSE = const super::times::PULSE,
    UNPRIMED = const offset_of!(Stepper, tracks) + offset_of!(Track, ring) + offset_of!(Ring, unprimed),
    COMPARE_BIT = const offset_of!(Stepper, tracks) + offset_of!(Track, ring) + offset_of!(Ring, compare_bit),
    TAIL_AT = const offset_of!(Stepper, tracks) + offset_of!(Track, ring) + offset_of!(Ring, tail_at),
    HEAD = const offset_of!(Stepper, tracks) + offset_of!(Track, ring) + offset_of!(Ring, head),
    TCNT1 = const super::register::TCNT1,
    SREG = const super::register::SREG,
    TIMSK0 = const super::register::TIMSK0,
    TCNT0 = const super::register::TCNT0,
    TIFR0 = const super::register::TIFR0,
    UCSR0B = const 0xc1,
);

/// What the refill fills; [`set_mode`] sets it.
pub(crate) mod mode {
    /// Nothing plays.
    pub(crate) const NONE: u8 = 0;
    /// One ring, by the merge.
    pub(crate) const MERGE: u8 = 1;
    /// One ring of one motor.
    pub(crate) const ONE_RING: u8 = 2;
    /// Two such rings.
    pub(crate) const TWO_RINGS: u8 = 3;
    /// One ring of motors that share DIR lines.
    pub(crate) const SHARED: u8 = 4;
    /// One ring, by the merge, which the program's `source_limit` has already called. Where the limit is near, a ring is not full, and the second run of
    /// the merge would find nothing to do. The bit of [`ONE_RING`] is not set, as in all modes with lists.
    pub(crate) const MERGED_BY_SOURCE: u8 = 8;
    /// The shield: ring A by the merge, and ring B. The bit of [`ONE_RING`] is not set, as in all modes with lists.
    pub(crate) const MERGE_AND_B: u8 = 5;
}

#[unsafe(export_name = "steps_mode")]
static mut MODE: u8 = mode::NONE;

/// Sets what the refill fills. Only whoever has the stepper may call this.
pub(super) fn set_mode(mode: u8) {
    // SAFETY: one byte; the refill is out.
    unsafe { (&raw mut MODE).write_volatile(mode) }
}

/// A ring ran empty.
#[unsafe(no_mangle)]
extern "C" fn steps_underrun() {
    // SAFETY: this is the refill, which a guard would have kept out.
    unsafe { &mut *STEPPER.0.get() }.watch(clock::moment());
}

/// Steps that a motor had made when the first ring was played up to `tail`. The caller keeps the refill out.
#[unsafe(no_mangle)]
extern "C" fn steps_position(motor: u8, tail: u8) -> i32 {
    // SAFETY: the caller keeps the refill out.
    unsafe { &*STEPPER.0.get() }.position(motor, tail)
}
