//! Following a law in time.

use super::{Law, LawError, Piece, Pieces};
use crate::Time;
use std::collections::VecDeque;

/// Position, speed and acceleration of a law at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// θ, steps: `whole` + `fraction`, rounded.
    pub position: f64,
    /// Whole steps of θ: the `origin` of the law's piece.
    pub whole: i64,
    /// θ − `whole`, steps; it may be more than one step.
    pub fraction: f64,
    /// θ', steps/s.
    pub speed: f64,
    /// θ'', steps/s².
    pub acceleration: f64,
}

/// Reads a law at times that mostly increase. It has its own copy of the law.
///
/// It needs constant memory. To go back over a few pieces costs nothing. To go further, back or ahead, takes no longer for a greater distance,
/// except for laws that depend on all that was before: see [`Law::pieces_from`].
///
/// ```
/// use pulsetrain_motion::{Law, Time, law::Cursor};
/// let law = Law::sine(100.0, Time::from_seconds(2.0), Some(1))?;
/// let mut cursor = Cursor::new(&law);
/// assert_eq!(cursor.at(Time::from_seconds(1.0))?.position, 200.0);
/// // Past its end a law stays where it is.
/// assert_eq!(cursor.at(Time::from_seconds(9.0))?.speed, 0.0);
/// # Ok::<(), pulsetrain_motion::LawError>(())
/// ```
pub struct Cursor {
    law: Law,
    /// The pieces after the recent ones; `None` before the first look.
    pieces: Option<Pieces>,
    recent: VecDeque<Piece>,
    /// Whether it may begin anywhere in the law without all the pieces before.
    jumps: bool,
}

// A law may be followed on another thread than the one that made it.
const _: () = {
    const fn is_send<T: Send + 'static>() {}
    is_send::<Cursor>();
};

/// Pieces kept for going back.
const KEPT: usize = 8;

impl Cursor {
    /// A cursor at the beginning of `law`.
    #[must_use]
    pub fn new(law: &Law) -> Cursor {
        let jumps = !law.depends_on_its_past();
        Cursor { law: law.clone(), pieces: None, recent: VecDeque::with_capacity(KEPT), jumps }
    }

    /// The law at `t`; before its beginning and past its end it is at rest.
    ///
    /// # Errors
    /// The law's own errors, if it is undefined or jumps at `t`, or in the pieces on the way there.
    pub fn at(&mut self, t: Time) -> Result<Sample, LawError> {
        if self.recent.front().is_some_and(|piece| t < piece.start && piece.start > Time::ZERO) {
            self.forget();
        }
        let mut walked = 0;
        while self.recent.back().is_none_or(|piece| piece.end < t) {
            if walked == KEPT && self.jumps {
                self.forget();
            }
            walked += 1;
            // Where two pieces meet, the first one counts. What walks anyway keeps the pieces before, for going back.
            let from = if self.jumps { t.before() } else { Time::ZERO };
            match self.pieces.get_or_insert_with(|| self.law.pieces_from(from)).next() {
                Some(piece) => {
                    if self.recent.len() == KEPT {
                        self.recent.pop_front();
                    }
                    self.recent.push_back(piece?);
                }
                None => break,
            }
        }
        let piece = self.recent.iter().rev().find(|piece| piece.start <= t).or(self.recent.front());
        let piece = piece.ok_or_else(|| LawError::Parameter("the motion is empty".into()))?;
        Ok(piece.sample(t))
    }

    /// Forgets where it is in the law.
    fn forget(&mut self) {
        self.recent.clear();
        self.pieces = None;
    }
}

impl Piece {
    /// The law at `t`, at rest outside of the piece.
    fn sample(&self, t: Time) -> Sample {
        let jet: [f64; 3] = self.curve.taylor((t.clamp(self.start, self.end) - self.zero).seconds());
        let moving = t >= self.start && t <= self.end;
        Sample {
            position: self.origin as f64 + jet[0],
            whole: self.origin,
            fraction: jet[0],
            speed: if moving { jet[1] } else { 0.0 },
            acceleration: if moving { 2.0 * jet[2] } else { 0.0 },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::{Ease, Joint, WORKED_OUT};
    use crate::machine::Delta;
    use crate::time::Rate;

    #[test]
    fn going_back_gives_the_same_as_going_forth() {
        let law = Law::sine(1000.0, Time::from_seconds(0.01), None).unwrap();
        let mut cursor = Cursor::new(&law);
        let mut sample = |k: u64| cursor.at(Time::from_ratio(1, 3000).times(k)).unwrap();
        let forth: Vec<Sample> = (0..300).map(&mut sample).collect();
        let back: Vec<Sample> = (0..300).rev().map(&mut sample).collect();
        assert!(forth.iter().eq(back.iter().rev()));
    }

    /// A law rests after its end, however far away that is.
    #[test]
    fn a_law_rests_after_its_end() {
        let sine = Law::sine(100.0, Time::SECOND, Some(3)).unwrap();
        let late = sine.clone().delayed(Time::from_seconds(2.0)).unwrap().faded(
            sine.clone().shifted(5.0).unwrap(),
            Time::from_seconds(1.0),
            Time::from_seconds(1.0),
        );
        let shifted = sine.clone().shifted(7.0).unwrap();
        let ease = Ease { before: Rate::ONE, after: Time::ZERO, over: Time::SECOND, to: Rate::of(0.5).unwrap() };
        let slowed = shifted.clone().retimed(Time::from_seconds(10.0), ease).unwrap();
        let steady = shifted.retimed(Time::from_seconds(10.0), Ease::steady(Rate::ONE)).unwrap();
        for (law, wanted) in [(sine, 0.0), (late.unwrap(), 5.0), (slowed, 7.0), (steady, 7.0)] {
            for at_s in [3.5, 100.0, 1e6] {
                let sample = Cursor::new(&law).at(Time::from_seconds(at_s)).unwrap();
                assert!((sample.position - wanted).abs() < 1e-9 && sample.speed == 0.0, "{sample:?} at {at_s} s");
                let mut walked = Cursor::new(&law);
                walked.at(Time::from_seconds(0.1)).unwrap();
                assert_eq!(walked.at(Time::from_seconds(at_s)).unwrap(), sample);
            }
        }
    }

    /// How many pieces are worked out, in all layers of the law together, for a look at `at`.
    #[track_caller]
    fn check(law: Result<Law, LawError>, most: usize) {
        let at = Time::from_seconds(1e6 + 0.01);
        let mut cursor = Cursor::new(&law.unwrap());
        let mut worked_out = |t: Time| {
            let before = WORKED_OUT.get();
            cursor.at(t).unwrap();
            WORKED_OUT.get() - before
        };
        // Of a new cursor, ahead from the beginning, and back.
        let counts = [worked_out(at), worked_out(Time::ZERO), worked_out(at), worked_out(at - Time::from_seconds(5e5))];
        assert!(counts.iter().all(|count| *count <= most), "{counts:?}");
    }

    #[test]
    fn a_look_at_a_far_time_needs_few_pieces() {
        let s = Time::from_seconds;
        let sine = |cycles| Law::sine(200.0, s(0.1), cycles);
        let short = || Law::trapezoid(100.0, 400.0, 4000.0, 4000.0).unwrap();
        check(sine(None), KEPT + 2);
        check(sine(Some(100_000_000)), KEPT + 2);
        check(Law::circle(200.0, s(0.1), None, 1), KEPT + 2);
        check(Law::speed(1e7, None), KEPT + 2);
        check(short().repeated(None), 2 * KEPT + 4);
        check(sine(None).unwrap().delayed(s(3.0)), 2 * KEPT + 4);
        check(Law::then(vec![short(), Law::rest(s(9e5)).unwrap(), sine(None).unwrap()]), 40);
        check(Law::sum(vec![sine(None).unwrap(), Law::circle(5.0, s(0.3), None, 0).unwrap()]), 40);
        check(sine(None).unwrap().stopped(s(1.2e6), 1e5, 0.0), 40);
        let slower = Ease { before: Rate::ONE, after: s(7.0), over: s(0.5), to: Rate::of(0.7).unwrap() };
        check(sine(None).unwrap().retimed(s(1e6), slower), 40);
        check(sine(None).unwrap().retimed(s(0.0), slower).unwrap().retimed(s(3e6), slower), 60);
        // Windows of 8 s: those in 64 s.
        check(Ok(Law::formula("30*sin(7*t)", &[], 200.0, None).unwrap()), KEPT + 10);
    }

    /// After one cursor has walked through laws that follow one another, other cursors find a later law at once.
    #[test]
    fn a_later_law_is_found_without_those_before() {
        let s = Time::from_seconds;
        let part = |k: u32| Law::trapezoid(f64::from(k) - 100.3, 400.0, 4000.0, 4000.0).unwrap();
        let law = Law::then((0..200).map(part).collect()).unwrap();
        let (end, mut walked) = (law.end().unwrap(), Cursor::new(&law));
        let times: Vec<Time> = (0..=40).map(|k| end.times(k).divided_by(40)).chain([s(0.0), end + s(1.0)]).collect();
        let samples: Vec<Sample> = times.iter().map(|t| walked.at(*t).unwrap()).collect();
        for (t, sample) in times.iter().zip(samples) {
            let before = WORKED_OUT.get();
            assert_eq!(Cursor::new(&law).at(*t).unwrap(), sample, "at {} s", t.seconds());
            assert!(WORKED_OUT.get() - before <= 8, "{} pieces", WORKED_OUT.get() - before);
        }
        // Laws that were not walked through give the same.
        let fresh = Law::then((0..200).map(part).collect()).unwrap();
        assert_eq!(Cursor::new(&fresh).at(times[33]).unwrap(), Cursor::new(&law).at(times[33]).unwrap());
    }

    #[test]
    fn few_coefficients_are_the_first_of_all() {
        let s = Time::from_seconds;
        let formula = |text: &str| Law::formula(text, &[], 1.0, None).unwrap();
        let sine = Law::sine(100.0, Time::SECOND, None).unwrap();
        let robot = Delta { base_mm: 60.0, upper_arm_mm: 70.0, forearm_mm: 150.0, effector_mm: 25.0 };
        let rest = Law::speed(0.0, None).unwrap().shifted(-140.0).unwrap();
        let arm = Law::arm(Joint::new(robot, 1, 500.0), [formula("9*sin(3*t)"), formula("tanh(t)^3"), rest]);
        let ease = Ease { before: Rate::ONE, after: Time::ZERO, over: s(0.5), to: Rate::of(0.5).unwrap() };
        let laws = [
            Law::trapezoid(300.0, 400.0, 4000.0, 4000.0).unwrap(),
            formula("sqrt(2 + sin(t))/(1 + t^2) + asin(0.3*cos(t))*exp(-t)"),
            arm.clone(),
            sine.clone().retimed(s(0.2), ease).unwrap(),
            arm.faded_apart(sine.clone(), s(0.1), s(1.0)).unwrap(),
            Law::sum(vec![sine, formula("atan(t)")]).unwrap(),
        ];
        for law in laws {
            for piece in law.pieces().take(12).map(Result::unwrap) {
                let u = (piece.start - piece.zero).seconds() + 0.3 * (piece.end - piece.start).seconds();
                let few: [f64; 3] = piece.curve.taylor(u);
                assert_eq!(few, piece.curve.jet(u)[..3], "{:?}", piece.curve);
            }
        }
    }
}
