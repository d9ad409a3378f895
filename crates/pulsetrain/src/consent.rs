//! A long motion is planned or run only if the user agrees.

use miette::Diagnostic;
use pulsetrain_motion::{Time, human};
use pulsetrain_plan::LAST_TICK;
use pulsetrain_session::estimate::{Estimate, Task};
use pulsetrain_session::prepare::Prepared;

use crate::console::Console;

/// From this waiting time on the command says how long it will take, s.
const WORTH_SAYING_S: f64 = 5.0;

/// A motion that is longer than anybody is likely to want.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum LongMotion {
    /// Nobody has said that it is meant.
    #[error("{file}: this motion is long: {estimate}")]
    #[diagnostic(help("say --yes if it is meant; or take its beginning: --for \"10 s\""))]
    Unasked {
        /// The motion file.
        file: String,
        /// What it comes to.
        estimate: Estimate,
    },
    /// Somebody was asked, and does not want it.
    #[error("{file}: nothing was planned")]
    #[diagnostic(help("--for \"10 s\" takes the beginning of a long motion"))]
    Declined {
        /// The motion file.
        file: String,
        /// What it comes to.
        estimate: Estimate,
    },
    /// No board counts so far.
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
        /// When its ticks end, s.
        limit_s: f64,
        /// What the motion comes to.
        estimate: Estimate,
    },
}

impl LongMotion {
    /// What the motion comes to.
    #[must_use]
    pub const fn estimate(&self) -> &Estimate {
        match self {
            LongMotion::Unasked { estimate, .. }
            | LongMotion::Declined { estimate, .. }
            | LongMotion::TooLong { estimate, .. } => estimate,
        }
    }
}

/// How much of a motion is meant, and who can be asked.
#[derive(Clone, Copy, Debug)]
pub struct Consent {
    /// What is wanted of the motion.
    pub length: Option<Time>,
    /// What is to be done with it.
    pub task: Task,
    /// It was said that a long one is meant.
    pub yes: bool,
    /// A script reads the output: it cannot be asked.
    pub json: bool,
}

/// Goes on at once with a motion of usual length; asks whether a long one is meant.
///
/// # Errors
/// [`LongMotion`]: nobody is there to say so, or says no; or no board counts so far.
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
