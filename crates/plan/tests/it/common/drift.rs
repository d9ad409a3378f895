//! Very long motions against exact integers: what is left of an error after 10^8 steps.

use super::laws::{constant_speed, sine};
use super::{replay, settings};
use pulsetrain_motion::{Grid, Time};
use pulsetrain_oracle::{Sine, rational};
use pulsetrain_plan::Settings;

/// The Uno's timer, where fractions have the fewest bits.
const UNO: (u64, u32) = (16_000_000, 16);
/// The first and last steps that are looked at apart.
const SAMPLE: u64 = 1_000_000;

/// How far steps were from their exact times: largest |scheduled − exact|, ticks.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Drift {
    /// Steps made.
    pub(crate) steps: u64,
    /// Over all steps.
    pub(crate) largest: f64,
    /// Over the first million.
    pub(crate) first: f64,
    /// Over the last million.
    pub(crate) last: f64,
    /// What the process held after the first million steps, and after the last step, kB; where Linux tells.
    pub(crate) memory_kb: [Option<f64>; 2],
}

impl Drift {
    fn add(&mut self, error: f64, total: u64) {
        self.steps += 1;
        self.largest = self.largest.max(error.abs());
        if self.steps <= SAMPLE {
            self.first = self.first.max(error.abs());
        }
        if self.steps > total.saturating_sub(SAMPLE) {
            self.last = self.last.max(error.abs());
        }
        if self.steps == SAMPLE {
            self.memory_kb[0] = memory_kb();
        }
        if self.steps == total {
            self.memory_kb[1] = memory_kb();
        }
    }
}

/// What the process holds of main memory.
fn memory_kb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.split_whitespace().next()?.parse().ok()
}

/// A step every 100π ticks (the nearest f64 in steps/s, which is a rational number).
pub(crate) fn constant(steps: u64) -> Drift {
    let (tick_hz, _) = UNO;
    let speed = tick_hz as f64 / (100.0 * std::f64::consts::PI);
    // The law ends a quarter of a step after the last step's level.
    let law = constant_speed(speed, (steps as f64 + 0.25) / speed);
    // speed = numerator / 2^SHIFT steps/s, exactly: step n is due at (n − ½ + 1/64)·tick_hz·2^SHIFT/numerator ticks.
    const SHIFT: u32 = 37;
    let numerator = (speed * (1_u64 << SHIFT) as f64) as i128;
    assert!(numerator as f64 == speed * (1_u64 << SHIFT) as f64, "the speed is not a multiple of 2^-{SHIFT}");
    let step = i128::from(tick_hz) << SHIFT;
    let mut drift = Drift::default();
    replay(&law, &settings(UNO), |made| {
        let level_in_64ths = i128::from(drift.steps) * 64 + 33;
        let error = i128::from(made.tick) * numerator * 64 - level_in_64ths * step;
        drift.add(error as f64 / (numerator * 64) as f64, steps);
    })
    .expect("a plan");
    drift
}

/// The tutorial's sinusoid with a period of π/3 s (the nearest 2^-64 s).
pub(crate) fn sinusoid(cycles: u64) -> Drift {
    const SWING: u64 = 4000;
    let (tick_hz, _) = UNO;
    let period = Time::from_seconds(std::f64::consts::FRAC_PI_3);
    let raw = u128::try_from(period.raw()).expect("a positive period");
    let offsets = Sine::new(SWING as u32, &rational(1, 2)).offsets(raw, tick_hz);
    let half_period = raw * u128::from(tick_hz) / 2;
    let settings = Settings { grid: Grid::REACH, ..settings(UNO) };
    let mut drift = Drift::default();
    replay(&sine(SWING as f64 / 2.0, period, cycles), &settings, |made| {
        let (half, step) = (drift.steps / SWING, drift.steps % SWING);
        let exact = u128::from(half) * half_period + offsets[step as usize];
        let error = ((u128::from(made.tick) << 64) as i128 - exact as i128) as f64 / (1_u128 << 64) as f64;
        drift.add(error, 2 * SWING * cycles);
    })
    .expect("a plan");
    drift
}
