//! Tests the page of a run in Chromium, as a person would use it.

use crate::command::{self, Done, Failure, command, root};
use crate::{installs, programs};

/// Runs `xtask/page/page.test.mjs` against a run that a program of its own plays, and `live.test.mjs` against a live motion on the virtual Uno. With
/// `pictures` they leave screenshots.
pub(crate) fn test(pictures: bool) -> Done {
    installs::debian(&[installs::CHROMIUM])?;
    let folder = installs::npm("xtask/page", "page")?;
    let shots = folder.join("pictures");
    let failed = |why| Failure::File { path: folder.clone(), why };
    std::fs::create_dir_all(&shots).map_err(failed)?;
    for file in ["page.test.mjs", "live.test.mjs"] {
        std::fs::copy(root().join("xtask/page").join(file), folder.join(file)).map_err(failed)?;
    }
    programs::build()?;
    let mut node = command("node");
    node.args(["--test", "--test-reporter=spec", "page.test.mjs", "live.test.mjs"]).current_dir(&folder);
    node.env("PAGE", programs::example("page")).env("CHROMIUM", installs::CHROMIUM.1);
    node.env("PULSETRAIN", programs::pulsetrain());
    if pictures {
        node.env("SCREENSHOTS", &shots);
    }
    command::run(&mut node)?;
    if pictures {
        println!("look at the pictures in {}", shots.display());
    }
    Ok(())
}
