//! Tests the Python client and the tracker of films in an environment of its own under the target folder.

use crate::command::{self, Done, cargo, command, root, target_dir};
use std::path::PathBuf;

/// The packages that the client needs.
const PYSERIAL: &str = "pyserial==3.5";
/// The package that its example plots with.
const MATPLOTLIB: &str = "matplotlib==3.11.2";
/// The package whose packets of OSC are sent to Pulsetrain.
const PYTHON_OSC: &str = "python-osc==1.10.2";
/// The package that checks its types.
const MYPY: &str = "mypy==2.4.1";

/// The packages of the tracker of films, and of the clips that test it.
const TRACKER: [&str; 2] = ["opencv-python-headless==5.0.0.93", "av==18.1.0"];
/// What runs on them, from the folder of the client.
const TRACKER_SOURCE: &str = "../crates/pulsetrain/src/film/tracker.py";

/// The path of a Python that has what films need. Installs ffmpeg, which makes the clips, on Debian; elsewhere, without
/// it, those tests are left out.
pub(crate) fn with_tracker() -> Done<PathBuf> {
    if cfg!(target_os = "linux") && command("ffmpeg").arg("-version").output().is_err() {
        command::install_debian("ffmpeg")?;
    }
    TRACKER.iter().try_for_each(|package| with(package).map(drop))?;
    with(TRACKER[0])
}

/// Checks the client's types, and runs its tests against virtual boards at pseudo-terminals, and those of films.
pub(crate) fn test_client() -> Done {
    let client = root().join("python");
    with(PYSERIAL)?;
    with(MATPLOTLIB)?;
    with(PYTHON_OSC)?;
    with_tracker()?;
    let python = with(MYPY)?;
    let types = ["-m", "mypy", "--strict", "--cache-dir"];
    let cache = target_dir().join("mypy");
    let sources = ["pulsetrain_winch", "tests", "examples", TRACKER_SOURCE];
    command::run(command(&python).args(types).arg(cache).args(sources).current_dir(&client))?;
    // Built like the workspace's tests: an emulated chip needs the optimizer to run in real time.
    command::run(&mut cargo("build --profile test --package pulsetrain --bin pulsetrain --example osc_monitor"))?;
    let built = |name: &str| target_dir().join("debug").join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    let mut tests = command(python);
    tests.args(["-m", "unittest"]).current_dir(client).env("PULSETRAIN", built("pulsetrain"));
    tests.env("PULSETRAIN_OSC_MONITOR", built("examples/osc_monitor"));
    command::run(&mut tests)
}

/// The path of a Python that has a package.
pub(crate) fn with(package: &str) -> Done<PathBuf> {
    let environment = target_dir().join("python");
    let bin = if cfg!(windows) { "Scripts" } else { "bin" };
    let python = environment.join(bin).join("python");
    // A Python without pip is left from an attempt that failed.
    if !environment.join(bin).join(if cfg!(windows) { "pip.exe" } else { "pip" }).exists() {
        let system = if cfg!(windows) { "python" } else { "python3" };
        let make = || command::run(command(system).args(["-m", "venv"]).arg(&environment));
        make().or_else(|_| command::install_debian("python3-venv").and_then(|()| make()))?;
    }
    let pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", package];
    command::run(command(&python).args(pip))?;
    Ok(python)
}
