//! What a motor does next: a batch of steps that need no looking at, or one thing with its tick.
//!
//! # Fast and slow
//! As long as a motor only steps, with intervals between [`Times::fastest`](super::times::Times) and 16 383 ticks that change
//! little, its next steps are granted at once: nobody looks at them one by one, the expansion makes them
//! ([`expand`](super::expand)). That all of a segment's are such is found out when it is loaded ([`Motor::prechecked`]), where it
//! is; else it is looked at for up to 31, 15, 7, 3 or one. All else is one thing at a time: a step, a turn of DIR, or nothing at all, which keeps the
//! compare register moving (no two things are more than [`FILLER`] ticks apart).
//!
//! # DIR
//! A line turns [`Times::early`](super::times::Times) before its step, or later if it is not free until then, but `lead` before
//! it at least. The step is then committed: no switch takes it back.
//!
//! # Cycles
//! 30 a batch; 85 where the limit is looked at, 120 where a switch waits too; 110 where intervals are, and 35 more for each halving, and 16 for each step
//! that is counted up to the limit; 250 to 400 for one thing.

use super::brake::{STATE, state};
use super::motor::{EpochBytes, FaultKind, HIGH_FIXED, Motor, Switch, WAITING_EPOCHS, flag};
use super::times;
use crate::ThisProgram;
use crate::engine::program::Program;
use crate::engine::tuning::plan::{DIR_CLEARANCE, LIMIT_CHECK_FROM};
use core::arch::global_asm;
use core::mem::offset_of;

/// Two things that a motor does are so far apart at most, ticks: at 2^14 the compare register is a quarter of the way round.
pub(crate) const FILLER: u16 = ThisProgram::FILLER;
const _: () = assert!(FILLER <= 16_384 && FILLER % 256 == 0);

/// What the motor Y makes next, for assembly, if it is steps of a segment all of which are sure, and soon enough: how many are left of them,
/// up to 255, in r24. Else it goes to `$slow`, where [`plan`](self) says. ThisProgram r25.
macro_rules! prechecked_steps {
    ($slow:literal) => {
        concat!(
            "
    ldd r24, Y+{FLAGS}
    andi r24, 1 << {TURN} | 1 << {STEPPED} | 1 << {ANCHORED} | 1 << {COMMITTED} | 1 << {SWITCH} | 1 << {SINGLY}
    cpi r24, 1 << {STEPPED} | 1 << {ANCHORED}
    brne ",
            $slow,
            "
    ldd r24, Y+{PRECHECKED}
    andi r24, 0xff - {HIGH_FIXED}
    dec r24
    cpi r24, {LIMIT_CHECK_FROM} - 1
    brsh ",
            $slow,
            "
    ldd r24, Y+{LEFT}
    ldd r25, Y+{LEFT}+1
    cpse r25, r1
    ser r24
    tst r24
    breq ",
            $slow,
            "\n"
        )
    };
}
pub(super) use prechecked_steps;

/// Where in a motor its switch is, behind its parts.
pub(super) const OF_SWITCH: usize = offset_of!(Motor, switch) - offset_of!(Motor, epochs);

global_asm!(
    r#"
    .macro load_4 a, b, c, d, offset
    ldd \a, Y+\offset
    ldd \b, Y+\offset+1
    ldd \c, Y+\offset+2
    ldd \d, Y+\offset+3
    .endm
    .macro store_4 a, b, c, d, offset
    std Y+\offset, \a
    std Y+\offset+1, \b
    std Y+\offset+2, \c
    std Y+\offset+3, \d
    .endm
    .macro load_limit a, b, c, d
    lds \a, steps_times+{LIMIT}
    lds \b, steps_times+{LIMIT}+1
    lds \c, steps_times+{LIMIT}+2
    lds \d, steps_times+{LIMIT}+3
    .endm
    // Compares a to d with the moment at Y+\offset; N: it is before. ThisProgram \temp.
    .macro compare_4 a, b, c, d, offset, temp
    ldd \temp, Y+\offset
    cp \a, \temp
    ldd \temp, Y+\offset+1
    cpc \b, \temp
    ldd \temp, Y+\offset+2
    cpc \c, \temp
    ldd \temp, Y+\offset+3
    cpc \d, \temp
    .endm

    // Passes over what waits of epochs before that of r22; Z is at the motor Y's parts. \if_also: T says that of the epoch being run in any case, and
    // otherwise what waits of that of r22 goes as well. ThisProgram r20, r21, X, r18, r19.
    .macro drop_epochs if_also
    ldd r26, Y+{NEXT}
    ldd r27, Y+{NEXT}+1
    ldd r18, Y+{END}
    ldd r19, Y+{END}+1
93: ld r20, Z
    ldd r21, Z+1
    add r26, r20
    adc r27, r21
    cp r26, r18
    cpc r27, r19
    brlo 94f
    ldd r20, Y+{START}
    ldd r21, Y+{START}+1
    sub r26, r18
    sbc r27, r19
    add r26, r20
    adc r27, r21
94:
    .if \if_also
    st Z, r1
    std Z+1, r1
    brts 95f
    ldd r20, Z+{EPOCH_RUNNING}
    cp r20, r22
    breq 97f
    .endif
95: ldi r20, {WAITING_EPOCHS} * {EPOCH_SIZE}
96: ldd r21, Z+{EPOCH_SIZE}
    st Z+, r21
    dec r20
    brne 96b
    st Z, r1                            // the last one: no bytes
    std Z+1, r1
    std Z+2, r1
    sbiw r30, {WAITING_EPOCHS} * {EPOCH_SIZE}
    ldd r20, Z+{WAITING}
    subi r20, 1
    brcs 97f
    std Z+{WAITING}, r20
    .if \if_also
    brtc 93b
    .endif
    ldd r21, Z+{EPOCH_RUNNING}
    cp r21, r22
    brne 93b
97: std Z+{EPOCH_RUNNING}, r22
    std Y+{NEXT}, r26
    std Y+{NEXT}+1, r27
    .endm
    // Nothing is done before the switch, which is r18 to r21 then. ThisProgram r26.
    .macro horizon_to_switch
    load_4 r18, r19, r20, r21, {SWITCH_AT}
    compare_4 r18, r19, r20, r21, {HORIZON}, r26
    brmi 98f
    store_4 r18, r19, r20, r21, {HORIZON}
98:
    .endm

    .section .text.steps_plan, "ax", @progbits
    .global steps_settle, steps_plan, plan_slow, plan_window, plan_make_step
    // Horizon, last and free, if they were left to follow from the last step. ThisProgram r18 to r21, r24, r25.
steps_settle:
    ldd r24, Y+{FLAGS}
    sbrs r24, {STEPPED}
    ret
    andi r24, 0xff - (1 << {STEPPED})
    std Y+{FLAGS}, r24
    load_4 r18, r19, r20, r21, {TICK}
    store_4 r18, r19, r20, r21, {LAST}
    lds r24, steps_times+{STEP_GAP}
    lds r25, steps_times+{STEP_GAP}+1
    add r18, r24
    adc r19, r25
    adc r20, r1
    adc r21, r1
    store_4 r18, r19, r20, r21, {HORIZON}
    load_4 r18, r19, r20, r21, {TICK}
    lds r24, steps_times+{DIR_HOLD}
    lds r25, steps_times+{DIR_HOLD}+1
    add r18, r24
    adc r19, r25
    adc r20, r1
    adc r21, r1
    store_4 r18, r19, r20, r21, {DIR_FREE}
    ret

    // What the motor Y does next. r24: how many; 0: nothing within the limit. r25 is 1 for steps that the expansion makes;
    // else r20:21 is the tick of one thing, r22 and r23 its rise and fall, and r24 is 2 if a long pulse begins.
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
    // As many as are asked for.
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
    // Not if the switch comes first.
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
    clr r15                             // r14:15: the time until the limit, 0 if that was not looked at
    rjmp 7f
plan_not_yet:
    clr r24
    ret
1:  // Is there time for one step?
    clr r15
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
7:  // How far the interval may go up or down within 31 steps: 31 |add| + 465 |add2|. r18:19 is 32 |add|, r20:21 512 |add2|.
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
    // Where they take more than 16 bits, for half as many at a time, as below.
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
    // Too far: half as many, whose intervals go half as far by add, and a quarter as far by add2.
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
    // The time until the limit, in 16 bits.
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
    // No more than r26, than are left, and are asked for.
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
    // Is there time for 32 of the longest?
4:  cpi r25, 7
    brsh 5f
    inc r25
    swap r25
    lsl r25
    cp r19, r25
    brsh 7f
    // If not, they are counted with intervals that are cut to 1/256 of a tick. 31 steps come less than 24 ticks later than that.
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

    // Steps that the motor Y may make without anybody looking at them, in r31; carry: perhaps none. It has some left. ThisProgram r18 to r21,
    // r26, r27, r30.
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
    // Is there time until r18 to r21 for 24 of the longest, or for 8?
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

    // The limit, or the moment r18 to r21, less the registers' tick, in 16 bits, r18:19. Carry: it is before that. ThisProgram r22.
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

    // No step at or after the switch: r18:19 at most until a tick before it.
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

plan_fail:                              // for a reason in r22; r18 to r21: when
    .if {LEASES}
    call brake_fail
    .else
    clr r23
    movw r24, r28
    call steps_fail
    .endif
plan_slow:
    rcall steps_settle
1:  ldd r24, Y+{LEFT}
    ldd r25, Y+{LEFT}+1
    or r24, r25
    brne plan_step
    call source_load
    brcc 1b
    // Nothing is left to be run.
    rcall plan_window
    ldd r24, Y+{FLAGS}
    sbrs r24, {SWITCH}
    rjmp 2f
    rcall plan_switch_due
    brcs 2f
    rjmp plan_near_switch
2:
    .if {LEASES}
    call brake_check_underrun
    brcc 3f
    ldi r22, {UNDERRUN}
    rjmp plan_fail
3:
    .endif
    rjmp plan_wait

plan_step:
    rcall plan_window
    // r22 to r25: the tick of the next step
    ldd r26, Y+{FRACTION}
    ldd r27, Y+{INTERVAL}
    add r26, r27
    ldd r26, Y+{FRACTION}+1
    ldd r27, Y+{INTERVAL}+1
    adc r26, r27
    load_4 r22, r23, r24, r25, {TICK}
    ldd r26, Y+{INTERVAL}+2
    adc r22, r26
    ldd r26, Y+{INTERVAL}+3
    adc r23, r26
    ldd r26, Y+{INTERVAL}+4
    adc r24, r26
    adc r25, r1
    // How far that is beyond the window
    movw r26, r22
    movw r30, r24
    sub r26, r18
    sbc r27, r19
    sbc r30, r20
    sbc r31, r21
    ldd r0, Y+{FLAGS}
    sbrc r0, {COMMITTED}
    rjmp plan_committed
    tst r31
    brmi 3f
    or r30, r31
    brne plan_beyond
    lds r14, steps_times+{DIR_EARLY}
    lds r15, steps_times+{DIR_EARLY}+1
    cp r14, r26
    cpc r15, r27
    brlo plan_beyond
    // Does the switch come first?
3:  sbrs r0, {SWITCH}
    rjmp 4f
    compare_4 r22, r23, r24, r25, {SWITCH_AT}, r26
    brpl plan_near_switch
    // Is it too soon?
4:  compare_4 r22, r23, r24, r25, {HORIZON}, r26
    brpl 5f
    .if {LEASES}
    // A step of a stop is late then.
    sbrc r0, {UNREADABLE}
    rjmp 5f
    .endif
plan_step_missed:
    movw r18, r22
    movw r20, r24
    ldi r22, {MISSED}
    rjmp plan_fail
5:  sbrc r0, {SINGLY}
    rjmp plan_hand_to_caller
plan_dir_is_right:
    sbrc r0, {TURN}
    rjmp plan_turn_dir
    movw r26, r22
    movw r30, r24
    sub r26, r18
    sbc r27, r19
    sbc r30, r20
    sbc r31, r21
plan_committed:                         // r26, r27, r30, r31: how far beyond the window it is
    mov r14, r26
    or r14, r27
    or r14, r30
    or r14, r31
    breq 1f
    sbrs r31, 7
    rjmp plan_wait_for
1:  mov r26, r0
    andi r26, 1 << {COMMITTED} | 1 << {SINGLY}
    brne plan_one_step
    rjmp plan_first_of_batch
plan_one_step:
    rcall plan_return_if_only_steps
    rcall plan_make_step
    ldd r22, Y+{STEP}
    ldd r23, Y+{STEP_END}
    clr r25
    ldi r24, 1
    cpse r22, r23
    ldi r24, 2
    ret

plan_beyond:
    sbrs r0, {SWITCH}
    rjmp plan_wait
    rcall plan_switch_due
    brcs plan_wait
plan_near_switch:                             // branches do not reach it
    rjmp plan_make_switch

    // The window: r18 to r21 is the last tick at which something may be done now. T: that is the limit.
plan_window:
    load_4 r18, r19, r20, r21, {LAST}
    subi r19, {FILLER_HIGH}
    sbci r20, -1
    sbci r21, -1
    load_limit r22, r23, r24, r25
    clt
    cp r22, r18
    cpc r23, r19
    cpc r24, r20
    cpc r25, r21
    brpl 1f
    set
    movw r18, r22
    movw r20, r24
1:  ret

    // Carry is clear if the switch is due within the window, or `early` after it. ThisProgram r14, r15, r26, r27, r30, r31.
plan_switch_due:
    movw r26, r18
    movw r30, r20
    lds r14, steps_times+{DIR_EARLY}
    lds r15, steps_times+{DIR_EARLY}+1
    add r26, r14
    adc r27, r15
    adc r30, r1
    adc r31, r1
    compare_4 r26, r27, r30, r31, {SWITCH_AT}, r14
    clc
    brpl 1f
    sec
1:  ret

    // Nothing until the window's end. What comes within 512 ticks after it, by r26, r27, r30, r31, is given room.
plan_wait_for:
    or r30, r31
    brne plan_wait
    cpi r27, 2
    brsh plan_wait
    brts 4f
    subi r19, 2
    sbci r20, 0
    sbci r21, 0
plan_wait:
    brts 4f
    rjmp 5f
4:  clr r24
    ret
5:  rcall plan_return_if_only_steps
    mov r25, r21
    lds r24, steps_times+{SHARED}
    tst r24
    brne 2f
    store_4 r18, r19, r20, r21, {LAST}
    // DIR keeps clear of it.
    movw r22, r18
    movw r24, r20
    subi r22, 256 - {DIR_CLEARANCE}
    sbci r23, -1
    sbci r24, -1
    sbci r25, -1
    compare_4 r22, r23, r24, r25, {DIR_FREE}, r26
    brmi 1f
    store_4 r22, r23, r24, r25, {DIR_FREE}
    // Nobody may come back to before it.
1:  movw r22, r18
    movw r24, r20
    sec
    adc r22, r1
    adc r23, r1
    adc r24, r1
    adc r25, r1
    compare_4 r22, r23, r24, r25, {HORIZON}, r26
    brmi 2f
    store_4 r22, r23, r24, r25, {HORIZON}
    // An accumulator that is left behind would come back as the future.
2:  ldd r26, Y+{LEFT}
    ldd r27, Y+{LEFT}+1
    or r26, r27
    brne 3f
    ldd r26, Y+{TICK}+3
    sub r25, r26
    cpi r25, 0x41
    brlo 3f
    cpi r25, 0x80
    brsh 3f
    ldd r24, Y+{FLAGS}
    andi r24, 0xff - (1 << {ANCHORED})
    std Y+{FLAGS}, r24
3:  movw r20, r18
    ldi r24, 1
    clr r22
    clr r23
    clr r25
    ret

    // Turns DIR before the step at r22 to r25.
plan_turn_dir:
    rcall plan_return_if_only_steps
    movw r26, r22
    movw r30, r24
    lds r14, steps_times+{DIR_EARLY}
    lds r15, steps_times+{DIR_EARLY}+1
    sub r26, r14
    sbc r27, r15
    sbc r30, r1
    sbc r31, r1
    compare_4 r26, r27, r30, r31, {DIR_FREE}, r14
    brpl 1f
    load_4 r26, r27, r30, r31, {DIR_FREE}
1:  compare_4 r26, r27, r30, r31, {LAST}, r14
    brpl 2f
    load_4 r26, r27, r30, r31, {LAST}
    // Is there time enough until the step? It is less than 2^15.
2:  movw r14, r22
    sub r14, r26
    sbc r15, r27
    lds r0, steps_times+{DIR_SETUP}
    cp r14, r0
    lds r0, steps_times+{DIR_SETUP}+1
    cpc r15, r0
    brge 4f
    rjmp plan_step_missed
4:  sub r26, r18
    sbc r27, r19
    sbc r30, r20
    sbc r31, r21
    mov r0, r26
    or r0, r27
    or r0, r30
    or r0, r31
    breq 3f
    tst r31
    brmi 3f
    rjmp plan_wait_for
3:  add r26, r18
    adc r27, r19
    adc r30, r20
    adc r31, r21
    store_4 r26, r27, r30, r31, {LAST}
    sec
    adc r22, r1
    adc r23, r1
    adc r24, r1
    adc r25, r1
    store_4 r22, r23, r24, r25, {HORIZON}
    ldd r24, Y+{FLAGS}
    andi r24, 0xff - (1 << {TURN})
    ori r24, 1 << {COMMITTED}
    std Y+{FLAGS}, r24
    ldd r23, Y+{DIR}
    ldd r24, Y+{LEVELS}
    eor r24, r23
    std Y+{LEVELS}, r24
    movw r20, r26
    clr r22
    clr r25
    ldi r24, 1
    ret

    // Behind this is what does something that is no step: if steps alone are asked for, there are none. ThisProgram r26.
plan_return_if_only_steps:
    lds r26, steps_times+{ONLY_STEPS}
    tst r26
    breq 1f
    pop r26
    pop r26
plan_none:
    clr r24
1:  ret

    // Where steps are looked at one by one, somebody else may have to do something about the line before.
plan_hand_to_caller:
    lds r26, steps_times+{SHARED}
    tst r26
    brne 1f
    rjmp plan_dir_is_right
1:  store_4 r22, r23, r24, r25, {DUE}
    ldi r24, 3
    clr r25
    ret

    // Goes over to the epoch of the switch that waits: without steps, anchor and prediction, and forward.
plan_make_switch:
    // Steps that are left of the old one are not made.
    load_4 r18, r19, r20, r21, {POSITION}
    ldd r22, Y+{LEFT}
    ldd r23, Y+{LEFT}+1
    ldd r24, Y+{FLAGS}
    sbrc r24, {BACKWARD}
    rjmp 1f
    sub r18, r22
    sbc r19, r23
    sbc r20, r1
    sbc r21, r1
    rjmp 2f
1:  add r18, r22
    adc r19, r23
    adc r20, r1
    adc r21, r1
    ldi r25, 1 << {BACKWARD} | 1 << {TURN}
    eor r24, r25
2:  store_4 r18, r19, r20, r21, {POSITION}
    std Y+{LEFT}, r1
    std Y+{LEFT}+1, r1
    .if {LEASES}
    movw r30, r28
    subi r30, lo8(-({EPOCHS}))
    sbci r31, hi8(-({EPOCHS}))
    ldd r25, Z+{STATE}
    sbrc r25, {AWAITS}
    jmp brake_begin
    std Z+{STATE}, r1
    .endif
    andi r24, 0xff - (1 << {ANCHORED} | 1 << {UNREADABLE} | 1 << {SWITCH})
    std Y+{FLAGS}, r24
    call load_clear
    .if {LEASES}
    ldd r22, Z+{SWITCH_EPOCH}
    set
    rcall plan_drop_epochs
    std Z+{FAULT_KIND}, r1
    rcall plan_horizon_to_switch
    .else
    movw r30, r28
    subi r30, lo8(-({EPOCHS}))
    sbci r31, hi8(-({EPOCHS}))
    ldd r22, Z+{SWITCH_EPOCH}
    drop_epochs 0
    std Z+{FAULT_KIND}, r1
    horizon_to_switch
    .endif
    .if {LEASES}
    call brake_check_lease_end
    .endif
    rjmp plan_slow

    .if {LEASES}
    .global plan_drop_epochs, plan_horizon_to_switch
plan_drop_epochs:
    drop_epochs 1
    ret
plan_horizon_to_switch:
    horizon_to_switch
    ret
    .endif

    // A step that comes clear of what was before it, as a motion's first: with those that follow it, or at least by the expansion.
plan_first_of_batch:
    lds r26, steps_times+{ONLY_STEPS}
    sbrc r26, {PREFETCH}
    rjmp plan_none
    movw r30, r22
    ldd r26, Y+{LAST}
    ldd r27, Y+{LAST}+1
    sub r30, r26
    sbc r31, r27
    lds r26, steps_times+{MIN_INTERVAL}
    lds r27, steps_times+{MIN_INTERVAL}+1
    cp r30, r26
    cpc r31, r27
    brlo 1f
    // What is between two groups at least is no more than this.
    lds r26, steps_times+{DIR_HOLD}
    lds r27, steps_times+{DIR_HOLD}+1
    cp r30, r26
    cpc r31, r27
    brlo 1f
    rcall plan_prechecked
    brcc 2f
    // At least one, if the interval stays short.
    ldd r26, Y+{INTERVAL}+3
    ldd r27, Y+{INTERVAL}+4
    cpi r26, 0x40
    cpc r27, r1
    brsh 1f
    ldd r26, Y+{ADD}+3
    subi r26, -1
    cpi r26, 2
    brsh 1f
    ldi r31, 1
2:  ldd r24, Y+{FLAGS}
    ori r24, 1 << {STEPPED}
    std Y+{FLAGS}, r24
    rjmp plan_return_steps
1:  rjmp plan_one_step

    // The next step, at r22 to r25. Its tick in r20:21.
plan_make_step:
    ldd r26, Y+{FRACTION}
    ldd r27, Y+{INTERVAL}
    add r26, r27
    std Y+{FRACTION}, r26
    ldd r26, Y+{FRACTION}+1
    ldd r27, Y+{INTERVAL}+1
    adc r26, r27
    std Y+{FRACTION}+1, r26
    store_4 r22, r23, r24, r25, {TICK}
    // interval += add, 40 bits
    ldd r30, Y+{ADD}+3
    mov r31, r30
    lsl r31
    sbc r31, r31
    load_4 r18, r19, r20, r21, {INTERVAL}
    ldd r26, Y+{ADD}
    add r18, r26
    ldd r26, Y+{ADD}+1
    adc r19, r26
    ldd r26, Y+{ADD}+2
    adc r20, r26
    adc r21, r30
    ldd r26, Y+{INTERVAL}+4
    adc r26, r31
    std Y+{INTERVAL}+4, r26
    store_4 r18, r19, r20, r21, {INTERVAL}
    // add += add2
    load_4 r18, r19, r20, r21, {ADD2}
    ldd r26, Y+{ADD}
    add r18, r26
    ldd r26, Y+{ADD}+1
    adc r19, r26
    ldd r26, Y+{ADD}+2
    adc r20, r26
    adc r21, r30
    store_4 r18, r19, r20, r21, {ADD}
    ldd r26, Y+{LEFT}
    ldd r27, Y+{LEFT}+1
    sbiw r26, 1
    std Y+{LEFT}, r26
    std Y+{LEFT}+1, r27
    ldd r24, Y+{FLAGS}
    andi r24, 0xff - (1 << {COMMITTED})
    ori r24, 1 << {STEPPED}
    std Y+{FLAGS}, r24
    movw r20, r22
    ret
    "#,
    FRACTION = const offset_of!(Motor, registers),
    TICK = const offset_of!(Motor, registers) + 2,
    INTERVAL = const offset_of!(Motor, registers) + 6,
    ADD = const offset_of!(Motor, registers) + 11,
    ADD2 = const offset_of!(Motor, registers) + 15,
    LEFT = const offset_of!(Motor, registers) + 19,
    FLAGS = const offset_of!(Motor, flags),
    STEP = const offset_of!(Motor, step),
    STEP_END = const offset_of!(Motor, step_end),
    DIR = const offset_of!(Motor, dir),
    HORIZON = const offset_of!(Motor, horizon),
    LAST = const offset_of!(Motor, last),
    DIR_FREE = const offset_of!(Motor, dir_free),
    PRECHECKED = const offset_of!(Motor, prechecked),
    LIMIT_CHECK_FROM = const LIMIT_CHECK_FROM,
    HIGH_FIXED = const HIGH_FIXED,
    SWITCH_AT = const offset_of!(Motor, switch_at),
    LEVELS = const offset_of!(Motor, levels),
    DUE = const offset_of!(Motor, due),
    NEXT = const offset_of!(Motor, next),
    START = const offset_of!(Motor, start),
    END = const offset_of!(Motor, end),
    POSITION = const offset_of!(Motor, position),
    EPOCHS = const offset_of!(Motor, epochs),
    WAITING_EPOCHS = const WAITING_EPOCHS,
    EPOCH_SIZE = const size_of::<EpochBytes>(),
    EPOCH_RUNNING = const offset_of!(EpochBytes, epoch),
    WAITING = const offset_of!(Motor, waiting_epochs) - offset_of!(Motor, epochs),
    FAULT_KIND = const offset_of!(Motor, fault_kind) - offset_of!(Motor, epochs),
    SWITCH_EPOCH = const OF_SWITCH + offset_of!(Switch, epoch),
    BACKWARD = const flag::BACKWARD,
    UNREADABLE = const flag::UNREADABLE,
    TURN = const flag::TURN,
    STEPPED = const flag::STEPPED,
    ANCHORED = const flag::ANCHORED,
    COMMITTED = const flag::COMMITTED,
    SWITCH = const flag::SWITCH,
    SINGLY = const flag::SINGLY,
    FILLER_HIGH = const 256 - (FILLER >> 8),
    MISSED = const FaultKind::Missed as u8,
    LEASES = const ThisProgram::LEASES as u8,
    UNDERRUN = const FaultKind::Underrun as u8,
    STATE = const STATE,
    AWAITS = const state::AWAITS,
    LIMIT = const times::LIMIT,
    STEP_GAP = const times::STEP_GAP,
    DIR_HOLD = const times::DIR_HOLD,
    DIR_SETUP = const times::DIR_SETUP,
    DIR_EARLY = const times::DIR_EARLY,
    MIN_INTERVAL = const times::MIN_INTERVAL,
    MAX_STEPS = const times::MAX_STEPS,
    DIR_CLEARANCE = const DIR_CLEARANCE,
    SHARED = const times::SHARED,
    ONLY_STEPS = const times::ONLY_STEPS,
    PREFETCH = const times::PREFETCH,
);
