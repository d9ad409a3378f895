//! The ring of a motor that has one of its own: plan, expand, publish, until the ring is full.
//!
//! # Cycles
//! 80 a batch and 90 a call, beside what [`plan`](super::plan) and [`expand`](super::expand) take.

use super::motor::Motor;
use super::plan::Plan;
use super::ring::Ring;
use super::stepper::Track;
use super::times;
use core::arch::global_asm;
use core::mem::offset_of;

/// A ring is filled when it has room for so many groups.
const ROOM: u8 = 14;
/// Steps that are expanded at once when there is room for [`LOW`] of them or more: the ring runs low. Else as many as there is
/// room for.
const FEW: u8 = 16;
const LOW: u8 = 30;
/// Batches that are expanded in one go.
const BATCHES: u8 = 8;
/// The answer when the ring is full, or has had its batches.
const FULL: u8 = 255;

global_asm!(
    r#"
    .section .text.steps_fill, "ax", @progbits
    .global steps_fill
    // r24:25: the track; r22:23: its motor. The result is that of steps_plan, or FULL in r24.
    // Inside, r2:3 is the track, Y the motor; the batches left are on the stack.
steps_fill:
    .irp r, 2,3,8,9,10,11,12,13,14,15,16,17,28,29
    push r\r
    .endr
    movw r2, r24
    movw r28, r22
    ldi r24, {BATCHES}
    push r24
fill_next:
    // Is there room?
    movw r30, r2
    ldd r26, Z+{TAIL_AT}
    clr r27
    ld r26, X
    ldd r24, Z+{HEAD}
    sub r26, r24
    dec r26
    lsr r26
    lsr r26
    cpi r26, {ROOM}
    brlo 1f
    pop r24
    subi r24, 1
    push r24
    brcc 6f
1:  ldi r24, {FULL}
    rjmp fill_done
6:  ldd r24, Y+{STEP}
    ldd r25, Y+{STEP_FALL}
    cpse r24, r25
    lsr r26
    dec r26
    // Few at once while the ring runs low: they are published the sooner.
    ldi r24, {FEW}
    cpi r26, {LOW}
    brsh 2f
    mov r24, r26
2:  sts steps_times+{MOST}, r24
    call steps_plan
    tst r24
    breq 7f
    sbrs r25, 0
7:  rjmp fill_done
    // r24 steps
    mov r20, r24
    movw r30, r2
    ldd r18, Z+{STEP_FIRST}
    ldd r19, Z+{LAST_BYTE}
    ldd r23, Z+{UNLIKE}
    mov r24, r23
    sub r24, r20
    brcc 7f
    clr r24
7:  std Z+{UNLIKE}, r24
    ldd r24, Z+{HEAD}
    ldd r31, Z+{PAGE}
    mov r30, r24
    push r24
    ldd r26, Y+{STEP}
    ldd r27, Y+{STEP_FALL}
    cp r26, r27
    brne 3f
    tst r23
    brne 8f
    call steps_expand_ring_again
    rjmp 4f
8:  call steps_expand_ring
    rjmp 4f
3:  lds r17, steps_times+{PULSE}
    call steps_expand_ring_long
    // Published from the end: what was pending comes last.
4:  pop r22
    movw r30, r2
    mov r26, r24
    ldd r27, Z+{PAGE}
    ldd r25, Z+{STEP_LAST}
    st X, r25
    std Z+{HEAD}, r24
    mov r26, r22
    ldd r25, Z+{BEFORE_STEP}
    st X, r25
    ldd r25, Z+{STEP_FIRST}
    std Z+{BEFORE_STEP}, r25
    ldd r22, Y+{STEP}
    ldd r23, Y+{STEP_FALL}
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
    rjmp fill_next
fill_done:
    pop r0
    .irp r, 29,28,17,16,15,14,13,12,11,10,9,8,3,2
    pop r\r
    .endr
    ret
    "#,
    BATCHES = const BATCHES,
    ROOM = const ROOM,
    FEW = const FEW,
    LOW = const LOW,
    FULL = const FULL,
    TAIL_AT = const offset_of!(Track, ring) + offset_of!(Ring, tail_at),
    UNLIKE = const offset_of!(Track, ring) + offset_of!(Ring, unlike),
    HEAD = const offset_of!(Track, ring) + offset_of!(Ring, head),
    PAGE = const offset_of!(Track, ring) + offset_of!(Ring, page),
    PENDING = const offset_of!(Track, ring) + offset_of!(Ring, pending),
    BEFORE_STEP = const offset_of!(Track, ring) + offset_of!(Ring, before_step),
    STEP_FIRST = const offset_of!(Track, ring) + offset_of!(Ring, step_first),
    STEP_LAST = const offset_of!(Track, ring) + offset_of!(Ring, step_last),
    LAST_BYTE = const offset_of!(Track, ring) + offset_of!(Ring, step_fall),
    AT = const offset_of!(Track, at),
    TICK = const offset_of!(Motor, registers) + 2,
    STEP = const offset_of!(Motor, step),
    STEP_FALL = const offset_of!(Motor, step_fall),
    MOST = const times::MOST,
    PULSE = const times::PULSE,
);

#[expect(improper_ctypes, reason = "the assembly knows fields by their offsets")]
unsafe extern "C" {
    fn steps_fill(track: *mut Track, motor: *mut Motor) -> u64;
}

/// Fills `track` with steps of `motor`, its only one; up to one thing that the assembly leaves to others: a [`Plan::One`].
#[inline(always)]
pub(super) fn fill(track: &mut Track, motor: &mut Motor) -> Option<Plan> {
    // SAFETY: the assembly uses both, the ring's page beyond what is published, the queue's memory and the times alone.
    let answer = unsafe { steps_fill(track, motor) }.to_le_bytes();
    match answer {
        [.., FULL | 0, _] => None,
        answer => Some(Plan::of(answer)),
    }
}
