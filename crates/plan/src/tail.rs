//! The stop tail: what ends every queue, so that losing the host is a planned stop.

use crate::brake::Brake;
pub use crate::brake::Told;
use crate::ensemble::{Ensemble, Start};
use crate::error::{PlanError, Refused};
use crate::packed::Meter;
use crate::planner::Planner;
use crate::settings::Settings;
use crate::{Move, planner::Origin};
use pulsetrain_core::Direction;
use pulsetrain_core::packing::State;
use pulsetrain_motion::Time;
use pulsetrain_motion::law::{Class, Curve, Entry, Fixed, Law, Piece};
use pulsetrain_motion::program::{Program, SharedSteps, Wiring};
use std::collections::BTreeMap;

/// A motor in motion, at the tick where its tail begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Steps made so far, from the start of the law.
    pub position: i64,
    /// θ, steps from the start of the law.
    pub theta: f64,
    /// Speed of the law, steps/s.
    pub speed: f64,
    /// Largest acceleration that the law itself asked for so far, steps/s²: the tail's, if the motor's limit is not known.
    pub acceleration: f64,
    /// What the board has been told before; `None` where that is not known, which costs bytes.
    pub told: Option<Told>,
    /// The tail is to be one of fewer bytes, if there is one; it may take half as long again.
    pub brief: bool,
}

/// The moves that bring a motor to rest.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tail {
    /// The accumulator that they begin at, ticks · 2^F from the tick of the tail; no step comes before that tick.
    pub start: i64,
    /// In order.
    pub moves: Vec<Move>,
}

impl Tail {
    /// Moves that begin at the tick of the tail, with fraction ½.
    fn anew(moves: Vec<Move>, settings: &Settings) -> Tail {
        Tail { start: 1 << (settings.fraction_bits - 1), moves }
    }
}

/// Where nothing says how hard a motor may be braked, it may be as hard as to stop it in this time, s.
pub const SOFTEST_STOP_S: f64 = 1.0;

/// The moves that bring a motor to rest within its limits.
///
/// Up to the pull-in rate the motor stops at once. Faster, it is braked by no more than its largest acceleration; if the
/// file gives none, than the largest that the law had, or than what takes 1 s; the plan's own next step, with which a tail may begin,
/// may be beyond by a 2000th, as rounding has it. Within that the tail is short, not quick:
/// a few bytes, which take up to about twice the time; up to three times where it is to be [`brief`](Motion::brief).
///
/// # Errors
/// If a motor is so fast that the board cannot make its steps, which the plan before the tail would have met first.
pub fn stop_tail(motion: &Motion, settings: &Settings) -> Result<Tail, PlanError> {
    let quick = soonest_tail(&Motion { brief: false, ..*motion }, settings)?;
    if !motion.brief {
        return Ok(quick);
    }
    let bytes = |tail: &Tail| {
        let mut meter = Meter::after(settings, motion.told.map_or(State::default(), |told| told.state));
        tail.moves.iter().for_each(|next| meter.add(next));
        meter.bytes()
    };
    // Parts that nothing leads to may end where no part will do. Tails that do not begin alike are not told alike.
    let brief =
        soonest_tail(motion, settings).ok().filter(|brief| brief.start == quick.start && bytes(brief) < bytes(&quick));
    Ok(brief.unwrap_or(quick))
}

/// The first that comes out of it: going on, a few segments, a plan.
fn soonest_tail(motion: &Motion, settings: &Settings) -> Result<Tail, PlanError> {
    let Some(braking) = Braking::of(motion, settings) else { return Ok(Tail::default()) };
    if let Some(tail) = braking.onward(motion, settings) {
        return Ok(tail);
    }
    if let Some(moves) = braking.in_few_segments(motion, settings) {
        return Ok(Tail::anew(moves, settings));
    }
    let law = braking.law(motion);
    let origin = Origin { position: motion.position, theta: 0.0, speed: motion.speed };
    let mut planner = Planner::from(origin, &law, settings)?;
    let mut moves = Vec::new();
    while let Some(next) = planner.next_move()? {
        moves.push(next);
    }
    Ok(Tail::anew(moves, settings))
}

/// The tails of all motors of a program, in order on shared DIR lines; they begin at one tick.
///
/// For each motor its motion there, and its last step before: tick, relative to that of the tail, and direction.
///
/// # Errors
/// As for [`stop_tail`], and where motors that share a DIR line turn too close together.
pub fn stop_tails(program: &Program, motors: &[(Motion, Option<(i64, Direction)>)]) -> Result<Vec<Tail>, Refused> {
    let settings: Vec<Settings> = program.motors.iter().map(|motor| Settings::of(program, motor)).collect();
    // As they come, if that brings no steps together.
    let together: Result<Vec<Tail>, PlanError> =
        motors.iter().zip(&settings).map(|((motion, _), settings)| stop_tail(motion, settings)).collect();
    if let Ok(mut tails) = together {
        let close = match program.board.shared_steps {
            Some(needs) => begin_later(program, motors, &mut tails, &settings, needs),
            None => close_steps(program, motors, &tails, &settings),
        };
        if close == 0 {
            return Ok(tails);
        }
        // A few steps that are put off take fewer bytes than tails that are planned together.
        if program.board.shared_steps.is_some()
            && close < usize::MAX
            && let Ok(tails) = put_off(program, motors, &tails)
        {
            return Ok(tails);
        }
    }
    let mut tails = vec![None; motors.len()];
    // Where the board makes the steps of all motors one after the other each is in the others' way.
    let is_free = |motor| program.board.shared_steps.is_none() && is_in_no_ones_way(program, motors, motor);
    for (motor, tail) in tails.iter_mut().enumerate().filter(|(motor, _)| is_free(*motor)) {
        *tail = Some(stop_tail(&motors[motor].0, &settings[motor]).map_err(|error| Refused { motor, error })?);
    }
    if let Some(tails) = tails.iter().cloned().collect() {
        return Ok(tails);
    }
    let at_rest = Law::rest(Time::SECOND).map_err(|error| Refused { motor: 0, error: error.into() })?;
    let mut laws = Vec::with_capacity(motors.len());
    for (((motion, last_step), settings), tail) in motors.iter().zip(&settings).zip(&tails) {
        let braking = Braking::of(motion, settings).filter(|_| tail.is_none());
        let moves = braking.as_ref().map_or(Some(Vec::new()), |braking| braking.in_few_segments(motion, settings));
        let law = braking.filter(|_| moves.is_none()).map(|braking| braking.law(motion));
        let (position, speed) = if law.is_some() { (motion.position, motion.speed) } else { (0, 0.0) };
        let start = Start { origin: Origin { position, theta: 0.0, speed }, last_step: *last_step };
        laws.push((law, start, moves.unwrap_or_default()));
    }
    let plans = laws.iter().map(|(law, start, _)| (law.as_ref().unwrap_or(&at_rest), Some(start)));
    let mut ensemble = Ensemble::assemble(program, plans)?;
    for (motor, (_, _, moves)) in laws.iter().enumerate() {
        ensemble.go_first(motor, &Tail::anew(moves.clone(), &settings[motor]));
    }
    let mut moves = |motor| -> Result<Vec<Move>, Refused> {
        std::iter::from_fn(|| ensemble.next_move(motor).transpose()).collect()
    };
    let tails = tails.into_iter().zip(&settings).enumerate().map(|(motor, (tail, settings))| match tail {
        Some(tail) => Ok(tail),
        None => Ok(Tail::anew(moves(motor)?, settings)),
    });
    tails.collect()
}

/// Begins tails by so little later that fewest of their steps meet; how many still do.
fn begin_later(
    program: &Program,
    motors: &[(Motion, Option<(i64, Direction)>)],
    tails: &mut [Tail],
    settings: &[Settings],
    needs: SharedSteps,
) -> usize {
    let mut close = 0;
    for motor in 0..tails.len() {
        let start = tails[motor].start;
        let later = |places: u32| start + (i64::from(places * needs.apart_ticks) << settings[motor].fraction_bits);
        let mut best = (usize::MAX, 0);
        // Each motor before is in the way of two places at most.
        for places in 0..=2 * motor as u32 {
            tails[motor].start = later(places);
            let close = close_steps(program, &motors[..=motor], &tails[..=motor], settings);
            best = best.min((close, places));
            if close == 0 {
                break;
            }
        }
        tails[motor].start = later(best.1);
        close = best.0;
    }
    close
}

/// The same tails, with steps put off where they would come too close to those of others.
fn put_off(
    program: &Program,
    motors: &[(Motion, Option<(i64, Direction)>)],
    tails: &[Tail],
) -> Result<Vec<Tail>, Refused> {
    let at_rest = Law::rest(Time::SECOND).map_err(|error| Refused { motor: 0, error: error.into() })?;
    let origin = Origin { position: 0, theta: 0.0, speed: 0.0 };
    let starts: Vec<Start> = motors.iter().map(|(_, last_step)| Start { origin, last_step: *last_step }).collect();
    let mut ensemble = Ensemble::assemble(program, starts.iter().map(|start| (&at_rest, Some(start))))?;
    tails.iter().enumerate().for_each(|(motor, tail)| ensemble.go_first(motor, tail));
    let put_off = tails.iter().enumerate().map(|(motor, tail)| {
        let moves: Result<Vec<Move>, Refused> = std::iter::from_fn(|| ensemble.next_move(motor).transpose()).collect();
        Ok(Tail { start: tail.start, moves: moves? })
    });
    put_off.collect()
}

/// How many steps come too close to the one before: opposite ones on each DIR line, and where the board needs it those of all motors. Of so
/// many steps that it would take long to say: `usize::MAX`.
fn close_steps(
    program: &Program,
    motors: &[(Motion, Option<(i64, Direction)>)],
    tails: &[Tail],
    settings: &[Settings],
) -> usize {
    const MOST_STEPS: u64 = 20_000;
    let mut lines: BTreeMap<Option<u8>, Vec<(i128, bool)>> = BTreeMap::new();
    let mut steps_left = MOST_STEPS;
    for (motor, tail) in tails.iter().enumerate() {
        let (dir, forward_high) = match program.motors[motor].wiring {
            Wiring::StepDir { dir, forward_high, .. } => (Some(dir), forward_high),
            Wiring::Coils { .. } => (None, true),
        };
        let level = |direction: Direction| (direction == Direction::Forward) == forward_high;
        let line = lines.entry(dir).or_default();
        line.extend(motors[motor].1.map(|(tick, direction)| (i128::from(tick), level(direction))));
        let mut accumulator = i128::from(tail.start);
        for next in &tail.moves {
            match *next {
                Move::Dwell { ticks } => accumulator += i128::from(ticks) << settings[motor].fraction_bits,
                Move::Run { segment, direction } => {
                    let Some(left) = steps_left.checked_sub(segment.count.into()) else { return usize::MAX };
                    steps_left = left;
                    let tick = |k: u32| (accumulator + segment.span(k)) >> settings[motor].fraction_bits;
                    line.extend((1..=segment.count).map(|k| (tick(k), level(direction))));
                    accumulator += segment.span(segment.count);
                }
            }
        }
    }
    let apart = settings.iter().map(|settings| i128::from(settings.reversal_ticks)).max().unwrap_or(0) + 1;
    let mut close = 0;
    for steps in lines.iter_mut().filter_map(|(dir, steps)| dir.map(|_| steps)) {
        steps.sort_unstable();
        close += steps.windows(2).filter(|pair| pair[0].1 != pair[1].1 && pair[1].0 - pair[0].0 < apart).count();
    }
    close + program.board.shared_steps.map_or(0, |needs| close_steps_of_all(lines, needs, apart))
}

/// How many steps of all lines neither go together with the one before nor come as far behind it as the board needs; where a line turns,
/// `turn` ticks more.
fn close_steps_of_all(lines: BTreeMap<Option<u8>, Vec<(i128, bool)>>, needs: SharedSteps, turn: i128) -> usize {
    let steps =
        lines.into_iter().flat_map(|(dir, steps)| steps.into_iter().map(move |(tick, level)| (tick, dir, level)));
    let mut steps: Vec<_> = steps.collect();
    steps.sort_unstable();
    let (together, apart) = (i128::from(needs.together_ticks), i128::from(needs.apart_ticks));
    let mut levels = BTreeMap::new();
    let mut made: Option<i128> = None;
    let is_close = |(tick, dir, level): (i128, Option<u8>, bool)| {
        let turns = dir.is_some_and(|dir| levels.insert(dir, level).is_some_and(|before| before != level));
        let since = made.map_or(i128::MAX, |made| tick - made);
        let goes_along = !turns && since <= together;
        if !goes_along {
            made = Some(tick);
        }
        !goes_along && since < apart + if turns { turn } else { 0 }
    };
    steps.into_iter().map(is_close).filter(|close| *close).count()
}

/// Whether the tail of a motor needs no regard for opposite steps on its DIR line: its own last step, and what other
/// motors did and do there, has the line as this tail has it.
fn is_in_no_ones_way(program: &Program, motors: &[(Motion, Option<(i64, Direction)>)], motor: usize) -> bool {
    let line = |motor: usize| match program.motors[motor].wiring {
        Wiring::StepDir { dir, forward_high, .. } => Some((dir, forward_high)),
        Wiring::Coils { .. } => None,
    };
    let (own, forward_high) = line(motor).unzip();
    let levels = |other: usize| {
        let (motion, last) = &motors[other];
        let brakes = (motion.speed != 0.0).then_some(motion.speed > 0.0);
        let made = last.map(|(_, direction)| direction == Direction::Forward);
        let same = line(other).map(|(_, high)| high) == forward_high;
        [brakes, made].map(|way| way.map(|forward| forward == same))
    };
    let shares = |other: &usize| *other == motor || (own.is_some() && line(*other).map(|(dir, _)| dir) == own);
    let mut all = (0..motors.len()).filter(shares).flat_map(levels).flatten();
    let first = all.next();
    all.all(|level| Some(level) == first)
}

/// How a motor above its pull-in rate is to be braked.
#[derive(Clone, Copy, Debug)]
struct Braking {
    /// Where θ is when it begins.
    theta: f64,
    /// Steps/s².
    deceleration: f64,
}

impl Braking {
    /// `None` if the motor may stop at once.
    fn of(motion: &Motion, settings: &Settings) -> Option<Braking> {
        let speed = motion.speed;
        if speed.abs() <= settings.limits.pull_in || speed == 0.0 {
            return None;
        }
        let own = motion.acceleration.max(speed.abs() / SOFTEST_STOP_S);
        let deceleration = settings.limits.max_acceleration.unwrap_or(own);
        // Where a pair of steps was dropped, θ lies outside the band of the motor's position: brake from its edge.
        let (low, high) = (settings.grid.down_level(motion.position), settings.grid.up_level(motion.position));
        Some(Braking { theta: motion.theta.clamp(low, high), deceleration })
    }

    /// The moves to rest that go on from what the board was told.
    fn onward(&self, motion: &Motion, settings: &Settings) -> Option<Tail> {
        let told = motion.told?;
        let moves = match self.brake(motion, settings) {
            Some(brake) => brake.onward(&told, settings)?,
            None => Vec::new(),
        };
        Some(Tail { start: told.accumulator, moves })
    }

    /// The moves to rest; `None` if only the plan of the [law](Braking::law) will do, which takes more segments.
    fn in_few_segments(&self, motion: &Motion, settings: &Settings) -> Option<Vec<Move>> {
        self.brake(motion, settings).map_or(Some(Vec::new()), |brake| brake.moves(settings))
    }

    /// `None` if the motor is at rest before its next step.
    fn brake(&self, motion: &Motion, settings: &Settings) -> Option<Brake> {
        let hz = settings.tick_hz as f64;
        let (speed, limit) = (motion.speed.abs() / hz, self.deceleration / (hz * hz));
        let forward = motion.speed > 0.0;
        let level =
            if forward { settings.grid.up_level(motion.position) } else { settings.grid.down_level(motion.position) };
        let way = (level - self.theta).abs();
        let square = speed * speed - 2.0 * limit * way;
        if square <= 0.0 {
            return None;
        }
        Some(Brake {
            unbraked: (way / speed, speed),
            first: 2.0 * way / (speed + square.sqrt()),
            speed: square.sqrt(),
            limit,
            pull_in: settings.limits.pull_in / hz,
            brief: motion.brief,
            direction: if forward { Direction::Forward } else { Direction::Backward },
        })
    }

    /// θ from the tail's first instant to rest.
    fn law(&self, motion: &Motion) -> Law {
        let (speed, deceleration) = (motion.speed, self.deceleration);
        let piece = Piece {
            zero: Time::ZERO,
            start: Time::ZERO,
            end: Time::from_seconds(speed.abs() / deceleration),
            origin: 0,
            curve: Curve::Polynomial(vec![self.theta, speed, -0.5 * deceleration * speed.signum()]),
            entry: Entry::SpeedJump,
        };
        Law::Fixed(Fixed { pieces: vec![piece].into(), class: Class::ClosedForm })
    }
}
