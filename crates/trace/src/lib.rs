//! Traces in and out, and the verdict: whether edges, steps or a film follow the law.
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
