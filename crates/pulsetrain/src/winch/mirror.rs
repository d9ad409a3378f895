//! What a board does with the lines that it was told, reckoned here: core's reader and paths, without pins.

use std::time::Duration;

use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::session::Session;
use pulsetrain_core::winch::text::{Heard, LineReader};

/// A board at rest that hears the same lines, in the port's time. What a real one was told before is not known to it.
#[derive(Clone, Debug)]
pub(super) struct Mirror {
    reader: LineReader,
    session: Session,
    /// Milliseconds of the port's time that are over.
    ms: u128,
    /// Steps of each axis since the start, forward minus backward.
    made: [i64; 4],
}

impl Mirror {
    /// One that starts now.
    pub(super) const fn new(now: Duration) -> Mirror {
        Mirror { reader: LineReader::new(), session: Session::new(), ms: now.as_millis(), made: [0; 4] }
    }

    /// Hears a line, now.
    pub(super) fn tell(&mut self, line: &str, now: Duration) {
        self.go_on(now);
        for byte in line.bytes().chain(*b"\n") {
            if let Heard::Command(verb) = self.reader.push::<InMemory>(byte) {
                self.session.obey(verb, &mut self.reader);
            }
        }
    }

    /// Lets time pass until now.
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

    /// Where each axis is, from where it was at the start, steps.
    pub(super) const fn made(&self) -> [i64; 4] {
        self.made
    }

    /// Whether no axis goes on, or is to: while the drivers are off none does.
    pub(super) fn is_at_rest(&self) -> bool {
        !self.session.drives() || self.session.is_at_rest()
    }
}
