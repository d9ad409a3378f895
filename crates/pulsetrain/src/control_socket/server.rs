//! The Unix socket of a run: one transport of its [`Hub`].

use std::fs;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::Shutdown;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use super::SocketError;
use super::client::{ENDING, folder};
use super::hub::{Hub, HubLines, HubSender, LONG_LINE_TIME, PATIENCE};
use crate::clock::Onward;
use crate::files::outputs::rename_own;
use crate::live::run_line::{MAX_BATCH_COMMANDS, MAX_LINE_BYTES, MAX_MOTION_LINE_BYTES, RunLine};
use crate::live::{ClientKind, JoinError};

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
        rename_own(&hidden, &path).map_err(access)?;
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
    thread::Builder::new().name("control client".into()).spawn(move || {
        let clock = Onward::from(Duration::ZERO);
        receive(stream, &sender, PATIENCE, &|| clock.now());
    })?;
    Ok(())
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

/// Reads a client's lines until it has no more. In the middle of a long line it may be silent for `patience`, and all of that line may take
/// [`LONG_LINE_TIME`] by the clock `now`.
fn receive(input: UnixStream, sender: &HubSender, patience: Duration, now: &dyn Fn() -> Duration) {
    let mut input = BufReader::new(input);
    let mut lines: Vec<Vec<u8>> = Vec::new();
    loop {
        let mut line = Vec::new();
        let read = (&mut input).take(MAX_LINE_BYTES as u64).read_until(b'\n', &mut line);
        // The last line may come without its end.
        let is_long = line.len() >= MAX_LINE_BYTES && line.last() != Some(&b'\n');
        if is_long {
            sender.lines(lines.iter().map(Vec::as_slice));
            lines.clear();
            // Only a live motion takes a motion file.
            if !sender.hub().is_live() {
                return sender.complain(format!("a line has {MAX_LINE_BYTES} bytes at most"));
            }
            // One at a time: the process has room for one. The others wait for it, and so it must not stop half way.
            let _alone = sender.hub().long_line();
            match read_long_line(&mut input, &mut line, patience, now) {
                Ok(None) => sender.motion_line(&line),
                Ok(Some(why)) => {
                    sender.complain(why);
                    // What it still sends is not taken.
                    return drop(input.get_ref().shutdown(Shutdown::Read));
                }
                Err(_) => return,
            }
            continue;
        }
        if read.is_err() || line.is_empty() {
            return;
        }
        lines.push(line);
        // Lines of one write act together.
        if lines.len() == MAX_BATCH_COMMANDS || !input.buffer().contains(&b'\n') {
            sender.lines(lines.iter().map(Vec::as_slice));
            lines.clear();
        }
    }
}

/// Reads a long line to its end. If it comes too slowly or has too many bytes, this stops reading, and returns the reason.
fn read_long_line(
    input: &mut BufReader<UnixStream>,
    line: &mut Vec<u8>,
    patience: Duration,
    now: &dyn Fn() -> Duration,
) -> io::Result<Option<String>> {
    let until = now() + LONG_LINE_TIME;
    input.get_ref().set_read_timeout(Some(patience))?;
    loop {
        let part = match input.fill_buf() {
            Ok(part) => part,
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {
                let (len, patience_s) = (line.len(), patience.as_secs_f64());
                let advice = "send a line with a motion file without a break";
                return Ok(Some(format!("a line stopped after {len} bytes for {patience_s} s: {advice}")));
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error),
        };
        let end = part.iter().position(|byte| *byte == b'\n');
        let len = end.map_or(part.len(), |end| end + 1);
        line.extend_from_slice(&part[..len]);
        input.consume(len);
        if line.len() > MAX_MOTION_LINE_BYTES || (line.len() == MAX_MOTION_LINE_BYTES && end.is_none()) {
            return Ok(Some(format!("a line with a motion file has {MAX_MOTION_LINE_BYTES} bytes at most")));
        }
        // The last line may come without its end.
        if end.is_some() || len == 0 {
            input.get_ref().set_read_timeout(None)?;
            return Ok(None);
        }
        if now() >= until {
            let (len, time_s) = (line.len(), LONG_LINE_TIME.as_secs());
            return Ok(Some(format!("{len} bytes of a line came within {time_s} s, and not its end: send it faster")));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::FileTexts;
    use crate::live::{RunCommand, RunInfo};
    use pulsetrain_motion::file::MOST_OF_A_MOTION_FILE;
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::sync::mpsc::channel;

    /// A client of a live motion. Only a broken server makes it wait to the end.
    fn client(hub: &Hub, patience: Duration) -> BufReader<UnixStream> {
        let (ours, theirs) = UnixStream::pair().unwrap();
        let (sender, lines) = hub.join(ClientKind::Socket).unwrap().split();
        let output = theirs.try_clone().unwrap();
        thread::spawn(move || write(output, &lines));
        // Each look at this clock is 10 s later.
        let looks = AtomicU64::new(0);
        let now = move || Duration::from_secs(10 * looks.fetch_add(1, Ordering::SeqCst));
        thread::spawn(move || receive(theirs, &sender, patience, &now));
        ours.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        let mut client = BufReader::new(ours);
        client.read_line(&mut String::new()).unwrap();
        client
    }

    #[test]
    fn a_client_that_stops_in_a_long_line_does_not_block_the_others() {
        let (sender, requests) = channel();
        let hub = Hub::of_live(RunInfo { is_live: true, ..RunInfo::nothing() }, sender);
        hub.looked();
        let mut stuck = client(&hub, Duration::from_millis(1));
        stuck.get_mut().write_all(&[b' '; MAX_LINE_BYTES + 1]).unwrap();
        let mut said = String::new();
        stuck.read_line(&mut said).unwrap();
        assert!(said.contains("a line stopped after 4097 bytes for 0.001 s"), "{said}");
        let mut other = client(&hub, Duration::from_secs(60));
        let text = " ".repeat(MAX_LINE_BYTES);
        let line = format!("{{\"command\":\"motion\",\"text\":\"{text}\"}}\n");
        other.get_mut().write_all(line.as_bytes()).unwrap();
        let motion = RunCommand::Motion { text, files: FileTexts::new() }.into();
        assert_eq!(requests.recv_timeout(Duration::from_secs(60)), Ok(motion));
    }

    /// A client that sends a byte now and then keeps its turn for a limited time.
    #[test]
    fn a_client_that_sends_a_long_line_slowly_does_not_block_the_others() {
        let (sender, requests) = channel();
        let hub = Hub::of_live(RunInfo { is_live: true, ..RunInfo::nothing() }, sender);
        hub.looked();
        let mut slow = client(&hub, Duration::from_secs(60));
        let mut output = slow.get_ref().try_clone().unwrap();
        output.write_all(&[b' '; MAX_LINE_BYTES]).unwrap();
        // It sends on until it is cut off.
        let sends = thread::spawn(move || while output.write_all(b" ").is_ok() {});
        let mut said = String::new();
        slow.read_line(&mut said).unwrap();
        assert!(said.contains("bytes of a line came within 30 s, and not its end"), "{said}");
        sends.join().unwrap();
        let mut other = client(&hub, Duration::from_secs(60));
        let text = " ".repeat(MAX_LINE_BYTES);
        other.get_mut().write_all(format!("{{\"command\":\"motion\",\"text\":\"{text}\"}}\n").as_bytes()).unwrap();
        let motion = RunCommand::Motion { text, files: FileTexts::new() }.into();
        assert_eq!(requests.recv_timeout(Duration::from_secs(60)), Ok(motion));
    }

    /// However JSON writes its characters.
    #[test]
    fn the_largest_motion_file_fits_in_a_line() {
        let bytes = MOST_OF_A_MOTION_FILE as usize;
        for (character, written) in [("é", r"\u00e9"), ("<", r"\u003c"), ("😀", r"\ud83d\ude00")] {
            let read: String = serde_json::from_str(&format!("\"{written}\"")).unwrap();
            assert_eq!(read, character);
            let line = r#"{"command":"motion","text":""}"#.len() + bytes / character.len() * written.len() + 1;
            assert!(line <= MAX_MOTION_LINE_BYTES, "{character}: {line}");
        }
    }
}
