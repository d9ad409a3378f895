//! The judge of boards that compute their own path: do the edges follow StepperWinch's recurrence?
//!
//! # What is here
//! - [`judge`]: lines that were sent, and edges → a [`WinchReport`]
//! - [`Command`]: lines, read
//! - `path`: the recurrence in f64
//! - `effects`: in which millisecond each line came into effect
//!
//! # What is not
//! Anything of a board's own fixed point: lines, path and steps are implemented here a second time.
//!
//! A board obeys a line a few milliseconds after it has arrived, and nothing shows when. The judge finds it out: of all
//! possible milliseconds it takes those that agree best with the steps. The report contains how long this took.

mod command;
mod effects;
mod path;

pub use command::{AXES, Command, Order, WrongLine};

use crate::Edge;
use path::Board;
use schemars::JsonSchema;
use serde::Serialize;

/// 1/64 step beyond the middle between two steps: where a path makes the next one.
const THRESHOLD: f64 = 0.5 + 1.0 / 64.0;

/// Number of faults that are listed. The count includes all.
const LISTED_FAULTS: usize = 8;

/// A line that was sent to the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SentLine {
    /// The earliest tick of the board's clock at which it can have arrived.
    pub tick: u64,
    /// The latest tick at which it can have arrived.
    pub until: u64,
    /// What it says.
    pub command: Command,
}

/// A status line from the board: the positions of its axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    /// Its clock, µs, without the wraps at 32 bits.
    pub usec: u64,
    /// Steps made, of x, y, z and a.
    pub positions: [i32; 4],
}

/// The wiring of a board, its timing, and the bounds.
#[derive(Clone, Debug, PartialEq)]
pub struct WinchOptions {
    /// Ticks per second.
    pub tick_hz: f64,
    /// STEP lines of x, y, z and a; a step is a rising edge.
    pub step: [u8; 4],
    /// DIR lines of x, y, z and a; high is forward.
    pub dir: [u8; 4],
    /// The drivers' common enable line; low is on. Before its first edge they are off.
    pub enable: u8,
    /// Constant delay from the path's time of a step to its edge, ticks.
    pub constant_ticks: f64,
    /// Largest deviation from this delay, earlier or later, ticks.
    pub late_ticks: f64,
    /// Largest distance of a step from the path, steps, in addition to that of its deviation in time.
    pub bound_steps: f64,
    /// Longest time from the arrival of a line to its effect, ms.
    pub effect_ms: u64,
    /// Longest time for the drivers to go on or off, ms. Off is due when all axes have stopped.
    pub release_ms: u64,
    /// The zero of the report's times, and of the onlooker's, s of the board's clock.
    pub origin_s: f64,
    /// Shortest pulse, and shortest time from DIR to STEP, ticks.
    pub shortest_ticks: u64,
}

impl Default for WinchOptions {
    /// An Uno with a CNC shield: edges to the tick, within 0.1 step, as docs/winch.md has it; times of an A4988, 1 µs.
    fn default() -> WinchOptions {
        WinchOptions {
            tick_hz: 16e6,
            step: [2, 3, 4, 12],
            dir: [5, 6, 7, 13],
            enable: 8,
            constant_ticks: 0.0,
            late_ticks: 1.0,
            bound_steps: 0.1,
            effect_ms: 6,
            release_ms: 30,
            origin_s: 0.0,
            shortest_ticks: 16,
        }
    }
}

impl WinchOptions {
    /// A Pico with drivers on the pins of docs/wiring.md: edges to the tick, the same times of a driver.
    #[must_use]
    pub fn pico() -> WinchOptions {
        WinchOptions {
            tick_hz: 125e6,
            step: [2, 4, 6, 8],
            dir: [3, 5, 7, 9],
            enable: 22,
            shortest_ticks: 125,
            ..WinchOptions::default()
        }
    }
}

/// The verdict on a run.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct WinchReport {
    /// Whether every bound was kept.
    pub ok: bool,
    /// The reports of x, y, z and a.
    pub axes: [AxisReport; 4],
    /// Number of status lines that were compared with the pulses.
    pub statuses: usize,
    /// Shortest and longest time from a line's coming to the millisecond in which it moved an axis, ms; `None` without lines
    /// for axes. Where a line makes no difference at first, the shortest that agrees.
    pub effect_ms: Option<(f64, f64)>,
    /// The first faults.
    pub faults: Vec<WinchFault>,
    /// The number of all faults.
    pub fault_count: usize,
}

/// What the trace shows of one axis.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct AxisReport {
    /// x, y, z or a.
    pub axis: String,
    /// Steps in the trace.
    pub steps: u64,
    /// Steps forward minus steps backward, before the end of the last whole millisecond.
    pub position: i64,
    /// Position of the path at that time, steps.
    pub position_wanted: f64,
    /// Largest distance of a step from the path, steps.
    pub max_error_steps: f64,
    /// Its time, s from the origin.
    pub max_error_at_s: f64,
    /// Root of the mean square, steps.
    pub rms_error_steps: f64,
    /// Largest uncertainty of the path itself, steps. With gains at the edge of their range, and at the limits, a
    /// board's rounding errors grow.
    pub max_doubt_steps: f64,
    /// Shortest time between two steps, µs.
    pub shortest_interval_us: Option<f64>,
    /// Shortest pulse, µs.
    pub shortest_pulse_us: Option<f64>,
    /// Shortest time from a change of DIR to the next step, µs.
    pub shortest_setup_us: Option<f64>,
}

/// A bound that broke.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct WinchFault {
    /// x, y, z or a.
    pub axis: char,
    /// The time, s from the origin.
    pub at_s: f64,
    /// The fault.
    pub what: String,
}

/// Watches while a run is judged, to draw pictures. Times are s from the origin, positions steps.
pub trait Onlooker {
    /// The path of an axis at the beginning of a millisecond, and its speed in it, steps/s.
    fn path(&mut self, axis: usize, at_s: f64, position: f64, speed: f64);

    /// A step to `position`, this many steps behind the path, or ahead of it (negative).
    fn step(&mut self, axis: usize, at_s: f64, position: i64, behind: f64);
}

/// Watches nothing.
impl Onlooker for () {
    fn path(&mut self, _: usize, _: f64, _: f64, _: f64) {}
    fn step(&mut self, _: usize, _: f64, _: i64, _: f64) {}
}

/// A step in the trace.
#[derive(Clone, Copy, Debug)]
struct AxisStep {
    /// The time at which the path was to make it, ms: the edge without the board's constant delay.
    ms: f64,
    /// The position after it.
    position: i64,
    forward: bool,
}

impl AxisStep {
    /// The position of the path at which it makes this step.
    fn wanted_at(self) -> f64 {
        self.position as f64 + if self.forward { THRESHOLD - 1.0 } else { 1.0 - THRESHOLD }
    }

    /// How far the path of an axis is beyond that position, in the direction of the step.
    fn behind(self, board: &Board, axis: usize, begin_ms: u64) -> f64 {
        let position = board.paths[axis].position + board.speed(axis) * 1e-3 * (self.ms - begin_ms as f64);
        let beyond = position - self.wanted_at();
        if self.forward { beyond } else { -beyond }
    }

    /// Passes the step to the path of its axis, which may use it.
    fn show(self, board: &mut Board, axis: usize, begin_ms: u64, options: &WinchOptions) {
        /// Largest distance of a board's step from its own path, in addition to that of its deviation in time, steps.
        const NEAR: f64 = 0.01;
        let (behind, speed) = (self.behind(board, axis, begin_ms), board.speed(axis));
        let within = NEAR + speed.abs() * options.late_ticks / options.tick_hz;
        let behind = if self.forward { behind } else { -behind };
        board.paths[axis].see(behind, (self.ms - begin_ms as f64) * 1e-3, within);
    }
}

/// Judges a run from tick 0 of the board's clock, when the board stands at 0, to the beginning of the millisecond of
/// `end`.
///
/// `sent` and `edges` are in order of time; lines of `edges` are the board's pins.
///
/// # Errors
/// If edges are not in order of time.
pub fn judge(
    sent: &[SentLine],
    edges: &[Edge],
    statuses: &[Status],
    end: u64,
    options: &WinchOptions,
    onlooker: &mut impl Onlooker,
) -> Result<WinchReport, OutOfOrder> {
    let mut seen = see(edges, options)?;
    let ms_end = (end as f64 / options.tick_hz * 1e3) as u64;
    let sent = &with_deadman(sent, end, options);
    let effects = effects::find(sent, &seen, ms_end, options);
    follow(sent, &effects, &mut seen, ms_end, options, onlooker);
    seen.compare(statuses, options);
    let tick_ms = 1e3 / options.tick_hz;
    let is_for_axes = |command: &Command| {
        *command != Command::HALT && (command.enables || command.orders.iter().any(Option::is_some))
    };
    let took = sent.iter().zip(&effects).filter(|(sent, _)| is_for_axes(&sent.command));
    let took = took.map(|(sent, effect)| *effect as f64 - sent.until as f64 * tick_ms);
    let effect_ms = took.fold(None, |span: Option<(f64, f64)>, ms| {
        Some(span.map_or((ms, ms), |(low, high)| (low.min(ms), high.max(ms))))
    });
    let Seen { axes, faults, fault_count, .. } = seen;
    Ok(WinchReport { ok: fault_count == 0, axes, statuses: statuses.len(), effect_ms, faults, fault_count })
}

/// The paths alone, if each line takes effect in the first millisecond after it can have arrived.
///
/// This is for boards whose pins nothing records. In a move the paths may be a few milliseconds off. The result tells
/// for each axis whether it comes to rest at this place in any case. That is not so after a drift, or a stop in the
/// middle of a move, until there is an absolute target again.
pub fn predict(sent: &[SentLine], end: u64, options: &WinchOptions, onlooker: &mut impl Onlooker) -> [bool; 4] {
    let ms = |tick: u64| (tick as f64 / options.tick_hz * 1e3).ceil() as u64;
    let sent = with_deadman(sent, end, options);
    let mut lines = sent.iter().peekable();
    let mut board = Board::START;
    for now in 0..ms(end) {
        while let Some(sent) = lines.next_if(|sent| ms(sent.until) <= now) {
            board.obey(&sent.command);
        }
        for (axis, path) in board.paths.iter().enumerate() {
            onlooker.path(axis, now as f64 * 1e-3 - options.origin_s, path.position, board.speed(axis));
        }
        board.tick();
    }
    board.paths.map(|path| !path.depends_on_time)
}

/// A deadman triggers when its time is over, or at most this much later, ms, because a board checks it only now and
/// then.
const DEADMAN_LATE_MS: u64 = 6;

/// Adds the effects of deadmen to the lines: after the silence that a line has set, unless the next line comes earlier.
fn with_deadman(sent: &[SentLine], end: u64, options: &WinchOptions) -> Vec<SentLine> {
    let ticks = |ms: u64| (ms as f64 * 1e-3 * options.tick_hz) as u64;
    let mut all = Vec::with_capacity(sent.len());
    let mut deadman_ms = 0;
    for (at, line) in sent.iter().enumerate() {
        all.push(*line);
        deadman_ms = line.command.deadman_ms.map_or(deadman_ms, u64::from);
        if deadman_ms == 0 {
            continue;
        }
        let (tick, until) = (line.tick + ticks(deadman_ms), line.until + ticks(deadman_ms + DEADMAN_LATE_MS));
        if sent.get(at + 1).map_or(end, |next| next.tick) > tick {
            all.push(SentLine { tick, until, command: Command::HALT });
        }
    }
    all
}

/// An edge is earlier than the one before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("edge {edge} is at tick {tick}, before the one before it")]
pub struct OutOfOrder {
    /// The index of the edge, from 0.
    pub edge: usize,
    /// Its tick.
    pub tick: u64,
}

/// What the trace has shown so far.
struct Seen {
    /// The ticks at which the drivers went on or off.
    drives: Vec<(u64, bool)>,
    steps: [Vec<AxisStep>; 4],
    /// The ticks of the steps' edges.
    ticks: [Vec<u64>; 4],
    axes: [AxisReport; 4],
    faults: Vec<WinchFault>,
    fault_count: usize,
}

impl Seen {
    fn fault(&mut self, axis: usize, at_s: f64, what: impl FnOnce() -> String) {
        if self.faults.len() < LISTED_FAULTS {
            self.faults.push(WinchFault { axis: AXES[axis], at_s, what: what() });
        }
        self.fault_count += 1;
    }

    /// Each status says what the pins have done.
    fn compare(&mut self, statuses: &[Status], options: &WinchOptions) {
        /// How far the reading of the clock and of the positions may be apart, µs.
        const APART: u64 = 30;
        let ticks_per_us = options.tick_hz / 1e6;
        for status in statuses {
            let at = |usec: u64| (usec as f64 * ticks_per_us) as u64;
            for (axis, reported) in status.positions.into_iter().enumerate() {
                let ticks = &self.ticks[axis];
                let first = ticks.partition_point(|tick| *tick <= at(status.usec.saturating_sub(APART)));
                let last = ticks.partition_point(|tick| *tick <= at(status.usec + APART));
                let made = |count: usize| if count == 0 { 0 } else { self.steps[axis][count - 1].position };
                // Positions are 32 bits that wrap.
                let agrees = (first..=last).any(|count| made(count) as i32 == reported);
                if !agrees {
                    let (made, at_s) = (made(last), status.usec as f64 * 1e-6 - options.origin_s);
                    self.fault(axis, at_s, || format!("it says position {reported}, but its pulses make {made}"));
                }
            }
        }
    }
}

/// Edges to steps, and what a driver needs of them.
fn see(edges: &[Edge], options: &WinchOptions) -> Result<Seen, OutOfOrder> {
    let name = |axis: usize| AxisReport { axis: AXES[axis].to_string(), ..AxisReport::default() };
    let mut seen = Seen {
        drives: Vec::new(),
        steps: [const { Vec::new() }; 4],
        ticks: [const { Vec::new() }; 4],
        axes: std::array::from_fn(name),
        faults: Vec::new(),
        fault_count: 0,
    };
    let tick_us = 1e6 / options.tick_hz;
    let (mut forward, mut turned, mut risen) = ([false; 4], [None; 4], [None; 4]);
    let mut undriven = [false; 4];
    let mut last = 0;
    let shorten = |shortest: &mut Option<f64>, us: f64| *shortest = Some(shortest.map_or(us, |old| old.min(us)));
    for (edge, &Edge { tick, line, level }) in edges.iter().enumerate() {
        if tick < last {
            return Err(OutOfOrder { edge, tick });
        }
        last = tick;
        let at_s = tick as f64 / options.tick_hz - options.origin_s;
        if let Some(axis) = options.dir.iter().position(|dir| *dir == line) {
            if risen[axis].is_some() {
                seen.fault(axis, at_s, || "DIR changes while STEP is high".to_owned());
            }
            (forward[axis], turned[axis]) = (level, Some(tick));
        }
        if line == options.enable && seen.drives.last().is_none_or(|(_, on)| *on == level) {
            seen.drives.push((tick, !level));
        }
        let Some(axis) = options.step.iter().position(|step| *step == line) else { continue };
        if !level {
            let Some(risen) = risen[axis].take() else { continue };
            let pulse: u64 = tick - risen;
            shorten(&mut seen.axes[axis].shortest_pulse_us, pulse as f64 * tick_us);
            if pulse < options.shortest_ticks {
                seen.fault(axis, at_s, || format!("a pulse of {pulse} ticks"));
            }
            continue;
        }
        risen[axis] = Some(tick);
        // A row of such steps is one fault.
        let is_driven = seen.drives.last().is_some_and(|(_, on)| *on);
        if !is_driven && !std::mem::replace(&mut undriven[axis], true) {
            seen.fault(axis, at_s, || "a step while the drivers are off (ENABLE is high)".to_owned());
        }
        undriven[axis] &= !is_driven;
        if let Some(turned) = turned[axis].take() {
            let setup: u64 = tick - turned;
            shorten(&mut seen.axes[axis].shortest_setup_us, setup as f64 * tick_us);
            if setup < options.shortest_ticks {
                seen.fault(axis, at_s, || format!("DIR changes {setup} ticks before a step"));
            }
        }
        if let Some(before) = seen.ticks[axis].last() {
            shorten(&mut seen.axes[axis].shortest_interval_us, (tick - before) as f64 * tick_us);
        }
        let forward = forward[axis];
        let report = &mut seen.axes[axis];
        report.position += if forward { 1 } else { -1 };
        report.steps += 1;
        let ms = (tick as f64 - options.constant_ticks) / options.tick_hz * 1e3;
        seen.steps[axis].push(AxisStep { ms, position: report.position, forward });
        seen.ticks[axis].push(tick);
    }
    Ok(seen)
}

/// The edges of ENABLE, gone along.
struct Drivers<'a> {
    edges: &'a [(u64, bool)],
    are_on: bool,
}

impl<'a> Drivers<'a> {
    fn new(edges: &'a [(u64, bool)]) -> Drivers<'a> {
        Drivers { edges, are_on: false }
    }

    /// Whether they are on at the end of the next millisecond.
    fn at_end_of(&mut self, ms: u64, options: &WinchOptions) -> bool {
        let end = ((ms + 1) as f64 * 1e-3 * options.tick_hz) as u64;
        while let Some(((tick, on), later)) = self.edges.split_first()
            && *tick <= end
        {
            (self.are_on, self.edges) = (*on, later);
        }
        self.are_on
    }
}

/// Milliseconds since the drivers were as they are to be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
struct Differing(u64);

impl Differing {
    /// Goes on by a millisecond; whether they have differed for too long now: that is true once.
    fn go_on(&mut self, differ: bool, options: &WinchOptions) -> bool {
        self.0 = if differ { self.0 + 1 } else { 0 };
        self.0 == options.release_ms
    }
}

/// Goes along the paths, with each line in its millisecond, and looks at every step.
fn follow(
    sent: &[SentLine],
    effects: &[u64],
    seen: &mut Seen,
    ms_end: u64,
    options: &WinchOptions,
    onlooker: &mut impl Onlooker,
) {
    let mut board = Board::START;
    let mut lines = sent.iter().zip(effects).peekable();
    let mut next = [0; 4];
    let mut squares = [0.0; 4];
    // Said once for each time that an axis is lost.
    let mut lost = [false; 4];
    let late_ms = options.late_ticks / options.tick_hz * 1e3;
    let drives = std::mem::take(&mut seen.drives);
    let (mut drivers, mut differing) = (Drivers::new(&drives), Differing::default());
    for ms in 0..ms_end {
        while let Some((sent, _)) = lines.next_if(|(_, effect)| **effect <= ms) {
            board.obey(&sent.command);
        }
        let (mut positions, mut allowed) = ([0; 4], [0.0; 4]);
        for axis in 0..4 {
            let speed = board.speed(axis);
            let at_s = ms as f64 * 1e-3 - options.origin_s;
            onlooker.path(axis, at_s, board.paths[axis].position, speed);
            let doubt = board.paths[axis].doubt.steps();
            let report = &mut seen.axes[axis];
            report.max_doubt_steps = report.max_doubt_steps.max(doubt);
            allowed[axis] = options.bound_steps + speed.abs() * 1e-3 * late_ms + doubt;
            let allowed = allowed[axis];
            let mut position = seen.steps[axis][..next[axis]].last().map_or(0, |step| step.position);
            while let Some(step) = seen.steps[axis].get(next[axis]).copied()
                && step.ms < (ms + 1) as f64
            {
                next[axis] += 1;
                position = step.position;
                let (behind, at_s) = (step.behind(&board, axis, ms), step.ms * 1e-3 - options.origin_s);
                step.show(&mut board, axis, ms, options);
                onlooker.step(axis, at_s, position, behind);
                squares[axis] += behind * behind;
                let report = &mut seen.axes[axis];
                if behind.abs() > report.max_error_steps {
                    (report.max_error_steps, report.max_error_at_s) = (behind.abs(), at_s);
                }
                if behind.abs() > allowed {
                    seen.fault(axis, at_s, || {
                        let side = if behind > 0.0 { "behind" } else { "before" };
                        format!(
                            "the step to {position} is {:.3} step {side} the path, {allowed:.3} allowed",
                            behind.abs()
                        )
                    });
                }
            }
            positions[axis] = position;
        }
        board.tick();
        if differing.go_on(drivers.at_end_of(ms, options) != board.drives, options) {
            let level = if board.drives { "off (ENABLE is high)" } else { "on (ENABLE is low)" };
            let at_s = (ms + 1) as f64 * 1e-3 - options.origin_s;
            seen.fault(0, at_s, || format!("all drivers are still {level}"));
        }
        for (axis, position) in positions.into_iter().enumerate() {
            let wanted = board.paths[axis].position;
            let beyond = (wanted - position as f64).abs() - THRESHOLD;
            // A step at the end of a millisecond may be seen in the next.
            if beyond <= allowed[axis] {
                lost[axis] = false;
            } else if !std::mem::replace(&mut lost[axis], true) {
                let at_s = (ms + 1) as f64 * 1e-3 - options.origin_s;
                seen.fault(axis, at_s, || format!("it is at {position}, the path at {wanted:.2}"));
            }
        }
    }
    for (axis, path) in board.paths.iter().enumerate() {
        let report = &mut seen.axes[axis];
        report.position = seen.steps[axis][..next[axis]].last().map_or(0, |step| step.position);
        report.position_wanted = path.position;
        report.rms_error_steps = (squares[axis] / (report.steps as f64).max(1.0)).sqrt();
    }
}
