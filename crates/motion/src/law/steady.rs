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

/// What a law with an endless constant speed has of it, at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinePart {
    /// steps/s.
    pub speed: f64,
    /// How far that speed has brought the motor since the law began, steps.
    pub way: f64,
    /// What the law's shifts add to that, steps.
    pub offset: f64,
    /// The motor takes up backlash where the speed reverses.
    pub has_backlash: bool,
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

    /// What this law has of an endless constant speed, at its own time `at`; `None` if it has none then, or if it ends.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time};
    /// let seconds = Time::from_seconds;
    /// let turning = Law::speed(100.0, None)?.delayed(seconds(1.0))?;
    /// let law = Law::sum(vec![turning, Law::sine(20.0, seconds(1.0), None)?])?;
    /// let part = law.line_part(seconds(3.0)).unwrap();
    /// assert_eq!((part.speed, part.way), (100.0, 200.0));
    /// assert_eq!(law.line_part(seconds(0.5)), None);
    /// // An easing of 1 s loses half of the first second's way.
    /// let eased = Law::speed(100.0, None)?.eased(seconds(1.0))?;
    /// assert_eq!(eased.line_part(seconds(3.0)).unwrap().way, 250.0);
    /// assert_eq!(eased.line_part(seconds(0.5)), None);
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    #[must_use]
    pub fn line_part(&self, at: Time) -> Option<LinePart> {
        match self {
            Law::Steady(Steady { speed, duration: None }) => {
                let way = (Double::from(*speed) * Double::from(at)).nearest();
                Some(LinePart { speed: *speed, way, offset: 0.0, has_backlash: false })
            }
            Law::Changed(changed) if at >= changed.delay => {
                Some(changed.of_line(changed.law.line_part(at - changed.delay)?))
            }
            Law::Then(laws) => {
                let (last, before) = laws.split_last()?;
                let begins = before.iter().map(Law::end).try_fold(Time::ZERO, |end, e| Some(end + e?))?;
                if at >= begins { last.line_part(at - begins) } else { None }
            }
            Law::Blended(blended) if blended.end().is_none() && at >= blended.begun() => {
                Some(blended.of_line(blended.law().line_part(at)?))
            }
            Law::Warped(warped) => {
                let (law_time, rate) = warped.eased_at(at)?;
                let line = warped.law().line_part(law_time)?;
                Some(LinePart { speed: rate.get() * line.speed, ..line })
            }
            Law::Sum(laws) => laws.iter().filter_map(|law| law.line_part(at)).reduce(|a, b| LinePart {
                speed: a.speed + b.speed,
                way: a.way + b.way,
                offset: a.offset + b.offset,
                has_backlash: a.has_backlash || b.has_backlash,
            }),
            // A swing has turns of its own.
            Law::Backlash(backlash) if backlash.law().is_line() => {
                Some(LinePart { has_backlash: true, ..backlash.law().line_part(at)? })
            }
            _ => None,
        }
    }

    /// Whether it is nothing but a constant speed, from some time on.
    fn is_line(&self) -> bool {
        match self {
            Law::Steady(steady) => steady.duration.is_none(),
            Law::Changed(changed) => changed.law.is_line(),
            Law::Blended(blended) => blended.law().is_line(),
            Law::Warped(warped) => warped.law().is_line(),
            _ => false,
        }
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
