//! Speed up, cruise, slow down.

use crate::crossing::{Crossing, Rational, Real, rational, real};

/// A move forward over whole steps: from rest to `speed` with `acceleration`, and to rest with `deceleration`.
#[derive(Clone, Debug)]
pub struct Trapezoid {
    distance: u64,
    speed: Rational,
    /// Steps and seconds of speeding up.
    sped_up: (Rational, Rational),
    /// Steps and seconds at which slowing down begins.
    slow_down: (Rational, Rational),
    /// Acceleration and deceleration, steps/s²; `None` for a constant speed.
    rates: Option<(Rational, Rational)>,
}

impl Trapezoid {
    /// A rest-to-rest move that reaches `speed`; steps, steps/s, steps/s², all positive.
    ///
    /// # Panics
    /// If `distance` is too short to reach `speed`.
    #[must_use]
    pub fn new(distance: u64, speed: Rational, acceleration: Rational, deceleration: Rational) -> Trapezoid {
        let square = &speed * &speed;
        let up = &square / (Rational::from(2) * &acceleration);
        let slow_from = Rational::from(distance) - &square / (Rational::from(2) * &deceleration);
        assert!(up <= slow_from, "too short to reach the speed");
        let up_s = &speed / &acceleration;
        let slow_s = &up_s + (&slow_from - &up) / &speed;
        Trapezoid {
            distance,
            speed,
            sped_up: (up, up_s),
            slow_down: (slow_from, slow_s),
            rates: Some((acceleration, deceleration)),
        }
    }

    /// `distance` steps at `speed` (positive, steps/s) from t = 0 on.
    #[must_use]
    pub fn constant_speed(speed: Rational, distance: u64) -> Trapezoid {
        let end = (Rational::from(distance), Rational::from(distance) / &speed);
        Trapezoid { distance, speed, sped_up: (Rational::ZERO, Rational::ZERO), slow_down: end, rates: None }
    }

    /// All steps in order, on a grid of hysteresis h (0 ≤ h ≤ ½).
    pub fn crossings<'a>(&'a self, hysteresis: &Rational) -> impl Iterator<Item = Crossing> + 'a {
        let offset = rational(1, 2) + hysteresis;
        (0..self.distance)
            .map(move |n| Crossing { seconds: self.time_at(&(Rational::from(n) + &offset)), forward: true })
    }

    /// The time at which θ is at `level`, s.
    fn time_at(&self, level: &Rational) -> Real {
        let (cruise_from, cruise_s) = &self.sped_up;
        match &self.rates {
            Some((acceleration, _)) if level < cruise_from => real(&(Rational::from(2) * level / acceleration)).sqrt(),
            Some((_, deceleration)) if *level > self.slow_down.0 => {
                // Seen from the end, slowing down is speeding up.
                let left = Rational::from(self.distance) - level;
                let end = &self.slow_down.1 + &self.speed / deceleration;
                real(&end) - real(&(Rational::from(2) * left / deceleration)).sqrt()
            }
            _ => real(&(cruise_s + (level - cruise_from) / &self.speed)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_move_with_round_numbers() {
        // 100 steps/s: 50 steps and 1 s to get there at 100 steps/s², 25 steps and ½ s to stop at 200 steps/s².
        let law = Trapezoid::new(175, rational(100, 1), rational(100, 1), rational(200, 1));
        let steps: Vec<_> = law.crossings(&rational(1, 2)).collect();
        assert_eq!(steps.len(), 175);
        let check = |step: usize, expected: Rational| {
            let expected = real(&expected);
            let error = (&steps[step - 1].seconds - expected).to_f64().value();
            assert!(error.abs() < 1e-50, "step {step}: off by {error} s");
        };
        check(2, rational(1, 5)); // ½·100·0.2² = 2
        check(50, rational(1, 1));
        check(51, rational(101, 100));
        check(150, rational(2, 1));
        check(175, rational(5, 2));
        check(174, rational(24, 10)); // ½·200·0.1² = 1 step from the end
    }
}
