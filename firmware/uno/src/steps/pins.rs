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
    pub(crate) fn drive(self, high: bool) {
        let (direction, port) = self.registers();
        if high { port.set(self.mask) } else { port.clear(self.mask) }
        direction.set(self.mask);
    }

    /// Sets the level of an output. An interrupt may be toggling its neighbours.
    pub(crate) fn set(self, high: bool) {
        let (_, port) = self.registers();
        regs::free(|| if high { port.set(self.mask) } else { port.clear(self.mask) });
    }

    /// Makes it an input without pull-up, as after a reset. As [`Pin::drive`].
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

    /// No lines.
    pub(crate) const NONE: Lines = Lines { step: 0, dir: 0, flags: 0, step_pin: 0, dir_pin: 0 };

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

    /// Whether DIR is high.
    pub(crate) fn dir_is_high(self) -> bool {
        Pin::of(self.dir_pin).is_some_and(|pin| {
            let (_, port) = pin.registers();
            port.read() & pin.mask != 0
        })
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
    lines: [Option<Lines>; MAX_MOTORS],
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
        if motors.len() > MAX_MOTORS {
            return Err(Refusal { reason: Reason::TooManyMotors, detail: MAX_MOTORS as u16 });
        }
        // Bit by pin.
        let (mut steps, mut dirs) = (0u32, 0u32);
        for motor in motors {
            if steps & output(motor.step_pin)? != 0 {
                return Err(refused(Reason::PinTaken, motor.step_pin));
            }
            steps |= output(motor.step_pin)?;
            dirs |= output(motor.dir_pin)?;
        }
        if let Some(motor) = configuration.motors().find(|motor| steps & bit(motor.dir_pin) != 0) {
            return Err(refused(Reason::PinTaken, motor.dir_pin));
        }
        let enable = match configuration.enable_pin {
            NO_PIN => None,
            pin if (steps | dirs) & bit(pin) != 0 => return Err(refused(Reason::PinTaken, pin)),
            pin => Some(Pin::of(pin).ok_or(refused(Reason::Pin, pin))?),
        };
        let kind = Layout::kind(configuration, steps, dirs)?;
        let mut lines = [None; MAX_MOTORS];
        for (place, motor) in lines.iter_mut().zip(configuration.motors()) {
            let others = configuration.motors().filter(|other| other.dir_pin == motor.dir_pin).count();
            *place = Some(Layout::lines_of(kind, &motor, others > 1)?);
        }
        Ok(Layout { kind, lines, enable })
    }

    /// The lines of each motor.
    pub(crate) fn lines(&self) -> impl Iterator<Item = &Lines> {
        self.lines.iter().flatten()
    }

    #[inline(never)]
    fn kind(configuration: &Configuration<'_>, steps: u32, dirs: u32) -> Result<Kind, Refusal> {
        const COMPARE: u32 = 0x0600;
        const PORT_D: u32 = 0x00fc;
        const PORT_B: u32 = 0x3f00;
        let all = steps | dirs;
        let dirs_are_own = configuration.motors().len() == dirs.count_ones() as usize;
        if steps & !COMPARE == 0 && dirs_are_own {
            return Ok(Kind::Compare);
        }
        if all & !PORT_D == 0 {
            return Ok(Kind::PortD);
        }
        if all & !PORT_B == 0 {
            return Ok(Kind::PortB);
        }
        // STEP 12 and DIR 13 belong together.
        let misfit = |motor: &MotorSetup| {
            let a_axis = motor.step_pin == 12 && motor.dir_pin == 13;
            let on_port_d = (bit(motor.step_pin) | bit(motor.dir_pin)) & !PORT_D == 0;
            !(a_axis || on_port_d)
        };
        match configuration.motors().find(misfit) {
            None => Ok(Kind::Shield),
            Some(motor) => {
                let step_fits = bit(motor.step_pin) & PORT_D != 0;
                Err(refused(Reason::PinMix, if step_fits { motor.dir_pin } else { motor.step_pin }))
            }
        }
    }

    #[inline(never)]
    fn lines_of(kind: Kind, motor: &MotorSetup, shared_dir: bool) -> Result<Lines, Refusal> {
        let pin = |number| Pin::of(number).ok_or(refused(Reason::Pin, number));
        let (step_pin, dir_pin) = (pin(motor.step_pin)?, pin(motor.dir_pin)?);
        let (step, dir) = match kind {
            Kind::Shield if motor.step_pin == 12 => (1 << 0, 1 << 1),
            _ => (step_pin.mask, dir_pin.mask),
        };
        let flag = |is, bit| if is { bit } else { 0 };
        let flags = flag(motor.forward_high, Lines::FORWARD_HIGH)
            | flag(motor.step_low, Lines::STEP_LOW)
            | flag(shared_dir, Lines::SHARED_DIR);
        Ok(Lines { step, dir, flags, step_pin: motor.step_pin, dir_pin: motor.dir_pin })
    }
}

fn refused(reason: Reason, pin: u8) -> Refusal {
    Refusal { reason, detail: u16::from(pin) }
}

fn bit(pin: u8) -> u32 {
    if pin < 32 { 1 << pin } else { 0 }
}

/// The bit of a pin that can be STEP or DIR.
fn output(pin: u8) -> Result<u32, Refusal> {
    if (2..14).contains(&pin) { Ok(bit(pin)) } else { Err(refused(Reason::Pin, pin)) }
}
