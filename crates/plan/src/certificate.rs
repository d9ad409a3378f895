//! The certificate: what is proven of a plan.

use pulsetrain_motion::law::Class;

/// The bound that is proven, and what was counted while planning.
#[derive(Clone, Debug, PartialEq)]
pub struct Certificate {
    /// ≥ |scheduled − exact| of every step so far, ticks.
    pub bound_ticks: f64,
    /// What "exact" means in `bound_ticks`.
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
    /// The highest speed of the law so far, steps/s, and its time, s.
    pub peak_speed: (f64, f64),
    /// The largest acceleration of the law so far, steps/s², and its time, s.
    pub peak_acceleration: (f64, f64),
    /// Pairs of opposite steps that were dropped because they were closer than the driver or the motor allows.
    pub pairs_dropped: u64,
    /// Largest |position − θ| because of dropped pairs, steps.
    pub worst_position_error: f64,
    /// Steps that were delayed because another motor used the shared DIR line.
    pub steps_put_off: u64,
    /// Longest delay of such a step, ticks.
    pub longest_put_off_ticks: u64,
}
