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

/// Constant jerk for a while.
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

/// The fastest way from speed `v` and acceleration `a` (within the limit) to speed `to` and acceleration 0.
fn change_speed(v: f64, a: f64, to: f64, max_acceleration: f64, max_jerk: f64) -> [Phase; 3] {
    // The speed that is left when the acceleration is simply taken back decides the direction.
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

    /// Braking from above the speed limit: the jerk limit down, then constant, until the speed limit is reached.
    /// It stops short where going on would, by the time the deceleration is taken back, pass the opposite limit.
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

    /// Where the move stands when it has come to rest by way of the speed `peak`, from `from` on.
    fn reach(&self, from: State, peak: f64) -> f64 {
        let at_peak = self.change(from, peak).into_iter().fold(from, State::after);
        self.change(at_peak, 0.0).into_iter().fold(State { a: 0.0, ..at_peak }, State::after).x
    }

    fn change(&self, from: State, to: f64) -> [Phase; 3] {
        change_speed(from.v, from.a, to, self.max_acceleration, self.max_jerk)
    }

    /// The speed between the move's two changes of speed, and how long it is kept, s.
    ///
    /// Where the move comes to rest grows with that speed, so one bisection finds it: of two time-optimal moves with
    /// the same beginning, the one with the higher peak is nowhere behind.
    fn peak(&self, from: State) -> (f64, f64) {
        let straight = from.v + from.a * from.a.abs() / (2.0 * self.max_jerk);
        let forward = self.distance >= self.reach(from, straight);
        let limit = if forward { self.max_speed } else { -self.max_speed };
        // From the peak that adds nothing to the stop, outward.
        let mut near = if forward { straight.max(0.0).min(limit) } else { straight.min(0.0).max(limit) };
        let short = |peak: f64| {
            if forward { self.reach(from, peak) <= self.distance } else { self.reach(from, peak) >= self.distance }
        };
        if short(limit) {
            return (limit, (self.distance - self.reach(from, limit)) / limit);
        }
        let mut far = limit;
        loop {
            let middle = 0.5 * (near + far);
            if middle == near || middle == far {
                return (near, 0.0);
            }
            if short(middle) { near = middle } else { far = middle }
        }
    }
}

/// Lays phases one after the other.
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
        // The rest backward from the target, so that it is met exactly.
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
