/* How the programs say what they computed, in a way that does not depend on how long a UART takes for a byte. */
#ifndef OUTPUT_H
#define OUTPUT_H

#include <avr/io.h>
#include <avr/sleep.h>
#include <stdint.h>

/* 1 M baud, 8 data bits: 160 cycles a byte. */
static inline void output_begin(void) {
    UCSR0A = _BV(U2X0);
    UBRR0 = 1;
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(TXEN0);
}

/* The byte leaves the UART; waits longer than any emulator takes for it, so that nobody polls. */
static void output_byte(uint8_t byte) {
    UDR0 = byte;
    __builtin_avr_delay_cycles(400);
}

static void output_u32(uint32_t value) {
    for (uint8_t index = 0; index < 4; index++) {
        output_byte((uint8_t)value);
        value >>= 8;
    }
}

/* A byte with its cycle, and no wait. */
static inline void mark(uint8_t byte) {
    GPIOR0 = byte;
}

static inline void output_end(void) {
    sleep_cpu();
}

/* Marsaglia's xorshift, 32 bits. */
static inline uint32_t random_u32(uint32_t *state) {
    uint32_t x = *state;
    x ^= x << 13;
    x ^= x >> 17;
    x ^= x << 5;
    return *state = x;
}

#endif
