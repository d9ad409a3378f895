//! Following a law in time.

use super::{Law, LawError, Piece, Pieces};
use crate::Time;
use std::collections::VecDeque;

/// Position, speed and acceleration of a law at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// θ, steps: `whole` + `fraction`, rounded.
    pub position: f64,
    /// Whole steps of θ: the `origin` of the law's piece.
    pub whole: i64,
    /// θ − `whole`, steps; it may be more than one step.
    pub fraction: f64,
    /// θ', steps/s.
    pub speed: f64,
    /// θ'', steps/s².
    pub acceleration: f64,
}

/// Reads a law at times that mostly increase. It has its own copy of the law.
///
/// It needs constant memory. To go back over a few pieces costs nothing; to go further back it starts from the beginning again.
///
/// ```
/// use pulsetrain_motion::{Law, Time, law::Cursor};
/// let law = Law::sine(100.0, Time::from_seconds(2.0), Some(1))?;
/// let mut cursor = Cursor::new(&law);
/// assert_eq!(cursor.at(Time::from_seconds(1.0))?.position, 200.0);
/// // Past its end a law stays where it is.
/// assert_eq!(cursor.at(Time::from_seconds(9.0))?.speed, 0.0);
/// # Ok::<(), pulsetrain_motion::LawError>(())
/// ```
pub struct Cursor {
    law: Law,
    pieces: Pieces,
    recent: VecDeque<Piece>,
}

// A law may be followed on another thread than the one that made it.
const _: () = {
    const fn is_send<T: Send + 'static>() {}
    is_send::<Cursor>();
};

/// Pieces kept for going back.
const KEPT: usize = 8;

impl Cursor {
    /// A cursor at the beginning of `law`.
    #[must_use]
    pub fn new(law: &Law) -> Cursor {
        Cursor { law: law.clone(), pieces: law.pieces(), recent: VecDeque::with_capacity(KEPT) }
    }

    /// The law at `t`; before its beginning and past its end it is at rest.
    ///
    /// # Errors
    /// The law's own errors, if it is undefined or jumps before `t`.
    pub fn at(&mut self, t: Time) -> Result<Sample, LawError> {
        if self.recent.front().is_some_and(|piece| t < piece.start && piece.start > Time::ZERO) {
            *self = Cursor::new(&self.law);
        }
        while self.recent.back().is_none_or(|piece| piece.end < t) {
            match self.pieces.next() {
                Some(piece) => {
                    if self.recent.len() == KEPT {
                        self.recent.pop_front();
                    }
                    self.recent.push_back(piece?);
                }
                None => break,
            }
        }
        let piece = self.recent.iter().rev().find(|piece| piece.start <= t).or(self.recent.front());
        let piece = piece.ok_or_else(|| LawError::Parameter("the motion is empty".into()))?;
        Ok(piece.sample(t))
    }
}

impl Piece {
    /// The law at `t`, at rest outside of the piece.
    fn sample(&self, t: Time) -> Sample {
        let jet = self.curve.jet((t.clamp(self.start, self.end) - self.zero).seconds());
        let moving = t >= self.start && t <= self.end;
        Sample {
            position: self.origin as f64 + jet[0],
            whole: self.origin,
            fraction: jet[0],
            speed: if moving { jet[1] } else { 0.0 },
            acceleration: if moving { 2.0 * jet[2] } else { 0.0 },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn going_back_gives_the_same_as_going_forth() {
        let law = Law::sine(1000.0, Time::from_seconds(0.01), None).unwrap();
        let mut cursor = Cursor::new(&law);
        let mut sample = |k: u64| cursor.at(Time::from_ratio(1, 3000).times(k)).unwrap();
        let forth: Vec<Sample> = (0..300).map(&mut sample).collect();
        let back: Vec<Sample> = (0..300).rev().map(&mut sample).collect();
        assert!(forth.iter().eq(back.iter().rev()));
    }
}
