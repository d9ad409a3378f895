//! Reads and writes traces, and judges them: do edges, steps or a film follow the law?
//!
//! ```
//! use pulsetrain_motion::file;
//! use pulsetrain_trace::steps::{Step, StepTrace};
//! use pulsetrain_trace::verdict::{Options, judge_steps};
//!
//! let text = r#"
//!     board = "uno"
//!     grid = "reach"
//!     tolerance = "1 tick"
//!     [motor.wheel]
//!     steps_per_rev = 200
//!     driver = "A4988"
//!     pins = { step = 8, dir = 9 }
//!     forward = "high"
//!     [[motion]]
//!     motor = "wheel"
//!     law.sine = { amplitude = "1.8 deg", period = "1 s", cycles = 1 }
//! "#;
//! let no_other_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
//! let program = file::read(text, "wheel.toml", &no_other_files).expect("a motion file");
//!
//! // The amplitude is one step: two steps forward, at a quarter and half of the second, and two back.
//! let step = |tick, forward| Step { motor: 0, tick, forward };
//! let steps = vec![step(4_000_000, true), step(8_000_000, true), step(12_000_002, false), step(16_000_000, false)];
//! let trace = StepTrace { tick_hz: 16_000_000, motors: vec!["wheel".into()], steps };
//! let report = judge_steps(&trace, &program, &Options::default())?;
//! assert!(!report.ok);
//! assert_eq!(
//!     report.failures[0].to_string(),
//!     "motor wheel: step 3 is 2.00 ticks late, limit 1.00, at t = 0.750000 s"
//! );
//! # Ok::<(), pulsetrain_trace::verdict::JudgeError>(())
//! ```
//!
//! # What is here, top down
//! - [`verdict`]: the judge, from edges, steps or a film to a [`verdict::Report`]; its reading at a glance is [`summary`]
//! - [`winch`]: the judge of boards that work out their own path
//! - [`capture`]: any file that can be judged, by its content
//! - [`vcd_file`], [`saleae`], [`sigrok`], [`steps`], [`camera`]: one file format each; `levels`: what analysers' rows have in common
//! - [`crossing`]: when a law wants its steps, solved from θ(t) alone
//! - [`decode`]: edges → what each motor and its driver see
//! - [`lines`]: the wires and their names
//!
//! # What is not
//! Plans: the judge knows laws and wiring, never `pulsetrain-plan`, so that it cannot share the planner's mistakes.
#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit"))]
#![forbid(unsafe_code)]

pub mod camera;
pub mod capture;
pub mod crossing;
pub mod decode;
mod levels;
pub mod lines;
pub mod saleae;
pub mod sigrok;
pub mod steps;
pub mod summary;
pub mod vcd_file;
pub mod verdict;
pub mod winch;

pub use lines::{Edge, Line, Trace};
pub use pulsetrain_motion::columns::ReadError;
