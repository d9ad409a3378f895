; A millisecond of a path and the ticks of its steps: pulsetrain_core::winch::path::Path::tick and Slice::train, to the
; same bits. crates/board/tests/it/chips/winch_avr.rs compares them and says what it costs.
;
;   void winch_tick(Path *r24, Train *r22)
;
; Path as it lies in memory (Path::bytes), all lowest byte first:
;    0 made             4 made less q, 2^-16 millisteps    8 gap, 6 bytes
;   14 speed, 6 bytes  20 drift                           22 k: m  26 b: m  30 k: n  31 b: n
;   32 vmax            36 amax dt, 5 bytes                42 stopping       43 ramp  45 way, 6 bytes
; Train: 0 count, 1 backward, 2 first, 6 interval. Without steps only the count is written.
;
; r26 is 0 throughout, r1 again in the end. No interrupt may rely on r1 or the T flag. Stack: 22 bytes and two calls.

.section .text.winch, "ax", @progbits
.global winch_tick, winch_tick_inside, winch_enter, winch_leave, winch_clear, winch_product, winch_negate
winch_tick:
    rcall winch_enter
    rcall winch_tick_inside
    rjmp winch_leave

; The same for a caller that has all registers free.
winch_tick_inside:
    push r22
    push r23
    movw r28, r24
    clr r26
    rcall winch_clear
    ldd r18, Y+42
    tst r18
    breq 1f
    rjmp 60f
1:

; While a ramp is set, the reference goes nearer to its target: step = +-ramp, or the way if that is less.
    ldd r18, Y+43
    ldd r19, Y+44
    mov r20, r18
    or r20, r19
    breq 5f
    ldd r2, Y+45
    ldd r3, Y+46
    ldd r4, Y+47
    ldd r5, Y+48
    ldd r6, Y+49
    ldd r7, Y+50
    mov r20, r2
    or r20, r3
    or r20, r4
    or r20, r5
    or r20, r6
    or r20, r7
    breq 5f
    bst r7, 7
    clr r20
    brtc 2f
    com r20
    com r19
    neg r18
    sbci r19, 0xff
2:

; rest = way - step. If its sign is not that of the way, the step is the whole way.
    sub r2, r18
    sbc r3, r19
    sbc r4, r20
    sbc r5, r20
    sbc r6, r20
    sbc r7, r20
    mov r21, r7
    eor r21, r20
    brpl 3f
    add r18, r2
    adc r19, r3
    clr r2
    clr r3
    movw r4, r2
    movw r6, r2
3:
    std Y+45, r2
    std Y+46, r3
    std Y+47, r4
    std Y+48, r5
    std Y+49, r6
    std Y+50, r7
    movw r30, r18
    mov r27, r20
    rcall winch_move_gap
    rcall winch_clear
5:

; X = r22-r25: the four significant bytes of the gap. r27: by how many bytes its product with k must be shifted.
    ldd r25, Y+13
    ldd r24, Y+12
    ldd r23, Y+11
    ldd r22, Y+10
    ldd r27, Y+30
    mov r18, r24
    lsl r18
    sbc r18, r18
    cp r18, r25
    brne 16f
    mov r18, r23
    lsl r18
    sbc r18, r18
    cp r18, r24
    brne 15f
    mov r18, r22
    lsl r18
    sbc r18, r18
    cp r18, r23
    brne 14f
    mov r25, r22
    ldd r24, Y+9
    ldd r23, Y+8
    ldd r22, Y+5
    subi r27, 3
    rjmp 20f
14:
    movw r24, r22
    ldd r23, Y+9
    ldd r22, Y+8
    subi r27, 4
    rjmp 20f
15:
    mov r25, r24
    mov r24, r23
    mov r23, r22
    ldd r22, Y+9
    subi r27, 5
    rjmp 20f
16:
    subi r27, 6
20:
    brcc 21f
    ldi r27, 0x10
    sbrc r25, 7
    ldi r27, 0xf0
    mov r17, r27
    rjmp 22f
21:
    movw r30, r28
    adiw r30, 22
    rcall winch_term
22:
    ldd r18, Y+16
    ldd r19, Y+17
    ldd r20, Y+18
    ldd r21, Y+19
    clr r22
    clr r23
    ldd r24, Y+20
    ldd r25, Y+21
    sub r22, r18
    sbc r23, r19
    sbc r24, r20
    sbc r25, r21
    ldd r27, Y+31
    subi r27, 2
    movw r30, r28
    adiw r30, 26
    rcall winch_term

; r2-r7: the old speed, 48 bits. While stopping, the change is what would bring it to 0.
30:
    ldd r2, Y+14
    ldd r3, Y+15
    ldd r4, Y+16
    ldd r5, Y+17
    ldd r6, Y+18
    ldd r7, Y+19
    ldd r18, Y+42
    tst r18
    breq 31f
    sub r10, r2
    sbc r11, r3
    sbc r12, r4
    sbc r13, r5
    sbc r14, r6
    sbc r15, r7
    mov r18, r15
    lsl r18
    sbc r18, r18
    mov r16, r18
    mov r17, r18
31:

; The change, r10-r17, is clamped to +-amax dt: 40 bits, r18-r22.
    ldd r18, Y+36
    ldd r19, Y+37
    ldd r20, Y+38
    ldd r21, Y+39
    ldd r22, Y+40
    clr r23
    bst r17, 7
    brtc 32f
    com r23
    com r22
    rcall winch_negate
    sbci r22, 0xff
32:
    cp r10, r18
    cpc r11, r19
    cpc r12, r20
    cpc r13, r21
    cpc r14, r22
    cpc r15, r23
    cpc r16, r23
    cpc r17, r23
    brlt 31f
    brtc 33f
    rjmp 34f
31:
    brtc 34f
33:
    movw r10, r18
    movw r12, r20
    movw r14, r22
34:

; r10-r15: the new speed.
    add r10, r2
    adc r11, r3
    adc r12, r4
    adc r13, r5
    adc r14, r6
    adc r15, r7
    ldd r18, Y+42
    tst r18
    breq 35f
    mov r18, r10
    or r18, r11
    or r18, r12
    or r18, r13
    or r18, r14
    or r18, r15
    brne 35f
    std Y+42, r26
35:
    ldd r18, Y+32
    ldd r19, Y+33
    ldd r20, Y+34
    ldd r21, Y+35
    bst r15, 7
    brts 36f
    cp r12, r18
    cpc r13, r19
    cpc r14, r20
    cpc r15, r21
    brge 37f
    rjmp 39f
36:
    movw r22, r12
    movw r24, r14
    add r22, r18
    adc r23, r19
    adc r24, r20
    adc r25, r21
    brmi 37f
    rjmp 39f

; Too fast: vmax, or amax dt slower than the old speed, whichever is more.
37:
    movw r22, r2
    movw r24, r4
    movw r30, r6
    sbrs r31, 7
    rjmp 38f
    com r31
    com r30
    rcall winch_negate_x
    sbci r30, 0xff
    sbci r31, 0xff
38:
    ldd r27, Y+36
    sub r22, r27
    ldd r27, Y+37
    sbc r23, r27
    ldd r27, Y+38
    sbc r24, r27
    ldd r27, Y+39
    sbc r25, r27
    ldd r27, Y+40
    sbc r30, r27
    sbc r31, r26
    brmi 40f
    cp r26, r22
    cpc r26, r23
    cpc r18, r24
    cpc r19, r25
    cpc r20, r30
    cpc r21, r31
    brcs 41f
40:
    clr r22
    clr r23
    movw r24, r18
    movw r30, r20
41:
    brtc 42f
    com r31
    com r30
    rcall winch_negate_x
    sbci r30, 0xff
    sbci r31, 0xff
42:
    movw r10, r22
    movw r12, r24
    movw r14, r30
39:
    std Y+14, r10
    std Y+15, r11
    std Y+16, r12
    std Y+17, r13
    std Y+18, r14
    std Y+19, r15

; r18-r21: made less q, before; r22-r25: after. The gap changes by the difference of millisteps, and the drift.
    ldd r18, Y+4
    ldd r19, Y+5
    ldd r20, Y+6
    ldd r21, Y+7
    movw r22, r18
    movw r24, r20
    sub r22, r4
    sbc r23, r5
    sbc r24, r6
    sbc r25, r7
    tst r9
    brne 45f
    ldd r30, Y+20
    ldd r31, Y+21
    add r30, r24
    adc r31, r25
    sub r30, r20
    sbc r31, r21
    breq 45f                    ; both bytes: at rest, and at the drift's own speed
    mov r27, r31
    lsl r27
    sbc r27, r27
    rcall winch_move_gap
45:

; Mirrored, a backward slice is a forward one. T: backward.
    bst r7, 7
    brtc 46f
    rcall winch_negate_x
    rcall winch_negate
    com r7
    com r6
    com r5
    neg r4
    ldi r27, 0xff
    sbc r5, r27
    sbc r6, r27
    sbc r7, r27
46:
    clr r16
    subi r18, 0x00
    sbci r19, 0x60
    sbci r20, 0xfc
    sbci r21, 0xfd
    subi r22, 0x01
    sbci r23, 0x60
    sbci r24, 0xfc
    sbci r25, 0xfd
    brpl 48f
47:
    inc r16
    subi r24, 0x18
    sbci r25, 0xfc
    brmi 47b
48:
    subi r22, 0xff
    sbci r23, 0x9f
    sbci r24, 0x03
    sbci r25, 0x02
    brtc 49f
    rcall winch_negate_x
49:
    std Y+4, r22
    std Y+5, r23
    std Y+6, r24
    std Y+7, r25
    pop r31
    pop r30
    std Z+0, r16
    tst r16
    brne 50f
    rjmp 59f
50:
    ldi r27, 0
    bld r27, 0
    std Z+1, r27
    ldd r22, Y+0
    ldd r23, Y+1
    ldd r24, Y+2
    ldd r25, Y+3
    brts 51f
    add r22, r16
    adc r23, r26
    adc r24, r26
    adc r25, r26
    rjmp 52f
51:
    sub r22, r16
    sbc r23, r26
    sbc r24, r26
    sbc r25, r26
52:
    std Y+0, r22
    std Y+1, r23
    std Y+2, r24
    std Y+3, r25

; The steps of the slice: speed r4-r7 and distance r18-r21 are shifted to 16 significant bits in the upper halves.
    ldi r22, 0xe8
    ldi r23, 0x03
    movw r2, r22
53:
    tst r7
    brne 54f
    mov r7, r6
    mov r6, r5
    mov r5, r4
    clr r4
    mov r21, r20
    mov r20, r19
    mov r19, r18
    clr r18
    rjmp 53b
55:
    lsl r2
    rol r3
    lsl r18
    rol r19
    rol r20
    rol r21
    lsl r4
    rol r5
    rol r6
    rol r7
54:
    brpl 55b

; r22:r23 = 2^31 / r6:r7, bit by bit; the bits come in inverted, and the one that goes out last is 0.
    ldi r24, 0
    ldi r25, 0x80
    cp r6, r24
    cpc r7, r25
    brne 56f
    ldi r22, 0xff
    ldi r23, 0xff
    rjmp 58f
56:
    ldi r23, 0xfe
61:
    lsl r24
    rol r25
    brcs 1f
    cp r24, r6
    cpc r25, r7
    brcs 2f
1:
    sub r24, r6
    sbc r25, r7
    clc
2:
    rol r23
    brcs 61b
    ldi r22, 0xfe
57:
    lsl r24
    rol r25
    brcs 1f
    cp r24, r6
    cpc r25, r7
    brcs 2f
1:
    sub r24, r6
    sbc r25, r7
    clc
2:
    rol r22
    brcs 57b
    com r22
    com r23
58:
    ldi r27, 125                ; in r22, r24, r25: 16000 / 2^7 times that
    mul r23, r27
    movw r24, r0
    mul r22, r27
    mov r22, r0
    add r24, r1
    adc r25, r26
    rcall winch_ticks
    std Z+2, r11
    std Z+3, r12
    std Z+4, r13
    std Z+5, r14
    cpi r16, 2
    brcs 3f
    movw r20, r2
    rcall winch_ticks
    rjmp 4f
3:
    clr r11
    clr r12
    clr r13
    clr r14
4:
    std Z+6, r11
    std Z+7, r12
    std Z+8, r13
    std Z+9, r14
59:
    clr r1
    ret

; Restores what winch_enter has saved, and returns.
winch_leave:
    clr r1
    pop r29
    pop r28
    pop r17
    pop r16
    pop r15
    pop r14
    pop r13
    pop r12
    pop r11
    pop r10
    pop r9
    pop r8
    pop r7
    pop r6
    pop r5
    pop r4
    pop r3
    pop r2
    ret

; Stopping: no products. r9 says so to the position's code; after a product it is 0.
60:
    ldi r27, 1
    mov r9, r27
    rjmp 30b

; Saves the caller's registers on the stack; winch_leave restores them.
winch_enter:
    pop r31
    pop r30
    push r2
    push r3
    push r4
    push r5
    push r6
    push r7
    push r8
    push r9
    push r10
    push r11
    push r12
    push r13
    push r14
    push r15
    push r16
    push r17
    push r28
    push r29
    ijmp

; The gap += r30:31 with the sign r27, unless it would leave 48 bits. Uses r10-r15.
winch_move_gap:
    ldd r10, Y+8
    ldd r11, Y+9
    ldd r12, Y+10
    ldd r13, Y+11
    ldd r14, Y+12
    ldd r15, Y+13
    add r10, r30
    adc r11, r31
    adc r12, r27
    adc r13, r27
    adc r14, r27
    adc r15, r27
    brvs 1f
    std Y+8, r10
    std Y+9, r11
    std Y+10, r12
    std Y+11, r13
    std Y+12, r14
    std Y+13, r15
1:
    ret

; Negates X, and r18-r21.
winch_negate_x:
    com r25
    com r24
    com r23
    neg r22
    sbci r23, 0xff
    sbci r24, 0xff
    sbci r25, 0xff
    ret
winch_negate:
    com r21
    com r20
    com r19
    neg r18
    sbci r19, 0xff
    sbci r20, 0xff
    sbci r21, 0xff
    ret

winch_clear:
    clr r10
    clr r11
    movw r12, r10
    movw r14, r10
    movw r16, r10
winch_none:
    ret

; r10-r17 += X m / 256^n, towards 0, by sign and magnitude; m at Z, n in r27. All but the changing registers are
; lost; r9 is 0. Nothing times m, as for a path at rest or at a constant speed, is soon done.
winch_term:
    mov r9, r22
    or r9, r23
    or r9, r24
    or r9, r25
    breq winch_none
    ld r18, Z+
    ld r19, Z+
    ld r20, Z+
    ld r21, Z+

; The same with m in r18-r21; Z stays. With bit 7 of r27 it is the product alone, in r2-r9.
winch_product:
    bst r25, 7
    brtc 1f
    rcall winch_negate_x
1:
    clr r4
    clr r5
    movw r6, r4
    movw r8, r4
; Column by column: none needs more than three bytes.
    mul r22, r18
    movw r2, r0
    mul r22, r19
    add r3, r0
    adc r4, r1
    mul r23, r18
    add r3, r0
    adc r4, r1
    adc r5, r26
    mul r22, r20
    add r4, r0
    adc r5, r1
    adc r6, r26
    mul r23, r19
    add r4, r0
    adc r5, r1
    adc r6, r26
    mul r24, r18
    add r4, r0
    adc r5, r1
    adc r6, r26
    mul r22, r21
    add r5, r0
    adc r6, r1
    adc r7, r26
    mul r23, r20
    add r5, r0
    adc r6, r1
    adc r7, r26
    mul r24, r19
    add r5, r0
    adc r6, r1
    adc r7, r26
    mul r25, r18
    add r5, r0
    adc r6, r1
    adc r7, r26
    mul r23, r21
    add r6, r0
    adc r7, r1
    adc r8, r26
    mul r24, r20
    add r6, r0
    adc r7, r1
    adc r8, r26
    mul r25, r19
    add r6, r0
    adc r7, r1
    adc r8, r26
    mul r24, r21
    add r7, r0
    adc r8, r1
    adc r9, r26
    mul r25, r20
    add r7, r0
    adc r8, r1
    adc r9, r26
    mul r25, r21
    add r8, r0
    adc r9, r1
    sbrc r27, 7
    ret
2:
    subi r27, 2
    brcs 3f
    movw r2, r4
    movw r4, r6
    movw r6, r8
    clr r8
    clr r9
    rjmp 2b
3:
    sbrs r27, 0
    rjmp 4f
    mov r2, r3
    mov r3, r4
    mov r4, r5
    mov r5, r6
    mov r6, r7
    mov r7, r8
    mov r8, r9
    clr r9
4:
    brts 5f
    add r10, r2
    adc r11, r3
    adc r12, r4
    adc r13, r5
    adc r14, r6
    adc r15, r7
    adc r16, r8
    adc r17, r9
    clr r9
    ret
5:
    sub r10, r2
    sbc r11, r3
    sbc r12, r4
    sbc r13, r5
    sbc r14, r6
    sbc r15, r7
    sbc r16, r8
    sbc r17, r9
    clr r9
    ret

; r11-r14 = x y / 2^8; x in r20:r21, y in r22, r24, r25: less than 2^40 together.
winch_ticks:
    mul r20, r22
    movw r10, r0
    mul r21, r24
    movw r12, r0
    clr r14
    mul r20, r24
    add r11, r0
    adc r12, r1
    adc r13, r26
    adc r14, r26
    mul r21, r22
    add r11, r0
    adc r12, r1
    adc r13, r26
    adc r14, r26
    mul r20, r25
    add r12, r0
    adc r13, r1
    adc r14, r26
    mul r21, r25
    add r13, r0
    adc r14, r1
    ret
