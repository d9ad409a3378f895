//! `pulsetrain run`: plan, run on the native board or a virtual one, judge, report, draw.

use crate::arguments;
use crate::arguments::Motion;
use clap::Args;
use pulsetrain_board::BoardKind;
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::Time;
use std::cell::Cell;
use std::path::{Path, PathBuf};

use miette::{Report, miette};
use pulsetrain_board::Leased;

use super::on_port::{self, PortRun};
use super::problems::{RunStopped, drive_problem, run_problem};
use super::{plan, ports};
use crate::console::{self, Access, Console, Exit};
use crate::control_socket::{Control, Ending, RunEnded, RunInfo};
use crate::diagnostic::advised;
use crate::interrupt;
use crate::made::Made;
use crate::record::{Files, Recorded, Recorder};
use crate::report::{RunEnd, RunReport};
use crate::standing::{quoted, standings, way_back};
use pulsetrain_motion::human;
use pulsetrain_plot::Picture;
use pulsetrain_plot::machine::Drawn;
use pulsetrain_session::Proof;
use pulsetrain_session::control::{Ended, Event};
use pulsetrain_session::drive::{DriveError, Driven};
use pulsetrain_session::estimate::Task;
use pulsetrain_session::lateness::Edges;
use pulsetrain_session::plans::Planned;
use pulsetrain_session::prepare::{Prepared, usual_baud};

#[derive(Args, Debug)]
#[command(after_help = "\
A motion for an `uno` or a `pico` runs on a virtual board: the real firmware on an emulated chip. A motion for another \
board runs on the native board, this computer's own step generator.

Ctrl-C, or `pulsetrain stop` from another terminal, brakes the motors within their limits. A second Ctrl-C, or \
`pulsetrain stop --now`, stops them at once. Then the run prints where the motors are, and the command that brings \
them back.

Before a motion goes to a real Uno, a virtual Uno plays its first 10 s, several times as fast, and every edge is \
compared with the law. If the Uno could not keep up, nothing is sent and nothing moves. A Pico has far larger queues \
and needs no rehearsal.

Files written to DIR:
  report.json  what was planned, proven, run and judged
  steps.csv    time_s,motor,tick,direction,position_steps
  trace.vcd    every edge of every line
  plot.svg     position, intervals, speed and errors

Examples:
  pulsetrain run examples/tutorial.toml
  pulsetrain run examples/sweep.toml --for \"60 s\" --out out/minute
  pulsetrain run examples/sweep.toml --for forever --no-trace --no-steps
  pulsetrain run examples/sweep.toml --pause-at \"2 s\" --resume-at \"3 s\"
  pulsetrain run examples/tutorial.toml --native
  pulsetrain run examples/formula.toml --port /dev/ttyACM0")]
pub(crate) struct RunArgs {
    #[command(flatten)]
    pub(crate) motion: Motion,
    /// Where the files go [default: out/ and the file's name without .toml]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Run it on this computer's own step generator, not on an emulated board
    #[arg(long, conflicts_with = "port")]
    pub(crate) native: bool,
    /// Run it on the board at this serial port, in real time
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// Rate of the line to the board, once it is found [default: 1000000; 2000000 for a Pico, whose own USB has no rate]
    #[arg(long, value_name = "BAUD", value_parser = arguments::baud, conflicts_with = "native")]
    pub(crate) baud: Option<Baud>,
    /// How much faster than it should the board's clock runs, ppm, as `pulsetrain calibrate` measures it; this corrects for it
    #[arg(long, value_name = "PPM", value_parser = arguments::clock_ppm, requires = "port", allow_hyphen_values = true)]
    pub(crate) clock_ppm: Option<f64>,
    /// Bring all motors to a halt on their paths from this time on, as soon as their limits allow
    #[arg(long, value_name = "TIME", value_parser = arguments::duration, allow_hyphen_values = true)]
    pub(crate) pause_at: Option<Time>,
    /// Go on from the halt at this time of the run, or as soon as the motors rest
    #[arg(long, value_name = "TIME", value_parser = arguments::duration, allow_hyphen_values = true, requires = "pause_at")]
    pub(crate) resume_at: Option<Time>,
    /// How much of it the virtual Uno plays before an Uno at the port is sent anything [default: all, 10 s at most]
    #[arg(long, value_name = "TIME", value_parser = arguments::duration, allow_hyphen_values = true, requires = "port")]
    pub(crate) rehearse: Option<Time>,
    /// Begin at once, without a rehearsal
    #[arg(long, conflicts_with = "rehearse", requires = "port")]
    pub(crate) no_rehearsal: bool,
    /// Write no trace.vcd
    #[arg(long)]
    pub(crate) no_trace: bool,
    /// Write no steps.csv
    #[arg(long)]
    pub(crate) no_steps: bool,
    /// Print all that is known of each motor: its plan, and its edges
    #[arg(short, long)]
    pub(crate) verbose: bool,
    /// Print the report as JSON (docs/json.md)
    #[arg(long)]
    pub(crate) json: bool,
}

pub(crate) fn run(args: &RunArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let task = match &args.port {
        Some(_) => Task::Port,
        None if args.native => Task::Native { files: true },
        None => Task::Virtual,
    };
    let mut prepared = args.motion.prepare(task, args.json, console)?;
    if let Some(ppm) = args.clock_ppm {
        prepared.calibrate(ppm);
    }
    if let Some(at) = args.pause_at {
        prepared.pause(at, args.resume_at).map_err(advised)?;
    }
    plan::check_baud(&prepared, args.baud)?;
    let folder = args.out.clone().unwrap_or_else(|| default_folder(&args.motion.file));
    let how = HowToRun {
        native: args.native,
        port: args.port.as_deref(),
        baud: args.baud,
        rehearse: args.rehearse,
        no_rehearsal: args.no_rehearsal,
        trace: !args.no_trace,
        steps: !args.no_steps,
        json: args.json,
        verbose: args.verbose,
        folder: &folder,
        goto_options: goto_options(args),
        is_known: Vec::new(),
    };
    perform(prepared, &how, console)
}

/// Where and how a prepared motion is run.
#[derive(Clone, Debug)]
pub(super) struct HowToRun<'a> {
    pub(super) native: bool,
    pub(super) port: Option<&'a str>,
    pub(super) baud: Option<Baud>,
    pub(super) rehearse: Option<Time>,
    pub(super) no_rehearsal: bool,
    /// Whether trace.vcd is written.
    pub(super) trace: bool,
    /// Whether steps.csv is written.
    pub(super) steps: bool,
    pub(super) json: bool,
    pub(super) verbose: bool,
    /// Where the files go.
    pub(super) folder: &'a Path,
    /// The options that `goto` needs to run on the same board.
    pub(super) goto_options: String,
    /// By motor: whether it is known where it stands. Empty: all begin where their laws do.
    pub(super) is_known: Vec<bool>,
}

impl HowToRun<'_> {
    /// Whether it is known of all motors where they stand.
    pub(super) fn knows_all(&self) -> bool {
        self.is_known.iter().all(|known| *known)
    }

    /// The files of a run, in words.
    pub(super) fn files(&self, others: &[&str]) -> String {
        let files = [(self.steps, "steps.csv"), (self.trace && self.port.is_none(), "trace.vcd")];
        let files = files.iter().filter(|(is_wanted, _)| *is_wanted).map(|(_, name)| *name);
        let all: Vec<&str> = ["report.json"].into_iter().chain(files).chain(others.iter().copied()).collect();
        format!("{}: {}", self.folder.display(), all.join(", "))
    }
}

/// The options of `goto` for the board of a run.
fn goto_options(args: &RunArgs) -> String {
    let board = args.motion.board.as_ref().map(|board| format!(" --board {board}"));
    let port = args.port.as_deref().map(|port| format!(" --port {}", quoted(port)));
    board.into_iter().chain(port).chain(args.native.then(|| " --native".to_owned())).collect()
}

/// Runs a prepared motion. Other commands find it by its control socket.
pub(super) fn perform(prepared: Prepared, how: &HowToRun<'_>, console: &mut Console<'_>) -> miette::Result<Exit> {
    let info = RunInfo::new(&prepared.file, &prepared.program, how.port, how.native);
    let control = Control::open(&info, console);
    let done = perform_with(prepared, how, &control, console);
    match &done {
        Ok((_, ended)) => control.end(ended),
        Err(error) => {
            let moved = error.downcast_ref::<RunStopped>().is_some();
            control.end(&RunEnded { moved, ..RunEnded::failed(error.to_string()) });
        }
    }
    done.map(|(exit, _)| exit)
}

fn perform_with(
    mut prepared: Prepared,
    how: &HowToRun<'_>,
    control: &Control,
    console: &mut Console<'_>,
) -> miette::Result<(Exit, RunEnded)> {
    let folder = how.folder;
    let baud = how.baud.unwrap_or_else(|| usual_baud(&prepared.program.board.name));
    if !how.native {
        // A Pico's own USB has no baud rate. Without --baud a rate limits the plan only if the port is not that USB; a
        // virtual Pico is reached by USB.
        let by_uart = how.port.is_some_and(|name| !ports::is_own_usb(name));
        prepared.over_line(if by_uart { Some(baud) } else { how.baud });
    }
    // Before anything moves or is written, the motion is planned, and perhaps refused: all of it, or the beginning of a
    // long one.
    let proof = plan::prove_first(&mut prepared, console)?;
    if let Some(name) = how.port {
        return on_port::run(&prepared, proof, PortRun { port: name, baud, how }, control, console);
    }
    stopped_before_begin(control)?;
    // From here on Ctrl-C stops the motors.
    interrupt::watch();
    let edges = Edges::of(&prepared.program);
    let (ran, runner) = match BoardKind::emulated(&prepared.program.board.name).filter(|_| !how.native) {
        Some(kind) => {
            let mut driven = Driven::on_virtual(kind, &prepared, baud).map_err(drive_problem)?;
            let firmware = human::version(driven.board_mut().info().firmware);
            let runner = format!("virtual {}, firmware {firmware}", kind.title());
            (to_files(&prepared, proof, driven, edges, how, control, console)?, runner)
        }
        None => {
            let driven = Driven::native(&prepared).map_err(advised)?;
            (to_files(&prepared, proof, driven, Edges::default(), how, control, console)?, "native".to_owned())
        }
    };
    let ran = ran.map_err(|NotRun { error, planned, made }| {
        run_problem(error, plan::report_made(&prepared, &planned, &made), runner.clone(), folder)
    })?;
    let Ran { ended, planned, recorded, judged_until_s } = ran;
    let end = run_end(&prepared, &ended, how);
    let Recorded { verdict, picture, lateness, figures, made, unwritten } = recorded;
    let plan = match judged_until_s {
        None => plan::report(&prepared, &planned),
        Some(_) => plan::report_made(&prepared, &planned, &made),
    };
    let mut report = RunReport::new(plan, runner, verdict, lateness, figures);
    report.judged_until_s = judged_until_s;
    report.stopped = ended.stopped.then(|| RunEnd::wanted(&ended, judged_until_s.unwrap_or_default(), &end));
    if !how.json {
        console.print(&report)?;
        if how.verbose {
            console.print(format_args!("\n{}", report.details()))?;
        }
    }
    let text = format!("{}\n", console::json(&report)?);
    let written = unwritten
        .map_or_else(|| console::write(&folder.join("report.json"), text.as_bytes()), Err)
        .map_err(Report::from)
        .and_then(|()| draw(&picture, &folder.join("plot.svg")));
    // The verdict is printed even if a file could not be written.
    report.unwritten = written.as_ref().err().map(ToString::to_string);
    if how.json {
        console.print_json(&report)?;
    } else {
        if written.is_ok() {
            console.print(format_args!("\n  {}\n", how.files(&["plot.svg"])))?;
        }
        console.print(format_args!("{}\n", report.conclusion()))?;
    }
    if let Err(error) = written {
        // A script reads one JSON value, which was the report.
        let exit = if how.json { console.complain(&error) } else { Err(error) };
        return exit.map(|exit| (exit, end));
    }
    Ok((if report.pass { Exit::Success } else { Exit::BoundBroken }, end))
}

/// Refuses to begin if a stop was asked for while the motion was planned.
pub(super) fn stopped_before_begin(control: &Control) -> miette::Result<()> {
    if control.wants_stop() {
        return Err(miette!("stopped before it began: no motor has moved"));
    }
    Ok(())
}

/// How a run ended, for the clients of its control socket.
pub(super) fn run_end(prepared: &Prepared, ended: &Ended, how: &HowToRun<'_>) -> RunEnded {
    let program = &prepared.program;
    let mut motors = standings(program, &ended.counted, ended.uncertain.as_deref().unwrap_or_default());
    let is_wanted = ended.stopped && how.knows_all();
    let way_back = is_wanted.then(|| way_back(&prepared.file, program, &motors, &how.goto_options)).flatten();
    let mut is_known = how.is_known.iter();
    motors.retain(|_| is_known.next().is_none_or(|known| *known));
    let ended = if ended.stopped { Ending::Stopped } else { Ending::Finished };
    RunEnded { ended, why: None, motors, way_back, moved: true }
}

/// A run that came to the motion's end, or was stopped on its way, as somebody asked for.
pub(crate) struct Ran {
    pub(crate) ended: Ended,
    pub(crate) planned: Vec<Planned>,
    pub(crate) recorded: Recorded,
    /// When somebody stopped it or changed it, s of the motion: the motors left the file's laws then. `None` if nobody did.
    pub(crate) judged_until_s: Option<f64>,
}

/// A run that failed.
pub(crate) struct NotRun {
    pub(crate) error: DriveError,
    pub(crate) planned: Vec<Planned>,
    /// What each motor made.
    pub(crate) made: Vec<Made>,
}

/// What became of a run.
pub(crate) type RanOrNot = Result<Ran, NotRun>;

fn to_files<B: Leased>(
    prepared: &Prepared,
    proof: Proof,
    driven: Driven<B>,
    edges: Edges,
    how: &HowToRun<'_>,
    control: &Control,
    console: &mut Console<'_>,
) -> miette::Result<RanOrNot> {
    let wanted = [how.trace, how.steps];
    let files = Files::new(&prepared.program, &driven.lines, how.folder, wanted, console::create);
    record(prepared, proof, driven, Some(files), edges, Some(control), console)
}

/// Runs a planned motion, with a progress bar. If the run ends early its files end there, complete to that point. Without its files it is
/// judged all the same, since nothing real moves.
pub(crate) fn record<B: Leased, W: std::io::Write>(
    prepared: &Prepared,
    proof: Proof,
    mut driven: Driven<B>,
    files: Option<Result<Files<W>, Access>>,
    edges: Edges,
    control: Option<&Control>,
    console: &mut Console<'_>,
) -> miette::Result<RanOrNot> {
    let board = &prepared.program.board;
    let title = format!("{} on {}", file_name(&prepared.file), board.name);
    let drawn = Drawn::of(&prepared.program);
    let mut unopened = None;
    let files = files.and_then(|files| files.map_err(|error| unopened = Some(error)).ok());
    let judged_until_s = Cell::new(None);
    let mut recorder = Recorder::new(&prepared.program, &drawn, &driven.lines, title, files, &edges, &judged_until_s)?;
    if !proof.is_whole {
        driven = driven.proving(prepared, proof.until_s).map_err(drive_problem)?;
    }
    let bar = console.run_progress(prepared);
    bar.stage("running");
    let mut now_s = 0.0;
    let mut look = |event: &Event| {
        bar.follow(event);
        match event {
            Event::Progress { at_s } => now_s = *at_s,
            // What was sent before follows the file's laws; the change comes after it.
            Event::Stopping { .. } | Event::StoppedAtOnce { .. } | Event::Pausing { .. } | Event::Tempo { .. } => {
                judged_until_s.set(judged_until_s.get().or(Some(now_s)));
            }
            _ => {}
        }
    };
    let ended = match control {
        None => driven.run(&mut recorder, |event| look(&event)),
        Some(control) => driven.run_with(control.commands(), &mut recorder, |event| {
            look(&event);
            control.tell(&event);
        }),
    };
    drop(bar);
    let planned = if proof.is_whole { proof.planned } else { driven.planned() };
    match ended {
        Err(error) => {
            let (made, unwritten) = recorder.close();
            // The stop matters more than the file.
            if let Some(unwritten) = unopened.or(unwritten) {
                console.tell(format_args!("{unwritten}\n"));
            }
            Ok(Err(NotRun { error, planned, made }))
        }
        Ok(ended) => {
            let recorded = recorder.finish(&planned, driven.lateness().unwrap_or_default())?;
            let recorded = Recorded { unwritten: unopened.or(recorded.unwritten), ..recorded };
            Ok(Ok(Ran { ended, planned, recorded, judged_until_s: judged_until_s.get() }))
        }
    }
}

/// Writes a picture as SVG, or as PNG if the path ends in .png.
pub(crate) fn draw(picture: &Picture, path: &Path) -> miette::Result<()> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    match ending.as_deref() {
        Some("png") => {
            let png = picture.png().map_err(|error| miette!("cannot draw {}: {error}", path.display()))?;
            Ok(console::write(path, &png)?)
        }
        Some("svg") => {
            let svg = picture.svg().map_err(|error| miette!("cannot draw {}: {error}", path.display()))?;
            Ok(console::write(path, svg.as_bytes())?)
        }
        _ => Err(miette!(help = "name it .svg or .png", "{} is no kind of picture", path.display())),
    }
}

fn default_folder(file: &Path) -> PathBuf {
    Path::new("out").join(file.file_stem().unwrap_or(file.as_os_str()))
}

pub(super) fn file_name(path: &str) -> String {
    Path::new(path).file_name().map_or_else(|| path.to_owned(), |name| name.to_string_lossy().into_owned())
}
