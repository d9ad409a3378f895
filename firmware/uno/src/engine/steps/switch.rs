//! Switches: at a tick all motors go over to another epoch. One switch may wait; the plan makes it ([`plan`](super::plan)).

use super::motor::{Motor, Switch, flag};
use super::plan::OF_SWITCH;
use super::stepper;
use core::arch::global_asm;
use core::mem::offset_of;
use pulsetrain_core::{Epoch, Tick32};

global_asm!(
    r#"
    // A loop over the motors in use: Y.
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
    .section .text.steps_switch, "ax", @progbits
    .global steps_switch
    // For Rust: the tick is r22 to r25, the epoch r20. Result r24: not 0 if it was accepted.
steps_switch:
    push r28
    push r29
    // Refused if a switch waits for an earlier tick.
    switch_each
1:  ldd r18, Y+{FLAGS}
    sbrs r18, {SWITCH}
    rjmp 2f
    ldd r18, Y+{SWITCH_AT}
    cp r18, r22
    ldd r18, Y+{SWITCH_AT}+1
    cpc r18, r23
    ldd r18, Y+{SWITCH_AT}+2
    cpc r18, r24
    ldd r18, Y+{SWITCH_AT}+3
    cpc r18, r25
    brmi 5f
2:  switch_next 1b
    switch_each
3:  movw r30, r28
    subi r30, lo8(-({EPOCHS}))
    sbci r31, hi8(-({EPOCHS}))
    std Z+{EPOCH}, r20
    std Z+{AT}, r22
    std Z+{AT}+1, r23
    std Z+{AT}+2, r24
    std Z+{AT}+3, r25
    std Y+{SWITCH_AT}, r22
    std Y+{SWITCH_AT}+1, r23
    std Y+{SWITCH_AT}+2, r24
    std Y+{SWITCH_AT}+3, r25
    std Z+{IS_DUE}, r1
    ldd r18, Y+{FLAGS}
    ori r18, 1 << {SWITCH}
    std Y+{FLAGS}, r18
    switch_next 3b
    ldi r24, 1
4:  pop r29
    pop r28
    ret
5:  clr r24
    rjmp 4b
    "#,
    COUNT = const stepper::COUNT,
    MOTOR_SIZE = const size_of::<Motor>(),
    EPOCHS = const offset_of!(Motor, epochs),
    FLAGS = const offset_of!(Motor, flags),
    SWITCH = const flag::SWITCH,
    EPOCH = const OF_SWITCH + offset_of!(Switch, epoch),
    AT = const OF_SWITCH + offset_of!(Switch, at),
    SWITCH_AT = const offset_of!(Motor, switch_at),
    IS_DUE = const offset_of!(Motor, is_due) - offset_of!(Motor, epochs),
);

unsafe extern "C" {
    fn steps_switch(at: u32, epoch: u8) -> u8;
}

/// All motors are to go over to `epoch` at `at`, which is not before the horizon. `false`, and nothing changes, if a switch waits for an earlier tick. A
/// switch that waits for that tick or a later one is replaced. No motor waits for the end of a lease.
#[inline(always)]
pub(super) fn all(epoch: Epoch, at: Tick32) -> bool {
    // SAFETY: the assembly uses only the motors, which belong to whoever has the stepper.
    unsafe { steps_switch(at.0, epoch.0) != 0 }
}
