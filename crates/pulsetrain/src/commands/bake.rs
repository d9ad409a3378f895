//! `pulsetrain bake`: a motion that stays on a board.

use std::path::Path;

use miette::miette;
use pulsetrain_plan::Refused;
use serde::Serialize;

use crate::bake::{BakeError, Sketch};
use crate::cli::Bake;
use crate::console::{self, Console, Exit};
use crate::human;
use crate::prepare::Prepared;

/// What it comes to.
#[derive(Debug, Serialize)]
struct Baked {
    /// The .ino file.
    file: String,
    rows: usize,
    table_bytes: usize,
    /// It repeats for ever.
    endless: bool,
}

pub(crate) fn run(args: &Bake, console: &mut Console<'_>) -> miette::Result<Exit> {
    let prepared = match args.length {
        None => Prepared::endless(&args.file, args.board.as_deref())?,
        length => Prepared::load(&args.file, args.board.as_deref(), length)?,
    };
    let name = args.sketch.file_name().map(|name| name.to_string_lossy().into_owned()).filter(|name| is_name(name));
    let Some(name) = name else {
        let help =
            "the Arduino IDE wants letters, digits, dots, dashes and underscores, beginning with a letter or digit";
        return Err(miette!(help = help, "{} is no name for a sketch", args.sketch.display()));
    };
    let title =
        Path::new(&prepared.file).file_name().map_or_else(String::new, |file| file.to_string_lossy().into_owned());
    let sketch = match Sketch::new(&prepared.program, &title) {
        Ok(sketch) => sketch,
        Err(BakeError::Plan(Refused { motor, error })) => return Err(prepared.refuse(Refused { motor, error }).into()),
        Err(error) => return Err(miette!(help = error.advice(), "{}: {error}", prepared.file)),
    };
    let path = args.sketch.join(format!("{name}.ino"));
    console::write(&path, sketch.text.as_bytes())?;
    let baked = Baked {
        file: path.display().to_string(),
        rows: sketch.rows,
        table_bytes: sketch.bytes,
        endless: sketch.endless,
    };
    if args.json {
        console.print_json(&baked)?;
    } else {
        let (rows, bytes) = (human::count(baked.rows as i128), human::count(baked.table_bytes as i128));
        let ends = if baked.endless { "it repeats for ever" } else { "it runs once after power-up" };
        console.print(format_args!("{}: {rows} rows, {bytes} bytes of flash for them; {ends}\n", baked.file))?;
    }
    Ok(Exit::Success)
}

fn is_name(name: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    name.len() <= 63 && name.chars().all(allowed) && name.starts_with(|c: char| c.is_ascii_alphanumeric())
}
