//! Files that a command writes. None is an input of the command, nor another of its outputs; and nothing that was there before is lost:
//!
//! - a finished file is written beside its place, as NAME.part, and takes it when it is whole;
//! - a log is created, never overwritten: what was there before becomes NAME.1, or the next number that is free;
//! - devices are written to as they are.
//!
//! Each has its option, since an error says where the file may go instead.

use std::fmt;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use miette::Diagnostic;

use super::{Identity, KNOWN, folder_of};
use crate::access::{Access, elsewhere};

/// Where a file goes, and what on the command line says so.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Destination {
    path: PathBuf,
    option: &'static str,
}

impl Destination {
    /// A file at `path`, which `option` chooses.
    #[must_use]
    pub fn new(path: &Path, option: &'static str) -> Destination {
        Destination { path: path.to_owned(), option }
    }
}

/// An output would destroy a file that the command needs.
#[derive(Debug)]
pub struct Clash {
    to: Destination,
    /// What the file is besides.
    is: String,
}

impl fmt::Display for Clash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "cannot write {}: {}", self.to.path.display(), self.is)
    }
}

impl std::error::Error for Clash {}

impl Diagnostic for Clash {
    fn help<'a>(&'a self) -> Option<Box<dyn fmt::Display + 'a>> {
        Some(Box::new(format!("{}; nothing was overwritten", elsewhere(self.to.option))))
    }
}

/// Why a file is not written.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum OutputError {
    /// The command needs what is there.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Clash(#[from] Clash),
    /// The system's own.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Access(#[from] Access),
}

/// Notes that a command writes to a place, before it does anything that takes time or moves motors.
///
/// # Errors
/// If an input of the command is there, or another output goes there.
pub fn claim(to: &Destination) -> Result<(), OutputError> {
    if is_device(&to.path) {
        return Ok(());
    }
    let identity = Identity::of(&to.path);
    KNOWN.with_borrow_mut(|known| {
        let input = known.inputs.iter().find(|(_, input)| input.is_same(&identity));
        if let Some((path, _)) = input {
            let is = format!("the command reads it, as {}", path.display());
            return Err(Clash { to: to.clone(), is }.into());
        }
        if streams().any(|stream| stream.is_same(&identity)) {
            let is = "the command's own output goes there".to_owned();
            return Err(Clash { to: to.clone(), is }.into());
        }
        let output = known.outputs.iter().find(|(other, output)| other != to && output.is_same(&identity));
        if let Some((other, _)) = output {
            let is = format!("another file of the command goes there, as {} ({})", other.path.display(), other.option);
            return Err(Clash { to: to.clone(), is }.into());
        }
        if !known.outputs.iter().any(|(other, _)| other == to) {
            known.outputs.push((to.clone(), identity));
        }
        Ok(())
    })
}

/// Notes several files of a folder, as [`claim`] does.
///
/// # Errors
/// As [`claim`].
pub fn claim_all(folder: &Path, names: &[&str], option: &'static str) -> Result<(), OutputError> {
    names.iter().try_for_each(|name| claim(&Destination::new(&folder.join(name), option)))
}

/// The files to which the process's streams go, if they are files.
fn streams() -> impl Iterator<Item = Identity> {
    #[cfg(unix)]
    {
        use std::os::fd::AsFd;
        let streams = [io::stdout().as_fd().try_clone_to_owned(), io::stderr().as_fd().try_clone_to_owned()];
        let about = streams.into_iter().flatten().filter_map(|stream| File::from(stream).metadata().ok());
        about
            .filter(fs::Metadata::is_file)
            .map(|about| Identity { path: PathBuf::new(), number: super::number(&about) })
    }
    #[cfg(not(unix))]
    std::iter::empty()
}

/// Writes a finished file, and makes the folders above it.
///
/// # Errors
/// When it cannot be written. Then what was there before is still there.
pub fn write(path: &Path, option: &'static str, contents: &[u8]) -> Result<(), OutputError> {
    let to = Destination::new(path, option);
    claim(&to)?;
    let written = finished(path).and_then(|mut file| file.write_all(contents).and_then(|()| file.flush()));
    written.map_err(|error| unwritten(&to, error).into())
}

/// A finished file that is written bit by bit. It takes its place when it is flushed.
///
/// # Errors
/// When it cannot be made.
pub fn create(path: &Path, option: &'static str) -> Result<Finished, OutputError> {
    let to = Destination::new(path, option);
    claim(&to)?;
    finished(path).map_err(|error| unwritten(&to, error).into())
}

/// As [`create`], with the system's error.
pub(crate) fn create_in(folder: &Path, name: &str, option: &'static str) -> io::Result<Finished> {
    let path = folder.join(name);
    claim(&Destination::new(&path, option))
        .map_err(|error| io::Error::new(io::ErrorKind::AlreadyExists, error.to_string()))?;
    finished(&path)
}

/// A file that is new, and that nothing may be in the place of.
///
/// # Errors
/// When it cannot be written, or is there already.
pub fn write_new(path: &Path, option: &'static str, contents: &[u8]) -> Result<(), OutputError> {
    let to = Destination::new(path, option);
    claim(&to)?;
    let written = create_new(path).and_then(|mut file| file.write_all(contents));
    written.map_err(|error| unwritten(&to, error).into())
}

/// A log: it has what is written as soon as that is flushed, and what was there before becomes NAME.1, or the next number that is free.
///
/// # Errors
/// When it cannot be made.
pub fn create_log(path: &Path, option: &'static str) -> Result<BufWriter<File>, OutputError> {
    let to = Destination::new(path, option);
    claim(&to)?;
    log(path).map(BufWriter::new).map_err(|error| unwritten(&to, error).into())
}

/// The error for a file that could not be written to its end.
#[must_use]
pub fn unwritten(to: &Destination, error: io::Error) -> Access {
    Access::write(&to.path, to.option, error)
}

/// A file of a device that wants it written in place, such as the drive of a Pico.
///
/// # Errors
/// The system's own.
#[expect(clippy::disallowed_methods, reason = "the one place that opens outputs")]
pub(crate) fn create_in_place(path: &Path) -> io::Result<File> {
    File::create(path)
}

/// Writes a file of this program's own whole, or not at all: the power may fail. `path` is no user's.
///
/// # Errors
/// The system's own.
#[expect(clippy::disallowed_methods, reason = "the one place that opens outputs")]
pub(crate) fn replace_own(path: &Path, text: &str) -> io::Result<()> {
    path.parent().map_or(Ok(()), fs::create_dir_all)?;
    let aside = path.with_extension("new");
    fs::write(&aside, text)?;
    fs::rename(&aside, path)
}

/// Gives a name of this program's own to what was made beside it.
///
/// # Errors
/// The system's own.
#[expect(clippy::disallowed_methods, reason = "the one place that opens outputs")]
pub(crate) fn rename_own(from: &Path, to: &Path) -> io::Result<()> {
    fs::rename(from, to)
}

/// A place beside a finished file, for a program that writes it by itself. [`take_place`] gives it its name.
pub(crate) fn part_path(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!(".{}.part.{name}", std::process::id()))
}

/// Lets a whole file take its place.
///
/// # Errors
/// The system's own. Then what was there before is still there.
#[expect(clippy::disallowed_methods, reason = "the one place that opens outputs")]
pub(crate) fn take_place(part: &Path, path: &Path) -> io::Result<()> {
    check_replaceable(path)?;
    fs::rename(part, path).inspect_err(|_| drop(fs::remove_file(part)))
}

/// A file on its way to its place.
#[derive(Debug)]
pub struct Finished {
    file: BufWriter<File>,
    /// Where it is and where it belongs, until it is there.
    way: Option<(PathBuf, PathBuf)>,
}

impl Write for Finished {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    /// The file is whole: it takes its place.
    #[expect(clippy::disallowed_methods, reason = "the one place that opens outputs")]
    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()?;
        let Some((part, path)) = self.way.take() else { return Ok(()) };
        fs::rename(&part, path).inspect_err(|_| drop(fs::remove_file(&part)))
    }
}

impl Drop for Finished {
    fn drop(&mut self) {
        if let Some((part, _)) = self.way.take() {
            // It is not whole. What was there before stays.
            drop(fs::remove_file(part));
        }
    }
}

fn finished(path: &Path) -> io::Result<Finished> {
    if is_device(path) {
        return Ok(Finished { file: BufWriter::new(device(path)?), way: None });
    }
    make_folder_of(path)?;
    // The file that a link leads to is replaced, not the link.
    let path = super::followed(path);
    check_replaceable(&path)?;
    let (part, file) = free(|number| match number {
        1 => with_ending(&path, ".part"),
        number => with_ending(&path, &format!(".part{number}")),
    })?;
    if let Ok(about) = fs::metadata(&path) {
        // Who may read it stays as it was. A system that cannot say so loses nothing.
        drop(fs::set_permissions(&part, about.permissions()));
    }
    Ok(Finished { file: BufWriter::new(file), way: Some((part, path)) })
}

/// Checks that a file may be replaced: renaming does not ask.
fn check_replaceable(path: &Path) -> io::Result<()> {
    match fs::metadata(path) {
        Ok(about) if about.is_dir() => Err(io::ErrorKind::IsADirectory.into()),
        Ok(about) if about.permissions().readonly() => Err(io::ErrorKind::PermissionDenied.into()),
        Ok(_) => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(error) => Err(error),
    }
}

fn log(path: &Path) -> io::Result<File> {
    if is_device(path) {
        return device(path);
    }
    make_folder_of(path)?;
    // A link stays, and the file that it leads to gets the number.
    let path = super::followed(path);
    loop {
        match create_new(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => put_away(&path)?,
            done => return done,
        }
    }
}

/// Gives a file the first name of NAME.1, NAME.2, … that is free.
#[expect(clippy::disallowed_methods, reason = "the one place that opens outputs")]
fn put_away(path: &Path) -> io::Result<()> {
    // The name is taken before it is used: two programs never take the same one.
    let (taken, _) = free(|number| with_ending(path, &format!(".{number}")))?;
    fs::rename(path, &taken).inspect_err(|_| drop(fs::remove_file(&taken)))
}

/// A file's path with more behind its name. A name that would become too long for a file system is cut.
fn with_ending(path: &Path, ending: &str) -> PathBuf {
    /// Most systems have 255 bytes.
    const MAX_NAME_BYTES: usize = 255;
    let name = path.file_name().unwrap_or_default();
    let most = MAX_NAME_BYTES - ending.len();
    let mut name = if name.len() > most {
        let text = name.to_string_lossy();
        text[..text.floor_char_boundary(most)].into()
    } else {
        name.to_owned()
    };
    name.push(ending);
    path.with_file_name(name)
}

/// How many names are tried.
const MAX_NUMBERS: u32 = 100_000;

/// Creates the first file of a row of names that is not there.
fn free(name: impl Fn(u32) -> PathBuf) -> io::Result<(PathBuf, File)> {
    for number in 1..=MAX_NUMBERS {
        let path = name(number);
        match create_new(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            done => return done.map(|file| (path, file)),
        }
    }
    Err(io::ErrorKind::AlreadyExists.into())
}

#[expect(clippy::disallowed_methods, reason = "the one place that opens outputs")]
fn create_new(path: &Path) -> io::Result<File> {
    let file = OpenOptions::new().append(true).create_new(true).open(path);
    // Where a folder is, systems say that it is there already.
    file.map_err(|error| if path.is_dir() { io::ErrorKind::IsADirectory.into() } else { error })
}

/// Whether it is written to as it is: a device, a pipe, or a stream of the process.
fn is_device(path: &Path) -> bool {
    let is_of_process = || path.starts_with("/proc") && path.components().any(|part| part.as_os_str() == "fd");
    let is_stream =
        ["/dev/stdout", "/dev/stderr", "/dev/fd"].iter().any(|stream| path.starts_with(stream)) || is_of_process();
    fs::metadata(path).is_ok_and(|about| !about.is_dir() && (is_stream || !about.is_file()))
}

/// Opens a device, or a pipe that somebody reads: another would never open.
#[expect(clippy::disallowed_methods, reason = "the one place that opens outputs")]
fn device(path: &Path) -> io::Result<File> {
    #[cfg(unix)]
    {
        use rustix::fs::{Mode, OFlags};
        use std::os::unix::fs::FileTypeExt;
        let kind = fs::metadata(path)?.file_type();
        if kind.is_block_device() {
            return Err(io::Error::other("this is a disk: all that is on it would be lost"));
        }
        if kind.is_fifo() {
            let reader = rustix::fs::open(path, OFlags::WRONLY | OFlags::NONBLOCK | OFlags::CLOEXEC, Mode::empty());
            // It is held until the pipe is open for writing: its reader does not see an end in between.
            let _held = reader.map_err(|error| match error {
                rustix::io::Errno::NXIO => io::Error::other("nobody reads this pipe"),
                error => error.into(),
            })?;
            return OpenOptions::new().write(true).open(path);
        }
    }
    OpenOptions::new().append(true).open(path)
}

/// Makes the folders above a file.
fn make_folder_of(path: &Path) -> io::Result<()> {
    fs::create_dir_all(folder_of(path)).map_err(|error| match error.kind() {
        // Something is there that is no folder.
        io::ErrorKind::AlreadyExists => io::ErrorKind::NotADirectory.into(),
        _ => error,
    })
}
