/* CRC-32 of a buffer, a heap sort of it, and the CRC again: loads, stores, shifts, compares, calls. */
#include "output.h"

enum { COUNT = 300 };
static uint16_t values[COUNT];

static uint32_t crc32(const uint8_t *bytes, uint16_t count) {
    uint32_t crc = 0xffffffff;
    while (count--) {
        crc ^= *bytes++;
        for (uint8_t bit = 0; bit < 8; bit++) crc = crc & 1 ? crc >> 1 ^ 0xedb88320 : crc >> 1;
    }
    return ~crc;
}

static void sift(uint16_t *heap, uint16_t root, uint16_t count) {
    for (;;) {
        uint16_t child = 2 * root + 1;
        if (child >= count) return;
        if (child + 1 < count && heap[child + 1] > heap[child]) child++;
        if (heap[root] >= heap[child]) return;
        uint16_t larger = heap[child];
        heap[child] = heap[root];
        heap[root] = larger;
        root = child;
    }
}

int main(void) {
    output_begin();
    uint32_t state = 0x12345678;
    for (uint8_t round = 0; round < 8; round++) {
        for (uint16_t index = 0; index < COUNT; index++) values[index] = (uint16_t)random_u32(&state);
        output_u32(crc32((const uint8_t *)values, sizeof values));
        for (uint16_t index = COUNT / 2; index-- > 0;) {
            sift(values, index, COUNT);
            mark((uint8_t)values[0]);
        }
        for (uint16_t last = COUNT - 1; last > 0; last--) {
            uint16_t largest = values[0];
            values[0] = values[last];
            values[last] = largest;
            sift(values, 0, last);
            mark((uint8_t)largest);
        }
        output_u32(crc32((const uint8_t *)values, sizeof values));
    }
    output_end();
}
