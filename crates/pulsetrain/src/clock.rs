//! The clock of this computer. Only the command reads it; what depends on it takes the time as an argument.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use jiff::ZonedDateTime;

/// The time of day in this computer's time zone.
pub(crate) fn now() -> ZonedDateTime {
    ZonedDateTime::now()
}

/// Seconds since 1970 in UTC.
pub(crate) fn unix_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
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
