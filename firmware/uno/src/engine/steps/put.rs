//! One thing into a ring: into the pending group if it fits, else behind it.
//!
//! # Registers of the processor
//! | | |
//! |---|---|
//! | Y | the track |
//! | r18 to r21 | the tick |
//! | r22, r23 | what is toggled then, and at the end of a short pulse |
//! | X | a group |

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
    .section .text.steps_place, "ax", @progbits
    .global steps_place
    // One thing that the motor r14:15 does, as the plan says it, into the ring of the track r16:17. Keeps Y, which is that motor, r2 to r17.
steps_place:
    movw r28, r16
    push r24
    // The moment near the pending group's that has these lower bits.
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
    call put_here
    // If that is another, what follows must be looked at until all is in time again.
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
    // The end of a long pulse.
    lds r24, steps_times+{PULSE}
    lds r25, steps_times+{PULSE}+1
    add r18, r24
    adc r19, r25
    adc r20, r1
    adc r21, r1
    clr r23
    call put_here
3:  movw r28, r14
    ret

    .section .text.steps_put, "ax", @progbits
    .global put_here
    // Into the ring of the track Y, from r18 to r21 on. Gives its tick.
put_here:
    ldd r24, Y+{RISE}
    and r24, r22
    ldd r25, Y+{FALL}
    and r25, r23
    or r24, r25
    // An edge of the compare hardware needs a group of its own.
    mov r25, r22
    or r25, r23
    ldd r26, Y+{EDGE}
    and r25, r26
    or r24, r25
    brne put_behind
    ldd r24, Y+{AT}
    cp r24, r18
    ldd r24, Y+{AT}+1
    cpc r24, r19
    ldd r24, Y+{AT}+2
    cpc r24, r20
    ldd r24, Y+{AT}+3
    cpc r24, r21
    brmi put_behind
    cbi {EECR}, {AT_ONCE}
    ldd r24, Y+{RISE}
    eor r24, r22
    std Y+{RISE}, r24
    ldd r24, Y+{FALL}
    eor r24, r23
    std Y+{FALL}, r24
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
    // As soon as can be.
put_behind:
    ldd r24, Y+{AT}
    ldd r25, Y+{AT}+1
    ldd r26, Y+{AT}+2
    ldd r27, Y+{AT}+3
    ldd r0, Y+{APART}
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

    .section .text.steps_push, "ax", @progbits
    .global put_push, put_prepare, steps_push_nothing
    // The pending group is published: the interrupt reads neither beyond its END nor the group after it before the last write.
put_push:
    cbi {EECR}, {AT_ONCE}
    std Y+{AT}, r18
    std Y+{AT}+1, r19
    std Y+{AT}+2, r20
    std Y+{AT}+3, r21
    rcall put_bits
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
    rcall put_played
    st X, r25
    std Y+{RISE}, r22
    std Y+{FALL}, r23
    // What is published of the pending group once a step follows it.
put_prepare:
    ldi r24, {GROUPS}
    std Y+{UNLIKE}, r24
    ldd r30, Y+{EDGE}
    rcall put_played
    std Y+{BEFORE_STEP}, r25
    ret

    // What the compare hardware and its interrupt do with r22 and r23: r25; r0 is the hardware's bit. Uses r31.
put_bits:
    ldd r0, Y+{EDGE}
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

    // The pending group's first byte when it is played and followed by one whose rise is r30: r25. Uses r0, r30, r31.
put_played:
    ldd r0, Y+{EDGE}
    ldd r25, Y+{RISE}
    tst r0
    breq 3f
    push r22
    push r23
    mov r22, r25
    ldd r23, Y+{FALL}
    and r30, r0
    rcall put_bits
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

    // For Rust: nothing in the ring of the track r24:25, at r20 to r23.
steps_push_nothing:
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

    .section .text.steps_put_shared, "ax", @progbits
    .global steps_put, steps_push_filler
    // Into the ring of motors that share DIR lines, from r18 to r21 on. Gives its tick. Y is used.
steps_put:
    ldi r28, lo8(steps_stepper+{TRACK})
    ldi r29, hi8(steps_stepper+{TRACK})
    jmp put_here
    // A filler of motors that share DIR lines, at r18 to r21. Y is used.
steps_push_filler:
    ldi r28, lo8(steps_stepper+{TRACK})
    ldi r29, hi8(steps_stepper+{TRACK})
    clr r22
    clr r23
    jmp put_push
    "#,
    TRACK = const offset_of!(Stepper, tracks),
    AT = const offset_of!(Track, at),
    APART = const offset_of!(Track, apart),
    RISE = const offset_of!(Track, ring) + offset_of!(Ring, pending),
    FALL = const offset_of!(Track, ring) + offset_of!(Ring, pending) + 1,
    EDGE = const offset_of!(Track, ring) + offset_of!(Ring, edge),
    HEAD = const offset_of!(Track, ring) + offset_of!(Ring, head),
    PAGE = const offset_of!(Track, ring) + offset_of!(Ring, page),
    END = const offset_of!(Track, ring) + offset_of!(Ring, end),
    START = const offset_of!(Track, ring) + offset_of!(Ring, start),
    UNLIKE = const offset_of!(Track, ring) + offset_of!(Ring, unlike),
    BEFORE_STEP = const offset_of!(Track, ring) + offset_of!(Ring, before_step),
    FLAGS = const offset_of!(Motor, flags),
    SINGLY = const flag::SINGLY,
    PULSE = const times::PULSE,
    GROUPS = const GROUPS,
    EECR = const register::EECR,
    AT_ONCE = const register::AT_ONCE,
    PLAIN = const hardware::PLAIN,
    PLAY = const hardware::PLAY,
    END_PULSE = const hardware::END_PULSE,
    TOGGLED = const hardware::TOGGLED,
    NEXT_TOGGLES = const hardware::NEXT_TOGGLES,
);

unsafe extern "C" {
    fn steps_push_nothing(track: *mut Track, tick: u32);
}

impl Track {
    /// Publishes the pending group; one that does nothing at `tick` is the pending one then.
    #[inline(always)]
    pub(super) fn push_nothing(&mut self, tick: Tick32) {
        // SAFETY: the assembly uses this track, and its ring's groups that the interrupt does not read yet.
        unsafe { steps_push_nothing(self, tick.0) }
    }
}
