//! The refill's side: the steps of every millisecond, from the paths to the motors.
//!
//! A slice is a millisecond of the board's clock. Slices begin at multiples of [`SLICE`], also before the drivers were on. All four paths work out
//! the same slice together. A motor that steps in it gets a train. There is room for two trains of each motor, behind the lists of the merge in their
//! page. `winch_load` takes them.
//!
//! The limit is [`CLEARANCE`] before the next slice begins, so that DIR can be turned for a step at its very beginning.
//!
//! Main keeps the refill out for 1340 cycles at most to obey a line, and for 3480 to take four positions at one time (measured with steps in between,
//! four axes at 10 000 steps/s). Slices are worked out early enough for that: at least 8000 ticks were left (crates/board/tests/it/chips/winch_line.rs).

use crate::engine::steps::motor::{Motor, flag};
use crate::engine::steps::plan::FILLER;
use crate::engine::steps::times;
use crate::engine::tuning;
use crate::engine::tuning::winch::{CLEARANCE, FIRST_SLICE, LOOK_AHEAD, MAX_PERIOD};
use core::arch::global_asm;
use core::mem::offset_of;
use pulsetrain_core::Tick32;
use pulsetrain_core::winch::spacing::TICKS;

/// Ticks of a slice.
pub(crate) const SLICE: u16 = TICKS;

/// Bytes of a train: what tick.s writes, and the begin of its slice, 4 bytes at [`BEGIN`].
pub(crate) const TRAIN: u8 = 16;
const BEGIN: u8 = 10;

/// Bytes of the page for each motor: the list of its lane is at their end, its trains at their beginning. A slice has 11 steps at most.
const LANE: u8 = 64;
const _: () = assert!(2 * TRAIN + 2 * 11 <= LANE);

const _: () = assert!(SLICE == SLICE >> 7 << 7 && SLICE >> 7 < 256);

global_asm!(
    r#"
    .section .bss.winch_feed, "aw", @nobits
winch_slice: .skip 4                    // the next slice

    .section .text.winch, "ax", @progbits
    .global winch_limit, winch_load, winch_due, winch_begin_trains, winch_rests
    // `source_limit`: works out the next slice, if it begins within [`LOOK_AHEAD`] and there is room for its trains, and gives the limit. That takes
    // long, so that the ring is filled first.
winch_limit:
    call steps_merge_run
    call steps_limit
    subi r23, {SOONER} >> 8
    sbci r24, 0
    sbci r25, 0
    movw r26, r22
    movw r30, r24
    rcall winch_is_before               // r18 to r21: the next slice
    brpl 6f
    ldi r28, lo8(steps_motors)
    ldi r29, hi8(steps_motors)
    ldi r17, 4
2:  ldd r30, Y+{START}
    ldd r31, Y+{START}+1
    ld r24, Z
    tst r24
    brne 6f
    subi r28, lo8(-({MOTOR_SIZE}))
    sbci r29, hi8(-({MOTOR_SIZE}))
    dec r17
    brne 2b
    ldi r28, lo8(steps_motors)
    ldi r29, hi8(steps_motors)
    ldi r24, lo8(winch_paths)
    ldi r25, hi8(winch_paths)
    movw r10, r24
    ldi r17, 4
3:  .irp r, 10,11,17,28,29
    push r\r
    .endr
    movw r24, r10
    ldd r22, Y+{START}
    ldd r23, Y+{START}+1
    rcall winch_tick_inside
    .irp r, 29,28,17,11,10
    pop r\r
    .endr
    ldd r30, Y+{START}
    ldd r31, Y+{START}+1
    ld r24, Z
    tst r24
    breq 4f
    lds r24, winch_slice
    std Z+{BEGIN}, r24
    lds r24, winch_slice+1
    std Z+{BEGIN}+1, r24
    lds r24, winch_slice+2
    std Z+{BEGIN}+2, r24
    lds r24, winch_slice+3
    std Z+{BEGIN}+3, r24
    ldi r24, {TRAIN}
    eor r30, r24
    std Y+{START}, r30
4:  movw r24, r10
    adiw r24, {PATH}
    movw r10, r24
    subi r28, lo8(-({MOTOR_SIZE}))
    sbci r29, hi8(-({MOTOR_SIZE}))
    dec r17
    brne 3b
    rcall winch_next
6:  subi r18, lo8({CLEARANCE})
    sbci r19, hi8({CLEARANCE})
    sbci r20, 0
    sbci r21, 0
    movw r22, r18
    movw r24, r20
    ret

    // `source_due`: a refill works out one slice, and takes most of a slice's time for it.
winch_due:
    cpi r26, {MAX_PERIOD}
    brlo 1f
    ldi r26, {MAX_PERIOD}
1:  sec
    ret

    // `source_load`: the next train, if there is one. The registers' tick is an interval before its first step.
winch_load:
    ldd r24, Y+{FLAGS}
    sbrc r24, {UNREADABLE}
    rjmp 8f
    ldd r30, Y+{NEXT}
    ldd r31, Y+{NEXT}+1
    ld r22, Z
    cpi r22, 1
    brcc .+2
    ret                                 // with carry
    ldd r18, Z+6
    ldd r19, Z+7
    ldd r20, Z+8
    ldd r21, Z+9
    brne 1f
    clr r18                             // one step: that of a slice is no shorter than the wait for it
    clr r19
    ldi r20, lo8({SLICE})
    ldi r21, hi8({SLICE})
1:  ldd r14, Z+2
    sub r14, r18
    ldd r15, Z+3
    sbc r15, r19
    ldd r24, Z+4
    sbc r24, r20
    ldd r25, Z+5
    sbc r25, r21
    sbc r23, r23
    ldd r26, Z+10
    add r24, r26
    ldd r26, Z+11
    adc r25, r26
    ldd r26, Z+12
    adc r26, r23
    ldd r27, Z+13
    adc r27, r23
    ldd r22, Y+{FLAGS}
    ldd r23, Z+1
    eor r23, r22                        // whether it turns round
    sbrs r22, {STEPPED}
    rjmp 2f
    // A turn of DIR or a filler before this needs `dir_free` and `last`.
    sbrc r23, {BACKWARD}
    rjmp 4f
    movw r30, r24
    add r30, r20
    adc r31, r21
    mov r0, r26
    adc r0, r1
    ldd r22, Y+{MOTOR_TICK}
    sub r30, r22
    ldd r22, Y+{MOTOR_TICK}+1
    sbc r31, r22
    ldd r22, Y+{MOTOR_TICK}+2
    sbc r0, r22
    tst r0
    brne 4f
    cpi r31, {FILLER_HIGH}
    brsh 4f
    ldd r30, Y+{NEXT}
    ldd r31, Y+{NEXT}+1
    rcall 3f
    // Returns all steps to whoever called the plan: steps of known slices need no other check.
    pop r24
    pop r24
    ldd r24, Y+{LEFT}
    ldi r25, 1
    ret
2:  sbrs r23, {BACKWARD}
    rjmp 5f
    ldi r23, 1 << {BACKWARD} | 1 << {TURN}
    eor r22, r23
5:  ori r22, 1 << {ANCHORED}
    std Y+{FLAGS}, r22
3:  ld r23, Z
    st Z, r1
    std Y+{LEFT}, r23
    std Y+{LEFT}+1, r1
    std Y+{FRACTION}, r14
    std Y+{FRACTION}+1, r15
    std Y+{MOTOR_TICK}, r24
    std Y+{MOTOR_TICK}+1, r25
    std Y+{MOTOR_TICK}+2, r26
    std Y+{MOTOR_TICK}+3, r27
    std Y+{INTERVAL}, r18
    std Y+{INTERVAL}+1, r19
    std Y+{INTERVAL}+2, r20
    std Y+{INTERVAL}+3, r21
    std Y+{INTERVAL}+4, r1
    ldi r22, {TRAIN}
    eor r30, r22
    std Y+{NEXT}, r30
    std Y+{PRECHECKED}, r1
    // Counts all its steps into the position.
    ldd r18, Y+{POSITION}
    ldd r19, Y+{POSITION}+1
    ldd r20, Y+{POSITION}+2
    ldd r21, Y+{POSITION}+3
    ldd r22, Y+{FLAGS}
    sbrc r22, {BACKWARD}
    rjmp 6f
    add r18, r23
    adc r19, r1
    adc r20, r1
    adc r21, r1
    rjmp 7f
6:  sub r18, r23
    sbc r19, r1
    sbc r20, r1
    sbc r21, r1
7:  std Y+{POSITION}, r18
    std Y+{POSITION}+1, r19
    std Y+{POSITION}+2, r20
    std Y+{POSITION}+3, r21
    clc
    ret
4:  call steps_settle
    rjmp winch_load
8:  sec
    ret

    // r18 to r21: the next slice. N: it is before r26, r27, r30, r31. Uses r22 to r25.
winch_is_before:
    lds r18, winch_slice
    lds r19, winch_slice+1
    lds r20, winch_slice+2
    lds r21, winch_slice+3
    movw r22, r18
    movw r24, r20
    sub r22, r26
    sbc r23, r27
    sbc r24, r30
    sbc r25, r31
    ret

winch_next:
    lds r18, winch_slice
    lds r19, winch_slice+1
    lds r20, winch_slice+2
    lds r21, winch_slice+3
    subi r18, lo8(-({SLICE}))
    sbci r19, hi8(-({SLICE}))
    sbci r20, -1
    sbci r21, -1
    sts winch_slice, r18
    sts winch_slice+1, r19
    sts winch_slice+2, r20
    sts winch_slice+3, r21
    ret

    // Empties the trains of four motors, and sets the limit to r22 to r25.
winch_begin_trains:
    sts steps_times+{LIMIT}, r22
    sts steps_times+{LIMIT}+1, r23
    sts steps_times+{LIMIT}+2, r24
    sts steps_times+{LIMIT}+3, r25
    ldi r30, lo8(steps_motors)
    ldi r31, hi8(steps_motors)
    ldi r26, lo8(ring_b_page)
    ldi r27, hi8(ring_b_page)
    ldi r24, 4
1:  std Z+{START}, r26
    std Z+{START}+1, r27
    std Z+{NEXT}, r26
    std Z+{NEXT}+1, r27
    st X, r1
    subi r26, -{TRAIN}
    st X, r1
    subi r26, {TRAIN} - {LANE}
    subi r30, lo8(-({MOTOR_SIZE}))
    sbci r31, hi8(-({MOTOR_SIZE}))
    dec r24
    brne 1b
    ret

    // r24: 0 if no path is faster than 1 step/s, and no train waits.
winch_rests:
    ldi r30, lo8(winch_paths + {SPEED})
    ldi r31, hi8(winch_paths + {SPEED})
    clr r24
    ldi r25, 4
1:  ld r22, Z+
    ld r23, Z+
    subi r22, -1
    sbci r23, -1
    andi r22, 0xfe
    or r24, r22
    or r24, r23
    adiw r30, {PATH} - 2
    dec r25
    brne 1b
    ldi r26, lo8(ring_b_page)
    ldi r27, hi8(ring_b_page)
    ldi r25, 4
3:  ld r22, X
    or r24, r22
    subi r26, -{TRAIN}
    ld r22, X
    or r24, r22
    subi r26, {TRAIN} - {LANE}
    dec r25
    brne 3b
    ret
    "#,
    MAX_PERIOD = const MAX_PERIOD,
    FILLER_HIGH = const FILLER >> 8,
    FLAGS = const offset_of!(Motor, flags),
    UNREADABLE = const flag::UNREADABLE,
    STEPPED = const flag::STEPPED,
    BACKWARD = const flag::BACKWARD,
    TURN = const flag::TURN,
    ANCHORED = const flag::ANCHORED,
    FRACTION = const offset_of!(Motor, registers),
    MOTOR_TICK = const offset_of!(Motor, registers) + 2,
    INTERVAL = const offset_of!(Motor, registers) + 6,
    LEFT = const offset_of!(Motor, registers) + 19,
    PRECHECKED = const offset_of!(Motor, prechecked),
    POSITION = const offset_of!(Motor, position),
    LIMIT = const times::LIMIT,
    SOONER = const tuning::stepper::LOOK_AHEAD - LOOK_AHEAD,
    START = const offset_of!(Motor, start),
    NEXT = const offset_of!(Motor, next),
    LANE = const LANE,
    SPEED = const super::SPEED,
    MOTOR_SIZE = const size_of::<Motor>(),
    BEGIN = const BEGIN,
    TRAIN = const TRAIN,
    SLICE = const SLICE,
    CLEARANCE = const CLEARANCE,
    PATH = const super::PATHS / 4,
);

unsafe extern "C" {
    fn winch_pass(until: Tick32);
    fn winch_begin_trains(limit: Tick32);
    safe fn winch_rests() -> u8;
}

/// Skips slices that begin before `now`. To be called at least once in 2^31 ticks while nothing drives.
#[inline(always)]
pub(crate) fn pass(now: Tick32) {
    // SAFETY: the refill does not use slices while nothing drives.
    unsafe { winch_pass(now) }
}

/// Starts trains and slices. The refill is kept out, and the rings have just been started.
#[inline(always)]
pub(crate) fn begin(now: Tick32) {
    // SAFETY: the lists have only fillers yet, at their ends.
    unsafe { winch_begin_trains(now) };
    pass(now.after(FIRST_SLICE));
}

/// Whether no path moves, and no train waits. The refill must be kept out.
#[inline(always)]
pub(crate) fn rests() -> bool {
    winch_rests() == 0
}
