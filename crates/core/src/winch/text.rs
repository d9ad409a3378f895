//! Lines from the host, byte by byte, to commands.
//!
//! Nothing of a line acts before its end, so that a refused one changes nothing. Values are read as they come: there is
//! no buffer for the line, and no token takes long.

use super::number::Float;
use super::path::{FASTEST_DRIFT, Gains, GainsRefused, Limits};

/// Axes, x, y, z, a.
const COUNT: usize = 4;

/// The longest line, bytes without its ending.
pub const LONGEST_LINE: u8 = 80;

/// The most words of a line.
pub const MOST_WORDS: u8 = 10;

/// Commands that take one whole number for each of their flags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verb {
    /// `a`: absolute targets, steps. Drivers are to be enabled.
    Target,
    /// `d`: the same, relative.
    Move,
    /// `v`: drift of the targets, steps/s. Drivers are to be enabled.
    Drift,
    /// `r`: impulse of the reference, steps.
    Impulse,
    /// `s`: ramp speed, steps/s; not positive: no limit.
    Ramp,
}

/// What a line asks for. A bit of `axes` stands for an axis: 1 for x, 2 for y, 4 for z, 8 for a.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// `version`.
    Version,
    /// `ping`.
    Ping,
    /// `enable`: drivers on or off.
    Enable(bool),
    /// `srate`: the interval of status lines, ms, at least 1.
    Report(u16),
    /// `strict`: whether any irregularity is to be refused.
    Strict(bool),
    /// `deadman`: the longest silence, ms, after which the axes are stopped; 0: any.
    Deadman(u16),
    /// `a`, `d`, `v`, `r`, `s`.
    Axes {
        /// Which.
        verb: Verb,
        /// For whom there is a value.
        axes: u8,
        /// By axis; 0 where there is none. Drifts are at most [`FASTEST_DRIFT`] either way, ramps 0 to 65 535.
        values: [i32; COUNT],
    },
    /// `g`.
    Gains {
        /// For whom.
        axes: u8,
        /// Stable ones.
        gains: Gains,
    },
    /// `l`.
    Limits {
        /// For whom.
        axes: u8,
        /// Bounded ones.
        limits: Limits,
    },
}

/// Why a line was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum What {
    /// No such command.
    Command,
    /// A flag that is no axis, or an axis twice. Only when strict.
    Flags,
    /// Not a number, or not a whole one where one is needed.
    Number,
    /// A number that is too large, or too small.
    Range,
    /// A frequency outside of 0.01 to 20 Hz.
    Frequency,
    /// A damping ratio outside of 0.07 to 5.
    Ratio,
    /// `srate` with a value that is not positive: `dbg`, as the original said it.
    Rate,
    /// Too few values.
    Missing,
    /// Too many values. Only when strict.
    Extra,
    /// More than [`MOST_WORDS`]: `dbg`, as the original said it.
    Words,
    /// More than [`LONGEST_LINE`] bytes.
    Long,
    /// A byte that is no text.
    Noise,
    /// The checksum is not that of the line, or no checksum.
    Checksum,
}

/// A refused line, of which nothing was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Why.
    pub what: What,
    /// In which word, counted from 1.
    pub word: u8,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Unknown,
    Version,
    Ping,
    Enable,
    Report,
    Strict,
    Deadman,
    Axes(Verb),
    Gains,
    Limits,
}

impl Kind {
    /// Of a word, its letters from the lowest byte up.
    #[inline(never)]
    fn of(word: u64) -> Kind {
        const fn letters(text: [u8; 8]) -> u64 {
            u64::from_le_bytes(text)
        }
        const VERSION: u64 = letters(*b"version\0");
        const PING: u64 = letters(*b"ping\0\0\0\0");
        const ENABLE: u64 = letters(*b"enable\0\0");
        const REPORT: u64 = letters(*b"srate\0\0\0");
        const STRICT: u64 = letters(*b"strict\0\0");
        const DEADMAN: u64 = letters(*b"deadman\0");
        if let [letter, 0, 0, 0, 0, 0, 0, 0] = word.to_le_bytes() {
            return match letter {
                b'a' => Kind::Axes(Verb::Target),
                b'd' => Kind::Axes(Verb::Move),
                b'v' => Kind::Axes(Verb::Drift),
                b'r' => Kind::Axes(Verb::Impulse),
                b's' => Kind::Axes(Verb::Ramp),
                b'g' => Kind::Gains,
                b'l' => Kind::Limits,
                _ => Kind::Unknown,
            };
        }
        match word {
            VERSION => Kind::Version,
            PING => Kind::Ping,
            ENABLE => Kind::Enable,
            REPORT => Kind::Report,
            STRICT => Kind::Strict,
            DEADMAN => Kind::Deadman,
            _ => Kind::Unknown,
        }
    }

    const fn has_flags(self) -> bool {
        matches!(self, Kind::Axes(_) | Kind::Gains | Kind::Limits)
    }

    const fn is_decimal(self) -> bool {
        matches!(self, Kind::Gains | Kind::Limits)
    }
}

/// A number being read, as atol and atof take it; but nothing may be left over after it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Number {
    digits: u32,
    /// `digits` are to be multiplied by 10^`power`, and by the exponent.
    power: i8,
    /// [`NO_DIGIT`] until it has one.
    exponent: u8,
    seen: u8,
}

/// An exponent without digits.
const NO_DIGIT: u8 = 0xff;
/// More than any exponent that is taken.
const BEYOND: u8 = 60;

/// What has been seen of a number.
mod seen {
    pub(super) const MINUS: u8 = 1;
    pub(super) const DIGIT: u8 = 2;
    pub(super) const POINT: u8 = 4;
    pub(super) const EXPONENT: u8 = 8;
    pub(super) const EXPONENT_MINUS: u8 = 16;
    /// The last byte.
    pub(super) const EXPONENT_NOW: u8 = 32;
    pub(super) const ANY: u8 = 64;
    pub(super) const BAD: u8 = 128;
}

impl Number {
    const NONE: Number = Number { digits: 0, power: 0, exponent: NO_DIGIT, seen: 0 };

    /// Takes a byte. Of a `whole` number digits after a point do not count.
    #[inline(never)]
    fn push(&mut self, byte: u8, whole: bool) {
        let digit = byte.wrapping_sub(b'0');
        let before = self.seen;
        self.seen = (before | seen::ANY) & !seen::EXPONENT_NOW;
        if digit >= 10 {
            self.seen |= match byte {
                b'+' if before == 0 => 0,
                b'-' if before == 0 => seen::MINUS,
                b'+' if before & seen::EXPONENT_NOW != 0 => 0,
                b'-' if before & seen::EXPONENT_NOW != 0 => seen::EXPONENT_MINUS,
                b'.' if before & (seen::POINT | seen::EXPONENT) == 0 => seen::POINT,
                b'e' | b'E' if !whole && before & (seen::DIGIT | seen::EXPONENT) == seen::DIGIT => {
                    seen::EXPONENT | seen::EXPONENT_NOW
                }
                _ => seen::BAD,
            };
            return;
        }
        if before & seen::EXPONENT != 0 {
            self.exponent = match self.exponent {
                NO_DIGIT => digit,
                tens @ 0..=5 => tens * 10 + digit,
                _ => BEYOND,
            };
            return;
        }
        self.seen |= seen::DIGIT;
        let after = before & seen::POINT != 0;
        if after && whole {
            return;
        }
        let limit = BEYOND.cast_signed();
        if self.digits <= 429_496_728 {
            self.digits = (self.digits << 3) + (self.digits << 1) + u32::from(digit);
            // A number of so many zeros is 0 all the same.
            self.power = if after && self.power > -limit { self.power - 1 } else { self.power };
        } else if !after && self.power < limit {
            self.power += 1;
        }
    }

    const fn is_number(self) -> bool {
        let lacks_exponent = self.seen & seen::EXPONENT != 0 && self.exponent == NO_DIGIT;
        self.seen & (seen::BAD | seen::DIGIT) == seen::DIGIT && !lacks_exponent
    }

    const fn is_negative(self) -> bool {
        self.seen & seen::MINUS != 0
    }

    fn integer(self, strict: bool) -> Result<i32, What> {
        if !self.is_number() || (strict && self.seen & seen::POINT != 0) {
            return Err(What::Number);
        }
        let negative = self.is_negative();
        if self.power != 0 || self.digits > 0x7fff_ffff + u32::from(negative) {
            return Err(What::Range);
        }
        let value = self.digits.cast_signed();
        Ok(if negative { value.wrapping_neg() } else { value })
    }

    fn float(self) -> Result<Float, What> {
        if !self.is_number() {
            return Err(What::Number);
        }
        let exponent = if self.exponent == NO_DIGIT { 0 } else { self.exponent.cast_signed() };
        let exponent = if self.seen & seen::EXPONENT_MINUS != 0 { -exponent } else { exponent };
        // Within ±120, and Float goes on from there.
        let float = Float::from_decimal(self.digits, self.power + exponent).ok_or(What::Range)?;
        if self.is_negative() && float != Float::ZERO { Err(What::Range) } else { Ok(float) }
    }
}

/// The state of a checksum: `*` and two hexadecimal digits, at the end of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Check {
    None,
    Star,
    High(u8),
    Given(u8),
    Bad,
}

/// Reads lines.
///
/// ```
/// use pulsetrain_core::winch::text::{Command, Reader, Verb};
/// let mut reader = Reader::new();
/// let command = b"a ax 5 7\r\n".iter().find_map(|byte| reader.push(*byte)).unwrap();
/// assert_eq!(command, Ok(Command::Axes { verb: Verb::Target, axes: 0b1001, values: [7, 0, 0, 5] }));
/// let refusal = b"a x seven\n".iter().find_map(|byte| reader.push(*byte)).unwrap().unwrap_err();
/// assert_eq!(refusal.word, 3);
/// ```
#[derive(Clone, Debug)]
pub struct Reader {
    strict: bool,
    line: Line,
}

/// What is known of the line being read.
#[derive(Clone, Debug)]
struct Line {
    len: u8,
    /// Words begun.
    words: u8,
    /// Whether the last of them is not over.
    within: bool,
    /// Of all bytes before the checksum: exclusive or.
    sum: u8,
    check: Check,
    fault: Option<Refusal>,
    kind: Kind,
    /// Flags that are axes, two bits each, the last one lowest; at most eight.
    order: u16,
    flags: u8,
    /// Axes among the flags.
    axes: u8,
    /// Axes with a value; or how many values, for commands without axes.
    given: u8,
    number: Number,
    /// Values by axis; the first word's letters, until it is over.
    values: [i32; COUNT],
    decimals: [Float; 2],
}

impl Line {
    const NONE: Line = Line {
        len: 0,
        words: 0,
        within: false,
        sum: 0,
        check: Check::None,
        fault: None,
        kind: Kind::Unknown,
        order: 0,
        flags: 0,
        axes: 0,
        given: 0,
        number: Number::NONE,
        values: [0; COUNT],
        decimals: [Float::ZERO; 2],
    };

    /// The first fault is the one told.
    fn refuse(&mut self, what: What) {
        if self.fault.is_none() {
            self.fault = Some(Refusal { what, word: self.words });
        }
    }
}

impl Default for Reader {
    fn default() -> Reader {
        Reader::new()
    }
}

impl Reader {
    /// At the beginning of a line, not strict.
    #[must_use]
    pub const fn new() -> Reader {
        Reader { strict: false, line: Line::NONE }
    }

    /// From now on any irregularity is refused, or none that does no harm.
    pub const fn set_strict(&mut self, strict: bool) {
        self.strict = strict;
    }

    /// Forgets what it has of a line.
    pub fn restart(&mut self) {
        self.line = Line::NONE;
    }

    /// Takes a byte. At a line's end, unless the line is blank: the command, or why there is none.
    #[inline(never)]
    pub fn push(&mut self, byte: u8) -> Option<Result<Command, Refusal>> {
        if byte == b'\n' || byte == b'\r' {
            return self.end();
        }
        let line = &mut self.line;
        if line.len == LONGEST_LINE {
            line.refuse(What::Long);
            return None;
        }
        line.len += 1;
        if line.check != Check::None || byte == b'*' {
            if line.within {
                self.end_word();
            }
            self.line.push_check(byte);
            return None;
        }
        line.sum ^= byte;
        if byte == b' ' || byte == b'\t' {
            if line.within {
                self.end_word();
            }
            return None;
        }
        if !line.within {
            line.within = true;
            line.words += 1;
            line.number = Number::NONE;
            if line.words > MOST_WORDS {
                line.refuse(What::Words);
            }
        }
        if !matches!(byte, 0x21..=0x7e) {
            line.refuse(What::Noise);
        }
        if line.fault.is_none() {
            self.push_word(byte);
        }
        None
    }

    #[inline(always)]
    fn push_word(&mut self, byte: u8) {
        let line = &mut self.line;
        match line.words {
            1 => line.push_letter(byte),
            2 if line.kind.has_flags() => {
                if !line.push_flag(byte) && self.strict {
                    line.refuse(What::Flags);
                }
            }
            _ => line.number.push(byte, !line.kind.is_decimal()),
        }
    }

    /// The word being read is over.
    #[inline(never)]
    fn end_word(&mut self) {
        let line = &mut self.line;
        line.within = false;
        if line.fault.is_some() {
            return;
        }
        if line.words == 1 {
            let [low, high, ..] = line.values;
            let ([b0, b1, b2, b3], [b4, b5, b6, b7]) = (low.to_le_bytes(), high.to_le_bytes());
            line.values = [0; COUNT];
            line.kind = Kind::of(u64::from_le_bytes([b0, b1, b2, b3, b4, b5, b6, b7]));
            if line.kind == Kind::Unknown {
                line.refuse(What::Command);
            }
        } else if line.words > 2 || !line.kind.has_flags() {
            match line.take_value(self.strict) {
                Ok(true) => {}
                Ok(false) if !self.strict => {}
                Ok(false) => line.refuse(What::Extra),
                Err(what) => line.refuse(what),
            }
        }
    }

    /// The line is over.
    #[inline(never)]
    fn end(&mut self) -> Option<Result<Command, Refusal>> {
        if self.line.within {
            self.end_word();
        }
        let line = &mut self.line;
        match line.check {
            Check::None => {}
            Check::Given(sum) if sum == line.sum => {}
            // The end of a line that is too long was not read.
            _ if line.len == LONGEST_LINE && line.fault.is_some() => {}
            // Whatever else is wrong with it comes from that.
            _ => line.fault = Some(Refusal { what: What::Checksum, word: line.words }),
        }
        let heard = match line.fault {
            Some(refusal) => Some(Err(refusal)),
            None if line.words == 0 => None,
            None => Some(line.command(self.strict).map_err(|what| {
                let word = match what {
                    What::Missing => line.words + 1,
                    What::Frequency => 3,
                    What::Ratio | What::Range => 4,
                    _ => line.words,
                };
                Refusal { what, word }
            })),
        };
        self.restart();
        heard
    }
}

impl Line {
    fn push_check(&mut self, byte: u8) {
        let digit = match byte {
            b'0'..=b'9' => byte - b'0',
            b'a'..=b'f' => byte - b'a' + 10,
            b'A'..=b'F' => byte - b'A' + 10,
            _ => 16,
        };
        self.check = match self.check {
            Check::None => Check::Star,
            Check::Star if digit < 16 => Check::High(digit << 4),
            Check::High(high) if digit < 16 => Check::Given(high | digit),
            _ => Check::Bad,
        };
    }

    /// The first word's letters stand in the first two values.
    fn push_letter(&mut self, byte: u8) {
        let [low, high, ..] = self.values;
        let ([b0, b1, b2, b3], [b4, b5, b6, b7]) = (low.to_le_bytes(), high.to_le_bytes());
        if b7 != 0 {
            self.refuse(What::Command);
        }
        // The first letter ends up lowest: the others are put where the first 0 is.
        let mut bytes = [b0, b1, b2, b3, b4, b5, b6, b7];
        if let Some(free) = bytes.iter_mut().find(|letter| **letter == 0) {
            *free = byte;
        }
        let [b0, b1, b2, b3, b4, b5, b6, b7] = bytes;
        self.values = [i32::from_le_bytes([b0, b1, b2, b3]), i32::from_le_bytes([b4, b5, b6, b7]), 0, 0];
    }

    /// Whether it is an axis, and for the first time.
    fn push_flag(&mut self, byte: u8) -> bool {
        let (axis, bit) = match byte {
            b'x' => (0, 1),
            b'y' => (1, 2),
            b'z' => (2, 4),
            b'a' => (3, 8),
            _ => return false,
        };
        let again = self.axes & bit != 0;
        self.axes |= bit;
        // There is no room for more than eight values.
        if self.flags < 8 {
            self.order = self.order << 2 | axis;
            self.flags += 1;
        }
        !again
    }

    /// Takes the number just read; whether one was wanted.
    fn take_value(&mut self, strict: bool) -> Result<bool, What> {
        match self.kind {
            Kind::Version | Kind::Ping => Ok(false),
            Kind::Gains | Kind::Limits => {
                let Some(place) = self.decimals.get_mut(usize::from(self.given)) else { return Ok(false) };
                *place = self.number.float()?;
                self.given += 1;
                Ok(true)
            }
            Kind::Axes(verb) => {
                let index = self.words - 3;
                if index >= self.flags {
                    return Ok(false);
                }
                let mut value = self.number.integer(strict)?;
                let mut order = self.order;
                let mut last = self.flags - 1;
                while last > index {
                    order >>= 2;
                    last -= 1;
                }
                let axis = u8::try_from(order & 3).unwrap_or(0);
                let Some(place) = self.values.get_mut(usize::from(axis)) else { return Ok(false) };
                match verb {
                    Verb::Target => {}
                    // Named twice, an axis moves by both.
                    Verb::Move | Verb::Impulse => value = place.checked_add(value).ok_or(What::Range)?,
                    Verb::Drift if value.unsigned_abs() > u32::from(FASTEST_DRIFT) => return Err(What::Range),
                    Verb::Ramp if value > i32::from(u16::MAX) => return Err(What::Range),
                    Verb::Drift => {}
                    Verb::Ramp => value = if value < 0 { 0 } else { value },
                }
                *place = value;
                self.given |= 1 << axis;
                Ok(true)
            }
            _ => {
                if self.given != 0 {
                    return Ok(false);
                }
                let value = self.number.integer(strict)?;
                let is_time = matches!(self.kind, Kind::Report | Kind::Deadman);
                if self.kind == Kind::Report && value <= 0 {
                    return Err(What::Rate);
                }
                if is_time && !(0..=0xffff).contains(&value) {
                    return Err(What::Range);
                }
                self.values = [value, 0, 0, 0];
                self.given = 1;
                Ok(true)
            }
        }
    }

    fn command(&self, strict: bool) -> Result<Command, What> {
        let (axes, [value, ..], [first, second]) = (self.axes, self.values, self.decimals);
        let wanted = match self.kind {
            Kind::Unknown | Kind::Version | Kind::Ping => 0,
            Kind::Gains | Kind::Limits => 2,
            // An axis without a value is left alone; with none at all nothing would be done.
            Kind::Axes(_) if strict => self.flags + u8::from(self.flags == 0),
            Kind::Axes(_) | Kind::Enable | Kind::Report | Kind::Strict | Kind::Deadman => 1,
        };
        let values = if self.kind.has_flags() { self.words.saturating_sub(2) } else { self.words - 1 };
        if values < wanted {
            return Err(What::Missing);
        }
        let [b0, b1, _, _] = value.to_le_bytes();
        let short = u16::from_le_bytes([b0, b1]);
        Ok(match self.kind {
            Kind::Unknown => return Err(What::Command),
            Kind::Version => Command::Version,
            Kind::Ping => Command::Ping,
            Kind::Enable => Command::Enable(value != 0),
            Kind::Strict => Command::Strict(value != 0),
            Kind::Report => Command::Report(short),
            Kind::Deadman => Command::Deadman(short),
            Kind::Axes(verb) => Command::Axes { verb, axes: self.given, values: self.values },
            Kind::Gains => {
                let gains = Gains::new(first, second).map_err(|why| match why {
                    GainsRefused::Frequency => What::Frequency,
                    GainsRefused::Ratio => What::Ratio,
                })?;
                Command::Gains { axes, gains }
            }
            Kind::Limits => Command::Limits { axes, limits: Limits::new(first, second).ok_or(What::Range)? },
        })
    }
}
