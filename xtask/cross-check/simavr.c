/* Runs AVR code in simavr and prints what it did, in the lines that the emulator's example `cross_check` prints too.
 *
 *   simavr program IMAGE CYCLES  runs a raw flash image; a line `CYCLE BYTE` for each byte written to UDR0, and
 *                                `CYCLE mark BYTE` for each written to GPIOR0, at the cycle in which the writing
 *                                instruction ends; `CYCLE end` at SLEEP. `sent BYTE` is what left the UART.
 *   simavr instructions          one case a line on standard input, its after-state on standard output.
 *
 * The program's own words decide when something is logged, not simavr's peripherals: their timing is not the chip's.
 */
#include <simavr/sim_avr.h>
#include <simavr/sim_core.h>
#include <simavr/avr_uart.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { FLASH = 0x8000, SRAM_FIRST = 0x100, SRAM_END = 0x900, UDR0 = 0xc6, GPIOR0 = 0x3e, GPIOR1 = 0x4a, GPIOR2 = 0x4b };
enum { SPL = 0x5d, SPH = 0x5e };
enum { SLEEP = 0x9588 };

static uint16_t word_at(const avr_t *avr, uint32_t byte_address) {
    return (uint16_t)(avr->flash[byte_address] | avr->flash[byte_address + 1] << 8);
}

static uint8_t sreg_of(const avr_t *avr) {
    uint8_t sreg = 0;
    for (int bit = 0; bit < 8; bit++) sreg |= (uint8_t)((avr->sreg[bit] != 0) << bit);
    return sreg;
}

static void silent(avr_t *avr, const int level, const char *format, va_list arguments) {
    (void)avr, (void)level, (void)format, (void)arguments;
}

static avr_t *make(void) {
    avr_global_logger_set(silent);
    avr_t *avr = avr_make_mcu_by_name("atmega328p");
    if (!avr) {
        fputs("simavr does not know the atmega328p\n", stderr);
        exit(1);
    }
    avr_init(avr);
    avr->frequency = 16000000;
    avr->codeend = avr->flashend;
    return avr;
}

/* One instruction and what simavr does after each, without its usleep. */
static void step(avr_t *avr) {
    avr->run_cycle_count = avr->run_cycle_limit = 1;
    avr->state = cpu_Running;
    avr_flashaddr_t next = avr_run_one(avr);
    avr_cycle_timer_process(avr);
    avr->pc = next;
}

static void sent(struct avr_irq_t *irq, uint32_t value, void *parameter) {
    (void)irq, (void)parameter;
    printf("sent %02x\n", value & 0xff);
}

static int program(const char *path, avr_cycle_count_t cycles) {
    FILE *file = fopen(path, "rb");
    if (!file) return perror(path), 1;
    avr_t *avr = make();
    memset(avr->flash, 0xff, FLASH);
    size_t size = fread(avr->flash, 1, FLASH, file);
    fclose(file);
    if (size == 0) return 1;
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), sent, NULL);

    while (avr->cycle < cycles) {
        uint16_t word = word_at(avr, avr->pc);
        uint8_t source = (uint8_t)(word >> 4 & 31);
        uint8_t byte = avr->data[source];
        int to_uart = (word & 0xfe0f) == 0x9200 && word_at(avr, avr->pc + 2) == UDR0;
        int to_mark = (word & 0xf800) == 0xb800 && ((word >> 5 & 0x30) | (word & 0xf)) == GPIOR0 - 0x20;
        if (word == SLEEP) {
            printf("%llu end\n", (unsigned long long)avr->cycle);
            return 0;
        }
        step(avr);
        if (to_uart) printf("%llu %02x\n", (unsigned long long)avr->cycle, byte);
        if (to_mark) printf("%llu mark %02x\n", (unsigned long long)avr->cycle, byte);
    }
    puts("no end");
    return 0;
}

/* The memory that every case starts from. The emulator's example has the same function. */
static uint8_t pattern(uint32_t address) {
    return (uint8_t)(address * 0x9e3779b1u >> 24);
}

/* Case: `pc sreg sp w0 w1 w2 registers`, hexadecimal, pc in words, registers as 64 digits, r0 first.
 * Answer: `pc sreg sp cycles registers [address:byte]...` with the bytes of memory that changed. */
static int instructions(void) {
    avr_t *avr = make();
    for (uint32_t at = 0; at < FLASH; at++) avr->flash[at] = pattern(at);
    uint8_t before[SRAM_END];
    for (uint32_t at = 0; at < SRAM_END; at++) before[at] = pattern(at);

    char line[256];
    while (fgets(line, sizeof line, stdin)) {
        unsigned pc, sreg, sp, word[3];
        char registers[65];
        if (sscanf(line, "%x %x %x %x %x %x %64s", &pc, &sreg, &sp, &word[0], &word[1], &word[2], registers) != 7) return 1;
        for (int index = 0; index < 32; index++) {
            unsigned byte;
            sscanf(registers + 2 * index, "%2x", &byte);
            avr->data[index] = (uint8_t)byte;
        }
        for (int index = 0; index < 3; index++) {
            avr->flash[2 * (pc + index)] = (uint8_t)word[index];
            avr->flash[2 * (pc + index) + 1] = (uint8_t)(word[index] >> 8);
        }
        memcpy(avr->data + SRAM_FIRST, before + SRAM_FIRST, SRAM_END - SRAM_FIRST);
        avr->data[GPIOR0] = before[GPIOR0];
        avr->data[GPIOR1] = before[GPIOR1];
        avr->data[GPIOR2] = before[GPIOR2];
        avr->data[SPL] = (uint8_t)sp;
        avr->data[SPH] = (uint8_t)(sp >> 8);
        for (int bit = 0; bit < 8; bit++) avr->sreg[bit] = sreg >> bit & 1;
        avr->interrupt_state = 0;
        avr->pc = 2 * pc;
        avr->cycle = 0;
        avr->run_cycle_count = avr->run_cycle_limit = 1;
        avr->state = cpu_Running;
        avr_flashaddr_t next = avr_run_one(avr);
        if (avr->state == cpu_Crashed) {
            puts("crashed");
            continue;
        }

        printf("%04x %02x %04x %llu ", next / 2, sreg_of(avr), avr->data[SPL] | avr->data[SPH] << 8,
               (unsigned long long)avr->cycle);
        for (int index = 0; index < 32; index++) printf("%02x", avr->data[index]);
        static const uint16_t plain[] = {GPIOR0, GPIOR1, GPIOR2};
        for (int index = 0; index < 3; index++)
            if (avr->data[plain[index]] != before[plain[index]]) printf(" %03x:%02x", plain[index], avr->data[plain[index]]);
        for (int at = SRAM_FIRST; at < SRAM_END; at++)
            if (avr->data[at] != before[at]) printf(" %03x:%02x", at, avr->data[at]);
        putchar('\n');
        for (uint32_t at = 2 * pc; at < 2 * pc + 6; at++) avr->flash[at] = pattern(at);
    }
    return 0;
}

int main(int count, char **words) {
    if (count == 4 && !strcmp(words[1], "program")) return program(words[2], strtoull(words[3], NULL, 10));
    if (count == 2 && !strcmp(words[1], "instructions")) return instructions();
    fputs("usage: simavr program IMAGE CYCLES | simavr instructions\n", stderr);
    return 2;
}
