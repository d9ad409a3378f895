//! The limits and units that the planner must keep.

use crate::load::Load;
use pulsetrain_core::RegisterWidths;
use pulsetrain_motion::Grid;
use pulsetrain_motion::program::{Limits, Motor, Program};

/// Everything that the plan of one motor depends on, except its law.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Ticks per second.
    pub tick_hz: u64,
    /// The registers of the board's recurrence, with 16 to 32 fraction bits.
    pub registers: RegisterWidths,
    /// Bound on |scheduled − exact|, ticks, at least 0.55.
    pub tolerance_ticks: f64,
    /// Whether segments are chosen for the packed stream (fewest bytes), or in full resolution (fewest segments).
    pub packed: bool,
    /// The rule for when a motor steps.
    pub grid: Grid,
    /// Shortest interval between two steps, ticks: the board's, or the driver's pulse high + low if longer.
    pub min_interval_ticks: u64,
    /// Shortest interval between two opposite steps, ticks: pulse + DIR hold + DIR setup, and the board's own time for
    /// it.
    pub reversal_ticks: u64,
    /// The capacity of the board's processor, if it is known.
    pub load: Option<Load>,
    /// The limits of the motor.
    pub limits: Limits,
}

impl Settings {
    /// A tolerance of 1 tick, the `nearest` grid, packed segments, and no other limit, for [firmware with so many fraction
    /// bits](RegisterWidths::with_fraction_bits).
    #[must_use]
    pub fn new(tick_hz: u64, fraction_bits: u32) -> Settings {
        Settings {
            tick_hz,
            registers: RegisterWidths::with_fraction_bits(fraction_bits),
            tolerance_ticks: 1.0,
            packed: true,
            grid: Grid::NEAREST,
            min_interval_ticks: 1,
            reversal_ticks: 1,
            load: None,
            limits: Limits { max_speed: None, max_acceleration: None, pull_in: 0.0 },
        }
    }

    /// The settings for the plan of a law that is `factor` times slower, expressed for the law itself.
    ///
    /// θ(t/s) on ticks of f Hz has its steps at the very ticks that θ(t) has at s·f Hz; its speeds are s times, its
    /// accelerations s² times smaller, and so are the limits that they meet.
    #[must_use]
    pub fn slowed(&self, factor: f64) -> Settings {
        let mut slowed = self.clone();
        slowed.tick_hz = (self.tick_hz as f64 * factor) as u64;
        let limits = &mut slowed.limits;
        limits.max_speed = limits.max_speed.map(|speed| speed * factor);
        limits.max_acceleration = limits.max_acceleration.map(|acceleration| acceleration * factor * factor);
        limits.pull_in *= factor;
        slowed
    }

    /// The most steps a second that the board and the driver allow.
    #[must_use]
    pub fn highest_rate_hz(&self) -> f64 {
        self.tick_hz as f64 / self.min_interval_ticks as f64
    }

    /// The gain of the packed stream: coarser units where the tolerance leaves room for them.
    #[must_use]
    pub fn gain(&self) -> Option<i8> {
        let room = libm::log2((self.tolerance_ticks - 0.5) / 0.5).round();
        self.packed.then_some(-(room.clamp(-60.0, 60.0) as i8))
    }
}

impl Settings {
    /// The settings for the plan of one motor of a program.
    #[must_use]
    pub fn of(program: &Program, motor: &Motor) -> Settings {
        let board = &program.board;
        let timing = program.timing(motor).ticks(board.tick_hz);
        let own = entry(&board.min_interval_ticks, program).map_or(1, u64::from);
        let load = entry(&board.segment_ticks, program).map(|segment| Load {
            step_ticks: own,
            onward_ticks: segment.onward.into(),
            turning_ticks: segment.turning.into(),
            heard_ticks: segment.heard.into(),
            // `what_the_planner_takes_at_its_limit_the_board_does` in pulsetrain's tests/it/chips/pico_figures.rs holds that a Pico can wait so long.
            burst_ticks: board.tick_hz / 1000,
            heard_burst_ticks: board.tick_hz / 50,
        });
        Settings {
            tolerance_ticks: program.tolerance.ticks(board.tick_hz),
            grid: program.grid,
            min_interval_ticks: own.max(timing.pulse_high + timing.pulse_low),
            reversal_ticks: timing.reversal() + u64::from(board.turn_ticks),
            load,
            limits: motor.limits,
            registers: board.registers,
            ..Settings::new(board.tick_hz, board.registers.fraction_bits)
        }
    }
}

/// The entry of a table by number of motors for a program's number. The last entry holds for more motors.
fn entry<T: Copy>(table: &[T], program: &Program) -> Option<T> {
    table.get(program.motors.len() - 1).or(table.last()).copied()
}
