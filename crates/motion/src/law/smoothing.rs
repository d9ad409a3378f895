//! The smoother of recordings: a cubic smoothing spline, solved in one pass over the rows.
//!
//! What is smoothed is the interpolated recording, not the bare rows: rows that lie close together are averaged, and long gaps are filled, so
//! that the cut-off is the same all along, however unevenly the rows come. Between its knots the spline is a cubic, so a smoothed law is as
//! exact as any other table. Unknown are the position and the slope at every knot; the least ∫(θ − rows)² dt + λ∫θ''² dt is the solution of
//! linear equations that tie each knot to its two neighbours, and it has a continuous acceleration by itself.

use super::{Law, TableLaw};
use crate::{Time, whole_power};

/// The frequency at which the gain is −3 dB, Hz, times the smoothing time, s.
pub const CUT_OFF: f64 = 0.5;

/// Rows closer together than this are averaged, as a part of the smoothing time. That costs 0.2 % at the cut-off.
const CLOSEST: f64 = 1.0 / 16.0;
/// Gaps longer than this are filled, as a part of the smoothing time: 8 points in a period of the cut-off.
const WIDEST: f64 = 0.25;
/// Points that fill a gap next to each of its ends, at most. Beyond them, 8 smoothing times from the end, the spline is the interpolant.
const FILLED: u32 = 32;
/// Points of a smoothed recording, at most.
const MOST_POINTS: usize = 1 << 22;

/// A point of a curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Point {
    /// s.
    pub(super) t: f64,
    /// steps.
    pub(super) x: f64,
    /// steps/s.
    pub(super) slope: f64,
}

/// The cubic between two points, at `t`.
pub(super) fn between(from: &Point, to: &Point, t: f64) -> f64 {
    let (h, u) = (to.t - from.t, t - from.t);
    let secant = (to.x - from.x) / h;
    let cubic = (from.slope + to.slope - 2.0 * secant) / (h * h);
    let square = (3.0 * secant - 2.0 * from.slope - to.slope) / h;
    from.x + u * (from.slope + u * (square + u * cubic))
}

/// The knots of the smoothing spline of `rows`, which are two at least; `at` is what is laid through the rows, behind a row at a time.
/// `None` if `over_s` is longer than the rows last, or far too short for their gaps.
pub(super) fn smoothed(rows: &[(f64, f64)], at: impl Fn(usize, f64) -> f64, over_s: f64) -> Option<Vec<Point>> {
    let (first, last) = (rows.first()?, rows.last()?);
    if !(over_s > 0.0 && over_s <= last.0 - first.0) {
        return None;
    }
    let mut points = vec![*first];
    for point in averaged(rows, over_s * CLOSEST).chain([*last]) {
        fill(&mut points, point, rows, &at, over_s * WIDEST);
        if points.len() > MOST_POINTS {
            return None;
        }
    }
    Some(solve(&points, over_s))
}

/// The rows without the first and the last. Those that lie within `closest` of one another are one point in their middle; what lies next to
/// the first and the last row, which stay where they are, is left out.
fn averaged(rows: &[(f64, f64)], closest: f64) -> impl Iterator<Item = (f64, f64)> {
    /// Rows that are averaged: when they begin, and their sums.
    #[derive(Clone, Copy)]
    struct Group {
        from: f64,
        weight: f64,
        t: f64,
        x: f64,
    }
    impl Group {
        fn mean(self) -> (f64, f64) {
            (self.from + self.t / self.weight, self.x / self.weight)
        }
    }
    let (start, end) = (rows[0].0 + 0.5 * closest, rows[rows.len() - 1].0 - 0.5 * closest);
    let mut inner = rows.windows(3);
    let mut group: Option<Group> = None;
    std::iter::from_fn(move || {
        for row in inner.by_ref() {
            // A row stands for the time half-way to its neighbours.
            let ((before, _), (t, x), (after, _)) = (row[0], row[1], row[2]);
            let weight = 0.5 * (after - before);
            let begun = Group { from: t, weight, t: 0.0, x: weight * x };
            let Some(of) = group.filter(|of| t - of.from <= closest || t - of.mean().0 < 0.5 * closest) else {
                if let Some(full) = group.replace(begun) {
                    return Some(full.mean());
                }
                continue;
            };
            group = Some(Group {
                weight: of.weight + weight,
                t: of.t + weight * (t - of.from),
                x: of.x + weight * x,
                ..of
            });
        }
        group.take().map(Group::mean)
    })
    .filter(move |(t, _)| *t > start && *t < end)
}

/// Appends a point, and before it what fills a gap that is wider than `widest`.
fn fill(
    points: &mut Vec<(f64, f64)>,
    next: (f64, f64),
    rows: &[(f64, f64)],
    at: &impl Fn(usize, f64) -> f64,
    widest: f64,
) {
    let from = points.last().map_or(next.0, |last| last.0);
    let gap = next.0 - from;
    let parts = (gap / widest).ceil();
    let place = |t: f64| {
        let row = rows.partition_point(|row| row.0 <= t).clamp(1, rows.len() - 1) - 1;
        (t, at(row, t))
    };
    if parts > f64::from(2 * FILLED) {
        points.extend((1..=FILLED).map(|k| place(from + f64::from(k) * widest)));
        points.extend((1..=FILLED).rev().map(|k| place(next.0 - f64::from(k) * widest)));
    } else if parts > 1.0 {
        points.extend((1..parts as u32).map(|k| place(from + gap * f64::from(k) / parts)));
    }
    points.push(next);
}

/// A 2 × 2 matrix.
type Matrix = [[f64; 2]; 2];

fn times(m: &Matrix, v: [f64; 2]) -> [f64; 2] {
    [m[0][0] * v[0] + m[0][1] * v[1], m[1][0] * v[0] + m[1][1] * v[1]]
}

fn transposed(m: &Matrix) -> Matrix {
    [[m[0][0], m[1][0]], [m[0][1], m[1][1]]]
}

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    let b = transposed(b);
    let [first, second] = [times(a, b[0]), times(a, b[1])];
    [[first[0], second[0]], [first[1], second[1]]]
}

fn inverse([[a, b], [c, d]]: Matrix) -> Matrix {
    let determinant = a * d - b * c;
    [[d / determinant, -b / determinant], [-c / determinant, a / determinant]]
}

/// What a stretch of length `h` adds to the equations, of bending with the factor `stiffness`: to its first point's own, to its last
/// point's own, and to what ties the first to the last. Unknown are position and slope.
fn bending(h: f64, stiffness: f64) -> [Matrix; 3] {
    let [value, mixed, slope] = [12.0 / (h * h * h), 6.0 / (h * h), 4.0 / h].map(|k| k * stiffness);
    [[[value, mixed], [mixed, slope]], [[value, -mixed], [-mixed, slope]], [[-value, mixed], [-mixed, 0.5 * slope]]]
}

/// The spline through the first and the last point, at rest there, and near the others. Time is in units of `over_s` here, so that no number
/// is much larger than another.
fn solve(points: &[(f64, f64)], over_s: f64) -> Vec<Point> {
    // 1/(1 + λω⁴) is 1/√2 at ω = 2π·CUT_OFF/over.
    let stiffness = (std::f64::consts::SQRT_2 - 1.0) / whole_power(std::f64::consts::TAU * CUT_OFF, 4);
    let last = points.len() - 1;
    let length = |k: usize| (points[k + 1].0 - points[k].0) / over_s;
    // Relative to the first position, so that nothing is lost of a small motion far away.
    let zero = points[0].1;
    let ends = [[0.0, 0.0], [points[last].1 - zero, 0.0]];
    // Of every inner point: the inverse of its own equation once the points before it are gone, and the right side.
    let mut reduced: Vec<(Matrix, [f64; 2])> = Vec::with_capacity(last);
    let mut before = bending(length(0), stiffness);
    for (k, point) in points.iter().enumerate().take(last).skip(1) {
        let after = bending(length(k), stiffness);
        // A point stands for the time half-way to its neighbours, but no further than the smoother looks.
        let weight = 0.5 * (length(k - 1).min(0.5) + length(k).min(0.5));
        let mut own = before[1];
        for (row, more) in own.iter_mut().zip(after[0]) {
            row.iter_mut().zip(more).for_each(|(own, more)| *own += more);
        }
        own[0][0] += weight;
        let tie = transposed(&before[2]);
        let mut right = [weight * (point.1 - zero), 0.0];
        let from = match reduced.last() {
            None => times(&tie, ends[0]),
            Some((inverse, right)) => {
                let through = product(&tie, inverse);
                let taken = product(&through, &before[2]);
                for (row, less) in own.iter_mut().zip(taken) {
                    row.iter_mut().zip(less).for_each(|(own, less)| *own -= less);
                }
                times(&through, *right)
            }
        };
        right.iter_mut().zip(from).for_each(|(right, from)| *right -= from);
        reduced.push((inverse(own), right));
        before = after;
    }
    let mut solved = vec![Point { t: points[last].0, x: points[last].1, slope: 0.0 }];
    let mut next = ends[1];
    for (k, (inverse, right)) in reduced.iter().enumerate().rev() {
        let tie = bending(length(k + 1), stiffness)[2];
        let from = times(&tie, next);
        next = times(inverse, [right[0] - from[0], right[1] - from[1]]);
        solved.push(Point { t: points[k + 1].0, x: zero + next[0], slope: next[1] / over_s });
    }
    solved.push(Point { t: points[0].0, x: zero, slope: 0.0 });
    solved.reverse();
    solved
}

/// No smoothing is offered that takes the motion farther from its rows than this, root mean square, as a part of its range.
const FARTHEST_OFF: f64 = 0.1;
/// None is offered that is longer than this, as a part of how long a table lasts.
const LONGEST: f64 = 0.25;
/// The search ends when its bounds differ by less than this ratio: what it finds has two digits.
const PRECISION: f64 = 1.03;

/// The least smoothing of all tables of some laws with which these fit, and the laws with it; rounded up to two digits, and tried as it is
/// returned. `None` if the laws have no table, or none fits that leaves the motion what it is: it may be as long as a quarter of the
/// table, and move it by a tenth of its range (root mean square). Laws given together are coordinates of one motion: the range is that of
/// the coordinate that goes farthest, since another may be flat but for noise.
///
/// `fits` returns `None` if there is no time to try any more; then there is no answer either.
pub fn least_smoothing(laws: &[&Law], fits: impl Fn(&[Law]) -> Option<bool>) -> Option<(Time, Vec<Law>)> {
    let tables: Vec<&TableLaw> = laws.iter().flat_map(|law| law.tables()).collect();
    let spacing = |table: &&TableLaw| table.lasts_s() / table.rows() as f64;
    let now = |table: &&TableLaw| table.smooth().map_or(0.0, Time::seconds);
    let shortest = tables.iter().map(spacing).fold(f64::INFINITY, f64::min);
    let shortest = tables.iter().map(now).fold(shortest, f64::max);
    let longest = tables.iter().map(|table| LONGEST * table.lasts_s()).fold(f64::INFINITY, f64::min);
    let range = tables.iter().map(|table| table.range()).fold(0.0, f64::max);
    let smooth = |over_s: f64| -> Option<(Time, Vec<Law>)> {
        let over = Time::from_seconds(over_s);
        let with = |law: &&Law| if law.tables().is_empty() { Some((*law).clone()) } else { law.smoothed(over) };
        let smooth = laws.iter().map(with).collect::<Option<Vec<Law>>>()?;
        let is_near = |table: &TableLaw| table.distance().rms <= FARTHEST_OFF * range;
        smooth.iter().flat_map(Law::tables).all(is_near).then_some((over, smooth))
    };
    // What cannot be smoothed so, or is moved too far by it, does not fit.
    let fits_over = |over_s: f64| smooth(over_s).map_or(Some(false), |(_, laws)| fits(&laws));
    let (mut below, mut above) = (shortest, shortest);
    loop {
        above = (above * 1.5).min(longest);
        if above <= below {
            return None;
        }
        if fits_over(above)? {
            break;
        }
        below = above;
    }
    while above / below > PRECISION {
        let middle = (above * below).sqrt();
        if fits_over(middle)? { above = middle } else { below = middle }
    }
    // What is rounded may not fit: a little more does.
    let mut over_s = above;
    for _ in 0..4 {
        over_s = rounded_up(over_s);
        if fits_over(over_s)? {
            return smooth(over_s);
        }
        over_s *= 1.05;
    }
    None
}

/// Rounded up to two digits.
fn rounded_up(value: f64) -> f64 {
    let unit = libm::exp10(libm::floor(libm::log10(value)) - 1.0);
    // What has two digits already keeps them.
    libm::ceil(value / unit - 1e-9) * unit
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::{Cursor, Interpolation};
    use proptest::prelude::*;

    /// A recording of a sinusoid that takes `period` times the smoothing time of 1 s, at these times: the gain in its middle.
    fn gain(period: f64, times: impl Iterator<Item = f64>) -> f64 {
        let omega = std::f64::consts::TAU / period;
        let rows: Vec<(f64, f64)> = times.map(|t| (t, 1000.0 * (omega * (t - 40.0)).cos())).collect();
        let law = Law::table(&rows, Interpolation::Monotone).unwrap().smoothed(Time::SECOND).unwrap();
        let mut cursor = Cursor::new(&law);
        let mut at = |t: f64| cursor.at(Time::from_seconds(t)).unwrap().position;
        // Its phase is not shifted: a quarter of a period later it is 0.
        assert!(at(40.0 + 0.25 * period).abs() < 15.0, "{}", at(40.0 + 0.25 * period));
        at(40.0) / 1000.0
    }

    #[test]
    fn the_gain_is_that_of_a_butterworth_filter_forwards_and_backwards() {
        let even = |each: f64| (0..).map(move |k| f64::from(k) * each).take_while(|t| *t <= 80.0);
        for period in [8.0_f64, 4.0, 2.0, 1.0, 0.5] {
            // 1/√2 where the period is twice the smoothing time.
            let wanted = 1.0 / (1.0 + (std::f64::consts::SQRT_2 - 1.0) * (2.0 / period).powi(4));
            for each in [0.001, 0.01, 0.0531] {
                let gain = gain(period, even(each));
                assert!((gain - wanted).abs() < 0.01, "{period} s, rows each {each} s: {gain}, not {wanted}");
            }
            // Rows that come unevenly: three close together, then a pause.
            let uneven = even(0.08).flat_map(|t| [t, t + 0.001, t + 0.004]);
            let gain = gain(period, uneven);
            assert!((gain - wanted).abs() < 0.03, "{period} s, uneven rows: {gain}, not {wanted}");
        }
    }

    proptest! {
        /// Position, speed and acceleration are continuous; both ends stay and are at rest; nothing is far from where the rows are.
        #[test]
        fn smoothed_tables_are_smooth(
            steps in prop::collection::vec((0.0001_f64..0.2, -500.0_f64..500.0), 3..80),
            gap in 0.0_f64..200.0,
            over in 0.01_f64..2.0,
            far in -1e9_f64..1e9,
            linear: bool,
        ) {
            let mut t = 0.0;
            let mut rows: Vec<(f64, f64)> = steps.iter().map(|step| { t += step.0; (t, far + step.1) }).collect();
            let half = rows.len() / 2;
            rows[half..].iter_mut().for_each(|row| row.0 += gap);
            let zero = rows[0].0;
            rows.iter_mut().for_each(|row| row.0 -= zero);
            let end = rows[rows.len() - 1];
            let over = over.min(end.0);
            let interpolation = if linear { Interpolation::Linear } else { Interpolation::Monotone };
            let law = Law::table(&rows, interpolation).unwrap().smoothed(Time::from_seconds(over)).unwrap();
            let mut last: Option<[f64; 3]> = None;
            let mut hardest = 0.0_f64;
            for piece in law.pieces() {
                let piece = piece.unwrap();
                let [from, to] = [piece.first(), piece.last()].map(|u| {
                    let jet = piece.curve.jet(u);
                    [jet[0] + (piece.origin as f64), jet[1], 2.0 * jet[2]]
                });
                hardest = hardest.max(to[2].abs());
                let before = last.unwrap_or([rows[0].1, 0.0, from[2]]);
                prop_assert!((from[0] - before[0]).abs() < 1e-6, "{from:?} after {before:?}");
                prop_assert!((from[1] - before[1]).abs() < 1e-5 * (1.0 + 1e3 / over), "{from:?} after {before:?}");
                prop_assert!((from[2] - before[2]).abs() < 1e-3 * (1.0 + 1e3 / over / over), "{from:?} after {before:?}");
                // It may swing over by a fraction of what it smooths.
                prop_assert!((to[0] - far).abs() < 700.0, "{} of {far}", to[0]);
                last = Some(to);
            }
            let last = last.unwrap();
            prop_assert!((last[0] - end.1).abs() < 1e-6 && last[1].abs() < 1e-5 * (1.0 + 1e3 / over), "{last:?}");
            // What is 1000 steps high at most takes no more than so much.
            prop_assert!(hardest < 3e4 / over / over, "{hardest}");
        }
    }

    #[test]
    fn the_least_smoothing_that_fits_is_found() {
        let rows: Vec<(f64, f64)> =
            (0..=400).map(|k| (f64::from(k) * 0.01, f64::from(k % 2))).chain([(5.0, 500.0)]).collect();
        let law = Law::table(&rows, Interpolation::Monotone).unwrap().delayed(Time::SECOND).unwrap();
        let over = |laws: &[Law]| laws[0].tables()[0].smooth().unwrap().seconds();
        let least = |fits: &dyn Fn(f64) -> Option<bool>| least_smoothing(&[&law], |laws| fits(over(laws)));
        let (found, laws) = least(&|over| Some(over >= 0.1234)).unwrap();
        assert!((0.1234..=0.14).contains(&found.seconds()), "{}", found.seconds());
        assert_eq!(over(&laws), found.seconds());
        assert_eq!(format!("{:.6}", found.seconds() * 100.0).trim_end_matches('0').trim_end_matches('.').len(), 2);
        assert!(least(&|_| Some(false)).is_none());
        assert!(least(&|_| None).is_none());
        assert!(least_smoothing(&[&Law::sine(1.0, Time::SECOND, Some(1)).unwrap()], |_| Some(true)).is_none());
        // Noise alone is no motion; next to a motion it is a coordinate that does not move.
        let noise: Vec<(f64, f64)> = (0..=500).map(|k| (f64::from(k) * 0.01, f64::from(k % 2))).collect();
        let noise = Law::table(&noise, Interpolation::Monotone).unwrap();
        let fits = |laws: &[Law]| Some(over(laws) >= 0.1234);
        assert!(least_smoothing(&[&noise], fits).is_none());
        let (found, laws) = least_smoothing(&[&law, &noise], fits).unwrap();
        assert!(laws.iter().all(|law| law.tables()[0].smooth() == Some(found)) && found.seconds() < 0.14);
    }
}
