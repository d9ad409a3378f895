//! Laws that several tests and benches plan.

use pulsetrain_motion::Time;
use pulsetrain_motion::law::{Class, Curve, Entry, Fixed, Law, Piece, Sine};
use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

/// The variants of the tutorial: period, s, as a ratio; cycles. The last is not in it: a period of 10 h.
pub(crate) const TUTORIAL: [(i64, u64, u64); 9] =
    [(500, 1, 1), (10, 1, 1), (3, 1, 1), (3, 2, 10), (1, 1, 1), (4, 5, 1), (1, 10, 1), (1, 100, 1), (36_000, 1, 1)];

/// A − A·cos(2πt/T) for some cycles.
pub(crate) fn sine(amplitude: f64, period: Time, cycles: u64) -> Law {
    Law::Sine(Sine { amplitude, period, cycles: Some(cycles) })
}

/// speed·t + Σ amplitude·sin(omega·t) for `end_s` seconds.
pub(crate) fn waves(speed: f64, waves: &[(f64, f64)], end_s: f64) -> Law {
    let mut curves = vec![Curve::Polynomial(vec![0.0, speed])];
    curves.extend(waves.iter().map(|&(amplitude, omega)| Curve::Cosine {
        offset: 0.0,
        amplitude,
        omega,
        // sin x = cos(x − π/2)
        phase: -FRAC_PI_2,
    }));
    fixed(Class::Enclosed, vec![(Curve::Sum(curves), end_s)])
}

/// `distance` steps from rest to rest at `speed`, with one acceleration; steps and seconds.
pub(crate) fn trapezoid(distance: f64, speed: f64, acceleration: f64) -> Law {
    let ramp_s = speed / acceleration;
    let ramp = speed * ramp_s / 2.0;
    let cruise = distance - 2.0 * ramp;
    let curves = [
        (vec![0.0, 0.0, acceleration / 2.0], ramp_s),
        (vec![ramp, speed], cruise / speed),
        (vec![ramp + cruise, speed, -acceleration / 2.0], ramp_s),
    ];
    fixed(Class::ClosedForm, curves.map(|(c, s)| (Curve::Polynomial(c), s)).to_vec())
}

/// A constant speed, steps/s.
pub(crate) fn constant_speed(speed: f64, end_s: f64) -> Law {
    fixed(Class::ClosedForm, vec![(Curve::Polynomial(vec![0.0, speed]), end_s)])
}

/// Curves one after the other, each with its own time from 0 s and its duration, s.
fn fixed(class: Class, curves: Vec<(Curve, f64)>) -> Law {
    let mut start = Time::ZERO;
    let pieces = curves
        .into_iter()
        .map(|(curve, seconds)| {
            let piece_start = start;
            start = start + Time::from_seconds(seconds);
            Piece { zero: piece_start, start: piece_start, end: start, origin: 0, curve, entry: Entry::Continuous }
        })
        .collect();
    Law::Fixed(Fixed { pieces: Arc::new(pieces), class })
}
