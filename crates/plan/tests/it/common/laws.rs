//! Laws that several tests and benches plan.

use pulsetrain_motion::Time;
use pulsetrain_motion::law::{Class, Curve, Entry, Fixed, Law, Piece};
use std::f64::consts::FRAC_PI_2;

/// The variants of the tutorial: period, s, as a ratio; cycles. The last is not in it: a period of 10 h.
pub(crate) const TUTORIAL: [(i64, u64, u64); 9] =
    [(500, 1, 1), (10, 1, 1), (3, 1, 1), (3, 2, 10), (1, 1, 1), (4, 5, 1), (1, 10, 1), (1, 100, 1), (36_000, 1, 1)];

/// A − A·cos(2πt/T) for some cycles.
pub(crate) fn sine(amplitude: f64, period: Time, cycles: u64) -> Law {
    Law::sine(amplitude, period, Some(cycles)).expect("a sine")
}

/// `distance` steps from rest to rest at `speed`, with one acceleration; steps and seconds.
pub(crate) fn trapezoid(distance: f64, speed: f64, acceleration: f64) -> Law {
    Law::trapezoid(distance, speed, acceleration, acceleration).expect("a trapezoid")
}

/// A constant speed, steps/s.
pub(crate) fn constant_speed(speed: f64, end_s: f64) -> Law {
    Law::speed(speed, Some(Time::from_seconds(end_s))).expect("a speed")
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
    let curve = Curve::Sum(curves);
    let end = Time::from_seconds(end_s);
    let piece = Piece { zero: Time::ZERO, start: Time::ZERO, end, origin: 0, curve, entry: Entry::Continuous };
    Law::Fixed(Fixed { pieces: vec![piece].into(), class: Class::Enclosed })
}
