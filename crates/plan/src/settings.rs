//! What the planner must keep to.

use pulsetrain_motion::Grid;
use pulsetrain_motion::program::Limits;

/// Everything that a plan of one motor depends on besides its law.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Ticks per second.
    pub tick_hz: u64,
    /// F of the board's recurrence: 16..=32.
    pub fraction_bits: u32,
    /// Bound on |scheduled − exact|, ticks, at least 0.55.
    pub tolerance_ticks: f64,
    /// When a motor steps.
    pub grid: Grid,
    /// Shortest interval between two steps, ticks: the board's, or the driver's pulse high + low if longer.
    pub min_interval_ticks: u64,
    /// Shortest interval between two opposite steps, ticks: pulse + DIR hold + DIR setup.
    pub reversal_ticks: u64,
    /// What the motor can do.
    pub limits: Limits,
}
