//! What a motion file says, checked and in the units of motors: steps, seconds, nanoseconds.

use crate::boards::{self, PinError};
use crate::electrical::Winding;
use crate::machine::Machine;
use crate::{Grid, Law};

/// A motion file that has been read and checked: everything that the later stages need.
#[derive(Clone, Debug)]
pub struct Program {
    /// The board, with its limits.
    pub board: Board,
    /// The rule that turns θ into step times.
    pub grid: Grid,
    /// Largest |scheduled − exact| that the user accepts.
    pub tolerance: Tolerance,
    /// After so long a rest, ms, drivers and coils are switched off (1 to [`LONGEST_IDLE_MS`]); `None`: they hold.
    pub idle_ms: Option<u16>,
    /// The motors, in the file's order.
    pub motors: Vec<Motor>,
    /// Which of them draw figures together, in the file's order.
    pub machines: Vec<Machine>,
    /// How much of the board's queues each motor gets, in 64ths; none: equal parts.
    pub queue_parts: Vec<u8>,
}

/// The longest [`Program::idle_ms`]: what every board can. A Pico tells ticks of 8 ns apart within 2^31.
pub const LONGEST_IDLE_MS: u16 = 8000;

/// Why a program cannot run on another board.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BoardError {
    /// The board drives fewer motors.
    #[error("the board `{board}` drives {limit} motors at most, but the file has {motors}")]
    TooManyMotors {
        /// Board.
        board: String,
        /// Motors of the file.
        motors: usize,
        /// Motors that the board can drive.
        limit: usize,
    },
    /// A pin of the file is none of the board's.
    #[error("motor `{motor}`: {error}")]
    Pin {
        /// Motor.
        motor: String,
        /// What is wrong with the pin.
        error: PinError,
    },
}

impl Program {
    /// The same program on another board; the tolerance stays what it was.
    ///
    /// # Errors
    /// [`BoardError`] if the board drives fewer motors, or is in the table and lacks a pin that the file uses.
    pub fn with_board(self, board: Board) -> Result<Program, BoardError> {
        if self.motors.len() > board.max_motors {
            let (motors, limit) = (self.motors.len(), board.max_motors);
            return Err(BoardError::TooManyMotors { board: board.name, motors, limit });
        }
        if let Some(row) = boards::find(&board.name) {
            for motor in &self.motors {
                for pin in motor.wiring.pins() {
                    row.pin(i64::from(pin)).map_err(|error| BoardError::Pin { motor: motor.name.clone(), error })?;
                }
            }
        }
        Ok(Program { board, ..self })
    }

    /// The times that the board keeps to for a motor: its driver's. Where the board has one pulse length, set-up and hold for all motors,
    /// these are the longest of all drivers, and LOW is the motor's own: nobody makes it, it is what is left between two pulses.
    #[must_use]
    pub fn timing(&self, motor: &Motor) -> DriverTiming {
        let is_driver = matches!(motor.wiring, Wiring::StepDir { .. });
        if self.board.one_timing && is_driver {
            DriverTiming { pulse_low_ns: motor.timing.pulse_low_ns, ..DriverTiming::longest(&self.motors) }
        } else {
            motor.timing
        }
    }

    /// Another motor whose driver needs a longer pulse than this one's, so that the board makes this one's as long; the longest.
    #[must_use]
    pub fn lengthens_pulse(&self, motor: &Motor) -> Option<&Motor> {
        let pulse_ns = self.timing(motor).pulse_high_ns;
        self.motors.iter().find(|other| other.timing.pulse_high_ns == pulse_ns && pulse_ns > motor.timing.pulse_high_ns)
    }
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

/// The bound of the certificate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tolerance {
    /// In ticks of whatever board runs the motion; at least 0.55 (see `pulsetrain-plan`).
    Ticks(f64),
    /// In seconds.
    Seconds(f64),
}

impl Tolerance {
    /// In ticks of a board.
    #[must_use]
    pub fn ticks(self, tick_hz: u64) -> f64 {
        match self {
            Tolerance::Ticks(ticks) => ticks,
            Tolerance::Seconds(seconds) => seconds * tick_hz as f64,
        }
    }

    /// Where the file gives none: 1 tick if the board times its edges in hardware, else 1 µs.
    #[must_use]
    pub fn default_of(board: &Board) -> Tolerance {
        if board.hardware_timed { Tolerance::Ticks(1.0) } else { Tolerance::Seconds(1e-6) }
    }
}

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
    /// Whether another motor has the same DIR line.
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

/// The lines of a motor. Pin numbers are the board's own (Arduino digital pins, GPIO numbers).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wiring {
    /// A step/dir driver.
    StepDir {
        /// STEP pin; a step is a rising edge.
        step: u8,
        /// DIR pin; motors may share one.
        dir: u8,
        /// Level of DIR for forward: seeds 000 and 001 LOW, 003 HIGH.
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

/// How long after one another a motor's segments may come that are in its queue, ticks. What their steps take, each the shortest interval,
/// comes on top.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SegmentTicks {
    /// One that goes the same way as that before it.
    pub onward: u32,
    /// One that turns.
    pub turning: u32,
    /// What comes on top of either, for good, as the board has to hear of it from the host: that can wait while the queue lasts.
    pub heard: u32,
}

/// How a board makes the steps of motors that share a DIR line, if one after the other: those of all its motors then.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SharedSteps {
    /// Steps within so many ticks are made together.
    pub together_ticks: u32,
    /// From a step to one that is not made together with it, ticks at least.
    pub apart_ticks: u32,
}

/// A board's limits: one row of the committed table.
#[derive(Clone, Debug, PartialEq)]
pub struct Board {
    /// "uno", "due", "pico", "native".
    pub name: String,
    /// Ticks per second.
    pub tick_hz: u64,
    /// Fraction bits of its recurrence.
    pub fraction_bits: u32,
    /// Motors at most.
    pub max_motors: usize,
    /// Shortest own interval of a motor, ticks, with 1, 2, … motors; the last entry serves for more.
    pub min_interval_ticks: Vec<u32>,
    /// Whether the edges are timed in hardware (then the default tolerance is 1 tick, else 1 µs).
    pub hardware_timed: bool,
    /// Whether it has one pulse length, DIR set-up and hold for all motors: the longest that a driver needs. See [`Program::timing`].
    pub one_timing: bool,
    /// What a turn of DIR takes beside pulse, hold and set-up, ticks: from the step before it to the one after it.
    pub turn_ticks: u32,
    /// What it needs between steps of different motors; `None` where their pulses may overlap.
    pub shared_steps: Option<SharedSteps>,
    /// What segments take the processor, with 1, 2, … motors; the last entry serves for more. Empty if it is not known.
    pub segment_ticks: Vec<SegmentTicks>,
    /// Where the row's figures come from: "estimate" until a bench on the firmware has printed them.
    pub source: String,
}
