//! The control socket of a run. Other commands of the same user find the run there, send it commands, and follow its events.
//!
//! Each run listens at a Unix socket `NAME-PID.sock` in the user's runtime folder: `$XDG_RUNTIME_DIR/pulsetrain`, or
//! `pulsetrain-UID` in the folder for temporary files. The folder has mode 0700 and the socket 0600, so that no other user
//! can connect. Both sides send lines of JSON. A client's have at most [`MAX_LINE_BYTES`] bytes; one with a motion file at most
//! [`MAX_MOTION_LINE_BYTES`]:
//!
//! 1. The run sends [`RunInfo`]. Its field `pulsetrain_control` is the protocol's version, [`VERSION`].
//! 2. The client sends batches of commands, such as `{"command":"stop"}`, and `{"follow":true}` if it wants each status.
//! 3. The run sends lines of [`run_line`](crate::live::run_line): an event, an error about a line of the client, and at last how it ended.
//!
//! [`MAX_LINE_BYTES`]: crate::live::run_line::MAX_LINE_BYTES
//! [`MAX_MOTION_LINE_BYTES`]: crate::live::run_line::MAX_MOTION_LINE_BYTES
//!
//! The socket is one transport of the run's [`Hub`], which has the clients of all kinds and their queues. A client never
//! delays a step: threads of its own read and write, and a client that takes no lines is dropped.
//! docs/control.md describes the same for other programs. Windows has no such socket yet.

use std::io;
use std::path::PathBuf;

use miette::Diagnostic;
use pulsetrain_motion::program::Program;

use crate::live::run_line::VERSION;
use crate::live::{RunInfo, RunPlace};

#[cfg(unix)]
mod client;
mod control;
mod hub;
#[cfg(unix)]
mod server;
#[cfg(not(unix))]
mod unsupported;

#[cfg(unix)]
pub(crate) use client::folder;
#[cfg(unix)]
pub use client::{RunClient, runs};
pub use control::Control;
pub(crate) use hub::LONG_LINE_TIME;
pub use hub::{Hub, HubClient, HubLines, HubSender, Next};
#[cfg(unix)]
use server::ControlSocket;
#[cfg(not(unix))]
use unsupported::NoSocket as ControlSocket;
#[cfg(not(unix))]
pub use unsupported::{NoClient as RunClient, runs};

/// The first line of a run of this process.
#[must_use]
pub fn run_info(file: &str, program: &Program, port: Option<&str>, is_native: bool) -> RunInfo {
    let port_paths = port.map(port_paths).unwrap_or_default();
    RunInfo::new(file, program, RunPlace { pid: std::process::id(), port, port_paths, is_native })
}

/// The absolute path of a port, and the path behind its links: [`RunInfo::is_at`] compares them.
pub(crate) fn port_paths(port: &str) -> Vec<PathBuf> {
    let absolute = std::path::absolute(port).ok();
    absolute.into_iter().chain(std::fs::canonicalize(port).ok()).collect()
}

/// Why runs cannot be found, or a run cannot be reached.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum SocketError {
    /// The folder of the sockets is another user's, or others may write in it.
    #[error("{} is not this user's alone, so nothing in it can be trusted", .folder.display())]
    #[diagnostic(help("remove it, or set XDG_RUNTIME_DIR to a folder of your own"))]
    Folder {
        /// The folder.
        folder: PathBuf,
    },
    /// The folder, or a socket in it, cannot be used.
    #[error("cannot use {}: {error}", .path.display())]
    Access {
        /// The folder or the socket.
        path: PathBuf,
        /// The system's error.
        error: io::Error,
    },
    /// The run is of another version of this program.
    #[error("the run at {place} speaks version {theirs} of the control lines, this program {VERSION}")]
    #[diagnostic(help("press Ctrl-C where it runs, or use the version of pulsetrain that runs it"))]
    Version {
        /// The run's port, or its name.
        place: String,
        /// Its version.
        theirs: u32,
    },
    /// The run has ended, or closed the connection.
    #[error("the run at {place} went away without saying how it ended")]
    #[diagnostic(help("`pulsetrain stop --port PORT` asks the board itself"))]
    Gone {
        /// The run's port, or its name.
        place: String,
    },
    /// This system has no control socket.
    #[error("this system has no control socket yet: only runs on Linux, macOS and other Unix systems have one")]
    #[diagnostic(help("press Ctrl-C where it runs; a second Ctrl-C stops at once"))]
    System,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_is_found_by_each_of_its_names() {
        let info = RunInfo {
            name: "ttyACM0-7".to_owned(),
            port: Some("board".to_owned()),
            port_paths: port_paths("board"),
            ..RunInfo::nothing()
        };
        let absolute = std::path::absolute("board").unwrap().display().to_string();
        for (name, is_it) in [("board", true), ("./board", true), (&absolute, true), ("ttyACM0-7", true), ("x", false)]
        {
            assert_eq!(info.is_at(name, &port_paths(name)), is_it, "{name}");
        }
    }
}
