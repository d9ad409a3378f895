//! Why a motion is refused.

use pulsetrain_motion::LawError;

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
    /// The line does not bring the plans of all motors to the board's queues in time.
    Line,
}

/// Why a motion is refused; nothing has moved.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// The law itself breaks.
    #[error(transparent)]
    Law(#[from] LawError),
    /// The certificate asked for is below what any plan can have.
    #[error("a tolerance of {tolerance_ticks} ticks cannot be proven; the least is {least_ticks}")]
    ToleranceTooTight {
        /// Asked for, ticks.
        tolerance_ticks: f64,
        /// Least, ticks.
        least_ticks: f64,
    },
    /// Steps would come closer together than the board can make them.
    #[error("at t = {at_s:.6} s steps come at {rate_hz:.0} steps/s; the board makes {limit_hz:.0} steps/s at most")]
    TooFastForBoard {
        /// When, s.
        at_s: f64,
        /// Asked for, steps/s.
        rate_hz: f64,
        /// The board's limit, steps/s.
        limit_hz: f64,
    },
    /// Segments come faster than the board takes them from its queue.
    #[error(
        "at t = {at_s:.6} s the motion bends or turns so often that it takes {rate_hz:.0} segments/s; of each of so many motors the board does {limit_hz:.0} such segments/s at most, with their steps"
    )]
    TooManySegments {
        /// When, s.
        at_s: f64,
        /// Asked for, segments/s.
        rate_hz: f64,
        /// The board's limit for such segments, with their steps and turns, segments/s.
        limit_hz: f64,
    },
    /// The board's queue holds so little of the motion that what comes next is late.
    #[error(
        "at t = {at_s:.6} s the motion bends or turns so often that the board's queue holds {:.1} ms of it; it takes {:.1} ms until more is there",
        1e3 * .held_s, 1e3 * .needed_s
    )]
    QueueTooShort {
        /// When, s.
        at_s: f64,
        /// What the queue holds by then, s.
        held_s: f64,
        /// From room in it to more of the plan, s.
        needed_s: f64,
    },
    /// The line does not bring the plans of all motors.
    #[error(
        "at t = {at_s:.6} s the plans of all motors take {rate:.0} bytes/s; the line brings {limit:.0} bytes/s of plans at most"
    )]
    LineTooSlow {
        /// When, s.
        at_s: f64,
        /// Asked for, bytes/s.
        rate: f64,
        /// The line's, bytes/s.
        limit: f64,
    },
    /// The softest braking of the board is harder than the motor allows.
    #[error(
        "it runs at up to {speed:.0} steps/s and may brake with {limit:.2} steps/s² at most; the board brakes with {least:.2} steps/s² at least \
         from there"
    )]
    BrakesTooHard {
        /// The largest of the law, steps/s.
        speed: f64,
        /// The motor's max_acceleration, steps/s².
        limit: f64,
        /// What the board's numbers hold, steps/s².
        least: f64,
    },
    /// A step that waits for a shared DIR line would come too close to the motor's next or last one.
    #[error(
        "at t = {at_s:.6} s a step that waits for the shared DIR line would be {interval_ticks} ticks from its neighbour; {limit_ticks} is the least: give the motor a DIR line of its own"
    )]
    LineTooBusy {
        /// When, s.
        at_s: f64,
        /// What is left between the two steps, ticks.
        interval_ticks: i64,
        /// The least, ticks.
        limit_ticks: i64,
    },
    /// The law is faster than the motor.
    #[error("at t = {at_s:.6} s the law runs at {speed:.1} steps/s; the motor's limit is {limit:.1} steps/s")]
    TooFast {
        /// When, s.
        at_s: f64,
        /// steps/s.
        speed: f64,
        /// steps/s.
        limit: f64,
    },
    /// The law accelerates more than the motor can.
    #[error(
        "at t = {at_s:.6} s the law accelerates by {acceleration:.0} steps/s²; the motor's limit is {limit:.0} steps/s²"
    )]
    TooMuchAcceleration {
        /// When, s.
        at_s: f64,
        /// steps/s².
        acceleration: f64,
        /// steps/s².
        limit: f64,
    },
    /// The law starts, ends or changes its speed at once by more than the pull-in rate.
    #[error(
        "at t = {at_s:.6} s the speed goes from {from:.1} to {to:.1} steps/s at once; the motor's pull-in rate allows a change of {pull_in:.1} steps/s"
    )]
    SpeedJump {
        /// When, s.
        at_s: f64,
        /// steps/s, before.
        from: f64,
        /// steps/s, after.
        to: f64,
        /// steps/s.
        pull_in: f64,
    },
    /// Numbers of 53 bits are too coarse for the law's step times.
    #[error(
        "the step at t = {at_s:.6} s can only be proven to {bound_ticks:.3} ticks, {tolerance_ticks} are asked for"
    )]
    NotProvable {
        /// When, s.
        at_s: f64,
        /// What can be proven, ticks.
        bound_ticks: f64,
        /// What was asked for, ticks.
        tolerance_ticks: f64,
    },
    /// The law consists of pieces far shorter than a tick.
    #[error("from t = {at_s:.6} s on the law changes many times within one tick of the board")]
    TooFine {
        /// When, s.
        at_s: f64,
    },
    /// The motion goes on for longer than ticks can count.
    #[error("the motion goes on to t = {at_s:.0} s; the board's ticks can be planned up to {limit_s:.0} s")]
    TooLong {
        /// Where a part of it ends, s.
        at_s: f64,
        /// s.
        limit_s: f64,
    },
}

impl PlanError {
    /// Whose limit it is, if it is a limit.
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

    /// When it happens, s, if at one time.
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

/// A plan that was refused, and whose it is.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{error}")]
pub struct Refused {
    /// Index of the motor in the program.
    pub motor: usize,
    /// Why.
    pub error: PlanError,
}
