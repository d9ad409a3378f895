/* Products, quotients, remainders and shifts of 16, 32 and 64 bits, signed and unsigned. */
#include "output.h"

static void output_u64(uint64_t value) {
    output_u32((uint32_t)value);
    output_u32((uint32_t)(value >> 32));
}

int main(void) {
    output_begin();
    uint32_t state = 0x2545f491;
    uint64_t sum = 0;
    for (uint8_t round = 0; round < 120; round++) {
        uint32_t a = random_u32(&state);
        uint32_t b = random_u32(&state) >> (round & 31) | 1;
        uint64_t wide = (uint64_t)a << 32 | random_u32(&state);
        uint64_t narrow = (uint64_t)b << (round & 15) | 1;
        sum += (uint64_t)a * b;
        mark((uint8_t)sum);
        sum ^= a / b + a % b;
        mark((uint8_t)sum);
        sum += (uint64_t)((int32_t)a / (int32_t)b) - (uint64_t)((int16_t)a % (int16_t)(b | 1));
        mark((uint8_t)sum);
        sum ^= wide / narrow + wide % narrow;
        mark((uint8_t)sum);
        sum += (uint64_t)((int64_t)wide >> (a & 63)) ^ wide << (b & 63);
        mark((uint8_t)sum);
        sum += (uint64_t)((int64_t)wide * (int64_t)narrow);
        output_u64(sum);
    }
    output_end();
}
