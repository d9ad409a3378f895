//! The lists: filled when they are used up, topped up before that.

use super::state::MOTORS;
use super::{LANE_SIZE, LIST, Lane, Merge, SHORT_LANE, SHORT_LIST};
use crate::engine::steps::motor::{HIGH_FIXED, Motor, flag};
use crate::engine::steps::plan::prechecked_steps;
use crate::engine::steps::register;
use crate::engine::steps::ring::{GROUPS, Group, flags};
use crate::engine::tuning::merge::{LIST_LOW_BEFORE_SWITCH, TOP_UP_BEFORE_SWITCH_FROM, TOP_UP_FROM};
use crate::engine::tuning::plan::LIMIT_CHECK_FROM;
use crate::engine::tuning::stepper::BATCH_STEPS;
use core::arch::global_asm;
use core::mem::offset_of;

global_asm!(
    r#"
    .section .text.steps_merge_run
    .global merge_fill_up
merge_fill_up:
    lds r2, steps_merge+{MOTORS}
    ldi r28, lo8(steps_motors)
    ldi r29, hi8(steps_motors)
    ldi r24, lo8(steps_merge)
    ldi r25, hi8(steps_merge)
    movw r4, r24                        // the lane
    ldi r24, 2 * {LIST}
    mov r3, r24                         // where its list ends
    // Skip lists with enough left.
2:  movw r30, r4
    ldd r24, Z+{NEXT}
    mov r25, r3
    sub r25, r24
    cpi r25, {LIST_LOW_BEFORE_SWITCH}
    brsh 4f
    ldd r24, Y+{FLAGS}
    sbrc r24, {SWITCH}
    rjmp 5f
    lds r24, steps_merge+{LIST_LOW}
    cp r25, r24
    brsh 4f
5:  sbic {FLAGS_IO}, {NOT_PLAIN_B}
    rcall merge_serve_shield_b
    rcall merge_top_up
    brcc 3f
4:
    subi r28, lo8(-({MOTOR_SIZE}))
    sbci r29, hi8(-({MOTOR_SIZE}))
    ldi r24, {LANE_SIZE}
    add r4, r24
    adc r5, r1
    ldi r24, 2 * {LIST}
    add r24, r3
    short_list_end r24
    mov r3, r24
    dec r2
    brne 2b
    sec
3:  ret

    // Between two lists: refill ring B of the shield first, if it has run low.
merge_serve_shield_b:
    unless_shield_b_is_low 1f
    .irp r, 2,3,4,5,28,29
    push r\r
    .endr
    call ring_fill_shield_b
    .irp r, 29,28,5,4,3,2
    pop r\r
    .endr
1:  ret

    // Tops up the list of the lane r4:5, whose motor is Y, if it has few ticks left, all of them steps, and more steps are to come. This also loads the
    // motor's records and makes its switches. Carry is clear if the ring has run down meanwhile.
merge_top_up:
    lds r24, steps_merge+{AT}
    lds r30, steps_merge+{TAIL}
    ldi r31, 0
    ld r25, Z
    sub r25, r24
    ldi r24, 4 * ({GROUPS} - {TOP_UP_FROM} + 1)
    ldd r30, Y+{FLAGS}
    sbrc r30, {SWITCH}
    ldi r24, 4 * ({GROUPS} - {TOP_UP_BEFORE_SWITCH_FROM} + 1)
    cp r25, r24
    brcs .+2
    ret
    movw r30, r4
    ldd r6, Z+{NEXT}
    mov r7, r3
    sub r7, r6                          // bytes that are left
    lds r24, steps_merge+{LIST_LOW}
    ldd r25, Y+{FLAGS}
    sbrc r25, {SWITCH}
    ldi r24, {LIST_LOW_BEFORE_SWITCH}
    cp r7, r24
    brsh 9f
    ldd r24, Z+{AT_TICK}
    ldd r25, Y+{STEP}
    tst r25                             // a lane of no motor
    breq 9f
    cp r24, r25
    brne 9f
    ldd r24, Y+{STEP_END}
    cp r24, r25
    brne 9f
    mov r24, r7
    lsr r24
    neg r24
    subi r24, -{LIST}
    sbrc r3, 5
    subi r24, {LIST} - {SHORT_LIST}
    breq 9f                             // it is full, as it may be before a switch; no other is
    lds r8, steps_times+{MAX_STEPS}
    sts steps_times+{MAX_STEPS}, r24
    sts steps_times+{ONLY_STEPS}, r24
    call steps_plan
    sts steps_times+{ONLY_STEPS}, r1
    sts steps_times+{MAX_STEPS}, r8
    tst r24
    brne 1f
9:  sec
    ret
    // Move what is left, so that the r24 steps have room behind it.
1:  mov r20, r24
    lsl r24
    mov r30, r6
    ldi r31, hi8(ring_b_page)
    mov r26, r6
    sub r26, r24
    ldi r27, hi8(ring_b_page)
    mov r6, r26
    rjmp 4f
3:  ld r25, Z+
    st X+, r25
    dec r7
4:  tst r7
    brne 3b
    movw r30, r26                       // the last list ends with its page
    call steps_expand_list
    movw r30, r4
    std Z+{NEXT}, r6
    rjmp merge_top_up

    // What the motor of the lane r30 does next goes into its list; r18:19 is the deadline. Carry: nothing. Keeps r2 to r13, r16, r17.
merge_fill_list:
    lds r24, steps_merge+{LISTS}
    subi r24, 1
    brcc 1f
    ret
1:  sts steps_merge+{LISTS}, r24
    push r30
    ldi r24, {MOTOR_SIZE}
    mul r30, r24
    movw r28, r0
    clr r1
    subi r28, lo8(-(steps_motors))
    sbci r29, hi8(-(steps_motors))
    ldd r24, Y+{STEP}
    tst r24
    breq 1f
    "#,
    prechecked_steps!("6f"),
    r#"
    lds r25, steps_times+{MAX_STEPS}
    cpi r30, {SHORT_LANE}
    brne 8f
    lds r31, steps_merge+{THIRD_END}
    sbrc r31, 5
    ldi r25, {SHORT_LIST}
8:  cp r24, r25
    brlo .+2
    mov r24, r25
    ldi r25, 1
    rjmp 7f
6:  cpi r30, {SHORT_LANE}
    brne 6f
    lds r31, steps_merge+{THIRD_END}
    sbrs r31, 5
    rjmp 6f
    ldi r24, {SHORT_LIST}
    sts steps_times+{MAX_STEPS}, r24
    call steps_plan
    ldi r31, {BATCH_STEPS}
    sts steps_times+{MAX_STEPS}, r31
    rjmp 7f
6:  call steps_plan
7:  pop r30
    tst r24
    brne 2f
    sec
    ret
    // A lane without a motor: a filler, after the pending group.
1:  pop r30
    movw r20, r18
    subi r21, 256 - ({FILLER} >> 8)
    clr r22
    clr r23
    ldi r24, 1
    clr r25
2:                                      // X: the lane; r30: where its list ends
    ldi r26, {LANE_SIZE}
    mul r30, r26
    movw r26, r0
    clr r1
    subi r26, lo8(-(steps_merge))
    sbci r27, hi8(-(steps_merge))
    inc r30
    swap r30
    lsl r30
    lsl r30
    short_list_end r30
    ldi r31, hi8(ring_b_page)
    cpi r25, 1
    breq 3f
    // a single event
    st X+, r22
    st X+, r23
    adiw r26, 2
    subi r30, 2
    cpi r24, 1
    breq 1f
    subi r30, 2
    st X, r30
    st Z+, r20
    st Z+, r21
    lds r24, steps_times+{PULSE}
    add r20, r24
    lds r24, steps_times+{PULSE}+1
    adc r21, r24
    rjmp 2f
1:  st X, r30
2:  st Z+, r20
    st Z+, r21
    clc
    ret
    // r24 steps
3:  ldd r22, Y+{STEP}
    ldd r23, Y+{STEP_END}
    st X+, r22
    st X+, r23
    adiw r26, 2
    mov r20, r24
    lsl r24
    cpse r22, r23
    lsl r24
    sub r30, r24
    st X, r30
    .irp r, 8,9,10,11,12,13,16,17
    push r\r
    .endr
    cp r22, r23
    brne 4f
    call steps_expand_list
    rjmp 5f
4:  lds r17, steps_times+{PULSE}
    call steps_expand_list_long
5:  .irp r, 17,16,13,12,11,10,9,8
    pop r\r
    .endr
    clc
    ret
    "#,
    MOTORS = const MOTORS,
    AT_TICK = const offset_of!(Lane, masks) + offset_of!(Group, at_tick),
    NEXT = const offset_of!(Lane, next),
    AT = const offset_of!(Merge, at),
    TAIL = const offset_of!(Merge, tail),
    LISTS = const offset_of!(Merge, lists_left),
    LANE_SIZE = const LANE_SIZE,
    THIRD_END = const offset_of!(Merge, third_end),
    MOTOR_SIZE = const size_of::<Motor>(),
    STEP = const offset_of!(Motor, step),
    STEP_END = const offset_of!(Motor, step_end),
    PULSE = const crate::engine::steps::times::PULSE,
    GROUPS = const GROUPS,
    FLAGS_IO = const register::GPIOR0,
    NOT_PLAIN_B = const flags::NOT_PLAIN_B,
    SHORT_LANE = const SHORT_LANE,
    SHORT_LIST = const SHORT_LIST,
    BATCH_STEPS = const BATCH_STEPS,
    TOP_UP_FROM = const TOP_UP_FROM,
    TOP_UP_BEFORE_SWITCH_FROM = const TOP_UP_BEFORE_SWITCH_FROM,
    LIST_LOW = const offset_of!(Merge, list_low),
    LIST_LOW_BEFORE_SWITCH = const LIST_LOW_BEFORE_SWITCH,
    FLAGS = const offset_of!(Motor, flags),
    SWITCH = const flag::SWITCH,
    TURN = const flag::TURN,
    STEPPED = const flag::STEPPED,
    ANCHORED = const flag::ANCHORED,
    COMMITTED = const flag::COMMITTED,
    SINGLY = const flag::SINGLY,
    PRECHECKED = const offset_of!(Motor, prechecked),
    HIGH_FIXED = const HIGH_FIXED,
    LIMIT_CHECK_FROM = const LIMIT_CHECK_FROM,
    LEFT = const offset_of!(Motor, registers) + 19,
    FILLER = const crate::engine::steps::plan::FILLER,
    LIST = const LIST,
    MAX_STEPS = const crate::engine::steps::times::MAX_STEPS,
    ONLY_STEPS = const crate::engine::steps::times::ONLY_STEPS,
);
