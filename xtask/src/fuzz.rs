//! Fuzzing with only the pinned toolchain and a C++ compiler: sets what cargo-fuzz would set.

use crate::command::{self, Done, Failure, cargo, command, output, root};
use crate::installs;
use std::fs;
use std::path::{Path, PathBuf};

/// Coverage counters for libFuzzer, only in the fuzzed code (`--target` keeps them out of build scripts).
const RUSTFLAGS: &str = "--cfg fuzzing -Cdebug-assertions -Ccodegen-units=1 -Cpasses=sancov-module \
    -Cllvm-args=-sanitizer-coverage-level=4 -Cllvm-args=-sanitizer-coverage-inline-8bit-counters \
    -Cllvm-args=-sanitizer-coverage-pc-table -Cllvm-args=-sanitizer-coverage-trace-compares";

/// Every target, and the folders whose files it starts from.
const TARGETS: [(&str, &[&str]); 12] = [
    ("motion_file", &["examples"]),
    ("formula", &["fuzz/seeds/formula"]),
    ("table", &["fuzz/seeds/table"]),
    ("vcd", &["fuzz/seeds/vcd"]),
    ("saleae", &["fuzz/seeds/saleae"]),
    ("sigrok", &["fuzz/seeds/sigrok"]),
    ("steps", &["fuzz/seeds/steps"]),
    ("camera", &["fuzz/seeds/camera"]),
    ("packing", &["fuzz/seeds/packing"]),
    ("wire", &["fuzz/seeds/wire"]),
    ("winch", &["fuzz/seeds/winch"]),
    ("winch_uno", &["fuzz/seeds/winch"]),
];

/// Runs each target (or only `only`) for `seconds`. Inputs that break it stay in fuzz/artifacts.
pub(crate) fn run(seconds: u64, only: Option<&str>) -> Done {
    let targets: Vec<_> = TARGETS.into_iter().filter(|(name, _)| only.is_none_or(|only| only == *name)).collect();
    if targets.is_empty() {
        let names = TARGETS.map(|(name, _)| name).join(", ");
        return Err(Failure::Check(format!("no such fuzz target; there are {names}")));
    }
    let binaries = build()?;
    let mut fuzzers = Vec::new();
    for (name, seeds) in targets {
        let corpus = made(root().join("fuzz/corpus").join(name))?;
        let artifacts = made(root().join("fuzz/artifacts").join(name))?;
        let mut fuzzer = command(binaries.join(name));
        // libFuzzer writes new inputs to the first folder, and only reads the others.
        fuzzer.arg(corpus).args(seeds).arg(format!("-max_total_time={seconds}"));
        // A hang is a failure, too: no input of a few kilobytes needs seconds.
        fuzzer.args(["-timeout=10", "-rss_limit_mb=2048", "-print_final_stats=1", "-verbosity=0"]);
        fuzzer.arg(format!("-artifact_prefix={}/", artifacts.display()));
        fuzzers.push(fuzzer);
    }
    command::run_side_by_side(fuzzers)
}

/// Builds all targets. Gives the folder of the binaries.
fn build() -> Done<PathBuf> {
    let host = output(command("rustc").args(["--print", "host-tuple"]))?.trim().to_owned();
    let target_dir = root().join("fuzz/target");
    // libFuzzer itself is C++.
    command::run(command("c++").arg("--version")).or_else(|_| installs::debian(&[("g++", "/usr/bin/g++")]))?;
    command::run(
        cargo("build --release --manifest-path fuzz/Cargo.toml --target")
            .arg(&host)
            .env("RUSTFLAGS", RUSTFLAGS)
            .env("CARGO_TARGET_DIR", &target_dir),
    )?;
    Ok(target_dir.join(host).join("release"))
}

fn made(folder: PathBuf) -> Done<PathBuf> {
    let failure = |folder: &Path, why| Failure::File { path: folder.to_path_buf(), why };
    fs::create_dir_all(&folder).map_err(|why| failure(&folder, why))?;
    Ok(folder)
}
