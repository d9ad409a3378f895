//! The Pico's firmware: from the linker's ELF file to the UF2 file that a Pico reads.

use super::{Done, Failure, alone, command, root, run, target_dir};
use object::elf::{PT_LOAD, ProgramHeader32};
use object::read::elf::{ElfFile32, ProgramHeader as _};
use object::{LittleEndian, Object as _, ObjectSymbol as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::{env, fs};

/// Bytes of a Pico's flash without the two sectors of its settings, and its address.
const FLASH: u32 = 2040 * 1024;
const FLASH_AT: u32 = 0x1000_0000;
/// RAM, without the stack.
const RAM: u32 = 248 * 1024;

/// The firmware, and the path of its map of symbols.
const FIRMWARE: &str = "pico";
const SYMBOLS: &str = "testdata/pico.sym";
/// The committed images: the firmware, and the library's examples.
const IMAGES: [(&str, &str); 5] = [
    (FIRMWARE, "crates/board/images/pico.uf2"),
    ("examples/dds_circle", "crates/board/images/dds_circle.uf2"),
    ("examples/lorenz", "crates/board/images/lorenz.uf2"),
    ("examples/delta", "crates/board/images/delta.uf2"),
    ("examples/mailbox", "testdata/mailbox.uf2"),
];

/// Builds the firmware and its examples, prints their sizes, and writes the committed images.
pub(crate) fn build() -> Done {
    let folder = compiled()?;
    for (name, image) in IMAGES {
        let Linked { uf2, table, symbols } = linked(&folder.join(name))?;
        print!("{name}:\n{table}");
        write(root().join(image), &uf2)?;
        if name == FIRMWARE {
            write(root().join(SYMBOLS), symbols.as_bytes())?;
        }
    }
    Ok(())
}

/// Builds the firmware and its examples, and fails if a committed image differs.
pub(crate) fn check() -> Done {
    let folder = compiled()?;
    IMAGES.into_iter().try_for_each(|(name, image)| check_one(&folder, name, image))?;
    check_own()
}

/// The page that says how to write a program of one's own.
const PAGE: &str = "docs/pico.md";
/// The repository's folder as the page names it, seen from the program's folder.
const NEIGHBOUR: &str = "../pulsetrain/";

/// Builds the program of [`PAGE`] as the page says, outside of the repository, and makes a UF2 file of it.
fn check_own() -> Done {
    let path = root().join(PAGE);
    let page = fs::read_to_string(&path).map_err(|why| Failure::File { path, why })?;
    let folder = env::temp_dir().join(format!("pulsetrain-own-{}", std::process::id()));
    let done = build_own(&page, &folder);
    // A temporary file that cannot be removed does no harm.
    let _ = fs::remove_dir_all(&folder);
    done
}

fn build_own(page: &str, folder: &Path) -> Done {
    let missing =
        |what: &str| Failure::Check(format!("{PAGE} has no {what}: the program of one's own cannot be built"));
    for name in ["Cargo.toml", ".cargo/config.toml", "src/main.rs"] {
        let text = block(page, name).ok_or_else(|| missing(name))?;
        if name == "Cargo.toml" && !text.contains(NEIGHBOUR) {
            return Err(missing(NEIGHBOUR));
        }
        let path = folder.join(name);
        let written = path.parent().map_or(Ok(()), fs::create_dir_all);
        let text = text.replace(NEIGHBOUR, &format!("{}/", root().display()));
        written.and_then(|()| fs::write(&path, text)).map_err(|why| Failure::File { path, why })?;
    }
    for name in ["build.rs", "memory.ld", "Cargo.lock"] {
        let path = root().join("firmware/pico").join(name);
        fs::copy(&path, folder.join(name)).map_err(|why| Failure::File { path, why })?;
    }
    let target = target_dir().join("pico-own");
    run(command("cargo").current_dir(folder).args(["build", "--release", "--target-dir"]).arg(&target))?;
    convert(&target.join("thumbv6m-none-eabi/release/myfw"))
}

/// The block of a page whose first line is a comment that ends with that name.
fn block<'a>(page: &'a str, name: &str) -> Option<&'a str> {
    let blocks = page.split("\n```").skip(1).step_by(2).filter_map(|block| Some(block.split_once('\n')?.1));
    blocks.into_iter().find(|block| block.lines().next().and_then(|line| line.split(' ').nth(1)) == Some(name))
}

/// Makes a UF2 file next to the linker's file, and prints its size.
pub(crate) fn convert(elf: &Path) -> Done {
    let Linked { uf2, table, .. } = linked(elf)?;
    let path = elf.with_extension("uf2");
    print!("{}:\n{table}", path.display());
    write(path, &uf2)
}

fn write(path: PathBuf, bytes: &[u8]) -> Done {
    fs::write(&path, bytes).map_err(|why| Failure::File { path, why })
}

fn check_one(folder: &Path, name: &str, image: &str) -> Done {
    let Linked { uf2, table, symbols } = linked(&folder.join(name))?;
    print!("{name}:\n{table}");
    same(image, &uf2)?;
    if name == FIRMWARE { same(SYMBOLS, symbols.as_bytes()) } else { Ok(()) }
}

fn same(image: &str, built: &[u8]) -> Done {
    let path = root().join(image);
    let committed = fs::read(&path).map_err(|why| Failure::File { path, why })?;
    if committed == built {
        return Ok(());
    }
    let first = committed.iter().zip(built).take_while(|(a, b)| a == b).count();
    Err(Failure::Check(format!(
        "{image} is not what firmware/pico builds: byte {first} is the first that differs, of {} committed and {} built. Run `cargo \
         xtask firmware pico`, and commit it with the change. (If nothing was changed, another version of rustc built it.)",
        committed.len(),
        built.len()
    )))
}

/// The variable is set if this program runs in place of rustc: see [`as_rustc`].
const AS_RUSTC: &str = "PULSETRAIN_AS_RUSTC";

/// Runs rustc if cargo has started this program in its place (`RUSTC_WRAPPER`). Gives rustc's exit code.
///
/// Cargo gives each crate a hash, from which symbols get their names and functions their order. For a crate outside of
/// the workspace, such as core for the firmware's, it depends on the crate's folder. Here it depends on name and
/// version instead, so that the image is the same wherever it is built.
pub(crate) fn as_rustc() -> Option<ExitCode> {
    env::var_os(AS_RUSTC)?;
    let mut arguments = env::args().skip(1);
    let rustc = arguments.next()?;
    let of_package = |what: &str| env::var(what).unwrap_or_default();
    let metadata = format!("metadata={}-{}", of_package("CARGO_PKG_NAME"), of_package("CARGO_PKG_VERSION"));
    let arguments =
        arguments.map(|argument| if argument.starts_with("metadata=") { metadata.clone() } else { argument });
    let status = std::process::Command::new(rustc).args(arguments).status().ok()?;
    Some(if status.success() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Builds the firmware and its examples under `target/`. Gives the folder.
fn compiled() -> Done<PathBuf> {
    let target = "thumbv6m-none-eabi";
    run(command("rustup").args(["target", "add", target]))?;
    // Not in the folder of a build without this program as rustc, since cargo would use what lies there.
    let folder = target_dir().join("pico-image");
    let mut cargo = command("cargo");
    // A cargo started this xtask. Its choice of toolchain must not reach the build. `-Z location-detail` is in the
    // folder's configuration.
    cargo.env_remove("RUSTUP_TOOLCHAIN").env_remove("CARGO").env("RUSTC_BOOTSTRAP", "1");
    let this = env::current_exe().map_err(|why| Failure::File { path: "xtask".into(), why })?;
    cargo.env("RUSTC_WRAPPER", this).env(AS_RUSTC, "1");
    run(alone(&mut cargo)
        .current_dir(root().join("firmware/pico"))
        .args(["build", "--release", "--locked", "--bins", "--examples", "--target-dir"])
        .arg(&folder))?;
    Ok(folder.join(target).join("release"))
}

/// The outputs for a linked file.
struct Linked {
    uf2: Vec<u8>,
    /// Its size, in words.
    table: String,
    /// The addresses of assembly's routines and variables.
    symbols: String,
}

fn linked(path: &Path) -> Done<Linked> {
    let bytes = fs::read(path).map_err(|why| Failure::File { path: path.into(), why })?;
    let failure = |why| Failure::Check(format!("{} is no ELF file for Arm: {why}", path.display()));
    let elf = ElfFile32::parse(&*bytes).map_err(failure)?;
    let segments =
        segments(&elf).ok_or_else(|| Failure::Check(format!("{} is cut off: build it again", path.display())))?;
    Ok(Linked { uf2: uf2(&flash(&segments)?), table: table(&segments), symbols: symbols(&elf) })
}

/// A segment to load.
struct Segment<'a> {
    /// Its address while the program runs, and its address in the flash.
    address: u32,
    stored: u32,
    bytes: &'a [u8],
    /// Bytes in memory. If there are more than in the file, the rest is zeros.
    size: u32,
}

type Elf<'a> = ElfFile32<'a, LittleEndian>;

fn segments<'a>(elf: &Elf<'a>) -> Option<Vec<Segment<'a>>> {
    let endian = elf.endian();
    let loaded = elf.elf_program_headers().iter().filter(|header| header.p_type(endian) == PT_LOAD);
    let segment = |header: &ProgramHeader32<LittleEndian>| {
        Some(Segment {
            address: header.p_vaddr(endian),
            stored: header.p_paddr(endian),
            bytes: header.data(endian, elf.data()).ok()?,
            size: header.p_memsz(endian),
        })
    };
    loaded.map(segment).collect()
}

/// A line for each global symbol of assembly: address and name. Rust's symbols change with the compiler.
fn symbols(elf: &Elf<'_>) -> String {
    let global = elf.symbols().filter(|symbol| symbol.is_global() && symbol.is_definition());
    let mut all: Vec<_> = global.filter_map(|symbol| Some((symbol.address() & !1, symbol.name().ok()?))).collect();
    all.retain(|(_, name)| !name.starts_with('_'));
    all.sort_unstable();
    all.iter().map(|(address, name)| format!("{address:#010x} {name}\n")).collect()
}

/// The contents of the flash from its beginning.
fn flash(segments: &[Segment<'_>]) -> Done<Vec<u8>> {
    let mut flash = Vec::new();
    for Segment { stored, bytes, .. } in segments.iter().filter(|segment| !segment.bytes.is_empty()) {
        let outside = || Failure::Check(format!("{} bytes at {stored:#x} are not in the flash", bytes.len()));
        let start = stored.checked_sub(FLASH_AT).filter(|start| *start < FLASH).ok_or_else(outside)? as usize;
        let end = start + bytes.len();
        if end > FLASH as usize {
            return Err(outside());
        }
        if flash.len() < end {
            flash.resize(end, 0);
        }
        flash[start..end].copy_from_slice(bytes);
    }
    Ok(flash)
}

/// Blocks of 512 bytes with 256 bytes of the flash each: github.com/microsoft/uf2, README.
///
/// The emulator has a writer, too, for `bake`. But xtask builds before the other crates, so it uses none of them
/// (ARCHITECTURE.md).
fn uf2(flash: &[u8]) -> Vec<u8> {
    const PAYLOAD: usize = 256;
    const HAS_FAMILY: u32 = 0x2000;
    const RP2040: u32 = 0xe48b_ff56;
    let blocks = flash.chunks(PAYLOAD);
    let count = blocks.len() as u32;
    let mut file = Vec::new();
    for (number, bytes) in (0..).zip(blocks) {
        let address = FLASH_AT + number * PAYLOAD as u32;
        for word in [0x0a32_4655, 0x9e5d_5157, HAS_FAMILY, address, PAYLOAD as u32, number, count, RP2040] {
            file.extend(word.to_le_bytes());
        }
        let mut data = [0; 476];
        data[..bytes.len()].copy_from_slice(bytes);
        file.extend(data);
        file.extend(0x0ab1_6f30_u32.to_le_bytes());
    }
    file
}

/// The image's size, in words.
fn table(segments: &[Segment<'_>]) -> String {
    let flash: usize = segments.iter().map(|segment| segment.bytes.len()).sum();
    let in_ram = segments.iter().filter(|segment| segment.address >> 24 == 0x20);
    let (loaded, all) =
        in_ram.fold((0, 0), |(loaded, all), segment| (loaded + segment.bytes.len(), all + segment.size));
    format!(
        "flash  {flash:>6} of {FLASH} bytes\nRAM    {all:>6} of {RAM} bytes: program {loaded}, the rest zeros at first; stack 16384 \
         beside it\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An ELF file with one segment, which is stored at the flash's beginning and runs in RAM.
    fn elf(bytes: &[u8]) -> Vec<u8> {
        let mut elf = vec![0; 52];
        elf[..7].copy_from_slice(b"\x7fELF\x01\x01\x01");
        elf[28] = 52;
        elf[42] = 32;
        elf[44] = 1;
        let len = bytes.len() as u32;
        for word in [1, 84, 0x2000_0000, FLASH_AT, len, len + 8, 5, 4] {
            elf.extend(word.to_le_bytes());
        }
        elf.extend(bytes);
        elf
    }

    #[test]
    fn bytes_go_where_they_are_stored() {
        let elf = elf(&[7; 300]);
        let segments = segments(&Elf::parse(&*elf).expect("it is one")).expect("a whole file");
        let file = uf2(&flash(&segments).expect("inside"));
        assert_eq!(file.len(), 2 * 512);
        assert_eq!(file[12..16], FLASH_AT.to_le_bytes());
        assert_eq!(file[512 + 12..512 + 16], (FLASH_AT + 256).to_le_bytes());
        assert_eq!((&file[32..288], file[512 + 32 + 43], file[512 + 32 + 44]), (&[7; 256][..], 7, 0));
        assert!(table(&segments).contains("RAM       308 of 253952 bytes: program 300"), "{}", table(&segments));
    }

    #[test]
    fn files_that_are_cut_off_are_refused() {
        let elf = elf(&[7; 300]);
        assert!(segments(&Elf::parse(&elf[..elf.len() - 1]).expect("its head is whole")).is_none());
        assert!(Elf::parse(&b"\x7fELF\x02\x01"[..]).is_err());
    }
}
