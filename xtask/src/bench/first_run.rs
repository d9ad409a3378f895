//! The time of the README's first command for a user who has Rust and nothing else.

use super::report;
use crate::command::{self, Done, Failure, cargo, command, root};
use std::path::Path;
use std::process::Command;
use std::time::Instant;

/// Times of a command.
struct Times {
    wall_s: f64,
    /// Of the command and its children. `None` where the system does not say.
    processor_s: Option<f64>,
}

/// Clones the last commit, runs the command there with empty caches, and the built binary again. Writes the page.
pub(crate) fn run() -> Done {
    let folder = std::env::temp_dir().join(format!("pulsetrain-first-run-{}", std::process::id()));
    let measured = measure_in(&folder);
    let removed = std::fs::remove_dir_all(&folder).map_err(|why| Failure::File { path: folder, why });
    let rows = measured.and_then(|rows| removed.map(|()| rows))?;
    let mut text = format!(
        "# A first run, from a clean clone\n\nWritten by `cargo xtask bench first-run`; do not edit. {} Commit {}. Nothing is promised. Downloads count in the wall time, \
         and so do other programs that want the cores; not so in the processor time.\n\n| command | wall time, s | processor time, s |\n|---|---|---|\n",
        report::machine()?,
        command::output(command("git").args(["rev-parse", "--short", "HEAD"]))?.trim(),
    );
    for (what, Times { wall_s, processor_s }) in rows {
        let processor = processor_s.map_or_else(|| "unknown".to_owned(), |s| format!("{s:.2}"));
        text.push_str(&format!("| {what} | {wall_s:.2} | {processor} |\n"));
    }
    print!("{text}");
    report::write("first-run", &text)
}

fn measure_in(folder: &Path) -> Done<[(&'static str, Times); 2]> {
    let clone = folder.join("pulsetrain");
    command::run(command("git").args(["clone", "--quiet"]).arg(root()).arg(&clone))?;
    let timed = |command: &mut Command| {
        let (start, before) = (Instant::now(), children_s());
        command::run(command.current_dir(&clone))?;
        let processor_s = before.zip(children_s()).map(|(before, after)| after - before);
        Ok(Times { wall_s: start.elapsed().as_secs_f64(), processor_s })
    };
    let mut first = cargo("run --release -- run examples/tutorial.toml");
    let first = timed(first.env("CARGO_HOME", folder.join("cargo")).env_remove("CARGO_TARGET_DIR"))?;
    let binary = clone.join("target/release/pulsetrain");
    let again = timed(command(binary).args(["run", "examples/tutorial.toml"]))?;
    Ok([
        ("`cargo run --release -- run examples/tutorial.toml`, no dependency downloaded", first),
        ("`pulsetrain run examples/tutorial.toml` with the built binary", again),
    ])
}

/// Processor time of all children that have ended, s. Linux counts it in hundredths of a second (proc(5), fields 16 and
/// 17 of /proc/self/stat).
fn children_s() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The name in field 2 may have spaces; it ends at the last bracket, before field 3.
    let mut fields = stat.rsplit_once(") ")?.1.split(' ').skip(13);
    let mut hundredths = || fields.next()?.parse::<f64>().ok();
    Some((hundredths()? + hundredths()?) / 100.0)
}
