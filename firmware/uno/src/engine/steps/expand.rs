//! Expansion: registers of a segment → ticks of its steps, n at a time.
//!
//! It does what [`Registers::advance`] does, n times, with the registers in those of the processor: four additions for the tick, four for the interval,
//! four for `add`. The tick's fifth byte takes the carry. The tick's sixth byte, and the interval's fifth, are worked out at the end.
//!
//! # What the caller must see to
//! 1 ≤ n ≤ `left` and n ≤ 255. Before and after each of the n steps −32768 ≤ interval < 32768 ticks. Then the tick moves by less than 2^24, and the
//! interval's fifth byte is its sign.
//!
//! # Rings
//! A ring is filled while it is played. So the expansion publishes some steps, looks how much room there is by now, and goes on until all are made or the
//! ring is full. Steps that find no room stay in `left`. All groups toggle what a step toggles already, so that only ticks are written.
//!
//! If all intervals of a segment are shorter than 256 ticks ([`Motor::prechecked`] is 1), they and their changes fit into 24 bits, and the change of the
//! tick into 16. The same holds for a list if all intervals have the same bits 8 and above ([`HIGH_FIXED`]). These loops are unrolled four times.
//!
//! # Cycles
//! | into | changing law | shorter than 256 ticks | cruise (add = add2 = 0) | around n steps |
//! |---|---|---|---|---|
//! | a ring | 19.5 | 15.75 | 11.5 | 80, and 40 each time that some are published |
//! | a list | 18.5, or 14.75 | | 10.5 | 100, or 85 |

use super::motor::{HIGH_FIXED, Motor};
use super::register;
use super::ring::GROUPS;
use crate::engine::tuning::expand::{PUBLISH_MIN, PUBLISH_STEPS, RING_LOW_BELOW};
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

// `sbrc r20, 5` asks whether half of the ring is free.
const _: () = assert!(GROUPS / 2 == 1 << 5);

// Bit 3 of their data addresses tells the tails of ring A and B apart.
const _: () = assert!((register::OCR0A + 0x20) & 8 == 0 && (register::OCR0B + 0x20) & 8 != 0);

// Arguments: Y the registers (the motor), Z where the ticks go, r20 n, r17 the length of long pulses. For a ring also: r19, the data
// address of its tail; r6, the low byte of Z; and first bytes of groups: r17 of the pending one, r18 of a step that another follows, r7 of the last step.
// For a ring of long pulses r18 is what either edge toggles.
// Results: r24, the low byte of the last group's address; for a ring r5, how many steps found no room.
// Keeps Y, r1 to r4 and r7; for lists and rings not r17; never X.
// Registers of the processor while expanding:
//   r0 r21         fraction
//   r22 r23 r24    tick, its low three bytes
//   r25 r26 r27 r8 interval, its low four bytes
//   r9 to r12      add
//   r13 to r16     add2
//   r20            steps of this batch that are left
//   r18 r19        first byte of a group; second tick of a long pulse
//   r5             steps after this batch (rings only)
//   r6 r7 r17      see above
//   Y              the registers; Z where the ticks go
global_asm!(
    r#"
    // Takes the steps off `left`.
    .macro expand_count                 //                              10
    ldd r24, Y+19
    ldd r25, Y+20
    sub r24, r20
    sbc r25, r1
    std Y+19, r24
    std Y+20, r25
    .endm

    .macro expand_enter                 //                              52
    expand_count                        // 10                           10
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

    .macro expand_leave_add             //                              8
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

    // Loads what changes where all intervals are shorter than 256 ticks: not the tick's and the interval's high bytes.           40
    .macro short_enter
    expand_count
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
    .macro short_leave                  //                              33
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

    // What all but the fastest expansion, that of a ring, have in common: once in the image.
    .section .text.steps_expand_common, "ax", @progbits
expand_begin:                           // call                         3
    expand_enter                        //                              55
    ret                                 // 4                            59
expand_end_changed:
    expand_leave_add
expand_end:
    expand_leave

    .macro expander name, store, cruise, high_fixed=0
    .section .text.\name, "ax", @progbits
    .global \name
\name:
    .if \high_fixed
    ldd r24, Y+{PRECHECKED}
    sbrs r24, {HIGH_FIXED_BIT}
    rjmp 9f
    cpi r20, 2
    brlo 9f
    rjmp 10f
9:
    .endif
    call expand_begin                   //                              59
    .if \cruise
    brne 8f                             // 2                            61
    rjmp 5f
    .endif
8:  sbrs r20, 0                         // 2 when odd, 3 when even
    rjmp 2f                             //                              64
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
3:  jmp expand_end_changed              // 3                            43
4:  jmp expand_end                      // 3                            35
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
    .if \high_fixed
10: short_enter
    sbrs r20, 0
    rjmp 11f
    advance_high_fixed \store
11: sbrs r20, 1
    rjmp 12f
    advance_high_fixed \store
    advance_high_fixed \store
12: subi r20, 4
    brcs 14f
13: .rept 4
    advance_high_fixed \store
    .endr
    subi r20, 4
    brcc 13b
14: short_leave
    mov r24, r30
    ret
    .endif
    .endm

    // Bits 8 and above of the interval stay: 24 bits of it and of its changes are added, and 16 of the tick.   14 with a list's store
    .macro advance_high_fixed store
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

    // Into groups that toggle the right pins already.
    .macro ring_store                   //                              5
    std Z+1, r23
    std Z+2, r22
    subi r30, -4
    .endm

    // r20: the size of the next batch into the ring, of the r5 steps that are left. \done if none are left, or there is no room.         16
    .macro ring_next_batch done
    in r20, {TAIL_A}
    sbrc r19, 3
    in r20, {TAIL_B}
    sub r20, r6
    dec r20
    lsr r20
    lsr r20
    cpi r20, {PUBLISH_MIN}
    brsh .+2
    rjmp \done
    cpi r20, {GROUPS} - {RING_LOW_BELOW}
    brlo .+2
    ldi r20, {PUBLISH_MIN}
    sbrc r20, 5                         // it has 62 groups at most
    ldi r20, {PUBLISH_STEPS}
    cp r5, r20
    brsh .+2
    mov r20, r5
    sub r5, r20
    sbrs r20, 0
    .endm

    // Z becomes the pending group. The one that was pending, r6, is published with the first byte r17.     9
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
    // Segments whose intervals are all shorter than 256 ticks have loops of their own.
    ldd r24, Y+{PRECHECKED}
    cpi r24, 1
    brne 9f
    cpi r20, 2
    brlo 9f
    rjmp 17f
9:  expand_enter
    mov r5, r20                         // keeps Z
    brne 8f
    rjmp 5f
8:  ring_next_batch 4f
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
4:  expand_leave_add
    // Steps that found no room are left.
3:  ldd r20, Y+19
    add r20, r5
    std Y+19, r20
    ldd r20, Y+20
    adc r20, r1
    std Y+20, r20
    expand_leave
5:  ring_next_batch 3b
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
    // All intervals are shorter than 256 ticks: 24 bits of them and of their changes are added, and 16 of the tick.
    .macro advance_short                //                              15
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
10: ring_next_batch 13f
    rjmp 12f
11: advance_short
12: sbrs r20, 1
    rjmp 15f
    advance_short
    advance_short
15: subi r20, 4
    brcs 14f
16: .rept 4
    advance_short
    .endr
    subi r20, 4
    brcc 16b
14: ring_publish
    tst r5
    breq 13f
    rjmp 10b
13: short_leave
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
17: short_enter
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
    // The same into the short ring behind the lists.                                                         7
    .macro shield_b_store
    std Z+1, r23
    std Z+2, r22
    subi r30, -4
    brcs .+2
    ldi r30, {START}
    .endm
    expander steps_expand_shield_b, shield_b_store, 0
    expander steps_expand_ring_long, ring_store_long, 0
    expander steps_expand_list_long, list_store_long, 0
    "#,
    PUBLISH_STEPS = const PUBLISH_STEPS,
    PUBLISH_MIN = const PUBLISH_MIN,
    GROUPS = const GROUPS,
    RING_LOW_BELOW = const RING_LOW_BELOW,
    TAIL_A = const register::OCR0A,
    TAIL_B = const register::OCR0B,
    PRECHECKED = const offset_of!(Motor, prechecked),
    HIGH_FIXED_BIT = const HIGH_FIXED.trailing_zeros(),
    START = const super::ring::SHORT_RING_START,
);
