@ What benches/arm_speed.rs runs: sorting, a CRC and 64-bit products in a loop that never sleeps, with calls, stacks of
@ registers, tables and bytes, and SysTick's interrupt every 1000 cycles.
@
@   arm-none-eabi-as -mcpu=cortex-m0plus -o busy.o arm_busy.s
@   arm-none-eabi-ld -Ttext=0 -o busy.elf busy.o
@   arm-none-eabi-objcopy -O ihex busy.elf arm_busy.hex
    .syntax unified
    .thumb
    .text
    .word   0x20004000          @ stack pointer
    .word   _start + 1
    .rept   13
    .word   fault + 1
    .endr
    .word   tick + 1            @ SysTick

    .equ    NUMBERS, 0x20000000 @ 64 words
    .equ    TICKS, 0x20001000
    .equ    ROUNDS, 0x20001004

    .global _start
    .thumb_func
_start:
    ldr     r0, =0xe000e010     @ SYST_CSR
    ldr     r1, =999
    str     r1, [r0, #4]
    movs    r1, #7
    str     r1, [r0]
    ldr     r7, =0x12345678
1:
    bl      fill
    bl      sort
    bl      crc
    bl      products
    ldr     r1, =ROUNDS
    ldr     r2, [r1]
    adds    r2, r2, #1
    str     r2, [r1]
    b       1b

@ 64 numbers of a linear congruence.
    .thumb_func
fill:
    push    {r4, lr}
    ldr     r0, =NUMBERS
    movs    r1, #64
    ldr     r2, =1664525
    ldr     r3, =1013904223
1:
    muls    r7, r2, r7
    adds    r7, r7, r3
    stmia   r0!, {r7}
    subs    r1, r1, #1
    bne     1b
    pop     {r4, pc}

@ Insertion sort.
    .thumb_func
sort:
    push    {r4-r6, lr}
    ldr     r0, =NUMBERS
    movs    r1, #4
1:
    ldr     r2, [r0, r1]
    mov     r3, r1
2:
    subs    r4, r3, #4
    bmi     3f
    ldr     r5, [r0, r4]
    cmp     r5, r2
    bls     3f
    str     r5, [r0, r3]
    mov     r3, r4
    b       2b
3:
    str     r2, [r0, r3]
    adds    r1, r1, #4
    cmp     r1, #255
    bls     1b
    pop     {r4-r6, pc}

@ CRC-32 of the 256 bytes, bit by bit.
    .thumb_func
crc:
    push    {r4-r6, lr}
    ldr     r0, =NUMBERS
    movs    r1, #0
    mvns    r1, r1
    movs    r2, #0
    ldr     r6, =0xedb88320
1:
    ldrb    r3, [r0, r2]
    eors    r1, r1, r3
    movs    r4, #8
2:
    lsrs    r1, r1, #1
    bcc     3f
    eors    r1, r1, r6
3:
    subs    r4, r4, #1
    bne     2b
    adds    r2, r2, #1
    lsrs    r5, r2, #8
    beq     1b
    pop     {r4-r6, pc}

@ 64-bit products from 16-bit halves, added up.
    .thumb_func
products:
    push    {r4-r7, lr}
    movs    r6, #0
    movs    r7, #63
1:
    ldr     r0, =NUMBERS
    lsls    r1, r7, #2
    ldr     r0, [r0, r1]
    uxth    r1, r0
    lsrs    r2, r0, #16
    mov     r3, r1
    muls    r3, r1, r3
    mov     r4, r2
    muls    r4, r2, r4
    muls    r1, r2, r1
    lsrs    r5, r1, #15
    lsls    r1, r1, #17
    adds    r3, r3, r1
    adcs    r4, r4, r5
    adds    r6, r6, r3
    rev     r3, r4
    eors    r6, r6, r3
    subs    r7, r7, #1
    bpl     1b
    pop     {r4-r7, pc}

    .thumb_func
tick:
    push    {r4, lr}
    ldr     r0, =TICKS
    ldr     r1, [r0]
    adds    r1, r1, #1
    str     r1, [r0]
    pop     {r4, pc}

    .thumb_func
fault:
    b       fault
    .ltorg
