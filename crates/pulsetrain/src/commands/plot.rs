//! `pulsetrain plot`: a picture of a motion, run on the native board.

use super::problems::drive_problem;
use super::{plan, run};
use crate::arguments::Motion;
use crate::console::{Access, Console, Exit};
use crate::diagnostic::advised;
use crate::record::Files;
use clap::Args;
use pulsetrain_session::Proof;
use pulsetrain_session::drive::Driven;
use pulsetrain_session::estimate::Task;
use pulsetrain_session::lateness::Edges;
use std::path::PathBuf;

#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  pulsetrain plot examples/tutorial.toml
  pulsetrain plot examples/tutorial.toml --out tutorial.png")]
pub(crate) struct PlotArgs {
    #[command(flatten)]
    pub(crate) motion: Motion,
    /// Picture to write, .svg or .png [default: the file's name with .svg]
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
}

pub(crate) fn run(args: &PlotArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let mut prepared = args.motion.prepare(Task::Native { files: false }, false, console)?;
    let planned = plan::plan(&mut prepared, console)?;
    let path = args.out.clone().unwrap_or_else(|| args.motion.file.with_extension("svg"));
    let driven = Driven::native(&prepared).map_err(advised)?;
    let files = None::<Result<Files<std::io::Sink>, Access>>;
    let ran =
        run::record(&prepared, Proof { planned, is_whole: true }, driven, files, Edges::default(), None, console)?;
    let recorded = ran.map_err(|(error, _)| drive_problem(error))?.recorded;
    run::draw(&recorded.picture, &path)?;
    console.print(format_args!("{}\n", path.display()))?;
    Ok(if recorded.verdict.ok { Exit::Success } else { Exit::BoundBroken })
}
