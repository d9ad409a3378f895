//! A run from its program to its report, as one call: [`run::run`] proves, connects, records, runs and judges. The command line, a page in a
//! browser and other programs share it.
//!
//! # What is here, top down
//! - [`run`]: the order of calls; [`run::RunOptions`] go in, [`run::Progress`] comes out while it runs, then [`run::Run`]
//! - [`record`]: files, verdict and picture, while a board runs; [`recorded_steps`]: the steps that came
//! - [`run_report`], [`plan_report`]: what is known of a run and of its plan, as JSON and as tables
//! - [`positions`]: where motors are, in the file's units; [`error`]: errors as JSON, with their place in a motion file
//!
//! # What is not
//! It opens no file and no port: what it writes, it writes where the caller says. It knows no command line: advice that names a command is added
//! there.
#![forbid(unsafe_code)]

pub mod error;
pub mod plan_report;
pub mod positions;
pub mod record;
pub mod recorded_steps;
pub mod run;
pub mod run_report;

/// A value as indented JSON.
///
/// # Errors
/// When the value has no JSON form.
pub fn json(value: &impl serde::Serialize) -> Result<String, serde_json::Error> {
    serde_json::to_string_pretty(value)
}
