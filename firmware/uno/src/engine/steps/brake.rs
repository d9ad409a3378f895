//! Braking: what a motor does whose lease is over, by core's rule (`pulsetrain_core::braking`), a part at a time.
//!
//! A motor [awaits](state::AWAITS) the end of the lease as it awaits a switch, and goes over to its stop there ([`plan`](super::plan)). From then
//! on it reads no records: its steps come from here.
//!
//! # The level in bytes
//! The limit's mantissa M, its exponent E and its rest level L are bytes. So is the level: E is 61 at most and an interval has 39 bits, so that the level
//! lies between -77 and 124.
//!
//! # Cycles
//! A part takes 280 to 420, and what finds out whether its steps are sure.

use super::motor::{Motor, Part, Reason, Switch, flag};
use super::plan::OF_SWITCH;
use super::stepper;
use super::times;
use core::arch::global_asm;
use core::mem::offset_of;
use pulsetrain_core::Tick32;
use pulsetrain_core::avr::Registers;

/// Bits of a motor's braking state, by number.
pub(crate) mod state {
    /// Its next switch is the end of the lease.
    pub(crate) const AWAITS: u8 = 0;
    /// A switch waits at that tick or later.
    pub(crate) const WAITS: u8 = 1;
    /// It makes the steps of its stop.
    pub(crate) const BRAKES: u8 = 2;
}

/// What a [`Lease`] is.
pub(crate) mod lease {
    /// There is none.
    pub(crate) const OFF: u8 = 0;
    /// Plans hold up to its tick.
    pub(crate) const UNTIL: u8 = 1;
    /// Plans hold to their end.
    pub(crate) const LAST: u8 = 2;
    /// It is over.
    pub(crate) const LAPSED: u8 = 3;
    /// Or else it was one of these, and a motor cannot follow its plan: all brake as soon as they can, or at its tick if that is sooner.
    pub(crate) const FAULT: u8 = 4;
}

/// How long plans hold. The assembly knows where it is.
#[derive(Clone, Copy)]
#[repr(C)]
pub(crate) struct Lease {
    /// One of [`lease`].
    pub(crate) state: u8,
    /// Not 0 if a motor was in motion when it was over.
    pub(crate) moved: u8,
    pub(crate) at: Tick32,
}

const _: () = assert!(offset_of!(Lease, state) == 0);

#[unsafe(export_name = "steps_lease")]
static mut LEASE: Lease = Lease::OFF;

impl Lease {
    /// None.
    pub(crate) const OFF: Lease = Lease { state: lease::OFF, moved: 0, at: Tick32(0) };

    /// To be asked by who has the stepper.
    #[inline(always)]
    pub(crate) fn get() -> Lease {
        // SAFETY: a copy; who has the stepper alone writes it.
        unsafe { (&raw const LEASE).read() }
    }

    /// There is none from now on. To be called by who has the stepper.
    #[inline(always)]
    pub(crate) fn end() {
        // SAFETY: who has the stepper alone writes it.
        unsafe { (&raw mut LEASE).write(Lease::OFF) };
    }
}

global_asm!(
    r#"
    // Z: at the parts of the motor Y.
    .macro brake_point
    movw r30, r28
    subi r30, lo8(-({PARTS}))
    sbci r31, hi8(-({PARTS}))
    .endm

    .section .text.steps_load_leased, "ax", @progbits
    .global steps_load_leased, steps_brake
    // A program's source of steps: records of the queue, and parts of a stop.
steps_load_leased:
    ldd r24, Y+{FLAGS}
    sbrs r24, {UNREADABLE}
    jmp steps_load_record
    brake_point
    ldd r24, Z+{STATE}
    sbrc r24, {BRAKES}
    rjmp steps_brake
brake_none:
    sec
    ret

    // The next part of a stop, from the motor Y's interval on; Z is at its parts. Carry: it rests.
    // r18 to r22: the interval, and then what it grows by; r24 and r25: its upper eight bits, and the number of its leading one.
steps_brake:
    ldd r18, Y+{INTERVAL}
    ldd r19, Y+{INTERVAL}+1
    ldd r20, Y+{INTERVAL}+2
    ldd r21, Y+{INTERVAL}+3
    ldd r22, Y+{INTERVAL}+4
    mov r0, r18
    mov r23, r19
    movw r26, r20
    mov r24, r22
    tst r24
    brmi brake_rest                     // as long as registers hold
    ldi r25, 39
1:  tst r24
    brne 2f
    mov r24, r27
    mov r27, r26
    mov r26, r23
    mov r23, r0
    clr r0
    subi r25, 8
    brcc 1b
brake_rest:                             // no interval
    std Z+{STATE}, r1
    sec
    ret
2:  sbrc r24, 7
    rjmp 3f
    lsl r27
    rol r24
    dec r25
    rjmp 2b
    // r26: the level.
3:  ldd r23, Z+{MANTISSA}
    ldd r26, Z+{EXPONENT}
    sub r26, r25
    lsl r26
    ldi r25, 181                        // 128 times the root of 2
    mul r24, r25
    cp r24, r23
    brlo 4f
    cp r1, r23
    brlo 5f
    dec r26
    rjmp 5f
4:  inc r26
    lsl r0
    rol r1
    brcs 5f
    cp r1, r23
    brsh 5f
    inc r26
5:  clr r1
    tst r26
    brmi 6f
    ldd r25, Z+{REST_LEVEL}
    cp r25, r26
    brlo 7f
    // Slow enough after one step more.
6:  std Z+{STATE}, r1
    ldi r24, 1
    clr r18
    clr r19
    movw r20, r18
    rjmp 13f
    // It grows by the interval / 2^(level + 1), which is less than 2^31,
7:  mov r24, r26
8:  lsr r22
    ror r21
    ror r20
    ror r19
    ror r18
    subi r24, 1
    brcc 8b
    tst r22
    brne 9f
    sbrs r21, 7
    rjmp 10f
9:  ser r18
    ser r19
    ser r20
    ldi r21, 0x7f
    // and by one unit at least.
10: mov r24, r18
    or r24, r19
    or r24, r20
    or r24, r21
    brne 11f
    inc r18
    // 2^(level - 2) steps, 1 to 128.
11: ldi r24, 1
12: cpi r26, 3
    brlo 13f
    lsl r24
    dec r26
    sbrs r24, 7
    rjmp 12b
13: std Y+{ADD}, r18
    std Y+{ADD}+1, r19
    std Y+{ADD}+2, r20
    std Y+{ADD}+3, r21
    .irp at, 0,1,2,3
    std Y+{ADD2}+\at, r1
    .endr
    std Y+{LEFT}, r24
    std Y+{LEFT}+1, r1
    jmp steps_load_taken

    .section .text.steps_stop, "ax", @progbits
    .global steps_stop, steps_dry, steps_freshen, steps_fail_leased, steps_lease_goes_on, steps_limit_leased, steps_await_all
    // From the plan: the lease is over, and the motor Y goes over to its stop. Z is at its parts, r25 its braking state, r22 and r23 have the steps
    // that were left; those are off the position already.
steps_stop:
    or r22, r23
    mov r14, r22
    // What waits of its epoch is dropped, and of that of a switch that is not made.
    ldd r22, Z+{PART_EPOCH}
    sbrc r25, {WAITS}
    ldd r22, Z+{SWITCH_EPOCH}
    clt
    call plan_pass_parts
    call plan_reach_switch
    ldi r27, 0                          // its state
    ldd r24, Y+{FLAGS}
    sbrs r24, {ANCHORED}
    rjmp 7f
    rcall brake_is_fresh
    breq 7f
    tst r14
    brne 6f
    rcall brake_last_interval
    std Y+{INTERVAL}, r22
    std Y+{INTERVAL}+1, r23
    std Y+{INTERVAL}+2, r24
    std Y+{INTERVAL}+3, r25
    std Y+{INTERVAL}+4, r26
6:  ldi r27, 1 << {BRAKES}
    sts steps_lease+{MOVED}, r27
7:  ldd r24, Y+{FLAGS}
    andi r24, 0xff - (1 << {SWITCH})
    ori r24, 1 << {UNREADABLE}
    std Y+{FLAGS}, r24
    std Z+{STATE}, r27
    jmp plan_slow

    // The motor Y cannot follow its plan, for the reason r22, at r18 to r21: with a lease it brakes from the horizon, and all others as soon as they can.
steps_fail_leased:
    lds r24, steps_lease
    tst r24
    brne 1f
    clr r23
    movw r24, r28
    jmp steps_fail
1:  cpi r24, {LAPSED}
    breq 2f
    ori r24, {FAULT}
    sts steps_lease, r24
2:  call steps_settle
    brake_point
    std Z+{REASON}, r22
    .irp at, 0,1,2,3
    ldd r2\at, Y+{HORIZON}+\at
    std Y+{SWITCH_AT}+\at, r2\at
    .endr
    ldd r24, Z+{REASON}
    cpi r24, {MISSED}
    brne 3f
    // The step comes then.
    ldd r24, Y+{INTERVAL}+2
    sub r20, r24
    ldd r24, Y+{INTERVAL}+3
    sbc r21, r24
    ldd r24, Y+{INTERVAL}+4
    sbc r22, r24
    sbc r23, r1
    .irp at, 0,1,2,3
    std Y+{TICK}+\at, r2\at
    .endr
3:  ldd r24, Y+{FLAGS}
    ldd r25, Z+{STATE}
    sbrs r25, {AWAITS}
    rcall brake_await
    ori r24, 1 << {UNREADABLE}
    std Y+{FLAGS}, r24
    ret

    // The motor Y, whose flags are r24, awaits what is at its switch's tick. Z is at its parts. Uses r25.
brake_await:
    ldi r25, 1 << {AWAITS}
    sbrc r24, {SWITCH}
    ori r25, 1 << {WAITS}
    std Z+{STATE}, r25
    std Z+{IS_DUE}, r1
    ori r24, 1 << {SWITCH}
    std Y+{FLAGS}, r24
    ret

    // The motor Y has begun a new epoch: the end of the lease may be near.
steps_lease_goes_on:
    lds r24, steps_lease
    sbrs r24, 0
    ret
    lds r22, steps_times+{LIMIT}
    lds r23, steps_times+{LIMIT}+1
    lds r24, steps_times+{LIMIT}+2
    lds r25, steps_times+{LIMIT}+3
    rcall brake_is_near
    brcs steps_await_end
    ret

    // Carry: the end of the lease is near the limit r22 to r25. What is planned at once reaches 1.5 ms beyond that at most, and this is 2 ms. r18 to r21:
    // the end. Uses r26, r27, r30, r31.
brake_is_near:
    ldi r30, lo8(steps_lease+{AT})
    ldi r31, hi8(steps_lease+{AT})
    ld r18, Z
    ldd r19, Z+1
    ldd r20, Z+2
    ldd r21, Z+3
    movw r26, r18
    movw r30, r20
    sub r26, r22
    sbc r27, r23
    sbc r30, r24
    sbc r31, r25
    brmi 1f
    or r30, r31
    brne 2f
    sbrs r27, 7
1:  sec
2:  ret

    // A program's limit: 3 ms from now. All motors are told if the end of the lease is near.
steps_limit_leased:
    call steps_limit
    lds r18, steps_lease
    sbrc r18, {FAULT_BIT}
    rjmp 2f
    cpi r18, {UNTIL}
    brne 1f
    rcall brake_is_near
    brcc 1f
    .irp r, 22,23,24,25
    push r\r
    .endr
    rcall steps_await_all
3:  .irp r, 25,24,23,22
    pop r\r
    .endr
1:  ret
2:  .irp r, 22,23,24,25
    push r\r
    .endr
    call steps_lapse
    rjmp 3b

    // All motors brake at r18 to r21.
steps_await_all:
    ldi r28, lo8(steps_motors)
    ldi r29, hi8(steps_motors)
    lds r22, steps_stepper+{COUNT}
1:  rcall steps_await_end
    subi r28, lo8(-({MOTOR_SIZE}))
    sbci r29, hi8(-({MOTOR_SIZE}))
    dec r22
    brne 1b
    ret

    // The motor Y brakes at r18 to r21, not before its horizon, unless a switch comes first, it brakes already or rests. Uses r24, r25, Z.
steps_await_end:
    ldd r24, Y+{FLAGS}
    sbrc r24, {UNREADABLE}
    ret
    brake_point
    ldd r25, Z+{STATE}
    sbrc r25, {AWAITS}
    rjmp 1f
    sbrs r24, {SWITCH}
    rjmp 2f
    ldd r25, Y+{SWITCH_AT}
    cp r18, r25
    ldd r25, Y+{SWITCH_AT}+1
    cpc r19, r25
    ldd r25, Y+{SWITCH_AT}+2
    cpc r20, r25
    ldd r25, Y+{SWITCH_AT}+3
    cpc r21, r25
    brpl 3f
2:  rcall brake_await
1:  std Y+{SWITCH_AT}, r18
    std Y+{SWITCH_AT}+1, r19
    std Y+{SWITCH_AT}+2, r20
    std Y+{SWITCH_AT}+3, r21
3:  ret

    // The motor Y is at rest until its next step. Uses r18, r19, r24.
steps_freshen:
    movw r18, r30
    brake_point
    .irp at, 0,1,2,3
    ldd r24, Y+{POSITION}+\at
    std Z+{FRESH_AT}+\at, r24
    .endr
    movw r30, r18
    ret

    // Z: the motor Y, of whose segment no step is left, has made none since it was at rest; Z+ is at its parts. Uses r22, r23.
brake_is_fresh:
    ldd r22, Y+{POSITION}
    ldd r23, Z+{FRESH_AT}
    cp r22, r23
    .irp at, 1,2,3
    ldd r22, Y+{POSITION}+\at
    ldd r23, Z+{FRESH_AT}+\at
    cpc r22, r23
    .endr
    ret

    // The interval before the last step, r22 to r26: less by what it grew, and that was less by add2. Uses r25, r27.
brake_last_interval:
    ldd r22, Y+{INTERVAL}
    ldd r23, Y+{INTERVAL}+1
    ldd r24, Y+{INTERVAL}+2
    ldd r25, Y+{INTERVAL}+3
    ldd r26, Y+{INTERVAL}+4
    ldd r27, Y+{ADD}
    sub r22, r27
    ldd r27, Y+{ADD}+1
    sbc r23, r27
    ldd r27, Y+{ADD}+2
    sbc r24, r27
    ldd r27, Y+{ADD}+3
    sbc r25, r27
    sbc r26, r1
    sbrc r27, 7
    inc r26
    ldd r27, Y+{ADD2}
    add r22, r27
    ldd r27, Y+{ADD2}+1
    adc r23, r27
    ldd r27, Y+{ADD2}+2
    adc r24, r27
    ldd r27, Y+{ADD2}+3
    adc r25, r27
    adc r26, r1
    sbrc r27, 7
    dec r26
    ret

    // Carry: the motor Y, which has nothing to do, has run dry: with a lease that is not the last its next step would be due by r18 to r21. Keeps those, and T.
steps_dry:
    lds r24, steps_lease
    andi r24, 0xff - {LAST}
    breq 1f
    ldd r24, Y+{FLAGS}
    andi r24, 1 << {ANCHORED} | 1 << {UNREADABLE}
    cpi r24, 1 << {ANCHORED}
    brne 1f
    brake_point
    rcall brake_is_fresh
    breq 1f
    rcall brake_last_interval
    movw r30, r18
    movw r14, r20
    ldd r27, Y+{TICK}
    sub r30, r27
    ldd r27, Y+{TICK}+1
    sbc r31, r27
    ldd r27, Y+{TICK}+2
    sbc r14, r27
    ldd r27, Y+{TICK}+3
    sbc r15, r27
    brmi 1f
    cp r30, r24
    cpc r31, r25
    cpc r14, r26
    cpc r15, r1
    brlo 1f
    sec
    ret
1:  clc
    ret
    "#,
    FLAGS = const offset_of!(Motor, flags),
    ANCHORED = const flag::ANCHORED,
    SWITCH = const flag::SWITCH,
    TICK = const offset_of!(Motor, registers) + offset_of!(Registers, tick),
    POSITION = const offset_of!(Motor, position),
    HORIZON = const offset_of!(Motor, horizon),
    SWITCH_AT = const offset_of!(Motor, switch_at),
    PART_EPOCH = const offset_of!(Part, epoch),
    SWITCH_EPOCH = const OF_SWITCH + offset_of!(Switch, epoch),
    FRESH_AT = const offset_of!(Motor, fault_tick) - offset_of!(Motor, parts),
    WAITS = const state::WAITS,
    AWAITS = const state::AWAITS,
    REASON = const offset_of!(Motor, reason) - offset_of!(Motor, parts),
    IS_DUE = const offset_of!(Motor, is_due) - offset_of!(Motor, parts),
    MISSED = const Reason::Missed as u8,
    UNTIL = const lease::UNTIL,
    LAPSED = const lease::LAPSED,
    FAULT = const lease::FAULT,
    FAULT_BIT = const lease::FAULT.trailing_zeros(),
    AT = const offset_of!(Lease, at),
    LIMIT = const times::LIMIT,
    COUNT = const stepper::COUNT,
    MOTOR_SIZE = const size_of::<Motor>(),
    LAST = const lease::LAST,
    MOVED = const offset_of!(Lease, moved),
    UNREADABLE = const flag::UNREADABLE,
    INTERVAL = const offset_of!(Motor, registers) + offset_of!(Registers, interval_low),
    ADD = const offset_of!(Motor, registers) + offset_of!(Registers, add),
    ADD2 = const offset_of!(Motor, registers) + offset_of!(Registers, add2),
    LEFT = const offset_of!(Motor, registers) + offset_of!(Registers, left),
    PARTS = const offset_of!(Motor, parts),
    STATE = const STATE,
    BRAKES = const state::BRAKES,
    MANTISSA = const STATE + 1,
    EXPONENT = const STATE + 2,
    REST_LEVEL = const STATE + 3,
);

/// Where in a motor its braking state is, behind its parts; the limit follows.
pub(super) const STATE: usize = offset_of!(Motor, braking) - offset_of!(Motor, parts);
const _: () = assert!(STATE + 3 < 64);
