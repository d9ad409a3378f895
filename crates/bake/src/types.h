struct Row {
  uint16_t steps;    // bit 15: backward; 0: a wait
  uint16_t part;     // fraction of the interval, ticks / 65536
  uint32_t ticks;    // whole ticks of the interval, or of the wait
  int32_t add;       // added to the interval after each step, ticks / 65536
  int32_t add2;      // added to `add` after each step
};

// A time or an interval: ticks of 62.5 ns, and 1/65536 of them. Both wrap.
struct Fixed {
  uint16_t part;
  uint32_t ticks;
};

// A motor's constants.
struct Plan {
  uint16_t first, end, turn;     // rows; turn: the row where a turn begins again, or NEVER
  Fixed base, period;            // time of the step before the first turn; period of a turn
  uint32_t rest;                 // fraction of the period, ticks / 2^48
  uint8_t step_b, step_d;        // STEP on port B and D
  uint8_t dir_b, dir_d;          // DIR
  uint8_t forward;               // level of DIR that is forward
  uint16_t setup, hold;          // least time from DIR to STEP, and from the end of a STEP pulse to DIR; ticks
};
const uint16_t NEVER = 0xffff;

