//! The motion as it is wanted: the motion file, the knobs that were turned, and the cue.
//!
//! Each change is a change of the file's values. The changed file is read by the ordinary reader, so that units, ranges and errors are those of any
//! motion file.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use pulsetrain_motion::file::{Contents, Cue, FileError, Live, ParameterValue, Sheet, Source};
use pulsetrain_motion::program::{PositionUnits, Program};
use pulsetrain_motion::quantity::{Quantity, nearest};
use pulsetrain_motion::{Law, Time};
use pulsetrain_session::prepare::Prepared;

use crate::command::KnobValue;
use crate::run_info::KnobInfo;
use pulsetrain_report::positions::{START, check_range, example_position, start};

/// The files that a motion file names, by the names that it gives them.
pub type FileTexts = BTreeMap<PathBuf, String>;

/// Reads a file by the name that a motion file gives it.
pub type FileLoader = dyn Fn(&Path) -> io::Result<String> + Send + Sync;

/// The files that a motion file may name.
#[derive(Clone)]
pub enum NamedFiles {
    /// These, and no others.
    Only(FileTexts),
    /// What this function reads. It is called once for each file.
    LoadedBy(Arc<FileLoader>),
}

impl NamedFiles {
    /// No file.
    #[must_use]
    pub fn none() -> NamedFiles {
        NamedFiles::Only(FileTexts::new())
    }
}

/// The motion as it is wanted.
#[derive(Clone, Debug)]
pub struct LiveSetpoints {
    /// What messages call the file.
    name: String,
    board: Option<String>,
    files: Arc<FileCache>,
    /// The file as it was read last.
    sheet: Sheet,
    live: Live,
    units: Vec<PositionUnits>,
    cue: Option<CueTaken>,
    /// Values that differ from the file's and the cue's, by parameter.
    turned: BTreeMap<String, ParameterValue>,
    /// What the motors were set up for: it cannot change while they run.
    setup: Arc<Program>,
    /// Where each motor's motion begins, steps: `goto 0`.
    home: Arc<Vec<f64>>,
    /// The program that was made last, by these setpoints or some that they were copied from: a knob is checked first, and turned then.
    made: Arc<Mutex<Option<BuiltProgram>>>,
    /// A changed file that another thread has read, for these setpoints or some that they were copied from.
    ahead: Arc<Mutex<Option<Box<ReadAhead>>>>,
}

/// A changed file that was read, and what of.
#[derive(Debug)]
struct ReadAhead {
    text: String,
    files: FileTexts,
    source: Arc<Source>,
    turned: BTreeMap<String, ParameterValue>,
    cue: Option<CueTaken>,
    read: Result<LiveSetpoints, Box<NoMotion>>,
}

/// A program, and what it was made of.
#[derive(Debug)]
struct BuiltProgram {
    source: Arc<Source>,
    files: Arc<FileCache>,
    turned: BTreeMap<String, ParameterValue>,
    cue: Option<CueTaken>,
    setup: Arc<Program>,
    program: Arc<Program>,
}

/// The files that were read, so that a knob does not read a large table again.
struct FileCache {
    read: Mutex<FileTexts>,
    /// `None`: only the given files are there.
    loader: Option<Arc<FileLoader>>,
}

impl std::fmt::Debug for FileCache {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FileCache").field("read", &self.read).finish_non_exhaustive()
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct CueTaken {
    number: usize,
    /// When its motions begin, by the laws' time; `None`: with the motion.
    begins: Option<Time>,
}

/// A knob that is turned.
#[derive(Clone, Debug)]
pub struct KnobMove {
    /// The knob's name, as it was asked for.
    pub knob: String,
    /// The parameter that it sets.
    target: String,
    /// Its value now.
    pub from: f64,
    /// The wanted value, within the knob's range.
    pub to: f64,
    /// The unit of both.
    pub unit: String,
    /// Whether only whole numbers will do.
    pub is_whole: bool,
    is_bare: bool,
    /// How long the change takes, at least.
    pub over: Option<Time>,
    /// The knob's own limit, if it kept the value from the wanted one.
    pub range: Option<String>,
}

/// Why something that was asked for cannot be done.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ChangeRefusal {
    /// No knob, or no number of a law, has that name.
    #[error("there is no knob `{knob}`{}", .meant.as_ref().map_or_else(String::new, |meant| format!("; did you mean `{meant}`?")))]
    NoKnob {
        /// The name.
        knob: String,
        /// A name that is there.
        meant: Option<String>,
    },
    /// No cue has that name.
    #[error("there is no cue \"{cue}\"{}", .meant.as_ref().map_or_else(String::new, |meant| format!("; did you mean \"{meant}\"?")))]
    NoCue {
        /// The name.
        cue: String,
        /// A name that is there.
        meant: Option<String>,
    },
    /// There is no next cue, or none before this one.
    #[error("{0}")]
    NoOtherCue(&'static str),
    /// A value is no number of the knob's kind.
    #[error("{0}")]
    Value(String),
    /// The motion with that value is refused by the reader of motion files.
    #[error("{0}")]
    File(String),
    /// What the motors were set up for would change.
    #[error("{0}. That is set up when a motion begins: stop this one, and begin again")]
    Setup(String),
}

impl LiveSetpoints {
    /// The setpoints of a motion file's text, which messages call `name`. `board` replaces the file's own.
    ///
    /// # Errors
    /// If the text is wrong.
    pub fn of(
        text: &str,
        name: &str,
        board: Option<&str>,
        files: NamedFiles,
    ) -> Result<(LiveSetpoints, Contents), FileError> {
        let cache = match files {
            NamedFiles::Only(texts) => FileCache { read: Mutex::new(texts), loader: None },
            NamedFiles::LoadedBy(loader) => FileCache { read: Mutex::default(), loader: Some(loader) },
        };
        LiveSetpoints::with_cache(text, name, board, cache)
    }

    fn with_cache(
        text: &str,
        name: &str,
        board: Option<&str>,
        cache: FileCache,
    ) -> Result<(LiveSetpoints, Contents), FileError> {
        let sheet = Sheet::parse(text, name)?;
        let contents = sheet.contents(&|named| cache.load(named))?;
        let setpoints = LiveSetpoints {
            name: name.to_owned(),
            board: board.map(str::to_owned),
            files: Arc::new(cache),
            live: contents.live.clone(),
            units: contents.units(),
            sheet,
            cue: None,
            turned: BTreeMap::new(),
            setup: Arc::new(contents.program.clone()),
            home: Arc::new(contents.program.motors.iter().map(start).collect()),
            made: Arc::default(),
            ahead: Arc::default(),
        };
        Ok((setpoints, contents))
    }

    /// Notes what the motors were set up for.
    pub fn set_up(&mut self, program: &Program) {
        self.setup = Arc::new(program.clone());
    }

    /// What the motors were set up for.
    #[must_use]
    pub fn setup(&self) -> &Arc<Program> {
        &self.setup
    }

    /// What may change while the motion runs, by the file: knobs, cues, schedule.
    #[must_use]
    pub fn live(&self) -> &Live {
        &self.live
    }

    /// Where each motor's motion begins, steps.
    #[must_use]
    pub fn home(&self) -> &[f64] {
        &self.home
    }

    /// The setpoints with the file's own values: no cue, and no turned knobs. A motion that starts again from time 0 follows it.
    #[must_use]
    pub fn restarted(&self) -> LiveSetpoints {
        LiveSetpoints { cue: None, turned: BTreeMap::new(), ..self.clone() }
    }

    /// The motors at rest at these positions, steps.
    ///
    /// # Errors
    /// If one is no position that a motor can have.
    pub fn resting_at(&self, positions: &[f64]) -> Result<Program, ChangeRefusal> {
        let mut program = Program::clone(&self.setup);
        for (motor, steps) in program.motors.iter_mut().zip(positions) {
            let rest = Law::speed(0.0, None).and_then(|rest| rest.shifted(*steps));
            motor.law = rest.map_err(|error| ChangeRefusal::Value(error.to_string()))?;
        }
        // Each motor goes its own way.
        program.machines.clear();
        Ok(program)
    }

    /// A position of a motor, steps: with its unit, or `0` or `start`, where the motion began.
    ///
    /// # Errors
    /// If the text is no position of that motor.
    pub fn position_of(&self, motor: usize, text: &str) -> Result<f64, ChangeRefusal> {
        let text = text.trim();
        if text == "0" || text == START {
            return Ok(self.home[motor]);
        }
        let known = &self.setup.motors[motor];
        position(text, &known.name, &example_position(&self.setup, motor), &self.units[motor])
    }

    /// Which motors stand where, steps, as somebody says it. `last` is where they rested when that was known last.
    ///
    /// # Errors
    /// If there is no such motor, or the text is no position of it.
    pub fn places(
        &self,
        motor: Option<&str>,
        position: &str,
        last: Option<&[f64]>,
    ) -> Result<Vec<(usize, f64)>, ChangeRefusal> {
        let names = || self.setup.motors.iter().map(|motor| motor.name.as_str());
        let motors = match motor {
            None => 0..self.setup.motors.len(),
            Some(name) => {
                let number = names().position(|known| known == name).ok_or_else(|| {
                    let meant = nearest(name, names()).map(|near| format!("; did you mean `{near}`?"));
                    let there_are = || format!("; there are {}", names().collect::<Vec<_>>().join(", "));
                    ChangeRefusal::Value(format!("there is no motor `{name}`{}", meant.unwrap_or_else(there_are)))
                })?;
                number..number + 1
            }
        };
        const UNKNOWN: &str = "the last position at rest is not known: none was saved, or the motors were moving then; \
                               write a position";
        let place = |motor: usize| match (position.trim(), last) {
            ("last", Some(last)) => Ok((motor, last[motor])),
            ("last", None) => Err(ChangeRefusal::Value(UNKNOWN.to_owned())),
            (text, _) => Ok((motor, self.position_of(motor, text)?)),
        };
        motors.map(place).collect()
    }

    /// Adds files that a changed motion file names, where no others are read.
    pub fn provide(&self, files: &FileTexts) {
        self.files.lock().extend(files.clone());
        *self.made.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    /// The motion file's text.
    #[must_use]
    pub fn text(&self) -> &str {
        self.sheet.source().text()
    }

    /// The files that the motion file named so far.
    #[must_use]
    pub fn files(&self) -> FileTexts {
        self.files.lock().clone()
    }

    /// The names of the cues, in the file's order.
    #[must_use]
    pub fn cues(&self) -> Vec<String> {
        self.live.cues.iter().map(|cue| cue.name.clone()).collect()
    }

    /// The file with the cue and the turned knobs in it.
    fn sheet(&self) -> Sheet {
        let mut sheet = match self.cue {
            Some(CueTaken { number, .. }) => self.sheet.with_cue(number),
            None => self.sheet.clone(),
        };
        for (name, value) in &self.turned {
            // What a new file no longer has was left out of `turned`.
            if let Ok(turned) = sheet.with(name, value) {
                sheet = turned;
            }
        }
        sheet
    }

    /// The motion as it is wanted.
    ///
    /// # Errors
    /// If the reader refuses it, or if it changes wiring, drivers or the board.
    pub fn program(&self) -> Result<Arc<Program>, ChangeRefusal> {
        let is_same = |made: &BuiltProgram| {
            Arc::ptr_eq(&made.source, self.sheet.source())
                && Arc::ptr_eq(&made.files, &self.files)
                && made.turned == self.turned
                && made.cue == self.cue
                && Arc::ptr_eq(&made.setup, &self.setup)
        };
        let made = || self.made.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(made) = made().as_ref().filter(|made| is_same(made)) {
            return Ok(Arc::clone(&made.program));
        }
        let program = self.read()?;
        // The files that it names are kept as they were read, and are not read again.
        *made() = Some(BuiltProgram {
            source: Arc::clone(self.sheet.source()),
            files: Arc::clone(&self.files),
            turned: self.turned.clone(),
            cue: self.cue,
            setup: Arc::clone(&self.setup),
            program: Arc::clone(&program),
        });
        Ok(program)
    }

    /// Reads the file with the cue and the turned knobs in it.
    fn read(&self) -> Result<Arc<Program>, ChangeRefusal> {
        let contents = self.sheet().contents(&|named| self.files.load(named)).map_err(|error| {
            let advice = error.problems()[0].advice().map(|advice| format!(" ({advice})"));
            ChangeRefusal::File(format!("{error}{}", advice.unwrap_or_default()))
        })?;
        let prepared = Prepared::new(self.name.clone(), contents, self.board.as_deref());
        let mut program = prepared.map_err(|error| ChangeRefusal::File(error.to_string()))?.program;
        check_setup(&self.setup, &program)?;
        program.queue_parts.clone_from(&self.setup.queue_parts);
        if let Some(CueTaken { number, begins: Some(begins) }) = self.cue {
            for motor in &self.live.cues[number].motors {
                let law = &mut program.motors[*motor].law;
                *law = law.clone().delayed(begins).map_err(|error| ChangeRefusal::File(error.to_string()))?;
            }
        }
        Ok(Arc::new(program))
    }

    /// Every knob: those of `[live.knobs]`, and then each number of a law that none of them sets.
    #[must_use]
    pub fn knobs(&self) -> Vec<KnobInfo> {
        let parameters = self.sheet().parameters();
        let mut knobs = Vec::new();
        for knob in &self.live.knobs {
            let Some(parameter) = parameters.iter().find(|parameter| parameter.name == knob.target) else { continue };
            let Some(value) = self.in_unit(&parameter.value, &knob.unit, &knob.target) else { continue };
            knobs.push(KnobInfo {
                name: knob.name.clone(),
                target: knob.target.clone(),
                unit: knob.unit.clone(),
                least: knob.least,
                greatest: knob.greatest,
                value,
            });
        }
        let is_free = |name: &str| !self.live.knobs.iter().any(|knob| knob.target == name);
        for parameter in parameters.iter().filter(|parameter| is_free(&parameter.name)) {
            let (value, unit) = parameter.value.parts();
            let (name, unit) = (parameter.name.clone(), unit.to_owned());
            knobs.push(KnobInfo { target: name.clone(), name, unit, least: None, greatest: None, value });
        }
        knobs
    }

    /// What turning a knob means.
    ///
    /// # Errors
    /// If there is no such knob, or the value is none of its kind.
    pub fn knob_move(&self, name: &str, value: &KnobValue) -> Result<KnobMove, ChangeRefusal> {
        let knob = self.live.knobs.iter().find(|knob| knob.name == name);
        let sheet = self.sheet();
        let target = knob.map_or(name, |knob| &knob.target);
        let Ok(parameter) = sheet.parameter(target) else {
            let parameters = sheet.parameters();
            let knobs = self.live.knobs.iter().map(|knob| knob.name.as_str());
            let names = parameters.iter().map(|parameter| parameter.name.as_str()).chain(knobs);
            let meant = nearest(name, names).map(str::to_owned);
            return Err(ChangeRefusal::NoKnob { knob: name.to_owned(), meant });
        };
        // A bare number is in the unit of the file, whatever a knob was turned to since.
        let of_file = self.sheet.parameter(target).ok();
        let written = of_file.as_ref().unwrap_or(&parameter).value.parts().1.to_owned();
        let unit = knob.map_or(written, |knob| knob.unit.clone());
        let from = self
            .in_unit(&parameter.value, &unit, target)
            .ok_or_else(|| ChangeRefusal::Value(format!("`{name}` has no value in {unit}")))?;
        let wanted = match value {
            KnobValue::Number(number) => *number,
            KnobValue::Text(text) => self.number(text.trim(), &unit, name, target)?,
        };
        if !wanted.is_finite() {
            return Err(ChangeRefusal::Value(format!("`{name}`: {wanted} is no number that a motor can follow")));
        }
        let is_whole = matches!(parameter.value, ParameterValue::Whole(_)) && unit.is_empty();
        if is_whole && wanted.fract() != 0.0 && !self.takes_fractions(&sheet, target) {
            return Err(ChangeRefusal::Value(format!("`{name}` takes whole numbers alone, but this is {wanted}")));
        }
        let is_whole = is_whole && wanted.fract() == 0.0;
        let (mut to, mut range) = (wanted, None);
        if let Some(knob) = knob {
            let in_range = wanted.clamp(knob.least.unwrap_or(f64::MIN), knob.greatest.unwrap_or(f64::MAX));
            if in_range != wanted {
                let end = if in_range < wanted { "greatest" } else { "least" };
                range = Some(format!("the {end} value of knob `{name}`"));
                to = in_range;
            }
        }
        let is_bare = unit.is_empty();
        let over = knob.and_then(|knob| knob.smoothing);
        Ok(KnobMove {
            knob: name.to_owned(),
            target: target.to_owned(),
            from,
            to,
            unit,
            is_whole,
            is_bare,
            over,
            range,
        })
    }

    /// Whether a whole number in the file may become one with a fraction: a formula's constant may, a number of cycles not.
    fn takes_fractions(&self, sheet: &Sheet, target: &str) -> bool {
        let half = sheet.with(target, &ParameterValue::Number(0.5));
        half.is_ok_and(|sheet| sheet.contents(&|named| self.files.load(named)).is_ok())
    }

    /// The setpoints with a knob at some value, in the knob's unit.
    #[must_use]
    pub fn with_knob(&self, knob_move: &KnobMove, value: f64) -> LiveSetpoints {
        let mut setpoints = self.clone();
        let value = match (knob_move.is_whole, knob_move.is_bare) {
            (true, _) => ParameterValue::Whole(value.round() as i64),
            (false, true) => ParameterValue::Number(value),
            (false, false) => ParameterValue::Quantity(format!("{value} {}", knob_move.unit)),
        };
        setpoints.turned.insert(knob_move.target.clone(), value);
        setpoints
    }

    /// A step of a knob's motor in the knob's unit; `None` if it sets no position.
    #[must_use]
    pub fn step_in_unit(&self, knob_move: &KnobMove) -> Option<f64> {
        let one = Quantity::parse(&format!("1 {}", knob_move.unit)).ok()?;
        let owner = knob_move.target.split('.').next()?;
        let motor = self.setup.motors.iter().position(|motor| motor.name == owner)?;
        let steps = one.value * self.units.get(motor)?.steps(one.base)?;
        (one.base.is_position() && one.per_seconds == 0).then(|| 1.0 / steps)
    }

    /// A text as a number in a knob's unit.
    fn number(&self, text: &str, unit: &str, name: &str, target: &str) -> Result<f64, ChangeRefusal> {
        if let Ok(number) = text.parse::<f64>() {
            return Ok(number);
        }
        let refuse = |why: String| ChangeRefusal::Value(format!("`{name}`: {why}"));
        let quantity = Quantity::parse(text).map_err(|error| {
            refuse(match error.meant() {
                Some(meant) => format!("{error}; did you mean \"{meant}\"?"),
                None => error.to_string(),
            })
        })?;
        if unit.is_empty() {
            return Err(refuse(format!("the law has a bare number here, but this is {}", quantity.kind())));
        }
        if let Some((number, written)) = Quantity::parts(text)
            && written == unit
        {
            return Ok(number);
        }
        self.in_unit(&ParameterValue::Quantity(text.to_owned()), unit, target).ok_or_else(|| {
            let wanted =
                Quantity::parse(&format!("1 {unit}")).map_or_else(|_| unit.to_owned(), |one| one.kind().to_string());
            refuse(format!("it must be {wanted}, but this is {}; write it like \"1 {unit}\"", quantity.kind()))
        })
    }

    /// A value in a unit; `None` if it is of another kind. Positions need the motor, whose name begins the parameter's.
    fn in_unit(&self, value: &ParameterValue, unit: &str, target: &str) -> Option<f64> {
        let text = match value {
            ParameterValue::Quantity(text) if !unit.is_empty() => text,
            _ => return Some(value.parts().0).filter(|_| unit.is_empty() || value.parts().1.is_empty()),
        };
        if let (number, written) = value.parts()
            && written == unit
        {
            return Some(number);
        }
        let (quantity, one) = (Quantity::parse(text).ok()?, Quantity::parse(&format!("1 {unit}")).ok()?);
        if quantity.kind() == one.kind() {
            return Some(quantity.value / one.value);
        }
        let is_position = quantity.base.is_position() && one.base.is_position();
        let motor = target.split('.').next()?;
        let motor = self.setup.motors.iter().position(|known| known.name == motor)?;
        let units = self.units.get(motor)?;
        let (steps, of_one) = (units.steps(quantity.base)?, units.steps(one.base)?);
        let same = is_position && quantity.per_seconds == one.per_seconds;
        same.then(|| quantity.value * steps / (one.value * of_one))
    }

    /// The setpoints at a cue, which begins at `now` of the laws' time, and how long the change takes, at least.
    ///
    /// # Errors
    /// If there is no such cue.
    pub fn at_cue(&self, name: &str, now: Time) -> Result<(LiveSetpoints, Cue), ChangeRefusal> {
        let number = self.live.cues.iter().position(|cue| cue.name == name).ok_or_else(|| {
            let meant = nearest(name, self.live.cues.iter().map(|cue| cue.name.as_str())).map(str::to_owned);
            ChangeRefusal::NoCue { cue: name.to_owned(), meant }
        })?;
        Ok(self.at(number, now))
    }

    /// Whether there is a cue after that one.
    #[must_use]
    pub fn has_cue_after(&self, cue: &Cue) -> bool {
        self.live.cues.last().is_some_and(|last| last.name != cue.name)
    }

    /// The setpoints at the next cue, or at the one before this one.
    ///
    /// # Errors
    /// If there is none.
    pub fn at_other_cue(&self, is_next: bool, now: Time) -> Result<(LiveSetpoints, Cue), ChangeRefusal> {
        let number = match (self.cue, is_next) {
            _ if self.live.cues.is_empty() => return Err(ChangeRefusal::NoOtherCue("the motion file has no cues")),
            (None, true) => 0,
            (Some(CueTaken { number, .. }), true) if number + 1 < self.live.cues.len() => number + 1,
            (Some(_), true) => return Err(ChangeRefusal::NoOtherCue("this is the last cue")),
            (Some(CueTaken { number, .. }), false) if number > 0 => number - 1,
            (_, false) => return Err(ChangeRefusal::NoOtherCue("there is no cue before this one")),
        };
        Ok(self.at(number, now))
    }

    fn at(&self, number: usize, now: Time) -> (LiveSetpoints, Cue) {
        let cue = &self.live.cues[number];
        let mut setpoints = self.clone();
        // The motions of the cue before are gone with it, and so are values in motions that this cue replaces.
        let before = self.cue.map(|before| self.live.cues[before.number].motors.clone()).unwrap_or_default();
        let own: Vec<String> =
            cue.motors.iter().chain(&before).map(|motor| self.setup.motors[*motor].name.clone()).collect();
        setpoints
            .turned
            .retain(|name, _| name.split('.').next().is_none_or(|motor| !own.iter().any(|own| own == motor)));
        setpoints.cue = Some(CueTaken { number, begins: (cue.begins_now && !cue.motors.is_empty()).then_some(now) });
        setpoints.turned.extend(cue.set.iter().cloned());
        (setpoints, cue.clone())
    }

    /// Takes a changed motion file over, with changed files that it names. Other files stay as they were read last. A turned knob keeps its value, unless the file has a new one for it. The present cue
    /// goes on if it is in the new file, too.
    ///
    /// # Errors
    /// The file's problems, or [`ChangeRefusal`] if it changes wiring, drivers or the board.
    pub fn with_file(&self, text: &str, files: &FileTexts) -> Result<LiveSetpoints, Box<NoMotion>> {
        let ahead = self.ahead.lock().unwrap_or_else(PoisonError::into_inner).take_if(|ahead| {
            ahead.text == text
                && ahead.files == *files
                && Arc::ptr_eq(&ahead.source, self.sheet.source())
                && ahead.turned == self.turned
                && ahead.cue == self.cue
        });
        ahead.map_or_else(|| self.read_file(text, files), |ahead| ahead.read)
    }

    /// Reads a changed file, for [`with_file`](LiveSetpoints::with_file) on another thread: a large one takes longer than a board has plan.
    pub(crate) fn read_ahead(&self, text: &str, files: &FileTexts) -> Option<LiveSetpoints> {
        let read = self.read_file(text, files);
        let setpoints = read.as_ref().ok().cloned();
        if let Some(setpoints) = &setpoints {
            // What is wrong with it is said when the motion is asked for it.
            let _ = setpoints.program();
        }
        let ahead = ReadAhead {
            text: text.to_owned(),
            files: files.clone(),
            source: Arc::clone(self.sheet.source()),
            turned: self.turned.clone(),
            cue: self.cue,
            read,
        };
        *self.ahead.lock().unwrap_or_else(PoisonError::into_inner) = Some(Box::new(ahead));
        setpoints
    }

    fn read_file(&self, text: &str, files: &FileTexts) -> Result<LiveSetpoints, Box<NoMotion>> {
        let mut known = self.files();
        known.extend(files.clone());
        // A text may come from a page or over a socket: it names what this motion has read, or what came with it, and reads nothing else of this
        // computer. Whoever watches the file on the disk sends what it names with it.
        let cache = FileCache { read: Mutex::new(known), loader: None };
        let read = LiveSetpoints::with_cache(text, &self.name, self.board.as_deref(), cache);
        let (mut setpoints, contents) = read.map_err(|error| Box::new(NoMotion::File(error)))?;
        let prepared = Prepared::new(self.name.clone(), contents, self.board.as_deref());
        let program =
            prepared.map_err(|error| Box::new(NoMotion::Other(ChangeRefusal::File(error.to_string()))))?.program;
        check_setup(&self.setup, &program).map_err(|error| Box::new(NoMotion::Other(error)))?;
        (setpoints.setup, setpoints.home) = (Arc::clone(&self.setup), Arc::clone(&self.home));
        setpoints.cue = self.cue.and_then(|taken| {
            let name = &self.live.cues[taken.number].name;
            let number = setpoints.live.cues.iter().position(|cue| cue.name == *name)?;
            Some(CueTaken { number, ..taken })
        });
        let (old, new) = (self.sheet.parameters(), setpoints.sheet().parameters());
        let value = |of: &[pulsetrain_motion::file::SheetParameter], name: &str| {
            of.iter().find(|parameter| parameter.name == name).map(|parameter| parameter.value.clone())
        };
        for (name, turned) in &self.turned {
            let Some(in_new) = value(&new, name) else { continue };
            let is_kept = value(&old, name).is_none_or(|in_old| in_old == in_new);
            if is_kept {
                setpoints.turned.insert(name.clone(), turned.clone());
            }
        }
        Ok(setpoints)
    }

    /// The motors at rest at a position: with its unit, or `0`, where the motion began.
    ///
    /// # Errors
    /// If the text is no position of a motor, or beyond the range of its machine.
    pub fn at_position(&self, text: &str) -> Result<Arc<Program>, ChangeRefusal> {
        let motors = 0..self.setup.motors.len();
        let steps = motors.map(|motor| self.position_of(motor, text)).collect::<Result<Vec<f64>, _>>()?;
        // A changed file may have other ranges.
        let mut known = Program::clone(&self.setup);
        if let Ok(program) = self.program() {
            for (known, new) in known.machines.iter_mut().zip(&program.machines) {
                known.kinematics.clone_from(&new.kinematics);
            }
        }
        let goals: Vec<Option<f64>> = steps.iter().copied().map(Some).collect();
        // The motors can always rest where the motion began.
        if !matches!(text, "0" | START) {
            check_range(&known, &goals)
                .map_err(|error| ChangeRefusal::Value(format!("{error}; {}", error.advice())))?;
        }
        self.resting_at(&steps).map(Arc::new)
    }
}

/// Why a changed motion file is not taken over.
#[derive(Debug, thiserror::Error)]
pub enum NoMotion {
    /// The file is wrong.
    #[error(transparent)]
    File(FileError),
    /// It cannot be taken over while the motors run.
    #[error(transparent)]
    Other(ChangeRefusal),
}

impl FileCache {
    fn lock(&self) -> std::sync::MutexGuard<'_, FileTexts> {
        self.read.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn load(&self, named: &Path) -> io::Result<String> {
        if let Some(text) = self.lock().get(named) {
            return Ok(text.clone());
        }
        let Some(loader) = &self.loader else {
            return Err(io::Error::other("a motion that is sent names only files that the motion named before"));
        };
        let text = loader(named)?;
        self.lock().insert(named.to_owned(), text.clone());
        Ok(text)
    }
}

/// A position of a motor, steps.
fn position(text: &str, motor: &str, example: &str, units: &PositionUnits) -> Result<f64, ChangeRefusal> {
    /// Counts of every board have 32 bits.
    const MAX_STEPS: f64 = 2_147_483_647.0;
    let refuse = |why: String| {
        let help = format!("write it like \"{example}\", or 0, where the motion began");
        ChangeRefusal::Value(format!("{text:?} is no position of motor {motor}: {why}; {help}"))
    };
    let quantity = Quantity::parse(text).map_err(|error| refuse(error.to_string()))?;
    if !quantity.base.is_position() || quantity.per_seconds != 0 {
        return Err(refuse(format!("it is {}", quantity.kind())));
    }
    let steps = units.steps(quantity.base).ok_or_else(|| refuse("it has no `lead`".to_owned()))? * quantity.value;
    if steps.abs() < MAX_STEPS { Ok(steps) } else { Err(refuse("it is too far away".to_owned())) }
}

/// Checks that another program has the same wiring, drivers and board: they are set up once, before the motion.
fn check_setup(setup: &Program, new: &Program) -> Result<(), ChangeRefusal> {
    let refuse = |what: String| Err(ChangeRefusal::Setup(what));
    if setup.board != new.board {
        return refuse(match setup.board.name == new.board.name {
            true => "the motors load the board in another way than before".to_owned(),
            false => format!("the board was \"{}\", and is \"{}\" now", setup.board.name, new.board.name),
        });
    }
    let names = |program: &Program| program.motors.iter().map(|motor| motor.name.clone()).collect::<Vec<_>>();
    if names(setup) != names(new) {
        return refuse(format!("the motors were {}, and are {} now", names(setup).join(", "), names(new).join(", ")));
    }
    for (old, new) in setup.motors.iter().zip(&new.motors) {
        let what = match () {
            () if old.wiring != new.wiring => "the pins",
            () if old.timing != new.timing || old.driver != new.driver => "the driver or its times",
            () if old.scale.steps_per_rev != new.scale.steps_per_rev => "steps_per_rev or microsteps",
            () if old.limits.pull_in != new.limits.pull_in => "the pull-in rate",
            () => continue,
        };
        return refuse(format!("{what} of motor {} changed", old.name));
    }
    if setup.grid != new.grid || setup.idle_ms != new.idle_ms {
        return refuse("`grid` or `idle` changed".to_owned());
    }
    Ok(())
}
