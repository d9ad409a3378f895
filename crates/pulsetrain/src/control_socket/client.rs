//! A client's end: finds the runs of this user, and talks to one.

use std::fs;
use std::io::{self, BufRead, BufReader, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::SocketError;
use crate::live::run_line::VERSION;
use crate::live::{RunCommand, RunInfo, RunLine};

/// A run sends its first line at once. One that does not is no run of ours.
const FIRST_LINE: Duration = Duration::from_secs(2);

/// A client's end of a run's control socket.
#[derive(Debug)]
pub struct RunClient {
    info: RunInfo,
    lines: BufReader<UnixStream>,
}

impl RunClient {
    fn connect(path: &Path) -> io::Result<RunClient> {
        let stream = UnixStream::connect(path)?;
        stream.set_read_timeout(Some(FIRST_LINE))?;
        let mut lines = BufReader::new(stream);
        let mut first = String::new();
        lines.read_line(&mut first)?;
        let info = serde_json::from_str(&first)?;
        lines.get_ref().set_read_timeout(None)?;
        Ok(RunClient { info, lines })
    }

    /// What the run said of itself.
    #[must_use]
    pub fn info(&self) -> &RunInfo {
        &self.info
    }

    /// Sends a command.
    ///
    /// # Errors
    /// If the run has gone away, or is of another version.
    pub fn command(&mut self, command: &RunCommand) -> Result<(), SocketError> {
        self.send(command)
    }

    /// Asks for a line with each status of the run.
    ///
    /// # Errors
    /// As [`RunClient::command`].
    pub fn follow(&mut self) -> Result<(), SocketError> {
        self.send(&serde_json::json!({ "follow": true }))
    }

    fn send(&mut self, line: &impl serde::Serialize) -> Result<(), SocketError> {
        if self.info.pulsetrain_control != VERSION {
            let (place, theirs) = (self.info.place().to_owned(), self.info.pulsetrain_control);
            return Err(SocketError::Version { place, theirs });
        }
        let text = serde_json::to_string(line).map_err(|_| self.gone())? + "\n";
        self.lines.get_mut().write_all(text.as_bytes()).map_err(|_| self.gone())
    }

    /// Waits for the next line of the run.
    ///
    /// # Errors
    /// If the run goes away before its last line.
    pub fn next_line(&mut self) -> Result<RunLine, SocketError> {
        let mut line = String::new();
        match self.lines.read_line(&mut line) {
            Ok(len) if len > 0 => serde_json::from_str(&line).map_err(|_| self.gone()),
            _ => Err(self.gone()),
        }
    }

    /// The next line of the run; `None` if no line comes within `patience`.
    ///
    /// # Errors
    /// As [`RunClient::next_line`].
    pub fn next_line_within(&mut self, patience: Duration) -> Result<Option<RunLine>, SocketError> {
        self.lines.get_ref().set_read_timeout(Some(patience)).map_err(|_| self.gone())?;
        let waited = match self.lines.fill_buf() {
            // A line is sent as a whole.
            Ok(_) => self.next_line().map(Some),
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => Ok(None),
            Err(_) => Err(self.gone()),
        };
        self.lines.get_ref().set_read_timeout(None).map_err(|_| self.gone())?;
        waited
    }

    fn gone(&self) -> SocketError {
        SocketError::Gone { place: self.info.place().to_owned() }
    }
}

/// The runs of this user on this computer, in the order of their names. Sockets of runs that were killed are removed.
///
/// # Errors
/// If the folder of the sockets is not this user's alone, or cannot be read.
pub fn runs() -> Result<Vec<RunClient>, SocketError> {
    let folder = folder()?;
    let access = |error: io::Error| SocketError::Access { path: folder.clone(), error };
    let mut paths = Vec::new();
    for entry in fs::read_dir(&folder).map_err(access)? {
        let path = entry.map_err(access)?.path();
        if path.extension().is_some_and(|ending| ending == ENDING) {
            paths.push(path);
        }
    }
    paths.sort();
    let mut found = Vec::new();
    for path in paths {
        match RunClient::connect(&path) {
            Ok(run) => found.push(run),
            // Its process is gone.
            Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => drop(fs::remove_file(&path)),
            // It ends just now, or has all the clients that it takes.
            Err(_) => {}
        }
    }
    Ok(found)
}

/// The ending of the sockets' names.
pub(super) const ENDING: &str = "sock";

/// The folder of the sockets, which is made if it is not there.
pub(crate) fn folder() -> Result<PathBuf, SocketError> {
    let user = rustix::process::geteuid().as_raw();
    let runtime = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from).filter(|path| path.is_absolute());
    let folder = match runtime.filter(|path| path.is_dir()) {
        Some(runtime) => runtime.join("pulsetrain"),
        None => std::env::temp_dir().join(format!("pulsetrain-{user}")),
    };
    let access = |error: io::Error| SocketError::Access { path: folder.clone(), error };
    match fs::DirBuilder::new().mode(0o700).create(&folder) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(access(error)),
        _ => {}
    }
    // A link, or a folder that somebody else made, could lead to sockets of somebody else.
    let found = fs::symlink_metadata(&folder).map_err(access)?;
    if found.is_dir() && found.uid() == user && found.mode() & 0o077 == 0 {
        return Ok(folder);
    }
    Err(SocketError::Folder { folder })
}
