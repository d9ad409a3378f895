//! The Unix socket of a run: one transport of its [`Hub`].

use std::fs;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::Shutdown;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::thread;

use super::client::{ENDING, folder};
use super::hub::{ClientKind, Hub, HubLines, HubSender, JoinError, PATIENCE};
use super::{LONGEST_LINE, LONGEST_MOTION_LINE, MOST_TOGETHER, RunLine, SocketError};

/// A run's socket. It goes away with this value.
#[derive(Debug)]
pub(super) struct ControlSocket {
    path: PathBuf,
}

impl ControlSocket {
    /// Makes the socket, and listens at it in a thread of its own.
    pub(super) fn listen(name: &str, hub: &Hub) -> Result<ControlSocket, SocketError> {
        let folder = folder()?;
        // A socket has its final name when it listens already: a client takes one that refuses it for a dead run's.
        let (hidden, path) = (folder.join(format!(".{name}")), folder.join(format!("{name}.{ENDING}")));
        let access = |error: io::Error| SocketError::Access { path: path.clone(), error };
        let listener = bind(&hidden).map_err(access)?;
        fs::rename(&hidden, &path).map_err(access)?;
        let hub = hub.clone();
        let accepts = thread::Builder::new().name("control socket".into()).spawn(move || accept(&listener, &hub));
        match accepts {
            Ok(_) => Ok(ControlSocket { path }),
            Err(error) => {
                drop(fs::remove_file(&path));
                Err(access(error))
            }
        }
    }
}

/// The hub is over by then.
impl Drop for ControlSocket {
    fn drop(&mut self) {
        // The listening thread wakes up by a connection, and ends.
        drop(UnixStream::connect(&self.path));
        // If it is gone already, so much the better.
        drop(fs::remove_file(&self.path));
    }
}

fn bind(path: &Path) -> io::Result<UnixListener> {
    // A process of the same number may have been killed here before.
    drop(fs::remove_file(path));
    let listener = UnixListener::bind(path)?;
    fs::set_permissions(path, fs::Permissions::from_mode(0o600))?;
    Ok(listener)
}

fn accept(listener: &UnixListener, hub: &Hub) {
    loop {
        let served = match listener.accept() {
            Ok((stream, _)) => serve(stream, hub),
            Err(error) => Err(error),
        };
        // The process has no more files or threads for now, say. A client that cannot be served is one less.
        let pause = if served.is_err() { PATIENCE } else { std::time::Duration::ZERO };
        if hub.is_over_within(pause) {
            return;
        }
    }
}

fn serve(mut stream: UnixStream, hub: &Hub) -> io::Result<()> {
    stream.set_write_timeout(Some(PATIENCE))?;
    let client = match hub.join(ClientKind::Socket) {
        Ok(client) => client,
        Err(JoinError::Over) => return Ok(()),
        Err(error @ JoinError::Full) => {
            let line = serde_json::to_string(&RunLine::Error { error: error.to_string() }).unwrap_or_default();
            // It may be gone already.
            drop(stream.write_all(format!("{line}\n").as_bytes()));
            return Ok(());
        }
    };
    let (sender, lines) = client.split();
    let output = stream.try_clone()?;
    thread::Builder::new().name("control client".into()).spawn(move || write(output, &lines))?;
    thread::Builder::new().name("control client".into()).spawn(move || hear(stream, &sender)).map(drop)
}

/// Writes a client's lines, up to the last one or to the first that is not taken in time.
fn write(mut output: UnixStream, lines: &HubLines) {
    while let Some(line) = lines.next_line() {
        if output.write_all(line.as_bytes()).is_err() {
            break;
        }
    }
    drop(output.shutdown(Shutdown::Both));
}

/// Reads a client's lines until it has no more.
fn hear(input: UnixStream, sender: &HubSender) {
    let mut input = BufReader::new(input);
    let mut lines: Vec<Vec<u8>> = Vec::new();
    loop {
        let mut line = Vec::new();
        let read = (&mut input).take(LONGEST_LINE as u64).read_until(b'\n', &mut line);
        // The last line may come without its end.
        let is_long = line.len() >= LONGEST_LINE && line.last() != Some(&b'\n');
        if is_long {
            sender.lines(lines.iter().map(Vec::as_slice));
            lines.clear();
            // Only a live motion takes a motion file.
            if !sender.hub().is_live() {
                return sender.complain(format!("a line has {LONGEST_LINE} bytes at most"));
            }
            // One at a time: the process has room for one.
            let _alone = sender.hub().long_line();
            let left = (LONGEST_MOTION_LINE - line.len()) as u64;
            if (&mut input).take(left).read_until(b'\n', &mut line).is_err() {
                return;
            }
            if line.len() >= LONGEST_MOTION_LINE && line.last() != Some(&b'\n') {
                return sender.complain(format!("a line with a motion file has {LONGEST_MOTION_LINE} bytes at most"));
            }
            sender.motion_line(&line);
            continue;
        }
        if read.is_err() || line.is_empty() {
            return;
        }
        lines.push(line);
        // Lines of one write act together.
        if lines.len() == MOST_TOGETHER || !input.buffer().contains(&b'\n') {
            sender.lines(lines.iter().map(Vec::as_slice));
            lines.clear();
        }
    }
}
