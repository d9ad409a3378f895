//! A board's clock as the host has read it. The board answers some time between question and answer, so each reading has an uncertainty.

use std::collections::VecDeque;
use std::time::Duration;

/// Readings that are kept: enough to have a quick one among them, few enough to search each time.
const READINGS: usize = 16;

/// How far a board's clock may be off its nominal rate, ppm: ±0.5 % of a ceramic resonator.
const WORST_PPM: f64 = 5000.0;

/// Seconds that two readings must be apart before a rate is computed from them.
const SHORTEST_SPAN_S: f64 = 0.5;

/// A tick that the clock showed some time between two host times.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reading {
    tick: u64,
    /// The middle of those two times, s.
    at: f64,
    /// Half of the time between them, s.
    within: f64,
}

/// A board's clock: converts between its ticks and the host's time, which is that of the port ([`Port::now`](crate::Port::now)).
///
/// ```
/// use pulsetrain_board::BoardClock;
/// use std::time::Duration;
/// let mut clock = BoardClock::new(16_000_000);
/// let ms = Duration::from_millis;
/// // 100 ppm fast, each answer within 1 ms.
/// for second in 0..10 {
///     clock.read(second * 16_001_600, ms(1000 * second), ms(1000 * second + 1));
/// }
/// let (ppm, uncertain) = clock.ppm().unwrap();
/// assert!((ppm - 100.0).abs() <= uncertain && uncertain < 150.0);
/// let tick = clock.tick_at(ms(20_000)).unwrap();
/// assert!(tick.abs_diff(320_032_000) < 16_000);
/// ```
#[derive(Clone, Debug)]
pub struct BoardClock {
    tick_hz: f64,
    /// The first good reading: the rate is computed from here to the last one.
    first: Option<Reading>,
    recent: VecDeque<Reading>,
    /// The most certain reading by now.
    best: Option<Reading>,
    /// The rate with which ticks are extrapolated from `best`, ticks/s.
    rate_hz: f64,
    /// How much faster than nominal the clock is, and how uncertain that is, ppm.
    ppm: Option<(f64, f64)>,
}

impl BoardClock {
    /// A clock of a nominal rate, ticks/s, that has not been read yet.
    #[must_use]
    pub fn new(tick_hz: u32) -> BoardClock {
        let tick_hz = f64::from(tick_hz);
        BoardClock { tick_hz, first: None, recent: VecDeque::new(), best: None, rate_hz: tick_hz, ppm: None }
    }

    /// Notes that the clock showed `tick` some time between `asked` and `answered`.
    pub fn read(&mut self, tick: u64, asked: Duration, answered: Duration) {
        let (from, to) = (asked.as_secs_f64(), answered.as_secs_f64());
        let reading = Reading { tick, at: (from + to) / 2.0, within: (to - from).max(0.0) / 2.0 };
        let first = *self.first.get_or_insert(reading);
        if reading.at < first.at + SHORTEST_SPAN_S && reading.within < first.within {
            self.first = Some(reading);
        }
        if self.recent.len() == READINGS {
            self.recent.pop_front();
        }
        self.recent.push_back(reading);

        // The older a reading is, the less certain is what follows from it: the rate is uncertain too.
        let vague = |reading: &Reading, ppm: f64| reading.within + (to - reading.at) * 1e-6 * ppm;
        let best_for = |ppm: f64| {
            let least = self.recent.iter().min_by(|a, b| vague(a, ppm).total_cmp(&vague(b, ppm)));
            least.copied().unwrap_or(reading)
        };
        let last = best_for(self.ppm.map_or(WORST_PPM, |(_, uncertain)| uncertain.min(WORST_PPM)));
        let span = last.at - first.at;
        if span >= SHORTEST_SPAN_S {
            let ticks = last.tick.wrapping_sub(first.tick) as f64;
            let ppm = (ticks / (span * self.tick_hz) - 1.0) * 1e6;
            let uncertain = (first.within + last.within) / span * 1e6;
            self.ppm = Some((ppm, uncertain));
            if uncertain < WORST_PPM {
                self.rate_hz = self.tick_hz * (1.0 + ppm * 1e-6);
            }
        }
        self.best = Some(last);
    }

    /// How much faster than its nominal rate the clock runs, and how uncertain that is, ppm.
    ///
    /// `None` until readings half a second apart have come.
    #[must_use]
    pub const fn ppm(&self) -> Option<(f64, f64)> {
        self.ppm
    }

    /// The tick at a host time, rounded down; `None` until the clock was read.
    #[must_use]
    pub fn tick_at(&self, time: Duration) -> Option<u64> {
        let reading = self.best?;
        let ticks = ((time.as_secs_f64() - reading.at) * self.rate_hz).floor();
        // Far below 2^63 either way.
        Some(reading.tick.saturating_add_signed(ticks as i64))
    }

    /// The host time at which the clock shows `tick`; `None` until the clock was read.
    #[must_use]
    pub fn time_of(&self, tick: u64) -> Option<Duration> {
        let reading = self.best?;
        let ahead = tick as f64 - reading.tick as f64;
        Some(Duration::try_from_secs_f64((reading.at + ahead / self.rate_hz).max(0.0)).unwrap_or(Duration::MAX))
    }
}
