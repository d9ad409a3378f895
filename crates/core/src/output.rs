//! The output: events → edges of a motor's lines.
//!
//! [`StepDir`] drives STEP and DIR of a driver, [`Coils`] the four coils of a motor through a ULN2003. The
//! [channel](crate::channel) says when steps are due. The board knows which pin a line is, and sets it.

use crate::channel::{EventKind, StepEvent};
use crate::{Direction, Tick32};

/// Lines that change at one tick; bit i is line i.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// The tick at which they change.
    pub tick: Tick32,
    /// Lines that go high.
    pub set: u32,
    /// Lines that go low.
    pub clear: u32,
}

/// How a motor is driven.
#[derive(Clone, Debug)]
pub enum Output {
    /// A step/dir driver.
    StepDir(StepDir),
    /// Four coils.
    Coils(Coils),
}

impl Output {
    /// The tick at which the edge of `event` is due. A DIR edge comes before its step by the set-up time.
    #[must_use]
    pub const fn due(&self, event: StepEvent) -> Tick32 {
        match (self, event.kind) {
            (Output::StepDir(driver), EventKind::Direction(_)) => event.tick.before(driver.setup_ticks),
            _ => event.tick,
        }
    }

    /// The tick of the edge that ends a pulse or releases the coils, if no event comes before. The end of a pulse always comes before
    /// the next event.
    #[must_use]
    pub const fn pending_tick(&self) -> Option<Tick32> {
        match self {
            Output::StepDir(driver) => driver.fall,
            Output::Coils(coils) => coils.release,
        }
    }

    /// Makes the edge that is [pending`](Output::pending_tick).
    pub fn take_pending(&mut self) -> Option<Edge> {
        match self {
            Output::StepDir(driver) => {
                driver.fall.take().map(|tick| Edge { tick, set: 0, clear: bit(driver.step_line) })
            }
            Output::Coils(coils) => coils.release.take().map(|tick| coils.change(tick, 0)),
        }
    }

    /// Makes the edge of `event` at `tick`: when it is [`due`](Output::due), or later if that is past.
    pub fn apply(&mut self, event: StepEvent, tick: Tick32) -> Edge {
        match self {
            Output::StepDir(driver) => driver.apply(event, tick),
            Output::Coils(coils) => coils.apply(event, tick),
        }
    }

    /// Sets the position after a stop, when some steps that were taken were not made. Coils continue from the phase of this position, and
    /// stay off if they are off. No pulse is under way any more.
    pub fn set_position(&mut self, position: i32) {
        match self {
            Output::StepDir(driver) => driver.fall = None,
            Output::Coils(coils) => coils.set_position(position),
        }
    }

    /// How long before an event its edge may come, ticks: the set-up time of DIR.
    #[must_use]
    pub const fn lead_ticks(&self) -> u32 {
        match self {
            Output::StepDir(driver) => driver.setup_ticks,
            Output::Coils(_) => 0,
        }
    }

    /// The shortest interval between two steps that are still two pulses on the line, ticks.
    #[must_use]
    pub const fn gap_ticks(&self) -> u32 {
        match self {
            Output::StepDir(driver) => driver.pulse_ticks.saturating_add(1),
            Output::Coils(_) => 1,
        }
    }

    /// Whether every step must set its direction, because another motor may have changed the line.
    #[must_use]
    pub const fn asserts_every_step(&self) -> bool {
        matches!(self, Output::StepDir(driver) if driver.shared_dir)
    }
}

/// STEP and DIR of a driver. A step is a rising edge; both lines start low.
#[derive(Clone, Debug)]
pub struct StepDir {
    step_line: u8,
    dir_line: u8,
    pulse_ticks: u32,
    setup_ticks: u32,
    forward_high: bool,
    shared_dir: bool,
    fall: Option<Tick32>,
}

/// The settings of a [`StepDir`]. It does not know the hold time of DIR; the planner keeps it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepDirSettings {
    /// Line of STEP, 0..32.
    pub step_line: u8,
    /// Line of DIR, 0..32.
    pub dir_line: u8,
    /// Length of a STEP pulse, ticks, 1..2^30.
    pub pulse_ticks: u32,
    /// Time from a change of DIR to its step, ticks, below 2^30.
    pub setup_ticks: u32,
    /// DIR is high for forward.
    pub forward_high: bool,
    /// Whether another motor uses this DIR line too.
    pub shared_dir: bool,
}

impl StepDir {
    /// Both lines low.
    #[must_use]
    pub const fn new(settings: StepDirSettings) -> StepDir {
        let StepDirSettings { step_line, dir_line, pulse_ticks, setup_ticks, forward_high, shared_dir } = settings;
        let pulse_ticks = if pulse_ticks == 0 { 1 } else { pulse_ticks };
        StepDir { step_line, dir_line, pulse_ticks, setup_ticks, forward_high, shared_dir, fall: None }
    }

    fn apply(&mut self, event: StepEvent, tick: Tick32) -> Edge {
        match event.kind {
            EventKind::Step => {
                self.fall = Some(tick.after(self.pulse_ticks));
                Edge { tick, set: bit(self.step_line), clear: 0 }
            }
            EventKind::Direction(direction) => {
                let high = (direction == Direction::Forward) == self.forward_high;
                let line = bit(self.dir_line);
                if high { Edge { tick, set: line, clear: 0 } } else { Edge { tick, set: 0, clear: line } }
            }
        }
    }
}

/// How coils are switched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sequence {
    /// One coil at a time.
    Wave,
    /// Two coils at a time.
    Full,
    /// Two and one in turn.
    Half,
}

impl Sequence {
    /// The phase at position 0, an index into [`HALF_STEPS`].
    const fn first_phase(self) -> u8 {
        match self {
            Sequence::Wave => 1,
            Sequence::Full | Sequence::Half => 0,
        }
    }
}

/// Patterns of the coils, half step after half step, forward; bit 0 is IN1.
///
/// Forward is what the program of the Pico plotter puts on the pins and calls counterclockwise. Its `out pins, 4` puts
/// bit 0 on IN1, where its printed table has IN1 as the highest bit: the table's columns, read as headed, would turn
/// the other way.
pub const HALF_STEPS: [u8; 8] = [0x9, 0x8, 0xc, 0x4, 0x6, 0x2, 0x3, 0x1];

/// The four coils of a motor. They are off until the first step.
#[derive(Clone, Debug)]
pub struct Coils {
    /// The lines that are high at each phase.
    levels: [u32; 8],
    sequence: Sequence,
    release_ticks: Option<u32>,
    /// Index into `HALF_STEPS`.
    phase: u8,
    direction: Direction,
    /// The lines that are high.
    now: u32,
    release: Option<Tick32>,
}

impl Coils {
    /// Coils at phase 0, on `lines` (IN1 to IN4, each 0..32).
    ///
    /// If no step follows within `release_ticks` (below 2^31) of one, all coils are switched off; `None` holds them. The
    /// next step goes on from the phase that was left.
    #[must_use]
    pub fn new(lines: [u8; 4], sequence: Sequence, release_ticks: Option<u32>) -> Coils {
        let lines = lines.map(bit);
        let high = |pattern: u8| {
            let on = lines.iter().enumerate().filter(|(number, _)| pattern >> number & 1 != 0);
            on.fold(0, |levels, (_, line)| levels | line)
        };
        Coils {
            levels: HALF_STEPS.map(high),
            sequence,
            release_ticks,
            phase: sequence.first_phase(),
            direction: Direction::Forward,
            now: 0,
            release: None,
        }
    }

    fn apply(&mut self, event: StepEvent, tick: Tick32) -> Edge {
        match event.kind {
            EventKind::Direction(direction) => {
                self.direction = direction;
                Edge { tick, set: 0, clear: 0 }
            }
            EventKind::Step => {
                self.phase = self.phase.wrapping_add(self.phases()) & 7;
                self.release = self.release_ticks.map(|ticks| tick.after(ticks));
                self.change(tick, self.of_phase())
            }
        }
    }

    /// Makes as many steps as there are `words`, the last of them at `tick`, the way that the one before went: each word gets the
    /// lines that are high after its step, from bit `shift` on.
    pub(crate) fn run(&mut self, words: &mut [u32], shift: u32, tick: Tick32) {
        let phases = self.phases();
        for word in words {
            self.phase = self.phase.wrapping_add(phases) & 7;
            *word |= self.of_phase() << shift;
        }
        self.now = self.of_phase();
        self.release = self.release_ticks.map(|ticks| tick.after(ticks));
    }

    /// All coils are switched off if no step follows within this many ticks.
    pub(crate) const fn release_ticks(&self) -> Option<u32> {
        self.release_ticks
    }

    /// What a step adds to the phase, modulo 8.
    const fn phases(&self) -> u8 {
        let half_steps: u8 = if let Sequence::Half = self.sequence { 1 } else { 2 };
        match self.direction {
            Direction::Forward => half_steps,
            Direction::Backward => half_steps.wrapping_neg(),
        }
    }

    fn set_position(&mut self, position: i32) {
        self.release = None;
        let [steps, ..] = position.to_le_bytes();
        let phase = if self.sequence == Sequence::Half { steps } else { steps << 1 };
        self.phase = phase.wrapping_add(self.sequence.first_phase()) & 7;
        if self.now != 0 {
            self.now = self.of_phase();
        }
    }

    const fn change(&mut self, tick: Tick32, now: u32) -> Edge {
        let edge = Edge { tick, set: now & !self.now, clear: self.now & !now };
        self.now = now;
        edge
    }

    /// Switches all coils off at once. The next step continues from their last phase.
    pub const fn switch_off(&mut self) {
        (self.now, self.release) = (0, None);
    }

    /// Switches them on as the position has them, until the next step or [`switch_off`](Coils::switch_off).
    pub const fn switch_on(&mut self) {
        self.now = self.of_phase();
    }

    /// The levels of the coils, bit by line.
    #[must_use]
    pub const fn levels(&self) -> u32 {
        self.now
    }

    const fn of_phase(&self) -> u32 {
        self.levels[self.phase as usize & 7]
    }
}

/// The mask of a line; lines are taken modulo 32.
const fn bit(line: u8) -> u32 {
    1 << (line & 31)
}
