/* Ackermann's function and permutations by recursion, tables in flash, calls through pointers: stack, LPM, ICALL. */
#include "output.h"
#include <avr/pgmspace.h>

static const uint8_t table[64] PROGMEM = {
    99, 124, 119, 123, 242, 107, 111, 197, 48, 1,   103, 43,  254, 215, 171, 118, 202, 130, 201, 125, 250, 89,
    71, 240, 173, 212, 162, 175, 156, 164, 114, 192, 183, 253, 147, 38,  54,  63,  247, 204, 52,  165, 229, 241,
    113, 216, 49, 21, 4, 199, 35, 195, 24, 150, 5, 154, 7, 18, 128, 226, 235, 39, 178, 117,
};

static uint16_t __attribute__((noinline)) ackermann(uint16_t m, uint16_t n) {
    mark((uint8_t)n);
    if (m == 0) return n + 1;
    if (n == 0) return ackermann(m - 1, 1);
    return ackermann(m - 1, ackermann(m, n - 1));
}

static uint8_t rotate(uint8_t x) { return (uint8_t)(x << 1 | x >> 7); }
static uint8_t swap(uint8_t x) { return (uint8_t)(x << 4 | x >> 4); }
static uint8_t negate(uint8_t x) { return (uint8_t)-x; }
static uint8_t look_up(uint8_t x) { return pgm_read_byte(&table[x & 63]); }

static uint8_t (*const volatile functions[])(uint8_t) = {rotate, swap, negate, look_up};

static uint32_t hash = 5381;

static void permute(uint8_t *items, uint8_t count) {
    if (count == 1) {
        for (uint8_t index = 0; index < 6; index++) hash = hash * 33 ^ items[index];
        mark((uint8_t)hash);
        return;
    }
    for (uint8_t index = 0; index < count; index++) {
        permute(items, count - 1);
        uint8_t other = count % 2 ? 0 : index;
        uint8_t item = items[other];
        items[other] = items[count - 1];
        items[count - 1] = item;
    }
}

int main(void) {
    output_begin();
    output_u32(ackermann(2, 9));
    uint8_t items[6] = {1, 2, 3, 5, 8, 13};
    permute(items, 6);
    output_u32(hash);
    uint8_t x = 1;
    for (uint16_t round = 0; round < 2000; round++) {
        x = (uint8_t)(functions[(round ^ x) & 3](x) + round);
        mark(x);
    }
    output_byte(x);
    output_end();
}
