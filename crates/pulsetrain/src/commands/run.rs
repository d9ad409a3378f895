//! `pulsetrain run`: plan, run on the native board or a virtual one, judge, report, draw.

use crate::arguments;
use crate::arguments::Motion;
use clap::Args;
use pulsetrain_board::BoardKind;
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::Time;
use std::path::{Path, PathBuf};

use miette::{Report, miette};
use pulsetrain_board::Leased;

use super::on_port::{self, PortRun};
use super::problems::{drive_problem, run_problem};
use super::{plan, ports};
use crate::console::{self, Access, Console, Exit};
use crate::diagnostic::advised;
use crate::record::{Files, Recorded, Recorder};
use crate::report::RunReport;
use pulsetrain_motion::human;
use pulsetrain_plot::Picture;
use pulsetrain_plot::machine::Drawn;
use pulsetrain_session::drive::{DriveError, Driven};
use pulsetrain_session::estimate::Task;
use pulsetrain_session::lateness::Edges;
use pulsetrain_session::plans::Planned;
use pulsetrain_session::prepare::{Prepared, usual_baud};

#[derive(Args, Debug)]
#[command(after_help = "\
Motions for the boards `uno` and `pico` run on a virtual one, the real firmware on an emulated chip;
others on the native board, this computer's own stepgen.

What an Uno at a port is to run is rehearsed before: the virtual one plays it, several times as fast, with each edge held against the law. What it \
does not keep up with is refused, and nothing moves. A Pico's queues are far larger, and nothing is rehearsed for one.

Files written to DIR:
  report.json  what was planned, proven, run and judged
  steps.csv    time_s,motor,tick,direction,position_steps
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
    /// Let the board at this serial port run it, in real time; Ctrl-C stops the motors as planned, twice at once
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
    /// Begin at once, without that
    #[arg(long, conflicts_with = "rehearse", requires = "port")]
    pub(crate) no_rehearsal: bool,
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
    let baud = args.baud.unwrap_or_else(|| usual_baud(&prepared.program.board.name));
    if !args.native {
        // A Pico's own USB has no baud rate. Without --baud a rate limits the plan only if the port is not that USB; a
        // virtual Pico is reached by USB.
        let by_uart = args.port.as_deref().is_some_and(|name| !ports::is_own_usb(name));
        prepared.over_line(if by_uart { Some(baud) } else { args.baud });
    }
    // The whole motion is planned, and perhaps refused, before anything moves or is written.
    let planned = plan::plan(&mut prepared, console)?;
    let folder = args.out.clone().unwrap_or_else(|| default_folder(&args.motion.file));
    if let Some(name) = &args.port {
        let run = PortRun {
            port: name,
            baud,
            rehearse: args.rehearse,
            no_rehearsal: args.no_rehearsal,
            json: args.json,
            verbose: args.verbose,
            folder: &folder,
        };
        return on_port::run(&prepared, &planned, run, console);
    }
    let edges = Edges::of(&prepared.program);
    let (recorded, runner) = match BoardKind::named(&prepared.program.board.name).filter(|_| !args.native) {
        Some(kind) => {
            let mut driven = Driven::on_virtual(kind, &prepared, baud).map_err(drive_problem)?;
            let firmware = human::version(driven.board_mut().info().firmware);
            let runner = format!("virtual {}, firmware {firmware}", kind.title());
            (to_files(&prepared, &planned, driven, edges, &folder, console)?, runner)
        }
        None => {
            let driven = Driven::native(&prepared).map_err(advised)?;
            (to_files(&prepared, &planned, driven, Edges::default(), &folder, console)?, "native".to_owned())
        }
    };
    let recorded =
        recorded.map_err(|error| run_problem(error, plan::report(&prepared, &planned), runner.clone(), &folder))?;
    let Recorded { verdict, picture, lateness, figures, unwritten } = recorded;
    let mut report = RunReport::new(plan::report(&prepared, &planned), runner, verdict, lateness, figures);
    if !args.json {
        console.print(&report)?;
        if args.verbose {
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
    if args.json {
        console.print_json(&report)?;
    } else {
        if written.is_ok() {
            console.print(format_args!("\n  {}: report.json, steps.csv, trace.vcd, plot.svg\n", folder.display()))?;
        }
        console.print(format_args!("{}\n", report.conclusion()))?;
    }
    if let Err(error) = written {
        // A script reads one JSON value, which was the report.
        return if args.json { console.complain(&error) } else { Err(error) };
    }
    Ok(if report.pass { Exit::Success } else { Exit::BoundBroken })
}

fn to_files<B: Leased>(
    prepared: &Prepared,
    planned: &[Planned],
    driven: Driven<B>,
    edges: Edges,
    folder: &Path,
    console: &mut Console<'_>,
) -> miette::Result<Result<Recorded, DriveError>> {
    let files = Files::new(&prepared.program, &driven.lines, folder, console::create);
    record(prepared, planned, driven, Some(files), edges, console)
}

/// Runs a planned motion, with a progress bar. If the run ends early its files end there, complete to that point. Without its files it is
/// judged all the same, since nothing real moves.
pub(crate) fn record<B: Leased, W: std::io::Write>(
    prepared: &Prepared,
    planned: &[Planned],
    mut driven: Driven<B>,
    files: Option<Result<Files<W>, Access>>,
    edges: Edges,
    console: &mut Console<'_>,
) -> miette::Result<Result<Recorded, DriveError>> {
    let board = &prepared.program.board;
    let title = format!("{} on {}", file_name(&prepared.file), board.name);
    let drawn = Drawn::of(&prepared.program);
    let mut unopened = None;
    let files = files.and_then(|files| files.map_err(|error| unopened = Some(error)).ok());
    let mut recorder = Recorder::new(&prepared.program, &drawn, &driven.lines, title, files, &edges)?;
    let bar = console.progress(prepared.end_s(), &human::seconds_to(prepared.end_s(), 6));
    bar.stage("running");
    if let Err(error) = driven.run(&mut recorder, |event| bar.follow(&event)) {
        drop(bar);
        // The stop matters more than the file.
        if let Some(unwritten) = unopened.or(recorder.close()) {
            console.tell(format_args!("{unwritten}\n"));
        }
        return Ok(Err(error));
    }
    let recorded = recorder.finish(planned, driven.lateness().unwrap_or_default())?;
    Ok(Ok(Recorded { unwritten: unopened.or(recorded.unwritten), ..recorded }))
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
