//! Expansion: registers of a segment → ticks of its steps, n at a time.
//!
//! What [`Registers::advance`] does n times, with the registers in the
//! processor's own: four additions for the time, four for the interval, four for its change. The time's fifth byte takes
//! the carry; the sixth and the interval's fifth follow from the rest at the end.
//!
//! # What the caller promises
//! 1 ≤ n ≤ `left`, n ≤ 255, and before and after each of the n steps −32768 ≤ interval < 32768 ticks: then the time moves by
//! less than 2^24 ticks, and the interval's fifth byte is its sign.
//!
//! # Rings
//! A ring is filled while it is played: the expansion publishes some steps, looks how much room there is by now, and goes on
//! until all are made or the ring is full. What there was no room for stays in `left`. All groups that it comes to are a step's
//! already, so that ticks alone are written.
//!
//! Where the segment is sure and all its intervals are shorter than 256 ticks ([`Motor::sure`] is 1), they and their changes fit
//! into 24 bits, and n of them into 16. The same holds of a list if bit 8 and those above it stay the same throughout ([`EVEN`]). Those
//! loops are written out four times.
//!
//! # Cycles
//! | into | changing law | shorter than 256 ticks | cruise (add = add2 = 0) | around n steps |
//! |---|---|---|---|---|
//! | a ring | 19.5 | 15.75 | 11.5 | 80, and 40 each time that some are published |
//! | a list | 18.5, or 14.75 | | 10.5 | 100, or 85 |

use super::motor::{EVEN, Motor};
use super::register;
use crate::engine::tuning::expand::{HURRY, LEAST, SOME};
use core::arch::global_asm;
use core::mem::offset_of;
use pulsetrain_core::avr::Registers;

const _: () = assert!(offset_of!(Registers, fraction) == 0);
const _: () = assert!(offset_of!(Registers, tick) == 2);
const _: () = assert!(offset_of!(Registers, interval_low) == 6);
const _: () = assert!(offset_of!(Registers, interval_high) == 10);
const _: () = assert!(offset_of!(Registers, add) == 11);
const _: () = assert!(offset_of!(Registers, add2) == 15);
const _: () = assert!(offset_of!(Registers, left) == 19);

// Bit 3 of their data addresses tells the tails apart.
const _: () = assert!((register::OCR0A + 0x20) & 8 == 0 && (register::OCR0B + 0x20) & 8 != 0);

// Arguments: Y the registers (the motor), Z where the ticks go, r20 n, r17 the length of long pulses; for a ring r19, the data
// address of its tail, r6, the low byte of Z, and first bytes of groups: r17 of the one that is pending, r18 of a step that is
// followed by another, r7 of the last. For a ring of long pulses r18, what either edge toggles.
// Result: r24, the low byte of where the last one went; for a ring r5, steps that there was no room for.
// Keeps Y, r1 to r4, r7; r17 but for lists and rings; not X.
// Registers of the processor while expanding:
//   r0 r21         fraction
//   r22 r23 r24    tick, its low three bytes
//   r25 r26 r27 r8 interval, its low four bytes
//   r9 to r12      add
//   r13 to r16     add2
//   r20            steps left of the batch
//   r18 r19        first byte of a group; second tick of a long pulse
//   r5             steps left beyond the batch (ring only)
//   r6 r7 r17      see above
//   Y              the Registers; Z where the ticks go
global_asm!(
    r#"
    // The steps are taken off those that are left.
    .macro expand_take                  //                              10
    ldd r24, Y+19
    ldd r25, Y+20
    sub r24, r20
    sbc r25, r1
    std Y+19, r24
    std Y+20, r25
    .endm

    .macro expand_enter                 //                              52
    expand_take                         // 10                           10
    ldd r0, Y+0                         // 17 x 2                       44
    ldd r21, Y+1
    ldd r22, Y+2
    ldd r23, Y+3
    ldd r24, Y+4
    ldd r25, Y+6
    ldd r26, Y+7
    ldd r27, Y+8
    ldd r8, Y+9
    ldd r9, Y+11
    ldd r10, Y+12
    ldd r11, Y+13
    ldd r12, Y+14
    ldd r13, Y+15
    ldd r14, Y+16
    ldd r15, Y+17
    ldd r16, Y+18
    cp r9, r1                           // 8                            52
    .irp r, 10,11,12,13,14,15,16
    cpc r\r, r1
    .endr
    .endm

    .macro expand_leave_lawful          //                              8
    std Y+11, r9
    std Y+12, r10
    std Y+13, r11
    std Y+14, r12
    .endm

    .macro expand_leave                 //                              32 with ret
    std Y+0, r0                         // 2                            2
    std Y+1, r21                        // 2                            4
    std Y+2, r22                        // 2                            6
    std Y+3, r23                        // 2                            8
    ldd r0, Y+4                         // 2                            10
    std Y+4, r24                        // 2                            12
    cp r24, r0                          // 1                            13
    brcc 1f                             // 2 (6 without)                15
    ldd r24, Y+5
    inc r24
    std Y+5, r24
1:  std Y+6, r25                        // 2                            17
    std Y+7, r26                        // 2                            19
    std Y+8, r27                        // 2                            21
    std Y+9, r8                         // 2                            23
    lsl r8                              // 1                            24
    sbc r8, r8                          // 1                            25
    std Y+10, r8                        // 2                            27
    mov r24, r30                        // 1                            28
    ret                                 // 4                            32
    .endm

    .macro advance_tick                 //                              5
    add r0, r25
    adc r21, r26
    adc r22, r27
    adc r23, r8
    adc r24, r1
    .endm

    .macro advance_interval             //                              8
    add r25, r9
    adc r26, r10
    adc r27, r11
    adc r8, r12
    add r9, r13
    adc r10, r14
    adc r11, r15
    adc r12, r16
    .endm

    // What is needed where intervals stay below the next 256 ticks: their highest byte stays as it is.           40
    .macro near_enter
    expand_take
    ldd r0, Y+0
    ldd r21, Y+1
    ldd r22, Y+2
    ldd r23, Y+3
    ldd r25, Y+6
    ldd r26, Y+7
    ldd r27, Y+8
    ldd r8, Y+9
    ldd r9, Y+11
    ldd r10, Y+12
    ldd r11, Y+13
    ldd r13, Y+15
    ldd r14, Y+16
    ldd r15, Y+17
    .endm
    .macro near_leave                   //                              33
    ldd r20, Y+2
    cp r22, r20
    ldd r20, Y+3
    cpc r23, r20
    brcc 18f
    ldd r24, Y+4
    inc r24
    std Y+4, r24
    brne 18f
    ldd r24, Y+5
    inc r24
    std Y+5, r24
18: std Y+0, r0
    std Y+1, r21
    std Y+2, r22
    std Y+3, r23
    std Y+6, r25
    std Y+7, r26
    std Y+8, r27
    std Y+11, r9
    std Y+12, r10
    std Y+13, r11
    lsl r11
    sbc r11, r11
    std Y+14, r11
    .endm

    .macro expander name, store, cruise, even=0
    .section .text.\name, "ax", @progbits
    .global \name
\name:
    .if \even
    ldd r24, Y+{SURE}
    sbrs r24, {EVEN_BIT}
    rjmp 9f
    cpi r20, 2
    brlo 9f
    rjmp 10f
9:
    .endif
    expand_enter                        //                              52
    .if \cruise
    brne 8f                             // 2                            54
    rjmp 5f
    .endif
8:  sbrs r20, 0                         // 2 when odd, 3 when even
    rjmp 2f                             //                              57
1:  advance_tick
    \store
    advance_interval
    dec r20
    breq 3f
2:  advance_tick
    \store
    advance_interval
    advance_tick
    \store
    advance_interval
    subi r20, 2                         // 1
    brne 2b                             // 2: 3 for two steps
3:  expand_leave_lawful                 //                              8
4:  expand_leave                        //                              32
    .if \cruise
5:  sbrs r20, 0
    rjmp 7f
6:  advance_tick
    \store
    dec r20
    breq 4b
7:  advance_tick
    \store
    advance_tick
    \store
    subi r20, 2
    brne 7b
    rjmp 4b
    .endif
    .if \even
10: near_enter
    sbrs r20, 0
    rjmp 11f
    advance_even \store
11: sbrs r20, 1
    rjmp 12f
    advance_even \store
    advance_even \store
12: subi r20, 4
    brcs 14f
13: .rept 4
    advance_even \store
    .endr
    subi r20, 4
    brcc 13b
14: near_leave
    mov r24, r30
    ret
    .endif
    .endm

    // Bit 8 of the interval and those above it stay: 24 bits of it and of its changes, and 16 of the time.   14 with a list's store
    .macro advance_even store
    add r0, r25
    adc r21, r26
    adc r22, r27
    adc r23, r8
    \store
    add r25, r9
    adc r26, r10
    adc r27, r11
    add r9, r13
    adc r10, r14
    adc r11, r15
    .endm

    // What was left out of it, in the shorter code.
    .macro near_end
    mov r12, r11
    lsl r12
    sbc r12, r12
    ldd r20, Y+2
    cp r22, r20
    ldd r20, Y+3
    cpc r23, r20
    adc r24, r1
    .endm

    // Into groups that toggle the same already.
    .macro ring_store                   //                              5
    std Z+1, r23
    std Z+2, r22
    subi r30, -4
    .endm

    // Steps for the ring at once, r20, of the r5 that are left; \done if there are none, or no room.         16
    .macro ring_some done
    in r20, {TAIL_A}
    sbrc r19, 3
    in r20, {TAIL_B}
    sub r20, r6
    dec r20
    lsr r20
    lsr r20
    cpi r20, {LEAST}
    brsh .+2
    rjmp \done
    cpi r20, {HURRY}
    brlo .+2
    ldi r20, {LEAST}
    sbrc r20, 5                         // it has 62 groups at most
    ldi r20, {SOME}
    cp r5, r20
    brsh .+2
    mov r20, r5
    sub r5, r20
    sbrs r20, 0
    .endm

    // Z becomes the pending group; the one that was, r6, is published with the first byte r17.     9
    .macro ring_publish
    st Z, r7
    eor r30, r6
    eor r6, r30
    eor r30, r6
    st Z, r17
    mov r30, r6
    mov r17, r18
    .endm

    .section .text.steps_expand_ring, "ax", @progbits
    .global steps_expand_ring
steps_expand_ring:
    // Segments whose intervals are all shorter than 256 ticks have a way of their own.
    ldd r24, Y+{SURE}
    cpi r24, 1
    brne 9f
    cpi r20, 2
    brlo 9f
    rjmp 17f
9:  expand_enter
    mov r5, r20                         // keeps Z
    brne 8f
    rjmp 5f
8:  ring_some 4f
    rjmp 2f
1:  advance_tick
    ring_store
    advance_interval
    dec r20
    breq 3f
2:  advance_tick
    ring_store
    advance_interval
    advance_tick
    ring_store
    advance_interval
    subi r20, 2
    brne 2b
3:  ring_publish
    tst r5
    breq 4f
    rjmp 8b
4:  expand_leave_lawful
    // What there was no room for is left.
3:  ldd r20, Y+19
    add r20, r5
    std Y+19, r20
    ldd r20, Y+20
    adc r20, r1
    std Y+20, r20
    expand_leave
5:  ring_some 3b
    rjmp 7f
6:  advance_tick
    ring_store
    dec r20
    breq 9f
7:  advance_tick
    ring_store
    advance_tick
    ring_store
    subi r20, 2
    brne 7b
9:  ring_publish
    tst r5
    brne 5b
    rjmp 3b
    // All intervals are shorter than 256 ticks: they, and their changes, have 24 bits, and the time has 16 that change.
    .macro advance_near                 //                              15
    add r0, r25
    adc r21, r26
    adc r22, r27
    adc r23, r1
    ring_store
    add r25, r9
    adc r26, r10
    adc r27, r11
    add r9, r13
    adc r10, r14
    adc r11, r15
    .endm
10: ring_some 13f
    rjmp 12f
11: advance_near
12: sbrs r20, 1
    rjmp 15f
    advance_near
    advance_near
15: subi r20, 4
    brcs 14f
16: .rept 4
    advance_near
    .endr
    subi r20, 4
    brcc 16b
14: ring_publish
    tst r5
    breq 13f
    rjmp 10b
13: near_leave
    tst r5
    breq 19f
    ldd r20, Y+19
    add r20, r5
    std Y+19, r20
    ldd r20, Y+20
    adc r20, r1
    std Y+20, r20
19: mov r24, r30
    ret
17: near_enter
    mov r5, r20
    cp r9, r1
    .irp r, 10,11,13,14,15
    cpc r\r, r1
    .endr
    breq .+2
    rjmp 10b
    ldd r24, Y+4
    rjmp 5b

    // A long pulse: two groups a step, the second r17 ticks after the first.                       22
    .macro ring_store_long
    std Z+1, r23
    std Z+2, r22
    subi r30, -4
    st Z, r18
    std Z+3, r1
    mov r19, r22
    add r19, r17
    std Z+2, r19
    mov r19, r23
    adc r19, r1
    std Z+1, r19
    subi r30, -4
    st Z, r18
    std Z+3, r1
    .endm

    .macro list_store                   //                              4
    st Z+, r22
    st Z+, r23
    .endm

    .macro list_store_long              //                              11
    st Z+, r22
    st Z+, r23
    movw r18, r22
    add r18, r17
    adc r19, r1
    st Z+, r18
    st Z+, r19
    .endm

    expander steps_expand_list, list_store, 1, 1
    // The same into the ring behind lists.                                                         7
    .macro beside_store
    std Z+1, r23
    std Z+2, r22
    subi r30, -4
    brcs .+2
    ldi r30, {START}
    .endm
    expander steps_expand_beside, beside_store, 1, 1
    expander steps_expand_ring_long, ring_store_long, 0
    expander steps_expand_list_long, list_store_long, 0
    "#,
    SOME = const SOME,
    LEAST = const LEAST,
    HURRY = const HURRY,
    TAIL_A = const register::OCR0A,
    TAIL_B = const register::OCR0B,
    SURE = const offset_of!(Motor, sure),
    EVEN_BIT = const EVEN.trailing_zeros(),
    START = const super::ring::BEHIND_LISTS,
);
