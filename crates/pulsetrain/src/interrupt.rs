//! Counts Ctrl-C: the first one stops the motors as planned, the next one at once.

use std::io::Write;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};

use pulsetrain_session::control::Command;

static TIMES: AtomicU32 = AtomicU32::new(0);
static WATCHED: OnceLock<bool> = OnceLock::new();
/// Takes the commands for which Ctrl-C stands.
type Takes = Box<dyn Fn(Command) + Send>;

/// Where the commands go.
static COMMANDS: Mutex<Option<Takes>> = Mutex::new(None);

/// Whether Ctrl-C stops motors, instead of ending the process.
static STOPS_MOTORS: AtomicBool = AtomicBool::new(false);
/// What the process does, in one or two words.
static STAGE: Mutex<&str> = Mutex::new("");

/// The exit code of a process that Ctrl-C has ended, as shells have it.
const INTERRUPTED: i32 = 130;

/// From this call on Ctrl-C (and SIGTERM) ends the process with a message. For the program itself; a program that embeds this library keeps its
/// own way.
pub(crate) fn explain() {
    WATCHED.get_or_init(|| {
        ctrlc::set_handler(|| {
            if STOPS_MOTORS.load(Ordering::Relaxed) {
                return pressed();
            }
            let stage = *STAGE.lock().unwrap_or_else(PoisonError::into_inner);
            let end = match stage {
                "" => "Interrupted.".to_owned(),
                "planning" | "rehearsing" => {
                    format!("Interrupted while {stage}: nothing has moved, nothing was written.")
                }
                stage => format!("Interrupted while {stage}."),
            };
            // If standard error is closed, the exit code is the only sign.
            drop(writeln!(std::io::stderr(), "\n{end}"));
            std::process::exit(INTERRUPTED);
        })
        .is_ok()
    });
}

/// Names what the process does, for the message of [`explain`].
pub(crate) fn stage(name: &'static str) {
    *STAGE.lock().unwrap_or_else(PoisonError::into_inner) = name;
}

/// From this call on Ctrl-C (and SIGTERM) does not end the process. [`wanted`] and [`send_to`] report it instead.
pub(crate) fn watch() {
    STOPS_MOTORS.store(true, Ordering::Relaxed);
    // If Ctrl-C cannot be watched, it ends the process at once, as the system has it.
    WATCHED.get_or_init(|| ctrlc::set_handler(pressed).is_ok());
}

fn pressed() {
    let commands = COMMANDS.lock().unwrap_or_else(PoisonError::into_inner);
    let command = command(TIMES.fetch_add(1, Ordering::Relaxed));
    if let Some(take) = commands.as_ref() {
        take(command);
    }
}

/// From now on `take` gets the commands of Ctrl-C, also those since [`watch`]: the first stops the motors as planned, the next one at once.
pub(crate) fn send_to(take: impl Fn(Command) + Send + 'static) {
    let mut commands = COMMANDS.lock().unwrap_or_else(PoisonError::into_inner);
    (0..TIMES.load(Ordering::Relaxed)).map(command).for_each(&take);
    *commands = Some(Box::new(take));
}

/// The command for the given count of Ctrl-C.
const fn command(before: u32) -> Command {
    if before == 0 { Command::Stop } else { Command::StopNow }
}

/// Whether the user has pressed Ctrl-C.
pub(crate) fn wanted() -> bool {
    TIMES.load(Ordering::Relaxed) > 0
}
