//! Motors that share DIR lines, in one ring, one event after the other.
//!
//! The motor with the earliest step is found. If its DIR line must turn, it turns when all motors on that line have had their hold time. All steps that
//! are due within half the spacing of groups, and find their DIR lines right, go into the same group. A step of a stop that must wait for its DIR line is
//! late; the other steps of that motor keep their ticks.
//!
//! # Registers of the processor
//! | | |
//! |---|---|
//! | r2 to r5 | steps up to this tick go into the same group |
//! | r6 to r9 | the earliest step's tick, or when it can be made |
//! | r10:11 | the motor whose step that is, or 0 |
//! | r12, r13 | counters of motors, and of events |
//! | r16, r17 | a DIR line; the steps of the group |

use super::motor::{Motor, flag};
use super::pins::Lines;
use super::ring::{GROUPS, Ring};
use super::stepper::{COUNT, SPACING, Stepper, Track};
use super::times;
use crate::engine::tuning::shared_dir::{BATCH, REFILL_BELOW};
use core::arch::global_asm;
use core::mem::offset_of;

global_asm!(
    r#"
    .macro shared_each
    ldi r28, lo8(steps_motors)
    ldi r29, hi8(steps_motors)
    lds r12, steps_stepper+{COUNT}
    .endm
    .macro shared_next again
    subi r28, lo8(-({MOTOR_SIZE}))
    sbci r29, hi8(-({MOTOR_SIZE}))
    dec r12
    breq .+2
    rjmp \again
    .endm
    // Points Z to the motor's epochs. Z flag: the motor's next step is not known yet.
    .macro shared_knows_due
    rcall shared_point_to_epochs
    ldd r24, Z+{IS_DUE}
    tst r24
    .endm

    .section .text.shared_fill, "ax", @progbits
    .global shared_fill
    // For the refill. Uses all registers.
shared_fill:
    ldi r24, {BATCH}
    mov r13, r24
shared_again:
    lds r26, steps_stepper+{TAIL_AT}
    clr r27
    ld r26, X
    lds r24, steps_stepper+{HEAD}
    sub r26, r24
    dec r26
    cpi r26, 4 * ({GROUPS} - {REFILL_BELOW})
    brsh 1f
    ret
    // Which motor has the earliest step?
1:  clr r10
    clr r11
    shared_each
2:  shared_knows_due
    brne 5f
    call steps_settle
    rcall shared_pending_tick
    store_4 r18, r19, r20, r21, {LAST}
    call steps_plan
    rcall shared_point_to_epochs
    cpi r24, 3
    ldi r24, 1
    breq .+2
    ldi r24, 0
    std Z+{IS_DUE}, r24
    rcall shared_pending_tick
    store_4 r18, r19, r20, r21, {LAST}
    movw r30, r28
    adiw r30, {HORIZON}
    rcall shared_raise_to
    movw r30, r28
    adiw r30, {DIR_FREE}
    rcall shared_raise_to
    shared_knows_due
    breq 4f
5:  load_4 r18, r19, r20, r21, {DUE}
    mov r24, r10
    or r24, r11
    breq 3f
    cp r18, r6
    cpc r19, r7
    cpc r20, r8
    cpc r21, r9
    brpl 4f
3:  movw r6, r18
    movw r8, r20
    movw r10, r28
4:  shared_next 2b
    // Is it due within the window?
    ldi r28, lo8(steps_motors)
    ldi r29, hi8(steps_motors)
    rcall shared_pending_tick
    store_4 r18, r19, r20, r21, {LAST}
    call plan_window
    mov r24, r10
    or r24, r11
    breq 6f
    cp r18, r6
    cpc r19, r7
    cpc r20, r8
    cpc r21, r9
    brpl shared_turn
    // No: a filler, 512 ticks before the window ends, so that the next event has room.
6:  brtc .+2
    ret
    subi r19, 2
    sbci r20, 0
    sbci r21, 0
    call put_shared_filler
    rjmp shared_more

    // Turn its DIR line, if need be.
shared_turn:
    movw r28, r10
    rcall shared_check_dir
    breq shared_make
    ldd r16, Y+{DIR}
    movw r22, r6
    movw r24, r8
    lds r18, steps_times+{DIR_EARLY}
    lds r19, steps_times+{DIR_EARLY}+1
    sub r22, r18
    sbc r23, r19
    sbc r24, r1
    sbc r25, r1
    shared_each
1:  ldd r18, Y+{DIR}
    cp r18, r16
    brne 2f
    ldd r18, Y+{LEVELS}
    eor r18, r16
    std Y+{LEVELS}, r18
    compare_4 r22, r23, r24, r25, {DIR_FREE}, r18
    brpl 2f
    load_4 r22, r23, r24, r25, {DIR_FREE}
2:  shared_next 1b
    movw r18, r22
    movw r20, r24
    clr r22
    mov r23, r16
    call put_shared
    lds r24, steps_times+{DIR_SETUP}
    lds r25, steps_times+{DIR_SETUP}+1
    add r18, r24
    adc r19, r25
    adc r20, r1
    adc r21, r1
    cp r18, r6
    cpc r19, r7
    cpc r20, r8
    cpc r21, r9
    brmi shared_make
    movw r6, r18
    movw r8, r20

    // Collect all steps that share the group.
shared_make:
    movw r2, r6
    movw r4, r8
    lds r24, steps_stepper+{SPACING}
    lsr r24
    add r2, r24
    adc r3, r1
    adc r4, r1
    adc r5, r1
    clr r17
    shared_each
1:  shared_knows_due
    breq 2f
    load_4 r22, r23, r24, r25, {DUE}
    cp r2, r22
    cpc r3, r23
    cpc r4, r24
    cpc r5, r25
    brmi 2f
    rcall shared_check_dir
    brne 2f
    std Z+{IS_DUE}, r1
    ldd r24, Y+{STEP}
    or r17, r24
    load_4 r22, r23, r24, r25, {DUE}
    call plan_make_step
    call steps_settle
    movw r18, r6
    movw r20, r8
    lds r24, steps_stepper+{SPACING}
    add r18, r24
    adc r19, r1
    adc r20, r1
    adc r21, r1
    lds r24, steps_times+{DIR_HOLD}
    lds r25, steps_times+{DIR_HOLD}+1
    add r18, r24
    adc r19, r25
    adc r20, r1
    adc r21, r1
    store_4 r18, r19, r20, r21, {DIR_FREE}
2:  shared_next 1b
    movw r18, r6
    movw r20, r8
    mov r22, r17
    mov r23, r17
    lds r2, steps_times+{PULSE}
    lds r3, steps_times+{PULSE}+1
    mov r26, r2
    or r26, r3
    breq 3f
    clr r23
    call put_shared
    add r18, r2
    adc r19, r3
    adc r20, r1
    adc r21, r1
3:  call put_shared
shared_more:
    dec r13
    breq .+2
    rjmp shared_again
    ret

    // Points Z to the epochs of the motor Y.
shared_point_to_epochs:
    movw r30, r28
    subi r30, lo8(-({EPOCHS}))
    sbci r31, hi8(-({EPOCHS}))
    ret

    // r18 to r21 is the tick of the pending group.
shared_pending_tick:
    lds r18, steps_stepper+{AT}
    lds r19, steps_stepper+{AT}+1
    lds r20, steps_stepper+{AT}+2
    lds r21, steps_stepper+{AT}+3
    ret

    // Raises the tick at Z to r18 to r21, if it is earlier. Uses r24.
shared_raise_to:
    ld r24, Z
    cp r24, r18
    ldd r24, Z+1
    cpc r24, r19
    ldd r24, Z+2
    cpc r24, r20
    ldd r24, Z+3
    cpc r24, r21
    brpl 1f
    st Z, r18
    std Z+1, r19
    std Z+2, r20
    std Z+3, r21
1:  ret

    // Z flag: the DIR line of the motor Y has the level that its next step needs. Points Z to its epochs. Uses r24, r25.
shared_check_dir:
    rcall shared_point_to_epochs
    ldd r24, Y+{LEVELS}
    ldd r25, Y+{DIR}
    and r24, r25
    breq .+2
    ldi r24, 1
    ldd r25, Y+{FLAGS}
    eor r24, r25
    ldd r25, Z+{LINE_FLAGS}
    eor r24, r25
    andi r24, 1
    ret
    "#,
    BATCH = const BATCH,
    GROUPS = const GROUPS,
    REFILL_BELOW = const REFILL_BELOW,
    COUNT = const COUNT,
    SPACING = const SPACING,
    TAIL_AT = const offset_of!(Stepper, tracks) + offset_of!(Track, ring) + offset_of!(Ring, tail_at),
    HEAD = const offset_of!(Stepper, tracks) + offset_of!(Track, ring) + offset_of!(Ring, head),
    AT = const offset_of!(Stepper, tracks) + offset_of!(Track, at),
    MOTOR_SIZE = const size_of::<Motor>(),
    EPOCHS = const offset_of!(Motor, epochs),
    IS_DUE = const offset_of!(Motor, is_due) - offset_of!(Motor, epochs),
    LINE_FLAGS = const offset_of!(Motor, lines) + Lines::FLAGS - offset_of!(Motor, epochs),
    DUE = const offset_of!(Motor, due),
    LAST = const offset_of!(Motor, last),
    HORIZON = const offset_of!(Motor, horizon),
    DIR_FREE = const offset_of!(Motor, dir_free),
    LEVELS = const offset_of!(Motor, levels),
    FLAGS = const offset_of!(Motor, flags),
    STEP = const offset_of!(Motor, step),
    DIR = const offset_of!(Motor, dir),
    DIR_EARLY = const times::DIR_EARLY,
    DIR_SETUP = const times::DIR_SETUP,
    DIR_HOLD = const times::DIR_HOLD,
    PULSE = const times::PULSE,
);

// `shared_check_dir` combines these bits: which way a segment goes, and which level of DIR is forward.
const _: () = assert!(flag::BACKWARD == 0 && Lines::FORWARD_HIGH == 1);
