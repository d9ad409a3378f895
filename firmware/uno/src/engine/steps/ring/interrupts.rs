//! The step interrupts, TIMER1_COMPA and TIMER1_COMPB. **They make the edges.**
//!
//! Compare match A plays ring A: on PORTD (`Kind::PortD`), on PORTD and PB4, PB5 as bits 0 and 1 (`Kind::Shield`), or on pin 9, which the hardware
//! toggles (`Kind::Compare`). Compare match B plays ring B: on PORTB, on pin 10, which the hardware toggles, on PORTD (`Kind::PortDTwoRings`), or on PORTB
//! as ring B of the shield (`Kind::ShieldTwoRings`).
//!
//! On the shield ring A has the groups of three motors, which must not wait for long. So ring B's interrupt makes its edge, looks whether match A waits,
//! and if so lets it in before it goes on. Nobody else comes in, because match A ranks before the receive and the refill interrupt. Ring B's own match
//! cannot come again, because its compare register still has a past tick. If ring A ran empty, match A may be flagged while its interrupt is
//! disabled, and the refill interrupt comes in. It sees where it came from, and returns at once ([`refill`](crate::engine::steps::refill)).
//!
//! The interrupts save registers in I/O registers that nothing else uses. No instruction changes a flag, so SREG need not be saved:
//!
//! | register | holds |
//! |---|---|
//! | GPIOR0 | [`flags`], bit-addressable |
//! | GPIOR1, GPIOR2, EEDR | r24, r30, r31 of the interrupted program (restored before another interrupt is let in); the receive interrupt uses them too |
//! | EEARH | page of ring B: 3; or 2, when there is no ring A |
//! | OCR0A, OCR0B | low byte of the address of the next group to play, ring A and ring B |
//!
//! # Cycles
//! From the match to the end, with 4 for the response and 3 for the way of an edge to the pin and the vector's jump (§7.7.1, §14.2.4). Ring B's vector
//! takes 1 or 2 more, to tell the ports apart:
//!
//! | kind | to the rising edge | pulse | total |
//! |---|---|---|---|
//! | PORTD | 17 | 16 (1.0 µs) | 38 |
//! | the same by ring B | 18 | 16 | 39 |
//! | PORTB | 19 | 16 | 40 |
//! | PORTD, stretched | 17 | 31 (1.94 µs) | 53 |
//! | PORTB, stretched | 19 | 31 | 55 |
//! | shield | 17, PB4 26 | 24 or 25, PB4 19 (1.19 µs) | 50 to 53 |
//! | shield, stretched | the same | 36 or 37, PB4 31 | 62 to 65 |
//! | compare, a plain step | by the hardware | 35 (2.19 µs) | 40 |
//! | compare, another group | by the hardware | 46 | 67; toggling is switched after 54 |
//! | ring B of the shield | 19 | 25 (1.6 µs) | 49 |
//! | the same, match A waits | 19 | 73 (4.6 µs) | 97: 30 until match A is let in, its 37, and 30 |

use super::{END_B_ON_PORTD, SHORT_RING_START, flags};
use crate::engine::steps::register;
use core::arch::global_asm;

// The interrupt of one ring: `\vector` is its name, `\pin` its PINx, `\ocr` OCR1xL, `\tail` where the tail is kept. The macro makes both interrupts, which
// differ in names, and in the shield's extra pins.
global_asm!(
    r#"
    .macro ring_interrupt vector, load_page, tail, pin, ocr, end_bit, not_plain, underrun, com_mask, com_toggle, foc, dir_on_portb, enable_mask, output
    .global \vector
\vector:                                // 4 response + 3 jump           7
    out {SAVE24}, r24                   // 1                             8
    out {SAVE30}, r30                   // 1                             9
    out {SAVE31}, r31                   // 1                            10
    in r30, \tail                       // 1                            11
    \load_page                          // 1                            12
    ld r24, Z+                          // 2                            14
    sbrc r24, \end_bit                  // 2 (skips)                    16
    rjmp 1f
    out \pin, r24                       // 1  the rising edge           17
    sbic {FLAGS}, \not_plain            // 2 (skips)                    19
    rjmp 5f
    ld r24, Z+                          // 2                            21
    sts \ocr+1, r24                     // 2                            23
    ld r24, Z+                          // 2                            25
    sts \ocr, r24                       // 2                            27
    ld r24, Z+                          // 2                            29
    out \tail, r30                      // 1                            30
    in r30, {SAVE30}                    // 1                            31
    in r31, {SAVE31}                    // 1                            32
    out \pin, r24                       // 1  the falling edge: 17 + 16 33
    in r24, {SAVE24}                    // 1                            34
    reti                                // 4                            38

    // END, or a group of the compare hardware                sbrc 1 + rjmp 2: 17
1:  sbrs r24, 6                         // 2 (skips)                    19
    rjmp 2f
    ld r24, Z+                          // 2                            21
    sts \ocr+1, r24                     // 2                            23
    ld r24, Z+                          // 2                            25
    sts \ocr, r24                       // 2                            27
    ld r24, Z+                          // 2                            29
    out \tail, r30                      // 1                            30
    in r30, {SAVE30}                    // 1                            31
    in r31, {SAVE31}                    // 1                            32
    ldi r24, \foc                       // 1                            33
    sts {TCCR1C}, r24                   // 2  the falling edge          35
    in r24, {SAVE24}                    // 1                            36
    reti                                // 4                            40

    // Other groups of the compare hardware, and END. They are rare, so flags and r25 go onto the stack.
2:  push r25
    in r25, {SREG}
    push r25
    mov r25, r24
    sbrs r25, 5
    rjmp 4f
    ld r24, Z+
    sts \ocr+1, r24
    ld r24, Z+
    sts \ocr, r24
    ld r24, Z+
    out \tail, r30
    sbis {FLAGS}, \dir_on_portb
    out {PIND}, r24
    sbic {FLAGS}, \dir_on_portb
    out {PINB}, r24
    ldi r24, \foc
    sbrc r25, 4
    sts {TCCR1C}, r24
    lds r24, {TCCR1A}
    andi r24, \com_mask
    sbrc r25, 0
    ori r24, \com_toggle
    sts {TCCR1A}, r24
3:  pop r25
    out {SREG}, r25
    pop r25
    in r24, {SAVE24}
    in r30, {SAVE30}
    in r31, {SAVE31}
    reti

    // END: disables this interrupt, and the hardware toggles no more.
4:  ldi r24, \foc
    sbrc r25, 4
    sts {TCCR1C}, r24
    // A long pulse that has begun goes on: the port takes over its level.
    sbrs r25, 3
    rjmp 8f
    sbic {PINB}, \output
    sbi {PORTB}, \output
8:
    lds r24, {TCCR1A}
    andi r24, \com_mask
    sts {TCCR1A}, r24
    lds r24, {TIMSK1}
    andi r24, \enable_mask
    sts {TIMSK1}, r24
    sbi {FLAGS}, \underrun
    rjmp 3b
    .endm

    // The stretched pulse, 1.9 us                            sbic 1 + rjmp 2: 20
    .macro stretched_pulse tail, pin, ocr
    ld r24, Z+                          // 2                            22
    sts \ocr+1, r24                     // 2                            24
    ld r24, Z+                          // 2                            26
    sts \ocr, r24                       // 2                            28
    ld r24, Z+                          // 2                            30
    out \tail, r30                      // 1                            31
    in r30, {SAVE30}                    // 1                            32
    in r31, {SAVE31}                    // 1                            33
    .endm

    .macro wait cycles
    .rept \cycles / 2
    rjmp .+0
    .endr
    .rept \cycles % 2
    nop
    .endr
    .endm

    // This section comes first in the flash, so that the short jumps of the vectors reach it.
    .text
    ring_interrupt timer1_compa, "ldi r31, hi8(ring_a_page)", {TAIL_A}, {PIND}, {OCR1A}, 1, {NOT_PLAIN_A}, {UNDERRUN_A}, 0x3f, 0x40, 0x80, {DIR_A_ON_PORTB}, 0xfd, 1
5:  sbic {FLAGS}, {SHIELD}              // 2 (skips)                    22
    rjmp 6f
    stretched_pulse {TAIL_A}, {PIND}, {OCR1A} // 13                          35
    wait 12                             // 12                           47
    out {PIND}, r24                     // 1  17 + 31                   48
    in r24, {SAVE24}                    // 1                            49
    reti                                // 4                            53

    // The shield: bit 0 is PB4, bit 1 is PB5 (at the end only).   sbic 1 + rjmp 2: 23
6:  sbrc r24, 0                         // 2 (skips), 1 if set
    sbi {PINB}, 4                       // 2 if set                     25 or 26
    stretched_pulse {TAIL_A}, {PIND}, {OCR1A} // 13                          38 or 39
    sbic {FLAGS}, {SHIELD_STRETCHED}    // 2 (skips), 1 if set          40 or 41
    rjmp 8f
7:  out {PIND}, r24                     // 1                            41 or 42
    sbrc r24, 0                         // 2 (skips), 1 if set
    sbi {PINB}, 4                       // 2 if set                     43 to 45
    sbrc r24, 1                         // 2 (skips), 1 if set
    sbi {PINB}, 5                       // 2 if set                     45 to 48
    in r24, {SAVE24}                    // 1                            46 to 49
    reti                                // 4                            50 to 53
8:  wait 9                              // 9 + sbic 1 + rjmp 2 + rjmp 2 = 14, 12 more than the skip:
    rjmp 7b                             // PB4 is high for 57 - 26 = 31 cycles, PORTD for 37 at most

    ring_interrupt timer1_compb, "in r31, {PAGE_B}", {TAIL_B}, {PINB}, {OCR1B}, 7, {NOT_PLAIN_B}, {UNDERRUN_B}, 0xcf, 0x10, 0x40, {DIR_B_ON_PORTB}, 0xfb, 2
5:
    sbic {FLAGS}, {SHIELD_B}            // 2 (skips), 1 and 2           23 or 24
    rjmp 6f
    stretched_pulse {TAIL_B}, {PINB}, {OCR1B} // 13                          33
    wait 14                             // 14                           47
    out {PINB}, r24                     // 1                            48
    in r24, {SAVE24}                    // 1                            49
    reti                                // 4                            53

    // Ring B of the shield. If match A waits already, it goes first. Of what was done so far only the edge counts then; all else is done again.
6:  sbis {TIFR1}, 1                     // 2 (skips), 1 and 2           26 or 27
    rjmp 7f
    in r24, {SAVE24}                    // 1                            27
    in r30, {SAVE30}                    // 1                            28
    sei                                 // 1                            29
    in r31, {SAVE31}                    // 1                            30
    .global timer1_compb_window
timer1_compb_window:                    // match A is played here
    cli
    out {SAVE24}, r24
    out {SAVE30}, r30
    out {SAVE31}, r31
    in r30, {TAIL_B}
    in r31, {PAGE_B}
    ld r24, Z+
7:  ld r24, Z+                          // 2                            29
    sts {OCR1B}+1, r24                  // 2                            31
    ld r24, Z+                          // 2                            33
    sts {OCR1B}, r24                    // 2                            35
    ld r24, Z+                          // 2                            37
    sbrs r30, 7                         // 2, or 1 and 1                39
    ldi r30, {START}
    out {TAIL_B}, r30                   // 1                            40
    in r30, {SAVE30}                    // 1                            41
    in r31, {SAVE31}                    // 1                            42
    out {PINB}, r24                     // 1  the falling edge          43
    in r24, {SAVE24}                    // 1                            44
    reti                                // 4                            48

    // Ring B on PORTD: the short pulse only.
    .global timer1_compb_portd
timer1_compb_portd:                     // as the others, and 1            8
    out {SAVE24}, r24                   // 1                             9
    out {SAVE30}, r30                   // 1                             10
    out {SAVE31}, r31                   // 1                            11
    in r30, {TAIL_B}                    // 1                            12
    in r31, {PAGE_B}                    // 1                            13
    ld r24, Z+                          // 2                            15
    sbrc r24, {END_ON_PORTD}            // 2 (skips)                    17
    rjmp 2b
    out {PIND}, r24                     // 1  the rising edge           18
    ld r24, Z+                          // 2                            20
    sts {OCR1B}+1, r24                  // 2                            22
    ld r24, Z+                          // 2                            24
    sts {OCR1B}, r24                    // 2                            26
    ld r24, Z+                          // 2                            28
    out {TAIL_B}, r30                   // 1                            29
    in r30, {SAVE30}                    // 1                            30
    in r31, {SAVE31}                    // 1                            31
    wait 2                              // 2                            33
    out {PIND}, r24                     // 1  the falling edge: 18 + 16 34
    in r24, {SAVE24}                    // 1                            35
    reti                                // 4                            39
    "#,
    SAVE24 = const register::GPIOR1,
    SAVE30 = const register::GPIOR2,
    SAVE31 = const register::EEDR,
    PAGE_B = const register::EEARH,
    TAIL_A = const register::OCR0A,
    TAIL_B = const register::OCR0B,
    FLAGS = const register::GPIOR0,
    PIND = const register::PIND,
    PINB = const register::PINB,
    PORTB = const register::PORTB,
    SREG = const register::SREG,
    OCR1A = const register::OCR1A,
    OCR1B = const register::OCR1B,
    TCCR1A = const register::TCCR1A,
    TCCR1C = const register::TCCR1C,
    TIMSK1 = const register::TIMSK1,
    NOT_PLAIN_A = const flags::NOT_PLAIN_A,
    NOT_PLAIN_B = const flags::NOT_PLAIN_B,
    SHIELD = const flags::SHIELD,
    SHIELD_STRETCHED = const flags::SHIELD_STRETCHED,
    UNDERRUN_A = const flags::UNDERRUN_A,
    UNDERRUN_B = const flags::UNDERRUN_B,
    DIR_A_ON_PORTB = const flags::DIR_A_ON_PORTB,
    DIR_B_ON_PORTB = const flags::DIR_B_ON_PORTB,
    END_ON_PORTD = const END_B_ON_PORTD.trailing_zeros(),
    SHIELD_B = const flags::SHIELD_B,
    START = const SHORT_RING_START,
    TIFR1 = const register::TIFR1,
);
