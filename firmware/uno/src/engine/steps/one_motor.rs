//! A ring of one motor: plan, expand, publish, until the ring is full.
//!
//! # Cycles
//! 100 a batch, beside what [`plan`](super::plan) and [`expand`](super::expand) take; 8 more a step as long as the ring has groups that are no
//! steps.

use super::motor::Motor;
use super::refill::mode;
use super::ring::{GROUPS, Ring};
use super::stepper::Track;
use super::times;
use crate::engine::tuning::one_motor::{LONG_PULSES, REFILL_BELOW};
use core::arch::global_asm;
use core::mem::offset_of;

global_asm!(
    r#"
    .section .text.one_motor_fill, "ax", @progbits
    .global one_motor_fill
    // For the refill: r24:25 is the track, r22:23 its motor, r20 how many batches may be made; an event counts as two. Uses all registers.
    // Afterwards r4 is r20 if there was no room, and less if there was.
    // Inside, r2:3 is the track, Y the motor, r4 how many batches may still be made.
one_motor_fill:
    movw r2, r24
    movw r28, r22
    mov r4, r20
one_motor_next:
    // Is there room?
    movw r30, r2
    ldd r26, Z+{TAIL_AT}
    clr r27
    ld r26, X
    ldd r24, Z+{HEAD}
    sub r26, r24
    dec r26
    cpi r26, 4 * ({GROUPS} - {REFILL_BELOW})
    brlo 2f
    cpi r26, 4 * ({GROUPS} - {REFILL_BELOW_OF_TWO})
    brsh 7f
    lds r25, steps_mode
    sbrc r25, {TWO_RINGS_BIT}
    rjmp 2f
7:
    dec r4
    brpl 6f
1:  ret
    // The ring is full. If the motor has no steps left, load its next record already.
2:  ldd r24, Y+{LEFT}
    ldd r25, Y+{LEFT}+1
    or r24, r25
    brne 1b
    ldi r24, 1 << {PREFETCH}
    sts steps_times+{ONLY_STEPS}, r24
    call steps_plan
    sts steps_times+{ONLY_STEPS}, r1
    ret
6:  ldd r24, Z+{UNPRIMED}
    tst r24
    breq 5f
    lsr r26
    lsr r26
    dec r26
    ldd r24, Y+{STEP}
    ldd r25, Y+{STEP_END}
    cp r24, r25
    breq 3f
    // Two groups a step. Few at once, so that they are published sooner while the ring runs low.
    lsr r26
    cpi r26, {LONG_PULSES}
    brlo 3f
    ldi r26, {LONG_PULSES}
    rjmp 3f
    // All groups toggle what a step toggles: the expansion itself checks how much room there is.
5:  ser r26
3:  sts steps_times+{MAX_STEPS}, r26
    call steps_plan
    tst r24
    breq 1b
    movw r30, r2
    sbrc r25, 0
    rjmp 9f
    // A single event.
    movw r16, r2
    movw r14, r28
    call put_planned
    dec r4
    rjmp one_motor_next
    // r24 steps
9:  mov r20, r24
    ldd r18, Z+{STEP_PUBLISHED}
    ldd r19, Z+{TAIL_AT}
    ldd r6, Z+{HEAD}
    ldd r7, Z+{STEP_PENDING}
    ldd r21, Z+{UNPRIMED}
    tst r21
    brne 8f
    mov r17, r18
    ldd r31, Z+{PAGE}
    mov r30, r6
    call steps_expand_ring
    movw r30, r2
    std Z+{HEAD}, r24
    ldd r18, Y+{TICK}
    ldd r19, Y+{TICK}+1
    ldd r20, Y+{TICK}+2
    ldd r21, Y+{TICK}+3
    rjmp 5f
8:  ldd r17, Z+{BEFORE_STEP}
    std Z+{BEFORE_STEP}, r18
    ldd r22, Z+{STEP_END_BYTE}
    ldd r31, Z+{PAGE}
    mov r30, r6
    ldd r26, Y+{STEP}
    ldd r27, Y+{STEP_END}
    cp r26, r27
    brne 3f
    // These groups were no steps before: set what they toggle.
    mov r25, r20
1:  subi r30, -4
    st Z, r18
    std Z+3, r22
    dec r25
    brne 1b
    mov r30, r6
    push r21
    push r20
    call steps_expand_ring
    pop r20
    pop r21
    sub r20, r5
    sub r21, r20
    brcc .+2
    clr r21
    movw r30, r2
    std Z+{UNPRIMED}, r21
    rjmp 4f
    // Published from the end: the group that was pending is published last.
3:  mov r5, r17
    lds r17, steps_times+{PULSE}
    call steps_expand_ring_long
    movw r30, r2
    mov r26, r24
    ldd r27, Z+{PAGE}
    st X, r7
    mov r26, r6
    st X, r5
    clr r5
4:  std Z+{HEAD}, r24
    ldd r22, Y+{STEP}
    ldd r23, Y+{STEP_END}
    std Z+{PENDING}, r22
    std Z+{PENDING}+1, r23
    ldd r18, Y+{TICK}
    ldd r19, Y+{TICK}+1
    ldd r20, Y+{TICK}+2
    ldd r21, Y+{TICK}+3
    cp r22, r23
    breq 5f
    lds r24, steps_times+{PULSE}
    lds r25, steps_times+{PULSE}+1
    add r18, r24
    adc r19, r25
    adc r20, r1
    adc r21, r1
5:  std Z+{AT}, r18
    std Z+{AT}+1, r19
    std Z+{AT}+2, r20
    std Z+{AT}+3, r21
    // r5 steps found no room: the ring is full.
    tst r5
    brne 6f
    rjmp one_motor_next
6:  ret
    "#,
    GROUPS = const GROUPS,
    REFILL_BELOW = const REFILL_BELOW[0],
    REFILL_BELOW_OF_TWO = const REFILL_BELOW[1],
    TWO_RINGS_BIT = const (mode::TWO_RINGS ^ mode::ONE_RING).trailing_zeros(),
    LONG_PULSES = const LONG_PULSES,
    TAIL_AT = const offset_of!(Track, ring) + offset_of!(Ring, tail_at),
    UNPRIMED = const offset_of!(Track, ring) + offset_of!(Ring, unprimed),
    HEAD = const offset_of!(Track, ring) + offset_of!(Ring, head),
    PAGE = const offset_of!(Track, ring) + offset_of!(Ring, page),
    PENDING = const offset_of!(Track, ring) + offset_of!(Ring, pending),
    BEFORE_STEP = const offset_of!(Track, ring) + offset_of!(Ring, before_step),
    STEP_PUBLISHED = const offset_of!(Track, ring) + offset_of!(Ring, step_published),
    STEP_PENDING = const offset_of!(Track, ring) + offset_of!(Ring, step_pending),
    STEP_END_BYTE = const offset_of!(Track, ring) + offset_of!(Ring, step_end),
    AT = const offset_of!(Track, at),
    TICK = const offset_of!(Motor, registers) + 2,
    STEP = const offset_of!(Motor, step),
    STEP_END = const offset_of!(Motor, step_end),
    MAX_STEPS = const times::MAX_STEPS,
    ONLY_STEPS = const times::ONLY_STEPS,
    PREFETCH = const times::PREFETCH,
    LEFT = const offset_of!(Motor, registers) + 19,
    PULSE = const times::PULSE,
);
