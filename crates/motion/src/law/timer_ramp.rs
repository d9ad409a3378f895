//! The maximum-speed article's ramp: intervals linear in the step number, counted in ticks of a timer.

use super::{Class, Curve, Double, Entry, Law, LawError, Piece, checked};
use crate::Time;

/// The maximum-speed article's move, in its own terms. Source: its sketch, `setup()` and the timer's interrupt.
///
/// Counts are intervals: the sketch's register holds one less than the interval that the chip makes of it
/// (ATmega328P DS40002061B §18.7.2: CTC), and it is the caller who adds that one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimerRamp {
    /// Steps of the move, signed.
    pub steps: i64,
    /// One tick of the timer, s (8 µs in the sketch).
    pub tick_s: f64,
    /// The longest interval that the ramp may begin with, ticks (the sketch's 255).
    pub start_count: u32,
    /// The interval at full speed, ticks.
    pub cruise_count: u32,
    /// Steps that the ramp is wanted to take.
    pub accelerate_during: u32,
}

/// The ramp that the sketch's `setup()` computes, ticks and steps.
struct Intervals {
    initial: i64,
    delta: i64,
    during: i64,
}

/// `steps` intervals that change by `difference` ticks from one to the next.
struct Run {
    first: i64,
    difference: i64,
    steps: i64,
}

impl TimerRamp {
    fn ramp(&self) -> Intervals {
        let (start, cruise) = (i64::from(self.start_count), i64::from(self.cruise_count));
        match i64::from(self.accelerate_during) {
            0 => Intervals { initial: cruise, delta: 0, during: 0 },
            during => match (start - cruise) / during {
                // A delta below 1: a shorter ramp of 1 each step, from the longest interval on.
                ..=0 if cruise < start => Intervals { initial: start, delta: 1, during: start - cruise },
                ..=0 => Intervals { initial: cruise, delta: 0, during: 0 },
                delta => Intervals { initial: cruise + delta * during, delta, during },
            },
        }
    }

    /// The intervals before steps 1, 2, …, as the sketch's two counters make them.
    ///
    /// As in the sketch, a move shorter than both ramps slows down early, and one shorter than a ramp only accelerates. One thing is not
    /// copied: the sketch's 8-bit register wraps when such a move slows down past the initial interval.
    fn runs(&self) -> [Run; 3] {
        let Intervals { initial, delta, during } = self.ramp();
        let steps = self.steps.unsigned_abs().min(i64::MAX as u64) as i64;
        // The interrupt of step k has steps − k + 1 steps left. It slows down from step `turn` + 1 on.
        let turn = if during > 0 && steps >= during { steps - during } else { steps };
        let up = during.min(turn);
        let least = initial - delta * up;
        let flat = (turn + 1 - up).min(steps - up);
        [
            Run { first: initial, difference: -delta, steps: up },
            Run { first: least, difference: 0, steps: flat },
            Run { first: least + delta, difference: delta, steps: steps - up - flat },
        ]
    }
}

impl Law {
    /// The maximum-speed article's ramp: θ reaches each whole step exactly when the sketch makes it; in between, t is quadratic in θ.
    ///
    /// The speed jumps from step to step, as in the sketch, so that pieces begin with [`Entry::SpeedJump`]. The first one does not: the motor
    /// must be able to start at the speed of the first interval.
    ///
    /// # Errors
    /// [`LawError::Parameter`] for a move of 0 steps, a count of 0, or a tick that is not positive.
    pub fn timer_ramp(ramp: TimerRamp) -> Result<Law, LawError> {
        checked("the timer's tick", ramp.tick_s, "s", |t| t > 0.0 && t < 1e6)?;
        checked("steps", ramp.steps as f64, "", |n| n != 0.0 && n.abs() < 1e12)?;
        checked("the cruise count", f64::from(ramp.cruise_count), "ticks", |n| n > 0.0)?;
        let direction = ramp.steps.signum();
        let mut pieces: Vec<Piece> = Vec::new();
        let (mut at_ticks, mut at_steps) = (0_i64, 0_i64);
        let time = |ticks: i64| {
            let exact = Double::from(ramp.tick_s) * Double::from(ticks);
            Time::from_seconds(exact.hi) + Time::from_seconds(exact.lo)
        };
        for run in ramp.runs().into_iter().filter(|run| run.steps > 0) {
            let (n, d) = (i128::from(run.steps), i128::from(run.difference));
            let ticks = n * i128::from(run.first) + d * (n * (n - 1) / 2);
            let end_ticks = i64::try_from(ticks).ok().and_then(|ticks| at_ticks.checked_add(ticks));
            let Some(end_ticks) = end_ticks.filter(|&t| t as f64 * ramp.tick_s < 1e12) else {
                return Err(LawError::Parameter("the move takes longer than 1e12 s".into()));
            };
            // t(x) = first·x + difference·x(x − 1)/2, ticks.
            let difference = run.difference as f64;
            let curve = if run.difference == 0 {
                Curve::Polynomial(vec![0.0, direction as f64 / (run.first as f64 * ramp.tick_s)])
            } else {
                Curve::TimerRamp {
                    u0: 0.0,
                    x0: 0.0,
                    factor: direction as f64,
                    linear: (run.first as f64 - 0.5 * difference) * ramp.tick_s,
                    quadratic: 0.5 * difference * ramp.tick_s,
                }
            };
            pieces.push(Piece {
                zero: time(at_ticks),
                start: time(at_ticks),
                end: time(end_ticks),
                origin: direction * at_steps,
                curve,
                entry: if pieces.is_empty() { Entry::Continuous } else { Entry::SpeedJump },
            });
            at_ticks = end_ticks;
            at_steps += run.steps;
        }
        Law::fixed(pieces, Class::ClosedForm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The sketch's setup() and interrupt, line by line, on integers: the interval before each step, ticks.
    fn sketch(ramp: &TimerRamp) -> Vec<i64> {
        let (top, cruise) = (i64::from(ramp.start_count), i64::from(ramp.cruise_count));
        let mut during = i64::from(ramp.accelerate_during);
        let (mut delta, mut interval) = (0, cruise);
        if during > 0 {
            delta = (top - cruise) / during;
            if delta <= 0 {
                if cruise < top {
                    (delta, interval, during) = (1, top, top - cruise);
                } else {
                    (delta, during) = (0, 0);
                }
            } else {
                interval = cruise + delta * during;
            }
        }
        let (mut up, mut down, mut left) = (during, during, ramp.steps.abs());
        let mut intervals = Vec::new();
        while left > 0 {
            intervals.push(interval);
            if left == down {
                down -= 1;
                interval += delta;
            } else if up > 0 {
                up -= 1;
                interval -= delta;
            }
            left -= 1;
        }
        intervals
    }

    fn check(ramp: TimerRamp) {
        let law = Law::timer_ramp(ramp).unwrap();
        let mut cursor = crate::law::Cursor::new(&law);
        let (mut ticks, mut steps) = (0, 0);
        for interval in sketch(&ramp) {
            ticks += interval;
            steps += ramp.steps.signum();
            let sample = cursor.at(Time::from_seconds(ticks as f64 * ramp.tick_s)).unwrap();
            // 1e-9 step is far below a tick at any speed that a count of 1 or more gives.
            assert!((sample.position - steps as f64).abs() < 1e-9, "{ramp:?}: {} at step {steps}", sample.position);
        }
        let end = ticks as f64 * ramp.tick_s;
        assert!((law.end().unwrap().seconds() - end).abs() <= 2.0 * f64::EPSILON * end);
    }

    const SKETCH: TimerRamp =
        TimerRamp { steps: 1600, tick_s: 8e-6, start_count: 255, cruise_count: 18, accelerate_during: 10 };

    #[test]
    fn steps_come_when_the_sketch_makes_them() {
        check(SKETCH);
        check(TimerRamp { steps: -1600, ..SKETCH });
        // A delta below 1: 237 steps of 1 tick.
        check(TimerRamp { accelerate_during: 255, ..SKETCH });
        check(TimerRamp { accelerate_during: 0, ..SKETCH });
        check(TimerRamp { cruise_count: 255, ..SKETCH });
    }

    proptest! {
        #[test]
        fn any_move_does(steps in -60_i64..60, start in 1_u32..300, cruise in 1_u32..300, during in 0_u32..40) {
            prop_assume!(steps != 0);
            check(TimerRamp { steps, tick_s: 8e-6, start_count: start, cruise_count: cruise, accelerate_during: during });
        }
    }
}
