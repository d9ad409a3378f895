//! The command that brings motors back to a motion's start.

use pulsetrain_motion::program::Program;
use pulsetrain_report::positions::{MotorPosition, START, start, typed};

/// The command that brings motors from where they stand back to the motion's start. `None` if all stand there, or one does
/// not know where it stands.
#[must_use]
pub(crate) fn way_back(file: &str, program: &Program, positions: &[MotorPosition], options: &str) -> Option<String> {
    if positions.iter().any(|position| position.is_uncertain) || positions.iter().all(|position| position.steps == 0) {
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
    let from = motors.iter().zip(starts).zip(positions).map(|((motor, start), end)| {
        let position = typed(start + end.steps as f64, &motor.scale);
        if motors.len() == 1 {
            format!(" --from \"{position}\"")
        } else {
            format!(" --from \"{}={position}\"", motor.name)
        }
    });
    let from: String = from.collect();
    Some(format!("pulsetrain goto {} {target}{options}{from}", quoted(file)))
}

/// A word of a command line, in quotes if a shell would split it.
#[must_use]
pub(crate) fn quoted(word: &str) -> String {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "/\\.:_-+=,@%".contains(letter);
    if !word.is_empty() && word.chars().all(is_plain) { word.to_owned() } else { format!("\"{word}\"") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_a_command_are_quoted_where_a_shell_would_split_them() {
        for (word, expected) in [("a/b-1.toml", "a/b-1.toml"), ("my motion.toml", "\"my motion.toml\""), ("", "\"\"")] {
            assert_eq!(quoted(word), expected);
        }
    }
}
