//! Lines from the host, byte by byte, to commands.
//!
//! Nothing of a line acts before its end, so that a refused one changes nothing. Values are read as they come: there is
//! no buffer for the line, and no byte takes long.

use super::letters::{Letters, NAMES};
use super::number::Float;
use super::path::{FASTEST_DRIFT, Gains, GainsRefused, Limits, Parts, Path};

/// Axes: x, y, z, a.
const COUNT: usize = 4;

/// The longest line, bytes without its ending.
pub const LONGEST_LINE: u8 = 80;

/// The most words of a line.
pub const MOST_WORDS: u8 = 10;

/// What a command is called.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Verb {
    /// `a`: absolute targets, steps. Drivers are to be enabled.
    Target,
    /// `d`: the same, relative.
    Move,
    /// `v`: drift of the targets, steps/s, at most [`FASTEST_DRIFT`] either way. Drivers are to be enabled.
    Drift,
    /// `r`: impulse of the reference, steps.
    Impulse,
    /// `s`: ramp speed, 0 to 65 535 steps/s; 0: no limit.
    Ramp,
    /// `g`: gains.
    Gains,
    /// `l`: limits.
    Limits,
    /// `enable`: drivers on (not 0) or off.
    Enable,
    /// `srate`: the interval of status lines, 1 to 65 535 ms.
    Report,
    /// `deadman`: the longest silence, up to 65 535 ms, after which the axes are stopped; 0: any.
    Deadman,
    /// `strict`: whether any irregularity is to be refused (not 0).
    Strict,
    /// `version`.
    Version,
    /// `ping`.
    Ping,
    /// No command.
    Unknown,
}

impl Verb {
    /// The `index`th of the names.
    const fn of(index: u8) -> Verb {
        match index {
            0 => Verb::Target,
            1 => Verb::Move,
            2 => Verb::Drift,
            3 => Verb::Impulse,
            4 => Verb::Ramp,
            5 => Verb::Gains,
            6 => Verb::Limits,
            7 => Verb::Enable,
            8 => Verb::Report,
            9 => Verb::Deadman,
            10 => Verb::Strict,
            11 => Verb::Version,
            12 => Verb::Ping,
            _ => Verb::Unknown,
        }
    }

    const fn has_flags(self) -> bool {
        (self as u8) <= Verb::Limits as u8
    }

    const fn is_decimal(self) -> bool {
        matches!(self, Verb::Gains | Verb::Limits)
    }
}

/// Why a line was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum What {
    /// Nothing is wrong.
    Nothing,
    /// No such command.
    Command,
    /// A flag that is no axis, or an axis twice. Only when strict.
    Flags,
    /// Not a number, or not a whole one where one is needed.
    Number,
    /// A number that is too large, or too small.
    Range,
    /// Too few values.
    Missing,
    /// Too many values. Only when strict.
    Extra,
    /// More than [`LONGEST_LINE`] bytes.
    Long,
    /// A byte that is no text.
    Noise,
    /// The checksum is not that of the line, or no checksum.
    Checksum,
    /// A frequency outside of 0.01 to 20 Hz.
    Frequency,
    /// A damping ratio outside of 0.07 to 5.
    Ratio,
    /// `srate` with a value that is not positive: `dbg`, as the original said it.
    Rate,
    /// More than [`MOST_WORDS`]: `dbg`, as the original said it.
    Words,
}

/// A refused line, of which nothing was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Why.
    pub what: What,
    /// In which word, counted from 1.
    pub word: u8,
}

/// What a byte has brought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heard {
    /// Nothing yet.
    Nothing,
    /// A command: the reader has it until the next byte.
    Command(Verb),
    /// A line that was refused.
    Refused(Refusal),
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

    const fn is_number(&self) -> bool {
        let lacks_exponent = self.seen & seen::EXPONENT != 0 && self.exponent == NO_DIGIT;
        self.seen & (seen::BAD | seen::DIGIT) == seen::DIGIT && !lacks_exponent
    }

    /// Whether it has a point, at which whole numbers end.
    const fn is_cut(&self) -> bool {
        self.seen & seen::POINT != 0
    }

    const fn is_negative(&self) -> bool {
        self.seen & seen::MINUS != 0
    }

    /// As a whole number of 32 bits, if it is one.
    fn integer(&self) -> Option<i32> {
        let negative = self.is_negative();
        if self.power != 0 || self.digits > 0x7fff_ffff + u32::from(negative) {
            return None;
        }
        let value = self.digits.cast_signed();
        Some(if negative { value.wrapping_neg() } else { value })
    }

    /// If it is not negative, and less than 2^32.
    fn float(&self) -> Option<Float> {
        let exponent = if self.exponent == NO_DIGIT { 0 } else { self.exponent.cast_signed() };
        let exponent = if self.seen & seen::EXPONENT_MINUS != 0 { -exponent } else { exponent };
        // Within ±120, and Float goes on from there.
        if self.is_negative() && self.digits != 0 {
            return None;
        }
        Float::from_decimal(self.digits, self.power + exponent)
    }
}

/// How far a checksum is: `*` and two hexadecimal digits, at the end of a line.
mod check {
    pub(super) const NONE: u8 = 0;
    pub(super) const DONE: u8 = 3;
    pub(super) const BAD: u8 = 4;
}

/// Reads lines.
///
/// ```
/// use pulsetrain_core::winch::letters::InMemory;
/// use pulsetrain_core::winch::text::{Heard, Reader, Verb, What};
/// let mut reader = Reader::new();
/// let mut hear = |line: &[u8]| line.iter().map(|byte| reader.push::<InMemory>(*byte)).last().unwrap();
/// assert_eq!(hear(b"a ax 5 7\n"), Heard::Command(Verb::Target));
/// let Heard::Refused(refusal) = hear(b"a x seven\n") else { panic!() };
/// assert_eq!((refusal.what, refusal.word), (What::Number, 3));
/// ```
#[derive(Clone, Debug)]
pub struct Reader {
    strict: bool,
    /// A line has ended: the next byte begins another.
    over: bool,
    line: Line,
}

/// What is known of a line. All zeros at its beginning.
#[derive(Clone, Debug)]
struct Line {
    /// Bytes.
    len: u8,
    /// Words begun.
    words: u8,
    /// Letters of the word being read; 0 between words.
    within: u8,
    /// Of all bytes before the checksum: exclusive or.
    sum: u8,
    check: u8,
    /// What the checksum says.
    given_sum: u8,
    fault: Refusal,
    verb: Verb,
    /// Flags that are axes, two bits each, the last one lowest; at most eight.
    order: u16,
    flags: u8,
    /// Axes among the flags.
    axes: u8,
    /// Axes with a value.
    given: u8,
    /// Of the first word.
    letters: [u8; LETTERS],
    number: Number,
    /// A value for each axis; of gains and limits: two mantissas and two exponents, and in the end their [`Parts`].
    values: [i32; COUNT],
}

/// More than the longest command has.
const LETTERS: usize = 8;

impl Line {
    const NONE: Line = Line {
        len: 0,
        words: 0,
        within: 0,
        sum: 0,
        check: check::NONE,
        given_sum: 0,
        fault: Refusal { what: What::Nothing, word: 0 },
        verb: Verb::Target,
        order: 0,
        flags: 0,
        axes: 0,
        given: 0,
        letters: [0; LETTERS],
        number: Number { digits: 0, power: 0, exponent: 0, seen: 0 },
        values: [0; COUNT],
    };
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
        Reader { strict: false, over: false, line: Line::NONE }
    }

    /// From now on any irregularity is refused, or none that does no harm.
    pub const fn set_strict(&mut self, strict: bool) {
        self.strict = strict;
    }

    /// Forgets what it has of a line.
    pub const fn restart(&mut self) {
        self.over = true;
    }

    /// Takes a byte, and says at a line's end, unless the line is blank, what it was.
    #[inline(never)]
    pub fn push<L: Letters>(&mut self, byte: u8) -> Heard {
        if self.over {
            self.over = false;
            self.line = Line::NONE;
        }
        let ends = byte == b'\n' || byte == b'\r';
        if !ends {
            if self.line.len == LONGEST_LINE {
                self.refuse(What::Long);
                return Heard::Nothing;
            }
            self.line.len += 1;
        }
        let is_check = self.line.check != check::NONE || byte == b'*';
        if ends || is_check || byte == b' ' || byte == b'\t' {
            if self.line.within != 0 && self.line.fault.what == What::Nothing {
                self.end_word::<L>();
            }
            self.line.within = 0;
            if ends {
                return self.end();
            }
            if is_check {
                self.push_check(byte);
            } else {
                self.line.sum ^= byte;
            }
            return Heard::Nothing;
        }
        self.line.sum ^= byte;
        if self.line.within == 0 {
            self.line.words += 1;
            self.line.number = Number::NONE;
            if self.line.words > MOST_WORDS {
                self.refuse(What::Words);
            }
        }
        self.line.within += 1;
        if !matches!(byte, 0x21..=0x7e) {
            self.refuse(What::Noise);
        }
        match self.line.words {
            1 => match self.line.letters.get_mut(usize::from(self.line.within - 1)) {
                Some(place) => *place = byte,
                None => self.refuse(What::Command),
            },
            2 if self.line.verb.has_flags() => self.push_flag(byte),
            _ => self.line.number.push(byte, !self.line.verb.is_decimal()),
        }
        Heard::Nothing
    }

    /// The value of a command that has one and is not for axes.
    #[must_use]
    pub const fn value(&self) -> i32 {
        let [value, ..] = self.line.values;
        value
    }

    /// Axes that a command is for: those with a value, or for gains and limits all that are named. 1 is x, 2 y, 4 z, 8 a.
    #[must_use]
    pub const fn axes(&self) -> u8 {
        if self.line.verb.is_decimal() { self.line.axes } else { self.line.given }
    }

    /// Values by axis; 0 where there is none.
    #[must_use]
    pub const fn values(&self) -> [i32; COUNT] {
        self.line.values
    }

    /// What `g` says.
    #[must_use]
    pub const fn gains(&self) -> Gains {
        Gains::of(self.parts())
    }

    /// What `l` says.
    #[must_use]
    pub const fn limits(&self) -> Limits {
        Limits::of(self.parts())
    }

    const fn parts(&self) -> Parts {
        let [first, second, bytes, _] = self.line.values;
        let [low, high, ..] = bytes.to_le_bytes();
        Parts { first: first.cast_unsigned(), second: second.cast_unsigned(), low, high }
    }

    /// Does to four paths, in the order of x, y, z, a, what the command just heard says to axes. Other commands do
    /// nothing to them, but for `enable 0`, which stops them all within their limits: when they have stopped, the drivers
    /// may be released.
    ///
    /// ```
    /// use pulsetrain_core::winch::letters::InMemory;
    /// use pulsetrain_core::winch::path::Path;
    /// use pulsetrain_core::winch::text::{Heard, Reader};
    /// let (mut reader, mut paths) = (Reader::new(), [const { Path::new() }; 4]);
    /// for byte in *b"v y 1000\n" {
    ///     if let Heard::Command(_) = reader.push::<InMemory>(byte) {
    ///         reader.obey(&mut paths);
    ///     }
    /// }
    /// assert!(paths[0].is_at_rest() && !paths[1].is_at_rest());
    /// ```
    #[inline(never)]
    pub fn obey(&self, paths: &mut [Path; COUNT]) {
        let mut bits = self.axes();
        if !self.line.verb.has_flags() {
            if self.line.verb != Verb::Enable || self.value() != 0 {
                return;
            }
            bits = 0b1111;
        }
        let (gains, limits) = (self.gains(), self.limits());
        for (path, value) in paths.iter_mut().zip(&self.line.values) {
            if bits & 1 != 0 {
                match self.line.verb {
                    Verb::Gains => path.set_gains(&gains),
                    Verb::Limits => path.set_limits(&limits),
                    Verb::Target => path.set_target(*value),
                    Verb::Move => path.move_target(*value),
                    Verb::Impulse => path.push_reference(*value),
                    Verb::Drift => path.set_drift(low(*value).cast_signed()),
                    Verb::Ramp => path.set_ramp(low(*value)),
                    _ => path.stop(),
                }
            }
            bits >>= 1;
        }
    }

    /// The first fault is the one told.
    #[inline(never)]
    fn refuse(&mut self, what: What) {
        if self.line.fault.what == What::Nothing {
            self.line.fault = Refusal { what, word: self.line.words };
        }
    }

    /// The line is over.
    #[inline(always)]
    fn end(&mut self) -> Heard {
        let cut = self.line.len == LONGEST_LINE;
        self.over = true;
        let checked =
            self.line.check == check::NONE || (self.line.check == check::DONE && self.line.given_sum == self.line.sum);
        // Whatever else is wrong comes from that; but the end of a line that is too long was not read.
        let excused = cut && self.line.fault.what != What::Nothing;
        if !(checked || excused) {
            self.line.fault.what = What::Nothing;
            self.refuse(What::Checksum);
        }
        if self.line.fault.what == What::Nothing {
            if self.line.words == 0 {
                return Heard::Nothing;
            }
            self.check_values();
        }
        if self.line.fault.what == What::Nothing {
            Heard::Command(self.line.verb)
        } else {
            Heard::Refused(self.line.fault)
        }
    }

    /// Whether the values of a line that is over are enough, and gains and limits are taken.
    #[inline(always)]
    fn check_values(&mut self) {
        let mut values = self.line.words - 1;
        let mut wanted = match self.line.verb {
            Verb::Version | Verb::Ping => 0,
            Verb::Gains | Verb::Limits => 2,
            // An axis without a value is left alone; with none at all nothing would be done.
            _ => 1,
        };
        if self.line.verb.has_flags() {
            values = values.saturating_sub(1);
            if self.strict && !self.line.verb.is_decimal() && self.line.flags > 1 {
                wanted = self.line.flags;
            }
        }
        if values < wanted {
            self.line.words += 1;
            self.refuse(What::Missing);
        } else if self.line.verb.is_decimal() {
            let [first, second, low, high] = self.line.values;
            let [first_exponent, ..] = low.to_le_bytes();
            let [second_exponent, ..] = high.to_le_bytes();
            let first = Float::new(first.cast_unsigned(), first_exponent.cast_signed());
            let second = Float::new(second.cast_unsigned(), second_exponent.cast_signed());
            self.tune(first, second);
        }
    }

    #[inline(never)]
    fn tune(&mut self, first: Float, second: Float) {
        let parts = if self.line.verb == Verb::Gains {
            match Gains::new(first, second) {
                Ok(gains) => gains.parts(),
                Err(why) => {
                    self.line.words = if why == GainsRefused::Frequency { 3 } else { 4 };
                    return self.refuse(if why == GainsRefused::Frequency { What::Frequency } else { What::Ratio });
                }
            }
        } else if let Some(limits) = Limits::new(first, second) {
            limits.parts()
        } else {
            self.line.words = 4;
            return self.refuse(What::Range);
        };
        let bytes = i32::from_le_bytes([parts.low, parts.high, 0, 0]);
        self.line.values = [parts.first.cast_signed(), parts.second.cast_signed(), bytes, 0];
    }

    #[inline(never)]
    fn push_check(&mut self, byte: u8) {
        let digit = match byte | 0x20 {
            b'0'..=b'9' if byte & 0x20 != 0 => byte - b'0',
            letter @ b'a'..=b'f' => letter - b'a' + 10,
            _ => 16,
        };
        if self.line.check == check::NONE {
            self.line.check = 1;
        } else if digit < 16 && self.line.check < check::DONE {
            self.line.check += 1;
            self.line.given_sum = self.line.given_sum << 4 | digit;
        } else {
            self.line.check = check::BAD;
        }
    }

    /// Finds the command that the letters are.
    #[inline(never)]
    fn find<L: Letters>(&mut self) {
        let mut at = NAMES;
        let mut index = 0;
        while index < Verb::Unknown as u8 {
            // Names end with a 0; so do letters, but for a word of eight, which is none of them.
            let mut same = true;
            for ours in &self.line.letters {
                let letter = L::letter(at);
                at += 1;
                same &= *ours == letter;
                if letter == 0 {
                    break;
                }
            }
            if same {
                break;
            }
            index += 1;
        }
        self.line.verb = Verb::of(index);
        if self.line.verb == Verb::Unknown {
            self.refuse(What::Command);
        }
    }

    #[inline(never)]
    fn push_flag(&mut self, byte: u8) {
        let axis = match byte {
            b'x'..=b'z' => byte - b'x',
            b'a' => 3,
            _ => {
                if self.strict {
                    self.refuse(What::Flags);
                }
                return;
            }
        };
        let bit = bit(axis);
        if self.strict && self.line.axes & bit != 0 {
            self.refuse(What::Flags);
        }
        self.line.axes |= bit;
        // There is no room for more than eight values.
        if self.line.flags < 8 {
            self.line.order = self.line.order << 2 | u16::from(axis);
            self.line.flags += 1;
        }
    }

    /// The word being read is over.
    #[inline(never)]
    fn end_word<L: Letters>(&mut self) {
        let mut index = self.line.words - 1;
        if index == 0 {
            self.find::<L>();
            return;
        }
        let mut wanted = 1;
        match self.line.verb {
            Verb::Version | Verb::Ping => wanted = 0,
            verb if verb.has_flags() => {
                if index == 1 {
                    return;
                }
                index -= 1;
                wanted = if verb.is_decimal() { 2 } else { self.line.flags };
            }
            _ => {}
        }
        if index > wanted {
            if self.strict {
                self.refuse(What::Extra);
            }
        } else if !self.line.number.is_number()
            || (self.strict && !self.line.verb.is_decimal() && self.line.number.is_cut())
        {
            self.refuse(What::Number);
        } else if self.line.verb.is_decimal() {
            self.take_decimal(index);
        } else {
            self.take_integer(index, wanted);
        }
    }

    /// Takes the number just read, the `index`th from 1.
    #[inline(always)]
    fn take_decimal(&mut self, index: u8) {
        let Some(float) = self.line.number.float() else { return self.refuse(What::Range) };
        let (mantissa, exponent) = float.parts();
        let [first, second, low, high] = &mut self.line.values;
        let (place, below) = if index == 1 { (first, low) } else { (second, high) };
        *place = mantissa.cast_signed();
        *below = exponent.into();
    }

    /// Takes the number just read, the `index`th from 1 of `count`.
    #[inline(never)]
    fn take_integer(&mut self, index: u8, count: u8) {
        let Some(mut value) = self.line.number.integer() else { return self.refuse(What::Range) };
        let mut axis = 0;
        if self.line.verb.has_flags() {
            let mut order = self.line.order;
            let mut last = count;
            while last > index {
                order >>= 2;
                last -= 1;
            }
            let [flag, _] = order.to_le_bytes();
            axis = flag & 3;
            self.line.given |= bit(axis);
        }
        let Some(place) = self.line.values.get_mut(usize::from(axis)) else { return };
        match self.line.verb {
            Verb::Move | Verb::Impulse => {
                // Named twice, an axis moves by both.
                let (sum, overflow) = place.overflowing_add(value);
                if overflow {
                    return self.refuse(What::Range);
                }
                value = sum;
            }
            Verb::Drift if value.unsigned_abs() > u32::from(FASTEST_DRIFT) => return self.refuse(What::Range),
            Verb::Report if value <= 0 => return self.refuse(What::Rate),
            Verb::Ramp if value < 0 => value = 0,
            Verb::Ramp | Verb::Report | Verb::Deadman => {
                let [_, _, b2, b3] = value.to_le_bytes();
                if b2 | b3 != 0 {
                    return self.refuse(What::Range);
                }
            }
            _ => {}
        }
        *place = value;
    }
}

/// An axis' bit.
const fn bit(axis: u8) -> u8 {
    // By steps: an AVR has no shift by a variable.
    let low = if axis & 1 == 0 { 1 } else { 2 };
    if axis & 2 == 0 { low } else { low << 2 }
}

/// Its lower half.
const fn low(value: i32) -> u16 {
    let [b0, b1, _, _] = value.to_le_bytes();
    u16::from_le_bytes([b0, b1])
}
