//! From a law to segments, with a proof for every scheduled tick.
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
pub use line::{Demand, Line, Supply, Way};
pub use load::Load;
pub use planner::{LAST_TICK, LONGEST_WAIT_TICKS, Origin, Planner};
pub use settings::Settings;

use pulsetrain_core::{Direction, Segment};

/// The least bound that a certificate can promise: half a tick is lost to whole ticks, the rest is for the fit.
pub const LEAST_TOLERANCE_TICKS: f64 = 0.55;

/// What a planner gives out, one after the other; the first comes after tick 0, fraction ½.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Move {
    /// A wait without steps. The fraction of the accumulator stays.
    Dwell {
        /// Whole ticks.
        ticks: u64,
    },
    /// Steps.
    Run {
        /// Their recurrence.
        segment: Segment,
        /// Which way they count.
        direction: Direction,
    },
}
