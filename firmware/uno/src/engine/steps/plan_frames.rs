//! Frames that change plans: Switch, Extend, Trim and Brake, read byte by byte. In assembly, because that takes less flash.
//!
//! # Registers of the processor
//! | | |
//! |---|---|
//! | r14 | bytes of the lease and limits, or of Trim |
//! | r16:17 | their address |
//! | r18 to r21, r22 to r25 | ticks |
//! | Y, Z | a motor, and its epochs |

use super::brake::{CurrentLease, lease, state};
use super::motor::{EpochBytes, Motor, flag};
use super::pins::MAX_MOTORS;
use super::plan::OF_SWITCH;
use super::refill::mode;
use super::stepper::{COUNT, SWAP, Stepper, Track};
use core::arch::global_asm;
use core::mem::offset_of;
use pulsetrain_core::Tick32;
use pulsetrain_core::wire::message::kind;

const _: () = assert!(kind::SWITCH < kind::EXTEND && kind::EXTEND < kind::TRIM && kind::TRIM < kind::BRAKE);

/// Answers.
pub(crate) mod answer {
    /// Done.
    pub(crate) const ACCEPTED: u8 = 0;
    /// Too late. The tick is the first that would do.
    pub(crate) const LATE: u8 = 1;
    /// For Switch: too early, and the tick is the first that is too early. For Trim: a queue has not so many bytes, and the tick is that motor's number.
    pub(crate) const EARLY: u8 = 2;
    /// For Switch: too many wait. For Trim and Brake: there is no lease, or it has lapsed.
    pub(crate) const FULL: u8 = 3;
    /// The bytes are no such frame.
    pub(crate) const MALFORMED: u8 = 4;
    /// Bit of an answer: it has a tick.
    pub(crate) const MOMENT: u8 = 0x80;
}

global_asm!(
    r#"
    .macro frame_each
    ldi r28, lo8(steps_motors)
    ldi r29, hi8(steps_motors)
    lds r27, steps_stepper+{COUNT}
    .endm
    .macro frame_next again
    subi r28, lo8(-({MOTOR_SIZE}))
    sbci r29, hi8(-({MOTOR_SIZE}))
    dec r27
    brne \again
    .endm
    .macro frame_lease
    ldi r30, lo8(steps_lease)
    ldi r31, hi8(steps_lease)
    .endm

    .section .text.steps_horizon, "ax", @progbits
    .global steps_horizon
    // For Rust: the first tick at which plans can be changed, r22 to r25. Some motor must be configured.
steps_horizon:
    push r28
    push r29
    rcall frame_horizon
    pop r29
    pop r28
    ret
    // The same for assembly. Uses r18 to r21, r27, Y, Z.
frame_horizon:
    lds r22, steps_stepper+{AT}
    lds r23, steps_stepper+{AT}+1
    lds r24, steps_stepper+{AT}+2
    lds r25, steps_stepper+{AT}+3
    lds r18, steps_mode
    cpi r18, {TWO_RINGS}
    breq 1f
    cpi r18, {MERGE_AND_B}
    brne 2f
1:  ldi r30, lo8(steps_stepper+{AT}+{TRACK_SIZE})
    ldi r31, hi8(steps_stepper+{AT}+{TRACK_SIZE})
    rcall frame_maximum
2:  frame_each
3:  push r24
    push r25
    call steps_settle
    pop r25
    pop r24
    movw r30, r28
    adiw r30, {HORIZON}
    rcall frame_maximum
    frame_next 3b
    subi r22, -1
    sbci r23, -1
    sbci r24, -1
    sbci r25, -1
    ret
    // r22 to r25 becomes the tick at Z, if that is later. Uses r18 to r21.
frame_maximum:
    ld r18, Z
    ldd r19, Z+1
    ldd r20, Z+2
    ldd r21, Z+3
    cp r22, r18
    cpc r23, r19
    cpc r24, r20
    cpc r25, r21
    brpl 1f
    movw r22, r18
    movw r24, r20
1:  ret

    .section .text.steps_plan_frame, "ax", @progbits
    .global steps_plan_frame, steps_lapse, steps_update_lease
    // For Rust: does what the r22 bytes at r24:25 say, of the kind r20. Gives an answer in r24, and its tick in r18 to r21, or 0.
steps_plan_frame:
    push r14
    push r16
    push r17
    push r28
    push r29
    movw r16, r24
    mov r14, r22
    cpi r20, {EXTEND}
    breq 2f
    brsh 3f
    rcall frame_switch
    // No tick.
1:  cpi r24, {LATE}
    breq 5f
    cpi r24, {EARLY}
    breq 5f
    sbrc r24, 7
    rjmp 5f
    clr r18
    clr r19
    movw r20, r18
5:  pop r29
    pop r28
    pop r17
    pop r16
    pop r14
    ret
2:  rcall frame_extend
    rjmp 1b
3:  cpi r20, {BRAKE}
    breq 4f
    rcall frame_trim
    rjmp 1b
4:  rcall frame_brake
    rjmp 1b
frame_brake:
    tst r14
    brne frame_bad
    rcall frame_update_lease
    cpi r20, {OFF}
    ldi r24, {FULL}
    breq 2f
    cpi r20, {LAPSED}
    breq 1f
    rcall steps_lapse
1:  ldi r30, lo8(steps_lease+{LEASE_AT})
    ldi r31, hi8(steps_lease+{LEASE_AT})
    rcall frame_compare
    ldi r24, {ACCEPTED} | {MOMENT}
2:  ret
frame_bad:
    ldi r24, {MALFORMED}
    ret

    // Switch: epoch, tick, lease, limits.
frame_switch:
    ldi r24, 9
    sub r14, r24
    brcs frame_bad
    subi r16, -9
    sbci r17, -1
    rcall frame_check
    brcs frame_bad
    call clock_moment
    movw r30, r16
    sbiw r30, 8
    // How far the tick is ahead: r27 is the fourth byte, r20 all bytes above or-ed, r21 the last.
    ld r18, Z
    sub r18, r22
    ldd r18, Z+1
    sbc r18, r23
    ldd r18, Z+2
    sbc r18, r24
    ldd r27, Z+3
    sbc r27, r25
    ldd r20, Z+4
    lds r0, clock+4
    sbc r20, r0
    ldd r21, Z+5
    lds r0, clock+5
    sbc r21, r0
    or r20, r21
    ldd r21, Z+6
    lds r0, clock+6
    sbc r21, r0
    or r20, r21
    ldd r21, Z+7
    lds r0, clock+7
    sbc r21, r0
    or r20, r21
    sbrc r21, 7
    rjmp frame_late
    tst r20
    brne 1f
    cpi r27, 0x40
    brlo 2f
1:  movw r18, r22
    movw r20, r24
    subi r21, -0x40
    ldi r24, {EARLY} | {MOMENT}
    ret
    // Not while motors still wait for the end of a lease that is over. If the lease is not over, its end is set again below.
2:  rcall frame_update_lease
    cpi r20, {LAPSED}
    brne 4f
    frame_each
3:  rcall frame_point_to_epochs
    ldd r20, Z+{STATE}
    sbrc r20, {END_NEXT}
    rjmp frame_late
    frame_next 3b
    rjmp 5f
4:  rcall frame_cancel_end
5:  rcall frame_horizon
    movw r30, r16
    sbiw r30, 8
    rcall frame_compare
    brmi frame_late
    movw r22, r18
    movw r24, r20
    ld r20, -Z
    call steps_switch
    tst r24
    ldi r24, {FULL}
    breq 7f
    // If the lease ends before the switch, the switch will not be made, and that lease stays. Otherwise the new one is no shorter.
    movw r30, r16
    sbiw r30, 8
    ld r22, Z
    ldd r23, Z+1
    ldd r24, Z+2
    ldd r25, Z+3
    lds r20, steps_lease
    cpi r20, {UNTIL}
    brne 6f
    ldi r30, lo8(steps_lease+{LEASE_AT})
    ldi r31, hi8(steps_lease+{LEASE_AT})
    rcall frame_compare
    brmi frame_limits
6:  movw r30, r16
    adiw r30, 1
    rcall frame_maximum
    rcall frame_store_lease
    rjmp frame_limits
7:  ret

    // Compares the tick at Z, r18 to r21, with r22 to r25. N: it is before.
frame_compare:
    ld r18, Z
    ldd r19, Z+1
    ldd r20, Z+2
    ldd r21, Z+3
    cp r18, r22
    cpc r19, r23
    cpc r20, r24
    cpc r21, r25
    ret

    // Too late: answers with the horizon.
frame_late:
    rcall frame_horizon
    movw r18, r22
    movw r20, r24
    ldi r24, {LATE} | {MOMENT}
    ret

    // Extend: lease, limits.
frame_extend:
    rcall frame_check
    brcs 8f
    movw r30, r16
    ld r24, Z+
    rcall frame_move_end
    brcs frame_late
    // Limits, how hard a motor may brake: three bytes for each motor, by its number, or none.
frame_limits:
    subi r16, -5
    sbci r17, -1
    ldi r24, 5
    sub r14, r24
    ldi r20, 0
    breq 2f
1:  rcall frame_motor
    rcall frame_point_to_epochs
    movw r26, r16
    ld r24, X+
    std Z+{STATE}+1, r24
    ld r24, X+
    std Z+{STATE}+2, r24
    ld r24, X+
    std Z+{STATE}+3, r24
    movw r16, r26
    inc r20
    ldi r24, 3
    sub r14, r24
    brne 1b
2:  ldi r24, {ACCEPTED}
    ret
8:  rjmp frame_bad

    // Trim: the new end, and two bytes for each motor: how many to take off its queue.
frame_trim:
    lds r24, steps_stepper+{COUNT}
    lsl r24
    subi r24, -4
    cp r24, r14
    brne 8b
    // Twice: first only check that all queues have so many bytes.
    set
1:  ldi r20, 0
2:  rcall frame_motor
    rcall frame_point_to_epochs
    ldd r24, Z+{WAITING}
    add r30, r24
    adc r31, r1
    lsl r24
    add r30, r24
    adc r31, r1
    movw r26, r16
    adiw r26, 4
    add r26, r20
    adc r27, r1
    add r26, r20
    adc r27, r1
    ld r18, X+
    ld r19, X
    ld r24, Z
    ldd r25, Z+1
    sub r24, r18
    sbc r25, r19
    brcs 5f
    brts 3f
    st Z, r24
    std Z+1, r25
3:  inc r20
    lds r24, steps_stepper+{COUNT}
    cp r20, r24
    brne 2b
    brtc 4f
    movw r30, r16
    ldi r24, {UNTIL}
    rcall frame_move_end
    brcs 6f
    clt
    rjmp 1b
4:  ldi r24, {ACCEPTED}
    ret
5:  mov r18, r20
    clr r19
    clr r20
    clr r21
    ldi r24, {EARLY}
    ret
6:  lds r24, steps_lease
    dec r24
    cpi r24, {LAST}
    brsh 7f
    rjmp frame_late
7:  ldi r24, {FULL}
    ret

    // Moves the end of the lease to the tick at Z, and sets its state to r24. Carry: too late.
frame_move_end:
    push r30
    push r31
    push r24
    rcall frame_update_lease
    rcall frame_horizon
    pop r18
    pop r31
    pop r30
    lds r20, steps_lease
    cpi r20, {UNTIL}
    breq 1f
    cpi r20, {LAST}
    brne 2f
1:  cpi r18, {LAST}
    breq 3f
    push r18
    rcall frame_compare
    pop r18
    brmi 2f
3:  ld r22, Z
    ldd r23, Z+1
    ldd r24, Z+2
    ldd r25, Z+3
    mov r20, r18
    rcall frame_set_lease
    rcall frame_cancel_end
    clc
    ret
2:  sec
    ret

    // Stores a lease: its state from the first byte at r16:17, its end from r22 to r25.
frame_store_lease:
    movw r30, r16
    ld r20, Z
frame_set_lease:
    frame_lease
    st Z, r20
    std Z+{MOVED}, r1
    std Z+{LEASE_AT}, r22
    std Z+{LEASE_AT}+1, r23
    std Z+{LEASE_AT}+2, r24
    std Z+{LEASE_AT}+3, r25
    ret

    // Carry: the r14 bytes at r16:17 are not a lease, followed by limits for all motors or for none.
frame_check:
    movw r30, r16
    mov r24, r14
    subi r24, 5
    brcs 3f
    ld r25, Z
    dec r25
    cpi r25, 2                          // UNTIL or LAST: frames set no lease off
    brsh 2f
    adiw r30, 5
    tst r24
    breq 3f
    lds r25, steps_stepper+{COUNT}
    mov r26, r25
    lsl r26
    add r26, r25
    cp r24, r26
    brne 2f
1:  ld r25, Z+
    sbrs r25, 7
    rjmp 2f
    ld r25, Z+
    cpi r25, 62
    brsh 2f
    adiw r30, 1
    subi r24, 3
    brne 1b
3:  ret
2:  sec
    ret

    // Points Y to the motor of the number r20. Uses r24, r25.
frame_motor:
    mov r24, r20
    lds r25, steps_stepper+{SWAP}
    tst r25
    breq 2f
    cpi r24, {LAST_MOTOR}
    breq 1f
    eor r24, r25
    cpi r24, {LAST_MOTOR}
    mov r24, r20
    brne 2f
1:  eor r24, r25
2:  ldi r25, {MOTOR_SIZE}
    mul r24, r25
    movw r28, r0
    clr r1
    subi r28, lo8(-(steps_motors))
    sbci r29, hi8(-(steps_motors))
    ret

    // Points Z to the motor's epochs.
frame_point_to_epochs:
    movw r30, r28
    subi r30, lo8(-({EPOCHS}))
    sbci r31, hi8(-({EPOCHS}))
    ret

    // Motors that wait for the end of the lease do so no more.
frame_cancel_end:
    frame_each
1:  rcall frame_point_to_epochs
    ldd r25, Z+{STATE}
    sbrs r25, {END_NEXT}
    rjmp 3f
    std Z+{STATE}, r1
    std Z+{IS_DUE}, r1
    ldd r24, Y+{FLAGS}
    sbrs r25, {SWITCH_TOO}
    andi r24, 0xff - (1 << {SWITCH})
    std Y+{FLAGS}, r24
    .irp at, 0,1,2,3
    ldd r24, Z+{EPOCH_SWITCH_AT}+\at
    std Y+{SWITCH_AT}+\at, r24
    .endr
3:  frame_next 1b
    ret

    // For Rust: the next routine.
steps_update_lease:
    push r28
    push r29
    rcall frame_update_lease
    pop r29
    pop r28
    ret

    // Notes that the lease is over, if the horizon has passed its end, or a motor could not follow its plan. r20: its state.
frame_update_lease:
    lds r20, steps_lease
    sbrc r20, {FAULT_BIT}
    rjmp steps_lapse
    cpi r20, {UNTIL}
    brne 1f
    rcall frame_horizon
    ldi r30, lo8(steps_lease+{LEASE_AT})
    ldi r31, hi8(steps_lease+{LEASE_AT})
    rcall frame_compare
    brmi steps_lapse
    ldi r20, {UNTIL}
1:  ret

    // The lease is over at its end, or at the horizon if that is sooner. r20: its state.
steps_lapse:
    rcall frame_horizon
    frame_lease
    ld r20, Z
    andi r20, 3
    cpi r20, {LAST}
    breq 1f
    adiw r30, {LEASE_AT}
    rcall frame_compare
    brmi 2f
1:  frame_lease
    std Z+{LEASE_AT}, r22
    std Z+{LEASE_AT}+1, r23
    std Z+{LEASE_AT}+2, r24
    std Z+{LEASE_AT}+3, r25
    movw r18, r22
    movw r20, r24
2:  ldi r24, {LAPSED}
    sts steps_lease, r24
    call brake_all_at_end
    ldi r20, {LAPSED}
    ret
    "#,
    COUNT = const COUNT,
    SWAP = const SWAP,
    LAST_MOTOR = const MAX_MOTORS - 1,
    MOTOR_SIZE = const size_of::<Motor>(),
    TRACK_SIZE = const size_of::<Track>(),
    AT = const offset_of!(Stepper, tracks) + offset_of!(Track, at),
    TWO_RINGS = const mode::TWO_RINGS,
    MERGE_AND_B = const mode::MERGE_AND_B,
    HORIZON = const offset_of!(Motor, horizon),
    FLAGS = const offset_of!(Motor, flags),
    SWITCH = const flag::SWITCH,
    SWITCH_AT = const offset_of!(Motor, switch_at),
    EPOCHS = const offset_of!(Motor, epochs),
    WAITING = const offset_of!(Motor, waiting_epochs) - offset_of!(Motor, epochs),
    IS_DUE = const offset_of!(Motor, is_due) - offset_of!(Motor, epochs),
    EPOCH_SWITCH_AT = const OF_SWITCH + offset_of!(super::motor::Switch, at),
    STATE = const super::brake::STATE,
    END_NEXT = const state::END_NEXT,
    SWITCH_TOO = const state::SWITCH_TOO,
    LEASE_AT = const offset_of!(CurrentLease, at),
    MOVED = const offset_of!(CurrentLease, moved),
    UNTIL = const lease::UNTIL,
    LAST = const lease::LAST,
    LAPSED = const lease::LAPSED,
    FAULT_BIT = const lease::FAULT.trailing_zeros(),
    ACCEPTED = const answer::ACCEPTED,
    LATE = const answer::LATE,
    EARLY = const answer::EARLY,
    FULL = const answer::FULL,
    MALFORMED = const answer::MALFORMED,
    MOMENT = const answer::MOMENT,
    OFF = const lease::OFF,
    EXTEND = const kind::EXTEND,
    BRAKE = const kind::BRAKE,
);

const _: () = assert!(size_of::<EpochBytes>() == 3);
const _: () = assert!(lease::UNTIL == 1 && lease::LAST == 2);

unsafe extern "C" {
    fn steps_horizon() -> u32;
    fn steps_plan_frame(bytes: *const u8, len: u8, kind: u8) -> u64;
    fn steps_update_lease();
}

impl Stepper {
    /// Does what a frame of this kind says: Switch, Extend, Trim or Brake. Gives an [`answer`], and its tick.
    #[inline(always)]
    pub(crate) fn obey_plan_frame(&mut self, kind: u8, bytes: &[u8]) -> (u8, Tick32) {
        // SAFETY: the assembly uses the motors and their lease, which belong to whoever has the stepper.
        let [m0, m1, m2, m3, _, _, answer, _] =
            unsafe { steps_plan_frame(bytes.as_ptr(), bytes.len() as u8, kind) }.to_le_bytes();
        (answer, Tick32(u32::from_le_bytes([m0, m1, m2, m3])))
    }

    /// The first tick at which a switch would be accepted. Some motor must be configured.
    #[inline(always)]
    pub(super) fn first_changeable(&self) -> Tick32 {
        // SAFETY: as above.
        Tick32(unsafe { steps_horizon() })
    }

    /// The lease, brought up to date: it is over once the horizon has passed its end.
    #[inline(always)]
    pub(crate) fn lease(&mut self) -> CurrentLease {
        // SAFETY: as above.
        unsafe { steps_update_lease() };
        CurrentLease::get()
    }
}
