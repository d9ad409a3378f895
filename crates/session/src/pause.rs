//! Pause, resume and tempo: how the rate of the laws' time is changed within the motors' limits.
//!
//! All motors share one time, so that their paths and phases do not change. The motor with the least reserve decides how long a change takes.
//! Where a law itself brakes as hard as its motor may, the change begins later.

use pulsetrain_motion::law::{Begin, Cursor, Ease};
use pulsetrain_motion::machine::{Kinematics, Machine};
use pulsetrain_motion::program::{Motor, Program};
use pulsetrain_motion::time::Rate;
use pulsetrain_motion::{Law, LawError, Time, whole_power};
use pulsetrain_plan::{PlanError, SOFTEST_STOP_S, Settings};
use schemars::JsonSchema;
use serde::Serialize;

/// Why motors cannot be paused or resumed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PauseError {
    /// A law cannot be evaluated where it has to be.
    #[error("motor {motor}: {error}")]
    Law {
        /// Index of the motor in the program.
        motor: usize,
        /// Why it cannot be evaluated.
        error: LawError,
    },
    /// The laws need all that the motors can do, for too long.
    #[error(
        "no {what} within {within_s} s keeps all motors to their limits: the motion itself takes all that they can do"
    )]
    NoRoom {
        /// "pause", "resumption", "change of tempo" or "change".
        what: &'static str,
        /// How far ahead a place was searched, s.
        within_s: f64,
    },
    /// No fade keeps to the limits between two laws whose distance grows all the time.
    #[error(
        "the distance between the old law and the new one keeps growing, and no change within {within_s} s keeps all motors to their limits. A number \
         that is multiplied by the time, such as `a` in a*t, changes the whole way since the beginning: write `law.speed`, which goes on from where the \
         motor is"
    )]
    Parting {
        /// The longest fade that was tried, s.
        within_s: f64,
    },
}

/// How far ahead a place for the halt is searched, s: at first, and if there is none. The first one is short since it is sampled finer.
const LOOK_S: [f64; 2] = [2.0, 30.0];
/// Samples of each law in that time: every 0.5 ms at first.
const SAMPLES: usize = 4096;
/// The shortest easing that is tried, s: a shorter one would be hardly noticed.
const SHORTEST_S: f64 = 0.01;
/// Each further easing is longer by this factor: at most a tenth longer than needed.
const LONGER: f64 = 1.1;
/// Parts of an easing, at whose ends the limits are checked.
const PLACES: usize = 48;
/// The fraction of a limit that may be used at a sample, so that the motion between two samples keeps to the limit too.
pub(crate) const USABLE: f64 = 0.97;
/// A motor without a limit may brake up to this many times as hard as its law accelerates.
const UNLIMITED: f64 = 2.0;

/// A motor's law, sampled over some time ahead.
struct Samples {
    /// Speed, steps/s, and acceleration, steps/s², at each sample.
    at: Vec<(f64, f64)>,
    /// The most that the motor may accelerate, steps/s².
    limit: f64,
}

impl Samples {
    fn of(motor: &Motor, from: Time, look: Time) -> Result<Samples, LawError> {
        let mut cursor = Cursor::new(&motor.law);
        let mut at = Vec::with_capacity(SAMPLES + 1);
        for k in 0..=SAMPLES as u64 {
            let sample = cursor.at(from + look.times(k).divided_by(SAMPLES as u64))?;
            at.push((sample.speed, sample.acceleration));
        }
        let limit = motor.limits.max_acceleration.unwrap_or_else(|| {
            let own = at.iter().map(|(speed, acceleration)| acceleration.abs().max(speed.abs() / SOFTEST_STOP_S));
            UNLIMITED * own.fold(0.0, f64::max)
        });
        Ok(Samples { at, limit })
    }

    /// Whether the motor keeps to its limit at `part` (0 to 1) of the sampled time, while the laws' time runs at `rate` times its speed, which
    /// changes by `change` a second. The acceleration of the law itself at the rate `known` is always allowed: it was planned.
    fn allows(&self, part: f64, rate: f64, change: f64, usable: f64, known: f64) -> bool {
        let place = (part * SAMPLES as f64).round() as usize;
        let Some((speed, acceleration)) = self.at.get(place).copied() else { return false };
        let needed = (acceleration * rate * rate + speed * change).abs();
        needed <= self.limit * usable || needed <= acceleration.abs() * known * known || speed == 0.0
    }
}

fn sampled(program: &Program, from: Time, look_s: f64) -> Result<Vec<Samples>, PauseError> {
    let look = Time::from_seconds(look_s);
    let motors = program.motors.iter().enumerate();
    motors.map(|(motor, m)| Samples::of(m, from, look).map_err(|error| PauseError::Law { motor, error })).collect()
}

/// Durations of an easing that are tried, s, the shortest first.
fn durations(longest_s: f64) -> impl Iterator<Item = f64> {
    std::iter::successors(Some(SHORTEST_S), |s| Some(s * LONGER)).take_while(move |s| *s <= longest_s)
}

/// The quickest change of the rate of the laws' time, for motors that are at `from` of their laws. `caution` is the fraction of each limit that may
/// be used, up to 1; `known` is a rate at which the laws were planned before.
///
/// # Errors
/// When a law cannot be evaluated, or leaves no room.
pub fn quickest(
    program: &Program,
    from: Time,
    (before, to): (Rate, Rate),
    caution: f64,
    known: Rate,
) -> Result<Ease, PauseError> {
    let (r0, change) = (before.get(), to.get() - before.get());
    for look_s in LOOK_S {
        let motors = sampled(program, from, look_s)?;
        let fits = |after_s: f64, over_s: f64| {
            (0..=PLACES).all(|k| {
                let x = k as f64 / PLACES as f64;
                let time_s = r0 * (after_s + over_s * x) + change * over_s * (x * x * x - 0.5 * x * x * x * x);
                let rate = r0 + change * x * x * (3.0 - 2.0 * x);
                let slope = change * 6.0 * x * (1.0 - x) / over_s;
                motors.iter().all(|motor| motor.allows(time_s / look_s, rate, slope, USABLE * caution, known.get()))
            })
        };
        // Motors at rest gain nothing by waiting. Out of a halt the laws' time advances by half: a sampled time serves an easing twice as long.
        let (waits, most_s) = if before == Rate::ZERO { (1, 2.0 * look_s) } else { (64, look_s) };
        let mut best: Option<(f64, f64)> = None;
        for after_s in (0..waits).map(|k| look_s * f64::from(k) / 128.0) {
            let left_s = best.map_or(most_s, |(after_s, over_s)| after_s + over_s) - after_s;
            let found = durations(left_s.min(most_s - after_s)).find(|over_s| fits(after_s, *over_s));
            best = found.map(|over_s| (after_s, over_s)).or(best);
        }
        if let Some((after_s, over_s)) = best {
            return Ok(Ease { before, after: Time::from_seconds(after_s), over: Time::from_seconds(over_s), to });
        }
    }
    let (what, within_s) = match (before, to) {
        (_, Rate::ZERO) => ("pause", LOOK_S[1]),
        (Rate::ZERO, _) => ("resumption", 2.0 * LOOK_S[1]),
        _ => ("change of tempo", LOOK_S[1]),
    };
    Err(PauseError::NoRoom { what, within_s })
}

/// A limit that a higher tempo would break.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ceiling {
    /// What has that limit.
    pub of: Limited,
    /// Which limit, in the file's words where it has one: "max_speed", "max_acceleration", "the board's shortest interval", "the line to the board".
    pub limit: &'static str,
}

/// A part of a program that has limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limited {
    /// A motor, by its index in the program.
    Motor(usize),
    /// A machine's tip; the machine by its index in the program.
    Tip(usize),
}

impl Ceiling {
    pub(crate) const fn of_motor(motor: usize, limit: &'static str) -> Ceiling {
        Ceiling { of: Limited::Motor(motor), limit }
    }
}

/// The limit of a motor whose law has no value somewhere.
pub(crate) const NO_LAW: &str = "its law is not defined at every time";
/// The limit of the board's steps/s.
const SHORTEST_INTERVAL: &str = "the board's shortest interval";

/// The limit that a plan would break.
pub(crate) const fn limit_of(error: &PlanError) -> &'static str {
    match error {
        PlanError::TooFast { .. } => "max_speed",
        PlanError::TooMuchAcceleration { .. } | PlanError::BrakesTooHard { .. } => "max_acceleration",
        PlanError::SpeedJump { .. } => "pull_in",
        PlanError::TooFastForBoard { .. } => SHORTEST_INTERVAL,
        PlanError::TooManySegments { .. } => "the board's processor",
        PlanError::LineTooBusy { .. } => "the shared DIR line",
        PlanError::QueueTooShort { .. } | PlanError::LineTooSlow { .. } => "the line to the board",
        PlanError::ToleranceTooTight { .. } | PlanError::NotProvable { .. } | PlanError::TooFine { .. } => "tolerance",
        PlanError::TooLong { .. } => "the longest time that the board counts",
        PlanError::Law(_) => NO_LAW,
    }
}

/// A program that is under way at `from` of its laws: it may begin at any speed. Or the motor whose law cannot do that.
pub(crate) fn underway(program: &Program, from: Time) -> Result<Program, (usize, LawError)> {
    let mut program = program.clone();
    for (motor, m) in program.motors.iter_mut().enumerate() {
        let law = m.law.clone().retimed(from, Ease::steady(Rate::ONE)).and_then(|law| law.beginning(Begin::Jump));
        m.law = law.map_err(|error| (motor, error))?;
    }
    Ok(program)
}

/// The highest rate of the laws' time, from `from` of the laws on, at which motors and tips keep to their limits, and the limit that a higher one would
/// break; [`Rate::MAX`] if none would. Never below `known`, a rate at which the laws were planned before.
///
/// Laws that repeat are sampled for a period, others to their end, but for half a minute at most.
///
/// # Errors
/// When a law cannot be evaluated.
pub fn highest_rate(program: &Program, from: Time, known: Rate) -> Result<(Rate, Option<Ceiling>), PauseError> {
    let all = vec![true; program.motors.len()];
    let of_motors = highest_factor(program, from, USABLE, &all)?;
    let of_tips = highest_tip_factor(program, from, USABLE, &all)?;
    let (highest, ceiling) = if of_tips.0 < of_motors.0 { of_tips } else { of_motors };
    Ok((Rate::of(highest).map_or(known, |rate| rate.max(known)), ceiling))
}

/// As [`highest_rate`], of some motors, with `usable` of each limit, and below 1 too.
pub(crate) fn highest_factor(
    program: &Program,
    from: Time,
    usable: f64,
    motors: &[bool],
) -> Result<(f64, Option<Ceiling>), PauseError> {
    let mut highest = (Rate::MAX.get(), None);
    for (index, motor) in program.motors.iter().enumerate().filter(|(index, _)| motors[*index]) {
        let mut samples = Vec::new();
        for (from, look) in looks(&motor.law, from) {
            let looked = Samples::of(motor, from, look).map_err(|error| PauseError::Law { motor: index, error })?;
            samples.extend(looked.at);
        }
        let peak = |of: fn(&(f64, f64)) -> f64| samples.iter().map(of).fold(0.0, |peak: f64, x| peak.max(x.abs()));
        let (speed, acceleration) = (peak(|sample| sample.0), peak(|sample| sample.1));
        let board = Settings::of(program, motor).highest_rate_hz();
        let limits = [
            ("max_speed", motor.limits.max_speed.map(|limit| usable * limit / speed)),
            ("max_acceleration", motor.limits.max_acceleration.map(|limit| (usable * limit / acceleration).sqrt())),
            (SHORTEST_INTERVAL, Some(usable * board / speed)),
        ];
        lower(&mut highest, Limited::Motor(index), limits);
    }
    Ok(highest)
}

/// Lowers the highest rate to what the limits of a part allow; `limits` has the highest rate that each allows.
fn lower(
    highest: &mut (f64, Option<Ceiling>),
    of: Limited,
    limits: impl IntoIterator<Item = (&'static str, Option<f64>)>,
) {
    for (limit, rate) in limits {
        // What is at rest has no ceiling: the quotient is infinite.
        if let Some(rate) = rate.filter(|rate| *rate < highest.0) {
            *highest = (rate, Some(Ceiling { of, limit }));
        }
    }
}

/// The parts of a law that are sampled, from `from` on: when they begin, and how long they are. Of a law that repeats it is what comes before the first
/// period, and a period.
fn looks(law: &Law, from: Time) -> impl Iterator<Item = (Time, Time)> {
    let most = Time::from_seconds(LOOK_S[1]);
    let looks = match (law.cycle(), law.end()) {
        (Some((start, period)), _) => [(from, (start - from).min(most)), (from.max(start), period)],
        (None, Some(end)) => [(from, (end - from).clamp(Time::ZERO, most)), (end, Time::ZERO)],
        (None, None) => [(from, most), (from, Time::ZERO)],
    };
    looks.into_iter().filter(|(_, look)| *look > Time::ZERO)
}

/// A time before the end of a law, s: its speed there is that at the end.
const BEFORE_END_S: f64 = 1e-6;

/// The motor, of those asked for, whose law ends within half a minute, and at a tempo too fast for the motor to stop at once.
///
/// # Errors
/// When a law cannot be evaluated.
pub(crate) fn sudden_end(
    program: &Program,
    from: Time,
    tempo: Rate,
    motors: &[bool],
) -> Result<Option<Ceiling>, PauseError> {
    let before = Time::from_seconds(BEFORE_END_S);
    for (index, motor) in program.motors.iter().enumerate().filter(|(index, _)| motors[*index]) {
        let is_near = |end: &Time| *end - before > from && *end - from <= Time::from_seconds(LOOK_S[1]);
        let Some(end) = motor.law.end().filter(is_near) else { continue };
        let last = Cursor::new(&motor.law).at(end - before);
        let last = last.map_err(|error| PauseError::Law { motor: index, error })?;
        let slowed = 2.0 * BEFORE_END_S * last.acceleration.abs();
        if (last.speed.abs() - slowed) * tempo.get() > motor.limits.pull_in * (1.0 + ROUNDING) + ROUNDING {
            return Ok(Some(Ceiling::of_motor(index, "pull_in")));
        }
    }
    Ok(None)
}

/// A speed at a law's end may be higher than allowed by this many steps/s, and by this share: rounding.
const ROUNDING: f64 = 1e-3;

/// As [`highest_factor`], for the tips of machines that have limits and at least one of these motors. A tip whose path is not known has no highest rate.
pub(crate) fn highest_tip_factor(
    program: &Program,
    from: Time,
    usable: f64,
    motors: &[bool],
) -> Result<(f64, Option<Ceiling>), PauseError> {
    let mut highest = (Rate::MAX.get(), None);
    for (index, machine) in program.machines.iter().enumerate().filter(|(_, machine)| has_limits(machine)) {
        let Some(axes) = axes(program, machine).filter(|_| machine.motors.iter().any(|motor| motors[*motor])) else {
            continue;
        };
        let of_machine = |error| PauseError::Law { motor: machine.motors[0], error };
        let [speed, acceleration] = tip_peaks(&axes, from).map_err(of_machine)?;
        let limits = [
            ("max_speed", machine.tip_limits[0].map(|limit| usable * limit / speed)),
            ("max_acceleration", machine.tip_limits[1].map(|limit| (usable * limit / acceleration).sqrt())),
        ];
        lower(&mut highest, Limited::Tip(index), limits);
    }
    Ok(highest)
}

/// Whether the path of a tip with limits is not known: its arms change separately from one path to another.
pub(crate) fn has_unknown_tip(program: &Program) -> bool {
    program.machines.iter().any(|machine| has_limits(machine) && axes(program, machine).is_none())
}

fn has_limits(machine: &Machine) -> bool {
    machine.tip_limits != [None; 2]
}

/// The laws of a tip's coordinates, and how many of the machine's units are in one of theirs; `None` if its path is not known.
fn axes(program: &Program, machine: &Machine) -> Option<Vec<(Law, f64)>> {
    match &machine.kinematics {
        Kinematics::Xy { steps_per_unit } => {
            let motors = machine.motors.iter().zip(steps_per_unit);
            Some(motors.map(|(motor, steps)| (program.motors[*motor].law.clone(), 1.0 / steps)).collect())
        }
        Kinematics::Delta { .. } => {
            let path = program.motors[*machine.motors.first()?].law.tip_path()?;
            Some(path.tip.into_iter().map(|law| (law, 1.0)).collect())
        }
    }
}

/// The highest speed and acceleration of a tip from `from` on: over a period if all of its coordinates repeat alike, or else as far as the one that needs
/// the longest look.
fn tip_peaks(axes: &[(Law, f64)], from: Time) -> Result<[f64; 2], LawError> {
    let mut places: Vec<(Time, Time)> = axes.iter().flat_map(|(law, _)| looks(law, from)).collect();
    let mut periods: Vec<Time> = axes.iter().filter_map(|(law, _)| law.cycle()).map(|(_, period)| period).collect();
    periods.dedup();
    if periods.len() > 1 {
        // Together they repeat later, if at all.
        places.push((from, Time::from_seconds(LOOK_S[1])));
    }
    places.sort_unstable();
    places.dedup();
    let mut cursors: Vec<(Cursor, f64)> = axes.iter().map(|(law, scale)| (Cursor::new(law), *scale)).collect();
    let mut squares = [0.0_f64; 2];
    for (from, look) in places {
        for k in 0..=SAMPLES as u64 {
            let at = from + look.times(k).divided_by(SAMPLES as u64);
            let mut sums = [0.0; 2];
            for (cursor, scale) in &mut cursors {
                let sample = cursor.at(at)?;
                sums[0] += whole_power(sample.speed * *scale, 2);
                sums[1] += whole_power(sample.acceleration * *scale, 2);
            }
            squares = [squares[0].max(sums[0]), squares[1].max(sums[1])];
        }
    }
    Ok(squares.map(f64::sqrt))
}

/// A time in ticks, rounded down, plus one.
pub(crate) fn ticks(time: Time, hz: u64) -> u64 {
    // Not negative, and an hour at most.
    time.ticks(hz).0.unsigned_abs() + 1
}

/// The program with other laws.
fn with_laws(program: &Program, change: impl Fn(Law) -> Result<Law, LawError>) -> Result<Program, PauseError> {
    let mut program = program.clone();
    for (motor, m) in program.motors.iter_mut().enumerate() {
        m.law = change(m.law.clone()).map_err(|error| PauseError::Law { motor, error })?;
    }
    Ok(program)
}

/// The program from `from` of its laws on, with another rate of their time.
///
/// # Errors
/// When a law cannot be retimed so.
pub fn retimed(program: &Program, from: Time, ease: Ease) -> Result<Program, PauseError> {
    with_laws(program, |law| law.retimed(from, ease))
}

/// When the motors slow down, rest and go on in a pause that is part of a program.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Paused {
    /// When they begin to slow down, s.
    pub slows_at_s: f64,
    /// When they rest, s.
    pub rests_at_s: f64,
    /// When they begin to move again, and when they have their full speed, s; `None` if they do not go on.
    pub goes_on_s: Option<(f64, f64)>,
}

/// A program that pauses by itself: from `at` on its time is slowed to a halt; from `until` on, or from the halt if that is
/// later, it runs again.
///
/// # Errors
/// When a law cannot be evaluated, or leaves no room.
pub fn paused(program: &Program, at: Time, until: Option<Time>) -> Result<(Program, Paused), PauseError> {
    let Ease { after, over, .. } = quickest(program, at, (Rate::ONE, Rate::ZERO), 1.0, Rate::ONE)?;
    let (slows, halt) = (at + after, at + after + over.divided_by(2));
    let rests = slows + over;
    let goes_on = match until {
        Some(until) => Some((until.max(rests), quickest(program, halt, (Rate::ZERO, Rate::ONE), 1.0, Rate::ONE)?.over)),
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
