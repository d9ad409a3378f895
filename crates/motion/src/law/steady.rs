//! Constant speed and rest.

use super::formula::Terms;
use super::{Curve, Double, Entry, Law, LawError, Piece, checked};
use crate::Time;

/// θ = speed·t. An endless one consists of windows with an exact number of whole steps, so that it stays exact for days.
#[derive(Clone, Debug, PartialEq)]
pub struct Steady {
    /// steps/s; 0 is rest.
    pub speed: f64,
    /// How long; `None`: endless.
    pub duration: Option<Time>,
}

/// The most steps in a window. Within it a position is exact to 2^-29 step.
const WINDOW_STEPS: f64 = 16_777_216.0;
/// The longest window, s.
const LONGEST_S: f64 = 4096.0;

impl Law {
    /// θ = `speed`·t, `speed` in steps/s of either sign.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if the speed is not finite or beyond 1e12 steps/s, or the duration not positive.
    pub fn speed(speed: f64, duration: Option<Time>) -> Result<Law, LawError> {
        checked("speed", speed, "steps/s", |v| v.abs() <= 1e12)?;
        if duration.is_some_and(|d| d <= Time::ZERO) {
            return Err(LawError::Parameter("the duration must be positive".into()));
        }
        Ok(Law::Steady(Steady { speed, duration }))
    }

    /// No motion for `duration`.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if the duration is not positive.
    pub fn rest(duration: Time) -> Result<Law, LawError> {
        Law::speed(0.0, Some(duration))
    }
}

impl Steady {
    /// The time from which on an endless one repeats, and its period: a number of whole steps that takes a second or two, or one step if that
    /// takes longer. `None` at rest, and for steps of so many minutes that their length is not known well enough in 2^-64 s.
    pub(super) fn cycle(&self) -> Option<(Time, Time)> {
        const FRACTION: u64 = (1 << 52) - 1;
        let speed = self.speed.abs();
        if self.duration.is_some() || !speed.is_normal() {
            return None;
        }
        // speed = mantissa · 2^exponent.
        let mantissa = speed.to_bits() & FRACTION | (FRACTION + 1);
        let zeros = mantissa.trailing_zeros();
        let exponent = (speed.to_bits() >> 52) as i32 - 1075 + zeros as i32;
        let (mantissa, steps) = (i128::from(mantissa >> zeros), libm::ceil(speed) as i128);
        let shift = u32::try_from(64 - exponent).ok().filter(|shift| *shift + 1 < steps.leading_zeros())?;
        Some((Time::ZERO, Time::from_raw(((steps << shift) + mantissa / 2) / mantissa)))
    }

    pub(super) fn pieces_from(self, at: Time) -> impl Iterator<Item = Result<Piece, LawError>> {
        let end = self.duration.unwrap_or(Time::MAX);
        // A power of two, so that every window starts at an exact time.
        let length = libm::exp2(libm::floor(libm::log2((WINDOW_STEPS / self.speed.abs()).clamp(1e-6, LONGEST_S))));
        let window = Time::from_seconds(length);
        // A number of windows beyond u64 is a time beyond every end.
        let first = u64::try_from(at.min(end.before()).raw() / window.raw()).unwrap_or(u64::MAX);
        (first..).map(move |k| window.times(k)).take_while(move |&start| start < end).map(move |start| {
            let mut piece = Piece {
                zero: start,
                start,
                end: end.min(start + window),
                origin: 0,
                curve: Curve::Polynomial(if self.speed == 0.0 { vec![0.0] } else { vec![0.0, self.speed] }),
                entry: Entry::Continuous,
            };
            piece.raise(Double::from(self.speed) * Double::from(start))?;
            // The piece's `origin` has the whole steps.
            let terms = (self.speed != 0.0).then(|| Terms::of_line(self.speed, start, piece.origin));
            piece.curve = piece.curve.accurate_by(terms);
            Ok(piece)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A second or two of whole steps, to the last bit of the speed; no period of what rests, or of a step in an hour.
    #[test]
    fn a_speed_repeats_after_whole_steps() {
        for speed in [1.0, 2.5, -1600.0, 1.0 / 3.0, 33.333_333, 1234.567, 0.002, 1e12, 7.000_000_000_1e8] {
            let endless = Steady { speed, duration: None };
            let (from, period) = endless.cycle().unwrap();
            let steps = period.seconds() * speed.abs();
            assert!(
                from == Time::ZERO && (steps / steps.round() - 1.0).abs() < 5e-16 && steps > 0.5,
                "{speed}: {steps}"
            );
            assert!(speed.abs() < 1.0 || (1.0..2.0).contains(&period.seconds()), "{speed}: {period:?}");
            assert_eq!(Steady { speed, duration: Some(Time::SECOND) }.cycle(), None);
        }
        for speed in [0.0, 1e-300, f64::MIN_POSITIVE / 2.0, 0.000_277_777] {
            assert_eq!(Steady { speed, duration: None }.cycle(), None, "{speed}");
        }
    }
}
