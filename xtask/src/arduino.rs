//! Tests that need what others wrote for the Uno: Debian's Arduino core with its bootloaders, its compiler, avrdude.

use crate::command::{self, Done, cargo, command, install_debian, target_dir};
use std::path::{Path, PathBuf};

/// A file of each package, by which it is known to be there; and the package.
const PACKAGES: [(&str, &str); 4] = [
    ("/usr/share/arduino/hardware/arduino/avr/boards.txt", "arduino-core-avr"),
    ("/usr/bin/avr-g++", "gcc-avr"),
    ("/usr/lib/avr/include/avr/io.h", "avr-libc"),
    ("/usr/bin/avrdude", "avrdude"),
];

/// Real bootloaders on the virtual Uno, programmed by avrdude and by `pulsetrain flash`; baked sketches, compiled.
pub(crate) fn test() -> Done {
    if !cfg!(target_os = "linux") {
        println!("the tests with Debian's Arduino core were left out: this is no Linux");
        return Ok(());
    }
    for (file, package) in PACKAGES {
        if !Path::new(file).exists() {
            install_debian(package)?;
        }
    }
    let optiboot = optiboot()?;
    for tests in [
        "test --package pulsetrain-board --test uno_bootloader -- --ignored",
        "test --package pulsetrain --test flash -- --ignored",
        "test --package pulsetrain --test baked -- --ignored --skip an_hour",
    ] {
        command::run(cargo(tests).env("PULSETRAIN_OPTIBOOT", &optiboot))?;
    }
    Ok(())
}

/// Optiboot's source, as Debian has it.
const OPTIBOOT: &str = "/usr/share/arduino/hardware/arduino/avr/bootloaders/optiboot/optiboot.c";

/// Builds the Uno's Optiboot from Debian's source with its makefile's settings: Debian's own image has 532 bytes, 20 more than there are
/// up to the end of the flash (the source is older than the compiler). These switches make it 512, the word with its version left out, which
/// only people look at.
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
