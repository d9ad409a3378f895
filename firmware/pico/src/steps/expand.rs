//! A run's steps, one word each: what `pulsetrain_core::words::expand` does, in 35 cycles for two steps.

use core::arch::global_asm;
use pulsetrain_core::Recurrence;
use pulsetrain_core::words::Stretch;

// In: r0 the recurrence, r1 the first word, r2 the end of the words, r3 the stretch. Out: r0 the end of what was written.
// Ticks and fraction of the accumulator are added up apart: what the fraction carries over is a step's ticks.
global_asm!(
    r#"
    .section .text.expand_steps, "ax", %progbits
    .global expand_steps
    .type expand_steps, %function
    .thumb_func
expand_steps:
    push {{r4-r7, lr}}
    mov r4, r8
    mov r5, r9
    mov r6, r10
    mov r7, r11
    push {{r3-r7}}
    mov r10, r0
    mov r6, r1                  @ where the next word goes
    mov lr, r2
    ldm r3!, {{r4, r7}}         @ r7: ticks left
    mov r11, r4                 @ the gap
    ldr r5, [r3]
    subs r5, r4
    mov r12, r5                 @ bits less gap
    ldr r4, [r0, #24]
    mov r8, r4                  @ add2
    ldr r4, [r0, #28]
    mov r9, r4
    ldr r2, [r0, #8]            @ interval
    ldr r3, [r0, #12]
    ldr r4, [r0, #16]           @ add
    ldr r5, [r0, #20]
    ldr r0, [r0]                @ the accumulator's fraction
    mov r1, lr
    subs r1, r6
    lsls r1, r1, #29            @ an odd number begins in the middle
    bmi 5f
1:  adds r0, r2                 @ 1
    movs r1, #0                 @ 2: the carry stays
    adcs r1, r3                 @ 3: ticks of this step
    cmp r1, r11                 @ 4
    blo 3f                      @ 5
    subs r7, r1                 @ 6: also below 0 if the ticks are
    bls 2f                      @ 7
    adds r2, r4                 @ 8
    adcs r3, r5                 @ 9
    add r1, r12                 @ 10
    stmia r6!, {{r1}}           @ 12
    mov r1, r8                  @ 13: the flags stay
    adds r4, r1                 @ 14
    mov r1, r9                  @ 15
    adcs r5, r1                 @ 16
5:  adds r0, r2                 @ 17, and so on
    movs r1, #0
    adcs r1, r3
    cmp r1, r11
    blo 3f
    subs r7, r1
    bls 2f
    adds r2, r4
    adcs r3, r5
    add r1, r12
    stmia r6!, {{r1}}
    mov r1, r8
    adds r4, r1
    mov r1, r9
    adcs r5, r1
    cmp r6, lr                  @ 33
    bne 1b                      @ 35
    b 4f
2:  adds r7, r1
3:  subs r0, r2
4:  mov r1, r10
    str r0, [r1]
    str r2, [r1, #8]
    str r3, [r1, #12]
    str r4, [r1, #16]
    str r5, [r1, #20]
    pop {{r3}}
    ldr r2, [r3, #4]
    subs r2, r7                 @ ticks that passed
    ldr r3, [r1, #4]
    adds r3, r2
    str r3, [r1, #4]
    mov r0, r6
    pop {{r4-r7}}
    mov r8, r4
    mov r9, r5
    mov r10, r6
    mov r11, r7
    pop {{r4-r7, pc}}
    .size expand_steps, . - expand_steps
    "#
);

unsafe extern "C" {
    fn expand_steps(recurrence: *mut Recurrence, words: *mut u32, end: *mut u32, stretch: *const Stretch) -> *mut u32;
}

/// As [`pulsetrain_core::words::expand`], for 32 fraction bits.
pub(crate) fn expand(recurrence: &mut Recurrence, words: &mut [u32], stretch: &Stretch) -> u32 {
    if words.is_empty() {
        return 0;
    }
    let core::ops::Range { start, end } = words.as_mut_ptr_range();
    // SAFETY: it writes words from `start` on, at least one and none at `end` or after it; both types are laid out as in C.
    let next = unsafe { expand_steps(recurrence, start, end, stretch) };
    (next as u32 - start as u32) >> 2
}
