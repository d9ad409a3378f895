//! The compared sides: our emulator, simavr with a harness of ours in C, avr8js and rp2040js with harnesses in
//! JavaScript, Unicorn with one in Python, QEMU.

use crate::command::{self, Done, Failure, cargo, command, root};
use crate::{installs, programs};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The tools that are built and installed for the comparisons.
pub(super) struct Tools {
    /// Under the target folder.
    folder: PathBuf,
}

impl Tools {
    /// Installs and builds the tools that are missing.
    pub(super) fn prepare() -> Done<Tools> {
        installs::debian(&installs::AVR)?;
        installs::debian(&installs::SIMAVR)?;
        installs::debian(&[installs::QEMU])?;
        let folder = installs::npm("xtask/cross-check", "cross-check")?;
        // simavr has the GPL: it runs here, and is no part of what the project distributes.
        command::run(
            command("cc").args(["-O2", "-Wall", "-Wextra", "-Werror", "-o"]).arg(folder.join("simavr")).args([
                "-I/usr/include/simavr",
                "xtask/cross-check/simavr.c",
                "-lsimavr",
                "-lelf",
            ]),
        )?;
        programs::build()?;
        Ok(Tools { folder })
    }

    pub(super) fn simavr(&self) -> Command {
        command(self.folder.join("simavr"))
    }

    pub(super) fn avr8js(&self) -> Command {
        let mut node = command("node");
        node.arg("xtask/cross-check/avr8js.mjs").arg(self.folder.join("node_modules/avr8js/dist/cjs/index.js"));
        node
    }

    pub(super) fn ours(&self) -> Command {
        command(programs::example("cross_check"))
    }

    pub(super) fn rp2040js(&self) -> Command {
        let mut node = command("node");
        node.arg("xtask/cross-check/rp2040js.mjs").arg(self.folder.join("node_modules/rp2040js/dist/esm/index.js"));
        node
    }

    pub(super) fn ours_arm(&self) -> Command {
        command(programs::example("cross_check_arm"))
    }

    /// Unicorn's Cortex-M3. It has the GPL: it runs here, and is no part of what the project distributes.
    pub(super) fn unicorn(&self) -> Done<Command> {
        let mut python = command(installs::python()?);
        python.arg("xtask/cross-check/unicorn_m3.py");
        Ok(python)
    }

    /// Compiles `usb_serial`; gives back the ELF file.
    pub(super) fn compile_usb(&self) -> Done<PathBuf> {
        const TARGET: &str = "thumbv6m-none-eabi";
        let target = self.folder.join("usb-serial");
        let source = root().join("xtask/cross-check/usb_serial");
        command::run(command("rustup").args(["target", "add", TARGET]))?;
        // The package is built next to its manifest, so that no other configuration applies. link.x is cortex-m-rt's;
        // memory.x is its own.
        let mut build = cargo("build --quiet --release --locked --target");
        build.arg(TARGET).current_dir(&source).env("CARGO_TARGET_DIR", &target);
        command::run(build.env("RUSTFLAGS", format!("-Clink-arg=-Tlink.x -Clink-arg=-L{}", source.display())))?;
        Ok(target.join(TARGET).join("release/usb-serial"))
    }

    /// QEMU's LM3S6965, with an image at address 0. What the program prints goes to standard output. QEMU has the GPL.
    pub(super) fn qemu(&self, image: &Path) -> Command {
        let mut qemu = command("qemu-system-arm");
        qemu.args(["-M", "lm3s6965evb", "-display", "none", "-serial", "null", "-monitor", "none"]);
        qemu.args(["-chardev", "stdio,id=text", "-semihosting-config", "enable=on,target=native,chardev=text"]);
        qemu.arg("-kernel").arg(image);
        qemu
    }

    /// Compiles a program of `programs` for ARMv6-M with its linker script; gives back the raw image.
    pub(super) fn compile_arm(&self, name: &str) -> Done<PathBuf> {
        command::run(command("rustup").args(["target", "add", "thumbv6m-none-eabi"]))?;
        let image = self.folder.join(name).with_extension("bin");
        command::run(
            command("rustc")
                .args(["--edition", "2024", "--target", "thumbv6m-none-eabi", "-O", "-C", "panic=abort"])
                .arg(format!("-Clink-arg=-Txtask/cross-check/programs/{name}.ld"))
                .args(["-C", "link-arg=--oformat=binary", "-o"])
                .arg(&image)
                .arg(format!("xtask/cross-check/programs/{name}.rs")),
        )?;
        Ok(image)
    }

    /// Runs one side with `cases`. They stay in the target folder, for a person who looks into a difference.
    pub(super) fn ask(&self, name: &str, side: &mut Command, cases: &str) -> Done<String> {
        let path = self.folder.join(name).with_extension("txt");
        std::fs::write(&path, cases).map_err(|why| Failure::File { path, why })?;
        command::pipe(side, cases)
    }

    /// The contents of the flash by an image in Intel HEX.
    pub(super) fn flash_of(&self, image: &str) -> Done<Vec<u8>> {
        let path = self.folder.join("flash.bin");
        command::run(command("avr-objcopy").args(["-I", "ihex", "-O", "binary", image]).arg(&path))?;
        std::fs::read(&path).map_err(|why| Failure::File { path, why })
    }

    /// Compiles one of `xtask/cross-check/programs`; gives back the raw flash image.
    pub(super) fn compile(&self, name: &str) -> Done<PathBuf> {
        let elf = self.folder.join(name).with_extension("elf");
        let image = elf.with_extension("bin");
        command::run(
            command("avr-gcc")
                .args(["-mmcu=atmega328p", "-O2", "-std=gnu11", "-Wall", "-Wextra", "-Werror", "-o"])
                .arg(&elf)
                .args([&format!("xtask/cross-check/programs/{name}.c"), "-lm"]),
        )?;
        command::run(command("avr-objcopy").args(["-O", "binary"]).args([&elf, &image]))?;
        Ok(image)
    }
}
