//! Replies to StepperWinch's lines, as text. [`verb_lines`](super::verb_lines) has the replies to verbs.

use super::letters::{Letters, REPLIES, text};
use super::text::{LineError, LineFault};

/// The longest reply, bytes: a status of five numbers with eleven characters each.
pub const LONGEST: usize = 5 + 5 * 12 + 2;

/// A line to the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineReply {
    /// `awake`: at start, and to `ping`.
    Awake,
    /// `id StepperWinch <date>`.
    Id,
    /// `txyza <usec> <x> <y> <z> <a>`.
    Status {
        /// The board's clock, µs, as a signed number: negative after 35.8 min, wraps at 71.6 min.
        usec: i32,
        /// Steps made.
        positions: [i32; 4],
    },
    /// `err <what> <word>`, with what would be accepted; or `dbg` and the original's text, where it has one.
    Refused(LineError),
    /// `err taken`: a host that speaks frames has the board.
    Taken,
}

/// A line that is being written.
struct TextWriter<'a> {
    out: &'a mut [u8],
    len: u8,
}

impl TextWriter<'_> {
    /// Appends a byte, if it fits.
    #[inline(never)]
    fn byte(&mut self, byte: u8) {
        if let Some(place) = self.out.get_mut(usize::from(self.len)) {
            *place = byte;
            self.len += 1;
        }
    }

    /// The `nth` text of replies.
    #[inline(never)]
    fn text<L: Letters>(&mut self, mut nth: u8) {
        let mut at = REPLIES;
        loop {
            let letter = L::letter(at);
            at += 1;
            if letter == 0 {
                if nth == 0 {
                    return;
                }
                nth -= 1;
            } else if nth == 0 {
                self.byte(letter);
            }
        }
    }

    /// A space, and the number.
    #[inline(never)]
    fn number(&mut self, value: i32) {
        self.byte(b' ');
        if value < 0 {
            self.byte(b'-');
        }
        let mut rest = value.unsigned_abs();
        let mut begun = false;
        // The first digit is of 10^9s; then the rest grows tenfold from digit to digit.
        let mut unit = 1_000_000_000_u32;
        let mut left = 10u8;
        while left > 0 {
            left -= 1;
            let (mut part, mut weight, mut digit) = (unit << 1, 2u8, 0u8);
            if unit == 100_000_000 {
                (part, weight) = (unit << 3, 8);
            }
            while weight > 0 {
                if rest >= part {
                    rest -= part;
                    digit += weight;
                }
                part >>= 1;
                weight >>= 1;
            }
            begun |= digit != 0 || left == 0;
            if begun {
                self.byte(b'0' + digit);
            }
            if unit == 100_000_000 {
                rest = (rest << 3) + (rest << 1);
            }
            unit = 100_000_000;
        }
    }
}

impl LineReply {
    /// Writes it, with CR LF, and says how many bytes it has; [`LONGEST`] at most.
    ///
    /// ```
    /// use pulsetrain_core::winch::letters::InMemory;
    /// use pulsetrain_core::winch::reply::{LONGEST, LineReply};
    /// let mut line = [0; LONGEST];
    /// let len = LineReply::Status { usec: -7, positions: [1, -20, 0, i32::MIN] }.write::<InMemory>(&mut line);
    /// assert_eq!(line[..usize::from(len)], *b"txyza -7 1 -20 0 -2147483648\r\n");
    /// ```
    #[inline(never)]
    pub fn write<L: Letters>(&self, out: &mut [u8]) -> u8 {
        let mut to = TextWriter { out, len: 0 };
        match self {
            LineReply::Awake => to.text::<L>(text::AWAKE),
            LineReply::Id => to.text::<L>(text::ID),
            LineReply::Status { usec, positions } => {
                to.text::<L>(text::STATUS);
                to.number(*usec);
                for position in positions {
                    to.number(*position);
                }
            }
            LineReply::Refused(refusal) => to.refusal::<L>(*refusal),
            LineReply::Taken => {
                to.text::<L>(text::ERROR);
                to.text::<L>(text::TAKEN);
            }
        }
        to.byte(b'\r');
        to.byte(b'\n');
        to.len
    }
}

impl TextWriter<'_> {
    #[inline(always)]
    fn refusal<L: Letters>(&mut self, LineError { what, word }: LineError) {
        let (what, hint) = match what {
            LineFault::Rate => return self.text::<L>(text::RATE),
            LineFault::Words => return self.text::<L>(text::WORDS),
            LineFault::Frequency => (LineFault::Range, text::FREQUENCY),
            LineFault::Ratio => (LineFault::Range, text::RATIO),
            what => (what, 0),
        };
        self.text::<L>(text::ERROR);
        self.text::<L>((what as u8).wrapping_sub(LineFault::Command as u8).wrapping_add(text::FIRST_WHAT));
        self.number(word.into());
        if hint != 0 {
            self.text::<L>(hint);
        }
    }
}
