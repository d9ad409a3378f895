//! `pulsetrain winch`: StepperWinch's text, from a script or typed.

use crate::arguments;
use crate::arguments::WinchAt;
use crate::console::Access;
use crate::files::inputs::{InputLine, MAX_TYPED_BYTES, next_line};
use crate::files::outputs;
use clap::Args;
use pulsetrain_board::BoardKind;
use pulsetrain_board::profiles::Role;
use pulsetrain_motion::Time;
use std::io::{IsTerminal, stdin, stdout};
use std::path::Path;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;

use miette::{Report, miette};
use pulsetrain_board::native_winch::NativeWinch;
use pulsetrain_board::{Port, PortError, Serial, VirtualBoard};
use pulsetrain_motion::boards;
use pulsetrain_trace::winch::{AXES, Status, WinchOptions};
use pulsetrain_trace::{Line, Trace, steps, vcd_file};

use super::other_image::image_at;
use super::problems::{self, virtual_board};
use super::run::draw;
use crate::console::{self, Console, Exit, access};
use crate::last_positions;
use crate::winch::console::{ConsoleError, Ended, Plain, converse};
use crate::winch::run::{
    Judged, Names, Run, ScriptControl, judge, judge_by_statuses, on_port, on_virtual, positions_off_zero,
};
use crate::winch::script::{self, Script};
use crate::winch::talk::{STOP, Talk};
use crate::winch::terminal::Terminal;
use crate::{interrupt, serve};
use pulsetrain_motion::human;

#[derive(Args, Debug)]
#[command(after_help = "\
A script has a line for each command, with its time: \"1.5 s: a x 100\". A motion file with law.winch is a script, \
too. On a virtual board every edge is compared with the path. Of a real board only its status lines are known.

Without a script it is a console. In a terminal it shows the axes' positions; otherwise it reads lines from the \
standard input. docs/winch.md has all commands.

Files written to DIR by a script:
  report.json   what was sent and judged
  plot.svg      position, intervals, speed, and how far steps are from the path
  statuses.csv  what the board said of its axes
  steps.csv, trace.vcd   every step and every edge, of virtual boards

Examples:
  pulsetrain winch examples/winch.toml --board uno
  pulsetrain winch examples/winch.toml --board pico
  pulsetrain winch script.txt --native --out out/script
  pulsetrain winch --port /dev/ttyACM0
  echo \"a x 200\" | pulsetrain winch --native
  echo \"move x 2000\" | pulsetrain winch --board pico     MOVE, SPEED, DIRECTION: docs/verbs.md")]
pub(crate) struct WinchArgs {
    /// Script of timed lines, or motion file (.toml) with law.winch; without one it is a console
    pub(crate) script: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) at: WinchAt,
    /// How long the script lasts [default: the motion's duration, or 4 s after its last line]
    #[arg(long = "for", value_name = "TIME", value_parser = arguments::duration, requires = "script", allow_hyphen_values = true)]
    pub(crate) length: Option<Time>,
    /// Where the files go [default: out/ and the script's name without its ending]
    #[arg(long, value_name = "DIR", requires = "script")]
    pub(crate) out: Option<PathBuf>,
    /// Print the report as JSON
    #[arg(long, requires = "script")]
    pub(crate) json: bool,
}

pub(crate) fn run(args: &WinchArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    // Watch Ctrl-C first: it must stop the axes.
    interrupt::watch();
    let Some(path) = &args.script else { return typed_lines(args, console) };
    // The whole script is read, and perhaps refused, before anything moves.
    let script = script::load(path, args.length)?;
    let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    let options = if args.at.native { WinchOptions::default() } else { options_of(kind(args)) };
    let folder =
        args.out.clone().unwrap_or_else(|| Path::new("out").join(path.file_stem().unwrap_or(path.as_os_str())));
    std::fs::create_dir_all(&folder).map_err(|error| {
        let help = "say --out DIR, a folder in which you may write; nothing was sent";
        miette!(help = help, "{}", access("make", &folder, error))
    })?;
    let files = ["report.json", "plot.svg", "statuses.csv", "steps.csv", "trace.vcd"];
    outputs::claim_all(&folder, &files, "--out")?;
    let (run, judged) = match &args.at.port {
        Some(port) => {
            let (mut talk, board) = connect_at(port)?;
            if let Some(positions) = positions_off_zero(&mut talk).map_err(port_problem)? {
                return Err(not_at_zero(port, positions));
            }
            let run = on_port(&mut talk, &script, watcher(&script, console)).map_err(port_problem)?;
            let runner = format!("board at {port}");
            let judged = judge_by_statuses(&run, Names { script: &name, runner: &runner, board: &board });
            (run, judged)
        }
        None if args.at.native => run_virtual(NativeWinch::new(), "native winch", &name, &script, &options, console)?,
        None => {
            let (board, runner) = (virtual_board(kind(args), Role::Winch)?, virtual_name(args));
            run_virtual(board, &runner, &name, &script, &options, console)?
        }
    };
    let Judged { mut report, picture } = judged;
    if !args.json {
        console.print(&report)?;
    }
    let text = format!("{}\n", console::json(&report)?);
    let written = outputs::write(&folder.join("report.json"), "--out", text.as_bytes())
        .map_err(Report::from)
        .and_then(|()| draw(&picture, &folder.join("plot.svg"), "--out"))
        .and_then(|()| write_files(&run, &folder, &options, report.verdict.is_some()));
    // What the axes did is printed even if a file could not be written.
    report.unwritten = written.as_ref().err().map(ToString::to_string);
    if args.json {
        console.print_json(&report)?;
    }
    match written {
        // A program reads one JSON value, which was the report.
        Err(error) if args.json => return console.complain(&error),
        Err(error) => return Err(error),
        Ok(_) if args.json => {}
        Ok(files) => console.print(format_args!("{}: report.json, plot.svg, {files}\n", folder.display()))?,
    }
    Ok(if report.is_ok() { Exit::Success } else { Exit::BoundBroken })
}

/// The error for a port whose board reads text. The advice differs from other boards', since text has no lease.
fn port_problem(error: PortError) -> Report {
    match error {
        PortError::Gone { .. } => {
            let help = "look at the cable; the board goes on with its last orders, as long as it has power: `deadman <ms>` in \
                        the script has it stop by itself";
            miette!(help = help, "{error}")
        }
        error => problems::port_problem(error),
    }
}

/// The error for a board on which a script cannot be judged. Nothing was sent to it.
fn not_at_zero(port: &str, [x, y, z, a]: [i32; 4]) -> Report {
    let help =
        "go to 0 by hand (`a xyza 0 0 0 0`), or plug the board in again, which also brings back gains and limits";
    miette!(
        help = help,
        "the axes of the board at {port} stand at x {x}, y {y}, z {z}, a {a}, and a script is judged from 0 on"
    )
}

fn run_virtual<B: VirtualBoard>(
    board: B,
    runner: &str,
    name: &str,
    script: &Script,
    options: &WinchOptions,
    console: &Console<'_>,
) -> miette::Result<(Run, Judged)> {
    let (mut talk, board) = connect(board, runner)?;
    let run = on_virtual(&mut talk, script, watcher(script, console)).map_err(port_problem)?;
    let judged = judge(&run, Names { script: name, runner, board: &board }, options)
        .map_err(|error| miette!("{runner}: {error}"))?;
    Ok((run, judged))
}

fn kind(args: &WinchArgs) -> BoardKind {
    args.at.board.unwrap_or_default()
}

fn virtual_name(args: &WinchArgs) -> String {
    format!("virtual {}", kind(args).title())
}

/// A virtual board's wiring, and when it makes its edges.
fn options_of(board: BoardKind) -> WinchOptions {
    let wiring = board.profile().axes;
    let (tick_hz, late_ticks) =
        boards::find(board.name()).map_or((0, 0), |limits| (limits.tick_hz, limits.lateness_ticks));
    WinchOptions {
        tick_hz: tick_hz as f64,
        step: wiring.pins.map(|(step, _)| step),
        dir: wiring.pins.map(|(_, dir)| dir),
        enable: wiring.enable,
        constant_ticks: wiring.edge_delay_ticks.into(),
        // The path's steps are rounded to ticks.
        late_ticks: f64::from(late_ticks).max(1.0),
        // An A4988's times, 1 µs.
        shortest_ticks: tick_hz / 1_000_000,
        ..WinchOptions::default()
    }
}

/// Connects to a board that reads text. Gives its name, too.
fn connect<P: Port>(port: P, place: &str) -> miette::Result<(Talk<P>, String)> {
    let mut talk = Talk::new(port);
    let board = talk.ask().map_err(port_problem)?.ok_or_else(|| {
        let help = "is it StepperWinch, or Pulsetrain's firmware, and no program that sends frames has it? An Uno knows text with its \
                    image `winch` alone: `pulsetrain flash uno --port PORT --image winch`. A baked motion does not, until it is stopped \
                    (`pulsetrain stop`, a Pico's) or the firmware is back (`pulsetrain flash`)";
        miette!(help = help, "the {place} does not speak StepperWinch's text: it does not answer `version`")
    })?;
    Ok((talk, board))
}

/// Connects to a board at a port. If it does not answer text, it is asked in frames whether it is an Uno with another
/// image.
fn connect_at(port: &str) -> miette::Result<(Talk<Serial>, String)> {
    last_positions::forget(port);
    connect(Serial::open(port, true).map_err(port_problem)?, port)
        .map_err(|error| image_at(port, "winch").map_or(error, Report::new))
}

fn watcher(script: &Script, console: &Console<'_>) -> impl FnMut(f64) -> ScriptControl {
    let bar = console.progress(script.end_s, &human::seconds_to(script.end_s, 6));
    bar.stage("running");
    move |seconds| {
        bar.set(seconds);
        if interrupt::wanted() { ScriptControl::Stop } else { ScriptControl::GoOn }
    }
}

/// Writes the run's files except report and picture, and gives their names.
fn write_files(run: &Run, folder: &Path, options: &WinchOptions, has_edges: bool) -> miette::Result<&'static str> {
    let begin_us = run.begin as f64 / run.tick_hz as f64 * 1e6;
    let mut table = String::from("time_s,x,y,z,a\n");
    for Status { usec, positions: [x, y, z, a] } in &run.statuses {
        table.push_str(&format!("{:.6},{x},{y},{z},{a}\n", (*usec as f64 - begin_us) * 1e-6));
    }
    outputs::write(&folder.join("statuses.csv"), "--out", table.as_bytes())?;
    if !has_edges {
        return Ok("statuses.csv");
    }
    let broken = |error| Access::write(folder, "--out", error);
    // Ticks in both files count by the board's clock.
    let WinchOptions { step, dir, .. } = *options;
    let last = run.edges.iter().map(|edge| edge.line).chain(step).chain(dir).max().unwrap_or(0);
    let mut lines: Vec<Line> = (0..=last.max(19)).map(|pin| Line::named(format!("pin{pin}"))).collect();
    for (axis, (step, dir)) in AXES.iter().zip(step.into_iter().zip(dir)) {
        lines[usize::from(step)].names.insert(0, format!("{axis}.step"));
        lines[usize::from(dir)].names.insert(0, format!("{axis}.dir"));
    }
    let trace = Trace { tick_hz: run.tick_hz, lines, edges: run.edges.clone() };
    vcd_file::write(&trace, outputs::create(&folder.join("trace.vcd"), "--out")?).map_err(broken)?;
    let names = AXES.map(String::from);
    let mut rows = steps::StepWriter::new(outputs::create(&folder.join("steps.csv"), "--out")?, run.tick_hz, &names)
        .map_err(broken)?;
    let mut forward = [false; 4];
    for edge in &run.edges {
        if let Some(axis) = dir.iter().position(|line| *line == edge.line) {
            forward[axis] = edge.level;
        } else if let Some(axis) = step.iter().position(|line| *line == edge.line && edge.level) {
            rows.push(steps::Step { motor: axis as u8, tick: edge.tick, forward: forward[axis] }).map_err(broken)?;
        }
    }
    rows.finish().map_err(broken)?;
    Ok("statuses.csv, steps.csv, trace.vcd")
}

/// Runs the console.
fn typed_lines(args: &WinchArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    match &args.at.port {
        Some(port) => run_console(connect_at(port)?, console),
        None if args.at.native => run_console(connect(serve::Paced::new(NativeWinch::new()), "native winch")?, console),
        None => run_console(
            connect(serve::Paced::new(virtual_board(kind(args), Role::Winch)?), &virtual_name(args))?,
            console,
        ),
    }
}

fn run_console<P: Port>((mut talk, board): (Talk<P>, String), console: &mut Console<'_>) -> miette::Result<Exit> {
    let ended = if stdin().is_terminal() && stdout().is_terminal() {
        console.print(format_args!("{board}; `help` lists the commands, Ctrl-C stops all axes, `quit` ends\n"))?;
        // The screen shows positions as they change.
        talk.tell(&talk.as_wanted("srate 50")).map_err(port_problem)?;
        let ended = Terminal::new(console.out.screen(), STOP)
            .map_err(ConsoleError::from)
            .and_then(|mut terminal| converse(&mut talk, &mut terminal));
        // Back to the usual interval. If the port is gone, that is reported already.
        ended.and_then(|_| Ok(talk.tell(&talk.as_wanted("srate 200"))?)).map(|()| Exit::Success)
    } else {
        match converse(&mut talk, &mut Plain::new(typed(), &mut console.out)) {
            Ok(Ended { refused: 0, is_settled: true }) => Ok(Exit::Success),
            // Also a script with a refused line ends with this exit code.
            Ok(_) => Ok(Exit::BoundBroken),
            // If the reader of the output has gone away (`| head`), the console ends.
            Err(ConsoleError::Person(error)) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(Exit::Success),
            Err(error) => Err(error),
        }
    };
    ended.map_err(|error| match error {
        ConsoleError::Port(error) => port_problem(error),
        error => Report::new(error),
    })
}

/// Lines of standard input that wait. Whoever writes more waits, too.
const MAX_WAITING_LINES: usize = 64;

/// Lines of standard input, as they come. Of one that is longer than an order can be the beginning comes, which is too long, too.
pub(super) fn typed() -> Receiver<String> {
    let (to_console, lines) = sync_channel(MAX_WAITING_LINES);
    // The thread ends with the input, or with the program.
    thread::spawn(move || {
        let (mut input, mut line) = (stdin().lock(), Vec::new());
        while let Ok(InputLine::Whole | InputLine::TooLong) = next_line(&mut input, &mut line, MAX_TYPED_BYTES) {
            // A line that is not text goes to the board, which refuses it.
            if to_console.send(String::from_utf8_lossy(&line).trim_end_matches('\n').to_owned()).is_err() {
                return;
            }
        }
    });
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_in_text_goes_on_when_the_cable_is_gone() {
        let help = |error: PortError| port_problem(error).help().map(|help| help.to_string()).unwrap_or_default();
        let (name, why) = ("/dev/ttyACM0".to_owned(), "Broken pipe".to_owned());
        assert!(help(PortError::Gone { name: name.clone(), why: why.clone() }).contains("goes on"));
        assert!(help(PortError::Unusable { name, why }).contains("usually"));
    }
}
