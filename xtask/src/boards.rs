//! Core, built for the boards' processors: no float, no alloc, 16-bit `usize` on the AVR.

use crate::command::{Done, cargo, command, run};

/// Builds `pulsetrain-core` for the Pico's Cortex-M0+ and the Uno's ATmega328P.
pub(crate) fn build_core() -> Done {
    run(command("rustup").args(["target", "add", "thumbv6m-none-eabi"]))?;
    run(&mut cargo("build --package pulsetrain-core --target thumbv6m-none-eabi"))?;
    // No core library is shipped for AVR: it is built here, which stable Rust does only when told to.
    run(command("rustup").args(["component", "add", "rust-src"]))?;
    run(cargo("build --release --package pulsetrain-core --target avr-none -Zbuild-std=core")
        .env("RUSTC_BOOTSTRAP", "1")
        .env("CARGO_TARGET_AVR_NONE_RUSTFLAGS", "-C target-cpu=atmega328p"))
}
