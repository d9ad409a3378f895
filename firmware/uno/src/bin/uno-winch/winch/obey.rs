//! What lines do, on main's side: commands to paths, the clock and positions of a status, the configuration of the shield.

use super::feed::SLICE;
use super::{Asked, reader};
use crate::engine::steps::register;
use core::arch::global_asm;
use core::mem::offset_of;
use pulsetrain_core::Tick32;
use pulsetrain_core::winch::text::Verb;
use pulsetrain_core::wire::message::MOTOR_SETUP_LEN;

/// What a command needs: pins, and powered drivers.
pub(super) const AXES: u8 = 0x40;
pub(super) const DRIVE: u8 = 0x80;

// The assembly compares with these numbers.
const _: () = assert!(Verb::Enable as u8 + 1 == Verb::Report as u8 && Verb::Report as u8 + 1 == Verb::Deadman as u8);
const _: () = assert!(Verb::Strict as u8 + 1 == Verb::Version as u8 && Verb::Version as u8 + 1 == Verb::Ping as u8);

/// Bytes of the shield's motors in a configuration.
const SHIELD: usize = 4 * MOTOR_SETUP_LEN;
const _: () = assert!(super::TEXT + SHIELD <= super::READER);

global_asm!(
    r#"
    .section .text.winch
    .global winch_pass, winch_has_passed, winch_copy_shield, winch_clock_and_positions, winch_do, winch_obey_axes, winch_begin
    // Does what a line says, the verb r24, as far as it can here. r24: what to reply, or which of {AXES} and {DRIVE} must be done.
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
    // A command to axes
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

    // Does what the verb r22 says, for each of the axes r24.
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
    // Gains and limits are worked out once: the other axes copy them from this one, from r16 of Y on.
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

    // Writes five values from r24:25 on: the clock, in us, and the steps that four motors have made by then.
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

    // Whether at r22 to r25 r18:19 milliseconds have passed since the tick at r20:21. If so, that tick moves on by as much, so that no error adds up; or to
    // now, if twice as much has passed.
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

    // Copies the shield's motors, as a configuration has them, to where the reader has a line.
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

    // Skips slices that begin before r22 to r25.
winch_pass:
    movw r26, r22
    movw r30, r24
1:  rcall winch_is_before
    brpl 2f
    rcall winch_next
    rjmp 1b
2:  ret

    // Text becomes on: initialises paths, reader, and what was asked.
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
    IMPULSE = const Verb::Impulse as u8,
    GAINS = const Verb::Gains as u8,
    ENABLE = const Verb::Enable as u8,
    DEADMAN = const Verb::Deadman as u8,
    VERSION = const Verb::Version as u8,
    AWAKE = const super::AWAKE,
    ID = const super::ID,
    AXES = const AXES,
    DRIVE = const DRIVE,
    TIMSK0 = const register::TIMSK0,
    TAIL = const register::OCR0A,
    SHIELD = const SHIELD,
    TEXT = const super::TEXT,
    OF_GAINS = const super::OF_GAINS,
    OF_LIMITS = const super::OF_LIMITS,
    SLICE = const SLICE,
    PATH = const super::PATHS / 4,
);

unsafe extern "C" {
    fn winch_copy_shield() -> *const [u8; SHIELD];
    pub(super) fn winch_begin();
    pub(super) safe fn winch_do(verb: u8) -> u8;
    pub(super) safe fn winch_obey_axes(axes: u8, verb: u8);
    pub(super) fn winch_clock_and_positions(to: *mut i32);
    pub(super) safe fn winch_has_passed(now: Tick32, then: &mut Tick32, ms: u16) -> bool;
}

/// Four motors on the CNC shield, as a configuration has them. They are in the reader's line.
#[inline(always)]
pub(crate) fn shield() -> &'static [u8; SHIELD] {
    // SAFETY: main alone uses the reader, and not before the next byte.
    unsafe { &*winch_copy_shield() }
}
