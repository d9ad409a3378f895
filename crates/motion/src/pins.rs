//! Which pins of a board work together.
//!
//! The Uno's interrupt changes pins by writing one port register. So STEP and DIR lines must be on one port, or be those that the compare
//! hardware drives. Enable lines are not timed, and may be on any pin.
//!
//! A Pico's state machine drives pins with consecutive numbers (RP2040 datasheet, 3.5.6): [`check_pico`]. GPIO 23 to 25 are not on its
//! header; the pins of coils may continue from 22 to 26.

use std::cmp::Reverse;
use std::fmt;
use std::ops::RangeInclusive;

use crate::motor::{Motor, Wiring};
use pulsetrain_core::wire::message::coil_pins;

/// A set of pins that the Uno's firmware drives together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PinKind {
    /// One or two motors with STEP on 9 and 10: the compare hardware (OC1A, OC1B) makes the edge, to the cycle.
    Compare,
    /// Everything on 2 to 7: port D.
    PortD,
    /// Everything on 8 to 13: port B.
    PortB,
    /// Everything on 2 to 7, 12 and 13: port D, with two pins of port B for the fourth axis of a CNC shield.
    Shield,
}

/// A line of a motor that does not fit the others.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stray {
    /// Whose.
    pub motor: String,
    /// "STEP" or "DIR".
    pub line: &'static str,
    /// Its pin.
    pub pin: u8,
}

impl fmt::Display for Stray {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of `{}` (pin {})", self.line, self.motor, self.pin)
    }
}

/// Why an Uno cannot drive these motors; [`PinsError::advice`] says what fits.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PinsError {
    /// The Uno's firmware does not drive coils.
    #[error("motor `{motor}` has four coil lines, but the Uno's firmware drives STEP and DIR")]
    Coils {
        /// Whose.
        motor: String,
    },
    /// Two motors have different enable lines, and the Uno has one for all.
    #[error("motors `{first}` and `{second}` have enable lines of their own, but the board has one for all")]
    TwoEnables {
        /// The first motor with an enable line.
        first: String,
        /// The first motor with another pin or another level.
        second: String,
    },
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
    /// The pins are not of one kind.
    #[error("an Uno cannot drive these pins together: {}", list(.strays))]
    Apart {
        /// The kind that fits most of the lines.
        nearest: PinKind,
        /// The lines that do not fit it.
        strays: Vec<Stray>,
    },
}

fn list(strays: &[Stray]) -> String {
    let names: Vec<String> = strays.iter().map(Stray::to_string).collect();
    match names.as_slice() {
        [rest @ .., last] if !rest.is_empty() => format!("{} and {last} are apart from the others", rest.join(", ")),
        names => format!("{} is apart from the others", names.join("")),
    }
}

impl PinsError {
    /// What would work instead.
    #[must_use]
    pub fn advice(&self) -> String {
        match self {
            PinsError::Coils { .. } => "give it a driver with STEP and DIR, or run it with --board native".to_owned(),
            PinsError::NotBeside { step, .. } => {
                format!("wire DIR to pin {}, or to the one below STEP", u16::from(*step) + 1)
            }
            PinsError::SharedDir { .. } => "give each motor a DIR next to its STEP".to_owned(),
            PinsError::CoilsApart { pins, .. } => {
                // It proposes four consecutive pins, from the lowest of the user's own on, if possible.
                let own = |in1: &u8| coil_pins(*in1).iter().filter(|pin| pins.contains(pin)).count();
                let nearest = COILS_FROM.max_by_key(|in1| (own(in1), pins.contains(in1), Reverse(*in1)));
                let [in1, in2, in3, in4] = coil_pins(nearest.unwrap_or(*COILS_FROM.start()));
                format!("wire IN1 to IN4 to {in1}, {in2}, {in3} and {in4}, say")
            }
            PinsError::TwoEnables { .. } => "wire the enable inputs to one pin, with one level".to_owned(),
            PinsError::Apart { nearest, .. } => {
                let mut text = format!("nearest: {nearest}. What fits:");
                for kind in PinKind::ALL {
                    text.push_str(&format!("\n- {kind}"));
                }
                text
            }
        }
    }
}

impl fmt::Display for PinKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            PinKind::Compare => {
                "one or two motors with STEP on 9 and 10, each with its own DIR on any of 2-8 and 11-13"
            }
            PinKind::PortD => "every STEP and DIR on 2-7",
            PinKind::PortB => "every STEP and DIR on 8-13",
            PinKind::Shield => "every STEP and DIR on 2-7, 12 and 13: the CNC shield",
        })
    }
}

impl PinKind {
    /// All kinds, the most precise one first. Where several fit, the first is used.
    pub const ALL: [PinKind; 4] = [PinKind::Compare, PinKind::PortD, PinKind::PortB, PinKind::Shield];

    /// Edge tick − scheduled tick of a STEP edge that is not delayed. `pulsetrain run` and the benches count lateness from it.
    #[must_use]
    pub const fn constant_ticks(self) -> u32 {
        match self {
            PinKind::Compare => 1,
            PinKind::PortD => 17,
            PinKind::PortB => 19,
            PinKind::Shield => 17,
        }
    }

    /// The kind of the pins that the motors of an Uno use.
    ///
    /// # Errors
    /// [`PinsError`] if the board cannot drive them together.
    ///
    /// ```
    /// use pulsetrain_motion::pins::PinKind;
    /// use pulsetrain_motion::program::Wiring;
    /// let motor = |step, dir| Wiring::StepDir { step, dir, forward_high: true, enable: None };
    /// let kind = |wirings: &[Wiring]| PinKind::of_wirings(wirings.iter().map(|wiring| ("m", wiring)));
    /// assert_eq!(kind(&[motor(8, 9)]), Ok(PinKind::PortB));
    /// assert_eq!(kind(&[motor(2, 5), motor(12, 13)]), Ok(PinKind::Shield));
    /// assert!(kind(&[motor(2, 9)]).is_err());
    /// ```
    pub fn of_wirings<'a>(wirings: impl Iterator<Item = (&'a str, &'a Wiring)>) -> Result<PinKind, PinsError> {
        let mut lines = Vec::new();
        let mut enable_line: Option<(&str, (u8, bool))> = None;
        for (motor, wiring) in wirings {
            let Wiring::StepDir { step, dir, enable, .. } = *wiring else {
                return Err(PinsError::Coils { motor: motor.to_owned() });
            };
            lines.push(Lines { motor, step, dir });
            match (enable, enable_line) {
                (Some(enable), None) => enable_line = Some((motor, enable)),
                (Some(enable), Some((first, known))) if enable != known => {
                    return Err(PinsError::TwoEnables { first: first.to_owned(), second: motor.to_owned() });
                }
                _ => {}
            }
        }
        let (nearest, strays) = Self::ALL
            .into_iter()
            .map(|kind| (kind, kind.strays(&lines)))
            .min_by_key(|(_, strays)| strays.len())
            .unwrap_or((PinKind::PortB, Vec::new()));
        if strays.is_empty() { Ok(nearest) } else { Err(PinsError::Apart { nearest, strays }) }
    }

    /// The kind of the pins of a program's motors.
    ///
    /// # Errors
    /// As [`PinKind::of_wirings`].
    pub fn of(motors: &[Motor]) -> Result<PinKind, PinsError> {
        Self::of_wirings(motors.iter().map(|motor| (motor.name.as_str(), &motor.wiring)))
    }

    /// The lines that are not on pins of this kind.
    fn strays(self, motors: &[Lines]) -> Vec<Stray> {
        let mut strays = Vec::new();
        for (index, motor) in motors.iter().enumerate() {
            let shared = motors.iter().enumerate().any(|(other, lines)| other != index && lines.dir == motor.dir);
            let (step, dir) = match self {
                PinKind::Compare => (matches!(motor.step, 9 | 10), matches!(motor.dir, 2..=8 | 11..=13) && !shared),
                PinKind::PortD => (matches!(motor.step, 2..=7), matches!(motor.dir, 2..=7)),
                PinKind::PortB => (matches!(motor.step, 8..=13), matches!(motor.dir, 8..=13)),
                PinKind::Shield => (matches!(motor.step, 2..=7 | 12 | 13), matches!(motor.dir, 2..=7 | 12 | 13)),
            };
            let mut note = |fits: bool, line, pin| {
                if !fits {
                    strays.push(Stray { motor: motor.motor.to_owned(), line, pin });
                }
            };
            note(step, "STEP", motor.step);
            note(dir, "DIR", motor.dir);
        }
        strays
    }
}

/// The GPIOs of a Pico for IN1. The UART has those before; after those later ones there are fewer than three more pins.
const COILS_FROM: RangeInclusive<u8> = 2..=22;

/// Whether a Pico's state machines can drive these motors.
///
/// # Errors
/// [`PinsError`] if the lines of a motor are not consecutive, or two motors share one.
pub fn check_pico(motors: &[Motor]) -> Result<(), PinsError> {
    let mut enable_line: Option<(&str, (u8, bool))> = None;
    let mut dirs: Vec<(&str, u8)> = Vec::new();
    for Motor { name, wiring, .. } in motors {
        match *wiring {
            Wiring::StepDir { step, dir, enable, .. } => {
                if let Some((first, pin)) = dirs.iter().find(|(_, other)| *other == dir) {
                    return Err(PinsError::SharedDir { first: (*first).to_owned(), second: name.clone(), pin: *pin });
                }
                dirs.push((name, dir));
                if step.abs_diff(dir) != 1 {
                    return Err(PinsError::NotBeside { motor: name.clone(), step, dir });
                }
                match (enable, enable_line) {
                    (Some(enable), None) => enable_line = Some((name, enable)),
                    (Some(enable), Some((first, known))) if enable != known => {
                        return Err(PinsError::TwoEnables { first: first.to_owned(), second: name.clone() });
                    }
                    _ => {}
                }
            }
            Wiring::Coils { pins, .. } => {
                if pins != coil_pins(pins[0]) {
                    return Err(PinsError::CoilsApart { motor: name.clone(), pins });
                }
            }
        }
    }
    Ok(())
}

/// The STEP and DIR lines, or the coils, of one motor.
struct Lines<'a> {
    motor: &'a str,
    step: u8,
    dir: u8,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kind(pins: &[(u8, u8)]) -> Result<PinKind, PinsError> {
        kind_with(&pins.iter().map(|&(step, dir)| (step, dir, None)).collect::<Vec<_>>())
    }

    /// STEP, DIR, and the enable line with its level.
    type UnoPins = (u8, u8, Option<(u8, bool)>);

    fn kind_with(pins: &[UnoPins]) -> Result<PinKind, PinsError> {
        const NAMES: [&str; 4] = ["a", "b", "c", "d"];
        let wirings: Vec<Wiring> =
            pins.iter().map(|&(step, dir, enable)| Wiring::StepDir { step, dir, forward_high: true, enable }).collect();
        PinKind::of_wirings(NAMES.into_iter().zip(&wirings))
    }

    #[test]
    fn the_seeds_pins_fit() {
        assert_eq!(kind(&[(8, 9)]), Ok(PinKind::PortB), "the tutorial");
        assert_eq!(kind(&[(9, 8), (10, 8), (11, 8), (12, 8)]), Ok(PinKind::PortB), "the sweep article");
        assert_eq!(kind(&[(2, 5), (3, 6), (4, 7), (12, 13)]), Ok(PinKind::Shield), "StepperWinch");
        assert_eq!(kind(&[(2, 5), (3, 6), (4, 7)]), Ok(PinKind::PortD));
        assert_eq!(kind(&[(6, 7)]), Ok(PinKind::PortD), "the maximum-speed article");
        assert_eq!(kind(&[(9, 2)]), Ok(PinKind::Compare));
        assert_eq!(kind(&[(9, 8), (10, 13)]), Ok(PinKind::Compare));
    }

    /// The compare hardware has one DIR for each motor; on port B they may share it.
    #[test]
    fn a_shared_dir_line_is_the_ports() {
        assert_eq!(kind(&[(9, 8), (10, 8)]), Ok(PinKind::PortB));
        assert!(kind(&[(9, 2), (10, 2)]).is_err());
    }

    #[test]
    fn what_is_apart_is_named_with_what_fits() {
        let error = kind(&[(9, 8), (11, 8), (5, 8)]).unwrap_err();
        assert_eq!(
            error.to_string(),
            "an Uno cannot drive these pins together: STEP of `c` (pin 5) is apart from the others"
        );
        assert!(error.advice().starts_with("nearest: every STEP and DIR on 8-13. What fits:\n- one or two motors"));
        let error = kind(&[(14, 9), (15, 8)]).unwrap_err();
        assert!(error.to_string().contains("STEP of `a` (pin 14) and STEP of `b` (pin 15) are apart"), "{error}");
    }

    #[test]
    fn one_enable_line_for_all() {
        assert_eq!(kind_with(&[(2, 5, Some((8, false))), (12, 13, Some((8, false)))]), Ok(PinKind::Shield));
        assert_eq!(kind_with(&[(2, 5, None), (3, 6, Some((19, true)))]), Ok(PinKind::PortD));
        assert!(matches!(
            kind_with(&[(2, 5, Some((8, false))), (3, 6, Some((9, false)))]),
            Err(PinsError::TwoEnables { .. })
        ));
    }

    #[test]
    fn coils_that_are_apart_are_told_what_has_most_of_their_pins() {
        let check = |pins, expected: &str| {
            let error = PinsError::CoilsApart { motor: "m".to_owned(), pins };
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

    #[test]
    fn coils_are_refused() {
        let coils = Wiring::Coils { pins: [2, 3, 4, 5], sequence: crate::motor::CoilSequence::Full };
        let error = PinKind::of_wirings([("m", &coils)].into_iter()).unwrap_err();
        assert!(error.to_string().contains("motor `m` has four coil lines"));
    }
}
