//! A constant speed and sinusoids.

use crate::crossing::{BITS, Crossing, Rational, Real, rational, real};
use dashu::base::Abs;

/// θ = speed·t + Σ amplitude·sin(omega·t): laws without closed step times.
#[derive(Clone, Debug)]
pub struct Waves {
    /// The constant speed, steps/s.
    pub speed: Rational,
    /// The sinusoids.
    pub waves: Vec<Wave>,
}

/// One sinusoid: amplitude·sin(omega·t).
#[derive(Clone, Debug)]
pub struct Wave {
    /// The amplitude, steps.
    pub amplitude: Rational,
    /// The angular frequency, rad/s, positive.
    pub omega: Rational,
}

impl Waves {
    /// All steps of 0..=`end_s`, in order, on a grid of hysteresis h (0 < h ≤ ½).
    ///
    /// Samples in f64, `samples` per second, find which levels are crossed and about when; Newton's iteration then gives the exact time. An excursion that
    /// begins and ends between two samples is missed: there must be enough of them.
    ///
    /// # Panics
    /// If an iteration leaves the interval between its two samples: then `samples` is too small.
    pub fn crossings(&self, hysteresis: &Rational, end_s: u32, samples: u32) -> Vec<Crossing> {
        let exact_offset = real(&(rational(1, 2) + hysteresis));
        let offset = exact_offset.to_f64().value();
        let law = self.in_f64();
        let (mut position, mut found) = (0_i64, Vec::new());
        for sample in 1..=u64::from(end_s) * u64::from(samples) {
            let t = sample as f64 / f64::from(samples);
            let theta = value(&law, t);
            // More than one level may lie between two samples.
            while (theta - position as f64).abs() >= offset {
                let forward = theta > position as f64;
                let level =
                    if forward { Real::from(position) + &exact_offset } else { Real::from(position) - &exact_offset };
                let seconds = self.refine(&level, t);
                let early = t - seconds.to_f64().value();
                assert!(
                    (-1e-12..1.5 / f64::from(samples)).contains(&early),
                    "level {level} was crossed {early} s before {t} s"
                );
                found.push(Crossing { seconds, forward });
                position += if forward { 1 } else { -1 };
            }
        }
        found
    }

    /// The root of θ = `level` near `guess_s`.
    fn refine(&self, level: &Real, guess_s: f64) -> Real {
        let speed = real(&self.speed);
        let mut t = Real::try_from(guess_s).expect("a finite time").with_precision(BITS).value();
        loop {
            let mut theta = &speed * &t;
            let mut slope = speed.clone();
            for wave in &self.waves {
                let (amplitude, omega) = (real(&wave.amplitude), real(&wave.omega));
                let (sine, cosine) = (&omega * &t).sin_cos();
                theta += &amplitude * sine;
                slope += amplitude * omega * cosine;
            }
            let change = (theta - level) / slope;
            t -= &change;
            // Newton's iteration squares the error: the next one would be below 1e-50 s.
            if change.abs().to_f64().value() < 1e-26 {
                return t;
            }
        }
    }

    fn in_f64(&self) -> (f64, Vec<(f64, f64)>) {
        let float = |value: &Rational| real(value).to_f64().value();
        (float(&self.speed), self.waves.iter().map(|w| (float(&w.amplitude), float(&w.omega))).collect())
    }
}

fn value((speed, waves): &(f64, Vec<(f64, f64)>), t: f64) -> f64 {
    speed * t + waves.iter().map(|(amplitude, omega)| amplitude * (omega * t).sin()).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 100·sin(t) has closed step times: Newton's must be those.
    #[test]
    fn one_wave_steps_where_arc_sines_say() {
        let law = Waves { speed: Rational::ZERO, waves: vec![Wave { amplitude: 100.into(), omega: 1.into() }] };
        let steps = law.crossings(&rational(1, 64), 4, 10_000);
        let up: Vec<_> = steps.iter().filter(|s| s.forward).collect();
        assert_eq!(up.len(), 100);
        for (n, step) in up.iter().enumerate() {
            let level = rational(n as i128, 1) + rational(33, 64);
            let exact = real(&(level / Rational::from(100))).asin();
            let error = (&step.seconds - exact).to_f64().value();
            assert!(error.abs() < 1e-50, "step {n}: off by {error} s");
        }
        // From 100 down to 100·sin(4) = −75.7, past −75 − 33/64: to position −76.
        assert_eq!(steps.len() - up.len(), 176);
    }
}
