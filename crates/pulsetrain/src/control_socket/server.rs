//! The run's end: listens, passes commands on to the run, and events to the clients.

use std::fs;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::Shutdown;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use pulsetrain_session::control::{Command, Event};

use super::client::{ENDING, folder};
use super::{ClientLine, LONGEST_LINE, RunEnded, RunInfo, RunLine, SocketError};
use crate::console::Console;
use crate::interrupt;

/// Clients at a time.
const MOST_CLIENTS: usize = 16;
/// Lines that wait for a client. One that takes none of them loses its connection.
const MOST_WAITING: usize = 256;
/// Lines that wait for a client when statuses are left out: the rest is for events, which it must not miss.
const MOST_STATUSES: usize = 128;
/// How long a client may take for a line, and the end of a run may wait for its clients.
const PATIENCE: Duration = Duration::from_secs(1);

/// The commands to a run: those of Ctrl-C, and those of the clients at its control socket.
#[derive(Debug)]
pub struct Control {
    commands: Receiver<Command>,
    shared: Arc<Shared>,
    /// `None` if the socket could not be made.
    socket: Option<PathBuf>,
}

#[derive(Debug)]
struct Shared {
    first_line: String,
    commands: Sender<Command>,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    clients: Vec<ConnectedClient>,
    connected: u64,
    /// How many times the run has looked for a command, and how many such looks a command has used.
    looks: u64,
    used: u64,
    stop_sent: bool,
    stop_now_sent: bool,
    is_over: bool,
}

#[derive(Debug)]
struct ConnectedClient {
    number: u64,
    stream: UnixStream,
    lines: SyncSender<Arc<str>>,
    /// How many of them its writer has not written.
    waiting: Arc<AtomicUsize>,
    writer: JoinHandle<()>,
    follows: bool,
    /// It has closed its sending side. Such clients make room for new ones.
    is_silent: bool,
}

impl Control {
    /// Listens to Ctrl-C and at a socket for a run. If there can be no socket, it prints why, and the run goes on without.
    pub fn open(info: &RunInfo, console: &mut Console<'_>) -> Control {
        let (sender, commands) = interrupt::commands();
        let first_line = serde_json::to_string(info).unwrap_or_default() + "\n";
        let (state, changed) = (Mutex::default(), Condvar::new());
        let shared = Arc::new(Shared { first_line, commands: sender, state, changed });
        let socket = listen(&info.name, &shared).map_err(|error| {
            console.tell(format_args!("`pulsetrain stop` cannot reach this run, only Ctrl-C can: {error}\n"));
        });
        Control { commands, shared, socket: socket.ok() }
    }

    /// The commands, as they come.
    #[must_use]
    pub fn commands(&self) -> &Receiver<Command> {
        &self.commands
    }

    /// Whether a client has asked for a stop.
    #[must_use]
    pub fn wants_stop(&self) -> bool {
        let state = self.shared.state();
        state.stop_sent || state.stop_now_sent
    }

    /// Tells the clients of an event. It never waits for them.
    pub fn tell(&self, event: &Event) {
        let mut state = self.shared.state();
        let is_status = matches!(event, Event::Status(_));
        if is_status {
            state.looks += 1;
            self.shared.changed.notify_all();
        }
        // The run's last line says more than the last event.
        let is_left_out = matches!(event, Event::Progress { .. } | Event::Ended(_) | Event::Failed { .. });
        if is_left_out || !state.clients.iter().any(|client| client.follows || !is_status) {
            return;
        }
        let Ok(line) = serde_json::to_string(event) else { return };
        let line: Arc<str> = (line + "\n").into();
        state.clients.retain(|client| {
            let is_busy = client.waiting.load(Ordering::Relaxed) >= MOST_STATUSES;
            if is_status && (!client.follows || is_busy) {
                return true;
            }
            client.waiting.fetch_add(1, Ordering::Relaxed);
            match client.lines.try_send(Arc::clone(&line)) {
                Ok(()) => true,
                // Without this line the client would take the run for another than it is.
                Err(_) => client.hang_up(),
            }
        });
    }

    /// Tells the clients how the run ended, and closes the socket.
    pub fn end(mut self, ended: &RunEnded) {
        let line = serde_json::to_string(&RunLine::Ended(ended.clone())).ok();
        self.close(line.map(|line| (line + "\n").into()));
    }

    fn close(&mut self, last: Option<Arc<str>>) {
        let Some(socket) = self.socket.take() else { return };
        let clients = {
            let mut state = self.shared.state();
            state.is_over = true;
            self.shared.changed.notify_all();
            std::mem::take(&mut state.clients)
        };
        // The listening thread wakes up by a connection, and ends.
        drop(UnixStream::connect(&socket));
        // If it is gone already, so much the better.
        drop(fs::remove_file(&socket));
        for ConnectedClient { lines, stream, writer, .. } in clients {
            if let Some(last) = &last {
                drop(lines.try_send(Arc::clone(last)));
            }
            drop(lines);
            // The writer ends when all is sent, or with the first line that is not taken in time.
            drop(writer.join());
            drop(stream.shutdown(Shutdown::Both));
        }
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        self.close(None);
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Passes a command on. A stop goes at once, and only once. Others wait until the run has looked for a command again, so
    /// that they cannot pile up.
    fn pass_on(&self, command: Command) {
        let mut state = self.state();
        match command {
            Command::Stop if std::mem::replace(&mut state.stop_sent, true) => return,
            Command::StopNow if std::mem::replace(&mut state.stop_now_sent, true) => return,
            Command::Stop | Command::StopNow => {}
            Command::Pause | Command::Resume | Command::Tempo { .. } => {
                while state.used >= state.looks && !state.is_over {
                    state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
                }
                state.used = state.looks;
            }
        }
        // The receiver lives as long as the run.
        let _ = self.commands.send(command);
    }
}

impl ConnectedClient {
    /// Ends the connection. False, for `retain`.
    fn hang_up(&self) -> bool {
        drop(self.stream.shutdown(Shutdown::Both));
        false
    }
}

/// Makes the socket, and listens at it in a thread of its own.
fn listen(name: &str, shared: &Arc<Shared>) -> Result<PathBuf, SocketError> {
    let folder = folder()?;
    // A socket has its final name when it listens already: a client takes one that refuses it for a dead run's.
    let (hidden, path) = (folder.join(format!(".{name}")), folder.join(format!("{name}.{ENDING}")));
    let access = |error: io::Error| SocketError::Access { path: path.clone(), error };
    let listener = bind(&hidden).map_err(access)?;
    fs::rename(&hidden, &path).map_err(access)?;
    let shared = Arc::clone(shared);
    let accepts = thread::Builder::new().name("control socket".into()).spawn(move || accept(&listener, &shared));
    match accepts {
        Ok(_) => Ok(path),
        Err(error) => {
            drop(fs::remove_file(&path));
            Err(access(error))
        }
    }
}

fn bind(path: &Path) -> io::Result<UnixListener> {
    // A process of the same number may have been killed here before.
    drop(fs::remove_file(path));
    let listener = UnixListener::bind(path)?;
    fs::set_permissions(path, fs::Permissions::from_mode(0o600))?;
    Ok(listener)
}

fn accept(listener: &UnixListener, shared: &Arc<Shared>) {
    loop {
        let stream = listener.accept();
        let state = shared.state();
        if state.is_over {
            return;
        }
        match stream {
            Ok((stream, _)) => {
                drop(state);
                // A client that cannot be served is one less.
                let _ = serve(stream, shared);
            }
            // The process has no more files for now, say.
            Err(_) => drop(shared.changed.wait_timeout(state, PATIENCE)),
        }
    }
}

fn serve(mut stream: UnixStream, shared: &Arc<Shared>) -> io::Result<()> {
    stream.set_write_timeout(Some(PATIENCE))?;
    let mut state = shared.state();
    if state.clients.len() >= MOST_CLIENTS
        && let Some(silent) = state.clients.iter().position(|client| client.is_silent)
    {
        state.clients.remove(silent).hang_up();
    }
    if state.clients.len() >= MOST_CLIENTS {
        drop(state);
        let error = format!("this run has {MOST_CLIENTS} clients already");
        let line = serde_json::to_string(&RunLine::Error { error }).unwrap_or_default();
        return stream.write_all(format!("{line}\n").as_bytes());
    }
    state.connected += 1;
    let number = state.connected;
    let (lines, to_client) = sync_channel::<Arc<str>>(MOST_WAITING);
    drop(lines.try_send(shared.first_line.as_str().into()));
    let (mut output, input) = (stream.try_clone()?, stream.try_clone()?);
    let waiting = Arc::new(AtomicUsize::new(0));
    let to_write = Arc::clone(&waiting);
    let writer = thread::Builder::new().name("control client".into()).spawn(move || {
        while let Ok(line) = to_client.recv() {
            if output.write_all(line.as_bytes()).is_err() {
                drop(output.shutdown(Shutdown::Both));
                return;
            }
            // Answers and the last line are not counted.
            let less = |waiting: usize| Some(waiting.saturating_sub(1));
            let _ = to_write.fetch_update(Ordering::Relaxed, Ordering::Relaxed, less);
        }
    })?;
    let client = ConnectedClient { number, stream, lines, waiting, writer, follows: false, is_silent: false };
    state.clients.push(client);
    drop(state);
    let shared = Arc::clone(shared);
    thread::Builder::new().name("control client".into()).spawn(move || hear(input, number, &shared)).map(drop)
}

/// Reads a client's lines until it has no more.
fn hear(input: UnixStream, number: u64, shared: &Shared) {
    let mut input = BufReader::new(input);
    let mut line = Vec::new();
    loop {
        line.clear();
        let read = (&mut input).take(LONGEST_LINE as u64).read_until(b'\n', &mut line);
        // The last line may come without its end.
        let is_too_long = line.len() >= LONGEST_LINE && line.last() != Some(&b'\n');
        if read.is_err() || line.is_empty() || is_too_long {
            break;
        }
        let answer = match ClientLine::read(&line) {
            Ok(ClientLine::Command(command)) => {
                shared.pass_on(command);
                continue;
            }
            Ok(ClientLine::Follow(follows)) => {
                if let Some(client) = shared.state().of(number) {
                    client.follows = follows;
                }
                continue;
            }
            Err(error) => RunLine::Error { error },
        };
        if shared.state().answer(number, &answer).is_none() {
            return;
        }
    }
    let mut state = shared.state();
    if line.len() >= LONGEST_LINE {
        let error = format!("a line has {LONGEST_LINE} bytes at most");
        state.answer(number, &RunLine::Error { error });
    }
    // It may still read.
    if let Some(client) = state.of(number) {
        client.is_silent = true;
    }
}

impl State {
    fn of(&mut self, number: u64) -> Option<&mut ConnectedClient> {
        self.clients.iter_mut().find(|client| client.number == number)
    }

    /// Sends a client a line. `None` if it is gone, or takes no lines.
    fn answer(&mut self, number: u64, line: &RunLine) -> Option<()> {
        let line: Arc<str> = (serde_json::to_string(line).ok()? + "\n").into();
        self.of(number)?.lines.try_send(line).ok()
    }
}
