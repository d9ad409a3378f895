//! `pulsetrain bake`: a motion that stays on a board.

use std::fs;
use std::path::Path;

use miette::miette;
use pulsetrain_board::stk500;
use serde::Serialize;

use crate::bake::{BakeError, Image, PicoImage, Size, Sketch, sketch};
use crate::cli::Bake;
use crate::console::{self, Console, Exit};
use crate::human;
use crate::prepare::Prepared;

/// What it comes to.
#[derive(Debug, Serialize)]
struct Baked {
    /// The .ino file, or the image.
    file: String,
    rows: usize,
    table_bytes: usize,
    /// Of an image, all that it takes of the flash.
    #[serde(skip_serializing_if = "Option::is_none")]
    flash_bytes: Option<usize>,
    /// It repeats for ever.
    endless: bool,
}

pub(crate) fn run(args: &Bake, console: &mut Console<'_>) -> miette::Result<Exit> {
    let mut prepared = match args.length {
        None => Prepared::endless(&args.file, args.board.as_deref())?,
        length => Prepared::load(&args.file, args.board.as_deref(), length)?,
    };
    if let Some(ppm) = args.clock_ppm {
        prepared.calibrate(ppm);
    }
    if prepared.program.board.name == "pico" {
        return pico(args, &prepared, console);
    }
    let refused = |error| problem(&prepared, error);
    let (path, text, size, flash) = match (&args.sketch, &args.output) {
        (Some(folder), _) => {
            let name = sketch_name(folder)?;
            let title = Path::new(&prepared.file).file_name().unwrap_or_default().to_string_lossy();
            let sketch = Sketch::new(&prepared.program, &title).map_err(refused)?;
            let path = folder.join(format!("{name}.ino"));
            check_own(&path)?;
            (path, sketch.text, sketch.size, None)
        }
        (None, Some(file)) => {
            let image = Image::new(&prepared.program).map_err(refused)?;
            (file.clone(), image.hex(), image.size, Some(image.flash.len()))
        }
        (None, None) => return Err(miette!("say --sketch DIR or --output FILE")),
    };
    console::write(&path, text.as_bytes())?;
    let Size { rows, bytes, endless } = size;
    let baked = Baked { file: path.display().to_string(), rows, table_bytes: bytes, flash_bytes: flash, endless };
    if args.json {
        console.print_json(&baked)?;
        return Ok(Exit::Success);
    }
    let (rows, bytes) = (human::count(rows as i128), human::count(bytes as i128));
    let ends = ends(endless);
    let all = flash.map_or(String::new(), |bytes| {
        let room = human::count(stk500::room(stk500::RATES[0]) as i128);
        format!(", {} with what plays them, of {room}", human::count(bytes as i128))
    });
    console.print(format_args!("{}: {rows} rows, {bytes} bytes of flash for them{all}; {ends}\n", baked.file))?;
    if args.sketch.is_none() {
        console
            .print(format_args!("`pulsetrain flash uno --port PORT --image {}` writes it to the Uno\n", baked.file))?;
    }
    Ok(Exit::Success)
}

/// Leaves alone what somebody wrote: a sketch is written over if it was made here.
fn check_own(path: &Path) -> miette::Result<()> {
    let Ok(text) = fs::read(path) else { return Ok(()) };
    if String::from_utf8_lossy(&text).lines().take(2).any(|line| line.contains(sketch::MADE)) {
        return Ok(());
    }
    let help = "name another folder; or move that file away, if it is not needed";
    Err(miette!(help = help, "{} is there, and was not made by `pulsetrain bake`", path.display()))
}

/// What it comes to on a Pico.
#[derive(Debug, Serialize)]
struct BakedPico {
    file: String,
    /// Segments and waits.
    items: usize,
    /// Of the motion, and of all that the image takes.
    motion_bytes: usize,
    flash_bytes: usize,
    endless: bool,
}

fn pico(args: &Bake, prepared: &Prepared, console: &mut Console<'_>) -> miette::Result<Exit> {
    let Some(path) = &args.output else {
        let help =
            "--output FILE writes an image, which `pulsetrain flash pico` takes; a sketch can be had for --board uno";
        return Err(miette!(help = help, "{}: sketches are for an Uno, and this is for a Pico", prepared.file));
    };
    let image = PicoImage::new(&prepared.program).map_err(|error| problem(prepared, error))?;
    console::write(path, &image.uf2())?;
    let PicoImage { items, block_bytes: motion_bytes, endless, ref flash } = image;
    let baked = BakedPico { file: path.display().to_string(), items, motion_bytes, flash_bytes: flash.len(), endless };
    if args.json {
        console.print_json(&baked)?;
        return Ok(Exit::Success);
    }
    let count = |number: usize| human::count(number as i128);
    console.print(format_args!(
        "{}: {} segments and waits, {} bytes of flash, {} with the firmware, of {}; {}\n\
         `pulsetrain flash pico --image {0}` writes it to the Pico; `pulsetrain flash pico` alone takes it away\n",
        baked.file,
        count(items),
        count(motion_bytes),
        count(flash.len()),
        count(PicoImage::ROOM),
        ends(endless),
    ))?;
    Ok(Exit::Success)
}

const fn ends(endless: bool) -> &'static str {
    if endless { "it repeats for ever" } else { "it runs once after power-up" }
}

fn problem(prepared: &Prepared, error: BakeError) -> miette::Report {
    match error {
        BakeError::Plan(refused) => prepared.refuse(refused).into(),
        error => miette!(help = error.advice(), "{}: {error}", prepared.file),
    }
}

/// A sketch is called as its folder.
fn sketch_name(folder: &Path) -> miette::Result<String> {
    let name = folder.file_name().map(|name| name.to_string_lossy().into_owned()).filter(|name| is_name(name));
    name.ok_or_else(|| {
        let help =
            "the Arduino IDE wants letters, digits, dots, dashes and underscores, beginning with a letter or digit";
        miette!(help = help, "{} is no name for a sketch", folder.display())
    })
}

fn is_name(name: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    name.len() <= 63 && name.chars().all(allowed) && name.starts_with(|c: char| c.is_ascii_alphanumeric())
}
