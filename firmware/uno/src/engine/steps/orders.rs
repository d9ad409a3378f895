//! What a host says of plans beside their data, from the bytes of its frames: Switch, Extend, Trim. In assembly, for the flash that it takes.
//!
//! # Registers of the processor
//! | | |
//! |---|---|
//! | r14 | bytes of a lease field and limits, or of Trim |
//! | r16:17 | where they are |
//! | r18 to r21, r22 to r25 | moments |
//! | Y, Z | a motor, and its parts |

use super::brake::{Lease, lease, state};
use super::motor::{Motor, Part, flag};
use super::pins::MAX_MOTORS;
use super::plan::OF_SWITCH;
use super::stepper::{COUNT, SWAP, Stepper, Track};
use super::task::mode;
use core::arch::global_asm;
use core::mem::offset_of;
use pulsetrain_core::Tick32;
use pulsetrain_core::wire::message::kind;

const _: () = assert!(kind::SWITCH < kind::EXTEND && kind::EXTEND < kind::TRIM && kind::TRIM < kind::BRAKE);

/// Answers.
pub(crate) mod answer {
    /// It is done.
    pub(crate) const ACCEPTED: u8 = 0;
    /// Too late: the moment is the first that would do.
    pub(crate) const LATE: u8 = 1;
    /// To Switch: too early, the moment is the first that is. To Trim: the moment is a motor's number, whose queue has not so many bytes.
    pub(crate) const EARLY: u8 = 2;
    /// To Switch: too many wait. To Trim: there is no lease, or it has lapsed.
    pub(crate) const FULL: u8 = 3;
    /// The bytes say no such thing.
    pub(crate) const MALFORMED: u8 = 4;
    /// A bit that is set if there is a moment.
    pub(crate) const MOMENT: u8 = 0x80;
}

global_asm!(
    r#"
    .macro order_each
    ldi r28, lo8(steps_motors)
    ldi r29, hi8(steps_motors)
    lds r27, steps_stepper+{COUNT}
    .endm
    .macro order_next again
    subi r28, lo8(-({MOTOR_SIZE}))
    sbci r29, hi8(-({MOTOR_SIZE}))
    dec r27
    brne \again
    .endm
    .macro order_lease
    ldi r30, lo8(steps_lease)
    ldi r31, hi8(steps_lease)
    .endm

    .section .text.steps_horizon, "ax", @progbits
    .global steps_horizon
    // For Rust: the first tick at which something can be said otherwise, r22 to r25. Some motor is configured.
steps_horizon:
    push r28
    push r29
    rcall order_horizon
    pop r29
    pop r28
    ret
    // The same. Uses r18 to r21, r27, Y, Z.
order_horizon:
    lds r22, steps_stepper+{AT}
    lds r23, steps_stepper+{AT}+1
    lds r24, steps_stepper+{AT}+2
    lds r25, steps_stepper+{AT}+3
    lds r18, steps_mode
    cpi r18, {BOTH}
    breq 1f
    cpi r18, {BESIDE}
    brne 2f
1:  ldi r30, lo8(steps_stepper+{AT}+{TRACK_SIZE})
    ldi r31, hi8(steps_stepper+{AT}+{TRACK_SIZE})
    rcall order_later
2:  order_each
3:  push r24
    push r25
    call steps_settle
    pop r25
    pop r24
    movw r30, r28
    adiw r30, {HORIZON}
    rcall order_later
    order_next 3b
    subi r22, -1
    sbci r23, -1
    sbci r24, -1
    sbci r25, -1
    ret
    // The later of r22 to r25 and what is at Z. Uses r18 to r21.
order_later:
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

    .section .text.steps_order, "ax", @progbits
    .global steps_order, steps_lapse, steps_look_at_lease
    // For Rust: does what the r22 bytes at r24:25 say, of the kind r20. r24: an answer, r18 to r21 its moment, or 0.
steps_order:
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
    rcall order_switch
    // No moment.
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
2:  rcall order_extend
    rjmp 1b
3:  cpi r20, {BRAKE}
    breq 4f
    rcall order_trim
    rjmp 1b
4:  rcall order_brake
    rjmp 1b
order_brake:
    tst r14
    brne order_bad
    rcall order_latch
    cpi r20, {OFF}
    ldi r24, {FULL}
    breq 2f
    cpi r20, {LAPSED}
    breq 1f
    rcall steps_lapse
1:  ldi r30, lo8(steps_lease+{LEASE_AT})
    ldi r31, hi8(steps_lease+{LEASE_AT})
    rcall order_compare
    ldi r24, {ACCEPTED} | {MOMENT}
2:  ret
order_bad:
    ldi r24, {MALFORMED}
    ret

    // Epoch, tick, lease, limits.
order_switch:
    ldi r24, 9
    sub r14, r24
    brcs order_bad
    subi r16, -9
    sbci r17, -1
    rcall order_check
    brcs order_bad
    call clock_moment
    movw r30, r16
    sbiw r30, 8
    // How far it is ahead: r27 the fourth byte, r20 all above that, r21 the last.
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
    rjmp order_late
    tst r20
    brne 1f
    cpi r27, 0x40
    brlo 2f
1:  movw r18, r22
    movw r20, r24
    subi r21, -0x40
    ldi r24, {EARLY} | {MOMENT}
    ret
    // Not while motors await the end of a lease that is over. The end of one that is not they are told again.
2:  rcall order_latch
    cpi r20, {LAPSED}
    brne 4f
    order_each
3:  rcall order_point
    ldd r20, Z+{STATE}
    sbrc r20, {AWAITS}
    rjmp order_late
    order_next 3b
    rjmp 5f
4:  rcall order_go_on
5:  rcall order_horizon
    movw r30, r16
    sbiw r30, 8
    rcall order_compare
    brmi order_late
    movw r22, r18
    movw r24, r20
    ld r20, -Z
    call steps_switch
    tst r24
    ldi r24, {FULL}
    breq 7f
    // A lease that ends before it stands: it is not made, then. Another is no shorter.
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
    rcall order_compare
    brmi order_limits
6:  movw r30, r16
    adiw r30, 1
    rcall order_later
    rcall order_set
    rjmp order_limits
7:  ret

    // The moment at Z, r18 to r21, compared with r22 to r25; N: it is before.
order_compare:
    ld r18, Z
    ldd r19, Z+1
    ldd r20, Z+2
    ldd r21, Z+3
    cp r18, r22
    cpc r19, r23
    cpc r20, r24
    cpc r21, r25
    ret

    // The horizon.
order_late:
    rcall order_horizon
    movw r18, r22
    movw r20, r24
    ldi r24, {LATE} | {MOMENT}
    ret

    // Lease, limits.
order_extend:
    rcall order_check
    brcs 8f
    movw r30, r16
    ld r24, Z+
    rcall order_put_off
    brcs order_late
    // Limits for each motor by its number, or none: how hard it may brake.
order_limits:
    subi r16, -5
    sbci r17, -1
    ldi r24, 5
    sub r14, r24
    ldi r20, 0
    breq 2f
1:  rcall order_motor
    rcall order_point
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
8:  rjmp order_bad

    // Until, two bytes for each motor.
order_trim:
    lds r24, steps_stepper+{COUNT}
    lsl r24
    subi r24, -4
    cp r24, r14
    brne 8b
    // Twice: at first only whether they can all be had.
    set
1:  ldi r20, 0
2:  rcall order_motor
    rcall order_point
    ldd r24, Z+{BEHIND}
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
    rcall order_put_off
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
    rjmp order_late
7:  ldi r24, {FULL}
    ret

    // The lease's state is r24 from now on, its end what is at Z. Carry: that cannot be.
order_put_off:
    push r30
    push r31
    push r24
    rcall order_latch
    rcall order_horizon
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
    rcall order_compare
    pop r18
    brmi 2f
3:  ld r22, Z
    ldd r23, Z+1
    ldd r24, Z+2
    ldd r25, Z+3
    mov r20, r18
    rcall order_set_state
    rcall order_go_on
    clc
    ret
2:  sec
    ret

    // The lease is what the first byte at r16:17 says, up to r22 to r25.
order_set:
    movw r30, r16
    ld r20, Z
order_set_state:
    order_lease
    st Z, r20
    std Z+{MOVED}, r1
    std Z+{LEASE_AT}, r22
    std Z+{LEASE_AT}+1, r23
    std Z+{LEASE_AT}+2, r24
    std Z+{LEASE_AT}+3, r25
    ret

    // Carry: r14 bytes at r16:17 are no lease and limits for all motors, or none.
order_check:
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

    // The motor Y of the number r20. Uses r24, r25.
order_motor:
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

    // Z: at the motor's parts.
order_point:
    movw r30, r28
    subi r30, lo8(-({PARTS}))
    sbci r31, hi8(-({PARTS}))
    ret

    // The end of the lease, which some motors await, is no end any more.
order_go_on:
    order_each
1:  rcall order_point
    ldd r25, Z+{STATE}
    sbrs r25, {AWAITS}
    rjmp 3f
    std Z+{STATE}, r1
    std Z+{IS_DUE}, r1
    ldd r24, Y+{FLAGS}
    sbrs r25, {WAITS}
    andi r24, 0xff - (1 << {SWITCH})
    std Y+{FLAGS}, r24
    .irp at, 0,1,2,3
    ldd r24, Z+{AWAITED_AT}+\at
    std Y+{SWITCH_AT}+\at, r24
    .endr
3:  order_next 1b
    ret

    // For Rust: the lease is over if the horizon has passed its end, or a motor could not follow its plan.
steps_look_at_lease:
    push r28
    push r29
    rcall order_latch
    pop r29
    pop r28
    ret

    // The lease is over if the horizon has passed its end, or a motor could not follow its plan. r20: its state.
order_latch:
    lds r20, steps_lease
    sbrc r20, {FAULT_BIT}
    rjmp steps_lapse
    cpi r20, {UNTIL}
    brne 1f
    rcall order_horizon
    ldi r30, lo8(steps_lease+{LEASE_AT})
    ldi r31, hi8(steps_lease+{LEASE_AT})
    rcall order_compare
    brmi steps_lapse
    ldi r20, {UNTIL}
1:  ret

    // It is over at its end, or as soon as can be if that is sooner. r20: its state.
steps_lapse:
    rcall order_horizon
    order_lease
    ld r20, Z
    andi r20, 3
    cpi r20, {LAST}
    breq 1f
    adiw r30, {LEASE_AT}
    rcall order_compare
    brmi 2f
1:  order_lease
    std Z+{LEASE_AT}, r22
    std Z+{LEASE_AT}+1, r23
    std Z+{LEASE_AT}+2, r24
    std Z+{LEASE_AT}+3, r25
    movw r18, r22
    movw r20, r24
2:  ldi r24, {LAPSED}
    sts steps_lease, r24
    call steps_await_all
    ldi r20, {LAPSED}
    ret
    "#,
    COUNT = const COUNT,
    SWAP = const SWAP,
    LAST_MOTOR = const MAX_MOTORS - 1,
    MOTOR_SIZE = const size_of::<Motor>(),
    TRACK_SIZE = const size_of::<Track>(),
    AT = const offset_of!(Stepper, tracks) + offset_of!(Track, at),
    BOTH = const mode::BOTH,
    BESIDE = const mode::BESIDE,
    HORIZON = const offset_of!(Motor, horizon),
    FLAGS = const offset_of!(Motor, flags),
    SWITCH = const flag::SWITCH,
    SWITCH_AT = const offset_of!(Motor, switch_at),
    PARTS = const offset_of!(Motor, parts),
    BEHIND = const offset_of!(Motor, behind) - offset_of!(Motor, parts),
    IS_DUE = const offset_of!(Motor, is_due) - offset_of!(Motor, parts),
    AWAITED_AT = const OF_SWITCH + offset_of!(super::motor::Switch, at),
    STATE = const super::brake::STATE,
    AWAITS = const state::AWAITS,
    WAITS = const state::WAITS,
    LEASE_AT = const offset_of!(Lease, at),
    MOVED = const offset_of!(Lease, moved),
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

const _: () = assert!(size_of::<Part>() == 3);
const _: () = assert!(lease::UNTIL == 1 && lease::LAST == 2);

unsafe extern "C" {
    fn steps_horizon() -> u32;
    fn steps_order(bytes: *const u8, len: u8, kind: u8) -> u64;
    fn steps_look_at_lease();
}

impl Stepper {
    /// Does what the bytes of a frame of this kind say: Switch, Extend, Trim, Brake. Gives an [`answer`], and its moment.
    #[inline(always)]
    pub(crate) fn order(&mut self, kind: u8, bytes: &[u8]) -> (u8, Tick32) {
        // SAFETY: the assembly uses the motors and their lease, which are whose this is.
        let [m0, m1, m2, m3, _, _, answer, _] =
            unsafe { steps_order(bytes.as_ptr(), bytes.len() as u8, kind) }.to_le_bytes();
        (answer, Tick32(u32::from_le_bytes([m0, m1, m2, m3])))
    }

    /// The first tick at which a switch would be accepted. Some motor is configured.
    #[inline(always)]
    pub(super) fn first_open(&self) -> Tick32 {
        // SAFETY: as above.
        Tick32(unsafe { steps_horizon() })
    }

    /// The lease, which is over once the horizon has passed its end.
    #[inline(always)]
    pub(crate) fn lease(&mut self) -> Lease {
        // SAFETY: as above.
        unsafe { steps_look_at_lease() };
        Lease::get()
    }
}
