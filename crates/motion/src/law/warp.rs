//! A law whose own time is slowed to a halt, or brought up to speed again: pause and resume.
//!
//! Positions stay the same, and so do the phases of motors that are eased alike. Only the times change.
//!
//! With x from 0 to 1 over the easing, the law's time runs at 1 − (3x² − 2x³) or at 3x² − 2x³ of its rate: speeds are never
//! higher than the law's, and accelerations are |θ''|·rate² + |θ'|·1.5/over at most.

use super::accurate::Accurate;
use super::{Class, Curve, Double, Entry, Law, LawError, Piece, checked};
use crate::Time;
use std::collections::VecDeque;
use std::sync::Arc;

/// A law from a time of its own on, slowed to a halt or started from one.
#[derive(Clone, Debug)]
pub struct Warped {
    law: Law,
    from: Time,
    ease: Ease,
}

#[derive(Clone, Copy, Debug)]
enum Ease {
    /// It continues for a while, and then slows to a halt.
    Out { after: Time, over: Time },
    /// It starts from a halt.
    In { over: Time },
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
        checked("time before the easing", after.seconds(), "s", |t| (0.0..=1e12).contains(&t))?;
        self.warped(from, over, Ease::Out { after, over })
    }

    /// This law from its time `from` on, started from a halt: in the first `over` its own time moves on by `over`/2.
    ///
    /// To continue after [`eased_out`](Law::eased_out), use its `from + after + over/2` as `from`.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if `from` is negative, or `over` not 1e-6 to 1e6 s.
    pub fn eased_in(self, from: Time, over: Time) -> Result<Law, LawError> {
        self.warped(from, over, Ease::In { over })
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

    fn warped(self, from: Time, over: Time, ease: Ease) -> Result<Law, LawError> {
        checked("time of the law", from.seconds(), "s", |t| (0.0..=1e12).contains(&t))?;
        checked("duration of the easing", over.seconds(), "s", |t| (1e-6..=1e6).contains(&t))?;
        Ok(Law::Warped(Arc::new(Warped { law: self, from, ease })))
    }
}

/// A part of the warped law, from `start` to `end`, which begins at the law's own time `from`.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    start: Time,
    end: Time,
    from: Time,
    /// The law's own time since `from`, as a polynomial of the time since `start`, s; `None`: they are equal.
    map: Option<[Accurate; 5]>,
}

impl Stretch {
    fn plain(start: Time, end: Time, from: Time) -> Stretch {
        Stretch { start, end, from, map: None }
    }

    /// The law's own time at the end.
    fn to(&self) -> Time {
        let span = self.end - self.start;
        self.from + if self.map.is_some() { span.divided_by(2) } else { span }
    }

    /// The time at which the law's own time is `at`.
    fn when(&self, at: Time) -> Time {
        if at >= self.to() {
            return self.end;
        }
        let Some(map) = self.map else { return self.start + (at - self.from) };
        let wanted = (at - self.from).seconds();
        let (mut before, mut after) = (Time::ZERO, self.end - self.start);
        // Bisection, down to the last bit of an f64.
        for _ in 0..64 {
            let middle = before + (after - before).divided_by(2);
            if evaluate(&map, middle.seconds()) < wanted { before = middle } else { after = middle }
        }
        self.start + after
    }
}

fn evaluate(map: &[Accurate; 5], u: f64) -> f64 {
    map.iter().rev().fold(0.0, |sum, c| sum * u + c.nearest())
}

impl Warped {
    fn stretches(&self) -> Vec<Stretch> {
        // The coefficients of x³ − x⁴/2, with x from 0 to 1 over this time, in seconds.
        let bend = |over: Time| {
            let d = Accurate::of(Double::from(over));
            let cube = Accurate::ONE / (d * d);
            (cube, cube / (d + d))
        };
        let zero = Accurate::ZERO;
        match self.ease {
            Ease::Out { after, over: slowing } => {
                let (c, d) = bend(slowing);
                let map = [zero, Accurate::ONE, zero, -c, d];
                let eased = Stretch { start: after, end: after + slowing, from: self.from + after, map: Some(map) };
                let plain = Stretch::plain(Time::ZERO, after, self.from);
                if after > Time::ZERO { vec![plain, eased] } else { vec![eased] }
            }
            Ease::In { over: rising } => {
                let (c, d) = bend(rising);
                let map = [zero, zero, zero, c, -d];
                let eased = Stretch { start: Time::ZERO, end: rising, from: self.from, map: Some(map) };
                vec![eased, Stretch::plain(rising, Time::MAX, eased.to())]
            }
        }
    }

    pub(super) fn end(&self) -> Option<Time> {
        match self.ease {
            Ease::Out { after, over } => Some(after + over),
            Ease::In { over } => {
                let half = over.divided_by(2);
                self.law.end().map(|end| over + (end - self.from - half).clamp(Time::ZERO, Time::MAX))
            }
        }
    }

    /// The law whose time it is.
    pub(super) const fn law(&self) -> &Law {
        &self.law
    }

    /// Another law with this law's easing.
    pub(super) const fn of(&self, law: Law) -> Warped {
        Warped { law, from: self.from, ease: self.ease }
    }

    pub(super) fn class(&self) -> Class {
        self.law.class().max(Class::Enclosed)
    }

    pub(super) fn pieces(&self) -> impl Iterator<Item = Result<Piece, LawError>> + use<> {
        let mut stretches: VecDeque<Stretch> = self.stretches().into();
        let mut inner = self.law.pieces();
        // The law's current piece, and the time up to which the warped law is done.
        let mut piece: Option<Piece> = None;
        let mut at = Time::ZERO;
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
                            // The law has ended. It stays where it is until the easing is over, too.
                            let end = if stretch.end == Time::MAX { at } else { stretch.end };
                            let last = piece.as_ref().map(Piece::last_position);
                            stretches.clear();
                            return last.filter(|_| end > at).map(|position| Piece::rest(at, end, position));
                        }
                    }
                }
                let own = piece.as_ref()?;
                let end = stretch.when(own.end);
                let mut warped = own.clone();
                (warped.start, warped.end) = (at, end);
                match stretch.map {
                    None => warped.zero = own.zero + (stretch.start - stretch.from),
                    Some(mut map) => {
                        map[0] = Accurate::of(Double::from(stretch.from) - Double::from(own.zero));
                        warped.zero = stretch.start;
                        if !own.curve.is_constant() {
                            let terms = own.curve.terms().map(|terms| terms.warped(map));
                            let (curve, time) = (Box::new(own.curve.clone().plain()), map.map(Accurate::nearest));
                            warped.curve = Curve::Warped { curve, time }.accurate_by(terms);
                        }
                    }
                }
                // Inside a piece of the law nothing jumps.
                if !std::mem::take(&mut entered) || own.start < stretch.from {
                    warped.entry = Entry::Continuous;
                }
                at = end;
                return Some(Ok(warped));
            }
        })
    }
}
