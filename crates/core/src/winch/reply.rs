//! What a board says, as text.

use super::text::{Refusal, What};

/// Of this dialect's firmware; after `id StepperWinch`, where the original had its day of compilation.
pub const DATE: [u8; 11] = *b"Nov 21 2026";

const MONTH_AND_DAY: u64 = letters([DATE[0], DATE[1], DATE[2], DATE[3], DATE[4], DATE[5], DATE[6], DATE[7]]);
const YEAR: u64 = letters([DATE[8], DATE[9], DATE[10], 0, 0, 0, 0, 0]);

/// The longest reply, bytes: a status of five numbers with eleven characters each.
pub const LONGEST: usize = 5 + 5 * 12 + 2;

/// A line to the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reply {
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
    /// `err <what> <word>`, and what would be taken; or `dbg`, where the original said it so.
    Refused(Refusal),
}

/// Bytes of a line being written.
struct Writer<'a> {
    out: &'a mut [u8],
    len: usize,
}

impl Writer<'_> {
    /// What does not fit is lost.
    #[inline(never)]
    fn byte(&mut self, byte: u8) {
        if let Some(place) = self.out.get_mut(self.len) {
            *place = byte;
            self.len += 1;
        }
    }

    /// Up to the first 0. A number holds them, not a slice: constants would lie in an AVR's RAM.
    #[inline(never)]
    fn word(&mut self, bytes: u64) {
        for byte in bytes.to_le_bytes() {
            if byte == 0 {
                return;
            }
            self.byte(byte);
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

const fn letters(text: [u8; 8]) -> u64 {
    u64::from_le_bytes(text)
}

impl Reply {
    /// Writes it, with CR LF, and says how many bytes it has; [`LONGEST`] at most.
    ///
    /// ```
    /// use pulsetrain_core::winch::reply::{LONGEST, Reply};
    /// let mut line = [0; LONGEST];
    /// let len = Reply::Status { usec: -7, positions: [1, -20, 0, i32::MIN] }.write(&mut line);
    /// assert_eq!(line[..len], *b"txyza -7 1 -20 0 -2147483648\r\n");
    /// ```
    #[inline(never)]
    pub fn write(&self, out: &mut [u8]) -> usize {
        let mut to = Writer { out, len: 0 };
        match *self {
            Reply::Awake => to.word(letters(*b"awake\0\0\0")),
            Reply::Id => {
                to.word(letters(*b"id Stepp"));
                to.word(letters(*b"erWinch "));
                to.word(MONTH_AND_DAY);
                to.word(YEAR);
            }
            Reply::Status { usec, positions } => {
                to.word(letters(*b"txyza\0\0\0"));
                to.number(usec);
                for position in positions {
                    to.number(position);
                }
            }
            Reply::Refused(refusal) => to.refusal(refusal),
        }
        to.byte(b'\r');
        to.byte(b'\n');
        to.len
    }
}

impl Writer<'_> {
    fn refusal(&mut self, Refusal { what, word }: Refusal) {
        match what {
            What::Rate => {
                self.word(letters(*b"dbg inva"));
                self.word(letters(*b"lid srat"));
                self.word(letters(*b"e value\0"));
                return;
            }
            What::Words => {
                self.word(letters(*b"dbg exce"));
                self.word(letters(*b"ssive in"));
                self.word(letters(*b"put erro"));
                self.word(letters(*b"r\0\0\0\0\0\0\0"));
                return;
            }
            _ => {}
        }
        self.word(letters(*b"err \0\0\0\0"));
        self.word(match what {
            What::Command => letters(*b"command\0"),
            What::Flags => letters(*b"flags\0\0\0"),
            What::Number => letters(*b"number\0\0"),
            What::Missing => letters(*b"missing\0"),
            What::Extra => letters(*b"extra\0\0\0"),
            What::Long => letters(*b"long\0\0\0\0"),
            What::Noise => letters(*b"noise\0\0\0"),
            What::Checksum => letters(*b"checksum"),
            _ => letters(*b"range\0\0\0"),
        });
        self.number(word.into());
        match what {
            What::Frequency => {
                self.word(letters(*b" 0.01..2"));
                self.word(letters(*b"0 Hz\0\0\0\0"));
            }
            What::Ratio => self.word(letters(*b" 0.07..5")),
            _ => {}
        }
    }
}
