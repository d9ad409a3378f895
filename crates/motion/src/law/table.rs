//! Motions from tables of times and positions.

use super::{Class, Curve, Double, Entry, FARTHEST, Law, LawError, Piece};
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
            Interpolation::Monotone => Some(monotone_slopes(rows)),
            Interpolation::Linear => None,
        };
        let mut pieces = Vec::with_capacity(rows.len());
        let begin = Time::from_seconds(rows[0].0);
        if begin > Time::ZERO {
            pieces.push(Piece::rest(Time::ZERO, begin, Double::from(rows[0].1))?);
        }
        for (row, pair) in rows.windows(2).enumerate() {
            let ((t0, x0), (t1, x1)) = (pair[0], pair[1]);
            let (start, end) = (Time::from_seconds(t0), Time::from_seconds(t1));
            let (h, way) = ((end - start).seconds(), x1 - x0);
            let mut lay = |zero: Time, start: Time, end: Time, position: f64, c: Vec<f64>| -> Result<(), LawError> {
                let curve = Curve::Polynomial(c);
                let mut piece = Piece { zero, start, end, origin: 0, curve, entry: Entry::Continuous };
                piece.raise(Double::from(position))?;
                pieces.push(piece);
                Ok(())
            };
            let secant = way / h;
            let Some(m) = &slopes else {
                lay(start, start, end, x0, vec![0.0, secant])?;
                continue;
            };
            let (m0, m1) = (m[row], m[row + 1]);
            let cubic = (m0 + m1 - 2.0 * secant) / (h * h);
            let from_start = vec![0.0, m0, (3.0 * secant - 2.0 * m0 - m1) / h, cubic];
            let from_end = vec![0.0, m1, (2.0 * m1 + m0 - 3.0 * secant) / h, cubic];
            // Where the motion rests, and where it begins (steps count from there), the row's own numbers must stand: rounding of a curve
            // that comes from the other row would decide when a step there is due, or whether.
            let middle = start + (end - start).divided_by(2);
            if m1 != 0.0 || way == 0.0 || middle == start {
                lay(start, start, end, x0, from_start)?;
            } else if m0 == 0.0 || row == 0 {
                lay(start, start, middle, x0, from_start)?;
                lay(end, middle, end, x1, from_end)?;
            } else {
                lay(end, start, end, x1, from_end)?;
            }
        }
        Law::fixed(pieces, Class::Interpolant)
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
