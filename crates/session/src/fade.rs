//! A change from the laws that the motors follow to others: a fade, within the limits of all motors.
//!
//! A delta robot's path fades as a path: its effector is on the blend of both paths, and the arms follow. Where it would leave what the arms
//! reach, or their `angles`, each arm fades separately.
//!
//! The program's time goes on, so that motors keep their common zero. A law that differs from the old one in frequency alone, or also in size, goes
//! on at the same phase: during the change the old law's time speeds up or slows down to the new frequency, and the new law's time from the old one.
//! Likewise an endless constant speed goes on from where the motor is: during the change the speed itself goes to the new one, without passing it.

use crate::pause::{Ceiling, PauseError, USABLE, highest_factor, highest_tip_factor, sudden_end, ticks};
use crate::plans::TRIED_MOVES;
use crate::{Session, SessionError, Tempo};
use pulsetrain_board::Leased;
use pulsetrain_motion::law::{ArmPath, Cursor, Ease, Joint, PathPair, Sample, Steady, fade_weight};
use pulsetrain_motion::machine::{Kinematics, Machine};
use pulsetrain_motion::program::{Motor, Program};
use pulsetrain_motion::time::Rate;
use pulsetrain_motion::{Law, LawError, Time, whole_power};
use pulsetrain_plan::{SOFTEST_STOP_S, Settings};
use std::sync::Arc;

/// Other laws for motors that move.
#[derive(Clone, Debug)]
pub struct Change {
    /// The motors with their new laws. Board, motors and wiring are those of the first program. A motor whose law is the same as before goes on as it is.
    pub program: Arc<Program>,
    /// How long the change takes, at least; `None`: as short as the limits allow.
    pub over: Option<Time>,
    /// Where the new laws begin.
    pub begins: Begins,
}

/// Where new laws begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begins {
    /// At the begin of the motion: their time is that of the laws before.
    WithTheMotion,
    /// At the change.
    Now,
}

/// How an endless constant speed goes on in a later session: [`Session::shifts`].
#[derive(Clone, Debug, PartialEq)]
pub struct Shift {
    /// The law that the motor followed; `None`: it was to join the law that it follows next.
    pub law: Option<Law>,
    /// What earlier speeds have added to the way of that law, steps.
    pub steps: f64,
}

/// When a change happens, ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transition {
    /// When the motors leave the old laws.
    pub from: u64,
    /// When they follow the new ones.
    pub until: u64,
}

/// The shortest fade, s: a shorter one would be hardly noticed.
const SHORTEST_S: f64 = 0.02;
/// The longest fade that is tried if a shorter one breaks a limit, s.
const LONGEST_S: f64 = 600.0;
/// That time is divided into so many parts. Two laws part if their distance is more than a step greater at the end of each part than at its beginning.
const PARTING_PLACES: u32 = 12;
/// Each further fade that is tried is longer by this factor.
const LONGER: f64 = 1.15;
/// Places of a fade at which the limits are checked: one for each [`PLACE_S`], within these bounds.
const PLACES: std::ops::RangeInclusive<u32> = 48..=1000;
/// See [`PLACES`].
const PLACE_S: f64 = 0.004;
/// The fraction of a limit that is usable where the laws themselves take more than [`USABLE`] of it.
const NEARLY_ALL: f64 = 0.999;
/// How much of a fade is planned before it is sent: it must not take longer than the board's queues last.
const PROVEN: Time = Time::SECOND;
/// The fraction of a limit that a fade may use that begins with a resumption.
const PAUSED: f64 = 0.5;
/// An arm may be this far beyond its `angles`: rounding, rad.
const ROUNDING_RAD: f64 = 1e-9;
/// How many times as fast as its paths a tip may be in a change, in speed and acceleration, if they take nearly all of its limits.
const TIP_EXCESS: f64 = 1.25;
/// How many times as fast as its laws a motor without a limit may be, in speed and acceleration.
const UNLIMITED: f64 = 2.0;

/// The laws that the motors follow, in the program's time, with the fades that are under way.
#[derive(Clone, Debug)]
pub(crate) struct Mix {
    /// The laws before the oldest fade.
    base: Vec<Law>,
    /// Those under way, oldest first: two at most. A third one waits until one of them is over.
    fades: Vec<Fade>,
    /// What each motor follows after the last fade.
    voices: Vec<Voice>,
}

/// A motor's law, and where its own time is.
#[derive(Clone, Debug)]
struct Voice {
    law: Law,
    /// From the first time of the program on, its own time goes on from the second one. `None`: both are the same.
    own: Option<(Time, Time)>,
    /// What earlier speeds have added to the way of its constant speed, steps.
    shift: f64,
    stance: Stance,
    /// The law that an earlier session followed, while the motor rests until it joins one. [`Voice::shift`] is that law's.
    left: Option<Law>,
}

/// How a motor came to its law.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stance {
    /// By the program's time.
    Following,
    /// It was sent there: the law began at a change. A constant speed after it begins from there.
    Sent,
    /// It rests until it joins a law that has gone on without it.
    Joining,
}

/// A fade of the motors whose laws change.
#[derive(Clone, Debug)]
struct Fade {
    from: Time,
    over: Time,
    /// By motor; `None` if it goes on as it is.
    turns: Vec<Option<Turn>>,
    /// By motor: whether it fades separately, even if it is an arm of a robot.
    apart: Vec<bool>,
}

/// A motor's part of a fade.
#[derive(Clone, Debug)]
struct Turn {
    /// The rate to which the old law's time is brought, if that changes.
    old_rate: Option<Rate>,
    /// By how much a constant speed changes, steps/s.
    faster: Option<f64>,
    /// The new law in the program's time during the fade, and after it.
    new: Law,
    settled: Law,
}

/// What a motor or a tip does at a place of a fade: speed and acceleration.
#[derive(Clone, Copy, Debug)]
struct FadeSample {
    needed: [f64; 2],
    /// The same of the old law alone, and of the new one.
    old: [f64; 2],
    new: [f64; 2],
}

impl Voice {
    /// Its own time at a time of the program.
    fn own_time(&self, at: Time) -> Time {
        self.own.map_or(at, |(since, own)| own + (at - since))
    }

    /// Its law in the program's time.
    fn in_program_time(&self) -> Result<Law, LawError> {
        let law = match self.own {
            None => self.law.clone(),
            Some((since, own)) => self.law.clone().retimed(own, Ease::steady(Rate::ONE))?.delayed(since)?,
        };
        if self.shift == 0.0 { Ok(law) } else { law.shifted(self.shift) }
    }

    /// It follows a law in the program's time.
    fn following(law: Law) -> Voice {
        Voice { law, own: None, shift: 0.0, stance: Stance::Following, left: None }
    }
}

impl Fade {
    fn until(&self) -> Time {
        self.from + self.over
    }

    /// Whether it takes a motor through other times of its old law than those of the program.
    fn retimes_old_laws(&self) -> bool {
        self.turns.iter().flatten().any(|turn| turn.old_rate.is_some())
    }

    /// A motor's law with this fade in it.
    fn of(&self, motor: usize, old: &Law) -> Result<Law, LawError> {
        let Some(turn) = &self.turns[motor] else { return Ok(old.clone()) };
        let old = self.old_law(turn, old)?;
        let faded = if self.apart[motor] { Law::faded_apart } else { Law::faded };
        faded(old, turn.new.clone(), self.from, self.over)
    }

    /// What reads a motor's laws; `None` if the motor's law does not change. `kept` read them for the last duration that was tried; it is used again if
    /// the laws do not depend on the duration.
    fn reader(&self, motor: usize, old: &Law, kept: Option<Reader>) -> Result<Option<Reader>, PauseError> {
        let Some(turn) = &self.turns[motor] else { return Ok(None) };
        let is_same = turn.old_rate.is_none() && turn.faster.is_none();
        let mut reader = match kept.filter(|_| is_same) {
            Some(reader) => reader,
            None => {
                let old = self.old_law(turn, old).map_err(|error| PauseError::Law { motor, error })?;
                Reader::of(&old, &turn.new)
            }
        };
        let is_blended = |(pair, _): &mut (PathPair, PathBlend)| pair.are_followed(self.from, self.over);
        reader.blends = !self.apart[motor] && reader.path.as_mut().is_some_and(is_blended);
        Ok(Some(reader))
    }

    /// The old law during the fade.
    fn old_law(&self, turn: &Turn, old: &Law) -> Result<Law, LawError> {
        if let Some(faster) = turn.faster {
            return Law::sum(vec![old.clone(), faster_by(faster, self.from, self.over)?]);
        }
        match turn.old_rate {
            None => Ok(old.clone()),
            Some(to) => {
                let ease = Ease { before: Rate::ONE, after: Time::ZERO, over: self.over, to };
                old.clone().retimed(self.from, ease)?.delayed(self.from)
            }
        }
    }
}

impl Mix {
    /// The laws of a program from its beginning.
    pub(crate) fn of(program: &Program) -> Mix {
        let laws = program.motors.iter().map(|motor| motor.law.clone());
        Mix { base: laws.clone().collect(), fades: Vec::new(), voices: laws.map(Voice::following).collect() }
    }

    /// Forgets the fades that are over at `now`, and what they have replaced. Returns whether there were any.
    pub(crate) fn settle(&mut self, now: Time) -> bool {
        let before = self.fades.len();
        // The newest first: once it is over, its motors follow none of the earlier ones.
        for index in (0..before).rev() {
            let fade = &self.fades[index];
            // A later fade may still take a motor through earlier times of its old law.
            let is_needed = fade.until() > now || self.fades[index + 1..].iter().any(Fade::retimes_old_laws);
            if is_needed && fade.turns.iter().any(Option::is_some) {
                continue;
            }
            for (motor, turn) in self.fades.remove(index).turns.into_iter().enumerate() {
                if let Some(turn) = turn {
                    self.base[motor] = turn.settled;
                    self.fades[..index].iter_mut().for_each(|earlier| earlier.turns[motor] = None);
                }
            }
        }
        self.fades.len() < before
    }

    /// When the changes that are under way at `now` are over.
    pub(crate) fn changes_until(&self, now: Time) -> Option<Time> {
        self.fades.iter().map(Fade::until).max().filter(|until| *until > now)
    }

    /// When all motors have come to the ends of the laws that they follow; `None` if one of them has none.
    pub(crate) fn ends_at(&self) -> Option<Time> {
        let mut ends = self.voices.iter().map(|voice| voice.in_program_time().ok()?.end());
        ends.try_fold(Time::ZERO, |latest, end| Some(latest.max(end?)))
    }

    /// When there is room for another fade, after [`settle`](Mix::settle); `None`: now.
    fn full_until(&self) -> Option<Time> {
        let [first, .., last] = &self.fades[..] else { return None };
        Some(if last.retimes_old_laws() { last.until() } else { first.until().min(last.until()) })
    }

    /// Motors that rest where they are, with the laws that they followed before.
    fn at_rest(&self, positions: &[f64]) -> Result<Mix, PauseError> {
        Ok(Mix { voices: self.voices.clone(), ..Mix::resting(positions)? })
    }

    /// Motors that rest where they are, and follow no other law. With `shifts` a constant speed that they join goes on from the ways in it; else it begins
    /// where the motors rest.
    pub(crate) fn joining(positions: &[f64], shifts: Option<&[Shift]>) -> Result<Mix, PauseError> {
        let mut mix = Mix::resting(positions)?;
        for (motor, voice) in mix.voices.iter_mut().enumerate() {
            let Some(shifts) = shifts else { continue };
            voice.stance = Stance::Joining;
            if let Some(shift) = shifts.get(motor) {
                (voice.shift, voice.left) = (shift.steps, shift.law.clone());
            }
        }
        Ok(mix)
    }

    fn resting(positions: &[f64]) -> Result<Mix, PauseError> {
        let rest = |(motor, theta): (usize, &f64)| {
            let law = Law::speed(0.0, None).and_then(|rest| rest.shifted(*theta));
            law.map_err(|error| PauseError::Law { motor, error })
        };
        let base: Vec<Law> = positions.iter().enumerate().map(rest).collect::<Result<_, _>>()?;
        let sent = |law: &Law| Voice { stance: Stance::Sent, ..Voice::following(law.clone()) };
        let voices = base.iter().map(sent).collect();
        Ok(Mix { base, fades: Vec::new(), voices })
    }

    /// What earlier speeds have added to the way of each motor's constant speed; `None` if the motors were sent to a position.
    pub(crate) fn shifts(&self) -> Option<Vec<Shift>> {
        let shift = |voice: &Voice| {
            let law = match voice.stance {
                Stance::Following => Some(voice.law.clone()),
                Stance::Joining => voice.left.clone(),
                Stance::Sent => return None,
            };
            Some(Shift { law, steps: voice.shift })
        };
        self.voices.iter().map(shift).collect()
    }

    /// This mix, if a robot whose arms rest joins a path: as a robot whose effector rests, so that the effector goes on the blend of its place and
    /// the path.
    fn with_resting_tips(mut self, program: &Program) -> Mix {
        for machine in program.machines.iter().filter(|_| self.fades.is_empty()) {
            let &[a, b, c] = &machine.motors[..] else { continue };
            let arm = |motor: usize| {
                let path = program.motors.get(motor)?.law.tip_path()?;
                Some((path.joint, self.base.get(motor)?.rests_for_ever_at()?))
            };
            let (Some(a_rests), Some(b_rests), Some(c_rests)) = (arm(a), arm(b), arm(c)) else { continue };
            let arms = [a_rests, b_rests, c_rests];
            let laws = Law::arms_at_rest(arms.map(|(joint, _)| joint), arms.map(|(_, steps)| steps));
            for (motor, law) in machine.motors.iter().zip(laws.into_iter().flatten()) {
                self.base[*motor] = law;
            }
        }
        self
    }

    /// The laws of all motors in the program's time, from now on.
    fn laws(&self) -> Result<Vec<Law>, PauseError> {
        let law = |motor: usize| {
            let law = self.fades.iter().try_fold(self.base[motor].clone(), |law, fade| fade.of(motor, &law));
            law.map_err(|error| PauseError::Law { motor, error })
        };
        (0..self.base.len()).map(law).collect()
    }

    /// The laws that the motors follow after the last fade, each in its own time.
    pub(crate) fn followed(&self) -> impl Iterator<Item = &Law> {
        self.voices.iter().map(|voice| &voice.law)
    }

    /// A program with these laws.
    pub(crate) fn program(&self, like: &Program) -> Result<Program, PauseError> {
        let mut program = like.clone();
        for (motor, law) in program.motors.iter_mut().zip(self.laws()?) {
            motor.law = law;
        }
        Ok(program)
    }

    /// The motors whose laws a change changes. Motors that were stopped left their laws: all of them change then.
    fn changed(&self, change: &Change) -> Vec<bool> {
        let motors = change.program.motors.iter().zip(&self.voices).zip(&self.base);
        motors
            .map(|((motor, voice), base)| {
                let is_at_rest = self.fades.is_empty() && voice.in_program_time().is_ok_and(|law| law != *base);
                change.begins == Begins::Now || is_at_rest || motor.law != voice.law
            })
            .collect()
    }

    /// Whether a motor rests apart from its law, which goes on: it was stopped.
    fn is_stopped(&self, motor: usize) -> bool {
        let base = &self.base[motor];
        let is_law = || self.voices[motor].in_program_time().is_ok_and(|law| law == *base);
        self.fades.is_empty() && base.rests_for_ever_at().is_some() && !is_law()
    }

    /// A fade into other laws of the motors that are `changed`, and what the motors follow then. `stopped`: [`is_stopped`](Mix::is_stopped) by motor.
    fn fade(
        &self,
        change: &Change,
        (from, over): (Time, Time),
        (changed, stopped): (&[bool], &[bool]),
        apart: &[bool],
    ) -> Result<(Fade, Vec<Voice>), PauseError> {
        let mut voices = self.voices.clone();
        let mut turns = Vec::with_capacity(voices.len());
        for (motor, voice) in voices.iter_mut().enumerate() {
            if !changed[motor] {
                turns.push(None);
                continue;
            }
            let law = change.program.motors[motor].law.clone();
            let turn = Mix::turn(voice, law, change.begins, (from, over), stopped[motor]);
            turns.push(Some(turn.map_err(|error| PauseError::Law { motor, error })?));
        }
        Ok((Fade { from, over, turns, apart: apart.to_vec() }, voices))
    }

    /// A motor's change to another law; `voice` becomes what it follows then.
    fn turn(
        voice: &mut Voice,
        law: Law,
        begins: Begins,
        (from, over): (Time, Time),
        is_stopped: bool,
    ) -> Result<Turn, LawError> {
        if begins == Begins::WithTheMotion && voice.stance == Stance::Joining {
            return Mix::turn_of_joining(voice, law, from);
        }
        if begins == Begins::WithTheMotion
            && law != voice.law
            && let Some(turn) = Mix::turn_of_line(voice, &law, (from, over), is_stopped)?
        {
            return Ok(turn);
        }
        let at = voice.own_time(from);
        let phase = if law == voice.law {
            Some((at, None))
        } else {
            voice.law.pace_to(&law).and_then(|pace| Some((pace.of_new(at)?, pace.rates())))
        };
        let (own, rates) = match (begins, phase) {
            (Begins::Now, _) => (Some((from, Time::ZERO)), None),
            (Begins::WithTheMotion, None) => (None, None),
            (Begins::WithTheMotion, Some((own, rates))) => ((own != from).then_some((from, own)), rates),
        };
        let is_kept = begins == Begins::WithTheMotion && law == voice.law;
        let shift =
            if is_kept && law.line_part(own.map_or(from, |(_, own)| own)).is_some() { voice.shift } else { 0.0 };
        let stance = if begins == Begins::Now { Stance::Sent } else { Stance::Following };
        *voice = Voice { law, own, shift, stance, left: None };
        let Some((old_rate, new_rate)) = rates else {
            let law = voice.in_program_time()?;
            return Ok(Turn { old_rate: None, faster: None, new: law.clone(), settled: law });
        };
        let ease = Ease { before: new_rate, after: Time::ZERO, over, to: Rate::ONE };
        let start = voice.own_time(from);
        let new = voice.law.clone().retimed(start, ease)?.delayed(from)?;
        voice.own = Some((from + over, start + ease.of_law()));
        Ok(Turn { old_rate: Some(old_rate), faster: None, new, settled: voice.in_program_time()? })
    }

    /// As [`Mix::turn`], from rest to a law that has gone on since an earlier session. A constant speed has come as far as the one that was followed then
    /// would be now: another speed since the beginning would be another way.
    fn turn_of_joining(voice: &mut Voice, law: Law, from: Time) -> Result<Turn, LawError> {
        let old = voice.left.as_ref().and_then(|left| left.line_part(from));
        let shift = match (old, law.line_part(from)) {
            (Some(old), Some(new)) => voice.shift + old.way - new.way,
            _ => 0.0,
        };
        *voice = Voice { shift, ..Voice::following(law) };
        let settled = voice.in_program_time()?;
        Ok(Turn { old_rate: None, faster: None, new: settled.clone(), settled })
    }

    /// As [`Mix::turn`], between laws with an endless constant speed: it goes on from where the motor is. `None` for others.
    fn turn_of_line(
        voice: &mut Voice,
        law: &Law,
        (from, over): (Time, Time),
        is_stopped: bool,
    ) -> Result<Option<Turn>, LawError> {
        let (own, at) = match voice.stance {
            Stance::Sent => (None, from),
            Stance::Following | Stance::Joining => (voice.own, voice.own_time(from)),
        };
        let (Some(old), Some(new)) = (voice.law.line_part(voice.own_time(from)), law.line_part(at)) else {
            return Ok(None);
        };
        // Where the backlash is taken up now is known as long as the speed keeps its direction.
        let keeps_direction = new.speed == 0.0 || old.speed * new.speed > 0.0;
        if (old.has_backlash || new.has_backlash) && !keeps_direction {
            return Ok(None);
        }
        // A motor that was stopped has no speed that changes: it joins the new one, where the old one would be by now.
        let faster = if is_stopped { 0.0 } else { new.speed - old.speed };
        let there = if voice.stance == Stance::Sent { old.way + old.offset } else { old.way };
        let shift = voice.shift + there - new.way - 0.5 * faster * over.seconds();
        *voice = Voice { own, shift, ..Voice::following(law.clone()) };
        let settled = voice.in_program_time()?;
        if faster == 0.0 {
            return Ok(Some(Turn { old_rate: None, faster: None, new: settled.clone(), settled }));
        }
        let new = Law::sum(vec![settled.clone(), slower_before(faster, from, over)?])?;
        Ok(Some(Turn { old_rate: None, faster: Some(faster), new, settled }))
    }

    /// The shortest fade that keeps all motors to `caution` times their limits at a tempo, and lasts as long as the change is to last at least.
    fn quickest(
        &self,
        change: &Change,
        from: Time,
        tempo: Rate,
        caution: f64,
    ) -> Result<(Fade, Vec<Voice>), PauseError> {
        let old = self.laws()?;
        let least_s = change.over.map_or(SHORTEST_S, |over| tempo.of_law(over).seconds().max(SHORTEST_S));
        let mut over_s = least_s;
        let mut apart = vec![false; old.len()];
        // Neither depends on the duration.
        let changed = self.changed(change);
        let stopped: Vec<bool> = (0..old.len()).map(|motor| self.is_stopped(motor)).collect();
        let mut readers: Vec<Option<Reader>> = old.iter().map(|_| None).collect();
        'fades: while over_s <= LONGEST_S.max(least_s) {
            let over = Time::from_seconds(over_s);
            let (fade, voices) = self.fade(change, (from, over), (&changed, &stopped), &apart)?;
            for (motor, reader) in readers.iter_mut().enumerate() {
                *reader = fade.reader(motor, &old[motor], reader.take())?;
            }
            // All arms of a robot fade alike.
            let mut is_mixed = false;
            for machine in &change.program.machines {
                let is_blended = |motor: &&usize| readers[**motor].as_ref().is_some_and(|reader| reader.blends);
                let blended = machine.motors.iter().filter(is_blended).count();
                if (1..machine.motors.len()).contains(&blended) {
                    machine.motors.iter().for_each(|motor| apart[*motor] = true);
                    is_mixed = true;
                }
            }
            if is_mixed {
                continue;
            }
            let mut fits = true;
            let mut samples: Vec<Option<FadeSamples>> = vec![None; old.len()];
            for (motor, turn) in fade.turns.iter().enumerate() {
                let (Some(turn), Some(reader)) = (turn.as_ref().filter(|_| fits), &mut readers[motor]) else {
                    continue;
                };
                let machine = change.program.machines.iter().find(|machine| machine.motors.contains(&motor));
                let sampled =
                    sampled(&fade, turn, reader, tempo, machine).map_err(|error| PauseError::Law { motor, error })?;
                let Some(sampled) = sampled else {
                    machine.into_iter().flat_map(|machine| &machine.motors).for_each(|motor| apart[*motor] = true);
                    apart[motor] = true;
                    continue 'fades;
                };
                fits = keeps(&sampled.motor, &change.program, &change.program.motors[motor], caution);
                samples[motor] = Some(sampled);
            }
            for machine in change.program.machines.iter().filter(|machine| machine.tip_limits != [None; 2]) {
                fits = fits && keeps_tip(machine, &samples, &fade, &old, tempo, caution)?;
            }
            if fits {
                return Ok((fade, voices));
            }
            over_s *= LONGER;
        }
        let (fade, _) = self.fade(change, (from, Time::from_seconds(least_s)), (&changed, &stopped), &apart)?;
        Err(match grow_apart(&fade, &old, from)? {
            true => PauseError::Parting { within_s: LONGEST_S },
            false => PauseError::NoRoom { what: "change", within_s: LONGEST_S },
        })
    }
}

/// Whether the distance between a motor's old law and its new one keeps growing, as far as fades are tried. A constant speed that changes from where the
/// motor is does not count: its way during the fade is as short as can be.
fn grow_apart(fade: &Fade, old: &[Law], from: Time) -> Result<bool, PauseError> {
    for (motor, turn) in fade.turns.iter().enumerate() {
        let Some(turn) = turn.as_ref().filter(|turn| turn.faster.is_none()) else { continue };
        let (mut before, mut after) = (Cursor::new(&old[motor]), Cursor::new(&turn.settled));
        let mut distance = |k: u32| {
            let at = from + Time::from_seconds(LONGEST_S * f64::from(k) / f64::from(PARTING_PLACES));
            let (old, new) = (before.at(at)?, after.at(at)?);
            Ok(((new.whole - old.whole) as f64 + (new.fraction - old.fraction)).abs())
        };
        let distances: Result<Vec<f64>, LawError> = (0..=PARTING_PLACES).map(&mut distance).collect();
        let distances = distances.map_err(|error| PauseError::Law { motor, error })?;
        if distances.windows(2).all(|pair| pair[1] > pair[0] + 1.0) {
            return Ok(true);
        }
    }
    Ok(false)
}

/// A speed that goes from 0 to `faster`, steps/s, within a fade, and stays there: with x from 0 to 1 it is `faster`·(3x² − 2x³).
fn faster_by(faster: f64, from: Time, over: Time) -> Result<Law, LawError> {
    let s = over.seconds();
    let rise = Law::polynomials([(over, vec![0.0, 0.0, 0.0, faster / (s * s), -0.5 * faster / (s * s * s)])])?;
    Law::then(vec![rise, Law::speed(faster, None)?])?.delayed(from)
}

/// What has to be added to a constant speed that is `faster` than another one, for the way of [`faster_by`] within a fade: nothing after its end.
fn slower_before(faster: f64, from: Time, over: Time) -> Result<Law, LawError> {
    let s = over.seconds();
    let way = vec![0.5 * faster * s, -faster, 0.0, faster / (s * s), -0.5 * faster / (s * s * s)];
    Law::polynomials([(over, way)])?.delayed(from)
}

/// A motor's motion at many places of a fade, and its robot's tip if it is an arm that follows a path.
#[derive(Clone, Debug)]
struct FadeSamples {
    motor: Vec<FadeSample>,
    tip: Vec<FadeSample>,
}

/// The places of a fade at which it is looked at.
fn places_of(fade: &Fade) -> u32 {
    ((fade.over.seconds() / PLACE_S) as u32).clamp(*PLACES.start(), *PLACES.end())
}

/// A place of a fade.
fn place_at(fade: &Fade, k: u32, places: u32) -> Time {
    fade.from + fade.over.times(u64::from(k)).divided_by(u64::from(places))
}

/// A motor's motion at many places of a fade; `None` if it is an arm that does not reach, or that would leave its `angles`.
fn sampled(
    fade: &Fade,
    turn: &Turn,
    Reader { old: old_law, new: new_law, path, blends }: &mut Reader,
    tempo: Rate,
    machine: Option<&Machine>,
) -> Result<Option<FadeSamples>, LawError> {
    let (over_s, places) = (fade.over.seconds(), places_of(fade));
    let angles = machine.and_then(|machine| match &machine.kinematics {
        Kinematics::Delta { angles, .. } => *angles,
        Kinematics::Xy { .. } => None,
    });
    let mut path = path.as_mut().filter(|_| *blends).map(|(_, path)| path);
    let mut samples = FadeSamples { motor: Vec::with_capacity(places as usize + 1), tip: Vec::new() };
    for k in 0..=places {
        let at = place_at(fade, k, places);
        let (old, new) = (old_law.at(at)?, new_law.at(at)?);
        let weight = weight_at(k, places, over_s);
        let [_, speed, acceleration] = match &mut path {
            None => blended(old, new, weight),
            Some(path) => {
                let Some((motion, tip)) = path.at(at, weight, angles)? else { return Ok(None) };
                samples.tip.push(tip.at_tempo(tempo));
                motion
            }
        };
        // The change of a constant speed is no part of the laws.
        let x = f64::from(k) / f64::from(places);
        let faster = turn.faster.map_or(0.0, |faster| 6.0 * x * (1.0 - x) * faster / over_s);
        let own = |law: Sample| [law.speed, law.acceleration - faster];
        let sample = FadeSample { needed: [speed, acceleration], old: own(old), new: own(new) };
        samples.motor.push(sample.at_tempo(tempo));
    }
    Ok(Some(samples))
}

/// Reads a motor's old law and its new one during a fade, and the paths of its robot's effector. It keeps its place, as many durations are tried.
struct Reader {
    old: Cursor,
    new: Cursor,
    /// Both paths, if the motor is an arm of a robot.
    path: Option<(PathPair, PathBlend)>,
    /// Whether the paths are blended.
    blends: bool,
}

impl Reader {
    fn of(old: &Law, new: &Law) -> Reader {
        let path = PathPair::of(old, new).map(|pair| {
            let blend = PathBlend::of(pair.paths());
            (pair, blend)
        });
        Reader { old: Cursor::new(old), new: Cursor::new(new), path, blends: false }
    }
}

/// The weight of the new law at place `k` of `places`, and its derivatives by time.
fn weight_at(k: u32, places: u32, over_s: f64) -> [f64; 3] {
    let [w, dw, ddw] = fade_weight(f64::from(k) / f64::from(places));
    [w, dw / over_s, ddw / (over_s * over_s)]
}

/// The blend of two laws at a weight: how far it is from the old one's whole steps, its speed and its acceleration.
fn blended(old: Sample, new: Sample, [w, dw, ddw]: [f64; 3]) -> [f64; 3] {
    // Steps of a motor: whole ones far from 0 are taken apart.
    let way = (new.whole - old.whole) as f64 + (new.fraction - old.fraction);
    let by = new.speed - old.speed;
    [
        old.fraction + w * way,
        old.speed + w * by + dw * way,
        old.acceleration + w * (new.acceleration - old.acceleration) + 2.0 * dw * by + ddw * way,
    ]
}

/// Two paths of a robot's effector that are blended, and an arm that follows.
struct PathBlend {
    joint: Joint,
    /// The coordinates of the old path and of the new one.
    tip: [[Cursor; 2]; 3],
    /// What is added to the joint's position, if there is anything.
    added: Option<[Cursor; 2]>,
}

impl PathBlend {
    fn of([old, new]: &[ArmPath; 2]) -> PathBlend {
        let both = |old: &Law, new: &Law| [Cursor::new(old), Cursor::new(new)];
        let nothing = Law::Steady(Steady { speed: 0.0, duration: None });
        let added = (old.added.is_some() || new.added.is_some())
            .then(|| both(old.added.as_ref().unwrap_or(&nothing), new.added.as_ref().unwrap_or(&nothing)));
        PathBlend { joint: old.joint, tip: [0, 1, 2].map(|k| both(&old.tip[k], &new.tip[k])), added }
    }

    /// The motor's motion, and the tip's; `None` where the arm does not reach or is not between `angles`, rad.
    fn at(
        &mut self,
        at: Time,
        weight: [f64; 3],
        angles: Option<(f64, f64)>,
    ) -> Result<Option<([f64; 3], FadeSample)>, LawError> {
        let mut tip = [[0.0; 3]; 3];
        let mut axes = [FadeSample::AT_REST; 3];
        for ((tip, axis), [old, new]) in tip.iter_mut().zip(&mut axes).zip(&mut self.tip) {
            let (old, new) = (old.at(at)?, new.at(at)?);
            let [along, speed, acceleration] = blended(old, new, weight);
            *tip = [old.whole as f64 + along, speed, acceleration];
            let own = |law: Sample| [law.speed, law.acceleration];
            *axis = FadeSample { needed: [speed, acceleration], old: own(old), new: own(new) };
        }
        let mut motion = self.joint.motion(tip);
        let angle = motion[0] / self.joint.steps_per_rad();
        if !motion.iter().all(|x| x.is_finite())
            || angles.is_some_and(|(least, most)| angle < least - ROUNDING_RAD || angle > most + ROUNDING_RAD)
        {
            return Ok(None);
        }
        if let Some([old, new]) = &mut self.added {
            let added = blended(old.at(at)?, new.at(at)?, weight);
            motion.iter_mut().zip(added).for_each(|(motion, added)| *motion += added);
        }
        Ok(Some((motion, FadeSample::along(&axes))))
    }
}

impl FadeSample {
    const AT_REST: FadeSample = FadeSample { needed: [0.0; 2], old: [0.0; 2], new: [0.0; 2] };

    /// The same while the laws' time runs at a tempo.
    fn at_tempo(self, tempo: Rate) -> FadeSample {
        let rate = tempo.get();
        let of = |[speed, acceleration]: [f64; 2]| [speed * rate, acceleration * rate * rate];
        FadeSample { needed: of(self.needed), old: of(self.old), new: of(self.new) }
    }

    /// The tip's speed and acceleration, from those of its axes.
    fn along(axes: &[FadeSample]) -> FadeSample {
        let sum = |of: fn(&FadeSample) -> [f64; 2]| {
            [0, 1].map(|k| axes.iter().map(|axis| whole_power(of(axis)[k], 2)).sum::<f64>().sqrt())
        };
        FadeSample { needed: sum(|axis| axis.needed), old: sum(|axis| axis.old), new: sum(|axis| axis.new) }
    }

    /// The most that one of the laws alone takes: speed (0) or acceleration (1).
    fn own(&self, of: usize) -> f64 {
        self.old[of].abs().max(self.new[of].abs())
    }

    /// Whether it keeps to limits of speed and acceleration, of which a fade may use `caution`.
    fn keeps(&self, limits: [f64; 2], caution: f64) -> bool {
        [0, 1].into_iter().all(|of| {
            let is_near = self.own(of) > USABLE * caution * limits[of];
            self.needed[of].abs() <= limits[of] * if is_near { NEARLY_ALL } else { USABLE * caution }
        })
    }
}

/// Whether the tip of a machine keeps to its limits at all places of a fade. A robot whose arms fade separately has no path that is known.
fn keeps_tip(
    machine: &Machine,
    samples: &[Option<FadeSamples>],
    fade: &Fade,
    old: &[Law],
    tempo: Rate,
    caution: f64,
) -> Result<bool, PauseError> {
    let limits = machine.tip_limits.map(|limit| limit.unwrap_or(f64::INFINITY));
    let fits = |tip: &FadeSample| {
        // A path may run at its machine's limit all the time. Without more than that it could never change.
        let most = [0, 1].map(|of| limits[of].max(TIP_EXCESS * tip.own(of)));
        tip.keeps(most, caution)
    };
    let Kinematics::Xy { steps_per_unit } = &machine.kinematics else {
        let tip = machine.motors.iter().find_map(|motor| samples[*motor].as_ref());
        return Ok(tip.is_none_or(|samples| samples.tip.iter().all(fits)));
    };
    if machine.motors.iter().all(|motor| samples[*motor].is_none()) {
        return Ok(true);
    }
    let places = places_of(fade);
    let mut unchanged: Vec<Cursor> = machine.motors.iter().map(|motor| Cursor::new(&old[*motor])).collect();
    for k in 0..=places {
        let mut axes = [FadeSample::AT_REST; 2];
        for (axis, motor) in machine.motors.iter().enumerate() {
            let sample = match &samples[*motor] {
                Some(samples) => samples.motor[k as usize],
                None => {
                    let law = unchanged[axis].at(place_at(fade, k, places));
                    let law = law.map_err(|error| PauseError::Law { motor: *motor, error })?;
                    let same = [law.speed, law.acceleration];
                    FadeSample { needed: same, old: same, new: same }.at_tempo(tempo)
                }
            };
            let unit =
                |[speed, acceleration]: [f64; 2]| [speed / steps_per_unit[axis], acceleration / steps_per_unit[axis]];
            axes[axis] = FadeSample { needed: unit(sample.needed), old: unit(sample.old), new: unit(sample.new) };
        }
        if !fits(&FadeSample::along(&axes)) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Whether a motor keeps to its limits at all places of a fade.
fn keeps(samples: &[FadeSample], program: &Program, motor: &Motor, caution: f64) -> bool {
    let board = Settings::of(program, motor).highest_rate_hz();
    let own = |of: usize| samples.iter().map(|sample| sample.own(of)).fold(0.0, f64::max);
    let (pull_in, own_speed) = (motor.limits.pull_in, own(0));
    let unlimited = [
        UNLIMITED * own_speed.max(pull_in),
        UNLIMITED * own(1).max(own_speed / SOFTEST_STOP_S).max(pull_in / SOFTEST_STOP_S),
    ];
    let limits = [
        motor.limits.max_speed.unwrap_or(unlimited[0]).min(board),
        motor.limits.max_acceleration.unwrap_or(unlimited[1]),
    ];
    samples.iter().all(|sample| sample.keeps(limits, caution))
}

impl<B: Leased> Session<B> {
    /// Lets the motors change to other laws while they move, as soon as that reaches the board, by a fade that keeps all of them to their limits. The
    /// tempo stays as it is. While the motion is paused, it goes on with the new laws. Motors that were stopped join the new laws from where they rest.
    ///
    /// # Errors
    /// [`SessionError::Waiting`] while two changes are under way, while the tempo changes, or until the queues have room: try again at the tick in the error, with the last change that
    /// is wanted. [`SessionError::Pause`] where no fade keeps to the limits. Else as [`Session::change`]. The motion goes on after an error.
    ///
    /// ```
    /// # use pulsetrain_session::{Session, fade::{Begins, Change}};
    /// # use pulsetrain_board::{Config, Edge, MotorConfig, Native, Wiring};
    /// # let text = pulsetrain_motion::template::motion_file("example");
    /// # let no_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
    /// # let program = pulsetrain_motion::file::read(&text, "example.toml", &no_files).unwrap();
    /// # let mut wider = program.clone();
    /// # wider.motors[0].law = wider.motors[0].law.clone().scaled(0.5).unwrap();
    /// # let wiring = Wiring::StepDir { step: 0, dir: 1, forward_high: true, pulse_ticks: 16, setup_ticks: 16 };
    /// # let motors = vec![MotorConfig { wiring, pull_in_ticks: 1 }];
    /// # let board = Native::new(&Config { fraction_bits: program.board.registers.fraction_bits, motors }).unwrap();
    /// # let mut nobody = |_: Edge| {};
    /// let mut session = Session::new(board, program)?;
    /// session.advance(session.zero() + 1_000_000, &mut nobody)?;
    /// let change = Change { program: wider.into(), over: None, begins: Begins::WithTheMotion };
    /// let transition = session.change_to(&change)?;
    /// assert!(transition.from < transition.until);
    /// assert_eq!(session.run(&mut nobody, |_| {}).failure, None);
    /// # Ok::<(), pulsetrain_session::SessionError>(())
    /// ```
    pub fn change_to(&mut self, change: &Change) -> Result<Transition, SessionError> {
        self.change_with_tempo(change, None).map(|(transition, _)| transition)
    }

    /// As [`Session::change_to`], with another tempo from the same tick on. If motors or board cannot follow the new laws at that tempo, it is the highest
    /// that they can.
    ///
    /// # Errors
    /// As [`Session::change_to`], and [`SessionError::NoTempo`] if the tempo is 0.
    pub fn change_with_tempo(
        &mut self,
        change: &Change,
        wanted: Option<Rate>,
    ) -> Result<(Transition, Option<Tempo>), SessionError> {
        let (program, hz) = (&change.program, self.pace.tick_hz);
        if wanted == Some(Rate::ZERO) {
            return Err(SessionError::NoTempo);
        }
        let new_tempo = wanted.map(|wanted| self.tempo_of(program, wanted)).transpose()?;
        if program.motors.len() != self.timelines.len() {
            return Err(SessionError::Motors { program: program.motors.len(), board: self.timelines.len() });
        }
        self.attempt(|session, caution, delay| {
            let (at, time) = session.moment(delay)?;
            let mut tempo = session.playback.tempo();
            let to = new_tempo.map_or(tempo, |(rate, _)| rate);
            let mut mix = session.playback.mix().clone();
            mix.settle(time);
            if session.playback.is_stopped() {
                let positions =
                    (0..program.motors.len()).map(|motor| session.state(motor, at).map(|state| state.theta));
                mix = mix.at_rest(&positions.collect::<Result<Vec<f64>, _>>()?)?;
                // Motors at rest have no tempo to ease from, and it may be the one that the planner refused.
                tempo = to;
            }
            mix = mix.with_resting_tips(program);
            if let Some(full_until) = mix.full_until() {
                let until = at + ticks(tempo.to_pass(full_until - time), hz);
                return Err(SessionError::Waiting { at, until });
            }
            // The resumption speeds the laws' time up while the motors change over: it needs a part of each limit.
            let caution = if session.is_paused() { PAUSED * caution } else { caution };
            let (fade, voices) = mix.quickest(change, time, tempo.max(to), caution)?;
            let of_fade = fade.over;
            mix.fades.push(fade);
            mix.voices = voices;
            let new = Arc::new(mix.program(program)?);
            // The fade is part of what the easing is held against.
            let ease = match to == tempo || session.is_paused() {
                true => Ease::steady(to),
                false => crate::pause::quickest(&new, time, (tempo, to), caution, tempo)?,
            };
            let over = ease.end() + to.to_pass((of_fade - ease.of_law()).max(Time::ZERO));
            if !session.is_paused() {
                let retimed = crate::pause::retimed(&new, time, ease)?;
                session.change_proven(
                    at,
                    Arc::new(retimed),
                    ticks(over.min(PROVEN), hz).max(session.pace.look_ahead),
                )?;
            }
            session.playback.changed(new, mix, time);
            if new_tempo.is_some() {
                session.playback.eases(time, ease);
            }
            let told = new_tempo.map(|(rate, ceiling)| Tempo { rate, from: at + ticks(ease.end(), hz), ceiling });
            Ok((Transition { from: at, until: at + ticks(over, hz) }, told))
        })
    }

    /// Lets motors that were stopped join their laws again, from where they rest. The laws' time went on meanwhile.
    ///
    /// # Errors
    /// As [`Session::change_to`].
    pub fn rejoin(&mut self) -> Result<Transition, SessionError> {
        let program = Arc::new(self.playback.followed());
        self.change_to(&Change { program, over: None, begins: Begins::WithTheMotion })
    }

    /// The first limit that the laws of a program would break after a change to it, if there is one. Laws that repeat are looked at for a period,
    /// others for half a minute; then, on a board with a line, as much of the plan as takes some milliseconds is held against all limits.
    ///
    /// # Errors
    /// When a law cannot be evaluated.
    pub fn ceiling_of(&self, change: &Change) -> Result<Option<Ceiling>, SessionError> {
        self.ceiling_at(change, self.playback.tempo())
    }

    /// As [`Session::ceiling_of`], at a tempo that comes with the change.
    ///
    /// # Errors
    /// As [`Session::ceiling_of`].
    pub fn ceiling_at(&self, change: &Change, tempo: Rate) -> Result<Option<Ceiling>, SessionError> {
        let mix = self.playback.mix();
        // Motors that were stopped left their laws: all of them join the new ones.
        let changed = if self.is_stopped() { vec![true; change.program.motors.len()] } else { mix.changed(change) };
        let from = if change.begins == Begins::Now { Time::ZERO } else { self.law_time() };
        let (highest, ceiling) = highest_factor(&change.program, from, NEARLY_ALL, &changed)?;
        if highest < tempo.get() {
            return Ok(ceiling);
        }
        if let Some(ceiling) = sudden_end(&change.program, from, tempo, &changed)? {
            return Ok(Some(ceiling));
        }
        // The file's reader holds paths against the limits of their tips, at tempo 1.
        if tempo > Rate::ONE {
            let (highest, ceiling) = highest_tip_factor(&change.program, from, NEARLY_ALL, &changed)?;
            if highest < tempo.get() {
                return Ok(ceiling);
            }
        }
        Ok(self.plan_refused(&change.program, from, tempo, TRIED_MOVES).map(|(ceiling, _)| ceiling))
    }
}
