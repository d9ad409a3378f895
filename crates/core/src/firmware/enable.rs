//! The enable line of the drivers: active while there is something to do, and for a while after it.

use crate::wire::Millis;
use crate::wire::message::Configuration;

/// When drivers are enabled. The caller sets the pin: each method that changes the level gives it.
#[derive(Clone, Copy, Debug)]
pub struct EnableLine {
    /// Rest after which the drivers are released, ms.
    idle_ms: Option<u16>,
    /// Enable is active high.
    high: bool,
    on: bool,
    /// Since when there is nothing to do; `None` if that was not asked since the drivers were enabled.
    rests_since: Option<Millis>,
}

impl EnableLine {
    /// Drivers that are released.
    pub const OFF: EnableLine = EnableLine { idle_ms: None, high: false, on: false, rests_since: None };

    /// The line of a configuration; the drivers are released.
    #[must_use]
    pub const fn of(configuration: &Configuration<'_>) -> EnableLine {
        EnableLine { idle_ms: configuration.idle_ms, high: configuration.enable_high, ..EnableLine::OFF }
    }

    /// Enables or releases the drivers.
    pub const fn set(&mut self, on: bool) {
        (self.on, self.rests_since) = (on, None);
    }

    /// The level of the pin: true is high.
    #[must_use]
    pub const fn level(&self) -> bool {
        self.on == self.high
    }

    /// Enables the drivers while there is something to do, and for `idle_ms` after it; to be called every millisecond or so. Whether
    /// the level has changed.
    pub fn update(&mut self, now: Millis, idle: bool) -> bool {
        let was_on = self.on;
        if !idle {
            (self.on, self.rests_since) = (true, Some(now));
        } else if let Some(idle_ms) = self.idle_ms {
            let since = *self.rests_since.get_or_insert(now);
            self.on &= now.since(since) < idle_ms;
        }
        self.on != was_on
    }
}
