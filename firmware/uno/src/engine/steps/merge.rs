//! Two to four motors in one ring. Each has a list of ticks, and the merge takes the earliest of the lists' heads.
//!
//! # Lists
//! A lane is one motor: its list has up to 32 ticks that all toggle the same pins. When the list is used up, the motor says what it does next
//! ([`plan`](super::plan)): a batch of steps, which is expanded into the list, or a single event. A long pulse is two ticks. All heads lie within 32 767
//! ticks of each other, since two events of a motor are 16 384 apart at most.
//!
//! If several lists are used up together, it takes longer to fill them than the ring lasts. So while the ring is nearly full, short lists of steps are
//! topped up (`merge_top_up`): what is left moves to the front, and more steps go behind it.
//!
//! At a switch all lists end at the same tick, and each motor needs some 3000 cycles for its first steps of the other epoch. So while motors wait for a
//! switch, longer lists are topped up, too, and the refill comes more often. Motors go over to the other epoch one after the other, as their lists are
//! topped up beyond the switch.
//!
//! # Spacing
//! Groups are at least W ticks apart. So the interrupt has set the compare register before the next match, even if something kept it waiting. A tick
//! less than W/2 after the last group (or before it) joins that group. A tick from W/2 to W after it is put off to W. So no edge is early or late by more
//! than W/2. Two ticks that toggle the same pin never share a group.
//!
//! W is 48 for the short pulse, 60 for the stretched one and the shield, 76 for the shield's stretched one, and 78 while ring B of the shield is in use;
//! `tuning::stepper` has the reasons. With ring B a tick is put off by 24 at most, so that no edge is late by more than 60. A tick that comes before that
//! joins the last group, and is early by up to 54.
//!
//! # Sorted lanes
//! Of four lanes the merge compares two pairs of heads, and then the earlier of each; a lane without a motor has fillers. Of three it knows the order:
//! the code has a state for each of the 6 orders. A lane whose head was taken mostly comes last next time, and one comparison tells. The third list is
//! half as long then, as ring B of the shield is behind it if there is a fourth motor ([`shield_b`](super::shield_b)). Two motors, the shield's longer
//! pulses, and pulses of two ticks take the way of four lanes; so do three in a program without these states
//! ([`THREE_LANES`](crate::engine::program::Program::THREE_LANES)).
//!
//! # Cycles
//! A step: 34 to 37 with four lanes, 31 to 33 with three, and 18.5 for its expansion. A list: 130, the plan, and the start and end of the expansion. A
//! call: 280, 90 for checking the lists, and 75 each time that groups are published.

use crate::engine::steps::refill::mode;
use crate::engine::steps::register;
use crate::engine::steps::ring::{GROUPS, Group, Ring, SHORT_RING_GROUPS, SHORT_RING_START, flags};
use crate::engine::steps::stepper::{Stepper, Track};
use crate::engine::tuning::merge::{
    LISTS, PASSES, PUBLISH_GROUPS, REFILL_BELOW, RESUME_BELOW, RING_LOW_BELOW, SHIELD_B_LOW_BELOW,
};
use core::arch::global_asm;
use core::mem::offset_of;
pub(crate) use state::Merge;
use state::{LANE_SIZE, Lane, NONE, SHORT_LANE, SHORT_LIST};

/// Lanes. Those without a motor get fillers.
pub(crate) const LANES: usize = 4;

/// Ticks that a lane's list holds.
pub(crate) const LIST: u8 = 32;

mod state;

global_asm!(
    r#"
    // Registers while merging:
    //   r2:3 r4:5 r6:7 r8:9           heads of the lanes
    //   r10 to r13                    next of the lanes
    //   r14:15 r20:21 r22:23 r28:29   masks of the lanes: what a tick toggles, and what the end of its pulse toggles
    //   r16:17                        masks of the pending group. The first group of a batch has the END mark in r16; what it toggles is in the state then
    //   r18:19                        deadline: tick of the pending group + W
    //   r24 r25                       W/2, W
    //   r0                            groups that may still be put into the ring
    //   X                             the pending group's address
    //   Z                             into the lists' page

    // Puts the pending group into the ring, and makes the lane's head the pending group.           18
    .macro emit low, high, at_tick, at_end, lane
    cp \low, r18                        // 1                            1
    cpc \high, r19                      // 1                            2
    brmi 3f                             // 1                            3
    st X+, r16                          // 2                            5
    st X+, \high                        // 2                            7
    st X+, \low                         // 2                            9
    st X+, r17                          // 2                            11
    ldi r27, hi8(ring_a_page)           // 1                            12
    movw r18, \low                      // 1                            13
1:  add r18, r25                        // 1                            14
    adc r19, r1                         // 1                            15
    movw r16, \at_tick                  // 1                            16
    dec r0                              // 1                            17
    breq 5f                             // 1                            18
2:
    .endm

    // The rarer case: the head comes before the deadline. Joining takes 20 more, putting off 17.
    .macro emit_before_deadline low, high, at_tick, at_end, lane
3:  movw r30, r18
    sub r30, r24
    sbc r31, r1
    cp \low, r30
    cpc \high, r31
    brpl 4f
    lds r30, steps_merge+{END}
    cp r16, r30
    breq 74f                            // the first of a batch
    // It joins the pending group, unless both toggle the same line.
    mov r30, \at_tick
    and r30, r16
    brne 4f
    mov r30, \at_end
    and r30, r17
    brne 4f
    or r16, \at_tick
    or r17, \at_end
    ldi r31, hi8(ring_b_page)
    rjmp 2b
    // The pending group goes into the ring, and the head is put off to the deadline.
4:  st X+, r16
    st X+, r19
    st X+, r18
    st X+, r17
    ldi r27, hi8(ring_a_page)
    ldi r31, hi8(ring_b_page)
    rjmp 1b
74: movw r30, \at_tick
    rcall merge_join
    breq 2b
    rjmp 4b
5:  rcall merge_publish_and_check
    brcc 2b
    ldi r24, \lane
    rjmp merge_exit
    .endm

    // The next tick of the lane becomes its head.                                                  8
    .macro advance_0
    sbrc r10, 6                         // 2 (skips)                    2
    call merge_refill_0
    mov r30, r10                        // 1                            3
    ld r2, Z+                           // 2                            5
    ld r3, Z+                           // 2                            7
    mov r10, r30                        // 1                            8
    .endm
    .macro advance_1
    sbrc r11, 7
    call merge_refill_1
    mov r30, r11
    ld r4, Z+
    ld r5, Z+
    mov r11, r30
    .endm
    .macro advance_2
    sbrc r12, 6
    call merge_refill_2
    mov r30, r12
    ld r6, Z+
    ld r7, Z+
    mov r12, r30
    .endm
    // The same where the third list is shorter.
    .macro advance_short_0
    advance_0
    .endm
    .macro advance_short_1
    advance_1
    .endm
    .macro advance_short_2
    sbrc r12, 5
    call merge_refill_2
    mov r30, r12
    ld r6, Z+
    ld r7, Z+
    mov r12, r30
    .endm
    .macro advance_3                    // this list ends with its page                             9
    sbrs r13, 7
    call merge_refill_3
    mov r30, r13
    ld r8, Z+
    ld r9, Z+
    mov r13, r30
    ldi r31, hi8(ring_b_page)
    .endm

    // Lane a has the earliest head, c the latest. After a's head was taken, its next one is compared with c and b.   30
    .macro merge_order_3 last, a, al, ah, ar, af, b, bl, bh, c, cl, ch
three_\a\b\c:
    emit r\al, r\ah, r\ar, r\af, \a
    advance_short_\a
    cp r\al, r\cl
    cpc r\ah, r\ch
    .if \last
    brmi 7f
    rjmp three_\b\c\a
    .else
    brpl three_\b\c\a
    .endif
7:  cp r\al, r\bl
    cpc r\ah, r\bh
    brmi three_\a\b\c
    rjmp three_\b\a\c
    emit_before_deadline r\al, r\ah, r\ar, r\af, \a
    .endm
    // Three orders that follow each other as long as the lanes take turns.
    .macro merge_turn_3 a, al, ah, ar, af, b, bl, bh, br, bf, c, cl, ch, cr, cf
    merge_order_3 0, \a, \al, \ah, \ar, \af, \b, \bl, \bh, \c, \cl, \ch
    merge_order_3 0, \b, \bl, \bh, \br, \bf, \c, \cl, \ch, \a, \al, \ah
    merge_order_3 1, \c, \cl, \ch, \cr, \cf, \a, \al, \ah, \b, \bl, \bh
    .endm

    // Goes to \late if \a comes after \b.
    .macro before al, ah, bl, bh, late
    cp r\al, r\bl
    cpc r\ah, r\bh
    brpl \late
    .endm
    // Lane a has the earliest head of four.                                                        42 to 44
    .macro merge_first a, al, ah, ar, af
merge_first_\a:
    emit r\al, r\ah, r\ar, r\af, \a    //                              18
    advance_\a                          //                              26 or 27
    rjmp merge_four                     // 2                            29
    emit_before_deadline r\al, r\ah, r\ar, r\af, \a
    .endm

    .macro point_to_merge               //                              2
    ldi r28, lo8(steps_merge)
    ldi r29, hi8(steps_merge)
    .endm

    // Loads the masks of the lanes, from the state at Y.                                           20
    .macro load_masks
    ldd r14, Y+{LANE0}+{AT_TICK}
    ldd r15, Y+{LANE0}+{AT_END}
    ldd r20, Y+{LANE1}+{AT_TICK}
    ldd r21, Y+{LANE1}+{AT_END}
    ldd r22, Y+{LANE2}+{AT_TICK}
    ldd r23, Y+{LANE2}+{AT_END}
    ldd r24, Y+{HALF}
    ldd r25, Y+{SPACING}
    ldd r0, Y+{LANE3}+{AT_TICK}
    ldd r29, Y+{LANE3}+{AT_END}
    mov r28, r0
    .endm

    .macro each_head what
    \what 2, {LANE0}+{HEAD}
    \what 3, {LANE0}+{HEAD}+1
    \what 4, {LANE1}+{HEAD}
    \what 5, {LANE1}+{HEAD}+1
    \what 6, {LANE2}+{HEAD}
    \what 7, {LANE2}+{HEAD}+1
    \what 8, {LANE3}+{HEAD}
    \what 9, {LANE3}+{HEAD}+1
    \what 10, {LANE0}+{NEXT}
    \what 11, {LANE1}+{NEXT}
    \what 12, {LANE2}+{NEXT}
    \what 13, {LANE3}+{NEXT}
    \what 18, {DEADLINE}
    \what 19, {DEADLINE}+1
    .endm
    .macro fetch register, offset
    ldd r\register, Y+\offset
    .endm
    .macro store register, offset
    std Y+\offset, r\register
    .endm

    // Goes to \enough unless ring B of the shield is in use, and has run low. Uses r24, r25.
    .macro unless_shield_b_is_low enough
    sbis {FLAGS_IO}, {SHIELD_B}
    rjmp \enough
    lds r24, steps_stepper+{RING_B}+{RING_HEAD}
    in r25, {TAIL_B}
    sec
    sbc r25, r24
    brcc .+2
    subi r25, {START}
    cpi r25, 4 * ({SHORT_RING_GROUPS} - {SHIELD_B_LOW_BELOW})
    brlo \enough
    .endm
    // Corrects \end, the end of a list, if it is the third one.
    .macro short_list_end end
    cpi \end, 2 * {LIST} * ({SHORT_LANE} + 1)
    brne 9f
    lds \end, steps_merge+{THIRD_END}
9:
    .endm
    .macro saved_registers what
    .irp r, 2,3,4,5,6,7,8,9,10,11,12,13,16,17,18,19
    \what r\r
    .endr
    .endm
    .macro saved_registers_reversed what
    .irp r, 19,18,17,16,13,12,11,10,9,8,7,6,5,4,3,2
    \what r\r
    .endr
    .endm

    .section .text.steps_merge_run, "ax", @progbits
    .global steps_merge_run
    // For the refill: merges until the ring is full, or a motor has nothing more to do up to the limit. Uses all registers. Without ring B, carry is clear if
    // lists were topped up until the ring had run down: it may be called again.
steps_merge_run:
    lds r24, steps_merge+{AT}
    lds r30, steps_merge+{TAIL}
    ldi r31, 0
    ld r17, Z
    sub r17, r24
    dec r17
    lsr r17
    lsr r17
    cpi r17, {GROUPS} - {REFILL_BELOW}
    brsh 1f
    ret
1:  lds r24, steps_stepper+{TRACK_AT}
    lds r25, steps_stepper+{TRACK_AT}+1
    lds r18, steps_merge+{SPACING}
    add r24, r18
    adc r25, r1
    sts steps_merge+{DEADLINE}, r24
    sts steps_merge+{DEADLINE}+1, r25
    movw r18, r24
    ldi r24, {MAX_LISTS}
    sts steps_merge+{LISTS}, r24
    ldi r24, {MAX_PASSES}
    sts steps_merge+{PASSES}, r24
    lds r16, steps_merge+{EMPTY_LANE}
    cpi r16, {NONE}
    breq 3f
    // A lane has no head: take the next tick of its list, which may have to be filled.
    ldi r24, {LANE_SIZE}
    mul r16, r24
    movw r6, r0
    clr r1
    ldi r24, lo8(steps_merge)
    ldi r25, hi8(steps_merge)
    add r6, r24
    adc r7, r25
    movw r28, r6
    ldd r30, Y+{NEXT}
    mov r24, r16
    inc r24
    swap r24
    lsl r24
    lsl r24
    short_list_end r24
    cp r30, r24
    brne 2f
    mov r30, r16
    call merge_fill_list
    brcc 1f
    ret
1:  movw r28, r6
    ldd r30, Y+{NEXT}
2:  ldi r31, hi8(ring_b_page)
    ld r24, Z+
    std Y+{HEAD}, r24
    ld r24, Z+
    std Y+{HEAD}+1, r24
    std Y+{NEXT}, r30
3:  point_to_merge
    each_head fetch                     // 15 x 2
    mov r0, r17
    ldd r17, Y+{PENDING_AT_END}
    ldd r16, Y+{END}
    ldd r26, Y+{AT}
    ldi r27, hi8(ring_a_page)
    ldi r31, hi8(ring_b_page)
    ldi r30, {GROUPS} - {RING_LOW_BELOW}
    cp r0, r30
    brlo 4f
    ldi r30, {PUBLISH_GROUPS}
    mov r0, r30
4:  mov r30, r0
    load_masks                          // 20, and it uses r0
    mov r0, r30
    lds r30, steps_merge+{THIRD_END}
    sbrc r30, 5
    jmp ring_merge_three
merge_four:                             // the earlier of each pair, then the earlier of these     13 to 15
    before 2, 3, 4, 5, 2f
    before 6, 7, 8, 9, 1f
    before 2, 3, 6, 7, merge_first_2
    rjmp merge_first_0
1:  before 2, 3, 8, 9, merge_first_3_far
    rjmp merge_first_0
2:  before 6, 7, 8, 9, 3f
    before 4, 5, 6, 7, merge_first_2
    rjmp merge_first_1
3:  before 4, 5, 8, 9, merge_first_3_far
    rjmp merge_first_1
merge_first_3_far:
    rjmp merge_first_3

    merge_first 2, 6, 7, 22, 23
    merge_first 0, 2, 3, 14, 15
    merge_first 1, 4, 5, 20, 21
    merge_first 3, 8, 9, 28, 29

    // Publishes what has been put into the ring. Uses r24, r25, Y.                                 24
merge_publish:
    lds r28, steps_merge+{AT}           // 2
    cp r26, r28                         // 1
    breq 1f                             // 1
    lds r25, steps_merge+{END}          // 2
    st X, r25                           // 2  END where the pending group will be
    ldi r29, hi8(ring_a_page)           // 1
    lds r24, steps_merge+{PENDING_AT_TICK} // 2
    st Y, r24                           // 2  and off the first one
    sts steps_merge+{AT}, r26           // 2
    sts steps_merge+{PENDING_AT_TICK}, r16 // 2
    mov r16, r25                        // 1
1:  ret                                 // 4, and 3 for the call

    // Joins the masks r30:31 to the pending group, the first of a batch, unless both toggle the same line. Z flag: joined.
    //                                                                                              27
merge_join:                             // call                         3
    push r0                             // 2                            5
    lds r16, steps_merge+{PENDING_AT_TICK}
    mov r0, r30                         // 1                            6
    and r0, r16                         // 1                            7
    brne 1f                             // 1                            8
    mov r0, r31                         // 1                            9
    and r0, r17                         // 1                            10
    brne 1f                             // 1                            11
    or r16, r30                         // 1                            12
    or r17, r31                         // 1                            13
    ldi r31, hi8(ring_b_page)           // 1                            14
    cp r1, r1                           // 1                            15
1:
    sts steps_merge+{PENDING_AT_TICK}, r16
    lds r16, steps_merge+{END}
    pop r0                              // 2                            17
    ret                                 // 4                            21

    // Publishes, and goes on if the ring has room enough; otherwise carry is set. Groups must have been put into the ring since it was published last.
    //                                                                                              48, and 7 for the call
merge_publish_and_check:
    lds r30, steps_merge+{AT}
    ldi r31, hi8(ring_a_page)
    lds r24, steps_merge+{END}
    st X, r24
    sts steps_merge+{AT}, r26
    lds r25, steps_merge+{PENDING_AT_TICK}
    st Z, r25
    sts steps_merge+{PENDING_AT_TICK}, r16
    mov r16, r24
    lds r24, steps_merge+{PASSES}
    subi r24, 1
    brcs 1f
    sts steps_merge+{PASSES}, r24
    sbic {FLAGS_IO}, {NOT_PLAIN_B}
    rjmp 3f
2:  lds r30, steps_merge+{TAIL}
    ldi r31, 0
    ld r24, Z
    ldi r31, hi8(ring_b_page)
    sub r24, r26
    dec r24
    lsr r24
    lsr r24
    mov r0, r24
    cpi r24, {GROUPS} - {RING_LOW_BELOW}
    brlo 4f
    ldi r25, {PUBLISH_GROUPS}
    mov r0, r25
4:  cpi r24, {GROUPS} - {RESUME_BELOW}
    lds r24, steps_merge+{HALF}
    lds r25, steps_merge+{SPACING}
1:  ret
    // Ring B of the shield must not run empty.
3:  unless_shield_b_is_low 2b
    saved_registers push
    push r26
    push r27
    call ring_fill_shield_b
    pop r27
    pop r26
    saved_registers_reversed pop
    point_to_merge
    load_masks
    rjmp 2b

    .macro refill lane, next, offset
merge_refill_\lane:                     // call                         3
    ldi r30, \lane                      // 1                            4
    rcall merge_refill_list             // 96                           100
    lds \next, steps_merge+\offset+{NEXT} // 2                         102
    ret                                 // 4                            106
    .endm
    refill 0, r10, {LANE0}
    refill 1, r11, {LANE1}
    refill 2, r12, {LANE2}
    refill 3, r13, {LANE3}

    // Fills the list of the lane r30.                                                              85, and merge_fill_list
merge_refill_list:                      // call                         3
    push r30                            // 2                            5
    rcall merge_publish                 // 28                           33
    pop r30                             // 2                            35
    push r0                             // 5 x 2                        45
    push r18
    push r19
    push r26
    push r27
    push r30
    // While a list is filled, ring B of the shield runs down.
    sbis {FLAGS_IO}, {NOT_PLAIN_B}
    rjmp 2f
    unless_shield_b_is_low 2f
    saved_registers push
    push r30
    call ring_fill_shield_b
    pop r30
    saved_registers_reversed pop
2:
    rcall merge_fill_list
    pop r22
    pop r27
    pop r26
    pop r19
    pop r18
    brcs merge_no_steps                 // 1
    point_to_merge                      // 2
    load_masks                          // 21
    ldi r31, hi8(ring_b_page)           // 1
    pop r0
    ret                                 // 4

    // The motor of the lane r22 has nothing to do. Drops r0 and two return addresses from the stack.
merge_no_steps:
    mov r24, r22
    .rept 5
    pop r0
    .endr
merge_exit:
    sts steps_merge+{EMPTY_LANE}, r24
    point_to_merge
    ldd r16, Y+{PENDING_AT_TICK}
    std Y+{PENDING_AT_END}, r17
    each_head store
    sts steps_stepper+{RING}+{RING_PENDING}, r16
    sts steps_stepper+{RING}+{RING_PENDING}+1, r17
    ldd r24, Y+{AT}
    sts steps_stepper+{RING}+{RING_HEAD}, r24
    // The track's tick: less than 2^16 after what it was.
    ldd r24, Y+{SPACING}
    sub r18, r24
    sbc r19, r1
    lds r24, steps_stepper+{TRACK_AT}
    lds r25, steps_stepper+{TRACK_AT}+1
    sts steps_stepper+{TRACK_AT}, r18
    sts steps_stepper+{TRACK_AT}+1, r19
    cp r18, r24
    cpc r19, r25
    brcc 1f
    lds r24, steps_stepper+{TRACK_AT}+2
    lds r25, steps_stepper+{TRACK_AT}+3
    adiw r24, 1
    sts steps_stepper+{TRACK_AT}+2, r24
    sts steps_stepper+{TRACK_AT}+3, r25
    // While the ring is nearly full (or could not be filled), lists are topped up, since it takes long to fill several at once.
1:
    lds r24, steps_mode
    cpi r24, {SHIELD_MODE}
    brne .+2
    ret

    // Three lanes with the short third list: states of their own.
    .section .text.merge_three, "ax", @progbits
    .global merge_three
merge_three:
    // Finds the order of the lanes.
    before 2, 3, 4, 5, 53f
    before 4, 5, 6, 7, 51f
    rjmp three_012
51: before 2, 3, 6, 7, 52f
    rjmp three_021
52: rjmp three_201
53: before 2, 3, 6, 7, 54f
    rjmp three_102
54: before 4, 5, 6, 7, 55f
    rjmp three_120
55: rjmp three_210
    merge_turn_3 0, 2, 3, 14, 15, 1, 4, 5, 20, 21, 2, 6, 7, 22, 23
    merge_turn_3 0, 2, 3, 14, 15, 2, 6, 7, 22, 23, 1, 4, 5, 20, 21
    "#,
    LANE0 = const 0,
    LANE1 = const LANE_SIZE,
    LANE2 = const 2 * LANE_SIZE,
    LANE3 = const 3 * LANE_SIZE,
    AT_TICK = const offset_of!(Lane, masks) + offset_of!(Group, at_tick),
    AT_END = const offset_of!(Lane, masks) + offset_of!(Group, at_end),
    HEAD = const offset_of!(Lane, head),
    NEXT = const offset_of!(Lane, next),
    DEADLINE = const offset_of!(Merge, deadline),
    PENDING_AT_TICK = const offset_of!(Merge, pending) + offset_of!(Group, at_tick),
    PENDING_AT_END = const offset_of!(Merge, pending) + offset_of!(Group, at_end),
    AT = const offset_of!(Merge, at),
    END = const offset_of!(Merge, end),
    HALF = const offset_of!(Merge, half),
    SPACING = const offset_of!(Merge, spacing),
    TAIL = const offset_of!(Merge, tail),
    PASSES = const offset_of!(Merge, passes),
    LISTS = const offset_of!(Merge, lists_left),
    LANE_SIZE = const LANE_SIZE,
    EMPTY_LANE = const offset_of!(Merge, empty_lane),
    THIRD_END = const offset_of!(Merge, third_end),
    NONE = const NONE,
    RING = const offset_of!(Stepper, tracks) + offset_of!(Track, ring),
    RING_HEAD = const offset_of!(Ring, head),
    RING_PENDING = const offset_of!(Ring, pending),
    TRACK_AT = const offset_of!(Stepper, tracks) + offset_of!(Track, at),
    GROUPS = const GROUPS,
    SHORT_RING_GROUPS = const SHORT_RING_GROUPS,
    REFILL_BELOW = const REFILL_BELOW,
    MAX_LISTS = const LISTS,
    MAX_PASSES = const PASSES,
    FLAGS_IO = const register::GPIOR0,
    NOT_PLAIN_B = const flags::NOT_PLAIN_B,
    SHIELD_B = const flags::SHIELD_B,
    SHIELD_B_LOW_BELOW = const SHIELD_B_LOW_BELOW,
    RING_B = const offset_of!(Stepper, tracks) + size_of::<Track>() + offset_of!(Track, ring),
    TAIL_B = const register::OCR0B,
    START = const SHORT_RING_START,
    SHORT_LANE = const SHORT_LANE,
    SHIELD_MODE = const mode::MERGE_AND_B,
    LIST = const LIST,
    RESUME_BELOW = const RESUME_BELOW,
    RING_LOW_BELOW = const RING_LOW_BELOW,
    PUBLISH_GROUPS = const PUBLISH_GROUPS,
);

mod lists;
