//! What Timer/Counter 0, 1 and 2 have in common: the counter, its compare units and waveforms (DS40002061B §15.4 to
//! §15.8, §16.7 to §16.10, §18.4 to §18.8). The registers are in `timer8` and `timer16`.
//!
//! Timer clock edges are instants; the counter keeps its value from one edge to the next. The value *before* an edge
//! decides what the edge does: if it equalled OCRnx, OCFnx is set and the pin changes, and the counter steps at the
//! same edge (figures 15-8 to 15-11, 16-10 to 16-13). So a match appears one timer clock after the counter reached
//! OCRnx.
//!
//! A counter takes no computing time between events. A read brings it up to date, and `next_event` is the time of the
//! next edge that changes a pin or raises an interrupt.
//!
//! Not emulated: Timer2 with a crystal of its own (§18.9).

/// Bits of TIFRn and TIMSKn.
pub(super) const TOV: u8 = 1;
pub(super) const OCF: [u8; 2] = [1 << 1, 1 << 2];
pub(super) const ICF: u8 = 1 << 5;

/// How the counter runs (tables 15-8, 16-4, 18-8).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shape {
    /// Normal and CTC mode: counts up, then from TOP or MAX to 0. A new OCRnx counts at once.
    Plain,
    /// Fast PWM: counts up, then from TOP to 0. A new OCRnx counts from BOTTOM on.
    Fast,
    /// Phase correct PWM: counts up and down. A new OCRnx counts from TOP on.
    PhaseCorrect,
    /// Phase and frequency correct PWM: counts up and down. A new OCRnx counts from BOTTOM on.
    PhaseFrequencyCorrect,
}

impl Shape {
    const fn is_pwm(self) -> bool {
        !matches!(self, Shape::Plain)
    }

    const fn is_dual(self) -> bool {
        matches!(self, Shape::PhaseCorrect | Shape::PhaseFrequencyCorrect)
    }
}

/// The highest value of the counter, TOP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Top {
    Fixed(u16),
    OcrA,
    Icr,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Mode {
    pub(super) shape: Shape,
    pub(super) top: Top,
}

/// What clocks the counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Clock {
    Stopped,
    /// One edge in every so many cycles of the system clock.
    Prescaled(u64),
    /// The rising edges of a pin, or its falling edges.
    Pin {
        rising: bool,
    },
}

/// What a timer does to its output pins.
pub(super) trait Outputs {
    fn drive(&mut self, channel: usize, driven: Option<bool>, cycle: u64);
}

#[derive(Clone)]
pub(super) struct Timer {
    /// MAX: 0xff or 0xffff.
    max: u16,
    value: u16,
    down: bool,
    mode: Mode,
    clock: Clock,
    /// The cycle up to which the timer's clock edges have been counted.
    now: u64,
    /// The cycle in which the prescaler was last 0.
    origin: u64,
    /// No edges come: the prescaler is held in reset, or PRR has stopped the clock.
    held: bool,
    /// The counter was just written, so that the next edge makes no match (§16.7.2).
    blocked: bool,
    compare: [u16; 2],
    buffer: [u16; 2],
    pub(super) icr: u16,
    /// COMnx1:0 of both channels.
    com: [u8; 2],
    /// The OCnx flip-flops that drive the pins.
    output: [bool; 2],
    pub(super) flags: u8,
    pub(super) mask: u8,
}

impl Timer {
    pub(super) fn new(max: u16) -> Timer {
        Timer {
            max,
            value: 0,
            down: false,
            mode: Mode { shape: Shape::Plain, top: Top::Fixed(max) },
            clock: Clock::Stopped,
            now: 0,
            origin: 0,
            held: false,
            blocked: false,
            compare: [0; 2],
            buffer: [0; 2],
            icr: 0,
            com: [0; 2],
            output: [false; 2],
            flags: 0,
            mask: 0,
        }
    }

    /// Resets the timer in `cycle`. The caller resets the ports, which disconnects the outputs.
    pub(super) fn reset(&mut self, cycle: u64) {
        *self = Timer { now: cycle, origin: cycle, ..Timer::new(self.max) };
    }

    /// The pending interrupts: bits as in TIFRn.
    pub(super) fn pending(&self) -> u8 {
        self.flags & self.mask
    }

    pub(super) fn value(&self) -> u16 {
        self.value
    }

    pub(super) fn compare_register(&self, channel: usize) -> u16 {
        if self.mode.shape.is_pwm() { self.buffer[channel] } else { self.compare[channel] }
    }

    pub(super) fn icr_is_top(&self) -> bool {
        self.mode.top == Top::Icr
    }

    pub(super) fn clock(&self) -> Clock {
        self.clock
    }

    fn top(&self) -> u16 {
        match self.mode.top {
            Top::Fixed(top) => top,
            Top::OcrA => self.compare[0],
            Top::Icr => self.icr,
        }
    }

    /// Whether a channel drives its pin (tables 15-2 to 15-7, 16-1 to 16-3, 18-2 to 18-7).
    fn drives(&self, channel: usize) -> bool {
        match self.com[channel] {
            0 => false,
            // In PWM modes, toggling exists for channel A alone, with OCRnA or ICRn as TOP (see the tables).
            1 if self.mode.shape.is_pwm() => channel == 0 && self.toggles_in_pwm(),
            _ => true,
        }
    }

    fn toggles_in_pwm(&self) -> bool {
        match self.mode.top {
            Top::OcrA => true,
            // Table 16-2 allows it in modes 14 and 15, table 16-3 only in modes 9 and 11.
            Top::Icr => self.mode.shape == Shape::Fast,
            Top::Fixed(_) => false,
        }
    }

    fn announce(&self, channel: usize, cycle: u64, outputs: &mut impl Outputs) {
        outputs.drive(channel, self.drives(channel).then_some(self.output[channel]), cycle);
    }

    fn set_output(&mut self, channel: usize, level: bool, cycle: u64, outputs: &mut impl Outputs) {
        if self.drives(channel) && self.output[channel] != level {
            self.output[channel] = level;
            outputs.drive(channel, Some(level), cycle);
        }
    }

    // Writes of registers. The caller has brought the timer up to `cycle`, in which the write takes effect.

    pub(super) fn write_value(&mut self, value: u16) {
        self.value = value & self.max;
        self.blocked = true;
        if !self.mode.shape.is_dual() || self.value == 0 {
            self.down = false;
        } else if self.value == self.top() {
            self.down = true;
        }
    }

    pub(super) fn write_compare(&mut self, channel: usize, value: u16) {
        self.buffer[channel] = value & self.max;
        if !self.mode.shape.is_pwm() {
            self.compare[channel] = self.buffer[channel];
        }
    }

    pub(super) fn set_mode(&mut self, mode: Mode, com: [u8; 2], cycle: u64, outputs: &mut impl Outputs) {
        if !mode.shape.is_pwm() {
            // Outside PWM modes OCRnx has no buffer (§15.5).
            self.compare = self.buffer;
        }
        if !mode.shape.is_dual() {
            self.down = false;
        }
        self.mode = mode;
        self.com = com;
        for channel in 0..2 {
            self.announce(channel, cycle, outputs);
        }
    }

    pub(super) fn set_clock(&mut self, clock: Clock) {
        self.clock = clock;
    }

    /// FOCnx: the pin changes as at a match, and nothing else happens. PWM modes ignore it (§15.9.2, §16.11.3).
    pub(super) fn force(&mut self, channel: usize, cycle: u64, outputs: &mut impl Outputs) {
        if !self.mode.shape.is_pwm() {
            self.act(channel, self.com[channel], cycle, outputs);
        }
    }

    /// Resets the prescaler to 0 in `cycle`; with `hold` it stays there.
    pub(super) fn reset_prescaler(&mut self, cycle: u64, hold: bool) {
        self.origin = cycle;
        self.now = cycle;
        self.held = hold;
    }

    /// The clock runs again from `cycle` on. It stood still since the timer was last brought up to date.
    pub(super) fn resume(&mut self, cycle: u64) {
        self.origin += cycle - self.now;
        self.now = cycle;
    }

    /// Captures the counter into ICRn (§16.6), unless ICRn is TOP.
    pub(super) fn capture(&mut self) {
        if !self.icr_is_top() {
            self.icr = self.value;
            self.flags |= ICF;
        }
    }

    // Time: edges, events and their order.

    /// The cycle of the `n`th edge from now, n ≥ 1.
    fn edge_cycle(&self, n: u64, period: u64) -> u64 {
        if period == 1 { self.now + n } else { self.origin + ((self.now - self.origin) / period + n) * period }
    }

    /// Brings the timer up to date, the edge in `cycle` included.
    pub(super) fn advance(&mut self, cycle: u64, outputs: &mut impl Outputs) {
        if cycle <= self.now {
            return;
        }
        let Clock::Prescaled(period) = self.clock else {
            self.now = cycle;
            return;
        };
        if self.held {
            // While held, the prescaler stays at 0.
            (self.now, self.origin) = (cycle, cycle);
            return;
        }
        loop {
            let edges = if period == 1 {
                cycle - self.now
            } else {
                (cycle - self.origin) / period - (self.now - self.origin) / period
            };
            let quiet = u64::from(self.quiet_edges());
            if edges <= quiet {
                self.skip(edges as u16);
                self.now = cycle;
                return;
            }
            self.skip(quiet as u16);
            let at = self.edge_cycle(quiet + 1, period);
            self.now = at;
            self.edge(at, outputs);
        }
    }

    /// One edge of the pin that clocks the timer.
    pub(super) fn count(&mut self, cycle: u64, outputs: &mut impl Outputs) {
        self.now = cycle;
        self.edge(cycle, outputs);
    }

    /// The next cycle in which a pin may change or an interrupt become pending; `u64::MAX` if there is none.
    pub(super) fn next_event(&self) -> u64 {
        let Clock::Prescaled(period) = self.clock else { return u64::MAX };
        if self.held {
            return u64::MAX;
        }
        let wanted = self.mask & !self.flags;
        let seen = [0, 1].map(|channel| wanted & OCF[channel] != 0 || self.com[channel] != 0);
        if !seen[0] && !seen[1] && wanted & (TOV | ICF) == 0 {
            return u64::MAX;
        }
        // The next turn is an event too, because the distances below hold only up to it.
        let mut edges = self.turn();
        for (seen, compare) in seen.into_iter().zip(self.compare) {
            if seen {
                edges = edges.min(self.distance(compare));
            }
        }
        self.edge_cycle(u64::from(edges) + 1, period)
    }

    /// Edges until the counter reaches a value before its next turn; MAX if it does not.
    fn distance(&self, value: u16) -> u16 {
        let distance = if self.down { self.value.checked_sub(value) } else { value.checked_sub(self.value) };
        distance.unwrap_or(u16::MAX)
    }

    /// Edges until the counter turns: at TOP, at MAX if the counter is above TOP, at BOTTOM.
    fn turn(&self) -> u16 {
        if self.mode.shape.is_dual() {
            let top = self.top();
            if self.value == 0 || self.value == top {
                return 0;
            }
            if self.down {
                // A program has set the counter above TOP: it meets TOP on its way down.
                return self.value.checked_sub(top).unwrap_or(self.value);
            }
        }
        self.distance(self.top()).min(self.max - self.value)
    }

    /// Edges that only step the counter, before the next one that does more.
    fn quiet_edges(&self) -> u16 {
        if self.blocked {
            return 0;
        }
        self.turn().min(self.distance(self.compare[0])).min(self.distance(self.compare[1]))
    }

    fn skip(&mut self, edges: u16) {
        if self.down {
            self.value -= edges;
        } else {
            self.value += edges;
        }
    }

    /// Changes a pin as a match does. `com` is to be read as in the tables for counting up.
    fn act(&mut self, channel: usize, com: u8, cycle: u64, outputs: &mut impl Outputs) {
        match com {
            1 => self.set_output(channel, !self.output[channel], cycle, outputs),
            2 => self.set_output(channel, false, cycle, outputs),
            3 => self.set_output(channel, true, cycle, outputs),
            _ => {}
        }
    }

    /// Handles one edge. The counter's value before the edge decides what happens.
    fn edge(&mut self, cycle: u64, outputs: &mut impl Outputs) {
        let (value, top) = (self.value, self.top());
        let blocked = std::mem::take(&mut self.blocked);
        if self.mode.shape.is_dual() && (value == top || value == 0) {
            // At TOP the counter turns down, from wherever it came.
            self.down = value != 0;
        }
        for (channel, flag) in OCF.into_iter().enumerate() {
            if value == self.compare[channel] && !blocked {
                self.flags |= flag;
                self.matched(channel, value == top, cycle, outputs);
            }
        }
        if self.mode.shape.is_dual() {
            self.dual_edge(top, cycle, outputs);
            return;
        }
        // In CTC mode with OCRnA the match itself clears the counter, and a blocked match does not.
        let at_top = value == top && !(blocked && self.mode.top == Top::OcrA);
        if at_top && self.mode.top == Top::Icr {
            self.flags |= ICF;
        }
        let overflow = if self.mode.shape == Shape::Fast { at_top } else { value == self.max };
        if overflow {
            self.flags |= TOV;
        }
        if at_top || value == self.max {
            self.value = 0;
            if self.mode.shape == Shape::Fast {
                self.compare = self.buffer;
                for channel in 0..2 {
                    // At BOTTOM, non-inverting mode sets the pin and inverting mode clears it.
                    if self.com[channel] >= 2 {
                        self.set_output(channel, self.com[channel] == 2, cycle, outputs);
                    }
                }
            }
        } else {
            self.value += 1;
        }
    }

    fn matched(&mut self, channel: usize, at_top: bool, cycle: u64, outputs: &mut impl Outputs) {
        let com = self.com[channel];
        let com = match self.mode.shape {
            // In fast PWM a match at TOP changes nothing; BOTTOM decides the level (§16.9.3).
            Shape::Fast if at_top && com >= 2 => return,
            // While it counts down, the pin changes in the opposite direction.
            Shape::PhaseCorrect | Shape::PhaseFrequencyCorrect if self.down && com >= 2 => com ^ 1,
            _ => com,
        };
        self.act(channel, com, cycle, outputs);
    }

    fn dual_edge(&mut self, top: u16, cycle: u64, outputs: &mut impl Outputs) {
        let value = self.value;
        if value == top && value != 0 {
            if self.mode.top == Top::Icr {
                self.flags |= ICF;
            }
            if self.mode.shape == Shape::PhaseCorrect {
                self.compare = self.buffer;
            }
            // At TOP the pin takes the level that a match on the way up leaves, even if that match was missed. So the
            // pulses are symmetric (§15.7.4).
            for channel in 0..2 {
                let is_top = channel == 0 && self.mode.top == Top::OcrA;
                if self.com[channel] >= 2 && self.compare[channel] < top && !is_top {
                    self.act(channel, self.com[channel], cycle, outputs);
                }
            }
            self.down = true;
            self.value = value - 1;
        } else if value == 0 {
            self.flags |= TOV;
            if self.mode.shape == Shape::PhaseFrequencyCorrect || top == 0 {
                self.compare = self.buffer;
            }
            self.down = false;
            // TOP = 0 is below the lowest resolution (§16.9.4). The counter stays at 0 until TOP is larger.
            self.value = u16::from(self.top() != 0);
        } else if self.down {
            self.value = value - 1;
        } else if value == self.max {
            // A program has set TOP below the counter: it counts on to MAX and then goes to 0.
            self.value = 0;
        } else {
            self.value = value + 1;
        }
    }
}
