//! Laws made of laws: sums, sequences, scaled, shifted, delayed and repeated ones.

use super::formula::Terms;
use super::{Curve, Double, Entry, Law, LawError, LinePart, Piece, Pieces, Workload, checked};
use crate::Time;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// θ = factor·law(t − delay) + offset, at rest before `delay`.
#[derive(Clone, Debug, PartialEq)]
pub struct Changed {
    pub(super) law: Law,
    factor: f64,
    offset: f64,
    pub(super) delay: Time,
}

/// A finite law that repeats, each time from where it ended.
#[derive(Clone, Debug, PartialEq)]
pub struct Repeated {
    pub(super) law: Law,
    pub(super) period: Time,
    pub(super) times: Option<u64>,
    /// θ(period) − θ(0).
    net: Double,
}

/// Laws one after the other, each from where the one before ended.
pub struct Sequence {
    laws: Box<[Law]>,
    /// Where the laws begin, from the first up to the last that was read so far. Without it each cursor would work out the ends of all laws before its
    /// time.
    begun: Mutex<Vec<Begun>>,
}

/// Where a law of a sequence begins.
#[derive(Clone, Copy)]
struct Begun {
    at: Time,
    /// What is added to its positions.
    offset: Double,
}

/// The most pieces of a law that is repeated. All of them are looked at beforehand.
pub(super) const MOST_PARTS: usize = 1 << 20;

impl Law {
    /// The sum of `laws`. Each stays where it ends.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if there is none.
    pub fn sum(laws: Vec<Law>) -> Result<Law, LawError> {
        Ok(Law::Sum(some(laws)?.into()))
    }

    /// `laws` one after the other, each from where the one before ended. Only the last may be endless.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if there is none, or one that is not the last is endless.
    pub fn then(laws: Vec<Law>) -> Result<Law, LawError> {
        let laws = some(laws)?;
        match laws.iter().take(laws.len() - 1).position(|law| law.end().is_none()) {
            Some(row) => Err(LawError::Parameter(format!("motion {} is endless: nothing can follow it", row + 1))),
            None => Ok(Law::Then(Arc::new(Sequence { laws: laws.into(), begun: Mutex::default() }))),
        }
    }

    /// θ × `factor`.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if the factor is not finite or beyond 1e12.
    pub fn scaled(self, factor: f64) -> Result<Law, LawError> {
        checked("factor", factor, "", |f| f.abs() <= 1e12)?;
        Ok(self.changed(factor, 0.0, Time::ZERO))
    }

    /// θ + `steps`.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if `steps` is not finite or beyond 1e15.
    pub fn shifted(self, steps: f64) -> Result<Law, LawError> {
        checked("shift", steps, "steps", |s| s.abs() <= super::FARTHEST)?;
        Ok(self.changed(1.0, steps, Time::ZERO))
    }

    /// At rest at its first position for `delay`, then this law.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if the delay is negative or beyond 1e12 s.
    pub fn delayed(self, delay: Time) -> Result<Law, LawError> {
        checked("delay", delay.seconds(), "s", |d| (0.0..=1e12).contains(&d))?;
        Ok(if delay == Time::ZERO { self } else { self.changed(1.0, 0.0, delay) })
    }

    fn changed(self, factor: f64, offset: f64, delay: Time) -> Law {
        Law::Changed(Arc::new(Changed { law: self, factor, offset, delay }))
    }

    /// This law `times` times or for ever, each time from where it ended.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if the law is endless or has more than 2^20 pieces, or `times` is 0, and the law's own where it breaks.
    pub fn repeated(self, times: Option<u64>) -> Result<Law, LawError> {
        let Some(period) = self.end() else {
            return Err(LawError::Parameter("the motion is endless: it cannot be repeated".into()));
        };
        if times == Some(0) {
            return Err(LawError::Parameter("repeat is 0; it must be at least 1".into()));
        }
        let (mut first, mut last) = (None, Double::ZERO);
        for (row, piece) in self.pieces().enumerate() {
            if row == MOST_PARTS {
                return Err(too_many("to repeat"));
            }
            let piece = piece?;
            first.get_or_insert_with(|| piece.first_position());
            last = piece.last_position();
        }
        let net = last - first.unwrap_or(last);
        Ok(Law::Repeated(Arc::new(Repeated { law: self, period, times, net })))
    }
}

/// The error for a law with too many pieces; `what` says what cannot be done with it.
pub(super) fn too_many(what: &str) -> LawError {
    LawError::Parameter(format!("the motion has more than {MOST_PARTS} parts: too many {what}"))
}

fn some(laws: Vec<Law>) -> Result<Vec<Law>, LawError> {
    if laws.is_empty() { Err(LawError::Parameter("there is no motion to combine".into())) } else { Ok(laws) }
}

impl Changed {
    pub(super) fn pieces_from(self: Arc<Changed>, at: Time) -> impl Iterator<Item = Result<Piece, LawError>> {
        let mut waiting = at < self.delay;
        let mut inner = self.law.pieces_from(at - self.delay).peekable();
        std::iter::from_fn(move || {
            if std::mem::take(&mut waiting) {
                let first = match inner.peek()? {
                    Ok(piece) => piece.first_position(),
                    Err(error) => return Some(Err(error.clone())),
                };
                return Some(Piece::rest(Time::ZERO, self.delay, self.place(first)));
            }
            Some(inner.next()?.map_err(|error| error.later(self.delay)).and_then(|piece| self.change(piece)))
        })
    }

    /// Another law, changed as this one.
    pub(super) fn of(&self, law: Law) -> Law {
        law.changed(self.factor, self.offset, self.delay)
    }

    /// What is left of its law's constant speed.
    pub(super) fn of_line(&self, line: LinePart) -> LinePart {
        LinePart {
            speed: self.factor * line.speed,
            way: self.factor * line.way,
            offset: self.factor * line.offset + self.offset,
            ..line
        }
    }

    /// What it adds to the law, if it does not scale it.
    pub(super) fn shift(&self) -> Option<f64> {
        (self.factor == 1.0).then_some(self.offset)
    }

    pub(super) fn workload(&self, until: Time) -> Workload {
        let inner = self.law.workload(until - self.delay);
        let waits = if self.delay > Time::ZERO { 1.0 } else { 0.0 };
        Workload { steps: inner.steps * self.factor.abs(), pieces: inner.pieces + waits, ..inner }
    }

    fn place(&self, position: Double) -> Double {
        position * Double::from(self.factor) + Double::from(self.offset)
    }

    fn change(&self, mut piece: Piece) -> Result<Piece, LawError> {
        piece.postpone(self.delay);
        if self.factor != 1.0 {
            piece.curve.scale(self.factor);
        }
        let origin = self.place(Double::from(std::mem::take(&mut piece.origin)));
        piece.raise(origin)?;
        Ok(piece)
    }
}

impl Repeated {
    pub(super) fn pieces_from(self: Arc<Repeated>, at: Time) -> impl Iterator<Item = Result<Piece, LawError>> {
        let period = self.period;
        let times = self.times.unwrap_or(u64::MAX);
        let first = u64::try_from(at.raw() / period.raw()).unwrap_or(u64::MAX).min(times - 1);
        (first..times).map(move |k| (k, period.times(k))).take_while(|&(_, by)| by < Time::MAX).flat_map(
            move |(k, by)| {
                let net = self.net
                    * (Double::from((k >> 32) as f64 * 4_294_967_296.0) + Double::from((k & 0xffff_ffff) as f64));
                // Only the first repetition is not begun at its own time 0.
                self.law.pieces_from(at - by).map(move |piece| {
                    let mut piece = piece.map_err(|error| error.later(by))?;
                    piece.postpone(by);
                    piece.raise(net)?;
                    Ok(piece)
                })
            },
        )
    }
}

impl std::ops::Deref for Sequence {
    type Target = [Law];

    fn deref(&self) -> &[Law] {
        &self.laws
    }
}

/// `begun` does not count: it follows from the laws.
impl PartialEq for Sequence {
    fn eq(&self, other: &Sequence) -> bool {
        self.laws == other.laws
    }
}

impl std::fmt::Debug for Sequence {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.laws.fmt(f)
    }
}

impl Sequence {
    fn begun(&self) -> MutexGuard<'_, Vec<Begun>> {
        self.begun.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The last law that is known to begin at `at` or before, and when it begins.
    fn last_begun(&self, at: Time) -> (usize, Time) {
        let begun = self.begun();
        let last = begun.partition_point(|begun| begun.at <= at).saturating_sub(1);
        begun.get(last).map_or((0, Time::ZERO), |begun| (last, begun.at))
    }

    /// What is added to a law's positions, if that is known.
    fn offset(&self, law: usize) -> Option<Double> {
        self.begun().get(law).map(|begun| begun.offset)
    }

    /// Notes where a law begins, if that is known of all before it.
    fn note(&self, law: usize, at: Time, offset: Double) {
        let mut begun = self.begun();
        if begun.len() == law {
            begun.push(Begun { at, offset });
        }
    }

    /// The pieces from about the time `at` on.
    pub(super) fn pieces_from(self: Arc<Sequence>, at: Time) -> impl Iterator<Item = Result<Piece, LawError>> {
        let mut current: Option<Pieces> = None;
        // The current law, or the next one, and where it begins.
        let (mut law, mut begins) = self.last_begun(at);
        let mut start = begins;
        // The piece before: where it ends takes long to work out, and only the next law needs to know.
        let mut before: Option<Piece> = None;
        // The offset of the current law, which is known from its first piece.
        let mut offset: Option<Double> = None;
        std::iter::from_fn(move || {
            loop {
                let Some(pieces) = current.as_mut() else {
                    let next = self.get(law)?;
                    (begins, offset) = (start, self.offset(law));
                    let is_over = law + 1 < self.len() && next.end().is_some_and(|end| begins + end <= at);
                    // Of a law before that time only the first and the last piece count: where it begins and ends.
                    let from = if is_over { next.end().map_or(Time::ZERO, Time::before) } else { at - begins };
                    if from > Time::ZERO && offset.is_none() {
                        match next.pieces().next() {
                            Some(Ok(first)) => {
                                let own = offset_after(before.as_ref(), &first);
                                self.note(law, begins, own);
                                offset = Some(own);
                            }
                            Some(Err(error)) => return Some(Err(error.later(begins))),
                            None => {
                                law += 1;
                                continue;
                            }
                        }
                    }
                    current = Some(next.pieces_from(from));
                    continue;
                };
                let Some(piece) = pieces.next() else {
                    (current, law) = (None, law + 1);
                    continue;
                };
                return Some(piece.map_err(|error| error.later(begins)).and_then(|mut piece| {
                    let offset = *offset.get_or_insert_with(|| {
                        let own = offset_after(before.as_ref(), &piece);
                        self.note(law, begins, own);
                        own
                    });
                    piece.postpone(begins);
                    piece.raise(offset)?;
                    start = piece.end;
                    before = Some(piece.clone());
                    Ok(piece)
                }));
            }
        })
    }
}

/// What is added to a law's positions, of which `first` is the first piece, so that it begins where the piece before ends.
fn offset_after(before: Option<&Piece>, first: &Piece) -> Double {
    before.map_or(Double::ZERO, |before| before.last_position() - first.first_position())
}

/// When the last of `laws` ends; `None`: never.
pub(super) fn latest_end(laws: &[Law]) -> Option<Time> {
    laws.iter().map(Law::end).try_fold(Time::ZERO, |end, e| Some(end.max(e?)))
}

/// One law of several: its current piece, or its position after its end.
pub(super) struct Summand {
    pieces: Pieces,
    piece: Option<Piece>,
    rests_at: Double,
}

impl Summand {
    /// A law from its time `at` on.
    pub(super) fn from(law: &Law, at: Time) -> Summand {
        Summand { pieces: law.pieces_from(at), piece: None, rests_at: Double::ZERO }
    }

    /// Goes on to the piece that goes on at `at`.
    pub(super) fn advance(&mut self, at: Time) -> Result<(), LawError> {
        while self.piece.as_ref().is_none_or(|piece| piece.end <= at) {
            if let Some(piece) = self.piece.take() {
                self.rests_at = piece.last_position();
            }
            let Some(next) = self.pieces.next() else { break };
            self.piece = Some(next?);
        }
        Ok(())
    }

    /// When its piece ends; `None` if the law has ended.
    pub(super) fn ends(&self) -> Option<Time> {
        self.piece.as_ref().map(|piece| piece.end)
    }

    /// Its curve with the time since `zero`, and the level that is to be added to it, steps.
    pub(super) fn about(&self, zero: Time) -> (Curve, Double) {
        let Some(piece) = &self.piece else { return (Curve::constant(0.0), self.rests_at) };
        let mut curve = piece.curve.clone();
        curve.rezero(Double::from(zero) - Double::from(piece.zero));
        (curve.plain(), Double::from(piece.origin))
    }

    /// Its curve's terms with the time since `zero`, if they are known. They are those before the shift, because a curve's shift rounds.
    pub(super) fn terms_about(&self, zero: Time) -> Option<Terms> {
        let Some(piece) = &self.piece else { return Some(Terms::of_polynomial(&[0.0])) };
        let mut terms = piece.curve.terms()?;
        terms.rezero(Double::from(zero) - Double::from(piece.zero));
        Some(terms)
    }
}

/// Several laws at the same times.
pub(super) struct Together {
    /// Each at its current piece.
    pub(super) laws: Vec<Summand>,
    at: Time,
    begun: bool,
}

impl Together {
    /// Laws from about their time `from` on.
    pub(super) fn from(laws: &[Law], from: Time) -> Together {
        let from = latest_end(laws).map_or(from, |end| from.min(end.before()));
        Together { laws: laws.iter().map(|law| Summand::from(law, from)).collect(), at: Time::ZERO, begun: false }
    }

    /// Goes on to the next time in which each law has one piece: from when until when. `None` if all have ended.
    pub(super) fn advance(&mut self) -> Result<Option<(Time, Time)>, LawError> {
        if !std::mem::replace(&mut self.begun, true) {
            for law in &mut self.laws {
                if let Some(piece) = law.pieces.next().transpose()? {
                    // They begin where the last of them does, or where one has ended since.
                    self.at = self.at.max(piece.start);
                    law.piece = Some(piece);
                }
            }
        }
        for law in &mut self.laws {
            law.advance(self.at)?;
        }
        let start = self.at;
        let Some(end) = self.laws.iter().filter_map(Summand::ends).min() else { return Ok(None) };
        self.at = end;
        Ok(Some((start, end)))
    }

    /// What may change where they begin a piece at `start`.
    pub(super) fn entry(&self, start: Time) -> Entry {
        let mut pieces = self.laws.iter().filter_map(|law| law.piece.as_ref());
        let jumps = pieces.any(|piece| piece.entry == Entry::SpeedJump && piece.start == start);
        if jumps { Entry::SpeedJump } else { Entry::Continuous }
    }
}

/// The pieces of a sum of laws, from the one on that has the time `from`. A piece ends wherever a piece of one law ends.
pub(super) fn sum_from(laws: &[Law], from: Time) -> impl Iterator<Item = Result<Piece, LawError>> + use<> {
    let mut terms = Together::from(laws, from);
    std::iter::from_fn(move || match terms.advance() {
        Ok(stretch) => stretch.map(|(start, end)| merge(&terms, start, end)),
        Err(error) => Some(Err(error)),
    })
}

fn merge(terms: &Together, start: Time, end: Time) -> Result<Piece, LawError> {
    let mut merged = Piece::rest(start, end, Double::ZERO)?;
    let mut level = Double::ZERO;
    let mut sum: Vec<f64> = vec![0.0];
    let mut curves = Vec::new();
    let mut accurate = Some(None);
    merged.entry = terms.entry(start);
    for term in &terms.laws {
        let Some(piece) = &term.piece else {
            level = level + term.rests_at;
            continue;
        };
        level = level + Double::from(piece.origin);
        accurate = accurate.and_then(|before: Option<Terms>| {
            let own = term.terms_about(start)?;
            Some(Some(match before {
                Some(before) => before.and(own),
                None => own,
            }))
        });
        match term.about(start).0 {
            Curve::Polynomial(c) => {
                sum.resize(sum.len().max(c.len()), 0.0);
                sum.iter_mut().zip(c).for_each(|(sum, c)| *sum += c);
            }
            Curve::Sum(inner) => curves.extend(inner),
            other => curves.push(other),
        }
    }
    let is_line = curves.is_empty() && sum.iter().skip(2).all(|&c| c == 0.0);
    merged.curve = Curve::Polynomial(sum);
    if !curves.is_empty() {
        curves.push(merged.curve);
        merged.curve = Curve::Sum(curves);
    }
    merged.curve = merged.curve.accurate_by(accurate.flatten().filter(|_| !is_line));
    merged.raise(level)?;
    Ok(merged)
}

impl LawError {
    /// The error of a law that begins `by` later.
    fn later(mut self, by: Time) -> LawError {
        if let LawError::Undefined { at_s, .. } | LawError::Jump { at_s, .. } = &mut self {
            *at_s += by.seconds();
        }
        self
    }
}
