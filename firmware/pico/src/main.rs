//! The image that `cargo xtask firmware pico` builds, and hosts drive.
#![no_std]
#![no_main]

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    // SAFETY: the start-up code calls main once, and nothing else is begun.
    unsafe { pulsetrain_pico::firmware::run() }
}
