//! `pulsetrain status`: how the runs of this computer are.

use std::fmt::{self, Display};
use std::time::Duration;

use clap::Args;
use miette::miette;
use pulsetrain_motion::human;
use pulsetrain_session::control::Status;
use serde::Serialize;

use super::steer::in_words;
use super::stop::chosen;
use crate::console::{Console, Exit};
use crate::control_socket::{RunClient, runs};
use crate::live::{RunEnded, RunEvent, RunInfo, RunLine};

#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  pulsetrain status
  pulsetrain status --follow --json      a line of JSON for each status, to the end of the run")]
pub(crate) struct StatusArgs {
    /// The run at this serial port, or of this name
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// Go on until the run ends, with a line for each status
    #[arg(long)]
    pub(crate) follow: bool,
    /// Print lines of JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// How long `status` waits for a run's next line without --follow. A run that moves sends 20 statuses a second; one that plans, or judges at
/// its end, sends none.
const PATIENCE: Duration = Duration::from_millis(500);

/// A status, and whose.
#[derive(Debug, Serialize)]
struct RunStatus<'a> {
    run: &'a RunInfo,
    /// `None`: the run sends none now.
    status: Option<Status>,
    /// Positions of the motors in their units.
    positions: Vec<f64>,
}

pub(crate) fn run(args: &StatusArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let runs = runs()?;
    if runs.is_empty() && args.port.is_none() {
        return console.print(if args.json { "" } else { "nothing runs on this computer\n" }).map(|()| Exit::Success);
    }
    // Without --follow all runs are listed.
    let mut chosen = chosen(runs, args.port.as_deref(), !args.follow, "status --follow")?;
    if let (true, Some(port)) = (chosen.is_empty(), &args.port) {
        let help = "`pulsetrain status` lists the runs; `pulsetrain info --port PORT` asks a board";
        return Err(miette!(help = help, "no run of this computer has {port}"));
    }
    // All are asked before the first one is waited for.
    chosen.iter_mut().try_for_each(RunClient::follow)?;
    chosen.into_iter().try_for_each(|run| show(run, args, console))?;
    Ok(Exit::Success)
}

fn show(mut run: RunClient, args: &StatusArgs, console: &mut Console<'_>) -> miette::Result<()> {
    loop {
        let line = if args.follow { Some(run.next_line()?) } else { run.next_line_within(PATIENCE)? };
        let info = run.info();
        let line = match line {
            None | Some(RunLine::Event(RunEvent::Status(_))) => {
                let status = match line {
                    Some(RunLine::Event(RunEvent::Status(status))) => Some(status),
                    _ => None,
                };
                let motors = status.iter().flat_map(|status| status.motors.iter().enumerate());
                let positions = motors.filter_map(|(motor, status)| info.position(motor, status.position)).collect();
                let status = RunStatus { run: info, status, positions };
                if args.json {
                    print_line(&status, console)?
                } else {
                    console.print(&status)?
                }
                if !args.follow {
                    return Ok(());
                }
                continue;
            }
            Some(line) => line,
        };
        match line {
            RunLine::Event(event) if args.follow => {
                if args.json {
                    print_line(&event, console)?
                } else {
                    console.print(format_args!("{}\n", in_words(&event)))?
                }
            }
            RunLine::Event(_) | RunLine::Control { .. } | RunLine::Info(_) => {}
            RunLine::Error { error } => return Err(miette!("the run at {}: {error}", info.place())),
            RunLine::Ended(end) => {
                return if args.json {
                    print_line(&end, console)
                } else {
                    console.print(format_args!("{}\n", last_words(&end)))
                };
            }
        }
    }
}

/// Prints a value as one line of JSON.
fn print_line(value: &impl Serialize, console: &mut Console<'_>) -> miette::Result<()> {
    let line = serde_json::to_string(value).map_err(|error| miette!("cannot write JSON: {error}"))?;
    console.print(format_args!("{line}\n"))
}

impl Display for RunStatus<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let RunStatus { run, status, positions } = self;
        let Some(status) = status else {
            return writeln!(
                f,
                "{} at {}: no status now; it plans its motion, or judges what it made",
                run.file,
                run.place()
            );
        };
        write!(f, "{} at {}, {}:", run.file, run.place(), human::seconds_to(status.at_s, 4))?;
        for ((motor, state), position) in run.motors.iter().zip(&status.motors).zip(positions) {
            let unit = human::unit(&motor.unit);
            write!(f, "  {} {} {unit}", motor.name, human::significant(*position, 6))?;
            match state.speed {
                Some(speed) => write!(f, " {} {unit}/s", human::significant(speed / motor.steps_per_unit, 3))?,
                None => f.write_str(" brakes")?,
            }
        }
        writeln!(f)
    }
}

fn last_words(end: &RunEnded) -> String {
    match &end.why {
        Some(why) => format!("it ended: {why}"),
        None => format!("it ended: {}", pulsetrain_report::positions::listed(&end.motors)),
    }
}
