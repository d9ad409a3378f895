//! `pulsetrain bake`: writes a motion that a board plays without a computer.

use crate::arguments;
use crate::files::outputs::{self, Destination};
use clap::Args;
use pulsetrain_motion::Time;
use pulsetrain_motion::file::read_named;
use std::path::Path;
use std::path::PathBuf;

use miette::miette;
use pulsetrain_board::virtual_uno::VirtualUno;
use schemars::JsonSchema;
use serde::Serialize;

use super::rehearsal::Rehearsal;
use crate::consent::{self, Consent};
use crate::console::{Console, Exit};
use crate::diagnostic::advised;
use crate::load;
use pulsetrain_bake::rehearsal;
use pulsetrain_bake::{BakeError, Image, PicoImage, PutOff, Size, Sketch, Target, sketch};
use pulsetrain_motion::human;
use pulsetrain_session::estimate::Task;
use pulsetrain_session::prepare::Prepared;
use pulsetrain_session::rehearsal::Length;

#[derive(Args, Debug)]
#[command(after_help = "\
For an Arduino Uno and a Raspberry Pi Pico. An image is the firmware with the motion in its flash. It steps as exactly \
as a run from this computer, and as fast (on a Pico nearly as fast). An endless motion that repeats never loses its \
phase: each period begins at its own exact time, to 2^-48 of a tick on an Uno and 2^-64 on a Pico.

A sketch is plain C++ for the Arduino IDE, with tables in flash and no library. It is slower, and its motors wait for \
one another. It uses the Uno's Timer1 and stops millis() and delay().

Before an Uno's image is written, a virtual Uno plays it, and every edge is compared with the law. If the Uno could \
not keep up, no image is written.

Examples:
  pulsetrain bake examples/sweep.toml --output sweep.hex          four motors, for ever
  pulsetrain flash uno --port /dev/ttyACM0 --image sweep.hex      onto the Uno; `flash uno` alone brings the firmware back
  pulsetrain bake examples/pico.toml --output motion.uf2          for a Pico
  pulsetrain flash pico --image motion.uf2
  pulsetrain bake examples/tutorial.toml --sketch tutorial        writes tutorial/tutorial.ino")]
#[command(group(clap::ArgGroup::new("to").required(true).args(["sketch", "output"])))]
pub(crate) struct BakeArgs {
    /// Motion file (TOML)
    pub(crate) file: PathBuf,
    /// Write an Arduino sketch into this folder; the sketch has the folder's name
    #[arg(long, value_name = "DIR")]
    pub(crate) sketch: Option<PathBuf>,
    /// Write an image of the board's flash there: Intel HEX of an Uno's, UF2 of a Pico's
    #[arg(long, short, value_name = "FILE")]
    pub(crate) output: Option<PathBuf>,
    /// Hold the motion against this board's limits instead of the file's
    #[arg(long, value_name = "BOARD", value_parser = arguments::board)]
    pub(crate) board: Option<String>,
    /// How much of an endless motion, with its unit; the planned stop comes after [default: it never ends]
    #[arg(long = "for", value_name = "TIME", value_parser = arguments::duration, allow_hyphen_values = true)]
    pub(crate) length: Option<Time>,
    /// Go on with a motion that takes long to plan or to run, or makes large files, without being asked
    #[arg(long)]
    pub(crate) yes: bool,
    /// How much faster than it should the board's clock runs, ppm, as `pulsetrain calibrate` measures it; the motion is corrected for it
    #[arg(long, value_name = "PPM", value_parser = arguments::clock_ppm, allow_hyphen_values = true)]
    pub(crate) clock_ppm: Option<f64>,
    /// How much of it the virtual Uno plays before its image is written [default: all, 60 s at most; where motors repeat, until each
    /// phase that they have to one another was seen]
    #[arg(long, value_name = "TIME", value_parser = arguments::duration, allow_hyphen_values = true, conflicts_with = "sketch")]
    pub(crate) rehearse: Option<Time>,
    /// Write an Uno's image without this rehearsal
    #[arg(long, conflicts_with_all = ["rehearse", "sketch"])]
    pub(crate) no_rehearsal: bool,
    /// Print the report as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// The sketch that was made.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct BakedSketch {
    /// Path of the .ino file.
    file: String,
    /// Rows of its table.
    rows: usize,
    /// Bytes of its table.
    table_bytes: usize,
    /// Whether the motion repeats for ever.
    endless: bool,
    /// Steps that a shared DIR line delays; of a repeating motion, in one turn.
    steps_put_off: u64,
    /// The longest of these delays, ticks.
    longest_put_off_ticks: u64,
}

/// The image that was made.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct BakedImage {
    /// Path of the image.
    file: String,
    /// Segments and waits.
    items: usize,
    /// Bytes of the motion.
    motion_bytes: usize,
    /// Bytes of the whole image.
    flash_bytes: usize,
    /// Whether the motion repeats for ever.
    endless: bool,
    /// Steps that a shared DIR line delays; of a repeating motion, in one turn.
    steps_put_off: u64,
    /// The longest of these delays, ticks.
    longest_put_off_ticks: u64,
    /// Only for an Uno, and only if the user wants a rehearsal.
    #[serde(skip_serializing_if = "Option::is_none")]
    rehearsed: Option<Rehearsal>,
}

pub(crate) fn run(args: &BakeArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let mut prepared = load::endless(&args.file, args.board.as_deref())?;
    let consent = Consent { length: args.length, task: Task::Plan, yes: args.yes, json: args.json };
    consent::agree(&prepared, consent, console)?;
    if args.length.is_some() {
        prepared = prepared.ending(args.length).map_err(advised)?;
    }
    if let Some(ppm) = args.clock_ppm {
        prepared.calibrate(ppm);
    }
    if let Some(path) = &args.output {
        outputs::claim(&Destination::new(path, "--output"))?;
    }
    // For a board without a firmware the image or the sketch is refused, with the reason.
    let target = Target::of(&prepared.program).unwrap_or(Target::Avr);
    if !target.is_rehearsed() && args.rehearse.is_some() {
        let help = "leave --rehearse out: a Pico's limits are of motors that read their motion from its flash";
        return Err(miette!(help = help, "{}: only images for an Uno are rehearsed", prepared.file));
    }
    match (&args.sketch, &args.output, target) {
        (None, Some(path), Target::Rp2040) => {
            check_ending(path, "uf2", "a Pico's image is UF2")?;
            pico(args, &prepared, path, console)
        }
        (None, Some(path), Target::Avr) => {
            check_ending(path, "hex", "an Uno's image is Intel HEX")?;
            uno(args, &prepared, path, console)
        }
        (Some(folder), _, Target::Avr) => sketch(args, &prepared, folder, console),
        (Some(_), _, Target::Rp2040) => {
            let help = "--output FILE writes an image, which `pulsetrain flash pico` takes; a sketch can be had for --board uno";
            Err(miette!(help = help, "{}: sketches are for an Uno, and this is for a Pico", prepared.file))
        }
        (None, None, _) => Err(miette!("say --sketch DIR or --output FILE")),
    }
}

fn sketch(args: &BakeArgs, prepared: &Prepared, folder: &Path, console: &mut Console<'_>) -> miette::Result<Exit> {
    let name = sketch_name(folder)?;
    let title = Path::new(&prepared.file).file_name().unwrap_or_default().to_string_lossy();
    let sketch = Sketch::new(&prepared.program, &title).map_err(|error| problem(prepared, error))?;
    let path = folder.join(format!("{name}.ino"));
    check_own(&path)?;
    outputs::write(&path, "--sketch", sketch.text.as_bytes())?;
    let Size { rows, bytes: table_bytes, endless, put_off } = sketch.size;
    let PutOff { steps: steps_put_off, longest_ticks: longest_put_off_ticks } = put_off;
    let file = path.display().to_string();
    let baked = BakedSketch { file, rows, table_bytes, endless, steps_put_off, longest_put_off_ticks };
    if args.json {
        console.print_json(&baked)?;
        return Ok(Exit::Success);
    }
    let (rows, bytes) = (human::count(rows as i128), human::count(table_bytes as i128));
    console.print(format_args!("{}: {rows} rows, {bytes} bytes of flash for them; {}\n", baked.file, ends(endless)))?;
    say_put_off(put_off, prepared, endless, console)?;
    Ok(Exit::Success)
}

fn pico(args: &BakeArgs, prepared: &Prepared, path: &Path, console: &mut Console<'_>) -> miette::Result<Exit> {
    let image = PicoImage::new(&prepared.program).map_err(|error| problem(prepared, error))?;
    let PicoImage { items, block_bytes: motion_bytes, endless, put_off, ref flash } = image;
    let PutOff { steps: steps_put_off, longest_ticks: longest_put_off_ticks } = put_off;
    let (file, flash_bytes, rehearsed) = (path.display().to_string(), flash.len(), None);
    let baked =
        BakedImage { file, items, motion_bytes, flash_bytes, endless, steps_put_off, longest_put_off_ticks, rehearsed };
    outputs::write(path, "--output", &image.uf2())?;
    baked.say(args, prepared, PicoImage::FLASH_BYTES, ("Pico", "pulsetrain flash pico"), console)
}

fn uno(args: &BakeArgs, prepared: &Prepared, path: &Path, console: &mut Console<'_>) -> miette::Result<Exit> {
    let image = Image::new(&prepared.program).map_err(|error| problem(prepared, error))?;
    let Image { items, block_bytes: motion_bytes, endless, put_off, ref flash } = image;
    let PutOff { steps: steps_put_off, longest_ticks: longest_put_off_ticks } = put_off;
    let rehearsed =
        if args.no_rehearsal { None } else { Some(rehearse(args, prepared, flash, longest_put_off_ticks, console)?) };
    let (file, flash_bytes) = (path.display().to_string(), flash.len());
    let baked =
        BakedImage { file, items, motion_bytes, flash_bytes, endless, steps_put_off, longest_put_off_ticks, rehearsed };
    outputs::write(path, "--output", image.hex().as_bytes())?;
    baked.say(args, prepared, Image::FLASH_BYTES, ("Uno", "pulsetrain flash uno --port PORT"), console)
}

/// Plays an image on the virtual Uno, before the image is written.
fn rehearse(
    args: &BakeArgs,
    prepared: &Prepared,
    flash: &[u8],
    put_off_ticks: u64,
    console: &Console<'_>,
) -> miette::Result<Rehearsal> {
    let program = &prepared.program;
    let length = args.rehearse.map_or_else(|| Length::of(program), |time| Length::exactly(program, time.seconds()));
    let mut uno = VirtualUno::with_image(flash).map_err(|error| miette!("{}: {error}", prepared.file))?;
    let bar = console.progress(length.seconds, &human::seconds(length.seconds));
    bar.stage("rehearsing");
    let done = rehearsal::rehearse(&mut uno, program, length, |seconds| bar.set(seconds));
    drop(bar);
    let done = done.map_err(|failed| {
        let help = failed.advice();
        miette!(help = help, "{}: {failed}", prepared.file)
    })?;
    Rehearsal::new(&done, put_off_ticks, prepared)
}

impl BakedImage {
    /// Prints the image's size, with the board and the command that writes it to the board.
    fn say(
        &self,
        args: &BakeArgs,
        prepared: &Prepared,
        room: usize,
        (board, flash): (&str, &str),
        console: &mut Console<'_>,
    ) -> miette::Result<Exit> {
        if args.json {
            console.print_json(self)?;
            return Ok(Exit::Success);
        }
        let count = |number: usize| human::count(number as i128);
        console.print(format_args!(
            "{}: {} segments and waits, {} bytes of flash, {} with the firmware, of {}; {}\n\
             `{flash} --image {0}` writes it to the {board}; `{flash}` alone takes it away\n",
            self.file,
            count(self.items),
            count(self.motion_bytes),
            count(self.flash_bytes),
            count(room),
            ends(self.endless),
        ))?;
        let put_off = PutOff { steps: self.steps_put_off, longest_ticks: self.longest_put_off_ticks };
        say_put_off(put_off, prepared, self.endless, console)?;
        if board == "Uno" {
            match &self.rehearsed {
                Some(done) => console.print(format_args!("rehearsed {}\n", done.says))?,
                None => console.print("not rehearsed (--no-rehearsal)\n")?,
            }
        }
        Ok(Exit::Success)
    }
}

/// Checks that the file's name ends as the board's images do. Another ending is another board's image, or a file that
/// somebody wrote.
fn check_ending(path: &Path, ending: &str, what: &str) -> miette::Result<()> {
    if path.extension().is_some_and(|is| is.eq_ignore_ascii_case(ending)) {
        return Ok(());
    }
    let help = format!("name it {}; nothing was written", path.with_extension(ending).display());
    Err(miette!(help = help, "{} does not end in .{ending}: {what}", path.display()))
}

/// Refuses to write over a sketch that somebody wrote. A sketch of this program carries its mark.
fn check_own(path: &Path) -> miette::Result<()> {
    if !path.exists() {
        return Ok(());
    }
    // What is too large to be one is none.
    const MAX_SKETCH_BYTES: u64 = 10_000_000;
    let text = read_named(path, MAX_SKETCH_BYTES).unwrap_or_default();
    if String::from_utf8_lossy(&text).lines().take(2).any(|line| line.contains(sketch::MADE)) {
        return Ok(());
    }
    let help = "name another folder; or move that file away, if it is not needed";
    Err(miette!(help = help, "{} is there, and was not made by `pulsetrain bake`", path.display()))
}

/// Prints which steps are delayed and so are not where their law has them.
fn say_put_off(put_off: PutOff, prepared: &Prepared, endless: bool, console: &mut Console<'_>) -> miette::Result<()> {
    let PutOff { steps, longest_ticks } = put_off;
    if steps == 0 {
        return Ok(());
    }
    let by = human::seconds(longest_ticks as f64 / prepared.program.board.tick_hz as f64);
    let turn = if endless { ", what repeats counted once" } else { "" };
    let (steps, ticks) = (human::count(steps.into()), human::count(longest_ticks.into()));
    console.print(format_args!(
        "put off (shared DIR): {steps} steps by up to {ticks} ticks = {by} from where they are planned{turn}\n"
    ))
}

const fn ends(endless: bool) -> &'static str {
    if endless { "it repeats for ever" } else { "it runs once after power-up" }
}

fn problem(prepared: &Prepared, error: BakeError) -> miette::Report {
    match error {
        BakeError::Plan(refused) => advised(prepared.refuse(refused)),
        error => miette!(help = error.advice(), "{}: {error}", prepared.file),
    }
}

/// The Arduino IDE wants a sketch to have its folder's name.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::console::json;

    /// Two motors in step with one another, with a ring each, at the highest rate that the planner allows.
    fn prepared(hz: f64, folder: &Path) -> Prepared {
        let motor = |step: u8, dir: u8| {
            format!(
                "[motor.m{step}]\nsteps_per_rev = 200\npulse_high = \"1 us\"\npins = {{ step = {step}, dir = {dir} }}\n\
                 forward = \"high\"\n[[motion]]\nmotor = \"m{step}\"\nlaw.sine = {{ amplitude = \"{} step\", period = \"0.5 s\", \
                 cycles = 1 }}\n",
                hz * 0.5 / std::f64::consts::TAU
            )
        };
        std::fs::create_dir_all(folder).unwrap();
        let file = folder.join("pair.toml");
        let text = format!("board = \"uno\"\ntolerance = \"1 us\"\n{}{}", motor(2, 5), motor(3, 6));
        std::fs::write(&file, text.as_bytes()).unwrap();
        let mut prepared = load::endless(&file, None).unwrap();
        prepared.program.board.min_interval_ticks = vec![60; 4];
        prepared
    }

    /// Tests that run firmware on an emulated chip.
    mod chips {
        use super::*;

        #[test]
        fn what_the_board_does_not_keep_up_with_is_refused_and_not_written() {
            let folder = std::env::temp_dir().join(format!("pulsetrain-rehearsal-{}", std::process::id()));
            let path = folder.join("pair.hex");
            let mut args = BakeArgs {
                file: folder.join("pair.toml"),
                sketch: None,
                output: Some(path.clone()),
                board: None,
                length: None,
                yes: false,
                clock_ppm: None,
                rehearse: None,
                no_rehearsal: false,
                json: true,
            };
            let bake = |args: &BakeArgs, prepared: &Prepared| {
                let (mut out, mut err) = (Vec::new(), Vec::new());
                let done = uno(args, prepared, &path, &mut Console::new(&mut out, &mut err, false));
                done.map(|_| String::from_utf8(out).unwrap())
            };
            let fast = prepared(130_000.0, &folder);
            let refused = bake(&args, &fast).unwrap_err();
            let help = refused.help().map(|help| help.to_string()).unwrap_or_default();
            let said = refused.to_string();
            assert!(said.contains("pair.toml: rehearsed on the virtual Uno, ") && said.contains("motor m"), "{said}");
            assert!(said.contains("t = 0."), "{said}");
            assert!(help.contains("m2 at ") && help.contains("k steps/s") && help.contains("--no-rehearsal"), "{help}");
            assert!(!path.exists(), "nothing is written");
            // Without a rehearsal the file is written, and the report has none.
            args.no_rehearsal = true;
            assert!(!bake(&args, &fast).unwrap().contains("rehearsed") && path.exists());
            std::fs::remove_file(&path).unwrap();
            // A rehearsal of a part of the motion says that it is a part.
            (args.no_rehearsal, args.json) = (false, false);
            let slow = prepared(30_000.0, &folder);
            args.rehearse = Some(pulsetrain_motion::Time::from_seconds(0.2));
            let said = bake(&args, &slow).unwrap();
            assert!(said.contains("the first 200 ms of 500 ms, not the rest: every edge within"), "{said}");
            (args.rehearse, args.json) = (None, true);
            let said: serde_json::Value = serde_json::from_str(&bake(&args, &slow).unwrap()).unwrap();
            let rehearsed = &said["rehearsed"];
            assert_eq!(
                (&rehearsed["played_s"], &rehearsed["of_s"]),
                (&0.5.into(), &0.5.into()),
                "{}",
                json(&said).unwrap()
            );
            assert!(rehearsed["max_error_ticks"].as_f64() < rehearsed["bound_ticks"].as_f64() && path.exists());
            std::fs::remove_dir_all(&folder).unwrap();
        }
    }
}
