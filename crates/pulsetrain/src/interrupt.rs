//! Ctrl-C: counted, so that what runs can come to a planned end, or to a sudden one.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Mutex, OnceLock, PoisonError};

use pulsetrain_session::control::Command;

static TIMES: AtomicU32 = AtomicU32::new(0);
static WATCHED: OnceLock<bool> = OnceLock::new();
/// Who gets the commands that Ctrl-C stands for.
static COMMANDS: Mutex<Option<Sender<Command>>> = Mutex::new(None);

/// From now on Ctrl-C (and a request to terminate) does not end the process: [`wanted`] and [`commands`] tell of it.
pub(crate) fn watch() {
    let handler = || {
        let commands = COMMANDS.lock().unwrap_or_else(PoisonError::into_inner);
        let command = command(TIMES.fetch_add(1, Ordering::Relaxed));
        // Nobody listens once a run is over.
        let _ = commands.as_ref().map(|commands| commands.send(command));
    };
    // Where it cannot be watched the system's own way stays: the process ends at once.
    WATCHED.get_or_init(|| ctrlc::set_handler(handler).is_ok());
}

/// The commands to a session that Ctrl-C stands for, those since [`watch`] included: the first stops the motors as planned, the next at once.
pub(crate) fn commands() -> Receiver<Command> {
    let (sender, receiver) = channel();
    let mut commands = COMMANDS.lock().unwrap_or_else(PoisonError::into_inner);
    for before in 0..TIMES.load(Ordering::Relaxed) {
        // The other end is right here.
        let _ = sender.send(command(before));
    }
    *commands = Some(sender);
    receiver
}

/// The command that Ctrl-C stands for after it came so many times.
const fn command(before: u32) -> Command {
    if before == 0 { Command::Stop } else { Command::StopNow }
}

/// Whether the user wants an end.
pub(crate) fn wanted() -> bool {
    TIMES.load(Ordering::Relaxed) > 0
}
