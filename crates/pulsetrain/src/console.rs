//! Where a command prints, and how it ends.

use pulsetrain_motion::human;
use std::fmt::Display;
use std::io::{self, BufRead, IsTerminal, Write};
use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};
use miette::Diagnostic;
use pulsetrain_session::control::Event;

/// How a command ended: the process's exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// All is well: code 0.
    Success = 0,
    /// The motion ran, or a capture was read, and a bound broke: code 1.
    BoundBroken = 1,
    /// Wrong usage, wrong input, a motion that is refused, or a file that cannot be written: code 2.
    Refused = 2,
    /// The motors were stopped before the motion's end: code 3.
    Stopped = 3,
}

impl From<Exit> for std::process::ExitCode {
    fn from(exit: Exit) -> Self {
        std::process::ExitCode::from(exit as u8)
    }
}

/// A file, or the output, cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[error("cannot {action} {what}: {}", in_words(.error))]
pub struct Access {
    action: &'static str,
    what: String,
    // Its text is in the message, so it is no source: else it would be printed twice.
    error: io::Error,
}

impl Diagnostic for Access {
    fn help<'a>(&'a self) -> Option<Box<dyn Display + 'a>> {
        let advice = match (self.action, self.error.kind()) {
            ("read", io::ErrorKind::NotFound) => "look at the path; it counts from the folder in which you are",
            ("read", _) => return None,
            (_, io::ErrorKind::PermissionDenied) => "take another place with --out, or change its permissions",
            (_, io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded) => {
                "make room, or take another disk with --out"
            }
            (_, io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::NotADirectory | io::ErrorKind::IsADirectory) => {
                "take another place with --out"
            }
            (_, io::ErrorKind::AlreadyExists) => "take another name, or delete it first",
            _ => return None,
        };
        Some(Box::new(advice))
    }
}

/// A system's error in words, without its number.
pub(crate) fn in_words(error: &io::Error) -> String {
    match error.kind() {
        io::ErrorKind::NotFound => "there is no such file or folder".to_owned(),
        io::ErrorKind::PermissionDenied => "you may not".to_owned(),
        io::ErrorKind::StorageFull => "the disk is full".to_owned(),
        io::ErrorKind::QuotaExceeded => "your share of the disk is full".to_owned(),
        io::ErrorKind::ReadOnlyFilesystem => "the disk is read-only".to_owned(),
        io::ErrorKind::AlreadyExists => "it exists already".to_owned(),
        io::ErrorKind::IsADirectory => "it is a folder".to_owned(),
        io::ErrorKind::NotADirectory => "a part of its path is a file, not a folder".to_owned(),
        _ => {
            let text = error.to_string();
            text.split(" (os error").next().unwrap_or_default().to_owned()
        }
    }
}

/// Where a command prints.
pub struct Console<'a> {
    /// Results.
    pub out: &'a mut dyn Write,
    /// Errors.
    pub err: &'a mut dyn Write,
    /// Whether `err` is a terminal: colours and progress bars are for people.
    pub err_is_terminal: bool,
}

impl Console<'_> {
    /// Prints a result. A reader that has gone away (`| head`) is no error: the command does its work all the same,
    /// and its exit code stays right.
    ///
    /// # Errors
    /// When the output cannot be written for another reason.
    pub fn print(&mut self, text: impl Display) -> miette::Result<()> {
        match write!(self.out, "{text}").and_then(|()| self.out.flush()) {
            Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
            Err(error) => Err(Access { action: "write to", what: "the output".into(), error }.into()),
            Ok(()) => Ok(()),
        }
    }

    /// Prints a value as JSON. Its type is one of [`schema::all`](crate::schema::all).
    ///
    /// # Errors
    /// As [`Console::print`].
    pub fn print_json<T: serde::Serialize + schemars::JsonSchema>(&mut self, value: &T) -> miette::Result<()> {
        self.print(format_args!("{}\n", json(value)?))
    }

    /// Prints a remark that is not part of the result. If it cannot be printed, the command goes on.
    pub fn tell(&mut self, text: impl Display) {
        let _ = write!(self.err, "{text}").and_then(|()| self.err.flush());
    }

    /// Prints an error that comes after a result in JSON, which is the one value that a script reads: on standard error alone.
    ///
    /// # Errors
    /// None: the exit code says that something is wrong.
    pub fn complain(&mut self, error: &miette::Report) -> miette::Result<Exit> {
        let help = error.help().map_or_else(String::new, |help| format!("\n  help: {help}"));
        self.tell(format_args!("{error}{help}\n"));
        Ok(Exit::Refused)
    }

    /// Prints a remark and asks whether to go on. `None` if standard error or standard input is no terminal.
    pub fn confirm(&mut self, text: &str) -> Option<bool> {
        let is_terminal = self.err_is_terminal && io::stdin().is_terminal();
        ask(&mut io::stdin().lock(), self.err, is_terminal, text)
    }

    /// A progress bar of `length`, counted in `unit`. It is hidden if standard error is no terminal.
    #[must_use]
    pub fn progress(&self, length: f64, unit: &str) -> Progress {
        if !self.err_is_terminal {
            return Progress { bar: ProgressBar::hidden(), length };
        }
        let bar = ProgressBar::new(PROGRESS_PARTS);
        let template = format!("{{msg:12}} [{{wide_bar:.cyan/blue}}] {{percent:>3}} % of {} {{eta:>4}}", unit);
        if let Ok(style) = ProgressStyle::with_template(&template) {
            bar.set_style(style.progress_chars("━━╌"));
        }
        Progress { bar, length }
    }

    /// A progress bar for the run of a motion that ends then, s; the time that has passed if the motion has no end.
    #[must_use]
    pub fn run_progress(&self, end_s: Option<f64>) -> Progress {
        if let Some(end_s) = end_s {
            return self.progress(end_s, &human::seconds_to(end_s, 6));
        }
        if !self.err_is_terminal {
            return Progress { bar: ProgressBar::hidden(), length: f64::INFINITY };
        }
        let bar = ProgressBar::new_spinner();
        if let Ok(style) = ProgressStyle::with_template("{msg:12} {elapsed_precise}, Ctrl-C ends it") {
            bar.set_style(style);
        }
        Progress { bar, length: f64::INFINITY }
    }
}

/// Asks at a terminal whether to go on: "y" and "yes" mean yes, everything else no. `None` if there is no terminal.
fn ask(input: &mut dyn BufRead, output: &mut dyn Write, is_terminal: bool, text: &str) -> Option<bool> {
    if !is_terminal {
        return None;
    }
    write!(output, "{text}\nGo on? [y/N] ").and_then(|()| output.flush()).ok()?;
    let mut answer = String::new();
    input.read_line(&mut answer).ok()?;
    Some(matches!(answer.trim().to_lowercase().as_str(), "y" | "yes"))
}

const PROGRESS_PARTS: u64 = 10_000;

/// A progress bar. It disappears when this is dropped.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    length: f64,
}

impl Progress {
    /// Names the present work in one or two words.
    pub fn stage(&self, name: &'static str) {
        crate::interrupt::stage(name);
        self.bar.set_message(name);
    }

    /// Sets how much of the length is done.
    pub fn set(&self, done: f64) {
        if self.length.is_infinite() {
            self.bar.tick();
            return;
        }
        self.bar.set_position((done / self.length * PROGRESS_PARTS as f64) as u64);
    }

    /// Sets how much is done by an event of a run.
    pub fn follow(&self, event: &Event) {
        if let Event::Progress { at_s } = event {
            self.set(*at_s);
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        crate::interrupt::stage("");
        self.bar.finish_and_clear();
    }
}

/// A value as indented JSON.
///
/// # Errors
/// When the value has no JSON form.
pub fn json(value: &impl serde::Serialize) -> miette::Result<String> {
    pulsetrain_report::json(value).map_err(|error| miette::miette!("cannot write JSON: {error}"))
}

/// Reads a file.
///
/// # Errors
/// When it cannot be read.
pub fn read(path: &Path) -> Result<Vec<u8>, Access> {
    std::fs::read(path).map_err(|error| access("read", path, error))
}

/// Writes a file, making the directories above it.
///
/// # Errors
/// When it cannot be written.
pub fn write(path: &Path, contents: &[u8]) -> Result<(), Access> {
    make_folder_of(path).and_then(|()| std::fs::write(path, contents)).map_err(|error| access("write", path, error))
}

/// Makes the folders above a file.
fn make_folder_of(path: &Path) -> io::Result<()> {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    parent.map_or(Ok(()), std::fs::create_dir_all).map_err(|error| match error.kind() {
        // Something is there that is no folder.
        io::ErrorKind::AlreadyExists => io::ErrorKind::NotADirectory.into(),
        _ => error,
    })
}

/// Opens a file for writing, making the directories above it.
///
/// # Errors
/// When it cannot be made.
pub fn create(path: &Path) -> Result<io::BufWriter<std::fs::File>, Access> {
    open(path).map_err(|error| access("write", path, error))
}

/// As [`create`], with the system's error.
pub(crate) fn open(path: &Path) -> io::Result<io::BufWriter<std::fs::File>> {
    make_folder_of(path).and_then(|()| std::fs::File::create(path)).map(io::BufWriter::new)
}

/// An [`Access`] error of a file.
#[must_use]
pub fn access(action: &'static str, path: &Path, error: io::Error) -> Access {
    Access { action, what: path.display().to_string(), error }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_is_a_file_is_told_as_one() {
        let file = std::env::current_exe().unwrap();
        let said =
            |path: &Path| [create(path).unwrap_err(), write(path, b"text").unwrap_err()].map(|error| error.to_string());
        for path in [file.join("trace.vcd"), file.join("out/trace.vcd")] {
            let [created, written] = said(&path);
            assert!(created.ends_with("trace.vcd: a part of its path is a file, not a folder"), "{created}");
            assert_eq!(written, created);
        }
    }

    #[test]
    fn a_terminal_is_asked_and_nobody_else() {
        let said = |answer: &str, is_terminal| {
            let mut output = Vec::new();
            let said = ask(&mut answer.as_bytes(), &mut output, is_terminal, "long.toml: about 1 year");
            (said, String::from_utf8(output).unwrap())
        };
        let question = "long.toml: about 1 year\nGo on? [y/N] ".to_owned();
        for (answer, goes_on) in
            [("y\n", true), ("Yes\n", true), ("n\n", false), ("\n", false), ("", false), ("yo\n", false)]
        {
            assert_eq!(said(answer, true), (Some(goes_on), question.clone()), "{answer:?}");
        }
        assert_eq!(said("y\n", false), (None, String::new()));
    }
}
