struct Row {
  uint16_t steps;    // bit 15: backward; 0: a wait
  uint16_t part;     // of the interval, ticks / 65536
  uint32_t ticks;    // of the interval, or the wait
  int32_t add;       // to the interval after each step, ticks / 65536
  int32_t add2;      // to that
};

// A time or an interval: ticks of 62.5 ns, and 1/65536 of them. Both wrap.
struct Fixed {
  uint16_t part;
  uint32_t ticks;
};

// What never changes of a motor.
struct Plan {
  uint16_t first, end, turn;     // rows; turn: where it begins again, or NEVER
  Fixed base, period;            // the step before the first turn; what each turn adds
  uint32_t rest;                 // of the period, ticks / 2^48
  uint8_t step_b, step_d;        // STEP on port B and D
  uint8_t dir_b, dir_d;          // DIR
  uint8_t forward;               // level of DIR that is forward
  uint16_t setup, hold;          // DIR comes so long before STEP at least, and after the STEP before it is over; ticks
};
const uint16_t NEVER = 0xffff;

