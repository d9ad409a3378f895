//! Builds the Uno's firmware, measures it, and writes its image where `pulsetrain-board` reads it.
//!
//! Users run the committed image. It is small, and it contains no path, so the same toolchain makes the same bytes on
//! any machine.

mod bytes;
pub(crate) mod pico;

use crate::command::{Done, Failure, command, output, root, run, target_dir};
use crate::installs;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Bytes of flash for the firmware: 32 KiB less the Uno's bootloader (optiboot, 512 bytes).
const FLASH: u64 = 32_768 - 512;
/// Bytes of RAM.
const RAM: u64 = 2048;

/// The folder of the images that users flash and virtual boards run. It lies inside the crate, so that the crate's
/// package has them.
pub(crate) const IMAGES: &str = "crates/board/images";
/// The folder of files that only tests need: maps of symbols, images of parts of the firmware.
const TEST_DATA: &str = "testdata";
/// The programs of firmware/uno. Their images have the same names.
pub(crate) const PROGRAMS: [&str; 4] = ["uno", "uno-winch", "uno-verbs", "uno-baked"];
/// The folder of the programs' and their engine's sources.
const SOURCES: &str = "firmware/uno/src/";
/// The winch's assembly alone is committed, too, for a test on the emulated chip.
const WINCH: &str = "testdata/winch.hex";

/// Bytes of flash that each image must leave free for the next changes of the firmware.
const FREE: u64 = 500;

/// A program that was built.
struct Built {
    name: &'static str,
    /// Its image and its map of symbols, with their paths in the repository.
    files: [(String, String); 2],
    size: Size,
    /// Bytes of flash by module.
    bytes: bytes::Bytes,
}

/// Builds the Uno's firmware, prints its sizes, and writes the committed images.
pub(crate) fn uno() -> Done {
    let built = built_uno()?;
    print!("{}", table(&built));
    for (name, text) in built.iter().flat_map(|built| &built.files) {
        write(&root().join(name), text)?;
    }
    write(&root().join(WINCH), &read(built_winch()?)?)?;
    has_room(&built)
}

/// Builds the Uno's firmware, and prints the images' sizes and each module's number of lines; with a commit, also that
/// commit's numbers.
pub(crate) fn sizes(before: Option<&str>) -> Done {
    let built = built_uno()?;
    let before = before.map(lines_at).transpose()?;
    let bytes: Vec<_> = built.iter().map(|built| (built.name, built.bytes.clone())).collect();
    print!("{}\n{}\n{}", table(&built), bytes::table(&bytes), lines_table(&lines_now()?, before.as_ref()));
    has_room(&built)
}

fn write(path: &Path, text: &str) -> Done {
    let written = path.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::write(path, text));
    written.map_err(|why| Failure::File { path: path.to_owned(), why })
}

/// Builds the Uno's firmware, and fails if a committed file differs.
pub(crate) fn check_uno() -> Done {
    print!("{}", measure_uno()?);
    Ok(())
}

/// Builds the Uno's firmware, and gives the programs' sizes as a table.
pub(crate) fn measure_uno() -> Done<String> {
    let programs = built_uno()?;
    for (name, built) in programs.iter().flat_map(|program| &program.files) {
        same(name, &read(root().join(name))?, built)?;
    }
    same(WINCH, &read(root().join(WINCH))?, &read(built_winch()?)?)?;
    has_room(&programs)?;
    Ok(table(&programs))
}

/// Number of lines of each module.
type Lines = BTreeMap<String, usize>;

/// A module of firmware/uno/src by its file, without the folder: files have moved between folders.
fn module(path: &str) -> String {
    let path = path.strip_prefix("engine/").unwrap_or(path);
    path.strip_prefix("bin/").and_then(|path| path.split_once('/')).map_or(path, |(_, path)| path).to_owned()
}

fn lines_now() -> Done<Lines> {
    let mut lines = Lines::new();
    for path in output(command("git").args(["ls-files", SOURCES]))?.lines() {
        *lines.entry(module(path.trim_start_matches(SOURCES))).or_default() += read(root().join(path))?.lines().count();
    }
    Ok(lines)
}

fn lines_at(commit: &str) -> Done<Lines> {
    let mut lines = Lines::new();
    for path in output(command("git").args(["ls-tree", "-r", "--name-only", commit, SOURCES]))?.lines() {
        let text = output(command("git").args(["show", &format!("{commit}:{path}")]))?;
        *lines.entry(module(path.trim_start_matches(SOURCES))).or_default() += text.lines().count();
    }
    Ok(lines)
}

fn lines_table(now: &Lines, before: Option<&Lines>) -> String {
    let (mut text, empty) = (format!("{:24} {:>6}", "lines of", "now"), Lines::new());
    text.push_str(if before.is_some() { " before\n" } else { "\n" });
    let modules: BTreeSet<_> = now.keys().chain(before.unwrap_or(&empty).keys()).collect();
    let mut row = |module: &str, now: usize, then: Option<usize>| {
        let then = then.map_or_else(String::new, |lines| format!(" {lines:>6}"));
        text.push_str(&format!("{module:24} {now:>6}{then}\n"));
    };
    for module in modules {
        let of = |lines: &Lines| lines.get(module).copied().unwrap_or(0);
        row(module, of(now), before.map(of));
    }
    row("all", now.values().sum(), before.map(|lines| lines.values().sum()));
    text
}

/// The modules with their texts.
fn sources() -> Done<Vec<(String, String)>> {
    let files = output(command("git").args(["ls-files", SOURCES]))?;
    files.lines().map(|path| Ok((module(path.trim_start_matches(SOURCES)), read(root().join(path))?))).collect()
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
    // libgcc and the start-up code come with avr-gcc.
    installs::debian(&installs::AVR)?;
    let built = target_dir().join("uno");
    run(alone(&mut build()?)
        .current_dir(root().join("firmware/uno"))
        .args(["build", "--release", "--locked", "-Zbuild-std=core", "--target-dir"])
        .arg(&built))?;
    let sources = sources()?;
    let program = |name: &'static str| -> Done<Built> {
        let elf = built.join(format!("avr-none/release/{name}.elf"));
        let sections = output(command("avr-size").arg("-A").arg(&elf))?;
        let image = built.join(format!("{name}.hex"));
        run(command("avr-objcopy").args(["-O", "ihex", "-R", ".eeprom"]).arg(&elf).arg(&image))?;
        let said = output(command("avr-nm").arg("-n").arg(&elf))?;
        let (symbols, bytes) = (symbols(&said), bytes::by_module(&said, &sources));
        let files = [(format!("{IMAGES}/{name}.hex"), read(image)?), (format!("{TEST_DATA}/{name}.sym"), symbols)];
        Ok(Built { name, files, size: Size::of(&sections)?, bytes })
    };
    PROGRAMS.into_iter().map(program).collect()
}

/// A map of symbols from the output of avr-nm: address in flash or RAM, bytes, and name. It has the routines and
/// variables of assembly, and those of Rust with fixed names. Other names change with the compiler.
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

/// Assembles the part that only the Uno's winch has. Gives the image's path.
fn built_winch() -> Done<PathBuf> {
    let (elf, image) = (target_dir().join("winch.elf"), target_dir().join("winch.hex"));
    run(command("avr-gcc")
        .args(["-mmcu=atmega328p", "-nostdlib", "-x", "assembler"])
        .arg(root().join("crates/board/tests/it/chips/winch_entries.s"))
        .args(
            ["tick.s", "text.s", "command.s", "reply.s"]
                .map(|name| root().join("firmware/uno/src/bin/uno-winch/winch").join(name)),
        )
        .arg("-o")
        .arg(&elf))?;
    run(command("avr-objcopy").args(["-O", "ihex"]).arg(&elf).arg(&image))?;
    Ok(image)
}

/// A cargo that can build core for AVR, for which no compiled core exists: the pinned toolchain with its sources from
/// rustup, or Debian's if there is no rustup.
fn build() -> Done<Command> {
    let mut cargo = if run(command("rustup").args(["component", "add", "rust-src"])).is_ok() {
        command("cargo")
    } else {
        // Debian's rustc-web and cargo-web cannot be installed together with rustup.
        installs::debian(&[("rust-web-src", "/usr/share/doc/rust-web-src")])?;
        command("/usr/bin/cargo")
    };
    // A cargo started this xtask. Its choice of toolchain must not reach the build.
    cargo.env_remove("RUSTUP_TOOLCHAIN").env_remove("CARGO").env("RUSTC_BOOTSTRAP", "1");
    Ok(cargo)
}

/// A build that no environment variable changes: an image is the same wherever it is built.
fn alone(cargo: &mut Command) -> &mut Command {
    for (name, _) in std::env::vars_os() {
        if name.to_str().is_some_and(changes_images) {
            cargo.env_remove(name);
        }
    }
    cargo
}

/// Whether an environment variable of that name changes a build.
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

/// The size of an image, bytes.
struct Size {
    flash: u64,
    /// Pages of RAM, and its variables.
    pages: u64,
    variables: u64,
}

impl Size {
    /// From the list of sections that avr-size prints.
    fn of(sections: &str) -> Done<Size> {
        let size = |name: &str| -> u64 {
            let line = sections.lines().find(|line| line.split_whitespace().next() == Some(name));
            line.and_then(|line| line.split_whitespace().nth(1)).and_then(|size| size.parse().ok()).unwrap_or(0)
        };
        let (code, data) = (size(".text"), size(".data"));
        if code == 0 {
            return Err(Failure::Check(format!("no .text in what avr-size says:\n{sections}")));
        }
        Ok(Size { flash: code + data, pages: size(".pages"), variables: data + size(".bss") + size(".noinit") })
    }

    fn free(&self) -> u64 {
        FLASH.saturating_sub(self.flash)
    }

    fn ram(&self) -> u64 {
        self.pages + self.variables
    }
}

/// The images' sizes as a table.
fn table(built: &[Built]) -> String {
    let mut text = format!(
        "{:12} {:>6} {:>6} {:>6} {:>6} {:>10} {:>6}\n",
        "bytes of", "flash", "free", "RAM", "pages", "variables", "stack"
    );
    for Built { name, size, .. } in built {
        let (free, ram, stack) = (size.free(), size.ram(), RAM.saturating_sub(size.ram()));
        let Size { flash, pages, variables } = size;
        text.push_str(&format!("{name:12} {flash:>6} {free:>6} {ram:>6} {pages:>6} {variables:>10} {stack:>6}\n"));
    }
    text
}

/// Fails if an image leaves less flash than [`FREE`].
fn has_room(built: &[Built]) -> Done {
    match built.iter().find(|built| built.size.free() < FREE) {
        Some(Built { name, size, .. }) => Err(Failure::Check(format!(
            "{name} leaves {} bytes of flash, and {FREE} are promised: take something out of it",
            size.free()
        ))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sections(code: u64) -> Size {
        let text = format!(
            "uno.elf  :\nsection  size  addr\n.data  700  8389632\n.pages  768  8388864\n\
             .text  {code}  0\n.bss  300  8390332\n.noinit  4  8390632\nTotal  29772\n"
        );
        Size::of(&text).expect("has .text")
    }

    fn built(code: u64) -> [Built; 1] {
        [Built { name: "uno", files: Default::default(), size: sections(code), bytes: bytes::Bytes::new() }]
    }

    #[test]
    fn the_table_adds_up() {
        let table = table(&built(28_000));
        let row: Vec<_> = table.lines().nth(1).expect("a row").split_whitespace().collect();
        assert_eq!(row, ["uno", "28700", "3556", "1772", "768", "1004", "276"]);
    }

    #[test]
    fn an_image_leaves_what_is_promised() {
        assert!(has_room(&built(FLASH - 700 - FREE)).is_ok());
        let said = has_room(&built(FLASH - 700 - FREE + 1)).expect_err("a byte too few").to_string();
        assert!(said.contains("uno leaves 499 bytes"), "{said}");
    }

    #[test]
    fn lines_are_a_modules_wherever_it_lies() {
        assert_eq!(module("steps/ring.rs"), module("engine/steps/ring.rs"));
        assert_eq!(module("winch/tick.s"), module("bin/uno-winch/winch/tick.s"));
        let [now, before] = [[("ring.rs", 3), ("new.rs", 1)], [("ring.rs", 5), ("old.rs", 7)]]
            .map(|lines| lines.into_iter().map(|(name, lines)| (name.to_owned(), lines)).collect());
        let table = lines_table(&now, Some(&before));
        let rows: Vec<Vec<_>> = table.lines().map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(rows[1..], [["new.rs", "1", "0"], ["old.rs", "0", "7"], ["ring.rs", "3", "5"], ["all", "4", "12"]]);
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
        assert!(Size::of("uno.elf :\n").is_err());
    }
}
