//! The native board: core's queue, channel, output and merge for each motor, in virtual time.
//!
//! Ticks are 64 bits here; the moments of the stepgen are extended as time goes on. Time moves only by
//! [`Native::advance`] and [`Native::stop_now`], and each tick is passed once.

use crate::lease::{ExtendRefused, Lease, LeaseState, Leased, TrimRefused};
use crate::{Board, Sizer};
use pulsetrain_core::braking::Limit;
use pulsetrain_core::channels;
use pulsetrain_core::lease::{self, Lapse, LapseCause};
use pulsetrain_core::output::{Coils, Output, Sequence, StepDir, StepDirSettings};
use pulsetrain_core::queue::{Items, Place};
use pulsetrain_core::shared_line::{self, SharedLine};
use pulsetrain_core::{Axis, Channel, Direction, Entry, Epoch, Item, Merge, Tick32, channel};
use std::collections::VecDeque;

/// Motors at most.
pub const MAX_MOTORS: usize = 16;

/// Items that the queue of a motor holds, unless it is [unbounded](Native::unbounded): room for motions beyond 10^6 steps/s.
pub const QUEUE_LEN: usize = 1024;

/// Lines at most.
pub const MAX_LINES: u8 = 32;

/// Longest stretch that is run at once: moments are told apart within 2^31 ticks, and set-up and pulse reach beyond.
const STRETCH: u64 = 1 << 29;

/// Everything that a native board needs to know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Config {
    /// F of the recurrence: 16, 24 or 32.
    pub fraction_bits: u32,
    /// At most [`MAX_MOTORS`].
    pub motors: Vec<MotorConfig>,
}

/// One motor of a native board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MotorConfig {
    /// Its lines, all below [`MAX_LINES`].
    pub wiring: Wiring,
    /// The shortest interval that the motor can start and stop at, ticks: see [`StopReport::uncertain`].
    pub pull_in_ticks: u64,
}

/// The lines of a motor and their timing. Motors may share a DIR line and nothing else.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wiring {
    /// A step/dir driver; a step is a rising edge.
    StepDir {
        /// Line of STEP.
        step: u8,
        /// Line of DIR.
        dir: u8,
        /// DIR is high for forward.
        forward_high: bool,
        /// STEP stays high so long, 1..2^29.
        pulse_ticks: u32,
        /// DIR changes so long before the step that it is for, below 2^29.
        setup_ticks: u32,
    },
    /// Four coils.
    Coils {
        /// IN1 to IN4.
        lines: [u8; 4],
        /// How they are switched.
        sequence: Sequence,
        /// Off if no step follows so soon after one, below 2^29; `None` holds.
        release_ticks: Option<u32>,
    },
}

impl Wiring {
    fn lines(&self) -> Vec<u8> {
        match *self {
            Wiring::StepDir { step, dir, .. } => vec![step, dir],
            Wiring::Coils { lines, .. } => lines.to_vec(),
        }
    }

    /// So long before a step its lines may have to change, ticks.
    pub(crate) const fn lead_ticks(&self) -> u32 {
        match *self {
            Wiring::StepDir { setup_ticks, .. } => setup_ticks,
            Wiring::Coils { .. } => 0,
        }
    }

    fn longest_ticks(&self) -> u32 {
        match *self {
            Wiring::StepDir { pulse_ticks, setup_ticks, .. } => pulse_ticks.max(setup_ticks),
            Wiring::Coils { release_ticks, .. } => release_ticks.unwrap_or(0),
        }
    }
}

/// A configuration that no board has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// F is not one of 16, 24, 32.
    #[error("{0} fraction bits: a native board has 16, 24 or 32")]
    FractionBits(u32),
    /// More than [`MAX_MOTORS`].
    #[error("{0} motors: a native board has at most {MAX_MOTORS}")]
    Motors(usize),
    /// A line that is not there.
    #[error("line {0}: a native board has lines 0 to 31")]
    Line(u8),
    /// A line that two things use, and that is not DIR of both.
    #[error("line {0} is used twice")]
    LineTaken(u8),
    /// A pulse, set-up or release of 2^29 ticks or more, or a pulse of none.
    #[error("a time of {0} ticks: a native board keeps 1 to 2^29 - 1")]
    Ticks(u32),
}

/// One line that changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// When.
    pub tick: u64,
    /// Which line.
    pub line: u8,
    /// High?
    pub level: bool,
}

/// One step as the stepgen scheduled it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScheduledStep {
    /// Index of the motor.
    pub motor: usize,
    /// When.
    pub tick: u64,
    /// Which way it counts.
    pub direction: Direction,
}

/// What looks on while a board runs. Any `FnMut(Edge)` does.
pub trait Observer {
    /// Edges come in order of ticks, those of one tick in order of lines.
    fn edge(&mut self, edge: Edge);

    /// Steps come in order of ticks for each motor, before their edge.
    fn step(&mut self, step: ScheduledStep) {
        let _ = step;
    }
}

impl<T: FnMut(Edge)> Observer for T {
    fn edge(&mut self, edge: Edge) {
        self(edge);
    }
}

/// A switch that was refused whole: the old plan goes on on all motors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SwitchRefused {
    /// A motor is committed beyond that tick.
    #[error("the board is committed up to tick {horizon}")]
    Late {
        /// The first tick at which a switch would be accepted now.
        horizon: u64,
    },
    /// The tick is 2^30 or more ahead of the board's time.
    #[error("the switch is too far ahead: only ticks before {limit} can be told apart")]
    Early {
        /// First tick that is too far.
        limit: u64,
    },
    /// Another switch waits, for an earlier tick.
    #[error("another switch waits already")]
    Full,
    /// Nothing can be said to the board any more; what it was told stands. [`Board::lost`] says why.
    #[error("nothing can be said to the board any more")]
    Lost,
}

/// What is left after an immediate stop.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StopReport {
    /// The tick after which no step was begun.
    pub tick: u64,
    /// Steps made, of each motor: exact.
    pub positions: Vec<i64>,
    /// Whether the motor was faster than it can stop at once, so that it may stand elsewhere.
    pub uncertain: Vec<bool>,
}

/// What went wrong on one motor, by a plan that no planner should have let through.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// This epoch asked for a step that came too late, or too soon after another; what followed was dropped.
    pub step_missed: bool,
    /// A DIR edge came later than its set-up before the step.
    pub setup_cut_short: bool,
}

/// A board in virtual time.
///
/// ```
/// use pulsetrain_board::{Config, Edge, MotorConfig, Native, Wiring};
/// use pulsetrain_core::{Direction, Entry, Epoch, Item, Tick32, Segment};
///
/// let wiring = Wiring::StepDir { step: 8, dir: 9, forward_high: true, pulse_ticks: 10, setup_ticks: 5 };
/// let motor = MotorConfig { wiring, pull_in_ticks: 1000 };
/// let mut board = Native::new(&Config { fraction_bits: 16, motors: vec![motor] })?;
/// let segment = Segment { count: 2, interval: 100 << 16, add: 0, add2: 0 };
/// for item in [Item::Anchor { tick: Tick32(0) }, Item::Run { segment, direction: Direction::Forward }] {
///     board.push(0, Entry { epoch: Epoch(0), item }).expect("room");
/// }
/// let mut edges = Vec::new();
/// board.advance(150, &mut |edge: Edge| edges.push((edge.tick, edge.line, edge.level)));
/// assert_eq!(edges, [(95, 9, true), (100, 8, true), (110, 8, false)]);
/// assert_eq!(board.positions(), [1]);
/// # Ok::<(), pulsetrain_board::native::ConfigError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Native {
    engine: Box<dyn Engine>,
    motors: Vec<Motor>,
    /// The longest set-up or pulse: an axis is committed no further ahead, ticks.
    committed_ticks: u64,
    /// The first tick that has not been passed.
    now: u64,
    /// Since when the lease is over, and why.
    lapsed: Option<(u64, LapseCause)>,
    /// Accepted extensions that [`Leased::extended`] has not reported yet.
    extended: usize,
}

/// What the board remembers of a motor beyond its axis.
#[derive(Clone, Debug)]
struct Motor {
    position: i64,
    pull_in_ticks: u64,
    /// Ticks of the last step and the one before.
    last: [Option<u64>; 2],
}

impl Native {
    /// A board at tick 0, all lines low, all motors at position 0, in epoch 0.
    ///
    /// # Errors
    /// When the configuration asks for what no board has.
    pub fn new(config: &Config) -> Result<Native, ConfigError> {
        Native::with_queues(config, QUEUE_LEN)
    }

    /// The same with queues of any length, so that it holds all that the board beside it holds.
    ///
    /// # Errors
    /// As [`Native::new`].
    pub fn unbounded(config: &Config) -> Result<Native, ConfigError> {
        Native::with_queues(config, usize::MAX)
    }

    fn with_queues(config: &Config, most: usize) -> Result<Native, ConfigError> {
        let outputs = outputs(config)?;
        let sharing = Sharing::of(config);
        let engine: Box<dyn Engine> = match config.fraction_bits {
            16 => Box::new(Axes::<16>::new(outputs, most, sharing)),
            24 => Box::new(Axes::<24>::new(outputs, most, sharing)),
            32 => Box::new(Axes::<32>::new(outputs, most, sharing)),
            bits => return Err(ConfigError::FractionBits(bits)),
        };
        let motors = config
            .motors
            .iter()
            .map(|motor| Motor { position: 0, pull_in_ticks: motor.pull_in_ticks, last: [None; 2] })
            .collect();
        let longest = config.motors.iter().map(|motor| motor.wiring.longest_ticks()).max();
        Ok(Native { engine, motors, committed_ticks: longest.map_or(0, u64::from), now: 0, lapsed: None, extended: 0 })
    }

    /// The same, with DIR lines that stay so long after a pulse: it matters to motors that share one while they brake.
    #[must_use]
    pub fn with_dir_hold(mut self, ticks: u32) -> Native {
        self.engine.hold(ticks);
        self
    }

    /// Puts an item last in a motor's queue.
    ///
    /// # Errors
    /// A full queue hands it back, and so does a motor that is not there.
    pub fn push(&mut self, motor: usize, entry: Entry) -> Result<(), Entry> {
        self.engine.push(motor, entry)
    }

    /// Free places in a motor's queue.
    #[must_use]
    pub fn credit(&self, motor: usize) -> usize {
        self.engine.credit(motor)
    }

    fn switch_with(
        &mut self,
        epoch: Epoch,
        tick: u64,
        lease: lease::Lease,
        limits: &[Limit],
    ) -> Result<(), SwitchRefused> {
        let limit = self.now + (1 << 30);
        let answer = if tick < self.horizon() {
            Err(SwitchRefused::Late { horizon: self.horizon() })
        } else if tick >= limit {
            Err(SwitchRefused::Early { limit })
        } else {
            self.engine.switch(epoch, Tick32::of(tick), lease, limits).map_err(|_| SwitchRefused::Full)
        };
        if answer.is_err() {
            self.engine.discard(epoch);
        }
        answer
    }

    /// The first tick that is open on all motors: a switch is accepted from there on.
    #[must_use]
    pub fn horizon(&self) -> u64 {
        // No axis is committed further ahead than the longest set-up or pulse.
        let ahead = self.engine.horizons().map(|horizon| horizon.since(Tick32::of(self.now)));
        self.now + ahead.filter(|&ahead| ahead < 1 << 31).max().map_or(0, u64::from)
    }

    /// The last tick up to which it may come and still take a switch at `tick`; `None` if there is none.
    pub(crate) fn last_before_switch(&self, tick: u64) -> Option<u64> {
        tick.checked_sub(1 + self.committed_ticks)
    }

    /// The first tick that has not been passed.
    #[must_use]
    pub fn now(&self) -> u64 {
        self.now
    }

    /// Makes all edges up to and with tick `until`.
    pub fn advance(&mut self, until: u64, observer: &mut impl Observer) {
        while self.now <= until {
            let end = until.min(self.now + STRETCH - 1);
            let mut watch = Watch { now: self.now, motors: &mut self.motors, observer };
            self.engine.run(Tick32::of(end), &mut watch);
            self.now = end + 1;
            self.note_lapse();
        }
    }

    /// All motors brake from `tick` on, unless they do already.
    pub fn brake_at(&mut self, tick: u64) {
        self.engine.lapse_at(Lapse { at: Tick32::of(tick), cause: LapseCause::Ordered });
        self.note_lapse();
    }

    /// Since when the lease is over: while that is near enough to be told.
    fn note_lapse(&mut self) {
        self.lapsed = self.engine.lease().1.map(|lapse| {
            let known = self.lapsed.filter(|(at, _)| Tick32::of(*at) == lapse.at);
            (known.map_or_else(|| self.near(lapse.at), |(at, _)| at), lapse.cause)
        });
    }

    /// The tick of a moment within 2^31 of now.
    fn near(&self, moment: Tick32) -> u64 {
        let ahead = moment.since(Tick32::of(self.now)).cast_signed();
        self.now.saturating_add_signed(ahead.into())
    }

    /// The lease as its channels know it, if ticks so far ahead can be told apart.
    fn moment_of(&self, lease: Lease) -> Result<lease::Lease, u64> {
        let limit = self.now + (1 << 30);
        match lease {
            Lease::Until(tick) if tick >= limit => Err(limit),
            Lease::Until(tick) => Ok(lease::Lease::Until(Tick32::of(tick))),
            Lease::Last => Ok(lease::Lease::Last),
        }
    }

    /// Makes all edges up to and with `tick`, and then begins no step more, whatever was planned. A pulse that was
    /// begun ends as it should.
    ///
    /// An unplanned stop: only for when no planned one will do. After it motors move again with an anchor.
    pub fn stop_now(&mut self, tick: u64, observer: &mut impl Observer) -> StopReport {
        self.advance(tick, observer);
        let tick = self.now - 1;
        let going = self.engine.stop();
        let uncertain = self
            .motors
            .iter()
            .zip(going)
            .map(|(motor, going)| {
                let [Some(last), Some(before)] = motor.last else { return false };
                // Slower than that since its last step, it is slow enough now.
                going && (last - before).max(tick - last) < motor.pull_in_ticks
            })
            .collect();
        StopReport { tick, positions: self.positions(), uncertain }
    }

    /// Steps forward minus steps backward of each motor: pulses begun so far.
    #[must_use]
    pub fn positions(&self) -> Vec<i64> {
        self.motors.iter().map(|motor| motor.position).collect()
    }

    /// Whether nothing is left to do: no step, no end of a pulse.
    #[must_use]
    pub fn idle(&self) -> bool {
        self.engine.is_idle()
    }

    /// The epoch that a motor runs.
    #[must_use]
    pub fn epoch(&self, motor: usize) -> Option<Epoch> {
        self.engine.epoch(motor)
    }

    /// What went wrong on a motor.
    #[must_use]
    pub fn faults(&self, motor: usize) -> Faults {
        self.engine.faults(motor)
    }
}

impl Board for Native {
    fn push(&mut self, motor: usize, entry: Entry) -> Result<(), Entry> {
        Native::push(self, motor, entry)
    }

    fn discard(&mut self, epoch: Epoch) {
        self.engine.discard(epoch);
    }

    fn room(&self, motor: usize) -> usize {
        self.credit(motor)
    }

    fn sizer(&self, _motor: usize) -> Sizer {
        Sizer::items()
    }

    fn lead(&self) -> u64 {
        0
    }

    fn horizon(&self) -> u64 {
        Native::horizon(self)
    }

    fn now(&self) -> u64 {
        self.now
    }

    fn epoch(&self) -> Epoch {
        Native::epoch(self, 0).unwrap_or_default()
    }

    fn advance(&mut self, until: u64, observer: &mut impl Observer) {
        Native::advance(self, until, observer);
    }

    fn stop_now(&mut self, tick: u64, observer: &mut impl Observer) -> StopReport {
        Native::stop_now(self, tick, observer)
    }

    fn positions(&self) -> Vec<i64> {
        Native::positions(self)
    }

    fn is_idle(&self) -> bool {
        self.idle()
    }

    fn faults(&self, motor: usize) -> Faults {
        Native::faults(self, motor)
    }
}

impl Leased for Native {
    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[Limit]) -> Result<(), SwitchRefused> {
        match self.moment_of(lease) {
            Ok(lease) => self.switch_with(epoch, tick, lease, limits),
            Err(limit) => {
                self.engine.discard(epoch);
                Err(SwitchRefused::Early { limit })
            }
        }
    }

    fn extend(&mut self, lease: Lease, limits: &[Limit]) -> Result<(), ExtendRefused> {
        let told = self.moment_of(lease).map_err(|limit| ExtendRefused::Early { limit })?;
        self.check_extend(lease)?;
        self.engine.extend(told, limits);
        self.extended += 1;
        Ok(())
    }

    fn extended(&mut self) -> Option<bool> {
        self.extended = self.extended.checked_sub(1)?;
        Some(true)
    }

    fn trim(&mut self, until: u64, items: &[usize]) -> Result<(), TrimRefused> {
        let lease = self.moment_of(Lease::Until(until)).map_err(|limit| ExtendRefused::Early { limit })?;
        self.check_extend(Lease::Until(until))?;
        self.engine.take_back(items).map_err(|motor| TrimRefused::Read { motor })?;
        self.engine.extend(lease, &[]);
        Ok(())
    }

    fn brake(&mut self) -> Option<u64> {
        let lapsed = self.lapsed.map(|(at, _)| at);
        if self.engine.check_extend(lease::Lease::Last).is_err() {
            return lapsed;
        }
        let at = match (lapsed, self.engine.lease().0) {
            (Some(at), _) => at,
            (None, lease::Lease::Until(until)) => self.horizon().min(self.near(until)),
            // Or the switch that begins one waits.
            (None, lease::Lease::Last | lease::Lease::Off) => self.horizon(),
        };
        self.brake_at(self.horizon().min(at));
        Some(at)
    }

    fn lease(&self) -> LeaseState {
        match (self.lapsed, self.engine.lease().0) {
            (Some((at, cause)), _) => LeaseState::Lapsed { at, cause, in_motion: self.engine.was_moving() },
            (None, lease::Lease::Off) => LeaseState::Off,
            (None, lease::Lease::Until(until)) => LeaseState::Until(self.near(until)),
            (None, lease::Lease::Last) => LeaseState::Last,
        }
    }
}

impl Native {
    /// Whether all motors would take it.
    fn check_extend(&self, lease: Lease) -> Result<(), ExtendRefused> {
        if let Lease::Until(until) = lease
            && until < self.horizon()
        {
            // What else speaks against it says more.
            self.engine.check_extend(lease::Lease::Last).map_err(|refused| self.refusal(refused))?;
            return Err(ExtendRefused::Late { horizon: self.horizon() });
        }
        let lease = self.moment_of(lease).map_err(|limit| ExtendRefused::Early { limit })?;
        self.engine.check_extend(lease).map_err(|refused| self.refusal(refused))
    }

    fn refusal(&self, refused: lease::ExtendRefused) -> ExtendRefused {
        match refused {
            lease::ExtendRefused::Off => ExtendRefused::Off,
            lease::ExtendRefused::Lapsed { at } => {
                ExtendRefused::Lapsed { at: self.lapsed.map_or_else(|| self.near(at), |(at, _)| at) }
            }
            lease::ExtendRefused::Late { .. } => ExtendRefused::Late { horizon: self.horizon() },
        }
    }
}

/// Counts for the board and tells the observer.
struct Watch<'a, O> {
    now: u64,
    motors: &'a mut [Motor],
    observer: &'a mut O,
}

/// What a stepgen tells as it runs.
trait Witness {
    fn step(&mut self, motor: usize, tick: Tick32, direction: Direction);
    fn edge(&mut self, edge: pulsetrain_core::output::Edge);
}

impl<O: Observer> Watch<'_, O> {
    fn extended(&self, tick: Tick32) -> u64 {
        self.now + u64::from(tick.since(Tick32::of(self.now)))
    }
}

impl<O: Observer> Witness for Watch<'_, O> {
    fn step(&mut self, motor: usize, tick: Tick32, direction: Direction) {
        let tick = self.extended(tick);
        let counts = &mut self.motors[motor];
        counts.position += i64::from(direction.sign());
        counts.last = [Some(tick), counts.last[0]];
        self.observer.step(ScheduledStep { motor, tick, direction });
    }

    fn edge(&mut self, edge: pulsetrain_core::output::Edge) {
        let tick = self.extended(edge.tick);
        let mut lines = edge.set | edge.clear;
        while lines != 0 {
            let line = lines.trailing_zeros() as u8;
            lines &= lines - 1;
            self.observer.edge(Edge { tick, line, level: edge.set >> line & 1 == 1 });
        }
    }
}

/// The stepgen of all motors, whatever its F.
trait Engine: std::fmt::Debug + Send + Sync {
    fn boxed(&self) -> Box<dyn Engine>;
    fn push(&mut self, motor: usize, entry: Entry) -> Result<(), Entry>;
    fn credit(&self, motor: usize) -> usize;
    /// With no limits the motors keep theirs.
    fn switch(
        &mut self,
        epoch: Epoch,
        at: Tick32,
        lease: lease::Lease,
        limits: &[Limit],
    ) -> Result<(), channel::SwitchRefused>;
    fn check_extend(&self, lease: lease::Lease) -> Result<(), lease::ExtendRefused>;
    fn extend(&mut self, lease: lease::Lease, limits: &[Limit]);
    /// Takes back so many items from the end of each queue; all or, with a motor that has not so many, none.
    fn take_back(&mut self, items: &[usize]) -> Result<(), usize>;
    fn lapse_at(&mut self, lapse: Lapse);
    fn lease(&self) -> (lease::Lease, Option<Lapse>);
    fn was_moving(&self) -> bool;
    fn hold(&mut self, ticks: u32);
    fn discard(&mut self, epoch: Epoch);
    fn horizons(&self) -> Box<dyn Iterator<Item = Tick32> + '_>;
    fn run(&mut self, until: Tick32, witness: &mut dyn Witness);
    /// Whether each motor had something left to do.
    fn stop(&mut self) -> Vec<bool>;
    fn is_idle(&self) -> bool;
    fn epoch(&self, motor: usize) -> Option<Epoch>;
    fn faults(&self, motor: usize) -> Faults;
}

impl Clone for Box<dyn Engine> {
    fn clone(&self) -> Self {
        self.as_ref().boxed()
    }
}

/// A motor's queue: as [`pulsetrain_core::Queue`], on the heap.
#[derive(Clone, Debug)]
struct Waiting {
    entries: VecDeque<Entry>,
    /// Entries that it holds.
    most: usize,
}

impl Waiting {
    const fn new(most: usize) -> Waiting {
        Waiting { entries: VecDeque::new(), most }
    }

    fn push(&mut self, entry: Entry) -> Result<(), Entry> {
        if self.entries.len() == self.most {
            return Err(entry);
        }
        self.entries.push_back(entry);
        Ok(())
    }

    fn credit(&self) -> usize {
        self.most - self.entries.len()
    }

    fn discard(&mut self, epoch: Epoch) {
        while self.entries.pop_back_if(|entry| entry.epoch == epoch).is_some() {}
    }
}

impl Items for Waiting {
    fn has(&self, epoch: Epoch) -> bool {
        self.entries.front().is_some_and(|entry| entry.epoch == epoch)
    }

    fn take(&mut self, _: &Place) -> Option<Item> {
        self.entries.pop_front().map(|entry| entry.item)
    }

    fn skip_to(&mut self, epoch: Epoch) {
        while self.entries.pop_front_if(|entry| entry.epoch != epoch).is_some() {}
    }

    fn clear(&mut self) {
        self.entries.clear();
    }
}

/// Who shares a DIR line.
#[derive(Clone, Debug)]
struct Sharing {
    /// Of each motor: its line, if it shares one, and whether that is high for forward.
    members: Vec<Option<(usize, bool)>>,
    /// The longest pulse and setup of each line's motors.
    apart_ticks: Vec<u32>,
}

impl Sharing {
    fn of(config: &Config) -> Sharing {
        let driver = |motor: &MotorConfig| match motor.wiring {
            Wiring::StepDir { dir, forward_high, pulse_ticks, setup_ticks, .. } => {
                Some((dir, forward_high, pulse_ticks, setup_ticks))
            }
            Wiring::Coils { .. } => None,
        };
        let drivers: Vec<_> = config.motors.iter().map(driver).collect();
        let mut lines: Vec<(u8, u32)> = Vec::new();
        for (dir, ..) in drivers.iter().flatten() {
            let sharing = || drivers.iter().flatten().filter(|other| other.0 == *dir);
            if sharing().count() > 1 && lines.iter().all(|(line, _)| line != dir) {
                let pulse = sharing().map(|driver| driver.2).max().unwrap_or(0);
                lines.push((*dir, pulse + sharing().map(|driver| driver.3).max().unwrap_or(0)));
            }
        }
        let place = |dir: u8| lines.iter().position(|(line, _)| *line == dir);
        let members =
            drivers.iter().map(|driver| driver.and_then(|(dir, high, ..)| Some((place(dir)?, high)))).collect();
        Sharing { members, apart_ticks: lines.into_iter().map(|(_, ticks)| ticks).collect() }
    }
}

#[derive(Clone, Debug)]
struct Axes<const F: u32> {
    motors: Motors<F>,
    merge: Merge<MAX_MOTORS>,
}

#[derive(Clone, Debug)]
struct Motors<const F: u32> {
    axes: Vec<Axis<F, Waiting>>,
    sharing: Sharing,
    lines: Vec<SharedLine>,
    /// Edges of motors whose turn came before that of the one that was asked for.
    ready: Vec<VecDeque<pulsetrain_core::output::Edge>>,
}

impl<const F: u32> Axes<F> {
    fn new(outputs: Vec<Output>, most: usize, sharing: Sharing) -> Axes<F> {
        let axes: Vec<_> = outputs.into_iter().map(|output| Axis::new(output, Waiting::new(most))).collect();
        let lines = sharing.apart_ticks.iter().copied().map(SharedLine::new).collect();
        let ready = vec![VecDeque::new(); axes.len()];
        Axes { motors: Motors { axes, sharing, lines, ready }, merge: Merge::new() }
    }

    fn axes(&self) -> &[Axis<F, Waiting>] {
        &self.motors.axes
    }

    fn channels_mut(&mut self) -> impl Iterator<Item = &mut Channel<F>> {
        self.motors.axes.iter_mut().map(Axis::channel_mut)
    }
}

impl<const F: u32> Motors<F> {
    /// The next edge of a motor that comes not after `until`.
    fn pull(
        &mut self,
        motor: usize,
        until: Tick32,
        witness: &mut dyn Witness,
    ) -> Option<pulsetrain_core::output::Edge> {
        if let Some(edge) = self.ready.get_mut(motor)?.pop_front() {
            return Some(edge);
        }
        let Some((line, _)) = self.sharing.members[motor] else { return self.next(motor, until, witness) };
        while !self.axes[motor].owes() {
            let Some(first) = self.first_on(line, until) else { break };
            if first == motor {
                break;
            }
            let edge = self.next(first, until, witness)?;
            self.ready[first].push_back(edge);
        }
        self.next(motor, until, witness)
    }

    /// After a lapse: whose step comes first on a DIR line; it is put off as the line needs it.
    fn first_on(&mut self, line: usize, until: Tick32) -> Option<usize> {
        let motors: Vec<usize> = self
            .sharing
            .members
            .iter()
            .enumerate()
            .filter(|(_, member)| member.is_some_and(|(of, _)| of == line))
            .map(|(motor, _)| motor)
            .collect();
        let lead = motors.iter().map(|motor| self.axes[*motor].lead_ticks()).max().unwrap_or(0);
        let steps = loop {
            let steps: Vec<_> = motors.iter().map(|motor| self.axes[*motor].scheduled(until.after(lead))).collect();
            if !self.agree() {
                break steps;
            }
        };
        motors.iter().find(|motor| self.axes[**motor].channel().lapse().is_some())?;
        // What is left of the plan comes before all steps of the stop, and keeps its own steps apart.
        let is_planned = |motor: &usize| !self.axes[*motor].channel().is_braking();
        let planned = motors.iter().zip(&steps).map(|(motor, step)| step.filter(|_| is_planned(motor)));
        if let Some(place) = shared_line::first(planned.map(|step| step.map(|(tick, _)| (tick, false)))) {
            return Some(motors[place]);
        }
        let place = shared_line::first(steps.iter().copied())?;
        let first = motors[place];
        let (Some((_, false)), Some((_, forward_high))) = (steps[place], self.sharing.members[first]) else {
            return Some(first);
        };
        let axis = &mut self.axes[first];
        let level = (axis.channel().direction() == Direction::Forward) == forward_high;
        let open = self.lines[line].open(level, axis.soonest_turn());
        axis.channel_mut().put_off(open);
        Some(first)
    }

    fn next(
        &mut self,
        motor: usize,
        until: Tick32,
        witness: &mut dyn Witness,
    ) -> Option<pulsetrain_core::output::Edge> {
        let axis = &mut self.axes[motor];
        let before = axis.channel().position();
        let edge = axis.next(until);
        let moved = axis.channel().position().wrapping_sub(before);
        self.agree();
        let edge = edge?;
        if moved != 0 {
            let direction = if moved == 1 { Direction::Forward } else { Direction::Backward };
            witness.step(motor, edge.tick, direction);
            if let Some((line, forward_high)) = self.sharing.members[motor] {
                self.lines[line].made(edge.tick, (direction == Direction::Forward) == forward_high);
            }
        }
        Some(edge)
    }

    /// Tells all of a lapse that one has noticed; whether there was one.
    fn agree(&mut self) -> bool {
        if !self.axes.iter().any(|axis| axis.channel().has_news()) {
            return false;
        }
        let Some(lapse) = channels::agreed_lapse(self.axes.iter().map(Axis::channel)) else { return false };
        self.axes.iter_mut().for_each(|axis| axis.channel_mut().lapse_at(lapse));
        true
    }
}

impl<const F: u32> Engine for Axes<F> {
    fn boxed(&self) -> Box<dyn Engine> {
        Box::new(self.clone())
    }

    fn push(&mut self, motor: usize, entry: Entry) -> Result<(), Entry> {
        let Some(axis) = self.motors.axes.get_mut(motor) else { return Err(entry) };
        if axis.channel().keeps(entry.epoch) { axis.queue_mut().push(entry) } else { Ok(()) }
    }

    fn credit(&self, motor: usize) -> usize {
        self.axes().get(motor).map_or(0, |axis| axis.queue().credit())
    }

    fn switch(
        &mut self,
        epoch: Epoch,
        at: Tick32,
        lease: lease::Lease,
        limits: &[Limit],
    ) -> Result<(), channel::SwitchRefused> {
        self.axes().iter().try_for_each(|axis| axis.channel().check_switch(at))?;
        let limits = limits.iter().copied().map(Some).chain(std::iter::repeat(None));
        self.channels_mut()
            .zip(limits)
            .try_for_each(|(channel, limit)| channel.schedule_switch(epoch, at, lease, limit))
    }

    fn check_extend(&self, lease: lease::Lease) -> Result<(), lease::ExtendRefused> {
        self.axes().iter().try_for_each(|axis| axis.channel().check_extend(lease))
    }

    fn extend(&mut self, lease: lease::Lease, limits: &[Limit]) {
        let limits = limits.iter().copied().map(Some).chain(std::iter::repeat(None));
        self.channels_mut().zip(limits).for_each(|(channel, limit)| channel.extend(lease, limit));
    }

    fn take_back(&mut self, items: &[usize]) -> Result<(), usize> {
        let mut queues = self.axes().iter().map(|axis| axis.queue().entries.len());
        let wanted = items.iter().map(|count| (*count, queues.next().unwrap_or(0)));
        if let Some(motor) = wanted.into_iter().position(|(count, waiting)| count > waiting) {
            return Err(motor);
        }
        for (axis, count) in self.motors.axes.iter_mut().zip(items) {
            let entries = &mut axis.queue_mut().entries;
            entries.truncate(entries.len() - count);
        }
        Ok(())
    }

    fn lapse_at(&mut self, lapse: Lapse) {
        self.channels_mut().for_each(|channel| channel.lapse_at(lapse));
    }

    fn lease(&self) -> (lease::Lease, Option<Lapse>) {
        let lease = self.axes().first().map_or(lease::Lease::Off, |axis| axis.channel().lease());
        let lapses = self.axes().iter().filter_map(|axis| axis.channel().lapse());
        (lease, lapses.min_by_key(|lapse| !lapse.cause.is_fault()))
    }

    fn was_moving(&self) -> bool {
        self.axes().iter().any(|axis| axis.channel().was_moving())
    }

    fn hold(&mut self, ticks: u32) {
        let Motors { sharing, lines, .. } = &mut self.motors;
        *lines = sharing.apart_ticks.iter().map(|apart| SharedLine::new(apart + ticks)).collect();
    }

    fn discard(&mut self, epoch: Epoch) {
        for axis in &mut self.motors.axes {
            axis.queue_mut().discard(epoch);
        }
    }

    fn horizons(&self) -> Box<dyn Iterator<Item = Tick32> + '_> {
        Box::new(self.axes().iter().map(|axis| axis.channel().horizon()))
    }

    fn run(&mut self, until: Tick32, witness: &mut dyn Witness) {
        let Axes { motors, merge } = self;
        merge.reopen();
        while let Some(edge) = merge.next(|motor| motors.pull(motor, until, witness)) {
            witness.edge(edge);
        }
        motors.axes.iter_mut().for_each(|axis| axis.pass(until));
        motors.lines.iter_mut().for_each(|line| line.pass(until));
    }

    fn stop(&mut self) -> Vec<bool> {
        let stop = |axis: &mut Axis<F, Waiting>| {
            let going = !axis.channel().is_idle(axis.queue());
            axis.stop();
            going
        };
        self.motors.axes.iter_mut().map(stop).collect()
    }

    fn is_idle(&self) -> bool {
        self.axes().iter().all(Axis::is_idle)
    }

    fn epoch(&self, motor: usize) -> Option<Epoch> {
        self.axes().get(motor).map(|axis| axis.channel().epoch())
    }

    fn faults(&self, motor: usize) -> Faults {
        self.axes().get(motor).map_or_else(Faults::default, |axis| Faults {
            step_missed: axis.channel().missed().is_some(),
            setup_cut_short: axis.setup_cut_short(),
        })
    }
}

/// The outputs of all motors, if their lines and times can be.
fn outputs(config: &Config) -> Result<Vec<Output>, ConfigError> {
    if config.motors.len() > MAX_MOTORS {
        return Err(ConfigError::Motors(config.motors.len()));
    }
    // How often a line is used as DIR, and as anything else.
    let (mut as_dir, mut otherwise) = ([0; MAX_LINES as usize], [0; MAX_LINES as usize]);
    for MotorConfig { wiring, .. } in &config.motors {
        if let Wiring::StepDir { pulse_ticks: 0, .. } = wiring {
            return Err(ConfigError::Ticks(0));
        }
        let ticks = wiring.longest_ticks();
        if u64::from(ticks) >= STRETCH {
            return Err(ConfigError::Ticks(ticks));
        }
        for line in wiring.lines() {
            let is_dir = matches!(wiring, Wiring::StepDir { dir, step, .. } if *dir == line && step != dir);
            let uses = if is_dir { &mut as_dir } else { &mut otherwise };
            *uses.get_mut(usize::from(line)).ok_or(ConfigError::Line(line))? += 1;
        }
    }
    for line in 0..MAX_LINES {
        let (dirs, others) = (as_dir[usize::from(line)], otherwise[usize::from(line)]);
        if others > 1 || (others == 1 && dirs > 0) {
            return Err(ConfigError::LineTaken(line));
        }
    }
    Ok(config
        .motors
        .iter()
        .map(|motor| match motor.wiring {
            Wiring::StepDir { step, dir, forward_high, pulse_ticks, setup_ticks } => {
                Output::StepDir(StepDir::new(StepDirSettings {
                    step_line: step,
                    dir_line: dir,
                    pulse_ticks,
                    setup_ticks,
                    forward_high,
                    shared_dir: as_dir[usize::from(dir)] > 1,
                }))
            }
            Wiring::Coils { lines, sequence, release_ticks } => {
                Output::Coils(Coils::new(lines, sequence, release_ticks))
            }
        })
        .collect())
}
