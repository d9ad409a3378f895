//! `pulsetrain plan`: plan and prove; nothing runs.

use crate::arguments;
use crate::arguments::Motion;
use clap::Args;
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::Time;

use crate::console::{Console, Exit};
use crate::diagnostic::advised;
use crate::report::{MotorReport, PlanReport, TableReport, unlimited};
use pulsetrain_session::estimate::Task;
use pulsetrain_session::plans::Planned;
use pulsetrain_session::prepare::Prepared;

#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  pulsetrain plan examples/tutorial.toml
  pulsetrain plan examples/tutorial.toml --board uno --json")]
pub(crate) struct PlanArgs {
    #[command(flatten)]
    pub(crate) motion: Motion,
    /// Rate of the line that is to bring the plan to the board [default: 1000000; a Pico's own USB, which has no rate]
    #[arg(long, value_name = "BAUD", value_parser = arguments::baud)]
    pub(crate) baud: Option<Baud>,
    /// Print the report as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

pub(crate) fn run(args: &PlanArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let mut prepared = args.motion.prepare(Task::Plan, args.json, console)?;
    prepared.over_line(args.baud);
    let planned = plan(&mut prepared, console)?;
    let report = report(&prepared, &planned);
    if args.json {
        console.print_json(&report)?
    } else {
        console.print(&report)?
    }
    Ok(Exit::Success)
}

/// Plans with a progress bar.
pub(crate) fn plan(prepared: &mut Prepared, console: &Console<'_>) -> miette::Result<Vec<Planned>> {
    let bar = console.progress(prepared.end_s(), "the motion");
    bar.stage("planning");
    let planned = prepared.prove(|seconds| bar.set(seconds)).map_err(advised)?;
    Ok(planned)
}

pub(crate) fn report(prepared: &Prepared, planned: &[Planned]) -> PlanReport {
    let program = &prepared.program;
    let board = &program.board;
    let last_tick = planned.iter().map(|planned| planned.last_tick).max().unwrap_or(0);
    let motors = program.motors.iter().zip(planned);
    let motors: Vec<MotorReport> =
        motors.map(|(motor, planned)| MotorReport::new(motor, board, &planned.certificate)).collect();
    PlanReport {
        file: prepared.file.clone(),
        board: board.name.clone(),
        tick_hz: board.tick_hz,
        tolerance_ticks: program.tolerance.ticks(board.tick_hz),
        duration_s: last_tick as f64 / board.tick_hz as f64,
        cut_at_s: prepared.cut.map(|cut| cut.at.seconds()),
        uncut_s: prepared.cut.and_then(|cut| cut.end).map(Time::seconds),
        pause: prepared.pause,
        tables: prepared.tables.iter().map(TableReport::new).collect(),
        notes: unlimited(&motors).into_iter().collect(),
        motors,
    }
}
