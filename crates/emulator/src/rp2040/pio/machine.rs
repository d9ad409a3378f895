//! One state machine: its registers, clock divider and state (RP2040 datasheet §3.2, §3.5, §3.7). Instructions are in
//! `execute`.
//!
//! Machines take no computing time in cycles in which they do nothing. A machine knows the tick of its next execution.
//! One that stalls has none until its condition may have changed, and one that counts down with `jmp x--` to its own
//! address has the tick after its last execution.

use super::fifo::Fifo;

/// No cycle: no event is to come.
pub(super) const NEVER: u64 = u64::MAX;

// Bits of EXECCTRL and SHIFTCTRL (§3.7).
pub(super) const SIDE_EN: u32 = 1 << 30;
pub(super) const SIDE_PINDIR: u32 = 1 << 29;
pub(super) const INLINE_OUT_EN: u32 = 1 << 18;
pub(super) const OUT_STICKY: u32 = 1 << 17;
pub(super) const STATUS_SEL: u32 = 1 << 4;
const FJOIN_RX: u32 = 1 << 31;
const FJOIN_TX: u32 = 1 << 30;
pub(super) const OUT_RIGHT: u32 = 1 << 19;
pub(super) const IN_RIGHT: u32 = 1 << 18;
pub(super) const AUTOPULL: u32 = 1 << 17;
pub(super) const AUTOPUSH: u32 = 1 << 16;

/// What a stalled machine waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stall {
    No,
    /// A word in the TX FIFO.
    Tx,
    /// Room in the RX FIFO.
    Rx,
    /// A pin.
    Pin,
    /// An IRQ flag.
    Irq,
}

/// A countdown: `jmp x--` or `jmp y--` to its own address, of which all executions are done at once.
#[derive(Clone, Copy, Debug)]
pub(super) struct Countdown {
    /// Whether the register is Y; else X.
    pub(super) y: bool,
    /// The register before the first execution.
    pub(super) from: u32,
    /// The tick of the first execution, 1/256 cycle.
    pub(super) start_256: u64,
    /// Time from one execution to the next, 1/256 cycle.
    pub(super) period_256: u64,
    /// Address of the jump.
    pub(super) pc: u8,
}

#[derive(Clone)]
pub(super) struct Machine {
    pub(super) enabled: bool,
    pub(super) tx: Fifo,
    pub(super) rx: Fifo,
    pub(super) pc: u8,
    pub(super) x: u32,
    pub(super) y: u32,
    pub(super) osr: u32,
    pub(super) isr: u32,
    /// Bits shifted out of the OSR, 0 to 32; 32 means empty.
    pub(super) osr_count: u8,
    /// Bits shifted into the ISR.
    pub(super) isr_count: u8,
    pub(super) clkdiv: u32,
    pub(super) execctrl: u32,
    pub(super) shiftctrl: u32,
    pub(super) pinctrl: u32,
    /// An instruction to be executed before the one at `pc`.
    pub(super) latched: Option<u16>,
    /// Whether `latched` came from SMx_INSTR: it needs neither a tick nor an enabled machine.
    pub(super) forced: bool,
    pub(super) stall: Stall,
    /// Whether `irq wait` has raised its flag.
    pub(super) irq_raised: bool,
    /// The pins that OUT_STICKY holds: mask and value of levels, then of directions.
    pub(super) sticky: [(u32, u32); 2],
    /// The time of one tick, 1/256 cycle. All ticks are whole periods of the divider away from it.
    phase_256: u64,
    /// The period of the divider, 1/256 cycle.
    period_256: u64,
    /// The cycle of the next execution.
    pub(super) at: u64,
    /// The cycle in which autopull fills the OSR between two instructions.
    pub(super) refill_at: u64,
    pub(super) countdown: Option<Countdown>,
    /// Ticks of delay that were left when the machine was disabled.
    left: u64,
    /// The cycle in which the machine goes on after a forced instruction.
    pub(super) resume_at: u64,
}

impl Machine {
    pub(super) fn new() -> Machine {
        Machine {
            enabled: false,
            tx: Fifo::new(4),
            rx: Fifo::new(4),
            pc: 0,
            x: 0,
            y: 0,
            osr: 0,
            isr: 0,
            osr_count: 32,
            isr_count: 0,
            clkdiv: 1 << 16,
            execctrl: 0x1f << 12,
            shiftctrl: OUT_RIGHT | IN_RIGHT,
            pinctrl: 5 << 26,
            latched: None,
            forced: false,
            stall: Stall::No,
            irq_raised: false,
            sticky: [(0, 0); 2],
            phase_256: 0,
            period_256: 256,
            at: NEVER,
            refill_at: NEVER,
            countdown: None,
            left: 0,
            resume_at: NEVER,
        }
    }

    // Ticks: the cycles in which the clock divider lets the machine run (§3.5.5).

    /// The first tick at or after a cycle.
    pub(super) fn tick_from(&self, cycle: u64) -> u64 {
        self.tick_from_256(cycle) >> 8
    }

    fn tick_from_256(&self, cycle: u64) -> u64 {
        let wanted = cycle << 8;
        if self.period_256 == 256 {
            return wanted;
        }
        if wanted >= self.phase_256 {
            self.phase_256 + (wanted - self.phase_256).div_ceil(self.period_256) * self.period_256
        } else {
            self.phase_256 - (self.phase_256 - wanted) / self.period_256 * self.period_256
        }
    }

    /// The exact time of the tick in a cycle, 1/256 cycle. It becomes the reference for later ticks.
    pub(super) fn enter_tick(&mut self, cycle: u64) -> u64 {
        self.phase_256 = self.tick_from_256(cycle);
        self.phase_256
    }

    /// The cycle of the tick that comes `ticks` ticks after the reference.
    pub(super) fn ticks_later(&self, ticks: u64) -> u64 {
        (self.phase_256 + ticks * self.period_256) >> 8
    }

    pub(super) fn period_256(&self) -> u64 {
        self.period_256
    }

    /// Sets the divider, from the next tick at or after `cycle` on. An integer part of 0 means 65 536 (§3.7).
    pub(super) fn set_clkdiv(&mut self, value: u32, cycle: u64) {
        self.clkdiv = value & 0xffff_ff00;
        self.phase_256 = self.tick_from_256(cycle);
        let (whole, part) = (u64::from(value >> 16), u64::from(value >> 8 & 0xff));
        self.period_256 = if whole == 0 { 65_536 << 8 } else { whole << 8 | part };
        if self.period_256 == 256 {
            self.phase_256 = cycle << 8;
        }
    }

    /// Changes the clock from a cycle on. The number of ticks to the next execution stays what it was.
    pub(super) fn change_clock(&mut self, cycle: u64, change: impl FnOnce(&mut Machine)) {
        let going = self.enabled && !self.forced;
        if going {
            self.pause(cycle);
        }
        change(self);
        if going {
            self.resume(cycle);
        }
    }

    /// Restarts the divider, with a tick in `cycle`.
    pub(super) fn restart_clock(&mut self, cycle: u64) {
        self.phase_256 = cycle << 8;
    }

    // The fields of the registers.

    pub(super) fn autopull(&self) -> bool {
        self.shiftctrl & AUTOPULL != 0
    }

    pub(super) fn autopush(&self) -> bool {
        self.shiftctrl & AUTOPUSH != 0
    }

    pub(super) fn pull_threshold(&self) -> u8 {
        count(self.shiftctrl >> 25)
    }

    pub(super) fn push_threshold(&self) -> u8 {
        count(self.shiftctrl >> 20)
    }

    pub(super) fn wrap_top(&self) -> u8 {
        (self.execctrl >> 12 & 31) as u8
    }

    pub(super) fn wrap_bottom(&self) -> u8 {
        (self.execctrl >> 7 & 31) as u8
    }

    pub(super) fn jmp_pin(&self) -> u32 {
        self.execctrl >> 24 & 31
    }

    pub(super) fn in_base(&self) -> u32 {
        self.pinctrl >> 15 & 31
    }

    pub(super) fn side_bits(&self) -> u32 {
        (self.pinctrl >> 29).min(5)
    }

    /// Base and number of the pins of OUT, SET and side-set.
    pub(super) fn out_pins(&self) -> (u32, u32) {
        (self.pinctrl & 31, self.pinctrl >> 20 & 63)
    }

    pub(super) fn set_pins(&self) -> (u32, u32) {
        (self.pinctrl >> 5 & 31, self.pinctrl >> 26 & 7)
    }

    pub(super) fn side_pins(&self) -> (u32, u32) {
        let enable = u32::from(self.execctrl & SIDE_EN != 0);
        (self.pinctrl >> 10 & 31, self.side_bits().saturating_sub(enable))
    }

    /// All pins that the machine may write.
    pub(super) fn drives(&self) -> u32 {
        pin_mask(self.out_pins()) | pin_mask(self.set_pins()) | pin_mask(self.side_pins())
    }

    pub(super) fn set_shiftctrl(&mut self, value: u32) {
        let joins = FJOIN_RX | FJOIN_TX;
        if (self.shiftctrl ^ value) & joins != 0 {
            // A change of FJOIN discards the contents of both FIFOs (§3.5.3).
            let (tx, rx) = match (value & FJOIN_TX != 0, value & FJOIN_RX != 0) {
                (false, false) => (4, 4),
                (true, false) => (8, 0),
                (false, true) => (0, 8),
                (true, true) => (0, 0),
            };
            self.tx.resize(tx);
            self.rx.resize(rx);
        }
        self.shiftctrl = value;
    }

    /// SM_RESTART (§3.7, CTRL). Program counter, X, Y and the contents of the OSR stay.
    pub(super) fn restart(&mut self) {
        (self.osr_count, self.isr_count, self.isr) = (32, 0, 0);
        (self.latched, self.forced, self.irq_raised) = (None, false, false);
        (self.stall, self.sticky, self.left) = (Stall::No, [(0, 0); 2], 0);
    }

    /// Clears SM_ENABLE: nothing is executed from `cycle` on.
    pub(super) fn pause(&mut self, cycle: u64) {
        if self.at != NEVER {
            let first = self.tick_from_256(cycle);
            let at = self.tick_from_256(self.at);
            self.left = at.saturating_sub(first) / self.period_256;
        } else {
            self.left = 0;
        }
        (self.at, self.refill_at) = (NEVER, NEVER);
    }

    /// Sets SM_ENABLE: the machine goes on with the first tick at or after `cycle`.
    pub(super) fn resume(&mut self, cycle: u64) {
        let first = self.enter_tick(cycle) >> 8;
        let left = std::mem::take(&mut self.left);
        let at = self.ticks_later(left);
        if self.forced {
            self.resume_at = at;
        } else {
            self.at = at;
        }
        if self.wants_refill() && !self.tx.is_empty() {
            self.refill_at = first;
        }
    }

    /// Forces an instruction through SMx_INSTR, to be executed in `cycle`.
    pub(super) fn force(&mut self, instruction: u16, cycle: u64) {
        if !self.forced {
            // A stalled instruction is tried again after the forced one.
            self.resume_at = if self.at == NEVER { cycle } else { self.at };
        }
        (self.latched, self.forced) = (Some(instruction), true);
        (self.stall, self.irq_raised) = (Stall::No, false);
        self.at = cycle;
    }

    /// Whether the OSR needs a word that autopull may fetch.
    pub(super) fn wants_refill(&self) -> bool {
        self.autopull() && self.osr_count >= self.pull_threshold()
    }

    /// Sets the countdown's register and the program counter to their values at the beginning of `cycle`.
    pub(super) fn settle(&mut self, cycle: u64) {
        let Some(countdown) = self.countdown.take() else { return };
        // The executions before `cycle`.
        let done = (cycle << 8).saturating_sub(countdown.start_256).div_ceil(countdown.period_256);
        if done > u64::from(countdown.from) {
            return;
        }
        let value = countdown.from - done as u32;
        if countdown.y {
            self.y = value;
        } else {
            self.x = value;
        }
        self.pc = countdown.pc;
        self.at = (countdown.start_256 + done * countdown.period_256) >> 8;
    }
}

/// A number of bits as registers and instructions encode it: 0 means 32.
pub(super) fn count(field: u32) -> u8 {
    match field & 31 {
        0 => 32,
        n => n as u8,
    }
}

/// A value whose lowest `bits` bits are 1.
pub(super) const fn ones(bits: u32) -> u32 {
    if bits >= 32 { u32::MAX } else { (1 << bits) - 1 }
}

/// The mask of the pins from a base on. Pin 0 follows pin 31.
pub(super) const fn pin_mask((base, number): (u32, u32)) -> u32 {
    ones(number).rotate_left(base)
}
