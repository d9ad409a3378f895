//! The Lorenz attractor: a law that has no formula, solved by Taylor series with error control.
//!
//! x' = σ(y − x), y' = x(ρ − z) − y, z' = xy − βz. Source: E. N. Lorenz, "Deterministic nonperiodic flow", J. Atmos. Sci.
//! 20 (1963), equations 25 to 27.
//!
//! Each piece is the Taylor polynomial of the orbit about the piece's beginning; it ends where its last terms come to
//! 1e-17 of the orbit's size. Two orbits that differ by that much separate within some tens of time units, however they are
//! computed. So a certificate is relative to these polynomials.

use super::{Class, Curve, Double, Entry, FARTHEST, Law, LawError, Piece, checked};
use crate::Time;

/// The equations' parameters and where the orbit begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// Lorenz's own: 10.
    pub sigma: f64,
    /// Lorenz's own: 28.
    pub rho: f64,
    /// Lorenz's own: 8/3.
    pub beta: f64,
    /// x, y and z at the beginning.
    pub start: [f64; 3],
}

/// A coordinate of an orbit as a law.
#[derive(Clone, Debug, PartialEq)]
pub struct Lorenz {
    orbit: Orbit,
    /// 0, 1 or 2.
    coordinate: usize,
    /// Steps for one unit of the coordinate.
    scale: f64,
    /// Units of the equations' time in a second.
    speed: f64,
    duration: Option<Time>,
}

/// Coefficients of each series.
const TERMS: usize = 24;
/// The size of the last terms at a piece's end, relative to the orbit's size. It is below f64's rounding.
const LAST_TERM: f64 = 1e-17;
/// A smaller state counts as 0, because its series would have numbers below f64's normal range.
const NOTHING: f64 = 1e-270;
/// The shortest piece, in units of the equations' time. An orbit that needs shorter ones runs away.
const SHORTEST: f64 = 1e-7;

type TaylorSeries = [f64; TERMS];

impl Orbit {
    /// Lorenz's own parameters, from a point near the attractor.
    pub const CLASSIC: Orbit = Orbit { sigma: 10.0, rho: 28.0, beta: 8.0 / 3.0, start: [1.0, 1.0, 25.0] };

    /// The Taylor series of x, y and z from a state on.
    fn expand(&self, state: [f64; 3]) -> [TaylorSeries; 3] {
        let [mut x, mut y, mut z] = [[0.0; TERMS]; 3];
        [x[0], y[0], z[0]] = state;
        for k in 0..TERMS - 1 {
            // Cauchy products: coefficient k of x·z and of x·y.
            let xz: f64 = (0..=k).map(|j| x[j] * z[k - j]).sum();
            let xy: f64 = (0..=k).map(|j| x[j] * y[k - j]).sum();
            let next = (k + 1) as f64;
            x[k + 1] = self.sigma * (y[k] - x[k]) / next;
            y[k + 1] = (self.rho * x[k] - xz - y[k]) / next;
            z[k + 1] = (xy - self.beta * z[k]) / next;
        }
        [x, y, z]
    }
}

/// How long a state's series are precise enough, in units of the equations' time.
fn reach(series: &[TaylorSeries; 3]) -> f64 {
    let size = |k: usize| series.iter().map(|s| s[k].abs()).fold(0.0, f64::max);
    // Two terms are looked at, since one may be small by chance. At a fixed point all are.
    (TERMS - 4..TERMS)
        .map(|k| libm::pow(LAST_TERM * size(0) / size(k).max(f64::MIN_POSITIVE), 1.0 / k as f64))
        .fold(1.0, f64::min)
}

impl Law {
    /// Coordinate 0, 1 or 2 of an orbit, `scale` steps for one of its units, `speed` of its units of time in a second.
    ///
    /// An orbit that runs away is an error of the law's [`pieces`](Law::pieces), with the time.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time, law::{Cursor, Orbit}};
    /// let law = Law::lorenz(Orbit::CLASSIC, 2, 10.0, 0.5, Some(Time::from_seconds(20.0)))?;
    /// assert_eq!(Cursor::new(&law).at(Time::ZERO)?.position, 250.0);
    /// assert!(Law::lorenz(Orbit::CLASSIC, 2, 10.0, 0.0, None).is_err());
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    ///
    /// # Errors
    /// [`LawError::Parameter`] if a parameter or the start is beyond ±1000, the start (0, 0, 0), where every orbit rests, the speed not 1e-6 to 1e6, the scale 0 or beyond
    /// 1e12, the duration not positive, or there is no such coordinate.
    pub fn lorenz(
        orbit: Orbit,
        coordinate: usize,
        scale: f64,
        speed: f64,
        duration: Option<Time>,
    ) -> Result<Law, LawError> {
        let Orbit { sigma, rho, beta, start: [x, y, z] } = orbit;
        for (name, value) in [("sigma", sigma), ("rho", rho), ("beta", beta), ("x", x), ("y", y), ("z", z)] {
            if value.is_nan() || value.abs() > 1000.0 {
                return Err(LawError::Parameter(format!("{name} is {value}; it must be from -1000 to 1000")));
            }
        }
        if orbit.start == [0.0; 3] {
            let why = "an orbit that starts at (0, 0, 0) rests there: begin near it, for example at (1, 1, 25)";
            return Err(LawError::Parameter(why.into()));
        }
        checked("scale", scale, "steps", |s| s != 0.0 && s.abs() <= 1e12)?;
        checked("speed", speed, "units of time in a second", |s| (1e-6..=1e6).contains(&s))?;
        checked("coordinate", coordinate as f64, "", |c| c < 3.0)?;
        if duration.is_some_and(|d| d <= Time::ZERO) {
            return Err(LawError::Parameter("the duration must be positive".into()));
        }
        Ok(Law::Lorenz(Lorenz { orbit, coordinate, scale, speed, duration }))
    }
}

impl Lorenz {
    pub(super) fn end(&self) -> Option<Time> {
        self.duration
    }

    pub(super) const fn class() -> Class {
        Class::Interpolant
    }

    pub(super) fn pieces(self) -> impl Iterator<Item = Result<Piece, LawError>> {
        let last = self.duration.unwrap_or(Time::MAX);
        let (mut state, mut start) = (self.orbit.start, Time::ZERO);
        std::iter::from_fn(move || {
            if start >= last {
                return None;
            }
            if state.iter().all(|s| s.abs() < NOTHING) {
                // It has come to rest at (0, 0, 0).
                let rest = Piece::rest(start, last, Double::ZERO);
                start = last;
                return Some(rest);
            }
            let series = self.orbit.expand(state);
            let reach = reach(&series);
            let far = series.iter().any(|s| (s[0] * self.scale).abs() > FARTHEST);
            if reach.is_nan() || reach < SHORTEST || far {
                let why = format!("the orbit runs away: it is at ({}, {}, {})", state[0], state[1], state[2]);
                let at_s = start.seconds();
                start = last;
                return Some(Err(LawError::Undefined { at_s, why }));
            }
            let end = last.min(start + Time::from_seconds(reach / self.speed));
            let ahead = (end - start).seconds() * self.speed;
            state = series.map(|s| s.iter().rev().fold(0.0, |sum, c| sum * ahead + c));
            let mut scale = self.scale;
            let coefficients = series[self.coordinate].iter().map(|c| {
                let scaled = c * scale;
                scale *= self.speed;
                scaled
            });
            let curve = Curve::Polynomial(coefficients.collect());
            let piece = Piece { zero: start, start, end, origin: 0, curve, entry: Entry::Continuous };
            start = end;
            Some(Ok(piece))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_orbit_that_runs_away_is_told_with_its_time() {
        // With σ < 0 and ρ = 0, x grows like e^(10 t).
        let orbit = Orbit { sigma: -10.0, rho: 0.0, beta: 1.0, start: [1.0, 0.0, 0.0] };
        let law = Law::lorenz(orbit, 0, 1.0, 1.0, Some(Time::from_seconds(100.0))).unwrap();
        let error = law.pieces().find_map(Result::err).unwrap();
        let LawError::Undefined { at_s, why } = error else { panic!("{error}") };
        assert!((3.0..5.0).contains(&at_s), "{at_s} s");
        assert!(why.starts_with("the orbit runs away"), "{why}");
        assert_eq!(law.pieces().filter(Result::is_err).count(), 1);
    }
}
