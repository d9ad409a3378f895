//! What is proven of a plan.

use pulsetrain_motion::law::Class;

/// What is proven, and what was counted on the way.
#[derive(Clone, Debug, PartialEq)]
pub struct Certificate {
    /// ≥ |scheduled − exact| of every step so far, ticks.
    pub bound_ticks: f64,
    /// What "exact" is relative to.
    pub class: Class,
    /// Steps planned.
    pub steps: u64,
    /// Steps forward minus steps backward.
    pub position: i64,
    /// Segments planned.
    pub segments: u64,
    /// Payload bytes of the packed stream; 0 for a plan in full resolution.
    pub bytes: u64,
    /// Shortest interval between two steps, ticks; `None` before the second step.
    pub shortest_interval_ticks: Option<u64>,
    /// Fastest speed of the law met so far, steps/s, and when, s.
    pub peak_speed: (f64, f64),
    /// Largest acceleration of the law met so far, steps/s², and when, s.
    pub peak_acceleration: (f64, f64),
    /// Pairs of opposite steps dropped, since they were closer than the driver or the motor allows.
    pub pairs_dropped: u64,
    /// Largest |position − θ| that dropping led to, steps.
    pub worst_position_error: f64,
    /// Steps put off because another motor had the shared DIR line.
    pub steps_put_off: u64,
    /// Longest time that a step was put off, ticks.
    pub longest_put_off_ticks: u64,
}
