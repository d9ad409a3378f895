//! Verbs as lines of text, in addition to the winch's lines, and the replies to them.
//!
//! | line | |
//! |---|---|
//! | `move xy 100 200` | this many steps, then the reply `done` |
//! | `run x` | steps without an end |
//! | `speed xy 125000` | ticks from step to step; a single value is for all named axes |
//! | `dir x 1` | 1 forward, -1 backward, 0 stationary |
//! | `halt`, `halt xy` | drops moves and runs: of all axes, or of these |
//!
//! All verbs of a line act from the same tick on, which the reply has. docs/verbs.md explains the verbs.
//!
//! The winch's [`LineReader`](super::text::LineReader) finds the ends of lines and checks their checksums. It does not know these
//! commands.

use super::AXES;
use super::text::LineFault;
use crate::verbs::{Heading, Verb};
use crate::wire::Refusal;
use crate::wire::message::Reason;
use crate::wire::orders::{ORDER_LEN, Obeyed, Orders, order};

/// The result of reading a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VerbLine {
    /// The first word is none of these verbs.
    Unknown,
    /// The line cannot be read: the fault, and the word that it is in, counted from 1.
    Refused(LineFault, u8),
    /// Orders for motors.
    Orders(LineOrders),
}

/// A line that was read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineOrders {
    orders: [[u8; ORDER_LEN]; AXES.len()],
    count: u8,
    axes: u8,
}

impl LineOrders {
    /// The same as in a frame.
    #[must_use]
    pub fn orders(&self) -> Option<Orders<'_>> {
        Orders::decode(self.orders.get(..usize::from(self.count))?.as_flattened())
    }

    /// Its axes: 1 is x, 2 y, 4 z, 8 a.
    #[must_use]
    pub const fn axes(&self) -> u8 {
        self.axes
    }
}

/// Reads a line, without its end and its checksum.
///
/// ```
/// use pulsetrain_core::winch::verb_lines::{VerbLine, read};
/// use pulsetrain_core::verbs::Verb;
/// use pulsetrain_core::winch::text::LineFault;
/// let VerbLine::Orders(line) = read(b"move xz 100 8") else { panic!() };
/// let orders: Vec<_> = line.orders().unwrap().iter().collect();
/// assert_eq!(orders, [(0, Verb::Move { steps: 100 }), (2, Verb::Move { steps: 8 })]);
/// assert_eq!(read(b"move x many"), VerbLine::Refused(LineFault::Number, 3));
/// assert_eq!(read(b"a x 5"), VerbLine::Unknown);
/// ```
#[must_use]
pub fn read(line: &[u8]) -> VerbLine {
    let mut words = line.split(|byte| *byte == b' ' || *byte == b'\t').filter(|word| !word.is_empty());
    let Some(name) = words.next() else { return VerbLine::Unknown };
    let (has_value, is_halt) = match name {
        b"move" | b"speed" | b"dir" => (true, false),
        b"run" => (false, false),
        b"halt" => (false, true),
        _ => return VerbLine::Unknown,
    };
    let mut line = LineOrders { orders: [[0; ORDER_LEN]; AXES.len()], count: 0, axes: 0 };
    let flags = match words.next() {
        Some(flags) => flags,
        None if is_halt => &AXES,
        None => return VerbLine::Refused(LineFault::Missing, 2),
    };
    let (mut last, mut word) = (None, 2);
    for flag in flags {
        let axis = (0..).zip(AXES).find(|(axis, name)| name == flag && line.axes >> axis & 1 == 0);
        let Some((axis, _)) = axis else { return VerbLine::Refused(LineFault::Flags, 2) };
        line.axes |= 1 << axis;
        let verb = if has_value {
            let verb = match words.next() {
                Some(value) => {
                    word += 1;
                    verb(name, value)
                }
                // One value is for all.
                None if word == 3 => last.ok_or(LineFault::Missing),
                None => Err(LineFault::Missing),
            };
            match verb {
                Ok(verb) => verb,
                Err(what) => return VerbLine::Refused(what, if what == LineFault::Missing { word + 1 } else { word }),
            }
        } else if is_halt {
            Verb::Halt
        } else {
            Verb::Run
        };
        last = Some(verb);
        if let Some(place) = line.orders.get_mut(usize::from(line.count)) {
            *place = order(axis, verb);
        }
        line.count += 1;
    }
    if words.next().is_some() {
        return VerbLine::Refused(LineFault::Extra, word + 1);
    }
    VerbLine::Orders(line)
}

/// What `name` says with that value.
fn verb(name: &[u8], value: &[u8]) -> Result<Verb, LineFault> {
    let (is_negative, digits) = match value {
        [b'-', digits @ ..] => (true, digits),
        [b'+', digits @ ..] | digits => (false, digits),
    };
    if digits.is_empty() {
        return Err(LineFault::Number);
    }
    let mut number = 0_u64;
    for digit in digits {
        let digit = digit.wrapping_sub(b'0');
        if digit > 9 {
            return Err(LineFault::Number);
        }
        number = number.saturating_mul(10).saturating_add(digit.into());
    }
    match (name, is_negative && number != 0, number) {
        (b"dir", false, 0) => Ok(Verb::Heading(Heading::Stationary)),
        (b"dir", false, 1) => Ok(Verb::Heading(Heading::Forward)),
        (b"dir", true, 1) => Ok(Verb::Heading(Heading::Backward)),
        (b"speed", false, ticks) => Ok(Verb::Speed { ticks }),
        (b"move", false, steps) => u32::try_from(steps).map(|steps| Verb::Move { steps }).map_err(|_| LineFault::Range),
        _ => Err(LineFault::Range),
    }
}

/// A line to the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VerbReply {
    /// `at <tick> x <position> <ticks to the next step> …`: the axes that a line named. `-` instead of ticks: no step comes, or none
    /// within 2^32 ticks.
    At {
        /// The tick from which on it acts, and what each axis does there.
        obeyed: Obeyed,
        /// As [`LineOrders::axes`].
        axes: u8,
    },
    /// `done <axis> <tick> <number>`: a move is finished, with the last step's period. The number counts the axis' moves since it was enabled.
    Done {
        /// 0 is x.
        axis: u8,
        /// When.
        tick: u64,
        /// Of this axis, wrapping.
        number: u32,
    },
    /// `uncertain <axes>`: the deadman stopped these axes at once, without a ramp. Text does not know their pull-in speeds. An axis that was
    /// faster may stand elsewhere than its count says.
    Uncertain {
        /// As [`LineOrders::axes`].
        axes: u8,
    },
    /// `err <what> <word>`: the line cannot be read.
    Unread(LineFault, u8),
    /// `err period <shortest>`, `err busy <axis>`: a motor refuses the verb. `err stopped`: motors stopped by themselves, and a new session of
    /// text begins. `err moving`: motors still move, under frames or after `enable 0`.
    Refused(Refusal),
    /// `err path`: the axes follow the winch's paths; `enable 0` ends that.
    Path,
    /// `err verbs`: the axes obey verbs, not paths; `enable 0` ends that.
    Verbs,
}

/// The longest reply, bytes.
pub const LONGEST: usize =
    "at ".len() + 20 + AXES.len() * (" x".len() + " -2147483648".len() + " 4294967295".len()) + 2;

impl VerbReply {
    /// Writes it, with CR LF, and says how many bytes it has; [`LONGEST`] at most.
    ///
    /// ```
    /// use pulsetrain_core::winch::verb_lines::{LONGEST, VerbReply};
    /// let mut line = [0; LONGEST];
    /// let len = VerbReply::Done { axis: 3, tick: u64::MAX, number: 7 }.write(&mut line);
    /// assert_eq!(line[..len], *b"done a 18446744073709551615 7\r\n");
    /// ```
    pub fn write(&self, out: &mut [u8]) -> usize {
        let mut to = LineWriter { out, len: 0 };
        match self {
            VerbReply::At { obeyed, axes } => {
                to.text(b"at");
                to.number(obeyed.tick);
                for ((axis, next), name) in (0..).zip(obeyed.motors()).zip(AXES) {
                    if axes >> axis & 1 != 0 {
                        to.text(&[b' ', name]);
                        to.signed(next.position);
                        if next.wait == u32::MAX {
                            to.text(b" -");
                        } else {
                            to.number(next.wait.into());
                        }
                    }
                }
            }
            VerbReply::Done { axis, tick, number } => {
                to.text(b"done ");
                to.text(&[name(u16::from(*axis))]);
                to.number(*tick);
                to.number((*number).into());
            }
            VerbReply::Uncertain { axes } => {
                to.text(b"uncertain ");
                for (axis, name) in (0..).zip(AXES) {
                    if axes >> axis & 1 != 0 {
                        to.text(&[name]);
                    }
                }
            }
            VerbReply::Unread(what, word) => {
                to.text(match what {
                    LineFault::Flags => b"err flags",
                    LineFault::Number => b"err number",
                    LineFault::Range => b"err range",
                    LineFault::Missing => b"err missing",
                    _ => b"err extra",
                });
                to.number((*word).into());
            }
            VerbReply::Refused(Refusal { reason: Reason::Period, detail }) => {
                to.text(b"err period");
                to.number((*detail).into());
            }
            VerbReply::Refused(Refusal { reason: Reason::Busy, detail }) => {
                to.text(b"err busy ");
                to.text(&[name(*detail)]);
            }
            VerbReply::Refused(Refusal { reason: Reason::NotArmed, .. }) => to.text(b"err stopped"),
            VerbReply::Refused(_) => to.text(b"err moving"),
            VerbReply::Path => to.text(b"err path"),
            VerbReply::Verbs => to.text(b"err verbs"),
        }
        to.text(b"\r\n");
        to.len
    }
}

/// Powers of ten. A table is used because a product of 64 bits would take a board longer than all else here.
const UNITS: [u64; 20] = {
    let (mut units, mut place) = ([1; 20], 19);
    while place > 0 {
        place -= 1;
        units[place] = 10 * units[place + 1];
    }
    units
};

const fn name(axis: u16) -> u8 {
    AXES[(axis & 3) as usize]
}

/// Bytes of a line being written; what does not fit is lost.
struct LineWriter<'a> {
    out: &'a mut [u8],
    len: usize,
}

impl LineWriter<'_> {
    fn text(&mut self, text: &[u8]) {
        for byte in text {
            if let Some(place) = self.out.get_mut(self.len) {
                *place = *byte;
                self.len += 1;
            }
        }
    }

    fn signed(&mut self, value: i32) {
        if value < 0 {
            self.text(b" -");
            self.digits(value.unsigned_abs().into());
        } else {
            self.number(value.unsigned_abs().into());
        }
    }

    /// A space, and the number.
    fn number(&mut self, value: u64) {
        self.text(b" ");
        self.digits(value);
    }

    /// Writes a number digit by digit, by subtractions, because boards have no division.
    fn digits(&mut self, value: u64) {
        let (mut rest, mut begun) = (value, false);
        for unit in UNITS {
            let mut digit = b'0';
            while rest >= unit {
                rest -= unit;
                digit += 1;
            }
            begun |= digit != b'0' || unit == 1;
            if begun {
                self.text(&[digit]);
            }
        }
    }
}
