//! The interrupt vectors, and what runs before main.
//!
//! Unused vectors are never enabled, so that their room is free. The receive interrupt starts at its vector and goes on over those that follow, which
//! saves a jump.

use crate::engine::link::{self, receive_interrupt};
use crate::engine::steps::register;
use crate::engine::steps::ring::flags;
use core::arch::global_asm;

// Four bytes each (DS40002061B §12.4). A short jump takes 2 cycles; the linker fails if it does not reach.
global_asm!(
    r#"
    .section .vectors, "ax", @progbits
    .global __vectors
__vectors:
    jmp __init
    .org 4 * 6
    jmp wdt                             // WDT
    .org 4 * 11
    rjmp timer1_compa                   // TIMER1_COMPA
    .org 4 * 12
    sbic {FLAGS}, {B_ON_PORTD}          // TIMER1_COMPB: 2 (skips)
    rjmp timer1_compb_portd
    rjmp timer1_compb
    .org 4 * 16
    push r24                            // TIMER0_OVF: 4 response, 2     6
    rjmp timer0_ovf                     // 2                             8
    "#,
    FLAGS = const register::GPIOR0,
    B_ON_PORTD = const flags::B_ON_PORTD,
);

global_asm!(
    r#"
    .section .vectors
    .org 4 * 18
    .global usart_rx
usart_rx:
    "#,
    receive_interrupt!(),
    HEAD = const register::EEARL,
    SREG = const register::SREG,
    ON = const link::ON,
    ON_WITH_INTERRUPT = const link::ON_WITH_INTERRUPT,
    PAGE = const link::PAGE,
    PAGE_BIT = const link::PAGE.trailing_zeros(),
    UCSR0A = const 0xc0,
    UCSR0B = const 0xc1,
    UDR0 = const 0xc6,
    OVERRUN = const 3,
    EECR = const register::EECR,
    RX_NO_NESTING = const register::RX_NO_NESTING,
    SAVE24 = const register::GPIOR1,
    SAVE30 = const register::GPIOR2,
    SAVE31 = const register::EEDR,
);

// libgcc's `__do_copy_data` and `__do_clear_bss` are in the sections .init4, between .init2 and .init9.
global_asm!(
    r#"
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
