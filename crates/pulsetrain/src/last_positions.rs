//! What a run leaves behind of the positions of a port's motors, for the `goto` after it.
//!
//! A board counts steps from 0 since it was set up, and does not know from which position. So a run writes down how its count and
//! the positions belong together. That holds as long as the board still has that count: a board that was reset, or set up by another
//! program, has another one.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;

use pulsetrain_motion::program::Program;
use serde::{Deserialize, Serialize};

use crate::files::inputs::of_system;
use crate::files::outputs;
use pulsetrain_report::positions;

#[derive(Debug, Serialize, Deserialize)]
struct LastPositions {
    /// The board's clock when this was written, ticks since it started.
    clock: u64,
    motors: Vec<LastPosition>,
    /// Whether the run went on: the board may have counted on since.
    #[serde(default)]
    goes_on: bool,
    /// Whether the motors rested.
    #[serde(default)]
    rests: bool,
}

#[derive(Debug, Serialize, Deserialize)]
struct LastPosition {
    name: String,
    /// The board's count.
    count: i64,
    /// Its position by the motion file, steps.
    steps: f64,
}

/// The file for a port. `None` where there is no folder for it.
fn file(port: &str) -> Option<PathBuf> {
    let real = std::fs::canonicalize(port).ok().filter(|path| !path.starts_with("/dev/pts"));
    // Behind the link of a virtual board is another pseudo-terminal for each client.
    let path = real.or_else(|| std::path::absolute(port).ok())?;
    let letters = path.to_string_lossy();
    let letters = letters.chars().map(|letter| if letter.is_ascii_alphanumeric() { letter } else { '-' });
    let letters: String = letters.collect();
    let last = letters.len().saturating_sub(LONGEST_NAME);
    Some(folder()?.join(format!("{}.position", &letters[last..])))
}

/// A file's name has 255 bytes on most systems.
const LONGEST_NAME: usize = 200;

#[cfg(unix)]
fn folder() -> Option<PathBuf> {
    crate::control_socket::folder().ok()
}

/// On other systems nothing is kept: `goto` takes the position from its user.
#[cfg(not(unix))]
fn folder() -> Option<PathBuf> {
    None
}

/// A file of the same name that outlives a restart of the computer.
fn state_file(port: &str) -> Option<PathBuf> {
    let set = |name: &str| std::env::var_os(name).filter(|value| Path::new(value).is_absolute()).map(PathBuf::from);
    let folder = set("XDG_STATE_HOME").or_else(|| Some(set("HOME")?.join(".local/state")))?.join("pulsetrain");
    Some(folder.join(file(port)?.file_name()?))
}

/// Forgets what was kept for a port: its board gets another count.
pub(crate) fn forget(port: &str) {
    for file in [file(port), state_file(port)].into_iter().flatten() {
        // Most often there is none.
        drop(std::fs::remove_file(file));
    }
}

/// Keeps the positions of a program's motors, by the board's counts at its clock `clock`. If they cannot be written, `goto` asks its user.
pub(crate) fn keep(port: &str, program: &Program, counts: &[i64], clock: u64) {
    if let (Some(file), Some(text)) = (file(port), written(program, counts, clock)) {
        drop(outputs::replace_own(&file, &text));
    }
}

/// What is kept.
pub(crate) fn written(program: &Program, counts: &[i64], clock: u64) -> Option<String> {
    serde_json::to_string(&LastPositions::of(program, counts, clock)).ok()
}

impl LastPositions {
    /// Of motors that rest after a run.
    fn of(program: &Program, counts: &[i64], clock: u64) -> LastPositions {
        let motors = program.motors.iter().zip(counts).map(|(motor, count)| LastPosition {
            name: motor.name.clone(),
            count: *count,
            steps: positions::start(motor) + *count as f64,
        });
        LastPositions { clock, motors: motors.collect(), goes_on: false, rests: true }
    }

    fn is_of(&self, program: &Program) -> bool {
        self.motors.len() == program.motors.len()
            && self.motors.iter().zip(&program.motors).all(|(kept, motor)| kept.name == motor.name)
    }
}

/// The positions of a program's motors, steps, if the board at the port still has the counts for which they were kept, at its clock
/// `clock`.
pub(crate) fn recall(port: &str, program: &Program, counts: &[i64], clock: u64) -> Option<Vec<f64>> {
    read(&of_system(&file(port)?), program, counts, clock)
}

/// As [`recall`], from what was [written].
pub(crate) fn read(text: &str, program: &Program, counts: &[i64], clock: u64) -> Option<Vec<f64>> {
    let kept: LastPositions = serde_json::from_str(text).ok()?;
    let is_same = kept.is_of(program)
        && clock >= kept.clock
        && counts.len() == kept.motors.len()
        && (kept.goes_on || kept.motors.iter().map(|motor| motor.count).eq(counts.iter().copied()));
    let motors = kept.motors.iter().zip(counts);
    is_same.then(|| motors.map(|(motor, count)| motor.steps + (count - motor.count) as f64).collect())
}

/// Keeps the positions of a long run's motors, in a thread, so that a slow disk delays no step.
#[derive(Debug)]
pub(crate) struct Keeper {
    port: String,
    texts: Option<Sender<String>>,
    writer: Option<JoinHandle<()>>,
    /// When the positions are kept next, s of the motion, and whether the motors rested.
    due: (f64, bool),
}

/// How often the positions are kept, s.
const KEPT_EVERY_S: f64 = 1.0;

impl Keeper {
    pub(crate) fn new(port: &str) -> Keeper {
        Keeper { port: port.to_owned(), texts: None, writer: None, due: (0.0, false) }
    }

    /// Keeps the positions of motors that go on, now and then, and when they come to rest. Their board is at its count.
    pub(crate) fn goes_on(&mut self, program: &Program, counts: &[i64], at_s: f64, rests: bool) {
        let is_due = at_s >= self.due.0 || at_s < self.due.0 - KEPT_EVERY_S || rests != self.due.1;
        if !is_due {
            return;
        }
        self.due = (at_s + KEPT_EVERY_S, rests);
        self.write(&LastPositions { goes_on: true, rests, ..LastPositions::of(program, counts, 0) });
    }

    /// Keeps the positions at the end of the run.
    pub(crate) fn ends(&mut self, program: &Program, counts: &[i64], clock: u64) {
        self.write(&LastPositions::of(program, counts, clock));
    }

    fn write(&mut self, positions: &LastPositions) {
        let (Ok(text), false) = (serde_json::to_string(positions), self.port.is_empty()) else { return };
        if self.texts.is_none() {
            let (texts, to_write) = channel::<String>();
            let files = [file(&self.port), state_file(&self.port)];
            self.texts = Some(texts);
            self.writer = Some(std::thread::spawn(move || {
                for text in to_write {
                    // If they cannot be written, the next run asks its user.
                    files.iter().flatten().for_each(|file| drop(outputs::replace_own(file, &text)));
                }
            }));
        }
        let sent = self.texts.as_ref().map(|texts| texts.send(text));
        debug_assert!(sent.is_none_or(|sent| sent.is_ok()), "the writer lives as long as the sender");
    }

    /// Waits until all is written.
    pub(crate) fn finish(&mut self) {
        drop(self.texts.take());
        if let Some(writer) = self.writer.take() {
            // A writer that failed has written nothing: the next run asks its user.
            let _ = writer.join();
        }
    }

    /// Where a program's motors rested when they were known last, steps; `None` if they moved, or nothing is kept.
    pub(crate) fn last(&self, program: &Program) -> Option<Vec<f64>> {
        let kept: Vec<LastPositions> = [file(&self.port), state_file(&self.port)]
            .into_iter()
            .flatten()
            .filter_map(|file| serde_json::from_str(&of_system(&file)).ok())
            .collect();
        let kept = kept.into_iter().next().filter(|kept| kept.rests && kept.is_of(program))?;
        Some(kept.motors.iter().map(|motor| motor.steps).collect())
    }
}
