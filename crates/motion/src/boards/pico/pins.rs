//! Which pins a Pico drives together: a state machine has pins with consecutive numbers (RP2040 datasheet, 3.5.6). GPIO 23 to 25 are not on the
//! header; the pins of coils may continue from 22 to 26.

use std::cmp::Reverse;
use std::ops::RangeInclusive;

use crate::boards::pins::{EnableLine, PinRules, PinsError, TwoEnables};
use crate::boards::profile::BoardProfile;
use crate::motor::{DriverTiming, Motor, Wiring};
use pulsetrain_core::pio::{SHORTEST_PULSE, STEP_DIR_OVERHEAD};
use pulsetrain_core::wire::message::coil_pins;

use super::measured::COILS;

/// A state machine for each motor.
#[derive(Clone, Copy, Debug)]
pub(super) struct PicoPins;

impl PinRules for PicoPins {
    fn check(&self, motors: &[Motor]) -> Result<(), PinsError> {
        check(motors).map_err(|error| PinsError::new(&error, error.advice()))
    }

    /// The processor's limits, or that of the pulse and three ticks. The processor needs more time for coils.
    fn shortest_intervals(&self, board: &BoardProfile, motors: &[Motor]) -> Vec<u32> {
        let word = word_ticks(motors, board.tick_hz);
        let has_coils = motors.iter().any(|motor| matches!(motor.wiring, Wiring::Coils { .. }));
        // With drivers there may be more motors than there are pins for coils: then the last figure is used.
        let coils = |count: usize| COILS.get(count).or(COILS.last()).map_or(0, |ticks| *ticks);
        let of = |(count, ticks): (usize, &u32)| word.max(*ticks).max(if has_coils { coils(count) } else { 0 });
        board.min_interval_ticks.iter().enumerate().map(of).collect()
    }

    fn turn_ticks(&self, board: &BoardProfile, motors: &[Motor]) -> u32 {
        word_turn_ticks(motors, board.tick_hz)
    }
}

/// Why a Pico cannot drive these motors.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
enum PicoPinsError {
    /// The board has one enable line for all.
    #[error(transparent)]
    TwoEnables(#[from] TwoEnables),
    /// STEP and DIR are not neighbours, so that one state machine cannot drive both.
    #[error(
        "DIR of `{motor}` (pin {dir}) is not next to its STEP (pin {step}), but a Pico drives the two as neighbours"
    )]
    NotBeside {
        /// Whose.
        motor: String,
        /// Pin of STEP.
        step: u8,
        /// Pin of DIR.
        dir: u8,
    },
    /// Two motors share a DIR pin, which two state machines cannot.
    #[error("motors `{first}` and `{second}` share DIR (pin {pin}), but a Pico needs one for each motor")]
    SharedDir {
        /// One motor.
        first: String,
        /// The other motor.
        second: String,
        /// Their DIR pin.
        pin: u8,
    },
    /// The four pins of coils are not consecutive, so that one state machine cannot drive them.
    #[error(
        "the coils of `{motor}` are on pins {}, {}, {} and {}, but a Pico drives four that stand one after the other on its \
         header, IN1 on the lowest", .pins[0], .pins[1], .pins[2], .pins[3]
    )]
    CoilsApart {
        /// Whose.
        motor: String,
        /// IN1 to IN4.
        pins: [u8; 4],
    },
}

impl PicoPinsError {
    /// What would work instead.
    fn advice(&self) -> String {
        match self {
            PicoPinsError::TwoEnables(error) => error.advice(),
            PicoPinsError::NotBeside { step, .. } => {
                format!("wire DIR to pin {}, or to the one below STEP", u16::from(*step) + 1)
            }
            PicoPinsError::SharedDir { .. } => "give each motor a DIR next to its STEP".to_owned(),
            PicoPinsError::CoilsApart { pins, .. } => {
                // It proposes four consecutive pins, from the lowest of the user's own on, if possible.
                let own = |in1: &u8| coil_pins(*in1).iter().filter(|pin| pins.contains(pin)).count();
                let nearest = COILS_FROM.max_by_key(|in1| (own(in1), pins.contains(in1), Reverse(*in1)));
                let [in1, in2, in3, in4] = coil_pins(nearest.unwrap_or(*COILS_FROM.start()));
                format!("wire IN1 to IN4 to {in1}, {in2}, {in3} and {in4}, say")
            }
        }
    }
}

/// The GPIOs of a Pico for IN1. The UART has those before; after those later ones there are fewer than three more pins.
const COILS_FROM: RangeInclusive<u8> = 2..=22;

/// Whether a Pico's state machines can drive these motors.
///
/// # Errors
/// [`PicoPinsError`] if the lines of a motor are not consecutive, or two motors share one.
fn check(motors: &[Motor]) -> Result<(), PicoPinsError> {
    let mut enable_line = EnableLine::default();
    let mut dirs: Vec<(&str, u8)> = Vec::new();
    for Motor { name, wiring, .. } in motors {
        match *wiring {
            Wiring::StepDir { step, dir, enable, .. } => {
                if let Some((first, pin)) = dirs.iter().find(|(_, other)| *other == dir) {
                    return Err(PicoPinsError::SharedDir {
                        first: (*first).to_owned(),
                        second: name.clone(),
                        pin: *pin,
                    });
                }
                dirs.push((name, dir));
                if step.abs_diff(dir) != 1 {
                    return Err(PicoPinsError::NotBeside { motor: name.clone(), step, dir });
                }
                enable_line.add(name, enable)?;
            }
            Wiring::Coils { pins, .. } => {
                if pins != coil_pins(pins[0]) {
                    return Err(PicoPinsError::CoilsApart { motor: name.clone(), pins });
                }
            }
        }
    }
    Ok(())
}

/// The shortest word of a Pico's state machine, ticks: the longest pulse of all motors and three cycles (`pulsetrain_core::pio`). Steps are
/// never closer than that, and a change of DIR is a word of its own.
fn word_ticks(motors: &[Motor], hz: u64) -> u32 {
    let pulse = DriverTiming::longest(motors).ticks(hz).pulse_high;
    u32::try_from(pulse.max(u64::from(SHORTEST_PULSE)) + u64::from(STEP_DIR_OVERHEAD)).unwrap_or(u32::MAX)
}

/// Time that a turn takes a Pico in addition to pulse, hold and set-up, ticks: the word that changes DIR begins when
/// the word of the step before it is over, and ends before the word of the step after it.
fn word_turn_ticks(motors: &[Motor], hz: u64) -> u32 {
    let word = u64::from(word_ticks(motors, hz));
    let timing = DriverTiming::longest(motors).ticks(hz);
    let turn = word.max(timing.pulse_high + timing.dir_hold) + word.max(timing.dir_setup);
    u32::try_from(turn - timing.reversal()).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coils_that_are_apart_are_told_what_has_most_of_their_pins() {
        let check = |pins, expected: &str| {
            let error = PicoPinsError::CoilsApart { motor: "m".to_owned(), pins };
            assert_eq!(error.advice(), format!("wire IN1 to IN4 to {expected}, say"), "{pins:?}");
        };
        check([5, 4, 3, 2], "2, 3, 4 and 5");
        check([22, 21, 27, 26], "21, 22, 26 and 27");
        check([10, 12, 14, 16], "10, 11, 12 and 13");
        check([28, 27, 26, 22], "22, 26, 27 and 28");
        check([28, 27, 26, 4], "22, 26, 27 and 28");
        check([4, 7, 12, 15], "4, 5, 6 and 7");
        check([3, 2, 1, 0], "2, 3, 4 and 5");
    }
}
