//! Reads lines from the host, byte by byte, as commands, and applies these to paths. [`session`](super::session) has drivers and status
//! lines.
//!
//! A line is stored, and read when it ends, so that a refused line changes nothing. The Uno does the same in assembly,
//! firmware/uno/src/bin/uno-winch/winch/text.s; crates/board/tests/it/chips/winch_avr.rs compares the two.

use super::letters::{COMMANDS, Letters, NAMES};
use super::path::{self, FASTEST, FASTEST_DRIFT, Gains, Limits, MAX_ACCELERATION, MIN_ACCELERATION, Path};

/// Axes: x, y, z, a.
const COUNT: usize = 4;

/// The longest line, bytes without its ending.
pub const LONGEST_LINE: u8 = 80;

/// The most words of a line.
pub const MAX_WORDS: u8 = 10;

/// The commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum LineCommand {
    /// `a`: absolute targets, steps. It enables the drivers.
    Target,
    /// `d`: relative targets, steps. It enables the drivers.
    Move,
    /// `v`: drift of the targets, steps/s, at most [`FASTEST_DRIFT`] either way. A greater one is cut to that, or refused when strict. It
    /// enables the drivers.
    Drift,
    /// `r`: impulse of the reference, steps.
    Impulse,
    /// `s`: ramp speed, 0 to 65 535 steps/s; 0: no limit.
    Ramp,
    /// `g`: gains.
    Gains,
    /// `l`: limits. Greater ones than a path allows are cut, or refused when strict.
    Limits,
    /// `enable`: drivers on (not 0; strict: 1) or off.
    Enable,
    /// `srate`: the interval of status lines, 1 to 65 535 ms.
    Report,
    /// `deadman`: the axes are stopped after this long a silence, up to 65 535 ms; 0: never.
    Deadman,
    /// `strict`: whether irregular lines are refused (1), or read as the original does (0).
    Strict,
    /// `version`.
    Version,
    /// `ping`.
    Ping,
    /// No command.
    Unknown,
}

impl LineCommand {
    /// The `index`th of the names.
    const fn of(index: u8) -> LineCommand {
        match index {
            0 => LineCommand::Target,
            1 => LineCommand::Move,
            2 => LineCommand::Drift,
            3 => LineCommand::Impulse,
            4 => LineCommand::Ramp,
            5 => LineCommand::Gains,
            6 => LineCommand::Limits,
            7 => LineCommand::Enable,
            8 => LineCommand::Report,
            9 => LineCommand::Deadman,
            10 => LineCommand::Strict,
            11 => LineCommand::Version,
            12 => LineCommand::Ping,
            _ => LineCommand::Unknown,
        }
    }

    /// Whether the letters of axes come next.
    #[must_use]
    pub const fn has_flags(self) -> bool {
        (self as u8) <= LineCommand::Limits as u8
    }

    const fn is_decimal(self) -> bool {
        matches!(self, LineCommand::Gains | LineCommand::Limits)
    }
}

const _: () = assert!(LineCommand::Unknown as u8 == COMMANDS, "the names stand in the order of the commands");

/// Why a line was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum LineFault {
    /// Nothing is wrong.
    Nothing,
    /// No such command.
    Command,
    /// No axis is named. When strict, also: a letter is no axis, or an axis is named twice.
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
    /// The checksum is not that of the line, or no checksum; or it is missing where one is needed.
    Checksum,
    /// A frequency outside of 0.01 to 20 Hz.
    Frequency,
    /// A damping ratio outside of 0.07 to 5.
    Ratio,
    /// `srate` with a value that is not positive: `dbg`, as the original said it.
    Rate,
    /// More than [`MAX_WORDS`]: `dbg`, as the original said it.
    Words,
}

/// A refused line. It changed nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineError {
    /// Why.
    pub what: LineFault,
    /// The word that is at fault, counted from 1.
    pub word: u8,
}

/// What a byte has completed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heard {
    /// Nothing yet.
    Nothing,
    /// A command. The reader keeps it until the next byte.
    Command(LineCommand),
    /// A line that was refused.
    Refused(LineError),
}

/// Reads lines.
///
/// ```
/// use pulsetrain_core::winch::letters::InMemory;
/// use pulsetrain_core::winch::text::{Heard, LineReader, LineCommand, LineFault};
/// let mut reader = LineReader::new();
/// let mut hear = |line: &[u8]| line.iter().map(|byte| reader.push::<InMemory>(*byte)).last().unwrap();
/// assert_eq!(hear(b"a ax 5 7\n"), Heard::Command(LineCommand::Target));
/// let Heard::Refused(refusal) = hear(b"a x seven\n") else { panic!() };
/// assert_eq!((refusal.what, refusal.word), (LineFault::Number, 3));
/// ```
#[derive(Clone, Debug)]
pub struct LineReader {
    strict: bool,
    /// A correct checksum was seen since strictness was last set.
    checked: bool,
    /// A line has ended: the next byte begins another.
    over: bool,
    verb: LineCommand,
    /// Axes among the flags.
    axes: u8,
    /// Axes with a value.
    given: u8,
    /// The number of words so far; while the line is read, the number of the cursor's word.
    words: u8,
    /// The first fault in the line.
    fault: LineError,
    /// A value for each axis; for gains and limits two values.
    values: [i32; COUNT],
    /// Bytes of the line, without its end.
    len: u8,
    /// Where its checksum begins, counted from 1; 0: there is none.
    star: u8,
    /// The next byte to be read.
    at: u8,
    /// The line, with a 0 after it.
    bytes: [u8; LONGEST_LINE as usize + 1],
}

/// Decimal places: of limits, and of gains.
const PLACES: [i8; 2] = [3, 6];

/// The largest power of ten by which a number is still multiplied after its digits fill 32 bits.
const FARTHEST: i8 = 32;

/// Larger exponents are cut to this one: the digits of a line are too few to bring the number back into range.
const FAR: u8 = 50;

impl Default for LineReader {
    fn default() -> LineReader {
        LineReader::new()
    }
}

impl LineReader {
    /// A reader that waits for a line. It is not strict.
    #[must_use]
    pub const fn new() -> LineReader {
        LineReader {
            strict: false,
            checked: false,
            over: true,
            verb: LineCommand::Target,
            axes: 0,
            given: 0,
            words: 0,
            fault: LineError { what: LineFault::Nothing, word: 0 },
            values: [0; COUNT],
            len: 0,
            star: 0,
            at: 0,
            bytes: [0; LONGEST_LINE as usize + 1],
        }
    }

    /// Sets whether irregular lines are refused.
    ///
    /// A strict reader wants a checksum in every line after the first line with a correct one. That may be the line just read, the one that
    /// sets strictness.
    pub const fn set_strict(&mut self, strict: bool) {
        self.strict = strict;
        self.checked = self.star != 0;
    }

    /// Forgets the beginning of a line.
    pub const fn restart(&mut self) {
        self.over = true;
    }

    /// Takes a byte. At the end of a line that is not blank it returns the command or the fault.
    pub fn push<L: Letters>(&mut self, byte: u8) -> Heard {
        if self.over {
            (self.over, self.len, self.star, self.words, self.fault.what) = (false, 0, 0, 0, LineFault::Nothing);
            self.put(0);
        }
        if byte == b'\n' || byte == b'\r' {
            self.over = true;
            return self.end::<L>();
        }
        if self.len == LONGEST_LINE {
            self.refuse(LineFault::Long);
            return Heard::Nothing;
        }
        if byte == b'*' && self.star == 0 {
            self.star = self.len + 1;
        }
        if !is_blank(byte) {
            if self.star == 0 && is_blank(self.before()) {
                self.words += 1;
                if self.words > MAX_WORDS {
                    self.refuse(LineFault::Words);
                }
            }
            if !matches!(byte, 0x21..=0x7e) {
                self.refuse(LineFault::Noise);
            }
        }
        self.put(byte);
        self.len += 1;
        Heard::Nothing
    }

    /// The line that was read last, without its checksum. It is there until the next byte comes.
    #[must_use]
    pub fn line(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or_default()
    }

    /// The value of a command that has one and is not for axes.
    #[must_use]
    pub const fn value(&self) -> i32 {
        let [value, ..] = self.values;
        value
    }

    /// Axes that a command is for: those with a value, or for gains and limits all that are named. 1 is x, 2 y, 4 z, 8 a.
    #[must_use]
    pub const fn axes(&self) -> u8 {
        if self.verb.is_decimal() { self.axes } else { self.given }
    }

    /// Values by axis; 0 where there is none. Of gains f and ζ, 10^-6; of limits vmax and amax, 10^-3.
    #[must_use]
    pub const fn values(&self) -> &[i32; COUNT] {
        &self.values
    }

    /// The gains of `g`.
    #[must_use]
    pub const fn gains(&self) -> Option<Gains> {
        let [frequency, ratio, ..] = self.values;
        Gains::new(frequency.cast_unsigned(), ratio.cast_unsigned())
    }

    /// The limits of `l`.
    #[must_use]
    pub const fn limits(&self) -> Option<Limits> {
        let [speed, acceleration, ..] = self.values;
        Limits::new(speed.cast_unsigned(), acceleration.cast_unsigned())
    }

    /// Applies the command that was just read to four paths, in the order x, y, z, a. A command that is not for axes changes no path, except
    /// `enable 0`: it stops all paths within their limits, and when they have stopped, the drivers may be released.
    ///
    /// ```
    /// use pulsetrain_core::winch::letters::InMemory;
    /// use pulsetrain_core::winch::path::Path;
    /// use pulsetrain_core::winch::text::{Heard, LineReader};
    /// let (mut reader, mut paths) = (LineReader::new(), [const { Path::new() }; 4]);
    /// for byte in *b"v y 1000\n" {
    ///     if let Heard::Command(_) = reader.push::<InMemory>(byte) {
    ///         reader.obey(&mut paths);
    ///     }
    /// }
    /// assert!(paths[0].is_at_rest() && !paths[1].is_at_rest());
    /// ```
    pub fn obey(&self, paths: &mut [Path; COUNT]) {
        let mut bits = self.axes();
        if !self.verb.has_flags() {
            if self.verb != LineCommand::Enable || self.value() != 0 {
                return;
            }
            bits = 0b1111;
        }
        for (path, value) in paths.iter_mut().zip(self.values) {
            if bits & 1 != 0 {
                match self.verb {
                    LineCommand::Gains => self.gains().iter().for_each(|gains| path.set_gains(gains)),
                    LineCommand::Limits => self.limits().iter().for_each(|limits| path.set_limits(limits)),
                    LineCommand::Target => path.set_target(value),
                    LineCommand::Move => path.move_target(value),
                    LineCommand::Impulse => path.push_reference(value),
                    LineCommand::Drift => path.set_drift(low(value).cast_signed()),
                    LineCommand::Ramp => path.set_ramp(low(value)),
                    _ => path.stop(),
                }
            }
            bits >>= 1;
        }
    }

    /// Of several faults the first is reported.
    fn refuse(&mut self, what: LineFault) {
        if self.fault.what == LineFault::Nothing {
            self.fault = LineError { what, word: self.words };
        }
    }

    /// The last byte that was stored; a blank at the beginning.
    fn before(&self) -> u8 {
        let Some(before) = self.len.checked_sub(1) else { return b' ' };
        self.bytes.get(usize::from(before)).copied().unwrap_or(0)
    }

    /// Behind the line.
    fn put(&mut self, byte: u8) {
        if let Some(place) = self.bytes.get_mut(usize::from(self.len)) {
            *place = byte;
        }
    }

    /// The byte at the cursor; 0 at the end.
    fn byte(&self) -> u8 {
        self.bytes.get(usize::from(self.at)).copied().unwrap_or(0)
    }

    /// The line is over.
    fn end<L: Letters>(&mut self) -> Heard {
        self.put(0);
        let is_right = if self.star != 0 {
            while is_blank(self.before()) {
                self.len -= 1;
            }
            let is_right = self.is_checked();
            self.checked |= is_right;
            self.len = self.star - 1;
            self.put(0);
            is_right
        } else {
            self.words == 0 || !(self.strict && self.checked)
        };
        // A wrong checksum explains all other faults, so it is the one that is reported. The end of a line that is too long was not read.
        if !is_right && self.fault.what != LineFault::Long {
            self.fault.what = LineFault::Nothing;
            self.refuse(LineFault::Checksum);
        }
        if self.fault.what == LineFault::Nothing {
            if self.words == 0 {
                return Heard::Nothing;
            }
            let what = self.read::<L>();
            self.refuse(what);
        }
        match self.fault.what {
            LineFault::Nothing => Heard::Command(self.verb),
            _ => Heard::Refused(self.fault),
        }
    }

    /// Whether the line ends with `*` and two hexadecimal digits, the exclusive or of all bytes before.
    fn is_checked(&mut self) -> bool {
        let mut sum = 0;
        self.at = 0;
        while self.at + 1 < self.star {
            sum ^= self.byte();
            self.at += 1;
        }
        let mut given = 0;
        while self.at + 1 < self.len {
            self.at += 1;
            let byte = self.byte();
            let digit = match byte | 0x20 {
                b'0'..=b'9' if byte & 0x20 != 0 => byte - b'0',
                letter @ b'a'..=b'f' => letter - b'a' + 10,
                _ => return false,
            };
            given = given << 4 | digit;
        }
        sum == given && self.len == self.star + 2
    }

    /// Reads a line that is not blank. Returns what is wrong with it, in the word at the cursor.
    fn read<L: Letters>(&mut self) -> LineFault {
        (self.at, self.words, self.axes, self.given, self.values) = (0, 0, 0, 0, [0; COUNT]);
        self.begin_word();
        if !self.find::<L>() {
            return LineFault::Command;
        }
        // The number of values that the command needs.
        let mut left = match self.verb {
            LineCommand::Version | LineCommand::Ping => 0,
            _ => 1,
        };
        let mut flag = 0;
        if self.verb.has_flags() {
            if !self.begin_word() {
                return LineFault::Missing;
            }
            flag = self.at;
            left = self.read_flags();
            if self.axes == 0 || self.strict && left == u8::MAX {
                return LineFault::Flags;
            }
            if self.verb.is_decimal() {
                left = 2;
            }
        }
        let all = self.strict || self.verb.is_decimal();
        let mut index = 0;
        while self.begin_word() {
            if left == 0 {
                if self.strict {
                    return LineFault::Extra;
                }
                self.skip_word();
                continue;
            }
            left -= 1;
            let what = if self.verb.is_decimal() {
                self.read_decimal(index)
            } else {
                let after = self.at;
                let mut axis = 0;
                if self.verb.has_flags() {
                    self.at = flag;
                    axis = self.next_axis();
                    flag = self.at;
                    self.at = after;
                }
                self.read_whole(axis)
            };
            if what != LineFault::Nothing {
                return what;
            }
            index += 1;
        }
        // An axis without a value is not changed. A line without any value would do nothing.
        if left != 0 && (all || index == 0) { LineFault::Missing } else { LineFault::Nothing }
    }

    /// Moves to the next word. Returns whether there is one.
    fn begin_word(&mut self) -> bool {
        while is_blank(self.byte()) {
            self.at += 1;
        }
        self.words += 1;
        self.byte() != 0
    }

    fn skip_word(&mut self) {
        while !is_end(self.byte()) {
            self.at += 1;
        }
    }

    /// Finds the command that is named by the word at the cursor. Returns whether there is one.
    fn find<L: Letters>(&mut self) -> bool {
        let (begin, mut name, mut index) = (self.at, NAMES, 0);
        while index < LineCommand::Unknown as u8 {
            self.at = begin;
            let mut same = true;
            loop {
                let letter = L::letter(name);
                name += 1;
                if letter == 0 {
                    break;
                }
                same &= letter == self.byte();
                if same {
                    self.at += 1;
                }
            }
            if same && is_end(self.byte()) {
                self.verb = LineCommand::of(index);
                return true;
            }
            index += 1;
        }
        false
    }

    /// How many axes the flags name; strict: [`u8::MAX`] if other letters are among them, or an axis twice.
    fn read_flags(&mut self) -> u8 {
        let mut count = 0;
        let mut is_bad = false;
        while !is_end(self.byte()) {
            let axis = axis(self.byte());
            self.at += 1;
            if axis < 4 {
                let bit = bit(axis);
                is_bad |= self.axes & bit != 0;
                self.axes |= bit;
                count += 1;
            } else {
                is_bad = true;
            }
        }
        if self.strict && is_bad { u8::MAX } else { count }
    }

    /// The axis of the next flag that is one. There is one.
    fn next_axis(&mut self) -> u8 {
        loop {
            let axis = axis(self.byte());
            self.at += 1;
            if axis < 4 {
                return axis;
            }
        }
    }

    /// Whether a minus was passed by; or a plus.
    fn sign(&mut self) -> bool {
        let byte = self.byte();
        if byte == b'-' || byte == b'+' {
            self.at += 1;
        }
        byte == b'-'
    }

    /// The digit at the cursor, or 10 or more.
    fn digit(&self) -> u8 {
        self.byte().wrapping_sub(b'0')
    }

    /// Reads a number as atol and atof do, but nothing may be left over after it.
    fn number(&mut self) -> Option<Number> {
        let mut number = Number { is_negative: self.sign(), is_cut: false, digits: 0, power: 0 };
        let mut seen = false;
        loop {
            let digit = self.digit();
            if digit < 10 {
                seen = true;
                // Of a whole number, digits after a point do not count.
                if !number.is_cut || self.verb.is_decimal() {
                    let fits = number.digits <= 429_496_728;
                    if fits {
                        number.digits = tenfold(number.digits) + u32::from(digit);
                    }
                    if number.is_cut && fits {
                        number.power -= 1;
                    } else if !number.is_cut && !fits {
                        number.power += 1;
                    }
                }
            } else if self.byte() == b'.' && !number.is_cut {
                number.is_cut = true;
            } else {
                break;
            }
            self.at += 1;
        }
        if seen && self.verb.is_decimal() && self.byte() | 0x20 == b'e' {
            self.at += 1;
            let is_negative = self.sign();
            seen = false;
            let mut exponent = 0;
            while self.digit() < 10 {
                seen = true;
                exponent = if exponent < FAR / 10 { exponent * 10 + self.digit() } else { FAR };
                self.at += 1;
            }
            // A line is too short for a power beyond 127.
            let exponent = exponent.cast_signed();
            number.power += if is_negative { -exponent } else { exponent };
        }
        (seen && is_end(self.byte())).then_some(number)
    }

    /// Reads a whole number, the value of `axis`.
    fn read_whole(&mut self, axis: u8) -> LineFault {
        let Some(number) = self.number() else { return LineFault::Number };
        if self.strict && number.is_cut {
            return LineFault::Number;
        }
        let Number { is_negative, digits, power, .. } = number;
        if power != 0 || digits > 0x7fff_ffff + u32::from(is_negative) {
            return LineFault::Range;
        }
        let mut value = digits.cast_signed();
        if is_negative {
            value = value.wrapping_neg();
        }
        self.given |= bit(axis);
        let Some(place) = self.values.get_mut(usize::from(axis)) else { return LineFault::Nothing };
        match self.verb {
            LineCommand::Move | LineCommand::Impulse => {
                // Named twice, an axis moves by both.
                let (sum, overflow) = place.overflowing_add(value);
                if overflow {
                    return LineFault::Range;
                }
                value = sum;
            }
            LineCommand::Drift if digits > u32::from(FASTEST_DRIFT) => {
                // No motor goes so fast.
                if self.strict || digits > 0x7fff_ffff {
                    return LineFault::Range;
                }
                let fastest = i32::from(FASTEST_DRIFT);
                value = if is_negative { -fastest } else { fastest };
            }
            LineCommand::Strict if value.cast_unsigned() > 1 => return LineFault::Range,
            LineCommand::Enable if self.strict && value.cast_unsigned() > 1 => return LineFault::Range,
            LineCommand::Report if value <= 0 => return LineFault::Rate,
            LineCommand::Ramp if value < 0 => value = 0,
            LineCommand::Ramp | LineCommand::Report | LineCommand::Deadman => {
                let [_, _, b2, b3] = value.to_le_bytes();
                if b2 | b3 != 0 {
                    return LineFault::Range;
                }
            }
            _ => {}
        }
        *place = value;
        LineFault::Nothing
    }

    /// Reads a decimal, the first or second of gains or limits.
    fn read_decimal(&mut self, index: u8) -> LineFault {
        let Some(number) = self.number() else { return LineFault::Number };
        let is_gain = self.verb == LineCommand::Gains;
        let [of_limits, of_gains] = PLACES;
        let (range, out_of_range) = match (is_gain, index) {
            (true, 0) => (path::FREQUENCIES, LineFault::Frequency),
            (true, _) => (path::RATIOS, LineFault::Ratio),
            (false, 0) => ([0, u32::from(FASTEST) * 1000], LineFault::Range),
            (false, _) => ([MIN_ACCELERATION * 1000, MAX_ACCELERATION * 1000], LineFault::Range),
        };
        let Some(mut value) = number.scaled(if is_gain { of_gains } else { of_limits }) else { return out_of_range };
        if number.is_negative && value != 0 {
            return out_of_range;
        }
        let [_, most] = range;
        if !is_gain && !self.strict && value > most {
            // What the original takes and no board does.
            value = most;
        }
        if !path::is_within(value, range) {
            return out_of_range;
        }
        if let Some(place) = self.values.get_mut(usize::from(index)) {
            *place = value.cast_signed();
        }
        LineFault::Nothing
    }
}

/// A number as it was written: ±`digits`·10^`power`.
#[derive(Clone, Copy, Debug)]
struct Number {
    is_negative: bool,
    /// It has a point, at which whole numbers end.
    is_cut: bool,
    digits: u32,
    power: i8,
}

impl Number {
    /// Without its sign, in units of 10^-`places`, rounded to nearest; all ones is what 32 bits do not hold, and `None` what a
    /// float of the original does not, 4.29·10^41 units on.
    fn scaled(&self, places: i8) -> Option<u32> {
        let (mut value, mut power, mut up) = (self.digits, self.power + places, false);
        while power > 0 && value != 0 {
            if value > 429_496_729 {
                return if power > FARTHEST { None } else { Some(u32::MAX) };
            }
            value = tenfold(value);
            power -= 1;
        }
        while power < 0 {
            up = value % 10 >= 5;
            value /= 10;
            power += 1;
        }
        Some(value + u32::from(up))
    }
}

/// Ten times as much, which must fit. An AVR's library multiplies slower.
const fn tenfold(value: u32) -> u32 {
    (value << 3) + (value << 1)
}

const fn is_blank(byte: u8) -> bool {
    byte == b' ' || byte == b'\t'
}

/// Whether a word ends before this byte.
const fn is_end(byte: u8) -> bool {
    byte == 0 || is_blank(byte)
}

/// The axis of a flag, or 4 or more.
const fn axis(flag: u8) -> u8 {
    match flag {
        b'a' => 3,
        b'x'..=b'z' => flag - b'x',
        _ => 4,
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
