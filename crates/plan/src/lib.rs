//! From a law to segments, with a proof for every scheduled tick.
//!
//! ```
//! use pulsetrain_motion::{Law, Time, law::Sine};
//! use pulsetrain_plan::{Move, Planner, Settings};
//!
//! // 2000 steps to each side within a second, on a timer of 16 MHz with 16 fraction bits (an Uno).
//! let law = Law::Sine(Sine { amplitude: 2000.0, period: Time::SECOND, cycles: Some(1) });
//! let mut planner = Planner::new(&law, &Settings::new(16_000_000, 16))?;
//! let mut steps = 0;
//! while let Some(next) = planner.next_move()? {
//!     if let Move::Run { segment, .. } = next {
//!         steps += segment.count;
//!     }
//! }
//! assert_eq!(steps, 8000);
//! // No step is scheduled further than this from where the law has it.
//! assert!(planner.certificate().bound_ticks <= 1.0);
//! # Ok::<(), pulsetrain_plan::PlanError>(())
//! ```
//!
//! # What is here, top down
//! - [`ensemble`]: all motors of a program
//! - `shared_dir`: the order of steps on a DIR line that motors share
//! - [`planner`]: a law as a stream of [`Move`]s, in constant memory, within every limit
//! - `braking`: limits as the numbers of the stop that boards make by themselves
//! - `run`: steps in one direction along one stretch, as segments
//! - `fit`: one segment: fit, quantise, bound
//! - `stretch`: where a law rises and where it falls
//! - `packed`: what a plan costs on the wire; `load`: what it costs the board's processor
//! - `line`: whether a line brings the plans of all motors in time
//! - `expansion`: the local inverse t(n) with a proven remainder
//! - `peak`: largest speed and acceleration, enclosed
//!
//! # What is not
//! Laws themselves (`pulsetrain-motion`), queues and edges (`pulsetrain-core`, `pulsetrain-board`).
#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit"))]
#![forbid(unsafe_code)]

mod braking;
pub mod certificate;
pub mod ensemble;
pub mod error;
mod expansion;
mod fit;
pub mod line;
mod load;
mod packed;
mod peak;
pub mod planner;
mod run;
pub mod settings;
mod shared_dir;
mod stretch;

pub use braking::{SOFTEST_STOP_S, Stopping, braking_limit, softest_braking, stopping};
pub use certificate::Certificate;
pub use ensemble::{Ensemble, Start};
pub use error::{PlanError, Refused};
pub use line::{Demand, Line, Refill, Supply, Way};
pub use load::Load;
pub use planner::{LAST_TICK, LONGEST_WAIT_TICKS, Origin, Planner};
pub use settings::Settings;

use pulsetrain_core::{Direction, Segment};

/// The smallest tolerance that a certificate can promise, ticks: rounding to whole ticks takes half a tick, the fit the
/// rest.
pub const MIN_TOLERANCE_TICKS: f64 = 0.55;

/// A move of a plan. A planner returns one after the other; the first begins after tick 0, fraction ½.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Move {
    /// A wait without steps. The fraction of the accumulator stays.
    Dwell {
        /// Whole ticks.
        ticks: u64,
    },
    /// Steps.
    Run {
        /// The recurrence of the steps.
        segment: Segment,
        /// The direction in which they count.
        direction: Direction,
    },
}
