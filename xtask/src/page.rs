//! Tests the page of a run in Chromium, as a person would use it.

use crate::command::{self, Done, Failure, cargo, command, root, target_dir};
use std::path::Path;

/// Debian's browser.
const CHROMIUM: &str = "/usr/bin/chromium";

/// Runs `xtask/page/page.test.mjs` against a run that a program of its own plays, and `live.test.mjs` against a live motion on the virtual Uno. With
/// `pictures` they leave screenshots.
pub(crate) fn test(pictures: bool) -> Done {
    if !Path::new(CHROMIUM).exists() {
        command::install_debian("chromium")?;
    }
    let npm = || command::output(command("npm").arg("--version"));
    npm().or_else(|_| command::install_debian("npm").and_then(|()| npm()))?;
    let folder = target_dir().join("page");
    let shots = folder.join("pictures");
    let failed = |why| Failure::File { path: folder.clone(), why };
    std::fs::create_dir_all(&shots).map_err(failed)?;
    for file in ["package.json", "package-lock.json", "page.test.mjs", "live.test.mjs"] {
        std::fs::copy(root().join("xtask/page").join(file), folder.join(file)).map_err(failed)?;
    }
    command::run(command("npm").args(["ci", "--no-audit", "--no-fund", "--silent"]).current_dir(&folder))?;
    // Built like the workspace's tests, so that all but the example is there already.
    command::run(&mut cargo("build --profile test --package pulsetrain --bin pulsetrain --example page"))?;
    let mut node = command("node");
    node.args(["--test", "--test-reporter=spec", "page.test.mjs", "live.test.mjs"]).current_dir(&folder);
    node.env("PAGE", target_dir().join("debug/examples/page")).env("CHROMIUM", CHROMIUM);
    node.env("PULSETRAIN", target_dir().join("debug/pulsetrain"));
    if pictures {
        node.env("SCREENSHOTS", &shots);
    }
    command::run(&mut node)?;
    if pictures {
        println!("look at the pictures in {}", shots.display());
    }
    Ok(())
}
