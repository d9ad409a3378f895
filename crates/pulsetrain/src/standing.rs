//! Where motors stand, in the file's units, and the command that brings them back.

use std::fmt;

use pulsetrain_motion::Time;
use pulsetrain_motion::human;
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::program::{Motor, Program, Scale};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where a motor stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Standing {
    /// The motor's name in the file.
    pub name: String,
    /// Steps forward minus steps backward since the board was set up.
    pub steps: i64,
    /// Its position in the file's unit.
    pub position: f64,
    /// That unit.
    pub unit: String,
    /// It was stopped at once above its pull-in speed, and may stand elsewhere than it counted.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_uncertain: bool,
}

impl fmt::Display for Standing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Standing { name, steps, position, unit, is_uncertain } = self;
        let position = human::significant(*position, 7);
        write!(f, "{name} at {position} {}", human::unit(unit))?;
        if unit != "step" {
            write!(f, " ({} steps since the start)", human::count((*steps).into()))?;
        }
        if *is_uncertain { write!(f, ", or farther: it was too fast to stop at once") } else { Ok(()) }
    }
}

/// Where a motor's law begins, steps: its position when the board's count is 0.
#[must_use]
pub fn start(motor: &Motor) -> f64 {
    // A law without a beginning was refused before.
    Cursor::new(&motor.law).at(Time::ZERO).map_or(0.0, |sample| sample.position)
}

/// Where the motors of a program stand, from the board's counts. `uncertain` may be shorter than the motors.
#[must_use]
pub fn standings(program: &Program, counts: &[i64], uncertain: &[bool]) -> Vec<Standing> {
    let motors = program.motors.iter().zip(counts).enumerate();
    let each = motors.map(|(index, (motor, steps))| Standing {
        name: motor.name.clone(),
        steps: *steps,
        position: (start(motor) + *steps as f64) / motor.scale.steps_per_unit,
        unit: motor.scale.unit.clone(),
        is_uncertain: uncertain.get(index).copied().unwrap_or(false),
    });
    each.collect()
}

/// All of them in a sentence: "wheel at 37.35 deg (83 steps since the start), arm at 0 mm (0 steps since the start)".
#[must_use]
pub fn listed(standings: &[Standing]) -> String {
    standings.iter().map(Standing::to_string).collect::<Vec<_>>().join("; ")
}

/// A position in steps as a quantity that can be typed, to a hundredth of a step.
#[must_use]
pub fn typed(steps: f64, scale: &Scale) -> String {
    let decimals = (scale.steps_per_unit.log10().ceil().max(0.0) as usize + 2).min(15);
    let text = format!("{:.decimals$}", steps / scale.steps_per_unit);
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    // "-0" is 0.
    let text = if text == "-0" { "0" } else { text };
    format!("{text} {}", scale.unit)
}

/// The command that brings motors from where they stand back to the motion's start. `None` if all stand there, or one does
/// not know where it stands.
#[must_use]
pub fn way_back(file: &str, program: &Program, standings: &[Standing], options: &str) -> Option<String> {
    if standings.iter().any(|standing| standing.is_uncertain) || standings.iter().all(|standing| standing.steps == 0) {
        return None;
    }
    let motors = &program.motors;
    let starts: Vec<f64> = motors.iter().map(start).collect();
    let target = match motors.first() {
        Some(first)
            if starts.iter().all(|start| *start == 0.0)
                && motors.iter().all(|motor| motor.scale.unit == first.scale.unit) =>
        {
            format!("\"0 {}\"", first.scale.unit)
        }
        _ => START.to_owned(),
    };
    let from = motors.iter().zip(starts).zip(standings).map(|((motor, start), standing)| {
        let position = typed(start + standing.steps as f64, &motor.scale);
        if motors.len() == 1 {
            format!(" --from \"{position}\"")
        } else {
            format!(" --from \"{}={position}\"", motor.name)
        }
    });
    let from: String = from.collect();
    Some(format!("pulsetrain goto {} {target}{options}{from}", quoted(file)))
}

/// What `goto` calls the position at which the motion begins.
pub const START: &str = "start";

/// A word of a command line, in quotes if a shell would split it.
#[must_use]
pub fn quoted(word: &str) -> String {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "/\\.:_-+=,@%".contains(letter);
    if !word.is_empty() && word.chars().all(is_plain) { word.to_owned() } else { format!("\"{word}\"") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_position_can_be_typed_to_a_hundredth_of_a_step() {
        let check = |steps: f64, unit: &str, steps_per_unit: f64, expected: &str| {
            let scale = Scale { unit: unit.to_owned(), steps_per_unit, steps_per_rev: 200.0 };
            assert_eq!(typed(steps, &scale), expected);
        };
        check(415.0, "deg", 3200.0 / 360.0, "46.688 deg");
        check(-415.0, "rev", 3200.0, "-0.129688 rev");
        check(8000.0, "step", 1.0, "8000 step");
        check(-0.0, "mm", 80.0, "0 mm");
        check(1.0, "m", 80_000.0, "0.0000125 m");
    }

    #[test]
    fn words_of_a_command_are_quoted_where_a_shell_would_split_them() {
        for (word, expected) in [("a/b-1.toml", "a/b-1.toml"), ("my motion.toml", "\"my motion.toml\""), ("", "\"\"")] {
            assert_eq!(quoted(word), expected);
        }
    }
}
