//! A law that nobody can write down: an integral along the Lorenz attractor, by Taylor series.

use pulsetrain_motion::Time;
use pulsetrain_motion::law::{Class, Curve, Entry, Fixed, Law, Piece};
use std::sync::Arc;

/// Coefficients of each series: 24 of them are good for about 0.05 s.
const TERMS: usize = 24;
/// What the last term may amount to at a piece's end, relative to the largest: below f64's rounding.
const LAST_TERM: f64 = 1e-18;
/// Start, Lorenz's own parameters σ = 10, ρ = 28, β = 8/3.
const START: [f64; 3] = [1.0, 1.0, 25.0];
const SIGMA: f64 = 10.0;
const RHO: f64 = 28.0;
const BETA: f64 = 8.0 / 3.0;

type Series = [f64; TERMS];

/// θ = `scale`·∫x dt, steps, along the orbit from [`START`], over `end_s` seconds.
pub(crate) fn lorenz(scale: f64, end_s: f64) -> Law {
    let mut pieces = Vec::new();
    let (mut state, mut position, mut start_s) = (START, 0.0, 0.0);
    while start_s < end_s {
        // Expanded at the start to find the middle, and at the middle for the piece itself: half the reach for |u|.
        let ahead = expand(state);
        let half = (reach(&ahead) / 2.0).min((end_s - start_s) / 2.0);
        let middle = expand(ahead.map(|series| value(&series, half)));
        let mut curve = vec![0.0];
        curve.extend(middle[0].iter().enumerate().map(|(k, x)| scale * x / (k + 1) as f64));
        // The curve's constant makes it begin where the piece before ended.
        let before = curve.iter().rev().fold(0.0, |sum, c| sum * -half + c);
        let origin = f64::floor(position);
        curve[0] = position - origin - before;
        position = origin + curve.iter().rev().fold(0.0, |sum, c| sum * half + c);
        let at = |seconds| Time::from_seconds(seconds);
        pieces.push(Piece {
            zero: at(start_s) + at(half),
            start: at(start_s),
            end: at(start_s + 2.0 * half),
            origin: origin as i64,
            curve: Curve::Polynomial(curve),
            entry: Entry::Continuous,
        });
        state = middle.map(|series| value(&series, half));
        start_s += 2.0 * half;
    }
    Law::Fixed(Fixed { pieces: Arc::new(pieces), class: Class::Interpolant })
}

/// The Taylor series of x, y and z from a state on.
fn expand(state: [f64; 3]) -> [Series; 3] {
    let [mut x, mut y, mut z] = [[0.0; TERMS]; 3];
    [x[0], y[0], z[0]] = state;
    for k in 0..TERMS - 1 {
        // Cauchy products: coefficient k of x·z and of x·y.
        let xz: f64 = (0..=k).map(|j| x[j] * z[k - j]).sum();
        let xy: f64 = (0..=k).map(|j| x[j] * y[k - j]).sum();
        let next = (k + 1) as f64;
        x[k + 1] = SIGMA * (y[k] - x[k]) / next;
        y[k + 1] = (RHO * x[k] - xz - y[k]) / next;
        z[k + 1] = (xy - BETA * z[k]) / next;
    }
    [x, y, z]
}

/// How far a state's series serve, s.
fn reach(series: &[Series; 3]) -> f64 {
    let size = |k: usize| series.iter().map(|s| s[k].abs()).fold(0.0, f64::max);
    let last = size(TERMS - 1).max(size(TERMS - 2)).max(f64::MIN_POSITIVE);
    (LAST_TERM * size(0) / last).powf(1.0 / (TERMS - 1) as f64)
}

fn value(series: &Series, u: f64) -> f64 {
    series.iter().rev().fold(0.0, |sum, c| sum * u + c)
}
