//! Full steps in a revolution of a motor: what a file or a command line says, checked.

/// Fewer full steps than any common motor has: what says so is a step angle, most often.
pub const FEWEST: u32 = 20;
/// More than any motor has, gears inside included.
pub const MOST: u32 = 10_000;

/// Why a number is not a motor's full steps in a revolution.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FullStepsError {
    /// It is what a full step turns.
    #[error("{degrees}: that is a step angle in degrees, not the full steps in a revolution")]
    Angle {
        /// As it was written, degrees.
        degrees: f64,
        /// Steps in a revolution that go with it.
        steps: u32,
    },
    /// It is no whole number.
    #[error("{0}: a motor has a whole number of full steps in a revolution")]
    NotWhole(f64),
    /// No motor has so few or so many.
    #[error("{0}: a motor has {FEWEST} to {MOST} full steps in a revolution")]
    OutOfRange(f64),
}

/// The half-step angle that the data sheet of the 28BYJ-48 gives as its step angle, degrees.
const HALF_STEP_OF_28BYJ_48: f64 = 5.625;

impl FullStepsError {
    /// What is wrong, without the place.
    #[must_use]
    pub const fn label(self) -> &'static str {
        match self {
            FullStepsError::Angle { .. } => "a step angle",
            FullStepsError::NotWhole(_) => "not whole",
            FullStepsError::OutOfRange(_) => "out of range",
        }
    }

    /// What to write.
    #[must_use]
    pub fn advice(self) -> String {
        match self {
            FullStepsError::Angle { degrees: HALF_STEP_OF_28BYJ_48, .. } => {
                "a 28BYJ-48, whose data sheet gives the angle of a half step: steps_per_rev = 32, microsteps = 2, gear = 63.68395"
                    .to_owned()
            }
            FullStepsError::Angle { steps, .. } => format!("write steps_per_rev = {steps}: 360° / step angle"),
            FullStepsError::NotWhole(_) => {
                "what turns behind a gearbox: give the motor's own steps, steps_per_rev = 200, and the gear, gear = 3.7"
                    .to_owned()
            }
            FullStepsError::OutOfRange(steps) if steps > f64::from(MOST) => {
                "give full steps, without microsteps: steps_per_rev = 200, microsteps = 16".to_owned()
            }
            FullStepsError::OutOfRange(_) => {
                "most motors have 200 (1.8°): steps_per_rev = 200. For one that has fewer, write twice as many and gear = 0.5"
                    .to_owned()
            }
        }
    }
}

/// Full steps in a revolution.
///
/// ```
/// use pulsetrain_motion::full_steps::{FullStepsError, checked};
/// assert_eq!(checked(200.0), Ok(200));
/// assert_eq!(checked(1.8), Err(FullStepsError::Angle { degrees: 1.8, steps: 200 }));
/// assert_eq!(checked(200.5), Err(FullStepsError::NotWhole(200.5)));
/// ```
///
/// # Errors
/// [`FullStepsError`] if it is not a whole number from [`FEWEST`] to [`MOST`].
pub fn checked(number: f64) -> Result<u32, FullStepsError> {
    let range = f64::from(FEWEST)..=f64::from(MOST);
    if range.contains(&number) && number.fract() == 0.0 {
        return Ok(number as u32);
    }
    let steps = 360.0 / number;
    let is_angle = range.contains(&steps.round()) && (steps - steps.round()).abs() <= 1e-6 * steps;
    Err(match number {
        degrees if is_angle => FullStepsError::Angle { degrees, steps: steps.round() as u32 },
        _ if number > 0.0 && number <= f64::from(MOST) && number.fract() != 0.0 => FullStepsError::NotWhole(number),
        _ => FullStepsError::OutOfRange(number),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn step_angles_are_told_from_steps() {
        for (degrees, steps) in [
            (1.8, 200),
            (0.9, 400),
            (0.72, 500),
            (0.36, 1000),
            (3.6, 100),
            (3.75, 96),
            (7.5, 48),
            (11.25, 32),
            (15.0, 24),
            (18.0, 20),
        ] {
            let error = checked(degrees).unwrap_err();
            assert_eq!(error, FullStepsError::Angle { degrees, steps });
            assert!(error.advice().contains(&format!("steps_per_rev = {steps}")), "{}", error.advice());
            assert_eq!(checked(f64::from(steps)), Ok(steps));
        }
        assert!(checked(5.625).unwrap_err().advice().contains("steps_per_rev = 32, microsteps = 2"));
    }

    #[test]
    fn anything_else_that_no_motor_has_is_refused() {
        for number in [200.5, 2037.8864, 0.123] {
            assert_eq!(checked(number), Err(FullStepsError::NotWhole(number)));
        }
        for number in [0.0, -200.0, 7.0, 17.0, 51_200.0, 1e300, f64::INFINITY] {
            assert_eq!(checked(number), Err(FullStepsError::OutOfRange(number)), "{number}");
        }
        assert!(checked(51_200.0).unwrap_err().advice().contains("microsteps = 16"));
    }
}
