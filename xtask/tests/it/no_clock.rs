//! Checks that no library except a real serial port, and no test, depends on the wall clock: times are arguments.

use std::path::{Path, PathBuf};

/// Files that may read the clock: measurements, the times of progress messages, real ports, the virtual board that
/// keeps pace with real time, a live motion's schedule and the times in its log, the page's connections, which may not be slow, and the time tags of
/// OSC.
const MAY: [&str; 12] = [
    "/benches/",
    "xtask/src/accept/",
    "xtask/src/bench/",
    "xtask/src/ci.rs",
    "xtask/src/soak.rs",
    "xtask/src/test.rs",
    "xtask/src/usage.rs",
    "crates/board/src/serial.rs",
    "crates/pulsetrain/src/clock.rs",
    "crates/pulsetrain/src/osc/",
    "crates/pulsetrain/src/page/server.rs",
    "crates/pulsetrain/src/serve.rs",
];
/// Ways to read the clock, and to wait for it.
const CLOCKS: [&str; 4] = ["Instant::now", "SystemTime", "ZonedDateTime::now", "thread::sleep"];

#[test]
fn nobody_reads_the_clock() {
    let mut sources = Vec::new();
    for folder in ["crates", "xtask", "fuzz/fuzz_targets"] {
        collect(&Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(folder), &mut sources);
    }
    assert!(sources.len() > 50, "the sources are elsewhere");
    for source in sources.iter().filter(|path| !path.ends_with("no_clock.rs")) {
        let name = source.to_string_lossy().replace('\\', "/");
        let text = std::fs::read_to_string(source).expect("a source file");
        for clock in CLOCKS {
            assert!(
                MAY.iter().any(|may| name.contains(may)) || !text.contains(clock),
                "{name} reads the clock: {clock}"
            );
        }
    }
}

fn collect(folder: &Path, sources: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("a folder of the repository") {
        let path = entry.expect("a folder entry").path();
        if path.is_dir() && !path.ends_with("target") {
            collect(&path, sources);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            sources.push(path);
        }
    }
}
