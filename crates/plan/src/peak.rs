//! The largest speed or acceleration of a curve, enclosed.

use pulsetrain_motion::law::{Bounds, Curve};

/// Largest |k-th derivative| of the curve on `from..=to`, with where it is: at least `known`, at most a
/// factor of 1 + `precision` below the true maximum (if that is above `known`). `order` is 1 or 2.
///
/// Windows whose Taylor bound cannot beat the best value found are passed over, the others halved.
pub(crate) fn peak(
    curve: &Curve,
    bounds: &Bounds,
    (from, to): (f64, f64),
    order: usize,
    known: f64,
    precision: f64,
) -> (f64, Option<f64>) {
    let factorial: f64 = (1..=order).map(|k| k as f64).product();
    let mut best = (known, None);
    for end in [from, to] {
        let value = factorial * curve.jet(end)[order].abs();
        if value > best.0 {
            best = (value, Some(end));
        }
    }
    let mut windows = vec![(0.5 * (from + to), 0.5 * (to - from))];
    let shortest = (to - from) * 1e-9;
    while let Some((middle, half)) = windows.pop() {
        let c = curve.jet(middle);
        let value = factorial * c[order].abs();
        if value > best.0 {
            best = (value, Some(middle));
        }
        // Σ_{k>order} k!/(k−order)! |c_k| half^(k−order)
        let falling = |k: usize| (k - order + 1..=k).map(|k| k as f64).product::<f64>();
        let rest = (order + 1..8)
            .rev()
            .fold(falling(8) * bounds.eighth * half, |sum, k| (sum + falling(k) * c[k].abs()) * half);
        // Where terms cancel, rounding alone is left: no search for what it cannot tell.
        let noise = factorial * bounds.rounding[order];
        if value + rest > best.0 * (1.0 + precision) + noise && half > shortest {
            let quarter = half * 0.5;
            windows.push((middle - quarter, quarter));
            windows.push((middle + quarter, quarter));
        }
    }
    best
}
