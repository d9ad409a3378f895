//! A law whose own time runs at another rate: pause, resume, tempo.
//!
//! Positions stay the same, and so do the phases of motors that are eased alike. Only the times change.
//!
//! With x from 0 to 1 over the easing, the rate of the law's time is r0 + (r1 − r0)·(3x² − 2x³). Accelerations are
//! |θ''|·rate² + |θ'|·1.5·|r1 − r0|/over at most.

use super::accurate::Accurate;
use super::{Class, Curve, Double, Entry, Law, LawError, Piece, checked};
use crate::Time;
use crate::time::Rate;
use std::collections::VecDeque;
use std::sync::Arc;

/// A law from a time of its own on, slowed to a halt or started from one.
#[derive(Clone, Debug, PartialEq)]
pub struct Warped {
    law: Law,
    from: Time,
    ease: Ease,
}

/// How the rate of a law's time changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ease {
    /// The rate before.
    pub before: Rate,
    /// For how long that rate goes on.
    pub after: Time,
    /// How long the rate then takes to change. The law's time gets on meanwhile as at the mean of both rates. 0 only if the rate does not change.
    pub over: Time,
    /// The rate from then on. At a halt the law ends.
    pub to: Rate,
}

impl Ease {
    /// No change of the rate.
    #[must_use]
    pub const fn steady(rate: Rate) -> Ease {
        Ease { before: rate, after: Time::ZERO, over: Time::ZERO, to: rate }
    }

    /// How far the law's time gets until the rate has changed.
    #[must_use]
    pub fn of_law(&self) -> Time {
        self.before.of_law(self.after) + (self.before.of_law(self.over) + self.to.of_law(self.over)).divided_by(2)
    }

    /// When the rate has changed.
    #[must_use]
    pub fn end(&self) -> Time {
        self.after + self.over
    }
}

impl Law {
    /// This law from its time `from` on. It continues for `after`, and then slows to a halt within `over`, in which its own time moves on by
    /// `over`/2. It ends there, at rest.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time, law::Cursor};
    /// let seconds = Time::from_seconds;
    /// let law = Law::speed(100.0, None)?.eased_out(seconds(3.0), seconds(1.0), seconds(0.5))?;
    /// assert_eq!(law.end(), Some(seconds(1.5)));
    /// let mut cursor = Cursor::new(&law);
    /// assert_eq!(cursor.at(seconds(1.0))?.position, 400.0);
    /// assert!((cursor.at(seconds(1.5))?.position - 425.0).abs() < 1e-9);
    /// assert!(Law::speed(100.0, None)?.eased_out(seconds(3.0), seconds(1.0), Time::ZERO).is_err());
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    ///
    /// # Errors
    /// [`LawError::Parameter`] if `from` or `after` is negative, or `over` not 1e-6 to 1e6 s.
    pub fn eased_out(self, from: Time, after: Time, over: Time) -> Result<Law, LawError> {
        self.retimed(from, Ease { before: Rate::ONE, after, over, to: Rate::ZERO })
    }

    /// This law from its time `from` on, started from a halt: in the first `over` its own time moves on by `over`/2.
    ///
    /// To continue after [`eased_out`](Law::eased_out), use its `from + after + over/2` as `from`.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if `from` is negative, or `over` not 1e-6 to 1e6 s.
    pub fn eased_in(self, from: Time, over: Time) -> Result<Law, LawError> {
        self.retimed(from, Ease { before: Rate::ZERO, after: Time::ZERO, over, to: Rate::ONE })
    }

    /// This law, started from a halt and slowed to a halt at its end: the first and the last `over`/2 of its own time take `over` each. Laws
    /// that are eased alike still draw the same figure together.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time, law::Cursor};
    /// let law = Law::speed(100.0, Some(Time::from_seconds(3.0)))?.eased(Time::SECOND)?;
    /// assert_eq!(law.end(), Some(Time::from_seconds(4.0)));
    /// let mut cursor = Cursor::new(&law);
    /// assert_eq!(cursor.at(Time::from_seconds(2.0))?.position, 150.0);
    /// assert!((cursor.at(Time::from_seconds(4.0))?.position - 300.0).abs() < 1e-9);
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    ///
    /// # Errors
    /// [`LawError::Parameter`] if `over` is not 1e-6 to 1e6 s, or longer than the law.
    pub fn eased(self, over: Time) -> Result<Law, LawError> {
        let end = self.end();
        let begun = self.eased_in(Time::ZERO, over)?;
        match (end, begun.end()) {
            (Some(end), Some(later)) if end >= over => begun.eased_out(Time::ZERO, later - over.divided_by(2), over),
            (None, _) => Ok(begun),
            _ => Err(LawError::Parameter(format!(
                "an easing of {} s is longer than the motion, {} s",
                over.seconds(),
                end.map_or(0.0, Time::seconds)
            ))),
        }
    }

    /// This law from its time `from` on, with its time's rate changed by an easing. Laws that are retimed alike keep to their common figure.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time, law::{Cursor, Ease}, time::Rate};
    /// let seconds = Time::from_seconds;
    /// let (before, to) = (Rate::ONE, Rate::of(0.5).unwrap());
    /// let ease = Ease { before, after: seconds(1.0), over: seconds(2.0), to };
    /// let law = Law::speed(100.0, Some(seconds(10.0)))?.retimed(seconds(3.0), ease)?;
    /// // 1 s at full rate, 1.5 s of the law within 2 s, and what is left, 4.5 s, at half the rate.
    /// assert_eq!(law.end(), Some(seconds(12.0)));
    /// assert_eq!(Cursor::new(&law).at(seconds(5.0))?.speed, 50.0);
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    ///
    /// # Errors
    /// [`LawError::Parameter`] if `from` or `after` is negative, or `over` not 1e-6 to 1e6 s.
    pub fn retimed(self, from: Time, ease: Ease) -> Result<Law, LawError> {
        checked("time of the law", from.seconds(), "s", |t| (0.0..=1e12).contains(&t))?;
        checked("time before the easing", ease.after.seconds(), "s", |t| (0.0..=1e12).contains(&t))?;
        if ease != Ease::steady(ease.to) || ease.to == Rate::ZERO {
            checked("duration of the easing", ease.over.seconds(), "s", |t| (1e-6..=1e6).contains(&t))?;
        }
        Ok(Law::Warped(Arc::new(Warped { law: self, from, ease })))
    }
}

/// A part of the warped law, from `start` to `end`, which begins at the law's own time `from`.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    start: Time,
    end: Time,
    from: Time,
    /// The law's time at the end.
    to: Time,
    map: Map,
}

/// The law's time within a stretch.
#[derive(Clone, Copy, Debug)]
enum Map {
    /// It runs at one rate.
    Steady(Rate),
    /// Its rate changes: the law's time, since `from`, against the time since `start`, s.
    Eased([Accurate; 5]),
}

impl Stretch {
    /// The time at which the law's own time is `at`.
    fn when(&self, at: Time) -> Time {
        if at >= self.to {
            return self.end;
        }
        let map = match self.map {
            Map::Steady(rate) => return self.start + rate.to_pass(at - self.from),
            Map::Eased(map) => map,
        };
        let wanted = (at - self.from).seconds();
        let (mut before, mut after) = (Time::ZERO, self.end - self.start);
        // Bisection, down to the last bit of an f64.
        for _ in 0..64 {
            let middle = before + (after - before).divided_by(2);
            if evaluate(&map, middle.seconds()) < wanted { before = middle } else { after = middle }
        }
        self.start + after
    }

    /// A time of the law that is reached at `at`, a time of this stretch, or shortly before.
    fn about(&self, at: Time) -> Time {
        let since = at.min(self.end) - self.start;
        match self.map {
            Map::Steady(rate) => self.from + rate.of_law(since),
            // Less by far more than the map is rounded.
            Map::Eased(map) => self.from + Time::from_seconds(evaluate(&map, since.seconds()) * (1.0 - 1e-9) - 1e-9),
        }
    }

    /// A piece of the law's own time in this stretch, from `at` to `end`.
    fn warped(&self, own: &Piece, at: Time, end: Time) -> Piece {
        let mut warped = own.clone();
        (warped.start, warped.end) = (at, end);
        let map = match self.map {
            Map::Steady(Rate::ONE) => {
                warped.zero = own.zero + (self.start - self.from);
                return warped;
            }
            Map::Steady(rate) => {
                // The piece's own zero is near the piece, also after days. What 2^-64 s round off is in the map's constant.
                let after = rate.to_pass(own.zero - self.from);
                warped.zero = self.start + after;
                let off = Double::from(self.from + rate.of_law(after)) - Double::from(own.zero);
                let zero = Accurate::ZERO;
                [Accurate::of(off), Accurate::of(Double::from(rate.get())), zero, zero, zero]
            }
            Map::Eased(mut map) => {
                map[0] = Accurate::of(Double::from(self.from) - Double::from(own.zero));
                warped.zero = self.start;
                map
            }
        };
        if !own.curve.is_constant() {
            let terms = own.curve.terms().map(|terms| terms.warped(map));
            let (curve, time) = (Box::new(own.curve.clone().plain()), map.map(Accurate::nearest));
            warped.curve = Curve::Warped { curve, time }.accurate_by(terms);
        }
        warped
    }
}

fn evaluate(map: &[Accurate; 5], u: f64) -> f64 {
    map.iter().rev().fold(0.0, |sum, c| sum * u + c.nearest())
}

impl Warped {
    fn stretches(&self) -> Vec<Stretch> {
        let Ease { before, after, over, to } = self.ease;
        let (slow, eased) = (self.from + before.of_law(after), self.from + self.ease.of_law());
        // Of x³ − x⁴/2 over the easing, in its seconds.
        let d = Accurate::of(Double::from(over));
        let change = Accurate::of(Double::from(to.get() - before.get()));
        let cube = change / (d * d);
        let zero = Accurate::ZERO;
        let map = [zero, Accurate::of(Double::from(before.get())), zero, cube, -(cube / (d + d))];
        let end = self.ease.end();
        let mut stretches = Vec::with_capacity(3);
        if after > Time::ZERO {
            let map = Map::Steady(before);
            stretches.push(Stretch { start: Time::ZERO, end: after, from: self.from, to: slow, map });
        }
        if over > Time::ZERO {
            stretches.push(Stretch { start: after, end, from: slow, to: eased, map: Map::Eased(map) });
        }
        if to > Rate::ZERO {
            let map = Map::Steady(to);
            stretches.push(Stretch { start: end, end: Time::MAX, from: eased, to: Time::MAX, map });
        }
        stretches
    }

    pub(super) fn end(&self) -> Option<Time> {
        let eased = self.from + self.ease.of_law();
        if self.ease.to == Rate::ZERO {
            return Some(self.ease.end());
        }
        let left = |end: Time| self.ease.to.to_pass((end - eased).clamp(Time::ZERO, Time::MAX));
        self.law.end().map(|end| self.ease.end() + left(end))
    }

    /// The law whose time it is.
    pub(super) const fn law(&self) -> &Law {
        &self.law
    }

    /// The law's time at `at`, and the rate of that time; `None` before the easing has ended, and at a halt.
    pub(super) fn eased_at(&self, at: Time) -> Option<(Time, Rate)> {
        let since = at - self.ease.end();
        let goes_on = since >= Time::ZERO && self.ease.to > Rate::ZERO;
        goes_on.then(|| (self.from + self.ease.of_law() + self.ease.to.of_law(since), self.ease.to))
    }

    /// Another law with this law's easing.
    pub(super) const fn of(&self, law: Law) -> Warped {
        Warped { law, from: self.from, ease: self.ease }
    }

    pub(super) fn class(&self) -> Class {
        self.law.class().max(Class::Enclosed)
    }

    pub(super) fn pieces_from(&self, from: Time) -> impl Iterator<Item = Result<Piece, LawError>> + use<> {
        let mut stretches: VecDeque<Stretch> = self.stretches().into();
        let there = stretches.iter().find(|stretch| from < stretch.end).or(stretches.back());
        let mut inner = self.law.pieces_from(there.map_or(self.from, |stretch| stretch.about(from))).peekable();
        // Where the law's first piece that is needed begins.
        let mut at = Time::ZERO;
        if let Some(Ok(first)) = inner.peek() {
            while stretches.len() > 1 && stretches[0].to < first.start {
                stretches.pop_front();
            }
            let begins = |stretch: &Stretch| {
                if first.start > stretch.from { stretch.when(first.start) } else { stretch.start }
            };
            at = stretches.front().map_or(at, begins);
        }
        let eased = self.ease.end();
        // The law's piece at hand, and how far the warped law is.
        let mut piece: Option<Piece> = None;
        let mut entered = false;
        std::iter::from_fn(move || {
            loop {
                let stretch = *stretches.front()?;
                if at >= stretch.end {
                    stretches.pop_front();
                    continue;
                }
                // A piece that ends at this time is over.
                let over = |piece: &Piece| piece.end <= stretch.from || stretch.when(piece.end) <= at;
                while piece.as_ref().is_none_or(over) {
                    match inner.next() {
                        Some(Ok(next)) => (piece, entered) = (Some(next), true),
                        Some(Err(error)) => return Some(Err(error)),
                        None => {
                            // The law has ended: it stays where it is until the easing has, too.
                            let end = at.max(eased);
                            let last = piece.as_ref().map(Piece::last_position);
                            stretches.clear();
                            // A law that ended earlier has this piece alone.
                            let end = if at == Time::ZERO { end.max(Time::from_raw(1)) } else { end };
                            return last.filter(|_| end > at).map(|position| Piece::rest(at, end, position));
                        }
                    }
                }
                let own = piece.as_ref()?;
                let end = stretch.when(own.end);
                let mut warped = stretch.warped(own, at, end);
                // Where it was cut it goes on as it is.
                if !std::mem::take(&mut entered) || own.start < stretch.from {
                    warped.entry = Entry::Continuous;
                }
                at = end;
                return Some(Ok(warped));
            }
        })
    }
}
