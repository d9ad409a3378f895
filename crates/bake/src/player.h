// A motor while it moves.
struct Motor {
  uint16_t row, left;            // the next row; steps left in the present row
  bool backward, going;
  Fixed at, interval, add, add2; // time of the next step, and the interval after it with its differences
  Fixed base;
  uint32_t carry;
};
Motor motors[MOST];

// The look-ahead: edges that are worked out, but not made yet. An event has the ticks since the event before; the pins to
// toggle; whether they are toggled again after a pulse (STEP) or stay (DIR); and its least distance from the event
// before, loops of 4 cycles. The main program writes at `head`, the interrupt reads at `tail`.
struct Event {
  uint16_t wait;
  uint8_t b, d;
  bool pulse;
  uint8_t after;
};
const uint8_t EVENTS = 64;
Event events[EVENTS];
volatile uint8_t head, tail;
volatile bool ran_dry;
const uint16_t LONGEST = 0x7000; // longest wait of one event, ticks: times are compared within 16 bits
const uint16_t EARLY = 256; // ticks by which DIR comes earlier than it must, where there is room
const uint8_t ENTRY = 74;  // ticks from an event's time to its edge, at the latest
const uint8_t SPREAD = 16; // ticks by which the interrupt may come earlier than that
const int16_t AGAIN = 30;  // ticks from reading the counter to the event's edge
const int16_t RETURN = 60; // ticks to leave the interrupt and enter it again

// The compiler must not move reads and writes of an event across those of head and tail.
#define KEEP_ORDER() __asm__ volatile("" ::: "memory")

// Takes `cycles` cycles more than with 0; 15 at most. (`lpm` takes 3 cycles, a skip 1, `rjmp` 2.)
static inline void wait_cycles(uint8_t cycles) {
  __asm__ volatile(
      "sbrc %0, 0\n\trjmp .+0\n\t"
      "sbrc %0, 1\n\tlpm\n\t"
      "sbrs %0, 2\n\trjmp 1f\n\tlpm\n\tnop\n\tnop\n1:\t"
      "sbrs %0, 3\n\trjmp 2f\n\tlpm\n\tlpm\n\tlpm\n2:"
      : : "r"(cycles) : "r0");
}

// Makes the edges. This is the only interrupt, so each edge comes a constant time after its event's time, to the cycle.
// Only edges that lie closer together than this interrupt, or than a driver's DIR needs, are later. A late edge delays no
// other one: OCR1A counts on from the event's time.
ISR(TIMER1_COMPA_vect) {
  uint8_t next = tail;
  const Event *event = &events[next];
  for (;;) {
    uint8_t b = event->b, d = event->d;
    bool pulse = event->pulse;
    // The present instruction, sleep, and the loop below change the delay by some cycles: wait for the difference.
    uint8_t early = (uint8_t)(OCR1AL + ENTRY) - TCNT1L;
    wait_cycles(early < SPREAD ? early : 0);
    PINB = b;
    PIND = d;
    if (pulse) {
      _delay_loop_2(PULSE);
      PINB = b;
      PIND = d;
    }
    next = (next + 1) % EVENTS;
    KEEP_ORDER();
    tail = next;
    if (next == head) {
      TIMSK1 = 0;
      ran_dry = true;
      return;
    }
    event = &events[next];
    uint16_t due = OCR1A + event->wait;
    OCR1A = due;
    uint8_t after = event->after;
    int16_t left = due - TCNT1;
    if (after && left < 4 * (int16_t)after) {
      _delay_loop_2(after);
      left = due - TCNT1;
    }
    if (left > RETURN) {
      return;
    }
    // Too soon to leave the interrupt: wait here, and make the edge with the interrupt's usual delay. (A compare value
    // that has passed would match only after a whole turn of the counter.)
    while ((int16_t)(TCNT1 - due) < ENTRY - AGAIN) {}
    TIFR1 = _BV(OCF1A);
  }
}

static inline __attribute__((always_inline)) void plus(Fixed &a, const Fixed &b) {
  uint32_t sum = (uint32_t)a.part + b.part;
  a.part = sum;
  a.ticks += b.ticks + (sum >> 16);
}

static Fixed signed_fixed(int32_t value) {
  Fixed fixed = { (uint16_t)value, (uint32_t)(value >> 16) };
  return fixed;
}

// Goes to the motor's next step. Each turn begins at its own exact time, so that no rounding error grows.
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

// Starts the timer once the ring is full, or contains the whole motion.
static void start() {
  if (!started) {
    started = true;
    OCR1A = events[tail].wait;
    TIFR1 = _BV(OCF1A);
    TIMSK1 = _BV(OCIE1A);
    TCCR1B = _BV(CS10); // 16 MHz: a tick is a cycle
  }
}

// Underrun: steps came faster than they could be worked out. The motors stop, since late steps are worse than none. The
// lamp is on.
static void stop_if_dry() {
  if (ran_dry) {
    DDRB |= LAMP;
    PORTB |= LAMP;
    for (;;) {}
  }
}

uint32_t last; // tick of the newest event

// Adds an event. If it is far away, events that do nothing come before it. Waits while the ring is full.
static void put(uint32_t tick, uint8_t b, uint8_t d, bool pulse, uint8_t after) {
  for (;;) {
    uint32_t wait = tick - last;
    bool far = wait > LONGEST;
    uint8_t next = (head + 1) % EVENTS;
    while (next == tail) {
      start();
      stop_if_dry();
      // A sleeping processor answers an interrupt with a constant delay. The ring is full, so there is no underrun here.
      sleep_cpu();
    }
    Event &event = events[head];
    event.wait = far ? LONGEST / 2 : wait;
    event.b = far ? 0 : b;
    event.d = far ? 0 : d;
    event.pulse = !far && pulse;
    event.after = far ? 0 : after;
    last += event.wait;
    KEEP_ORDER();
    head = next;
    if (!far) {
      return;
    }
  }
}

// Converts ticks to loops of 4 cycles.
static uint8_t loops(uint16_t ticks) {
  return (ticks + 3) / 4;
}

uint8_t dir_b, dir_d; // levels of the DIR lines

// Adds the earliest step of all motors, and all steps in the same tick. Gives false at the end of the motion.
static bool produce() {
  const Motor *first = 0;
  uint8_t number = 0;
  bool together = false;
  for (uint8_t other = 0; other < MOTORS; other++) {
    const Motor &motor = motors[other];
    int32_t later = first ? (int32_t)(motor.at.ticks - first->at.ticks) : -1;
    if (!motor.going || later > 0) {
      continue;
    }
    together = later == 0;
    if (later < 0) {
      first = &motor;
      number = other;
    }
  }
  if (!first) {
    return false;
  }
  uint32_t tick = first->at.ticks;
  uint8_t b = 0, d = 0, turn_b = 0, turn_d = 0;
  uint16_t setup = 0, hold = 0;
  do {
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
      hold = plan.hold > hold ? plan.hold : hold;
    }
    advance(number);
  } while (together && ++number < MOTORS);
  if (turn_b | turn_d) {
    dir_b ^= turn_b;
    dir_d ^= turn_d;
    // DIR changes after the hold and before the setup, in the middle of the time between. If another motor's step has
    // taken that time, the interrupt keeps hold and setup all the same, and makes this step later.
    uint32_t gap = tick - last, need = 4 * PULSE + hold + setup;
    uint32_t spare = gap > need ? (gap - need) / 2 : 0;
    uint32_t lead = setup + (spare < EARLY ? spare : EARLY);
    put(tick - (lead < gap ? lead : gap), turn_b, turn_d, false, loops(hold));
  }
  put(tick, b, d, true, loops(setup));
  return true;
}

// Prepares the motors and the timer, before the first tick.
static void prepare() {
  set_sleep_mode(SLEEP_MODE_IDLE);
  sleep_enable();
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

// Plays the motion to its end, if it has one.
static void play() {
  while (produce()) {
    stop_if_dry();
  }
  start();
  for (;;) {
    sleep_cpu();
  }
}
