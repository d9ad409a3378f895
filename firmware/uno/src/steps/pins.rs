//! Which pins there are, and which of them one stepgen can serve together.
//!
//! A pulse is made by one write to a port, so all STEP and DIR pins of a configuration lie where one interrupt reaches them:
//!
//! | kind | STEP and DIR | edges by |
//! |---|---|---|
//! | [`Kind::Compare`] | one or two motors, STEP on 9 and 10, DIR of its own on 2–13 | the timer, to the cycle |
//! | [`Kind::PortD`] | all on 2–7 | software, one port |
//! | [`Kind::PortB`] | all on 8–13 | software, one port |
//! | [`Kind::Shield`] | on 2–7, and one motor with STEP 12, DIR 13 (the CNC shield's A axis) | software, both ports |

use crate::regs::{self, Reg8};
use pulsetrain_core::wire::message::{Configuration, MotorSetup, NO_PIN};
use pulsetrain_core::wire::{Reason, Refusal};

/// Motors at most.
pub(crate) const MAX_MOTORS: usize = 4;

/// How edges are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// By the timer's compare outputs.
    Compare,
    /// On PORTD.
    PortD,
    /// On PORTB.
    PortB,
    /// On PORTD, and on PB4 and PB5 as bits 0 and 1.
    Shield,
}

/// A pin by its Arduino number: port and bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Pin {
    port: Port,
    mask: u8,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Port {
    B,
    C,
    D,
}

impl Pin {
    /// Pins 2 to 19; 0 and 1 are the serial line's.
    #[inline(never)]
    fn of(number: u8) -> Option<Pin> {
        let (port, bit) = match number {
            2..8 => (Port::D, number),
            8..14 => (Port::B, number - 8),
            14..20 => (Port::C, number - 14),
            _ => return None,
        };
        Some(Pin { port, mask: 1 << bit })
    }

    fn registers(self) -> (Reg8, Reg8) {
        match self.port {
            Port::B => (regs::DDRB, regs::PORTB),
            Port::C => (regs::DDRC, regs::PORTC),
            Port::D => (regs::DDRD, regs::PORTD),
        }
    }

    /// Makes it an output at `high`. The level first, so that no other is seen.
    ///
    /// Port and direction are read and written back: not while an interrupt plays groups.
    #[inline(never)]
    pub(crate) fn drive(self, high: bool) {
        let (direction, port) = self.registers();
        if high { port.set(self.mask) } else { port.clear(self.mask) }
        direction.set(self.mask);
    }

    /// Sets the level of an output. An interrupt may be toggling its neighbours.
    #[inline(never)]
    pub(crate) fn set(self, high: bool) {
        let (_, port) = self.registers();
        regs::free(|| if high { port.set(self.mask) } else { port.clear(self.mask) });
    }

    /// Whether it is driven high.
    fn is_high(self) -> bool {
        let (_, port) = self.registers();
        port.read() & self.mask != 0
    }

    /// Makes it an input without pull-up, as after a reset. As [`Pin::drive`].
    #[inline(never)]
    pub(crate) fn float(self) {
        let (direction, port) = self.registers();
        direction.clear(self.mask);
        port.clear(self.mask);
    }
}

/// The lines of one motor.
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
    const FORWARD_HIGH: u8 = 1;
    const STEP_LOW: u8 = 2;
    const SHARED_DIR: u8 = 4;

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

    /// Another motor has the same DIR line.
    #[inline(always)]
    pub(crate) const fn shared_dir(self) -> bool {
        self.flags & Lines::SHARED_DIR != 0
    }

    /// Both lines as outputs at rest: STEP inactive, DIR low.
    pub(crate) fn drive(self) {
        self.pins().for_each(|(pin, high)| pin.drive(high));
    }

    /// Both lines as inputs.
    pub(crate) fn float(self) {
        self.pins().for_each(|(pin, _)| pin.float());
    }

    /// Sets STEP to its level at rest.
    pub(crate) fn rest(self) {
        if let Some(pin) = Pin::of(self.step_pin) {
            pin.set(self.step_low());
        }
    }

    /// What of it is high while STEP rests, as bits of a group.
    pub(crate) fn levels(self) -> u8 {
        let mut levels = if self.step_low() { self.step } else { 0 };
        if Pin::of(self.dir_pin).is_some_and(Pin::is_high) {
            levels |= self.dir;
        }
        levels
    }

    /// Both pins, and their levels at rest.
    fn pins(self) -> impl Iterator<Item = (Pin, bool)> {
        let step = Pin::of(self.step_pin).map(|pin| (pin, self.step_low()));
        let dir = Pin::of(self.dir_pin).map(|pin| (pin, false));
        step.into_iter().chain(dir)
    }
}

/// The pins of a configuration, checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Layout {
    /// How edges are made.
    pub(crate) kind: Kind,
    /// DIR lines that more than one motor looks at: bit by pin.
    shared: u16,
    /// Enable of all drivers.
    pub(crate) enable: Option<Pin>,
}

impl Layout {
    /// Finds a stepgen that serves all pins of `configuration`.
    ///
    /// # Errors
    /// Which pin cannot be, and why.
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
        let enable = configuration.enable_pin;
        let enable = if enable == NO_PIN {
            None
        } else if enable < 16 && (steps | dirs) & 1 << enable != 0 {
            return Err(refused(Reason::PinTaken, enable));
        } else {
            Some(Pin::of(enable).ok_or(refused(Reason::Pin, enable))?)
        };
        let kind = kind(configuration, steps, dirs, shared)?;
        Ok(Layout { kind, shared, enable })
    }

    /// The lines of `motor`, which is one of those that were checked.
    #[inline(never)]
    pub(crate) fn lines(&self, motor: &MotorSetup) -> Lines {
        let MotorSetup { step_pin, dir_pin, forward_high, step_low, .. } = *motor;
        let mask = |pin| Pin::of(pin).map_or(0, |pin| pin.mask);
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
        if self.shared & bit(dir_pin) != 0 {
            flags |= Lines::SHARED_DIR;
        }
        Lines { step, dir, flags, step_pin, dir_pin }
    }
}

/// Who can make all these edges.
#[inline(never)]
fn kind(configuration: &Configuration<'_>, steps: u16, dirs: u16, shared: u16) -> Result<Kind, Refusal> {
    const COMPARE: u16 = 0x0600;
    const PORT_D: u16 = 0x00fc;
    const PORT_B: u16 = 0x3f00;
    let all = steps | dirs;
    if steps & !COMPARE == 0 && shared == 0 {
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

#[inline(never)]
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
