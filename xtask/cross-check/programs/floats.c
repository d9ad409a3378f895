/* Floats in software: sine, square root, exponential, logarithm, division, conversion both ways. */
#include "output.h"
#include <math.h>

static void output_float(float value) {
    union {
        float value;
        uint32_t bits;
    } both = {.value = value};
    output_u32(both.bits);
}

int main(void) {
    output_begin();
    float sum = 0;
    for (int16_t index = -60; index < 60; index++) {
        float x = (float)index * 0.173f;
        float y = sinf(x);
        mark((uint8_t)(int16_t)(100 * y));
        y += sqrtf(fabsf(x)) / (1.5f + cosf(x));
        mark((uint8_t)(int16_t)y);
        y += expf(x / 4) * logf(1 + x * x);
        sum += y;
        output_float(y);
        output_u32((uint32_t)(int32_t)(sum * 1000));
    }
    output_end();
}
