//! Builds for other machines than this one: core for the boards' processors (no float, no alloc, 16-bit `usize` on the
//! AVR), and all crates but the command line for a browser.

use crate::command::{Done, cargo, command, run};

/// All crates of the workspace but the command line and this one.
const IN_A_BROWSER: [&str; 12] =
    ["core", "emulator", "motion", "plan", "trace", "oracle", "board", "session", "bake", "plot", "report", "testkit"];

/// Checks that all crates but the command line build for wasm32.
pub(crate) fn check_wasm() -> Done {
    const TARGET: &str = "wasm32-unknown-unknown";
    run(command("rustup").args(["target", "add", TARGET]))?;
    let mut check = cargo(&format!("check --target {TARGET}"));
    run(check.args(IN_A_BROWSER.iter().flat_map(|name| ["--package".to_owned(), format!("pulsetrain-{name}")])))
}

/// Builds `pulsetrain-core` for the Pico's Cortex-M0+ and the Uno's ATmega328P.
pub(crate) fn build_core() -> Done {
    run(command("rustup").args(["target", "add", "thumbv6m-none-eabi"]))?;
    run(&mut cargo("build --package pulsetrain-core --target thumbv6m-none-eabi"))?;
    // No compiled core library exists for AVR. It is built here, which stable Rust allows only with RUSTC_BOOTSTRAP.
    run(command("rustup").args(["component", "add", "rust-src"]))?;
    run(cargo("build --release --package pulsetrain-core --target avr-none -Zbuild-std=core")
        .env("RUSTC_BOOTSTRAP", "1")
        .env("CARGO_TARGET_AVR_NONE_RUSTFLAGS", "-C target-cpu=atmega328p"))
}
