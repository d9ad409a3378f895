//! The local inverse t(s) of a law, with a proven remainder.
//!
//! A run of steps in one direction has its own coordinate s, in which the law rises and step j is due when s = j.
//! Times are ticks from the run's origin; see [`Frame`].

use pulsetrain_motion::law::{Bounds, Curve, Inverse, Jet};
use pulsetrain_motion::whole_power;

/// Relative error of one rounding.
pub(crate) const ULP: f64 = f64::EPSILON / 2.0;

/// How a run sees a curve: in its direction, counted in its steps, timed in ticks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame {
    /// +1 when θ rises, −1 when it falls.
    pub(crate) sign: f64,
    /// The curve's value at s = 0.
    pub(crate) zero: f64,
    /// The rounding error of `zero`, steps: the true value is the sum of both.
    pub(crate) zero_low: f64,
    /// Ticks per second.
    pub(crate) tick_hz: f64,
}

impl Frame {
    /// s of a turning point at x0, and its rounding error: the true turning point is at the sum of both.
    pub(crate) fn turn(&self, x0: f64) -> (f64, f64) {
        let (turn, lost) = two_sum(x0, -self.zero);
        (turn * self.sign, (lost - self.zero_low) * self.sign)
    }

    /// Largest rounding error of a position that comes from subtracting x0, steps.
    fn doubt(&self, x0: f64, s: f64) -> f64 {
        4.0 * ULP * (x0.abs() + self.zero.abs() + s.abs()) + self.zero_low.abs()
    }
}

/// a + b, and the exact rounding error of the sum (Knuth).
pub(crate) fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let b_part = sum - a;
    (sum, (a - (sum - b_part)) + (b - b_part))
}

/// The time of s by a closed formula, and its largest error, ticks. A level that is beyond the turning point by no more
/// than a touch is due at the turning point. `None` for curves for which the series is as good.
pub(crate) fn exact_due(frame: &Frame, inverse: &Inverse, s: f64) -> Option<(f64, f64)> {
    let (u0, (turn, lost), doubt) = match *inverse {
        Inverse::Parabola { u0, x0, doubt, .. } | Inverse::Arccosine { u0, x0, doubt, .. } => {
            (u0, frame.turn(x0), doubt)
        }
        Inverse::Line { .. } | Inverse::Quadratic { .. } => return None,
    };
    // From the turning point to s, steps.
    let gone = (s - turn) - lost;
    let at = |gone: f64| match *inverse {
        Inverse::Parabola { half_acceleration, later, .. } => {
            let side = if later { 1.0 } else { -1.0 };
            u0 * frame.tick_hz + side * frame.tick_hz * ((side * gone).max(0.0) / half_acceleration.abs()).sqrt()
        }
        Inverse::Arccosine { swing, omega, .. } => {
            let swing = swing.abs();
            arccosine_tick(frame, u0, swing, omega, gone.clamp(0.0, swing))
        }
        Inverse::Line { .. } | Inverse::Quadratic { .. } => 0.0,
    };
    let tick = at(gone);
    let doubt = doubt + 4.0 * ULP * lost.abs();
    // The formula is monotone, so the times of both ends of the doubt enclose the true one.
    let spread = if doubt > 0.0 { (at(gone + doubt) - tick).abs().max((tick - at(gone - doubt)).abs()) } else { 0.0 };
    let rounding = 8.0 * ULP * (tick.abs() + (tick - u0 * frame.tick_hz).abs());
    Some((tick, spread + rounding))
}

/// t(s) ≈ `tick` + Σ q_k (s − center)^k, ticks of the curve's own time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Expansion {
    /// The place at which the series was made, s.
    pub(crate) center: f64,
    /// t(center), ticks.
    pub(crate) tick: f64,
    /// q_1..q_7; q_0 is 0.
    pub(crate) q: [f64; 8],
    remainder: Remainder,
    /// Largest rounding error of s, steps.
    doubt: f64,
    /// Largest rounding error of `tick`, ticks.
    tick_doubt: f64,
}

#[derive(Clone, Copy, Debug)]
enum Remainder {
    /// Coefficients of t' are at most `slope`/`radius`^k: the nearest singularity is `radius` steps away, or none.
    Closed { slope: f64, radius: f64 },
    /// Reverted from a jet of the law.
    Reverted { c: Jet, eighth: f64, rounding: Jet },
}

impl Expansion {
    /// From a jet of the curve at its time `u`, s.
    pub(crate) fn from_jet(frame: &Frame, curve: &Curve, bounds: &Bounds, u: f64) -> Option<Expansion> {
        let mut c = curve.jet(u);
        let mut rounding = bounds.rounding;
        rounding[0] += ULP * (c[0].abs() + frame.zero.abs()) + frame.zero_low.abs();
        c[0] = (c[0] - frame.zero) * frame.sign;
        let per_tick = frame.tick_hz.recip();
        let mut scale = 1.0;
        for k in 1..8 {
            scale *= per_tick;
            c[k] *= frame.sign * scale;
            rounding[k] *= scale;
        }
        if c[1] <= 0.0 || !c.iter().all(|c| c.is_finite()) {
            return None;
        }
        let eighth = bounds.eighth * scale * per_tick;
        Some(Expansion {
            center: c[0],
            tick: u * frame.tick_hz,
            q: reverted(&c),
            remainder: Remainder::Reverted { c, eighth, rounding },
            doubt: 0.0,
            tick_doubt: 4.0 * ULP * (u * frame.tick_hz).abs(),
        })
    }

    /// From a formula for the inverse, at s = `center` or the nearest place where the series has a radius.
    pub(crate) fn from_inverse(frame: &Frame, inverse: &Inverse, center: f64) -> Expansion {
        let hz = frame.tick_hz;
        let mut q = [0.0; 8];
        match *inverse {
            Inverse::Line { u0, x0, speed } => {
                // u = u0 + (x − x0)/speed with x = zero + sign·s.
                q[1] = frame.sign * hz / speed;
                let tick = u0 * hz + ((frame.zero - x0) + frame.sign * center) * hz / speed;
                let remainder = Remainder::Closed { slope: q[1].abs(), radius: f64::INFINITY };
                let tick_doubt = 4.0 * ULP * ((u0 * hz).abs() + tick.abs());
                Expansion { center, tick, q, remainder, doubt: frame.doubt(x0, center), tick_doubt }
            }
            Inverse::Quadratic { x0, c } => {
                let x = (frame.zero - x0) + frame.sign * center;
                q[1] = frame.sign * (c[1] + 2.0 * c[2] * x) * hz;
                q[2] = c[2] * hz;
                // A series of two terms has no singularity.
                let remainder = Remainder::Closed { slope: q[1].abs(), radius: f64::INFINITY };
                let tick = (c[0] + (c[1] + c[2] * x) * x) * hz;
                let tick_doubt = 4.0 * ULP * ((c[0].abs() + (c[1].abs() + (c[2] * x).abs()) * x.abs()) * hz);
                Expansion { center, tick, q, remainder, doubt: frame.doubt(x0, center), tick_doubt }
            }
            Inverse::Parabola { u0, x0, half_acceleration, later, doubt } => {
                // Distance from the turning point in s: d = sign·(x − x0)·side, u = u0 ± √(d/|half_acceleration|).
                let side = if later { 1.0 } else { -1.0 };
                let (turn, lost) = frame.turn(x0);
                let distance = (side * (center - turn)).max(0.125);
                let center = turn + side * distance;
                let root = hz * (distance / half_acceleration.abs()).sqrt();
                q[0] = side * root;
                let mut binomial = 0.5;
                for k in 1..8 {
                    q[k] = q[k - 1] * binomial * side / distance;
                    binomial = (0.5 - k as f64) / (k as f64 + 1.0);
                }
                q[0] = 0.0;
                let remainder = Remainder::Closed { slope: q[1].abs(), radius: distance };
                let tick_doubt = 6.0 * ULP * ((u0 * hz).abs() + root);
                Expansion { center, tick: u0 * hz + side * root, q, remainder, doubt: doubt + lost.abs(), tick_doubt }
            }
            Inverse::Arccosine { u0, x0, swing, omega, doubt } => {
                let swing = swing.abs();
                let (turn, lost) = frame.turn(x0);
                let near = 0.125f64.min(swing / 2.0);
                let gone = (center - turn).clamp(near, swing - near);
                // t' = 1/(ω√(g(swing − g))): its Taylor coefficients f_k by the recurrence of G f' = −G'/2 f.
                let (g, slope) = (gone * (swing - gone), swing - 2.0 * gone);
                let inverse_g = 1.0 / g;
                let mut f = [0.0; 7];
                f[0] = hz / omega * inverse_g.sqrt();
                f[1] = -0.5 * slope * f[0] * inverse_g;
                for k in 1..6 {
                    let order = k as f64;
                    f[k + 1] = -((order + 0.5) * slope * f[k] - order * f[k - 1]) * inverse_g / (order + 1.0);
                }
                for k in 0..7 {
                    q[k + 1] = f[k] / (k as f64 + 1.0);
                }
                let remainder = Remainder::Closed { slope: f[0], radius: gone.min(swing - gone) };
                let tick = arccosine_tick(frame, u0, swing, omega, gone);
                let tick_doubt = 4.0 * ULP * ((u0 * hz).abs() + tick.abs());
                Expansion { center: turn + gone, tick, q, remainder, doubt: doubt + lost.abs(), tick_doubt }
            }
        }
    }

    /// The approximate t at s, relative to the expansion's own tick.
    pub(crate) fn offset(&self, s: f64) -> f64 {
        let y = s - self.center;
        let q = &self.q;
        ((((((q[7] * y + q[6]) * y + q[5]) * y + q[4]) * y + q[3]) * y + q[2]) * y + q[1]) * y
    }

    /// A proven bound on |t(s) − approximation|, ticks, for s within `reach` of the center and t in `window` (ticks).
    ///
    /// `first` and `last` are the approximations at the ends of the range, relative to the expansion's tick.
    /// Infinite where nothing can be proven.
    pub(crate) fn remainder(&self, reach: f64, first: f64, last: f64, window: (f64, f64)) -> f64 {
        let span = first.abs().max(last.abs());
        // The tick itself, and the evaluation of the polynomial: a few roundings each.
        let rounding = self.tick_doubt + 16.0 * ULP * span;
        match &self.remainder {
            Remainder::Closed { slope, .. } if span == 0.0 => slope * self.doubt + rounding,
            Remainder::Closed { slope, radius } => {
                let z = reach / radius;
                if z > 0.9 {
                    return f64::INFINITY;
                }
                let z2 = z * z;
                let z4 = z2 * z2;
                // Σ_{k≥7} slope·radius·z^(k+1)/(k+1); each coefficient comes from at most 16 roundings, and the
                // slope in reach is at most slope/(1 − z), or linear where there is no singularity.
                let tail = if z > 0.0 { slope * radius * z4 * z4 / (8.0 * (1.0 - z)) } else { 0.0 };
                let steepest = (slope + 2.0 * self.q[2].abs() * reach) / (1.0 - z);
                tail + steepest * (32.0 * ULP * reach + self.doubt) + rounding
            }
            Remainder::Reverted { c, eighth, rounding: jet_rounding } => {
                let outside = (window.0 - (self.tick + first)).max(self.tick + last - window.1).max(0.0);
                reverted_remainder(c, &self.q, *eighth, jet_rounding, reach, outside) + rounding
            }
        }
    }
}

/// Time of s on half a period of a sinusoid that leaves its turning point at `u0`, ticks.
fn arccosine_tick(frame: &Frame, u0: f64, swing: f64, omega: f64, gone: f64) -> f64 {
    let fraction = gone / swing;
    let angle = if fraction < 0.5 {
        2.0 * libm::asin(fraction.sqrt())
    } else {
        std::f64::consts::PI - 2.0 * libm::asin(((swing - gone) / swing).sqrt())
    };
    u0 * frame.tick_hz + angle * (frame.tick_hz / omega)
}

/// Coefficients of the inverse series, degree 7.
///
/// Source: Abramowitz & Stegun, Handbook of Mathematical Functions, 3.6.25.
fn reverted(c: &Jet) -> [f64; 8] {
    let i = 1.0 / c[1];
    let (a2, a3, a4, a5, a6, a7) = (c[2] * i, c[3] * i, c[4] * i, c[5] * i, c[6] * i, c[7] * i);
    let (s2, s3) = (a2 * a2, a3 * a3);
    let b2 = -a2;
    let b3 = 2.0 * s2 - a3;
    let b4 = 5.0 * a2 * a3 - a4 - 5.0 * s2 * a2;
    let b5 = 6.0 * a2 * a4 + 3.0 * s3 + 14.0 * s2 * s2 - a5 - 21.0 * s2 * a3;
    let b6 = 7.0 * (a2 * a5 + a3 * a4) + 84.0 * s2 * a2 * a3 - a6 - 28.0 * (s2 * a4 + a2 * s3) - 42.0 * s2 * s2 * a2;
    let b7 = 8.0 * (a2 * a6 + a3 * a5) + 4.0 * a4 * a4 + 120.0 * s2 * a2 * a4 + 180.0 * s2 * s3 + 132.0 * s2 * s2 * s2
        - a7
        - 36.0 * s2 * a5
        - 72.0 * a2 * a3 * a4
        - 12.0 * s3 * a3
        - 330.0 * s2 * s2 * a3;
    let (i2, i3, i4) = (i * i, i * i * i, i * i * i * i);
    [0.0, i, b2 * i2, b3 * i3, b4 * i4, b5 * i4 * i, b6 * i4 * i2, b7 * i4 * i3]
}

/// Σ_{k≥1} |c_k| x^k.
fn majorant(c: &[f64; 8], x: f64) -> f64 {
    c[1..].iter().rev().fold(0.0, |sum, c| (sum + c.abs()) * x)
}

/// Bound on |Q(y) − t(n)| for |y| ≤ reach (facts: 2 and 3 of the proof in docs/design/proof.md).
///
/// `outside` is how far Q leaves the interval on which the law's eighth coefficient is bounded.
fn reverted_remainder(c: &Jet, q: &[f64; 8], eighth: f64, rounding: &Jet, reach: f64, outside: f64) -> f64 {
    // The inverse was truncated: A(B(y)) − y has terms of order ≥ 8 only. Cauchy's bound on them, best of three circles.
    let mut tail = f64::INFINITY;
    for (circle, weight) in
        [(6.0, 1.0 / (1_679_616.0 * (5.0 / 6.0))), (10.0, 1.0 / 0.9e8), (16.0, 1.0 / 4.026_531_84e9)]
    {
        tail = tail.min(majorant(c, majorant(q, reach * circle)) * weight);
    }
    let hull = majorant(q, reach);
    // The proof divides by the slowest speed between Q and the true time, so the hull must hold both.
    let slack = hull * 0.0625 + 0.25;
    let wide = hull + slack;
    let power7 = whole_power(wide, 7);
    let bend: f64 = (2..8).rev().fold(0.0, |sum, k| (sum + k as f64 * c[k].abs()) * wide);
    let rate = c[1] - bend - 8.0 * eighth * power7;
    if rate <= 0.0 {
        return f64::INFINITY;
    }
    let error_of_jet = rounding.iter().rev().fold(0.0, |sum, r| sum * wide + r) + 64.0 * ULP * majorant(c, hull);
    let fastest = c[1] + bend;
    let bound = (tail + eighth * power7 * wide + error_of_jet + fastest * outside) / rate + outside;
    if bound <= slack { bound } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_rounding_lost_of_the_turning_point_counts() {
        let power = f64::exp2;
        // The turning point is at x0 − zero = −(2^20 + 2^-31) + 2^-40, and f64 has no room for its last term; s is
        // 2^-32 above the rounded value.
        let zero = power(20.0) + power(-31.0);
        let frame = Frame { sign: 1.0, zero, zero_low: 0.0, tick_hz: 16e6 };
        let parabola = Inverse::Parabola { u0: 0.0, x0: power(-40.0), half_acceleration: 1.0, later: true, doubt: 0.0 };
        assert_eq!(frame.turn(power(-40.0)), (-zero, power(-40.0)));
        let (tick, error) = exact_due(&frame, &parabola, power(-32.0) - zero).expect("it has a formula");
        let exact = 16e6 * (power(-32.0) - power(-40.0)).sqrt();
        assert!((tick - exact).abs() <= error && error < 1e-6, "{tick} ± {error}, {exact}");
    }
}
