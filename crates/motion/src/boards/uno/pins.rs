//! Which pins an Uno drives together.
//!
//! Its interrupt changes pins by writing one port register. So STEP and DIR lines must be on one port, or be those that the compare
//! hardware drives. Enable lines are not timed, and may be on any pin.

use std::fmt;

use crate::boards::pins::{EnableLine, PinsError, TwoEnables};
use crate::motor::{Motor, Wiring};
use pulsetrain_core::boards::uno;

/// A set of pins that the Uno's firmware drives together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PinKind {
    /// One or two motors with STEP on 9 and 10: the compare hardware (OC1A, OC1B) makes the edge, to the cycle.
    Compare,
    /// Everything on 2 to 7: port D.
    PortD,
    /// Everything on 8 to 13: port B.
    PortB,
    /// Everything on 2 to 7, port D, and one motor with STEP on 12 and DIR on 13, two pins of port B: the fourth axis of a CNC shield.
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

/// Why an Uno cannot drive these motors; [`UnoPinsError::advice`] says what fits.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UnoPinsError {
    /// The Uno's firmware does not drive coils.
    #[error("motor `{motor}` has four coil lines, but the Uno's firmware drives STEP and DIR")]
    Coils {
        /// Whose.
        motor: String,
    },
    /// The board has one enable line for all.
    #[error(transparent)]
    TwoEnables(#[from] TwoEnables),
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

impl UnoPinsError {
    /// What would work instead.
    #[must_use]
    pub fn advice(&self) -> String {
        match self {
            UnoPinsError::Coils { .. } => {
                "give it a driver with STEP and DIR, or run it with --board native".to_owned()
            }
            UnoPinsError::TwoEnables(error) => error.advice(),
            UnoPinsError::Apart { nearest, .. } => {
                let mut text = format!("nearest: {nearest}. What fits:");
                for kind in PinKind::ALL {
                    text.push_str(&format!("\n- {kind}"));
                }
                text
            }
        }
    }
}

impl From<UnoPinsError> for PinsError {
    fn from(error: UnoPinsError) -> PinsError {
        PinsError::new(&error, error.advice())
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
            PinKind::Shield => "every STEP and DIR on 2-7, and one motor with STEP 12 and DIR 13: the CNC shield",
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
            PinKind::Compare => uno::EDGE_DELAY_COMPARE,
            PinKind::PortD => uno::EDGE_DELAY_PORT_D,
            PinKind::PortB => uno::EDGE_DELAY_PORT_B,
            PinKind::Shield => uno::EDGE_DELAY_SHIELD,
        }
    }

    /// The kind of the pins that the motors of an Uno use.
    ///
    /// # Errors
    /// [`UnoPinsError`] if the board cannot drive them together.
    ///
    /// ```
    /// use pulsetrain_motion::boards::uno::PinKind;
    /// use pulsetrain_motion::program::Wiring;
    /// let motor = |step, dir| Wiring::StepDir { step, dir, forward_high: true, enable: None };
    /// let kind = |wirings: &[Wiring]| PinKind::of_wirings(wirings.iter().map(|wiring| ("m", wiring)));
    /// assert_eq!(kind(&[motor(8, 9)]), Ok(PinKind::PortB));
    /// assert_eq!(kind(&[motor(2, 5), motor(12, 13)]), Ok(PinKind::Shield));
    /// assert!(kind(&[motor(2, 9)]).is_err());
    /// ```
    pub fn of_wirings<'a>(wirings: impl Iterator<Item = (&'a str, &'a Wiring)>) -> Result<PinKind, UnoPinsError> {
        let mut lines = Vec::new();
        let mut enable_line = EnableLine::default();
        for (motor, wiring) in wirings {
            let Wiring::StepDir { step, dir, enable, .. } = *wiring else {
                return Err(UnoPinsError::Coils { motor: motor.to_owned() });
            };
            lines.push(Lines { motor, step, dir });
            enable_line.add(motor, enable)?;
        }
        let (nearest, strays) = Self::ALL
            .into_iter()
            .map(|kind| (kind, kind.strays(&lines)))
            .min_by_key(|(_, strays)| strays.len())
            .unwrap_or((PinKind::PortB, Vec::new()));
        if strays.is_empty() { Ok(nearest) } else { Err(UnoPinsError::Apart { nearest, strays }) }
    }

    /// The kind of the pins of a program's motors.
    ///
    /// # Errors
    /// As [`PinKind::of_wirings`].
    pub fn of(motors: &[Motor]) -> Result<PinKind, UnoPinsError> {
        Self::of_wirings(motors.iter().map(|motor| (motor.name.as_str(), &motor.wiring)))
    }

    /// The lines that are not on pins of this kind.
    fn strays(self, motors: &[Lines]) -> Vec<Stray> {
        let mut strays = Vec::new();
        for (index, motor) in motors.iter().enumerate() {
            let shared = motors.iter().enumerate().any(|(other, lines)| other != index && lines.dir == motor.dir);
            let on = |pins: u16| [motor.step, motor.dir].map(|pin| pin < 16 && pins >> pin & 1 == 1);
            // The table is the firmware's: what fits here, it drives.
            let [step, dir] = match self {
                PinKind::Compare => {
                    // Of one motor, DIR may be on the other of the two pins.
                    let is_step = motors.iter().any(|other| other.step == motor.dir);
                    let [_, dir] = on(uno::PORT_D_PINS | uno::PORT_B_PINS);
                    [on(uno::COMPARE_STEP_PINS)[0], dir && !is_step && !shared]
                }
                PinKind::PortD => on(uno::PORT_D_PINS),
                PinKind::PortB => on(uno::PORT_B_PINS),
                PinKind::Shield => match (motor.step, on(uno::PORT_D_PINS)) {
                    (step, _) if step == uno::SHIELD_MOTOR.0 => [true, motor.dir == uno::SHIELD_MOTOR.1],
                    (_, [step, dir]) => [step, dir],
                },
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

/// The STEP and DIR lines of one motor.
struct Lines<'a> {
    motor: &'a str,
    step: u8,
    dir: u8,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kind(pins: &[(u8, u8)]) -> Result<PinKind, UnoPinsError> {
        kind_with(&pins.iter().map(|&(step, dir)| (step, dir, None)).collect::<Vec<_>>())
    }

    /// STEP, DIR, and the enable line with its level.
    type UnoPins = (u8, u8, Option<(u8, bool)>);

    fn kind_with(pins: &[UnoPins]) -> Result<PinKind, UnoPinsError> {
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

    /// Edges by the compare hardware come 18 ticks before those by the interrupt: lateness is counted from what the firmware does.
    #[test]
    fn the_other_compare_pin_may_be_dir() {
        assert_eq!(kind(&[(9, 10)]), Ok(PinKind::Compare));
        assert_eq!(kind(&[(10, 9)]), Ok(PinKind::Compare));
        assert_eq!(kind(&[(9, 10), (11, 12)]), Ok(PinKind::PortB));
    }

    /// The compare hardware has one DIR for each motor; on port B they may share it.
    #[test]
    fn a_shared_dir_line_is_the_ports() {
        assert_eq!(kind(&[(9, 8), (10, 8)]), Ok(PinKind::PortB));
        assert!(kind(&[(9, 2), (10, 2)]).is_err());
    }

    /// The firmware knows one motor on PORTB beside those on PORTD, and not a STEP or a DIR of one.
    #[test]
    fn a_motor_is_on_one_port() {
        for (step, dir, stray) in [
            (12, 5, "STEP of `b` (pin 12)"),
            (5, 13, "DIR of `b` (pin 13)"),
            (13, 12, "STEP of `b` (pin 13)"),
            (13, 5, "STEP of `b` (pin 13)"),
        ] {
            let error = kind(&[(2, 3), (step, dir)]).unwrap_err();
            assert!(error.to_string().contains(stray), "{error}");
        }
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
            Err(UnoPinsError::TwoEnables(_))
        ));
    }

    #[test]
    fn coils_are_refused() {
        let coils = Wiring::Coils { pins: [2, 3, 4, 5], sequence: crate::motor::CoilSequence::Full };
        let error = PinKind::of_wirings([("m", &coils)].into_iter()).unwrap_err();
        assert!(error.to_string().contains("motor `m` has four coil lines"));
    }
}
