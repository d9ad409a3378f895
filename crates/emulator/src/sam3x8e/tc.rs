//! The timer counters: three blocks of three channels of 32 bits (Atmel-11057C §36).
//!
//! A match is one event. Between events a channel takes no computing time: its counter is computed when it is read.
//!
//! What the datasheet leaves open: a flag and an output change in the cycle after the one in which the counter gets the
//! value; a compare register that is written with the value that the counter has already does not match.
//!
//! Not emulated: capture mode, external events and clocks, counting down, bursts, the quadrature decoder, and the stepper
//! motor mode.

const NEVER: u64 = u64::MAX;

/// Offsets of the registers, of a channel and of a block (§36).
mod at {
    pub(super) const CCR: u32 = 0x00;
    pub(super) const CMR: u32 = 0x04;
    pub(super) const SMMR: u32 = 0x08;
    pub(super) const CV: u32 = 0x10;
    pub(super) const RA: u32 = 0x14;
    pub(super) const RB: u32 = 0x18;
    pub(super) const RC: u32 = 0x1c;
    pub(super) const SR: u32 = 0x20;
    pub(super) const IER: u32 = 0x24;
    pub(super) const IDR: u32 = 0x28;
    pub(super) const IMR: u32 = 0x2c;
    pub(super) const BCR: u32 = 0xc0;
    pub(super) const BMR: u32 = 0xc4;
}

/// TC_CCR.
const CLOCK_ENABLE: u32 = 1;
const CLOCK_DISABLE: u32 = 1 << 1;
const SOFTWARE_TRIGGER: u32 = 1 << 2;

/// TC_CMR in waveform mode (§36).
mod cmr {
    pub(super) const STOPS_AT_RC: u32 = 1 << 6;
    pub(super) const DISABLES_AT_RC: u32 = 1 << 7;
    pub(super) const RC_TRIGGERS: u32 = 2 << 13;
    pub(super) const WAVSEL: u32 = 3 << 13;
    pub(super) const WAVE: u32 = 1 << 15;
    /// EEVT: 0 is TIOB as an input.
    pub(super) const EXTERNAL_EVENT: u32 = 3 << 10;
    /// Places of what an event does to an output: nothing, set, clear, toggle.
    pub(super) const A_AT_RA: u32 = 16;
    pub(super) const A_AT_RC: u32 = 18;
    pub(super) const A_AT_TRIGGER: u32 = 22;
    pub(super) const B_AT_RB: u32 = 24;
    pub(super) const B_AT_RC: u32 = 26;
    pub(super) const B_AT_TRIGGER: u32 = 30;
}

/// TC_SR (§36).
mod sr {
    pub(super) const OVERFLOW: u32 = 1;
    pub(super) const RA: u32 = 1 << 2;
    pub(super) const RB: u32 = 1 << 3;
    pub(super) const RC: u32 = 1 << 4;
    /// The flags that reading clears.
    pub(super) const FLAGS: u32 = 0xff;
    pub(super) const CLOCK_ON: u32 = 1 << 16;
    pub(super) const TIOA: u32 = 1 << 17;
    pub(super) const TIOB: u32 = 1 << 18;
}

/// The ticks of a counter from one value to another; a whole turn if they are equal.
fn distance(from: u32, to: u32) -> u64 {
    match to.wrapping_sub(from) {
        0 => 1 << 32,
        ticks => ticks.into(),
    }
}

#[derive(Clone, Debug)]
struct Channel {
    mode: u32,
    stepper: u32,
    ra: u32,
    rb: u32,
    rc: u32,
    status: u32,
    mask: u32,
    /// The clock is enabled (CLKSTA); it runs after a trigger.
    enabled: bool,
    triggered: bool,
    /// The counter at a tick of its clock.
    value: u32,
    since_tick: u64,
    /// Cycles of a tick; 0: no tick comes.
    period: u64,
    tioa: bool,
    tiob: bool,
    next: u64,
}

impl Channel {
    fn new() -> Channel {
        Channel {
            mode: 0,
            stepper: 0,
            ra: 0,
            rb: 0,
            rc: 0,
            status: 0,
            mask: 0,
            enabled: false,
            triggered: false,
            value: 0,
            since_tick: 0,
            period: 0,
            tioa: false,
            tiob: false,
            next: NEVER,
        }
    }

    fn counts(&self) -> bool {
        self.enabled && self.triggered && self.period != 0
    }

    fn is_waveform(&self) -> bool {
        self.mode & cmr::WAVE != 0
    }

    fn counter(&self, cycle: u64) -> u32 {
        if !self.counts() {
            return self.value;
        }
        self.value.wrapping_add((cycle / self.period).saturating_sub(self.since_tick) as u32)
    }

    /// Brings the stored counter to a cycle.
    fn settle(&mut self, cycle: u64) {
        if self.counts() {
            let tick = (cycle / self.period).max(self.since_tick);
            self.value = self.value.wrapping_add((tick - self.since_tick) as u32);
            self.since_tick = tick;
        }
    }

    /// Sets the cycles of a tick from a cycle on. The ticks are those of a prescaler that is never reset.
    fn set_period(&mut self, period: u64, cycle: u64) {
        if period != self.period {
            self.settle(cycle);
            self.period = period;
            self.since_tick = cycle.checked_div(period).unwrap_or(0);
            self.schedule();
        }
    }

    fn resets_at_rc(&self) -> bool {
        self.mode & cmr::WAVSEL == cmr::RC_TRIGGERS
    }

    /// Works out the cycle of the next match or overflow.
    fn schedule(&mut self) {
        self.next = NEVER;
        if !self.counts() || !self.is_waveform() {
            return;
        }
        let to = |value| distance(self.value, value);
        let ticks = to(self.ra).min(to(self.rb)).min(to(self.rc)).min(to(0));
        self.next = (self.since_tick + ticks) * self.period;
    }

    /// What an event does to an output.
    fn act(&self, level: bool, place: u32) -> bool {
        match self.mode >> place & 3 {
            0 => level,
            1 => true,
            2 => false,
            _ => !level,
        }
    }

    /// Whether TIOB is an output: it is not while it is the external event (§36, EEVT).
    fn has_tiob(&self) -> bool {
        self.is_waveform() && self.mode & cmr::EXTERNAL_EVENT != 0
    }

    /// Handles the matches of a cycle. Of two that act on an output at once the one with RC counts (§36).
    fn run(&mut self, cycle: u64) {
        let ticks = cycle / self.period - self.since_tick;
        let value = self.value.wrapping_add(ticks as u32);
        (self.value, self.since_tick) = (value, cycle / self.period);
        if value == self.ra {
            self.status |= sr::RA;
            self.tioa = self.act(self.tioa, cmr::A_AT_RA);
        }
        if value == self.rb {
            self.status |= sr::RB;
            self.tiob = self.act(self.tiob, cmr::B_AT_RB);
        }
        if value == self.rc {
            self.status |= sr::RC;
            if self.mode >> cmr::A_AT_RC & 3 != 0 {
                self.tioa = self.act(self.tioa, cmr::A_AT_RC);
            }
            if self.mode >> cmr::B_AT_RC & 3 != 0 {
                self.tiob = self.act(self.tiob, cmr::B_AT_RC);
            }
            if self.resets_at_rc() {
                self.value = 0;
            }
            if self.mode & cmr::STOPS_AT_RC != 0 {
                self.triggered = false;
            }
            if self.mode & cmr::DISABLES_AT_RC != 0 {
                (self.enabled, self.triggered) = (false, false);
            }
        } else if value == 0 {
            self.status |= sr::OVERFLOW;
        }
        self.schedule();
    }

    /// A software trigger: the counter is 0 at the next tick, and counts from there (§36).
    fn trigger(&mut self, cycle: u64) {
        if !self.enabled {
            return;
        }
        self.triggered = true;
        self.value = 0;
        self.since_tick = cycle.checked_div(self.period).map_or(0, |tick| tick + 1);
        if self.is_waveform() {
            self.tioa = self.act(self.tioa, cmr::A_AT_TRIGGER);
            self.tiob = self.act(self.tiob, cmr::B_AT_TRIGGER);
        }
        self.schedule();
    }

    fn control(&mut self, value: u32, cycle: u64) {
        self.settle(cycle);
        if value & CLOCK_DISABLE != 0 {
            (self.enabled, self.triggered) = (false, false);
        } else if value & CLOCK_ENABLE != 0 {
            self.enabled = true;
        }
        if value & SOFTWARE_TRIGGER != 0 {
            self.trigger(cycle);
        }
        self.schedule();
    }

    fn read(&mut self, offset: u32, cycle: u64) -> u32 {
        match offset {
            at::CMR => self.mode,
            at::SMMR => self.stepper,
            at::CV => self.counter(cycle),
            at::RA => self.ra,
            at::RB => self.rb,
            at::RC => self.rc,
            at::SR => {
                let bit = |set, bit| if set { bit } else { 0 };
                let value =
                    self.status | bit(self.enabled, sr::CLOCK_ON) | bit(self.tioa, sr::TIOA) | bit(self.tiob, sr::TIOB);
                self.status = 0;
                value
            }
            at::IMR => self.mask,
            _ => 0,
        }
    }

    fn write(&mut self, offset: u32, value: u32, cycle: u64) {
        match offset {
            at::CCR => self.control(value, cycle),
            at::CMR => {
                self.settle(cycle);
                self.mode = value;
            }
            at::SMMR => self.stepper = value & 3,
            at::RA | at::RB | at::RC => {
                self.settle(cycle);
                match offset {
                    at::RA => self.ra = value,
                    at::RB => self.rb = value,
                    _ => self.rc = value,
                }
            }
            at::IER => self.mask |= value & sr::FLAGS,
            at::IDR => self.mask &= !value,
            _ => {}
        }
        self.schedule();
    }
}

/// Where the clocks of the channels come from, for [`Timers::set_clocks`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TimerClocks {
    /// Which channels have their peripheral clock (PMC), bit 0 for channel 0.
    pub(super) enabled: u32,
    /// Cycles of the slow clock.
    pub(super) slow_cycles: u64,
}

/// All nine channels.
#[derive(Clone, Debug)]
pub(super) struct Timers {
    channels: [Channel; 9],
    block_modes: [u32; 3],
    clocks: TimerClocks,
    /// The cycle of the next event.
    pub(super) next: u64,
}

impl Timers {
    pub(super) fn new() -> Timers {
        Timers {
            channels: std::array::from_fn(|_| Channel::new()),
            block_modes: [0; 3],
            clocks: TimerClocks { enabled: 0, slow_cycles: 1 },
            next: NEVER,
        }
    }

    pub(super) fn set_clocks(&mut self, clocks: TimerClocks, cycle: u64) {
        self.clocks = clocks;
        (0..9).for_each(|number| self.clock(number, cycle));
        self.schedule();
    }

    /// Gives a channel the clock that it has selected (TCCLKS, §36.6.3).
    fn clock(&mut self, number: usize, cycle: u64) {
        let is_on = self.clocks.enabled >> number & 1 != 0;
        let channel = &mut self.channels[number];
        let period = match channel.mode & 7 {
            _ if !is_on => 0,
            0 => 2,
            1 => 8,
            2 => 32,
            3 => 128,
            4 => self.clocks.slow_cycles,
            _ => 0,
        };
        channel.set_period(period, cycle);
    }

    fn schedule(&mut self) {
        self.next = self.channels.iter().map(|channel| channel.next).min().unwrap_or(NEVER);
    }

    /// Handles the matches of a cycle. Returns the channels that had one, bit 0 for channel 0.
    pub(super) fn run(&mut self, cycle: u64) -> u32 {
        let mut due = 0;
        for (number, channel) in self.channels.iter_mut().enumerate() {
            if channel.next == cycle {
                channel.run(cycle);
                due |= 1 << number;
            }
        }
        self.schedule();
        due
    }

    /// The outputs of a channel, TIOA and TIOB: `None` where it is no output.
    pub(super) fn outputs(&self, number: usize) -> (Option<bool>, Option<bool>) {
        let channel = &self.channels[number];
        (channel.is_waveform().then_some(channel.tioa), channel.has_tiob().then_some(channel.tiob))
    }

    /// The interrupt lines, bit 0 for channel 0.
    pub(super) fn lines(&self) -> u64 {
        self.channels.iter().rev().fold(0, |lines, channel| lines << 1 | u64::from(channel.status & channel.mask != 0))
    }

    /// Reads a register of a block, 0 to 2. Reading the status clears its flags.
    pub(super) fn read(&mut self, block: usize, offset: u32, cycle: u64) -> u32 {
        match (offset / 0x40, offset) {
            (channel @ 0..=2, _) => self.channels[3 * block + channel as usize].read(offset & 0x3f, cycle),
            (_, at::BMR) => self.block_modes[block],
            _ => 0,
        }
    }

    pub(super) fn write(&mut self, block: usize, offset: u32, value: u32, cycle: u64) {
        match (offset / 0x40, offset) {
            (channel @ 0..=2, _) => {
                let number = 3 * block + channel as usize;
                self.channels[number].write(offset & 0x3f, value, cycle);
                self.clock(number, cycle);
            }
            (_, at::BCR) if value & 1 != 0 => {
                (3 * block..3 * block + 3).for_each(|number| self.channels[number].trigger(cycle));
            }
            (_, at::BMR) => self.block_modes[block] = value,
            _ => {}
        }
        self.schedule();
    }
}
