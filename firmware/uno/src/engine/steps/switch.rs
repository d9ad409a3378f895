//! Switches: at a tick all motors go over to another epoch. Two may wait, one after the other; of a motor that waits for one alone both places have that.
//! The plan makes them ([`plan`](super::plan)).

use super::motor::{Motor, Switch, flag};
use super::plan::of_switch;
use super::stepper;
use core::arch::global_asm;
use core::mem::offset_of;
use pulsetrain_core::{Epoch, Moment};

global_asm!(
    r#"
    // Goes through the motors in use: Y.
    .macro switch_each
    ldi r28, lo8(steps_motors)
    ldi r29, hi8(steps_motors)
    lds r27, steps_stepper+{COUNT}
    .endm
    .macro switch_next again
    subi r28, lo8(-({MOTOR_SIZE}))
    sbci r29, hi8(-({MOTOR_SIZE}))
    dec r27
    brne \again
    .endm
    // Goes to \none if the motor Y waits for no switch, or r22 to r25 is not after the tick at Z+\offset. Z: its parts; r18 is its flags. Uses r26.
    .macro switch_after offset, none
    movw r30, r28
    subi r30, lo8(-({PARTS}))
    sbci r31, hi8(-({PARTS}))
    ldd r18, Y+{FLAGS}
    sbrs r18, {SWITCH}
    rjmp \none
    ldd r26, Z+\offset
    cp r22, r26
    ldd r26, Z+\offset+1
    cpc r23, r26
    ldd r26, Z+\offset+2
    cpc r24, r26
    ldd r26, Z+\offset+3
    cpc r25, r26
    brmi \none
    breq \none
    .endm

    .section .text.steps_switch, "ax", @progbits
    .global steps_switch
    // For Rust: r22 to r25 is the tick, r20 the epoch. r24: not 0 if it can be.
steps_switch:
    push r28
    push r29
    // None may wait for two before it.
    switch_each
1:  switch_after {SECOND_AT}, 2f
    ldd r26, Z+{FIRST_AT}
    ldd r18, Z+{SECOND_AT}
    cp r26, r18
    .irp at, 1,2,3
    ldd r26, Z+{FIRST_AT}+\at
    ldd r18, Z+{SECOND_AT}+\at
    cpc r26, r18
    .endr
    brne 7f
2:  switch_next 1b
    switch_each
3:  switch_after {FIRST_AT}, 4f
    rjmp 5f
4:  std Z+{FIRST_EPOCH}, r20
    std Z+{FIRST_AT}, r22
    std Z+{FIRST_AT}+1, r23
    std Z+{FIRST_AT}+2, r24
    std Z+{FIRST_AT}+3, r25
    std Y+{SWITCH_AT}, r22
    std Y+{SWITCH_AT}+1, r23
    std Y+{SWITCH_AT}+2, r24
    std Y+{SWITCH_AT}+3, r25
5:  std Z+{FIRST_EPOCH}+{SWITCH_SIZE}, r20
    std Z+{SECOND_AT}, r22
    std Z+{SECOND_AT}+1, r23
    std Z+{SECOND_AT}+2, r24
    std Z+{SECOND_AT}+3, r25
    std Z+{IS_DUE}, r1
    ori r18, 1 << {SWITCH}
    std Y+{FLAGS}, r18
    switch_next 3b
    ldi r24, 1
6:  pop r29
    pop r28
    ret
7:  clr r24
    rjmp 6b
    "#,
    COUNT = const stepper::COUNT,
    MOTOR_SIZE = const size_of::<Motor>(),
    SWITCH_SIZE = const size_of::<Switch>(),
    PARTS = const offset_of!(Motor, parts),
    FLAGS = const offset_of!(Motor, flags),
    SWITCH = const flag::SWITCH,
    FIRST_EPOCH = const of_switch(0) + offset_of!(Switch, epoch),
    FIRST_AT = const of_switch(0) + offset_of!(Switch, at),
    SECOND_AT = const of_switch(1) + offset_of!(Switch, at),
    SWITCH_AT = const offset_of!(Motor, switch_at),
    IS_DUE = const offset_of!(Motor, is_due) - offset_of!(Motor, parts),
);

unsafe extern "C" {
    fn steps_switch(at: u32, epoch: u8) -> u8;
}

/// At `at`, not before the horizon, all motors go over to `epoch`; or none does, because two switches wait before. One that waits at that tick
/// or later is replaced.
#[inline(always)]
pub(super) fn all(epoch: Epoch, at: Moment) -> bool {
    // SAFETY: the assembly uses the motors alone, which belong to who has the stepper.
    unsafe { steps_switch(at.0, epoch.0) != 0 }
}
