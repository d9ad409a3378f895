//! What is known of a board before it is connected: limits of plans, pins, queue, line. Each board has one [`BoardProfile`], in a folder of its own.

use std::fmt;
use std::ops::RangeInclusive;

use super::pins::{PinError, PinRules, PinsError};
use crate::motor::Motor;
use pulsetrain_core::RegisterWidths;

/// All that plans, motion files and messages depend on about a board.
///
/// It is data: a new board is a folder with one of these, and a line in [`BUILT_IN`](super::BUILT_IN). What a number cannot say is in
/// [`rules`](BoardProfile::rules).
pub struct BoardProfile {
    /// Its name in motion files and commands.
    pub name: &'static str,
    /// Names that it had once.
    pub former_names: &'static [&'static str],
    /// What it is, in a line.
    pub about: &'static str,
    /// What to know about its pins and timing.
    pub note: &'static str,
    /// Where the figures come from: "estimate" until a bench on the firmware has printed them.
    pub source: &'static str,

    /// Ticks per second.
    pub tick_hz: u64,
    /// The registers of its recurrence.
    pub registers: RegisterWidths,
    /// Motors at most.
    pub max_motors: usize,
    /// Shortest own interval of a motor, ticks, with 1, 2, … motors, the shortest pulses and any pins. The last entry serves for more motors.
    pub min_interval_ticks: &'static [u32],
    /// Whether the edges are timed in hardware (then the default tolerance is 1 tick, else 1 µs).
    pub hardware_timed: bool,
    /// Whether it has one pulse length, DIR set-up and hold for all motors: [`BoardLimits::one_timing`].
    pub one_timing: bool,
    /// [`BoardLimits::turn_ticks`] of one motor.
    pub turn_ticks: u32,
    /// [`BoardLimits::segment_ticks`].
    pub segment_ticks: &'static [SegmentTicks],
    /// How far ahead steps are committed, ticks.
    pub horizon_ticks: u32,
    /// Largest |edge − scheduled| beyond its constant, ticks.
    pub lateness_ticks: u32,

    /// RAM, bytes; `None` if it is no limit.
    pub ram_bytes: Option<u32>,
    /// Flash, bytes; `None` if it is no limit.
    pub flash_bytes: Option<u32>,
    /// Each motor's queue, bytes, with 1, 2, … motors; the last entry is for more. Empty if it is no limit.
    pub queue_bytes: &'static [u32],
    /// How plans come over its line; `None` if the board has no line.
    pub line: Option<LineTiming>,

    /// Pins that exist.
    pub pins: RangeInclusive<u8>,
    /// Pins that exist but cannot drive a motor, with the reason.
    pub reserved: &'static [(RangeInclusive<u8>, &'static str)],
    /// Where the analogue pins A0, A1, … begin, and how many they are. `None`: pins are called GP0, GP1, …
    pub analogue: Option<(u8, u8)>,
    /// Which pins work together, and what pins and pulses cost.
    pub rules: &'static dyn PinRules,
}

/// How plans come to a board over its line while motors move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineTiming {
    /// The time from when an item leaves its queue until a lease is extended over the item that replaced it, without the time on the line, µs. It
    /// is that of a board which has nothing else to read.
    pub delay_us: u32,
    /// Additional delay for each byte of plans that the board had to read in the last 10 ms, µs.
    pub delay_byte_us: u32,
    /// Other bytes that the line brings within this delay, bytes.
    pub delay_bytes: u32,
    /// Rate of the bytes that are no plans, bytes/s: extensions of the lease, and questions.
    pub other_bytes_per_s: u32,
    /// How many bytes a byte of a plan takes on the line, with its share of a frame's other bytes.
    pub frame_share: f64,
    /// The rate of the board's own USB, bytes/s, which has no baud. `None`: the board has only a UART, behind an adapter or a bridge.
    pub usb_bytes_per_s: Option<u32>,
}

/// The limits that a program is planned for: those of a board, with this program's motors and pins.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardLimits {
    /// The board.
    pub profile: &'static BoardProfile,
    /// Its name in motion files.
    pub name: String,
    /// Ticks per second.
    pub tick_hz: u64,
    /// The registers of its recurrence.
    pub registers: RegisterWidths,
    /// Motors at most.
    pub max_motors: usize,
    /// Shortest own interval of a motor, ticks, with 1, 2, … motors; the last entry serves for more.
    pub min_interval_ticks: Vec<u32>,
    /// Whether the edges are timed in hardware (then the default tolerance is 1 tick, else 1 µs).
    pub hardware_timed: bool,
    /// Whether it has one pulse length, DIR set-up and hold for all motors: the longest that a driver needs. See
    /// [`Program::timing`](crate::program::Program::timing).
    pub one_timing: bool,
    /// Time that a turn of DIR takes in addition to pulse, hold and set-up, from the step before it to the step after
    /// it, ticks.
    pub turn_ticks: u32,
    /// What it needs between steps of different motors; `None` where their pulses may overlap.
    pub shared_steps: Option<SharedSteps>,
    /// What segments take the processor, with 1, 2, … motors; the last entry serves for more. Empty if it is not known.
    pub segment_ticks: Vec<SegmentTicks>,
}

/// How long after one another a motor's segments may come that are in its queue, ticks. What their steps take, each the shortest interval,
/// comes on top.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SegmentTicks {
    /// A segment in the direction of the one before it.
    pub onward: u32,
    /// A segment in the other direction.
    pub turning: u32,
    /// Additional time for receiving either kind from the host. This work can wait while the queue lasts.
    pub heard: u32,
}

/// How a board makes the steps of motors that share a DIR line, if one after the other: those of all its motors then.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SharedSteps {
    /// Steps within this many ticks are made together.
    pub together_ticks: u32,
    /// Shortest time from a step to one that is not made together with it, ticks.
    pub apart_ticks: u32,
}

impl BoardProfile {
    /// The board's limits with the shortest pulses and any pins.
    #[must_use]
    pub fn limits(&'static self) -> BoardLimits {
        BoardLimits {
            profile: self,
            name: self.name.to_owned(),
            tick_hz: self.tick_hz,
            registers: self.registers,
            max_motors: self.max_motors,
            min_interval_ticks: self.min_interval_ticks.to_vec(),
            hardware_timed: self.hardware_timed,
            one_timing: self.one_timing,
            turn_ticks: self.turn_ticks,
            shared_steps: None,
            segment_ticks: self.segment_ticks.to_vec(),
        }
    }

    /// The pin of that number.
    ///
    /// # Errors
    /// [`PinError`] if the board has no such pin, or needs it itself.
    pub fn pin(&self, number: i64) -> Result<u8, PinError> {
        let Some(pin) = u8::try_from(number).ok().filter(|pin| self.pins.contains(pin)) else {
            return Err(self.no_pin(number.to_string()));
        };
        match self.reserved.iter().find(|(range, _)| range.contains(&pin)) {
            Some((_, why)) => Err(PinError::Reserved { board: self.name, pin, why }),
            None => Ok(pin),
        }
    }

    /// The pin of that name: `D8`, `A0`, `GP15` or `GPIO15`, whatever its case.
    ///
    /// # Errors
    /// [`PinError`] if the board has no such pin, or needs it itself.
    pub fn pin_named(&self, name: &str) -> Result<u8, PinError> {
        let lower = name.trim().to_ascii_lowercase();
        let number = |prefix: &str| lower.strip_prefix(prefix).and_then(|digits| digits.parse::<u8>().ok());
        let pin = match self.analogue {
            Some((first, count)) => number("a").filter(|n| *n < count).map(|n| first + n).or_else(|| number("d")),
            None => number("gpio").or_else(|| number("gp")),
        };
        self.pin(i64::from(pin.or_else(|| number("")).ok_or_else(|| self.no_pin(name.to_owned()))?))
    }

    /// Whether the board can drive these motors' pins together.
    ///
    /// # Errors
    /// [`PinsError`] if it cannot.
    pub fn check_pins(&self, motors: &[Motor]) -> Result<(), PinsError> {
        self.rules.check(motors)
    }

    /// The shortest intervals with 1, 2, … motors, ticks, for these motors' pins and their longest pulse. They are at least
    /// [`min_interval_ticks`](BoardProfile::min_interval_ticks), which is for the shortest pulses, except with the Uno's compare hardware.
    #[must_use]
    pub fn shortest_intervals(&self, motors: &[Motor]) -> Vec<u32> {
        self.rules.shortest_intervals(self, motors)
    }

    /// The longest pulse with which the board works out several steps of these motors at once, ns; `None` if their pulses are not longer. With
    /// longer pulses it works out one step at a time, and its rate is several times lower.
    #[must_use]
    pub fn longest_pulse_together(&self, motors: &[Motor]) -> Option<u32> {
        self.rules.longest_pulse_together(self, motors)
    }

    /// The shortest interval of each of four motors when the board plays a motion from its flash, ticks; `None` if it is that of a stream.
    #[must_use]
    pub fn shortest_of_four_baked(&self) -> Option<u32> {
        self.rules.shortest_of_four_baked()
    }

    /// [`BoardLimits::turn_ticks`] for these motors' pins.
    #[must_use]
    pub fn turn_ticks(&self, motors: &[Motor]) -> u32 {
        self.rules.turn_ticks(self, motors)
    }

    /// [`BoardLimits::shared_steps`] for these motors.
    #[must_use]
    pub fn shared_steps(&self, motors: &[Motor]) -> Option<SharedSteps> {
        self.rules.shared_steps(self, motors)
    }

    /// How much later than its scheduled tick a STEP edge of these motors comes: its constant delay, and what may be added to it, ticks.
    #[must_use]
    pub fn edge_delay(&self, motors: &[Motor]) -> EdgeDelay {
        self.rules.edge_delay(self, motors)
    }

    fn no_pin(&self, pin: String) -> PinError {
        PinError::None { board: self.name, pin, first: *self.pins.start(), last: *self.pins.end() }
    }
}

/// When STEP edges come after their scheduled ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EdgeDelay {
    /// Edge tick − scheduled tick of an edge that is not late.
    pub constant_ticks: u32,
    /// How much later an edge may be, ticks.
    pub late_ticks: u32,
}

/// Names are unique among the boards of a program.
impl PartialEq for BoardProfile {
    fn eq(&self, other: &BoardProfile) -> bool {
        self.name == other.name
    }
}

impl fmt::Debug for BoardProfile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "BoardProfile({:?})", self.name)
    }
}
