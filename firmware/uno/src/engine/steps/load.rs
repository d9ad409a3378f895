//! Records of the queue → registers of a segment. `pulsetrain_core::packing` has the format.
//!
//! # Registers of the processor
//! | | |
//! |---|---|
//! | Y | the [`Motor`](super::motor::Motor) |
//! | X, Z | the next byte of its queue, and where the queue's memory ends |
//! | r25 | the header, shifted to the right as its bits are used |
//! | r14 | bit length of the previous count |
//! | r15 | width of a field that is not a wide one, bytes |
//! | r18 to r22 | a number of 40 bits |
//! | r23, r24 | counters |
//!
//! # Cycles
//! A segment of three corrections of one byte each takes some 460, of which 95 check its intervals; a second byte of a correction takes 12 more.
//!
//! A record is always whole in its frame, so nobody checks that a byte is there before it is read. If more were read than there are, the record is bad, and
//! the rest of the epoch is dropped. What was read then came from the queue's own memory, so that no harm is done.

use crate::ThisProgram;
use crate::engine::program::Program;
use crate::engine::steps::motor::{EpochBytes, FaultKind, HIGH_FIXED, Motor, flag};
use crate::engine::steps::refill::mode;
use crate::engine::steps::times;
use core::arch::global_asm;
use core::mem::offset_of;
use pulsetrain_core::packing::COUNT_AFTER_EXACT;

const _: () = assert!(COUNT_AFTER_EXACT == 255);

global_asm!(
    r#"
    .section .text.steps_load_record, "ax", @progbits

    // \register: the next byte.                                                                       5
    .macro next_byte register
    ld \register, X+
    cp r26, r30
    brne .+2
    rcall load_wrap
    .endm

    // X may be at the end of the queue's memory: then it goes on at the start.
load_wrap:
    cpse r27, r31
    ret
    ldd r26, Y+{START}
    ldd r27, Y+{START}+1
    ret

    // r24: the next byte.                                                                          12 with its call
load_byte:
    next_byte r24
    ret

    // r18 to r22: a number of r23 bytes (0 to 5), sign-extended.
load_number:
    clr r18
    clr r24
    tst r23
    breq 1f
    rcall load_byte
    mov r18, r24
    dec r23
    breq 1f
    rcall load_byte
    mov r19, r24
    dec r23
    breq 2f
    rcall load_byte
    mov r20, r24
    dec r23
    breq 3f
    rcall load_byte
    mov r21, r24
    dec r23
    breq 4f
    rcall load_byte
    mov r22, r24
    ret
1:  lsl r24
    sbc r24, r24
    mov r19, r24
2:  lsl r24
    sbc r24, r24
    mov r20, r24
3:  lsl r24
    sbc r24, r24
    mov r21, r24
4:  lsl r24
    sbc r24, r24
    mov r22, r24
    ret

    // r18 to r22: a correction of r23 bytes in units of 2^(16 - r24) ticks. The exponent is clamped to 0 to 16.
    //                                                              one byte 45, two 57; 4 to 8 more where 16 - r24 > 7
load_correction:
    ldi r19, 16
    tst r24
    brmi 1f                             // as coarse as can be
    sub r19, r24
    brcc 1f
    clr r19                             // as fine as can be
    // r21 = 2^(r19 mod 8): multiplying by it shifts
1:  ldi r21, 1
    sbrc r19, 0
    lsl r21
    sbrs r19, 1
    rjmp 2f
    lsl r21
    lsl r21
2:  sbrc r19, 2
    swap r21
    cpi r23, 2
    brlo 3f
    brne load_wide
    next_byte r24
    next_byte r20
    mov r23, r19
    mul r24, r21
    movw r18, r0
    mulsu r20, r21
    ldi r22, 0
    add r19, r0
    mov r20, r1
    adc r20, r22
    rjmp 4f
3:  next_byte r18
    mov r23, r19
    mulsu r18, r21
    movw r18, r0
    mov r20, r1
    lsl r20
    sbc r20, r20
4:  clr r1
    mov r21, r20
    lsl r21
    sbc r21, r21
    mov r22, r21
    andi r23, 0xf8
    brne load_shift_byte
    ret
    // The same for more bytes, which shifts one bit at a time.
load_wide:
    push r19
    rcall load_number
    pop r23
load_shift:
    cpi r23, 8
    brlo 6f
load_shift_byte:
    mov r22, r21
    mov r21, r20
    mov r20, r19
    mov r19, r18
    clr r18
    subi r23, 8
    rjmp load_shift
6:  tst r23
    breq 8f
7:  lsl r18
    rol r19
    rol r20
    rol r21
    rol r22
    dec r23
    brne 7b
8:  ret

    // Adds r18 to r21 to the four bytes at Y+\offset.
    .macro load_add offset
    ldd r24, Y+\offset
    add r24, r18
    std Y+\offset, r24
    ldd r24, Y+\offset+1
    adc r24, r19
    std Y+\offset+1, r24
    ldd r24, Y+\offset+2
    adc r24, r20
    std Y+\offset+2, r24
    ldd r24, Y+\offset+3
    adc r24, r21
    std Y+\offset+3, r24
    .endm

    // The next bit of r25 says whether the next field is wide. r23: its width, bytes. Z flag: that is 0.   8
    .macro field_width
    mov r23, r15
    lsr r25
    brcc 99f
    inc r23
    cpi r23, 4
    brne 99f
    inc r23
99: tst r23
    .endm

    .global steps_load_record
    // Takes the next record. Carry: there is none, or it cannot be read. The motor must have no steps left. Keeps r2 to r13, r16, r17.
steps_load_record:
    ldd r24, Y+{FLAGS}
    sbrc r24, {UNREADABLE}
    rjmp load_none
    ldd r24, Y+{READY}
    ldd r25, Y+{READY}+1
    or r24, r25
    brne 1f
load_none:
    sec
    ret
1:  ldd r26, Y+{NEXT}
    ldd r27, Y+{NEXT}+1
    ldd r30, Y+{END}
    ldd r31, Y+{END}+1
    next_byte r25
    ldd r18, Y+{COUNT}
    ldd r19, Y+{COUNT}+1

    // The bit length of the previous count.
    mov r24, r18
    ldi r20, 0
    tst r19
    breq 2f
    ldi r20, 8
    mov r24, r19
2:  cpi r24, 16
    brlo 3f
    subi r20, -4
    swap r24
    andi r24, 15
3:  inc r20
    lsr r24
    brne 3b
    mov r14, r20

    // The count.
    mov r24, r25
    andi r24, 7
    cpi r24, 7
    breq load_explicit
    movw r20, r18
    cpi r24, 3
    breq load_have_count
    brsh 5f
    // 0 to 2: the previous one and a half, a quarter, an eighth of it.
4:  lsr r21
    ror r20
    dec r24
    brpl 4b
    add r18, r20
    adc r19, r21
    brcc load_have_count
    rjmp load_bad
    // 4 to 6: the previous one less an eighth, a quarter, a half of it.
5:  subi r24, 7
6:  lsr r21
    ror r20
    inc r24
    brne 6b
    sub r18, r20
    sbc r19, r21
    rjmp load_have_count
load_explicit:
    next_byte r24
    tst r24
    brne 7f
    rjmp load_control
7:  mov r18, r24
    clr r19
    cpi r24, 255
    brne load_have_count
    rcall load_byte
    mov r18, r24
    rcall load_byte
    mov r19, r24
load_have_count:
    mov r24, r18
    or r24, r19
    brne 8f
    rjmp load_bad
8:  std Y+{LEFT}, r18
    std Y+{LEFT}+1, r19
    std Y+{COUNT}, r18
    std Y+{COUNT}+1, r19
    // T: three steps or more, the usual case.
    cpi r18, 3
    cpc r19, r1
    set
    brsh .+2
    clt

    lsr r25
    lsr r25
    lsr r25
    mov r24, r25
    andi r24, 3
    mov r15, r24
    lsr r25
    lsr r25

    field_width
    breq 1f
    ldd r24, Y+{GAIN}
    add r24, r14
    subi r24, -2
    rcall load_correction
    load_add {INTERVAL}
    ldd r24, Y+{INTERVAL}+4
    adc r24, r22
    std Y+{INTERVAL}+4, r24
1:  brts 2f
    ldd r24, Y+{LEFT}
    cpi r24, 2
    brlo load_segment                   // one step
2:  field_width
    breq 3f
    ldd r24, Y+{GAIN}
    add r24, r14
    add r24, r14
    subi r24, 2
    rcall load_correction
    load_add {ADD}
3:  brtc load_segment                   // two steps
4:  field_width
    breq load_segment
    ldd r24, Y+{GAIN}
    add r24, r14
    add r24, r14
    add r24, r14
    subi r24, 5
    rcall load_correction
    load_add {ADD2}
load_segment:
    rcall load_consume
    brcc .+2
    ret
    .global load_count_steps
load_count_steps:
    ldd r24, Y+{FLAGS}
    sbrs r24, {ANCHORED}
    rjmp 4f
    // Counts all its steps into the position.
    ldd r18, Y+{POSITION}
    ldd r19, Y+{POSITION}+1
    ldd r20, Y+{POSITION}+2
    ldd r21, Y+{POSITION}+3
    ldd r22, Y+{LEFT}
    ldd r23, Y+{LEFT}+1
    sbrc r24, {BACKWARD}
    rjmp 2f
    add r18, r22
    adc r19, r23
    adc r20, r1
    adc r21, r1
    rjmp 3f
2:  sub r18, r22
    sbc r19, r23
    sbc r20, r1
    sbc r21, r1
3:  std Y+{POSITION}, r18
    std Y+{POSITION}+1, r19
    std Y+{POSITION}+2, r20
    std Y+{POSITION}+3, r21

    // Prechecks the segment: are all its intervals fit for batches? They differ from the first by n |add| + n² |add2| / 2 at most, n = r22 steps.
    // r19:20 is |add| in 2^-8 ticks, r15 |add2|.                                                           about 95
    std Y+{PRECHECKED}, r1
    tst r23
    breq load_precheck
    rjmp 8f
load_precheck:
    ldd r24, Y+{ADD2}+3
    ldd r25, Y+{ADD2}+2
    ldd r15, Y+{ADD2}+1
    sbrs r24, 7
    rjmp 5f
    com r24
    com r25
    com r15
5:  or r25, r24
    ldd r24, Y+{ADD}+3
    ldd r20, Y+{ADD}+2
    ldd r19, Y+{ADD}+1
    sbrs r24, 7
    rjmp 6f
    com r24
    com r20
    com r19
6:  or r25, r24
    breq .+2
    rjmp 7f                             // too much
    // T: there are lists, and |add| is more than n |add2|, so that the sign of add stays.
    clt
    lds r24, steps_mode
    sbrc r24, {OWN_RING_BIT}
    rjmp 9f
    ldd r24, Y+{ADD2}
    ldd r30, Y+{ADD2}+3
    sbrc r30, 7
    com r24
    mul r22, r24
    mov r24, r1
    mul r22, r15
    movw r30, r0
    add r30, r24
    adc r31, r25
    adiw r30, 2
    cp r19, r30
    cpc r20, r31
    brlo 9f
    set
9:  inc r15
    brne .+2
    rjmp 7f
    // r19:20, in 2^-8 ticks: |add| + n |add2| / 2, and 2 for what was rounded off.
    mul r22, r15
    lsr r1
    ror r0
    ldi r24, 2
    add r0, r24
    adc r1, r25
    add r19, r0
    adc r20, r1
    brcs 7f
    // r18:19, in ticks: n times that.
    mul r22, r19
    mov r24, r1
    mul r22, r20
    movw r18, r0
    add r18, r24
    adc r19, r25
    brcs 7f
    ldd r24, Y+{INTERVAL}+4
    tst r24
    brne 7f
    ldd r20, Y+{INTERVAL}+2
    ldd r21, Y+{INTERVAL}+3
    movw r24, r20
    add r24, r18                        // the longest
    adc r25, r19
    brcs 7f
    adiw r24, 2
    brcs 7f
    cpi r25, 7
    brsh 7f
    sub r20, r18                        // the shortest
    sbc r21, r19
    brcs 7f
    subi r20, 2
    sbci r21, 0
    brcs 7f
    lds r18, steps_times+{MIN_INTERVAL}
    lds r19, steps_times+{MIN_INTERVAL}+1
    cp r20, r18
    cpc r21, r19
    brlo 7f
    // Do all intervals have the same bits 8 and above? The first one is the shortest or the longest.
    brtc 9f
    ldd r20, Y+{INTERVAL}+3
    ldd r24, Y+{ADD}+3
    sbrs r24, 7
    mov r21, r20                        // the shortest
    mov r18, r25
    sbrc r24, 7
    mov r18, r20                        // the longest
    cpse r18, r21
    rjmp 9f
    ori r25, {HIGH_FIXED}
9:
    inc r25
    std Y+{PRECHECKED}, r25
7:  clr r1
    clc
    ret
    // More than 255 steps pass only if all intervals are the same.
8:  .irp at, 0,1,2,3,4,5,6,7
    ldd r24, Y+{ADD}+\at
    or r1, r24
    .endr
    brne 7b
    ldi r22, 1
    rjmp load_precheck
    // A motion without an anchor: a fault.
4:  std Y+{LEFT}, r1
    std Y+{LEFT}+1, r1
    ldi r22, {MISSED}
    ldd r18, Y+{HORIZON}
    ldd r19, Y+{HORIZON}+1
    ldd r20, Y+{HORIZON}+2
    ldd r21, Y+{HORIZON}+3
    rjmp load_fail

    // Takes the bytes that were read off the queue. Carry, and a fault, if there were not so many.
load_consume:
    movw r20, r26
    ldd r18, Y+{NEXT}
    ldd r19, Y+{NEXT}+1
    sub r20, r18
    sbc r21, r19
    brcc 1f
    add r20, r30                        // it went on at the start
    adc r21, r31
    ldd r18, Y+{START}
    ldd r19, Y+{START}+1
    sub r20, r18
    sbc r21, r19
1:  ldd r24, Y+{READY}
    ldd r25, Y+{READY}+1
    sub r24, r20
    sbc r25, r21
    brcs load_bad
    std Y+{READY}, r24
    std Y+{READY}+1, r25
    std Y+{NEXT}, r26
    std Y+{NEXT}+1, r27
    ret

load_bad:
    std Y+{LEFT}, r1                    // not counted yet
    std Y+{LEFT}+1, r1
    ldi r22, {BAD}
load_fail_here:
    ldd r18, Y+{TICK}
    ldd r19, Y+{TICK}+1
    ldd r20, Y+{TICK}+2
    ldd r21, Y+{TICK}+3
load_fail:
    .if {LEASES}
    call brake_fail
    .else
    clr r23
    movw r24, r28
    call steps_fail
    .endif
    sec
    ret
    "#,
    TICK = const offset_of!(Motor, registers) + 2,
    INTERVAL = const offset_of!(Motor, registers) + 6,
    ADD = const offset_of!(Motor, registers) + 11,
    ADD2 = const offset_of!(Motor, registers) + 15,
    LEFT = const offset_of!(Motor, registers) + 19,
    COUNT = const offset_of!(Motor, count),
    FLAGS = const offset_of!(Motor, flags),
    PRECHECKED = const offset_of!(Motor, prechecked),
    HIGH_FIXED = const HIGH_FIXED,
    OWN_RING_BIT = const mode::ONE_RING.trailing_zeros(),
    MIN_INTERVAL = const times::MIN_INTERVAL,
    GAIN = const offset_of!(Motor, gain),
    NEXT = const offset_of!(Motor, next),
    READY = const offset_of!(Motor, epochs) + offset_of!(EpochBytes, len),
    START = const offset_of!(Motor, start),
    END = const offset_of!(Motor, end),
    HORIZON = const offset_of!(Motor, horizon),
    POSITION = const offset_of!(Motor, position),
    BACKWARD = const flag::BACKWARD,
    ANCHORED = const flag::ANCHORED,
    UNREADABLE = const flag::UNREADABLE,
    MISSED = const FaultKind::Missed as u8,
    BAD = const FaultKind::Bad as u8,
    LEASES = const ThisProgram::LEASES as u8,
);

mod control;
