// Plays a baked motion without the Arduino core: the image that `pulsetrain bake --output` puts tables behind.
//
// What lies at TABLES is laid out in crates/pulsetrain/src/bake/image.rs.

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/pgmspace.h>
#include <avr/sleep.h>
#include <util/delay_basic.h>

#include "types.h"

#define TABLES 0x0c00
#define MOST 4

struct Head {
  uint8_t mark[3];
  uint8_t motors;
  uint16_t pulse;                          // loops of 4 cycles
  uint32_t lead;
  uint8_t ddr_b, ddr_c, ddr_d;             // pins that are driven
  uint8_t port_b, port_c, port_d;          // and their first levels
  uint8_t lamp;
};

// As image.rs has them.
static_assert(sizeof(Head) == 17 && sizeof(Plan) == 31 && sizeof(Row) == 16, "tables are laid out otherwise");

static Head head_of_tables;
static Plan plans[MOST];
static const Row *rows;

#define MOTORS head_of_tables.motors
#define PULSE head_of_tables.pulse
#define LEAD head_of_tables.lead
#define LAMP head_of_tables.lamp

#include "player.h"

int main() {
  // A bootloader's watchdog may still run, and its pins be driven.
  MCUSR = 0;
  WDTCSR = _BV(WDCE) | _BV(WDE);
  WDTCSR = 0;
  memcpy_P(&head_of_tables, (const void *)TABLES, sizeof head_of_tables);
  const Head &read = head_of_tables;
  if (read.mark[0] != 'P' || read.mark[1] != 'T' || read.mark[2] != '1' || read.motors > MOST) {
    for (;;) {}
  }
  memcpy_P(plans, (const uint8_t *)TABLES + sizeof(Head), read.motors * sizeof(Plan));
  rows = (const Row *)(TABLES + sizeof(Head) + read.motors * sizeof(Plan));
  PORTB = read.port_b;
  PORTC = read.port_c;
  PORTD = read.port_d;
  DDRB = read.ddr_b;
  DDRC = read.ddr_c;
  DDRD = read.ddr_d;
  prepare();
  sei();
  play();
}
