//! Tests the Python client and the tracker of films in an environment of its own under the target folder.

use crate::command::{self, Done, command, root, target_dir};
use crate::{installs, programs};
use std::path::PathBuf;

/// What tracks the marks of films, from the folder of the client.
const TRACKER_SOURCE: &str = "../crates/pulsetrain/src/film/tracker.py";

/// The path of a Python that has what films need. Installs ffmpeg, which makes the clips, on Debian; elsewhere, without
/// it, those tests are left out.
pub(crate) fn with_tracker() -> Done<PathBuf> {
    if cfg!(target_os = "linux") {
        installs::debian(&[installs::FFMPEG])?;
    }
    installs::python()
}

/// Checks the client's types, and runs its tests against virtual boards at pseudo-terminals, and those of films. Those that are
/// marked `long` run if `environment` says so.
pub(crate) fn test_client(environment: &[(&str, String)]) -> Done {
    let client = root().join("python");
    let python = with_tracker()?;
    let types = ["-m", "mypy", "--strict", "--cache-dir"];
    let cache = target_dir().join("mypy");
    let sources = ["pulsetrain_winch", "tests", "examples", TRACKER_SOURCE];
    command::run(command(&python).args(types).arg(cache).args(sources).current_dir(&client))?;
    programs::build()?;
    let mut tests = command(python);
    tests.envs(environment.iter().map(|(name, value)| (name, value)));
    tests.args(["-m", "unittest"]).current_dir(client).env("PULSETRAIN", programs::pulsetrain());
    tests.env("PULSETRAIN_OSC_MONITOR", programs::example("osc_monitor"));
    command::run(&mut tests)
}
