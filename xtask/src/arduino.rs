//! Other people's software for the Uno, which tests run on the virtual one: Debian's Arduino core with its bootloaders,
//! its compiler, and avrdude.

use crate::command::{self, Done, command, target_dir};
use crate::installs;
use std::path::PathBuf;

/// Installs these packages and builds Optiboot. Gives the variable with the image's path that the tests of bootloaders
/// read. `None` on a system other than Debian; those tests run only on Linux.
pub(crate) fn prepare() -> Done<Option<PathBuf>> {
    if !cfg!(target_os = "linux") {
        println!("the tests with Debian's Arduino core are left out: this is no Linux");
        return Ok(None);
    }
    installs::debian(&installs::ARDUINO)?;
    installs::debian(&installs::AVR)?;
    optiboot().map(Some)
}

/// Optiboot's source in Debian's package.
const OPTIBOOT: &str = "/usr/share/arduino/hardware/arduino/avr/bootloaders/optiboot/optiboot.c";

/// Builds the Uno's Optiboot from Debian's source with its makefile's settings. Debian's own image has 532 bytes, 20
/// more than fit at the end of the flash, since the source is older than the compiler. With these switches it has 512
/// bytes. They leave out the version word, which only people read.
fn optiboot() -> Done<PathBuf> {
    let (elf, image) = (target_dir().join("optiboot.elf"), target_dir().join("optiboot.hex"));
    let mut compiler = command("avr-gcc");
    compiler.args("-mmcu=atmega328p -DF_CPU=16000000L -DLED_START_FLASHES=3 -DBAUD_RATE=115200 -Os".split(' '));
    compiler.args("-fno-inline-small-functions -fno-split-wide-types -mrelax -fno-move-loop-invariants".split(' '));
    compiler.args("-fno-tree-loop-optimize -fno-ivopts -nostartfiles -nostdlib".split(' '));
    compiler.args(["-Wl,--section-start=.text=0x7e00", "-Wl,--section-start=.version=0x7ffe", "-Wl,--relax"]);
    command::run(compiler.arg(OPTIBOOT).arg("-o").arg(&elf))?;
    command::run(command("avr-objcopy").args(["-O", "ihex", "-j", ".text"]).args([&elf, &image]))?;
    Ok(image)
}
