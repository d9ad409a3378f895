//! One segment through the expansion of a law: fit, quantise, bound.

use crate::expansion::{Expansion, ULP};
use pulsetrain_core::Segment;
use pulsetrain_motion::whole_power;

/// The differences with which the next segment would continue, and the units in which the stream corrects them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Quantiser {
    /// The differences after the segment before, ticks · 2^F.
    pub(crate) predicted: Segment,
    /// Units of the corrections, ticks · 2^F.
    pub(crate) units: [f64; 3],
    /// 2^F.
    pub(crate) scale: f64,
}

impl Quantiser {
    /// The predicted difference, `order` 0 the interval, 1 add, 2 add2.
    pub(crate) fn prediction(&self, order: usize) -> i64 {
        [self.predicted.interval, self.predicted.add, self.predicted.add2][order]
    }

    /// The nearest value that the stream can encode; `None` if it is out of range.
    pub(crate) fn round(&self, order: usize, value: f64) -> Option<i64> {
        const LARGEST: f64 = 4.6e18;
        let (predicted, unit) = (self.prediction(order), self.units[order]);
        // The units are powers of two, so multiples of them are exact in f64 and the sum is made in integers.
        let correction = ((value - predicted as f64) / unit).round_ties_even() * unit;
        (correction.abs() < LARGEST).then(|| predicted.checked_add(correction as i64)).flatten()
    }
}

/// The accumulator at the beginning of a segment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SegmentStart {
    /// Steps of the run that are done.
    pub(crate) done: f64,
    /// Accumulator minus ½, ticks of the curve's own time.
    pub(crate) tick: f64,
    /// Fraction bits of the accumulator, ticks · 2^F.
    pub(crate) fraction: i64,
    /// F.
    pub(crate) fraction_bits: u32,
}

/// A segment and what is proven of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fit {
    /// A wait before the segment, ticks.
    pub(crate) dwell: u64,
    pub(crate) segment: Segment,
    /// ≥ |scheduled − exact| of every step, ticks.
    pub(crate) bound: f64,
    /// The part of the bound that depends on the segment's length.
    pub(crate) misfit: f64,
}

/// Segments up to this length are replayed step by step; longer ones are bounded as polynomials.
const REPLAYED: u32 = 48;

/// The law over the next steps: t(done + x) − start, ticks.
struct Target<'a> {
    expansion: &'a Expansion,
    base: f64,
    done: f64,
}

impl Target<'_> {
    fn at(&self, x: f64) -> f64 {
        self.base + self.expansion.offset(self.done + x)
    }
}

/// The best segment of `count` steps, with its proof. The law's bounds hold within `window`, ticks.
pub(crate) fn fit(
    expansion: &Expansion,
    start: &SegmentStart,
    quantiser: &Quantiser,
    count: u32,
    window: (f64, f64),
) -> Option<Fit> {
    let target = Target { expansion, base: expansion.tick - start.tick, done: start.done };
    let segment = match count {
        1 => one_step(&target, quantiser),
        2 => two_steps(&target, quantiser),
        _ => cubic(&target, quantiser, count),
    }?;
    let (near, far) = (start.done + 1.0 - expansion.center, start.done + f64::from(count) - expansion.center);
    let (first, last) = (expansion.offset(start.done + 1.0), expansion.offset(start.done + f64::from(count)));
    let span = first.abs().max(last.abs()) + (expansion.tick - start.tick).abs();
    let proven = expansion.remainder(near.abs().max(far.abs()), first, last, window) + 64.0 * ULP * span;
    if !proven.is_finite() {
        return None;
    }
    let misfit = if count <= REPLAYED {
        replayed_misfit(&target, &segment, start) - 0.5
    } else {
        polynomial_misfit(&target, &segment, quantiser.scale)
    };
    // Subtracting T0 twice adds one more rounding. An interval that is not positive is invalid.
    (segment.interval > 0 && segment.after(count - 1).interval > 0).then_some(Fit {
        dwell: 0,
        segment,
        bound: 0.5 + misfit + proven,
        misfit: misfit + proven,
    })
}

fn one_step(target: &Target<'_>, quantiser: &Quantiser) -> Option<Segment> {
    let interval = quantiser.round(0, target.at(1.0) * quantiser.scale)?;
    Some(single(interval, quantiser))
}

/// A segment of one step. The differences that it does not use stay as predicted, which costs no bytes.
pub(crate) fn single(interval: i64, quantiser: &Quantiser) -> Segment {
    Segment { count: 1, interval, ..quantiser.predicted }
}

fn two_steps(target: &Target<'_>, quantiser: &Quantiser) -> Option<Segment> {
    let (r1, r2) = (target.at(1.0), target.at(2.0));
    let add = quantiser.round(1, (r2 - 2.0 * r1) * quantiser.scale)?;
    let interval = quantiser.round(0, (r2 * quantiser.scale - add as f64) * 0.5)?;
    Some(Segment { count: 2, interval, add, add2: quantiser.predicted.add2 })
}

/// A cubic through the start and three zeros of a Chebyshev polynomial T4 that is stretched so that it has the
/// start's own error at x = 0; the differences are rounded from the highest down, each refitting those below it.
fn cubic(target: &Target<'_>, quantiser: &Quantiser, count: u32) -> Option<Segment> {
    let m = f64::from(count);
    let scale = quantiser.scale;
    let x = if count <= 4 { [1.0, 2.0, m] } else { zeros(target, m) };
    // Divided differences of (target(x) − 0)/x: the cubic goes through (0, 0).
    let y = x.map(|x| target.at(x) / x);
    let (d01, d12) = ((y[1] - y[0]) / (x[1] - x[0]), (y[2] - y[1]) / (x[2] - x[1]));
    let p3 = (d12 - d01) / (x[2] - x[0]);
    let mut p2 = d01 - p3 * (x[0] + x[1]);
    let mut p1 = y[0] - d01 * x[0] + p3 * x[0] * x[1];
    let add2 = quantiser.round(2, 6.0 * p3 * scale)?;
    let add2_ticks = add2 as f64 / scale;
    // The rounding of x³ is made good by x² and x such that the error changes sign at .464 m and .928 m.
    let excess = add2_ticks - 6.0 * p3;
    p2 -= excess * (1.392_305 * m / 6.0);
    p1 += excess * (0.430_781 * m * m / 6.0);
    let ideal = 2.0 * p2 + add2_ticks;
    let add = quantiser.round(1, ideal * scale)?;
    let add_ticks = add as f64 / scale;
    let excess = add_ticks - ideal;
    // And that of x² by x, with a change of sign at .828 m.
    p1 -= excess * 0.5 * 0.828_427 * m;
    let interval = quantiser.round(0, (p1 + add_ticks * 0.5 - add2_ticks / 3.0) * scale)?;
    Some(Segment { count, interval, add, add2 })
}

fn zeros(target: &Target<'_>, m: f64) -> [f64; 3] {
    let start_error = -target.at(0.0);
    // The error of the best cubic is about this times T4.
    let quartic = target.expansion.q[4] * 0.125 * whole_power(m * 0.5, 4);
    let share = (-start_error / (quartic + 1e-12f64.copysign(quartic))).clamp(-1.0, 1.0);
    // Where T4 takes the value `share` left of its first zero (a parabola through three points of it).
    let left = if share >= 0.0 { 0.0381 * (1.0 - share) } else { 0.0381 - 0.0381 * share + 0.0702 * share * share };
    let from = -left * m / (1.0 - left);
    let length = m - from;
    [from + length * 0.308_658_284, from + length * 0.691_341_716, from + length * 0.961_939_766]
}

/// Largest |scheduled − law| over the steps, from the board's own integers, ticks.
fn replayed_misfit(target: &Target<'_>, segment: &Segment, start: &SegmentStart) -> f64 {
    let (mut accumulator, mut interval, mut add) = (i128::from(start.fraction), segment.interval, segment.add);
    let offset = (start.fraction as f64) / (1u64 << start.fraction_bits) as f64 - 0.5;
    let mut worst = 0.0f64;
    for k in 1..=segment.count {
        accumulator += i128::from(interval);
        // The registers wrap as a board's do, where the fit is far off.
        interval = interval.wrapping_add(add);
        add = add.wrapping_add(segment.add2);
        let scheduled = (accumulator >> start.fraction_bits) as i64 as f64;
        worst = worst.max((scheduled - offset - target.at(f64::from(k))).abs());
    }
    worst
}

/// Σ|Chebyshev coefficients| of segment − law on 1..=count: a bound, since both are polynomials of degree ≤ 7.
fn polynomial_misfit(target: &Target<'_>, segment: &Segment, scale: f64) -> f64 {
    // cos(π(2j + 1)/16)
    const C1: f64 = 0.980_785_280_403_230_4;
    const C3: f64 = 0.831_469_612_302_545_2;
    const C5: f64 = 0.555_570_233_019_602_2;
    const C7: f64 = 0.195_090_322_016_128_27;
    const E1: f64 = 0.923_879_532_511_286_7; // cos(π/8)
    const E3: f64 = 0.382_683_432_365_089_8; // cos(3π/8)
    let (i, a, b) = (segment.interval as f64 / scale, segment.add as f64 / scale, segment.add2 as f64 / scale);
    let m = f64::from(segment.count);
    let (center, half) = ((m + 1.0) * 0.5, (m - 1.0) * 0.5);
    let error = |node: f64| {
        let x = center + half * node;
        x * (i + (x - 1.0) * 0.5 * (a + (x - 2.0) * (1.0 / 3.0) * b)) - target.at(x)
    };
    let pair = |node: f64| {
        let (right, left) = (error(node), error(-node));
        (right + left, right - left)
    };
    let ((e0, o0), (e1, o1), (e2, o2), (e3, o3)) = (pair(C1), pair(C3), pair(C5), pair(C7));
    let even = 0.5 * (e0 + e1 + e2 + e3).abs()
        + ((e0 - e3) * E1 + (e1 - e2) * E3).abs()
        + ((e0 - e1 - e2 + e3) * std::f64::consts::FRAC_1_SQRT_2).abs()
        + ((e0 - e3) * E3 - (e1 - e2) * E1).abs();
    let odd = (o0 * C1 + o1 * C3 + o2 * C5 + o3 * C7).abs()
        + (o0 * C3 - o1 * C7 - o2 * C1 - o3 * C5).abs()
        + (o0 * C5 - o1 * C1 + o2 * C7 + o3 * C3).abs()
        + (o0 * C7 - o1 * C5 + o2 * C3 - o3 * C1).abs();
    0.25 * (even + odd)
}
