//! Counts Ctrl-C: the first one stops the motors as planned, the next one at once.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Mutex, OnceLock, PoisonError};

use pulsetrain_session::control::Command;

static TIMES: AtomicU32 = AtomicU32::new(0);
static WATCHED: OnceLock<bool> = OnceLock::new();
/// Where the commands go for which Ctrl-C stands.
static COMMANDS: Mutex<Option<Sender<Command>>> = Mutex::new(None);

/// From this call on Ctrl-C (and SIGTERM) does not end the process. [`wanted`] and [`commands`] report it instead.
pub(crate) fn watch() {
    let handler = || {
        let commands = COMMANDS.lock().unwrap_or_else(PoisonError::into_inner);
        let command = command(TIMES.fetch_add(1, Ordering::Relaxed));
        // Once a run is over, nobody receives the command.
        let _ = commands.as_ref().map(|commands| commands.send(command));
    };
    // If Ctrl-C cannot be watched, it ends the process at once, as the system has it.
    WATCHED.get_or_init(|| ctrlc::set_handler(handler).is_ok());
}

/// The commands that Ctrl-C has sent since [`watch`]: the first stops the motors as planned, the next one at once. The sender is for commands from
/// elsewhere.
pub(crate) fn commands() -> (Sender<Command>, Receiver<Command>) {
    let (sender, receiver) = channel();
    let mut commands = COMMANDS.lock().unwrap_or_else(PoisonError::into_inner);
    for before in 0..TIMES.load(Ordering::Relaxed) {
        // The receiver is in this function, so sending cannot fail.
        let _ = sender.send(command(before));
    }
    *commands = Some(sender.clone());
    (sender, receiver)
}

/// The command for the given count of Ctrl-C.
const fn command(before: u32) -> Command {
    if before == 0 { Command::Stop } else { Command::StopNow }
}

/// Whether the user has pressed Ctrl-C.
pub(crate) fn wanted() -> bool {
    TIMES.load(Ordering::Relaxed) > 0
}
