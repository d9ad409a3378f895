//! Draws pictures of the documents that no command of the program draws.

use crate::command::{self, Done, cargo};

/// Draws docs/winch.md's comparisons with the sketch.
pub(crate) fn run() -> Done {
    command::run(&mut cargo("run --release --package pulsetrain --example winch_pictures -- docs/img"))
}
