//! Runs commands and prints which.

use std::ffi::OsStr;
use std::fs::{File, OpenOptions};
use std::io::{Read as _, Seek as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::{mem, thread};

/// Why a task stopped.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    /// A command could not be started.
    #[error("cannot run `{command}`: {why}")]
    Start { command: String, why: std::io::Error },
    /// A command ended with an exit code other than 0.
    #[error("`{command}` failed ({status})")]
    Status { command: String, status: std::process::ExitStatus },
    /// A file could not be read or written.
    #[error("{}: {why}", path.display())]
    File { path: PathBuf, why: std::io::Error },
    /// Some of several commands failed.
    #[error("{} failed:\n{}", .0.len(), .0.iter().map(|failure| format!("  {failure}")).collect::<Vec<_>>().join("\n"))]
    Several(Vec<Failure>),
    /// A measurement is not what it must be.
    #[error("{0}")]
    Check(String),
}

/// The result of a task.
pub(crate) type Done<T = ()> = Result<T, Failure>;

/// The repository's top folder.
pub(crate) fn root() -> PathBuf {
    let xtask = Path::new(env!("CARGO_MANIFEST_DIR"));
    xtask.parent().unwrap_or(xtask).to_path_buf()
}

/// The folder of builds.
pub(crate) fn target_dir() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}

/// A command that runs in the repository's top folder.
pub(crate) fn command(program: impl AsRef<OsStr>) -> Command {
    let mut command = Command::new(program);
    command.current_dir(root());
    command
}

/// `cargo` with `arguments` (split at spaces), of the pinned toolchain.
pub(crate) fn cargo(arguments: &str) -> Command {
    let mut cargo = command("cargo");
    cargo.args(arguments.split_whitespace());
    cargo
}

/// Runs a command to its end. Its output appears as it comes.
pub(crate) fn run(command: &mut Command) -> Done {
    let text = announce(command);
    let status = command.status().map_err(|why| Failure::Start { command: text.clone(), why })?;
    if status.success() { Ok(()) } else { Err(Failure::Status { command: text, status }) }
}

/// Runs all commands to their ends, one on each core at a time, also if some fail: the failure names all that did. The
/// output of a command is printed in one piece when the command has ended.
pub(crate) fn run_side_by_side(commands: Vec<Command>) -> Done {
    let done = side_by_side(commands, |mut command| {
        let text = words(&command);
        run_apart(&mut command, &text).map(drop)
    });
    all(done).map(drop)
}

/// All results, or all failures.
pub(crate) fn all<T>(done: Vec<Done<T>>) -> Done<Vec<T>> {
    let (mut given, mut failures) = (Vec::new(), Vec::new());
    for one in done {
        match one {
            Ok(value) => given.push(value),
            Err(failure) => failures.push(failure),
        }
    }
    if failures.is_empty() { Ok(given) } else { Err(Failure::Several(failures)) }
}

/// Does `work` on each of `items`, on each core at a time. Gives the results in the items' order.
pub(crate) fn side_by_side<T, R: Send>(
    items: impl IntoIterator<Item = T, IntoIter: Send>,
    work: impl Fn(T) -> R + Sync,
) -> Vec<R> {
    let waiting = Mutex::new(items.into_iter().enumerate());
    let done = Mutex::new(Vec::new());
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(|| {
                loop {
                    // The lock is held only for this statement.
                    let next = unpoisoned(&waiting).next();
                    let Some((place, item)) = next else { break };
                    let result = work(item);
                    unpoisoned(&done).push((place, result));
                }
            });
        }
    });
    let mut done = mem::take(&mut *unpoisoned(&done));
    done.sort_by_key(|(place, _)| *place);
    done.into_iter().map(|(_, result)| result).collect()
}

/// Runs a command to its end. Then prints its standard output and standard error below `text`, in the order in which
/// they were written, and gives them.
pub(crate) fn run_apart(command: &mut Command, text: &str) -> Done<String> {
    let start = |why| Failure::Start { command: text.to_owned(), why };
    // Not a pipe: a process that a failed test left behind would keep it open for ever.
    let mut file = unnamed_file().map_err(start)?;
    let (stdout, stderr) = (file.try_clone().map_err(start)?, file.try_clone().map_err(start)?);
    let status = command.stdout(stdout).stderr(stderr).status().map_err(start)?;
    let mut all = Vec::new();
    file.rewind().and_then(|()| file.read_to_end(&mut all)).map_err(start)?;
    let all = String::from_utf8_lossy(&all).into_owned();
    println!("$ {text}\n{all}");
    if status.success() { Ok(all) } else { Err(Failure::Status { command: text.to_owned(), status }) }
}

/// A new file for this process and those that it starts; it has no name any more.
fn unnamed_file() -> std::io::Result<File> {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let name = format!("xtask-output-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
    let path = std::env::temp_dir().join(name);
    let file = OpenOptions::new().read(true).append(true).create_new(true).open(&path)?;
    // Windows keeps the name of an open file.
    let _ = std::fs::remove_file(path);
    Ok(file)
}

/// No lock is held while anything could panic.
fn unpoisoned<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// Runs a command to its end with `input` on standard input. Gives its standard output.
pub(crate) fn pipe(command: &mut Command, input: &str) -> Done<String> {
    let text = announce(command);
    let start = |why| Failure::Start { command: text.clone(), why };
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().map_err(start)?;
    let output = thread::scope(|scope| {
        // Both pipes are used at once, since a child may answer before it has read its whole input.
        let stdin = child.stdin.take();
        scope.spawn(move || stdin.map(|mut pipe| pipe.write_all(input.as_bytes())));
        child.wait_with_output()
    })
    .map_err(start)?;
    if output.status.success() {
        Ok(String::from_utf8_lossy(&output.stdout).into_owned())
    } else {
        Err(Failure::Status { command: text, status: output.status })
    }
}

/// Runs a command to its end. Gives its standard output.
pub(crate) fn output(command: &mut Command) -> Done<String> {
    pipe(command, "")
}

fn announce(command: &Command) -> String {
    let text = words(command);
    eprintln!("$ {text}");
    text
}

fn words(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    words.map(OsStr::to_string_lossy).collect::<Vec<_>>().join(" ")
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn a_process_that_is_left_behind_keeps_no_stage_waiting() {
        // It has the output open until long after the shell has ended.
        let mut shell = command("sh");
        shell.args(["-c", "sleep 60 & echo out; echo err >&2"]);
        assert_eq!(run_apart(&mut shell, "left behind").expect("a sound shell"), "out\nerr\n");
        let failed = run_apart(command("sh").args(["-c", "echo why; exit 3"]), "it fails").expect_err("exit code 3");
        assert!(failed.to_string().contains("`it fails` failed"), "{failed}");
    }
}
