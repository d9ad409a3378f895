//! `pulsetrain new`: a motion file to start from.

use clap::Args;
use std::path::PathBuf;

use pulsetrain_motion::template;

use crate::console::{Console, Exit};
use crate::files::outputs;

#[derive(Args, Debug)]
#[command(after_help = "Example:\n  pulsetrain new crank      writes crank.toml")]
pub(crate) struct NewArgs {
    /// Name of the motion; NAME.toml is written
    pub(crate) name: PathBuf,
}

pub(crate) fn run(args: &NewArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let name = &args.name;
    let path = if name.extension().is_some_and(|end| end == "toml") {
        name.clone()
    } else {
        name.with_added_extension("toml")
    };
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    outputs::write_new(&path, "name", template::motion_file(&stem).as_bytes())?;
    let path = path.display();
    console.print(format_args!("wrote {path}; now: pulsetrain run {path}\n"))?;
    Ok(Exit::Success)
}
