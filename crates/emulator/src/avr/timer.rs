//! What Timer/Counter 0, 1 and 2 have in common: the counter, its compare units and waveforms (DS40002061B §15.4 to
//! §15.8, §16.7 to §16.10, §18.4 to §18.8).
//!
//! Timer clock edges are instants: the counter has a value from one to the next. At an edge, what the counter *was*
//! decides: if it equalled OCRnx, OCFnx is set and the pin moves, together with the counter's own step (figures 15-8
//! to 15-11, 16-10 to 16-13). A match with a value is thus seen one timer clock after the counter took it.
//!
//! Between events a counter costs nothing: it is brought up to date when somebody looks, and `next_event` is the next
//! edge that would move a pin or raise an interrupt.

/// Bits of TIFRn and TIMSKn.
pub(super) const TOV: u8 = 1;
pub(super) const OCF: [u8; 2] = [1 << 1, 1 << 2];
pub(super) const ICF: u8 = 1 << 5;

/// How the counter runs (tables 15-8, 16-4, 18-8).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shape {
    /// Up, and from TOP or MAX to 0; OCRnx at once: normal and CTC.
    Plain,
    /// Up, and from TOP to 0; OCRnx at BOTTOM.
    Fast,
    /// Up and down; OCRnx at TOP.
    PhaseCorrect,
    /// Up and down; OCRnx at BOTTOM.
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

/// What the counter runs to.
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
    /// Every so many cycles of the system clock.
    Prescaled(u64),
    /// Edges of a pin; those that rise, or those that fall.
    Pin {
        rising: bool,
    },
}

/// Something happened to a compare output in a cycle.
pub(super) trait Outputs {
    fn drive(&mut self, channel: usize, driven: Option<bool>, cycle: u64);
}

#[derive(Clone)]
pub(super) struct Timer {
    /// 0xff or 0xffff.
    max: u16,
    value: u16,
    down: bool,
    mode: Mode,
    clock: Clock,
    /// Where the timer's clock edges have been counted up to.
    now: u64,
    /// The cycle in which the prescaler was last 0.
    origin: u64,
    /// Prescaler held in reset, or clock taken away: no edges.
    held: bool,
    /// The counter was just written: no match at the next edge (§16.7.2).
    blocked: bool,
    compare: [u16; 2],
    buffer: [u16; 2],
    pub(super) icr: u16,
    /// COMnx1:0.
    com: [u8; 2],
    /// The OCnx registers behind the pins.
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

    /// As after a reset in `cycle`; pins are let go by who resets the ports.
    pub(super) fn reset(&mut self, cycle: u64) {
        *self = Timer { now: cycle, origin: cycle, ..Timer::new(self.max) };
    }

    /// The interrupts that wait: bits as in TIFRn.
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
            // Toggling in PWM modes is for channel A with OCRnA or ICRn as TOP alone, as the tables have it.
            1 if self.mode.shape.is_pwm() => channel == 0 && self.toggles_in_pwm(),
            _ => true,
        }
    }

    fn toggles_in_pwm(&self) -> bool {
        match self.mode.top {
            Top::OcrA => true,
            // Table 16-2: modes 14 and 15; table 16-3: modes 9 and 11 alone.
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

    // Registers. The caller has brought the timer up to `cycle`, in which the write takes effect.

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
            // The buffer is transparent outside PWM (§15.5).
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

    /// FOCnx: the pin moves as at a match, nothing else happens; not in PWM modes (§15.9.2, §16.11.3).
    pub(super) fn force(&mut self, channel: usize, cycle: u64, outputs: &mut impl Outputs) {
        if !self.mode.shape.is_pwm() {
            self.act(channel, self.com[channel], cycle, outputs);
        }
    }

    /// The prescaler begins anew in `cycle`; `hold` keeps it there.
    pub(super) fn reset_prescaler(&mut self, cycle: u64, hold: bool) {
        self.origin = cycle;
        self.now = cycle;
        self.held = hold;
    }

    /// The clock was away from when the timer was last brought up to date until `cycle`.
    pub(super) fn resume(&mut self, cycle: u64) {
        self.origin += cycle - self.now;
        self.now = cycle;
    }

    /// Captures the counter into ICRn (§16.6), unless that is TOP.
    pub(super) fn capture(&mut self) {
        if !self.icr_is_top() {
            self.icr = self.value;
            self.flags |= ICF;
        }
    }

    // Time.

    /// The cycle of the `n`th edge from now, n ≥ 1.
    fn edge_cycle(&self, n: u64, period: u64) -> u64 {
        if period == 1 { self.now + n } else { self.origin + ((self.now - self.origin) / period + n) * period }
    }

    /// Brings the timer up to `cycle`, its edge included.
    pub(super) fn advance(&mut self, cycle: u64, outputs: &mut impl Outputs) {
        if cycle <= self.now {
            return;
        }
        let Clock::Prescaled(period) = self.clock else {
            self.now = cycle;
            return;
        };
        if self.held {
            // The prescaler stays at 0.
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

    /// The next cycle in which a pin may move or an interrupt begin to wait; `u64::MAX` if none.
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
        // Turns count too: beyond them everything is worked out anew.
        let mut edges = self.turn();
        for (seen, compare) in seen.into_iter().zip(self.compare) {
            if seen {
                edges = edges.min(self.distance(compare));
            }
        }
        self.edge_cycle(u64::from(edges) + 1, period)
    }

    /// Edges until the counter has a value, if it comes to it without a turn; MAX otherwise.
    fn distance(&self, value: u16) -> u16 {
        let distance = if self.down { self.value.checked_sub(value) } else { value.checked_sub(self.value) };
        distance.unwrap_or(u16::MAX)
    }

    /// Edges until the counter is where it turns: at TOP, at MAX if that is behind it, at BOTTOM.
    fn turn(&self) -> u16 {
        if self.mode.shape.is_dual() {
            let top = self.top();
            if self.value == 0 || self.value == top {
                return 0;
            }
            if self.down {
                // Set above TOP by hand, it meets TOP on its way down.
                return self.value.checked_sub(top).unwrap_or(self.value);
            }
        }
        self.distance(self.top()).min(self.max - self.value)
    }

    /// Edges that only move the counter.
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

    /// A match's effect on a pin; `com` as in the tables for counting up.
    fn act(&mut self, channel: usize, com: u8, cycle: u64, outputs: &mut impl Outputs) {
        match com {
            1 => self.set_output(channel, !self.output[channel], cycle, outputs),
            2 => self.set_output(channel, false, cycle, outputs),
            3 => self.set_output(channel, true, cycle, outputs),
            _ => {}
        }
    }

    /// What an edge does, from the counter's value before it.
    fn edge(&mut self, cycle: u64, outputs: &mut impl Outputs) {
        let (value, top) = (self.value, self.top());
        let blocked = std::mem::take(&mut self.blocked);
        if self.mode.shape.is_dual() && (value == top || value == 0) {
            // However it came here: from now on it goes the other way.
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
        // In CTC mode with OCRnA it is the match that clears the counter, and a match can be blocked.
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
                    // Non-inverting: set at BOTTOM; inverting: cleared.
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
            // Fast PWM ignores a match at TOP: what is done at BOTTOM decides (§16.9.3).
            Shape::Fast if at_top && com >= 2 => return,
            // Counting down the pin moves the other way.
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
            // At TOP a pin is as a match on the way up leaves it, so that pulses are symmetric even if that match was
            // missed (§15.7.4).
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
            // TOP = 0 is below the resolution allowed (§16.9.4): the counter stays until TOP is larger.
            self.value = u16::from(self.top() != 0);
        } else if self.down {
            self.value = value - 1;
        } else if value == self.max {
            // TOP was set below the counter: it runs on to MAX and begins again.
            self.value = 0;
        } else {
            self.value = value + 1;
        }
    }
}
