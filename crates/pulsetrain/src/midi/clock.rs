//! The MIDI clock as a tempo.

use std::collections::VecDeque;
use std::time::Duration;

use pulsetrain_motion::time::Rate;

/// Ticks of the clock in a quarter note. Source: MIDI 1.0, "System Real Time Messages".
const PER_QUARTER: f64 = 24.0;
/// The tempo is known after as many intervals: half a quarter note.
const FEWEST: usize = 12;
/// It is taken from as many intervals, at most: two quarter notes.
const MOST: usize = 48;
/// A clock is slower than 10 quarter notes in a minute, or stopped, if nothing comes for so long.
const LONGEST_GAP: Duration = Duration::from_millis(250);
/// Smaller changes, as parts of the tempo, are jitter; and after two quarter notes without a change, smaller ones than the second.
const SMALLEST: [f64; 2] = [0.004, 0.001];
/// Ticks between two changes of the tempo: a change of the motion takes its time.
const BETWEEN: u32 = 6;

/// The tempo of a MIDI clock.
///
/// The ticks of USB and DIN cables come up to some milliseconds late. The tempo is the slope of the straight line that fits the last two quarter notes best
/// (least squares), and changes by less than 0.4 % are left out, by less than 0.1 % if it was steady for so long. A clock that stops tells nothing: the motion keeps its tempo.
///
/// ```
/// use pulsetrain::midi::ClockTempo;
/// use std::time::Duration;
/// // A clock of 90 quarter notes a minute; the motion is as in its file at 120.
/// let mut clock = ClockTempo::new(120.0);
/// let tick = |n: u32| Duration::from_secs_f64(60.0 / (24.0 * 90.0) * f64::from(n));
/// let told: Vec<f64> = (0..100).filter_map(|n| clock.tick(tick(n))).collect();
/// assert_eq!(told, [0.75]);
/// ```
#[derive(Clone, Debug)]
pub struct ClockTempo {
    bpm: f64,
    ticks: VecDeque<Duration>,
    told: Option<f64>,
    since_told: u32,
}

impl ClockTempo {
    /// A clock that gives the motion its own tempo at `bpm` quarter notes a minute.
    #[must_use]
    pub fn new(bpm: f64) -> ClockTempo {
        ClockTempo { bpm, ticks: VecDeque::with_capacity(MOST + 1), told: None, since_told: BETWEEN }
    }

    /// A tick came at `at` of any clock. The motion's new tempo, if that changes; 10 at most.
    pub fn tick(&mut self, at: Duration) -> Option<f64> {
        if self.ticks.back().is_some_and(|last| at <= *last || at - *last > LONGEST_GAP) {
            self.ticks.clear();
        }
        if self.ticks.len() > MOST {
            self.ticks.pop_front();
        }
        self.ticks.push_back(at);
        self.since_told = self.since_told.saturating_add(1);
        if self.ticks.len() <= FEWEST || self.since_told < BETWEEN {
            return None;
        }
        let rate = (60.0 / (PER_QUARTER * self.interval_s()) / self.bpm).min(Rate::MAX.get());
        // What people read.
        let rate = (rate * 1e4).round() / 1e4;
        let smallest = SMALLEST[usize::from(self.since_told > MOST as u32)];
        let is_new = self.told.is_none_or(|told| (rate - told).abs() > smallest * told);
        if !is_new || rate <= 0.0 {
            return None;
        }
        (self.told, self.since_told) = (Some(rate), 0);
        Some(rate)
    }

    /// The interval between ticks, by least squares.
    fn interval_s(&self) -> f64 {
        let first = self.ticks.front().copied().unwrap_or_default();
        let middle = (self.ticks.len() - 1) as f64 / 2.0;
        let sums = self.ticks.iter().enumerate().fold((0.0, 0.0), |(up, down), (number, at)| {
            let x = number as f64 - middle;
            (up + x * (*at - first).as_secs_f64(), down + x * x)
        });
        sums.0 / sums.1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a clock tells whose ticks come at these times, s.
    fn told(bpm: f64, ticks: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut clock = ClockTempo::new(bpm);
        ticks.filter_map(|at_s| clock.tick(Duration::from_secs_f64(at_s))).collect()
    }

    fn at(bpm: f64, count: u32) -> impl Iterator<Item = f64> {
        (0..count).map(move |n| f64::from(n) * 60.0 / (24.0 * bpm))
    }

    #[test]
    fn a_clock_with_jitter_has_one_tempo() {
        // Knuth's generator of 64 bits: each tick up to 1 ms late.
        let mut random = 1_u64;
        let late = at(120.0, 5000).map(|at_s| {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            at_s + 1e-3 * (random >> 40) as f64 / (1u64 << 24) as f64
        });
        let told = told(120.0, late);
        assert!(told.iter().all(|rate| (rate - 1.0).abs() < 0.012), "{told:?}");
        assert!((1..6).contains(&told.len()) && (told.last().unwrap() - 1.0).abs() < 0.005, "{told:?}");
    }

    #[test]
    fn another_tempo_is_followed_within_two_quarter_notes() {
        let faster = at(150.0, 200).map(|at_s| 10.0 + at_s);
        let ticks: Vec<f64> = at(100.0, 400).take_while(|at_s| *at_s < 9.99).chain(faster).collect();
        let told = told(100.0, ticks.into_iter());
        assert!(told[0] == 1.0 && (told.last().unwrap() - 1.5).abs() <= 0.0015, "{told:?}");
        assert!(told.windows(2).all(|pair| pair[0] < pair[1]), "{told:?}");
    }

    #[test]
    fn a_clock_that_stops_holds_the_tempo_and_extremes_are_held() {
        let gap = at(120.0, 100).chain(at(120.0, 100).map(|at_s| at_s + 60.0));
        assert_eq!(told(120.0, gap), [1.0], "the second beginning has the same tempo");
        assert_eq!(told(10.0, at(300.0, 100)), [10.0], "10 is the highest tempo");
        assert_eq!(told(120.0, at(9.0, 100)), [0.0; 0], "slower than 10 a minute is no clock");
        assert_eq!(
            told(120.0, [1.0, 1.0, 0.5, 0.2].into_iter().cycle().take(1000)),
            [0.0; 0],
            "times that go back tell nothing"
        );
    }
}
