//! Which pins a configuration takes, and whether PIO can drive them.

use super::MOTORS;
use super::pio::GATE;
use crate::regs;
use pulsetrain_core::output::Sequence;
use pulsetrain_core::wire::message::{Configuration, MotorSetup, NO_PIN, coil_pins};
use pulsetrain_core::wire::{Reason, Refusal};

/// GPIOs that motors cannot have, bit by GPIO: 0 and 1 are the serial line, 23 to 25 are the Pico's own, the gate among them, and
/// from 29 on no header has them.
const RESERVED_PINS: u32 = 0b11 | 0b111 << 23 | !0 << 29;
const _: () = assert!(RESERVED_PINS >> GATE & 1 == 1);

/// The lines of a motor.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Lines {
    /// STEP and DIR, on neighbouring pins.
    StepDir {
        /// 0 if STEP is the lower pin, 1 if DIR is.
        step_line: u8,
        forward_high: bool,
        step_low: bool,
    },
    /// IN1 to IN4, from the lowest on, as [`coil_pins`] has them.
    Coils { sequence: Sequence },
}

/// A motor's pins, one after the other.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) struct MotorPins {
    /// The lowest pin.
    pub(crate) base: u8,
    pub(crate) lines: Lines,
}

impl MotorPins {
    /// Of a place without a motor.
    pub(crate) const NONE: MotorPins = MotorPins { base: 0, lines: Lines::Coils { sequence: Sequence::Half } };

    /// # Errors
    /// When PIO cannot drive them: the outputs of a state machine are consecutive pins (§3.5.6).
    fn of(setup: &MotorSetup) -> Result<MotorPins, Refusal> {
        let MotorSetup { step_pin, dir_pin, forward_high, step_low, .. } = *setup;
        if let Some(sequence) = setup.coils() {
            return Ok(MotorPins { base: step_pin, lines: Lines::Coils { sequence } });
        }
        let (base, step_line) = match dir_pin.wrapping_sub(step_pin) {
            1 => (step_pin, 0),
            0xff => (dir_pin, 1),
            _ => return Err(Refusal { reason: Reason::PinMix, detail: u16::from(dir_pin) }),
        };
        Ok(MotorPins { base, lines: Lines::StepDir { step_line, forward_high, step_low } })
    }

    /// Its pins, from the lowest to the highest.
    pub(crate) fn pins(&self) -> impl Iterator<Item = u8> {
        let (pins, count) = match self.lines {
            Lines::StepDir { .. } => ([self.base, self.base.wrapping_add(1), 0, 0], 2),
            Lines::Coils { .. } => (coil_pins(self.base), 4),
        };
        pins.into_iter().take(count)
    }

    /// The number of GPIOs from the lowest pin to the highest, with those between that are not the motor's.
    pub(crate) fn span(&self) -> u32 {
        self.pins().last().map_or(0, |last| u32::from(last.wrapping_sub(self.base)) + 1)
    }

    /// Whether the pin is low when its line is high.
    pub(crate) fn is_inverted(&self, pin: u8) -> bool {
        matches!(self.lines, Lines::StepDir { step_low: true, step_line, .. } if pin == self.base + step_line)
    }
}

/// All pins of a configuration.
#[derive(Clone, Copy)]
pub(crate) struct PinLayout {
    pub(crate) motors: [MotorPins; MOTORS],
    pub(crate) count: u8,
    /// The pin that enables all drivers, or [`NO_PIN`].
    pub(crate) enable: u8,
    /// All pins, bit by GPIO.
    pub(crate) used: u32,
}

impl PinLayout {
    /// # Errors
    /// When a pin is not there, is used twice, or is not next to the others of its motor; when there are too many motors.
    pub(crate) fn of(configuration: &Configuration<'_>) -> Result<PinLayout, Refusal> {
        let count = configuration.motors().len();
        if count > MOTORS {
            return Err(Refusal { reason: Reason::TooManyMotors, detail: MOTORS as u16 });
        }
        let (enable, mut used) = (configuration.enable_pin, 0);
        let mut motors = [MotorPins::NONE; MOTORS];
        let mut take = |pin: u8| {
            let detail = u16::from(pin);
            if pin >= 32 || RESERVED_PINS >> pin & 1 != 0 {
                return Err(Refusal { reason: Reason::Pin, detail });
            }
            if used >> pin & 1 != 0 {
                return Err(Refusal { reason: Reason::PinTaken, detail });
            }
            used |= 1_u32 << pin;
            Ok(())
        };
        for (place, setup) in motors.iter_mut().zip(configuration.motors()) {
            *place = MotorPins::of(&setup)?;
            place.pins().try_for_each(&mut take)?;
        }
        if enable != NO_PIN {
            take(enable)?;
        }
        Ok(PinLayout { motors, count: count as u8, enable, used })
    }
}

/// Releases pins, bit by GPIO: nothing drives them, as after a reset.
pub(crate) fn release(pins: u32) {
    regs::SIO_OE_CLR.write(pins);
    for pin in (0..30).filter(|pin| pins >> pin & 1 != 0) {
        // §2.19.2, §2.19.6.3.
        regs::gpio_ctrl(pin).write(31);
        regs::pad(pin).write(1 << 6 | 1 << 4 | 1 << 2 | 1 << 1);
    }
}
