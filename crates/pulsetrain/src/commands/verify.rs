//! `pulsetrain verify`: judges a capture against the motion.

use crate::arguments;
use crate::arguments::{Alignment, Motion};
use crate::files::inputs;
use crate::files::outputs::{self, Destination};
use clap::Args;
use miette::miette;
use pulsetrain_motion::Time;
use pulsetrain_motion::quantity::{Quantity, nearest};
use pulsetrain_trace::capture::{self, Capture};
use pulsetrain_trace::verdict::{self, Align, JudgeError, Options};
use pulsetrain_trace::{Line, lines};
use std::path::PathBuf;

use super::film::{film_picture, wheel_of};
use super::hints;
use crate::consent::{self, Consent};
use crate::console::{Console, Exit};
use crate::diagnostic::advised;
use crate::load;
use pulsetrain_report::run_report::VerdictText;
use pulsetrain_session::estimate::Task;
use schemars::JsonSchema;
use serde::Serialize;

#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  pulsetrain verify out/tutorial/trace.vcd examples/tutorial.toml --pins
  pulsetrain verify capture.csv examples/tutorial.toml --pins --align start+rate
  pulsetrain verify capture.csv examples/tutorial.toml --align start \\
      --line \"Channel 0=wheel.step\" --line \"Channel 1=wheel.dir\"")]
pub(crate) struct VerifyArgs {
    /// The capture
    pub(crate) capture: PathBuf,
    #[command(flatten)]
    pub(crate) motion: Motion,
    /// The capture shows an Uno's pins: allow for its constant delay and its usual lateness
    #[arg(long)]
    pub(crate) pins: bool,
    /// What is fitted before the capture is judged [default: none; start+rate for a camera's track]
    #[arg(long, value_enum)]
    pub(crate) align: Option<Alignment>,
    /// How far the wheel of a camera's track may be from the motion [default: the motor's film_limit, else 1 deg or 1 step]
    #[arg(long, value_name = "ANGLE", value_parser = arguments::angle)]
    pub(crate) limit: Option<Quantity>,
    /// Draw a camera's track over the motion, as .svg
    #[arg(long, value_name = "FILE")]
    pub(crate) plot: Option<PathBuf>,
    /// Judge only up to this time of the motion: for captures that end before the motion does
    #[arg(long, value_name = "TIME", value_parser = arguments::duration, allow_hyphen_values = true, conflicts_with = "length")]
    pub(crate) until: Option<Time>,
    /// Sample rate of the analyser, e.g. "25 MHz": allow for steps that are seen one sample late
    #[arg(long, value_name = "RATE", value_parser = arguments::frequency)]
    pub(crate) sample_rate: Option<f64>,
    /// Which line a channel of the capture is, e.g. "Channel 0=wheel.step"; once for each channel
    #[arg(long, value_name = "CHANNEL=LINE", value_parser = arguments::channel)]
    pub(crate) line: Vec<(String, String)>,
    /// The motor whose wheel was filmed, if the motion file has several
    #[arg(long, value_name = "MOTOR")]
    pub(crate) motor: Option<String>,
    /// Print all that was measured of each motor
    #[arg(short, long)]
    pub(crate) verbose: bool,
    /// Print the verdict as JSON (docs/json.md)
    #[arg(long)]
    pub(crate) json: bool,
}

pub(crate) fn run(args: &VerifyArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    // Where an endless motion is cut does not matter if it is cut after the judged part.
    let length = args.motion.length.or(args.until.map(|until| until + Time::SECOND));
    let (prepared, wheels) = load::with_wheels(&args.motion.file, args.motion.board.as_deref())?;
    let shown = args.capture.display();
    let bytes = inputs::bytes(&args.capture, inputs::MAX_CAPTURE_BYTES)?;
    if let Some(path) = &args.plot {
        outputs::claim(&Destination::new(path, "--plot"))?;
    }
    let mut capture = capture::read(&bytes).map_err(|error| {
        let help =
            "captures are VCD, CSV of Saleae's or PulseView's, steps.csv, or a camera's track: CSV of time and angle";
        miette!(help = help, "{shown}: {error}")
    })?;
    let is_film = matches!(capture, Capture::Film(_));
    let prepared = if is_film && length.is_none() {
        // A film shows a part of the motion, and may show any.
        prepared
    } else {
        consent::agree(
            &prepared,
            Consent { length, task: Task::Plan, yes: args.motion.yes, json: args.json },
            console,
        )?;
        prepared.ending(length).map_err(advised)?
    };
    let program = &prepared.program;
    let of_motion = lines::of(program);
    for (from, to) in &args.line {
        if !names(&of_motion).any(|name| name.eq_ignore_ascii_case(to)) {
            let help = match names(&of_motion).find(|name| name.eq_ignore_ascii_case(from)) {
                Some(line) => format!("the channel stands before the line: write --line \"{to}={line}\""),
                None => did_you_mean(to, &of_motion),
            };
            return Err(miette!(help = help, "--line \"{from}={to}\": the motion has no line {to}"));
        }
        match &mut capture {
            Capture::Edges(trace) => {
                let help = did_you_mean(from, &trace.lines);
                trace.alias(from, to).map_err(|error| miette!(help = help, "{shown}: {error}"))?;
            }
            Capture::Steps(_) | Capture::Film(_) => {
                return Err(miette!("{shown} has no lines: --line is for VCD and CSV of analysers"));
            }
        }
    }
    let usual = if is_film { Alignment::StartAndRate } else { Alignment::None };
    let align: Align = args.align.unwrap_or(usual).into();
    if !is_film && (args.limit.is_some() || args.plot.is_some()) {
        return Err(miette!(
            help = "the limit of a capture's edges is the file's tolerance",
            "{shown} is no camera's track: --limit and --plot are for those"
        ));
    }
    let until_s = args.until.map(Time::seconds);
    let mut options = Options { align, until_s, sample_hz: args.sample_rate, ..Options::default() };
    if args.pins {
        options = hints::of_pins(&options, program);
    }
    let no_verdict = |error: JudgeError| match error {
        JudgeError::Line(_) => {
            miette!(help = "--line \"Channel 0=wheel.step\" says which channel is which line", "{shown}: {error}")
        }
        error => miette!("{shown}: {error}"),
    };
    let judged = match &capture {
        Capture::Edges(trace) => verdict::judge(trace, program, &options),
        Capture::Steps(steps) => verdict::judge_steps(steps, program, &options),
        Capture::Film(track) => {
            let wheel = wheel_of(program, &wheels, args.motor.as_deref(), args.limit.as_ref())?;
            let report =
                verdict::judge_film(track, program, args.motor.as_deref(), wheel, &options).map_err(no_verdict)?;
            if let Some(path) = &args.plot {
                let svg = film_picture(&report, &args.capture, &args.motion.file).svg();
                outputs::write(
                    path,
                    "--plot",
                    svg.map_err(|error| miette!("cannot draw {}: {error}", path.display()))?.as_bytes(),
                )?;
            }
            if args.json {
                console.print_json(&report)?
            } else {
                console.print(format_args!("{report}\n"))?
            }
            return Ok(exit(report.ok));
        }
    };
    let report = judged.map_err(no_verdict)?;
    let hints = if report.ok { Vec::new() } else { hints::hints(&capture, program, &options, &report, args.pins) };
    let pass = report.ok;
    if args.json {
        console.print_json(&VerifyReport { pass, report, hints })?;
    } else {
        console.print(VerdictText { report: &report, verbose: args.verbose })?;
        hints.iter().try_for_each(|hint| console.print(format_args!("{hint}\n")))?;
    }
    Ok(exit(pass))
}

/// The verdict on edges or steps.
#[derive(Serialize, JsonSchema)]
pub(crate) struct VerifyReport {
    /// Whether no bound broke.
    pass: bool,
    #[serde(flatten)]
    report: verdict::Report,
    /// What would make a capture pass that fails, or why it cannot.
    hints: Vec<String>,
}

fn names(lines: &[Line]) -> impl Iterator<Item = &str> {
    lines.iter().flat_map(|line| &line.names).map(String::as_str)
}

/// The line that a misspelt name is nearest to; else all lines.
fn did_you_mean(name: &str, lines: &[Line]) -> String {
    match nearest(name, names(lines)) {
        Some(near) => format!("did you mean {near}?"),
        None => format!("the lines are {}", names(lines).collect::<Vec<_>>().join(", ")),
    }
}

fn exit(ok: bool) -> Exit {
    if ok { Exit::Success } else { Exit::BoundBroken }
}
