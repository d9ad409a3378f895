; What a command does to a path: the methods of pulsetrain_core::winch::path::Path, to the same bits.
;
;   void winch_obey(Path *r24, const i32 *r22, u8 r20)
;
; r20 is the Verb, an axis' command or Enable, which stops it. At r22 is its value, or two of gains or limits. Path is as
; tick.s has it, and so is the use of registers.

.section .text.winch, "ax", @progbits
.global winch_obey, winch_obey_inside
winch_obey:
    rcall winch_enter
    rcall winch_obey_inside
    rjmp winch_leave

; The same for a caller that has all registers free. r1 may be anything afterwards.
winch_obey_inside:
    movw r28, r24
    movw r30, r22
    clr r26
    rcall winch_clear
    ld r22, Z
    ldd r23, Z+1
    ldd r24, Z+2
    ldd r25, Z+3
    cpi r20, 5
    brne .+2
    rjmp 20f
    cpi r20, 6
    brne .+2
    rjmp 30f
    cpi r20, 7
    brne .+2
    rjmp 10f
    cpi r20, 2
    breq 4f
    cpi r20, 4
    breq 5f
    cpi r20, 0
    brne 1f

; a: from the steps made to the target, a difference of 33 bits, and from q to the steps made.
    ldd r18, Y+0
    sub r22, r18
    ldd r18, Y+1
    sbc r23, r18
    ldd r18, Y+2
    sbc r24, r18
    ldd r18, Y+3
    sbc r25, r18
    in r18, 0x3f                ; SREG
    bst r18, 4                  ; S: the sign, whether 32 bits overflowed or not
    rcall winch_thousandfold
    ldd r18, Y+6
    ldd r19, Y+7
    mov r20, r19
    lsl r20
    sbc r20, r20
    add r10, r18
    adc r11, r19
    adc r12, r20
    adc r13, r20
    adc r14, r20
    adc r15, r20
    rjmp 7f

; d and r: from q to the reference, and for d on to the target.
1:
    bst r25, 7
    rcall winch_thousandfold
2:
    movw r30, r28
    adiw r30, 8
    rcall winch_add
    cpi r20, 3
    breq 8f
    adiw r30, 45 - 14
    rcall winch_add
    rjmp 7f

; v.
4:
    std Y+20, r22
    std Y+21, r23
    rjmp 9f

; s: as if the target had moved by 0.
5:
    std Y+43, r22
    std Y+44, r23
    rjmp 2b

; r10-r15: from q to the target. With a ramp set, the reference still has to go there.
7:
    ldd r18, Y+43
    ldd r19, Y+44
    or r18, r19
    breq 6f
    movw r30, r28
    adiw r30, 8
    rcall winch_subtract
    adiw r30, 45 - 14
    rcall winch_keep
    rjmp 9f
6:
    movw r30, r28
    adiw r30, 8
    rcall winch_keep
    rcall winch_clear
    adiw r30, 45 - 14
    rcall winch_keep
    rjmp 9f
8:
    sbiw r30, 6
    rcall winch_keep
9:
    std Y+42, r26
    ret

; The command `enable 0`.
10:
    std Y+20, r26
    std Y+21, r26
    movw r30, r28
    adiw r30, 8
    rcall winch_keep
    adiw r30, 45 - 14
    rcall winch_keep
    ldi r18, 1
    std Y+42, r18
    ret

; g: k = f f C, b = f ratio C, each as its four highest bytes and where they are.
20:
    ldd r18, Z+4
    ldd r19, Z+5
    ldd r20, Z+6
    ldd r21, Z+7
    movw r10, r22
    movw r12, r24
    ldi r30, 1
    rcall winch_factor
    ldi r22, lo8(59343007)
    ldi r23, hi8(59343007)
    ldi r24, hlo8(59343007)
    ldi r25, hhi8(59343007)
    rcall winch_factor
    std Y+26, r18
    std Y+27, r19
    std Y+28, r20
    std Y+29, r21
    std Y+31, r30
    movw r22, r10
    movw r24, r12
    movw r18, r10
    movw r20, r12
    ldi r30, 2
    rcall winch_factor
    ldi r22, lo8(47726478)
    ldi r23, hi8(47726478)
    ldi r24, hlo8(47726478)
    ldi r25, hhi8(47726478)
    rcall winch_factor
    std Y+22, r18
    std Y+23, r19
    std Y+24, r20
    std Y+25, r21
    std Y+30, r30
    ret

; l: vmax C / 2^24, amax C / 2^16.
30:
    ldi r18, lo8(1099511628)
    ldi r19, hi8(1099511628)
    ldi r20, hlo8(1099511628)
    ldi r21, hhi8(1099511628)
    ldi r27, 3
    rcall winch_product
    std Y+32, r10
    std Y+33, r11
    std Y+34, r12
    std Y+35, r13
    rcall winch_clear
    ldd r22, Z+4
    ldd r23, Z+5
    ldd r24, Z+6
    ldd r25, Z+7
    ldi r18, lo8(281474977)
    ldi r19, hi8(281474977)
    ldi r20, hlo8(281474977)
    ldi r21, hhi8(281474977)
    ldi r27, 2
    rcall winch_product
    std Y+36, r10
    std Y+37, r11
    std Y+38, r12
    std Y+39, r13
    std Y+40, r14
    ret

; r10-r15 = 1000 X, all of them 0 before; T is X's sign, its bit 32. Uses r18 and r19.
winch_thousandfold:
    ldi r18, lo8(1000)
    ldi r19, hi8(1000)
    mul r22, r18
    movw r10, r0
    mul r24, r18
    movw r12, r0
    mul r23, r18
    add r11, r0
    adc r12, r1
    adc r13, r26
    adc r14, r26
    mul r25, r18
    add r13, r0
    adc r14, r1
    adc r15, r26
    mul r22, r19
    add r11, r0
    adc r12, r1
    adc r13, r26
    adc r14, r26
    adc r15, r26
    mul r23, r19
    add r12, r0
    adc r13, r1
    adc r14, r26
    adc r15, r26
    mul r24, r19
    add r13, r0
    adc r14, r1
    adc r15, r26
    mul r25, r19
    add r14, r0
    adc r15, r1
    brtc 1f
    sub r14, r18
    sbc r15, r19
1:
    ret

; r18-r21 = the four highest bytes of X times r18-r21; r30 goes up by the bytes that are above them in 64 bits.
winch_factor:
    ldi r27, 0x80
    rcall winch_product
1:
    tst r9
    brne 2f
    mov r9, r8
    mov r8, r7
    mov r7, r6
    mov r6, r5
    mov r5, r4
    mov r4, r3
    mov r3, r2
    inc r30
    rjmp 1b
2:
    movw r18, r6
    movw r20, r8
    ret

; r10-r15 += the six bytes at Z, modulo 2^48. Z then points after them.
winch_add:
    ld r18, Z+
    add r10, r18
    ld r18, Z+
    adc r11, r18
    ld r18, Z+
    adc r12, r18
    ld r18, Z+
    adc r13, r18
    ld r18, Z+
    adc r14, r18
    ld r18, Z+
    adc r15, r18
    rjmp winch_bound

; The same, but subtracts.
winch_subtract:
    ld r18, Z+
    sub r10, r18
    ld r18, Z+
    sbc r11, r18
    ld r18, Z+
    sbc r12, r18
    ld r18, Z+
    sbc r13, r18
    ld r18, Z+
    sbc r14, r18
    ld r18, Z+
    sbc r15, r18
winch_bound:
    brvc 1f
    mov r18, r15
    lsl r18
    sbc r18, r18
    mov r10, r18
    mov r11, r18
    movw r12, r10
    mov r14, r18
    subi r18, 0x80
    mov r15, r18
1:
    ret

; Stores r10-r15 at Z. Z then points after them.
winch_keep:
    st Z+, r10
    st Z+, r11
    st Z+, r12
    st Z+, r13
    st Z+, r14
    st Z+, r15
    ret

; void winch_start(Path *r24): initialises four paths.
.global winch_start
winch_start:
    movw r26, r24
    ldi r25, 4
1:
    ldi r24, 51
    ldi r30, lo8(winch_first)
    ldi r31, hi8(winch_first)
2:
    clr r18
    cpi r24, 51 - 22 + 1
    brsh 3f
    cpi r24, 51 - 41
    brlo 3f
    lpm r18, Z+
3:
    st X+, r18
    dec r24
    brne 2b
    dec r25
    brne 1b
    ret

; From byte 22 to byte 41: k for 1 Hz, b = 1, 3500 steps/s, 35000 steps/s2.
winch_first:
    .byte 0x82, 0x56, 0x96, 0x02, 0x4c, 0x37, 0x89, 0x41, 0x05, 0x05
    .byte 0x00, 0x00, 0xac, 0x0d, 0x9a, 0x00, 0x00, 0x00, 0x23, 0x00
