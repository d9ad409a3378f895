//! The task's side: every millisecond's steps, from the paths to the motors.
//!
//! A slice is a millisecond of the board's clock: slices begin at its multiples of [`SLICE`], those before the drivers were
//! on included. All four paths do one together. A motor whose path makes steps in it gets a train; there is room for two of
//! them, in what the merge's lists leave of their page. `winch_load` takes them.
//!
//! Nothing is planned beyond what is known: the limit is [`CLEAR`] before the next slice begins, so that DIR can be turned for
//! a step at its very beginning.
//!
//! Main keeps the task out for 1340 cycles at most to obey a line, and for 3480 to take four positions at one time (measured with
//! steps in between, four axes at 10 000 steps/s). Slices are worked out early enough for that: at least 8000 ticks were left,
//! crates/board/tests/it/chips/winch_line.rs.

use super::{Asked, reader};
use crate::engine::steps::motor::{Motor, flag};
use crate::engine::steps::plan::FILLER;
use crate::engine::steps::{register, times};
use crate::engine::tuning;
use crate::engine::tuning::winch::{AHEAD, CLEAR, FIRST, SLICES};
use core::arch::global_asm;
use core::mem::offset_of;
use pulsetrain_core::Tick32;
use pulsetrain_core::winch::spacing::TICKS;
use pulsetrain_core::winch::text::LineCommand;
use pulsetrain_core::wire::message::MOTOR_SETUP_LEN;

/// Ticks of a slice.
pub(crate) const SLICE: u16 = TICKS;

/// From one train to the other, bytes: what tick.s writes, and the slice's beginning, 4 bytes at [`BEGIN`].
pub(crate) const TRAIN: u8 = 16;
const BEGIN: u8 = 10;

/// Where a motor's trains are: in the merge's lists, which end each quarter of the page. A slice makes 11 steps at most.
const LANE: u8 = 64;
const _: () = assert!(2 * TRAIN + 2 * 11 <= LANE);

const _: () = assert!(SLICE == SLICE >> 7 << 7 && SLICE >> 7 < 256);

/// What a command needs: pins, and drivers that are on.
pub(super) const AXES: u8 = 0x40;
pub(super) const DRIVE: u8 = 0x80;

// Numbers that the assembly compares with.
const _: () = assert!(
    LineCommand::Enable as u8 + 1 == LineCommand::Report as u8
        && LineCommand::Report as u8 + 1 == LineCommand::Deadman as u8
);
const _: () = assert!(
    LineCommand::Strict as u8 + 1 == LineCommand::Version as u8
        && LineCommand::Version as u8 + 1 == LineCommand::Ping as u8
);

/// Bytes of the shield's motors.
const SHIELD: usize = 4 * MOTOR_SETUP_LEN;
const _: () = assert!(super::TEXT + SHIELD <= super::READER);

global_asm!(
    r#"
    .section .bss.winch_feed, "aw", @nobits
winch_slice: .skip 4                    // the next slice

    .section .text.winch, "ax", @progbits
    .global winch_limit, winch_load, winch_due, winch_pass, winch_begin_trains, winch_rests, winch_has_passed, winch_copy_shield, winch_clock_and_positions, winch_do, winch_obey_axes, winch_begin
    // For the task, which has all registers free: works out the next slice, if it begins [`AHEAD`] from now and there is room, and gives
    // the limit. That takes long, so that the ring is filled first.
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
6:  subi r18, lo8({CLEAR})
    sbci r19, hi8({CLEAR})
    sbci r20, 0
    sbci r21, 0
    movw r22, r18
    movw r24, r20
    ret

    // A call of the task works out one slice, and takes most of one.
winch_due:
    cpi r26, {SLICES}
    brlo 1f
    ldi r26, {SLICES}
1:  sec
    ret

    // The next train of the winch , if there is one: its accumulator is an interval before its first step.
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
    // What follows from the step before must be known if it turns round, or if there is room for a filler before it.
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
    // All of it is granted at once, to whoever asked what the motor does next: steps of known slices need no other look.
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
    std Y+{SURE}, r1
    // All its steps are counted.
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

    // The next slice, r18 to r21; N: it is before r26, r27, r30, r31. Uses r22 to r25.
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

    // The trains of four motors begin, in the lists' page, one lane after the other; the limit is r22 to r25.
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

    // Does what a line says, the verb r24, but for what it asks of others: r24 is what to say, or which of {AXES} and {DRIVE}.
winch_do:
    ldi r30, lo8(winch_reader)
    ldi r31, hi8(winch_reader)
    sts winch_asked+{DEAD}, r1
    mov r22, r24
    ldd r18, Z+{VALUES}
    ldd r19, Z+{VALUES}+1
    cpi r22, {ENABLE}
    brlo 3f
    breq 2f
    cpi r22, {DEADMAN}
    brlo 6f
    breq 7f
    ldi r24, {AWAKE}
    cpi r22, {VERSION}
    brlo 8f
    brne 1f
    ldi r24, {ID}
1:  ret
2:  ldd r20, Z+{VALUES}+2
    ldd r21, Z+{VALUES}+3
    or r18, r19
    or r18, r20
    or r18, r21
    ldi r24, 0b1111
    ldi r23, {AXES}
    ldi r25, 1
    breq 5f
    ldi r24, 0
    rjmp 4f
    // An axis' command
3:  ldd r24, Z+{GIVEN}
    ldi r23, {AXES}
    cpi r22, {GAINS}
    brsh 9f
    cpi r22, {IMPULSE}
    ldi r25, 0
    brsh 5f
4:  ldi r23, {AXES} | {DRIVE}
    ldi r25, 0
5:  sts winch_asked+{RELEASING}, r25
    rjmp 10f
9:  ldd r24, Z+{NAMED}
10: push r23
    rcall winch_obey_axes
    pop r24
    ret
6:  sts winch_asked+{REPORT_MS}, r18
    sts winch_asked+{REPORT_MS}+1, r19
    rjmp 11f
7:  sts winch_asked+{DEADMAN_MS}, r18
    sts winch_asked+{DEADMAN_MS}+1, r19
    rjmp 11f
8:  ldi r24, {OVER}
    cpse r18, r1
    ori r24, {STRICT}
    ldd r18, Z+{STAR}
    cpse r18, r1
    ori r24, {CHECKED}
    st Z, r24
11: ldi r24, 0
    ret

    // What the verb r22 says, to each of the axes r24.
winch_obey_axes:
    rcall winch_enter
    mov r16, r22
    mov r17, r24
    ldi r24, lo8(winch_paths)
    ldi r25, hi8(winch_paths)
    movw r14, r24
    ldi r28, lo8(winch_reader + {VALUES})
    ldi r29, hi8(winch_reader + {VALUES})
    lds r24, {TIMSK0}
    push r24
    sts {TIMSK0}, r1
1:  lsr r17
    brcc 2f
    cpi r16, {OF_GAINS}
    brsh 4f
    .irp r, 14,15,16,17,28,29
    push r\r
    .endr
    movw r24, r14
    movw r22, r28
    mov r20, r16
    rcall winch_obey_inside
    clr r1
    .irp r, 29,28,17,16,15,14
    pop r\r
    .endr
    mov r24, r16
    subi r24, {GAINS}
    cpi r24, 2
    brsh 2f
    // Gains and limits are worked out once: the others get those of this one, from r16 of Y on.
    movw r28, r14
    ldi r16, {OF_GAINS}
    sbrc r24, 0
    ldi r16, {OF_LIMITS}
    rjmp 2f
4:  movw r30, r28
    add r30, r16
    adc r31, r1
    movw r26, r14
    add r26, r16
    adc r27, r1
    ldi r24, {OF_LIMITS} - {OF_GAINS}
5:  ld r25, Z+
    st X+, r25
    dec r24
    brne 5b
2:  movw r24, r14
    adiw r24, {PATH}
    movw r14, r24
    cpi r16, {GAINS}
    brsh 3f
    adiw r28, 4
3:  tst r17
    brne 1b
    pop r24
    sts {TIMSK0}, r24
    rjmp winch_leave

    // The clock, in us, and the steps that four motors have made by then, to five places from r24:25 on.
winch_clock_and_positions:
    .irp r, 16,17,28,29
    push r\r
    .endr
    movw r28, r24
    lds r24, {TIMSK0}
    push r24
    sts {TIMSK0}, r1
    call clock_moment
    lds r18, clock
    lds r19, clock+1
    lds r20, clock+2
    lds r21, clock+3
    lds r22, clock+4
    ldi r24, 4                          // of 2^-4 us
1:  lsl r18
    rol r19
    rol r20
    rol r21
    rol r22
    dec r24
    brne 1b
    in r17, {TAIL}
    st Y+, r19
    st Y+, r20
    st Y+, r21
    st Y+, r22
    clr r16
2:  mov r24, r16
    mov r22, r17
    call steps_position
    st Y+, r22
    st Y+, r23
    st Y+, r24
    st Y+, r25
    inc r16
    cpi r16, 4
    brne 2b
    pop r24
    sts {TIMSK0}, r24
    .irp r, 29,28,17,16
    pop r\r
    .endr
    ret

    // Whether at r22 to r25 it is r18:19 milliseconds since the moment at r20:21. That becomes so much later then, so that
    // nothing adds up; or now, if it was twice as long.
winch_has_passed:
    movw r30, r20
    movw r26, r18
    ld r0, Z
    sub r22, r0
    ldd r0, Z+1
    sbc r23, r0
    ldd r0, Z+2
    sbc r24, r0
    ldd r0, Z+3
    sbc r25, r0
    ldi r21, {SLICE} >> 7               // r18 to r21: the milliseconds in ticks
    clr r20
    mul r26, r21
    movw r18, r0
    mul r27, r21
    add r19, r0
    adc r20, r1
    clr r1
    mov r21, r20
    mov r20, r19
    mov r19, r18
    clr r18
    lsr r21
    ror r20
    ror r19
    ror r18
    sub r22, r18
    sbc r23, r19
    sbc r24, r20
    sbc r25, r21
    brcs 2f
    cp r22, r18
    cpc r23, r19
    cpc r24, r20
    cpc r25, r21
    brcs 1f
    add r18, r22
    adc r19, r23
    adc r20, r24
    adc r21, r25
1:  ld r24, Z
    add r18, r24
    st Z+, r18
    ld r24, Z
    adc r19, r24
    st Z+, r19
    ld r24, Z
    adc r20, r24
    st Z+, r20
    ld r24, Z
    adc r21, r24
    st Z+, r21
    ldi r24, 1
    ret
2:  ldi r24, 0
    ret

    // The shield's motors, as a configuration has them, to where the reader has a line.
winch_copy_shield:
    ldi r26, lo8(winch_reader + {TEXT})
    ldi r27, hi8(winch_reader + {TEXT})
    movw r22, r26
    ldi r30, lo8(winch_shield)
    ldi r31, hi8(winch_shield)
    ldi r24, {SHIELD}
1:  lpm r25, Z+
    st X+, r25
    dec r24
    brne 1b
    movw r24, r22
    ret
winch_shield:
    .byte 2, 5, 1, 0, 0, 0, 0, 0
    .byte 3, 6, 1, 0, 0, 0, 0, 0
    .byte 4, 7, 1, 0, 0, 0, 0, 0
    .byte 12, 13, 1, 0, 0, 0, 0, 0
    .balign 2

    // The next slice is none that begins before r22 to r25.
winch_pass:
    movw r26, r22
    movw r30, r24
1:  rcall winch_is_before
    brpl 2f
    rcall winch_next
    rjmp 1b
2:  ret

    // Text begins: paths, reader, and what was asked.
winch_begin:
    ldi r24, lo8(winch_paths)
    ldi r25, hi8(winch_paths)
    rcall winch_start
    ldi r24, {OVER}
    sts winch_reader, r24
    ldi r30, lo8(winch_asked)
    ldi r31, hi8(winch_asked)
    ldi r24, {ASKED}
1:  st Z+, r1
    dec r24
    brne 1b
    ldi r24, {AT_FIRST_MS}
    sts winch_asked+{REPORT_MS}, r24
    ret
    "#,
    SLICES = const SLICES,
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
    SURE = const offset_of!(Motor, sure),
    POSITION = const offset_of!(Motor, position),
    LIMIT = const times::LIMIT,
    SOONER = const tuning::stepper::AHEAD - AHEAD,
    START = const offset_of!(Motor, start),
    NEXT = const offset_of!(Motor, next),
    ASKED = const size_of::<Asked>(),
    AT_FIRST_MS = const super::REPORT_MS,
    DEAD = const offset_of!(Asked, dead),
    RELEASING = const offset_of!(Asked, releasing),
    REPORT_MS = const offset_of!(Asked, report_ms),
    DEADMAN_MS = const offset_of!(Asked, deadman_ms),
    VALUES = const reader::VALUES,
    GIVEN = const reader::GIVEN,
    NAMED = const reader::AXES,
    OVER = const reader::OVER,
    STRICT = const reader::STRICT,
    CHECKED = const reader::CHECKED,
    STAR = const reader::STAR,
    IMPULSE = const LineCommand::Impulse as u8,
    GAINS = const LineCommand::Gains as u8,
    ENABLE = const LineCommand::Enable as u8,
    DEADMAN = const LineCommand::Deadman as u8,
    VERSION = const LineCommand::Version as u8,
    AWAKE = const super::AWAKE,
    ID = const super::ID,
    AXES = const AXES,
    DRIVE = const DRIVE,
    TIMSK0 = const register::TIMSK0,
    TAIL = const register::OCR0A,
    LANE = const LANE,
    SHIELD = const SHIELD,
    TEXT = const super::TEXT,
    SPEED = const super::SPEED,
    OF_GAINS = const super::OF_GAINS,
    OF_LIMITS = const super::OF_LIMITS,
    MOTOR_SIZE = const size_of::<Motor>(),
    BEGIN = const BEGIN,
    TRAIN = const TRAIN,
    SLICE = const SLICE,
    CLEAR = const CLEAR,
    PATH = const super::PATHS / 4,
);

unsafe extern "C" {
    fn winch_pass(until: Tick32);
    fn winch_begin_trains(limit: Tick32);
    fn winch_copy_shield() -> *const [u8; SHIELD];
    pub(super) fn winch_begin();
    pub(super) safe fn winch_do(verb: u8) -> u8;
    pub(super) safe fn winch_obey_axes(axes: u8, verb: u8);
    pub(super) fn winch_clock_and_positions(to: *mut i32);
    safe fn winch_rests() -> u8;
    pub(super) safe fn winch_has_passed(now: Tick32, then: &mut Tick32, ms: u16) -> bool;
}

/// No slice begins before `now`. To be called at least once in 2^31 ticks while nothing drives.
#[inline(always)]
pub(crate) fn pass(now: Tick32) {
    // SAFETY: the task leaves the slices alone while nothing drives.
    unsafe { winch_pass(now) }
}

/// Trains and slices begin. The task is kept out, and rings have been started now.
#[inline(always)]
pub(crate) fn begin(now: Tick32) {
    // SAFETY: there is nothing in the lists yet but fillers, at their ends.
    unsafe { winch_begin_trains(now) };
    pass(now.after(FIRST));
}

/// Four motors on the CNC shield, as a configuration has them. They are where the line was that has been read.
#[inline(always)]
pub(crate) fn shield() -> &'static [u8; SHIELD] {
    // SAFETY: main alone uses the reader, and nobody before the next byte.
    unsafe { &*winch_copy_shield() }
}

/// Whether no path moves, and no train waits. The task is to be kept out.
#[inline(always)]
pub(crate) fn rests() -> bool {
    winch_rests() == 0
}
