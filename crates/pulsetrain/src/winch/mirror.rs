//! A model of the board: follows the lines that were sent, with core's own reader and paths, but without pins.

use std::time::Duration;

use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::session::Session;
use pulsetrain_core::winch::text::{Heard, LineReader};

/// A board at rest that gets the same lines, in the port's time. It does not know what the real board got earlier.
#[derive(Clone, Debug)]
pub(super) struct Mirror {
    reader: LineReader,
    session: Session,
    /// Milliseconds of the port's time that the model has passed.
    ms: u128,
    /// Steps of each axis since the start, forward minus backward.
    made: [i64; 4],
}

impl Mirror {
    /// A model that starts now.
    pub(super) const fn new(now: Duration) -> Mirror {
        Mirror { reader: LineReader::new(), session: Session::new(), ms: now.as_millis(), made: [0; 4] }
    }

    /// Gives it a line, now.
    pub(super) fn tell(&mut self, line: &str, now: Duration) {
        self.go_on(now);
        for byte in line.bytes().chain(*b"\n") {
            if let Heard::Command(verb) = self.reader.push::<InMemory>(byte) {
                self.session.obey(verb, &mut self.reader);
            }
        }
    }

    /// Lets its time pass until now.
    pub(super) fn go_on(&mut self, now: Duration) {
        while self.ms < now.as_millis() {
            self.ms += 1;
            for (made, slice) in self.made.iter_mut().zip(self.session.millisecond()) {
                let steps = i64::from(slice.count);
                *made += if slice.backward { -steps } else { steps };
            }
            if self.session.has_stopped() {
                self.session.release();
            }
        }
    }

    /// The position of each axis, from its position at the start, steps.
    pub(super) const fn made(&self) -> [i64; 4] {
        self.made
    }

    /// Whether no axis moves or will move. While the drivers are off none does.
    pub(super) fn is_at_rest(&self) -> bool {
        !self.session.drives() || self.session.is_at_rest()
    }
}
