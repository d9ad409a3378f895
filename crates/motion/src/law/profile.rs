//! Moves from speed to rest: trapezoids and jerk-limited S-curves.

use super::{Class, Curve, Double, Entry, FARTHEST, Law, LawError, Piece, checked};
use crate::Time;

/// A time-optimal jerk-limited move that ends at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SCurve {
    /// Steps, signed.
    pub distance: f64,
    /// steps/s, positive.
    pub max_speed: f64,
    /// steps/s², positive.
    pub max_acceleration: f64,
    /// steps/s³, positive.
    pub max_jerk: f64,
    /// steps/s, of either sign; the acceleration there is 0. If it is above `max_speed` the move brakes first.
    pub start_speed: f64,
}

/// A time of constant jerk.
#[derive(Clone, Copy, Debug)]
struct Phase {
    duration: f64,
    jerk: f64,
}

/// Position, speed, acceleration.
#[derive(Clone, Copy, Debug)]
struct State {
    x: f64,
    v: f64,
    a: f64,
}

impl State {
    /// The state after `t` seconds of constant jerk.
    fn after(self, Phase { duration: t, jerk: j }: Phase) -> State {
        State {
            x: self.x + t * (self.v + t * (self.a / 2.0 + t * j / 6.0)),
            v: self.v + t * (self.a + t * j / 2.0),
            a: self.a + t * j,
        }
    }
}

/// The fastest change from speed `v` and acceleration `a` (within the limit) to speed `to` and acceleration 0.
fn change_speed(v: f64, a: f64, to: f64, max_acceleration: f64, max_jerk: f64) -> [Phase; 3] {
    // If the acceleration is only brought to 0, this speed results. It decides the direction of the change.
    let side = if to >= v + a * a.abs() / (2.0 * max_jerk) { 1.0 } else { -1.0 };
    let (gain, a) = (side * (to - v), side * a);
    let peak = (max_jerk * gain + a * a / 2.0).max(0.0).sqrt();
    let (peak, hold) = if peak <= max_acceleration {
        (peak, 0.0)
    } else {
        let ramps = (2.0 * max_acceleration * max_acceleration - a * a) / (2.0 * max_jerk);
        (max_acceleration, (gain - ramps) / max_acceleration)
    };
    let jerk = side * max_jerk;
    [
        Phase { duration: ((peak - a) / max_jerk).max(0.0), jerk },
        Phase { duration: hold.max(0.0), jerk: 0.0 },
        Phase { duration: peak / max_jerk, jerk: -jerk },
    ]
}

impl SCurve {
    fn check(&self) -> Result<(), LawError> {
        checked("distance", self.distance, "steps", |d| d.abs() < FARTHEST)?;
        checked("max_speed", self.max_speed, "steps/s", |v| v > 0.0 && v <= 1e12)?;
        checked("max_acceleration", self.max_acceleration, "steps/s²", |a| a > 0.0 && a <= 1e15)?;
        checked("max_jerk", self.max_jerk, "steps/s³", |j| j > 0.0 && j <= 1e18)?;
        checked("start_speed", self.start_speed, "steps/s", |v| v.abs() <= 1e12)?;
        if self.distance == 0.0 && self.start_speed == 0.0 {
            return Err(LawError::Parameter("distance is 0 steps: there is nothing to do".into()));
        }
        Ok(())
    }

    /// Braking from above the speed limit: the deceleration grows at the jerk limit, then is constant, until the speed limit is reached.
    /// It ends earlier if the speed would pass the opposite limit before the deceleration can be brought back to 0.
    fn brake(&self) -> [Phase; 2] {
        let (v, jerk, limit) = (self.start_speed.abs(), self.max_jerk, self.max_speed);
        if v <= limit {
            return [Phase { duration: 0.0, jerk: 0.0 }; 2];
        }
        let to_full = self.max_acceleration / jerk;
        let to_limit = (2.0 * jerk * (v - limit)).sqrt() / jerk;
        let to_opposite = (jerk * (v + limit)).sqrt() / jerk;
        let (ramp, hold) = if to_full < to_limit.min(to_opposite) {
            let at_full = v - 0.5 * jerk * to_full * to_full;
            let to_limit = (at_full - limit) / self.max_acceleration;
            let to_opposite = (at_full + limit) / self.max_acceleration - self.max_acceleration / (2.0 * jerk);
            (to_full, to_limit.min(to_opposite).max(0.0))
        } else {
            (to_limit.min(to_opposite), 0.0)
        };
        let down = -self.start_speed.signum() * jerk;
        [Phase { duration: ramp, jerk: down }, Phase { duration: hold, jerk: 0.0 }]
    }

    /// The position at rest of a move from `from` by way of the speed `peak`.
    fn reach(&self, from: State, peak: f64) -> f64 {
        let at_peak = self.change(from, peak).into_iter().fold(from, State::after);
        self.change(at_peak, 0.0).into_iter().fold(State { a: 0.0, ..at_peak }, State::after).x
    }

    fn change(&self, from: State, to: f64) -> [Phase; 3] {
        change_speed(from.v, from.a, to, self.max_acceleration, self.max_jerk)
    }

    /// The speed between the move's two changes of speed, and how long it is kept, s.
    ///
    /// The final position grows with that speed outside of the speeds between rest and `straight`, so that one bisection finds it. (Of two
    /// time-optimal moves with the same beginning, the one with the higher peak is never behind the other.)
    fn peak(&self, from: State) -> (f64, f64) {
        let beyond = |peak: f64| self.reach(from, peak) - self.distance;
        // A speed between them is found by halving, near enough that no double is between the two.
        let between = |mut near: f64, mut far: f64| {
            let side = beyond(far).signum();
            loop {
                let middle = 0.5 * (near + far);
                if middle == near || middle == far {
                    return near;
                }
                if beyond(middle) * side <= 0.0 { near = middle } else { far = middle }
            }
        };
        let straight = from.v + from.a * from.a.abs() / (2.0 * self.max_jerk);
        let (at_rest, at_straight) = (beyond(0.0), beyond(straight));
        // After a brake that is not over at the speed limit, motors stop sooner if they brake on than if they first let go of it.
        if at_rest * at_straight < 0.0 {
            return (between(0.0, straight), 0.0);
        }
        let forward = at_straight <= 0.0;
        let limit = if forward { self.max_speed } else { -self.max_speed };
        let short = beyond(limit) * limit <= 0.0;
        if short {
            return (limit, -beyond(limit) / limit);
        }
        // The search begins at the peak of a plain stop, and goes outward.
        let near = if forward { straight.max(0.0).min(limit) } else { straight.min(0.0).max(limit) };
        (between(near, limit), 0.0)
    }
}

/// Builds pieces one after the other.
struct Track {
    pieces: Vec<Piece>,
    at: Time,
}

impl Track {
    /// Adds a stretch of `c[0] + c[1]·u + …` whose u is 0 at its beginning.
    fn forward(&mut self, duration: f64, c: Vec<f64>) -> Result<(), LawError> {
        self.add(duration, c, false)
    }

    /// Adds a stretch whose u is 0 at its end.
    fn backward(&mut self, duration: f64, c: Vec<f64>) -> Result<(), LawError> {
        self.add(duration, c, true)
    }

    fn add(&mut self, duration: f64, mut c: Vec<f64>, backward: bool) -> Result<(), LawError> {
        let (start, end) = (self.at, self.at + Time::from_seconds(duration));
        if end > start {
            if end > Time::from_seconds(1e12) {
                return Err(LawError::Parameter(format!("the move takes {duration} s: longer than 1e12 s")));
            }
            let position = std::mem::take(&mut c[0]);
            let zero = if backward { end } else { start };
            let mut piece =
                Piece { zero, start, end, origin: 0, curve: Curve::Polynomial(c), entry: Entry::Continuous };
            piece.raise(Double::from(position))?;
            self.pieces.push(piece);
            self.at = end;
        }
        Ok(())
    }
}

impl Law {
    /// A trapezoid of speed over `distance` (steps, signed), or a triangle where the distance is too short for `speed`.
    ///
    /// `speed` in steps/s, `acceleration` and `deceleration` in steps/s², all positive.
    ///
    /// # Errors
    /// [`LawError::Parameter`] for a distance of 0 and for limits that are not positive.
    pub fn trapezoid(distance: f64, speed: f64, acceleration: f64, deceleration: f64) -> Result<Law, LawError> {
        checked("distance", distance, "steps", |d| d != 0.0 && d.abs() < FARTHEST)?;
        checked("speed", speed, "steps/s", |v| v > 0.0 && v <= 1e12)?;
        checked("acceleration", acceleration, "steps/s²", |a| a > 0.0 && a <= 1e15)?;
        checked("deceleration", deceleration, "steps/s²", |a| a > 0.0 && a <= 1e15)?;
        let way = distance.abs();
        let peak = speed.min((2.0 * way / (1.0 / acceleration + 1.0 / deceleration)).sqrt());
        let (up, down) = (0.5 * peak * peak / acceleration, 0.5 * peak * peak / deceleration);
        let sign = distance.signum();
        let mut track = Track { pieces: Vec::new(), at: Time::ZERO };
        track.forward(peak / acceleration, vec![0.0, 0.0, sign * 0.5 * acceleration])?;
        track.forward(((way - up - down) / peak).max(0.0), vec![sign * up, sign * peak])?;
        track.backward(peak / deceleration, vec![distance, 0.0, -sign * 0.5 * deceleration])?;
        Law::fixed(track.pieces, Class::ClosedForm)
    }

    /// The time-optimal jerk-limited move of `s` that ends at rest. [`Law::end`] is its duration.
    ///
    /// Source of the structure (two changes of speed around a cruise, each at most three phases of constant jerk):
    /// L. Berscheid, T. Kröger, "Jerk-limited Real-time Trajectory Generation with Arbitrary Target States", RSS 2021.
    ///
    /// # Errors
    /// [`LawError::Parameter`] for limits that are not positive, and where neither distance nor start speed asks for a
    /// motion.
    pub fn s_curve(s: SCurve) -> Result<Law, LawError> {
        s.check()?;
        let mut track = Track { pieces: Vec::new(), at: Time::ZERO };
        let mut state = State { x: 0.0, v: s.start_speed, a: 0.0 };
        let mut forward = |state: &mut State, phase: Phase| {
            track.forward(phase.duration, vec![state.x, state.v, 0.5 * state.a, phase.jerk / 6.0])?;
            *state = state.after(phase);
            Ok::<_, LawError>(())
        };
        for phase in s.brake() {
            forward(&mut state, phase)?;
        }
        let (peak, cruise_s) = s.peak(state);
        for phase in s.change(state, peak) {
            forward(&mut state, phase)?;
        }
        state = State { v: peak, a: 0.0, ..state };
        forward(&mut state, Phase { duration: cruise_s, jerk: 0.0 })?;
        // The last change of speed is built backward from the target, so that the target is met exactly.
        let phases = s.change(state, 0.0);
        let mut end = State { x: s.distance, v: 0.0, a: 0.0 };
        let mut ends = Vec::new();
        for phase in phases.into_iter().rev() {
            ends.push((phase, end));
            end = end.after(Phase { duration: -phase.duration, jerk: phase.jerk });
        }
        for (phase, end) in ends.into_iter().rev() {
            track.backward(phase.duration, vec![end.x, end.v, 0.5 * end.a, phase.jerk / 6.0])?;
        }
        Law::fixed(track.pieces, Class::Enclosed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::Cursor;
    use proptest::prelude::*;

    #[track_caller]
    fn durations(law: &Law, expected: &[f64]) {
        let got: Vec<f64> = law.pieces().map(|p| p.map(|p| (p.end - p.start).seconds()).unwrap()).collect();
        assert!(got.len() == expected.len() && got.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{got:?}");
    }

    #[test]
    fn trapezoids_and_triangles() {
        // 1000 steps/s in 1 s and back in 0.5 s take 500 + 250 steps.
        durations(&Law::trapezoid(1750.0, 1000.0, 1000.0, 2000.0).unwrap(), &[1.0, 1.0, 0.5]);
        durations(&Law::trapezoid(-187.5, 1000.0, 1000.0, 2000.0).unwrap(), &[0.5, 0.25]);
        assert!(Law::trapezoid(10.0, 0.0, 1.0, 1.0).is_err());
        assert!(Law::trapezoid(f64::NAN, 1.0, 1.0, 1.0).is_err());
    }

    #[test]
    fn an_s_curve_with_all_seven_phases() {
        // Jerk to full acceleration 0.5 s, held 0.5 s, taken back 0.5 s: 1000 steps/s after 750 steps; a second of cruise.
        let s = SCurve {
            distance: 2500.0,
            max_speed: 1000.0,
            max_acceleration: 1000.0,
            max_jerk: 2000.0,
            start_speed: 0.0,
        };
        durations(&Law::s_curve(s).unwrap(), &[0.5, 0.5, 0.5, 1.0, 0.5, 0.5, 0.5]);
        let backward = SCurve { distance: -2500.0, ..s };
        assert_eq!(Law::s_curve(backward).unwrap().end(), Law::s_curve(s).unwrap().end());
    }

    /// Motors that brake from above the limit, and where they could stop a little sooner than by letting go of the brake at the limit.
    #[test]
    fn a_move_that_brakes_on_arrives() {
        let s = SCurve {
            distance: 202.0690673254012,
            max_speed: 10.0,
            max_acceleration: 3.045347628849082,
            max_jerk: 14.198232594650333,
            start_speed: 34.713319712726225,
        };
        for distance in (0..60).map(|k| 190.0 + 0.25 * f64::from(k)).chain([s.distance]) {
            for sign in [1.0, -1.0] {
                let law =
                    Law::s_curve(SCurve { distance: sign * distance, start_speed: sign * s.start_speed, ..s }).unwrap();
                let mut position = Double::ZERO;
                for piece in law.pieces().map(Result::unwrap) {
                    assert!(
                        (piece.first_position() - position).nearest().abs() < 1e-9,
                        "{distance} at {:?}",
                        piece.start
                    );
                    position = piece.last_position();
                }
                assert!((position.nearest() - sign * distance).abs() < 1e-9, "{distance}: {position:?}");
            }
        }
    }

    fn moves() -> impl Strategy<Value = SCurve> {
        (-3.0_f64..2.0, 1.0_f64..5.0, -1.0_f64..2.0, -1.0_f64..3.0, -5.0_f64..5.0, any::<bool>()).prop_map(
            |(way, speed, acceleration, jerk, start, forward)| {
                let max_speed = 10_f64.powf(speed);
                let max_acceleration = max_speed * 10_f64.powf(acceleration);
                let max_jerk = max_acceleration * 10_f64.powf(jerk);
                let scale = max_speed * (max_speed / max_acceleration + max_acceleration / max_jerk);
                let distance = scale * 10_f64.powf(way) * if forward { 1.0 } else { -1.0 };
                // Mostly from within the limits.
                let start_speed = max_speed * if start.abs() < 3.0 { start / 3.0 } else { start };
                SCurve { distance, max_speed, max_acceleration, max_jerk, start_speed }
            },
        )
    }

    proptest! {
        #[test]
        fn s_curves_stay_within_their_limits_and_arrive(s in moves()) {
            let law = Law::s_curve(s).unwrap();
            let end = law.end().unwrap();
            let mut cursor = Cursor::new(&law);
            let (mut fast, mut before) = (true, None::<f64>);
            for k in 0..=2000 {
                let sample = cursor.at(end.divided_by(2000).times(k)).unwrap();
                prop_assert!(sample.acceleration.abs() <= s.max_acceleration * (1.0 + 1e-6), "{sample:?}");
                // Too fast only until the limit is reached; the jerk that then takes the braking back reaches no further.
                fast &= sample.speed.abs() > s.max_speed * (1.0 + 1e-6);
                let limit = if fast { s.start_speed.abs() } else { s.max_speed };
                prop_assert!(sample.speed.abs() <= limit * (1.0 + 1e-6), "{k} {sample:?} {s:?}");
                if let Some(before) = before {
                    let most = s.max_jerk * end.seconds() / 2000.0 + 1e-6 * s.max_acceleration;
                    prop_assert!((sample.acceleration - before).abs() <= most * (1.0 + 1e-6), "{k} {sample:?}");
                }
                before = Some(sample.acceleration);
            }
            let last = cursor.at(end).unwrap();
            let scale = s.distance.abs() + s.start_speed * s.start_speed / s.max_acceleration;
            prop_assert!((last.position - s.distance).abs() <= 1e-9 * scale, "{last:?}");
            prop_assert!(last.speed.abs() <= 1e-6 * s.max_speed, "{last:?}");
            let mut position = Double::ZERO;
            for piece in law.pieces() {
                let piece = piece.unwrap();
                let gap = (piece.first_position() - position).nearest();
                prop_assert!(gap.abs() <= 1e-9 * scale, "{gap} at {}", piece.start.seconds());
                position = piece.last_position();
            }
        }
    }
}
