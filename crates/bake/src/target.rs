//! The boards that play a baked motion.

use pulsetrain_motion::program::Program;

/// How a motion is baked for a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// Into an Uno's flash: an [`Image`](crate::Image), or a [`Sketch`](crate::Sketch).
    Avr,
    /// Into a Pico's flash: a [`PicoImage`](crate::PicoImage).
    Rp2040,
}

impl Target {
    /// The target of a program's board; `None` if that plays no baked motions.
    #[must_use]
    pub fn of(program: &Program) -> Option<Target> {
        match program.board.name.as_str() {
            "uno" => Some(Target::Avr),
            "pico" => Some(Target::Rp2040),
            _ => None,
        }
    }

    /// Whether the virtual board plays an image before it is written: an Uno works steps out as it plays, and may be too slow.
    #[must_use]
    pub const fn is_rehearsed(self) -> bool {
        matches!(self, Target::Avr)
    }
}
