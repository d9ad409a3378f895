//! `pulsetrain plan`: plan and prove; nothing runs.

use crate::arguments;
use crate::arguments::Motion;
use clap::Args;
use miette::miette;
use pulsetrain_board::BoardKind;
use pulsetrain_core::wire::Baud;

use crate::console::{Console, Exit};
use crate::diagnostic::advised;
use pulsetrain_report::plan_report::PlanReport;
use pulsetrain_session::Proof;
use pulsetrain_session::estimate::Task;
use pulsetrain_session::plans::Planned;
use pulsetrain_session::prepare::Prepared;

#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  pulsetrain plan examples/tutorial.toml
  pulsetrain plan examples/tutorial.toml -v
  pulsetrain plan examples/tutorial.toml --board uno --json")]
pub(crate) struct PlanArgs {
    #[command(flatten)]
    pub(crate) motion: Motion,
    /// Rate of the line that is to bring the plan to the board [default: 1000000; a Pico's own USB, which has no rate]
    #[arg(long, value_name = "BAUD", value_parser = arguments::baud)]
    pub(crate) baud: Option<Baud>,
    /// Print all that is known of each motor's plan
    #[arg(short, long)]
    pub(crate) verbose: bool,
    /// Print the report as JSON (docs/json.md)
    #[arg(long)]
    pub(crate) json: bool,
}

pub(crate) fn run(args: &PlanArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let mut prepared = args.motion.prepare(Task::Plan, args.json, console)?;
    over_line(&mut prepared, args.baud)?;
    let planned = plan(&mut prepared, console)?;
    let report = PlanReport::new(&prepared, &planned);
    if args.json {
        console.print_json(&report)?;
    } else {
        console.print(&report)?;
        if args.verbose {
            console.print(format_args!("\n{}", report.details()))?;
        }
    }
    Ok(Exit::Success)
}

/// Lets the plan come to the board over a line at the rate that the user gave, or over the usual line.
///
/// # Errors
/// If the user gave a rate for a board that has no line.
pub(crate) fn over_line(prepared: &mut Prepared, baud: Option<Baud>) -> miette::Result<()> {
    check_baud(prepared, baud)?;
    prepared.over_line(baud);
    Ok(())
}

/// # Errors
/// If the user gave a rate for a board that has no line.
pub(crate) fn check_baud(prepared: &Prepared, baud: Option<Baud>) -> miette::Result<()> {
    let board = &prepared.program.board.name;
    if baud.is_some() && BoardKind::named(board).is_none() {
        let help = "leave --baud out, or add --board uno or --board pico";
        return Err(miette!(
            help = help,
            "{}: --baud has no meaning for the board `{board}`: no line leads to it",
            prepared.file
        ));
    }
    Ok(())
}

/// Plans with a progress bar.
pub(crate) fn plan(prepared: &mut Prepared, console: &Console<'_>) -> miette::Result<Vec<Planned>> {
    let bar = console.progress(prepared.end_s(), "the motion");
    bar.stage("planning");
    let planned = prepared.prove(|seconds| bar.set(seconds)).map_err(advised)?;
    Ok(planned)
}

/// Plans, with a progress bar, what has to be proven before the first step: all of the motion, or the beginning of one that takes long to plan. The rest is
/// proven while it runs.
pub(crate) fn prove_first(prepared: &mut Prepared, console: &Console<'_>) -> miette::Result<Proof> {
    let bar = console.progress(prepared.end_s(), "the motion");
    bar.stage("planning");
    let proven = prepared.prove_first(|seconds| bar.set(seconds)).map_err(advised)?;
    Ok(proven)
}
