//! What a run leaves behind of the positions of a port's motors, for the `goto` after it.
//!
//! A board counts steps from 0 since it was set up, and does not know from which position. So a run writes down how its count and
//! the positions belong together. That holds as long as the board still has that count: a board that was reset, or set up by another
//! program, has another one.

use std::path::PathBuf;

use pulsetrain_motion::program::Program;
use serde::{Deserialize, Serialize};

use crate::standing;

#[derive(Debug, Serialize, Deserialize)]
struct LastPositions {
    /// The board's clock when this was written, ticks since it started.
    clock: u64,
    motors: Vec<LastPosition>,
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

/// Forgets what was kept for a port: its board gets another count.
pub(crate) fn forget(port: &str) {
    if let Some(file) = file(port) {
        // Most often there is none.
        drop(std::fs::remove_file(file));
    }
}

/// Keeps the positions of a program's motors, by the board's counts at its clock `clock`. If they cannot be written, `goto` asks its user.
pub(crate) fn keep(port: &str, program: &Program, counts: &[i64], clock: u64) {
    if let (Some(file), Some(text)) = (file(port), written(program, counts, clock)) {
        drop(std::fs::write(file, text));
    }
}

/// What is kept.
pub(crate) fn written(program: &Program, counts: &[i64], clock: u64) -> Option<String> {
    let motors = program.motors.iter().zip(counts).map(|(motor, count)| LastPosition {
        name: motor.name.clone(),
        count: *count,
        steps: standing::start(motor) + *count as f64,
    });
    serde_json::to_string(&LastPositions { clock, motors: motors.collect() }).ok()
}

/// The positions of a program's motors, steps, if the board at the port still has the counts for which they were kept, at its clock
/// `clock`.
pub(crate) fn recall(port: &str, program: &Program, counts: &[i64], clock: u64) -> Option<Vec<f64>> {
    read(&std::fs::read_to_string(file(port)?).ok()?, program, counts, clock)
}

/// As [`recall`], from what was [written].
pub(crate) fn read(text: &str, program: &Program, counts: &[i64], clock: u64) -> Option<Vec<f64>> {
    let LastPositions { clock: kept, motors } = serde_json::from_str(text).ok()?;
    let is_same = motors.len() == program.motors.len()
        && clock >= kept
        && motors.iter().map(|motor| motor.count).eq(counts.iter().copied())
        && motors.iter().zip(&program.motors).all(|(kept, motor)| kept.name == motor.name);
    is_same.then(|| motors.iter().map(|motor| motor.steps).collect())
}
