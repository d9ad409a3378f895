//! A law that nobody can write down: an integral along the Lorenz attractor, by Taylor series.

use pulsetrain_motion::{Law, Time};

/// Coefficients of each series: 24 of them are good for some 20 ms.
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
    let (mut state, mut position, mut at_s) = (START, 0.0, 0.0);
    while at_s < end_s {
        let series = expand(state);
        let duration_s = reach(&series).min(end_s - at_s);
        let mut curve = vec![position];
        curve.extend(series[0].iter().zip(1..).map(|(x, k)| scale * x / f64::from(k)));
        position = value(&curve, duration_s);
        pieces.push((Time::from_seconds(duration_s), curve));
        state = series.map(|series| value(&series, duration_s));
        at_s += duration_s;
    }
    Law::polynomials(pieces).expect("pieces that meet")
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

fn value(series: &[f64], u: f64) -> f64 {
    series.iter().rev().fold(0.0, |sum, c| sum * u + c)
}
