; What the board says, as text: pulsetrain_core::winch::reply::Reply, to the same bytes.
;
;   u8 winch_say(u8 *r24, u8 r22, u8 r20)          the reply r22 about the word r20: a What, or one of the numbers after those
;   u8 winch_status(u8 *r24, const i32 *r22)       the clock and four positions
;
; Both write to r24 and return how many bytes. X is where the next one goes.

.section .text.winch, "ax", @progbits
.global winch_say, winch_status, winch_powers
winch_say:
    push r24
    movw r26, r24
    mov r25, r22
    subi r25, 1
    cpi r25, 11                 ; Rate, Words, awake, id, taken: as they are
    brsh 4f
    clr r25
    rcall winch_append          ; "err "
    mov r25, r22
    cpi r25, 10
    brlo 1f
    ldi r25, 4                  ; Frequency and Ratio are out of range
1:
    rcall winch_append
    mov r18, r20
    clr r19
    clr r20
    clr r21
    mov r23, r22
    rcall winch_decimal
    mov r25, r23
    cpi r25, 10
    brlo 3f
2:
    rcall winch_append
3:
winch_end_line:
    ldi r24, 13
    st X+, r24
    ldi r24, 10
    st X+, r24
    pop r24
    sub r26, r24
    mov r24, r26
    ret
4:
    subi r25, 0xff
    rjmp 2b

winch_status:
    push r24
    movw r26, r24
    ldi r25, 17
    rcall winch_append
    ldi r25, 5
1:
    movw r30, r22
    ld r18, Z+
    ld r19, Z+
    ld r20, Z+
    ld r21, Z+
    movw r22, r30
    rcall winch_decimal
    dec r25
    brne 1b
    rjmp winch_end_line

; Writes the text of the number r25.
winch_append:
    ldi r30, lo8(winch_texts)
    ldi r31, hi8(winch_texts)
1:
    subi r25, 1
    brcs 3f
2:
    lpm r24, Z+
    tst r24
    brne 2b
    rjmp 1b
3:
    lpm r24, Z+
    tst r24
    breq 4f
    st X+, r24
    rjmp 3b
4:
    ret

; Writes a space and the number r18-r21. T: a digit has been written. Keeps r22, r23, r25.
winch_decimal:
    ldi r24, 0x20
    st X+, r24
    sbrs r21, 7
    rjmp 1f
    ldi r24, 0x2d
    st X+, r24
    rcall winch_negate
1:
    push r22
    push r23
    push r25
    ldi r30, lo8(winch_powers)
    ldi r31, hi8(winch_powers)
    clt
2:
    lpm r22, Z+
    lpm r23, Z+
    lpm r24, Z+
    lpm r25, Z+
    clr r0
3:
    sub r18, r22
    sbc r19, r23
    sbc r20, r24
    sbc r21, r25
    brcs 4f
    inc r0
    rjmp 3b
4:
    add r18, r22
    adc r19, r23
    adc r20, r24
    adc r21, r25
    cpi r22, 1                  ; the last power
    breq 5f
    tst r0
    brne 6f
    brts 6f
    rjmp 2b
5:
    set
6:
    mov r24, r0
    subi r24, 0xd0
    st X+, r24
    brts 7f
    set
    rjmp 2b
7:
    cpi r22, 1
    brne 2b
    pop r25
    pop r23
    pop r22
    ret

winch_powers:
    .long 1000000000, 100000000, 10000000, 1000000, 100000, 10000, 1000, 100, 10, 1
winch_texts:
    .asciz "err "
    .asciz "command"
    .asciz "flags"
    .asciz "number"
    .asciz "range"
    .asciz "missing"
    .asciz "extra"
    .asciz "long"
    .asciz "noise"
    .asciz "checksum"
    .asciz " 0.01..20 Hz"
    .asciz " 0.07..5"
    .asciz "dbg invalid srate value"
    .asciz "dbg excessive input error"
    .asciz "awake"
    .asciz "id StepperWinch Nov 21 2026"
    .asciz "err taken"
    .asciz "txyza"
.balign 2
