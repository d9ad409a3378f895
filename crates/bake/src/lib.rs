//! Standalone motions: plans that a board plays without a computer.
//!
//! # What is here
//! - [`table`]: a motor's plan as rows, with what repeats for ever
//! - [`sketch`]: an Arduino sketch that plays such tables; `parts`: what it tells its player (`player.h`)
//! - `streams`: a motor's plan as packed bytes, with what repeats for ever
//! - [`image`]: an image of an Uno's flash, whose firmware plays such bytes; [`pico`]: the same for a Pico
//! - [`rehearsal`]: an Uno's image on the virtual Uno, before anybody writes it
//!
//! # What is not
//! Writing an image to a board (the command line), motions that a computer feeds (`pulsetrain-session`).
#![forbid(unsafe_code)]

pub mod image;
mod parts;
pub mod pico;
pub mod rehearsal;
pub mod sketch;
mod streams;
pub mod table;

pub use image::Image;
pub use parts::Size;
pub use pico::PicoImage;
pub use sketch::Sketch;
pub use table::{PutOff, Row, Table};

use pulsetrain_board::RemoteError;
use pulsetrain_motion::program::Program;
use pulsetrain_plan::Refused;

/// Why a motion cannot be baked.
#[derive(Debug, thiserror::Error)]
pub enum BakeError {
    /// The planner refuses it.
    #[error("motor {}: {}", .0.motor, .0.error)]
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
    /// An endless law that makes no step, or none that comes again.
    #[error("motor {motor} makes no step in the period of {period_s} s that it repeats after {after_s} s")]
    NoStep {
        /// Whose law.
        motor: String,
        /// From when on it repeats, s.
        after_s: f64,
        /// The period, s.
        period_s: f64,
    },
    /// Opposite steps of motors that share a DIR line come too close to one another in what repeats.
    #[error(
        "steps of {motors}, which share a DIR line, come {apart_ticks} ticks apart in what repeats: the line needs {needed_ticks} to turn"
    )]
    Meet {
        /// All motors of the line.
        motors: String,
        /// Between two opposite steps, ticks.
        apart_ticks: u64,
        /// Pulse, hold and setup, ticks.
        needed_ticks: u64,
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
    #[error("an Arduino Uno and a Raspberry Pi Pico can be baked for; this is planned for the board `{board}`")]
    Board {
        /// What it is planned for.
        board: String,
    },
    /// More steps a second than a sketch can work out.
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
    /// One motor's steps follow one another more closely than can be kept while others step too.
    #[error(
        "motor {motor} makes {rate_hz:.0} steps/s; beside the others, with its drivers' times, {limit_hz:.0} are the most"
    )]
    TooClose {
        /// Whose.
        motor: String,
        /// At the fastest, steps/s.
        rate_hz: f64,
        /// What can be kept, steps/s.
        limit_hz: f64,
    },
    /// The firmware does not take pins or times.
    #[error(transparent)]
    Refused(#[from] Box<RemoteError>),
    /// More than the flash has room for.
    #[error(
        "the motion takes {bytes} bytes or more; {board} has room for {limit}: for the first {fits_s:.1} s of the motion"
    )]
    TooLarge {
        /// Which, with its article.
        board: &'static str,
        /// Of all motors, as far as they were worked out.
        bytes: usize,
        /// What fits.
        limit: usize,
        /// What fits of the motion, s.
        fits_s: f64,
    },
    /// The player does not fit before the tables: a fault of this program.
    #[error("what plays the tables is broken: {what}")]
    Player {
        /// In which way.
        what: String,
    },
}

impl BakeError {
    /// What would do.
    #[must_use]
    pub const fn advice(&self) -> &'static str {
        match self {
            BakeError::Plan(_) => "`pulsetrain explain` tells more",
            BakeError::Endless { .. } | BakeError::NotPeriodic { .. } | BakeError::NoCommonPeriod { .. } => {
                "what repeats for ever: endless sines, sweeps, circles and speeds, and `repeat = \"forever\"`; --for cuts the motion"
            }
            BakeError::NoStep { .. } => "a larger amplitude: from half a step on; or leave the motor out",
            BakeError::Meet { .. } => {
                "a DIR line for each motor, or other starts; --for cuts the motion, and then it is the plan itself"
            }
            BakeError::Wait { .. } => "a shorter rest; or an image (--output), whose rests may be of any length",
            BakeError::Wiring { .. } => {
                "what can be baked: at most four motors with STEP and DIR on pins 2 to 13, STEP not on 13"
            }
            BakeError::Board { .. } => "say --board uno or --board pico, if its motors fit there",
            BakeError::TooFast { .. } | BakeError::TooClose { .. } => {
                "a slower motion, fewer microsteps; or an image (--output), whose firmware is several times faster"
            }
            BakeError::Refused(_) => "docs/wiring.md has what fits the board",
            BakeError::TooLarge { .. } => "a wider tolerance, fewer motors, or a shorter motion (--for)",
            BakeError::Player { .. } => "please tell the project",
        }
    }
}

/// Turns that are planned after what comes before them; baked are what comes before, and one.
const TURNS: u64 = 3;

/// What a player can take, at the most.
#[derive(Clone, Copy, Debug)]
pub struct Room {
    /// Of all motors' tables, bytes.
    pub bytes: usize,
    /// Steps a second, of a motor that is alone.
    pub rate_hz: f64,
}

impl Room {
    /// As much as a motion asks for.
    pub const ANY: Room = Room { bytes: usize::MAX, rate_hz: f64::INFINITY };
}

/// The tables of all motors of a program; endless laws, which must repeat, become tables that do.
///
/// # Errors
/// [`BakeError`]: a motion that is refused, that does not repeat, whose waits are too long, that is too fast or too large.
pub fn tables(program: &Program, room: Room) -> Result<Vec<Table>, BakeError> {
    let hz = program.board.tick_hz as f64;
    let mut ensemble = pulsetrain_plan::Ensemble::new(program).map_err(BakeError::Plan)?;
    let mut tables = Vec::new();
    for (index, motor) in program.motors.iter().enumerate() {
        let cycle = table::cycle(program, motor)?;
        let end = cycle.map(|(from, period)| {
            let (ticks, _) = (from + period.times(TURNS)).ticks(program.board.tick_hz);
            ticks.max(0).cast_unsigned()
        });
        // More moves have more rows than fit: no plan is unrolled further, however long the motion.
        let most = (room.bytes / Row::BYTES).saturating_mul(if cycle.is_some() { 1 + TURNS as usize } else { 1 });
        let mut plan = table::Unrolled::new(program.board.fraction_bits);
        while end.is_none_or(|end| plan.tick() <= end) {
            let Some(next) = ensemble.next_move(index).map_err(BakeError::Plan)? else { break };
            plan.push(next, ensemble.put_off_ticks(index));
            let rate_hz = hz / plan.shortest() as f64;
            if rate_hz > room.rate_hz {
                // The law's own peak, as far as it is known, is what the motion must be slowed by.
                let rate_hz = rate_hz.max(ensemble.certificate(index).peak_speed.0);
                return Err(BakeError::TooFast { rate_hz, limit_hz: room.rate_hz });
            }
            if plan.moves() > most {
                let fits_s = plan.tick_of(room.bytes / Row::BYTES) as f64 / hz;
                let bytes = plan.moves() * Row::BYTES;
                return Err(BakeError::TooLarge { board: "an Uno", bytes, limit: room.bytes, fits_s });
            }
        }
        tables.push(plan.table(motor, program, cycle)?);
    }
    let bytes = tables.iter().map(|table| table.rows.len()).sum::<usize>() * Row::BYTES;
    if bytes > room.bytes {
        let fits_s = table::tick_of(&tables, room.bytes / Row::BYTES) as f64 / hz;
        return Err(BakeError::TooLarge { board: "an Uno", bytes, limit: room.bytes, fits_s });
    }
    table::check_lines(program, &tables)?;
    Ok(tables)
}
