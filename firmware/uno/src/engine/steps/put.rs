//! One event into a ring: it joins the pending group if it fits, else it follows that.
//!
//! # Registers of the processor
//! | | |
//! |---|---|
//! | Y | the track |
//! | r18 to r21 | the tick |
//! | r22, r23 | what is toggled at the tick, and at the end of a short pulse |
//! | X | a group's address |

use super::motor::{Motor, flag};
use super::register;
use super::ring::{GROUPS, Ring, hardware};
use super::stepper::{Stepper, Track};
use super::times;
use core::arch::global_asm;
use core::mem::offset_of;
use pulsetrain_core::Tick32;

global_asm!(
    r#"
    .section .text.put_planned, "ax", @progbits
    .global put_planned
    // Puts an event of the motor r14:15, as `steps_plan` gives it, into the ring of the track r16:17. Keeps r2 to r17, and returns the motor in Y.
put_planned:
    movw r28, r16
    push r24
    // The plan gives the lower 16 bits of the tick: take the tick near the pending group's that has them.
    movw r18, r20
    ldd r24, Y+{AT}
    ldd r25, Y+{AT}+1
    ldd r20, Y+{AT}+2
    ldd r21, Y+{AT}+3
    movw r26, r18
    sub r26, r24
    sbc r27, r25
    sbrc r27, 7
    rjmp 1f
    brcc 2f
    subi r20, -1
    sbci r21, -1
    rjmp 2f
1:  brcs 2f
    subi r20, 1
    sbci r21, 0
2:  .irp r, 18,19,20,21
    push r\r
    .endr
    call put_or_join
    // If the event was put off, steps must be planned singly until one is on time again.
    clr r25
    .irp r, 21,20,19,18
    pop r24
    eor r24, r\r
    or r25, r24
    .endr
    movw r30, r14
    ldd r24, Z+{FLAGS}
    andi r24, 0xff - (1 << {SINGLY})
    cpse r25, r1
    ori r24, 1 << {SINGLY}
    std Z+{FLAGS}, r24
    pop r24
    cpi r24, 2
    brne 3f
    // The end of a long pulse is a group of its own.
    lds r24, steps_times+{PULSE}
    lds r25, steps_times+{PULSE}+1
    add r18, r24
    adc r19, r25
    adc r20, r1
    adc r21, r1
    clr r23
    call put_or_join
3:  movw r28, r14
    ret

    .section .text.put_or_join, "ax", @progbits
    .global put_or_join
    // Puts an event into the ring of the track Y, at r18 to r21 or later. Gives its tick.
put_or_join:
    ldd r24, Y+{AT_TICK}
    and r24, r22
    ldd r25, Y+{AT_END}
    and r25, r23
    or r24, r25
    // An edge of the compare hardware needs a group of its own.
    mov r25, r22
    or r25, r23
    ldd r26, Y+{COMPARE_BIT}
    and r25, r26
    or r24, r25
    brne put_after
    ldd r24, Y+{AT}
    cp r24, r18
    ldd r24, Y+{AT}+1
    cpc r24, r19
    ldd r24, Y+{AT}+2
    cpc r24, r20
    ldd r24, Y+{AT}+3
    cpc r24, r21
    brmi put_after
    cbi {EECR}, {RX_NO_NESTING}
    ldd r24, Y+{AT_TICK}
    eor r24, r22
    std Y+{AT_TICK}, r24
    ldd r24, Y+{AT_END}
    eor r24, r23
    std Y+{AT_END}, r24
    com r26
    and r24, r26
    ldd r26, Y+{HEAD}
    subi r26, -3
    ldd r27, Y+{PAGE}
    st X, r24
    ldd r18, Y+{AT}
    ldd r19, Y+{AT}+1
    ldd r20, Y+{AT}+2
    ldd r21, Y+{AT}+3
    jmp put_prepare
    // Not before the pending group's tick + spacing.
put_after:
    ldd r24, Y+{AT}
    ldd r25, Y+{AT}+1
    ldd r26, Y+{AT}+2
    ldd r27, Y+{AT}+3
    ldd r0, Y+{SPACING}
    add r24, r0
    adc r25, r1
    adc r26, r1
    adc r27, r1
    cp r18, r24
    cpc r19, r25
    cpc r20, r26
    cpc r21, r27
    brpl .+4
    movw r18, r24
    movw r20, r26
    jmp put_push

    .section .text.put_push, "ax", @progbits
    .global put_push, put_prepare, put_filler
    // Publishes the pending group, and makes this event the pending one. Before the last write the interrupt reads neither beyond the END mark nor the new group.
put_push:
    cbi {EECR}, {RX_NO_NESTING}
    std Y+{AT}, r18
    std Y+{AT}+1, r19
    std Y+{AT}+2, r20
    std Y+{AT}+3, r21
    rcall put_compare_bits
    ldd r24, Y+{END}
    or r25, r24
    ldd r24, Y+{HEAD}
    subi r24, -4
    ldd r26, Y+{START}
    cp r24, r26
    brsh .+2
    mov r24, r26
    mov r26, r24
    ldd r27, Y+{PAGE}
    st X, r25
    com r0
    and r0, r23
    subi r26, -3
    st X, r0
    ldd r26, Y+{HEAD}
    subi r26, -1
    st X+, r19
    st X, r18
    std Y+{HEAD}, r24
    subi r26, 2
    mov r30, r22
    rcall put_published_byte
    st X, r25
    std Y+{AT_TICK}, r22
    std Y+{AT_END}, r23
    // The byte with which the pending group is published if a step follows.
put_prepare:
    ldi r24, {GROUPS}
    std Y+{UNPRIMED}, r24
    ldd r30, Y+{COMPARE_BIT}
    rcall put_published_byte
    std Y+{BEFORE_STEP}, r25
    ret

    // r25: what the compare hardware and its interrupt do at r22 and r23, as bits. r0 is the bit that stands for STEP. Uses r31.
put_compare_bits:
    ldd r0, Y+{COMPARE_BIT}
    clr r25
    mov r31, r22
    and r31, r0
    breq .+2
    ori r25, {TOGGLED}
    mov r31, r23
    and r31, r0
    breq .+2
    ori r25, {END_PULSE}
    ret

    // r25: the first byte of the pending group when it is published, and followed by a group that toggles r30 at its tick. Uses r0, r30, r31.
put_published_byte:
    ldd r0, Y+{COMPARE_BIT}
    ldd r25, Y+{AT_TICK}
    tst r0
    breq 3f
    push r22
    push r23
    mov r22, r25
    ldd r23, Y+{AT_END}
    and r30, r0
    rcall put_compare_bits
    cpse r30, r1
    rjmp 1f
    ori r25, {PLAY}
    rjmp 2f
1:  ori r25, {PLAY} | {NEXT_TOGGLES}
    cp r22, r0
    brne 2f
    cp r23, r0
    brne 2f
    ldi r25, {PLAIN}
2:  ldd r30, Y+{END}
    or r25, r30
    pop r23
    pop r22
3:  ret

    // For Rust: a filler into the ring of the track r24:25, at r20 to r23.
put_filler:
    push r28
    push r29
    movw r28, r24
    movw r18, r20
    movw r20, r22
    clr r22
    clr r23
    rcall put_push
    pop r29
    pop r28
    ret

    .section .text.put_shared, "ax", @progbits
    .global put_shared, put_shared_filler
    // Puts an event of motors that share DIR lines, at r18 to r21 or later. Gives its tick. Uses Y.
put_shared:
    ldi r28, lo8(steps_stepper+{TRACK})
    ldi r29, hi8(steps_stepper+{TRACK})
    jmp put_or_join
    // A filler of motors that share DIR lines, at r18 to r21. Uses Y.
put_shared_filler:
    ldi r28, lo8(steps_stepper+{TRACK})
    ldi r29, hi8(steps_stepper+{TRACK})
    clr r22
    clr r23
    jmp put_push
    "#,
    TRACK = const offset_of!(Stepper, tracks),
    AT = const offset_of!(Track, at),
    SPACING = const offset_of!(Track, spacing),
    AT_TICK = const offset_of!(Track, ring) + offset_of!(Ring, pending),
    AT_END = const offset_of!(Track, ring) + offset_of!(Ring, pending) + 1,
    COMPARE_BIT = const offset_of!(Track, ring) + offset_of!(Ring, compare_bit),
    HEAD = const offset_of!(Track, ring) + offset_of!(Ring, head),
    PAGE = const offset_of!(Track, ring) + offset_of!(Ring, page),
    END = const offset_of!(Track, ring) + offset_of!(Ring, end),
    START = const offset_of!(Track, ring) + offset_of!(Ring, start),
    UNPRIMED = const offset_of!(Track, ring) + offset_of!(Ring, unprimed),
    BEFORE_STEP = const offset_of!(Track, ring) + offset_of!(Ring, before_step),
    FLAGS = const offset_of!(Motor, flags),
    SINGLY = const flag::SINGLY,
    PULSE = const times::PULSE,
    GROUPS = const GROUPS,
    EECR = const register::EECR,
    RX_NO_NESTING = const register::RX_NO_NESTING,
    PLAIN = const hardware::PLAIN,
    PLAY = const hardware::PLAY,
    END_PULSE = const hardware::END_PULSE,
    TOGGLED = const hardware::TOGGLED,
    NEXT_TOGGLES = const hardware::NEXT_TOGGLES,
);

unsafe extern "C" {
    fn put_filler(track: *mut Track, tick: u32);
}

impl Track {
    /// Publishes the pending group. A filler at `tick` becomes the pending one.
    #[inline(always)]
    pub(super) fn push_nothing(&mut self, tick: Tick32) {
        // SAFETY: the assembly uses this track, and its ring's groups that the interrupt does not read yet.
        unsafe { put_filler(self, tick.0) }
    }
}
