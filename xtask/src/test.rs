//! What a contributor runs before sending a change.

use crate::command::{self, Done, Failure, cargo, command};
use crate::{arduino, boards, python, ruckig};
use serde_json::Value;
use std::cmp::Reverse;
use std::path::{Path, PathBuf};
use std::process::Command;

/// All tests of the workspace, with Debian's Arduino core, and of the Python client, core built for the boards' processors, S-curves against ruckig.
///
/// `property_cases`: of each property test that does not set its own; else proptest's 256.
pub(crate) fn run(property_cases: Option<u32>) -> Done {
    let optiboot = arduino::prepare()?;
    let binaries = binaries()?;
    let count = binaries.len();
    let tests = binaries.into_iter().map(|binary| {
        let mut test = binary.command();
        test.envs(property_cases.map(|cases| ("PROPTEST_CASES", cases.to_string())));
        test.envs(optiboot.as_ref().map(|image| ("PULSETRAIN_OPTIBOOT", image)));
        test
    });
    let tested = command::run_side_by_side(tests.collect());
    command::run(&mut cargo("test --workspace --doc --no-fail-fast"))?;
    tested?;
    python::test_client()?;
    boards::build_core()?;
    let worst = ruckig::compare()?;
    println!("s-curve durations of {} moves: at most {worst:.1e} (relative) from ruckig's", ruckig::MOVES);
    println!("xtask test: {count} test binaries, documentation's examples, the Python client: all passed");
    Ok(())
}

/// Packages whose tests run virtual boards.
const LONG: [&str; 2] = ["pulsetrain", "board"];

/// What `cargo test` would run. It runs one after the other, and waits for the longest test of each.
struct Binary {
    /// What it was made of: the tests' file, or the library's.
    source: PathBuf,
    executable: PathBuf,
    /// Of its package.
    manifest: PathBuf,
}

impl Binary {
    /// What cargo says of it if it is a test.
    fn from_message(message: &Value) -> Option<Binary> {
        let path = |value: &Value| value.as_str().map(PathBuf::from);
        message["profile"]["test"].as_bool()?.then_some(())?;
        Some(Binary {
            source: path(&message["target"]["src_path"])?,
            executable: path(&message["executable"])?,
            manifest: path(&message["manifest_path"])?,
        })
    }

    /// Runs its tests one by one, as cargo would: in its package's folder.
    fn command(&self) -> Command {
        let package = self.manifest.parent().unwrap_or(Path::new("."));
        let mut test = command(&self.executable);
        test.current_dir(package).env("CARGO_MANIFEST_DIR", package).env("RUST_TEST_THREADS", "1");
        test
    }
}

/// Builds them. Those of the crates that run virtual boards come first: they take longest, and the last ones to run leave cores with
/// nothing to do.
fn binaries() -> Done<Vec<Binary>> {
    let messages = command::output(&mut cargo("test --workspace --no-run --message-format json-render-diagnostics"))?;
    let mut binaries = Vec::new();
    for line in messages.lines() {
        let message = serde_json::from_str(line)
            .map_err(|why| Failure::Check(format!("cargo's answer is no JSON: {why}: {line}")))?;
        binaries.extend(Binary::from_message(&message));
    }
    binaries.sort_by_key(|binary| {
        let long = LONG.iter().position(|package| binary.manifest.ends_with(Path::new(package).join("Cargo.toml")));
        (long.unwrap_or(LONG.len()), Reverse(binary.source.clone()))
    });
    Ok(binaries)
}
