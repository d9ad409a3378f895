//! A run's steps, one word each: what `pulsetrain_core::pio::expand` does, in 75 or 91 cycles for eight steps that need no check,
//! as none of them can be too soon or too late, and in 35 cycles for two that need it.

use core::arch::global_asm;
use pulsetrain_core::Recurrence;
use pulsetrain_core::pio::{Stretch, Unchecked, unchecked_steps};

// In: r0 the recurrence, r1 the first word, r2 the end of the words, r3 the stretch. Out: r0 the end of what was written.
// The accumulator's fraction and its ticks are added separately: what the fraction carries over goes into the step's ticks.
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

// In: r0 the recurrence, r1 the first word, r2 the end of the words, after it, r3 the bits less the gap, on the stack whether the
// upper half of add stays as it is in all steps: then a step takes two instructions fewer. Out: r0 ticks that passed. It begins in
// the middle of eight steps, so that the last of them is the last word.
global_asm!(
    r#"
    .section .text.expand_unchecked, "ax", %progbits
    .global expand_unchecked
    .type expand_unchecked, %function
    .thumb_func
expand_unchecked:
    push {{r4-r7, lr}}
    mov r4, r8
    mov r5, r9
    push {{r0, r4, r5}}
    mov r12, r3
    mov lr, r2
    mov r6, r1                  @ where the next word goes
    subs r4, r2, r1
    lsrs r4, r4, #2             @ words
    muls r3, r4
    negs r3, r3
    mov r9, r3                  @ the sum of all words, less what is no ticks in them
    negs r4, r4
    movs r5, #7
    ands r4, r5                 @ steps to be left out
    ldr r1, [sp, #32]
    cmp r1, #0
    bne 3f
    movs r5, #20                @ bytes of a step
    muls r4, r5
    adr r1, 1f
    b 4f
3:  lsls r4, r4, #4             @ 16 if the upper half of add stays
    adr r1, 2f
4:  adds r1, r4
    adds r1, #1                 @ Thumb
    ldr r7, [r0, #28]
    mov r8, r7
    ldr r7, [r0, #24]           @ add2
    ldr r2, [r0, #8]            @ interval
    ldr r3, [r0, #12]
    ldr r4, [r0, #16]           @ add
    ldr r5, [r0, #20]
    ldr r0, [r0]                @ the accumulator's fraction
    bx r1
    .balign 4
1:
    .rept 8
    adds r0, r2                 @ 1
    mov r1, r12                 @ 2: the carry stays
    adcs r1, r3                 @ 3: the word
    add r9, r1                  @ 4
    stmia r6!, {{r1}}           @ 6
    adds r2, r4                 @ 7
    adcs r3, r5                 @ 8
    adds r4, r7                 @ 9
    mov r1, r8                  @ 10: the carry stays
    adcs r5, r1                 @ 11
    .endr
    cmp r6, lr                  @ 89
    bne 1b                      @ 91
    b 5f
    .balign 4
2:
    .rept 8
    adds r0, r2                 @ 1
    mov r1, r12                 @ 2
    adcs r1, r3                 @ 3
    add r9, r1                  @ 4
    stmia r6!, {{r1}}           @ 6
    adds r2, r4                 @ 7
    adcs r3, r5                 @ 8
    adds r4, r7                 @ 9: the upper half stays
    .endr
    cmp r6, lr                  @ 73
    bne 2b                      @ 75
5:  pop {{r1}}
    str r0, [r1]
    str r2, [r1, #8]
    str r3, [r1, #12]
    str r4, [r1, #16]
    str r5, [r1, #20]
    ldr r3, [r1, #4]
    mov r0, r9
    adds r3, r0
    str r3, [r1, #4]
    pop {{r4, r5}}
    mov r8, r4
    mov r9, r5
    pop {{r4-r7, pc}}
    .size expand_unchecked, . - expand_unchecked
    "#
);

unsafe extern "C" {
    fn expand_unchecked(
        recurrence: *mut Recurrence,
        words: *mut u32,
        end: *mut u32,
        offset: u32,
        upper_stays: u32,
    ) -> u32;
    fn expand_steps(recurrence: *mut Recurrence, words: *mut u32, end: *mut u32, stretch: *const Stretch) -> *mut u32;
}

/// As [`pulsetrain_core::pio::expand`], for 32 fraction bits.
///
/// Not inlined, so that its loop has all registers.
#[inline(never)]
pub(crate) fn expand(recurrence: &mut Recurrence, words: &mut [u32], stretch: &Stretch) -> u32 {
    if words.is_empty() {
        return 0;
    }
    let Unchecked { count, small_add } = unchecked_steps(recurrence, stretch, words.len() as u32);
    let core::ops::Range { mut start, end } = words.as_mut_ptr_range();
    let mut rest = *stretch;
    if count != 0 {
        let offset = stretch.bits.wrapping_sub(stretch.gap);
        // SAFETY: `count` is at most the number of words.
        let next = unsafe { start.add(count as usize) };
        // SAFETY: it writes words from `start` on up to `next`; the recurrence is laid out as in C.
        rest.ticks -= unsafe { expand_unchecked(recurrence, start, next, offset, small_add.into()) };
        start = next;
    }
    if start == end {
        return count;
    }
    // SAFETY: it writes words from `start` on, at least one and none at `end` or after it; both types are laid out as in C.
    let next = unsafe { expand_steps(recurrence, start, end, &rest) };
    count + ((next as u32 - start as u32) >> 2)
}
