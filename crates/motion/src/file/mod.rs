//! Motion files: TOML in, a checked [`Program`] out, or errors that point at the place.
//!
//! ```toml
//! board = "uno"                       # uno, due, pico or native
//! grid = "reach"                      # or "nearest" (default), or { hysteresis = "0.1 step" }
//! tolerance = "1 tick"                # or a time, such as "1 us"
//! idle = "hold"                       # or a rest, such as "2 s", after which drivers and coils are switched off
//!
//! [motor.wheel]
//! steps_per_rev = 200
//! microsteps = 4
//! driver = "DQ542MA"
//! pins = { step = 8, dir = 9 }
//! forward = "low"
//!
//! [[motion]]
//! motor = "wheel"
//! law.sine = { amplitude = "2.5 rev", period = "1 s", cycles = 10 }
//! ```
//!
//! docs/motion-files.md describes every key. Amounts carry their unit; "rev", "deg" and "rad" are of what the motor
//! drives, behind its gear. Motions of one motor follow one another, each from where the one before ended; motors run
//! side by side from one common time zero.
//!
//! # What is here
//! - [`load`], [`read`]: the two ways in; [`load_contents`], [`read_contents`]: the same, with how tables were read
//! - [`FileError`], [`Problem`]: what is wrong, where, and what to do, in parts or as plain text; [`Source`]: the text that it is in
//! - `motor`, `machine`, `laws`, `path`, `formula`, `points`, `winch`: one module for each part of the file
//! - [`Sheet`]: a file whose values are changed before it is read; [`Live`]: its knobs and cues
//! - `reader`: values with their places; problems are collected, so that one reading finds several

mod context;
mod formula;
mod laws;
mod live;
mod machine;
mod midi;
mod motor;
mod path;
mod points;
mod problem;
mod reader;
mod sheet;
mod source;
mod syntax;
mod table_columns;
mod text;
mod winch;
mod winches;

use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

pub use live::{Cue, Knob, Live, ORDERS, Period, RestPlace, TimeOfDay};
pub use midi::{Midi, MidiDial, MidiKey, MidiOrder};
pub use problem::{BrokenPath, FileError, PathPoint, Problem};
pub use sheet::{ParameterValue, Sheet, SheetParameter, UnknownParameter};
pub use source::Source;
pub use table_columns::{ColumnDistance, ColumnUse, Smoothing, TableColumns};
pub use text::{
    MOST_OF_A_MOTION_FILE, MOST_OF_A_NAMED_FILE, csv_text, decoded, open_named, read_named, read_named_text,
};
pub use winch::WinchScript;

use crate::boards::{self, BoardProfile};
use crate::law::{Cursor, Law};
use crate::program::{LONGEST_IDLE_MS, Motor, PositionUnits, Program, TipRecording, Tolerance, Wheel};
use crate::quantity::{Base, nearest};
use crate::{Grid, Time};
use context::{Context, Loader, refuse};
use machine::Home;
use motor::{Gearing, MotorDraft};
use reader::{Node, Noted, Read, Reader, Section};
use toml_edit::Table;

/// A motion file's program, and how its tables were read.
#[derive(Clone, Debug)]
pub struct Contents {
    /// What is to be done.
    pub program: Program,
    /// The columns of every CSV file, as they were read.
    pub tables: Vec<TableColumns>,
    /// What the motors turn, in their order.
    pub wheels: Vec<Wheel>,
    /// What may be changed while the motion runs.
    pub live: Live,
    /// Of each machine of the program: its recording, if it is a delta robot whose only motion that is.
    pub recordings: Vec<Option<TipRecording>>,
}

impl Contents {
    /// The units of each motor's positions, in the program's order.
    #[must_use]
    pub fn units(&self) -> Vec<PositionUnits> {
        self.wheels.iter().map(|wheel| wheel.units).collect()
    }
}

/// Reads a motion file and the files that it names.
///
/// # Errors
/// [`FileError`] with every problem found.
pub fn load(path: &Path) -> Result<Program, FileError> {
    load_contents(path).map(|contents| contents.program)
}

/// Reads a motion file as [`load`] does, and also tells how its tables were read.
///
/// # Errors
/// As [`load`].
pub fn load_contents(path: &Path) -> Result<Contents, FileError> {
    load_contents_by(path, &read_named_text)
}

/// Gives the text of the file at a path, of so many bytes at most: [`read_named_text`], or what also notes the path.
pub type ReadText<'a> = &'a dyn Fn(&Path, u64) -> io::Result<String>;

/// Reads a motion file as [`load_contents`] does; `read` gives the text of it and of the files that it names.
///
/// # Errors
/// As [`load`].
pub fn load_contents_by(path: &Path, read: ReadText<'_>) -> Result<Contents, FileError> {
    let (name, text) = open(path, read)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    read_contents(&text, &name, &|named| read(&folder.join(named), MOST_OF_A_NAMED_FILE))
}

/// Reads a motion file for the command lines of its winch, to send them to a board as text; `read` gives the text of it and of the files that it names.
///
/// # Errors
/// [`FileError`] with every problem found; also when the file has other motions, which a line of text cannot say.
pub fn load_winch(path: &Path, read: ReadText<'_>) -> Result<WinchScript, FileError> {
    let (name, text) = open(path, read)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let load = |named: &Path| read(&folder.join(named), MOST_OF_A_NAMED_FILE);
    let sheet = Sheet::parse(&text, &name)?;
    read_with(sheet.source(), sheet.table(), |root| {
        program(root, sheet.table(), &load, boards::BUILT_IN)?;
        winch::script(root, &load)
    })
}

/// How a user begins.
const NEW: &str = "`pulsetrain new NAME` writes a motion file to begin with";

/// The name of a file, and its text.
fn open(path: &Path, read: ReadText<'_>) -> Result<(String, String), FileError> {
    let name = path.display().to_string();
    let text = read(path, MOST_OF_A_MOTION_FILE).map_err(|error| {
        let source = Arc::new(Source::new(&name, ""));
        let help = match error.kind() {
            io::ErrorKind::NotFound => Some(NEW.to_owned()),
            _ => None,
        };
        FileError::whole(&source, format!("cannot read {name}: {}", text::why(&error)), help)
    })?;
    Ok((name, text))
}

/// Reads the text of a motion file called `name`; `load` gives the text of the files that it names.
///
/// # Errors
/// [`FileError`] with every problem found.
///
/// ```
/// use pulsetrain_motion::file;
/// let none = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
/// let error = file::read("bord = \"uno\"", "my.toml", &none).unwrap_err();
/// assert!(error.plain().starts_with("my.toml:1:1: unknown key `bord` in the motion file\n    did you mean `board`?"));
/// ```
pub fn read(text: &str, name: &str, load: &dyn Fn(&Path) -> io::Result<String>) -> Result<Program, FileError> {
    read_contents(text, name, load).map(|contents| contents.program)
}

/// Reads a motion file's text as [`read`] does, and also tells how its tables were read.
///
/// # Errors
/// As [`read`].
pub fn read_contents(
    text: &str,
    name: &str,
    load: &dyn Fn(&Path) -> io::Result<String>,
) -> Result<Contents, FileError> {
    Sheet::parse(text, name)?.contents(load)
}

/// The `law.…` of a motor's first `[[motion]]`, as written in the file, on one line. `None` if a machine moves the motor, or if the text is no
/// motion file.
///
/// ```
/// use pulsetrain_motion::file;
/// let text = "[[motion]]\nmotor = \"a\"\nlaw.rest = { duration = \"1 s\" }\n[[motion]]\nmotor = \"b\"\nlaw.sine = {  period = \"2 s\" }";
/// assert_eq!(file::first_law(text, "b").as_deref(), Some("law.sine = { period = \"2 s\" }"));
/// assert_eq!(file::first_law(text, "c"), None);
/// ```
#[must_use]
pub fn first_law(text: &str, motor: &str) -> Option<String> {
    let document = toml_edit::Document::parse(text).ok()?;
    let motions = document.as_table().get("motion")?.as_array_of_tables()?;
    let is_of_motor = |motion: &&toml_edit::Table| motion.get("motor").and_then(|name| name.as_str()) == Some(motor);
    let law = motions.iter().find(is_of_motor)?.get("law")?.as_table_like()?;
    let (name, value) = law.iter().next()?;
    let value = value.as_value()?.to_string();
    Some(format!("law.{name} = {}", value.split_whitespace().collect::<Vec<_>>().join(" ")))
}

fn contents_of(root: &Section, table: &Table, load: Loader, boards: &[&'static BoardProfile]) -> Read<Contents> {
    let contents = program(root, table, load, boards)?;
    Ok(Contents { tables: root.reader.tables.take(), ..contents })
}

fn read_with<T>(source: &Arc<Source>, table: &Table, what: impl Fn(&Section) -> Read<T>) -> Result<T, FileError> {
    let reader = Reader::new(Arc::clone(source));
    let found = what(&Section::root(&reader, table));
    let (problems, others) = reader.into_problems();
    match (found, FileError::of(problems, others)) {
        (Ok(found), None) => Ok(found),
        (_, Some(error)) => Err(error),
        // `Noted` is made by noting alone, so this cannot be; but a wrong file must never pass.
        (Err(Noted), None) => Err(FileError::whole(source, "the file cannot be used".to_owned(), None)),
    }
}

fn program(root: &Section, table: &Table, load: Loader, boards: &[&'static BoardProfile]) -> Read<Contents> {
    root.check_keys(&["board", "grid", "tolerance", "idle", "motor", "machine", "motion", "live", "cue"]);
    let board = read_board(root, boards);
    let grid = root.get("grid").map_or(Ok(Grid::NEAREST), |node| read_grid(&node));
    let tolerance = root.get("tolerance").map(|node| read_tolerance(&node)).transpose();
    let idle = root.get("idle").map_or(Ok(None), |node| read_idle(&node));
    let drafts = motor::read_all(root, board.as_ref().ok().copied());
    let machine_drafts = machine::read_all(root, &drafts);
    let mut homes: Vec<Option<Home>> = machine_drafts.iter().map(|_| None).collect();
    let timelines = read_motions(root, &drafts, &machine_drafts, &mut homes, load);
    if timelines.iter().all(Read::is_ok) {
        winch::refuse_strays(root.reader);
    }
    let live = live::read(root, table, &drafts, &machine_drafts, load);
    let board = board?.limits();
    let tolerance = tolerance?.unwrap_or_else(|| Tolerance::default_of(&board));
    let mut motors = Vec::new();
    let mut gearings = Vec::new();
    let mut slack = Vec::new();
    let mut wheels = Vec::new();
    for ((_, draft), timeline) in drafts.into_iter().zip(timelines) {
        let draft = draft?;
        motors.push(Motor {
            law: timeline?.finish(root.reader, &draft)?,
            scale: draft.gearing.scale(),
            name: draft.name,
            wiring: draft.wiring?,
            driver: draft.driver,
            timing: draft.timing?,
            limits: draft.limits,
            winding: draft.winding,
        });
        wheels.push(Wheel { units: draft.gearing.position_units(), limit_steps: draft.film_limit });
        slack.push(draft.backlash.map_or(0.0, |backlash| backlash.steps));
        gearings.push(draft.gearing);
    }
    let (mut machines, mut recordings) = (Vec::new(), Vec::new());
    for ((_, draft), home) in machine_drafts.into_iter().zip(homes) {
        let draft = draft?;
        let gearings: Vec<&Gearing> = draft.motors.iter().map(|motor| &gearings[*motor]).collect();
        let slack: Vec<f64> = draft.motors.iter().map(|motor| slack[*motor]).collect();
        machines.push(draft.finish(root, &motors, &gearings, &slack, home.as_ref())?);
        recordings.push(home.and_then(|home| Some(TipRecording { begin: home.at, tip: home.tip? })));
    }
    let (grid, idle_ms) = (grid?, idle?);
    let program = Program { board, grid, tolerance, idle_ms, motors, machines, queue_parts: Vec::new() };
    Ok(Contents { program, tables: Vec::new(), wheels, live: live?, recordings })
}

fn read_board(root: &Section, boards: &[&'static BoardProfile]) -> Read<&'static BoardProfile> {
    let node = root.need("board", "board = \"uno\"")?;
    let name = node.text("board = \"uno\"")?;
    boards::find_in(boards, name).ok_or_else(|| {
        let names: Vec<&str> = boards.iter().map(|board| board.name).collect();
        let help = match (boards::renamed(name), nearest(name, names.iter().copied())) {
            (Some(board), _) => format!("write `board = \"{board}\"`: its firmware has these rates now"),
            (None, Some(near)) => format!("did you mean \"{near}\"?"),
            (None, None) => format!("known: {}", names.join(", ")),
        };
        node.note("not in the table", format!("unknown board \"{name}\""), help)
    })
}

fn read_grid(node: &Node) -> Read<Grid> {
    if node.as_text().is_some() {
        return node.word(&[("nearest", Grid::NEAREST), ("reach", Grid::REACH)]);
    }
    const EXAMPLE: &str = "grid = \"nearest\", \"reach\", or { hysteresis = \"0.1 step\" }";
    let section = node.section("the grid".to_owned(), &["hysteresis"], EXAMPLE)?;
    let node = section.need("hysteresis", EXAMPLE)?;
    let hysteresis = node.measure(Base::Step, 0, "0.1 step")?;
    if (0.0..=0.5).contains(&hysteresis) {
        return Ok(Grid { hysteresis });
    }
    Err(node.note("out of range", "`hysteresis` must be from 0 to 0.5 step", ""))
}

fn read_tolerance(node: &Node) -> Read<Tolerance> {
    /// No schedule of whole ticks can be proven closer: half a tick is its rounding.
    const MIN_TICKS: f64 = 0.55;
    let quantity = node.quantity("1 tick")?;
    match (quantity.base, quantity.per_seconds) {
        (Base::Tick, 0) if quantity.value >= MIN_TICKS => Ok(Tolerance::Ticks(quantity.value)),
        (Base::Tick, 0) => {
            let message =
                format!("`tolerance` must be {MIN_TICKS} ticks at least: ticks are whole, which costs half of one");
            Err(node.note("too small", message, "write tolerance = \"1 tick\""))
        }
        (Base::Time, 0) => Ok(Tolerance::Seconds(node.above_zero(quantity.value)?)),
        _ => {
            let message = format!("`tolerance` must be a time or a number of ticks, but this is {}", quantity.kind());
            Err(node.note(quantity.kind().to_string(), message, "write tolerance = \"1 tick\", or \"1 us\""))
        }
    }
}

/// Whole milliseconds, or none at all.
fn read_idle(node: &Node) -> Read<Option<u16>> {
    if node.as_text() == Some("hold") {
        return Ok(None);
    }
    let seconds = node.measure(Base::Time, 0, "2 s")?;
    let ms = (seconds * 1000.0).round();
    if (1.0..=f64::from(LONGEST_IDLE_MS)).contains(&ms) {
        return Ok(Some(ms as u16));
    }
    let (message, help) = (
        format!("`idle` must be from 1 ms to {} s, but this is {seconds} s", LONGEST_IDLE_MS / 1000),
        "write idle = \"hold\" for motors that are never switched off",
    );
    Err(node.note("out of range", message, help))
}

/// What one motor does, in order, from the common time zero on.
#[derive(Default)]
struct Timeline {
    laws: Vec<Law>,
    /// When what is there ends; `None`: never.
    end: Option<Time>,
    /// Where the last motion is written.
    last: Option<Range<usize>>,
}

impl Timeline {
    /// Appends a motion of `law`, resting before it until `start` if that is given: at `rests_at`, steps, if it is the first.
    fn push(&mut self, motion: &Section, start: Option<(Time, Node)>, law: Law, rests_at: f64) -> Read<()> {
        let before = || self.last.clone().map(|at| (at, "the motion before".to_owned()));
        let Some(end) = self.end else {
            let mut labels = vec![(motion.at.clone(), "never begins".to_owned())];
            labels.extend(before());
            let help = "give the motion before a duration, cycles or repeat that ends; or use law.sum for both at once";
            return Err(motion.reader.note_all(labels, "the motor's motion before this one never ends", help));
        };
        if let Some((start, node)) = start {
            if start < end {
                let mut labels = vec![(node.at.clone(), format!("at {} s", start.seconds()))];
                labels.extend(before());
                let message = format!("the motor's motion before this one ends later, at {} s", end.seconds());
                return Err(motion.reader.note_all(labels, message, "motions of one motor follow one another"));
            }
            if start > end {
                let rest = Law::rest(start - end);
                let rest = if rests_at == 0.0 { rest } else { rest.and_then(|rest| rest.shifted(rests_at)) };
                self.laws.push(rest.map_err(|error| refuse(&node, &error))?);
                self.end = Some(start);
            }
        }
        self.end = self.end.zip(law.end()).map(|(begin, length)| begin + length);
        self.laws.push(law);
        self.last = Some(motion.at.clone());
        Ok(())
    }

    /// Whether what is there never ends.
    fn is_endless(&self) -> bool {
        self.end.is_none()
    }

    /// All of it as one law.
    fn finish(self, reader: &Reader, draft: &MotorDraft) -> Read<Law> {
        let law = self.joined(reader, draft)?;
        let Some(backlash) = &draft.backlash else { return Ok(law) };
        law.with_backlash(backlash.steps, backlash.over)
            .map_err(|error| reader.note(backlash.at.clone(), "out of range", format!("`backlash`: {error}"), ""))
    }

    fn joined(mut self, reader: &Reader, draft: &MotorDraft) -> Read<Law> {
        match self.laws.len() {
            0 => {
                let message = format!("motor `{}` has no motion", draft.name);
                let help = format!("add [[motion]] with motor = \"{}\", or take the motor out", draft.name);
                Err(reader.note(draft.at.clone(), "never moves", message, help))
            }
            1 => Ok(self.laws.remove(0)),
            _ => Law::then(self.laws).map_err(|error| {
                let message = format!("the motions of motor `{}` do not join: {error}", draft.name);
                reader.note(draft.at.clone(), "this motor", message, "")
            }),
        }
    }
}

/// `[[motion]]`: the timeline of each motor, in the motors' order.
fn read_motions(
    root: &Section,
    drafts: &[(String, Read<MotorDraft>)],
    machines: &[(String, Read<machine::MachineDraft>)],
    homes: &mut [Option<Home>],
    load: Loader,
) -> Vec<Read<Timeline>> {
    const EXAMPLE: &str =
        "[[motion]] with motor = \"wheel\" and law.sine = { amplitude = \"1 rev\", period = \"1 s\" }";
    let start = || Ok(Timeline { end: Some(Time::ZERO), ..Timeline::default() });
    let mut timelines: Vec<Read<Timeline>> = drafts.iter().map(|_| start()).collect();
    let Ok(motions) = root.need("motion", EXAMPLE).and_then(|node| {
        // [motion] instead of [[motion]] is easily written, and means one.
        if node.is_table() { Ok(vec![node]) } else { node.list(EXAMPLE) }
    }) else {
        timelines.iter_mut().for_each(|timeline| *timeline = Err(Noted));
        return timelines;
    };
    // Where each machine's motors are after its last path, steps.
    let mut last: Vec<Option<Vec<f64>>> = machines.iter().map(|_| None).collect();
    for node in motions.into_iter().filter(|_| !drafts.is_empty()) {
        const KEYS: &[&str] = &["motor", "motors", "machine", "law", "path", "start", "repeat", "ease", "begin", "end"];
        let Ok(motion) = node.section("the motion".to_owned(), KEYS, EXAMPLE) else { continue };
        if let Some(node) = motion.get("machine") {
            let Ok(machine) = machine::named(&node, machines) else {
                blame_nobody(&mut timelines);
                continue;
            };
            let index = machines.iter().position(|(name, _)| *name == machine.name).unwrap_or_default();
            let moved = read_path(&motion, &node, machine, drafts, load, &mut timelines, last[index].as_deref());
            match moved {
                Ok((home, end)) => {
                    match &mut homes[index] {
                        // Two paths are no longer one recording.
                        Some(first) => first.tip = None,
                        none => *none = Some(home),
                    }
                    last[index] = Some(end);
                }
                Err(Noted) => machine.motors.iter().for_each(|motor| timelines[*motor] = Err(Noted)),
            }
            continue;
        }
        let Ok(indices) = motors_of(&motion, drafts) else {
            blame_nobody(&mut timelines);
            continue;
        };
        for index in indices {
            if let Some(robot) = arm_of(index, machines) {
                let message =
                    format!("motor `{}` is an arm of machine `{robot}`, and moves with it alone", drafts[index].0);
                motion.reader.note(
                    motion.at.clone(),
                    "an arm's motion",
                    message,
                    format!("write machine = \"{robot}\" and a path"),
                );
                timelines[index] = Err(Noted);
                continue;
            }
            let moved = match (&drafts[index].1, &mut timelines[index]) {
                (Ok(draft), Ok(timeline)) => read_motion(&motion, draft, load, timeline),
                _ => Err(Noted),
            };
            if moved.is_err() {
                timelines[index] = Err(Noted);
            }
        }
    }
    timelines
}

/// Whose motion one was meant to be is not known: no motor is then blamed for having none.
fn blame_nobody(timelines: &mut [Read<Timeline>]) {
    timelines.iter_mut().filter(|t| t.as_ref().is_ok_and(|t| t.laws.is_empty())).for_each(|t| *t = Err(Noted));
}

/// The delta robot that a motor is an arm of.
fn arm_of(motor: usize, machines: &[(String, Read<machine::MachineDraft>)]) -> Option<&str> {
    machines.iter().find_map(|(name, draft)| {
        let draft = draft.as_ref().ok()?;
        (matches!(draft.kind, machine::MachineKind::Delta { .. }) && draft.motors.contains(&motor))
            .then_some(name.as_str())
    })
}

/// A machine's motion: its motors begin it together. Gives where they stand then, and where at its end.
fn read_path(
    motion: &Section,
    node: &Node,
    machine: &machine::MachineDraft,
    drafts: &[(String, Read<MotorDraft>)],
    load: Loader,
    timelines: &mut [Read<Timeline>],
    last: Option<&[f64]>,
) -> Read<(Home, Vec<f64>)> {
    for key in ["motor", "motors"] {
        if motion.get(key).is_some() {
            let message = format!("a motion has either `machine` or `{key}`");
            return Err(motion.reader.note(motion.key_span(key), "one too many", message, "leave one of them out"));
        }
    }
    let motors = machine.motors.iter().map(|motor| drafts[*motor].1.as_ref().map_err(|Noted| Noted));
    let reading = path::PathReader { machine, motors: motors.collect::<Read<_>>()?, load };
    let path = reading.path(motion, last);
    let start = motion.get("start").map(|node| Ok((node.time("1 s")?, node))).transpose();
    let (path::Joints { laws, end, tip }, start) = (path?, start?);
    // When the last of them has ended what came before; one that never ends is an error of `push`.
    let ends = machine.motors.iter().filter_map(|motor| timelines[*motor].as_ref().ok()?.end);
    let together = ends.fold(Time::ZERO, Time::max);
    let begin = start.as_ref().map_or(together, |(start, _)| *start);
    let mut home = Home { at: begin, steps: Vec::new(), tip };
    for (motor, law) in machine.motors.iter().zip(laws) {
        let first = Cursor::new(&law).at(Time::ZERO).map_err(|error| refuse(node, &error))?;
        home.steps.push(first.position);
        let at = start.clone().unwrap_or_else(|| (together, node.clone()));
        match &mut timelines[*motor] {
            // The motor waits where the path begins, so that its positions are those of the machine.
            Ok(timeline) => timeline.push(motion, Some(at), law, first.position)?,
            Err(Noted) => return Err(Noted),
        }
    }
    Ok((home, end))
}

/// Which motors a motion is for.
fn motors_of(motion: &Section, drafts: &[(String, Read<MotorDraft>)]) -> Read<Vec<usize>> {
    let nodes = match (motion.get("motor"), motion.get("motors")) {
        (Some(_), Some(both)) => {
            return Err(both.note("one too many", "a motion has either `motor` or `motors`", "leave one of them out"));
        }
        (None, Some(list)) => list.list("motors = [\"left\", \"right\"]")?,
        _ => vec![motion.need("motor", "motor = \"wheel\"")?],
    };
    if nodes.is_empty() {
        return Err(motion.reader.note(motion.key_span("motors"), "empty", "the motion has no motors", ""));
    }
    let mut found: Vec<usize> = Vec::new();
    for node in nodes {
        let index = motor_named(&node, drafts)?;
        if found.contains(&index) {
            let message = format!("the motion names motor \"{}\" twice", drafts[index].0);
            return Err(node.note("named twice", message, ""));
        }
        found.push(index);
    }
    Ok(found)
}

/// The motor that is named at `node`.
fn motor_named(node: &Node, drafts: &[(String, Read<MotorDraft>)]) -> Read<usize> {
    let name = node.text("motor = \"wheel\"")?;
    drafts.iter().position(|(known, _)| known == name).ok_or_else(|| {
        let names = || drafts.iter().map(|(name, _)| name.as_str());
        let help = match nearest(name, names()) {
            Some(near) => format!("did you mean \"{near}\"?"),
            None => format!("the file's motors: {}", names().collect::<Vec<_>>().join(", ")),
        };
        node.note("not a motor of this file", format!("unknown motor \"{name}\""), help)
    })
}

fn read_motion(motion: &Section, draft: &MotorDraft, load: Loader, timeline: &mut Timeline) -> Read<()> {
    if let Some(path) = motion.get("path") {
        return Err(path.note(
            "of a machine",
            "`path` is for machines",
            "write `law` for a motor, or name a `machine`",
        ));
    }
    let context =
        Context { reader: motion.reader, motor: &draft.name, gearing: &draft.gearing, limits: &draft.limits, load };
    let node = motion.need("law", "law.sine = { amplitude = \"1 rev\", period = \"1 s\" }")?;
    let law = context.law(&node);
    let start = motion.get("start").map(|node| Ok((node.time("1 s")?, node))).transpose();
    let repeat = motion.get("repeat").map(|node| Ok((laws::times(&node)?, node))).transpose();
    let mut law = law?;
    if let Some((times, repeat)) = repeat? {
        law = law.repeated(times).map_err(|error| refuse(&repeat, &error))?;
    }
    if let Some(node) = motion.get("ease") {
        law = law.eased(node.duration("0.5 s")?).map_err(|error| refuse(&node, &error))?;
    }
    let law = context.blended(motion, law)?;
    timeline.push(motion, start?, law, 0.0)
}
