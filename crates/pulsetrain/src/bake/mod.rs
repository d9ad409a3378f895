//! Plans that stay on a board: motions without a host.
//!
//! - [`table`]: a motor's plan as rows, with what repeats for ever
//! - [`sketch`]: an Arduino sketch that plays such tables; [`image`]: an image of an Uno's flash that does, without a compiler
//! - `parts`: what both tell the player (`player.h`), which is the same

pub mod image;
mod parts;
pub mod sketch;
pub mod table;

pub use image::Image;
pub use parts::Size;
pub use sketch::Sketch;
pub use table::{Row, Table};

use pulsetrain_motion::Time;
use pulsetrain_motion::program::Program;
use pulsetrain_plan::Refused;

/// Why a motion cannot be baked.
#[derive(Debug, thiserror::Error)]
pub enum BakeError {
    /// The planner refuses it.
    #[error("{0:?}")]
    Plan(Refused),
    /// It never ends, and does not repeat either, as far as is known.
    #[error("motor {motor} never comes to an end, and nothing is known that it repeats")]
    Endless {
        /// Whose law.
        motor: String,
    },
    /// What should repeat does not: the plan's steps a period later are others.
    #[error("motor {motor}: step {step} after {after_s} s does not come again a period of {period_s} s later")]
    NotPeriodic {
        /// Whose law.
        motor: String,
        /// Number of the step in the period.
        step: usize,
        /// Where the period was taken to begin, s.
        after_s: f64,
        /// The period, s.
        period_s: f64,
    },
    /// Motors that share a DIR line have no common period that is short enough.
    #[error("motors that share a DIR line repeat together only after more than {most} of the longest one's periods")]
    NoCommonPeriod {
        /// The most that is looked at.
        most: u64,
    },
    /// A wait is longer than the counter can tell.
    #[error("motor {motor} rests for {wait_s:.0} s or more; the longest wait is {limit_s:.0} s")]
    Wait {
        /// Whose.
        motor: String,
        /// How long at least, s.
        wait_s: f64,
        /// The longest, s.
        limit_s: f64,
    },
    /// A pin or a kind of driver that cannot be baked.
    #[error("motor {motor}: {what}")]
    Wiring {
        /// Whose.
        motor: String,
        /// What is in the way.
        what: String,
    },
    /// Another board.
    #[error("only an Arduino Uno can be baked for yet; this is planned for the board `{board}`")]
    Board {
        /// What it is planned for.
        board: String,
    },
    /// More steps a second than the player can work out.
    #[error(
        "{rate_hz:.0} steps/s are too many: what is baked works out {limit_hz:.0} a second, of all motors together; the motion \
         {:.2} times slower fits", (100.0 * .rate_hz / .limit_hz).ceil() / 100.0
    )]
    TooFast {
        /// At the fastest, of all motors.
        rate_hz: f64,
        /// What it can do.
        limit_hz: f64,
    },
    /// More rows than the flash has room for.
    #[error("the tables have {bytes} bytes; an Uno has room for {limit}")]
    TooLarge {
        /// Of all motors.
        bytes: usize,
        /// What fits.
        limit: usize,
    },
}

impl BakeError {
    /// What would do.
    #[must_use]
    pub const fn advice(&self) -> &'static str {
        match self {
            BakeError::Plan(_) => "`pulsetrain explain` tells more",
            BakeError::Endless { .. } | BakeError::NotPeriodic { .. } | BakeError::NoCommonPeriod { .. } => {
                "what repeats for ever: endless sines, sweeps and circles, and `repeat = \"forever\"`; --for cuts the motion"
            }
            BakeError::Wait { .. } => "a shorter rest",
            BakeError::Wiring { .. } => "what can be baked: at most four motors with STEP and DIR on pins 2 to 13",
            BakeError::Board { .. } => "say --board uno, if its motors fit there",
            BakeError::TooFast { .. } => {
                "a slower motion, fewer microsteps; or `pulsetrain run --port`, whose firmware is several times faster"
            }
            BakeError::TooLarge { .. } => "a wider tolerance, fewer motors, or a shorter motion (--for)",
        }
    }
}

/// The tables of all motors of a program; endless laws, which must repeat, become tables that do.
///
/// # Errors
/// [`BakeError`]: a motion that is refused, that does not repeat, or whose waits are too long.
pub fn tables(program: &Program) -> Result<Vec<Table>, BakeError> {
    let together = table::shares_a_dir_line(program).then(|| table::common_period(program)).transpose()?.flatten();
    let mut ensemble = pulsetrain_plan::Ensemble::new(program).map_err(BakeError::Plan)?;
    let mut tables = Vec::new();
    for (index, motor) in program.motors.iter().enumerate() {
        let cycle = match (motor.law.end(), motor.law.cycle()) {
            (Some(_), _) => None,
            (None, Some((from, period))) => Some((from, together.unwrap_or(period))),
            (None, None) => return Err(BakeError::Endless { motor: motor.name.clone() }),
        };
        let mut plan = table::Unrolled::new(program.board.fraction_bits);
        let end = cycle.map(|(from, period): (Time, Time)| {
            let (ticks, _) = (from + period.times(3)).ticks(program.board.tick_hz);
            ticks.max(0).cast_unsigned()
        });
        while end.is_none_or(|end| plan.tick() <= end) {
            let Some(next) = ensemble.next_move(index).map_err(BakeError::Plan)? else { break };
            plan.push(next);
        }
        tables.push(plan.table(&motor.name, program, cycle)?);
    }
    Ok(tables)
}
