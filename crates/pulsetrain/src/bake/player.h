// What does.
struct Motor {
  uint16_t row, left;            // the next row; steps left of the present one
  bool backward, going;
  Fixed at, interval, add, add2; // the next step, and how it goes on
  Fixed base;
  uint32_t carry;
};
Motor motors[MOST];

// Edges that are worked out, and not made yet: ticks since the event before; pins to toggle, and those to toggle again
// after a pulse. The producer writes at `head`, the interrupt reads at `tail`.
struct Event {
  uint16_t wait;
  uint8_t b, d, pulse_b, pulse_d;
};
const uint8_t EVENTS = 64;
Event events[EVENTS];
volatile uint8_t head, tail;
volatile bool ran_dry;
const uint16_t LONGEST = 0x7000; // a wait

// Makes what is due. It is the only interrupt, so that it is never late by more than an instruction, but for edges that
// lie closer together than it takes itself.
ISR(TIMER1_COMPA_vect) {
  for (;;) {
    const Event &event = events[tail];
    PINB = event.b;
    PIND = event.d;
    if (event.pulse_b | event.pulse_d) {
      _delay_loop_2(PULSE);
      PINB = event.pulse_b;
      PIND = event.pulse_d;
    }
    uint8_t next = (tail + 1) % EVENTS;
    tail = next;
    if (next == head) {
      TIMSK1 = 0;
      ran_dry = true;
      return;
    }
    uint16_t due = OCR1A + events[next].wait;
    OCR1A = due;
    if ((int16_t)(due - TCNT1) > RETURN) {
      return;
    }
    // Too soon for leaving and coming again: it is waited for, and made as late as the interrupt would make it. (A
    // compare value that has passed would wait for a whole turn of the counter.)
    while ((int16_t)(TCNT1 - due) < ENTRY) {}
    TIFR1 = _BV(OCF1A);
  }
}

static inline void plus(Fixed &a, const Fixed &b) {
  uint32_t sum = (uint32_t)a.part + b.part;
  a.part = sum;
  a.ticks += b.ticks + (sum >> 16);
}

static Fixed signed_fixed(int32_t value) {
  Fixed fixed = { (uint16_t)value, (uint32_t)(value >> 16) };
  return fixed;
}

// To the motor's next step. What repeats begins each time at its own exact time, so that nothing adds up.
static void advance(uint8_t number) {
  Motor &motor = motors[number];
  const Plan &plan = plans[number];
  while (motor.left == 0) {
    if (motor.row == plan.end) {
      if (plan.turn == NEVER) {
        motor.going = false;
        return;
      }
      motor.row = plan.turn;
      plus(motor.base, plan.period);
      motor.carry += plan.rest;
      if (motor.carry < plan.rest) {
        Fixed least = { 1, 0 };
        plus(motor.base, least);
      }
      motor.at = motor.base;
    }
    Row row;
    memcpy_P(&row, &rows[motor.row++], sizeof row);
    if (row.steps == 0) {
      motor.at.ticks += row.ticks;
    } else {
      motor.left = row.steps & 0x7fff;
      motor.backward = row.steps >> 15;
      motor.interval.part = row.part;
      motor.interval.ticks = row.ticks;
      motor.add = signed_fixed(row.add);
      motor.add2 = signed_fixed(row.add2);
    }
  }
  motor.left--;
  plus(motor.at, motor.interval);
  plus(motor.interval, motor.add);
  plus(motor.add, motor.add2);
}

bool started;

// Begins once the ring is full, or all is in it.
static void start() {
  if (!started) {
    started = true;
    OCR1A = events[tail].wait;
    TIFR1 = _BV(OCF1A);
    TIMSK1 = _BV(OCIE1A);
    TCCR1B = _BV(CS10); // 16 MHz: a tick is a cycle
  }
}

uint32_t last; // tick of the event that was put in last

// Puts an event in, with others before it that do nothing if it is far away; waits while there is no room.
static void put(uint32_t tick, uint8_t b, uint8_t d, uint8_t pulse_b, uint8_t pulse_d) {
  for (;;) {
    uint32_t wait = tick - last;
    bool far = wait > LONGEST;
    uint8_t next = (head + 1) % EVENTS;
    while (next == tail) {
      start();
    }
    Event &event = events[head];
    event.wait = far ? LONGEST / 2 : wait;
    event.b = far ? 0 : b;
    event.d = far ? 0 : d;
    event.pulse_b = far ? 0 : pulse_b;
    event.pulse_d = far ? 0 : pulse_d;
    last += event.wait;
    head = next;
    if (!far) {
      return;
    }
  }
}

uint8_t dir_b, dir_d; // levels of the DIR lines

// The next step of whichever motor is first, and all that come at the same tick.
static bool produce() {
  int8_t first = -1;
  for (uint8_t number = 0; number < MOTORS; number++) {
    if (motors[number].going && (first < 0 || (int32_t)(motors[number].at.ticks - motors[first].at.ticks) < 0)) {
      first = number;
    }
  }
  if (first < 0) {
    return false;
  }
  uint32_t tick = motors[first].at.ticks;
  uint8_t b = 0, d = 0, turn_b = 0, turn_d = 0;
  uint16_t setup = 0, clear = 0;
  for (uint8_t number = first; number < MOTORS; number++) {
    const Plan &plan = plans[number];
    if (!motors[number].going || motors[number].at.ticks != tick) {
      continue;
    }
    b |= plan.step_b;
    d |= plan.step_d;
    bool high = plan.forward != motors[number].backward;
    uint8_t wrong_b = (high ? ~dir_b : dir_b) & plan.dir_b;
    uint8_t wrong_d = (high ? ~dir_d : dir_d) & plan.dir_d;
    if (wrong_b | wrong_d) {
      turn_b |= wrong_b;
      turn_d |= wrong_d;
      setup = plan.setup > setup ? plan.setup : setup;
      clear = plan.clear > clear ? plan.clear : clear;
    }
    advance(number);
  }
  if (turn_b | turn_d) {
    dir_b ^= turn_b;
    dir_d ^= turn_d;
    // Well before the step if there is room: the interrupt takes its time for both.
    uint32_t gap = tick - last;
    uint32_t lead = gap / 2 < EARLY ? gap / 2 : EARLY;
    if (lead + clear > gap) {
      lead = gap > clear ? gap - clear : 0;
    }
    if (lead < setup) {
      lead = setup < gap ? setup : gap;
    }
    put(tick - lead, turn_b, turn_d, 0, 0);
    if (lead < setup) {
      tick += setup - lead;
    }
  }
  put(tick, b, d, b, d);
  return true;
}

// Before the first tick.
static void prepare() {
  TCCR1A = 0;
  TCCR1B = 0;
  TCNT1 = 0;
  for (uint8_t number = 0; number < MOTORS; number++) {
    Motor &motor = motors[number];
    motor.row = plans[number].first;
    motor.base = plans[number].base;
    motor.going = true;
    motor.at.ticks = LEAD;
    motor.at.part = 0x8000;
    motor.base.ticks += LEAD;
    advance(number);
  }
}

// From the first tick to the last, if there is one.
static void play() {
  while (produce()) {
    if (ran_dry) {
      // Steps came faster than they could be worked out: better none than late ones. The lamp shines.
      DDRB |= LAMP;
      PORTB |= LAMP;
      for (;;) {}
    }
  }
  start();
  for (;;) {}
}
