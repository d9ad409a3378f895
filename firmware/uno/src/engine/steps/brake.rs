//! Braking: what a motor does at the end of its lease, by core's rule (`pulsetrain_core::braking`), one part of the stop at a time.
//!
//! A motor [waits](state::END_NEXT) for the end of the lease as it waits for a switch, and begins its stop there ([`plan`](super::plan)). From then on it
//! reads no records: its steps come from here.
//!
//! # The level in bytes
//! The limit's mantissa M, its exponent E and its rest level L are bytes. So is the level: E is 61 at most and an interval has 39 bits, so that the level
//! lies between -77 and 124.
//!
//! # Cycles
//! A part takes 280 to 420, and the check of its intervals (`load_count_steps`).

use super::motor::{EpochBytes, FaultKind, Motor, Switch, flag};
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
    pub(crate) const END_NEXT: u8 = 0;
    /// A switch waits, too, at the end or later.
    pub(crate) const SWITCH_TOO: u8 = 1;
    /// It makes the steps of its stop.
    pub(crate) const BRAKES: u8 = 2;
}

/// States of a [`CurrentLease`].
pub(crate) mod lease {
    /// There is no lease.
    pub(crate) const OFF: u8 = 0;
    /// Plans hold up to the lease's tick.
    pub(crate) const UNTIL: u8 = 1;
    /// Plans hold to their end.
    pub(crate) const LAST: u8 = 2;
    /// The lease is over.
    pub(crate) const LAPSED: u8 = 3;
    /// Flag, with one of the states above: a motor cannot follow its plan. All brake as soon as they can, or at the lease's tick if that is sooner.
    pub(crate) const FAULT: u8 = 4;
}

/// How long plans hold. The assembly finds it as `steps_lease`.
#[derive(Clone, Copy)]
#[repr(C)]
pub(crate) struct CurrentLease {
    /// One of [`lease`].
    pub(crate) state: u8,
    /// Not 0 if a motor was moving at the end.
    pub(crate) moved: u8,
    pub(crate) at: Tick32,
}

const _: () = assert!(offset_of!(CurrentLease, state) == 0);

#[unsafe(export_name = "steps_lease")]
static mut LEASE: CurrentLease = CurrentLease::OFF;

impl CurrentLease {
    /// No lease.
    pub(crate) const OFF: CurrentLease = CurrentLease { state: lease::OFF, moved: 0, at: Tick32(0) };

    /// The lease. Only whoever has the stepper may ask.
    #[inline(always)]
    pub(crate) fn get() -> CurrentLease {
        // SAFETY: a copy. Only whoever has the stepper writes it.
        unsafe { (&raw const LEASE).read() }
    }

    /// Ends it without a stop. Only whoever has the stepper may call this.
    #[inline(always)]
    pub(crate) fn end() {
        // SAFETY: only whoever has the stepper writes it.
        unsafe { (&raw mut LEASE).write(CurrentLease::OFF) };
    }
}

global_asm!(
    r#"
    // Points Z to the epochs of the motor Y.
    .macro brake_point_to_epochs
    movw r30, r28
    subi r30, lo8(-({EPOCHS}))
    sbci r31, hi8(-({EPOCHS}))
    .endm

    .section .text.load_leased, "ax", @progbits
    .global load_leased, steps_brake
    // `source_load` of a program with leases: records of the queue, and parts of a stop.
load_leased:
    ldd r24, Y+{FLAGS}
    sbrs r24, {UNREADABLE}
    jmp steps_load_record
    brake_point_to_epochs
    ldd r24, Z+{STATE}
    sbrc r24, {BRAKES}
    rjmp steps_brake
brake_none:
    sec
    ret

    // The next part of a stop, from the interval of the motor Y on. Z points to its epochs. Carry: it is at rest.
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
    brmi brake_at_rest                  // as long as registers hold
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
brake_at_rest:                          // no interval
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
    // Slow enough for rest after one more step.
6:  std Z+{STATE}, r1
    ldi r24, 1
    clr r18
    clr r19
    movw r20, r18
    rjmp 13f
    // The interval grows by itself / 2^(level + 1), less than 2^31,
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
    jmp load_count_steps

    .section .text.brake_begin, "ax", @progbits
    .global brake_begin, brake_check_underrun, brake_note_rest, brake_fail, brake_check_lease_end, limit_leased, brake_all_at_end
    // From the plan: the lease is over, and the motor Y begins its stop. Z points to its epochs, r25 is its braking state, r22:23 are the steps that were
    // left. The position does not count those any more.
brake_begin:
    or r22, r23
    mov r14, r22
    // Drops what waits of its epoch, and of that of a switch that will not be made.
    ldd r22, Z+{EPOCH_RUNNING}
    sbrc r25, {SWITCH_TOO}
    ldd r22, Z+{SWITCH_EPOCH}
    clt
    call plan_drop_epochs
    call plan_horizon_to_switch
    ldi r27, 0                          // its state
    ldd r24, Y+{FLAGS}
    sbrs r24, {ANCHORED}
    rjmp 7f
    rcall brake_check_rest
    breq 7f
    tst r14
    brne 6f
    rcall brake_previous_interval
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

    // The motor Y cannot follow its plan, for the fault r22, at r18 to r21. With a lease it brakes from its horizon, and all others as soon as they can.
brake_fail:
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
    brake_point_to_epochs
    std Z+{FAULT_KIND}, r22
    .irp at, 0,1,2,3
    ldd r2\at, Y+{HORIZON}+\at
    std Y+{SWITCH_AT}+\at, r2\at
    .endr
    ldd r24, Z+{FAULT_KIND}
    cpi r24, {MISSED}
    brne 3f
    // Its next step comes at the horizon: the registers' tick is an interval before that.
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
    sbrs r25, {END_NEXT}
    rcall brake_wait_for_end
    ori r24, 1 << {UNREADABLE}
    std Y+{FLAGS}, r24
    ret

    // The motor Y, whose flags are r24, waits for the end of the lease, at its switch's tick. Z points to its epochs. Uses r25.
brake_wait_for_end:
    ldi r25, 1 << {END_NEXT}
    sbrc r24, {SWITCH}
    ori r25, 1 << {SWITCH_TOO}
    std Z+{STATE}, r25
    std Z+{IS_DUE}, r1
    ori r24, 1 << {SWITCH}
    std Y+{FLAGS}, r24
    ret

    // The motor Y has begun a new epoch. If the end of the lease is near, it must wait for that now.
brake_check_lease_end:
    lds r24, steps_lease
    sbrs r24, 0
    ret
    lds r22, steps_times+{LIMIT}
    lds r23, steps_times+{LIMIT}+1
    lds r24, steps_times+{LIMIT}+2
    lds r25, steps_times+{LIMIT}+3
    rcall brake_check_end_near
    brcs brake_motor_at_end
    ret

    // Carry: the end of the lease, r18 to r21, is less than 2 ms after the limit r22 to r25. A batch reaches 1.5 ms beyond the limit at most. Uses r26, r27,
    // r30, r31.
brake_check_end_near:
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

    // `source_limit` of a program with leases: 3 ms from now. If the end of the lease is near, all motors wait for it from now on.
limit_leased:
    call steps_limit
    lds r18, steps_lease
    sbrc r18, {FAULT_BIT}
    rjmp 2f
    cpi r18, {UNTIL}
    brne 1f
    rcall brake_check_end_near
    brcc 1f
    .irp r, 22,23,24,25
    push r\r
    .endr
    rcall brake_all_at_end
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
brake_all_at_end:
    ldi r28, lo8(steps_motors)
    ldi r29, hi8(steps_motors)
    lds r22, steps_stepper+{COUNT}
1:  rcall brake_motor_at_end
    subi r28, lo8(-({MOTOR_SIZE}))
    sbci r29, hi8(-({MOTOR_SIZE}))
    dec r22
    brne 1b
    ret

    // The motor Y is to brake at r18 to r21, not before its horizon; unless a switch comes first, or it brakes already, or is at rest. Uses r24, r25, Z.
brake_motor_at_end:
    ldd r24, Y+{FLAGS}
    sbrc r24, {UNREADABLE}
    ret
    brake_point_to_epochs
    ldd r25, Z+{STATE}
    sbrc r25, {END_NEXT}
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
2:  rcall brake_wait_for_end
1:  std Y+{SWITCH_AT}, r18
    std Y+{SWITCH_AT}+1, r19
    std Y+{SWITCH_AT}+2, r20
    std Y+{SWITCH_AT}+3, r21
3:  ret

    // Notes that the motor Y is at rest until its next step. Uses r18, r19, r24.
brake_note_rest:
    movw r18, r30
    brake_point_to_epochs
    .irp at, 0,1,2,3
    ldd r24, Y+{POSITION}+\at
    std Z+{REST_POSITION}+\at, r24
    .endr
    movw r30, r18
    ret

    // Z flag: the motor Y, which has no steps left, has made none since it was at rest. Points Z to its epochs. Uses r22, r23.
brake_check_rest:
    ldd r22, Y+{POSITION}
    ldd r23, Z+{REST_POSITION}
    cp r22, r23
    .irp at, 1,2,3
    ldd r22, Y+{POSITION}+\at
    ldd r23, Z+{REST_POSITION}+\at
    cpc r22, r23
    .endr
    ret

    // r22 to r26: the interval before the last step. That was less by `add`, which in turn was less by `add2` then. Uses r25, r27.
brake_previous_interval:
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

    // Carry: an underrun. The motor Y has nothing to do, there is a lease that is not the last, and its next step would be due by r18 to r21. Keeps those, and T.
brake_check_underrun:
    lds r24, steps_lease
    andi r24, 0xff - {LAST}
    breq 1f
    ldd r24, Y+{FLAGS}
    andi r24, 1 << {ANCHORED} | 1 << {UNREADABLE}
    cpi r24, 1 << {ANCHORED}
    brne 1f
    brake_point_to_epochs
    rcall brake_check_rest
    breq 1f
    rcall brake_previous_interval
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
    EPOCH_RUNNING = const offset_of!(EpochBytes, epoch),
    SWITCH_EPOCH = const OF_SWITCH + offset_of!(Switch, epoch),
    REST_POSITION = const offset_of!(Motor, fault_tick) - offset_of!(Motor, epochs),
    SWITCH_TOO = const state::SWITCH_TOO,
    END_NEXT = const state::END_NEXT,
    FAULT_KIND = const offset_of!(Motor, fault_kind) - offset_of!(Motor, epochs),
    IS_DUE = const offset_of!(Motor, is_due) - offset_of!(Motor, epochs),
    MISSED = const FaultKind::Missed as u8,
    UNTIL = const lease::UNTIL,
    LAPSED = const lease::LAPSED,
    FAULT = const lease::FAULT,
    FAULT_BIT = const lease::FAULT.trailing_zeros(),
    AT = const offset_of!(CurrentLease, at),
    LIMIT = const times::LIMIT,
    COUNT = const stepper::COUNT,
    MOTOR_SIZE = const size_of::<Motor>(),
    LAST = const lease::LAST,
    MOVED = const offset_of!(CurrentLease, moved),
    UNREADABLE = const flag::UNREADABLE,
    INTERVAL = const offset_of!(Motor, registers) + offset_of!(Registers, interval_low),
    ADD = const offset_of!(Motor, registers) + offset_of!(Registers, add),
    ADD2 = const offset_of!(Motor, registers) + offset_of!(Registers, add2),
    LEFT = const offset_of!(Motor, registers) + offset_of!(Registers, left),
    EPOCHS = const offset_of!(Motor, epochs),
    STATE = const STATE,
    BRAKES = const state::BRAKES,
    MANTISSA = const STATE + 1,
    EXPONENT = const STATE + 2,
    REST_LEVEL = const STATE + 3,
);

/// Where in a motor its braking state is, after its epochs. The limit follows.
pub(super) const STATE: usize = offset_of!(Motor, braking) - offset_of!(Motor, epochs);
const _: () = assert!(STATE + 3 < 64);
