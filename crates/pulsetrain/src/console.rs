//! Where a command prints, and how it ends.

use pulsetrain_motion::human;
use std::cell::Cell;
use std::fmt::Display;
use std::io::{self, BufRead, IsTerminal, Write};

use indicatif::{ProgressBar, ProgressStyle};
use pulsetrain_session::control::Event;

use crate::access::unprinted;
pub use crate::access::{Access, access};
use crate::clean::{Cleaned, escaped_json};
use crate::files::inputs::{MAX_TYPED_BYTES, next_line};

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

/// Where a command prints.
pub struct Console<'a> {
    /// Results.
    pub out: Cleaned<'a>,
    /// Errors.
    pub err: Cleaned<'a>,
    /// Whether `err` is a terminal: colours and progress bars are for people.
    pub err_is_terminal: bool,
    /// Whether a planning that takes long says so on the process's standard error, where there is no progress bar.
    pub says_progress: bool,
}

impl<'a> Console<'a> {
    /// Prints results to `out` and errors to `err`, which may be a terminal.
    pub fn new(out: &'a mut dyn Write, err: &'a mut dyn Write, err_is_terminal: bool) -> Console<'a> {
        Console { out: Cleaned::new(out), err: Cleaned::new(err), err_is_terminal, says_progress: false }
    }
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
            Err(error) => Err(unprinted(error).into()),
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
        ask(&mut io::stdin().lock(), &mut self.err, is_terminal, text)
    }

    /// A progress bar of `length`, counted in `unit`. It is hidden if standard error is no terminal.
    #[must_use]
    pub fn progress(&self, length: f64, unit: &str) -> Progress {
        if !self.err_is_terminal {
            let mut progress = Progress::new(ProgressBar::hidden(), length);
            progress.says = self.says_progress;
            return progress;
        }
        let bar = ProgressBar::new(PROGRESS_PARTS);
        let template = format!("{{msg:12}} [{{wide_bar:.cyan/blue}}] {{percent:>3}} % of {} {{eta:>4}}", unit);
        if let Ok(style) = ProgressStyle::with_template(&template) {
            bar.set_style(style.progress_chars("━━╌"));
        }
        Progress::new(bar, length)
    }

    /// A progress bar for the run of a motion that ends then, s; the time that has passed if the motion has no end.
    #[must_use]
    pub fn run_progress(&self, end_s: Option<f64>) -> Progress {
        if let Some(end_s) = end_s {
            return self.progress(end_s, &human::seconds_to(end_s, 6));
        }
        if !self.err_is_terminal {
            return Progress::new(ProgressBar::hidden(), f64::INFINITY);
        }
        let bar = ProgressBar::new_spinner();
        if let Ok(style) = ProgressStyle::with_template("{msg:12} {elapsed_precise}, Ctrl-C ends it") {
            bar.set_style(style);
        }
        Progress::new(bar, f64::INFINITY)
    }
}

/// Asks at a terminal whether to go on: "y" and "yes" mean yes, everything else no. `None` if there is no terminal.
fn ask(input: &mut dyn BufRead, output: &mut dyn Write, is_terminal: bool, text: &str) -> Option<bool> {
    if !is_terminal {
        return None;
    }
    write!(output, "{text}\nGo on? [y/N] ").and_then(|()| output.flush()).ok()?;
    let mut answer = Vec::new();
    next_line(input, &mut answer, MAX_TYPED_BYTES).ok()?;
    let answer = String::from_utf8_lossy(&answer);
    Some(matches!(answer.trim().to_lowercase().as_str(), "y" | "yes"))
}

const PROGRESS_PARTS: u64 = 10_000;

/// A progress bar. It disappears when this is dropped.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
    length: f64,
    /// Whether it says in words how far the work is.
    says: bool,
    /// The present work, and after how long it is said next, s.
    stage: Cell<&'static str>,
    due_s: Cell<f64>,
}

/// Nothing is silent for longer, s; and how much longer it is before the next word.
const SILENT_S: f64 = 2.0;
const NEXT_WORD: f64 = 1.5;

impl Progress {
    fn new(bar: ProgressBar, length: f64) -> Progress {
        Progress { bar, length, says: false, stage: Cell::new(""), due_s: Cell::new(SILENT_S) }
    }

    /// Names the present work in one or two words.
    pub fn stage(&self, name: &'static str) {
        crate::interrupt::stage(name);
        self.stage.set(name);
        self.bar.set_message(name);
    }

    /// Sets how much of the length is done.
    pub fn set(&self, done: f64) {
        let passed_s = self.bar.elapsed().as_secs_f64();
        // Motors that run are heard; and a run's own words come at its end.
        let is_silent = self.stage.get() != "running" && self.length.is_finite();
        if self.says && is_silent && passed_s >= self.due_s.get() {
            self.due_s.set((passed_s * NEXT_WORD).max(passed_s + SILENT_S));
            let percent = (100.0 * done / self.length).clamp(0.0, 100.0);
            // If standard error is closed nobody reads it.
            drop(writeln!(io::stderr(), "{}: {percent:.0} % after {passed_s:.0} s; Ctrl-C ends it", self.stage.get()));
        }
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
    let json = pulsetrain_report::json(value).map_err(|error| miette::miette!("cannot write JSON: {error}"))?;
    Ok(escaped_json(&json))
}

#[cfg(test)]
mod tests {
    use super::*;

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
