//! Batches: steps that nobody looks at one by one.

use crate::engine::steps::motor::{HIGH_FIXED, Motor, flag};
use crate::engine::steps::times;
use crate::engine::tuning::plan::LIMIT_CHECK_FROM;
use core::arch::global_asm;
use core::mem::offset_of;

global_asm!(
    r#"
    .section .text.steps_plan
    // What the motor Y does next. r24: how many; 0: nothing up to the limit. r25 is 1 for steps, which the expansion makes. Otherwise it is a single event:
    // r20:21 is its tick, r22 and r23 are what it toggles at its tick and at its end, and r24 is 2 if a long pulse begins.
    // Keeps r2 to r13, r16, r17.
steps_plan:
    ldd r20, Y+{FLAGS}
    mov r24, r20
    andi r24, 1 << {TURN} | 1 << {STEPPED} | 1 << {ANCHORED} | 1 << {COMMITTED} | 1 << {SINGLY}
    cpi r24, 1 << {STEPPED} | 1 << {ANCHORED}
    brne plan_slow_up
    ldd r22, Y+{LEFT}
    ldd r23, Y+{LEFT}+1
    or r22, r23
    breq 4f
    rcall plan_prechecked
    brcs plan_check_intervals
    // As many as the caller asks for, at most.
plan_return_steps:
    lds r24, steps_times+{MAX_STEPS}
    cp r24, r31
    brlo 1f
    mov r24, r31
1:  ldi r25, 1
    ret
4:  call source_load
    brcc steps_plan
plan_slow_up:
    rjmp plan_slow

plan_check_intervals:
    ldd r24, Y+{INTERVAL}+4
    ldd r22, Y+{INTERVAL}+2             // whole ticks
    ldd r23, Y+{INTERVAL}+3
    tst r24
    brne plan_slow_up
    cpi r23, 0x40
    brsh plan_slow_up
    // No batch if the switch comes before the next step.
    ldd r20, Y+{FLAGS}
    sbrs r20, {SWITCH}
    rjmp 1f
    movw r30, r22
    load_4 r18, r19, r20, r21, {SWITCH_AT}
    rcall plan_from_tick
    brcs plan_slow_up
    movw r22, r30
    cp r22, r18
    cpc r23, r19
    brsh plan_slow_up
    rjmp 1f
plan_not_yet:
    clr r24
    ret
1:                                      // Is there time for one step?
    clr r15                             // r14:15: the time until the limit, 0 if that was not looked at
    cpi r23, 2
    brlo 7f
    movw r30, r22
    rcall plan_to_limit
    brcs plan_not_yet
    movw r22, r30
    cp r18, r22
    cpc r19, r23
    brlo plan_not_yet
    movw r14, r18
7:                                      // How far the interval may go up or down within 31 steps: 31 |add| + 465 |add2|. r18:19 is 32 |add|, r20:21 512 |add2|.
    ldd r18, Y+{ADD}+1
    ldd r19, Y+{ADD}+2
    ldd r24, Y+{ADD}+3
    sbrs r24, 7
    rjmp 2f
    com r18
    com r19
    com r24
2:  ldd r20, Y+{ADD2}+1
    ldd r21, Y+{ADD2}+2
    ldd r25, Y+{ADD2}+3
    sbrs r25, 7
    rjmp 3f
    com r20
    com r21
    com r25
3:  ldi r26, 31
    // If these take more than 16 bits, try half as many steps at a time, as below.
4:  mov r30, r24
    or r30, r25
    brne 5f
    cpi r19, 0x80
    brsh 5f
    cpi r21, 8
    brlo 6f
5:  lsr r26
    breq plan_slow_here
    lsr r24
    ror r19
    ror r18
    .rept 2
    lsr r25
    ror r21
    ror r20
    .endr
    rjmp 4b
plan_slow_here:
    rjmp plan_slow
6:  .rept 3
    lsr r19
    ror r18
    .endr
    lsl r20
    rol r21
2:  movw r30, r18
    add r30, r20
    adc r31, r21
    adiw r30, 4                         // what is left out of them
    movw r24, r22
    add r24, r30                        // the longest
    adc r25, r31
    cpi r25, 0x40
    brsh 3f
    sub r30, r22
    sbc r31, r23
    brcc 3f
    com r31                             // the shortest
    neg r30
    sbci r31, 0xff
    lds r0, steps_times+{MIN_INTERVAL}
    cp r30, r0
    lds r0, steps_times+{MIN_INTERVAL}+1
    cpc r31, r0
    brsh 4f
    // Too much change: try half as many steps. Their intervals change half as much by add, and a quarter as much by add2.
3:  lsr r26
    breq plan_slow_near
    lsr r19
    ror r18
    .rept 2
    lsr r21
    ror r20
    .endr
    rjmp 2b
4:
    ldd r20, Y+{FLAGS}
    movw r18, r14
    tst r15
    brne 7f
    // At such rates a ring is full long before the limit.
    cpi r25, 2
    brsh 3f
    ser r18
    ser r19
    sbrs r20, {SWITCH}
    rjmp plan_have_time
    // r18:19: the time until the limit, in 16 bits.
3:  rcall plan_to_limit
    brcs plan_not_yet_near
    ldd r20, Y+{FLAGS}
7:  sbrc r20, {SWITCH}
    rjmp plan_before_switch
    rjmp plan_have_time
plan_not_yet_near:
    rjmp plan_not_yet
plan_slow_near:
    rjmp plan_slow
plan_have_time:
    // r21: no more than r26, than are left, and than the caller asks for.
    lds r21, steps_times+{MAX_STEPS}
    cp r21, r26
    brlo .+2
    mov r21, r26
    ldd r22, Y+{LEFT}
    ldd r23, Y+{LEFT}+1
    tst r23
    brne 4f
    cp r22, r21
    brsh 4f
    mov r21, r22
    // Is there time for 32 of the longest interval?
4:  cpi r25, 7
    brsh 5f
    inc r25
    swap r25
    lsl r25
    cp r19, r25
    brsh 7f
    // If not, count the steps, with intervals rounded down to 1/256 of a tick. That makes 31 steps less than 24 ticks too early.
5:  subi r18, 24
    sbci r19, 0
    brcs 9f
    clr r14
    ldd r22, Y+{INTERVAL}+1
    ldd r23, Y+{INTERVAL}+2
    ldd r24, Y+{INTERVAL}+3
    ldd r25, Y+{ADD}+1
    ldd r26, Y+{ADD}+2
    ldd r27, Y+{ADD}+3
    ldd r30, Y+{ADD2}+1
    ldd r31, Y+{ADD2}+2
    ldd r0, Y+{ADD2}+3
    clr r20
6:  sub r14, r22
    sbc r18, r23
    sbc r19, r24
    brcs 8f
    inc r20
    cp r20, r21
    breq 7f
    add r22, r25
    adc r23, r26
    adc r24, r27
    add r25, r30
    adc r26, r31
    adc r27, r0
    rjmp 6b
8:  mov r21, r20
    tst r21
    brne 7f
9:  ldd r20, Y+{FLAGS}
    sbrc r20, {SWITCH}
    rjmp plan_slow
    clr r24
    ret
7:  mov r24, r21
    ldi r25, 1
    ret

    // r31: how many steps of the prechecked segment the motor Y may make now. Carry: that is not known. The motor has steps left. Uses r18 to r21, r26, r27,
    // r30.
plan_prechecked:
    ldd r30, Y+{PRECHECKED}
    andi r30, 0xff - {HIGH_FIXED}
    cpi r30, 1
    brlo 4f
    ldd r31, Y+{LEFT}
    ldd r26, Y+{LEFT}+1
    cpse r26, r1
    ser r31
    ldd r26, Y+{FLAGS}
    sbrc r26, {SWITCH}
    rjmp 1f
    // At higher rates a ring is full long before the limit.
    cpi r30, {LIMIT_CHECK_FROM}
    brsh 2f
    clc
    ret
1:  load_4 r18, r19, r20, r21, {SWITCH_AT}
    rcall 3f
    brcs 4f
2:  load_limit r18, r19, r20, r21
    // Until r18 to r21, is there time for 24 of the longest interval, or for 8?
3:  ldd r26, Y+{TICK}
    sub r18, r26
    ldd r26, Y+{TICK}+1
    sbc r19, r26
    ldd r26, Y+{TICK}+2
    sbc r20, r26
    ldd r26, Y+{TICK}+3
    sbc r21, r26
    brmi 6f
    ldi r18, 24
    or r20, r21
    brne 5f
    mov r26, r30
    lsl r26
    lsl r26
    lsl r26
    mov r27, r26
    lsl r27
    add r27, r26
    cp r19, r27
    brsh 5f
    ldi r18, 8
    cp r19, r26
    brlo 4f
5:  cp r31, r18
    brlo 7f
    mov r31, r18
7:  clc
4:  ret
6:  sec
    ret

    // r18:19: the limit, or the tick r18 to r21, less the registers' tick, in 16 bits. Carry: it is before that. Uses r22.
plan_to_limit:
    load_limit r18, r19, r20, r21
plan_from_tick:
    ldd r22, Y+{TICK}
    sub r18, r22
    ldd r22, Y+{TICK}+1
    sbc r19, r22
    ldd r22, Y+{TICK}+2
    sbc r20, r22
    ldd r22, Y+{TICK}+3
    sbc r21, r22
    brmi 1f
    or r20, r21
    breq 2f
    ser r18
    ser r19
2:  clc
    ret
1:  sec
    ret

    // No step at the switch or after it: r18:19 ends a tick before it.
plan_before_switch:
    movw r30, r18
    load_4 r18, r19, r20, r21, {SWITCH_AT}
    subi r18, 1
    sbci r19, 0
    sbci r20, 0
    sbci r21, 0
    rcall plan_from_tick
    brcc 1f
    rjmp plan_slow
1:  cp r30, r18
    cpc r31, r19
    brsh 2f
    movw r18, r30
2:  rjmp plan_have_time
    "#,
    TICK = const offset_of!(Motor, registers) + 2,
    INTERVAL = const offset_of!(Motor, registers) + 6,
    ADD = const offset_of!(Motor, registers) + 11,
    ADD2 = const offset_of!(Motor, registers) + 15,
    LEFT = const offset_of!(Motor, registers) + 19,
    FLAGS = const offset_of!(Motor, flags),
    PRECHECKED = const offset_of!(Motor, prechecked),
    LIMIT_CHECK_FROM = const LIMIT_CHECK_FROM,
    HIGH_FIXED = const HIGH_FIXED,
    SWITCH_AT = const offset_of!(Motor, switch_at),
    TURN = const flag::TURN,
    STEPPED = const flag::STEPPED,
    ANCHORED = const flag::ANCHORED,
    COMMITTED = const flag::COMMITTED,
    SWITCH = const flag::SWITCH,
    SINGLY = const flag::SINGLY,
    MIN_INTERVAL = const times::MIN_INTERVAL,
    MAX_STEPS = const times::MAX_STEPS,
);
