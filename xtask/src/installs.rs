//! Everything that tests and checks need from Debian, PyPI and npm, installed once and in one piece.

use crate::command::{self, Done, Failure, command, root, target_dir};
use std::fs;
use std::path::{Path, PathBuf};

/// A package of Debian, and a file by which it is recognised when it is installed.
pub(crate) type Package = (&'static str, &'static str);

/// What the Uno's firmware is built with.
pub(crate) const AVR: [Package; 2] = [("gcc-avr", "/usr/bin/avr-gcc"), ("avr-libc", "/usr/lib/avr/include/avr/io.h")];
/// Others' software for the Uno, which tests run on the virtual one.
pub(crate) const ARDUINO: [Package; 3] = [
    ("arduino-core-avr", "/usr/share/arduino/hardware/arduino/avr/boards.txt"),
    ("avrdude", "/usr/bin/avrdude"),
    ("gcc-avr", "/usr/bin/avr-g++"),
];
/// The emulator that the Uno's is compared with.
pub(crate) const SIMAVR: [Package; 3] = [
    ("gcc", "/usr/bin/cc"),
    ("libsimavr-dev", "/usr/include/simavr/sim_avr.h"),
    ("libelf-dev", "/usr/include/libelf.h"),
];
/// The emulator that a Cortex-M3's exceptions are compared with.
pub(crate) const QEMU: Package = ("qemu-system-arm", "/usr/bin/qemu-system-arm");
/// The browser of the page's tests.
pub(crate) const CHROMIUM: Package = ("chromium", "/usr/bin/chromium");
/// What makes the clips of films.
pub(crate) const FFMPEG: Package = ("ffmpeg", "/usr/bin/ffmpeg");
/// The library of the feature `midi`.
const ALSA: [Package; 2] = [("pkg-config", "/usr/bin/pkg-config"), ("libasound2-dev", "/usr/include/alsa/asoundlib.h")];
/// With it, `python3 -m venv` makes an environment that has pip.
const VENV: &str = "python3-venv";

/// The packages of PyPI for the tests: a serial port, plots, packets of OSC, types, films and their clips, S-curves, a
/// Cortex-M3.
const PYTHON: [&str; 8] = [
    "pyserial==3.5",
    "matplotlib==3.11.2",
    "python-osc==1.10.2",
    "mypy==2.4.1",
    "opencv-python-headless==5.0.0.93",
    "av==18.1.0",
    "ruckig==0.19.4",
    "unicorn==2.1.4",
];

/// Installs all that the gate needs.
pub(crate) fn all() -> Done {
    if cfg!(target_os = "linux") {
        let all = AVR.iter().chain(&ARDUINO).chain(&SIMAVR).chain(&ALSA).chain([&CHROMIUM, &FFMPEG, &QEMU]);
        debian(&all.copied().collect::<Vec<_>>())?;
    }
    python()?;
    npm("xtask/page", "page")?;
    npm("xtask/cross-check", "cross-check").map(drop)
}

/// Installs the library of the feature `midi`.
pub(crate) fn alsa() -> Done {
    if cfg!(target_os = "linux") { debian(&ALSA) } else { Ok(()) }
}

/// Installs the packages that are missing. If that fails, says what to install.
pub(crate) fn debian(packages: &[Package]) -> Done {
    let missing = packages.iter().filter(|(_, file)| !Path::new(file).exists());
    let mut names: Vec<_> = missing.map(|(name, _)| *name).collect();
    names.sort_unstable();
    names.dedup();
    if names.is_empty() { Ok(()) } else { apt(&names) }
}

fn apt(names: &[&str]) -> Done {
    // For root sudo may be missing. For a user apt-get alone is refused.
    let sudo: &[&str] = if command::output(command("id").arg("-u")).is_ok_and(|id| id.trim() == "0") {
        &[]
    } else {
        &["sudo", "--non-interactive"]
    };
    let apt = |arguments: &[&str]| {
        let words = [sudo, &["apt-get"], arguments].concat();
        command::run(command(words[0]).args(&words[1..]))
    };
    // A fresh image has no lists of packages. Two stages that install wait for each other.
    apt(&["--quiet=2", "update"])
        .and_then(|()| apt(&[&["-o", "DPkg::Lock::Timeout=300", "--quiet=2", "install", "--yes"], names].concat()))
        .map_err(|_| Failure::Check(format!("install what Debian calls {}, then run this again", names.join(", "))))
}

/// The path of a Python that has all of [`PYTHON`], in an environment of its own below the target folder.
pub(crate) fn python() -> Done<PathBuf> {
    let environment = target_dir().join("python");
    let bin = environment.join(if cfg!(windows) { "Scripts" } else { "bin" });
    let python = bin.join("python");
    once(&environment, &PYTHON.join("\n"), || {
        // A Python without pip is left from an attempt that failed.
        if !bin.join(if cfg!(windows) { "pip.exe" } else { "pip" }).exists() {
            let system = if cfg!(windows) { "python" } else { "python3" };
            let make = || command::run(command(system).args(["-m", "venv"]).arg(&environment));
            make().or_else(|_| apt(&[VENV]).and_then(|()| make()))?;
        }
        let pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check"];
        command::run(command(&python).args(pip).args(PYTHON))
    })?;
    Ok(python)
}

/// Installs the packages of `folder`'s package-lock.json below the target folder. Gives that folder.
pub(crate) fn npm(folder: &str, name: &str) -> Done<PathBuf> {
    let (from, to) = (root().join(folder), target_dir().join(name));
    let lock = from.join("package-lock.json");
    let locked = fs::read_to_string(&lock).map_err(|why| Failure::File { path: lock, why })?;
    fs::create_dir_all(&to).map_err(|why| Failure::File { path: to.clone(), why })?;
    once(&to, &locked, || {
        let version = || command::output(command("npm").arg("--version"));
        version().or_else(|_| apt(&["npm"]).and_then(|()| version()))?;
        for file in ["package.json", "package-lock.json"] {
            fs::copy(from.join(file), to.join(file)).map_err(|why| Failure::File { path: to.join(file), why })?;
        }
        command::run(command("npm").args(["ci", "--no-audit", "--no-fund", "--silent"]).current_dir(&to))
    })?;
    Ok(to)
}

/// Does `install` unless it was done in this folder for the same `wanted`.
fn once(folder: &Path, wanted: &str, install: impl FnOnce() -> Done) -> Done {
    let stamp = folder.join("installed.txt");
    if fs::read_to_string(&stamp).is_ok_and(|installed| installed == wanted) {
        return Ok(());
    }
    install()?;
    fs::write(&stamp, wanted).map_err(|why| Failure::File { path: stamp, why })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_installed_twice() {
        let folder = target_dir().join("installs-test");
        fs::create_dir_all(&folder).expect("a folder for the test");
        let _ = fs::remove_file(folder.join("installed.txt"));
        let mut count = 0;
        let mut install = |wanted: &str| {
            once(&folder, wanted, || {
                count += 1;
                Ok(())
            })
            .expect("a sound install")
        };
        install("a==1");
        install("a==1");
        install("a==2");
        assert_eq!(count, 2);
        // What failed is tried again.
        assert!(once(&folder, "a==3", || Err(Failure::Check("no net".to_owned()))).is_err());
        let mut again = false;
        once(&folder, "a==3", || {
            again = true;
            Ok(())
        })
        .expect("a sound install");
        assert!(again);
    }
}
