//! A whole run: prove, connect, record, run, finish, judge.

use std::cell::Cell;
use std::io::{self, Write};
use std::path::Path;
use std::sync::mpsc::Receiver;

use pulsetrain_board::{BoardKind, Leased};
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::human;
use pulsetrain_plot::Picture;
use pulsetrain_plot::machine::Drawn;
use pulsetrain_session::Proof;
use pulsetrain_session::control::{Command, Ended, Event};
use pulsetrain_session::drive::{DriveError, Driven};
use pulsetrain_session::lateness::Edges;
use pulsetrain_session::plans::Planned;
use pulsetrain_session::prepare::{Prepared, Refusal, usual_baud};

use crate::error::ErrorReport;
use crate::plan_report::PlanReport;
use crate::positions::{MotorPosition, motor_positions};
use crate::record::{Files, OutputFile, RecordError, Recorded, Recorder, Unwritten};
use crate::recorded_steps::RecordedSteps;
use crate::run_report::{RunEnd, RunReport, StoppedReport};

/// How a motion is run.
#[derive(Clone, Copy, Debug, Default)]
pub struct RunOptions<'a> {
    /// On the native board, even if the motion's board has an emulated chip.
    pub native: bool,
    /// Rate of the line to a virtual board. `None`: its usual one.
    pub baud: Option<Baud>,
    /// By motor: whether it is known where it stands. Empty: all begin where their laws do.
    pub is_known: &'a [bool],
    /// Commands to the run, as they come.
    pub commands: Option<&'a Receiver<Command>>,
}

/// What a run reports while it goes on.
pub trait Progress {
    /// The motion is planned up to `at_s`, s.
    fn planning(&mut self, at_s: f64) {
        let _ = at_s;
    }

    /// Whether the run may begin. It is asked once: the motion is proven, and nothing has moved.
    fn may_begin(&mut self) -> bool {
        true
    }

    /// Something happened in the session.
    fn event(&mut self, event: &Event) {
        let _ = event;
    }
}

/// Nobody looks on.
impl Progress for () {}

/// A run that came to the motion's end, or was stopped on its way by a command.
#[derive(Debug)]
pub struct Run {
    /// The report: JSON by [`json`](crate::json), text by `to_string`.
    pub report: RunReport,
    /// The picture of it.
    pub picture: Picture,
    /// How it ended.
    pub ended: Ended,
    /// Where the motors are, as far as that is known.
    pub positions: Vec<MotorPosition>,
    /// The file that could not be written. The verdict does not depend on it.
    pub unwritten: Option<Unwritten>,
}

/// Why there is no [`Run`].
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The motion breaks a limit. Nothing has moved.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The run may not begin: [`Progress::may_begin`]. Nothing has moved.
    #[error("stopped before it began: no motor has moved")]
    NotBegun,
    /// It cannot be judged.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The board cannot begin, or the motors stopped before the motion's end without a command.
    #[error("{error}")]
    Drive {
        /// Why.
        error: DriveError,
        /// What was made. `None` if nothing moved.
        report: Option<Box<StoppedReport>>,
        /// The file that could not be written.
        unwritten: Option<Unwritten>,
    },
}

impl From<DriveError> for RunError {
    fn from(error: DriveError) -> RunError {
        RunError::Drive { error, report: None, unwritten: None }
    }
}

impl From<&RunError> for ErrorReport {
    fn from(error: &RunError) -> ErrorReport {
        let help = match error {
            RunError::Refused(refusal) => refusal.advice(),
            RunError::Drive { error, .. } => error.advice(),
            RunError::NotBegun | RunError::Record(_) => None,
        };
        ErrorReport { help: help.map(str::to_owned), ..ErrorReport::new(error.to_string()) }
    }
}

/// Runs a motion on the board's emulated chip, or on the native board if there is none: proves it, connects, runs it, judges every edge.
/// A motion that takes long to plan is proven on while it runs.
///
/// `open` opens the files that are wanted, and gives `None` for the others. If the run ends early they end there, complete to that point.
///
/// ```
/// use pulsetrain_report::{json, record::OutputFile, run::{RunOptions, run}};
/// use pulsetrain_motion::file;
/// use pulsetrain_session::prepare::Prepared;
///
/// let text = r#"
/// board = "native"
/// [motor.wheel]
/// steps_per_rev = 200
/// microsteps = 8
/// driver = "A4988"
/// pins = { step = 8, dir = 9 }
/// forward = "high"
/// max_acceleration = "20 rev/s^2"
/// [[motion]]
/// motor = "wheel"
/// law.sine = { amplitude = "45 deg", period = "2 s", cycles = 1 }
/// "#;
/// let no_other_file = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
/// let contents = file::read_contents(text, "wheel.toml", &no_other_file).map_err(|error| error.plain())?;
/// let mut prepared = Prepared::new("wheel.toml".into(), contents, None)?;
/// let mut steps = Vec::new();
/// let mut file = Some(&mut steps);
/// let open = |name| if name == OutputFile::Steps { file.take().map(Ok) } else { None };
/// let run = run(&mut prepared, &RunOptions::default(), open, &mut ())?;
/// assert!(run.report.pass && json(&run.report)?.contains("\"steps_got\": 800"));
/// // A line for each step, below the headings.
/// assert_eq!(String::from_utf8(steps)?.lines().count(), 801);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// When the motion is refused, may not begin, cannot be judged, or stops without a command.
pub fn run<W: Write>(
    prepared: &mut Prepared,
    options: &RunOptions<'_>,
    open: impl FnMut(OutputFile) -> Option<io::Result<W>>,
    progress: &mut impl Progress,
) -> Result<Run, RunError> {
    if !options.native {
        prepared.over_line(options.baud);
    }
    // Before anything moves or is written, the motion is planned, and perhaps refused: all of it, or the beginning of a
    // long one.
    let proof = prepared.prove_first(|at_s| progress.planning(at_s))?;
    if !progress.may_begin() {
        return Err(RunError::NotBegun);
    }
    match BoardKind::emulated(&prepared.program.board.name).filter(|_| !options.native) {
        Some(kind) => {
            let baud = options.baud.unwrap_or_else(|| usual_baud(&prepared.program.board.name));
            let mut driven = Driven::on_virtual(kind, prepared, baud)?;
            let firmware = human::version(driven.board_mut().info().firmware);
            let runner = format!("virtual {}, firmware {firmware}", kind.title());
            let edges = Edges::of(&prepared.program);
            judged(prepared, proof, driven, &edges, runner, options, open, progress)
        }
        None => {
            let driven = Driven::native(prepared)?;
            judged(prepared, proof, driven, &Edges::default(), "native".to_owned(), options, open, progress)
        }
    }
}

#[expect(clippy::too_many_arguments, reason = "the steps of `run` behind the choice of the board")]
fn judged<B: Leased, W: Write>(
    prepared: &Prepared,
    proof: Proof,
    driven: Driven<B>,
    edges: &Edges,
    runner: String,
    options: &RunOptions<'_>,
    open: impl FnMut(OutputFile) -> Option<io::Result<W>>,
    progress: &mut impl Progress,
) -> Result<Run, RunError> {
    let files = Files::new(&prepared.program, &driven.lines, open);
    let RecordedRun { ended, planned, recorded, judged_until_s } =
        record(prepared, proof, driven, Some(files), edges, options.commands, progress).map_err(
            |error| match *error {
                Unfinished::Record(error) => RunError::Record(error),
                Unfinished::Drive { error, planned, made, unwritten } => {
                    let plan = PlanReport::made(prepared, &planned, &made);
                    let report = StoppedReport::of(&error, plan, runner.clone());
                    RunError::Drive { error, report, unwritten }
                }
            },
        )?;
    let Recorded { verdict, picture, lateness, figures, made, unwritten } = recorded;
    let plan = match judged_until_s {
        None => PlanReport::new(prepared, &planned),
        Some(_) => PlanReport::made(prepared, &planned, &made),
    };
    let positions = known_positions(prepared, &ended, options.is_known);
    let mut report = RunReport::new(plan, runner, verdict, lateness, figures);
    report.judged_until_s = judged_until_s;
    report.stopped = ended.stopped.then(|| RunEnd::by_command(&ended, judged_until_s.unwrap_or_default(), &positions));
    Ok(Run { report, picture, ended, positions, unwritten })
}

/// Where the motors are at the end of a run: those of which it was known where they stood. `is_known` is by motor; empty: all.
#[must_use]
pub fn known_positions(prepared: &Prepared, ended: &Ended, is_known: &[bool]) -> Vec<MotorPosition> {
    let uncertain = ended.uncertain.as_deref().unwrap_or_default();
    let all = motor_positions(&prepared.program, &ended.counted, uncertain);
    let mut is_known = is_known.iter();
    all.into_iter().filter(|_| is_known.next().is_none_or(|known| *known)).collect()
}

/// A run that came to the motion's end, or was stopped or changed on its way by a command.
#[derive(Debug)]
pub struct RecordedRun {
    /// How it ended.
    pub ended: Ended,
    /// The figures of each motor's plan.
    pub planned: Vec<Planned>,
    /// Verdict and picture.
    pub recorded: Recorded,
    /// When a command stopped or changed it, s of the motion: the motors left the file's laws then. `None`: at no time.
    pub judged_until_s: Option<f64>,
}

/// A run that did not end as it should.
#[derive(Debug)]
pub enum Unfinished {
    /// It cannot be judged.
    Record(RecordError),
    /// The board could not go on.
    Drive {
        /// Why.
        error: DriveError,
        /// The figures of each motor's plan.
        planned: Vec<Planned>,
        /// What each motor made.
        made: Vec<RecordedSteps>,
        /// The file that could not be written.
        unwritten: Option<Unwritten>,
    },
}

impl From<RecordError> for Box<Unfinished> {
    fn from(error: RecordError) -> Box<Unfinished> {
        Box::new(Unfinished::Record(error))
    }
}

/// Runs and judges a motion that is proven, on a board that is connected. If the run ends early its files end there, complete to that
/// point. Without its files it is judged all the same, since nothing real moves.
///
/// # Errors
/// When the motion cannot be judged, or stops without a command.
pub fn record<B: Leased, W: Write>(
    prepared: &Prepared,
    proof: Proof,
    mut driven: Driven<B>,
    files: Option<Result<Files<W>, Unwritten>>,
    edges: &Edges,
    commands: Option<&Receiver<Command>>,
    progress: &mut impl Progress,
) -> Result<RecordedRun, Box<Unfinished>> {
    let title = format!("{} on {}", file_name(&prepared.file), prepared.program.board.name);
    let drawn = Drawn::of(&prepared.program);
    let mut unopened = None;
    let files = files.and_then(|files| files.map_err(|error| unopened = Some(error)).ok());
    let judged_until_s = Cell::new(None);
    let mut recorder = Recorder::new(&prepared.program, &drawn, &driven.lines, title, files, edges, &judged_until_s)?;
    if !proof.is_whole {
        let before =
            |error| Box::new(Unfinished::Drive { error, planned: Vec::new(), made: Vec::new(), unwritten: None });
        driven = driven.proving(prepared, proof.until_s).map_err(before)?;
    }
    let mut now_s = 0.0;
    let mut look = |event: Event| {
        match &event {
            Event::Progress { at_s } => now_s = *at_s,
            // What was sent before follows the file's laws; the change comes after it.
            Event::Stopping { .. } | Event::StoppedAtOnce { .. } | Event::Pausing { .. } | Event::Tempo { .. } => {
                judged_until_s.set(judged_until_s.get().or(Some(now_s)));
            }
            _ => {}
        }
        progress.event(&event);
    };
    let ended = match commands {
        None => driven.run(&mut recorder, &mut look),
        Some(commands) => driven.run_with(commands, &mut recorder, &mut look),
    };
    let planned = if proof.is_whole { proof.planned } else { driven.planned() };
    match ended {
        Err(error) => {
            let (made, unwritten) = recorder.close();
            Err(Box::new(Unfinished::Drive { error, planned, made, unwritten: unopened.or(unwritten) }))
        }
        Ok(ended) => {
            let recorded = recorder.finish(&planned, driven.lateness().unwrap_or_default())?;
            let recorded = Recorded { unwritten: unopened.or(recorded.unwritten), ..recorded };
            Ok(RecordedRun { ended, planned, recorded, judged_until_s: judged_until_s.get() })
        }
    }
}

/// The name of a file without its folders.
#[must_use]
pub fn file_name(path: &str) -> String {
    Path::new(path).file_name().map_or_else(|| path.to_owned(), |name| name.to_string_lossy().into_owned())
}
