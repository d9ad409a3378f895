//! The rule that turns θ into step times.

/// θ that turns, rests or ends this far before a level, steps, or nearer, touches it: the motor makes the step. It is far less than a motor can
/// show, and far more than f64 rounds. The planner and the judge both have it, each with a computation of its own.
pub const TOUCH_STEPS: f64 = 1e-9;

/// Where θ comes to [`TOUCH_STEPS`] before a level within this, steps, a motor may make the step or not: two computations in f64 need not agree there.
pub const TOUCH_DOUBT_STEPS: f64 = 1e-11;

/// When a motor at position n steps: up when θ crosses n + ½ + h, down when it crosses n − ½ − h.
///
/// Both of the project's grids are this rule with another h.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// h, steps, in 0..=½.
    pub hysteresis: f64,
}

impl Grid {
    /// `nearest`, the default: h = 1/64 step.
    pub const NEAREST: Grid = Grid { hysteresis: 1.0 / 64.0 };
    /// `reach`, the tutorial's: up when θ reaches the next step, down when it returns to the one below.
    pub const REACH: Grid = Grid { hysteresis: 0.5 };

    /// θ (steps from the start) at which a motor at `position` steps up; a touch counts.
    #[must_use]
    pub fn up_level(self, position: i64) -> f64 {
        position as f64 + (0.5 + self.hysteresis)
    }

    /// θ (steps from the start) at which a motor at `position` steps down; a touch counts.
    #[must_use]
    pub fn down_level(self, position: i64) -> f64 {
        position as f64 - (0.5 + self.hysteresis)
    }
}
