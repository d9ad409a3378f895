//! `pulsetrain run`: plan, run on the native board or a virtual one, judge, report, draw.

use crate::arguments;
use crate::arguments::Motion;
use crate::files::outputs;
use clap::Args;
use pulsetrain_board::Native;
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::Time;
use std::path::{Path, PathBuf};

use miette::{Report, miette};

use super::on_port::{self, PortRun};
use super::problems::{RunStopped, drive_problem, run_problem};
use super::{plan, ports};
use crate::console::{self, Access, Console, Exit};
use crate::control_socket::{Control, run_info};
use crate::diagnostic::advised;
use crate::interrupt;
use crate::live::{Ending, RunEnded};
use crate::way_back::{quoted, way_back};
use pulsetrain_plot::Picture;
use pulsetrain_report::record::{Files, OutputFile, Recorded, Unwritten};
use pulsetrain_report::run::{
    Progress, Run, RunError, RunOptions, Unfinished, known_positions, record, run as run_motion,
};
use pulsetrain_session::Proof;
use pulsetrain_session::control::{Ended, Event};
use pulsetrain_session::drive::Driven;
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
    // A file that would destroy an input is found before anything is planned, or moves.
    let files = ["report.json", "steps.csv", "trace.vcd", "plot.svg"];
    let is_wanted = |name: &&str| match *name {
        "steps.csv" => how.steps,
        "trace.vcd" => how.trace && how.port.is_none(),
        "plot.svg" => how.port.is_none(),
        _ => true,
    };
    let files: Vec<&str> = files.into_iter().filter(is_wanted).collect();
    outputs::claim_all(how.folder, &files, "--out")?;
    let info = run_info(&prepared.file, &prepared.program, how.port, how.native);
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
    if let Some(name) = how.port {
        // A Pico's own USB has no baud rate. Without --baud a rate limits the plan only if the port is not that USB.
        let baud = how.baud.unwrap_or_else(|| usual_baud(&prepared.program.board.name));
        prepared.over_line(if ports::is_own_usb(name) { how.baud } else { Some(baud) });
        // Before anything moves or is written, the motion is planned, and perhaps refused: all of it, or the beginning of a
        // long one.
        let proof = plan::prove_first(&mut prepared, console)?;
        return on_port::run(&prepared, proof, PortRun { port: name, baud, how }, control, console);
    }
    let options =
        RunOptions { native: how.native, baud: how.baud, is_known: &how.is_known, commands: Some(control.commands()) };
    let open = |file: OutputFile| {
        let is_wanted = match file {
            OutputFile::Trace => how.trace,
            OutputFile::Steps => how.steps,
        };
        is_wanted.then(|| outputs::create_in(folder, file.name(), "--out"))
    };
    let mut bars = RunBars::new(&prepared, Some(control), console);
    bars.planning(0.0);
    let run = run_motion(&mut prepared, &options, open, &mut bars);
    drop(bars);
    let Run { mut report, picture, ended, unwritten, .. } = run.map_err(|error| not_run(error, folder, console))?;
    let end = run_end(&prepared, &ended, how);
    if let Some(stopped) = &mut report.stopped {
        stopped.help = end.way_back.clone().unwrap_or_default();
    }
    if !how.json {
        console.print(&report)?;
        if how.verbose {
            console.print(format_args!("\n{}", report.details()))?;
        }
    }
    let text = format!("{}\n", console::json(&report)?);
    let written = unwritten
        .map_or_else(
            || outputs::write(&folder.join("report.json"), "--out", text.as_bytes()),
            |unwritten| Err(file_error(unwritten, folder).into()),
        )
        .map_err(Report::from)
        .and_then(|()| draw(&picture, &folder.join("plot.svg"), "--out"));
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
    let motors = known_positions(prepared, ended, &how.is_known);
    let is_wanted = ended.stopped && how.knows_all();
    let way_back = is_wanted.then(|| way_back(&prepared.file, &prepared.program, &motors, &how.goto_options)).flatten();
    let ended = if ended.stopped { Ending::Stopped } else { Ending::Finished };
    RunEnded { ended, why: None, motors, way_back, moved: true }
}

/// The error for a file of a run.
fn file_error(unwritten: Unwritten, folder: &Path) -> Access {
    Access::write(&folder.join(unwritten.file.name()), "--out", unwritten.error)
}

/// The error for a run that has no verdict, with advice.
fn not_run(error: RunError, folder: &Path, console: &mut Console<'_>) -> Report {
    match error {
        RunError::Refused(refusal) => advised(refusal),
        RunError::Drive { error, report, unwritten } => {
            // The stop matters more than the file.
            if let Some(unwritten) = unwritten {
                console.tell(format_args!("{}\n", file_error(unwritten, folder)));
            }
            run_problem(error, report, folder)
        }
        error @ (RunError::NotBegun | RunError::Record(_)) => miette!("{error}"),
    }
}

/// The progress bars of a run: while it is planned, then while it runs. A run with clients reports to them, too.
struct RunBars<'c, 'o> {
    console: &'c Console<'o>,
    control: Option<&'c Control>,
    /// When the motion ends, s. `None`: it has no end.
    end_s: Option<f64>,
    /// The present bar.
    bar: Option<console::Progress>,
}

impl<'c, 'o> RunBars<'c, 'o> {
    fn new(prepared: &Prepared, control: Option<&'c Control>, console: &'c Console<'o>) -> RunBars<'c, 'o> {
        RunBars { console, control, end_s: (!prepared.is_endless()).then(|| prepared.end_s()), bar: None }
    }

    /// The present bar; if there is none, a new one for that stage.
    fn bar(&mut self, stage: &'static str, new: impl FnOnce(&Console<'_>) -> console::Progress) -> &console::Progress {
        let console = self.console;
        self.bar.get_or_insert_with(|| {
            let bar = new(console);
            bar.stage(stage);
            bar
        })
    }
}

impl Progress for RunBars<'_, '_> {
    fn planning(&mut self, at_s: f64) {
        let end_s = self.end_s.unwrap_or(f64::INFINITY);
        self.bar("planning", |console| console.progress(end_s, "the motion")).set(at_s);
    }

    fn may_begin(&mut self) -> bool {
        self.bar = None;
        if self.control.is_some_and(Control::wants_stop) {
            return false;
        }
        // From here on Ctrl-C stops the motors.
        interrupt::watch();
        true
    }

    fn event(&mut self, event: &Event) {
        let end_s = self.end_s;
        self.bar("running", |console| console.run_progress(end_s)).follow(event);
        if let Some(control) = self.control {
            control.publish(&event.clone().into());
        }
    }
}

/// Runs a motion that is planned on the native board, with a progress bar, and judges it. It writes no files.
pub(super) fn recorded(
    prepared: &Prepared,
    planned: Vec<Planned>,
    driven: Driven<Native>,
    console: &Console<'_>,
) -> miette::Result<Recorded> {
    let proof = Proof { planned, is_whole: true, until_s: f64::INFINITY };
    let files = None::<Result<Files<std::io::Sink>, Unwritten>>;
    let mut bars = RunBars::new(prepared, None, console);
    match record(prepared, proof, driven, files, &Edges::default(), None, &mut bars) {
        Ok(run) => Ok(run.recorded),
        Err(unfinished) => Err(match *unfinished {
            Unfinished::Record(error) => miette!("{error}"),
            Unfinished::Drive { error, .. } => drive_problem(error),
        }),
    }
}

/// Writes a picture as SVG, or as PNG if the path ends in .png. `option` says where it goes.
pub(crate) fn draw(picture: &Picture, path: &Path, option: &'static str) -> miette::Result<()> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    match ending.as_deref() {
        Some("png") => {
            let png = picture.png().map_err(|error| miette!("cannot draw {}: {error}", path.display()))?;
            Ok(outputs::write(path, option, &png)?)
        }
        Some("svg") => {
            let svg = picture.svg().map_err(|error| miette!("cannot draw {}: {error}", path.display()))?;
            Ok(outputs::write(path, option, svg.as_bytes())?)
        }
        _ => Err(miette!(help = "name it .svg or .png", "{} is no kind of picture", path.display())),
    }
}

fn default_folder(file: &Path) -> PathBuf {
    Path::new("out").join(file.file_stem().unwrap_or(file.as_os_str()))
}
