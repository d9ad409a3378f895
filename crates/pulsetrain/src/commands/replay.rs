//! `pulsetrain replay`: a live motion once more, from its log.

use std::io::BufReader;
use std::path::PathBuf;

use clap::Args;
use miette::miette;
use pulsetrain_board::{Edge, Leased, Observer, ScheduledStep};
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::human;
use pulsetrain_motion::program::Program;
use pulsetrain_plot::{Errors, MotorPicture, Picture};
use pulsetrain_report::run::file_name;
use pulsetrain_session::control::Ended;
use pulsetrain_session::drive::{DriveError, Driven};

use super::live::{PreparedLive, Trace, Transport, in_words, proving};
use super::problems::drive_problem;
use super::run::draw;
use crate::console::{Access, Console, Exit};
use crate::diagnostic::{WrongFile, advised};
use crate::files::inputs;
use crate::files::outputs::{self, Destination};
use crate::live::log::{LogEntry, LogLine, Replay};
use crate::live::{LiveRun, LiveSetpoints, NamedFiles, RunEvent};

#[derive(Args, Debug)]
#[command(after_help = "\
On a virtual board, and on the native one, the same requests come at the same ticks of the board, and make the same edges. Of a run on a real board \
this does what was asked; when it was done differs a little, as that board had a clock of its own.

Examples:
  pulsetrain live examples/live.toml --log show.jsonl
  pulsetrain replay show.jsonl --trace show.vcd --plot show.svg")]
pub(crate) struct ReplayArgs {
    /// The log that `pulsetrain live --log` wrote
    log: PathBuf,
    /// Write every edge to this file (VCD)
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Draw positions and speeds, and where each change begins, into this file (.svg or .png)
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Print what happens as well
    #[arg(short, long)]
    verbose: bool,
}

/// What was done again.
struct Again {
    /// Things done as in the log, and those that differ: what the log has, and what happened now.
    same: usize,
    differs: Option<(Option<TickedEvent>, Option<TickedEvent>)>,
    /// The tick at which the motion begins, and the board's ticks in a second.
    zero: u64,
    hz: u64,
    end_s: f64,
    picture: Picture,
}

impl Again {
    /// A tick as a time of the motion, s.
    fn seconds(&self, tick: u64) -> f64 {
        tick.saturating_sub(self.zero) as f64 / self.hz as f64
    }
}

/// Takes the edges and the picture of a motion.
struct ReplayRecorder {
    trace: Trace,
    picture: Picture,
    /// Each motor's steps, forward minus backward.
    positions: Vec<i64>,
    /// The motion's time, s.
    now_s: f64,
}

impl ReplayRecorder {
    fn new(trace: Trace, program: &Program, file: &str) -> ReplayRecorder {
        let motors = &program.motors;
        let picture = Picture {
            title: format!("{}, changed while it ran", file_name(file)),
            tick_s: 1.0 / program.board.tick_hz as f64,
            motors: motors
                .iter()
                .map(|motor| MotorPicture::new(motor.name.clone(), motor.scale.clone(), 0.0))
                .collect(),
            errors: Errors::Live,
            figures: Vec::new(),
            changes: Vec::new(),
        };
        ReplayRecorder { trace, picture, positions: vec![0; motors.len()], now_s: 0.0 }
    }

    fn note(&mut self, happened: &RunEvent) {
        match happened {
            RunEvent::Progress { at_s } => self.now_s = *at_s,
            RunEvent::Status(status) => {
                self.now_s = status.at_s;
                for (picture, motor) in self.picture.motors.iter_mut().zip(&status.motors) {
                    if let (Some(target), Some(speed)) = (motor.target, motor.speed) {
                        picture.want(status.at_s, target, speed);
                    }
                }
            }
            // Their own times are those at which the new tempo is reached.
            RunEvent::Tempo { .. } | RunEvent::Pausing { .. } | RunEvent::Resuming { .. } => {
                self.picture.changes.push(self.now_s);
            }
            event => self.picture.changes.extend(event.changes_from_s()),
        }
    }
}

impl Observer for ReplayRecorder {
    fn edge(&mut self, edge: Edge) {
        self.trace.edge(edge);
    }

    fn step(&mut self, step: ScheduledStep) {
        let position = &mut self.positions[step.motor];
        *position += i64::from(step.direction.sign());
        // Ticks count from the motion's beginning.
        let at_s = step.tick as f64 * self.picture.tick_s;
        self.picture.motors[step.motor].step(at_s, *position);
    }
}

/// Something done, and its tick.
type TickedEvent = (u64, RunEvent);

pub(crate) fn run(args: &ReplayArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let file = inputs::open(&args.log, inputs::MAX_LOG_BYTES)?;
    for (path, option) in [(&args.trace, "--trace"), (&args.plot, "--plot")] {
        path.iter().try_for_each(|path| outputs::claim(&Destination::new(path, option)))?;
    }
    let wrong = |why: &dyn std::fmt::Display| miette!("{}: {why}", args.log.display());
    let log = Replay::read(BufReader::new(file)).map_err(|error| wrong(&error))?;
    let head = &log.head;
    let baud = match head.baud {
        None => None,
        Some(rate) => {
            let baud = Baud::ALL.into_iter().find(|baud| baud.rate() == rate);
            Some(baud.ok_or_else(|| wrong(&format!("{rate} baud is no rate of a board")))?)
        }
    };
    let board = head.board.as_deref();
    let opened = LiveSetpoints::of(&head.text, &head.file, board, NamedFiles::Only(head.files.clone()));
    let opened = opened.map_err(WrongFile::from)?;
    let way = Transport { is_native: head.is_native, port: None, baud };
    let mut staged = PreparedLive::new(opened, &head.file, board, way, console)?;
    if let Some(positions) = &head.rests_at {
        staged.rest_at(positions)?;
    }
    let (prepared, proof) = (&staged.prepared, &staged.proof);
    let again = match staged.virtual_kind(head.is_native) {
        Some(kind) => {
            let driven = Driven::on_virtual(kind, prepared, staged.baud).map_err(drive_problem)?;
            again(proving(driven, prepared, proof)?, &staged, &log, args, console)?
        }
        None => {
            let driven = Driven::native(prepared).map_err(advised)?;
            again(proving(driven, prepared, proof)?, &staged, &log, args, console)?
        }
    };
    let time = human::seconds_to(again.end_s, 6);
    if let Some(plot) = &args.plot {
        draw(&again.picture, plot, "--plot")?;
    }
    for file in args.trace.iter().chain(&args.plot) {
        console.print(format_args!("  {}\n", file.display()))?;
    }
    let changes = human::count(again.same as i128);
    match (&again.differs, &head.port) {
        (None, _) => console.print(format_args!("PASS: {time}, and {changes} things done, each at its tick\n"))?,
        (Some(_), Some(port)) => console.print(format_args!(
            "{time}, with the same commands. What was done is not compared: the log is of the board at {port}, which had a clock of its own\n"
        ))?,
        (Some((logged, now)), None) => {
            let told = |timed: &Option<TickedEvent>| match timed {
                Some((tick, happened)) => {
                    let at = human::seconds_to(again.seconds(*tick), 6);
                    format!("at {at}, {}", in_words(happened).unwrap_or_else(|| "its end".to_owned()))
                }
                None => "nothing".to_owned(),
            };
            console.print(format_args!(
                "FAIL: the log differs from its replay after {changes} things\n  the log:    {}\n  the replay: {}\n",
                told(logged),
                told(now)
            ))?;
            return Ok(Exit::BoundBroken);
        }
    }
    Ok(Exit::Success)
}

/// Runs the motion of a log again.
fn again<B: Leased>(
    driven: Driven<B>,
    staged: &PreparedLive,
    log: &Replay,
    args: &ReplayArgs,
    console: &mut Console<'_>,
) -> miette::Result<Again> {
    let hz = staged.prepared.program.board.tick_hz;
    let trace = match &args.trace {
        Some(path) => Trace::to(Box::new(outputs::create(path, "--trace")?), path, hz, &driven.lines)?,
        None => Trace::none(),
    };
    let zero = driven.zero();
    let mut recorder = ReplayRecorder::new(trace, &staged.prepared.program, &log.head.file);
    let (setpoints, rejoins) = (staged.setpoints.clone(), log.head.rejoins);
    let run = if staged.is_at_rest {
        LiveRun::at_rest(driven, setpoints, rejoins)
    } else {
        LiveRun::new(driven, setpoints, rejoins)
    };
    let mut done: Vec<TickedEvent> = Vec::new();
    let (now, ended) = perform(run, log, PATIENCE_S * hz, &mut recorder, &mut done);
    let ReplayRecorder { trace, picture, .. } = recorder;
    let unwritten: Option<Access> = trace.finish();
    if args.verbose {
        for (_, happened) in &done {
            if let Some(text) = in_words(happened) {
                console.print(format_args!("{text}\n"))?;
            }
        }
    }
    // What ended the run in the log is in its lines, too.
    if let Err(error) = ended
        && !done.iter().any(|(_, happened)| matches!(happened, RunEvent::Failed { .. }))
    {
        return Err(drive_problem(error));
    }
    if let Some(error) = unwritten {
        return Err(error.into());
    }
    let logged: Vec<TickedEvent> = log
        .lines
        .iter()
        .filter_map(|line| match &line.entry {
            LogEntry::Done(happened) => Some((line.tick, happened.clone())),
            _ => None,
        })
        .collect();
    let same = logged.iter().zip(&done).take_while(|(logged, done)| logged == done).count();
    // A log of a program that was killed may lack its last lines.
    let is_whole = is_whole(log);
    let is_same = same == logged.len() && (same == done.len() || !is_whole);
    let differs = (!is_same).then(|| (logged.get(same).cloned(), done.get(same).cloned()));
    let mut again = Again { same, differs, zero, hz, end_s: 0.0, picture };
    again.end_s = again.seconds(now);
    Ok(again)
}

/// How long after the end in the log the motion may go on, s, before it is taken for another one.
const PATIENCE_S: u64 = 5;

/// Whether the log goes on to the end of the run.
fn is_whole(log: &Replay) -> bool {
    log.lines.last().is_some_and(|line| line.entry == LogEntry::Over)
}

/// Whether the lines that are left have a stop, at this tick or before it.
fn stop_waits(lines: &[LogLine], tick: u64) -> bool {
    let until_now = lines.iter().take_while(|line| line.tick <= tick);
    { until_now }.any(|line| matches!(&line.entry, LogEntry::Asked(batch) if batch.has_stop()))
}

/// Gives the requests of a log at their ticks. Returns the tick at the end.
fn perform<B: Leased>(
    mut run: LiveRun<B>,
    log: &Replay,
    patience: u64,
    recorder: &mut ReplayRecorder,
    done: &mut Vec<TickedEvent>,
) -> (u64, Result<Option<Ended>, DriveError>) {
    let lines: &[LogLine] = &log.lines;
    let last = lines.last().map_or(0, |line| line.tick) + if is_whole(log) { patience } else { 0 };
    let mut next = 0;
    let mut keep = |events: &mut Vec<RunEvent>, tick: u64, recorder: &mut ReplayRecorder| {
        events.iter().for_each(|happened| recorder.note(happened));
        let is_kept = |happened: &RunEvent| !matches!(happened, RunEvent::Progress { .. } | RunEvent::Status(_));
        done.extend(events.drain(..).filter(is_kept).map(|happened| (tick, happened)));
    };
    loop {
        let mut events = Vec::new();
        while let Some(line) = lines.get(next).filter(|line| line.tick <= run.now()) {
            next += 1;
            let LogEntry::Asked(batch) = &line.entry else { continue };
            // Files that a changed motion file names follow it in the log.
            let after = lines[next..].iter().take_while(|line| !matches!(line.entry, LogEntry::Asked(_)));
            after.for_each(|line| {
                if let LogEntry::Files(files) = &line.entry {
                    run.setpoints().provide(files);
                }
            });
            let mut stop_waits = |tick: u64| stop_waits(&lines[next..], tick);
            let handled = run.handle_until(batch.clone(), &mut stop_waits, recorder, &mut |event| events.push(event));
            if !matches!(handled, Ok(None)) {
                keep(&mut events, run.now(), recorder);
                return (run.now(), handled);
            }
        }
        // The log of a run that was killed ends on the way; another one ends with the run.
        if next >= lines.len() && run.now() >= last {
            keep(&mut events, run.now(), recorder);
            return (run.now(), Ok(None));
        }
        let mut stop_waits = |tick: u64| stop_waits(&lines[next..], tick);
        let stepped = run.step_until(&mut stop_waits, recorder, &mut |happened| events.push(happened));
        keep(&mut events, run.now(), recorder);
        if !matches!(stepped, Ok(None)) {
            return (run.now(), stepped);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::log::{LogHead, VERSION};
    use crate::live::{KnobValue, RunCommand, RunEvent};

    /// A stop ended the search for a knob's nearest value while the log was written: it ends the replay's search at the same tick.
    #[test]
    fn a_stop_ends_a_search_where_it_did() {
        let text = include_str!("../../../../examples/live.toml");
        let opened = LiveSetpoints::of(text, "live.toml", None, NamedFiles::none());
        let (mut setpoints, contents) = opened.map_err(|error| error.plain()).unwrap();
        let mut prepared = pulsetrain_session::prepare::Prepared::new("live.toml".to_owned(), contents, None).unwrap();
        prepared.prove_first(|_| {}).unwrap();
        setpoints.set_up(&prepared.program);
        let driven = Driven::native(&prepared).unwrap();
        let hz = prepared.program.board.tick_hz;
        let asked_at = driven.zero() + hz;
        let stop_at = asked_at + hz * 35 / 1000;
        let (knob, value) = ("second.frequency".to_owned(), KnobValue::Text("50 Hz".to_owned()));
        let entries = [
            (asked_at, LogEntry::Asked(RunCommand::Set { knob, value }.into())),
            (stop_at, LogEntry::Asked(RunCommand::Stop.into())),
            (stop_at + hz, LogEntry::Over),
        ];
        let lines = entries.map(|(tick, entry)| LogLine { tick, at_s: 0.0, unix_s: 0.0, entry });
        let head = LogHead {
            pulsetrain_log: VERSION,
            program: "0".to_owned(),
            file: "live.toml".to_owned(),
            text: text.to_owned(),
            files: Default::default(),
            board: None,
            is_native: true,
            port: None,
            baud: None,
            rejoins: true,
            rests_at: None,
        };
        let log = Replay { head, lines: lines.into() };
        let trace = Trace::none();
        let mut recorder = ReplayRecorder::new(trace, &prepared.program, "live.toml");
        let mut done = Vec::new();
        let run = LiveRun::new(driven, setpoints, true);
        let (_, ended) = perform(run, &log, PATIENCE_S * hz, &mut recorder, &mut done);
        assert!(ended.unwrap().is_some_and(|ended| ended.stopped));
        let refused = done.iter().find(|(_, it)| matches!(it, RunEvent::Refused { .. }));
        let stopping = done.iter().find(|(_, it)| matches!(it, RunEvent::Stopping { .. }));
        for (tick, _) in [refused, stopping].map(|found| found.expect("it is done")) {
            assert!((stop_at..stop_at + hz * 25 / 1000).contains(tick), "{tick}, not soon after {stop_at}");
        }
    }
}
