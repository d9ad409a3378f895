//! Why a motion cannot be baked.

use pulsetrain_board::RemoteError;
use pulsetrain_plan::Refused;

/// Why a motion cannot be baked.
#[derive(Debug, thiserror::Error)]
pub enum BakeError {
    /// The planner refuses the motion.
    #[error("motor {}: {}", .0.motor, .0.error)]
    Plan(Refused),
    /// The motion never ends, and nothing is known that it repeats.
    #[error("motor {motor} never comes to an end, and nothing is known that it repeats")]
    Endless {
        /// The motor whose law it is.
        motor: String,
    },
    /// The motion should repeat, but the plan's steps a period later differ.
    #[error("motor {motor}: step {step} after {after_s} s does not come again a period of {period_s} s later")]
    NotPeriodic {
        /// The motor whose law it is.
        motor: String,
        /// Number of the differing step in the period.
        step: usize,
        /// When the law should begin to repeat, s.
        after_s: f64,
        /// The period, s.
        period_s: f64,
    },
    /// An endless law makes no step, or no step that comes again.
    #[error("motor {motor} makes no step in the period of {period_s} s that it repeats after {after_s} s")]
    NoStep {
        /// The motor whose law it is.
        motor: String,
        /// When the law begins to repeat, s.
        after_s: f64,
        /// The period, s.
        period_s: f64,
    },
    /// Motors share a DIR line, and two of their opposite steps come too close to one another while the motion repeats.
    #[error(
        "steps of {motors}, which share a DIR line, come {apart_ticks} ticks apart in what repeats: the line needs {needed_ticks} to turn"
    )]
    Meet {
        /// All motors of the line.
        motors: String,
        /// The distance of two opposite steps, ticks.
        apart_ticks: u64,
        /// The distance that they need, ticks: pulse, hold and setup.
        needed_ticks: u64,
    },
    /// Motors that share a DIR line have no common period that is short enough.
    #[error("motors that share a DIR line repeat together only after more than {most} of the longest one's periods")]
    NoCommonPeriod {
        /// How many of one motor's periods are tried.
        most: u64,
    },
    /// A wait is longer than the player's counter can measure.
    #[error("motor {motor} rests for {wait_s:.0} s or more; the longest wait is {limit_s:.0} s")]
    Wait {
        /// The motor that waits.
        motor: String,
        /// How long the wait is at least, s.
        wait_s: f64,
        /// The longest wait, s.
        limit_s: f64,
    },
    /// A pin or a kind of driver that cannot be baked.
    #[error("motor {motor}: {what}")]
    Wiring {
        /// The motor with that pin or driver.
        motor: String,
        /// Why it cannot be baked.
        what: String,
    },
    /// The board cannot play the motion.
    #[error("an Arduino Uno and a Raspberry Pi Pico can be baked for; this is planned for the board `{board}`")]
    Board {
        /// The board that the motion is planned for.
        board: String,
    },
    /// More steps a second than the sketch's player can work out.
    #[error(
        "{rate_hz:.0} steps/s are too many: what is baked works out {limit_hz:.0} a second, of all motors together; the motion \
         {:.2} times slower fits", (100.0 * .rate_hz / .limit_hz).ceil() / 100.0
    )]
    TooFast {
        /// The fastest rate, all motors together, steps/s.
        rate_hz: f64,
        /// The highest rate of the player, steps/s.
        limit_hz: f64,
    },
    /// One motor's steps follow one another more closely than the player can make them while other motors step, too.
    #[error(
        "motor {motor} makes {rate_hz:.0} steps/s; with the other motors and with its driver's times, {limit_hz:.0} are the most"
    )]
    TooClose {
        /// The motor that is too fast.
        motor: String,
        /// Its fastest rate, steps/s.
        rate_hz: f64,
        /// The highest rate that the player can keep, steps/s.
        limit_hz: f64,
    },
    /// The firmware refuses the pins or the times.
    #[error(transparent)]
    Refused(#[from] Box<RemoteError>),
    /// The motion needs more bytes than the flash has left.
    #[error(
        "the motion takes {bytes} bytes or more; {board} has room for {limit}: for the first {fits_s:.1} s of the motion"
    )]
    TooLarge {
        /// The board, with its article.
        board: &'static str,
        /// Bytes of all motors, as far as they were worked out.
        bytes: usize,
        /// Bytes that fit.
        limit: usize,
        /// How much of the motion fits, s.
        fits_s: f64,
    },
    /// The player's text and the tables do not fit together: a fault of this program.
    #[error("what plays the tables is broken: {what}")]
    Player {
        /// What is wrong.
        what: String,
    },
}

impl BakeError {
    /// What the user can do.
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
