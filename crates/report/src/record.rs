//! Records a run while it goes on: files, verdict and picture.

use std::cell::Cell;
use std::io::{self, Write};

use pulsetrain_board::{Edge, Observer, ScheduledStep};
use pulsetrain_core::Direction;
use pulsetrain_motion::program::Program;
use pulsetrain_motion::{LawError, Time};
use pulsetrain_trace::verdict::{EdgeJudge, JudgeError, Report};
use pulsetrain_trace::{Line, steps, vcd_file};

use crate::recorded_steps::RecordedSteps;
use pulsetrain_plot::machine::{Drawn, Figure, FigureReport};
use pulsetrain_plot::{Errors, MotorPicture, Picture};
use pulsetrain_session::lateness::{Edges, Lateness};
use pulsetrain_session::plans::Planned;

/// A file of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputFile {
    /// Every edge of every line, as VCD.
    Trace,
    /// Every step, as CSV.
    Steps,
}

impl OutputFile {
    /// Its name, without a folder.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            OutputFile::Trace => "trace.vcd",
            OutputFile::Steps => "steps.csv",
        }
    }
}

/// A file of a run cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {}: {error}", .file.name())]
pub struct Unwritten {
    /// Which one.
    pub file: OutputFile,
    /// Why.
    // Its text is in the message, so it is no source: else it would be printed twice.
    pub error: io::Error,
}

/// The files for the edges and steps of a run.
pub struct Files<W: Write> {
    /// Every edge of every line. `None`: not wanted.
    trace: Option<vcd_file::EdgeWriter<W>>,
    /// Every step. `None`: not wanted.
    steps: Option<steps::StepWriter<W>>,
}

impl<W: Write> Files<W> {
    /// Begins the files of a run of `program`, with its lines at their levels of time zero. `open` opens those that are wanted, and gives `None`
    /// for the others.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn new(
        program: &Program,
        lines: &[Line],
        mut open: impl FnMut(OutputFile) -> Option<io::Result<W>>,
    ) -> Result<Files<W>, Unwritten> {
        let names: Vec<String> = program.motors.iter().map(|motor| motor.name.clone()).collect();
        let tick_hz = program.board.tick_hz;
        let trace = open(OutputFile::Trace).map(|file| vcd_file::EdgeWriter::new(file?, tick_hz, lines)).transpose();
        let trace = trace.map_err(unwritten(OutputFile::Trace))?;
        let steps = open(OutputFile::Steps).map(|file| steps::StepWriter::new(file?, tick_hz, &names)).transpose();
        let steps = steps.map_err(unwritten(OutputFile::Steps))?;
        Ok(Files { trace, steps })
    }

    fn edge(&mut self, edge: pulsetrain_trace::Edge) -> Result<(), Unwritten> {
        self.trace.as_mut().map_or(Ok(()), |trace| trace.push(edge)).map_err(unwritten(OutputFile::Trace))
    }

    fn step(&mut self, step: steps::Step) -> Result<(), Unwritten> {
        self.steps.as_mut().map_or(Ok(()), |steps| steps.push(step)).map_err(unwritten(OutputFile::Steps))
    }

    /// Writes what is left in buffers.
    fn finish(self) -> Result<(), Unwritten> {
        let steps = self.steps.map_or(Ok(()), |steps| steps.finish().map(drop));
        let trace = self.trace.map_or(Ok(()), |trace| trace.finish().map(drop));
        trace.map_err(unwritten(OutputFile::Trace))?;
        steps.map_err(unwritten(OutputFile::Steps))
    }
}

fn unwritten(file: OutputFile) -> impl FnOnce(io::Error) -> Unwritten {
    move |error| Unwritten { file, error }
}

/// Why a run could not be recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The judge cannot give a verdict.
    #[error(transparent)]
    Judge(#[from] JudgeError),
    /// A law has no value where it is drawn.
    #[error("motor {motor}: {error}")]
    Law {
        /// The motor whose law it is.
        motor: String,
        /// The law's error.
        error: LawError,
    },
}

/// Observes a board while it runs.
pub struct Recorder<'a, W: Write> {
    program: &'a Program,
    judge: EdgeJudge<'a>,
    files: Option<Files<W>>,
    picture: Picture,
    figures: Vec<Figure<'a>>,
    made: Vec<RecordedSteps>,
    tick_s: f64,
    late_ticks: f64,
    /// Up to when the motion follows the program's laws, s; `None`: to its end, so far.
    judged_until_s: &'a Cell<Option<f64>>,
    /// The first error of a file. The verdict does not depend on files, so the recording goes on without them.
    unwritten: Option<Unwritten>,
    /// The first other error. Nothing is recorded after it.
    error: Option<RecordError>,
}

/// The verdict and the picture of a run.
#[derive(Debug)]
pub struct Recorded {
    /// The judge's verdict on the edges.
    pub verdict: Report,
    /// The picture.
    pub picture: Picture,
    /// How late STEP edges were against their scheduled ticks.
    pub lateness: Lateness,
    /// The errors of machines' figures, in the file's order.
    pub figures: Vec<FigureReport>,
    /// What each motor made.
    pub made: Vec<RecordedSteps>,
    /// The file that could not be written.
    pub unwritten: Option<Unwritten>,
}

impl<'a, W: Write> Recorder<'a, W> {
    /// Begins before the first edge. The board's edges come `constant_ticks` after their scheduled ticks, and up to
    /// `late_ticks` later, so both are added to the bound. `drawn` is [`Drawn::of`] the program. Edges after `judged_until_s` are not judged: it may be
    /// set on the way, when somebody stops or changes the motion.
    ///
    /// # Errors
    /// When the program cannot be judged.
    pub fn new(
        program: &'a Program,
        drawn: &'a Drawn,
        lines: &[Line],
        title: String,
        files: Option<Files<W>>,
        edges: &Edges,
        judged_until_s: &'a Cell<Option<f64>>,
    ) -> Result<Self, RecordError> {
        let tick_hz = program.board.tick_hz;
        let tick_s = 1.0 / tick_hz as f64;
        let options = edges.options(program, None);
        let judge = EdgeJudge::new(tick_hz, lines, program, &options)?.keeping_errors();
        let motors = program.motors.iter();
        let motors: Vec<_> =
            motors.map(|motor| MotorPicture::new(motor.name.clone(), motor.scale.clone(), 0.0)).collect();
        let made = vec![RecordedSteps::default(); motors.len()];
        Ok(Recorder {
            program,
            judge,
            files,
            picture: Picture { title, tick_s, motors, errors: Errors::Ticks, figures: Vec::new(), changes: Vec::new() },
            figures: Figure::all(program, drawn),
            made,
            tick_s,
            late_ticks: edges.late_ticks.into(),
            judged_until_s,
            unwritten: None,
            error: None,
        })
    }

    /// Ends the recording after the last edge. Gives the verdict and the picture.
    ///
    /// # Errors
    /// The first error of the recording.
    pub fn finish(self, planned: &[Planned], lateness: Lateness) -> Result<Recorded, RecordError> {
        let Recorder {
            program,
            mut judge,
            files,
            mut picture,
            figures,
            made,
            tick_s,
            late_ticks,
            unwritten,
            error,
            ..
        } = self;
        let until_s = self.judged_until_s.get();
        if let Some(until_s) = until_s {
            judge.end_at(until_s);
        }
        if let Some(error) = error {
            return Err(error);
        }
        let unwritten = unwritten.or(files.and_then(|files| files.finish().err()));
        let mut verdict = judge.finish_with(&mut |motor, tick, late| {
            picture.motors[motor].error(tick as f64 * tick_s, late);
        })?;
        // The lateness contains the board's constant delay. So the trace's time zero is that of the laws.
        verdict.alignment.shift_s = 0.0;
        let window = picture.close_view();
        for ((drawn, motor), planned) in picture.motors.iter_mut().zip(&program.motors).zip(planned) {
            drawn.bound_ticks = planned.certificate.bound_ticks;
            drawn.late_ticks = late_ticks;
            drawn
                .want_law(&motor.law, until_s.map_or(Time::MAX, Time::from_seconds))
                .and_then(|()| window.map_or(Ok(()), |window| drawn.want_closely(&motor.law, window)))
                .map_err(|error| RecordError::Law { motor: motor.name.clone(), error })?;
        }
        let (figures, pictures) = figures.into_iter().filter_map(Figure::finish).unzip();
        picture.figures = pictures;
        Ok(Recorded { verdict, picture, lateness, figures, made, unwritten })
    }

    /// Ends the files of a run that stopped early. Gives what each motor made, and the file that could not be written.
    pub fn close(self) -> (Vec<RecordedSteps>, Option<Unwritten>) {
        (self.made, self.unwritten.or(self.files.and_then(|files| files.finish().err())))
    }

    /// Ends the files where one of them cannot be written.
    fn written(&mut self, result: Result<(), Unwritten>) {
        if let Err(error) = result {
            self.unwritten.get_or_insert(error);
            self.files = None;
        }
    }

    fn note<T, E: Into<RecordError>>(&mut self, result: Result<T, E>) {
        if let Err(error) = result {
            self.error.get_or_insert(error.into());
        }
    }
}

impl<W: Write> Observer for Recorder<'_, W> {
    fn edge(&mut self, edge: Edge) {
        if self.error.is_some() {
            return;
        }
        let edge = pulsetrain_trace::Edge { tick: edge.tick, line: edge.line, level: edge.level };
        if let Some(until_s) = self.judged_until_s.get() {
            self.judge.end_at(until_s);
        }
        let judged = self.judge.push(edge).map_err(JudgeError::from);
        self.note(judged);
        let written = self.files.as_mut().map_or(Ok(()), |files| files.edge(edge));
        self.written(written);
        let (picture, tick_s) = (&mut self.picture, self.tick_s);
        self.judge.errors(&mut |motor, tick, late| picture.motors[motor].error(tick as f64 * tick_s, late));
    }

    fn step(&mut self, step: ScheduledStep) {
        if self.error.is_some() {
            return;
        }
        let made = &mut self.made[step.motor];
        made.step(step);
        let position = made.position;
        self.picture.motors[step.motor].step(step.tick as f64 * self.tick_s, position);
        // After a change the machine leaves the file's figure.
        if self.judged_until_s.get().is_none() {
            self.figures.iter_mut().for_each(|figure| figure.step(step.motor, step.tick, position));
        }
        if let Some(files) = &mut self.files {
            // A native board has at most 16 motors, so the index fits.
            let motor = step.motor as u8;
            let forward = step.direction == Direction::Forward;
            let written = files.step(steps::Step { motor, tick: step.tick, forward });
            self.written(written);
        }
    }
}
