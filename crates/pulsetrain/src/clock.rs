//! The clock of this computer. Only the command reads it; what depends on it takes the time as an argument.

use std::time::{Duration, Instant};

use jiff::ZonedDateTime;

/// The time of day in this computer's time zone.
pub(crate) fn now() -> ZonedDateTime {
    ZonedDateTime::now()
}

/// A time that goes on: that of a port, though the port is closed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Onward {
    since: Instant,
    then: Duration,
}

impl Onward {
    /// It is `then` now.
    pub(crate) fn from(then: Duration) -> Onward {
        Onward { since: Instant::now(), then }
    }

    /// What it is now.
    pub(crate) fn now(&self) -> Duration {
        self.then + self.since.elapsed()
    }
}
