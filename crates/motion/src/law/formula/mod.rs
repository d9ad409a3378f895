//! θ(t) in text: parsed, cut into windows of time, enclosed.
//!
//! # What is here
//! - `parse`: text → `tree`, errors that point; `words`: the functions and constants; `meant`: what other spellings were meant for
//! - `dimension`: what the parts measure, and which go together; looked at while the text is read, and nowhere later
//! - `resolve`: a tree on a window of time → a `smooth` expression; every branch is decided there, or the window is cut
//! - `form`: polynomials plus sinusoids, folded when the formula is read: their windows are plain [`Curve`]s
//! - `tape`: any other smooth expression, as a flat list of operations that allocates nothing for a jet
//! - `series`, `scalar`: Taylor recurrences, on f64 and on enclosures that follow the rounding of the same recurrence
//! - `terms`: the formula to 106 bits, for places where it hardly moves
//!
//! # The language
//! docs/formulas.md describes it; [`formula_functions`] has every function, with its domain and an example.
//!
//! # Units
//! Parameters keep what they measure. A number is in radians inside of sin, cos and tan, and in the formula's unit elsewhere; so is a parameter
//! that is an angle, which has two numbers then. asin, acos, atan and atan2 give radians inside of sin, cos and tan, and the formula's unit
//! elsewhere if that is one of angles.

pub(crate) mod dimension;
mod form;
mod meant;
mod parse;
mod resolve;
pub(super) mod scalar;
pub(super) mod series;
mod smooth;
mod tape;
mod terms;
mod tree;
mod words;

use super::{Curve, Double, Entry, Law, LawError, Piece, meet};
use crate::Time;
use dimension::{Amount, Parameter, Unit};
use form::Form;
pub(crate) use parse::taken;
use resolve::{NARROWEST_S, Resolver, Stop};
use smooth::Smooth;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
pub use tape::Window;
use tape::{Tape, Undefined};
pub use terms::Terms;
use tree::{Expression, Operation};
pub use words::{FormulaFunction, formula_functions};

/// What is wrong with the text of a formula, and where.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct FormulaError {
    /// Byte offset of the place in the text.
    pub offset: usize,
    /// Its length in bytes; 0 at the end of the text.
    pub length: usize,
    /// What is wrong with it.
    pub message: String,
    /// What to write instead, if that is more than the message says.
    pub help: String,
}

impl FormulaError {
    fn helped(self, help: impl Into<String>) -> FormulaError {
        FormulaError { help: help.into(), ..self }
    }
}

/// θ(t) in text.
#[derive(Clone, Debug, PartialEq)]
pub struct Formula {
    text: String,
    tree: Expression,
    duration: Option<Time>,
    parameters: Vec<ParameterUse>,
    everywhere: Everywhere,
    kept: Kept,
}

/// Windows of a formula that were worked out already: many look at the same ones, to check a motion and to plan it.
#[derive(Default)]
struct Kept(Mutex<BTreeMap<(Time, u64), KeptWindow>>);

/// A window, and the length that it was found at, s.
type KeptWindow = (Piece, f64);

/// No more windows are kept than this: those of a minute of a delta robot's arm.
const MOST_KEPT: usize = 4096;
/// What windows keep grows with the formula. So fewer are kept of a long one: for all of them together this much text, bytes.
const MOST_KEPT_TEXT: usize = 4 << 20;
/// Of a shorter formula no windows are kept, s. A recorded path of a delta robot is made of a formula for each row and arm: a window of each
/// would take more memory than all else.
const SHORTEST_KEPT_S: f64 = 1.0;

impl Kept {
    fn windows(&self) -> MutexGuard<'_, BTreeMap<(Time, u64), KeptWindow>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The window from `start` on for which `length` was tried first.
    fn get(&self, start: Time, length: f64) -> Option<KeptWindow> {
        self.windows().get(&(start, length.to_bits())).cloned()
    }

    /// Keeps the window of a formula whose text has so many bytes.
    fn keep(&self, start: Time, length: f64, window: KeptWindow, text: usize) {
        let mut windows = self.windows();
        if windows.len() >= (MOST_KEPT_TEXT / text.max(1)).clamp(1, MOST_KEPT) {
            windows.clear();
        }
        windows.insert((start, length.to_bits()), window);
    }
}

/// A copy begins without any.
impl Clone for Kept {
    fn clone(&self) -> Kept {
        Kept::default()
    }
}

/// They follow from the formula.
impl PartialEq for Kept {
    fn eq(&self, _: &Kept) -> bool {
        true
    }
}

impl std::fmt::Debug for Kept {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Kept")
    }
}

/// What a formula without branches is everywhere, once somebody has asked: it takes long to work out of thousands of terms.
#[derive(Clone, Default)]
struct Everywhere(OnceLock<Known>);

/// It follows from the formula.
impl PartialEq for Everywhere {
    fn eq(&self, _: &Everywhere) -> bool {
        true
    }
}

impl std::fmt::Debug for Everywhere {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Everywhere")
    }
}

/// A parameter of a formula, as it was used: with another number inside of sin, cos and tan if it is an angle.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterUse {
    /// Its name in the formula.
    pub name: String,
    /// As the file has it: "90 deg".
    pub written: String,
    /// Its number outside of sin, cos and tan and its unit, which is empty for a plain number; `None` if it is not used there.
    pub outside: Option<(f64, String)>,
    /// Its number inside of sin, cos and tan and its unit; `None` if it is not used there.
    pub in_trig: Option<(f64, String)>,
}

/// The longest window, s. A window ends at each multiple of it, and the next one is at first tried in that length: so the windows after a
/// multiple do not depend on those before.
const LONGEST_S: f64 = 64.0;
/// The length that is tried first of all, s.
const FIRST_S: f64 = 1.0;
/// The fastest sinusoid turns by no more within a window, rad: its phase stays exact to 2^-46.
const MOST_RADIANS: f64 = 64.0;
/// The limit in a window, roughly, for formulas that are no sum of lines and sinusoids, rad. Their peaks and turns in a
/// window are searched together.
const MOST_RADIANS_WITHOUT_FORM: f64 = 1024.0;
/// Windows of forms are cut until positions are exact to this, steps, or they are this short.
const EXACT_STEPS: f64 = 1e-8;
const SHORT_S: f64 = 1e-6;
/// The formula is refused after this many windows of the shortest kind in a row, because a branch never settles.
const MOST_FORCED: u32 = 100;
/// A window of this length ends such a row, s.
const SETTLED_S: f64 = 1e-9;
/// What two windows may be apart where they meet, steps, for it to be no jump.
const MEETING_STEPS: f64 = 1e-6;

impl Law {
    /// θ(t) = `steps_per_unit` × `text`, for `duration` or for ever. See [`formula`](self) for the language.
    ///
    /// A formula that is undefined or jumps somewhere is an error of the law's [`pieces`](Law::pieces), with the time.
    ///
    /// ```
    /// use pulsetrain_motion::{Law, Time};
    /// let law = Law::formula("a*t + sin(7*t)", &[("a".into(), 2.5)], 200.0, Some(Time::SECOND))?;
    /// assert_eq!(law.end(), Some(Time::SECOND));
    /// let error = Law::formula("2*t + sni(7*t)", &[], 200.0, None).unwrap_err();
    /// assert_eq!((error.offset, error.length), (6, 3));
    /// assert_eq!(error.message, "`sni` is unknown; did you mean `sin`?");
    /// # Ok::<(), pulsetrain_motion::law::FormulaError>(())
    /// ```
    ///
    /// # Errors
    /// [`FormulaError`], with the place in the text; about the other arguments with the whole text as the place.
    pub fn formula(
        text: &str,
        parameters: &[(String, f64)],
        steps_per_unit: f64,
        duration: Option<Time>,
    ) -> Result<Law, FormulaError> {
        let parameters: Vec<Parameter> =
            parameters.iter().map(|(name, value)| Parameter::plain(name, *value)).collect();
        Law::formula_in(text, &parameters, &Unit::plain(steps_per_unit), duration)
    }

    /// Reads a formula with parameters that have dimensions, and a result in `unit`.
    pub(crate) fn formula_in(
        text: &str,
        parameters: &[Parameter],
        unit: &Unit,
        duration: Option<Time>,
    ) -> Result<Law, FormulaError> {
        let whole = |message: String| tree::error((0, text.len()), message);
        let mut numbers = parameters.iter().flat_map(|p| [(&p.name, &p.outside), (&p.name, &p.in_trig)]);
        if let Some((name, Amount { value, .. })) = numbers.find(|(_, amount)| !amount.value.is_finite()) {
            return Err(whole(format!("the parameter `{name}` is {}: out of range", value.nearest())));
        }
        if !unit.steps.is_finite() {
            return Err(whole(format!("{} steps in a unit: out of range", unit.steps)));
        }
        if duration.is_some_and(|d| d <= Time::ZERO) {
            return Err(whole("the duration must be positive".into()));
        }
        let parsed = parse::parse(text, parameters, unit)?;
        let span = parsed.tree.span;
        let scale = Expression::new(Operation::Number(Double::from(unit.steps)), span)?;
        let tree = Expression::new(Operation::Multiply(scale, parsed.tree), span)?;
        let shown = |is_used: bool, amount: &Amount| is_used.then(|| (amount.value.nearest(), amount.unit.clone()));
        let parameters = parameters.iter().zip(parsed.used).map(|(p, [outside, in_trig])| ParameterUse {
            name: p.name.clone(),
            written: p.written.clone(),
            outside: shown(outside, &p.outside),
            in_trig: shown(in_trig, &p.in_trig),
        });
        let parameters = parameters.collect();
        Ok(Law::Formula(Arc::new(Formula {
            text: text.into(),
            tree,
            duration,
            parameters,
            everywhere: Everywhere::default(),
            kept: Kept::default(),
        })))
    }

    /// The parameters of each formula in it, in the order in which it has them.
    #[must_use]
    pub fn formula_parameters(&self) -> Vec<&[ParameterUse]> {
        match self {
            Law::Formula(formula) => vec![&formula.parameters],
            Law::Sum(laws) => laws.iter().flat_map(Law::formula_parameters).collect(),
            Law::Then(laws) => laws.iter().flat_map(Law::formula_parameters).collect(),
            Law::Changed(changed) => changed.law.formula_parameters(),
            Law::Repeated(repeated) => repeated.law.formula_parameters(),
            Law::Blended(blended) => blended.law().formula_parameters(),
            Law::Warped(warped) => warped.law().formula_parameters(),
            Law::Faded(faded) => faded.laws().into_iter().flat_map(Law::formula_parameters).collect(),
            Law::Arm(arm) => match arm.law() {
                Some(law) => law.formula_parameters(),
                None => arm.tip().iter().flat_map(Law::formula_parameters).collect(),
            },
            Law::Backlash(backlash) => backlash.law().formula_parameters(),
            Law::Sine(_) | Law::Steady(_) | Law::Fixed(_) | Law::Table(_) | Law::Circle(_) | Law::Lorenz(_) => {
                Vec::new()
            }
            Law::Winch(_) | Law::Compensation(_) => Vec::new(),
        }
    }
}

impl Formula {
    pub(super) fn duration(&self) -> Option<Time> {
        self.duration
    }

    /// Operations in it.
    pub(super) fn operations(&self) -> u32 {
        self.tree.size()
    }

    /// The windows from the last multiple of [`LONGEST_S`] before `at` on.
    pub(super) fn pieces_from(self: &Arc<Formula>, at: Time) -> Windows {
        let at = self.duration.map_or(at, |end| at.min(end.before()));
        let grid = Time::from_seconds(LONGEST_S);
        let start = Time::from_raw(at.raw() - at.raw() % grid.raw());
        let length = if start == Time::ZERO { FIRST_S } else { LONGEST_S };
        Windows { start, length, ..self.windows_at(Time::ZERO) }
    }

    /// Windows from `start` on, as if the law began there; the first is as long as can be.
    pub(super) fn windows_at(self: &Arc<Formula>, start: Time) -> Windows {
        Windows {
            formula: Arc::clone(self),
            begin: start,
            start,
            length: LONGEST_S,
            position: None,
            forced: 0,
            failed: false,
        }
    }
}

/// The pieces of a formula.
pub(super) struct Windows {
    formula: Arc<Formula>,
    /// Multiples of [`LONGEST_S`] count from here.
    begin: Time,
    start: Time,
    /// The next window's length, s.
    length: f64,
    /// Where the last window ended.
    position: Option<Double>,
    /// Narrowest windows in a row.
    forced: u32,
    failed: bool,
}

#[derive(Clone)]
enum Known {
    Form(Form),
    Tape(Arc<Tape>),
}

impl Iterator for Windows {
    type Item = Result<Piece, LawError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed || self.start >= self.formula.duration.unwrap_or(Time::MAX) {
            return None;
        }
        let piece = self.window();
        self.failed = piece.is_err();
        Some(piece)
    }
}

impl Windows {
    fn window(&mut self) -> Result<Piece, LawError> {
        let start = self.start;
        let last = self.formula.duration.unwrap_or(Time::MAX);
        let longest = Time::from_seconds(LONGEST_S);
        let mark = start + (longest - Time::from_raw((start - self.begin).raw() % longest.raw()));
        let mut end = last.min(mark).min(start + Time::from_seconds(self.length));
        let mut forced = false;
        let mut unsettled = None;
        // Windows that count from another time are read once: they are not kept.
        let keeps = self.begin == Time::ZERO && last.seconds() >= SHORTEST_KEPT_S;
        let tried = self.length;
        let kept = if keeps { self.formula.kept.get(start, tried) } else { None };
        let is_kept = kept.is_some();
        if let Some((piece, length)) = &kept {
            (end, self.length) = (piece.end, *length);
        }
        let piece = if let Some((piece, _)) = kept {
            piece
        } else {
            loop {
                match self.piece(end, forced) {
                    Ok(piece) => break piece?,
                    Err(Stop::Split(at)) if start < at && at < end => end = at,
                    Err(Stop::Narrow(undefined)) if forced => return Err(self.undefined(&undefined)),
                    Err(stop) => {
                        if let Stop::Narrow(undefined) = stop {
                            unsettled = Some(undefined);
                        }
                        self.length = 0.5 * (end - start).seconds();
                        forced = self.length < NARROWEST_S;
                        end = start + Time::from_seconds(self.length.max(0.5 * NARROWEST_S));
                    }
                }
            }
        };
        if forced {
            self.forced += 1;
        } else if (end - start).seconds() > SETTLED_S {
            self.forced = 0;
            if keeps && !is_kept && piece.curve.is_formula() {
                self.formula.kept.keep(start, tried, (piece.clone(), self.length), self.formula.text.len());
            }
        }
        if let Some(undefined) = unsettled.filter(|_| self.forced > MOST_FORCED) {
            return Err(self.undefined(&undefined));
        }
        if let Some(position) = self.position {
            // Where the branches meet is known to the narrowest window only.
            let speed = piece.curve.jet(piece.first())[1];
            meet(position, &piece, MEETING_STEPS + 2.0 * NARROWEST_S * speed.abs())?;
        }
        self.position = Some(piece.rough_position(piece.last()));
        self.start = piece.end;
        self.length = if self.start == mark { LONGEST_S } else { (2.0 * self.length.max(NARROWEST_S)).min(LONGEST_S) };
        Ok(piece)
    }

    fn undefined(&self, undefined: &Undefined) -> LawError {
        let (offset, length) = undefined.span;
        let text = self.formula.text.get(offset..offset + length).unwrap_or_default();
        LawError::Undefined { at_s: self.start.seconds(), why: format!("`{text}`: {}", undefined.why) }
    }

    /// The formula from the start to `end`; the inner error is final.
    fn piece(&self, end: Time, forced: bool) -> Result<Result<Piece, LawError>, Stop> {
        let known = match self.formula.everywhere.0.get() {
            Some(known) => known.clone(),
            None => {
                let resolver = Resolver { start: self.start, end, forced };
                let known = match resolver.resolve(&self.formula.tree)? {
                    Smooth::Form(form, _) => Known::Form(form),
                    smooth => Known::Tape(Arc::new(Tape::new(&smooth))),
                };
                if !self.formula.tree.has_branches() {
                    let _ = self.formula.everywhere.0.set(known.clone());
                }
                known
            }
        };
        let length = (end - self.start).seconds();
        let narrow = |why| Stop::Narrow(Undefined { span: self.formula.tree.span, why });
        let mut bends = true;
        let (curve, level) = match known {
            Known::Form(form) => {
                if form.fastest() * length > MOST_RADIANS && !forced {
                    return Err(narrow("it is too fast"));
                }
                let (curve, level) = form.curve_since(self.start);
                if curve.bounds(0.0, length).rounding[0] > EXACT_STEPS && length > SHORT_S {
                    return Err(narrow("it is too fast"));
                }
                // For a line f64 is exact enough: it needs no 106 bits.
                bends = !form.is_line();
                (curve, level)
            }
            Known::Tape(tape) => {
                let window = Window::new(&tape, self.start, length).map_err(Stop::Narrow)?;
                if window.fastest(length) * length > MOST_RADIANS_WITHOUT_FORM && !forced {
                    return Err(narrow("it is too fast"));
                }
                (Curve::Formula(window), Double::ZERO)
            }
        };
        let mut piece = Piece { zero: self.start, start: self.start, end, origin: 0, curve, entry: Entry::Continuous };
        Ok(piece.raise(level).map(|()| {
            let terms = bends.then(|| Terms::of_formula(&self.formula.tree, self.start, end, piece.origin));
            Piece { curve: piece.curve.accurate_by(terms), ..piece }
        }))
    }
}
