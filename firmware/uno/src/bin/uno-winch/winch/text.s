; Lines from the host to commands: pulsetrain_core::winch::text::Reader, which says what each line means. To the same
; answers: crates/board/tests/it/chips/winch_avr.rs compares them.
;
;   u16 winch_listen(Reader *r24, const u8 *r22, u8 r20)
;
; Takes bytes from the receive page, r20 at most from r22 on, up to the end of a line or a zero. r24: 0, nothing yet; 0x80 + Verb,
; a command; 0x40, a zero; else the What of a refused line. r25: bytes that were not taken.
;
; Reader as it lies in memory:
;    0 bit 0 strict, bit 1 over, bit 2 checked      1 len      2 star      3 words      4 what      5 word
;    6 verb      7 axes      8 given      9 values, 4 of 4 bytes      25 the line, 81 bytes
;
; While a line is read:
;   X        the cursor
;   r16      verb, and 0x10 if its numbers are decimals: 0x15 is g, 0x16 l
;   r13      values that are wanted
;   r17      values so far               r14:15  the flags that are left
;   r18-r21  a number's digits           r22  its power of ten       r23  bit 0 minus, bit 1 point, bit 2 digits

.section .text.winch, "ax", @progbits
.global winch_listen
winch_listen:
    push r28
    push r29
    movw r28, r24
    movw r30, r22
    ldd r24, Y+0
    sbrs r24, 1
    rjmp 1f
    andi r24, 0xfd
    std Y+0, r24
    std Y+1, r1
    std Y+2, r1
    std Y+3, r1
    std Y+4, r1
1:
    ldd r21, Y+1
    ldd r18, Y+2
    movw r26, r28
    adiw r26, 25
    add r26, r21
    adc r27, r1
    ldi r19, 0x20
    cpse r21, r1
    ld r19, -X
    cpse r21, r1
    adiw r26, 1

; A byte. Most bytes are between + and ~, and not the first of a word.
2:
    subi r20, 1
    brcs 8f
    ld r22, Z+
    andi r30, 0x7f
    cpi r22, 0x2b
    brlo 4f
    cpi r22, 0x7f
    brsh 4f
    cpi r19, 0x21
    brlo 13f
23:
    cpi r21, 80
    breq 7f
3:
    st X+, r22
    inc r21
    mov r19, r22
    rjmp 2b

4:
    cpi r22, 0x20
    breq 23b
    tst r22
    breq 10f
    cpi r22, 10
    breq 9f
    cpi r22, 13
    breq 9f
    cpi r21, 80
    breq 7f
    cpi r22, 0x2a
    brne 5f
    tst r18
    brne 5f
    mov r18, r21
    inc r18

; A word begins after a blank, unless it is the checksum.
5:
    mov r24, r22
    rcall winch_is_blank
    breq 3b
14:
    tst r18
    brne 6f
    cpi r19, 0x20
    breq 15f
    cpi r19, 9
    brne 6f
15:
    ldd r24, Y+3
    inc r24
    std Y+3, r24
    cpi r24, 11
    brlo 6f
    ldi r25, 13                 ; Words
    rcall winch_refuse
6:
    mov r24, r22
    subi r24, 0x21
    cpi r24, 0x5e
    brlo 3b
    ldi r25, 8                  ; Noise
    rcall winch_refuse
    rjmp 3b
13:
    cpi r21, 80
    brne 14b
7:
    ldi r25, 7                  ; Long
    rcall winch_refuse
    rjmp 2b

; No more bytes.
8:
    std Y+1, r21
    std Y+2, r18
    clr r20
    clr r24
    rjmp 20f

; A zero: what came before is not a line.
10:
    ldd r24, Y+0
    ori r24, 2
    std Y+0, r24
    ldi r24, 0x40
    rjmp 20f

; The line is complete. Blanks at its end do not belong to it.
9:
    subi r21, 1
    brcs 24f
    ld r24, -X
    rcall winch_is_blank
    breq 9b
    adiw r26, 1
24:
    inc r21
    std Y+1, r21
    std Y+2, r18
    push r20
    ldd r24, Y+0
    ori r24, 2
    std Y+0, r24
    st X, r1
    ldd r25, Y+2
    cpse r25, r1
    rjmp 22f
    andi r24, 5                 ; Strict, and there was a checksum before: a line that is not blank needs one
    cpi r24, 5
    brne 16f
    ldd r24, Y+3
    tst r24
    breq 16f
    rjmp 12f
22:
    movw r26, r28
    adiw r26, 25
    clr r22
    mov r23, r25
21:
    dec r23
    breq 11f
    ld r24, X+
    eor r22, r24
    rjmp 21b
11:
    st X+, r1
    ldd r24, Y+1
    sub r24, r25
    cpi r24, 2
    brne 12f
    rcall winch_hex
    brcc 12f
    swap r24
    eor r22, r24
    rcall winch_hex
    brcc 12f
    eor r22, r24
    brne 12f
    ldd r24, Y+0
    ori r24, 4
    std Y+0, r24
    rjmp 16f
12:
    ldd r24, Y+4
    cpi r24, 7
    breq 16f
    std Y+4, r1
    ldi r25, 9                  ; Checksum
    rcall winch_refuse
16:
    ldd r24, Y+4
    tst r24
    brne 19f
    ldd r24, Y+3
    tst r24
    breq 19f
    push r13
    push r14
    push r15
    push r16
    push r17
    rcall winch_read
    mov r25, r24
    rcall winch_refuse
    mov r24, r25
    tst r24
    brne 18f
    ldd r24, Y+6
    ori r24, 0x80
18:
    pop r17
    pop r16
    pop r15
    pop r14
    pop r13
19:
    pop r20
20:
    mov r25, r20
    pop r29
    pop r28
    ret

; Notes r25 as the error of the line, at the present word, unless there is one already.
winch_refuse:
    ldd r24, Y+4
    tst r24
    brne 1f
    std Y+4, r25
    ldd r24, Y+3
    std Y+5, r24
1:
    ret

; Z: r24 is 0 or a blank.
winch_is_end:
    tst r24
    breq 1f
winch_is_blank:
    cpi r24, 0x20
    breq 1f
    cpi r24, 9
1:
    ret

; A hexadecimal digit, r24, from X on; carry: it is one.
winch_hex:
    ld r24, X+
    subi r24, 0x30
    cpi r24, 10
    brcs 1f
    subi r24, 0x11
    andi r24, 0xdf
    cpi r24, 6
    brcc 1f
    subi r24, 0xf6
    sec
1:
    ret

; The cursor goes to the next word; Z: there is none.
winch_begin_word:
    ld r24, X+
    cpi r24, 0x20
    breq winch_begin_word
    cpi r24, 9
    breq winch_begin_word
    sbiw r26, 1
    ldd r25, Y+3
    inc r25
    std Y+3, r25
    tst r24
    ret

; The axis of the flag at X, which is skipped. Carry: it is an axis.
winch_axis:
    ld r24, X+
    subi r24, 0x78
    cpi r24, 0xe9
    breq 1f
    cpi r24, 3
    ret
1:
    ldi r24, 3
    sec
    ret

; The bit of axis r24, r25.
winch_bit:
    ldi r25, 1
    sbrc r24, 0
    lsl r25
    sbrs r24, 1
    ret
    lsl r25
    lsl r25
    ret

; Skips a sign, if there is one. T: minus.
winch_sign:
    clt
    ld r24, X
    cpi r24, 0x2b
    breq 1f
    cpi r24, 0x2d
    brne 2f
    set
1:
    adiw r26, 1
2:
    ret

; Ten times r18-r21.
winch_tenfold:
    lsl r18
    rol r19
    rol r20
    rol r21
    movw r30, r18
    movw r24, r20
    lsl r18
    rol r19
    rol r20
    rol r21
    lsl r18
    rol r19
    rol r20
    rol r21
    add r18, r30
    adc r19, r31
    adc r20, r24
    adc r21, r25
    ret

; Reads the line. r24: its error, or 0.
winch_read:
    std Y+3, r1
    movw r30, r28
    adiw r30, 7
    ldi r24, 9
1:
    st Z+, r1
    st Z+, r1
    dec r24
    brne 1b
    movw r26, r28
    adiw r26, 25
    rcall winch_begin_word
    movw r14, r26
    clr r16
    ld r25, X+                  ; a letter alone
    ld r24, X
    rcall winch_is_end
    brne 1f
    ldi r30, lo8(winch_letters)
    ldi r31, hi8(winch_letters)
2:
    lpm r24, Z+
    cp r24, r25
    breq 6f
    inc r16
    cpi r16, 7
    brne 2b
    rjmp 7f
1:
    ldi r16, 7
    ldi r30, lo8(winch_names)
    ldi r31, hi8(winch_names)
2:
    movw r26, r14
    clt
3:
    lpm r24, Z+
    tst r24
    breq 4f
    ld r25, X+
    cpse r24, r25
    set
    rjmp 3b
4:
    brts 5f
    ld r24, X
    rcall winch_is_end
    breq 6f
5:
    inc r16
    cpi r16, 13
    brlo 2b
7:
    ldi r24, 1                  ; Command
    ret
6:
    std Y+6, r16
    clr r17
    clr r13
    cpi r16, 11
    brsh 20f
    inc r13
    cpi r16, 7
    brsh 20f

; The flags.
    rcall winch_begin_word
    brne .+2
    rjmp 15f
    movw r14, r26
    clr r13
    clt
7:
    ld r24, X
    rcall winch_is_end
    breq 10f
    rcall winch_axis
    brcs 8f
    set
    rjmp 7b
8:
    inc r13
    rcall winch_bit
    ldd r24, Y+7
    mov r0, r24
    and r0, r25
    breq 9f
    set
9:
    or r24, r25
    std Y+7, r24
    rjmp 7b
10:
    ldi r24, 2                  ; Flags
    tst r13
    breq 12f
    ldd r25, Y+0
    brtc 11f
    sbrc r25, 0
12:
    ret
11:
    cpi r16, 5
    brlo 20f
    ori r16, 0x10
    mov r13, r24                ; two, whatever they are for

; The values.
20:
    rcall winch_begin_word
    brne .+2
    rjmp 14f
    tst r13
    brne 22f
    ldi r24, 6                  ; Extra
    ldd r25, Y+0
    sbrc r25, 0
    ret
21:
    ld r24, X
    rcall winch_is_end
    breq 20b
    adiw r26, 1
    rjmp 21b
22:
    dec r13
    rcall winch_number
    brcc .+2
    rjmp 16f
    sbrs r16, 4
    rjmp 23f
    rcall winch_take_decimal
    rjmp 24f
23:
    rcall winch_take_whole
24:
    tst r24
    breq 25f
    ret
25:
    inc r17
    rjmp 20b

; No more words.
14:
    clr r24
    tst r13
    breq 17f
    tst r17
    breq 15f
    ldd r25, Y+0
    sbrs r25, 0
    sbrc r16, 4
15:
    ldi r24, 5                  ; Missing
17:
    ret
16:
    ldi r24, 3                  ; Number
    ret

; Reads a number at X. Carry: there is none.
winch_number:
    clr r18
    clr r19
    movw r20, r18
    clr r22
    clr r23
    rcall winch_sign
    bld r23, 0
1:
    ld r24, X
    mov r0, r24
    subi r24, 0x30
    cpi r24, 10
    brsh 5f
    ori r23, 4
    sbrs r23, 1
    rjmp 2f
    sbrs r16, 4
    rjmp 4f
2:
    mov r0, r24
    ldi r24, 0x99
    ldi r25, 0x19
    cp r18, r24
    cpc r19, r24
    cpc r20, r24
    cpc r21, r25
    brcc 3f
    rcall winch_tenfold
    add r18, r0
    adc r19, r1
    adc r20, r1
    adc r21, r1
    sbrc r23, 1
    dec r22
    rjmp 4f
3:
    sbrs r23, 1
    inc r22
4:
    adiw r26, 1
    rjmp 1b
5:
    mov r24, r0
    sbrc r23, 1
    rjmp 6f
    cpi r24, 0x2e
    brne 6f
    ori r23, 2
    rjmp 4b
6:
    sbrs r23, 2
    rjmp 12f
    ori r24, 0x20
    cpi r24, 0x65
    brne 11f
    sbrs r16, 4
    rjmp 11f
    adiw r26, 1
    rcall winch_sign
    andi r23, 0xfb
    clr r25
7:
    ld r24, X
    subi r24, 0x30
    cpi r24, 10
    brsh 10f
    ori r23, 4
    cpi r25, 5
    brlo 8f
    ldi r25, 50
    rjmp 9f
8:
    lsl r25
    mov r0, r25
    lsl r25
    lsl r25
    add r25, r0
    add r25, r24
9:
    adiw r26, 1
    rjmp 7b
10:
    brtc .+2
    neg r25
    add r22, r25
    sbrs r23, 2
    rjmp 12f
11:
    ld r24, X
    rcall winch_is_end
    clc
    breq 13f
12:
    sec
13:
    ret

; The number is a decimal: the next one of gains or limits. r24: its error, or 0.
winch_take_decimal:
    subi r22, 0xfd
    cpi r16, 0x15
    brne 1f
    subi r22, 0xfd
1:
    rcall winch_is_nothing
    brne .+2
    rjmp 6f
    cpi r22, 8                  ; up to 255 of up to 10^7, which is nearly all that is said: at once
    brsh 9f
    mov r25, r19
    or r25, r20
    or r25, r21
    brne 9f
    mov r25, r18
    ldi r30, lo8(winch_powers + 4 * 9)
    ldi r31, hi8(winch_powers + 4 * 9)
    lsl r22
    lsl r22
    sub r30, r22
    sbc r31, r1
    clr r22
    lpm r24, Z+
    mul r24, r25
    movw r18, r0
    lpm r24, Z+
    mul r24, r25
    add r19, r0
    mov r20, r1
    adc r20, r22
    lpm r24, Z
    mul r24, r25
    add r20, r0
    mov r21, r1
    adc r21, r22
    clr r1
    rjmp 6f
9:
    tst r22
    breq 6f
    brmi 3f
    ldi r24, 0x99
    ldi r25, 0x19
    cpi r18, 0x9a
    cpc r19, r24
    cpc r20, r24
    cpc r21, r25
    brcs 2f
    cpi r22, 33                 ; more than 32 bits, and more than a float of the original
    brge 10f
    ser r18
    ser r19
    movw r20, r18
    rjmp 6f
2:
    rcall winch_tenfold
    dec r22
    rjmp 9b
3:
    rcall winch_is_nothing      ; nor is anything rounded up of it
    breq 6f
    clr r24
    ldi r25, 32
4:
    lsl r18
    rol r19
    rol r20
    rol r21
    rol r24
    cpi r24, 10
    brlo 5f
    subi r24, 10
    inc r18
5:
    dec r25
    brne 4b
    inc r22
    brne 3b
    cpi r24, 5
    brlo 6f
    subi r18, 0xff
    sbci r19, 0xff
    sbci r20, 0xff
    sbci r21, 0xff
6:
    sbrs r23, 0
    rjmp 7f
    rcall winch_is_nothing
    brne 10f

; Checks that it is between minimum and maximum. A limit that is too large is taken as the maximum, unless text is strict.
7:
    mov r24, r16
    subi r24, 0x15
    lsl r24
    add r24, r17
    swap r24
    lsr r24
    ldi r30, lo8(winch_ranges)
    ldi r31, hi8(winch_ranges)
    add r30, r24
    adc r31, r1
    rcall winch_compare
    brcs 10f
    rcall winch_compare
    breq 8f
    brcs 8f
    cpi r16, 0x15
    breq 10f
    ldd r25, Y+0
    sbrc r25, 0
    rjmp 10f
    sbiw r30, 4
    lpm r18, Z+
    lpm r19, Z+
    lpm r20, Z+
    lpm r21, Z+
8:
    mov r24, r17
    rjmp winch_store
10:
    ldi r24, 10                 ; Frequency, and Ratio
    add r24, r17
    cpi r16, 0x15
    breq 12f
    ldi r24, 4                  ; Range
12:
    ret

; Compares r18-r21 with the four bytes at Z.
winch_compare:
    lpm r24, Z+
    cp r18, r24
    lpm r24, Z+
    cpc r19, r24
    lpm r24, Z+
    cpc r20, r24
    lpm r24, Z+
    cpc r21, r24
    ret

; Stores r18-r21 as value r24. No error.
winch_store:
    rcall winch_place
    st Z, r18
    std Z+1, r19
    std Z+2, r20
    std Z+3, r21
    clr r24
    ret

; Z flag: r18-r21 are 0. Uses r25.
winch_is_nothing:
    mov r25, r18
    or r25, r19
    or r25, r20
    or r25, r21
    ret

; The address of value r24.
winch_place:
    lsl r24
    lsl r24
    movw r30, r28
    adiw r30, 9
    add r30, r24
    adc r31, r1
    ret

; The number is an integer, for the next flag that is an axis. r24: its error, or 0.
winch_take_whole:
    ldi r24, 3                  ; Number
    ldd r25, Y+0
    sbrs r25, 0
    rjmp 1f
    sbrc r23, 1
    ret
1:
    ldi r24, 4                  ; Range
    cpse r22, r1
    ret
    cpi r16, 2
    brne 2f
    ldi r30, lo8(winch_drift)
    ldi r31, hi8(winch_drift)
    rcall winch_compare
    brcs 2f
    ldi r24, 4
    ldd r25, Y+0
    sbrs r25, 0
    sbrc r21, 7
    ret
    ldi r18, lo8(15000)
    ldi r19, hi8(15000)
    clr r20
    clr r21
2:
    sbrs r23, 0
    rjmp 3f
    rcall winch_negate
3:
; The sign must still be the one that was written, unless the number is 0.
    mov r25, r21
    lsl r25
    sbc r25, r25
    sbrc r23, 0
    com r25
    tst r25
    breq 4f
    rcall winch_is_nothing
    brne 7f
4:
    clr r24
    cpi r16, 7
    brsh 6f
    movw r30, r26
    movw r26, r14
5:
    rcall winch_axis
    brcc 5b
    movw r14, r26
    movw r26, r30
    rcall winch_bit
    ldd r0, Y+8
    or r0, r25
    std Y+8, r0
6:
    cpi r16, 1
    breq 8f
    cpi r16, 3
    breq 8f
    cpi r16, 4
    breq 9f
    cpi r16, 8
    breq 10f
    cpi r16, 9
    breq 11f
    cpi r16, 10
    breq 14f
    cpi r16, 7
    brne 13f
    ldd r25, Y+0
    sbrs r25, 0
13:
    rjmp winch_store

; strict, and enable when strict: 0 or 1.
14:
    cpi r18, 2
    cpc r19, r1
    cpc r20, r1
    cpc r21, r1
    brlo 13b
7:
    ldi r24, 4                  ; Range
    ret

; An axis that is named twice moves by the sum.
8:
    mov r25, r24
    rcall winch_place
    mov r24, r25
    ld r0, Z
    add r18, r0
    ldd r0, Z+1
    adc r19, r0
    ldd r0, Z+2
    adc r20, r0
    ldd r0, Z+3
    adc r21, r0
    brvs 7b
    rjmp winch_store

; A negative ramp is no ramp.
9:
    sbrs r21, 7
    rjmp 11f
    clr r18
    clr r19
    movw r20, r18
    rjmp winch_store
10:
    rcall winch_is_nothing
    breq 12f
    sbrc r21, 7
    rjmp 12f
11:
    mov r25, r20
    or r25, r21
    brne 7b
    rjmp winch_store
12:
    ldi r24, 12                 ; Rate
    ret

winch_letters:
    .ascii "advrsgl"
winch_names:
    .asciz "enable"
    .asciz "srate"
    .asciz "deadman"
    .asciz "strict"
    .asciz "version"
    .asciz "ping"
; Minimum and maximum of f and of ζ, 10^-6; of vmax and of amax, 10^-3.
winch_ranges:
    .long 10000, 20000000
    .long 70000, 5000000
    .long 0, 10000000
    .long 1000, 250000000
; One more than the fastest drift.
winch_drift:
    .long 15001
.balign 2
