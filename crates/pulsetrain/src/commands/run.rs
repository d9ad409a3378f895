//! `pulsetrain run`: plan, run on the native board or a virtual one, judge, report, draw.

use std::path::{Path, PathBuf};

use miette::miette;
use pulsetrain_board::Leased;
use pulsetrain_motion::boards;

use super::{drive_problem, on_port, plan, ports, run_problem};
use crate::cli::Run;
use crate::console::{self, Console, Exit, access};
use crate::diagnostic::advised;
use crate::record::{Files, Recorded, Recorder};
use crate::report::RunReport;
use pulsetrain_motion::human;
use pulsetrain_plot::Picture;
use pulsetrain_plot::machine::Drawn;
use pulsetrain_session::drive::{DriveError, Driven};
use pulsetrain_session::estimate::Task;
use pulsetrain_session::lateness::Edges;
use pulsetrain_session::prepare::{Planned, Prepared, usual_baud};

pub(crate) fn run(args: &Run, console: &mut Console<'_>) -> miette::Result<Exit> {
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
    let baud = args.baud.unwrap_or_else(|| usual_baud(&prepared.program.board.name));
    if !args.native {
        // A Pico's own USB has no baud: without --baud it is reckoned with where it is seen to be there, as by the virtual Pico it is.
        let by_uart = args.port.as_deref().is_some_and(|name| !ports::is_own_usb(name));
        prepared.over_line(if by_uart { Some(baud) } else { args.baud });
    }
    // All is planned, and refused if need be, before anything moves or is written.
    let planned = plan::plan(&mut prepared, console)?;
    let folder = args.out.clone().unwrap_or_else(|| default_folder(&args.motion.file));
    if let Some(name) = &args.port {
        return on_port::run(&prepared, &planned, name, args, baud, &folder, console);
    }
    let edges = Edges::of(&prepared.program);
    let (recorded, runner) = match prepared.program.board.name.as_str() {
        name if boards::is_uno(name) && !args.native => {
            let mut driven = Driven::virtual_uno(&prepared, baud).map_err(drive_problem)?;
            let runner = format!("virtual Uno, firmware {}", human::version(driven.board_mut().info().firmware));
            (to_files(&prepared, &planned, driven, edges, &folder, console)?, runner)
        }
        "pico" if !args.native => {
            let mut driven = Driven::virtual_pico(&prepared, baud).map_err(drive_problem)?;
            let runner = format!("virtual Pico, firmware {}", human::version(driven.board_mut().info().firmware));
            (to_files(&prepared, &planned, driven, edges, &folder, console)?, runner)
        }
        _ => {
            let driven = Driven::native(&prepared).map_err(advised)?;
            (to_files(&prepared, &planned, driven, Edges::default(), &folder, console)?, "native".to_owned())
        }
    };
    let recorded =
        recorded.map_err(|error| run_problem(error, plan::report(&prepared, &planned), runner.clone(), &folder))?;
    let Recorded { verdict, picture, lateness, figures } = recorded;
    let report = RunReport::new(plan::report(&prepared, &planned), runner, verdict, lateness, figures);
    // The verdict is told also where a file has no room; a script gets one value, and then it is the error.
    if !args.json {
        console.print(&report.plan)?;
        console.print(&report)?;
    }
    console::write(&folder.join("report.json"), format!("{}\n", console::json(&report)?).as_bytes())?;
    draw(&picture, &folder.join("plot.svg"))?;
    if args.json {
        console.print_json(&report)?;
    } else {
        console.print(format_args!("{}: report.json, steps.csv, trace.vcd, plot.svg\n", folder.display()))?;
    }
    Ok(if report.is_ok() { Exit::Success } else { Exit::BoundBroken })
}

fn to_files<B: Leased>(
    prepared: &Prepared,
    planned: &[Planned],
    driven: Driven<B>,
    edges: Edges,
    folder: &Path,
    console: &Console<'_>,
) -> miette::Result<Result<Recorded, DriveError>> {
    let (trace, steps) = (folder.join("trace.vcd"), folder.join("steps.csv"));
    let files = Files::new(&prepared.program, &driven.lines, console::create(&trace)?, console::create(&steps)?)
        .map_err(|error| access("write", folder, error))?;
    record(prepared, planned, driven, Some(files), edges, console)
}

/// Runs a motion that has been planned, with a progress bar. The files of one that does not come to its end are ended there.
pub(crate) fn record<B: Leased, W: std::io::Write>(
    prepared: &Prepared,
    planned: &[Planned],
    mut driven: Driven<B>,
    files: Option<Files<W>>,
    edges: Edges,
    console: &Console<'_>,
) -> miette::Result<Result<Recorded, DriveError>> {
    let board = &prepared.program.board;
    let title = format!("{} on {}", file_name(&prepared.file), board.name);
    let drawn = Drawn::of(&prepared.program);
    let mut recorder = Recorder::new(&prepared.program, &drawn, &driven.lines, title, files, &edges)?;
    let bar = console.progress(prepared.end_s(), &human::seconds_to(prepared.end_s(), 6));
    bar.stage("running");
    if let Err(error) = driven.run(&mut recorder, |event| bar.follow(&event)) {
        recorder.close()?;
        return Ok(Err(error));
    }
    Ok(Ok(recorder.finish(planned, driven.lateness())?))
}

/// Writes a picture as SVG, or as PNG if the path says so.
pub(crate) fn draw(picture: &Picture, path: &Path) -> miette::Result<()> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    match ending.as_deref() {
        Some("png") => picture.png(path).map_err(|error| miette!("cannot write {}: {error}", path.display())),
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
