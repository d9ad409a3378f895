; What the speed is measured on: arithmetic on RAM without a pause, a compare interrupt of Timer1 every 400 cycles that
; toggles a pin, and every received character sent back. Assembled into busy.hex by:
;   avr-gcc -mmcu=atmega328p -nostdlib -o busy.elf busy.s && avr-objcopy -O ihex busy.elf busy.hex
.equ PIND, 0x09
.equ DDRD, 0x0a
.equ UCSR0A, 0xc0
.equ UDR0, 0xc6
.equ OCR1AH, 0x89
.equ OCR1AL, 0x88
        .org 0
        jmp start
        .org 11*4
        jmp compare
        .org 18*4
        jmp received
        .org 26*4
start:  ldi r16, 0xff
        out DDRD, r16
        ldi r16, 2
        sts UCSR0A, r16         ; U2X
        ldi r16, 1
        sts 0xc4, r16           ; 1 Mbaud
        ldi r16, 0x98
        sts 0xc1, r16           ; RXCIE, RXEN, TXEN
        ldi r16, 2
        sts 0x6f, r16           ; OCIE1A
        ldi r16, 1
        sts 0x81, r16           ; Timer1 at clk/1
        ldi r20, 0
        sei
outer:  ldi r28, 0              ; CRC-16 over 256 bytes of RAM
        ldi r29, 1
        ldi r24, 0xff
        ldi r25, 0xff
inner:  ld r18, Y
        eor r25, r18
        ldi r19, 8
bits:   lsl r24
        rol r25
        brcc 1f
        ldi r21, 0x10
        eor r25, r21
        ldi r21, 0x21
        eor r24, r21
1:      dec r19
        brne bits
        mul r24, r18
        add r18, r0
        adc r18, r1
        st Y+, r18
        rcall leaf
        dec r20
        brne inner
        rjmp outer
leaf:   push r18
        subi r18, 3
        sbci r19, 0
        pop r18
        ret
compare:
        push r16
        in r16, 0x3f
        push r16
        push r17
        push r18
        ldi r16, 4
        out PIND, r16
        lds r16, OCR1AL
        lds r17, OCR1AH
        ldi r18, 0x90           ; 400
        add r16, r18
        ldi r18, 1
        adc r17, r18
        sts OCR1AH, r17
        sts OCR1AL, r16
        ldi r16, 4
        out PIND, r16
        pop r18
        pop r17
        pop r16
        out 0x3f, r16
        pop r16
        reti
received:
        push r16
        lds r16, UDR0
        sts UDR0, r16
        pop r16
        reti
