//! The report of the judge.

use std::fmt;

use schemars::JsonSchema;
use serde::Serialize;

use super::MOST_PPM;

/// The verdict on a trace.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Report {
    /// Whether every bound was kept.
    pub ok: bool,
    /// Ticks per second of the board; all ticks in this report are the board's.
    pub tick_hz: u64,
    /// The alignment of the trace with the law.
    pub alignment: Alignment,
    /// One report for each motor.
    pub motors: Vec<MotorReport>,
    /// The first failures of each motor, in order of motors; `motors[…].faults` counts all.
    pub failures: Vec<Failure>,
}

/// The alignment of the trace with the law.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Alignment {
    /// Time in the trace of the law's time zero, s.
    pub shift_s: f64,
    /// How much faster the board's clock is than the trace's, ppm; 0 unless it was fitted.
    pub rate_ppm: f64,
}

/// What the trace shows of one motor.
///
/// An error is how late a step is (negative: early), without the board's constant delay and within the precision of
/// f64.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct MotorReport {
    /// The name of the motor in the motion file.
    pub motor: String,
    /// Steps of the law, without dropped pairs.
    pub steps_wanted: u64,
    /// Steps in the trace.
    pub steps_got: u64,
    /// Steps forward minus steps backward, by the law.
    #[serde(rename = "position_wanted_steps")]
    pub position_wanted: i64,
    /// Steps forward minus steps backward, in the trace.
    #[serde(rename = "position_got_steps")]
    pub position_got: i64,
    /// Steps of the law that the trace does not have.
    pub missing: u64,
    /// Steps of the trace that the law does not have.
    pub extra: u64,
    /// Steps in the wrong direction.
    pub wrong_direction: u64,
    /// Steps beyond the bound.
    pub off_time: u64,
    /// All faults: those above, timing, coils, position.
    pub faults: u64,
    /// The bound on |error|, ticks.
    pub bound_ticks: f64,
    /// Largest error, ticks.
    pub max_error_ticks: f64,
    /// Largest error, µs.
    pub max_error_us: f64,
    /// Largest error as a distance (error × speed), steps.
    pub max_error_steps: f64,
    /// Law time of the largest error, s.
    pub max_error_at_s: f64,
    /// Root of the mean square error, ticks.
    pub rms_error_ticks: f64,
    /// Root of the mean square error, µs.
    pub rms_error_us: f64,
    /// Root of the mean square error as a distance, steps.
    pub rms_error_steps: f64,
    /// Slope of the error against time (least squares), ppm.
    pub drift_ppm: f64,
    /// Slope of the error against time, ticks per hour.
    pub drift_ticks_per_hour: f64,
    /// Shortest interval between two steps, ticks.
    pub shortest_interval_ticks: Option<f64>,
    /// The highest step rate: the inverse of the shortest interval, steps/s.
    pub peak_rate_hz: Option<f64>,
    /// Shortest STEP HIGH.
    pub pulse_high: Option<Measured>,
    /// Shortest STEP LOW.
    pub pulse_low: Option<Measured>,
    /// Shortest time from a change of DIR to STEP rising.
    pub dir_setup: Option<Measured>,
    /// Shortest time from STEP falling to a change of DIR.
    pub dir_hold: Option<Measured>,
    /// Pairs of opposite steps that were dropped because they were closer than the driver or the motor allows.
    pub pairs_dropped: u64,
    /// Largest |position − θ| because of dropped pairs, steps.
    #[serde(rename = "worst_position_error_steps")]
    pub worst_position_error: f64,
    /// Steps that were later than the bound because another motor used the shared DIR line.
    pub steps_put_off: u64,
    /// The largest delay of such a step, ticks.
    pub longest_put_off_ticks: f64,
}

/// A time that a driver needs, as measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Measured {
    /// The shortest one, ns.
    pub seen_ns: f64,
    /// What the driver needs, ns.
    pub needed_ns: u32,
    /// Time in the trace of the shortest one, s.
    pub at_s: f64,
}

/// A bound that broke.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Failure {
    /// The motor.
    pub motor: String,
    /// The number of the law's step, from 1. For faults between steps it is the step before.
    pub step: u64,
    /// Law time, s.
    pub at_s: f64,
    /// The fault.
    #[serde(flatten)]
    pub fault: Fault,
}

/// The kinds of fault.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(tag = "fault", rename_all = "snake_case")]
pub enum Fault {
    /// The law has a step and the trace does not.
    Missing {
        /// Its direction.
        forward: bool,
    },
    /// The trace has a step and the law does not.
    Extra {
        /// Its direction.
        forward: bool,
    },
    /// The step is there, in the wrong direction.
    WrongDirection {
        /// Its direction in the trace.
        forward: bool,
    },
    /// A step is too early or too late.
    OffTime {
        /// Its lateness, ticks.
        error_ticks: f64,
        /// The bound, ticks.
        limit_ticks: f64,
    },
    /// STEP was HIGH for too short a time.
    PulseHigh {
        /// The time, ns.
        seen_ns: f64,
        /// What the driver needs, ns.
        needed_ns: u32,
    },
    /// STEP was LOW for too short a time.
    PulseLow {
        /// The time, ns.
        seen_ns: f64,
        /// What the driver needs, ns.
        needed_ns: u32,
    },
    /// DIR changed too late before STEP rose.
    DirSetup {
        /// The time, ns.
        seen_ns: f64,
        /// What the driver needs, ns.
        needed_ns: u32,
    },
    /// DIR changed too soon after STEP fell, or while it was HIGH.
    DirHold {
        /// The time, ns.
        seen_ns: f64,
        /// What the driver needs, ns.
        needed_ns: u32,
    },
    /// The coils changed by more than one step of the sequence.
    CoilJump {
        /// Pattern before; IN1 is bit 0.
        from: u8,
        /// Pattern after.
        to: u8,
    },
    /// The motor's final position is wrong.
    Position {
        /// Position in the trace, steps.
        got: i64,
        /// Position of the law, steps.
        wanted: i64,
    },
    /// The clock rate that fits best is further off than any clock.
    Clock {
        /// How much faster the board's clock is than the trace's, ppm.
        rate_ppm: f64,
        /// The largest deviation allowed, ppm.
        limit_ppm: f64,
    },
    /// The camera shows the motor at another angle.
    Angle {
        /// How far it is ahead of the law, steps.
        error_steps: f64,
        /// The limit, steps.
        limit_steps: f64,
    },
}

impl Fault {
    /// The fault of a fitted rate, if it is too large. A rate of 0 means that the clocks agree.
    pub(super) fn of_clock(rate: f64) -> Option<Fault> {
        let rate_ppm = rate * 1e6;
        (rate_ppm.abs() > MOST_PPM).then_some(Fault::Clock { rate_ppm, limit_ppm: MOST_PPM })
    }
}

fn way(forward: bool) -> &'static str {
    if forward { "forward" } else { "backward" }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Failure { motor, step, at_s, fault } = self;
        write!(f, "motor {motor}: ")?;
        match fault {
            Fault::Missing { forward } => write!(f, "step {step} ({}) missing", way(*forward)),
            Fault::Extra { forward } => write!(f, "extra step ({}) after step {step}", way(*forward)),
            Fault::WrongDirection { forward } => write!(f, "step {step} goes {}", way(*forward)),
            Fault::OffTime { error_ticks, limit_ticks } => {
                let late = if *error_ticks > 0.0 { "late" } else { "early" };
                write!(f, "step {step} is {:.2} ticks {late}, limit {limit_ticks:.2},", error_ticks.abs())
            }
            Fault::PulseHigh { seen_ns, needed_ns } => {
                write!(f, "STEP HIGH for {seen_ns:.1} ns, needs {needed_ns} ns,")
            }
            Fault::PulseLow { seen_ns, needed_ns } => write!(f, "STEP LOW for {seen_ns:.1} ns, needs {needed_ns} ns,"),
            Fault::DirSetup { seen_ns, needed_ns } => write!(f, "DIR setup {seen_ns:.1} ns, needs {needed_ns} ns,"),
            Fault::DirHold { seen_ns, needed_ns } => write!(f, "DIR hold {seen_ns:.1} ns, needs {needed_ns} ns,"),
            Fault::CoilJump { from, to } => write!(f, "coils jump from {from:04b} to {to:04b} (IN4 to IN1)"),
            Fault::Position { got, wanted } => write!(f, "ends at {got} steps, wanted {wanted},"),
            Fault::Clock { rate_ppm, limit_ppm } => {
                write!(f, "fits only with a clock that is off by {rate_ppm:+.0} ppm, limit {limit_ppm:.0},")
            }
            Fault::Angle { error_steps, limit_steps } => {
                write!(f, "is {error_steps:.3} steps off, limit {limit_steps:.3},")
            }
        }?;
        write!(f, " at t = {at_s:.6} s")
    }
}
