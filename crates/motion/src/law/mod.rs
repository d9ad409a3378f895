//! θ(t): a law is a stream of analytic pieces, in order, without gaps.
//!
//! Everything downstream sees a law through [`Piece`]s: the planner expands their [`Curve`]s, the verdict
//! follows them with a [`Cursor`](cursor::Cursor). A new law needs nothing else than pieces.

pub mod curve;

use crate::Time;
pub use curve::{Bounds, Curve, Inverse, Jet};

/// A stretch of a law on which θ is one analytic curve: θ(t) = `origin` + `curve`(t − `zero`), for t in `start..=end`.
#[derive(Clone, Debug)]
pub struct Piece {
    /// The law time at which the curve's own time u is 0 s. Near `start`, so that u keeps its precision.
    pub zero: Time,
    /// Where the piece begins.
    pub start: Time,
    /// Where it ends; finite, beyond `start`.
    pub end: Time,
    /// Whole steps added to the curve, so that endless laws lose no precision.
    pub origin: i64,
    /// θ − `origin`, steps, against u, seconds.
    pub curve: Curve,
    /// How θ may come into this piece from the one before.
    pub entry: Entry,
}

impl Piece {
    /// The curve's own time at `start`, seconds.
    #[must_use]
    pub fn first(&self) -> f64 {
        (self.start - self.zero).seconds()
    }

    /// The curve's own time at `end`, seconds.
    #[must_use]
    pub fn last(&self) -> f64 {
        (self.end - self.zero).seconds()
    }
}

/// How θ may come into a piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entry {
    /// Position must be continuous; speed may change by no more than the motor's pull-in rate.
    Continuous,
    /// The file says `jump`: speed may change by any amount; position must be continuous all the same.
    SpeedJump,
}

/// What the certificate of a law can be relative to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Class {
    /// Step times have a formula.
    ClosedForm,
    /// Crossings are enclosed by interval arithmetic: none is missed.
    Enclosed,
    /// Exact for the interpolant that was laid through data or an ODE's steps.
    Interpolant,
}

/// Why a law cannot be followed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LawError {
    /// θ is not a number there.
    #[error("θ is undefined at t = {at_s} s: {why}")]
    Undefined {
        /// Law time, s.
        at_s: f64,
        /// What breaks, in the user's words.
        why: String,
    },
    /// θ jumps.
    #[error("θ jumps at t = {at_s} s from {from} to {to} steps; a motor cannot")]
    Jump {
        /// Law time, s.
        at_s: f64,
        /// Steps, before.
        from: f64,
        /// Steps, after.
        to: f64,
    },
    /// A parameter is out of its range.
    #[error("{0}")]
    Parameter(String),
}

/// The pieces of a law, in order of time, without gaps, from t = 0 s; it never ends for an endless law.
pub type Pieces<'a> = Box<dyn Iterator<Item = Result<Piece, LawError>> + 'a>;

/// A motion law θ(t), t ≥ 0 s, θ in steps.
#[derive(Clone, Debug)]
pub enum Law {
    /// 000's sinusoid: θ = A − A·cos(2πt/T), in half periods.
    Sine(Sine),
    /// Pieces that were worked out beforehand: trapezoids, S-curves, ramps, tables.
    Fixed(Fixed),
}

/// θ = A − A·cos(2πt/T). Source: seeds/000, eq. 1.
#[derive(Clone, Debug)]
pub struct Sine {
    /// A, steps; may be negative, not 0.
    pub amplitude: f64,
    /// T.
    pub period: Time,
    /// Number of periods; `None`: endless.
    pub cycles: Option<u64>,
}

/// A finite list of pieces.
#[derive(Clone, Debug)]
pub struct Fixed {
    /// In order, without gaps, from t = 0 s.
    pub pieces: std::sync::Arc<Vec<Piece>>,
    /// What its certificate is relative to.
    pub class: Class,
}

impl Law {
    /// The pieces from t = 0 s on.
    #[must_use]
    pub fn pieces(&self) -> Pieces<'_> {
        match self {
            Law::Sine(sine) => Box::new((0..sine.half_periods()).map(|k| Ok(sine.half_period(k)))),
            Law::Fixed(fixed) => Box::new(fixed.pieces.iter().cloned().map(Ok)),
        }
    }

    /// When the law ends; `None`: never.
    #[must_use]
    pub fn end(&self) -> Option<Time> {
        match self {
            Law::Sine(sine) => sine.cycles.map(|n| sine.period.times(n)),
            Law::Fixed(fixed) => fixed.pieces.last().map(|p| p.end),
        }
    }

    /// What a certificate of this law is relative to.
    #[must_use]
    pub fn class(&self) -> Class {
        match self {
            Law::Sine(_) => Class::ClosedForm,
            Law::Fixed(fixed) => fixed.class,
        }
    }
}

impl Sine {
    fn half_periods(&self) -> u64 {
        self.cycles.map_or(u64::MAX, |n| n.saturating_mul(2))
    }

    /// Half period `k`, whose curve starts its own time at its own turning point.
    fn half_period(&self, k: u64) -> Piece {
        // k·T/2 = (k/2)·T + (k mod 2)·T/2: exact for even k, within 2^-64 s for odd k.
        let half = self.period.divided_by(2);
        let turn = |k: u64| self.period.times(k / 2) + if k % 2 == 1 { half } else { Time::ZERO };
        let rising = k % 2 == 0;
        Piece {
            zero: turn(k),
            start: turn(k),
            end: turn(k + 1),
            origin: 0,
            curve: Curve::Cosine {
                offset: self.amplitude,
                amplitude: if rising { -self.amplitude } else { self.amplitude },
                omega: std::f64::consts::TAU / self.period.seconds(),
                phase: 0.0,
            },
            entry: Entry::Continuous,
        }
    }
}
