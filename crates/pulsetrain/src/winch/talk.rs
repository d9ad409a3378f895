//! Sends lines to a board and receives its lines.

use std::time::Duration;

use pulsetrain_board::{Edge, Port, PortError};
use pulsetrain_trace::winch::{Command, Status};

/// A line from the board.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum BoardLine {
    /// A status: the axes' positions.
    Status(Status),
    /// Any other line, without its end.
    Line(String),
}

impl BoardLine {
    /// Whether the line refuses a command.
    #[must_use]
    pub fn is_refusal(&self) -> bool {
        matches!(self, BoardLine::Line(line) if ["err ", "dbg invalid ", "dbg excessive "].iter().any(|word| line.starts_with(word)))
    }

    /// Whether the line answers a command or refuses it. (A Pico's `done` comes unasked.)
    #[must_use]
    pub fn is_answer(&self) -> bool {
        self.is_refusal() || matches!(self, BoardLine::Line(line) if line == "awake" || line.starts_with("id "))
    }
}

/// Adds a line's checksum (docs/winch.md).
///
/// ```
/// assert_eq!(pulsetrain::winch::talk::with_checksum("a x 1"), "a x 1*28");
/// ```
#[must_use]
pub fn with_checksum(line: &str) -> String {
    let sum = line.bytes().fold(0, |sum, byte| sum ^ byte);
    format!("{line}*{sum:02x}")
}

/// The meaning of a refusal for people: of `err <what> <word>` and of `dbg …` (docs/winch.md).
///
/// ```
/// use pulsetrain::winch::talk::meaning;
/// assert_eq!(meaning("err missing 3").unwrap(), "word 3: a value is missing");
/// assert_eq!(meaning("err period 500").unwrap(), "a period is 500 ticks at least, and 2^62 at most (2^30 on an Uno)");
/// assert_eq!(meaning("dbg invalid srate value").unwrap(), "an interval of statuses is 1 to 65535 ms");
/// assert_eq!(meaning("awake"), None);
/// ```
#[must_use]
pub fn meaning(line: &str) -> Option<String> {
    match line {
        "dbg invalid srate value" => return Some("an interval of statuses is 1 to 65535 ms".to_owned()),
        "dbg excessive input error" => return Some("a line has at most 10 words".to_owned()),
        _ => {}
    }
    let mut words = line.strip_prefix("err ")?.split(' ');
    let means = match words.next()? {
        "command" => "no such command; `help` lists them",
        "number" => "not a number",
        "range" => "beyond what it may be",
        "missing" => "a value is missing",
        "flags" => "axes are letters of xyza, each once",
        "extra" => "the command takes no more words",
        "long" => "the line has more than 80 bytes",
        "noise" => return Some("something came that was not sent; say it again".to_owned()),
        "checksum" => "the checksum is wrong, or missing where each line needs one (`strict 0*1b` ends that)",
        "period" => {
            let shortest = words.next().unwrap_or_default();
            return Some(format!("a period is {shortest} ticks at least, and 2^62 at most (2^30 on an Uno)"));
        }
        "busy" => return Some("a move waits already: wait until one is done, or halt it".to_owned()),
        "moving" => return Some("the motors still move".to_owned()),
        "path" => return Some("the axes follow paths: `enable 0` ends that".to_owned()),
        "verbs" => return Some("the axes obey verbs: `enable 0` ends that".to_owned()),
        "taken" => return Some("a program that sends frames has the board".to_owned()),
        _ => return None,
    };
    let place = words.next().filter(|word| *word != "0").map(|word| format!("word {word}: "));
    Some(format!("{}{means}", place.unwrap_or_default()))
}

/// The meaning of a refusal of the line `told`, with the limit that the line broke.
///
/// ```
/// use pulsetrain::winch::talk::explain;
/// assert_eq!(explain("err range 4", "l x 100 0.5").unwrap(), "word 4: a highest acceleration is 1 to 250 000 steps/s²");
/// assert_eq!(explain("err range 4", "a x 1").unwrap(), "word 4: beyond what it may be");
/// ```
#[must_use]
pub fn explain(line: &str, told: &str) -> Option<String> {
    /// The meaning of an error in the line itself, which does not depend on the board's state.
    const OF_THE_LINE: [&str; 6] = ["number", "range", "missing", "flags", "extra", "long"];
    let means = meaning(line)?;
    let mut words = line.split(' ').skip(1);
    let is_of_the_line = words.next().is_some_and(|what| OF_THE_LINE.contains(&what));
    Some(match (is_of_the_line, words.next(), Command::parse(told)) {
        // Axes that verbs move have other commands.
        (true, Some(word), Err(wrong)) if !wrong.message.starts_with("unknown command") => {
            format!("word {word}: {wrong}")
        }
        _ => means,
    })
}

/// A port to a board that reads text.
#[derive(Debug)]
pub struct Talk<P> {
    port: P,
    bytes: Vec<u8>,
    /// The received part of a line.
    partial: Vec<u8>,
    clock: Clock,
    edges: Vec<Edge>,
    /// Whether a line with a right checksum was sent since strictness was last set, or the board has refused a line
    /// without one. A strict board wants a checksum on each line.
    is_checked: bool,
}

/// Stops all axes. [`Talk::as_wanted`] adds a checksum for a board that wants one.
pub(crate) const STOP: &str = "enable 0";

/// Time of a byte on the line at 115 200 baud.
pub(super) const BYTE: Duration = Duration::from_nanos(86_806);

/// The longest line that is kept. A longer one is noise.
const LONGEST: usize = 1000;

/// How often a board is asked for its name, and how long it is waited for.
const ASK_AGAIN: Duration = Duration::from_millis(250);
const ASK_FOR: Duration = Duration::from_secs(4);

impl<P: Port> Talk<P> {
    /// Takes an open port.
    pub fn new(port: P) -> Talk<P> {
        Talk {
            port,
            bytes: Vec::new(),
            partial: Vec::new(),
            clock: Clock::default(),
            edges: Vec::new(),
            is_checked: false,
        }
    }

    /// The port's time.
    pub fn now(&self) -> Duration {
        self.port.now()
    }

    /// The port.
    pub fn port(&self) -> &P {
        &self.port
    }

    /// Sends a line.
    ///
    /// # Errors
    /// If the port is gone.
    pub fn tell(&mut self, line: &str) -> Result<(), PortError> {
        let is_right =
            line.split_once('*').is_some_and(|(rest, _)| with_checksum(rest).eq_ignore_ascii_case(line.trim_end()));
        let is_strictness = line.split(['*', ' ', '\t']).find(|word| !word.is_empty()) == Some("strict");
        self.is_checked = is_right || (self.is_checked && !is_strictness);
        self.port.send(format!("{line}\n").as_bytes())
    }

    /// A line of this program's own in the form that the board accepts: with a checksum if lines before had one. A
    /// checksum that the user has not begun with would make the board strict, and it would refuse the lines that the
    /// user types.
    #[must_use]
    pub fn as_wanted(&self, line: &str) -> String {
        if self.is_checked { with_checksum(line) } else { line.to_owned() }
    }

    /// Lets time pass until `until`. Calls the function with each line from the board and its time.
    ///
    /// # Errors
    /// If the port is gone.
    pub fn wait(&mut self, until: Duration, mut hear: impl FnMut(Duration, BoardLine)) -> Result<(), PortError> {
        while self.port.now() < until {
            self.bytes.clear();
            self.port.receive(until, &mut self.bytes)?;
            for byte in std::mem::take(&mut self.bytes) {
                if byte != b'\n' {
                    self.partial.push(byte);
                    self.partial.truncate(LONGEST);
                    continue;
                }
                let line = String::from_utf8_lossy(&self.partial).trim().to_owned();
                self.partial.clear();
                if !line.is_empty() {
                    let said = self.clock.read(&line).map_or(BoardLine::Line(line), BoardLine::Status);
                    hear(self.port.now(), said);
                }
            }
        }
        self.port.edges(&mut self.edges);
        Ok(())
    }

    /// Asks the board for its name until it answers. `None` if it does not answer in text. A board that has just been
    /// reset is deaf for a second or two.
    ///
    /// # Errors
    /// If the port is gone.
    pub fn ask(&mut self) -> Result<Option<String>, PortError> {
        let end = self.now() + ASK_FOR;
        let mut name = None;
        while name.is_none() && self.now() < end {
            let question = self.as_wanted("version");
            self.tell(&question)?;
            let mut wants_checksum = false;
            self.wait(self.now() + ASK_AGAIN, |_, said| {
                let BoardLine::Line(line) = said else { return };
                wants_checksum |= line.starts_with("err checksum");
                if let Some(id) = line.strip_prefix("id ") {
                    name = Some(id.to_owned());
                }
            })?;
            self.is_checked |= wants_checksum;
        }
        Ok(name)
    }

    /// The next status. `None` if none comes within `time`.
    ///
    /// # Errors
    /// If the port is gone.
    pub fn status(&mut self, time: Duration) -> Result<Option<Status>, PortError> {
        let end = self.now() + time;
        let mut first = None;
        while first.is_none() && self.now() < end {
            self.wait(end.min(self.now() + ASK_AGAIN), |_, said| {
                if let (None, BoardLine::Status(status)) = (first, said) {
                    first = Some(status);
                }
            })?;
        }
        Ok(first)
    }

    /// The edges of the board's pins since the last call. Only a virtual board knows them.
    pub fn edges(&mut self) -> Vec<Edge> {
        std::mem::take(&mut self.edges)
    }
}

/// Extends the board's clock, whose signed 32 bits wrap.
#[derive(Clone, Copy, Debug, Default)]
struct Clock {
    last: Option<u64>,
}

impl Clock {
    /// Reads a status line. Statuses must be less than 71 minutes apart.
    fn read(&mut self, line: &str) -> Option<Status> {
        let mut words = line.strip_prefix("txyza ")?.split(' ').map(str::parse::<i32>);
        let mut number = || words.next()?.ok();
        let raw = number()?.cast_unsigned();
        let positions = [number()?, number()?, number()?, number()?];
        if words.next().is_some() {
            return None;
        }
        let usec = match self.last {
            Some(last) => last + u64::from(raw.wrapping_sub(last as u32)),
            None => raw.into(),
        };
        self.last = Some(usec);
        Some(Status { usec, positions })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_goes_on_when_the_line_s_wraps() {
        let mut clock = Clock::default();
        let mut read = |line: &str| clock.read(line).map(|status| status.usec);
        assert_eq!(read("txyza 2147483000 1 -2 3 4"), Some(2_147_483_000));
        assert_eq!(read("txyza -2147483296 1 -2 3 4"), Some(2_147_484_000));
        assert_eq!(read("txyza -1 1 -2 3 4"), Some(4_294_967_295));
        assert_eq!(read("txyza 99 1 -2 3 4"), Some(4_294_967_395));
        for line in ["txyza 1 2 3 4", "txyza 1 2 3 4 5 6", "txyza 1 2 3 4 x", "awake"] {
            assert_eq!(read(line), None, "{line}");
        }
    }
}
