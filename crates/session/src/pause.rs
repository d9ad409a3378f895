//! Pause and resume: how the laws' time is slowed to a halt and brought up to speed again, within the motors' limits.
//!
//! All motors share one time: their paths and their phases stay what they were. A pause takes as long as the motor that has
//! least to spare needs; where a law brakes by itself as hard as it may, it is first let go on.

use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::program::{Motor, Program};
use pulsetrain_motion::{Law, LawError, Time};
use pulsetrain_plan::SOFTEST_STOP_S;
use serde::Serialize;

/// When the laws' time begins to be slowed, and how long that takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Easing {
    /// The laws go on for so long.
    pub after: Time,
    /// Then their time comes to a halt within this, in which they do half of it.
    pub over: Time,
}

/// Why motors cannot be paused or resumed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PauseError {
    /// A law breaks where it is looked at.
    #[error("motor {motor}: {error}")]
    Law {
        /// Index of the motor in the program.
        motor: usize,
        /// How.
        error: LawError,
    },
    /// The laws ask for all that the motors can do, for too long.
    #[error(
        "no {what} within {within_s} s keeps all motors to their max_acceleration: the motion itself takes all of it"
    )]
    NoRoom {
        /// "pause" or "resumption".
        what: &'static str,
        /// So far it was looked, s.
        within_s: f64,
    },
}

/// How far ahead it is looked, s: first, and if that was not enough.
const LOOK_S: [f64; 2] = [2.0, 30.0];
/// At so many places of that.
const LOOKS: usize = 4096;
/// The shortest easing, s; others are longer by this factor each.
const SHORTEST_S: f64 = 0.01;
const LONGER: f64 = 1.1;
/// Places of an easing that are looked at.
const PLACES: usize = 48;
/// Of the limit, so that what lies between two looks is within it too.
const SPARE: f64 = 0.97;
/// Motors without a limit are braked up to so many times as hard as their laws do.
const UNLIMITED: f64 = 2.0;

/// One motor, at the looks.
struct Seen {
    /// steps/s, steps/s².
    at: Vec<(f64, f64)>,
    limit: f64,
}

impl Seen {
    fn of(motor: &Motor, from: Time, look: Time) -> Result<Seen, LawError> {
        let mut cursor = Cursor::new(&motor.law);
        let mut at = Vec::with_capacity(LOOKS + 1);
        for k in 0..=LOOKS as u64 {
            let sample = cursor.at(from + look.times(k).divided_by(LOOKS as u64))?;
            at.push((sample.speed, sample.acceleration));
        }
        let limit = motor.limits.max_acceleration.unwrap_or_else(|| {
            let own = at.iter().map(|(speed, acceleration)| acceleration.abs().max(speed.abs() / SOFTEST_STOP_S));
            UNLIMITED * own.fold(0.0, f64::max)
        });
        Ok(Seen { at, limit })
    }

    /// Whether the motor stays within its limit where the laws' time is `part` of the look, and runs at `rate`, which
    /// changes by `change` a second. What the law itself asks for was planned.
    fn allows(&self, part: f64, rate: f64, change: f64, spare: f64) -> bool {
        let place = (part * LOOKS as f64).round() as usize;
        let Some((speed, acceleration)) = self.at.get(place).copied() else { return false };
        let asked = (acceleration * rate * rate + speed * change).abs();
        asked <= self.limit * spare || asked <= acceleration.abs() || speed == 0.0
    }
}

fn seen(program: &Program, from: Time, look_s: f64) -> Result<Vec<Seen>, PauseError> {
    let look = Time::from_seconds(look_s);
    let motors = program.motors.iter().enumerate();
    motors.map(|(motor, m)| Seen::of(m, from, look).map_err(|error| PauseError::Law { motor, error })).collect()
}

/// Durations that are tried, s.
fn durations(longest_s: f64) -> impl Iterator<Item = f64> {
    std::iter::successors(Some(SHORTEST_S), |s| Some(s * LONGER)).take_while(move |s| *s <= longest_s)
}

/// The quickest way to a halt for motors that are at `from` of their laws; `caution` up to 1: less if that was too much.
///
/// # Errors
/// When a law breaks, or leaves no room.
pub fn quickest_halt(program: &Program, from: Time, caution: f64) -> Result<Easing, PauseError> {
    for look_s in LOOK_S {
        let seen = seen(program, from, look_s)?;
        let fits = |after_s: f64, over_s: f64| {
            (0..=PLACES).all(|k| {
                let x = k as f64 / PLACES as f64;
                let time_s = after_s + over_s * (x - x * x * x + 0.5 * x * x * x * x);
                let (rate, change) = (1.0 - x * x * (3.0 - 2.0 * x), -6.0 * x * (1.0 - x) / over_s);
                seen.iter().all(|seen| seen.allows(time_s / look_s, rate, change, SPARE * caution))
            })
        };
        let mut best: Option<(f64, f64)> = None;
        for after_s in (0..64).map(|k| look_s * f64::from(k) / 128.0) {
            let left_s = best.map_or(look_s, |(after_s, over_s)| after_s + over_s) - after_s;
            let found = durations(left_s.min(look_s - after_s)).find(|over_s| fits(after_s, *over_s));
            best = found.map(|over_s| (after_s, over_s)).or(best);
        }
        if let Some((after_s, over_s)) = best {
            return Ok(Easing { after: Time::from_seconds(after_s), over: Time::from_seconds(over_s) });
        }
    }
    Err(PauseError::NoRoom { what: "pause", within_s: LOOK_S[1] })
}

/// How long motors take at least that halted at `from` of their laws, until their time runs as ever.
///
/// # Errors
/// As [`quickest_halt`].
pub fn quickest_start(program: &Program, from: Time, caution: f64) -> Result<Time, PauseError> {
    for look_s in LOOK_S {
        let seen = seen(program, from, look_s)?;
        let fits = |over_s: &f64| {
            (0..=PLACES).all(|k| {
                let x = k as f64 / PLACES as f64;
                let time_s = over_s * (x * x * x - 0.5 * x * x * x * x);
                let (rate, change) = (x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x) / over_s);
                seen.iter().all(|seen| seen.allows(time_s / look_s, rate, change, SPARE * caution))
            })
        };
        // In an easing the laws do half of it.
        if let Some(over_s) = durations(2.0 * look_s).find(fits) {
            return Ok(Time::from_seconds(over_s));
        }
    }
    Err(PauseError::NoRoom { what: "resumption", within_s: 2.0 * LOOK_S[1] })
}

/// The program with other laws.
fn with_laws(program: &Program, change: impl Fn(Law) -> Result<Law, LawError>) -> Result<Program, PauseError> {
    let mut program = program.clone();
    for (motor, m) in program.motors.iter_mut().enumerate() {
        m.law = change(m.law.clone()).map_err(|error| PauseError::Law { motor, error })?;
    }
    Ok(program)
}

/// All laws from `from` on, up to a halt.
///
/// # Errors
/// When a law cannot be followed so.
pub fn halting(program: &Program, from: Time, easing: Easing) -> Result<Program, PauseError> {
    with_laws(program, |law| law.eased_out(from, easing.after, easing.over))
}

/// All laws from `from` on, from a halt.
///
/// # Errors
/// When a law cannot be followed so.
pub fn starting(program: &Program, from: Time, over: Time) -> Result<Program, PauseError> {
    with_laws(program, |law| law.eased_in(from, over))
}

/// A pause that is part of a program: when its motors are where.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Paused {
    /// They begin to slow down, s.
    pub slows_at_s: f64,
    /// They rest, s.
    pub rests_at_s: f64,
    /// They begin to move again, and run at the laws' speed, s.
    pub goes_on_s: Option<(f64, f64)>,
}

/// A program that pauses by itself: from `at` on its time is slowed to a halt; from `until` on, or from the halt if that is
/// later, it runs again.
///
/// # Errors
/// When a law breaks, or leaves no room.
pub fn paused(program: &Program, at: Time, until: Option<Time>) -> Result<(Program, Paused), PauseError> {
    let Easing { after, over } = quickest_halt(program, at, 1.0)?;
    let (slows, halt) = (at + after, at + after + over.divided_by(2));
    let rests = slows + over;
    let goes_on = match until {
        Some(until) => Some((until.max(rests), quickest_start(program, halt, 1.0)?)),
        None => None,
    };
    let program = with_laws(program, |law| {
        let mut parts = vec![law.clone().eased_out(Time::ZERO, slows, over)?];
        if let Some((goes_on, over)) = goes_on {
            if goes_on > rests {
                parts.push(Law::rest(goes_on - rests)?);
            }
            parts.push(law.eased_in(halt, over)?);
        }
        Law::then(parts)
    })?;
    let paused = Paused {
        slows_at_s: slows.seconds(),
        rests_at_s: rests.seconds(),
        goes_on_s: goes_on.map(|(at, over)| (at.seconds(), (at + over).seconds())),
    };
    Ok((program, paused))
}
