//! `pulsetrain flash`: writes the committed firmware, or another image, to a board.

use crate::arguments;
use crate::files::{inputs, outputs};
use clap::Args;
use pulsetrain_board::BoardKind;
use pulsetrain_board::profiles::{Flashing, Role};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;
use std::{fs, io};

use miette::{Report, miette};
use pulsetrain_board::stk500::{self, Bootloader, FlashError, Progress};
use pulsetrain_board::{PortError, Serial, hex, image, serial};
use pulsetrain_motion::quantity::nearest;
use schemars::JsonSchema;
use serde::Serialize;

use super::problems::port_problem;
use crate::console::{Console, Exit};
use pulsetrain_motion::human;

#[derive(Args, Debug)]
#[command(after_help = "\
An Uno, or a Nano with the newer bootloader, is programmed through its bootloader at 115200 baud. The older bootloader \
of Nanos (57600 baud) is larger; the firmware fits before it, too.

A Pico shows up as a drive if you hold BOOTSEL while you plug it in. The firmware is copied to that drive. It is found \
without --port; --port names another.

Examples:
  pulsetrain ports                              which port it is
  pulsetrain flash uno --port /dev/ttyACM0
  pulsetrain flash pico
  pulsetrain flash pico --port /media/me/RPI-RP2")]
pub(crate) struct FlashArgs {
    /// Which board
    #[arg(value_parser = arguments::board_kind())]
    pub(crate) board: BoardKind,
    /// The Uno's serial port; the folder where the Pico's drive is [default for a Pico: the one that is found]
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// Write this image instead of the firmware: Intel HEX for an Uno, UF2 for a Pico; for an Uno `winch`: the firmware that knows
    /// StepperWinch's text, or `verbs`: the one that obeys MOVE, SPEED and DIRECTION; both in place of plans
    #[arg(long, value_name = "FILE")]
    pub(crate) image: Option<PathBuf>,
    /// Print what was done as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// The result.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Flashed {
    /// "uno" or "pico".
    #[serde(serialize_with = "by_name")]
    #[schemars(with = "String")]
    board: BoardKind,
    /// The Uno's port, or the folder of the Pico's drive.
    place: String,
    /// Bytes that were written.
    bytes: usize,
    /// The bootloader's rate, bits a second.
    #[serde(skip_serializing_if = "Option::is_none")]
    baud: Option<u32>,
    /// Whether every byte was read back and is right. Never of a Pico: its drive is gone as soon as it has the whole
    /// image.
    verified: bool,
}

pub(crate) fn run(args: &FlashArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let file = args.image.as_deref();
    let board = args.board;
    let flashed = match board.profile().flashing {
        Flashing::Stk500 => {
            let image = flash_image(board, file)?;
            let port = args.port.as_ref().ok_or_else(|| which_port(&serial::names()))?;
            by_bootloader(board, port, &image, console)?
        }
        Flashing::Uf2 { family, drive } => {
            let image = uf2_image(board, family, file)?;
            by_drive(board, drive, args.port.as_deref(), &image, console)?
        }
    };
    if args.json {
        console.print_json(&flashed)?;
        return Ok(Exit::Success);
    }
    let is_own = args.image.as_ref().is_none_or(|file| named(board, file).is_some());
    console.print(format_args!("{}\n", done(&flashed, is_own)))?;
    Ok(Exit::Success)
}

/// The board's name in motion files.
fn by_name<S: serde::Serializer>(board: &BoardKind, to: S) -> Result<S::Ok, S::Error> {
    to.serialize_str(board.name())
}

/// Prints what was written, and the next command. This program's own firmware answers hosts; another image may not.
fn done(Flashed { board, place, bytes, .. }: &Flashed, is_own: bool) -> String {
    let bytes = human::count(*bytes as i128);
    let (name, title) = (board.name(), board.title());
    match (board.profile().flashing, is_own) {
        (Flashing::Stk500, true) => {
            format!(
                "{bytes} bytes are on the {title} at {place}, and were read back; `pulsetrain info --port {place}` asks it"
            )
        }
        (Flashing::Stk500, false) => format!(
            "{bytes} bytes are on the {title} at {place}, and were read back; they begin now. A baked motion answers no host: \
             `pulsetrain flash {name} --port {place}` brings the firmware back"
        ),
        (Flashing::Uf2 { .. }, true) => format!(
            "{bytes} bytes were written to {place}; the {title} took them and has restarted: `pulsetrain ports` shows its port"
        ),
        (Flashing::Uf2 { .. }, false) => format!(
            "{bytes} bytes were written to {place}; the {title} took them and has restarted. `pulsetrain flash {name}` brings the \
             firmware back"
        ),
    }
}

/// A port is not guessed: the only one may be another board's.
fn which_port(names: &[String]) -> Report {
    let help = "`pulsetrain ports` tells what is at each";
    match names {
        [] => miette!("say --port PORT; no serial port was found: is the board plugged in?"),
        names => miette!(help = help, "say --port PORT; there are {}", names.join(", ")),
    }
}

/// The role of the image of that name, where the board has one for each role: the user may give its name instead of a file.
pub(super) fn named(board: BoardKind, name: &Path) -> Option<Role> {
    let mut roles = Role::ALL.into_iter().filter(|_| board.has_image_for_each_role());
    roles.find(|role| Path::new(role.image_name()) == name)
}

/// The help for a name that is neither an image's nor a file's.
fn known_images(board: BoardKind, name: &Path) -> String {
    let names = Role::ALL.map(Role::image_name);
    let near = name.to_str().and_then(|name| nearest(name, names));
    let near = near.map_or_else(String::new, |near| format!("did you mean `{near}`? "));
    let (its, names) = (board.profile().title_with_article, names.map(|name| format!("`{name}`")).join(", "));
    format!("{near}{its}'s image is {names}, or a file in Intel HEX, such as a .hex file that `pulsetrain bake` wrote")
}

/// Writes one of the firmware's images to the board at a port, of the kind that has one for each role. Prints only to standard error, since the
/// results are those of another command.
pub(super) fn write(port: &str, image: Option<&str>, console: &mut Console<'_>) -> miette::Result<()> {
    let board = BoardKind::ALL.into_iter().find(|kind| kind.has_image_for_each_role()).unwrap_or_default();
    let flashed = by_bootloader(board, port, &flash_image(board, image.map(Path::new))?, console)?;
    // If standard error is closed nobody reads it.
    drop(writeln!(console.err, "{}", done(&flashed, true)));
    Ok(())
}

/// The flash's contents: the image of that name, or what is in that file (Intel HEX). Without a name it is the firmware.
fn flash_image(board: BoardKind, file: Option<&Path>) -> miette::Result<Vec<u8>> {
    let Some(file) = file else { return Ok(board.image(Role::Plans)) };
    if let Some(role) = named(board, file) {
        return Ok(board.image(role));
    }
    let bytes = inputs::bytes(file, inputs::MAX_IMAGE_BYTES)
        .map_err(|error| miette!(help = known_images(board, file), "{error}"))?;
    hex::parse(&String::from_utf8_lossy(&bytes), stk500::FLASH_BYTES)
        .map_err(|error| miette!(help = known_images(board, file), "{}: {error}", file.display()))
}

/// The UF2 file of that name. Without a name it is the firmware.
fn uf2_image(board: BoardKind, family: u32, file: Option<&Path>) -> miette::Result<Vec<u8>> {
    let Some(file) = file else { return Ok(board.image(Role::Plans)) };
    let bytes = inputs::bytes(file, inputs::MAX_IMAGE_BYTES)?;
    let help = format!("{}'s image is a UF2 file for the {}", board.profile().title_with_article, board.profile().chip);
    image::uf2(&bytes, family).map_err(|error| miette!(help = help, "{}: {error}", file.display()))?;
    Ok(bytes)
}

fn by_bootloader(board: BoardKind, name: &str, image: &[u8], console: &Console<'_>) -> miette::Result<Flashed> {
    for rate in stk500::RATES {
        let bar = console.progress(2.0 * image.len() as f64, &format!("{} KB", image.len().div_ceil(1000)));
        bar.stage("asking");
        let port = Serial::open_at(name, true, rate).map_err(port_problem)?;
        let done = Bootloader::find(port, rate).and_then(|found| {
            found.program(image, |progress| match progress {
                Progress::Written(bytes) => {
                    bar.stage("writing");
                    bar.set(bytes as f64);
                }
                Progress::Verified(bytes) => {
                    bar.stage("reading back");
                    bar.set((image.len() + bytes) as f64);
                }
            })
        });
        match done {
            Ok(_) => {
                let place = name.to_owned();
                return Ok(Flashed { board, place, bytes: image.len(), baud: Some(rate), verified: true });
            }
            Err(FlashError::NoBootloader { .. }) => {}
            Err(error) => return Err(problem(board, name, error)),
        }
    }
    let [new, old] = stk500::RATES;
    let help = "is it an Uno (`pulsetrain ports`)? If it has no reset by DTR, press its button as you start this. Boards without \
                a bootloader, or with one of another kind, take crates/board/images/uno.hex (or uno-winch.hex, uno-verbs.hex) \
                by a programmer";
    Err(miette!(help = help, "no {}'s bootloader answers at {name}, neither at {new} nor at {old} baud", board.title()))
}

/// The error, with advice.
fn problem(board: BoardKind, name: &str, error: FlashError) -> Report {
    let help = match &error {
        FlashError::Port(PortError::Gone { .. }) => {
            "look at the cable. If it was pulled out while bytes were written the board has no whole program now: start this again"
        }
        FlashError::Port(port) => return port_problem(port.clone()),
        FlashError::Empty => "nothing was written: is it the right file?",
        FlashError::NotBegun => "nothing was written: look at cable and supply, then start this again",
        FlashError::NoBootloader { .. } => "press the board's reset button as you start this",
        FlashError::OtherChip { .. } => board.profile().other_chip_help,
        FlashError::TooLarge { rate, .. } if *rate != stk500::RATES[0] => {
            "nothing was written; burn Optiboot over the old bootloader, which leaves 1.5 KB more (Arduino IDE: board Arduino \
             Uno, Tools, Burn Bootloader; it takes a programmer or a second Uno)"
        }
        FlashError::TooLarge { bytes, .. } if *bytes <= stk500::FLASH_BYTES => {
            "nothing was written; if the file holds a bootloader too, as the Arduino IDE's …with_bootloader.hex, take the one without"
        }
        FlashError::TooLarge { .. } => "nothing was written; the image is for a larger chip",
        FlashError::LostSync { .. } => {
            "the board has no whole program now; look at cable and supply, then start this again"
        }
        FlashError::Mismatch { .. } => {
            "the board has no whole program now: start this again; if it is the same address each time its flash is worn out"
        }
    };
    miette!(help = help, "{name}: {error}")
}

/// The file by which a folder is a chip's drive. It also names the chip.
const INFO: &str = "INFO_UF2.TXT";
/// The name of the file that is written. The chip ignores it.
const COPY: &str = "pulsetrain.uf2";
/// Bytes that are written at a time, so that the progress bar moves.
const PIECE: usize = 16 * 1024;

fn by_drive(
    board: BoardKind,
    drive: &str,
    folder: Option<&str>,
    bytes: &[u8],
    console: &Console<'_>,
) -> miette::Result<Flashed> {
    let folder = match folder {
        Some(folder) => PathBuf::from(folder),
        None => the_only(board, drive, drives(board))?,
    };
    check(&folder, board, drive)?;
    let path = folder.join(COPY);
    let bar = console.progress(bytes.len() as f64, &format!("{} KB", bytes.len().div_ceil(1000)));
    bar.stage("writing");
    copy(&path, bytes, |done| bar.set(done as f64)).or_else(|(written, error)| {
        // The chip restarts as soon as it has the last block, so the drive may disappear while the file is still open.
        if written == bytes.len() && disappears(&folder, STARTS_WITHIN) {
            Ok(())
        } else {
            Err(not_written(&path, &error))
        }
    })?;
    bar.stage("waiting for it to begin");
    if !disappears(&folder, STARTS_WITHIN) {
        let help = "hold BOOTSEL as you plug it in again, and start this again; some systems want the drive to be ejected first";
        return Err(miette!(
            help = help,
            "{} is still there {} s after the image was written: the {} did not take it",
            folder.display(),
            STARTS_WITHIN.as_secs(),
            board.title()
        ));
    }
    Ok(Flashed { board, place: folder.display().to_string(), bytes: bytes.len(), baud: None, verified: false })
}

/// How long a Pico may take to start its new image.
const STARTS_WITHIN: Duration = Duration::from_secs(5);

/// Whether a Pico's drive disappears within a time. Reading the file back shows nothing, since the computer has a copy
/// in memory. Nor does a folder that the user mounted by hand, so the drive's device is checked, too.
fn disappears(folder: &Path, within: Duration) -> bool {
    let device = device_of(folder, &inputs::of_system(Path::new("/proc/mounts")));
    serial::happens(within, || !folder.join(INFO).exists() || device.as_ref().is_some_and(|device| !device.exists()))
}

/// Writes a file. An error comes with the number of bytes that were written before it.
fn copy(path: &Path, bytes: &[u8], progress: impl Fn(usize)) -> Result<(), (usize, io::Error)> {
    let mut file = outputs::create_in_place(path).map_err(|error| (0, error))?;
    let mut done = 0;
    for piece in bytes.chunks(PIECE) {
        file.write_all(piece).map_err(|error| (done, error))?;
        done += piece.len();
        progress(done);
    }
    file.sync_all().map_err(|error| (done, error))
}

fn not_written(path: &Path, error: &io::Error) -> Report {
    let help = match error.kind() {
        io::ErrorKind::StorageFull => "the disk is full; a Pico's drive has room: is this one?",
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "you may not write there; drives that the desktop mounts are yours, others are with `mount -o uid=$USER`"
        }
        _ => "hold BOOTSEL as you plug the Pico in again, and start this again",
    };
    miette!(help = help, "cannot write {}: {error}", path.display())
}

/// Checks that a folder is a board's drive, by what that calls itself.
fn check(folder: &Path, board: BoardKind, drive: &str) -> miette::Result<()> {
    let (title, its) = (board.title(), board.profile().title_with_article);
    let hold = format!("hold BOOTSEL as you plug the {title} in: its drive is called {drive}");
    if !folder.is_dir() {
        return Err(miette!(help = hold, "{} is no folder: {its} is written to as a drive", folder.display()));
    }
    const MAX_INFO_BYTES: u64 = 10_000;
    let Ok(info) = inputs::text(&folder.join(INFO), MAX_INFO_BYTES) else {
        return Err(miette!(help = hold, "{} is no {title}'s drive: there is no {INFO} in it", folder.display()));
    };
    let id = info.lines().find_map(|line| line.trim().strip_prefix("Board-ID:")).map_or("", str::trim);
    if id == drive {
        return Ok(());
    }
    let help = board.profile().other_chip_help;
    Err(miette!(help = help, "{} is the drive of another board: it calls itself {id:?}", folder.display()))
}

fn the_only(board: BoardKind, drive: &str, mut drives: Vec<PathBuf>) -> miette::Result<PathBuf> {
    let title = board.title();
    match drives.len() {
        1 => Ok(drives.remove(0)),
        0 => {
            let help = format!(
                "hold BOOTSEL as you plug it in, and wait for its drive, {drive}; where nothing mounts drives by itself mount it, and name \
                 the folder with --port"
            );
            Err(miette!(help = help, "no {title} waits for an image"))
        }
        _ => {
            let names: Vec<String> = drives.iter().map(|drive| drive.display().to_string()).collect();
            let help = "name one with --port";
            Err(miette!(help = help, "{} {title}s wait for an image: {}", names.len(), names.join(", ")))
        }
    }
}

/// The drives of such boards that are mounted.
pub(crate) fn drives(board: BoardKind) -> Vec<PathBuf> {
    let Flashing::Uf2 { drive, .. } = board.profile().flashing else { return Vec::new() };
    let folders: Vec<PathBuf> = if cfg!(windows) {
        ('D'..='Z').map(|letter| PathBuf::from(format!("{letter}:\\"))).collect()
    } else if cfg!(target_os = "macos") {
        fs::read_dir("/Volumes").map_or_else(|_| Vec::new(), |all| all.flatten().map(|entry| entry.path()).collect())
    } else {
        mounted(&inputs::of_system(Path::new("/proc/mounts")))
    };
    folders.into_iter().filter(|folder| check(folder, board, drive).is_ok()).collect()
}

/// Folders in which systems mount removable drives.
fn mounted(table: &str) -> Vec<PathBuf> {
    let is_drive = |kind: &str| matches!(kind, "vfat" | "msdos" | "fuseblk");
    mounts(table).filter(|(_, _, kind)| is_drive(kind)).map(|(_, folder, _)| folder).collect()
}

/// The device that is mounted at a folder.
fn device_of(folder: &Path, table: &str) -> Option<PathBuf> {
    let folder = fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    let (device, ..) = mounts(table).find(|(_, at, _)| *at == folder)?;
    device.starts_with("/dev").then_some(device)
}

/// Device, folder and file system of each mount in /proc/mounts (fstab(5): blanks are written as \040).
fn mounts(table: &str) -> impl Iterator<Item = (PathBuf, PathBuf, &str)> {
    let path = |field: &str| PathBuf::from(field.replace("\\040", " "));
    table.lines().filter_map(move |line| {
        let mut fields = line.split(' ');
        Some((path(fields.next()?), path(fields.next()?), fields.next()?))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulsetrain_board::profiles;

    const UNO: BoardKind = BoardKind::of(&profiles::UNO);
    const PICO: BoardKind = BoardKind::of(&profiles::PICO);

    #[test]
    fn drives_are_found_among_what_is_mounted() {
        let table = "/dev/sda1 / ext4 rw 0 0\n\
                     /dev/sdb1 /media/me/RPI-RP2 vfat rw,nosuid 0 0\n\
                     /dev/sdc1 /media/me/MY\\040STICK vfat rw 0 0\n\
                     proc /proc proc rw 0 0\n";
        assert_eq!(mounted(table), [PathBuf::from("/media/me/RPI-RP2"), PathBuf::from("/media/me/MY STICK")]);
    }

    #[test]
    fn the_device_of_a_drive_is_known() {
        let table = "/dev/sdb1 /media/me/MY\\040PICO vfat rw 0 0\ntmpfs /run/pico tmpfs rw 0 0\n";
        assert_eq!(device_of(Path::new("/media/me/MY PICO"), table), Some(PathBuf::from("/dev/sdb1")));
        assert_eq!(device_of(Path::new("/run/pico"), table), None, "it has no device");
        assert_eq!(device_of(Path::new("/media/me"), table), None);
    }

    #[test]
    fn a_cable_pulled_out_leaves_no_whole_program() {
        let name = "/dev/ttyACM0".to_owned();
        let report = problem(UNO, &name, FlashError::Port(PortError::Gone { name: name.clone(), why: "x".into() }));
        let help = report.help().map(|help| help.to_string()).unwrap_or_default();
        assert!(help.contains("no whole program") && !help.contains("motors"), "{help}");
    }

    #[test]
    fn too_large_an_image_is_told_what_it_may_be() {
        let help = |bytes| {
            let rate = stk500::RATES[0];
            let error = FlashError::TooLarge { bytes, limit: stk500::room(rate), rate };
            problem(UNO, "/dev/ttyACM0", error).help().map(|help| help.to_string()).unwrap_or_default()
        };
        assert!(help(32_768).contains("holds a bootloader too"), "{}", help(32_768));
        assert!(help(32_769).contains("larger chip"), "{}", help(32_769));
    }

    #[test]
    fn who_names_no_port_is_told_which_there_are() {
        assert!(which_port(&[]).to_string().contains("is the board plugged in?"));
        let names = ["COM3", "COM7"].map(str::to_owned);
        assert_eq!(which_port(&names).to_string(), "say --port PORT; there are COM3, COM7");
    }

    #[test]
    fn what_may_not_answer_is_not_said_to_be_asked() {
        let said = |board, is_own| {
            let flashed = Flashed { board, place: "here".into(), bytes: 1234, baud: None, verified: board == UNO };
            done(&flashed, is_own)
        };
        for (board, asks) in [(UNO, "pulsetrain info --port here"), (PICO, "pulsetrain ports")] {
            let (own, other) = (said(board, true), said(board, false));
            assert!(own.contains("1234 bytes") && own.contains(asks), "{own}");
            assert!(!other.contains(asks) && other.contains(&format!("pulsetrain flash {}", board.name())), "{other}");
        }
    }

    #[test]
    fn one_drive_is_taken_none_and_several_are_told() {
        let two = vec![PathBuf::from("/a"), PathBuf::from("/b")];
        let the_only = |drives| the_only(PICO, "RPI-RP2", drives);
        assert_eq!(the_only(two[..1].to_vec()).unwrap(), two[0]);
        assert_eq!(the_only(two).unwrap_err().to_string(), "2 Picos wait for an image: /a, /b");
        assert_eq!(the_only(Vec::new()).unwrap_err().to_string(), "no Pico waits for an image");
    }
}
