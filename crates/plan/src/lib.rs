//! From a law to segments, with a proof for every scheduled tick.
#![forbid(unsafe_code)]

pub mod certificate;
pub mod settings;

pub use certificate::Certificate;
pub use settings::Settings;

use pulsetrain_core::{Direction, Segment};

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
