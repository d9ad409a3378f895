//! Control records: a reversal, a reset, a wait, an anchor, a check, a segment in full.

use crate::ThisProgram;
use crate::engine::program::Program;
use crate::engine::steps::motor::{COUNT_AT_REST, FaultKind, Motor, flag};
use core::arch::global_asm;
use core::mem::offset_of;
use pulsetrain_core::packing::Control;

global_asm!(
    r#"
    .section .text.steps_load_record
    // A control record: r25 has its header.
load_control:
    lsr r25
    lsr r25
    lsr r25
    cpi r25, 1
    brlo load_reverse
    breq load_reset
    cpi r25, 4
    brlo load_wait
    brne 1f
    rjmp load_exact
1:  cpi r25, 5
    brne 2f
    rjmp load_check
2:  rjmp load_bad

load_reverse:
    ldd r24, Y+{FLAGS}
    ldi r25, 1 << {BACKWARD} | 1 << {TURN}
    eor r24, r25
    std Y+{FLAGS}, r24
    .if {LEASES}
    call brake_note_rest
    .endif
load_reset:
    call load_clear
    rjmp load_consume

    // A dwell or an anchor: four bytes of ticks.
load_wait:
    push r25
    call steps_settle
    .if {LEASES}
    call brake_note_rest
    .endif
    ldi r23, 4
    rcall load_number
    pop r25
    cpi r25, {DWELL}
    brne 1f
    ldd r24, Y+{FLAGS}
    sbrs r24, {ANCHORED}
    rjmp load_consume
    load_add {TICK}
    rjmp load_consume
1:  std Y+{TICK}, r18
    std Y+{TICK}+1, r19
    std Y+{TICK}+2, r20
    std Y+{TICK}+3, r21
    ldi r24, 0x80
    std Y+{FRACTION}, r1
    std Y+{FRACTION}+1, r24
    ldd r24, Y+{POSITION}
    std Y+{ORIGIN}, r24
    ldd r24, Y+{POSITION}+1
    std Y+{ORIGIN}+1, r24
    ldd r24, Y+{FLAGS}
    ori r24, 1 << {ANCHORED}
    std Y+{FLAGS}, r24
    rjmp load_consume

    // A check: position since the anchor, tick and fraction must be those of the registers.
load_check:
    next_byte r18
    next_byte r19
    ldd r20, Y+{ORIGIN}
    ldd r21, Y+{ORIGIN}+1
    add r18, r20
    adc r19, r21
    ldd r20, Y+{POSITION}
    ldd r21, Y+{POSITION}+1
    eor r18, r20
    eor r19, r21
    or r18, r19                         // 0 as long as all agrees
    .irp at, {TICK}, {TICK}+1, {TICK}+2, {TICK}+3, {FRACTION}, {FRACTION}+1
    next_byte r24
    ldd r19, Y+\at
    eor r24, r19
    or r18, r24
    .endr
    mov r15, r18
    rcall load_consume
    brcs 1f
    ldd r24, Y+{FLAGS}
    sbrs r24, {ANCHORED}
    clr r15
    tst r15
    brne 2f
    rjmp steps_load_record
2:  ldi r22, {MISMATCH}
    rjmp load_fail_here
1:  ret

    // A segment in full. r0: widths of interval and add; r14: widths of add2 and the count.
load_exact:
    rcall load_byte
    mov r0, r24
    rcall load_byte
    mov r14, r24
    swap r24
    andi r24, 15
    mov r23, r24
    dec r24
    cpi r24, 2
    brsh load_bad_near                  // more steps than there are in 16 bits
    rcall load_byte
    mov r18, r24
    clr r19
    sbrs r23, 1
    rjmp 1f
    rcall load_byte
    mov r19, r24
1:  mov r24, r18
    or r24, r19
    breq load_bad_near
    std Y+{LEFT}, r18
    std Y+{LEFT}+1, r19
    ldi r24, 255
    tst r19
    brne 2f
    mov r18, r24
2:  std Y+{COUNT}, r18
    std Y+{COUNT}+1, r19

    mov r23, r0
    andi r23, 15
    cpi r23, 7
    brsh load_bad_near
    cpi r23, 6
    brne 3f
    // The interval has as many bits as the register, and one more for the sign.
    ldi r23, 5
    rcall load_number
    rcall load_byte
    tst r24
    breq 4f
load_bad_near:
    rjmp load_bad
3:  rcall load_number
    sbrc r22, 7
    rjmp load_bad
4:  std Y+{INTERVAL}, r18
    std Y+{INTERVAL}+1, r19
    std Y+{INTERVAL}+2, r20
    std Y+{INTERVAL}+3, r21
    std Y+{INTERVAL}+4, r22

    swap r0
    ldd r24, Y+{LEFT}+1
    ldd r25, Y+{LEFT}
    tst r24
    breq 5f
    ldi r25, 3
5:  mov r23, r0
    andi r23, 15
    cpi r25, 2
    brlo 6f
    rcall load_difference
    brne load_bad_near
    std Y+{ADD}, r18
    std Y+{ADD}+1, r19
    std Y+{ADD}+2, r20
    std Y+{ADD}+3, r21
    clr r23
6:  tst r23
    brne load_bad_near                  // a register without a use
    mov r23, r14
    andi r23, 15
    cpi r25, 3
    brlo 7f
    rcall load_difference
    brne load_bad_near
    std Y+{ADD2}, r18
    std Y+{ADD2}+1, r19
    std Y+{ADD2}+2, r20
    std Y+{ADD2}+3, r21
    clr r23
7:  tst r23
    brne load_bad_near
    rjmp load_segment

    // r18 to r21: a number of r23 bytes. Z flag clear: it has more than 32 bits.
load_difference:
    cpi r23, 5
    brlo 1f
    breq 1f
    ret                                 // with Z clear
1:  rcall load_number
    mov r24, r21
    lsl r24
    sbc r24, r24
    cp r24, r22
    ret

    .section .text.load_clear, "ax", @progbits
    // No prediction from the previous segment.
    .global load_clear
load_clear:
    ldi r24, {AT_REST}
    std Y+{COUNT}, r24
    std Y+{COUNT}+1, r1
    .irp at, 0,1,2,3,4,5,6,7,8,9,10,11,12
    std Y+{INTERVAL}+\at, r1
    .endr
    ret
    "#,
    FRACTION = const offset_of!(Motor, registers),
    TICK = const offset_of!(Motor, registers) + 2,
    INTERVAL = const offset_of!(Motor, registers) + 6,
    ADD = const offset_of!(Motor, registers) + 11,
    ADD2 = const offset_of!(Motor, registers) + 15,
    LEFT = const offset_of!(Motor, registers) + 19,
    COUNT = const offset_of!(Motor, count),
    AT_REST = const COUNT_AT_REST,
    DWELL = const Control::Dwell as u8,
    FLAGS = const offset_of!(Motor, flags),
    POSITION = const offset_of!(Motor, position),
    ORIGIN = const offset_of!(Motor, origin),
    BACKWARD = const flag::BACKWARD,
    TURN = const flag::TURN,
    ANCHORED = const flag::ANCHORED,
    MISMATCH = const FaultKind::Mismatch as u8,
    LEASES = const ThisProgram::LEASES as u8,
);
