//! θ(t): a law is a stream of analytic pieces, in order, without gaps.
//!
//! All other crates see a law as [`Piece`]s: the planner expands their [`Curve`]s, the verdict follows them with a [`Cursor`]. A new
//! law needs only to return its pieces.
//!
//! # What is here
//! - [`Law`]: the laws and their combinations, each checked when it is made
//! - [`formula`]: θ(t) in text, with interval enclosures
//! - [`winch`]: the path of a StepperWinch board under commands
//! - [`cursor`]: position, speed and acceleration at a time
//! - [`curve`]: the analytic curves: jets, bounds, inverses
//!
//! Each constructor checks its parameters and returns [`LawError::Parameter`] that names the one out of range.

mod accurate;
mod arm;
mod backlash;
mod blend;
mod circle;
mod combine;
pub mod cursor;
pub mod curve;
pub(crate) mod double;
pub(crate) mod extent;
mod fade;
pub mod formula;
mod joint;
mod lorenz;
mod pace;
mod profile;
mod smoothing;
mod steady;
mod table;
mod timer_ramp;
mod warp;
pub mod winch;
mod workload;

use crate::Time;
pub use arm::{Arm, ArmPath, PathPair};
pub use backlash::{Backlash, Compensation};
pub use blend::{Begin, Behind, Blended, End};
pub use circle::{Circle, dds_period};
pub use combine::{Changed, Repeated, Sequence};
pub use cursor::{Cursor, Sample};
pub use curve::{Bounds, Curve, Inverse, Jet};
use double::Double;
pub use fade::{Faded, fade_weight};
pub use formula::{FormulaError, FormulaFunction, ParameterUse, formula_functions};
pub use joint::{Joint, JointCurve};
pub use lorenz::{Lorenz, Orbit};
pub use pace::Pace;
pub use profile::SCurve;
pub use smoothing::{CUT_OFF, least_smoothing};
use std::ops::RangeInclusive;
use std::sync::Arc;
pub use steady::{LinePart, Steady};
pub use table::{Distance, Interpolation, TableLaw};
pub use timer_ramp::TimerRamp;
pub use warp::{Ease, Warped};
pub use winch::{WinchCommand, WinchSettings};
pub use workload::Workload;

/// A stretch of a law on which θ is one analytic curve: θ(t) = `origin` + `curve`(t − `zero`), for t in `start..=end`.
#[derive(Clone, Debug, PartialEq)]
pub struct Piece {
    /// The law time at which the curve's own time u is 0 s. Near `start`, so that u keeps its precision.
    pub zero: Time,
    /// Where the piece begins.
    pub start: Time,
    /// Where it ends; finite, beyond `start`.
    pub end: Time,
    /// Whole steps added to the curve, so that endless laws lose no precision.
    pub origin: i64,
    /// θ − `origin`, steps, against u, seconds.
    pub curve: Curve,
    /// What may change abruptly where this piece begins.
    pub entry: Entry,
}

impl Piece {
    /// The curve's own time at `start`, seconds.
    #[must_use]
    pub fn first(&self) -> f64 {
        (self.start - self.zero).seconds()
    }

    /// The curve's own time at `end`, seconds.
    #[must_use]
    pub fn last(&self) -> f64 {
        (self.end - self.zero).seconds()
    }

    /// θ at the curve's own time u, with the whole steps, to the precision of f64.
    fn rough_position(&self, u: f64) -> Double {
        Double::from(self.origin) + Double::from(self.curve.value(u))
    }

    /// θ at the curve's own time u, with the whole steps, as precisely as it is known.
    fn position(&self, u: f64) -> Double {
        let (value, rest) = self.curve.split_value(u);
        Double::from(self.origin) + Double::from(value) + Double::from(rest)
    }

    /// θ where the piece begins.
    fn first_position(&self) -> Double {
        self.position(self.first())
    }

    /// θ where the piece ends.
    fn last_position(&self) -> Double {
        self.position(self.last())
    }

    /// Adds `steps` to θ.
    fn raise(&mut self, steps: Double) -> Result<(), LawError> {
        let too_far = || LawError::Parameter("the position leaves ±2^62 steps".into());
        let (whole, rest) = steps.split().ok_or_else(too_far)?;
        self.origin = self.origin.checked_add(whole).ok_or_else(too_far)?;
        if rest != Double::ZERO {
            self.curve.raise(rest);
        }
        Ok(())
    }

    /// Moves the piece to a later time, by `by`.
    fn postpone(&mut self, by: Time) {
        self.zero = self.zero + by;
        self.start = self.start + by;
        self.end = self.end + by;
    }

    /// The number of the [part](Piece::part) that has the time `at`.
    fn part_at(&self, at: Time) -> i128 {
        // Part 0 is twice as long, on both sides of the zero.
        match (at - self.zero).raw().div_euclid(Time::from_seconds(LONGEST_PART_S).raw()) {
            k @ ..=-2 => k + 1,
            k => k.max(0),
        }
    }

    /// The range of the numbers of its [parts](Piece::part).
    fn parts(&self) -> RangeInclusive<i128> {
        match &self.curve {
            Curve::Polynomial(c) if c.len() > 1 => self.part_at(self.start)..=self.part_at(self.end.before()),
            _ => 0..=0,
        }
    }

    /// Part `k` of [`parts`](Piece::parts). A part of a polynomial counts its time from its own start, so that f64 resolves it. Only the parts
    /// next to the piece's zero keep that zero.
    fn part(&self, k: i128, parts: &RangeInclusive<i128>) -> Result<Piece, LawError> {
        let part = Time::from_seconds(LONGEST_PART_S);
        let begins = |k: i128| self.zero + Time::from_raw(part.raw() * if k > 0 { k } else { k - 1 });
        let mut cut = self.clone();
        if k > *parts.start() {
            cut.start = begins(k);
            cut.entry = Entry::Continuous;
        }
        if k < *parts.end() {
            cut.end = begins(k + 1);
        }
        if let (Curve::Polynomial(c), true) = (&mut cut.curve, k != 0) {
            cut.zero = begins(k);
            let level = curve::shift(c, Double::from(cut.zero) - Double::from(self.zero));
            c[0] = 0.0;
            cut.raise(level)?;
        }
        Ok(cut)
    }

    /// Its parts from the one on that has the time `at`: all if that is before it, the last if it is after it.
    fn cut(self, at: Time) -> impl Iterator<Item = Result<Piece, LawError>> {
        let parts = self.parts();
        let first = self.part_at(at).clamp(*parts.start(), *parts.end());
        (first..=*parts.end()).map(move |k| self.part(k, &parts))
    }

    /// A piece of rest at `position`.
    fn rest(start: Time, end: Time, position: Double) -> Result<Piece, LawError> {
        let curve = Curve::constant(0.0);
        let mut piece = Piece { zero: start, start, end, origin: 0, curve, entry: Entry::Continuous };
        piece.raise(position)?;
        Ok(piece)
    }
}

/// A piece of a polynomial that is longer is divided into parts, s. In this time, f64 resolves far less than a tick of 1 ns.
const LONGEST_PART_S: f64 = 32_768.0;

/// What may change abruptly at the beginning of a piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entry {
    /// Position must be continuous; speed may change by no more than the motor's pull-in rate.
    Continuous,
    /// The file has `jump`: speed may change by any amount, but position must be continuous.
    SpeedJump,
}

/// What a certificate compares step times with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Class {
    /// Step times have a formula.
    ClosedForm,
    /// Interval arithmetic encloses the crossings, so that none is missed.
    Enclosed,
    /// Step times are exact for an interpolant, through data or through the solution of an ODE.
    Interpolant,
}

/// Why a law cannot be followed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LawError {
    /// θ is not a number there.
    #[error("θ is undefined at t = {at_s} s: {why}")]
    Undefined {
        /// Law time, s.
        at_s: f64,
        /// What breaks, in the user's words.
        why: String,
    },
    /// θ jumps.
    #[error("θ jumps at t = {at_s} s from {from} to {to} steps; a motor cannot")]
    Jump {
        /// Law time, s.
        at_s: f64,
        /// Steps, before.
        from: f64,
        /// Steps, after.
        to: f64,
    },
    /// The motor turns round before it has taken up the backlash of its last turn.
    #[error(
        "it turns at t = {at_s} s, while the slack of its turn before is taken up until {until_s} s: `over`, the time of its `backlash`, \
         must be shorter"
    )]
    Backlash {
        /// Law time, s.
        at_s: f64,
        /// When it would be taken up, s.
        until_s: f64,
    },
    /// A parameter is out of its range.
    #[error("{0}")]
    Parameter(String),
}

/// The pieces of a law, in order of time, without gaps, from t = 0 s. For an endless law they do not end.
///
/// The iterator owns its part of the law, so that it can be stored, and sent to another thread.
pub type Pieces = Box<dyn Iterator<Item = Result<Piece, LawError>> + Send>;

/// A motion law θ(t), t ≥ 0 s, θ in steps. Copies share what is large.
#[derive(Clone, Debug, PartialEq)]
pub enum Law {
    /// The tutorial's sinusoid: θ = A − A·cos(2πt/T), in half periods.
    Sine(Sine),
    /// Constant speed, rest included.
    Steady(Steady),
    /// Pieces that were worked out beforehand: trapezoids, S-curves, ramps.
    Fixed(Fixed),
    /// Through or near the rows of a table.
    Table(TableLaw),
    /// One coordinate of a circle.
    Circle(Circle),
    /// One coordinate of an orbit of the Lorenz equations.
    Lorenz(Lorenz),
    /// θ(t) in text.
    Formula(Arc<formula::Formula>),
    /// StepperWinch's path under a list of timed commands.
    Winch(Arc<winch::Winch>),
    /// The sum of several laws.
    Sum(Arc<[Law]>),
    /// Several laws, one after the other, each from where the one before ended.
    Then(Arc<Sequence>),
    /// One law scaled, shifted or delayed.
    Changed(Arc<Changed>),
    /// A law that repeats.
    Repeated(Arc<Repeated>),
    /// A law with a ramp at its beginning or its end.
    Blended(Arc<Blended>),
    /// A law whose own time slows to a halt, or starts from one: pause and resume.
    Warped(Arc<Warped>),
    /// A law that changes into another one.
    Faded(Arc<Faded>),
    /// What an arm of a delta robot does while its effector follows a path.
    Arm(Arc<Arm>),
    /// A law with the extra steps that take up backlash at its turns.
    Backlash(Arc<Backlash>),
    /// Only the extra steps that take up backlash at a law's turns.
    Compensation(Arc<Compensation>),
}

/// θ = A − A·cos(2πt/T). Source: the tutorial, eq. 1.
#[derive(Clone, Debug, PartialEq)]
pub struct Sine {
    /// A, steps; may be negative, not 0.
    pub amplitude: f64,
    /// T.
    pub period: Time,
    /// Number of periods; `None`: endless.
    pub cycles: Option<u64>,
}

/// A finite list of pieces.
#[derive(Clone, Debug, PartialEq)]
pub struct Fixed {
    /// In order, without gaps, from t = 0 s.
    pub pieces: Arc<Vec<Piece>>,
    /// What its certificate is relative to.
    pub class: Class,
}

impl Law {
    /// θ = A − A·cos(2πt/T): `amplitude` A in steps, `cycles` periods or endless. Source: the tutorial, eq. 1.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time};
    /// assert!(Law::sine(2000.0, Time::SECOND, Some(10)).is_ok());
    /// assert!(Law::sine(2000.0, Time::ZERO, Some(10)).is_err());
    /// ```
    ///
    /// # Errors
    /// [`LawError::Parameter`] if the amplitude is 0 or not finite, or the period or the number of cycles not positive.
    pub fn sine(amplitude: f64, period: Time, cycles: Option<u64>) -> Result<Law, LawError> {
        checked("amplitude", amplitude, "steps", |a| a != 0.0 && a.abs() < FARTHEST)?;
        // A half period is a piece and must not be empty; the end must be a time.
        if period < Time::from_seconds(1e-12) || period > Time::from_seconds(1e12) {
            return Err(LawError::Parameter(format!("period is {} s; it must be 1e-12 to 1e12 s", period.seconds())));
        }
        if cycles == Some(0) {
            return Err(LawError::Parameter("cycles is 0; it must be at least 1".into()));
        }
        Ok(Law::Sine(Sine { amplitude, period, cycles }))
    }

    /// The sweep article's sweep: a sinusoid from the bottom at rest, endless, after `delay` at rest; `swing_steps` may be odd.
    ///
    /// θ = swing/2·(1 − cos 2πf(t − delay)).
    ///
    /// # Errors
    /// [`LawError::Parameter`] if the frequency is not positive or the swing is 0.
    pub fn sweep(frequency_hz: f64, swing_steps: u64, delay: Time) -> Result<Law, LawError> {
        checked("frequency", frequency_hz, "Hz", |f| f > 0.0 && f < 1e12)?;
        Law::sine(0.5 * swing_steps as f64, Time::from_seconds(1.0 / frequency_hz), None)?.delayed(delay)
    }

    /// Pieces of polynomials of any degree, one after the other: each its duration and its coefficients,
    /// steps/s^k, of the time since it began; relative to the interpolant. For Taylor solutions of ODEs.
    ///
    /// # Errors
    /// [`LawError::Parameter`] if a duration is not positive or a coefficient not finite,
    /// [`LawError::Jump`] where two pieces do not meet within 1e-6 step.
    pub fn polynomials(pieces: impl IntoIterator<Item = (Time, Vec<f64>)>) -> Result<Law, LawError> {
        let mut laid: Vec<Piece> = Vec::new();
        for (row, (duration, c)) in pieces.into_iter().enumerate() {
            if duration <= Time::ZERO || c.iter().any(|c| !c.is_finite()) {
                return Err(LawError::Parameter(format!(
                    "piece {row}: the duration must be positive and every coefficient a number"
                )));
            }
            let start = laid.last().map_or(Time::ZERO, |p| p.end);
            let curve = Curve::Polynomial(c);
            let piece = Piece { zero: start, start, end: start + duration, origin: 0, curve, entry: Entry::Continuous };
            if let Some(before) = laid.last() {
                meet(before.last_position(), &piece, 1e-6)?;
            }
            laid.push(piece);
        }
        Law::fixed(laid, Class::Interpolant)
    }

    /// A law of pieces that are known to be in order.
    fn fixed(pieces: Vec<Piece>, class: Class) -> Result<Law, LawError> {
        if pieces.is_empty() {
            return Err(LawError::Parameter("the motion is empty".into()));
        }
        Ok(Law::Fixed(Fixed { pieces: Arc::new(pieces), class }))
    }

    /// The pieces from t = 0 s on.
    #[must_use]
    pub fn pieces(&self) -> Pieces {
        self.pieces_from(Time::ZERO)
    }

    /// The pieces of [`pieces`](Law::pieces) from the one on in which `at` is: from `start` up to, not including, `end`. After the law's end,
    /// only the last one.
    ///
    /// The pieces before it are not worked out, except for an orbit, a winch's path and backlash, which depend on all that was before. So a
    /// law that breaks before `at` may not tell.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time};
    /// let law = Law::sine(100.0, Time::SECOND, None)?;
    /// let piece = law.pieces_from(Time::from_seconds(1e6 + 0.7)).next().unwrap()?;
    /// assert_eq!(piece.start, Time::from_seconds(1e6 + 0.5));
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    #[must_use]
    pub fn pieces_from(&self, at: Time) -> Pieces {
        let at = at.max(Time::ZERO);
        // Each begins at the piece that has `at`, or somewhat before it.
        let pieces: Pieces = match self.clone() {
            Law::Sine(sine) => {
                Box::new((sine.half_period_at(at)..sine.half_periods()).map(move |k| Ok(sine.half_period(k))))
            }
            Law::Steady(steady) => Box::new(steady.pieces_from(at)),
            Law::Fixed(fixed) => Box::new(fixed.pieces_from(at)),
            Law::Table(table) => Box::new(table.pieces_from(at)),
            Law::Circle(circle) => Box::new(circle.pieces_from(at)),
            Law::Lorenz(lorenz) => Box::new(lorenz.pieces()),
            Law::Formula(formula) => Box::new(formula.pieces_from(at)),
            Law::Winch(winch) => Box::new(winch.pieces()),
            Law::Sum(laws) => Box::new(combine::sum_from(&laws, at)),
            Law::Then(laws) => Box::new(laws.pieces_from(at)),
            Law::Changed(changed) => Box::new(changed.pieces_from(at)),
            Law::Repeated(repeated) => Box::new(repeated.pieces_from(at)),
            Law::Blended(blended) => Box::new(blended.pieces_from(at)),
            Law::Warped(warped) => Box::new(warped.pieces_from(at)),
            Law::Faded(faded) => Box::new(faded.pieces_from(at)),
            Law::Arm(arm) => arm.pieces_from(at),
            Law::Backlash(backlash) => Box::new(backlash.pieces_from(at)),
            Law::Compensation(slack) => Box::new(slack.pieces()),
        };
        #[cfg(test)]
        let pieces: Pieces = Box::new(pieces.inspect(|_| WORKED_OUT.set(WORKED_OUT.get() + 1)));
        if at == Time::ZERO { pieces } else { Box::new(since(pieces, at)) }
    }

    /// Whether [`pieces_from`](Law::pieces_from) works out all pieces before its time.
    fn depends_on_its_past(&self) -> bool {
        match self {
            Law::Lorenz(_) | Law::Winch(_) | Law::Backlash(_) | Law::Compensation(_) => true,
            Law::Sum(laws) => laws.iter().any(Law::depends_on_its_past),
            Law::Then(laws) => laws.iter().any(Law::depends_on_its_past),
            Law::Changed(changed) => changed.law.depends_on_its_past(),
            Law::Repeated(repeated) => repeated.law.depends_on_its_past(),
            Law::Blended(blended) => blended.law().depends_on_its_past(),
            Law::Warped(warped) => warped.law().depends_on_its_past(),
            Law::Faded(faded) => faded.laws().into_iter().any(Law::depends_on_its_past),
            Law::Arm(arm) => arm.law().into_iter().chain(arm.tip()).any(Law::depends_on_its_past),
            Law::Sine(_) | Law::Steady(_) | Law::Fixed(_) | Law::Table(_) | Law::Circle(_) | Law::Formula(_) => false,
        }
    }

    /// When the law ends; `None`: never.
    #[must_use]
    pub fn end(&self) -> Option<Time> {
        match self {
            Law::Sine(sine) => sine.cycles.map(|n| sine.period.times(n)),
            Law::Steady(steady) => steady.duration,
            Law::Fixed(fixed) => fixed.pieces.last().map(|p| p.end),
            Law::Table(table) => Some(table.end()),
            Law::Circle(circle) => circle.end(),
            Law::Lorenz(lorenz) => lorenz.end(),
            Law::Formula(formula) => formula.duration(),
            Law::Winch(winch) => winch.duration(),
            Law::Sum(laws) => combine::latest_end(laws),
            Law::Then(laws) => laws.iter().map(Law::end).try_fold(Time::ZERO, |end, e| Some(end + e?)),
            Law::Changed(changed) => changed.law.end().map(|end| end + changed.delay),
            Law::Repeated(repeated) => repeated.times.map(|n| repeated.period.times(n)),
            Law::Blended(blended) => blended.end(),
            Law::Warped(warped) => warped.end(),
            Law::Faded(faded) => faded.end(),
            Law::Arm(arm) => arm.end(),
            Law::Backlash(backlash) => backlash.end(),
            Law::Compensation(slack) => slack.end(),
        }
    }

    /// The time from which on the law repeats for ever, and its period; `None` if it ends, or if no period is known.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time};
    /// let endless = Law::sine(100.0, Time::SECOND, None)?.delayed(Time::from_seconds(0.5))?;
    /// assert_eq!(endless.cycle(), Some((Time::from_seconds(0.5), Time::SECOND)));
    /// assert_eq!(Law::sine(100.0, Time::SECOND, Some(3))?.cycle(), None);
    /// // Whole steps: 3 of 2.5 a second.
    /// assert_eq!(Law::speed(2.5, None)?.cycle(), Some((Time::ZERO, Time::from_ratio(6, 5))));
    /// # Ok::<(), pulsetrain_motion::LawError>(())
    /// ```
    #[must_use]
    pub fn cycle(&self) -> Option<(Time, Time)> {
        match self {
            Law::Sine(sine) if sine.cycles.is_none() => Some((Time::ZERO, sine.period)),
            Law::Circle(circle) => circle.cycle(),
            Law::Steady(steady) => steady.cycle(),
            Law::Blended(blended) => blended.cycle(),
            Law::Faded(faded) => faded.cycle(),
            Law::Arm(arm) => arm.law()?.cycle(),
            Law::Changed(changed) => changed.law.cycle().map(|(from, period)| (from + changed.delay, period)),
            Law::Repeated(repeated) if repeated.times.is_none() => Some((Time::ZERO, repeated.period)),
            Law::Then(laws) => {
                let (last, before) = laws.split_last()?;
                let begins = before.iter().map(Law::end).try_fold(Time::ZERO, |end, e| Some(end + e?))?;
                last.cycle().map(|(from, period)| (begins + from, period))
            }
            Law::Sum(laws) if laws.len() == 1 => laws[0].cycle(),
            _ => None,
        }
    }

    /// What a certificate of this law is relative to.
    #[must_use]
    pub fn class(&self) -> Class {
        let worst = |laws: &[Law], least| laws.iter().map(Law::class).max().unwrap_or(least).max(least);
        match self {
            Law::Sine(_) | Law::Circle(_) | Law::Steady(_) | Law::Winch(_) => Class::ClosedForm,
            Law::Fixed(fixed) => fixed.class,
            Law::Table(_) => Class::Interpolant,
            Law::Lorenz(_) => Lorenz::class(),
            Law::Formula(_) => Class::Enclosed,
            Law::Sum(laws) => worst(laws, Class::Enclosed),
            Law::Then(laws) => worst(laws, Class::ClosedForm),
            Law::Changed(changed) => changed.law.class(),
            Law::Repeated(repeated) => repeated.law.class(),
            Law::Blended(blended) => blended.class(),
            Law::Warped(warped) => warped.class(),
            Law::Faded(faded) => faded.class(),
            Law::Arm(arm) => arm.class(),
            Law::Backlash(backlash) => backlash.class(),
            Law::Compensation(_) => Compensation::class(),
        }
    }
}

/// Positions beyond this are refused: whole steps must fit an i64 with room to add.
const FARTHEST: f64 = 1e15;

/// `value` if it is finite and `allowed`, else an error that names it.
fn checked(name: &str, value: f64, unit: &str, allowed: impl Fn(f64) -> bool) -> Result<f64, LawError> {
    if value.is_finite() && allowed(value) {
        Ok(value)
    } else {
        Err(LawError::Parameter(format!("{name} is {value} {unit}: out of range")))
    }
}

/// Whether `piece` begins at `position`, within `tolerance` steps.
fn meet(position: Double, piece: &Piece, tolerance: f64) -> Result<(), LawError> {
    let next = piece.rough_position(piece.first());
    // Written so that not-a-number fails.
    if (next - position).nearest().abs() <= tolerance {
        Ok(())
    } else {
        Err(LawError::Jump { at_s: piece.start.seconds(), from: position.nearest(), to: next.nearest() })
    }
}

#[cfg(test)]
std::thread_local! {
    /// Pieces that were worked out, for tests of what is skipped.
    static WORKED_OUT: std::cell::Cell<usize> = const { std::cell::Cell::new(0) };
}

/// `pieces` without those that end at or before `at`; the last one stays.
fn since(mut pieces: Pieces, at: Time) -> impl Iterator<Item = Result<Piece, LawError>> + Send {
    let mut arrived = false;
    std::iter::from_fn(move || {
        let mut last = None;
        while !std::mem::replace(&mut arrived, true) {
            match pieces.next() {
                Some(Ok(piece)) if piece.end <= at => (last, arrived) = (Some(Ok(piece)), false),
                next => return next.or(last),
            }
        }
        pieces.next()
    })
}

impl Fixed {
    fn pieces_from(self, at: Time) -> impl Iterator<Item = Result<Piece, LawError>> {
        let pieces = self.pieces;
        let first = pieces.partition_point(|piece| piece.end <= at).min(pieces.len() - 1);
        (first..pieces.len()).flat_map(move |index| pieces[index].clone().cut(at))
    }
}

/// How many halves of `period` are over at `at`, or one less: the half of a period is rounded.
fn halves_over(period: Time, at: Time) -> u64 {
    let halves = 2 * (at.raw() / period.raw()) + (at.raw() % period.raw()) / period.divided_by(2).raw().max(1);
    u64::try_from(halves - 1).unwrap_or(if halves > 0 { u64::MAX } else { 0 })
}

impl Sine {
    fn half_periods(&self) -> u64 {
        self.cycles.map_or(u64::MAX, |n| n.saturating_mul(2))
    }

    /// The half period at `at`, or the one before it.
    fn half_period_at(&self, at: Time) -> u64 {
        halves_over(self.period, at).min(self.half_periods() - 1)
    }

    /// Half period `k`, whose curve starts its own time at its own turning point.
    fn half_period(&self, k: u64) -> Piece {
        // k·T/2 = (k/2)·T + (k mod 2)·T/2: exact for even k, within 2^-64 s for odd k.
        let half = self.period.divided_by(2);
        let turn = |k: u64| self.period.times(k / 2) + if k % 2 == 1 { half } else { Time::ZERO };
        let rising = k.is_multiple_of(2);
        Piece {
            zero: turn(k),
            start: turn(k),
            end: turn(k + 1),
            origin: 0,
            curve: Curve::Cosine {
                offset: self.amplitude,
                amplitude: if rising { -self.amplitude } else { self.amplitude },
                omega: std::f64::consts::TAU / self.period.seconds(),
                phase: 0.0,
            },
            entry: Entry::Continuous,
        }
    }
}
