//! The program in a process with bounds on memory, processor time and the size of files, for inputs that must not take more of them.
#![cfg(target_os = "linux")]

use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

/// What a process may take. It is ended when it takes more: then its code is none, or its message that of an allocation that failed.
#[derive(Clone, Copy)]
pub(crate) struct Bounds {
    /// Address space, MB. The program itself, its threads' stacks and the system's libraries take some 300.
    pub(crate) memory_mb: u32,
    /// Processor time, s.
    pub(crate) processor_s: u32,
    /// The largest file that it may write, blocks of 512 bytes.
    pub(crate) file_blocks: u32,
}

impl Default for Bounds {
    fn default() -> Bounds {
        Bounds { memory_mb: 1500, processor_s: 10, file_blocks: 2_000_000 }
    }
}

/// How long a process may wait for something that does not come. Nothing is measured by it: it only ends tests that fail.
const PATIENCE: Duration = Duration::from_secs(120);

/// Runs the program in a folder, with this standard input.
pub(crate) fn bounded(folder: &Path, bounds: Bounds, arguments: &[&str], input: &[u8]) -> Output {
    let Bounds { memory_mb, processor_s, file_blocks } = bounds;
    let script = format!(
        "trap '' XFSZ; ulimit -v {}; ulimit -t {processor_s}; ulimit -f {file_blocks}; exec timeout {} \"$0\" \"$@\"",
        u64::from(memory_mb) * 1024,
        PATIENCE.as_secs()
    );
    let mut command = Command::new("sh");
    command.args(["-c", &script, env!("CARGO_BIN_EXE_pulsetrain")]).args(arguments).current_dir(folder);
    command.env("XDG_RUNTIME_DIR", folder).env("XDG_STATE_HOME", folder);
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut to_child = child.stdin.take().unwrap();
    let input = input.to_vec();
    // A process that ends before it has read all is not wrong.
    let writer = std::thread::spawn(move || drop(to_child.write_all(&input)));
    let output = child.wait_with_output().unwrap();
    writer.join().unwrap();
    output
}

/// Both streams of a process, with the breaks of long lines taken out.
pub(crate) fn said(output: &Output) -> String {
    let all = [&output.stdout[..], &output.stderr].concat();
    String::from_utf8_lossy(&all).replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" ")
}
