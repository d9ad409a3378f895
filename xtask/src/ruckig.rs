//! Compares the durations of S-curves with those of the ruckig package, an independent time-optimal planner.

use crate::command::{self, Done, Failure, command};
use crate::random::Random;
use crate::{installs, programs};
use std::fmt::Write as _;

/// Moves compared.
pub(crate) const MOVES: usize = 1000;
/// Largest relative difference of two durations.
const TOLERANCE: f64 = 1e-6;
const SCRIPT: &str = "xtask/src/ruckig_durations.py";

/// Compares [`MOVES`] random moves. Gives the largest relative difference of two durations.
pub(crate) fn compare() -> Done<f64> {
    let moves = random_moves();
    programs::build()?;
    let ours = durations(command(programs::example("s_curve_durations")), &moves)?;
    let mut python = command(installs::python()?);
    python.arg(SCRIPT);
    let theirs = durations(python, &moves)?;

    let mut worst = 0.0;
    for ((&ours, &theirs), asked) in ours.iter().zip(&theirs).zip(moves.lines()) {
        let difference = (ours - theirs).abs() / theirs;
        if difference.is_nan() || difference > TOLERANCE {
            return Err(Failure::Check(format!("s-curve `{asked}` takes {ours} s; ruckig's takes {theirs} s")));
        }
        worst = f64::max(worst, difference);
    }
    Ok(worst)
}

/// One move a line: distance, largest speed, acceleration and jerk, start speed; steps and seconds.
///
/// Magnitudes spread over decades, so that every phase of the profile is missing in some of them; every second move
/// starts from rest, the others at any speed within the limit, also away from the target.
fn random_moves() -> String {
    let mut random = Random::new(1);
    let mut moves = String::new();
    for index in 0..MOVES {
        let sign = if random.unit() < 0.5 { -1.0 } else { 1.0 };
        let distance = sign * random.decades(0.0, 6.0);
        let speed = random.decades(1.0, 5.0);
        let acceleration = speed * random.decades(-1.0, 3.0);
        let jerk = acceleration * random.decades(-1.0, 3.0);
        let start_speed = if index % 2 == 0 { 0.0 } else { speed * (2.0 * random.unit() - 1.0) };
        // Writing to a String cannot fail.
        let _ = writeln!(moves, "{distance:e} {speed:e} {acceleration:e} {jerk:e} {start_speed:e}");
    }
    moves
}

fn durations(mut planner: std::process::Command, moves: &str) -> Done<Vec<f64>> {
    let text = command::pipe(&mut planner, moves)?;
    let durations: Vec<f64> = text.lines().filter_map(|line| line.trim().parse().ok()).collect();
    if durations.len() == MOVES {
        Ok(durations)
    } else {
        Err(Failure::Check(format!("{MOVES} moves asked, {} durations answered: {planner:?}", durations.len())))
    }
}
