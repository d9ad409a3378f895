//! Tests the Python client in an environment of its own under the target folder.

use crate::command::{self, Done, cargo, command, root, target_dir};
use std::path::PathBuf;

/// The packages that the client needs.
const PYSERIAL: &str = "pyserial==3.5";
/// The package that its example plots with.
const MATPLOTLIB: &str = "matplotlib==3.11.2";
/// The package that checks its types.
const MYPY: &str = "mypy==2.4.1";

/// Checks the client's types, and runs its tests against virtual boards at pseudo-terminals.
pub(crate) fn test_client() -> Done {
    let client = root().join("python");
    with(PYSERIAL)?;
    with(MATPLOTLIB)?;
    let python = with(MYPY)?;
    let types = ["-m", "mypy", "--strict", "--cache-dir"];
    let cache = target_dir().join("mypy");
    let sources = ["pulsetrain_winch", "tests", "examples"];
    command::run(command(&python).args(types).arg(cache).args(sources).current_dir(&client))?;
    // Built like the workspace's tests: an emulated chip needs the optimizer to run in real time.
    command::run(&mut cargo("build --profile test --package pulsetrain"))?;
    let pulsetrain = target_dir().join("debug").join(format!("pulsetrain{}", std::env::consts::EXE_SUFFIX));
    let mut tests = command(python);
    tests.args(["-m", "unittest"]).current_dir(client).env("PULSETRAIN", pulsetrain);
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
