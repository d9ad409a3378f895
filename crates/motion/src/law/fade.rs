//! A law that changes into another one: (1 − w)·old + w·new, with a weight w that rises from 0 to 1.
//!
//! With x from 0 to 1 over the fade, w = 10x³ − 15x⁴ + 6x⁵: speed and acceleration change without a jump at both ends. What the fade
//! adds to the laws' own motion, with d = new − old: |d'|·w + |d|·1.875/over to the speed.

use super::accurate::Accurate;
use super::combine::Summand;
use super::{Class, Curve, Double, Entry, Law, LawError, Piece, Pieces, checked};
use crate::Time;
use std::sync::Arc;

/// A law that follows another one up to `from`, changes over within `over`, and then is the new one. Both laws have the same time.
#[derive(Clone, Debug, PartialEq)]
pub struct Faded {
    old: Law,
    new: Law,
    from: Time,
    over: Time,
    /// What is followed during the fade, if that is no blend of both laws' positions: an arm follows the blend of two paths of its effector.
    along: Option<Law>,
}

/// The weight of the new law at x of the fade, from 0 to 1, and its first two derivatives by x.
///
/// ```
/// use pulsetrain_motion::law::fade_weight;
/// assert_eq!(fade_weight(0.0), [0.0, 0.0, 0.0]);
/// assert_eq!(fade_weight(0.5), [0.5, 1.875, 0.0]);
/// assert_eq!(fade_weight(1.0), [1.0, 0.0, 0.0]);
/// ```
#[must_use]
pub fn fade_weight(x: f64) -> [f64; 3] {
    let y = 1.0 - x;
    [x * x * x * (10.0 + x * (6.0 * x - 15.0)), 30.0 * x * x * y * y, 60.0 * x * y * (1.0 - 2.0 * x)]
}

impl Law {
    /// This law up to its time `from`; within `over` it changes into `new`, which has the same time. The new law need not meet this one anywhere.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time, law::Cursor};
    /// let seconds = Time::from_seconds;
    /// // Twice as wide from the third period on.
    /// let law = Law::sine(100.0, seconds(1.0), None)?.faded(Law::sine(200.0, seconds(1.0), None)?, seconds(2.0), seconds(1.0))?;
    /// let mut cursor = Cursor::new(&law);
    /// assert_eq!(cursor.at(seconds(1.5))?.position, 200.0);
    /// assert_eq!(cursor.at(seconds(2.5))?.position, 300.0);
    /// assert_eq!(cursor.at(seconds(3.5))?.position, 400.0);
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    ///
    /// If both are laws of one arm of a delta robot ([`tip_path`](Law::tip_path)), the effector's path fades: its coordinates are blended, and the
    /// arm follows.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if `from` is negative, or `over` not 1e-6 to 1e6 s.
    pub fn faded(self, new: Law, from: Time, over: Time) -> Result<Law, LawError> {
        let along = super::arm::between(&self, &new, from, over);
        self.faded_along(new, from, over, along)
    }

    /// As [`faded`](Law::faded), by the positions of this motor alone, whatever it is part of.
    ///
    /// # Errors
    /// As [`faded`](Law::faded).
    pub fn faded_apart(self, new: Law, from: Time, over: Time) -> Result<Law, LawError> {
        self.faded_along(new, from, over, None)
    }

    fn faded_along(self, new: Law, from: Time, over: Time, along: Option<Law>) -> Result<Law, LawError> {
        checked("time of the fade", from.seconds(), "s", |t| (0.0..=1e12).contains(&t))?;
        checked("duration of the fade", over.seconds(), "s", |t| (1e-6..=1e6).contains(&t))?;
        Ok(Law::Faded(Arc::new(Faded { old: self, new, from, over, along })))
    }
}

impl Faded {
    /// The new law.
    pub(super) const fn new_law(&self) -> &Law {
        &self.new
    }

    /// Both laws.
    pub(super) const fn laws(&self) -> [&Law; 2] {
        [&self.old, &self.new]
    }

    /// What is followed during the fade, if it is no blend of both laws' positions.
    pub(super) const fn along(&self) -> Option<&Law> {
        self.along.as_ref()
    }

    /// When it has become the new law.
    fn until(&self) -> Time {
        self.from + self.over
    }

    pub(super) fn end(&self) -> Option<Time> {
        self.new.end().map(|end| end.max(self.until()))
    }

    pub(super) fn cycle(&self) -> Option<(Time, Time)> {
        self.new.cycle().map(|(from, period)| (from.max(self.until()), period))
    }

    pub(super) fn class(&self) -> Class {
        self.old.class().max(self.new.class()).max(Class::Enclosed)
    }

    pub(super) fn pieces_from(self: Arc<Faded>, at: Time) -> impl Iterator<Item = Result<Piece, LawError>> {
        let (from, until) = (self.from, self.until());
        // After its end there is the last piece alone.
        let at = self.end().map_or(at, |end| at.min(end.before()));
        let cut = move |mut piece: Piece, start: Time, end: Time| {
            if piece.start < start {
                (piece.start, piece.entry) = (start, Entry::Continuous);
            }
            piece.end = piece.end.min(end);
            piece
        };
        let is_over = at >= from;
        let has_ended = self.old.end().is_some_and(|end| end <= at);
        let before = (!is_over && !has_ended).then(|| {
            self.old.pieces_from(at).take_while(move |piece| piece.as_ref().map_or(true, |piece| piece.start < from))
        });
        let before = before.into_iter().flatten().map(move |piece| Ok(cut(piece?, Time::ZERO, from)));
        let rests = self.old.end().filter(|end| *end < from && at < from).map(|end| {
            let last = self.old.pieces_from(end).last().transpose()?;
            Piece::rest(end, from, last.map_or(Double::ZERO, |piece| piece.last_position()))
        });
        let blended: Option<Pieces> = (at < until).then(|| match &self.along {
            None => Box::new(self.blended(at)) as Pieces,
            Some(along) => {
                let pieces = along.pieces_from(at.max(from));
                let during = pieces.take_while(move |piece| piece.as_ref().map_or(true, |piece| piece.start < until));
                Box::new(during.map(move |piece| Ok(cut(piece?, from, until))))
            }
        });
        let blended = blended.into_iter().flatten();
        let after = self
            .new
            .pieces_from(at.max(until))
            .filter(move |piece| piece.as_ref().map_or(true, |piece| piece.end > until));
        before.chain(rests).chain(blended).chain(after.map(move |piece| Ok(cut(piece?, until, Time::MAX))))
    }

    /// The pieces of the fade itself, from the one with time `at` on. One ends wherever a piece of either law ends, and in the middle of the fade.
    fn blended(&self, at: Time) -> impl Iterator<Item = Result<Piece, LawError>> + use<> {
        let (from, until) = (self.from, self.until());
        let middle = from + self.over.divided_by(2);
        let mut laws = [Summand::from(&self.old, from), Summand::from(&self.new, from)];
        let mut next = from;
        let weights = [weight_from_begin(self.over), weight_from_end(self.over)];
        let pieces = std::iter::from_fn(move || {
            if next >= until {
                return None;
            }
            for law in &mut laws {
                if let Err(error) = law.advance(next) {
                    next = until;
                    return Some(Err(error));
                }
            }
            let start = next;
            let (zero, end, weight) =
                if start < middle { (from, middle, &weights[0]) } else { (until, until, &weights[1]) };
            next = laws.iter().filter_map(Summand::ends).fold(end, Time::min);
            Some(blend(
                &laws,
                Piece { zero, start, end: next, origin: 0, curve: Curve::constant(0.0), entry: Entry::Continuous },
                weight,
            ))
        });
        pieces.skip_while(move |piece| piece.as_ref().is_ok_and(|piece| piece.end <= at))
    }
}

/// A fade's weight against the time since it began, 1/s^k.
fn weight_from_begin(over: Time) -> [Accurate; 6] {
    let over = Accurate::of(Double::from(over));
    let cube = over * over * over;
    let c = |c: f64| Accurate::from(c) / cube;
    let zero = Accurate::ZERO;
    [zero, zero, zero, c(10.0), c(-15.0) / over, c(6.0) / (over * over)]
}

/// A fade's weight against the time since its end, which is negative, 1/s^k.
fn weight_from_end(over: Time) -> [Accurate; 6] {
    let [zero, _, _, c3, c4, c5] = weight_from_begin(over);
    [Accurate::ONE, zero, zero, c3, -c4, c5]
}

/// The blend of two laws' pieces, in the place of `blend`.
fn blend(laws: &[Summand; 2], mut blend: Piece, weight: &[Accurate; 6]) -> Result<Piece, LawError> {
    let zero = blend.zero;
    let [(old, from), (new, to)] = laws.each_ref().map(|law| law.about(zero));
    blend.curve = match (old, new) {
        (Curve::Polynomial(old), Curve::Polynomial(new)) => blended_polynomial(&old, &new, to - from, weight),
        (old, mut new) => {
            new.raise(to - from);
            let terms = laws.each_ref().map(|law| law.terms_about(zero));
            let terms = if let [Some(old), Some(mut new)] = terms {
                new.raise(to - from);
                Some(old.faded(new, *weight))
            } else {
                None
            };
            let weight = weight.map(Accurate::nearest);
            Curve::Faded { old: Box::new(old), new: Box::new(new), weight }.accurate_by(terms)
        }
    };
    blend.raise(from)?;
    Ok(blend)
}

/// old + weight·(new + `higher` − old), multiplied out.
fn blended_polynomial(old: &[f64], new: &[f64], higher: Double, weight: &[Accurate; 6]) -> Curve {
    let of = |c: &[f64], k: usize| Double::from(c.get(k).copied().unwrap_or(0.0));
    let weight = weight.map(Accurate::nearest);
    let terms = old.len().max(new.len()).max(1);
    let difference = |k: usize| of(new, k) - of(old, k) + if k == 0 { higher } else { Double::ZERO };
    let c = (0..terms + weight.len() - 1).map(|k| {
        let products = (0..terms.min(k + 1)).map(|i| difference(i) * of(&weight, k - i));
        products.fold(of(old, k), |sum, product| sum + product).nearest()
    });
    Curve::Polynomial(c.collect())
}
