//! `pulsetrain run`: plan, run on the native board or a virtual one, judge, report, draw.

use crate::arguments;
use crate::arguments::Motion;
use clap::Args;
use pulsetrain_board::BoardKind;
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::Time;
use std::path::{Path, PathBuf};

use miette::miette;
use pulsetrain_board::Leased;

use super::on_port::{self, PortRun};
use super::problems::{drive_problem, run_problem};
use super::{plan, ports};
use crate::console::{self, Console, Exit, access};
use crate::control_socket::{Control, Ending, RunEnded, RunInfo};
use crate::diagnostic::advised;
use crate::interrupt;
use crate::record::{Files, Recorded, Recorder};
use crate::report::{RunEnd, RunReport, StoppedMotor, StoppedReport};
use crate::standing::{listed, quoted, standings, way_back};
use pulsetrain_motion::human;
use pulsetrain_plot::Picture;
use pulsetrain_plot::machine::Drawn;
use pulsetrain_session::control::{Ended, Event};
use pulsetrain_session::drive::{DriveError, Driven};
use pulsetrain_session::estimate::Task;
use pulsetrain_session::lateness::Edges;
use pulsetrain_session::plans::Planned;
use pulsetrain_session::prepare::{Prepared, usual_baud};

#[derive(Args, Debug)]
#[command(after_help = "\
Motions for the boards `uno` and `pico` run on a virtual one, the real firmware on an emulated chip;
others on the native board, this computer's own stepgen.

Ctrl-C, or `pulsetrain stop` from another terminal, brakes the motors within their limits; a second Ctrl-C, or \
`pulsetrain stop --now`, stops them at once. Then the run says where they are, and how they get back.

What an Uno at a port is to run is rehearsed before: the virtual one plays it, several times as fast, with each edge held against the law. What it \
does not keep up with is refused, and nothing moves. A Pico's queues are far larger, and nothing is rehearsed for one.

Files written to DIR:
  report.json  what was planned, proven, run and judged
  steps.csv    motor,tick,dir,position
  trace.vcd    every edge of every line
  plot.svg     position, intervals, speed and errors

Examples:
  pulsetrain run examples/tutorial.toml
  pulsetrain run examples/sweep.toml --for \"60 s\" --out out/minute
  pulsetrain run examples/sweep.toml --pause-at \"2 s\" --resume-at \"3 s\"
  pulsetrain run examples/tutorial.toml --native
  pulsetrain run examples/formula.toml --port /dev/ttyACM0")]
pub(crate) struct RunArgs {
    #[command(flatten)]
    pub(crate) motion: Motion,
    /// Where the files go [default: out/ and the file's name without .toml]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Run it on this computer's own stepgen even if its board has a firmware, which would run it on an emulated chip
    #[arg(long, conflicts_with = "port")]
    pub(crate) native: bool,
    /// Let the board at this serial port run it, in real time
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// Rate of the line to the board, once it is found [default: 1000000; 2000000 for a Pico, whose own USB has no rate]
    #[arg(long, value_name = "BAUD", value_parser = arguments::baud, conflicts_with = "native")]
    pub(crate) baud: Option<Baud>,
    /// How much faster than it should the board's clock runs, ppm, as `pulsetrain calibrate` tells: it is corrected for
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
    /// Begin at once, without that
    #[arg(long, conflicts_with = "rehearse", requires = "port")]
    pub(crate) no_rehearsal: bool,
    /// Print the report as JSON
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
    let folder = args.out.clone().unwrap_or_else(|| default_folder(&args.motion.file));
    let how = HowToRun {
        native: args.native,
        port: args.port.as_deref(),
        baud: args.baud,
        rehearse: args.rehearse,
        no_rehearsal: args.no_rehearsal,
        json: args.json,
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
    pub(super) json: bool,
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
        Err(error) => control.end(&RunEnded::failed(error.to_string())),
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
    // The whole motion is planned, and perhaps refused, before anything moves or is written.
    let planned = plan::plan(&mut prepared, console)?;
    if let Some(name) = how.port {
        return on_port::run(&prepared, &planned, PortRun { port: name, baud, how }, control, console);
    }
    stopped_before_begin(control)?;
    // From here on Ctrl-C stops the motors.
    interrupt::watch();
    let edges = Edges::of(&prepared.program);
    let (ran, runner) = match BoardKind::named(&prepared.program.board.name).filter(|_| !how.native) {
        Some(kind) => {
            let mut driven = Driven::on_virtual(kind, &prepared, baud).map_err(drive_problem)?;
            let firmware = human::version(driven.board_mut().info().firmware);
            let runner = format!("virtual {}, firmware {firmware}", kind.title());
            (to_files(&prepared, &planned, driven, edges, folder, control, console)?, runner)
        }
        None => {
            let driven = Driven::native(&prepared).map_err(advised)?;
            (to_files(&prepared, &planned, driven, Edges::default(), folder, control, console)?, "native".to_owned())
        }
    };
    let ran = ran.map_err(|error| run_problem(error, plan::report(&prepared, &planned), runner.clone(), folder))?;
    let (ended, recorded) = match ran {
        Ran::Whole { ended, recorded } => (ended, *recorded),
        Ran::Stopped { ended, at_s } => {
            let stopped = StoppedRun { prepared: &prepared, planned: &planned, runner, at_s };
            return stopped.report(&ended, how, console);
        }
    };
    let told = told_end(&prepared, &ended, how);
    let Recorded { verdict, picture, lateness, figures } = recorded;
    let report = RunReport::new(plan::report(&prepared, &planned), runner, verdict, lateness, figures);
    // The user sees the verdict even if a file could not be written. A script reads one JSON value, which is then the
    // error.
    if !how.json {
        console.print(&report.plan)?;
        console.print(&report)?;
    }
    console::write(&folder.join("report.json"), format!("{}\n", console::json(&report)?).as_bytes())?;
    draw(&picture, &folder.join("plot.svg"))?;
    if how.json {
        console.print_json(&report)?;
    } else {
        console.print(format_args!("{}: report.json, steps.csv, trace.vcd, plot.svg\n", folder.display()))?;
    }
    Ok((if report.is_ok() { Exit::Success } else { Exit::BoundBroken }, told))
}

/// Refuses to begin if a stop was asked for while the motion was planned.
pub(super) fn stopped_before_begin(control: &Control) -> miette::Result<()> {
    if control.wants_stop() {
        return Err(miette!("stopped before it began: no motor has moved"));
    }
    Ok(())
}

/// How a run ended, for the clients of its control socket.
pub(super) fn told_end(prepared: &Prepared, ended: &Ended, how: &HowToRun<'_>) -> RunEnded {
    let program = &prepared.program;
    let mut motors = standings(program, &ended.counted, ended.uncertain.as_deref().unwrap_or_default());
    let is_wanted = ended.stopped && how.knows_all();
    let way_back = is_wanted.then(|| way_back(&prepared.file, program, &motors, &how.goto_options)).flatten();
    let mut is_known = how.is_known.iter();
    motors.retain(|_| is_known.next().is_none_or(|known| *known));
    let ended = if ended.stopped { Ending::Stopped } else { Ending::Finished };
    RunEnded { ended, why: None, motors, way_back }
}

/// A run on a virtual board that was stopped, as somebody asked for. Nothing is judged: most of the motion is missing.
struct StoppedRun<'a> {
    prepared: &'a Prepared,
    planned: &'a [Planned],
    runner: String,
    at_s: f64,
}

impl StoppedRun<'_> {
    fn report(self, ended: &Ended, how: &HowToRun<'_>, console: &mut Console<'_>) -> miette::Result<(Exit, RunEnded)> {
        let told = told_end(self.prepared, ended, how);
        let at_once = if ended.uncertain.is_some() { "at once" } else { "within the motors' limits" };
        let at = human::seconds_to(self.at_s, 6);
        let message = format!("stopped at {at} {at_once}, as asked: {}", listed(&told.motors));
        let motors = told.motors.iter().map(|motor| StoppedMotor { name: motor.name.clone(), steps: motor.steps });
        let stopped = RunEnd {
            message: message.clone(),
            help: told.way_back.clone().unwrap_or_default(),
            motor: None,
            at_s: self.at_s,
            late_s: None,
            motors: motors.collect(),
        };
        let report = StoppedReport { plan: plan::report(self.prepared, self.planned), runner: self.runner, stopped };
        let text = console::json(&report)?;
        console::write(&how.folder.join("report.json"), format!("{text}\n").as_bytes())?;
        if how.json {
            console.print(format_args!("{text}\n"))?;
            return Ok((Exit::Success, told));
        }
        let runner = if report.runner == "native" { "native board" } else { &report.runner };
        console.print(format_args!("Run on the {runner}, {message}\n"))?;
        if let Some(way_back) = &told.way_back {
            console.print(format_args!("back to the start: {way_back}\n"))?;
        }
        let folder = how.folder.display();
        console
            .print(format_args!("{folder}: report.json, steps.csv and trace.vcd up to there; nothing was judged\n"))?;
        Ok((Exit::Success, told))
    }
}

/// What became of a run.
pub(crate) enum Ran {
    /// The motion came to its end.
    Whole { ended: Ended, recorded: Box<Recorded> },
    /// It was stopped, as somebody asked for; the motors braked from `at_s` on.
    Stopped { ended: Ended, at_s: f64 },
}

fn to_files<B: Leased>(
    prepared: &Prepared,
    planned: &[Planned],
    driven: Driven<B>,
    edges: Edges,
    folder: &Path,
    control: &Control,
    console: &Console<'_>,
) -> miette::Result<Result<Ran, DriveError>> {
    let (trace, steps) = (folder.join("trace.vcd"), folder.join("steps.csv"));
    let files = Files::new(&prepared.program, &driven.lines, console::create(&trace)?, console::create(&steps)?)
        .map_err(|error| access("write", folder, error))?;
    record(prepared, planned, driven, Some(files), edges, Some(control), console)
}

/// Runs a planned motion, with a progress bar. If the run ends early its files end there, complete to that point, and there is no verdict.
pub(crate) fn record<B: Leased, W: std::io::Write>(
    prepared: &Prepared,
    planned: &[Planned],
    mut driven: Driven<B>,
    files: Option<Files<W>>,
    edges: Edges,
    control: Option<&Control>,
    console: &Console<'_>,
) -> miette::Result<Result<Ran, DriveError>> {
    let board = &prepared.program.board;
    let title = format!("{} on {}", file_name(&prepared.file), board.name);
    let drawn = Drawn::of(&prepared.program);
    let mut recorder = Recorder::new(&prepared.program, &drawn, &driven.lines, title, files, &edges)?;
    let bar = console.progress(prepared.end_s(), &human::seconds_to(prepared.end_s(), 6));
    bar.stage("running");
    let (mut at_s, mut stops) = (0.0, false);
    let ended = match control {
        None => driven.run(&mut recorder, |event| bar.follow(&event)),
        Some(control) => driven.run_with(control.commands(), &mut recorder, |event| {
            bar.follow(&event);
            control.tell(&event);
            match event {
                Event::Progress { at_s: now } if !stops => at_s = now,
                Event::Stopping { at_s: from } => (at_s, stops) = (from, true),
                _ => {}
            }
        }),
    };
    match ended {
        Err(error) => {
            recorder.close()?;
            Ok(Err(error))
        }
        Ok(ended) if ended.stopped => {
            recorder.close()?;
            Ok(Ok(Ran::Stopped { ended, at_s }))
        }
        Ok(ended) => {
            let recorded = recorder.finish(planned, driven.lateness().unwrap_or_default())?;
            Ok(Ok(Ran::Whole { ended, recorded: Box::new(recorded) }))
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

fn file_name(path: &str) -> String {
    Path::new(path).file_name().map_or_else(|| path.to_owned(), |name| name.to_string_lossy().into_owned())
}
