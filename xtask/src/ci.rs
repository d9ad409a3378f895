//! What must hold before a change lands.

use crate::command::{self, Done, cargo, command};
use crate::{cross_check, firmware, fuzz, test};

/// Seconds that each fuzz target runs in CI.
const FUZZ_SECONDS: u64 = 15;
/// Cases of each property test in CI; in `cargo xtask test` as many as the test says, or 256.
const PROPERTY_CASES: u32 = 1024;

/// Cheapest first: what fails, fails early.
pub(crate) fn run() -> Done {
    command::run(command("rustup").args(["component", "add", "rustfmt", "clippy"]))?;
    command::run(&mut cargo("fmt --all --check"))?;
    for manifest in ["fuzz/Cargo.toml", "xtask/cross-check/usb_serial/Cargo.toml"] {
        command::run(&mut cargo(&format!("fmt --manifest-path {manifest} --check")))?;
    }
    command::run(&mut cargo("clippy --workspace --all-targets -- -D warnings"))?;
    command::run(cargo("doc --workspace --no-deps --document-private-items").env("RUSTDOCFLAGS", "-D warnings"))?;
    // What the virtual boards run, in the tests as well, is what the sources say.
    firmware::check_uno()?;
    firmware::pico::check()?;
    test::run(Some(PROPERTY_CASES))?;
    cross_check::run()?;
    command::run(&mut cargo("run --release -- run examples/tutorial.toml"))?;
    fuzz::run(FUZZ_SECONDS, None)?;
    println!("xtask ci: all passed");
    Ok(())
}
