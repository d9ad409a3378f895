//! The task's side: every millisecond's steps, from the paths to the motors.
//!
//! A slice is a millisecond of the board's clock: slices begin at its multiples of [`SLICE`], those before the drivers were
//! on included. All four paths do one together. A motor whose path makes steps in it gets a train; there is room for two of
//! them, in what the merge's lists leave of their page. [`load`](crate::steps) takes them.
//!
//! Nothing is planned beyond what is known: the limit is [`CLEAR`] before the next slice begins, so that DIR can be turned for
//! a step at its very beginning.

use crate::steps::motor::Motor;
use crate::steps::times::TIMES;
use core::arch::global_asm;
use core::mem::offset_of;
use pulsetrain_core::Moment;
use pulsetrain_core::winch::spacing::TICKS;
use pulsetrain_core::wire::message::MOTOR_SETUP_LEN;

/// Ticks of a slice.
pub(crate) const SLICE: u16 = TICKS;

/// From one train to the other, bytes: what tick.s writes, and the slice's beginning, 4 bytes at [`BEGIN`].
pub(crate) const TRAIN: u8 = 16;
const BEGIN: u8 = 10;

/// Where a motor's trains are: in the merge's lists, which end each quarter of the page. A slice makes 11 steps at most.
const LANE: u8 = 64;
const _: () = assert!(2 * TRAIN + 2 * 11 <= LANE);

/// Slices are worked out that begin this soon, ticks.
const AHEAD: u32 = 36_864;
/// Before the next slice nothing is done for so long, ticks: as long as DIR is turned before a step, at most.
const CLEAR: u16 = 768;
/// From the start of the rings to the first slice, ticks: the merge's first fillers are before.
const FIRST: u32 = 44_000;

/// Bytes of the shield's configuration.
const SHIELD: usize = 13 + 4 * MOTOR_SETUP_LEN;
const _: () = assert!(super::TEXT + SHIELD <= super::READER);

global_asm!(
    r#"
    .section .bss.winch_feed, "aw", @nobits
    .global winch_drives
winch_drives: .skip 1                   // bit 0: motors take their steps from paths
winch_begin: .skip 4                    // the next slice

    .section .text.winch, "ax", @progbits
    .global winch_advance, winch_pass, winch_begin_trains, winch_rests, winch_has_passed, winch_copy_shield
    // Works out the next slice, if it begins before r22 to r25 and there is room, and gives the limit.
winch_advance:
    rcall winch_enter
    movw r12, r22
    movw r14, r24
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
    lds r24, winch_begin
    std Z+{BEGIN}, r24
    lds r24, winch_begin+1
    std Z+{BEGIN}+1, r24
    lds r24, winch_begin+2
    std Z+{BEGIN}+2, r24
    lds r24, winch_begin+3
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
    rjmp winch_leave

    // The next slice, r18 to r21; N: it is before r12 to r15. Uses r22 to r25.
winch_is_before:
    lds r18, winch_begin
    lds r19, winch_begin+1
    lds r20, winch_begin+2
    lds r21, winch_begin+3
    movw r22, r18
    movw r24, r20
    sub r22, r12
    sbc r23, r13
    sbc r24, r14
    sbc r25, r15
    ret

winch_next:
    lds r18, winch_begin
    lds r19, winch_begin+1
    lds r20, winch_begin+2
    lds r21, winch_begin+3
    subi r18, lo8(-({SLICE}))
    sbci r19, hi8(-({SLICE}))
    sbci r20, -1
    sbci r21, -1
    sts winch_begin, r18
    sts winch_begin+1, r19
    sts winch_begin+2, r20
    sts winch_begin+3, r21
    ret

    // The trains of four motors begin: in the lists' page, one lane after the other.
winch_begin_trains:
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

    // Whether at r22 to r25 it is r16:17 milliseconds since r18 to r21.
winch_has_passed:
    sub r22, r18
    sbc r23, r19
    sbc r24, r20
    sbc r25, r21
    ldi r26, lo8({SLICE})
    ldi r27, hi8({SLICE})
    mul r16, r26
    movw r18, r0
    mul r17, r27
    movw r20, r0
    mul r16, r27
    add r19, r0
    adc r20, r1
    clr r30
    adc r21, r30
    mul r17, r26
    add r19, r0
    adc r20, r1
    adc r21, r30
    clr r1
    sub r22, r18
    sbc r23, r19
    sbc r24, r20
    sbc r25, r21
    ldi r24, 1
    sbc r24, r1
    ret

    // The shield's configuration, as a Configure frame has it, to where the reader has a line.
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
    // STEP is high for 1.94 us, for any driver on such a shield; DIR is right for 1 us before and after.
    .byte 31, 0, 16, 0, 16, 0
    // Enable on 8, active low; released by `enable 0` alone.
    .byte 8, 0, 0, 0, 0, 0, 4
    .byte 2, 5, 1, 0, 0, 0, 0, 0
    .byte 3, 6, 1, 0, 0, 0, 0, 0
    .byte 4, 7, 1, 0, 0, 0, 0, 0
    .byte 12, 13, 1, 0, 0, 0, 0, 0
    .balign 2

    // The next slice is none that begins before r22 to r25.
winch_pass:
    .irp r, 12,13,14,15
    push r\r
    .endr
    movw r12, r22
    movw r14, r24
1:  rcall winch_is_before
    brpl 2f
    rcall winch_next
    rjmp 1b
2:  .irp r, 15,14,13,12
    pop r\r
    .endr
    ret
    "#,
    START = const offset_of!(Motor, start),
    NEXT = const offset_of!(Motor, next),
    LANE = const LANE,
    SHIELD = const SHIELD,
    TEXT = const super::TEXT,
    SPEED = const super::SPEED,
    MOTOR_SIZE = const size_of::<Motor>(),
    BEGIN = const BEGIN,
    TRAIN = const TRAIN,
    SLICE = const SLICE,
    CLEAR = const CLEAR,
    PATH = const super::PATHS / 4,
);

unsafe extern "C" {
    #[link_name = "winch_drives"]
    static mut DRIVES: bool;
    fn winch_advance(until: Moment) -> Moment;
    fn winch_pass(until: Moment);
    fn winch_begin_trains();
    fn winch_copy_shield() -> *const [u8; SHIELD];
    safe fn winch_rests() -> u8;
    pub(super) safe fn winch_has_passed(now: Moment, then: Moment, ms: u16) -> bool;
}

/// Whether motors take their steps from paths.
#[inline(always)]
pub(crate) fn drives() -> bool {
    // SAFETY: a byte that main alone writes.
    unsafe { (&raw const DRIVES).read_volatile() }
}

/// Works out one slice, if it is due: the rings wait meanwhile. Gives the limit of what may be planned. The task's alone.
#[inline(always)]
pub(crate) fn advance(now: Moment) -> Moment {
    // SAFETY: it uses paths, trains and the motors' places for them, which main leaves alone while the task is not kept out.
    unsafe { winch_advance(now.after(AHEAD)) }
}

/// No slice begins before `now`. To be called at least once in 2^31 ticks while nothing drives.
#[inline(always)]
pub(crate) fn pass(now: Moment) {
    // SAFETY: the task leaves the slices alone while nothing drives.
    unsafe { winch_pass(now) }
}

/// From now on motors take their steps from paths. The task is kept out, and rings have been started now.
#[inline(always)]
pub(crate) fn begin(now: Moment) {
    // SAFETY: the task is kept out, and there is nothing in the lists yet but fillers, at their ends.
    unsafe { winch_begin_trains() };
    TIMES.set_limit(now);
    pass(now.after(FIRST));
    set_drives(true);
}

/// Motors take their steps from queues again.
#[inline(always)]
pub(crate) fn end() {
    set_drives(false);
}

fn set_drives(on: bool) {
    // SAFETY: one byte; the task reads it whole.
    unsafe { (&raw mut DRIVES).write_volatile(on) };
}

/// The payload of the frame that would configure the board as the winch needs it: four motors on the CNC shield. It is where
/// the line was that has been read.
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
