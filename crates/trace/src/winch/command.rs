//! Commands: lines of StepperWinch's protocol, as orders to each axis.

use std::ops::{Range, RangeInclusive};

/// Axes, in the order of their letters in a status line.
pub const AXES: [char; 4] = ['x', 'y', 'z', 'a'];

/// An order of a line to one axis. The letters are the protocol's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// `a`: the target is this position, steps.
    Target(f64),
    /// `d`: the target moves by this, steps.
    Move(f64),
    /// `v`: the target drifts at this speed, steps/s.
    Drift(f64),
    /// `r`: target and reference move by this at once, steps.
    Impulse(f64),
    /// `s`: the reference goes to its target no faster than this, steps/s; 0: at once.
    Ramp(f64),
    /// `g`: sets natural frequency and damping ratio.
    Gains {
        /// Natural frequency, Hz.
        frequency_hz: f64,
        /// Damping ratio.
        ratio: f64,
    },
    /// `l`: sets the limits of speed and acceleration.
    Limits {
        /// Steps/s.
        speed: f64,
        /// Steps/s².
        acceleration: f64,
    },
    /// `enable 0`: brakes within the limits, then switches the drivers off.
    Stop,
    /// A deadman has triggered: brakes within the limits, if the drivers are on.
    Halt,
}

/// A line after it has been read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// The orders to x, y, z and a; none for lines that move no axis, such as `ping`.
    pub orders: [Option<Order>; 4],
    /// Whether it switches the drivers on: `a`, `d`, `v`, and `enable 1` do.
    pub enables: bool,
    /// `deadman`: the longest silence from now on, ms; 0: no limit.
    pub deadman_ms: Option<u16>,
    /// `strict`: whether strict mode is to be on.
    pub strict: Option<bool>,
    /// Whether the line ends with its checksum.
    pub is_checked: bool,
}

impl Command {
    /// The command that a deadman executes when it triggers.
    pub(super) const HALT: Command =
        Command { orders: [Some(Order::Halt); 4], enables: false, deadman_ms: None, strict: None, is_checked: false };
}

/// An error in a line, with its place.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct WrongLine {
    /// The bytes of the line that it is about.
    pub at: Range<usize>,
    /// The error, with the limit.
    pub message: String,
}

/// All commands.
const COMMANDS: &str = "a, d, v, r, s, g, l, enable, srate, deadman, strict, version, ping";

/// Longest line, bytes, and most tokens in it.
const LONGEST: usize = 80;
const MAX_WORDS: usize = 10;

/// What is answered to lines of `docs/verbs.md`, which drive motors directly: a script is of paths, and those lines have none.
const VERB: &str = "scripts are of paths, and this tells motors directly: nothing would judge it. Without SCRIPT, `pulsetrain winch` \
                    takes such lines from the standard input";

impl Command {
    /// Reads a line as strictly as a board in its strict mode: what such a board would refuse is an error here.
    ///
    /// ```
    /// use pulsetrain_trace::winch::{Command, Order};
    /// let command = Command::parse("a ax 5 7").unwrap();
    /// assert_eq!(command.orders[0], Some(Order::Target(7.0)));
    /// assert!(Command::parse("a x 1*28").unwrap().is_checked);
    /// let wrong = Command::parse("g x 25 1").unwrap_err();
    /// assert_eq!((wrong.at, wrong.message.as_str()), (4..6, "a natural frequency is 0.01 to 20 Hz"));
    /// ```
    ///
    /// # Errors
    /// [`WrongLine`] with the place and the limit.
    pub fn parse(line: &str) -> Result<Command, WrongLine> {
        let wrong = |at: Range<usize>, message: &str| WrongLine { at, message: message.to_owned() };
        let whole = 0..line.len();
        if let Some((at, _)) = line.char_indices().find(|(_, letter)| !matches!(letter, ' '..='~' | '\t')) {
            return Err(wrong(at..line.len(), "a line is printable ASCII"));
        }
        if line.len() > LONGEST {
            return Err(wrong(LONGEST..line.len(), "a line has at most 80 bytes"));
        }
        let (line, is_checked) = checked(line)?;
        let tokens = tokens(line);
        let Some(((name, name_at), values)) = tokens.split_first() else {
            return Err(wrong(whole, "a command is missing"));
        };
        if tokens.len() > MAX_WORDS {
            return Err(wrong(tokens[MAX_WORDS].1.start..line.len(), "a line has at most 10 words"));
        }
        let mut command = Command { is_checked, ..Command::default() };
        if let "a" | "d" | "v" | "r" | "s" | "g" | "l" = *name {
            let Some(((flags, flags_at), values)) = values.split_first() else {
                return Err(wrong(whole, "the axes are missing, such as x or xyza"));
            };
            let axes = axes(flags).ok_or_else(|| wrong(flags_at.clone(), "axes are letters of xyza, each once"))?;
            if let "g" | "l" = *name {
                let order = pair(name, exactly(2, values, line)?)?;
                axes.into_iter().for_each(|axis| command.orders[axis] = Some(order));
            } else {
                for (axis, value) in axes.iter().zip(exactly(axes.len(), values, line)?) {
                    command.orders[*axis] = Some(single(name, value)?);
                }
                command.enables = matches!(*name, "a" | "d" | "v");
            }
            return Ok(command);
        }
        let range = match *name {
            "version" | "ping" => None,
            "enable" | "strict" => Some(0..=1),
            "srate" => Some(1..=65_535),
            "deadman" => Some(0..=65_535),
            "move" | "run" | "speed" | "dir" | "halt" => return Err(wrong(name_at.clone(), VERB)),
            _ => {
                let message = format!("unknown command; known: {COMMANDS}");
                return Err(WrongLine { at: name_at.clone(), message });
            }
        };
        let values = exactly(usize::from(range.is_some()), values, line)?;
        if let (Some(range), [value]) = (range, values) {
            let number = whole_number(value, range)?;
            match (*name, number) {
                ("enable", 0) => command.orders = [Some(Order::Stop); 4],
                ("enable", _) => command.enables = true,
                ("deadman", ms) => command.deadman_ms = u16::try_from(ms).ok(),
                ("strict", on) => command.strict = Some(on == 1),
                _ => {}
            }
        }
        Ok(command)
    }
}

/// The line without its checksum, and whether it has one.
fn checked(line: &str) -> Result<(&str, bool), WrongLine> {
    let Some((rest, given)) = line.split_once('*') else { return Ok((line, false)) };
    let sum = rest.bytes().fold(0, |sum, byte| sum ^ byte);
    let given = given.trim_end();
    let digits = given.len() == 2 && given.bytes().all(|digit| digit.is_ascii_hexdigit());
    if digits && u8::from_str_radix(given, 16) == Ok(sum) {
        return Ok((rest, true));
    }
    let message = format!("not the checksum of the line, which is *{sum:02x}");
    Err(WrongLine { at: rest.len()..line.trim_end().len(), message })
}

type Token<'a> = (&'a str, Range<usize>);

fn tokens(line: &str) -> Vec<Token<'_>> {
    let mut next = 0;
    let tokens = line.split([' ', '\t']).map(|word| {
        let start = next;
        // Each separator is one byte.
        next += word.len() + 1;
        (word, start..start + word.len())
    });
    tokens.filter(|(word, _)| !word.is_empty()).collect()
}

/// Axes by their places in [`AXES`].
fn axes(flags: &str) -> Option<Vec<usize>> {
    let places: Option<Vec<usize>> = flags.chars().map(|flag| AXES.iter().position(|axis| *axis == flag)).collect();
    places.filter(|places| places.iter().enumerate().all(|(n, place)| !places[..n].contains(place)))
}

fn exactly<'a>(count: usize, values: &'a [Token<'a>], line: &str) -> Result<&'a [Token<'a>], WrongLine> {
    if values.len() == count {
        return Ok(values);
    }
    let at = values.get(count).map_or(0, |extra| extra.1.start);
    let plural = if count == 1 { "" } else { "s" };
    let message = format!("{count} value{plural} wanted, but {} found", values.len());
    Err(WrongLine { at: at..line.len(), message })
}

fn single(name: &str, value: &Token<'_>) -> Result<Order, WrongLine> {
    let steps = i64::from(i32::MIN)..=i64::from(i32::MAX);
    Ok(match name {
        "a" => Order::Target(whole_number(value, steps)? as f64),
        "d" => Order::Move(whole_number(value, steps)? as f64),
        "r" => Order::Impulse(whole_number(value, steps)? as f64),
        "v" => Order::Drift(whole_number(value, -15_000..=15_000)? as f64),
        _ => Order::Ramp(whole_number(value, *steps.start()..=65_535)?.max(0) as f64),
    })
}

fn pair(name: &str, values: &[Token<'_>]) -> Result<Order, WrongLine> {
    let [first, second] = values else {
        return Err(WrongLine { at: 0..0, message: "2 values wanted".to_owned() });
    };
    // Boards read this many decimal places.
    let rounded = |value: f64, unit: f64| (value * unit).round() / unit;
    if name == "g" {
        let frequency_hz = rounded(decimal(first, 0.01..=20.0, "a natural frequency is 0.01 to 20 Hz")?, 1e6);
        let ratio = rounded(decimal(second, 0.07..=5.0, "a damping ratio is 0.07 to 5")?, 1e6);
        return Ok(Order::Gains { frequency_hz, ratio });
    }
    let speed = decimal(first, 0.0..=10e3, "a highest speed is 0 to 10 000 steps/s")?;
    let acceleration = decimal(second, 1.0..=250e3, "a highest acceleration is 1 to 250 000 steps/s²")?;
    Ok(Order::Limits { speed: rounded(speed, 1e3), acceleration: rounded(acceleration, 1e3) })
}

fn whole_number((text, at): &Token<'_>, range: RangeInclusive<i64>) -> Result<i64, WrongLine> {
    let number = text.parse::<i64>().ok().filter(|number| range.contains(number));
    number.ok_or_else(|| WrongLine {
        at: at.clone(),
        message: format!("a whole number from {} to {} is wanted", range.start(), range.end()),
    })
}

fn decimal((text, at): &Token<'_>, range: RangeInclusive<f64>, message: &str) -> Result<f64, WrongLine> {
    // Rust's f64 also reads "inf" and "nan", which no board does.
    let is_number = text.starts_with(|first: char| first.is_ascii_digit() || "+-.".contains(first));
    let number = text.parse::<f64>().ok().filter(|number| is_number && range.contains(number));
    number.ok_or_else(|| WrongLine { at: at.clone(), message: message.to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(line: &str, axis: usize, order: Option<Order>) {
        assert_eq!(Command::parse(line).unwrap().orders[axis], order, "{line}");
    }

    #[test]
    fn commands_reach_their_axes() {
        check("a ax 5 7", 3, Some(Order::Target(5.0)));
        check("  d\txy -50 +4 ", 1, Some(Order::Move(4.0)));
        check("v z -15000", 2, Some(Order::Drift(-15e3)));
        check("v z -15000", 0, None);
        check("r x 3", 0, Some(Order::Impulse(3.0)));
        check("s x -1", 0, Some(Order::Ramp(0.0)));
        check("g xy 2.5000001 0.7", 1, Some(Order::Gains { frequency_hz: 2.5, ratio: 0.7 }));
        check("l a 4e3 400", 3, Some(Order::Limits { speed: 4e3, acceleration: 400.0 }));
        check("a x 1*28", 0, Some(Order::Target(1.0)));
        check("a x 1 *08 ", 0, Some(Order::Target(1.0)));
        check("enable 0", 2, Some(Order::Stop));
        for silent in ["enable 1", "srate 20", "deadman 0", "strict 1", "version", "ping"] {
            check(silent, 0, None);
        }
        for (line, enables) in
            [("a x 1", true), ("v x 0", true), ("enable 1", true), ("enable 0", false), ("r x 1", false)]
        {
            assert_eq!(Command::parse(line).unwrap().enables, enables, "{line}");
        }
    }

    #[track_caller]
    fn refuse(line: &str, place: &str, message: &str) {
        let error = Command::parse(line).unwrap_err();
        assert_eq!((&line[error.at], error.message.as_str()), (place, message));
    }

    #[test]
    fn refusals_point_at_the_word() {
        refuse("a x ten", "ten", "a whole number from -2147483648 to 2147483647 is wanted");
        refuse("a x 99999999999", "99999999999", "a whole number from -2147483648 to 2147483647 is wanted");
        refuse("v x 15001", "15001", "a whole number from -15000 to 15000 is wanted");
        refuse("srate 0", "0", "a whole number from 1 to 65535 is wanted");
        refuse(
            "jump x 1",
            "jump",
            "unknown command; known: a, d, v, r, s, g, l, enable, srate, deadman, strict, version, ping",
        );
        for name in ["move", "run", "speed", "dir", "halt"] {
            refuse(&format!("{name} x 1"), name, VERB);
        }
        refuse("a xw 1 2", "xw", "axes are letters of xyza, each once");
        refuse("a xx 1 2", "xx", "axes are letters of xyza, each once");
        refuse("a xy 1", "a xy 1", "2 values wanted, but 1 found");
        refuse("a x 1 2", "2", "1 value wanted, but 2 found");
        refuse("ping 1", "1", "0 values wanted, but 1 found");
        refuse("g x nan 1", "nan", "a natural frequency is 0.01 to 20 Hz");
        refuse("g x 1 inf", "inf", "a damping ratio is 0.07 to 5");
        refuse("l x 1 0.5", "0.5", "a highest acceleration is 1 to 250 000 steps/s²");
        refuse("l x 10001 5", "10001", "a highest speed is 0 to 10 000 steps/s");
        refuse("enable 2", "2", "a whole number from 0 to 1 is wanted");
        refuse("a x 1*29 ", "*29", "not the checksum of the line, which is *28");
        refuse("a x 1*+8", "*+8", "not the checksum of the line, which is *28");
        refuse("ping*", "*", "not the checksum of the line, which is *10");
        refuse("", "", "a command is missing");
        refuse("a x", "a x", "1 value wanted, but 0 found");
        refuse("a", "a", "the axes are missing, such as x or xyza");
        refuse("a xy 1 2 3 4 5 6 7 8 9", "9", "a line has at most 10 words");
        refuse("ping é", "é", "a line is printable ASCII");
    }
}
