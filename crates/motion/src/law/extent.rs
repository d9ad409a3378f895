//! Proves that several laws together stay within a limit, or finds where they pass it. It uses bounds on whole intervals, not samples.

use super::{Law, LawError, Piece, Pieces};
use crate::Time;

/// The quantity that is compared with a limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Extent {
    /// The first law's value.
    Value,
    /// The length of the vector that the laws' speeds make.
    Speed,
    /// The length of the vector that the laws' accelerations make.
    Acceleration,
}

/// How often a part of a piece is halved at most. In a part of that length a limit is passed by no more than rounding.
const DEEPEST: u32 = 24;
/// The most parts of laws that are looked at, so that the search ends after some seconds.
const MOST_STRETCHES: u32 = 1 << 18;
/// A limit may be passed by this part of it, which is more than rounding.
const SLACK: f64 = 1e-9;
/// A place replaces the worst one so far only if its value is larger by this part. Otherwise the search would follow ever smaller gains.
const FARTHER: f64 = 1e-3;

/// The time at which `laws` (which run together, each multiplied by its scale) pass `limit` by most, and the value then, to a thousandth of it;
/// `None` if they stay within.
///
/// The limit of speeds and accelerations must not be negative.
///
/// # Errors
/// [`LawError::Parameter`] if the laws have too many pieces to look at; and the laws' own errors.
pub(crate) fn farthest_beyond(
    laws: &[(&Law, f64)],
    extent: Extent,
    limit: f64,
) -> Result<Option<(Time, f64)>, LawError> {
    let mut terms: Vec<(Pieces, Option<Piece>)> = laws.iter().map(|(law, _)| (law.pieces(), None)).collect();
    let (mut at, mut worst) = (Time::ZERO, None);
    for _ in 0..MOST_STRETCHES {
        for (pieces, piece) in &mut terms {
            while piece.as_ref().is_none_or(|piece| piece.end <= at) {
                match pieces.next() {
                    Some(next) => *piece = Some(next?),
                    None => return Ok(worst),
                }
            }
        }
        let pieces: Vec<(&Piece, f64)> =
            terms.iter().zip(laws).filter_map(|((_, piece), (_, scale))| Some((piece.as_ref()?, *scale))).collect();
        let Some(end) = pieces.iter().map(|(piece, _)| piece.end).min() else { return Ok(worst) };
        // Each new place has a larger value than those before.
        let mut bar = worst.map_or(limit, farther);
        while let Some(found) = in_part(&pieces, extent, bar, (at, end), 0) {
            // A piece without bounds there cannot be compared.
            if !(found.1 > bar && found.1.is_finite()) {
                return Ok(worst.or(Some(found)));
            }
            (worst, bar) = (Some(found), farther(found));
        }
        at = end;
    }
    if worst.is_some() {
        return Ok(worst);
    }
    Err(LawError::Parameter(format!("the path has more than {MOST_STRETCHES} parts: too long to be checked")))
}

/// The value that a place must exceed to replace this one.
fn farther((_, value): (Time, f64)) -> f64 {
    value + FARTHER * value.abs()
}

/// A time at which they pass the limit between two times, and the value; not always the first or the worst. In each law both times are in one
/// piece.
fn in_part(
    pieces: &[(&Piece, f64)],
    extent: Extent,
    limit: f64,
    (from, to): (Time, Time),
    depth: u32,
) -> Option<(Time, f64)> {
    let middle = from + (to - from).divided_by(2);
    let reach = 0.5 * (to - from).seconds() * (1.0 + 1e-12);
    let (here, most) = match extent {
        Extent::Value => {
            let (piece, scale) = *pieces.first()?;
            let model = Model::of(piece, scale, 0, (from, middle, to), reach);
            (model.c[0], model.most(reach))
        }
        Extent::Speed | Extent::Acceleration => {
            let order = if extent == Extent::Speed { 1 } else { 2 };
            // The square of the length as one polynomial: in a circle its terms cancel.
            let (mut square, mut rest) = (Model::default(), 0.0);
            for &(piece, scale) in pieces {
                let model = Model::of(piece, scale, order, (from, middle, to), reach);
                for (i, a) in model.c[..8].iter().enumerate() {
                    for (j, b) in model.c[..8].iter().enumerate() {
                        square.c[i + j] += a * b;
                    }
                }
                let size: f64 = model.c.iter().rev().fold(0.0, |sum, c| sum * reach + c.abs());
                rest += model.rest * (2.0 * size + model.rest);
            }
            square.rest = rest;
            (square.c[0].max(0.0).sqrt(), square.most(reach).max(0.0).sqrt())
        }
    };
    let allowed = limit + SLACK * limit.abs();
    if here > allowed || !most.is_finite() {
        return Some((middle, here));
    }
    if most <= allowed || depth == DEEPEST {
        return None;
    }
    in_part(pieces, extent, limit, (from, middle), depth + 1)
        .or_else(|| in_part(pieces, extent, limit, (middle, to), depth + 1))
}

/// A polynomial about the middle of a part, and a bound on its error in the part.
#[derive(Default)]
struct Model {
    c: [f64; 15],
    rest: f64,
}

impl Model {
    /// The model of the `order`th derivative of a piece.
    fn of(piece: &Piece, scale: f64, order: usize, (from, middle, to): (Time, Time, Time), reach: f64) -> Model {
        let u = |t: Time| (t - piece.zero).seconds();
        let jet = piece.curve.jet(u(middle));
        let bounds = piece.curve.bounds(u(from), u(to));
        // k·(k − 1)·…: the factor of x^k in the derivative.
        let falling = |k: usize| (0..order).map(|i| (k - i) as f64).product::<f64>();
        let mut model = Model::default();
        let mut power = 1.0;
        for (k, (coefficient, rounding)) in jet.into_iter().zip(bounds.rounding).enumerate().skip(order) {
            model.c[k - order] = falling(k) * coefficient * scale;
            model.rest += falling(k) * rounding * power;
            power *= reach;
        }
        if order == 0 {
            model.c[0] += piece.origin as f64 * scale;
        }
        model.rest = (model.rest + falling(8) * bounds.eighth * power) * scale.abs();
        model
    }

    /// A bound: the polynomial is nowhere larger.
    fn most(&self, reach: f64) -> f64 {
        self.c[0] + self.c[1..].iter().rev().fold(0.0, |sum, c| (sum + c.abs()) * reach) + self.rest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(laws: &[(&Law, f64)], extent: Extent, peak: f64, at_s: Option<f64>) {
        let beyond = |limit| farthest_beyond(laws, extent, limit).unwrap();
        assert_eq!(beyond(peak * 1.000_001), None);
        let (when, value) = beyond(peak * 0.999_999).expect("the peak is beyond it");
        assert!(value > peak * 0.999_999 && value < peak * 1.000_001, "{value}");
        if let Some(at_s) = at_s {
            assert!((when.seconds() - at_s).abs() < 2e-3 * at_s, "{} s", when.seconds());
        }
    }

    #[test]
    fn peaks_are_found_where_they_are() {
        let sine = Law::sine(100.0, Time::SECOND, Some(1)).unwrap();
        check(&[(&sine, 1.0)], Extent::Value, 200.0, Some(0.5));
        check(&[(&sine, 0.5)], Extent::Speed, 50.0 * std::f64::consts::TAU, Some(0.25));
        let formula = Law::formula("exp(-t)*sin(t)", &[], 1.0, Some(Time::from_seconds(3.0))).unwrap();
        // Where sin = cos: t = π/4.
        let quarter = std::f64::consts::FRAC_PI_4;
        check(&[(&formula, 1.0)], Extent::Value, (-quarter).exp() * quarter.sin(), Some(quarter));
    }

    /// Whatever the limit: also where it is passed long before, and passed again, and below 0.
    #[test]
    fn the_worst_moment_is_told_not_the_first() {
        let slow = Law::sine(100.0, Time::from_seconds(2.0), Some(1)).unwrap();
        let fast = Law::sine(100.0, Time::SECOND, Some(3)).unwrap();
        let law = Law::then(vec![slow.clone(), fast, slow]).unwrap();
        let peak = 100.0 * std::f64::consts::TAU;
        for part in [0.01, 0.3, 0.7, 0.99] {
            let (at, value) = farthest_beyond(&[(&law, 1.0)], Extent::Speed, part * peak).unwrap().unwrap();
            assert!(value > 0.998 * peak && value <= peak * 1.000_001, "{value}");
            // Each quarter of the fast one, but for its turns.
            let quarters = (at.seconds() - 2.0) * 4.0;
            assert!((0.9..11.1).contains(&quarters) && ((quarters - 1.0) % 2.0 - 1.0).abs() > 0.9, "{quarters}");
        }
        let (_, value) = farthest_beyond(&[(&law, -1.0)], Extent::Value, -150.0).unwrap().unwrap();
        assert!(value > -1.0, "{value}");
    }

    /// A constant speed just below the limit needs no endless halving.
    #[test]
    fn a_circle_has_one_speed_and_one_acceleration() {
        let period = Time::from_seconds(2.0);
        let [x, y] = [0, 1].map(|k| Law::circle(30.0, period, Some(5), k).unwrap());
        let omega = std::f64::consts::PI;
        check(&[(&x, 1.0), (&y, 1.0)], Extent::Speed, 30.0 * omega, None);
        check(&[(&x, 1.0), (&y, 1.0)], Extent::Acceleration, 30.0 * omega * omega, None);
    }
}
