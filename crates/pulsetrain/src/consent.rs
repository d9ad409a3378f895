//! Asks the user before a long motion is planned or run.

use miette::Diagnostic;
use pulsetrain_motion::{Time, human};
use pulsetrain_plan::LAST_TICK;
use pulsetrain_session::estimate::{Estimate, Task};
use pulsetrain_session::prepare::Prepared;

use crate::console::Console;

/// From this waiting time on, s, the command prints how long it will take.
const WORTH_SAYING_S: f64 = 5.0;

/// A motion that is longer than the user probably wants.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum LongMotion {
    /// The user has not said that the length is meant.
    #[error("{file}: this motion is long: {estimate}")]
    #[diagnostic(help("say --yes if it is meant; or take its beginning: --for \"10 s\""))]
    Unasked {
        /// The motion file.
        file: String,
        /// Its estimated length, time and files.
        estimate: Estimate,
    },
    /// The user was asked, and said no.
    #[error("{file}: nothing was planned")]
    #[diagnostic(help("--for \"10 s\" takes the beginning of a long motion"))]
    Declined {
        /// The motion file.
        file: String,
        /// Its estimated length, time and files.
        estimate: Estimate,
    },
    /// The motion is longer than any board's tick counter.
    #[error(
        "{file}: this motion is too long: {estimate}. Board `{board}` can count {} ({:.2e} s) at most.",
        human::long_time(*.limit_s), .limit_s
    )]
    #[diagnostic(help("Use fewer cycles, or --for \"10 s\". (--yes does not help.)"))]
    TooLong {
        /// The motion file.
        file: String,
        /// The board.
        board: String,
        /// When the board's counter ends, s.
        limit_s: f64,
        /// The motion's estimated length, time and files.
        estimate: Estimate,
    },
}

impl LongMotion {
    /// The motion's estimated length, time and files.
    #[must_use]
    pub const fn estimate(&self) -> &Estimate {
        match self {
            LongMotion::Unasked { estimate, .. }
            | LongMotion::Declined { estimate, .. }
            | LongMotion::TooLong { estimate, .. } => estimate,
        }
    }
}

/// The length that the user wants, and who can be asked about it.
#[derive(Clone, Copy, Debug)]
pub struct Consent {
    /// The wanted length. `None`: as in the file.
    pub length: Option<Time>,
    /// The command's work.
    pub task: Task,
    /// The user gave `--yes`.
    pub yes: bool,
    /// The output is for a script, which cannot be asked.
    pub json: bool,
}

/// Goes on at once with a motion of usual length. Asks the user whether a long one is meant.
///
/// # Errors
/// [`LongMotion`]: nobody can be asked, the user says no, or no board's counter reaches that far.
pub fn agree(prepared: &Prepared, consent: Consent, console: &mut Console<'_>) -> Result<(), LongMotion> {
    let estimate = Estimate::of(prepared, consent.length, consent.task);
    let (file, board) = (prepared.file.clone(), &prepared.program.board);
    let limit_s = LAST_TICK as f64 / board.tick_hz as f64;
    if estimate.motion_s > limit_s {
        return Err(LongMotion::TooLong { file, board: board.name.clone(), limit_s, estimate });
    }
    if consent.yes || !estimate.is_much() {
        if estimate.planning_s + estimate.running_s.unwrap_or(0.0) > WORTH_SAYING_S {
            console.tell(format_args!("{file}: this takes a while: {estimate}\n"));
        }
        return Ok(());
    }
    let question = format!("{file}: this motion is long: {estimate}.");
    match if consent.json { None } else { console.confirm(&question) } {
        Some(true) => Ok(()),
        Some(false) => Err(LongMotion::Declined { file, estimate }),
        None => Err(LongMotion::Unasked { file, estimate }),
    }
}
