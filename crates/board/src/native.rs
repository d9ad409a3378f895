//! The native board: the stepgen of `pulsetrain_core` (channel, output and merge) on the PC, in virtual time.
//!
//! Ticks have 64 bits here; the stepgen's 32-bit ticks are extended as time goes on. Time passes only in [`Native::advance`] and
//! [`Native::stop_now`], and each tick passes once.

use crate::lease::{ExtendRefused, Lease, LeaseState, Leased, TrimRefused};
use crate::{Board, Sizer};
use pulsetrain_core::braking::Limit;
use pulsetrain_core::channels;
use pulsetrain_core::lease::{self, Lapse, LapseCause};
use pulsetrain_core::output::{Coils, Output, Sequence, StepDir, StepDirSettings};
use pulsetrain_core::queue::{Items, Place};
use pulsetrain_core::shared_line::{self, SharedLine};
use pulsetrain_core::wire::message::{ALL_MOTORS, Cause, Event};
use pulsetrain_core::{Axis, Channel, Direction, Entry, Epoch, Item, Merge, Tick32, channel};
use std::collections::VecDeque;

/// Most motors of a native board.
pub const MAX_MOTORS: usize = 16;

/// Items in a motor's queue, unless it is [unbounded](Native::unbounded): enough for motions of more than 10^6 steps/s.
pub const QUEUE_LEN: usize = 1024;

/// Most lines of a native board: an edge of core has its lines in 32 bits.
pub const MAX_LINES: u8 = 32;

/// Most ticks that the stepgen runs at once. It can compare ticks within 2^31, and DIR setup and pulses reach beyond the end.
const LONGEST_RUN_TICKS: u64 = 1 << 29;

/// The configuration of a native board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Config {
    /// Fraction bits of an interval (F): 16, 24 or 32.
    pub fraction_bits: u32,
    /// The motors, at most [`MAX_MOTORS`].
    pub motors: Vec<MotorConfig>,
}

/// One motor of a native board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MotorConfig {
    /// Its lines, all below [`MAX_LINES`], and their timing.
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
        /// Whether DIR is high for forward.
        forward_high: bool,
        /// How long STEP stays high, ticks: 1 to 2^29 − 1.
        pulse_ticks: u32,
        /// How long before a step DIR has its level, ticks: below 2^29.
        setup_ticks: u32,
    },
    /// Four coils.
    Coils {
        /// The lines of IN1 to IN4.
        lines: [u8; 4],
        /// The order in which the coils are switched.
        sequence: Sequence,
        /// The coils are switched off this long after the last step, ticks, below 2^29; `None` if they stay on.
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

    /// The longest time before a step at which a line changes for it, ticks.
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

/// Why a configuration is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// F is not one of 16, 24, 32.
    #[error("{0} fraction bits: a native board has 16, 24 or 32")]
    FractionBits(u32),
    /// More than [`MAX_MOTORS`].
    #[error("{0} motors: a native board has at most {MAX_MOTORS}")]
    Motors(usize),
    /// There is no line of that number.
    #[error("line {0}: a native board has lines 0 to 31")]
    Line(u8),
    /// A line is used twice, and not only as DIR.
    #[error("line {0} is used twice")]
    LineTaken(u8),
    /// A pulse, DIR setup or release of 2^29 ticks or more, or a pulse of 0 ticks.
    #[error("a time of {0} ticks: a native board keeps 1 to 2^29 - 1")]
    Ticks(u32),
}

/// A change of one line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// When, ticks.
    pub tick: u64,
    /// The number of the line; of a board with pins, the pin.
    pub line: u8,
    /// Whether the line is high from then on.
    pub level: bool,
}

/// A step, at the tick for which the stepgen scheduled it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScheduledStep {
    /// Index of the motor.
    pub motor: usize,
    /// When, ticks.
    pub tick: u64,
    /// Whether the step counts up or down.
    pub direction: Direction,
}

/// Gets the edges and steps of a board while it runs. Any `FnMut(Edge)` is one that ignores steps.
pub trait Observer {
    /// An edge. Edges come in the order of their ticks, and of their lines within a tick.
    fn edge(&mut self, edge: Edge);

    /// A scheduled step. For each motor steps come in the order of their ticks, each before its edge.
    fn step(&mut self, step: ScheduledStep) {
        let _ = step;
    }
}

impl<T: FnMut(Edge)> Observer for T {
    fn edge(&mut self, edge: Edge) {
        self(edge);
    }
}

/// Why a switch was refused. The old plan goes on on all motors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SwitchRefused {
    /// A motor is committed beyond the switch's tick.
    #[error("the board is committed up to tick {horizon}")]
    Late {
        /// The first tick at which a switch would be accepted now.
        horizon: u64,
    },
    /// The tick is 2^30 or more ahead of the board's time.
    #[error("the switch is too far ahead: only ticks before {limit} can be told apart")]
    Early {
        /// The first tick that is too far ahead.
        limit: u64,
    },
    /// Another switch waits, for an earlier tick.
    #[error("another switch waits already")]
    Full,
    /// The board can no longer be reached; it follows the plan that it has. [`Board::lost`] says why.
    #[error("nothing can be said to the board any more")]
    Lost,
}

/// The result of an immediate stop.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StopReport {
    /// No step began after this tick.
    pub tick: u64,
    /// Steps forward minus backward that each motor's pins made: exact.
    pub positions: Vec<i64>,
    /// For each motor: whether it was faster than its pull-in rate, so that it may stand elsewhere than its pins counted.
    pub uncertain: Vec<bool>,
}

/// Faults of one motor. Each comes from a plan that the planner should have refused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Faults {
    /// A step of this epoch came too late, or too soon after the one before. The rest of the epoch was dropped.
    pub step_missed: bool,
    /// A DIR edge came less than the DIR setup before its step.
    pub setup_cut_short: bool,
}

/// The native board. See the [module](self).
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
    motors: Vec<NativeMotor>,
    /// The longest DIR setup or pulse, ticks: no axis is committed further ahead.
    committed_ticks: u64,
    /// The first tick that has not been passed.
    now: u64,
    /// The tick at which the lease ended, and why; `None` if it has not ended.
    lapsed: Option<(u64, LapseCause)>,
    /// How many accepted extensions [`Leased::extended`] has not reported yet.
    unreported_extensions: usize,
    /// What [`Board::events`] has not reported yet.
    events: Vec<Event>,
    /// Something was left to do when that was asked last.
    was_busy: bool,
    /// The lapse of the lease was looked at, and reported if motors were in motion.
    lapse_was_reported: bool,
}

/// What the board keeps of a motor besides its axis.
#[derive(Clone, Debug)]
struct NativeMotor {
    position: i64,
    pull_in_ticks: u64,
    /// The ticks of the last step and of the one before it.
    last: [Option<u64>; 2],
    /// A missed step was reported.
    miss_was_reported: bool,
}

impl Native {
    /// A board at tick 0, all lines low, all motors at position 0, in epoch 0.
    ///
    /// # Errors
    /// When the configuration is not possible.
    pub fn new(config: &Config) -> Result<Native, ConfigError> {
        Native::with_queues(config, QUEUE_LEN)
    }

    /// As [`Native::new`], with queues of any length: for a reference of a board whose queues may be longer.
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
            .map(|motor| NativeMotor {
                position: 0,
                pull_in_ticks: motor.pull_in_ticks,
                last: [None; 2],
                miss_was_reported: false,
            })
            .collect();
        let longest = config.motors.iter().map(|motor| motor.wiring.longest_ticks()).max();
        Ok(Native {
            engine,
            motors,
            committed_ticks: longest.map_or(0, u64::from),
            now: 0,
            lapsed: None,
            unreported_extensions: 0,
            events: Vec::new(),
            was_busy: false,
            lapse_was_reported: false,
        })
    }

    /// This board, with DIR lines that keep their level for so many ticks after a pulse. It matters to motors that share a DIR line while they brake.
    #[must_use]
    pub fn with_dir_hold(mut self, ticks: u32) -> Native {
        self.engine.hold(ticks);
        self
    }

    /// Appends an item to a motor's queue.
    ///
    /// # Errors
    /// Hands the item back if the queue is full or there is no such motor.
    pub fn push(&mut self, motor: usize, entry: Entry) -> Result<(), Entry> {
        self.engine.push(motor, entry)
    }

    /// Items that a motor's queue has room for; 0 for a motor that is not there.
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

    /// The first tick to which no motor is committed yet: a switch is accepted at this tick or later.
    #[must_use]
    pub fn horizon(&self) -> u64 {
        // No axis is committed further ahead than the longest set-up or pulse.
        let ahead = self.engine.horizons().map(|horizon| horizon.since(Tick32::of(self.now)));
        self.now + ahead.filter(|&ahead| ahead < 1 << 31).max().map_or(0, u64::from)
    }

    /// The last tick that may pass before a switch at `tick` would be refused; `None` if it would be refused at once.
    pub(crate) fn last_before_switch(&self, tick: u64) -> Option<u64> {
        tick.checked_sub(1 + self.committed_ticks)
    }

    /// The first tick that has not been passed.
    #[must_use]
    pub fn now(&self) -> u64 {
        self.now
    }

    /// Lets time pass, up to and with tick `until`, and makes all edges of that time.
    pub fn advance(&mut self, until: u64, observer: &mut impl Observer) {
        while self.now <= until {
            self.was_busy |= !self.engine.is_idle();
            let end = until.min(self.now + LONGEST_RUN_TICKS - 1);
            let mut watch = Watch { now: self.now, motors: &mut self.motors, observer };
            self.engine.run(Tick32::of(end), &mut watch);
            self.now = end + 1;
            self.note_lapse();
            self.note_events();
        }
    }

    /// Notes what a board reports by itself: the end of a lease in motion, a missed step, rest.
    fn note_events(&mut self) {
        let mut report = |cause, motor, tick| self.events.push(Event { cause, motor, tick, detail: 0 });
        let lapse = self.lapsed.filter(|(at, _)| *at < self.now);
        if let Some((at, cause)) = lapse
            && !self.lapse_was_reported
            && self.engine.was_moving()
            // A missed step is reported below, for its motor.
            && cause != LapseCause::StepMissed
        {
            report(cause.into(), ALL_MOTORS, at);
        }
        self.lapse_was_reported = lapse.is_some();
        for (number, motor) in self.motors.iter_mut().enumerate() {
            let is_missed = self.engine.faults(number).step_missed;
            if is_missed && !motor.miss_was_reported {
                report(Cause::StepMissed, number as u8, lapse.map_or(self.now, |(at, _)| at));
            }
            motor.miss_was_reported = is_missed;
        }
        if self.was_busy && self.engine.is_idle() {
            self.was_busy = false;
            report(Cause::Finished, ALL_MOTORS, self.now);
        }
    }

    /// Brakes all motors from `tick` on, unless they brake already.
    pub fn brake_at(&mut self, tick: u64) {
        self.engine.lapse_at(Lapse { at: Tick32::of(tick), cause: LapseCause::Ordered });
        self.note_lapse();
    }

    /// Notes the end of the lease while its 32-bit tick is near enough to be extended to 64 bits.
    fn note_lapse(&mut self) {
        self.lapsed = self.engine.lease().1.map(|lapse| {
            let known = self.lapsed.filter(|(at, _)| Tick32::of(*at) == lapse.at);
            (known.map_or_else(|| self.near(lapse.at), |(at, _)| at), lapse.cause)
        });
    }

    /// A 32-bit tick in 64 bits: the one within 2^31 of now.
    fn near(&self, moment: Tick32) -> u64 {
        let ahead = moment.since(Tick32::of(self.now)).cast_signed();
        self.now.saturating_add_signed(ahead.into())
    }

    /// Converts a lease to the 32-bit ticks of the channels.
    ///
    /// # Errors
    /// The first tick that is too far ahead, if the lease ends there or later.
    fn core_lease(&self, lease: Lease) -> Result<lease::Lease, u64> {
        let limit = self.now + (1 << 30);
        match lease {
            Lease::Until(tick) if tick >= limit => Err(limit),
            Lease::Until(tick) => Ok(lease::Lease::Until(Tick32::of(tick))),
            Lease::Last => Ok(lease::Lease::Last),
        }
    }

    /// Makes all edges up to and with `tick`, and then stops: no further step begins, whatever was planned. Pulses that have begun keep their length.
    ///
    /// A fast motor may turn further than it counts. To move again, a plan needs an anchor.
    pub fn stop_now(&mut self, tick: u64, observer: &mut impl Observer) -> StopReport {
        self.advance(tick, observer);
        let tick = self.now - 1;
        let going = self.engine.stop();
        self.was_busy = false;
        let uncertain = self
            .motors
            .iter()
            .zip(going)
            .map(|(motor, going)| {
                let [Some(last), Some(before)] = motor.last else { return false };
                // The motor has waited for longer than its pull-in interval since its last step: it can stop.
                going && (last - before).max(tick - last) < motor.pull_in_ticks
            })
            .collect();
        StopReport { tick, positions: self.positions(), uncertain }
    }

    /// Steps forward minus steps backward of each motor, by the pulses that have begun.
    #[must_use]
    pub fn positions(&self) -> Vec<i64> {
        self.motors.iter().map(|motor| motor.position).collect()
    }

    /// Whether no step and no end of a pulse is left to do.
    #[must_use]
    pub fn idle(&self) -> bool {
        self.engine.is_idle()
    }

    /// The epoch that a motor follows; `None` for a motor that is not there.
    #[must_use]
    pub fn epoch(&self, motor: usize) -> Option<Epoch> {
        self.engine.epoch(motor)
    }

    /// The faults of a motor; none for a motor that is not there.
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

    fn round_trip(&self) -> u64 {
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

    fn events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    fn faults(&self, motor: usize) -> Faults {
        Native::faults(self, motor)
    }
}

impl Leased for Native {
    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[Limit]) -> Result<(), SwitchRefused> {
        match self.core_lease(lease) {
            Ok(lease) => self.switch_with(epoch, tick, lease, limits),
            Err(limit) => {
                self.engine.discard(epoch);
                Err(SwitchRefused::Early { limit })
            }
        }
    }

    fn extend(&mut self, lease: Lease, limits: &[Limit]) -> Result<(), ExtendRefused> {
        let told = self.core_lease(lease).map_err(|limit| ExtendRefused::Early { limit })?;
        self.check_extend(lease)?;
        self.engine.extend(told, limits);
        self.unreported_extensions += 1;
        Ok(())
    }

    fn extended(&mut self) -> Option<bool> {
        self.unreported_extensions = self.unreported_extensions.checked_sub(1)?;
        Some(true)
    }

    fn trim(&mut self, until: u64, items: &[usize]) -> Result<(), TrimRefused> {
        let lease = self.core_lease(Lease::Until(until)).map_err(|limit| ExtendRefused::Early { limit })?;
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
            // The switch that begins the lease may still wait for its tick.
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
    /// Checks that all motors would accept an extension of the lease.
    ///
    /// # Errors
    /// Those of [`extend`](Leased::extend).
    pub fn check_extend(&self, lease: Lease) -> Result<(), ExtendRefused> {
        if let Lease::Until(until) = lease
            && until < self.horizon()
        {
            // Any other reason says more.
            self.engine.check_extend(lease::Lease::Last).map_err(|refused| self.refusal(refused))?;
            return Err(ExtendRefused::Late { horizon: self.horizon() });
        }
        let lease = self.core_lease(lease).map_err(|limit| ExtendRefused::Early { limit })?;
        self.engine.check_extend(lease).map_err(|refused| self.refusal(refused))
    }

    /// Removes the last `items[m]` items of each motor's queue. The lease stays as it is: [`trim`](Leased::trim) puts its end where the rest ends.
    ///
    /// # Errors
    /// The index of a motor with fewer items; then none is removed.
    pub fn take_back(&mut self, items: &[usize]) -> Result<(), usize> {
        self.engine.take_back(items)
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

/// Counts the steps of all motors, and passes steps and edges to the observer with 64-bit ticks.
struct Watch<'a, O> {
    now: u64,
    motors: &'a mut [NativeMotor],
    observer: &'a mut O,
}

/// Gets the steps and edges of the stepgen while it runs.
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

/// The stepgen of all motors, for any number of fraction bits.
trait Engine: std::fmt::Debug + Send + Sync {
    fn boxed(&self) -> Box<dyn Engine>;
    fn push(&mut self, motor: usize, entry: Entry) -> Result<(), Entry>;
    fn credit(&self, motor: usize) -> usize;
    /// Schedules a switch. A motor without a new limit keeps its own.
    fn switch(
        &mut self,
        epoch: Epoch,
        at: Tick32,
        lease: lease::Lease,
        limits: &[Limit],
    ) -> Result<(), channel::SwitchRefused>;
    fn check_extend(&self, lease: lease::Lease) -> Result<(), lease::ExtendRefused>;
    fn extend(&mut self, lease: lease::Lease, limits: &[Limit]);
    /// Removes so many items from the end of each queue.
    ///
    /// # Errors
    /// The index of a motor with fewer items; then none is removed.
    fn take_back(&mut self, items: &[usize]) -> Result<(), usize>;
    fn lapse_at(&mut self, lapse: Lapse);
    fn lease(&self) -> (lease::Lease, Option<Lapse>);
    fn was_moving(&self) -> bool;
    fn hold(&mut self, ticks: u32);
    fn discard(&mut self, epoch: Epoch);
    fn horizons(&self) -> Box<dyn Iterator<Item = Tick32> + '_>;
    fn run(&mut self, until: Tick32, witness: &mut dyn Witness);
    /// Stops all motors at once. Returns for each whether it had something left to do.
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

/// A motor's queue: like [`pulsetrain_core::Queue`], but on the heap.
#[derive(Clone, Debug)]
struct NativeQueue {
    entries: VecDeque<Entry>,
    /// Most entries that it holds.
    capacity: usize,
}

impl NativeQueue {
    const fn new(capacity: usize) -> NativeQueue {
        NativeQueue { entries: VecDeque::new(), capacity }
    }

    fn push(&mut self, entry: Entry) -> Result<(), Entry> {
        if self.entries.len() == self.capacity {
            return Err(entry);
        }
        self.entries.push_back(entry);
        Ok(())
    }

    fn credit(&self) -> usize {
        self.capacity - self.entries.len()
    }

    fn discard(&mut self, epoch: Epoch) {
        while self.entries.pop_back_if(|entry| entry.epoch == epoch).is_some() {}
    }
}

impl Items for NativeQueue {
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

/// Which motors share a DIR line.
#[derive(Clone, Debug)]
struct Sharing {
    /// For each motor that shares a line: the index of that line, and whether it is high for forward.
    members: Vec<Option<(usize, bool)>>,
    /// For each line: the longest pulse plus the longest DIR setup of its motors, ticks.
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

/// The stepgen with F fraction bits.
#[derive(Clone, Debug)]
struct Axes<const F: u32> {
    motors: Motors<F>,
    merge: Merge<MAX_MOTORS>,
}

/// The motors of a stepgen, and the DIR lines that they share.
#[derive(Clone, Debug)]
struct Motors<const F: u32> {
    axes: Vec<Axis<F, NativeQueue>>,
    sharing: Sharing,
    lines: Vec<SharedLine>,
    /// By motor: edges that were made early, since another motor on the same DIR line needed them, and were not yet given out.
    ready: Vec<VecDeque<pulsetrain_core::output::Edge>>,
}

impl<const F: u32> Axes<F> {
    fn new(outputs: Vec<Output>, most: usize, sharing: Sharing) -> Axes<F> {
        let axes: Vec<_> = outputs.into_iter().map(|output| Axis::new(output, NativeQueue::new(most))).collect();
        let lines = sharing.apart_ticks.iter().copied().map(SharedLine::new).collect();
        let ready = vec![VecDeque::new(); axes.len()];
        Axes { motors: Motors { axes, sharing, lines, ready }, merge: Merge::new() }
    }

    fn axes(&self) -> &[Axis<F, NativeQueue>] {
        &self.motors.axes
    }

    fn channels_mut(&mut self) -> impl Iterator<Item = &mut Channel<F>> {
        self.motors.axes.iter_mut().map(Axis::channel_mut)
    }
}

impl<const F: u32> Motors<F> {
    /// The next edge of a motor, up to tick `until`.
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
        while !self.axes[motor].has_pending_edge() {
            let Some(first) = self.first_on(line, until) else { break };
            if first == motor {
                break;
            }
            let edge = self.next(first, until, witness)?;
            self.ready[first].push_back(edge);
        }
        self.next(motor, until, witness)
    }

    /// After the end of the lease: the motor with the next step on a shared DIR line. If it brakes, its step is put off until the line may change.
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
            if !self.share_lapse() {
                break steps;
            }
        };
        motors.iter().find(|motor| self.axes[**motor].channel().lapse().is_some())?;
        // Planned steps come before all steps of the stop. The planner has kept them apart already.
        let is_planned = |motor: &usize| !self.axes[*motor].channel().is_braking();
        let planned = motors.iter().zip(&steps).map(|(motor, step)| step.filter(|_| is_planned(motor)));
        if let Some(place) = shared_line::first_motor(planned.map(|step| step.map(|(tick, _)| (tick, false)))) {
            return Some(motors[place]);
        }
        let place = shared_line::first_motor(steps.iter().copied())?;
        let first = motors[place];
        let (Some((_, false)), Some((_, forward_high))) = (steps[place], self.sharing.members[first]) else {
            return Some(first);
        };
        let axis = &mut self.axes[first];
        let level = (axis.channel().direction() == Direction::Forward) == forward_high;
        let open = self.lines[line].earliest_step(level, axis.soonest_turn());
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
        self.share_lapse();
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

    /// If one motor has noticed the end of the lease, gives it to all of them. Returns whether one had.
    fn share_lapse(&mut self) -> bool {
        if !self.axes.iter().any(|axis| axis.channel().has_unreported_lapse()) {
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
        if axis.channel().accepts(entry.epoch) { axis.queue_mut().push(entry) } else { Ok(()) }
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
        let stop = |axis: &mut Axis<F, NativeQueue>| {
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

/// The outputs of all motors.
///
/// # Errors
/// When a line or a time is not possible.
fn outputs(config: &Config) -> Result<Vec<Output>, ConfigError> {
    if config.motors.len() > MAX_MOTORS {
        return Err(ConfigError::Motors(config.motors.len()));
    }
    // How many times each line is used as DIR, and as anything else.
    let (mut as_dir, mut otherwise) = ([0; MAX_LINES as usize], [0; MAX_LINES as usize]);
    for MotorConfig { wiring, .. } in &config.motors {
        if let Wiring::StepDir { pulse_ticks: 0, .. } = wiring {
            return Err(ConfigError::Ticks(0));
        }
        let ticks = wiring.longest_ticks();
        if u64::from(ticks) >= LONGEST_RUN_TICKS {
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
