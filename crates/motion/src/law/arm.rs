//! The law of a delta robot's arm, from the path of its effector.
//!
//! Of a path from a file each arm has a formula of its own, which is quick to plan. It also keeps the path. Where a path is no formula, as while one
//! path fades into another, the arm's curve is composed of the coordinates' curves ([`joint`](super::joint)).

use super::combine::{MOST_PARTS, Summand, Together, latest_end, too_many};
use super::formula::Terms;
use super::joint::{Joint, JointCurve};
use super::{Class, Cursor, Curve, Double, Entry, Law, LawError, Piece, Pieces, checked};
use crate::Time;
use crate::machine::Delta;
use std::sync::Arc;

/// What one arm of a delta robot does while its effector follows a path.
#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    joint: Joint,
    /// The effector's coordinates, mm.
    tip: [Law; 3],
    /// The same motion as a law of its own; `None`: its pieces are composed of the coordinates' pieces.
    law: Option<Law>,
}

/// An arm's law as the joint of an effector that follows a path.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmPath {
    /// The joint.
    pub joint: Joint,
    /// The effector's coordinates, mm.
    pub tip: [Law; 3],
    /// What is added to the joint's position, steps: backlash, and where the motor counts from.
    pub added: Option<Law>,
}

/// No part of a path is cut shorter than this, s. Where an arm's angle cannot be enclosed in so short a part the arm does not reach.
const NARROWEST_S: f64 = 1e-9;
/// Where a path is given both ways, as a law of the arm and as a path, they agree to this, steps.
const SAME_STEPS: f64 = 1e-7;
/// A path goes on in another one, or repeats, if they meet to this, mm: the arm's angle goes on from where it is, and a leap of the effector would be another
/// one of the angle.
const SAME_MM: f64 = 1e-9;

impl Law {
    /// What the arm of `joint` does while the effector follows `tip`: x, y and z in mm, laws of any kind.
    ///
    /// An arm that does not reach is an error of the law's [`pieces`](Law::pieces).
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time, law::{Cursor, Joint}, machine::Delta};
    /// let robot = Delta { base_mm: 60.0, upper_arm_mm: 70.0, forearm_mm: 150.0, effector_mm: 25.0 };
    /// let up_and_down = Law::sine(10.0, Time::SECOND, None)?.shifted(-160.0)?;
    /// let rest = Law::speed(0.0, None)?;
    /// let law = Law::arm(Joint::new(robot, 0, 500.0), [rest.clone(), rest, up_and_down]);
    /// let half = Cursor::new(&law).at(Time::from_seconds(0.5))?.position;
    /// assert!((half - 500.0 * robot.angles([0.0, 0.0, -140.0]).unwrap()[0]).abs() < 1e-9);
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    #[must_use]
    pub fn arm(joint: Joint, tip: [Law; 3]) -> Law {
        Law::Arm(Arc::new(Arm { joint, tip, law: None }))
    }

    /// This law, being what the arm of `joint` does while the effector follows `tip`.
    #[must_use]
    pub(crate) fn of_arm(self, joint: Joint, tip: [Law; 3]) -> Law {
        Law::Arm(Arc::new(Arm { joint, tip, law: Some(self) }))
    }

    /// What the three arms of a robot do at rest at these positions, steps: laws whose effector rests. `None` if they are no arms of one robot, or if
    /// the effector cannot hold on to all of them.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, law::Joint, machine::Delta};
    /// let robot = Delta { base_mm: 60.0, upper_arm_mm: 70.0, forearm_mm: 150.0, effector_mm: 25.0 };
    /// let joints = [0, 1, 2].map(|arm| Joint::new(robot, arm, 500.0));
    /// let laws = Law::arms_at_rest(joints, [40.0, 70.0, -20.0]).unwrap();
    /// assert!(laws[1].tip_path().is_some());
    /// assert!(Law::arms_at_rest([joints[0]; 3], [0.0; 3]).is_none());
    /// ```
    #[must_use]
    pub fn arms_at_rest(joints: [Joint; 3], steps: [f64; 3]) -> Option<[Law; 3]> {
        let point = Joint::point(&joints, steps)?;
        let [x, y, z] = point.map(|at| rest_at(at).ok());
        let tip = [x?, y?, z?];
        let law = |k: usize| {
            let [position, ..] = joints[k].motion(point.map(|at| [at, 0.0, 0.0]));
            // The effector's place is rounded: the motor rests where it does.
            let off = steps[k] - position;
            (off.abs() <= SAME_STEPS).then(|| Law::arm(joints[k], tip.clone()).shifted(off).ok()).flatten()
        };
        Some([law(0)?, law(1)?, law(2)?])
    }

    /// Where this law rests for ever, steps; `None` if it moves or ends.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time, law::Ease, time::Rate};
    /// let rest = Law::speed(0.0, None)?.shifted(40.0)?;
    /// assert_eq!(rest.rests_for_ever_at(), Some(40.0));
    /// // As after a change that began at its own time.
    /// let later = rest.retimed(Time::ZERO, Ease::steady(Rate::ONE))?.delayed(Time::SECOND)?;
    /// assert_eq!(later.rests_for_ever_at(), Some(40.0));
    /// assert_eq!(Law::speed(1.0, None)?.rests_for_ever_at(), None);
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    #[must_use]
    pub fn rests_for_ever_at(&self) -> Option<f64> {
        match self {
            Law::Steady(steady) => (steady.speed == 0.0 && steady.duration.is_none()).then_some(0.0),
            Law::Changed(changed) => Some(changed.law.rests_for_ever_at()? + changed.shift()?),
            // A rest is the same at any rate of time.
            Law::Warped(warped) => warped.law().rests_for_ever_at(),
            _ => None,
        }
    }

    /// The path of the effector, if this is the law of a robot's arm that follows one, perhaps delayed, retimed, repeated, or one after the other.
    #[must_use]
    pub fn tip_path(&self) -> Option<ArmPath> {
        let both = |a: Option<Law>, b: Option<Law>| match (a, b) {
            (Some(a), Some(b)) => Law::sum(vec![a, b]).map(Some),
            (a, b) => Ok(a.or(b)),
        };
        match self {
            Law::Arm(arm) => Some(ArmPath { joint: arm.joint, tip: arm.tip.clone(), added: None }),
            Law::Changed(changed) => {
                let shift = changed.shift()?;
                let own = changed.law.tip_path()?.each(|law| law.delayed(changed.delay))?;
                let added = if shift == 0.0 { None } else { Some(rest_at(shift).ok()?) };
                Some(ArmPath { added: both(own.added, added).ok()?, ..own })
            }
            Law::Warped(warped) => warped.law().tip_path()?.each(|law| Ok(Law::Warped(Arc::new(warped.of(law))))),
            Law::Repeated(repeated) => {
                let own = repeated.law.tip_path().filter(|own| own.added.is_none())?;
                let closes = || Some(meet(own.point(repeated.law.end()?).ok()?, own.point(Time::ZERO).ok()?));
                if repeated.times != Some(1) && !closes()? {
                    return None;
                }
                own.each(|law| law.repeated(repeated.times))
            }
            Law::Faded(faded) => faded.along()?.tip_path(),
            Law::Backlash(backlash) => {
                let own = backlash.law().tip_path()?;
                Some(ArmPath { added: both(own.added, Some(backlash.added().clone())).ok()?, ..own })
            }
            Law::Sum(laws) => {
                let mut found = None;
                let mut added = None;
                for law in &**laws {
                    match (law.tip_path(), &found) {
                        (Some(own), None) => found = Some(own),
                        (Some(_), Some(_)) => return None,
                        (None, _) => added = both(added, Some(law.clone())).ok()?,
                    }
                }
                let own = found?;
                Some(ArmPath { added: both(own.added, added).ok()?, ..own })
            }
            Law::Then(laws) => one_after_the_other(laws),
            _ => None,
        }
    }

    /// The paths that [`faded`](Law::faded) blends, this law's and that of `new`; `None` if it blends positions.
    #[must_use]
    pub fn paths_to(&self, new: &Law, from: Time, over: Time) -> Option<[ArmPath; 2]> {
        let mut pair = PathPair::of(self, new)?;
        pair.are_followed(from, over).then_some(pair.paths)
    }

    /// What arm 0, 1 or 2 of `robot` does while the effector follows x, y and z, in mm, which end and are polynomials piece
    /// by piece (tables, lines): its angle times `steps_per_rad`.
    ///
    /// Each stretch of polynomials becomes a formula: crossings are enclosed, and an arm that does not reach is an error of
    /// the law's [`pieces`](Law::pieces).
    ///
    /// # Errors
    /// [`LawError::Parameter`] if they never end, or have pieces that are no polynomials or more than 2^20; and their own.
    pub fn delta_arm(robot: &Delta, arm: usize, tip: &[Law; 3], steps_per_rad: f64) -> Result<Law, LawError> {
        if tip.iter().any(|law| law.end().is_none()) {
            return Err(LawError::Parameter("the path never ends".into()));
        }
        let mut terms: [(Pieces, Option<Piece>); 3] = [0, 1, 2].map(|k| (tip[k].pieces(), None));
        let (mut at, mut laws) = (Time::ZERO, Vec::new());
        'stretches: loop {
            for (pieces, piece) in &mut terms {
                while piece.as_ref().is_none_or(|piece| piece.end <= at) {
                    match pieces.next() {
                        Some(next) => *piece = Some(next?),
                        None => break 'stretches,
                    }
                }
            }
            if laws.len() == MOST_PARTS {
                return Err(too_many("to follow"));
            }
            let ends = terms.iter().filter_map(|(_, piece)| piece.as_ref().map(|piece| piece.end));
            let Some(end) = ends.min() else { break };
            let mut texts = [const { String::new() }; 3];
            for (text, (_, piece)) in texts.iter_mut().zip(&terms) {
                if let Some(piece) = piece {
                    *text = in_powers_of_t(piece, at)?;
                }
            }
            let text = robot.formula(arm, [&texts[0], &texts[1], &texts[2]]);
            let law = Law::formula(&text, &[], steps_per_rad, Some(end - at));
            laws.push(law.map_err(|error| LawError::Parameter(error.message))?);
            at = end;
        }
        Ok(Law::then(laws)?.of_arm(Joint::new(*robot, arm, steps_per_rad), tip.clone()))
    }
}

/// The paths of two laws of one arm, read to see how one fades into the other.
pub struct PathPair {
    paths: [ArmPath; 2],
    laws: [PathCursor; 2],
}

/// Reads a law of an arm, and its path.
struct PathCursor {
    joint: Joint,
    law: Cursor,
    tip: [Cursor; 3],
    added: Option<Cursor>,
}

impl PathPair {
    /// The paths of `old` and `new`; `None` if they are no laws of one arm.
    #[must_use]
    pub fn of(old: &Law, new: &Law) -> Option<PathPair> {
        let paths = [old.tip_path()?, new.tip_path()?];
        let laws = [PathCursor::of(old, &paths[0]), PathCursor::of(new, &paths[1])];
        (paths[0].joint == paths[1].joint).then_some(PathPair { paths, laws })
    }

    /// Both paths.
    #[must_use]
    pub const fn paths(&self) -> &[ArmPath; 2] {
        &self.paths
    }

    /// Whether the laws keep to their paths from `from` for `over`: one that was joined from several may differ from its path by as little as their
    /// joints do.
    #[must_use]
    pub fn are_followed(&mut self, from: Time, over: Time) -> bool {
        let times = [from, from + over.divided_by(2), from + over];
        let [old, new] = &mut self.laws;
        times.into_iter().all(|at| old.is_on_path(at) && new.is_on_path(at))
    }
}

impl PathCursor {
    fn of(law: &Law, path: &ArmPath) -> PathCursor {
        let tip = path.tip.each_ref().map(Cursor::new);
        PathCursor { joint: path.joint, law: Cursor::new(law), tip, added: path.added.as_ref().map(Cursor::new) }
    }

    fn is_on_path(&mut self, at: Time) -> bool {
        let mut off = || {
            let [x, y, z] = &mut self.tip;
            let point = [x.at(at)?, y.at(at)?, z.at(at)?].map(|sample| [sample.position, 0.0, 0.0]);
            let [steps, ..] = self.joint.motion(point);
            let added = self.added.as_mut().map_or(Ok(0.0), |added| added.at(at).map(|sample| sample.position))?;
            Ok::<f64, LawError>(self.law.at(at)?.position - (steps + added))
        };
        off().is_ok_and(|off| off.abs() <= SAME_STEPS)
    }
}

impl ArmPath {
    /// Applies `change` to all its laws.
    fn each(self, change: impl Fn(Law) -> Result<Law, LawError>) -> Option<ArmPath> {
        let [x, y, z] = self.tip;
        let tip = [change(x).ok()?, change(y).ok()?, change(z).ok()?];
        let added = self.added.map(change).transpose().ok()?;
        Some(ArmPath { tip, added, ..self })
    }

    /// The law of the arm's motor.
    fn law(self) -> Result<Law, LawError> {
        let arm = Law::arm(self.joint, self.tip);
        match self.added {
            None => Ok(arm),
            Some(added) => Law::sum(vec![arm, added]),
        }
    }

    /// The motor's position at a time, steps.
    fn position(&self, at: Time) -> Result<f64, LawError> {
        let [steps, ..] = self.joint.motion(self.point(at)?.map(|at| [at, 0.0, 0.0]));
        Ok(steps + self.added.as_ref().map_or(Ok(0.0), |added| position_of(added, at))?)
    }

    /// Where the effector is at a time, mm.
    fn point(&self, at: Time) -> Result<[f64; 3], LawError> {
        let [x, y, z] = &self.tip;
        Ok([position_of(x, at)?, position_of(y, at)?, position_of(z, at)?])
    }

    /// This path as it fades into `new`, which must be of the same joint: see [`Law::faded`].
    fn faded(self, new: ArmPath, from: Time, over: Time) -> Option<ArmPath> {
        let fade = |old: Law, new: Law| old.faded_apart(new, from, over).ok();
        let ([x, y, z], [new_x, new_y, new_z]) = (self.tip, new.tip);
        let tip = [fade(x, new_x)?, fade(y, new_y)?, fade(z, new_z)?];
        let added = match (self.added, new.added) {
            (None, None) => None,
            (old, new) => {
                let rest = |law: Option<Law>| law.map_or_else(|| rest_at(0.0).ok(), Some);
                Some(fade(rest(old)?, rest(new)?)?)
            }
        };
        Some(ArmPath { joint: self.joint, tip, added })
    }
}

/// What an arm does from `from` for `over`, while the effector leaves the path of `old` for that of `new`. `None` if they are no paths of one arm.
pub(super) fn between(old: &Law, new: &Law, from: Time, over: Time) -> Option<Law> {
    let [old, new] = old.paths_to(new, from, over)?;
    old.faded(new, from, over)?.law().ok()
}

fn position_of(law: &Law, at: Time) -> Result<f64, LawError> {
    super::Cursor::new(law).at(at).map(|sample| sample.position)
}

/// Whether two points are the same one.
fn meet(a: [f64; 3], b: [f64; 3]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= SAME_MM)
}

/// For how long a law rests, and where it does; `None` if it does not.
fn rest(law: &Law) -> Option<(Time, f64)> {
    match law {
        Law::Steady(steady) => Some((steady.duration.filter(|_| steady.speed == 0.0)?, 0.0)),
        Law::Changed(changed) => {
            let (duration, at) = rest(&changed.law)?;
            Some((duration + changed.delay, at + changed.shift()?))
        }
        _ => None,
    }
}

/// The path of laws that follow one another: those of one arm, and rests.
fn one_after_the_other(laws: &[Law]) -> Option<ArmPath> {
    // How long the motor rests at first, and where.
    let mut rested: Option<(Time, f64)> = None;
    let mut path: Option<(ArmPath, [Vec<Law>; 3])> = None;
    // Where the effector is after the laws so far.
    let mut ended: Option<[f64; 3]> = None;
    for law in laws {
        match (law.tip_path(), &mut path) {
            (Some(ArmPath { added: Some(_), .. }), _) => return None,
            (Some(own), None) => {
                // Each law begins where the one before ended.
                let moved = rested.map_or(Some(0.0), |(_, at)| Some(at - own.position(Time::ZERO).ok()?))?;
                let added = if moved.abs() <= SAME_STEPS { None } else { Some(rest_at(moved).ok()?) };
                ended = law.end().and_then(|end| own.point(end).ok());
                let [x, y, z] = own.tip.clone().map(|law| vec![law]);
                path = Some((ArmPath { added, ..own }, [x, y, z]));
            }
            (Some(own), Some((first, tip))) => {
                if own.joint != first.joint || !meet(ended?, own.point(Time::ZERO).ok()?) {
                    return None;
                }
                ended = law.end().and_then(|end| own.point(end).ok());
                for (laws, law) in tip.iter_mut().zip(own.tip) {
                    laws.push(law);
                }
            }
            (None, found) => {
                let (duration, at) = rest(law)?;
                match found {
                    None => {
                        let (before, first) = rested.unwrap_or((Time::ZERO, at));
                        rested = Some((before + duration, first));
                    }
                    Some((_, tip)) => {
                        let rest = Law::rest(duration).ok()?;
                        tip.iter_mut().for_each(|laws| laws.push(rest.clone()));
                    }
                }
            }
        }
    }
    let (path, [x, y, z]) = path?;
    let begins = rested.map_or(Time::ZERO, |(duration, _)| duration);
    let joined = |laws: Vec<Law>| Law::then(laws).and_then(|law| law.delayed(begins)).ok();
    Some(ArmPath { tip: [joined(x)?, joined(y)?, joined(z)?], ..path })
}

/// At rest for ever.
fn rest_at(steps: f64) -> Result<Law, LawError> {
    Law::speed(0.0, None)?.shifted(steps)
}

impl Arm {
    /// The law of its own that it has.
    pub(super) const fn law(&self) -> Option<&Law> {
        self.law.as_ref()
    }

    pub(super) const fn tip(&self) -> &[Law; 3] {
        &self.tip
    }

    pub(super) fn end(&self) -> Option<Time> {
        self.law.as_ref().map_or_else(|| latest_end(&self.tip), Law::end)
    }

    pub(super) fn class(&self) -> Class {
        let of_tip = || self.tip.iter().map(Law::class).fold(Class::Enclosed, Class::max);
        self.law.as_ref().map_or_else(of_tip, Law::class)
    }

    pub(super) fn pieces_from(self: Arc<Arm>, at: Time) -> Pieces {
        match &self.law {
            Some(law) => law.pieces_from(at),
            None => Box::new(Composed {
                joint: self.joint,
                coordinates: Together::from(&self.tip, at),
                stretch: None,
                left: Vec::new(),
                at: self.end().map_or(at, |end| at.min(end.before())),
                failed: false,
            }),
        }
    }
}

/// The pieces of an arm, composed of its coordinates' pieces.
struct Composed {
    joint: Joint,
    coordinates: Together,
    /// The coordinates where each has one piece.
    stretch: Option<ArmStretch>,
    /// What is left of it, the next part last.
    left: Vec<(Time, Time)>,
    /// Parts that end before this time are not needed.
    at: Time,
    failed: bool,
}

/// The coordinates between two times.
struct ArmStretch {
    start: Time,
    tip: Arc<[Curve; 3]>,
    terms: Option<Terms>,
    entry: Entry,
}

impl Iterator for Composed {
    type Item = Result<Piece, LawError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        let piece = self.piece().transpose()?;
        self.failed = piece.is_err();
        Some(piece)
    }
}

impl Composed {
    fn piece(&mut self) -> Result<Option<Piece>, LawError> {
        loop {
            let Some((start, end)) = self.left.pop() else {
                let Some((start, end)) = self.coordinates.advance()? else { return Ok(None) };
                let stretch = self.stretch(start)?;
                if stretch.tip.iter().all(Curve::is_constant) {
                    return self.rest(&stretch, start, end).map(Some);
                }
                self.stretch = Some(stretch);
                self.left.push((start, end));
                continue;
            };
            if end <= self.at {
                continue;
            }
            let Some(stretch) = &self.stretch else { return Ok(None) };
            let (zero, a, b) = (stretch.start, (start - stretch.start).seconds(), (end - stretch.start).seconds());
            if let Some(curve) = JointCurve::new(self.joint, &stretch.tip, a, b) {
                let entry = if start == stretch.start { stretch.entry } else { Entry::Continuous };
                let curve = Curve::Joint(curve).accurate_by(stretch.terms.clone());
                return Ok(Some(Piece { zero, start, end, origin: 0, curve, entry }));
            }
            // The halves do not depend on the time from which the law is read.
            let middle = start + (end - start).divided_by(2);
            if (end - start).seconds() < NARROWEST_S {
                let point = stretch.tip.each_ref().map(|curve| curve.value(a));
                return Err(LawError::Undefined { at_s: start.seconds(), why: self.joint.complaint(point) });
            }
            self.left.extend([(middle, end), (start, middle)]);
        }
    }

    /// The coordinates from `start` on, with the time since then.
    fn stretch(&self, start: Time) -> Result<ArmStretch, LawError> {
        let curve = |summand: &Summand| {
            let (mut curve, level) = summand.about(start);
            checked("the effector's position", level.nearest(), "mm", |level| level.abs() <= super::FARTHEST)?;
            curve.raise(level);
            let mut terms = summand.terms_about(start);
            if let Some(terms) = &mut terms {
                terms.raise(level);
            }
            Ok((curve, terms))
        };
        let laws = &self.coordinates.laws;
        let [(x, x_terms), (y, y_terms), (z, z_terms)] = [curve(&laws[0])?, curve(&laws[1])?, curve(&laws[2])?];
        let terms = match (x_terms, y_terms, z_terms) {
            (Some(x), Some(y), Some(z)) => Some(Terms::of_joint(self.joint, [x, y, z])),
            _ => None,
        };
        Ok(ArmStretch { start, tip: Arc::new([x, y, z]), terms, entry: self.coordinates.entry(start) })
    }

    /// The arm while the effector rests.
    fn rest(&self, stretch: &ArmStretch, start: Time, end: Time) -> Result<Piece, LawError> {
        let point = stretch.tip.each_ref().map(|curve| curve.value(0.0));
        let steps = match &stretch.terms {
            Some(terms) => terms.at(0.0, &[])[0].value,
            None => Double::from(self.joint.motion(point.map(|at| [at, 0.0, 0.0]))[0]),
        };
        if !steps.is_finite() {
            return Err(LawError::Undefined { at_s: start.seconds(), why: self.joint.complaint(point) });
        }
        let rest = Piece::rest(start, end, steps)?;
        Ok(Piece { entry: stretch.entry, ..rest })
    }
}

/// A piece as the text of a polynomial of the time since `start`.
fn in_powers_of_t(piece: &Piece, start: Time) -> Result<String, LawError> {
    let mut curve = piece.curve.clone();
    curve.rezero(Double::from(start) - Double::from(piece.zero));
    let Curve::Polynomial(mut c) = curve.plain() else {
        return Err(LawError::Parameter("a part of the path is no polynomial".into()));
    };
    c.resize(c.len().max(1), 0.0);
    c[0] += piece.origin as f64;
    let mut terms = c.iter().rev();
    let highest = terms.next().map_or_else(String::new, |c| format!("({c:?})"));
    Ok(terms.fold(highest, |text, c| format!("({text}*t + ({c:?}))")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::double::ULP;
    use crate::law::{Cursor, Ease, Interpolation, fade_weight};
    use crate::time::Rate;
    use dashu::base::Abs;
    use dashu::float::FBig;
    use dashu::float::round::mode::HalfEven;

    const ROBOT: Delta = Delta { base_mm: 60.0, upper_arm_mm: 70.0, forearm_mm: 150.0, effector_mm: 25.0 };
    const STEPS_PER_RAD: f64 = 509.295_817_894_065_1;

    fn s(seconds: f64) -> Time {
        Time::from_seconds(seconds)
    }

    fn table(values: [f64; 4]) -> Law {
        let rows: Vec<(f64, f64)> = [0.0, 0.5, 1.25, 2.0].into_iter().zip(values).collect();
        Law::table(&rows, Interpolation::Monotone).unwrap()
    }

    fn at_rest(mm: f64) -> Law {
        rest_at(mm).unwrap()
    }

    /// A path of a table.
    fn rows() -> [Law; 3] {
        [table([0.0, 30.0, 30.0, -20.0]), table([0.0, 10.0, -40.0, -40.0]), table([-150.0, -140.0, -160.0, -150.0])]
    }

    /// A circle of formulas, for 4 s.
    fn circle(radius: f64, hz: f64) -> [Law; 3] {
        let formula = |text: &str| {
            let where_ = [("r".to_owned(), radius), ("f".to_owned(), hz)];
            Law::formula(text, &where_, 1.0, Some(s(4.0))).unwrap()
        };
        [formula("r*cos(2*pi*f*t)"), formula("r*sin(2*pi*f*t)*exp(-t/9)"), at_rest(-145.0)]
    }

    /// A sum, a sinusoid and a line.
    fn sums() -> [Law; 3] {
        let sine = |amplitude, period_s| Law::sine(amplitude, s(period_s), None).unwrap();
        [
            Law::sum(vec![sine(9.0, 1.3), sine(4.0, 0.4)]).unwrap(),
            sine(-12.0, 0.9),
            Law::speed(-3.0, Some(s(3.0))).unwrap().shifted(-140.0).unwrap(),
        ]
    }

    fn arms(tip: &[Law; 3]) -> [Law; 3] {
        [0, 1, 2].map(|arm| Law::arm(Joint::new(ROBOT, arm, STEPS_PER_RAD), tip.clone()))
    }

    /// Arms of a path from a file, each with a law of its own.
    fn arms_of_file(tip: &[Law; 3]) -> [Law; 3] {
        [0, 1, 2].map(|arm| Law::delta_arm(&ROBOT, arm, tip, STEPS_PER_RAD).unwrap())
    }

    fn position(law: &Law, at: Time) -> f64 {
        Cursor::new(law).at(at).unwrap().position
    }

    fn point(tip: &[Law; 3], at: Time) -> [f64; 3] {
        tip.each_ref().map(|law| position(law, at))
    }

    fn mixed(old: [f64; 3], new: [f64; 3], w: f64) -> [f64; 3] {
        [0, 1, 2].map(|k| (1.0 - w) * old[k] + w * new[k])
    }

    fn weight(at: f64, from: f64, over: f64) -> f64 {
        fade_weight(((at - from) / over).clamp(0.0, 1.0))[0]
    }

    /// The effector is where `wanted` says, by the robot's forward kinematics; the pieces join, and their bounds hold.
    #[track_caller]
    fn check(arms: &[Law; 3], until_s: f64, wanted: impl Fn(f64) -> [f64; 3]) {
        let mut cursors = arms.each_ref().map(Cursor::new);
        for k in 0..=400 {
            let at_s = until_s * f64::from(k) / 400.0;
            let angles = cursors.each_mut().map(|cursor| cursor.at(s(at_s)).unwrap().position / STEPS_PER_RAD);
            let tip = ROBOT.point(angles).unwrap();
            let off = tip.iter().zip(wanted(at_s)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off < 1e-9, "{off} mm off at {at_s} s");
        }
        for law in arms {
            let mut end = (Time::ZERO, None);
            for piece in law.pieces().take_while(|piece| piece.as_ref().unwrap().start < s(until_s)) {
                let piece = piece.unwrap();
                assert_eq!(piece.start, end.0);
                let begins = piece.first_position();
                assert!(
                    end.1.is_none_or(|at: Double| (at - begins).nearest().abs() < 1e-9),
                    "at {}",
                    piece.start.seconds()
                );
                end = (piece.end, Some(piece.last_position()));
                bounds_hold(&piece);
            }
        }
    }

    /// A jet at one place of a piece, moved to another, is the jet there.
    fn bounds_hold(piece: &Piece) {
        let (a, b) = (piece.first(), piece.last());
        let bounds = piece.curve.bounds(a, b);
        let reach = (b - a) / 6.0;
        for k in 0..6 {
            let from = a + reach * f64::from(k);
            let (from, to) = (piece.curve.jet(from), piece.curve.jet(from + reach));
            for order in 0..8 {
                let (mut sum, mut choose, mut power, mut doubt) = (from[order], 1.0, 1.0, bounds.rounding[order]);
                let ahead = from.iter().zip(bounds.rounding).chain([(&0.0, bounds.eighth)]).enumerate();
                for (i, (c, off)) in ahead.skip(order + 1) {
                    choose *= i as f64 / (i - order) as f64;
                    power *= reach;
                    sum += choose * c * power;
                    doubt += choose * (off + 8.0 * ULP * c.abs()) * power;
                }
                let off = (sum - to[order]).abs();
                assert!(
                    off <= doubt + bounds.rounding[order] + 4.0 * ULP * to[order].abs(),
                    "order {order}: {off:e}, {doubt:e}"
                );
            }
        }
    }

    #[test]
    fn arms_follow_coordinates_of_any_kind() {
        for tip in [rows(), circle(30.0, 0.8), sums()] {
            check(&arms(&tip), 2.9, |at| point(&tip, s(at)));
        }
    }

    #[test]
    fn a_table_of_an_arm_is_the_same_law_and_a_path() {
        let tip = rows();
        for (law, composed) in arms_of_file(&tip).iter().zip(&arms(&tip)) {
            assert_eq!(law.end(), Some(s(2.0)));
            for k in 0..=200 {
                let at = s(f64::from(k) / 100.0);
                assert!((position(law, at) - position(composed, at)).abs() < 1e-9, "at {} s", at.seconds());
            }
        }
        check(&arms_of_file(&tip), 2.0, |at| point(&tip, s(at)));
    }

    #[test]
    fn the_tip_of_a_fade_stays_on_the_blend_of_both_paths() {
        for (old, new) in [(rows(), circle(40.0, 0.7)), (circle(20.0, 1.0), sums()), (sums(), rows())] {
            let (from, over) = (0.4, 0.9);
            let fade = |k: usize| arms(&old)[k].clone().faded(arms(&new)[k].clone(), s(from), s(over)).unwrap();
            let law = [0, 1, 2].map(fade);
            let wanted = |at| mixed(point(&old, s(at)), point(&new, s(at)), weight(at, from, over));
            check(&law, 1.9, wanted);
            // An arm that fades alone leaves it.
            let apart = arms(&old)[0].clone().faded_apart(arms(&new)[0].clone(), s(from), s(over)).unwrap();
            assert!((position(&apart, s(0.85)) - position(&law[0], s(0.85))).abs() > 1e-3);
        }
    }

    /// Two fades, the second one from within the first; and all of it slowed down, and delayed.
    #[test]
    fn fades_within_fades_stay_on_their_path() {
        let (a, b, c) = (rows(), circle(35.0, 0.6), circle(15.0, 1.1));
        let fade =
            |old: &Law, new: &Law, from: f64, over: f64| old.clone().faded(new.clone(), s(from), s(over)).unwrap();
        let law = |k: usize| fade(&fade(&arms_of_file(&a)[k], &arms(&b)[k], 0.3, 0.8), &arms(&c)[k], 0.7, 0.9);
        let laws = [0, 1, 2].map(law);
        let wanted = |at: f64| {
            let first = mixed(point(&a, s(at)), point(&b, s(at)), weight(at, 0.3, 0.8));
            mixed(first, point(&c, s(at)), weight(at, 0.7, 0.9))
        };
        check(&laws, 2.5, wanted);
        let half = Rate::of(0.5).unwrap();
        let ease = Ease { before: Rate::ONE, after: s(0.2), over: s(0.4), to: half };
        let slow = laws.clone().map(|law| law.retimed(s(0.1), ease).unwrap().delayed(s(0.5)).unwrap());
        let time = |at: f64| {
            let x = ((at - 0.7) / 0.4).clamp(0.0, 1.0);
            let eased = 0.4 * (x - 0.5 * (x * x * x - 0.5 * x * x * x * x));
            0.1 + (at - 0.5).clamp(0.0, 0.2) + eased + 0.5 * (at - 1.1).max(0.0)
        };
        check(&slow, 3.5, |at| wanted(time(at)));
        // A change from there on.
        let changed = [0, 1, 2].map(|k| fade(&slow[k], &arms(&b)[k], 1.0, 1.0));
        check(&changed, 2.4, |at| mixed(wanted(time(at)), point(&b, s(at)), weight(at, 1.0, 1.0)));
        let halted = laws.map(|law| law.eased_out(s(0.1), s(0.5), s(0.2)).unwrap());
        let time = |at: f64| {
            let x = ((at - 0.5) / 0.2).clamp(0.0, 1.0);
            0.1 + at.min(0.5) + 0.2 * (x - x * x * x + 0.5 * x * x * x * x)
        };
        check(&halted, 0.7, |at| wanted(time(at)));
    }

    #[test]
    fn paths_with_rests_and_several_parts_fade_as_paths() {
        let then = |tips: [[Law; 3]; 2], k: usize| {
            let [first, second] = tips.map(|tip| arms_of_file(&tip)[k].clone());
            let begins = position(&first, Time::ZERO);
            let rest = Law::rest(s(0.3)).unwrap();
            Law::then(vec![rest.clone().shifted(begins).unwrap(), first, rest, second]).unwrap()
        };
        let back =
            [table([-20.0, 0.0, 0.0, 5.0]), table([-40.0, 0.0, 0.0, 5.0]), table([-150.0, -140.0, -140.0, -145.0])];
        let (old, new) = (rows(), circle(20.0, 0.5));
        let path = |at: f64| match at {
            at if at < 2.6 => point(&old, s((at - 0.3).clamp(0.0, 2.0))),
            at => point(&back, s(at - 2.6)),
        };
        let fade =
            |k: usize| then([old.clone(), back.clone()], k).faded(arms(&new)[k].clone(), s(1.9), s(1.5)).unwrap();
        check(&[0, 1, 2].map(fade), 3.9, |at| mixed(path(at), point(&new, s(at)), weight(at, 1.9, 1.5)));
        // A motor that counts from where it begins to rest keeps its count.
        let counts = Law::then(vec![Law::rest(s(0.3)).unwrap(), arms(&old)[1].clone()]).unwrap();
        let faded = counts.clone().faded(arms(&new)[1].clone(), s(0.5), s(0.5)).unwrap();
        let moved = position(&arms(&old)[1], Time::ZERO);
        let joint = Joint::new(ROBOT, 1, STEPS_PER_RAD);
        let tip = mixed(point(&old, s(0.45)), point(&new, s(0.75)), 0.5);
        let wanted = joint.motion(tip.map(|at| [at, 0.0, 0.0]))[0] - 0.5 * moved;
        assert!((position(&faded, s(0.75)) - wanted).abs() < 1e-9);
    }

    /// A sequence goes on from where the arm's angle is. If the effector would leap there, the arm's angle and the path are no longer the same motion.
    #[test]
    fn paths_that_leap_are_none() {
        let open = arms_of_file(&rows()).map(|law| law.repeated(Some(3)).unwrap());
        let twice = [0, 1, 2].map(|k| {
            let once = arms_of_file(&rows())[k].clone();
            Law::then(vec![once.clone(), Law::rest(s(0.1)).unwrap(), once]).unwrap()
        });
        for law in open.iter().chain(&twice) {
            assert_eq!(law.tip_path(), None);
        }
        let once = arms_of_file(&rows()).map(|law| law.repeated(Some(1)).unwrap());
        assert!(once.iter().all(|law| law.tip_path().is_some()));
        let loops =
            [table([0.0, 30.0, 30.0, 0.0]), table([5.0, 10.0, -40.0, 5.0]), table([-150.0, -140.0, -160.0, -150.0])];
        let closed = arms_of_file(&loops).map(|law| law.repeated(None).unwrap());
        let (from, over) = (6.3, 0.9);
        let faded = [0, 1, 2].map(|k| closed[k].clone().faded(arms(&sums())[k].clone(), s(from), s(over)).unwrap());
        check(&faded, 7.2, |at| mixed(point(&loops, s(at % 2.0)), point(&sums(), s(at)), weight(at, from, over)));
        // Open ones fade by themselves, from where they are.
        let faded = open[0].clone().faded(arms(&sums())[0].clone(), s(3.0), s(1.0)).unwrap();
        let half = 0.5 * (position(&open[0], s(3.5)) + position(&arms(&sums())[0], s(3.5)));
        assert!((position(&faded, s(3.5)) - half).abs() < 1e-9);
    }

    #[test]
    fn laws_of_other_robots_and_motors_fade_by_themselves() {
        let longer = Delta { forearm_mm: 151.0, ..ROBOT };
        let tip = circle(20.0, 0.5);
        let own = Law::arm(Joint::new(ROBOT, 0, 100.0), tip.clone());
        for other in [
            Law::arm(Joint::new(longer, 0, 100.0), tip.clone()),
            Law::arm(Joint::new(ROBOT, 1, 100.0), tip.clone()),
            own.clone().scaled(0.5).unwrap(),
            at_rest(10.0),
        ] {
            let faded = own.clone().faded(other.clone(), s(0.5), s(1.0)).unwrap();
            let wanted = 0.5 * (position(&own, s(1.0)) + position(&other, s(1.0)));
            assert!((position(&faded, s(1.0)) - wanted).abs() < 1e-9);
        }
    }

    #[test]
    fn the_slack_of_arms_fades_beside_the_path() {
        let tips = [circle(20.0, 0.9), circle(30.0, 0.9)];
        let with_slack = |tip: &[Law; 3]| arms(tip)[0].clone().with_backlash(6.0, s(0.05)).unwrap();
        let [old, new] = tips.each_ref().map(with_slack);
        let faded = old.clone().faded(new.clone(), s(1.0), s(1.0)).unwrap();
        let slack = |law: &Law, tip: &[Law; 3], at: Time| position(law, at) - position(&arms(tip)[0], at);
        let joint = Joint::new(ROBOT, 0, STEPS_PER_RAD);
        for k in 0..=20 {
            let at_s = 1.0 + f64::from(k) / 20.0;
            let w = weight(at_s, 1.0, 1.0);
            let tip = mixed(point(&tips[0], s(at_s)), point(&tips[1], s(at_s)), w);
            let slacks = [slack(&old, &tips[0], s(at_s)), slack(&new, &tips[1], s(at_s))];
            let wanted = joint.motion(tip.map(|at| [at, 0.0, 0.0]))[0] + (1.0 - w) * slacks[0] + w * slacks[1];
            assert!((position(&faded, s(at_s)) - wanted).abs() < 1e-8, "at {at_s} s");
        }
    }

    #[test]
    fn an_arm_that_does_not_reach_says_so() {
        let tip = [at_rest(0.0), at_rest(0.0), Law::speed(-30.0, None).unwrap().shifted(-150.0).unwrap()];
        let error = arms(&tip)[0].pieces().find_map(Result::err).unwrap();
        let LawError::Undefined { at_s, why } = error else { panic!("{error}") };
        // √((70 + 150)² − 35²) below the shafts.
        let reach = (f64::sqrt(220.0 * 220.0 - 35.0 * 35.0) - 150.0) / 30.0;
        assert!((at_s - reach).abs() < 1e-6, "{at_s}, not {reach}");
        assert!(why.starts_with("the effector cannot be at (0.000, 0.000, -217.198) mm: "), "{why}");
        let still = arms(&[at_rest(0.0), at_rest(0.0), at_rest(20.0)]);
        assert!(matches!(still[0].pieces().next(), Some(Err(LawError::Undefined { .. }))));
    }

    /// Pieces from any time on are those of the whole law.
    #[test]
    fn pieces_are_the_same_wherever_one_begins() {
        let law = arms(&rows())[0].clone().faded(arms(&circle(40.0, 0.7))[0].clone(), s(0.4), s(0.9)).unwrap();
        let begun = law.pieces().map(Result::unwrap).take_while(|piece| piece.start < s(6.0));
        let all: Vec<(Time, Time)> = begun.map(|piece| (piece.start, piece.end)).collect();
        assert!(all.len() > 10);
        for k in 0..40 {
            let at = s(0.1 * f64::from(k) + 0.01);
            let piece = law.pieces_from(at).next().unwrap().unwrap();
            assert!(all.contains(&(piece.start, piece.end)) && piece.start <= at, "at {} s", at.seconds());
            assert!(piece.end > at, "at {} s", at.seconds());
        }
    }

    type Wide = FBig<HalfEven, 2>;

    fn wide(x: f64) -> Wide {
        Wide::try_from(x).unwrap().with_precision(300).value()
    }

    /// The arm's position by the law of cosines, to 300 bits.
    fn exact(arm: usize, [x, y, z]: [Wide; 3]) -> Wide {
        let third = wide(1.0).atan() * wide(8.0) / wide(3.0);
        let angle = third * wide(arm as f64);
        let (sin, cos) = if arm == 0 { (wide(0.0), wide(1.0)) } else { angle.sin_cos() };
        let out = &cos * &x + &sin * &y + wide(25.0 - 60.0);
        let aside = &cos * &y - &sin * &x;
        let distance = &out * &out + &z * &z;
        let below = wide(150.0) * wide(150.0) - &aside * &aside;
        let cosine = (&distance + wide(70.0) * wide(70.0) - below) / (wide(140.0) * distance.clone().sqrt());
        let quarter = wide(1.0).atan() * wide(2.0);
        (quarter + (out / z).atan() - cosine.acos()) * wide(STEPS_PER_RAD)
    }

    /// During a fade of formulas the position is known to far more than f64 holds.
    #[test]
    fn a_fade_of_formulas_is_known_to_90_bits() {
        let tip = |a: f64, hz: f64| {
            let text = |text: &str| Law::formula(text, &[], 1.0, None).unwrap();
            [text(&format!("{a}*sin({hz}*t)")), text(&format!("{a}*cos({hz}*t)")), text("-140 - 3*t^2")]
        };
        let (old, new) = (tip(16.0, 2.0), tip(24.0, 3.0));
        let faded = arms(&old)[0].clone().faded(arms(&new)[0].clone(), s(0.5), s(1.0)).unwrap();
        let mut seen = 0;
        for piece in faded.pieces_from(s(0.5)).map(Result::unwrap).take_while(|piece| piece.start < s(1.5)) {
            let at = piece.start + (piece.end - piece.start).divided_by(3);
            let u = (at - piece.zero).seconds();
            let (hi, lo) = piece.curve.split_value(u);
            let t = wide(piece.zero.seconds()) + wide(u);
            let x = &t - wide(0.5);
            let w = &x * &x * &x * (wide(10.0) + &x * (wide(6.0) * &x - wide(15.0)));
            let mix = |f: fn(Wide) -> Wide| {
                let old = wide(16.0) * f(wide(2.0) * &t);
                &old + &w * (wide(24.0) * f(wide(3.0) * &t) - &old)
            };
            let z = wide(-140.0) - wide(3.0) * &t * &t;
            let wanted = exact(0, [mix(|t| t.sin()), mix(|t| t.cos()), z]);
            let is = wide(hi) + wide(lo) + wide(piece.origin as f64);
            let off = (is - wanted).abs().to_f64().value();
            assert!(piece.curve.is_accurate() && off < 1e-24, "{off:e} at {} s", at.seconds());
            seen += 1;
        }
        assert!(seen > 3);
    }
}
