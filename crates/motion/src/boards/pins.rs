//! Which pins of a board work together, and what they cost: what each board's rules answer.

use std::fmt;

use super::profile::{BoardProfile, EdgeDelay, SharedSteps};
use crate::motor::Motor;

/// Why a pin cannot drive a motor.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PinError {
    /// The board has no such pin.
    #[error("the board `{board}` has no pin {pin}: its pins are {first} to {last}")]
    None {
        /// Board.
        board: &'static str,
        /// The pin in the motion file.
        pin: String,
        /// Lowest pin number.
        first: u8,
        /// Highest pin number.
        last: u8,
    },
    /// The pin is taken.
    #[error("pin {pin} of the board `{board}` is taken: {why}")]
    Reserved {
        /// Board.
        board: &'static str,
        /// Pin number.
        pin: u8,
        /// What uses it.
        why: &'static str,
    },
}

/// Why a board cannot drive the pins of these motors together.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{problem}")]
pub struct PinsError {
    problem: String,
    advice: String,
}

impl PinsError {
    /// An error that says what does not fit, and what would.
    #[must_use]
    pub fn new(problem: impl fmt::Display, advice: String) -> PinsError {
        PinsError { problem: problem.to_string(), advice }
    }

    /// What would work instead.
    #[must_use]
    pub fn advice(&self) -> String {
        self.advice.clone()
    }
}

/// What is known of a board that is no number: which pins work together, and what pins and pulses cost. The answers that are here are those of a
/// board whose pins are all equivalent, and whose limits hold for all pulses.
pub trait PinRules: Sync {
    /// Whether the board can drive these motors' pins together.
    ///
    /// # Errors
    /// [`PinsError`] if it cannot.
    fn check(&self, motors: &[Motor]) -> Result<(), PinsError> {
        let _ = motors;
        Ok(())
    }

    /// [`BoardProfile::shortest_intervals`].
    fn shortest_intervals(&self, board: &BoardProfile, motors: &[Motor]) -> Vec<u32> {
        let _ = motors;
        board.min_interval_ticks.to_vec()
    }

    /// [`BoardProfile::turn_ticks`].
    fn turn_ticks(&self, board: &BoardProfile, motors: &[Motor]) -> u32 {
        let _ = motors;
        board.turn_ticks
    }

    /// [`BoardProfile::shared_steps`].
    fn shared_steps(&self, board: &BoardProfile, motors: &[Motor]) -> Option<SharedSteps> {
        let _ = (board, motors);
        None
    }

    /// [`BoardProfile::longest_pulse_together`].
    fn longest_pulse_together(&self, board: &BoardProfile, motors: &[Motor]) -> Option<u32> {
        let _ = (board, motors);
        None
    }

    /// [`BoardProfile::edge_delay`].
    fn edge_delay(&self, board: &BoardProfile, motors: &[Motor]) -> EdgeDelay {
        let _ = (board, motors);
        EdgeDelay::default()
    }

    /// [`BoardProfile::shortest_of_four_baked`].
    fn shortest_of_four_baked(&self) -> Option<u32> {
        None
    }
}

/// All pins are equivalent.
#[derive(Clone, Copy, Debug)]
pub struct AnyPins;

impl PinRules for AnyPins {}

/// The enable line, where a board has one for all motors.
#[derive(Debug, Default)]
pub(super) struct EnableLine<'a>(Option<(&'a str, (u8, bool))>);

impl<'a> EnableLine<'a> {
    /// Notes a motor's enable pin, and the level that switches it on.
    pub(super) fn add(&mut self, motor: &'a str, enable: Option<(u8, bool)>) -> Result<(), TwoEnables> {
        match (enable, self.0) {
            (Some(enable), None) => self.0 = Some((motor, enable)),
            (Some(enable), Some((first, known))) if enable != known => {
                return Err(TwoEnables { first: first.to_owned(), second: motor.to_owned() });
            }
            _ => {}
        }
        Ok(())
    }
}

/// Two motors have different enable lines, and the board has one for all.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("motors `{first}` and `{second}` have enable lines of their own, but the board has one for all")]
pub struct TwoEnables {
    /// The first motor with an enable line.
    pub first: String,
    /// The first motor with another pin or another level.
    pub second: String,
}

impl TwoEnables {
    /// What would work instead.
    #[must_use]
    pub fn advice(&self) -> String {
        "wire the enable inputs to one pin, with one level".to_owned()
    }
}
