//! Constant speed and rest.

use super::{Curve, Double, Entry, Law, LawError, Piece, checked};
use crate::Time;

/// θ = speed·t. Endless ones go on in windows whose whole steps are exact, so that days lose nothing.
#[derive(Clone, Debug)]
pub struct Steady {
    /// steps/s; 0 is rest.
    pub speed: f64,
    /// How long; `None`: endless.
    pub duration: Option<Time>,
}

/// Steps in a window at most: within it a position is exact to 2^-29 step.
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
    pub(super) fn pieces(&self) -> impl Iterator<Item = Result<Piece, LawError>> + '_ {
        let end = self.duration.unwrap_or(Time::MAX);
        // A power of two, so that every window starts at an exact time.
        let length = libm::exp2(libm::floor(libm::log2((WINDOW_STEPS / self.speed.abs()).clamp(1e-6, LONGEST_S))));
        let window = Time::from_seconds(length);
        (0..).map(move |k| window.times(k)).take_while(move |&start| start < end).map(move |start| {
            let mut piece = Piece {
                zero: start,
                start,
                end: end.min(start + window),
                origin: 0,
                curve: Curve::Polynomial(if self.speed == 0.0 { vec![0.0] } else { vec![0.0, self.speed] }),
                entry: Entry::Continuous,
            };
            piece.raise(Double::from(self.speed) * Double::from(start))?;
            Ok(piece)
        })
    }
}
