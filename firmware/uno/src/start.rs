//! The interrupt vectors and what comes before main.
//!
//! Vectors that are not used are never enabled, so that there is room between the others: the receive interrupt is where its
//! vector is, and over those that follow.

use core::arch::global_asm;

// Four bytes each (DS40002061B §12.4). `__do_copy_data` and `__do_clear_bss`, libgcc's, are in the sections .init4 between
// .init2 and .init9. The macro is link.rs's.
global_asm!(
    r#"
    .section .vectors, "ax", @progbits
    .global __vectors
__vectors:
    jmp __init
    .org 4 * 6
    jmp __vector_6                      // WDT
    .org 4 * 7
    jmp steps_task                      // TIMER2_COMPA
    .org 4 * 11
    jmp __vector_11                     // TIMER1_COMPA
    .org 4 * 12
    jmp __vector_12                     // TIMER1_COMPB
    .org 4 * 18
    .global __vector_18
__vector_18:
    receive_interrupt                   // USART_RX

    .section .init2, "ax", @progbits
    .global __init
__init:
    clr r1
    out 0x3f, r1
    ldi r28, lo8(0x8ff)
    ldi r29, hi8(0x8ff)
    out 0x3e, r29
    out 0x3d, r28

    .section .init9, "ax", @progbits
    jmp main
    "#
);
