//! `pulsetrain verify`: a capture against the motion.

use miette::miette;
use pulsetrain_motion::{Time, boards};
use pulsetrain_trace::capture::{self, Capture};
use pulsetrain_trace::verdict::{self, Align, JudgeError, Options};

use crate::cli::{Alignment, Verify};
use crate::consent::{self, Consent};
use crate::console::{self, Console, Exit};
use crate::diagnostic::advised;
use crate::load;
use crate::report::VerdictTable;
use pulsetrain_session::estimate::Task;
use pulsetrain_session::lateness::Edges;

pub(crate) fn run(args: &Verify, console: &mut Console<'_>) -> miette::Result<Exit> {
    // Where an endless motion is cut does not matter if it is after what is judged.
    let length = args.motion.length.or(args.until.map(|until| until + Time::SECOND));
    let prepared = load::endless(&args.motion.file, args.motion.board.as_deref())?;
    consent::agree(&prepared, Consent { length, task: Task::Plan, yes: args.motion.yes, json: args.json }, console)?;
    let prepared = prepared.ending(length).map_err(advised)?;
    let program = &prepared.program;
    let shown = args.capture.display();
    let bytes = console::read(&args.capture)?;
    let mut capture = capture::read(&bytes).map_err(|error| {
        let help =
            "captures are VCD, CSV of Saleae's or PulseView's, steps.csv, or a camera's track: CSV of time and angle";
        miette!(help = help, "{shown}: {error}")
    })?;
    for (from, to) in &args.line {
        match &mut capture {
            Capture::Edges(trace) => trace.alias(from, to).map_err(|error| miette!("{shown}: {error}"))?,
            Capture::Steps(_) | Capture::Film(_) => {
                return Err(miette!("{shown} has no lines: --line is for VCD and CSV of analysers"));
            }
        }
    }
    let align = match args.align {
        Alignment::None => Align::None,
        Alignment::Start => Align::Start,
        Alignment::StartAndRate => Align::StartAndRate,
    };
    let until_s = args.until.map(Time::seconds);
    let mut options = Options { align, until_s, sample_hz: args.sample_rate, ..Options::default() };
    if args.pins {
        // What is seen on pins comes the board's constant after its scheduled tick, and may be late.
        let edges = Edges::of(program);
        options.constant_ticks = edges.constant_ticks.into();
        let tolerance = program.tolerance.ticks(program.board.tick_hz);
        options.bound_ticks = Some(tolerance + f64::from(edges.late_ticks));
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
            let report =
                verdict::judge_film(track, program, args.motor.as_deref(), &options, None).map_err(no_verdict)?;
            if args.json {
                console.print_json(&report)?
            } else {
                console.print(format_args!("{report}\n"))?
            }
            return Ok(exit(report.ok));
        }
    };
    let report = judged.map_err(no_verdict)?;
    if args.json {
        console.print_json(&report)?;
    } else {
        console.print(VerdictTable(&report))?;
        if !report.ok && align == Align::None {
            console.print("Did the capture begin before the motion? Then say --align start, or start+rate\n")?;
        }
        if !report.ok && !args.pins && boards::is_uno(&program.board.name) {
            console.print("Does it show an Uno's pins, a virtual one's too? Then say --pins\n")?;
        }
    }
    Ok(exit(report.ok))
}

fn exit(ok: bool) -> Exit {
    if ok { Exit::Success } else { Exit::BoundBroken }
}
