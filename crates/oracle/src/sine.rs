//! The tutorial's sinusoid.

use crate::crossing::{BITS, Crossing, Rational, Real, rational, real};

/// θ = A − A·cos(2πt/T), stepped up and down `cycles` times. Source: the tutorial, eq. 1.
///
/// The arc cosines depend on the swing alone: one [`Sine`] serves every period and every tick rate.
#[derive(Clone, Debug)]
pub struct Sine {
    /// The times of the steps of the rising half, in periods: 0 to ½.
    phases: Vec<Real>,
}

impl Sine {
    /// A sinusoid of whole `swing` = 2A steps from bottom to top, on a grid of hysteresis h (0 ≤ h ≤ ½).
    ///
    /// # Panics
    /// If `swing` is 0.
    #[must_use]
    pub fn new(swing: u32, hysteresis: &Rational) -> Sine {
        assert!(swing > 0);
        let half = rational(1, 2);
        let amplitude = rational(swing.into(), 2);
        let phases = (0..swing)
            // Step up number n is due at θ = n + ½ + h, that is at cos(2πφ) = 1 − θ/A.
            .map(|n| Rational::ONE - (Rational::from(n) + &half + hysteresis) / &amplitude)
            .map(|cosine| if cosine == -Rational::ONE { real(&half) } else { real(&cosine).acos_unit(1) })
            .collect();
        Sine { phases }
    }

    /// The time of each step of the rising half since the beginning of its half period, in 2^-64 ticks, rounded down.
    ///
    /// `period` is in 2^-64 s, so that half period k begins at exactly k/2·`period`·`tick_hz` of these units.
    ///
    /// # Panics
    /// If a half period is 2^64 ticks or longer.
    #[must_use]
    pub fn offsets(&self, period: u128, tick_hz: u64) -> Vec<u128> {
        let period = Real::from(period).with_precision(BITS).value() * Real::from(tick_hz);
        let offset = |phase: &Real| {
            u128::try_from((&period * phase).floor().to_int().value()).expect("a half period below 2^64 ticks")
        };
        self.phases.iter().map(offset).collect()
    }

    /// All steps of `cycles` periods of `period` seconds, in order.
    ///
    /// The way down is that up, half a period later: θ(½ + φ) = 2A − θ(φ), and its levels mirror those of the way up.
    pub fn crossings<'a>(&'a self, period: &Rational, cycles: u64) -> impl Iterator<Item = Crossing> + 'a {
        let period = real(period);
        (0..2 * cycles).flat_map(move |half| {
            let turns = Real::from(half).with_precision(BITS).value() / Real::from(2);
            let period = period.clone();
            self.phases
                .iter()
                .map(move |phase| Crossing { seconds: (&turns + phase) * &period, forward: half % 2 == 0 })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tutorial_has_its_8000_steps_and_its_touch() {
        let sine = Sine::new(4000, &rational(1, 2));
        let steps: Vec<_> = sine.crossings(&rational(1, 1), 1).collect();
        assert_eq!(steps.len(), 8000);
        assert_eq!(steps.iter().filter(|s| s.forward).count(), 4000);
        // Step 2000 is at the middle, a quarter period in; 4000 touches the top; the last touches the bottom.
        for (index, quarters) in [(1999, 1), (3999, 2), (5999, 3), (7999, 4)] {
            assert_eq!(steps[index].seconds, real(&rational(quarters, 4)), "step {}", index + 1);
        }
        assert!(steps.is_sorted_by(|a, b| a.seconds <= b.seconds));
    }

    /// Put into the law, a step time must give the step's level: cosines check arc cosines.
    #[test]
    fn steps_lie_on_the_law() {
        for (swing, hysteresis) in [(4000, rational(1, 2)), (25, rational(1, 64)), (1, rational(0, 1))] {
            let sine = Sine::new(swing, &hysteresis);
            let amplitude = real(&rational(swing.into(), 2));
            let offset = real(&(rational(1, 2) + &hysteresis));
            for (n, phase) in sine.phases.iter().enumerate() {
                let theta = &amplitude - &amplitude * phase.cos_unit(1);
                let error = (theta - Real::from(n) - &offset).to_f64().value();
                assert!(error.abs() < 1e-50, "step {n} of {swing}: off by {error} steps");
            }
        }
    }
}
