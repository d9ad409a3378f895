//! The checks that must pass before a change lands.

use crate::command::{self, Done, Failure, cargo, command};
use crate::{accept, boards, cross_check, firmware, fuzz, page, test};
use std::path::PathBuf;
use std::time::Instant;
use std::{env, fs};

/// Seconds that each fuzz target runs in CI.
const FUZZ_SECONDS: u64 = 15;

/// Number of random motions that CI plans and runs, and their seed. `cargo xtask soak` tries thousands.
const ACCEPT_COUNT: u64 = 200;
const ACCEPT_SEED: u64 = 7;

/// A stage of CI: its name and its function.
type Stage = (&'static str, fn() -> Done);

/// The cheapest stage comes first, so that a failure comes early.
const STAGES: [Stage; 12] = [
    ("format", format),
    ("lints", lints),
    ("documentation", documentation),
    ("wasm32", boards::check_wasm),
    ("packages", packages),
    // The committed images, which virtual boards run in the tests too, must be those of the sources.
    ("images", || firmware::check_uno().and_then(|()| firmware::pico::check())),
    ("tests", || test::run(test::Tier::Gate)),
    ("page in Chromium", || page::test(false)),
    ("cross-check", cross_check::run),
    ("first command of the README", || command::run(&mut cargo("run --release -- run examples/tutorial.toml"))),
    ("accepted motions run", || accept::run(&accept::Options::random(ACCEPT_COUNT, ACCEPT_SEED))),
    ("fuzzing", || fuzz::run(FUZZ_SECONDS, None)),
];

/// Runs every stage, and prints the time of each.
pub(crate) fn run() -> Done {
    let mut took = Vec::new();
    for (name, stage) in STAGES {
        let start = Instant::now();
        stage()?;
        took.push((name, start.elapsed().as_secs()));
    }
    for (name, seconds) in took {
        println!("xtask ci: {name}: {} min {:02} s", seconds / 60, seconds % 60);
    }
    println!("xtask ci: all passed");
    Ok(())
}

fn format() -> Done {
    command::run(command("rustup").args(["component", "add", "rustfmt", "clippy"]))?;
    command::run(&mut cargo("fmt --all --check"))?;
    for manifest in ["fuzz/Cargo.toml", "xtask/cross-check/usb_serial/Cargo.toml"] {
        command::run(&mut cargo(&format!("fmt --manifest-path {manifest} --check")))?;
    }
    Ok(())
}

/// The feature `midi` stands on ALSA, a library of the system.
fn lints() -> Done {
    command::run(&mut cargo("clippy --workspace --all-targets -- -D warnings"))?;
    command::output(command("pkg-config").args(["--exists", "alsa"])).or_else(|_| {
        command::install_debian("pkg-config")?;
        command::install_debian("libasound2-dev").map(|()| String::new())
    })?;
    command::run(&mut cargo("clippy --package pulsetrain --features midi -- -D warnings"))
}

/// Checks what a program that embeds the crates gets: each package builds from its own files.
fn packages() -> Done {
    forget_unpacked()?;
    let ours = ["xtask", "pulsetrain-oracle", "pulsetrain-testkit"];
    let mut package = cargo("package --workspace --quiet --allow-dirty");
    command::run(package.args(ours.iter().flat_map(|name| ["--exclude", name])))
}

/// Removes the sources that cargo unpacked from earlier packages of ours. It takes them for those of a package of the same version.
fn forget_unpacked() -> Done {
    let home = env::var_os("CARGO_HOME").map(PathBuf::from).or_else(|| Some(env::home_dir()?.join(".cargo")));
    let Some(Ok(registries)) = home.map(|home| fs::read_dir(home.join("registry/src"))) else { return Ok(()) };
    // A registry in a folder, as `cargo package` makes one, has a name without a host.
    let local = registries.flatten().filter(|registry| registry.file_name().to_string_lossy().starts_with('-'));
    for package in local.filter_map(|registry| fs::read_dir(registry.path()).ok()).flatten().flatten() {
        if package.file_name().to_string_lossy().starts_with("pulsetrain-") {
            let path = package.path();
            fs::remove_dir_all(&path).map_err(|why| Failure::File { path, why })?;
        }
    }
    Ok(())
}

fn documentation() -> Done {
    command::run(cargo("doc --workspace --no-deps --document-private-items").env("RUSTDOCFLAGS", "-D warnings"))
}
