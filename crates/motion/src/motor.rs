//! One motor: its law, its lines, and what its driver and itself need.

use crate::Law;
use crate::electrical::Winding;
use crate::quantity::Base;

/// One motor and all that it does.
#[derive(Clone, Debug)]
pub struct Motor {
    /// As the file calls it.
    pub name: String,
    /// Everything that it does from the common time zero on, rests included, steps.
    pub law: Law,
    /// The lines that it is driven by.
    pub wiring: Wiring,
    /// Its driver in the table of [`drivers`](crate::drivers), if the file names one.
    pub driver: Option<&'static str>,
    /// What its driver needs.
    pub timing: DriverTiming,
    /// What it can do.
    pub limits: Limits,
    /// Steps to the user's unit.
    pub scale: Scale,
    /// Its electrical data, if the file gives them.
    pub winding: Option<Winding>,
}

impl Motor {
    /// Whether another motor uses the same DIR line.
    #[must_use]
    pub fn shares_dir_with(&self, other: &Motor) -> bool {
        let dir = |motor: &Motor| match motor.wiring {
            Wiring::StepDir { dir, .. } => Some(dir),
            Wiring::Coils { .. } => None,
        };
        !std::ptr::eq(self, other) && dir(self).is_some() && dir(self) == dir(other)
    }
}

/// Steps to the user's unit, for reports and plots.
#[derive(Clone, Debug, PartialEq)]
pub struct Scale {
    /// "rev", "deg", "mm", as the file uses it most.
    pub unit: String,
    /// Steps in one of that unit.
    pub steps_per_unit: f64,
    /// Steps in one revolution of the motor's shaft.
    pub steps_per_rev: f64,
}

/// Steps in one of each unit in which a motor's position may be given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionUnits {
    /// Steps in a revolution of what the motor drives.
    pub steps_per_turn: f64,
    /// Steps in a millimetre, if the motor has a lead.
    pub steps_per_mm: Option<f64>,
    /// Steps in a full step of the motor.
    pub steps_per_full_step: f64,
}

impl PositionUnits {
    /// Steps in one of a base unit; `None` if no position of this motor can be given in it.
    ///
    /// ```
    /// use pulsetrain_motion::{program::PositionUnits, quantity::Base};
    /// let units = PositionUnits { steps_per_turn: 3200.0, steps_per_mm: None, steps_per_full_step: 16.0 };
    /// assert_eq!((units.steps(Base::Turn), units.steps(Base::Length)), (Some(3200.0), None));
    /// ```
    #[must_use]
    pub fn steps(&self, base: Base) -> Option<f64> {
        match base {
            Base::Step => Some(1.0),
            Base::FullStep => Some(self.steps_per_full_step),
            Base::Turn => Some(self.steps_per_turn),
            Base::Length => self.steps_per_mm,
            _ => None,
        }
    }
}

/// What a motor turns, as a camera sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wheel {
    /// Steps in its units of position, behind the motor's gear.
    pub units: PositionUnits,
    /// Largest |angle − law| in a film, steps; `None`: the judge's own.
    pub limit_steps: Option<f64>,
}

/// The lines of a motor. Pin numbers are the board's own (Arduino digital pins, GPIO numbers).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wiring {
    /// A step/dir driver.
    StepDir {
        /// STEP pin; a step is a rising edge.
        step: u8,
        /// DIR pin; motors may share one.
        dir: u8,
        /// Level of DIR for forward: LOW in the tutorial and the sweep article, HIGH in StepperWinch.
        forward_high: bool,
        /// Enable pin and the level that enables, if wired.
        enable: Option<(u8, bool)>,
    },
    /// Four coil lines, IN1 to IN4 (ULN2003).
    Coils {
        /// IN1..IN4.
        pins: [u8; 4],
        /// How the coils are switched.
        sequence: CoilSequence,
    },
}

impl Wiring {
    /// Every pin of it.
    #[must_use]
    pub fn pins(&self) -> Vec<u8> {
        match self {
            Wiring::StepDir { step, dir, enable, .. } => {
                [Some(*step), Some(*dir), enable.map(|(pin, _)| pin)].into_iter().flatten().collect()
            }
            Wiring::Coils { pins, .. } => pins.to_vec(),
        }
    }
}

/// How coils are switched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CoilSequence {
    /// One coil at a time.
    Wave,
    /// Two coils at a time.
    Full,
    /// One and two in turn.
    Half,
}

/// What a step/dir driver needs, ns. For coils all are 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriverTiming {
    /// STEP high at least.
    pub pulse_high_ns: u32,
    /// STEP low at least.
    pub pulse_low_ns: u32,
    /// DIR stable before STEP rises.
    pub dir_setup_ns: u32,
    /// DIR stable after STEP falls.
    pub dir_hold_ns: u32,
}

impl DriverTiming {
    /// The longest of each time that drivers of these motors need.
    #[must_use]
    pub fn longest(motors: &[Motor]) -> DriverTiming {
        motors.iter().map(|motor| motor.timing).fold(DriverTiming::default(), |longest, other| DriverTiming {
            pulse_high_ns: longest.pulse_high_ns.max(other.pulse_high_ns),
            pulse_low_ns: longest.pulse_low_ns.max(other.pulse_low_ns),
            dir_setup_ns: longest.dir_setup_ns.max(other.dir_setup_ns),
            dir_hold_ns: longest.dir_hold_ns.max(other.dir_hold_ns),
        })
    }

    /// In ticks, each rounded up.
    ///
    /// ```
    /// use pulsetrain_motion::program::DriverTiming;
    /// let a4988 = DriverTiming { pulse_high_ns: 1000, pulse_low_ns: 1000, dir_setup_ns: 200, dir_hold_ns: 200 };
    /// assert_eq!(a4988.ticks(16_000_000).dir_setup, 4); // 3.2 ticks of 62.5 ns
    /// ```
    #[must_use]
    pub fn ticks(&self, tick_hz: u64) -> DriverTicks {
        // 2^32 ns at 2^31 Hz is some 2^33 ticks: boards tick slower.
        let ticks = |ns: u32| (u128::from(ns) * u128::from(tick_hz)).div_ceil(1_000_000_000) as u64;
        DriverTicks {
            pulse_high: ticks(self.pulse_high_ns),
            pulse_low: ticks(self.pulse_low_ns),
            dir_setup: ticks(self.dir_setup_ns),
            dir_hold: ticks(self.dir_hold_ns),
        }
    }
}

/// What a step/dir driver needs, in whole ticks of a board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DriverTicks {
    /// STEP high at least.
    pub pulse_high: u64,
    /// STEP low at least.
    pub pulse_low: u64,
    /// DIR stable before STEP rises.
    pub dir_setup: u64,
    /// DIR stable after STEP falls.
    pub dir_hold: u64,
}

impl DriverTicks {
    /// The shortest time between two opposite steps, rise to rise: pulse, DIR hold, DIR setup.
    #[must_use]
    pub fn reversal(&self) -> u64 {
        self.pulse_high + self.dir_hold + self.dir_setup
    }
}

/// What a motor can do, in steps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Limits {
    /// steps/s.
    pub max_speed: Option<f64>,
    /// steps/s².
    pub max_acceleration: Option<f64>,
    /// Speed that it can start, stop or change by at once, steps/s.
    pub pull_in: f64,
}
