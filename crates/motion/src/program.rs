//! The content of a motion file, checked and in the units of motors: steps, seconds, nanoseconds.

use crate::boards::PinError;
use crate::law::Law;
use crate::machine::Machine;
use crate::{Grid, Time};

pub use crate::boards::{BoardLimits, SegmentTicks, SharedSteps};
pub use crate::motor::{CoilSequence, DriverTicks, DriverTiming, Limits, Motor, PositionUnits, Scale, Wheel, Wiring};

/// A motion file that has been read and checked: everything that the later stages need.
#[derive(Clone, Debug)]
pub struct Program {
    /// The board, with its limits.
    pub board: BoardLimits,
    /// The rule that turns θ into step times.
    pub grid: Grid,
    /// Largest |scheduled − exact| that the user accepts.
    pub tolerance: Tolerance,
    /// Drivers and coils are switched off after a rest of this length, ms (1 to [`LONGEST_IDLE_MS`]); `None`: they stay
    /// on.
    pub idle_ms: Option<u16>,
    /// The motors, in the file's order.
    pub motors: Vec<Motor>,
    /// The machines, motors that draw a figure together, in the file's order.
    pub machines: Vec<Machine>,
    /// Each motor's share of the board's queues, in 64ths; empty: equal shares.
    pub queue_parts: Vec<u8>,
}

/// The longest [`Program::idle_ms`], which every board can count. A Pico compares ticks of 8 ns within 2^31, which is 17 s.
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
    /// The board lacks a pin of the file.
    #[error("motor `{motor}`: {error}")]
    Pin {
        /// Motor.
        motor: String,
        /// What is wrong with the pin.
        error: PinError,
    },
}

impl Program {
    /// This program on another board. The tolerance keeps its value.
    ///
    /// # Errors
    /// [`BoardError`] if the board drives fewer motors, or lacks a pin that the file uses.
    pub fn with_board(self, board: BoardLimits) -> Result<Program, BoardError> {
        if self.motors.len() > board.max_motors {
            let (motors, limit) = (self.motors.len(), board.max_motors);
            return Err(BoardError::TooManyMotors { board: board.name, motors, limit });
        }
        for motor in &self.motors {
            for pin in motor.wiring.pins() {
                let found = board.profile.pin(i64::from(pin));
                found.map_err(|error| BoardError::Pin { motor: motor.name.clone(), error })?;
            }
        }
        Ok(Program { board, ..self })
    }

    /// The driver times that the board keeps for a motor. Where the board has one pulse length, set-up and hold for all
    /// motors, these are the longest of all drivers. LOW is the motor's own, because it is simply the time between two
    /// pulses.
    #[must_use]
    pub fn timing(&self, motor: &Motor) -> DriverTiming {
        let is_driver = matches!(motor.wiring, Wiring::StepDir { .. });
        if self.board.one_timing && is_driver {
            DriverTiming { pulse_low_ns: motor.timing.pulse_low_ns, ..DriverTiming::longest(&self.motors) }
        } else {
            motor.timing
        }
    }

    /// The motor whose driver needs the longest pulse, if that is longer than this motor's: the board makes this one's as long.
    #[must_use]
    pub fn lengthens_pulse(&self, motor: &Motor) -> Option<&Motor> {
        let pulse_ns = self.timing(motor).pulse_high_ns;
        self.motors.iter().find(|other| other.timing.pulse_high_ns == pulse_ns && pulse_ns > motor.timing.pulse_high_ns)
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

    /// The default: 1 tick if the board times its edges in hardware, else 1 µs.
    #[must_use]
    pub fn default_of(board: &BoardLimits) -> Tolerance {
        if board.hardware_timed { Tolerance::Ticks(1.0) } else { Tolerance::Seconds(1e-6) }
    }
}

/// A delta robot's path from a table, neither repeated nor eased.
#[derive(Clone, Debug)]
pub struct TipRecording {
    /// When it begins.
    pub begin: Time,
    /// x, y and z, mm.
    pub tip: [Law; 3],
}
