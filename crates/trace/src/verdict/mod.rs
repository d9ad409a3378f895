//! The judge: compares edges, steps or a film with the law.
//!
//! ```
//! # use pulsetrain_motion::{Grid, Law, Time, boards::UNO, law::Sine, program::*};
//! # use pulsetrain_trace::{steps::{Step, StepTrace}, verdict::{self, Options}};
//! # let board = BoardLimits { min_interval_ticks: vec![640], hardware_timed: true, one_timing: false, turn_ticks: 0, ..UNO.limits() };
//! # let motor = Motor { name: "wheel".into(),
//! #     law: Law::Sine(Sine { amplitude: 1.0, period: Time::SECOND, cycles: Some(1) }),
//! #     wiring: Wiring::StepDir { step: 8, dir: 9, forward_high: false, enable: None },
//! #     timing: DriverTiming::default(), limits: Limits::default(),
//! #     scale: Scale { unit: "rev".into(), steps_per_unit: 200.0, steps_per_rev: 200.0 }, winding: None, driver: None };
//! # let program = Program { board, grid: Grid::REACH, tolerance: Tolerance::Ticks(1.0), idle_ms: None, motors: vec![motor], machines: Vec::new(), queue_parts: Vec::new() };
//! // θ = 1 − cos(2πt/1 s): steps at ¼ and ½ s, and back.
//! let step = |tick, forward| Step { motor: 0, tick, forward };
//! let steps = vec![step(4_000_000, true), step(8_000_000, true), step(12_000_002, false), step(16_000_000, false)];
//! let trace = StepTrace { tick_hz: 16_000_000, motors: vec!["wheel".into()], steps };
//! let report = verdict::judge_steps(&trace, &program, &Options::default())?;
//! assert!(!report.ok);
//! assert_eq!(
//!     report.failures[0].to_string(),
//!     "motor wheel: step 3 is 2.00 ticks late, limit 1.00, at t = 0.750000 s"
//! );
//! # Ok::<(), verdict::JudgeError>(())
//! ```

mod align;
mod film;
mod matcher;
mod matches;
mod report;
#[cfg(test)]
mod tests;

use pulsetrain_motion::program::{Motor, Program};
use pulsetrain_motion::{LawError, Time};

pub use film::{FilmPoint, FilmReport, Jump, judge_film};
pub use report::{Alignment, Failure, Fault, Measured, MotorReport, Report};

use crate::crossing::{Crossings, Instant};
use crate::decode::{Backwards, Decoder, Event};
use crate::lines::NoSuchLine;
use crate::steps::StepTrace;
use crate::{Edge, Line, Trace};
use matcher::{Limits, Matcher, Timebase};

/// Largest deviation of a clock, ppm: twice the ±0.5 % of an Uno's ceramic resonator. A trace that needs more to fit
/// shows another motion.
pub const MOST_PPM: f64 = 10_000.0;

/// Failures that are listed for each motor. The counts include all failures.
pub const MOST_FAULTS: usize = 100;

/// How a trace is aligned with the law.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Align {
    /// The trace's tick 0 is the law's time zero.
    #[default]
    None,
    /// The trace is shifted so that 0 is in the middle of the errors. This is for captures that begin at any time
    /// before the first step. The bound is widened by the uncertainty of the fit (8/√n of the errors' root mean
    /// square).
    Start,
    /// The trace is also scaled, by least squares, because the analyser has a clock of its own. More than [`MOST_PPM`]
    /// is a fault.
    StartAndRate,
}

/// How to judge.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Options {
    /// How the trace is aligned with the law.
    pub align: Align,
    /// Bound on |error|, ticks of the board, instead of the program's tolerance.
    pub bound_ticks: Option<f64>,
    /// The board's constant: edge tick − scheduled tick, ticks of the board.
    pub constant_ticks: i64,
    /// Law time up to which to judge, s. Without it: to the end of the law, or to the end of the trace if the law is
    /// endless.
    pub until_s: Option<f64>,
    /// Sample rate of the analyser, Hz, if it is lower than the tick rate of the trace. A step may appear one sample
    /// late.
    pub sample_hz: Option<f64>,
}

/// Why there is no verdict.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum JudgeError {
    /// The trace lacks a line.
    #[error(transparent)]
    Line(#[from] NoSuchLine),
    /// The trace is not in order of time.
    #[error(transparent)]
    Backwards(#[from] Backwards),
    /// The trace has no tick rate.
    #[error("the trace's tick rate is 0 Hz")]
    NoTickRate,
    /// The trace names a motor that the program does not have.
    #[error("the trace has steps of a motor {0}, the motion file has not")]
    NoSuchMotor(String),
    /// The motion file has several motors, but a film shows one.
    #[error("a film shows one motor; say which of {0}")]
    WhichMotor(String),
    /// The film is too short.
    #[error("{frames} frames of the motion cannot be judged; at least {limit} are needed")]
    TooFewFrames {
        /// The number of frames.
        frames: usize,
        /// The smallest number allowed.
        limit: usize,
    },
    /// The film shows the wheel too seldom.
    #[error(
        "frames are too far apart: at {at_s:.3} s the motion makes {turned:.2} turns from one frame to the next \
         ({frames_hz:.0} frames a second), and a film cannot tell a turn from none; film at {needed_hz:.0} frames a second or more, \
         or a slower motion"
    )]
    TooFast {
        /// Law time, s.
        at_s: f64,
        /// Turns from one frame to the next.
        turned: f64,
        /// Frames a second there.
        frames_hz: f64,
        /// Frames a second that would do.
        needed_hz: f64,
    },
    /// The angles are too uncertain.
    #[error(
        "the film cannot tell: the angle is uncertain by up to {uncertain_deg:.2}° (3 σ) in {frames} of {of} frames, and the limit \
         is {limit_deg:.2}°; film from nearer, with more light and a shorter exposure, or judge with a larger --limit"
    )]
    Uncertain {
        /// Three standard deviations of the worst frame, degrees.
        uncertain_deg: f64,
        /// The number of such frames.
        frames: u64,
        /// Of how many.
        of: u64,
        /// The limit, degrees.
        limit_deg: f64,
    },
    /// Nothing moves.
    #[error(
        "the film shows no motion that fits the law: the wheel turns by {seen_deg:.2}°; was it filmed while the motion ran?"
    )]
    NoMotion {
        /// How far the wheel turns in the film, degrees.
        seen_deg: f64,
    },
    /// The law breaks.
    #[error("motor {motor}: {error}")]
    Law {
        /// The motor.
        motor: String,
        /// The error of its law.
        error: LawError,
    },
}

/// Judges a trace of edges.
///
/// # Errors
/// If the trace lacks a line or is not in order, or a law breaks. Errors of the motion are in the report.
pub fn judge(trace: &Trace, program: &Program, options: &Options) -> Result<Report, JudgeError> {
    align::judge(trace.tick_hz, program, options, &mut |judge, until_tick| {
        let mut decoder = Decoder::new(&trace.lines, program)?;
        for edge in trace.edges.iter().take_while(|edge| until_tick.is_none_or(|until| edge.tick <= until)) {
            decoder.push(*edge, &mut |motor, tick, event| judge.event(motor, tick, event))?;
        }
        decoder.flush(&mut |motor, tick, event| judge.event(motor, tick, event));
        Ok(())
    })
}

/// Judges a trace of steps. Unlike [`judge`] it cannot check what only edges show: pulses, DIR setup and hold.
///
/// # Errors
/// If the trace names an unknown motor, or a law breaks.
pub fn judge_steps(trace: &StepTrace, program: &Program, options: &Options) -> Result<Report, JudgeError> {
    let mut motors = Vec::new();
    for name in &trace.motors {
        let known = program.motors.iter().position(|motor| motor.name == *name);
        motors.push(known.ok_or_else(|| JudgeError::NoSuchMotor(name.clone()))?);
    }
    align::judge(trace.tick_hz, program, options, &mut |judge, until_tick| {
        let mut last = vec![0; motors.len()];
        for step in &trace.steps {
            let index = usize::from(step.motor);
            let Some(&motor) = motors.get(index) else { return Err(JudgeError::NoSuchMotor(step.motor.to_string())) };
            if step.tick < last[index] {
                return Err(Backwards { tick: step.tick, after: last[index] }.into());
            }
            last[index] = step.tick;
            if until_tick.is_none_or(|until| step.tick <= until) {
                // Steps do not show when a shared DIR line changed: it may have changed just before.
                judge.event(motor, step.tick, Event::Step { forward: step.forward, since_dir: Some(0) });
            }
        }
        Ok(())
    })
}

/// Judges edges as they come, in constant memory; without alignment.
///
/// For a complete trace use [`judge`].
pub struct EdgeJudge<'a> {
    decoder: Decoder,
    judge: Judge<'a>,
}

impl<'a> EdgeJudge<'a> {
    /// A judge for edges of these lines, in ticks of `tick_hz`. It ignores `options.align`.
    ///
    /// # Errors
    /// If a line is missing or the tick rate is 0.
    pub fn new(tick_hz: u64, lines: &[Line], program: &'a Program, options: &Options) -> Result<Self, JudgeError> {
        let decoder = Decoder::new(lines, program)?;
        let timebase = align::given(tick_hz, program, options);
        Ok(EdgeJudge { decoder, judge: Judge::new(tick_hz, program, options, timebase)? })
    }

    /// Adds an edge. Edges must come in order of time.
    ///
    /// # Errors
    /// If the edge is earlier than the last one.
    pub fn push(&mut self, edge: Edge) -> Result<(), Backwards> {
        let judge = &mut self.judge;
        self.decoder.push(edge, &mut |motor, tick, event| judge.event(motor, tick, event))
    }

    /// Judges only up to `until_s`, s of the law, as [`Options::until_s`] does. No edge after it may have been added.
    pub fn end_at(&mut self, until_s: f64) {
        self.judge.until = Some(instant(until_s, self.judge.tick_hz));
    }

    /// Whether any bound broke among the steps judged so far.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        self.judge.motors.iter().any(|matcher| !matcher.faults.is_empty())
    }

    /// Keeps the error of every step from now on, for [`EdgeJudge::errors`].
    #[must_use]
    pub fn keeping_errors(mut self) -> Self {
        self.judge.motors.iter_mut().for_each(|matcher| matcher.recent = Some(Vec::new()));
        self
    }

    /// Passes on the errors that were kept since the last call: motor, tick, lateness in ticks of the board.
    pub fn errors(&mut self, sink: &mut dyn FnMut(usize, u64, f64)) {
        self.judge.errors(sink);
    }

    /// The verdict.
    ///
    /// # Errors
    /// If a law breaks.
    pub fn finish(self) -> Result<Report, JudgeError> {
        self.finish_with(&mut |_, _, _| {})
    }

    /// The verdict. The errors of the last steps go to `sink`, as with [`EdgeJudge::errors`].
    ///
    /// # Errors
    /// If a law breaks.
    pub fn finish_with(mut self, sink: &mut dyn FnMut(usize, u64, f64)) -> Result<Report, JudgeError> {
        let judge = &mut self.judge;
        self.decoder.flush(&mut |motor, tick, event| judge.event(motor, tick, event));
        self.judge.finish(sink)
    }
}

/// Judges all motors of a program.
pub(crate) struct Judge<'a> {
    program: &'a Program,
    tick_hz: u64,
    timebase: Timebase,
    until: Option<Instant>,
    /// Largest error of the trace's times, ticks, if they come from another clock than the board's.
    spare_ticks: u64,
    last_tick: u64,
    /// The last step of each motor.
    last_steps: Vec<Option<u64>>,
    motors: Vec<Matcher>,
}

impl<'a> Judge<'a> {
    fn new(tick_hz: u64, program: &'a Program, options: &Options, timebase: Timebase) -> Result<Self, JudgeError> {
        if tick_hz == 0 {
            return Err(JudgeError::NoTickRate);
        }
        let board_hz = program.board.tick_hz;
        let scale = board_hz as f64 / tick_hz as f64;
        let bound = options.bound_ticks.unwrap_or_else(|| program.tolerance.ticks(board_hz)) / scale;
        // Times from another clock are uncertain by one of its ticks, or by one sample.
        let own_clock = u64::from(board_hz != tick_hz || options.align == Align::StartAndRate);
        let sample_ticks = options.sample_hz.map_or(0, |sample_hz| (tick_hz as f64 / sample_hz).ceil() as u64);
        let spare_ticks = own_clock.max(sample_ticks);
        let bound = bound + spare_ticks as f64;
        // The board's own time for a change of DIR, in addition to the drivers' times.
        let turn = (f64::from(program.board.turn_ticks) / scale).ceil() as u64;
        // How long a step waits for steps of other motors, where the board makes one after the other.
        let apart = program.board.shared_steps.map(|steps| (f64::from(steps.apart_ticks) / scale).ceil());
        let motors = program.motors.iter().map(|motor| {
            let own = program.timing(motor).ticks(tick_hz).reversal() + turn;
            let sharing: Vec<u64> = program
                .motors
                .iter()
                .filter(|other| other.shares_dir_with(motor) || (apart.is_some() && !std::ptr::eq(*other, motor)))
                .map(|other| program.timing(other).ticks(tick_hz).reversal() + turn)
                .collect();
            let reversal = sharing.iter().copied().max().unwrap_or(0).max(own) as f64;
            let put_off = sharing.len() as f64 * (reversal + apart.unwrap_or(0.0));
            let limits = Limits {
                bound,
                put_off,
                pair: (own as f64).max(shortest_interval(program, motor) / scale),
                after_turn: if sharing.is_empty() { 0 } else { (put_off + reversal + bound) as u64 },
                after_step: apart.map(|apart| (apart + reversal + 2.0 * bound) as u64),
                scale,
                tick_hz: tick_hz as f64,
            };
            Matcher::new(&motor.name, Crossings::new(&motor.law, program.grid, tick_hz), limits, timebase)
        });
        let motors: Vec<Matcher> = motors.collect();
        let last_steps = vec![None; motors.len()];
        let until = options.until_s.map(|until_s| instant(until_s, tick_hz));
        Ok(Judge { program, tick_hz, timebase, until, spare_ticks, last_tick: 0, last_steps, motors })
    }

    pub(crate) fn event(&mut self, motor: usize, tick: u64, event: Event) {
        if self.until.is_some_and(|until| self.timebase.law(tick).minus(until) > 0.0) {
            return;
        }
        self.last_tick = self.last_tick.max(tick);
        match event {
            Event::Step { forward, since_dir } => {
                self.last_steps[motor] = Some(tick);
                let others = self.last_steps.iter().enumerate().filter(|(other, _)| *other != motor);
                // Edges of different motors may be out of order.
                let since_other = others.filter_map(|(_, last)| tick.checked_sub((*last)?)).min();
                self.motors[motor].push(tick, forward, since_dir, since_other);
            }
            Event::CoilJump { from, to } => {
                let at = self.timebase.law(tick).ticks();
                self.motors[motor].fault(at, Fault::CoilJump { from, to });
            }
            Event::High(ticks) => self.timing(motor, tick, ticks, Timing::High),
            Event::Low(ticks) => self.timing(motor, tick, ticks, Timing::Low),
            Event::Setup(ticks) => self.timing(motor, tick, ticks, Timing::Setup),
            Event::Hold(ticks) => self.timing(motor, tick, ticks, Timing::Hold),
        }
    }

    fn timing(&mut self, motor: usize, tick: u64, ticks: u64, timing: Timing) {
        let needs = &self.program.motors[motor].timing;
        let matcher = &mut self.motors[motor];
        let report = &mut matcher.report;
        let (shortest, needed_ns) = match timing {
            Timing::High => (&mut report.pulse_high, needs.pulse_high_ns),
            Timing::Low => (&mut report.pulse_low, needs.pulse_low_ns),
            Timing::Setup => (&mut report.dir_setup, needs.dir_setup_ns),
            Timing::Hold => (&mut report.dir_hold, needs.dir_hold_ns),
        };
        let seen_ns = ticks as f64 * 1e9 / self.tick_hz as f64;
        if shortest.is_none_or(|s| seen_ns < s.seen_ns) {
            *shortest = Some(Measured { seen_ns, needed_ns, at_s: tick as f64 / self.tick_hz as f64 });
        }
        if u128::from(ticks + self.spare_ticks) * 1_000_000_000 < u128::from(needed_ns) * u128::from(self.tick_hz) {
            let fault = match timing {
                Timing::High => Fault::PulseHigh { seen_ns, needed_ns },
                Timing::Low => Fault::PulseLow { seen_ns, needed_ns },
                Timing::Setup => Fault::DirSetup { seen_ns, needed_ns },
                Timing::Hold => Fault::DirHold { seen_ns, needed_ns },
            };
            matcher.fault(self.timebase.law(tick).ticks(), fault);
        }
    }

    fn errors(&mut self, sink: &mut dyn FnMut(usize, u64, f64)) {
        for (motor, matcher) in self.motors.iter_mut().enumerate() {
            for (tick, late) in matcher.recent.iter_mut().flat_map(|recent| recent.drain(..)) {
                sink(motor, tick, late);
            }
        }
    }

    /// Decides about all remaining steps, after the last event.
    fn finish(mut self, sink: &mut dyn FnMut(usize, u64, f64)) -> Result<Report, JudgeError> {
        let hz = self.tick_hz as f64;
        let mut failures = Vec::new();
        for (matcher, motor) in self.motors.iter_mut().zip(&self.program.motors) {
            let last = || self.timebase.law(self.last_tick);
            let until = self.until.or_else(|| motor.law.end().is_none().then(last));
            matcher.finish(until).map_err(|error| JudgeError::Law { motor: motor.name.clone(), error })?;
            if let Some(fault) = Fault::of_clock(self.timebase.rate) {
                matcher.fault(last().ticks(), fault);
            }
            failures.extend(matcher.faults.drain(..).map(|(step, at_s, fault)| Failure {
                motor: motor.name.clone(),
                step,
                at_s,
                fault,
            }));
        }
        self.errors(sink);
        Ok(Report {
            ok: failures.is_empty(),
            tick_hz: self.program.board.tick_hz,
            alignment: Alignment { shift_s: self.timebase.start.ticks() / hz, rate_ppm: self.timebase.rate * 1e6 },
            motors: self.motors.into_iter().map(|matcher| matcher.report).collect(),
            failures,
        })
    }
}

fn instant(at_s: f64, tick_hz: u64) -> Instant {
    let (tick, fraction) = Time::from_seconds(at_s).ticks(tick_hz);
    Instant { tick, fraction }
}

#[derive(Clone, Copy)]
enum Timing {
    High,
    Low,
    Setup,
    Hold,
}

/// Shortest interval that board, driver and motor allow, ticks of the board.
fn shortest_interval(program: &Program, motor: &Motor) -> f64 {
    let hz = program.board.tick_hz as f64;
    let board = &program.board.min_interval_ticks;
    let board = board.get(program.motors.len().saturating_sub(1)).or(board.last()).copied().unwrap_or(0);
    let driver = program.timing(motor).ticks(program.board.tick_hz);
    let driver = (driver.pulse_high + driver.pulse_low) as f64;
    let motor = motor.limits.max_speed.map_or(0.0, |speed| hz / speed);
    f64::from(board).max(driver).max(motor)
}
