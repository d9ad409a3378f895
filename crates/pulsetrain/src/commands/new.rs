//! `pulsetrain new`: a motion file to start from.

use std::fs::OpenOptions;
use std::io::Write;

use pulsetrain_motion::template;

use crate::cli::New;
use crate::console::{Console, Exit, access};

pub(crate) fn run(args: &New, console: &mut Console<'_>) -> miette::Result<Exit> {
    let name = &args.name;
    let path = if name.extension().is_some_and(|end| end == "toml") {
        name.clone()
    } else {
        name.with_added_extension("toml")
    };
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    // Nobody's file is overwritten.
    let mut file =
        OpenOptions::new().write(true).create_new(true).open(&path).map_err(|error| access("write", &path, error))?;
    file.write_all(template::motion_file(&stem).as_bytes()).map_err(|error| access("write", &path, error))?;
    let path = path.display();
    console.print(format_args!("wrote {path}; now: pulsetrain run {path}\n"))?;
    Ok(Exit::Success)
}
