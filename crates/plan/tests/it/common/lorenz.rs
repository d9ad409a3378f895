//! A law that nobody can write down: an integral along the Lorenz attractor, by Taylor series.

use pulsetrain_motion::Time;
use pulsetrain_motion::law::{Class, Curve, Entry, Fixed, Law, Piece};

/// Coefficients of each series: they serve for some 20 ms on either side.
const TERMS: usize = 36;
/// What the last term may amount to at a piece's end, relative to the largest: below f64's rounding.
const LAST_TERM: f64 = 1e-16;
/// Start, Lorenz's own parameters σ = 10, ρ = 28, β = 8/3.
const START: [f64; 3] = [1.0, 1.0, 25.0];
const SIGMA: f64 = 10.0;
const RHO: f64 = 28.0;
const BETA: f64 = 8.0 / 3.0;

type Series = [f64; TERMS];

/// θ = `scale`·∫x dt, steps, along the orbit from [`START`], over `end_s` seconds.
pub(crate) fn lorenz(scale: f64, end_s: f64) -> Law {
    let mut pieces = Vec::new();
    let (mut state, mut position, mut start) = (START, 0.0, Time::ZERO);
    while start.seconds() < end_s {
        // Expanded at its start to find the middle, and there for the piece: a series serves on both sides.
        let series = expand(state);
        let half_s = reach(&series).min((end_s - start.seconds()) / 2.0);
        let middle = expand(series.map(|series| value(&series, half_s)));
        let mut curve = vec![0.0];
        curve.extend(middle[0].iter().zip(1..).map(|(x, k)| scale * x / f64::from(k)));
        curve[0] = position - value(&curve, -half_s);
        position = value(&curve, half_s);
        state = middle.map(|series| value(&series, half_s));
        let half = Time::from_seconds(half_s);
        let (zero, end) = (start + half, start + half + half);
        let curve = Curve::Polynomial(curve);
        pieces.push(Piece { zero, start, end, origin: 0, curve, entry: Entry::Continuous });
        start = end;
    }
    Law::Fixed(Fixed { pieces: pieces.into(), class: Class::Interpolant })
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
    // One of the last terms may happen to be small.
    let last = (TERMS - 4..TERMS).map(size).fold(f64::MIN_POSITIVE, f64::max);
    (LAST_TERM * size(0) / last).powf(1.0 / (TERMS - 1) as f64)
}

fn value(series: &[f64], u: f64) -> f64 {
    series.iter().rev().fold(0.0, |sum, c| sum * u + c)
}
