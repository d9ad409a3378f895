//! Why a motion is refused.

use pulsetrain_motion::{LawError, human};

/// Whose limit a plan would break.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limit {
    /// The board cannot make steps, or begin segments, that close together.
    Board,
    /// The file gives the motor a maximum speed.
    MotorSpeed,
    /// The file gives the motor a maximum acceleration.
    MotorAcceleration,
    /// The motor cannot change its speed by that much at once.
    PullIn,
    /// The line cannot bring the plans of all motors to the board's queues in time.
    Line,
}

/// A rate above its limit, and by how much. A rate within a tenth of a percent is too much all the same: the bytes come too late.
fn too_much(rate: f64, limit: f64) -> String {
    let percent = 100.0 * (rate / limit - 1.0);
    if percent < 0.1 {
        return format!("all of {rate:.0} bytes/s, which leaves no time to bring them");
    }
    format!("{rate:.0} bytes/s, {} % too much", human::significant(percent, 2))
}

/// Why a motion is refused; nothing has moved.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// The law itself breaks.
    #[error(transparent)]
    Law(#[from] LawError),
    /// The tolerance is smaller than any plan can prove.
    #[error("a tolerance of {tolerance_ticks} ticks cannot be proven; the least is {least_ticks}")]
    ToleranceTooTight {
        /// The tolerance, ticks.
        tolerance_ticks: f64,
        /// The smallest that can be proven, ticks.
        least_ticks: f64,
    },
    /// Steps are closer together than the board can make them.
    #[error("at t = {at_s:.6} s steps come at {rate_hz:.0} steps/s; the board makes {limit_hz:.0} steps/s at most")]
    TooFastForBoard {
        /// The time, s.
        at_s: f64,
        /// The step rate of the law, steps/s.
        rate_hz: f64,
        /// The board's limit, steps/s.
        limit_hz: f64,
    },
    /// Segments come faster than the board can take them from its queue.
    #[error(
        "at t = {at_s:.6} s the motion bends or turns so often that it takes {rate_hz:.0} segments/s; of each of so many motors the board does {limit_hz:.0} such segments/s at most, with their steps"
    )]
    TooManySegments {
        /// The time, s.
        at_s: f64,
        /// The rate of the plan, segments/s.
        rate_hz: f64,
        /// The board's limit for such segments, including their steps and direction changes, segments/s.
        limit_hz: f64,
    },
    /// The board's queue holds so little of the motion that the next part of the plan comes too late.
    #[error(
        "at t = {at_s:.6} s the motion bends or turns so often that the board's queue holds {:.1} ms of it; it takes {:.1} ms until more is there \
         (a queue is the board's memory for what a motor does next)",
        1e3 * .held_s, 1e3 * .needed_s
    )]
    QueueTooShort {
        /// The time, s.
        at_s: f64,
        /// How much of the motion the queue holds at that time, s.
        held_s: f64,
        /// Time from free space in the queue to the next part of the plan, s.
        needed_s: f64,
    },
    /// The line cannot bring the plans of all motors.
    #[error(
        "at t = {at_s:.6} s the plans of all motors take {}; the line to the board brings {limit:.0} bytes/s of plans", too_much(*rate, *limit)
    )]
    LineTooSlow {
        /// The time, s.
        at_s: f64,
        /// The rate of the plan, bytes/s.
        rate: f64,
        /// The limit of the line, bytes/s.
        limit: f64,
    },
    /// The softest braking that the board can do is harder than the motor allows.
    #[error(
        "it runs at up to {speed:.0} steps/s and may brake with {limit:.2} steps/s² at most; the board brakes with {least:.2} steps/s² at least \
         from there"
    )]
    BrakesTooHard {
        /// The highest speed of the law, steps/s.
        speed: f64,
        /// The motor's max_acceleration, steps/s².
        limit: f64,
        /// The softest braking that the board's numbers can hold, steps/s².
        least: f64,
    },
    /// A step that waits for a shared DIR line would be too close to another step of its motor.
    #[error(
        "at t = {at_s:.6} s a step that waits for the shared DIR line would be {interval_ticks} ticks from its neighbour; {limit_ticks} is the least: give the motor a DIR line of its own"
    )]
    LineTooBusy {
        /// The time, s.
        at_s: f64,
        /// The interval between the two steps, ticks.
        interval_ticks: i64,
        /// The shortest allowed, ticks.
        limit_ticks: i64,
    },
    /// The law is faster than the motor.
    #[error("at t = {at_s:.6} s the law runs at {speed:.1} steps/s; the motor's limit is {limit:.1} steps/s")]
    TooFast {
        /// The time, s.
        at_s: f64,
        /// The speed of the law, steps/s.
        speed: f64,
        /// The motor's limit, steps/s.
        limit: f64,
    },
    /// The law accelerates more than the motor can.
    #[error(
        "at t = {at_s:.6} s the law accelerates by {acceleration:.0} steps/s²; the motor's limit is {limit:.0} steps/s²"
    )]
    TooMuchAcceleration {
        /// The time, s.
        at_s: f64,
        /// The acceleration of the law, steps/s².
        acceleration: f64,
        /// The motor's limit, steps/s².
        limit: f64,
    },
    /// The speed of the law jumps by more than the pull-in rate: at its start, at its end or between.
    #[error(
        "at t = {at_s:.6} s the speed goes from {from:.1} to {to:.1} steps/s at once; the motor's pull-in rate allows a change of {pull_in:.1} steps/s"
    )]
    SpeedJump {
        /// The time, s.
        at_s: f64,
        /// The speed before, steps/s.
        from: f64,
        /// The speed after, steps/s.
        to: f64,
        /// The motor's pull-in rate, steps/s.
        pull_in: f64,
    },
    /// Numbers of 53 bits are too coarse for the law's step times.
    #[error(
        "the step at t = {at_s:.6} s can only be proven to {bound_ticks:.3} ticks, {tolerance_ticks} are asked for"
    )]
    NotProvable {
        /// The time, s.
        at_s: f64,
        /// The bound that can be proven, ticks.
        bound_ticks: f64,
        /// The tolerance, ticks.
        tolerance_ticks: f64,
    },
    /// The law consists of pieces far shorter than a tick.
    #[error("from t = {at_s:.6} s on the law changes many times within one tick of the board")]
    TooFine {
        /// The time, s.
        at_s: f64,
    },
    /// The motion goes on for longer than ticks can count.
    #[error("the motion goes on to t = {at_s:.0} s; the board's ticks can be planned up to {limit_s:.0} s")]
    TooLong {
        /// The time at which a part of it ends, s.
        at_s: f64,
        /// The latest time that can be planned, s.
        limit_s: f64,
    },
}

impl PlanError {
    /// The owner of the broken limit, if the error is a limit.
    #[must_use]
    pub fn limit(&self) -> Option<Limit> {
        match self {
            PlanError::TooFastForBoard { .. } | PlanError::TooManySegments { .. } => Some(Limit::Board),
            PlanError::TooFast { .. } => Some(Limit::MotorSpeed),
            PlanError::TooMuchAcceleration { .. } => Some(Limit::MotorAcceleration),
            PlanError::SpeedJump { .. } => Some(Limit::PullIn),
            PlanError::QueueTooShort { .. } | PlanError::LineTooSlow { .. } => Some(Limit::Line),
            PlanError::Law(_)
            | PlanError::ToleranceTooTight { .. }
            | PlanError::NotProvable { .. }
            | PlanError::TooFine { .. }
            | PlanError::TooLong { .. }
            | PlanError::BrakesTooHard { .. }
            | PlanError::LineTooBusy { .. } => None,
        }
    }

    /// The time of the error, s, if it has one.
    #[must_use]
    pub fn at_s(&self) -> Option<f64> {
        match self {
            PlanError::TooFastForBoard { at_s, .. }
            | PlanError::TooManySegments { at_s, .. }
            | PlanError::TooFast { at_s, .. }
            | PlanError::LineTooBusy { at_s, .. }
            | PlanError::TooMuchAcceleration { at_s, .. }
            | PlanError::SpeedJump { at_s, .. }
            | PlanError::NotProvable { at_s, .. }
            | PlanError::TooFine { at_s }
            | PlanError::QueueTooShort { at_s, .. }
            | PlanError::LineTooSlow { at_s, .. }
            | PlanError::TooLong { at_s, .. } => Some(*at_s),
            PlanError::Law(
                LawError::Undefined { at_s, .. } | LawError::Jump { at_s, .. } | LawError::Backlash { at_s, .. },
            ) => Some(*at_s),
            PlanError::Law(_) | PlanError::ToleranceTooTight { .. } | PlanError::BrakesTooHard { .. } => None,
        }
    }
}

/// A plan that was refused, and its motor.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{error}")]
pub struct Refused {
    /// Index of the motor in the program.
    pub motor: usize,
    /// The reason.
    pub error: PlanError,
}
