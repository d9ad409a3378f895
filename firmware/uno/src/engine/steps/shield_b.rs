//! Ring B of the CNC shield: the motor on PORTB has a ring of its own, of 24 groups, behind the lists of the merge in their page.
//!
//! The other three motors are merged into ring A, on PORTD. To merge a fourth would take 35 cycles a step, and 12 more in ring A's interrupt for the
//! second port. Ring B lasts about as long as ring A without its lists. So it is checked before each list that the merge fills, and each time that the
//! merge publishes (`unless_shield_b_is_low`): a load of a record and the expansion of a list take up to 5000 cycles, with bytes coming in.
//!
//! # Cycles
//! 15 to 20 a step, and its interrupt's 49, or 60 where it lets another in; 200 a batch of 11 steps.

use super::motor::{HIGH_FIXED, Motor, flag};
use super::plan::prechecked_steps;
use super::register;
use super::ring::{END_B, Ring, SHORT_RING_GROUPS, SHORT_RING_START};
use super::stepper::{Stepper, Track};
use super::times;
use crate::engine::tuning::plan::LIMIT_CHECK_FROM;
use crate::engine::tuning::shield_b::{BATCHES, REFILL_BELOW, REFILL_LAST_BELOW, RING_LOW_BELOW, STEPS_WHEN_LOW};
use crate::engine::tuning::stepper::SPACING_SHIELD_B;
use core::arch::global_asm;
use core::mem::offset_of;

/// The motor on PORTB.
#[unsafe(export_name = "shield_b_motor")]
static mut MOTOR: *mut Motor = core::ptr::null_mut();

/// It is `motors[index]`, the last one. Only whoever has the stepper may call this.
pub(super) fn set_motor(motors: *mut [Motor; super::pins::MAX_MOTORS], index: u8) {
    // SAFETY: only the refill reads it, and that is kept out.
    unsafe { (&raw mut MOTOR).write_volatile(motors.cast::<Motor>().wrapping_add(usize::from(index))) }
}

global_asm!(
    r#"
    // r26: how many groups are free; r6: the pending group.
    .macro shield_b_free
    in r26, {TAIL}
    lds r6, steps_stepper+{HEAD}
    sec
    sbc r26, r6
    brcc .+2
    subi r26, {START}
    lsr r26
    lsr r26
    .endm
    .macro shield_b_load_motor
    lds r28, shield_b_motor
    lds r29, shield_b_motor+1
    ldi r24, {BATCHES}
    mov r4, r24
    .endm

    .section .text.shield_b, "ax", @progbits
    .global shield_fill, shield_b_fill
    // For the refill: fills both rings. Uses all registers.
shield_fill:
    rcall shield_b_fill
    call steps_merge_run
    call merge_fill_up
    // Once more at the end, since the next refill comes only after some time.
    shield_b_load_motor
    shield_b_free
    cpi r26, {GROUPS} - {REFILL_LAST_BELOW}
    brsh shield_b_batch
    ret
    // Fills ring B: plans, expands, publishes.
shield_b_fill:
    shield_b_load_motor
shield_b_next:
    shield_b_free
    cpi r26, {GROUPS} - {REFILL_BELOW}
    brsh shield_b_batch
1:  ret
shield_b_batch:
    cpi r26, {GROUPS} - {RING_LOW_BELOW}
    brlo 2f
    ldi r26, {STEPS_WHEN_LOW}
2:  mov r2, r26
    // Most often the next steps are of a prechecked segment, and soon: the plan need not be asked.
    "#,
    prechecked_steps!("5f"),
    r#"
    cp r24, r26
    brlo 3f
    mov r24, r26
    rjmp 3f
    // This ring has another minimal interval than the merge.
5:  dec r4
    brmi 1b
    lds r5, steps_times+{MAX_STEPS}
    lds r7, steps_times+{MIN_INTERVAL}
    lds r3, steps_times+{MIN_INTERVAL}+1
    sts steps_times+{MAX_STEPS}, r26
    ldi r24, {SPACING}
    sts steps_times+{MIN_INTERVAL}, r24
    sts steps_times+{MIN_INTERVAL}+1, r1
    call steps_plan
    sts steps_times+{MAX_STEPS}, r5
    sts steps_times+{MIN_INTERVAL}, r7
    sts steps_times+{MIN_INTERVAL}+1, r3
    tst r24
    breq 1b
    sbrc r25, 0
    rjmp 3f
    // A single event.
    ldi r30, lo8(steps_stepper+{TRACK})
    ldi r31, hi8(steps_stepper+{TRACK})
    movw r16, r30
    movw r14, r28
    call put_planned
    rjmp shield_b_next
    // r24 steps. r6 is the pending group: it is published last, when all that follow it are there.
3:  mov r20, r24
    ldi r31, hi8(ring_b_page)
    mov r30, r6
    lds r3, steps_stepper+{PENDING}
    lds r25, steps_stepper+{UNPRIMED}
    tst r25
    breq 4f
    // These groups were no steps before: set what they toggle.
    ldd r18, Y+{STEP}
    sts steps_stepper+{PENDING}, r18
    sts steps_stepper+{PENDING}+1, r18
8:  subi r30, -4
    brcs .+2
    ldi r30, {START}
    st Z, r18
    std Z+3, r18
    dec r24
    brne 8b
    mov r30, r6
    sub r25, r20
    brcc .+2
    clr r25
    sts steps_stepper+{UNPRIMED}, r25
4:  sub r2, r20
    call steps_expand_shield_b
    ldi r25, {END}
    mov r26, r24
    ldi r27, hi8(ring_b_page)
    st X, r25
    mov r26, r6
    st X, r3
    sts steps_stepper+{HEAD}, r24
    .irp at, 0,1,2,3
    ldd r24, Y+{TICK}+\at
    sts steps_stepper+{AT}+\at, r24
    .endr
    // The segment is used up, or the batch was smaller than the ring has room for: go on.
    tst r2
    brne 2f
    ret
2:  rjmp shield_b_next
    "#,
    RING_LOW_BELOW = const RING_LOW_BELOW,
    STEPS_WHEN_LOW = const STEPS_WHEN_LOW,
    BATCHES = const BATCHES,
    GROUPS = const SHORT_RING_GROUPS,
    REFILL_BELOW = const REFILL_BELOW,
    REFILL_LAST_BELOW = const REFILL_LAST_BELOW,
    START = const SHORT_RING_START,
    END = const END_B,
    SPACING = const SPACING_SHIELD_B,
    TAIL = const register::OCR0B,
    TRACK = const SECOND,
    HEAD = const SECOND + offset_of!(Track, ring) + offset_of!(Ring, head),
    PENDING = const SECOND + offset_of!(Track, ring) + offset_of!(Ring, pending),
    AT = const SECOND + offset_of!(Track, at),
    UNPRIMED = const SECOND + offset_of!(Track, ring) + offset_of!(Ring, unprimed),
    STEP = const offset_of!(Motor, step),
    FLAGS = const offset_of!(Motor, flags),
    PRECHECKED = const offset_of!(Motor, prechecked),
    LEFT = const offset_of!(Motor, registers) + 19,
    TURN = const flag::TURN,
    STEPPED = const flag::STEPPED,
    ANCHORED = const flag::ANCHORED,
    COMMITTED = const flag::COMMITTED,
    SWITCH = const flag::SWITCH,
    SINGLY = const flag::SINGLY,
    HIGH_FIXED = const HIGH_FIXED,
    LIMIT_CHECK_FROM = const LIMIT_CHECK_FROM,
    TICK = const offset_of!(Motor, registers) + 2,
    MAX_STEPS = const times::MAX_STEPS,
    MIN_INTERVAL = const times::MIN_INTERVAL,
);

/// The second track, ring B.
const SECOND: usize = offset_of!(Stepper, tracks) + size_of::<Track>();
