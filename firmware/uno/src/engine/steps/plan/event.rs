//! Single events: a step, a turn of DIR, a filler, and the switch to another epoch.

use super::{FILLER, OF_SWITCH};
use crate::ThisProgram;
use crate::engine::program::Program;
use crate::engine::steps::brake::{STATE, state};
use crate::engine::steps::motor::{FaultKind, Motor, Switch, flag};
use crate::engine::steps::times;
use crate::engine::tuning::plan::DIR_CLEARANCE;
use core::arch::global_asm;
use core::mem::offset_of;

global_asm!(
    r#"
    .section .text.steps_plan
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
    // The queue has nothing more.
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
    // r26, r27, r30, r31: how far that is beyond the window
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
    // Is it too early?
4:  compare_4 r22, r23, r24, r25, {HORIZON}, r26
    brpl 5f
    .if {LEASES}
    // A step of a stop is late then, not a fault.
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
plan_near_switch:                       // branches do not reach it
    rjmp plan_make_switch

    // The window: r18 to r21 is the last tick at which an event may be planned now. T: that is the limit.
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

    // Carry is clear if the switch is due within the window, or `dir_early` after it. Uses r14, r15, r26, r27, r30, r31.
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

    // A filler at the window's end. If the next event comes within 512 ticks after that (r26, r27, r30, r31), the filler comes 512 ticks earlier.
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
    // No turn of DIR too close to the filler.
    movw r22, r18
    movw r24, r20
    subi r22, 256 - {DIR_CLEARANCE}
    sbci r23, -1
    sbci r24, -1
    sbci r25, -1
    compare_4 r22, r23, r24, r25, {DIR_FREE}, r26
    brmi 1f
    store_4 r22, r23, r24, r25, {DIR_FREE}
    // Nothing may be planned before the filler any more.
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
    // The registers' tick is a quarter of the clock's range behind: soon it would look like the future. So the motor needs a new anchor.
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

    // Turns DIR for the step at r22 to r25.
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
    // Is there time enough from the turn to the step? It is less than 2^15.
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

    // If the caller asks for steps alone, returns to it with none. What follows the call makes an event. Uses r26.
plan_return_if_only_steps:
    lds r26, steps_times+{ONLY_STEPS}
    tst r26
    breq 1f
    pop r26
    pop r26
plan_none:
    clr r24
1:  ret

    // Where motors share DIR lines, the caller must turn the line first.
plan_hand_to_caller:
    lds r26, steps_times+{SHARED}
    tst r26
    brne 1f
    rjmp plan_dir_is_right
1:  store_4 r22, r23, r24, r25, {DUE}
    ldi r24, 3
    clr r25
    ret

    // The switch: goes over to the epoch that waits, without steps, anchor and prediction, and forward.
plan_make_switch:
    // Steps of the old epoch that are left are not made.
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
    sbrc r25, {END_NEXT}
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

    // A step that comes well after the last event, like a motion's first one. It begins a batch, or at least the expansion makes it.
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
    // `dir_hold` is no less than the spacing of groups.
    lds r26, steps_times+{DIR_HOLD}
    lds r27, steps_times+{DIR_HOLD}+1
    cp r30, r26
    cpc r31, r27
    brlo 1f
    rcall plan_prechecked
    brcc 2f
    // One step can be expanded if the interval stays within 16 bits: before it 0 to 2^14, and it changes by less than that.
    ldd r26, Y+{INTERVAL}+3
    ldd r27, Y+{INTERVAL}+4
    cpi r26, 0x40
    cpc r27, r1
    brsh 1f
    ldd r26, Y+{ADD}+3
    subi r26, -0x40
    cpi r26, 0x80
    brsh 1f
    ldi r31, 1
2:  ldd r24, Y+{FLAGS}
    ori r24, 1 << {STEPPED}
    std Y+{FLAGS}, r24
    rjmp plan_return_steps
1:  rjmp plan_one_step

    // Makes the next step, at r22 to r25. Gives its tick in r20:21.
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
    SWITCH_AT = const offset_of!(Motor, switch_at),
    LEVELS = const offset_of!(Motor, levels),
    DUE = const offset_of!(Motor, due),
    POSITION = const offset_of!(Motor, position),
    EPOCHS = const offset_of!(Motor, epochs),
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
    END_NEXT = const state::END_NEXT,
    DIR_HOLD = const times::DIR_HOLD,
    DIR_SETUP = const times::DIR_SETUP,
    DIR_EARLY = const times::DIR_EARLY,
    MIN_INTERVAL = const times::MIN_INTERVAL,
    DIR_CLEARANCE = const DIR_CLEARANCE,
    SHARED = const times::SHARED,
    ONLY_STEPS = const times::ONLY_STEPS,
    PREFETCH = const times::PREFETCH,
);
