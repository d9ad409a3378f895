//! The largest speed or acceleration of a curve, enclosed.

use pulsetrain_motion::law::{Bounds, Curve};

/// Most windows of a piece that are examined. No law that a board can follow needs as many.
const MOST_WINDOWS: u32 = 1 << 18;

/// Largest |k-th derivative| of the curve on `from..=to`, with its place. The result is at least `known`, and at most a
/// factor of 1 + `precision` below the true maximum (if that is above `known`). `order` is 1 or 2.
///
/// Windows whose Taylor bound cannot exceed the best value found are skipped, the others are halved. If that takes too
/// many windows, the error is the place where the search ended.
pub(crate) fn peak(
    curve: &Curve,
    bounds: &Bounds,
    (from, to): (f64, f64),
    order: usize,
    known: f64,
    precision: f64,
) -> Result<(f64, Option<f64>), f64> {
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
    let mut tried = 0;
    while let Some((middle, half)) = windows.pop() {
        tried += 1;
        if tried > MOST_WINDOWS {
            return Err(middle);
        }
        let c = curve.jet(middle);
        let value = factorial * c[order].abs();
        if value > best.0 {
            best = (value, Some(middle));
        }
        // Σ_{k>order} k!/(k−order)! |c_k| half^(k−order)
        let falling = |k: usize| (if order == 1 { k } else { k * (k - 1) }) as f64;
        let rest = (order + 1..8)
            .rev()
            .fold(falling(8) * bounds.eighth * half, |sum, k| (sum + falling(k) * c[k].abs()) * half);
        // Where terms cancel, only rounding is left, in which there is no peak to look for.
        let noise = factorial * bounds.rounding[order];
        if value + rest > best.0 * (1.0 + precision) + noise && half > shortest {
            let quarter = half * 0.5;
            windows.push((middle - quarter, quarter));
            windows.push((middle + quarter, quarter));
        }
    }
    Ok(best)
}
