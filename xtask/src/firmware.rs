//! Firmware: built, measured, and its image written where `pulsetrain-board` takes it from.
//!
//! The committed image is what users run; it is small, and the same bytes come out of the same toolchain on any machine:
//! no path is in it.

pub(crate) mod pico;

use crate::command::{self, Done, Failure, command, install_debian, output, root, run, target_dir};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Flash that is the firmware's: 32 KiB less the Uno's bootloader (optiboot, 512 bytes).
const FLASH: u64 = 32_768 - 512;
/// Bytes of RAM.
const RAM: u64 = 2048;

/// Where images are committed, each with its map of symbols beside it.
const IMAGES: &str = "crates/board/images";
/// The programs of firmware/uno, which its images are called after.
const PROGRAMS: [&str; 4] = ["uno", "uno-winch", "uno-verbs", "uno-baked"];
/// Of the winch the assembly alone, committed for a test on the emulated chip.
const WINCH: &str = "crates/board/images/winch.hex";

/// A program that was built.
struct Built {
    /// Its image and its map of symbols, by their names in [`IMAGES`].
    files: [(String, String); 2],
    /// What it takes, as text.
    table: String,
}

/// Builds the Uno's firmware, prints what it takes and writes the committed images.
pub(crate) fn uno() -> Done {
    for Built { files, table } in built_uno()? {
        print!("{table}");
        for (name, text) in files {
            write(&root().join(IMAGES).join(name), &text)?;
        }
    }
    print!("{}", lines_of_source()?);
    write(&root().join(WINCH), &read(built_winch()?)?)
}

fn write(path: &Path, text: &str) -> Done {
    let written = path.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::write(path, text));
    written.map_err(|why| Failure::File { path: path.to_owned(), why })
}

/// Builds the Uno's firmware, and fails when something committed is another one.
pub(crate) fn check_uno() -> Done {
    print!("{}", measure_uno()?);
    Ok(())
}

/// The same, and gives what the programs take, as text.
pub(crate) fn measure_uno() -> Done<String> {
    let mut text = String::new();
    for Built { files, table } in built_uno()? {
        text.push_str(&table);
        for (name, built) in files {
            let committed = format!("{IMAGES}/{name}");
            same(&committed, &read(root().join(&committed))?, &built)?;
        }
    }
    same(WINCH, &read(root().join(WINCH))?, &read(built_winch()?)?)?;
    Ok(text + &lines_of_source()?)
}

/// How many lines the sources have, as text.
fn lines_of_source() -> Done<String> {
    let mut text = String::new();
    for folder in ["engine", "bin/uno", "bin/uno-winch", "bin/uno-verbs", "bin/uno-baked"] {
        let lines = lines_in(&root().join("firmware/uno/src").join(folder))?;
        text.push_str(&format!("{lines:>6} lines in firmware/uno/src/{folder}\n"));
    }
    Ok(text)
}

/// Lines of all files in a folder.
fn lines_in(folder: &Path) -> Done<usize> {
    let failed = |why| Failure::File { path: folder.to_owned(), why };
    let mut lines = 0;
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        lines += if path.is_dir() { lines_in(&path)? } else { read(path)?.lines().count() };
    }
    Ok(lines)
}

fn read(path: PathBuf) -> Done<String> {
    fs::read_to_string(&path).map_err(|why| Failure::File { path, why })
}

fn same(image: &str, committed: &str, built: &str) -> Done {
    let (committed, built): (Vec<_>, Vec<_>) = (committed.lines().collect(), built.lines().collect());
    if committed == built {
        return Ok(());
    }
    let first = committed.iter().zip(&built).take_while(|(a, b)| a == b).count();
    Err(Failure::Check(format!(
        "{image} is not what firmware/uno builds: line {} is the first that differs, of {} committed and {} built. Run \
         `cargo xtask firmware`, and commit it with the change. (If nothing was changed, another version of rustc, \
         avr-gcc or avr-libc built it.)",
        first + 1,
        committed.len(),
        built.len()
    )))
}

/// Builds the Uno's firmware under `target/`.
fn built_uno() -> Done<Vec<Built>> {
    if command::run(command("avr-gcc").arg("--version")).is_err() {
        // libgcc and the start-up code come with them.
        install_debian("gcc-avr")?;
        install_debian("avr-libc")?;
    }
    let built = target_dir().join("uno");
    run(alone(&mut build()?)
        .current_dir(root().join("firmware/uno"))
        .args(["build", "--release", "--locked", "-Zbuild-std=core", "--target-dir"])
        .arg(&built))?;
    let program = |name: &str| -> Done<Built> {
        let elf = built.join(format!("avr-none/release/{name}.elf"));
        let sections = output(command("avr-size").arg("-A").arg(&elf))?;
        let image = built.join(format!("{name}.hex"));
        run(command("avr-objcopy").args(["-O", "ihex", "-R", ".eeprom"]).arg(&elf).arg(&image))?;
        let symbols = symbols(&output(command("avr-nm").arg("-n").arg(&elf))?);
        let files = [(format!("{name}.hex"), read(image)?), (format!("{name}.sym"), symbols)];
        Ok(Built { files, table: format!("{name}\n{}", table(&sections)?) })
    };
    PROGRAMS.into_iter().map(program).collect()
}

/// A map of symbols, from what avr-nm says: of routines and variables of assembly, and of Rust's that have names for it, the address, of the
/// flash or of RAM, bytes, and the name. Others' names change with the compiler.
fn symbols(said: &str) -> String {
    let mut map = String::new();
    for line in said.lines() {
        let mut fields = line.split_whitespace();
        let (Some(address), Some(kind), Some(name)) = (fields.next(), fields.next(), fields.next()) else { continue };
        let Ok(address) = u32::from_str_radix(address, 16) else { continue };
        let (memory, address) = match kind {
            "t" | "T" => ("flash", address),
            "b" | "B" | "d" | "D" if address >= 0x80_0100 => ("ram", address - 0x80_0000),
            _ => continue,
        };
        if !name.starts_with(['_', '.']) || name.starts_with("__vector") {
            map.push_str(&format!("{memory:5} {address:#06x} {name}\n"));
        }
    }
    map
}

/// Assembles what the Uno's winch has of its own. Gives the image's place.
fn built_winch() -> Done<PathBuf> {
    let (elf, image) = (target_dir().join("winch.elf"), target_dir().join("winch.hex"));
    run(command("avr-gcc")
        .args(["-mmcu=atmega328p", "-nostdlib", "-x", "assembler"])
        .arg(root().join("crates/board/tests/winch_entries.s"))
        .args(
            ["tick.s", "text.s", "command.s", "reply.s"]
                .map(|name| root().join("firmware/uno/src/bin/uno-winch/winch").join(name)),
        )
        .arg("-o")
        .arg(&elf))?;
    run(command("avr-objcopy").args(["-O", "ihex"]).arg(&elf).arg(&image))?;
    Ok(image)
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

/// A build that nothing of this one's surroundings may reach: an image is the same wherever it is built.
fn alone(cargo: &mut Command) -> &mut Command {
    for (name, _) in std::env::vars_os() {
        if name.to_str().is_some_and(changes_images) {
            cargo.env_remove(name);
        }
    }
    cargo
}

/// Whether a build is another one with that variable set.
fn changes_images(name: &str) -> bool {
    const ALL: [&str; 6] = [
        "RUSTFLAGS",
        "CARGO_ENCODED_RUSTFLAGS",
        "CARGO_INCREMENTAL",
        "CARGO_BUILD_INCREMENTAL",
        "CARGO_BUILD_RUSTFLAGS",
        "CARGO_BUILD_TARGET",
    ];
    let of_target = name.starts_with("CARGO_TARGET_") && name.ends_with("_RUSTFLAGS");
    ALL.contains(&name) || of_target || name.starts_with("CARGO_PROFILE_")
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
    fn an_image_that_is_another_is_told_with_what_to_do() {
        assert!(same("uno.hex", ":00\n:01\n", ":00\r\n:01\r\n").is_ok());
        let said = same("uno.hex", ":00\n:01\n:02\n", ":00\n:03\n").expect_err("they differ").to_string();
        assert!(said.contains("line 2 is the first") && said.contains("cargo xtask firmware"), "{said}");
        let said = same("uno.hex", ":00\n:01\n", ":00\n").expect_err("they differ").to_string();
        assert!(said.contains("line 2 is the first"), "{said}");
    }

    #[test]
    fn what_changes_an_image_is_kept_from_its_build() {
        let changing = ["CARGO_INCREMENTAL", "CARGO_PROFILE_RELEASE_OPT_LEVEL", "CARGO_TARGET_AVR_NONE_RUSTFLAGS"];
        assert!(changing.into_iter().all(changes_images));
        assert!(!["PATH", "CARGO_HOME", "CARGO_TARGET_DIR", "CARGO_BUILD_JOBS"].into_iter().any(changes_images));
    }

    #[test]
    fn a_map_has_what_tests_look_for() {
        let said = "00000000 T __vectors\n00000118 t __vector_11\n00000a2c t steps_plan\n00000b00 t _RNvCs_4core\n\
                    00800100 B receive_page\n00800900 A something\n";
        assert_eq!(
            symbols(said),
            "flash 0x0000 __vectors\nflash 0x0118 __vector_11\nflash 0x0a2c steps_plan\nram   0x0100 receive_page\n"
        );
    }

    #[test]
    fn an_empty_list_is_no_table() {
        assert!(table("uno.elf :\n").is_err());
    }
}
