//! The command line: its commands, and what runs each of them.

use std::ffi::OsString;
use std::io::Write;

use clap::{Parser, Subcommand};
use miette::{GraphicalReportHandler, GraphicalTheme};

use crate::arguments::{At, Table};
use crate::clean::is_order;
use crate::commands;
use crate::commands::problems::RunStopped;
use crate::console::{Console, Exit};
use crate::diagnostic::as_report;

const EXIT_CODES: &str = "\
Exit codes:
  0  all is well
  1  a bound broke: the verdict on a run or on a capture
  2  wrong usage, wrong input, a motion that is refused, or a file that cannot be written
  3  the motors stopped before the motion's end, without an order
  130  Ctrl-C before anything moved";

const EXAMPLES: &str = "\
Examples:
  pulsetrain new crank                       write crank.toml, a motion file with comments
  pulsetrain run crank.toml                  plan it, run it, judge it, draw it: out/crank
  pulsetrain plan crank.toml --board uno     what it needs on an Uno; nothing runs
  pulsetrain explain crank.toml              why it is refused, and what would fit
  pulsetrain verify capture.vcd crank.toml   judge a logic analyser's capture
  pulsetrain film clip.mp4 crank.toml        judge a clip of the wheel, which has two marks";

/// Drives stepper motors along any motion law, exactly
#[derive(Debug, Parser)]
#[command(name = "pulsetrain", version, term_width = 100, after_help = format!("{EXAMPLES}\n\n{EXIT_CODES}"))]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Plan a motion, run it, compare every edge with the law, and write report, steps, trace and plot
    Run(commands::run::RunArgs),
    /// Run a motion that is changed while it runs: by its file, knobs, cues, from anywhere
    Live(commands::live::LiveArgs),
    /// Run a live motion with a page in the browser that shows and steers it
    Serve(commands::live::ServeArgs),
    /// Run a live motion once more, from its log, on a virtual board
    Replay(commands::replay::ReplayArgs),
    /// Plan a motion and prove that it keeps all limits; nothing runs
    Plan(commands::plan::PlanArgs),
    /// Draw a motion: position, step intervals, speed, error
    Plot(commands::plot::PlotArgs),
    /// Try a formula without a motion file: position, speed, acceleration, range, first steps, plot
    Formula(commands::formula::FormulaArgs),
    /// Compare a capture with the motion: VCD, CSV of Saleae's Logic or PulseView, steps.csv, or a camera's track (CSV of time and angle)
    Verify(commands::verify::VerifyArgs),
    /// Compare a clip of the turning wheel, with two marks on it, with the motion
    Film(commands::film::FilmArgs),
    /// Explain why a motion is refused: which limit, where, and what would fit
    Explain(commands::explain::ExplainArgs),
    /// Calculate how fast a motor's winding lets it step; each figure with its formula and source
    Motor(commands::motor::MotorArgs),
    /// Run a virtual board in real time, for this program or any other serial client, until Ctrl-C
    Board(commands::board::BoardArgs),
    /// Write the firmware to a board; no other program is needed
    Flash(commands::flash::FlashArgs),
    /// List this computer's serial ports, and Picos that wait for firmware
    Ports(commands::ports::PortsArgs),
    /// Store a motion on a board: it runs from power-up on, without a computer
    Bake(commands::bake::BakeArgs),
    /// Measure a board's clock against this computer's; `run --clock-ppm` then corrects for it
    Calibrate(commands::calibrate::CalibrateArgs),
    /// Send StepperWinch's text to a board: from a console, or from a script whose motion is checked
    Winch(commands::winch::WinchArgs),
    /// Move motors by hand or from a script: MOVE, RUN, SPEED, DIRECTION, HALT
    Verbs(commands::verbs::VerbsArgs),
    /// Show a board's firmware, limits, clock and counters, and why it stopped last
    #[command(after_help = "\
Examples:
  pulsetrain info --port /dev/ttyACM0
  pulsetrain info --board pico")]
    Info(At),
    /// Stop a run of this computer (it brakes within the motors' limits), or all motors of a board at once
    Stop(commands::stop::StopArgs),
    /// Pause a run: its motors come to a halt on their paths
    Pause(commands::steer::PauseArgs),
    /// Resume a run after a pause
    Resume(commands::steer::PauseArgs),
    /// Make a run faster or slower from now on, with all motors in phase
    Tempo(commands::steer::TempoArgs),
    /// List the runs of this computer and where their motors are
    Status(commands::status::StatusArgs),
    /// Move motors from where they stand to a position
    Goto(commands::goto::GotoArgs),
    /// Show the settings that a board keeps without power, or change them
    Store(commands::store::StoreArgs),
    /// Have a board measure itself while it steps: cycles for a step, lateness, how far ahead it was
    Bench(commands::bench::BenchArgs),
    /// List the boards with their limits
    Boards(Table),
    /// List the drivers with their timings, microsteps and switch settings, from their datasheets
    Drivers(Table),
    /// Write a motion file with comments, to start from
    New(commands::new::NewArgs),
}

impl Command {
    /// The port of a command that needs one of an Uno's images.
    fn port(&self) -> Option<&str> {
        match self {
            Command::Run(args) => args.port.as_deref(),
            Command::Goto(args) => args.port.as_deref(),
            Command::Live(args) => args.port.as_deref(),
            Command::Serve(args) => args.live.port.as_deref(),
            Command::Bench(args) => args.at.port.as_deref(),
            Command::Winch(args) => args.at.port.as_deref(),
            Command::Verbs(args) => args.port.as_deref(),
            _ => None,
        }
    }

    fn wants_json(&self) -> bool {
        match self {
            Command::Run(args) => args.json,
            Command::Plan(args) => args.json,
            Command::Verify(args) => args.json,
            Command::Film(args) => args.json,
            Command::Explain(args) => args.json,
            Command::Motor(args) => args.json,
            Command::Formula(args) => args.json,
            Command::Boards(args) | Command::Drivers(args) => args.json,
            Command::Info(args) => args.json,
            Command::Stop(args) => args.json,
            Command::Status(args) => args.json,
            Command::Pause(args) | Command::Resume(args) => args.wants_json(),
            Command::Tempo(args) => args.wants_json(),
            Command::Goto(args) => args.json,
            Command::Store(args) => args.json,
            Command::Bench(args) => args.at.json,
            Command::Winch(args) => args.json,
            Command::Flash(args) => args.json,
            Command::Ports(args) => args.json,
            Command::Calibrate(args) => args.json,
            Command::Bake(args) => args.json,
            Command::Plot(_)
            | Command::New(_)
            | Command::Board(_)
            | Command::Verbs(_)
            | Command::Live(_)
            | Command::Serve(_)
            | Command::Replay(_) => false,
        }
    }
}

/// Runs a command as the process does, with its output going elsewhere: for tests and for other programs.
///
/// The first of `args` is the program's name.
///
/// ```
/// let (mut out, mut err) = (Vec::new(), Vec::new());
/// let exit = pulsetrain::cli::run(["pulsetrain", "boards"], &mut out, &mut err);
/// assert_eq!(exit, pulsetrain::console::Exit::Success);
/// assert!(String::from_utf8(out).unwrap().contains("Arduino Uno"));
/// ```
pub fn run<A: Into<OsString> + Clone>(
    args: impl IntoIterator<Item = A>,
    out: &mut dyn Write,
    err: &mut dyn Write,
) -> Exit {
    run_on(args, &mut Console::new(out, err, false))
}

/// Runs the command line of this process. Ctrl-C ends it with a message, or stops the motors of a board at a port.
pub fn run_process(console: &mut Console<'_>) -> Exit {
    crate::interrupt::explain();
    run_on(std::env::args_os(), console)
}

/// Runs a command on a console, which may be a terminal.
pub fn run_on<A: Into<OsString> + Clone>(args: impl IntoIterator<Item = A>, console: &mut Console<'_>) -> Exit {
    let cli = match Cli::try_parse_from(args) {
        Ok(cli) => cli,
        Err(message) if message.use_stderr() => {
            complain(console, &message.render());
            return Exit::Refused;
        }
        Err(help) => {
            let printed = console.print(format_args!("{}\n", help.to_string().trim_end()));
            return finish(printed.map(|()| Exit::Success), false, console);
        }
    };
    let as_json = cli.command.wants_json();
    let mut outcome = obey(&cli.command, console);
    if let Err(refused) = &outcome
        && let Some(written) = commands::other_image::offered(refused, cli.command.port(), console)
    {
        outcome = written.and_then(|()| obey(&cli.command, console));
    }
    finish(outcome, as_json, console)
}

fn obey(command: &Command, console: &mut Console<'_>) -> miette::Result<Exit> {
    crate::files::begin();
    match command {
        Command::Run(args) => commands::run::run(args, console),
        Command::Live(args) => commands::live::run(args, console),
        Command::Serve(args) => commands::live::serve(args, console),
        Command::Replay(args) => commands::replay::run(args, console),
        Command::Plan(args) => commands::plan::run(args, console),
        Command::Plot(args) => commands::plot::run(args, console),
        Command::Formula(args) => commands::formula::run(args, console),
        Command::Verify(args) => commands::verify::run(args, console),
        Command::Film(args) => commands::film::run(args, console),
        Command::Explain(args) => commands::explain::run(args, console),
        Command::Motor(args) => commands::motor::run(args, console),
        Command::Board(args) => commands::board::run(args, console),
        Command::Info(args) => commands::info::run(args, console),
        Command::Stop(args) => commands::stop::run(args, console),
        Command::Pause(args) => commands::steer::pause(args, console),
        Command::Resume(args) => commands::steer::resume(args, console),
        Command::Tempo(args) => commands::steer::tempo(args, console),
        Command::Status(args) => commands::status::run(args, console),
        Command::Goto(args) => commands::goto::run(args, console),
        Command::Store(args) => commands::store::run(args, console),
        Command::Bench(args) => commands::bench::run(args, console),
        Command::Winch(args) => commands::winch::run(args, console),
        Command::Verbs(args) => commands::verbs::run(args, console),
        Command::Flash(args) => commands::flash::run(args, console),
        Command::Ports(args) => commands::ports::run(args, console),
        Command::Calibrate(args) => commands::calibrate::run(args, console),
        Command::Bake(args) => commands::bake::run(args, console),
        Command::Boards(args) => commands::boards::run(args, console),
        Command::Drivers(args) => commands::drivers::run(args, console),
        Command::New(args) => commands::new::run(args, console),
    }
}

fn finish(outcome: miette::Result<Exit>, as_json: bool, console: &mut Console<'_>) -> Exit {
    outcome.unwrap_or_else(|report| {
        let stopped = report.downcast_ref::<RunStopped>();
        // A script reads standard output. If its reader has closed the pipe, there is nobody left to show the error to.
        if let (true, Some(RunStopped { report, .. })) = (as_json, stopped) {
            let _ = console.print_json(report);
        } else if as_json {
            let _ = console.print_json(&as_report(&report));
        }
        let text = rendered(&report, GraphicalTheme::unicode_nocolor());
        if console.err_is_terminal && !text.contains(is_order) {
            // Nothing in it is an order but its colours.
            drop(console.err.screen().write_all(rendered(&report, GraphicalTheme::unicode()).as_bytes()));
        } else {
            complain(console, &text);
        }
        if stopped.is_some() { Exit::Stopped } else { Exit::Refused }
    })
}

/// An error with its advice and the places in its source.
fn rendered(report: &miette::Report, theme: GraphicalTheme) -> String {
    let mut text = String::new();
    let handler = GraphicalReportHandler::new_themed(theme).with_width(100).with_links(false);
    if handler.render_report(&mut text, report.as_ref()).is_err() {
        text = format!("{report}\n");
    }
    // miette prints a help line below each problem, so the marker of the command goes in front of each problem
    // behind the first. No line of a file begins without a margin.
    text.replace("\nError: \n", "\n").replace("\nAdvice: \n", "\n")
}

/// If the errors' own stream is closed, the exit code is the only sign of the error.
fn complain(console: &mut Console<'_>, message: &dyn std::fmt::Display) {
    drop(write!(console.err, "{message}"));
}
