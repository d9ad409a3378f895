//! Stretches of a piece on which θ only rises or only falls, split at proven turning points.

use pulsetrain_motion::law::{Bounds, Curve, Inverse, Piece};

/// A window in which θ changes by less than this is not searched for turning points, steps. It is far less than a
/// touch.
const STILL: f64 = 1e-11;

/// Precision of turning points where a curve is known better than f64 holds, ticks: far less than the rounding to whole
/// ticks.
const SHARP_TICKS: f64 = 1e-3;

/// A stretch comes to rest if its speed at the end is below this part of its mean speed.
const AT_REST: f64 = 1e-6;

/// A monotone part of a piece.
#[derive(Clone, Debug)]
pub(crate) struct Stretch {
    pub(crate) curve: std::sync::Arc<Curve>,
    pub(crate) bounds: Bounds,
    /// In the curve's own time, s.
    pub(crate) from: f64,
    pub(crate) to: f64,
    /// The curve's values there, steps.
    pub(crate) value_from: f64,
    pub(crate) value_to: f64,
    /// A formula for its step times, if there is one.
    pub(crate) inverse: Option<Inverse>,
    /// The turning point at its end; `None` where the piece ends.
    turn: Option<Turn>,
    /// How far θ goes on in this direction in the next piece, steps. Infinite if θ comes to rest there, because then it
    /// is the next piece that decides whether θ touches a level.
    pub(crate) onward: f64,
}

impl Stretch {
    pub(crate) fn rises(&self) -> bool {
        self.value_to > self.value_from
    }

    /// How far θ goes on in `next`, the first stretch of the piece that begins where this one ends and lasts until
    /// `end`.
    pub(crate) fn onward_in(&self, next: &Stretch, end: f64) -> f64 {
        if next.rises() != self.rises() {
            return 0.0;
        }
        let way = (next.value_to - next.value_from).abs();
        let is_slow = next.curve.jet(next.to)[1].abs() * (next.to - next.from) < AT_REST * way;
        if next.to < end || is_slow { f64::INFINITY } else { way }
    }

    /// The earliest and latest time of its end, s. Where the curve is known better than f64 holds, that is from the
    /// last time at which the speed provably has its sign to the first at which it provably has the opposite one.
    pub(crate) fn end(&self, tick_hz: f64) -> (f64, f64) {
        let Some(turn) = self.turn else { return (self.to, self.to) };
        let close = SHARP_TICKS / tick_hz;
        // A bound that is NaN is no bound.
        let doubt = (self.curve.jet(self.to)[1].abs() + self.bounds.rounding[1]) / turn.least.max(0.0);
        let (low, high) = ((self.to - doubt).max(turn.window.0), (self.to + doubt).min(turn.window.1));
        let rises = self.rises();
        // Whether θ provably goes on, and whether it provably goes back.
        let way = |u: f64| match self.curve.accurate_speed(u) {
            Some((speed, doubt)) if speed.abs() > doubt => ((speed > 0.0) == rises, (speed > 0.0) != rises),
            _ => (false, false),
        };
        if high - low <= close || !way(low).0 || !way(high).1 {
            return (low, high);
        }
        let bisected = |is_before: &dyn Fn(f64) -> bool| {
            let (mut low, mut high) = (low, high);
            while high - low > close {
                let middle = 0.5 * (low + high);
                if middle <= low || middle >= high {
                    break;
                }
                if is_before(middle) { low = middle } else { high = middle }
            }
            (low, high)
        };
        (bisected(&|u| way(u).0).0, bisected(&|u| !way(u).1).1)
    }
}

/// The stretches of a piece, in order. A constant piece has none.
pub(crate) fn stretches(piece: &Piece, tick_hz: f64) -> Vec<Stretch> {
    let (from, to) = (piece.first(), piece.last());
    let curve = std::sync::Arc::new(piece.curve.clone());
    let bounds = curve.bounds(from, to);
    let whole = curve.inverse(from, to);
    let mut ends = if whole.is_some() { Vec::new() } else { turning_points(&curve, &bounds, from, to, tick_hz) };
    ends.push((to, None));
    let mut stretches = Vec::with_capacity(ends.len());
    let (mut start, mut value_from) = (from, curve.value(from));
    for (end, turn) in ends {
        let value_to = curve.value(end);
        if end > start && value_to != value_from {
            stretches.push(Stretch {
                curve: curve.clone(),
                bounds,
                from: start,
                to: end,
                value_from,
                value_to,
                inverse: whole.or_else(|| curve.inverse(start, end)),
                turn,
                onward: 0.0,
            });
        }
        (start, value_from) = (end, value_to);
    }
    stretches
}

/// A turning point, and what is known of it.
#[derive(Clone, Copy, Debug)]
struct Turn {
    /// The window in which it is, s.
    window: (f64, f64),
    /// Smallest magnitude of the acceleration there, steps/s²; not positive if none is proven.
    least: f64,
}

/// Every time in `from..=to` where the speed changes its sign, to within a quarter of a tick.
///
/// A window is skipped when its speed provably keeps its sign, searched for one root when its acceleration provably
/// does, and halved otherwise.
fn turning_points(curve: &Curve, bounds: &Bounds, from: f64, to: f64, tick_hz: f64) -> Vec<(f64, Option<Turn>)> {
    let shortest = 0.25 / tick_hz;
    let mut found = Vec::new();
    let mut start = from;
    let mut half = (to - from) * 0.5;
    while start < to {
        half = half.min((to - start) * 0.5);
        let middle = start + half;
        let c = curve.jet(middle);
        // Σ_{k≥2} k|c_k|x^(k−1) and Σ_{k≥3} k(k−1)|c_k|x^(k−2), rounding and the eighth order included.
        let (mut bend, mut twist) = (8.0 * bounds.eighth * half, 56.0 * bounds.eighth * half);
        for k in (2..8).rev() {
            let (order, size) = (k as f64, c[k].abs() + bounds.rounding[k]);
            bend = (bend + order * size) * half;
            if k >= 3 {
                twist = (twist + order * (order - 1.0) * size) * half;
            }
        }
        let end = start + 2.0 * half;
        // Where θ stands still, the sign is that of rounding errors. Turning points there move nothing and are not
        // searched.
        let still = (c[1].abs() + bend + bounds.rounding[1]) * 2.0 * half < STILL;
        let passed = c[1].abs() > bend + bounds.rounding[1];
        // The smallest magnitude of the acceleration.
        let least = 2.0 * (c[2].abs() - bounds.rounding[2]) - twist;
        if passed || still || least > 0.0 || half <= shortest {
            // Where rounding has the sign the curve's terms tell it, if it has any; else there is a turn if both sides of a rest say so.
            let speed = |u: f64| {
                let speed = curve.jet(u)[1];
                if speed.abs() > bounds.rounding[1] {
                    return speed;
                }
                match curve.accurate_speed(u) {
                    Some((speed, doubt)) => {
                        if speed.abs() > doubt {
                            speed
                        } else {
                            0.0
                        }
                    }
                    None => {
                        if still {
                            f64::NAN
                        } else {
                            speed
                        }
                    }
                }
            };
            if !passed && let Some(at) = root(curve, speed, start, end, 1e-2 * shortest).filter(|root| *root < to) {
                found.push((at, Some(Turn { window: (start, end), least })));
            }
            if end <= start {
                break;
            }
            start = end.min(to);
            half *= 1.6;
        } else {
            half *= 0.5;
        }
    }
    found
}

/// The place between `low` and `high` where the speed changes its sign, if it does.
fn root(curve: &Curve, speed: impl Fn(f64) -> f64, mut low: f64, mut high: f64, width: f64) -> Option<f64> {
    let (at_low, at_high) = (speed(low), speed(high));
    if at_low.is_nan() || at_high.is_nan() {
        return None;
    }
    // At rest exactly at an end: the window before this one has handled `low`.
    if at_low == 0.0 || at_high == 0.0 {
        return (at_low != 0.0).then_some(high);
    }
    let rising_at_low = at_low > 0.0;
    if rising_at_low == (at_high > 0.0) {
        return None;
    }
    let mut x = 0.5 * (low + high);
    while high - low > width {
        let here = speed(x);
        if (here > 0.0) == rising_at_low {
            low = x
        } else {
            high = x
        }
        let newton = x - here / (2.0 * curve.jet(x)[2]);
        if newton > low && newton < high {
            if (newton - x).abs() < width * 1e-3 {
                return Some(newton);
            }
            x = newton;
        } else {
            x = 0.5 * (low + high);
        }
        if x <= low || x >= high {
            break;
        }
    }
    Some(x)
}
