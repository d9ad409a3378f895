//! Motions from tables of times and positions.

use std::sync::Arc;

use super::smoothing::{self, Point};
use super::{Curve, Double, Entry, FARTHEST, LONGEST_PART_S, Law, LawError, Piece, Workload};
use crate::Time;

/// The curve through the rows of a table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Interpolation {
    /// Cubics that rise only where the rows rise and fall only where they fall; the speed is continuous.
    #[default]
    Monotone,
    /// Straight lines: the speed jumps at every row.
    Linear,
}

/// A motion through the rows of a table, or near them if it is smoothed.
#[derive(Clone, Debug, PartialEq)]
pub struct TableLaw {
    recording: Arc<Recording>,
    smoothed: Option<Smoothed>,
}

/// The rows as they are, s and steps.
#[derive(Debug, PartialEq)]
struct Recording {
    rows: Vec<(f64, f64)>,
    interpolation: Interpolation,
    /// Of the monotone cubics at the rows, steps/s.
    slopes: Vec<f64>,
}

/// Cubics near the rows; the acceleration is continuous.
#[derive(Clone, Debug, PartialEq)]
struct Smoothed {
    over: Time,
    knots: Arc<Vec<Point>>,
}

/// How far a smoothed motion is from the rows that it comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distance {
    /// The largest, steps.
    pub largest: f64,
    /// The time of the row where it is, s.
    pub at_s: f64,
    /// The root of the mean square over all rows, steps.
    pub rms: f64,
}

impl Law {
    /// Through `rows` of (time in s, position in steps); at rest at the first position before the first row's time.
    ///
    /// Slopes of [`Interpolation::Monotone`]: F. N. Fritsch, R. E. Carlson, "Monotone piecewise cubic interpolation",
    /// SIAM J. Numer. Anal. 17 (1980); in the middle the weighted harmonic mean of F. N. Fritsch, J. Butland, SIAM J.
    /// Sci. Stat. Comput. 5 (1984), at the ends the three-point formula, kept within the monotone region.
    ///
    /// # Errors
    /// [`LawError::Parameter`], with the row counted from 1, for fewer than two rows, a negative time, times that do
    /// not grow, and what is not a number.
    pub fn table(rows: &[(f64, f64)], interpolation: Interpolation) -> Result<Law, LawError> {
        let refuse = |row: usize, why: String| Err(LawError::Parameter(format!("row {}: {why}", row + 1)));
        if rows.len() < 2 {
            return refuse(rows.len(), "missing; a table needs at least two rows".into());
        }
        for (row, &(t, x)) in rows.iter().enumerate() {
            if !x.is_finite() || !(0.0..=1e12).contains(&t) || x.abs() > FARTHEST {
                return refuse(row, format!("({t} s, {x} steps) is out of range"));
            }
            if row > 0 && Time::from_seconds(t) <= Time::from_seconds(rows[row - 1].0) {
                let before = rows[row - 1].0;
                return refuse(row, format!("its time {t} s must be after the row before it, at {before} s"));
            }
        }
        let slopes = match interpolation {
            Interpolation::Monotone => monotone_slopes(rows),
            Interpolation::Linear => Vec::new(),
        };
        let recording = Arc::new(Recording { rows: rows.to_vec(), interpolation, slopes });
        Ok(Law::Table(TableLaw { recording, smoothed: None }))
    }

    /// This law with every table in it smoothed over `over`, or over what it was smoothed over before if that is longer. `None` if it has no
    /// table, or `over` is longer than a table's rows last.
    ///
    /// The smoother is the cubic smoothing spline (C. H. Reinsch, "Smoothing by spline functions", Numer. Math. 10, 1967): of all curves the
    /// one with the least ∫(θ − rows)² dt + λ∫θ''² dt. Its gain is 1/(1 + (f/f₀)⁴) and it does not shift phases: it is what a Butterworth
    /// filter of order 2 does that is run forwards and backwards (order 4 in all). `over` is half the period of the frequency at which the
    /// gain is −3 dB. The first and the last row stay where they are, and the law rests there.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time, law::{Cursor, Interpolation}};
    /// let rows: Vec<(f64, f64)> = (0..=100).map(|k| (f64::from(k) / 100.0, if k < 50 { 0.0 } else { 100.0 })).collect();
    /// let law = Law::table(&rows, Interpolation::Monotone)?.smoothed(Time::from_seconds(0.2)).unwrap();
    /// let mut cursor = Cursor::new(&law);
    /// assert_eq!(cursor.at(Time::SECOND)?.position, 100.0);
    /// // At the step itself it is half-way.
    /// assert!((cursor.at(Time::from_seconds(0.495))?.position - 50.0).abs() < 1.0);
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    #[must_use]
    pub fn smoothed(&self, over: Time) -> Option<Law> {
        self.changed_under_backlash(|law| law.with_smooth_tables(over))
    }

    fn with_smooth_tables(&self, over: Time) -> Option<Law> {
        if self.tables().is_empty() {
            return None;
        }
        let of_each = |laws: &[Law]| -> Option<Vec<Law>> {
            let smooth =
                |law: &Law| if law.tables().is_empty() { Some(law.clone()) } else { law.with_smooth_tables(over) };
            laws.iter().map(smooth).collect()
        };
        match self {
            Law::Table(table) => Some(Law::Table(table.smoothed(over)?)),
            Law::Sum(laws) => Law::sum(of_each(laws)?).ok(),
            Law::Then(laws) => Law::then(of_each(laws)?).ok(),
            Law::Changed(changed) => Some(changed.of(changed.law.with_smooth_tables(over)?)),
            Law::Repeated(repeated) => repeated.law.with_smooth_tables(over)?.repeated(repeated.times).ok(),
            Law::Warped(warped) => Some(Law::Warped(Arc::new(warped.of(warped.law().with_smooth_tables(over)?)))),
            Law::Blended(blended) => {
                // What is smooth begins and ends at rest: it needs no ramp.
                let law = blended.law().with_smooth_tables(over)?;
                blended.stop_of(law.clone()).or(Some(law))
            }
            _ => None,
        }
    }

    /// The tables in it, but those under a backlash's compensation.
    #[must_use]
    pub fn tables(&self) -> Vec<&TableLaw> {
        match self {
            Law::Table(table) => vec![table],
            Law::Sum(laws) => laws.iter().flat_map(Law::tables).collect(),
            Law::Then(laws) => laws.iter().flat_map(Law::tables).collect(),
            Law::Changed(changed) => changed.law.tables(),
            Law::Repeated(repeated) => repeated.law.tables(),
            Law::Warped(warped) => warped.law().tables(),
            Law::Faded(faded) => faded.laws().into_iter().flat_map(Law::tables).collect(),
            Law::Blended(blended) => blended.law().tables(),
            Law::Backlash(backlash) => backlash.law().tables(),
            _ => Vec::new(),
        }
    }
}

impl TableLaw {
    /// Over which time it is smoothed; `None`: not at all.
    #[must_use]
    pub fn smooth(&self) -> Option<Time> {
        self.smoothed.as_ref().map(|smoothed| smoothed.over)
    }

    /// How many rows it has.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.recording.rows.len()
    }

    /// From the first row to the last, s.
    #[must_use]
    pub fn lasts_s(&self) -> f64 {
        let rows = &self.recording.rows;
        rows[rows.len() - 1].0 - rows[0].0
    }

    /// From the lowest row to the highest, steps.
    #[must_use]
    pub fn range(&self) -> f64 {
        let positions = || self.recording.rows.iter().map(|row| row.1);
        positions().fold(f64::NEG_INFINITY, f64::max) - positions().fold(f64::INFINITY, f64::min)
    }

    /// The largest change from a row to the next, steps, and the time of the row after it, if such changes are rare and nearly as large as
    /// the range: then the positions may start again there.
    #[must_use]
    pub fn jump(&self) -> Option<(f64, f64)> {
        let range = self.range();
        let changes = || self.recording.rows.windows(2).map(|pair| (pair[1].1 - pair[0].1, pair[1].0));
        let (largest, at_s) = changes().max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))?;
        let large = changes().filter(|(change, _)| change.abs() > 0.3 * range).count();
        (largest.abs() > 0.7 * range && 4 * large < self.rows()).then_some((largest, at_s))
    }

    /// How far it is from its rows.
    #[must_use]
    pub fn distance(&self) -> Distance {
        let Some(Smoothed { knots, .. }) = &self.smoothed else { return Distance::default() };
        let (mut distance, mut square, mut k) = (Distance::default(), 0.0, 0);
        for &(t, x) in &self.recording.rows {
            while k + 2 < knots.len() && knots[k + 1].t < t {
                k += 1;
            }
            let off = (smoothing::between(&knots[k], &knots[k + 1], t) - x).abs();
            if off > distance.largest {
                (distance.largest, distance.at_s) = (off, t);
            }
            square += off * off;
        }
        distance.rms = (square / self.recording.rows.len() as f64).sqrt();
        distance
    }

    /// Its largest speed and acceleration, steps/s and steps/s².
    #[must_use]
    pub fn peaks(&self) -> (f64, f64) {
        let (mut speed, mut acceleration) = (0.0_f64, 0.0_f64);
        for k in 1..self.knots() {
            let (from, to) = (self.knot(k - 1), self.knot(k));
            let h = to.t - from.t;
            let secant = (to.x - from.x) / h;
            if self.is_straight() {
                speed = speed.max(secant.abs());
                continue;
            }
            let first = (6.0 * secant - 4.0 * from.slope - 2.0 * to.slope) / h;
            let last = (2.0 * from.slope + 4.0 * to.slope - 6.0 * secant) / h;
            acceleration = acceleration.max(first.abs()).max(last.abs());
            speed = speed.max(from.slope.abs()).max(to.slope.abs());
            if first * last < 0.0 {
                // The acceleration is 0 between them: there the speed is farthest from that at the ends.
                speed = speed.max((from.slope + 0.5 * first * first / (first - last) * h).abs());
            }
        }
        (speed, acceleration)
    }

    fn smoothed(&self, over: Time) -> Option<TableLaw> {
        let over = self.smooth().map_or(over, |before| before.max(over));
        let knots = self.recording.smoothed(over.seconds())?;
        let smoothed = Some(Smoothed { over, knots: Arc::new(knots) });
        Some(TableLaw { recording: Arc::clone(&self.recording), smoothed })
    }

    /// Between which points its curves are.
    fn knots(&self) -> usize {
        self.smoothed.as_ref().map_or(self.rows(), |smoothed| smoothed.knots.len())
    }

    fn knot(&self, k: usize) -> Point {
        match &self.smoothed {
            Some(smoothed) => smoothed.knots[k],
            None => self.recording.point(k),
        }
    }

    pub(super) fn end(&self) -> Time {
        Time::from_seconds(self.knot(self.knots() - 1).t)
    }

    /// The straight lines are not kept as cubics: what is straight has step times in closed form.
    fn is_straight(&self) -> bool {
        self.smoothed.is_none() && self.recording.interpolation == Interpolation::Linear
    }

    pub(super) fn pieces_from(self, at: Time) -> impl Iterator<Item = Result<Piece, LawError>> {
        let begin = Time::from_seconds(self.knot(0).t);
        let rest = (begin > Time::ZERO).then(|| Piece::rest(Time::ZERO, begin, Double::from(self.knot(0).x)));
        // The first curve that ends after `at`, or the last one.
        let (mut first, mut last) = (1, self.knots() - 1);
        while first < last {
            let middle = usize::midpoint(first, last);
            if Time::from_seconds(self.knot(middle).t) <= at { first = middle + 1 } else { last = middle }
        }
        let pieces = (first..self.knots()).flat_map(move |k| self.between(k - 1));
        rest.into_iter().filter(move |_| at < begin).chain(pieces).flat_map(move |piece| match piece {
            Ok(piece) => piece.cut(at).collect(),
            Err(error) => vec![Err(error)],
        })
    }

    /// The curves between two knots.
    fn between(&self, k: usize) -> impl Iterator<Item = Result<Piece, LawError>> + use<> {
        let (from, to) = (self.knot(k), self.knot(k + 1));
        let (start, end) = (Time::from_seconds(from.t), Time::from_seconds(to.t));
        let (h, way) = ((end - start).seconds(), to.x - from.x);
        let lay = |zero: Time, start: Time, end: Time, position: f64, c: Vec<f64>| -> Result<Piece, LawError> {
            let curve = Curve::Polynomial(c);
            let mut piece = Piece { zero, start, end, origin: 0, curve, entry: Entry::Continuous };
            piece.raise(Double::from(position))?;
            Ok(piece)
        };
        let secant = way / h;
        let (m0, m1) = (from.slope, to.slope);
        let cubic = (m0 + m1 - 2.0 * secant) / (h * h);
        let from_start = || vec![0.0, m0, (3.0 * secant - 2.0 * m0 - m1) / h, cubic];
        let from_end = || vec![0.0, m1, (2.0 * m1 + m0 - 3.0 * secant) / h, cubic];
        // Where the motion rests, and where it begins (steps count from there), the row's own numbers must stand: rounding of a curve
        // that comes from the other row would decide when a step there is due, or whether.
        let middle = start + (end - start).divided_by(2);
        let [first, second] = if self.is_straight() {
            [Some(lay(start, start, end, from.x, vec![0.0, secant])), None]
        } else if m1 != 0.0 || way == 0.0 || middle == start {
            [Some(lay(start, start, end, from.x, from_start())), None]
        } else if m0 == 0.0 || k == 0 {
            let second = lay(end, middle, end, to.x, from_end());
            [Some(lay(start, start, middle, from.x, from_start())), Some(second)]
        } else {
            [Some(lay(end, start, end, to.x, from_end())), None]
        };
        first.into_iter().chain(second)
    }

    /// About how much there is of it up to `until`.
    pub(super) fn workload(&self, until: Time) -> Workload {
        let (mut seen, mut before) = (Workload::default(), None::<Point>);
        let until_s = until.seconds();
        for knot in (0..self.knots()).map(|k| self.knot(k)) {
            if let Some(from) = before {
                let part = ((until_s - from.t) / (knot.t - from.t)).min(1.0);
                seen.steps += part * (knot.x - from.x).abs();
                seen.pieces += 1.0;
                seen.turns += if from.slope * knot.slope < 0.0 { 1.0 } else { 0.0 };
            }
            if knot.t >= until_s {
                break;
            }
            before = Some(knot);
        }
        // Long ones come in parts.
        seen.pieces += libm::floor(until_s.min(self.end().seconds()) / LONGEST_PART_S);
        seen
    }
}

impl Recording {
    fn point(&self, row: usize) -> Point {
        let (t, x) = self.rows[row];
        Point { t, x, slope: self.slopes.get(row).copied().unwrap_or(0.0) }
    }

    /// Where what is laid through the rows is at a time between row `row` and the next.
    fn at(&self, row: usize, t: f64) -> f64 {
        let (from, to) = (self.point(row), self.point(row + 1));
        match self.interpolation {
            Interpolation::Monotone => smoothing::between(&from, &to, t),
            Interpolation::Linear => from.x + (to.x - from.x) * ((t - from.t) / (to.t - from.t)),
        }
    }

    fn smoothed(&self, over_s: f64) -> Option<Vec<Point>> {
        smoothing::smoothed(&self.rows, |row, t| self.at(row, t), over_s)
    }
}

fn monotone_slopes(rows: &[(f64, f64)]) -> Vec<f64> {
    let h: Vec<f64> = rows.windows(2).map(|p| p[1].0 - p[0].0).collect();
    let d: Vec<f64> = rows.windows(2).zip(&h).map(|(p, h)| (p[1].1 - p[0].1) / h).collect();
    let n = h.len();
    if n == 1 {
        return vec![d[0]; 2];
    }
    let middle = (1..n).map(|i| {
        if d[i - 1] * d[i] <= 0.0 {
            return 0.0;
        }
        let (w0, w1) = (2.0 * h[i] + h[i - 1], h[i] + 2.0 * h[i - 1]);
        (w0 + w1) / (w0 / d[i - 1] + w1 / d[i])
    });
    let end = |h0: f64, h1: f64, d0: f64, d1: f64| {
        let slope = ((2.0 * h0 + h1) * d0 - h0 * d1) / (h0 + h1);
        if slope * d0 <= 0.0 {
            0.0
        } else if d0 * d1 <= 0.0 && slope.abs() > 3.0 * d0.abs() {
            3.0 * d0
        } else {
            slope
        }
    };
    std::iter::once(end(h[0], h[1], d[0], d[1]))
        .chain(middle)
        .chain(std::iter::once(end(h[n - 1], h[n - 2], d[n - 1], d[n - 2])))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::Cursor;
    use proptest::prelude::*;

    fn refused(rows: &[(f64, f64)], expected: &str) {
        let error = Law::table(rows, Interpolation::Monotone).unwrap_err().to_string();
        assert!(error.starts_with(expected), "{error}");
    }

    #[test]
    fn wrong_rows_are_named() {
        refused(&[(0.0, 0.0)], "row 2: missing");
        refused(&[(0.0, 0.0), (1.0, 2.0), (1.0, 3.0)], "row 3: its time 1 s");
        refused(&[(0.0, 0.0), (2.0, 2.0), (1.0, 3.0)], "row 3: its time 1 s");
        refused(&[(0.0, 0.0), (1.0, f64::NAN)], "row 2: (1 s, NaN steps)");
        refused(&[(-1.0, 0.0), (1.0, 0.0)], "row 1: (-1 s");
    }

    #[test]
    fn peaks_are_those_of_the_cubics() {
        // To 100 steps and back: 3x² − 2x³, steepest in its middle.
        let law = Law::table(&[(0.0, 0.0), (2.0, 100.0), (4.0, 0.0)], Interpolation::Monotone).unwrap();
        let rested =
            Law::table(&[(0.0, 0.0), (1.0, 0.0), (3.0, 100.0), (4.0, 100.0)], Interpolation::Monotone).unwrap();
        let (speed, acceleration) = rested.tables()[0].peaks();
        assert!((speed - 75.0).abs() < 1e-9 && (acceleration - 150.0).abs() < 1e-9, "{speed} {acceleration}");
        let (speed, _) = law.tables()[0].peaks();
        let mut cursor = Cursor::new(&law);
        let fastest = (0..=4000).map(|k| cursor.at(Time::from_seconds(f64::from(k) / 1000.0)).unwrap().speed.abs());
        assert!((speed - fastest.fold(0.0, f64::max)).abs() < 1e-3, "{speed}");
        let straight = Law::table(&[(0.0, 0.0), (1.0, 5.0), (3.0, 100.0)], Interpolation::Linear).unwrap();
        assert_eq!(straight.tables()[0].peaks(), (47.5, 0.0));
    }

    proptest! {
        #[test]
        fn monotone_rows_give_a_monotone_law(steps in prop::collection::vec((0.01_f64..2.0, 0.0_f64..1e5), 2..20)) {
            let mut row = (0.0, 0.0);
            let rows: Vec<_> = steps.iter().map(|s| { row = (row.0 + s.0, row.1 + s.1); row }).collect();
            let law = Law::table(&rows, Interpolation::Monotone).unwrap();
            let mut cursor = Cursor::new(&law);
            let end = rows.last().unwrap().0;
            let mut before = f64::NEG_INFINITY;
            for k in 0..=500 {
                let sample = cursor.at(Time::from_seconds(end * f64::from(k) / 500.0)).unwrap();
                prop_assert!(sample.position >= before - 1e-9);
                before = sample.position;
            }
            for &(t, x) in &rows {
                prop_assert!((cursor.at(Time::from_seconds(t)).unwrap().position - x).abs() <= 1e-9 * (1.0 + x.abs()));
            }
        }
    }
}
