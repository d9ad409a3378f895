//! Ramps for laws that do not begin or end at rest.

use super::combine::{MOST_PARTS, too_many};
use super::{Class, Cursor, Curve, Double, Entry, Law, LawError, LinePart, Piece, Sample, checked};
use crate::Time;
use std::sync::Arc;

/// What to do with a law that does not begin at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Begin {
    /// Wait, at rest, for the law's first moment of rest, and follow it from there.
    Delay,
    /// Replace the law's beginning, as short as the limits allow, by a quintic from rest at θ(0).
    Ramp {
        /// steps/s.
        max_speed: f64,
        /// steps/s².
        max_acceleration: f64,
    },
    /// As `Ramp`, but by a quartic, which does not make up for the distance lost in the ramp. The motion stays behind the law by that
    /// distance.
    RampBehind {
        /// steps/s.
        max_speed: f64,
        /// steps/s².
        max_acceleration: f64,
    },
    /// At once.
    Jump,
}

/// A ramp that does not make up for the distance that it loses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Behind {
    /// The distance that it loses, steps: after the ramp the law is that much farther. Negative if the law goes backward there.
    pub steps: f64,
    /// How long the ramp takes.
    pub ramp: Time,
    /// Whether the ramp is at the end. Then the motor stops that far from the law's last position.
    pub ends: bool,
}

/// What to do with a law that does not end at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum End {
    /// Replace the law's end, as short as the limits allow, by a quintic to rest at its last position.
    Ramp {
        /// steps/s.
        max_speed: f64,
        /// steps/s².
        max_acceleration: f64,
    },
    /// As `Ramp`, but by a quartic, which does not make up for the distance lost in the ramp. The motor does not reach the law's last
    /// position.
    RampBehind {
        /// steps/s.
        max_speed: f64,
        /// steps/s².
        max_acceleration: f64,
    },
    /// Stop at once. A nanosecond of rest follows, at whose beginning the speed may jump.
    Jump,
}

/// A law with a ramp at its beginning or its end.
#[derive(Clone, Debug, PartialEq)]
pub struct Blended {
    law: Law,
    /// The piece before the part of the law that is left.
    head: Option<Piece>,
    /// The pieces after it.
    tail: Option<Piece>,
    /// What is added to the positions of the part that is left, steps.
    shift: f64,
    /// The distance that the tail loses, steps.
    lost: f64,
    /// The speed may jump where the first piece begins.
    jump: bool,
}

/// The longest ramp that is tried, s.
const LONGEST_RAMP_S: f64 = 3600.0;
/// The shortest ramp that is tried, s.
const SHORTEST_RAMP_S: f64 = 1e-6;
/// The search for a place to rest ends after this many pieces.
const PIECES_TRIED: usize = 10_000;
/// A relative tolerance for speeds, greater than their rounding.
const ROUNDING: f64 = 1e-9;
/// A speed below this part of the fastest so far counts as rest, where the speed touches zero without changing its sign.
const NEARLY: f64 = 1e-6;

impl Law {
    /// This law, beginning as `begin` says.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if the law never comes to rest, or no ramp stays within the limits; and the law's own errors.
    pub fn beginning(self, begin: Begin) -> Result<Law, LawError> {
        let mut shift = 0.0;
        let head = match begin {
            Begin::Jump => None,
            Begin::Delay => {
                let rest = self.first_rest()?;
                let position = Cursor::new(&self).at(rest)?;
                let position = Double::from(position.whole) + Double::from(position.fraction);
                (rest > Time::ZERO).then(|| Piece::rest(Time::ZERO, rest, position)).transpose()?
            }
            Begin::Ramp { max_speed, max_acceleration } | Begin::RampBehind { max_speed, max_acceleration } => {
                let catches_up = matches!(begin, Begin::Ramp { .. });
                let mut cursor = Cursor::new(&self);
                let start = cursor.at(Time::ZERO)?;
                if start.speed == 0.0 && start.acceleration.abs() <= max_acceleration {
                    None
                } else {
                    let rest = Sample { speed: 0.0, acceleration: 0.0, ..start };
                    let mut ramp = |span: Time| {
                        let to = cursor.at(span)?;
                        Ok(if catches_up {
                            Ramp::between(rest, to, Time::ZERO, span, false)
                        } else {
                            Ramp::up_to_speed(rest, to, span)
                        })
                    };
                    let limits = (max_speed, max_acceleration);
                    let ramp = shortest(&mut ramp, self.end(), limits, catches_up && matches!(self, Law::Steady(_)))?;
                    if !catches_up {
                        shift = -way(ramp.last(), cursor.at(ramp.to)?);
                    }
                    Some(ramp.piece())
                }
            }
        };
        Ok(Law::Blended(Arc::new(Blended {
            law: self,
            head,
            tail: None,
            shift,
            lost: 0.0,
            jump: begin == Begin::Jump,
        })))
    }

    /// The distances that its ramps lose and do not make up for, in the order of these ramps.
    #[must_use]
    pub fn behind(&self) -> Vec<Behind> {
        match self {
            Law::Blended(blended) => {
                let [head, tail] = blended.behind();
                head.into_iter().chain(blended.law.behind()).chain(tail).collect()
            }
            Law::Then(laws) => laws.iter().flat_map(Law::behind).collect(),
            Law::Warped(warped) => warped.law().behind(),
            Law::Backlash(_) => self.without_backlash().map_or_else(Vec::new, |law| law.behind()),
            _ => Vec::new(),
        }
    }

    /// This law, ending as `end` says.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if the law is endless, or no ramp stays within the limits; and the law's own errors.
    pub fn ending(self, ending: End) -> Result<Law, LawError> {
        let Some(end) = self.end() else {
            return Err(LawError::Parameter("the motion is endless: it has no end to change".into()));
        };
        if self.pieces().nth(MOST_PARTS).is_some() {
            return Err(too_many("to look for the end"));
        }
        let mut cursor = Cursor::new(&self);
        let last = cursor.at(end)?;
        let mut lost = 0.0;
        let tail = match ending {
            End::Jump => {
                let position = Double::from(last.whole) + Double::from(last.fraction);
                let mut rest = Piece::rest(end, end + Time::from_ratio(1, 1_000_000_000), position)?;
                rest.entry = Entry::SpeedJump;
                Some(rest)
            }
            End::Ramp { max_acceleration, .. } | End::RampBehind { max_acceleration, .. }
                if last.speed == 0.0 && last.acceleration.abs() <= max_acceleration =>
            {
                None
            }
            End::Ramp { max_speed, max_acceleration } | End::RampBehind { max_speed, max_acceleration } => {
                let makes_up = matches!(ending, End::Ramp { .. });
                let rest = Sample { speed: 0.0, acceleration: 0.0, ..last };
                let mut ramp = |span: Time| {
                    let from = cursor.at(end - span)?;
                    Ok(if makes_up {
                        Ramp::between(from, rest, end - span, end, true)
                    } else {
                        Ramp::down_to_rest(from, end - span, end)
                    })
                };
                let limits = (max_speed, max_acceleration);
                let ramp = shortest(&mut ramp, Some(end), limits, makes_up && matches!(self, Law::Steady(_)))?;
                if !makes_up {
                    lost = way(Sample { whole: ramp.whole, fraction: ramp.c[0], ..last }, last);
                }
                Some(ramp.piece())
            }
        };
        Ok(Law::Blended(Arc::new(Blended { law: self, head: None, tail, shift: 0.0, lost, jump: false })))
    }

    /// This law up to `at`, then braked to rest by `braking` (steps/s²): how an endless law is brought to an end.
    ///
    /// From `pull_in` (steps/s) downward it stops at once.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if `at` or `braking` is not positive, or `pull_in` negative; and the law's own.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time};
    /// // 100 steps/s for 2 s, then 0.5 s of braking.
    /// let law = Law::speed(100.0, None)?.stopped(Time::from_seconds(2.0), 200.0, 0.0)?;
    /// assert_eq!(law.end(), Some(Time::from_seconds(2.5)));
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    pub fn stopped(self, at: Time, braking: f64, pull_in: f64) -> Result<Law, LawError> {
        checked("time of the stop", at.seconds(), "s", |t| t > 0.0)?;
        checked("braking", braking, "steps/s²", |a| a > 0.0)?;
        checked("pull_in", pull_in, "steps/s", |v| v >= 0.0)?;
        let from = Cursor::new(&self).at(at)?;
        let brakes = from.speed.abs() > pull_in;
        let seconds = if brakes { from.speed.abs() / braking } else { SHORTEST_RAMP_S };
        let curve = if brakes {
            vec![from.fraction, from.speed, -0.5 * braking * from.speed.signum()]
        } else {
            vec![from.fraction]
        };
        let end = at + Time::from_seconds(seconds.max(SHORTEST_RAMP_S));
        let tail = Piece {
            zero: at,
            start: at,
            end,
            origin: from.whole,
            curve: Curve::Polynomial(curve),
            entry: Entry::Continuous,
        };
        Ok(Law::Blended(Arc::new(Blended {
            law: self,
            head: None,
            tail: Some(tail),
            shift: 0.0,
            lost: 0.0,
            jump: false,
        })))
    }

    /// The law before it was [stopped](Law::stopped); `None` if this law is no stop.
    #[must_use]
    pub fn before_stop(&self) -> Option<&Law> {
        let Law::Blended(blended) = self else { return None };
        let stops = blended.stop().is_some_and(|(tail, _)| blended.law.end().is_none_or(|end| end > tail.start));
        stops.then_some(&blended.law)
    }

    /// The first time of zero speed.
    fn first_rest(&self) -> Result<Time, LawError> {
        let mut fastest = 0.0_f64;
        let mut before: Option<(Time, f64, f64)> = None;
        for piece in self.pieces().take(PIECES_TRIED) {
            let piece = piece?;
            let speeds = |t: Time| {
                let jet = piece.curve.jet((t - piece.zero).seconds());
                (t, jet[1], jet[2])
            };
            let step = (piece.end - piece.start).divided_by(64);
            for k in 0..=64 {
                let now = speeds(if k == 64 { piece.end } else { piece.start + step.times(k) });
                fastest = fastest.max(now.1.abs());
                if now.1 == 0.0 {
                    return Ok(now.0);
                }
                if let Some(before) = before.filter(|b| b.0 >= piece.start) {
                    if before.1 * now.1 < 0.0 {
                        return Ok(bisect(before.0, now.0, |t| speeds(t).1));
                    }
                    if before.1 * before.2 < 0.0 && now.1 * now.2 > 0.0 {
                        let slowest = bisect(before.0, now.0, |t| speeds(t).2);
                        if speeds(slowest).1.abs() <= NEARLY * fastest {
                            return Ok(slowest);
                        }
                    }
                }
                before = Some(now);
            }
        }
        let until = before.map_or(0.0, |b| b.0.seconds());
        Err(LawError::Parameter(format!(
            "the motion does not come to rest in its first {until} s: begin it with a ramp"
        )))
    }
}

/// The time between `a` and `b` at which `f` changes its sign, to 2^-64 s.
fn bisect(mut a: Time, mut b: Time, f: impl Fn(Time) -> f64) -> Time {
    let positive = f(a) > 0.0;
    while b - a > Time::from_raw(1) {
        let middle = a + (b - a).divided_by(2);
        if (f(middle) > 0.0) == positive { a = middle } else { b = middle }
    }
    b
}

/// The distance from one sample to another, steps.
fn way(from: Sample, to: Sample) -> f64 {
    (Double::from(to.whole) - Double::from(from.whole) + Double::from(to.fraction) - Double::from(from.fraction))
        .nearest()
}

/// A ramp: θ = whole + Σ c_k u^k, u from `from` on.
struct Ramp {
    whole: i64,
    c: [f64; 6],
    from: Time,
    to: Time,
    /// u is 0 at `to`, so that the end is met exactly.
    backward: bool,
    /// How fast the law is where the ramp meets it, steps/s.
    law_speed: f64,
}

impl Ramp {
    /// The quintic that takes position, speed and acceleration from `a` to `b`.
    fn between(a: Sample, b: Sample, from: Time, to: Time, backward: bool) -> Ramp {
        let span = (to - from).seconds();
        // At u = 0 the coefficients are the state there. The other end is at u = span.
        let (near, far, span) = if backward { (b, a, -span) } else { (a, b, span) };
        let (v0, a0) = (near.speed, near.acceleration);
        let x = way(near, far) - span * (v0 + 0.5 * span * a0);
        let v = (far.speed - v0 - span * a0) * span;
        let acceleration = (far.acceleration - a0) * span * span;
        let c3 = (10.0 * x - 4.0 * v + 0.5 * acceleration) / (span * span * span);
        let c4 = (-15.0 * x + 7.0 * v - acceleration) / (span * span * span * span);
        let c5 = (6.0 * x - 3.0 * v + 0.5 * acceleration) / (span * span * span * span * span);
        let law_speed = if backward { a.speed } else { b.speed };
        Ramp { whole: near.whole, c: [near.fraction, v0, 0.5 * a0, c3, c4, c5], from, to, backward, law_speed }
    }

    /// The quartic that goes from rest to speed and acceleration of `to`, at whatever position.
    fn up_to_speed(rest: Sample, to: Sample, span: Time) -> Ramp {
        let Sample { speed, acceleration, .. } = to;
        let s = span.seconds();
        let c3 = (speed - acceleration * s / 3.0) / (s * s);
        let c4 = (0.25 * acceleration * s - 0.5 * speed) / (s * s * s);
        let c = [rest.fraction, 0.0, 0.0, c3, c4, 0.0];
        Ramp { whole: rest.whole, c, from: Time::ZERO, to: span, backward: false, law_speed: speed }
    }

    /// The quartic that goes from speed and acceleration of `law` to rest, at whatever position.
    fn down_to_rest(law: Sample, from: Time, to: Time) -> Ramp {
        let Sample { speed, acceleration, .. } = law;
        let s = (to - from).seconds();
        let c3 = (speed + acceleration * s / 3.0) / (s * s);
        let c4 = (0.25 * acceleration * s + 0.5 * speed) / (s * s * s);
        let lost = s * s * s * (c3 - c4 * s);
        let c = [law.fraction + lost, 0.0, 0.0, c3, c4, 0.0];
        Ramp { whole: law.whole, c, from, to, backward: true, law_speed: speed }
    }

    fn piece(self) -> Piece {
        let (start, end) = (self.from, self.to);
        let zero = if self.backward { end } else { start };
        let curve = Curve::Polynomial(self.c.to_vec());
        Piece { zero, start, end, origin: self.whole, curve, entry: Entry::Continuous }
    }

    /// The position where a ramp that is not backward ends.
    fn last(&self) -> Sample {
        let span = (self.to - self.from).seconds();
        let fraction = self.c.iter().rev().fold(0.0, |sum, c| sum * span + c);
        Sample { position: 0.0, whole: self.whole, fraction, speed: self.law_speed, acceleration: 0.0 }
    }

    /// The highest speed and acceleration, from samples that miss less than a thousandth.
    fn peaks(&self) -> (f64, f64) {
        const SAMPLES: u32 = 256;
        let [_, c1, c2, c3, c4, c5] = self.c;
        let span = (self.to - self.from).seconds() * if self.backward { -1.0 } else { 1.0 };
        (0..=SAMPLES).fold((0.0_f64, 0.0_f64), |(v, a), k| {
            let u = span * f64::from(k) / f64::from(SAMPLES);
            let speed = c1 + u * (2.0 * c2 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5)));
            let acceleration = 2.0 * c2 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5));
            (v.max(speed.abs()), a.max(acceleration.abs()))
        })
    }
}

/// The shortest ramp of `ramp` that stays within the limits, steps/s and steps/s².
///
/// With `is_similar` all ramps are one curve, stretched in time. If one is too fast then all are, and nothing is searched for.
fn shortest(
    ramp: &mut dyn FnMut(Time) -> Result<Ramp, LawError>,
    end: Option<Time>,
    (max_speed, max_acceleration): (f64, f64),
    is_similar: bool,
) -> Result<Ramp, LawError> {
    checked("max_speed", max_speed, "steps/s", |v| v > 0.0)?;
    checked("max_acceleration", max_acceleration, "steps/s²", |a| a > 0.0)?;
    let excess = |ramp: &Ramp| {
        let (v, a) = ramp.peaks();
        // The law's own speed is known exactly, so that it may be equal to the limit.
        let law_speed = ramp.law_speed.abs();
        let v = if v <= law_speed * (1.0 + ROUNDING) { law_speed / (1.0 + ROUNDING) } else { 1.001 * v };
        (v / max_speed, 1.001 * a / max_acceleration)
    };
    let longest = end.map_or(LONGEST_RAMP_S, Time::seconds).min(LONGEST_RAMP_S);
    // A law is at rest after its end, so that the end is approached from inside, rounding included.
    let mut ramp = |span: f64| ramp(Time::from_seconds(span).min(end.unwrap_or(Time::MAX)));
    let mut closest: Option<(f64, f64, Ramp)> = None;
    let mut below = 0.0;
    let mut span = SHORTEST_RAMP_S.min(longest);
    loop {
        let tried = ramp(span)?;
        let (v, a) = excess(&tried);
        if v.max(a) <= 1.0 {
            break;
        }
        if is_similar && v > 1.0 {
            return Err(no_ramp(Some((v, 0.0, tried)), longest, max_speed, max_acceleration));
        }
        if closest.as_ref().is_none_or(|(least_v, least_a, _)| v.max(a) < least_v.max(*least_a)) {
            closest = Some((v, a, tried));
        }
        if span >= longest {
            return Err(no_ramp(closest, longest, max_speed, max_acceleration));
        }
        below = span;
        span = (span * 1.05).min(longest);
    }
    for _ in 0..40 {
        let middle = 0.5 * (below + span);
        let (v, a) = excess(&ramp(middle)?);
        if v.max(a) <= 1.0 { span = middle } else { below = middle }
    }
    ramp(span)
}

/// Why there is no ramp: describes the one that comes closest to the limits.
fn no_ramp(closest: Option<(f64, f64, Ramp)>, longest: f64, max_speed: f64, max_acceleration: f64) -> LawError {
    let (v, a, speed) = closest.map_or((0.0, 0.0, 0.0), |(v, a, ramp)| (v, a, ramp.law_speed.abs()));
    LawError::Parameter(if v > a {
        let needed = v * max_speed;
        let faster = if needed > 1.0011 * speed {
            ": a ramp makes up for the way that it loses, and is faster than the law for a while"
        } else {
            ""
        };
        format!(
            "no ramp stays within max_speed = {max_speed:.1} steps/s: the law runs at {speed:.1} steps/s where the ramp would meet it, and \
             the slowest ramp at {needed:.1} steps/s{faster}"
        )
    } else {
        let needed = a * max_acceleration;
        format!(
            "no ramp of up to {longest} s stays within max_acceleration = {max_acceleration:.1} steps/s²; the gentlest needs {needed:.1}"
        )
    })
}

impl Blended {
    /// The law without its ramps.
    pub(super) const fn law(&self) -> &Law {
        &self.law
    }

    /// Another law, [stopped](Law::stopped) in the same way; `None` if this one is no stop.
    pub(super) fn stop_of(&self, law: Law) -> Option<Law> {
        let (tail, curve) = self.stop()?;
        let (braking, pull_in) = match curve.get(2) {
            Some(half) => (2.0 * half.abs(), 0.0),
            // It stopped at once.
            None => (1.0, f64::MAX),
        };
        law.stopped(tail.start, braking, pull_in).ok()
    }

    /// Its tail with the coefficients, if it is a stop.
    fn stop(&self) -> Option<(&Piece, &[f64])> {
        let (None, Some(tail), false) = (&self.head, &self.tail, self.jump) else { return None };
        let Curve::Polynomial(curve) = &tail.curve else { return None };
        (curve.len() <= 3 && tail.entry == Entry::Continuous).then_some((tail, curve))
    }

    /// The distance that the motion stays behind its law, by the ramp at the beginning and by that at the end.
    fn behind(&self) -> [Option<Behind>; 2] {
        let behind = |ramp: &Option<Piece>, steps: f64, ends: bool| {
            let ramp = ramp.as_ref().filter(|_| steps != 0.0)?;
            Some(Behind { steps, ramp: ramp.end - ramp.start, ends })
        };
        [behind(&self.head, -self.shift, false), behind(&self.tail, self.lost, true)]
    }

    pub(super) fn end(&self) -> Option<Time> {
        self.tail.as_ref().map(|tail| tail.end).or_else(|| self.law.end())
    }

    /// When the ramp at its beginning is over.
    pub(super) fn begun(&self) -> Time {
        self.head.as_ref().map_or(Time::ZERO, |head| head.end)
    }

    /// Its law's constant speed, with the distance that the ramp at the beginning lost.
    pub(super) fn of_line(&self, line: LinePart) -> LinePart {
        LinePart { way: line.way + self.shift, ..line }
    }

    /// The cycle of its law, once the ramp is over.
    pub(super) fn cycle(&self) -> Option<(Time, Time)> {
        let begun = self.begun();
        let (from, period) = self.law.cycle().filter(|_| self.tail.is_none())?;
        Some((from.max(begun), period))
    }

    pub(super) fn class(&self) -> Class {
        let quintic = |piece: &Option<Piece>| {
            piece.as_ref().is_some_and(|p| matches!(&p.curve, Curve::Polynomial(c) if c.len() > 3))
        };
        let least = if quintic(&self.head) || quintic(&self.tail) { Class::Enclosed } else { Class::ClosedForm };
        self.law.class().max(least)
    }

    pub(super) fn pieces_from(&self, at: Time) -> impl Iterator<Item = Result<Piece, LawError>> + use<> {
        let from = self.head.as_ref().map_or(Time::ZERO, |head| head.end);
        let to = self.tail.as_ref().map_or(Time::MAX, |tail| tail.start);
        let shift = Double::from(self.shift);
        // An endless law is stopped by its tail.
        let middle = self.law.pieces_from(at).take_while(move |piece| !piece.as_ref().is_ok_and(|p| p.start >= to));
        let middle = middle.filter_map(move |piece| match piece {
            Ok(mut piece) => {
                piece.start = piece.start.max(from);
                piece.end = piece.end.min(to);
                (piece.start < piece.end).then(|| piece.raise(shift).map(|()| piece))
            }
            Err(error) => Some(Err(error)),
        });
        let jump = self.jump;
        let pieces = self.head.clone().into_iter().map(Ok).chain(middle).chain(self.tail.clone().into_iter().map(Ok));
        pieces.map(move |piece| {
            let mut piece = piece?;
            if jump && piece.start == Time::ZERO {
                piece.entry = Entry::SpeedJump;
            }
            Ok(piece)
        })
    }
}
