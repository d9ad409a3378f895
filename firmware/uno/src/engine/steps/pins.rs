//! Which pins can be used together, and how their edges are made.
//!
//! One write to a port makes an edge. So all STEP and DIR pins of a configuration must lie where one interrupt reaches them:
//!
//! | kind | STEP and DIR | edges by |
//! |---|---|---|
//! | [`Kind::Compare`] | one or two motors, STEP on 9 and 10, active high, each with a DIR of its own on 2–13 | the timer, to the cycle |
//! | [`Kind::PortD`] | all on 2–7 | software, one port |
//! | [`Kind::PortDTwoRings`] | two motors on 2–7, each with a DIR of its own, pulses up to 1 µs or over 1.9 µs | software, a ring each |
//! | [`Kind::PortB`] | all on 8–13 | software, one port |
//! | [`Kind::Shield`] | on 2–7, and one motor with STEP 12, DIR 13 (the CNC shield's A axis) | software, both ports |
//! | `Kind::ShieldTwoRings` | the same with four motors and pulses up to 1 µs, in programs that support it | software, a ring for each port |

use crate::ThisProgram;
use crate::engine::program::Program;
use crate::engine::regs::{self, Port};
use pulsetrain_core::wire::message::{Configuration, MotorSetup, NO_PIN};
use pulsetrain_core::wire::{Reason, Refusal};

pub(crate) use pulsetrain_core::boards::uno::MAX_MOTORS;

/// How edges are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// By the timer's compare outputs.
    Compare,
    /// On PORTD.
    PortD,
    /// On PORTD, two motors with a ring each. The interrupt of ring B makes only the short pulse.
    PortDTwoRings,
    /// On PORTB.
    PortB,
    /// On PORTD, and on PB4 and PB5 as bits 0 and 1.
    Shield,
    /// On PORTD, and one motor with a ring of its own on PORTB.
    ShieldTwoRings,
}

/// A pin: port and bit, or none.
#[derive(Clone, Copy)]
pub(crate) struct Pin {
    port: Port,
    /// Its bit. 0 for no pin: all operations are possible then, and do nothing.
    mask: u8,
}

impl Pin {
    /// No pin.
    pub(crate) const NONE: Pin = Pin { port: regs::PORT_B, mask: 0 };

    /// The board's LED, pin 13.
    pub(crate) const LAMP: Pin = Pin { port: regs::PORT_B, mask: 1 << 5 };

    /// Zeros, which take no flash. No operation is allowed.
    pub(crate) const UNSET: Pin = Pin { port: regs::NO_PORT, mask: 0 };

    /// Pins 2 to 19 by their Arduino numbers. 0 and 1 belong to the serial line.
    #[inline(never)]
    fn of(number: u8) -> Pin {
        let (port, bit) = match number {
            2..8 => (regs::PORT_D, number),
            8..14 => (regs::PORT_B, number - 8),
            14..20 => (regs::PORT_C, number - 14),
            _ => return Pin::NONE,
        };
        Pin { port, mask: 1 << bit }
    }

    /// Makes it an output at the level `high`. The level is set first, so that the pin never shows another.
    #[inline(never)]
    pub(crate) fn drive(self, high: bool) {
        self.set(high);
        regs::critical(|| self.port.direction().set(self.mask));
    }

    /// Sets the level of an output. Interrupts must be off for that, since they toggle other pins of the port.
    #[inline(never)]
    pub(crate) fn set(self, high: bool) {
        let levels = self.port.levels();
        regs::critical(|| if high { levels.set(self.mask) } else { levels.clear(self.mask) });
    }

    /// Whether it is driven high.
    fn is_high(self) -> bool {
        self.port.levels().read() & self.mask != 0
    }

    /// Makes it an input without pull-up, as after a reset.
    #[inline(never)]
    pub(crate) fn float(self) {
        regs::critical(|| self.port.direction().clear(self.mask));
        self.set(false);
    }
}

/// The two lines of one motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Lines {
    /// STEP's bit in a group.
    pub(crate) step: u8,
    /// DIR's bit in a group.
    pub(crate) dir: u8,
    flags: u8,
    step_pin: u8,
    dir_pin: u8,
}

impl Lines {
    /// Where the flags are, for assembly.
    pub(super) const FLAGS: usize = core::mem::offset_of!(Lines, flags);

    /// None.
    pub(crate) const NONE: Lines = Lines { step: 0, dir: 0, flags: 0, step_pin: 0, dir_pin: 0 };

    pub(super) const FORWARD_HIGH: u8 = 1;
    const STEP_LOW: u8 = 2;

    /// Forward is DIR high.
    #[inline(always)]
    pub(crate) const fn forward_high(self) -> bool {
        self.flags & Lines::FORWARD_HIGH != 0
    }

    /// STEP is active low.
    #[inline(always)]
    pub(crate) const fn step_low(self) -> bool {
        self.flags & Lines::STEP_LOW != 0
    }

    /// Makes both lines outputs: STEP inactive, DIR low.
    pub(crate) fn drive(self) {
        Pin::of(self.step_pin).drive(self.step_low());
        Pin::of(self.dir_pin).drive(false);
    }

    /// Makes both lines inputs.
    pub(crate) fn float(self) {
        Pin::of(self.step_pin).float();
        Pin::of(self.dir_pin).float();
    }

    /// Sets STEP to its level at rest.
    pub(crate) fn rest(self) {
        Pin::of(self.step_pin).set(self.step_low());
    }

    /// Which of the lines are high while STEP rests, as bits of a group.
    pub(crate) fn levels(self) -> u8 {
        let mut levels = if self.step_low() { self.step } else { 0 };
        if Pin::of(self.dir_pin).is_high() {
            levels |= self.dir;
        }
        levels
    }
}

/// The pins of a configuration, checked.
#[derive(Clone, Copy)]
pub(crate) struct Layout {
    /// How edges are made.
    pub(crate) kind: Kind,
    /// DIR lines that more than one motor uses: bit by pin.
    shared: u16,
    /// The enable line of all drivers.
    pub(crate) enable: Pin,
}

impl Layout {
    /// Finds a way to serve all pins of `configuration`.
    ///
    /// # Errors
    /// Which pin cannot be used, and why.
    #[inline(never)]
    pub(crate) fn of(configuration: &Configuration<'_>) -> Result<Layout, Refusal> {
        let motors = configuration.motors();
        if motors.len() == 0 || motors.len() > MAX_MOTORS {
            return Err(Refusal { reason: Reason::TooManyMotors, detail: MAX_MOTORS as u16 });
        }
        // Bit by pin.
        let (mut steps, mut dirs, mut shared) = (0, 0, 0);
        for motor in motors {
            let (step, dir) = (output(motor.step_pin)?, output(motor.dir_pin)?);
            if (steps | dirs) & step != 0 {
                return Err(refused(Reason::PinTaken, motor.step_pin));
            }
            steps |= step;
            if steps & dir != 0 {
                return Err(refused(Reason::PinTaken, motor.dir_pin));
            }
            shared |= dirs & dir;
            dirs |= dir;
        }
        let number = configuration.enable_pin;
        let enable = Pin::of(number);
        if number != NO_PIN && enable.mask == 0 {
            return Err(refused(Reason::Pin, number));
        }
        if number < 16 && (steps | dirs) & bit(number) != 0 {
            return Err(refused(Reason::PinTaken, number));
        }
        let kind = kind(configuration, steps, dirs, shared)?;
        Ok(Layout { kind, shared, enable })
    }

    /// Gives two motors on PORTD a ring each, and the shield's motor on PORTB a ring of its own, if that is possible.
    #[inline(never)]
    pub(crate) fn part(&mut self, motors: u8, pulse_ticks: u16) {
        if ThisProgram::SHIELD_B
            && self.kind == Kind::Shield
            && self.shared == 0
            && motors == MAX_MOTORS as u8
            && pulse_ticks <= 16
        {
            self.kind = Kind::ShieldTwoRings;
        }
        if self.kind == Kind::PortD && self.shared == 0 && motors == 2 && !matches!(pulse_ticks, 17..32) {
            self.kind = Kind::PortDTwoRings;
        }
    }

    /// Whether motors share a DIR line.
    pub(crate) fn is_shared(&self) -> bool {
        self.shared != 0
    }

    /// The lines of `motor`, which has been checked.
    #[inline(never)]
    pub(crate) fn lines(&self, motor: &MotorSetup) -> Lines {
        let MotorSetup { step_pin, dir_pin, forward_high, step_low, .. } = *motor;
        let mask = |pin| Pin::of(pin).mask;
        let (step, dir) = if self.kind == Kind::Shield && step_pin == 12 {
            (1 << 0, 1 << 1)
        } else {
            (mask(step_pin), mask(dir_pin))
        };
        let mut flags = 0;
        if forward_high {
            flags |= Lines::FORWARD_HIGH;
        }
        if step_low {
            flags |= Lines::STEP_LOW;
        }
        Lines { step, dir, flags, step_pin, dir_pin }
    }
}

/// The way to make all these edges.
#[inline(never)]
fn kind(configuration: &Configuration<'_>, steps: u16, dirs: u16, shared: u16) -> Result<Kind, Refusal> {
    const COMPARE: u16 = 0x0600;
    const PORT_D: u16 = 0x00fc;
    const PORT_B: u16 = 0x3f00;
    let all = steps | dirs;
    // The compare hardware makes pulses that are active high.
    let low = configuration.motors().any(|motor| motor.step_low);
    if steps & !COMPARE == 0 && shared == 0 && !low {
        return Ok(Kind::Compare);
    }
    if all & !PORT_D == 0 {
        return Ok(Kind::PortD);
    }
    if all & !PORT_B == 0 {
        return Ok(Kind::PortB);
    }
    for MotorSetup { step_pin, dir_pin, .. } in configuration.motors() {
        // STEP 12 and DIR 13 belong together.
        if (step_pin == 12 && dir_pin == 13) || (step_pin < 8 && dir_pin < 8) {
            continue;
        }
        return Err(refused(Reason::PinMix, if step_pin < 8 { dir_pin } else { step_pin }));
    }
    Ok(Kind::Shield)
}

#[inline(always)]
fn refused(reason: Reason, pin: u8) -> Refusal {
    Refusal { reason, detail: u16::from(pin) }
}

#[inline(never)]
fn bit(pin: u8) -> u16 {
    1 << (pin & 15)
}

/// The bit of a pin that can be STEP or DIR.
fn output(pin: u8) -> Result<u16, Refusal> {
    if (2..14).contains(&pin) { Ok(bit(pin)) } else { Err(refused(Reason::Pin, pin)) }
}
