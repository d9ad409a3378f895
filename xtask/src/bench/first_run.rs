//! The time of the README's first command for a user who has Rust and nothing else.

use crate::command::{self, Done, Failure, cargo, command, root};
use std::time::Instant;

/// Wall times.
pub(crate) struct FirstRun {
    /// `cargo run --release -- run examples/tutorial.toml` in a clean clone, with no dependency downloaded, s.
    pub(crate) first_s: f64,
    /// The run of the binary that this built, s.
    pub(crate) again_s: f64,
}

/// Clones the last commit, and runs it there with empty caches.
pub(crate) fn measure() -> Done<FirstRun> {
    let folder = std::env::temp_dir().join(format!("pulsetrain-first-run-{}", std::process::id()));
    let measured = measure_in(&folder);
    let removed = std::fs::remove_dir_all(&folder).map_err(|why| Failure::File { path: folder, why });
    measured.and_then(|times| removed.map(|()| times))
}

fn measure_in(folder: &std::path::Path) -> Done<FirstRun> {
    let clone = folder.join("pulsetrain");
    command::run(command("git").args(["clone", "--quiet"]).arg(root()).arg(&clone))?;
    let timed = |command: &mut std::process::Command| {
        let start = Instant::now();
        command::run(command.current_dir(&clone)).map(|()| start.elapsed().as_secs_f64())
    };
    let mut first = cargo("run --release -- run examples/tutorial.toml");
    let first_s = timed(first.env("CARGO_HOME", folder.join("cargo")).env_remove("CARGO_TARGET_DIR"))?;
    let binary = clone.join("target/release/pulsetrain");
    let again_s = timed(command(binary).args(["run", "examples/tutorial.toml"]))?;
    Ok(FirstRun { first_s, again_s })
}
