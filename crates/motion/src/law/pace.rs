//! Laws that differ in frequency: how far one of them is when the other one has the same phase.

use super::{Circle, Law, Sine};
use crate::Time;
use crate::time::Rate;

/// How the own time of a law goes on in a law of the same kind with another frequency.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pace {
    /// The old law's period.
    old: Time,
    /// The new law's period.
    new: Time,
    /// The old law's beginning.
    begins: Time,
}

impl Pace {
    /// The new law's time when the old law's time is `at`; `None` before the old law has begun.
    ///
    /// It has as many whole periods, and the same part of one. It is rounded once, to 2^-53 of a period.
    #[must_use]
    pub fn of_new(self, at: Time) -> Option<Time> {
        let since = (at - self.begins).raw();
        if self.old == self.new {
            return Some(at);
        }
        let (periods, rest) = (since.div_euclid(self.old.raw()), since.rem_euclid(self.old.raw()));
        let rest = Time::from_seconds(Time::from_raw(rest).seconds() / self.old.seconds() * self.new.seconds());
        (since >= 0).then(|| self.begins + self.new.times(periods as u64) + rest)
    }

    /// The rate of the old law's time at which it has the new law's frequency, and the rate of the new law's time at which it has the old one's.
    /// `None` where a rate would be above [`Rate::MAX`], or the frequencies are equal to the bits of a rate.
    #[must_use]
    pub fn rates(self) -> Option<(Rate, Rate)> {
        let faster = self.old.seconds() / self.new.seconds();
        let rates = (Rate::of(faster)?, Rate::of(1.0 / faster)?);
        let is_change = rates != (Rate::ONE, Rate::ONE);
        (is_change && rates.0 > Rate::ZERO && rates.1 > Rate::ZERO).then_some(rates)
    }
}

impl Law {
    /// How this law's time goes on in `new`, if that is a law of the same kind: endless, with the same turns, perhaps of another frequency, size
    /// or place. `None` if it is another kind of law.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time};
    /// let seconds = Time::from_seconds;
    /// let slow = Law::sine(100.0, seconds(2.0), None)?;
    /// let pace = slow.pace_to(&Law::sine(50.0, seconds(1.0), None)?).unwrap();
    /// // A quarter of the fourth period.
    /// assert_eq!(pace.of_new(seconds(6.5)), Some(seconds(3.25)));
    /// assert_eq!(slow.pace_to(&Law::speed(100.0, None)?), None);
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    #[must_use]
    pub fn pace_to(&self, new: &Law) -> Option<Pace> {
        let endless = |old: Time, new: Time| Pace { old, new, begins: Time::ZERO };
        match (self, new) {
            (Law::Sine(Sine { period: old, cycles: None, .. }), Law::Sine(Sine { period: new, cycles: None, .. })) => {
                Some(endless(*old, *new))
            }
            (Law::Circle(old), Law::Circle(new)) => Circle::periods(old, new).map(|(old, new)| endless(old, new)),
            (Law::Changed(old), Law::Changed(new)) => Some(old.law.pace_to(&new.law)?.later(old.delay)),
            // A scaled or delayed law, and one that is neither.
            (Law::Changed(old), new) => Some(old.law.pace_to(new)?.later(old.delay)),
            (old, Law::Changed(new)) => old.pace_to(&new.law),
            (Law::Then(old), Law::Then(new)) => {
                let ((old_last, old_before), (new_last, new_before)) = (old.split_last()?, new.split_last()?);
                let begins = old_before.iter().map(Law::end).try_fold(Time::ZERO, |end, e| Some(end + e?))?;
                (old_before.len() == new_before.len()).then_some(())?;
                Some(old_last.pace_to(new_last)?.later(begins))
            }
            (Law::Sum(old), Law::Sum(new)) => {
                let mut paces = old.iter().zip(new.iter()).map(|(old, new)| old.pace_to(new));
                let first = paces.next()??;
                (old.len() == new.len() && paces.all(|pace| pace == Some(first))).then_some(first)
            }
            (Law::Blended(old), Law::Blended(new)) => old.law().pace_to(new.law()),
            (Law::Backlash(old), Law::Backlash(new)) => old.law().pace_to(new.law()),
            _ => None,
        }
    }
}

impl Pace {
    /// The pace of laws that begin `by` later.
    fn later(self, by: Time) -> Pace {
        Pace { begins: self.begins + by, ..self }
    }
}
