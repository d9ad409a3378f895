//! Backlash of belts and gears. Whenever a motor turns round, it makes extra steps, quickly, to take up the backlash.
//!
//! What the motor drives stands still meanwhile. Source: the Pico plotter, "Slop in the etch a sketch mechanism".

use super::combine;
use super::{Class, Curve, Double, Entry, Law, LawError, Piece, Pieces, checked};
use crate::Time;
use std::collections::VecDeque;
use std::sync::Arc;

/// A law with backlash: after each turning point the motor moves farther by the backlash, within `over`, on a cubic from rest to rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Backlash {
    /// The law, and the extra motion.
    sum: [Law; 2],
}

/// The extra motion at a law's turning points.
#[derive(Clone, Debug, PartialEq)]
pub struct Compensation {
    law: Law,
    steps: f64,
    over: Time,
}

/// A law counts as turned round when it has come back this far, steps. Less may be rounding, and makes no step.
const TURNED: f64 = 0.25;
/// Samples in each piece. A turn between two samples shows as a change of the speed's sign.
const LOOKS: u32 = 16;
/// Positions that differ by no more than this count as equal, steps.
const SAME: f64 = 1e-9;

impl Law {
    /// This law for a motor with backlash: `slack` more steps after each turn, within `over`.
    ///
    /// In the direction of the first motion the backlash is already taken up. The law ends later by `over`, because its last turn may be
    /// at its end. Peak speed of the added motion is 1.5·slack/over, its acceleration 6·slack/over². Its pieces end with
    /// [`LawError::Backlash`] where it turns sooner than `over` after a turn.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time, law::Cursor};
    /// let law = Law::sine(100.0, Time::SECOND, Some(1))?.with_backlash(8.0, Time::from_ratio(1, 50))?;
    /// let mut cursor = Cursor::new(&law);
    /// let mut at = |s| cursor.at(Time::from_seconds(s)).map(|sample| sample.position);
    /// assert_eq!(at(0.5)?, 200.0); // the top
    /// assert!((at(0.75)? - (100.0 - 8.0)).abs() < 1e-9);
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    ///
    /// # Errors
    /// [`LawError::Parameter`] if the slack is not 0 to 1e9 steps, or `over` not 1e-6 to 1e3 s.
    pub fn with_backlash(self, slack: f64, over: Time) -> Result<Law, LawError> {
        checked("slack", slack, "steps", |s| (0.0..=1e9).contains(&s))?;
        checked("time to take it up", over.seconds(), "s", |s| (1e-6..=1e3).contains(&s))?;
        let added = Law::Compensation(Arc::new(Compensation { law: self.clone(), steps: slack, over }));
        Ok(Law::Backlash(Arc::new(Backlash { sum: [self, added] })))
    }

    /// The motion of what the motor drives: this law without the extra steps. `None` if the two cannot be separated.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time, law::Cursor};
    /// let seconds = Time::from_seconds;
    /// let law = Law::sine(100.0, seconds(1.0), None)?.with_backlash(8.0, seconds(0.02))?;
    /// // Halted after the turn at 0.5 s: on its way back, and 8 steps further.
    /// let halted = law.eased_out(Time::ZERO, seconds(0.55), seconds(0.1))?;
    /// let at = |law: &Law| Cursor::new(law).at(seconds(0.65)).map(|sample| sample.position);
    /// assert!((at(&halted)? - (at(&halted.without_backlash().unwrap())? - 8.0)).abs() < 1e-9);
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    #[must_use]
    pub fn without_backlash(&self) -> Option<Law> {
        self.map_backlash(&|backlash| Some(backlash.sum[0].clone()))
    }

    /// The time in which this law takes up backlash; `None` if it has none.
    #[must_use]
    pub fn backlash_over(&self) -> Option<Time> {
        match self {
            Law::Backlash(backlash) => backlash.slack().map(|slack| slack.over),
            Law::Then(laws) => laws.iter().find_map(Law::backlash_over),
            Law::Blended(blended) => blended.law().backlash_over(),
            Law::Warped(warped) => warped.law().backlash_over(),
            _ => None,
        }
    }

    /// This law with backlash taken up within another time; `None` if that time is not possible.
    #[must_use]
    pub fn with_backlash_over(&self, over: Time) -> Option<Law> {
        self.map_backlash(&|backlash| backlash.sum[0].clone().with_backlash(backlash.slack()?.steps, over).ok())
    }

    /// Applies `change` to this law. If the law has backlash, `change` is applied to the law without it, and the extra motion is added
    /// again.
    #[must_use]
    pub fn changed_under_backlash(&self, change: impl Fn(&Law) -> Option<Law>) -> Option<Law> {
        if !self.has_backlash() {
            return change(self);
        }
        self.map_backlash(&|backlash| {
            let slack = backlash.slack()?;
            change(&backlash.sum[0])?.with_backlash(slack.steps, slack.over).ok()
        })
    }

    /// This law with each part that has backlash replaced. In a motion file only the whole law of a motor has backlash; a stop or a pause may
    /// have been added to it.
    fn map_backlash(&self, change: &impl Fn(&Backlash) -> Option<Law>) -> Option<Law> {
        match self {
            Law::Backlash(backlash) => change(backlash),
            Law::Then(laws) => {
                Law::then(laws.iter().map(|law| law.map_backlash(change)).collect::<Option<Vec<Law>>>()?).ok()
            }
            Law::Blended(blended) if blended.law().has_backlash() => {
                blended.stop_of(blended.law().map_backlash(change)?)
            }
            Law::Warped(warped) => Some(Law::Warped(Arc::new(warped.of(warped.law().map_backlash(change)?)))),
            law => (!law.has_backlash()).then(|| law.clone()),
        }
    }

    /// Whether any part of it has backlash.
    fn has_backlash(&self) -> bool {
        match self {
            Law::Backlash(_) | Law::Compensation(_) => true,
            Law::Sum(laws) => laws.iter().any(Law::has_backlash),
            Law::Then(laws) => laws.iter().any(Law::has_backlash),
            Law::Changed(changed) => changed.law.has_backlash(),
            Law::Repeated(repeated) => repeated.law.has_backlash(),
            Law::Blended(blended) => blended.law().has_backlash(),
            Law::Warped(warped) => warped.law().has_backlash(),
            Law::Faded(faded) => faded.laws().into_iter().any(Law::has_backlash),
            Law::Arm(arm) => arm.law().is_some_and(Law::has_backlash),
            _ => false,
        }
    }
}

impl Backlash {
    /// The law without the extra motion.
    pub(super) const fn law(&self) -> &Law {
        &self.sum[0]
    }

    /// The extra motion.
    pub(super) const fn added(&self) -> &Law {
        &self.sum[1]
    }

    fn slack(&self) -> Option<&Compensation> {
        match &self.sum[1] {
            Law::Compensation(compensation) => Some(compensation),
            _ => None,
        }
    }

    pub(super) fn end(&self) -> Option<Time> {
        self.sum[1].end()
    }

    pub(super) fn class(&self) -> Class {
        self.law().class().max(Class::Enclosed)
    }

    pub(super) fn pieces_from(&self, at: Time) -> impl Iterator<Item = Result<Piece, LawError>> + use<> {
        combine::sum_from(&self.sum, at)
    }
}

impl Compensation {
    pub(super) fn end(&self) -> Option<Time> {
        self.law.end().map(|end| end + self.over)
    }

    pub(super) fn class() -> Class {
        Class::Enclosed
    }

    pub(super) fn pieces(self: Arc<Compensation>) -> impl Iterator<Item = Result<Piece, LawError>> {
        Added {
            turns: Turns::new(self.law.pieces()),
            slack: self,
            ready: VecDeque::new(),
            at: Time::ZERO,
            level: 0.0,
            ended: false,
        }
    }
}

/// The pieces of a [`Compensation`].
struct Added {
    slack: Arc<Compensation>,
    turns: Turns,
    ready: VecDeque<Result<Piece, LawError>>,
    /// The end of the pieces so far.
    at: Time,
    /// The extra motion there, steps.
    level: f64,
    ended: bool,
}

impl Iterator for Added {
    type Item = Result<Piece, LawError>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.ready.is_empty() && !self.ended {
            let turns = self.turns.of_a_piece();
            let mut compensate = |turns: Vec<_>| turns.into_iter().try_for_each(|(at, way)| self.compensate(at, way));
            match turns.map(|turns| turns.and_then(&mut compensate)) {
                Some(Ok(())) => {
                    // The farthest point so far may still become a turn. Nothing before it can.
                    self.rest_until(self.turns.farthest.0);
                }
                Some(Err(error)) => {
                    self.ended = true;
                    self.ready.push_back(Err(error));
                }
                None => {
                    self.ended = true;
                    self.rest_until(self.slack.end().unwrap_or(self.at));
                }
            }
        }
        self.ready.pop_front()
    }
}

impl Added {
    fn rest_until(&mut self, until: Time) {
        if until > self.at {
            self.ready.push_back(Piece::rest(self.at, until, Double::from(self.level)));
            self.at = until;
        }
    }

    /// The extra motion of a turn at `when`.
    fn compensate(&mut self, when: Time, direction: f64) -> Result<(), LawError> {
        if when < self.at {
            return Err(LawError::Backlash { at_s: when.seconds(), until_s: self.at.seconds() });
        }
        self.rest_until(when);
        let (start, over) = (self.at, self.slack.over.seconds());
        let by = direction * self.slack.steps;
        // 3x² − 2x³: begins and ends at rest.
        let curve =
            Curve::Polynomial(vec![self.level, 0.0, 3.0 * by / (over * over), -2.0 * by / (over * over * over)]);
        (self.at, self.level) = (start + self.slack.over, self.level + by);
        let entry = Entry::Continuous;
        self.ready.push_back(Ok(Piece { zero: start, start, end: self.at, origin: 0, curve, entry }));
        Ok(())
    }
}

/// Finds the turning points of a law.
struct Turns {
    pieces: Pieces,
    /// Its direction, ±1; 0 before its first motion.
    direction: f64,
    /// Time and position of its farthest point in that direction.
    farthest: (Time, Double),
    begun: bool,
}

impl Turns {
    fn new(pieces: Pieces) -> Turns {
        Turns { pieces, direction: 0.0, farthest: (Time::ZERO, Double::ZERO), begun: false }
    }

    /// The turns that are certain after one more piece, each with the new direction.
    fn of_a_piece(&mut self) -> Option<Result<Vec<(Time, f64)>, LawError>> {
        let piece = match self.pieces.next()? {
            Ok(piece) => piece,
            Err(error) => return Some(Err(error)),
        };
        if !std::mem::replace(&mut self.begun, true) {
            self.farthest.1 = piece.first_position();
        }
        let mut turns = Vec::new();
        let look = |k: u32| piece.first() + (piece.last() - piece.first()) * f64::from(k) / f64::from(LOOKS);
        let speed = |u: f64| piece.curve.jet(u)[1];
        for k in 0..LOOKS {
            let (from, to) = (look(k), look(k + 1));
            if speed(from) * speed(to) < 0.0 {
                let (mut a, mut b) = (from, to);
                while 0.5 * (a + b) > a && 0.5 * (a + b) < b {
                    let middle = 0.5 * (a + b);
                    if speed(middle) * speed(from) > 0.0 { a = middle } else { b = middle }
                }
                turns.extend(self.go_on(piece.zero + Time::from_seconds(b), piece.position(b)));
            }
            let end = if k + 1 == LOOKS { piece.end } else { piece.zero + Time::from_seconds(to) };
            turns.extend(self.go_on(end, piece.position(to)));
        }
        Some(Ok(turns))
    }

    /// Notes the law's position at `at`. Returns a turn if the law has now come back far enough from it.
    fn go_on(&mut self, at: Time, position: Double) -> Option<(Time, f64)> {
        let by = (position - self.farthest.1).nearest();
        if self.direction == 0.0 {
            if by.abs() > TURNED {
                (self.direction, self.farthest) = (by.signum(), (at, position));
            }
        } else if by * self.direction > 0.0 {
            self.farthest = (at, position);
        } else if by * self.direction >= -SAME {
            // The law rests at its farthest point.
            self.farthest.0 = at;
        } else if by * self.direction < -TURNED {
            let turn = (self.farthest.0, -self.direction);
            (self.direction, self.farthest) = (-self.direction, (at, position));
            return Some(turn);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::Cursor;

    fn seconds(s: f64) -> Time {
        Time::from_seconds(s)
    }

    /// Largest |law with slack taken up − law − expected| over a law's looks.
    #[track_caller]
    fn check(law: Law, slack: f64, over_s: f64, looks: &[(f64, f64)]) {
        let with_backlash = law.clone().with_backlash(slack, seconds(over_s)).unwrap();
        let (mut plain, mut with) = (Cursor::new(&law), Cursor::new(&with_backlash));
        for &(at_s, expected) in looks {
            let added = with.at(seconds(at_s)).unwrap().position - plain.at(seconds(at_s)).unwrap().position;
            assert!((added - expected).abs() < 1e-6, "{added} at {at_s} s");
        }
        assert_eq!(with_backlash.without_backlash().unwrap().end(), law.end());
    }

    #[test]
    fn slack_is_taken_up_at_each_turn_and_only_there() {
        // Forward, back, forward: turns at 0.5, 1, 1.5 s.
        let sine = Law::sine(500.0, Time::SECOND, Some(2)).unwrap();
        let looks = [(0.2, 0.0), (0.5, 0.0), (0.51, -5.0), (0.52, -10.0), (0.99, -10.0), (1.02, 0.0), (1.6, -10.0)];
        check(sine.clone(), 10.0, 0.02, &looks);
        // Backwards first: the slack is behind it the other way.
        check(sine.scaled(-1.0).unwrap(), 10.0, 0.02, &[(0.4, 0.0), (0.6, 10.0), (1.1, 0.0)]);
    }

    #[test]
    fn a_rest_at_the_turn_ends_before_the_compensation_begins() {
        let move_by = |d: f64| Law::trapezoid(d, 400.0, 4000.0, 4000.0).unwrap();
        let law = Law::then(vec![move_by(100.0), Law::rest(Time::SECOND).unwrap(), move_by(-100.0)]).unwrap();
        let turn = move_by(100.0).end().unwrap().seconds() + 1.0;
        check(law, 6.0, 0.01, &[(turn - 1e-9, 0.0), (turn + 0.005, -3.0), (turn + 0.01, -6.0)]);
    }

    #[test]
    fn a_turn_before_the_slack_is_taken_up_is_refused() {
        // Turns at 0.5, 1, 1.5 s.
        let sine = Law::sine(500.0, Time::SECOND, Some(2)).unwrap();
        check(sine.clone(), 10.0, 0.4, &[(0.7, -5.0), (1.0, -10.0), (1.45, 0.0)]);
        let with_backlash = sine.with_backlash(10.0, seconds(0.6)).unwrap();
        let error = with_backlash.pieces().find_map(Result::err).unwrap();
        let LawError::Backlash { at_s, until_s } = error else { panic!("{error}") };
        assert!((at_s - 1.0).abs() < 1e-9 && (until_s - 1.1).abs() < 1e-9, "{error}");
    }

    #[test]
    fn a_pause_in_the_same_direction_is_no_turn() {
        let move_by = |d: f64| Law::trapezoid(d, 400.0, 4000.0, 4000.0).unwrap();
        let law = Law::then(vec![move_by(100.0), Law::rest(Time::SECOND).unwrap(), move_by(100.0)]).unwrap();
        check(law, 6.0, 0.01, &[(0.9, 0.0), (1.5, 0.0), (2.0, 0.0)]);
    }

    #[test]
    fn an_endless_law_without_turns_has_pieces_all_the_way() {
        let law = Law::speed(1000.0, None).unwrap().with_backlash(5.0, seconds(0.1)).unwrap();
        assert_eq!(law.end(), None);
        assert_eq!(Cursor::new(&law).at(seconds(1e6)).unwrap().position, 1e9);
    }
}
