//! Where motors are, in the file's units.

use std::fmt;
use std::ops::RangeInclusive;

use pulsetrain_motion::Time;
use pulsetrain_motion::human;
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::machine::Machine;
use pulsetrain_motion::program::{Motor, Program, Scale};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where a motor stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MotorPosition {
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

impl fmt::Display for MotorPosition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let MotorPosition { name, steps, position, unit, is_uncertain } = self;
        // What rounding leaves of 0 is no position.
        let position = human::significant(if position.abs() < 1e-9 { 0.0 } else { *position }, 7);
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
pub fn motor_positions(program: &Program, counts: &[i64], uncertain: &[bool]) -> Vec<MotorPosition> {
    let motors = program.motors.iter().zip(counts).enumerate();
    let each = motors.map(|(index, (motor, steps))| MotorPosition {
        name: motor.name.clone(),
        steps: *steps,
        position: (start(motor) + *steps as f64) / motor.scale.steps_per_unit,
        unit: motor.scale.unit.clone(),
        is_uncertain: uncertain.get(index).copied().unwrap_or(false),
    });
    each.collect()
}

/// Why motors of a machine cannot be sent to a position.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OutOfRange {
    /// It is beyond the machine's `angles`.
    #[error("motor {motor} cannot go to {position}: `angles` of machine {machine} allow {least} to {most}")]
    Angles {
        /// The motor.
        motor: String,
        /// Where it was to go.
        position: String,
        /// Its machine.
        machine: String,
        /// The least position, as it can be typed.
        least: String,
        /// The largest position.
        most: String,
    },
    /// Each motor may be there, but not all of them together.
    #[error("the arms of machine {machine} do not meet at these angles: {positions}")]
    Apart {
        /// The machine.
        machine: String,
        /// Its motors and where they were to go.
        positions: String,
    },
}

impl OutOfRange {
    /// What can be done.
    #[must_use]
    pub fn advice(&self) -> String {
        match self {
            OutOfRange::Angles { least, most, .. } => format!("write a position from {least} to {most}"),
            OutOfRange::Apart { .. } => "move the arms together, or to angles that differ less".to_owned(),
        }
    }
}

/// A typed position has hundredths of a step.
const TYPED_STEPS: f64 = 0.01;

/// Checks where motors are to go, steps, against the ranges of their machines. `None`: it is not known where the motor is.
///
/// # Errors
/// For the first motor or machine that cannot be there.
pub fn check_range(program: &Program, positions: &[Option<f64>]) -> Result<(), OutOfRange> {
    for machine in &program.machines {
        let motors = || machine.motors.iter().map(|motor| (&program.motors[*motor], positions[*motor]));
        for (number, (motor, position)) in motors().enumerate() {
            let (Some(steps), Some((range, scale))) = (position, range_of(machine, number, motor)) else { continue };
            if steps < range.start() - TYPED_STEPS || steps > range.end() + TYPED_STEPS {
                let [position, least, most] = [steps, *range.start(), *range.end()].map(|steps| typed(steps, &scale));
                let (motor, machine) = (motor.name.clone(), machine.name.clone());
                return Err(OutOfRange::Angles { motor, position, machine, least, most });
            }
        }
        let since_start: Option<Vec<f64>> = motors().map(|(motor, steps)| Some(steps? - start(motor))).collect();
        if since_start.is_some_and(|steps| machine.tip(&steps).is_none()) {
            let each = motors().filter_map(|(motor, steps)| Some((motor, steps?)));
            let each = each.map(|(motor, steps)| format!("{} at {}", motor.name, typed(steps, &motor.scale)));
            let positions = each.collect::<Vec<_>>().join(", ");
            return Err(OutOfRange::Apart { machine: machine.name.clone(), positions });
        }
    }
    Ok(())
}

/// Where one of a machine's motors may be, steps, and the unit in which the file says it.
fn range_of(machine: &Machine, number: usize, motor: &Motor) -> Option<(RangeInclusive<f64>, Scale)> {
    let (range, start) = (machine.range(number)?, start(motor));
    let unit = "deg".to_owned();
    let scale = Scale { unit, steps_per_unit: range.steps_per_deg, steps_per_rev: motor.scale.steps_per_rev };
    Some((range.least + start..=range.most + start, scale))
}

/// A position that a motor can be sent to, for a message.
#[must_use]
pub fn example_position(program: &Program, motor: usize) -> String {
    let range = program.machines.iter().find_map(|machine| {
        let number = machine.motors.iter().position(|known| *known == motor)?;
        range_of(machine, number, &program.motors[motor])
    });
    let Some((range, scale)) = range else { return format!("90 {}", program.motors[motor].scale.unit) };
    let middle = (range.start() + range.end()) / 2.0;
    let whole = (middle / scale.steps_per_unit).round() * scale.steps_per_unit;
    typed(if range.contains(&whole) { whole } else { middle }, &scale)
}

/// All of them in a sentence: "wheel at 37.35 deg (83 steps since the start), arm at 0 mm (0 steps since the start)".
#[must_use]
pub fn listed(positions: &[MotorPosition]) -> String {
    positions.iter().map(MotorPosition::to_string).collect::<Vec<_>>().join("; ")
}

/// A position in steps as a quantity that can be typed, to a hundredth of a step.
#[must_use]
pub fn typed(steps: f64, scale: &Scale) -> String {
    let decimals = (libm::log10(scale.steps_per_unit).ceil().max(0.0) as usize + 2).min(15);
    let text = format!("{:.decimals$}", steps / scale.steps_per_unit);
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    // "-0" is 0.
    let text = if text == "-0" { "0" } else { text };
    format!("{text} {}", scale.unit)
}

/// What `goto` calls the position at which the motion begins.
pub const START: &str = "start";

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
}
