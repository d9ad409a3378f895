@ From a tape of words to edges, on an Arduino Due: three motors, each with a channel of the timers and a tape of its own.
@ A word is the ticks (1/42 us) from one rising edge to the next. The counter runs free; the compare registers are set to
@ absolute ticks, RA for the rise and RC for the fall. A word of 0 ends the tape. If the handler comes too late, RA is
@ behind the counter and no edge is made; the handler of that pulse's end sees it, and stops.
@
@   arm-none-eabi-as -mcpu=cortex-m3 -o tape.o due_tape.s
@   arm-none-eabi-ld -Ttext=0x80000 -e 0 -o tape.elf tape.o
@   arm-none-eabi-objcopy -O ihex --change-addresses=-0x80000 tape.elf due_tape.hex
@
@ The test writes the tapes and the state of each motor, and reads it: the next word, the tick of the last edge, whether
@ it has stopped, the channel's address.
    .syntax unified
    .cpu cortex-m3
    .thumb
    .equ STATES, 0x20000000
    .equ PULSE, 8
    .equ TC0, 0x40080000
    .equ RA, 0x14
    .equ RC, 0x1c
    .equ SR, 0x20
    .equ IER, 0x24
    .equ IDR, 0x28
    .equ CPCS, 1 << 4

    .word 0x20088000            @ stack
    .word start + 1
    .fill 14 + 27, 4, 0         @ system exceptions, interrupts 0 to 26
    .word step0 + 1             @ TC0
    .word step1 + 1             @ TC1
    .word step2 + 1             @ TC2
    .fill 15, 4, 0

@ A motor's interrupt, at the end of each pulse. 46 bytes: three lines of flash.
    .macro step channel
    .balign 16
step\channel:
    mov  r12, #STATES
    ldr  r0, [r12, #16 * \channel + 12]
    ldrd r1, r3, [r12, #16 * \channel]   @ next word, tick of the last edge
    ldr  r2, [r0, #SR]          @ acknowledges
    lsls r2, r2, #29            @ N: the edge was made (CPAS)
    bpl  stop\channel
    ldr  r2, [r1], #4
    cbz  r2, stop\channel
    add  r3, r2
    str  r3, [r0, #RA]
    add  r2, r3, #PULSE
    str  r2, [r0, #RC]
    bic  r1, r1, #0x1000        @ a ring of 4 KiB
    strd r1, r3, [r12, #16 * \channel]
    bx   lr
stop\channel:
    movs r2, #CPCS
    str  r2, [r0, #IDR]
    str  r2, [r12, #16 * \channel + 8]   @ stopped
    bx   lr
    .endm

    step 0
    step 1
    step 2

    .balign 4
start:
    ldr  r0, =0x400e0a00        @ EEFC0: 4 wait states
    movw r1, #0x400
    str  r1, [r0]
    str  r1, [r0, #0x200]       @ EEFC1
    ldr  r0, =0x400e0440        @ matrix: memories and bridges keep their last master
    ldr  r1, =0x10010
    movs r2, #9
1:  str  r1, [r0], #4
    subs r2, r2, #1
    bne  1b
    ldr  r0, =0x400e0600        @ PMC: TC0 to TC2
    mov  r1, #0x38000000
    str  r1, [r0, #0x10]
    ldr  r0, =0x400e1000        @ PB25 (TIOA0) is peripheral B
    mov  r1, #0x02000000
    str  r1, [r0, #0x70]
    str  r1, [r0, #4]
    ldr  r0, =0x400e0e00        @ PA2 (TIOA1) and PA5 (TIOA2) are peripheral A
    movs r1, #0x24
    str  r1, [r0, #4]
    ldr  r0, =TC0
    ldr  r1, =0x00098400        @ waveform, up, MCK/2; RA sets, RC clears
    movs r2, #CPCS
    movs r3, #3
    mov  r12, #0
    ldr  r5, =STATES
2:  str  r1, [r0, #4]
    ldr  r4, [r5, #4]           @ the first edge
    str  r4, [r0, #RA]
    add  r4, r4, #PULSE
    str  r4, [r0, #RC]
    str  r2, [r0, #IER]
    movs r4, #1                 @ the clock is enabled
    str  r4, [r0]
    adds r0, r0, #0x40
    adds r5, r5, #16
    subs r3, r3, #1
    bne  2b
    ldr  r0, =0xe000e100        @ interrupts 27, 28, 29
    mov  r1, #0x38000000
    str  r1, [r0]
    ldr  r0, =TC0
    movs r1, #1                 @ all three begin together
    str  r1, [r0, #0xc0]
    ldr  r0, =STATES + 0x40     @ what the program gets done meanwhile; it reads constants, as programs do
    movs r1, #0
loop:
    adds r1, r1, #1
    str  r1, [r0]
    ldr  r2, =0x12345678
    b    loop
