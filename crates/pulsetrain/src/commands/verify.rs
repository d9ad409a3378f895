//! `pulsetrain verify`: a capture against the motion.

use std::fmt::Display;

use miette::miette;
use pulsetrain_trace::capture::{self, Capture};
use pulsetrain_trace::verdict::{self, Align, JudgeError, Options};
use serde::Serialize;

use crate::cli::{Alignment, Verify};
use crate::console::{self, Console, Exit};

pub(crate) fn run(args: &Verify, console: &mut Console<'_>) -> miette::Result<Exit> {
    let prepared = args.motion.prepare()?;
    let program = &prepared.program;
    let shown = args.capture.display();
    let bytes = console::read(&args.capture)?;
    let capture = capture::read(&bytes).map_err(|error| {
        let help = "captures are VCD, Saleae CSV, steps.csv, or a camera's track: CSV of time and angle";
        miette!(help = help, "{shown}: {error}")
    })?;
    let align = match args.align {
        Alignment::None => Align::None,
        Alignment::Start => Align::Start,
        Alignment::StartAndRate => Align::StartAndRate,
    };
    let options = Options { align, ..Options::default() };
    let (ok, json, text) = match &capture {
        Capture::Edges(trace) => told(verdict::judge(trace, program, &options), |report| report.ok),
        Capture::Steps(steps) => told(verdict::judge_steps(steps, program, &options), |report| report.ok),
        Capture::Film(track) => {
            told(verdict::judge_film(track, program, args.motor.as_deref(), &options, None), |report| report.ok)
        }
    }
    .map_err(|error| miette!("{shown}: {error}"))??;
    console.print(format_args!("{}\n", if args.json { json } else { text }))?;
    Ok(if ok { Exit::Success } else { Exit::BoundBroken })
}

/// Whether a report is good, and how it reads, as JSON and as text.
fn told<R: Serialize + Display>(
    report: Result<R, JudgeError>,
    ok: impl Fn(&R) -> bool,
) -> Result<miette::Result<(bool, String, String)>, JudgeError> {
    let report = report?;
    Ok(console::json(&report).map(|json| (ok(&report), json, report.to_string())))
}
