//! Firmware: built, measured, and its image written where `pulsetrain-board` takes it from.
//!
//! The committed image is what users run; it is small, and the same bytes come out of the same toolchain on any machine:
//! no path is in it.

use crate::command::{self, Done, Failure, command, install_debian, output, root, run, target_dir};
use std::fs;
use std::process::Command;

/// Flash that is the firmware's: 32 KiB less the Uno's bootloader (optiboot, 512 bytes).
const FLASH: u64 = 32_768 - 512;
/// Bytes of RAM.
const RAM: u64 = 2048;

/// Builds the Uno's firmware, prints what it takes and writes crates/board/images/uno.hex.
pub(crate) fn uno() -> Done {
    if command::run(command("avr-gcc").arg("--version")).is_err() {
        // libgcc and the start-up code come with them.
        install_debian("gcc-avr")?;
        install_debian("avr-libc")?;
    }
    let built = target_dir().join("uno");
    run(build()?
        .current_dir(root().join("firmware/uno"))
        .args(["build", "--release", "--locked", "-Zbuild-std=core", "--target-dir"])
        .arg(&built)
        // Nothing of this build's surroundings may reach that one.
        .env_remove("RUSTFLAGS")
        .env_remove("CARGO_ENCODED_RUSTFLAGS")
        .env_remove("CARGO_TARGET_AVR_NONE_RUSTFLAGS")
        .env_remove("CARGO_BUILD_TARGET")
        .env_remove("CARGO_BUILD_RUSTFLAGS"))?;
    let elf = built.join("avr-none/release/uno.elf");
    let sections = output(command("avr-size").arg("-A").arg(&elf))?;
    let folder = root().join("crates/board/images");
    fs::create_dir_all(&folder).map_err(|why| Failure::File { path: folder.clone(), why })?;
    run(command("avr-objcopy").args(["-O", "ihex", "-R", ".eeprom"]).arg(&elf).arg(folder.join("uno.hex")))?;
    print!("{}", table(&sections)?);
    Ok(())
}

/// Assembles the tick of the Uno's winch by itself, for a test on the emulated chip, and writes
/// crates/board/images/winch_tick.hex.
pub(crate) fn winch_tick() -> Done {
    let elf = target_dir().join("winch_tick.elf");
    run(command("avr-gcc")
        .args(["-mmcu=atmega328p", "-nostdlib", "-x", "assembler"])
        .arg(root().join("firmware/uno/src/winch/tick.s"))
        .arg("-o")
        .arg(&elf))?;
    print!("{}", table(&output(command("avr-size").arg("-A").arg(&elf))?)?);
    run(command("avr-objcopy").args(["-O", "ihex"]).arg(&elf).arg(root().join("crates/board/images/winch_tick.hex")))
}

/// A cargo that can build core for AVR, for which no compiled one exists: the pinned toolchain with its sources, which
/// rustup brings; or, without rustup, Debian's.
fn build() -> Done<Command> {
    let mut cargo = if run(command("rustup").args(["component", "add", "rust-src"])).is_ok() {
        command("cargo")
    } else {
        // Debian's rustc-web and cargo-web; they cannot be installed beside rustup.
        install_debian("rust-web-src")?;
        command("/usr/bin/cargo")
    };
    // This xtask was itself started by a cargo, whose choice of toolchain would go on.
    cargo.env_remove("RUSTUP_TOOLCHAIN").env_remove("CARGO").env("RUSTC_BOOTSTRAP", "1");
    Ok(cargo)
}

/// What an image takes, from avr-size's list of sections.
fn table(sections: &str) -> Done<String> {
    let size = |name: &str| -> u64 {
        let line = sections.lines().find(|line| line.split_whitespace().next() == Some(name));
        line.and_then(|line| line.split_whitespace().nth(1)).and_then(|size| size.parse().ok()).unwrap_or(0)
    };
    let (code, pages) = (size(".text"), size(".pages"));
    let (data, zeroed, note) = (size(".data"), size(".bss"), size(".noinit"));
    if code == 0 {
        return Err(Failure::Check(format!("no .text in what avr-size says:\n{sections}")));
    }
    let flash = code + data;
    let ram = pages + data + zeroed + note;
    Ok(format!(
        "flash  {flash:>6} of {FLASH} bytes: code {code}, initial values {data}\n\
         RAM    {ram:>6} of {RAM} bytes: pages {pages}, variables {data} + {zeroed} + {note}\n\
         stack  {:>6} bytes are left\n",
        RAM.saturating_sub(ram)
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_adds_up() {
        let sections = "uno.elf  :\nsection  size  addr\n.data  700  8389632\n.pages  768  8388864\n\
                        .text  28000  0\n.bss  300  8390332\n.noinit  4  8390632\nTotal  29772\n";
        let table = table(sections).expect("has .text");
        assert!(table.contains("flash   28700 of 32256"), "{table}");
        assert!(table.contains("stack     276 bytes"), "{table}");
    }

    #[test]
    fn an_empty_list_is_no_table() {
        assert!(table("uno.elf :\n").is_err());
    }
}
