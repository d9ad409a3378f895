//! A console for a board that reads text: a person types lines and sees replies and positions.

use std::collections::VecDeque;
use std::io;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::Duration;

use miette::Diagnostic;
use pulsetrain_board::{Port, PortError};
use pulsetrain_trace::winch::Status;

use super::mirror::Mirror;
use super::talk::{BYTE, BoardLine, STOP, Talk};
use crate::interrupt;

/// Input of the person at the console.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ConsoleInput {
    /// A line for the board, or `help` or `quit` for the console.
    Line(String),
    /// A wish to stop all axes.
    Stop,
    /// A wish to end the console.
    End,
}

/// The person at the console: a terminal, or standard input and output.
pub trait Person {
    /// The input since the last call.
    ///
    /// # Errors
    /// If no more input can be read.
    fn inputs(&mut self) -> io::Result<Vec<ConsoleInput>>;

    /// Shows what the board has sent.
    ///
    /// # Errors
    /// If it cannot be shown.
    fn show(&mut self, said: &BoardLine) -> io::Result<()>;

    /// Shows a text of the console itself.
    ///
    /// # Errors
    /// If it cannot be shown.
    fn tell(&mut self, text: &str) -> io::Result<()>;

    /// Whether the console, once its input has ended, waits until the axes rest.
    fn waits_for_rest(&self) -> bool;

    /// Whether it shows positions as they change.
    fn shows_positions(&self) -> bool {
        false
    }
}

/// Why a console failed.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum ConsoleError {
    /// The board's port is gone.
    #[error(transparent)]
    Port(#[from] PortError),
    /// Input or output failed.
    #[error("the console cannot go on: {0}")]
    Person(io::Error),
}

// The message contains its source, so `source` gives none: else the text would be printed twice.
impl From<io::Error> for ConsoleError {
    fn from(error: io::Error) -> ConsoleError {
        ConsoleError::Person(error)
    }
}

/// The help of the console.
pub const HELP: &str = "\
\x20 a <axes> <steps>…           go to: `a xy 100 -50`     d <axes> <steps>…    go on by
  v <axes> <steps/s>…         drift on and on, ±15 000  r <axes> <steps>…    impulse
  s <axes> <steps/s>…         ramp of targets, up to 65 535; 0: none
  g <axes> <Hz> <ratio>       how it follows: 0.01 to 20 Hz, damping ratio 0.07 to 5 (1: no overshoot)
  l <axes> <steps/s> <steps/s²>   limits, 0 to 10 000 and 1 to 250 000
  enable 0                    stop all axes, then drivers off     enable 1    drivers on
  srate <ms>    status lines, 1 to 65 535     deadman <ms>    stop after so long a silence, up to 65 535; 0: never
  strict 0|1    refuse irregular lines      version, ping
  on a Pico:  move <axes> <n>…  run <axes>  speed <axes> <ticks>…  dir <axes> <1, -1, 0>…  halt    verbs: docs/verbs.md
  help, quit    of this console; quit leaves the board as it is
";

/// How often the board and the person are read.
const ROUND: Duration = Duration::from_millis(40);

/// Axes rest if they have not moved for this time, µs by the board's clock, and no line makes them go on.
const REST_US: u64 = 500_000;

/// Steps by which the mirror may lead the board's axes. A larger lead shows that the board does not follow the lines as
/// the mirror does. The lateness of lines makes less of a lead, since the axis makes no step in [`REST_US`].
const LEAD_STEPS: u64 = 3;

/// The longest wait for rest. With the default gains a move rings for ten seconds and more.
const LONGEST_WAIT: Duration = Duration::from_secs(30);

/// How a console ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ended {
    /// Number of lines that the board refused.
    pub refused: usize,
    /// Whether the axes rest, or nobody was to wait for that.
    pub is_settled: bool,
}

/// Bytes of lines that are sent at once: the board answers each line if there are no more than these (docs/winch.md).
/// The next lines follow once the board has been silent for a while.
const BURST: usize = 64;
const SILENCE: Duration = Duration::from_millis(20);
/// Lines that wait for the board.
const MAX_WAITING: usize = 64;

/// Connects a person with a board until the person ends it.
///
/// # Errors
/// If the board's port or the person's input or output fails.
pub fn converse<P: Port>(talk: &mut Talk<P>, person: &mut impl Person) -> Result<Ended, ConsoleError> {
    let mut rest = Rest::default();
    let mut mirror = Mirror::new(talk.now());
    let mut waiting = VecDeque::new();
    // The time from which the next lines may be sent.
    let mut free = talk.now();
    let (mut refused, mut is_ending, mut ended) = (0, false, None);
    loop {
        // More lines of a program than that wait where they come from. A person's keys are read at once.
        let has_room = waiting.len() < MAX_WAITING || person.shows_positions() || interrupt::wanted();
        let inputs = if has_room { person.inputs()? } else { Vec::new() };
        for input in inputs {
            match input {
                ConsoleInput::Stop => {
                    waiting.clear();
                    waiting.push_back(talk.as_wanted(STOP));
                    free = talk.now();
                }
                ConsoleInput::End => is_ending = true,
                ConsoleInput::Line(_) if is_ending => {}
                ConsoleInput::Line(line) => match line.trim() {
                    "" => {}
                    "help" | "?" => person.tell(HELP)?,
                    "quit" | "exit" => is_ending = true,
                    line => waiting.push_back(line.to_owned()),
                },
            }
        }
        let now = talk.now();
        mirror.go_on(now);
        let mut sent = 0;
        while free <= now
            && let Some(line) = waiting.pop_front_if(|line| sent == 0 || sent + line.len() < BURST)
        {
            rest = Rest::default();
            talk.tell(&line)?;
            mirror.tell(&line, now);
            sent += line.len() + 1;
        }
        if sent > 0 {
            free = now + BYTE * sent as u32 + SILENCE;
        }
        if is_ending && waiting.is_empty() {
            let waited = now.saturating_sub(*ended.get_or_insert(now));
            if !person.waits_for_rest() || rest.is_complete(&mirror) {
                return Ok(Ended { refused, is_settled: true });
            }
            if waited > LONGEST_WAIT {
                let what = match rest.since {
                    Some(_) => "the axes still move",
                    None => "no status tells whether the axes rest",
                };
                person.tell(&format!("{what}; the board goes on with its last orders\n"))?;
                return Ok(Ended { refused, is_settled: false });
            }
        }
        let until = if waiting.is_empty() { now + ROUND } else { free.min(now + ROUND) };
        let mut shown = Ok(());
        talk.wait(until, |at, said| {
            if let BoardLine::Status(status) = &said {
                rest.see(*status, mirror.made());
            }
            refused += usize::from(said.is_refusal());
            if said.is_answer() {
                free = free.max(at + SILENCE);
            }
            if shown.is_ok() {
                shown = person.show(&said);
            }
        })?;
        shown?;
    }
}

/// Watches for the axes to rest.
#[derive(Clone, Copy, Debug, Default)]
struct Rest {
    since: Option<Status>,
    /// The mirror's positions at that time.
    mirrored: [i64; 4],
    is_reached: bool,
}

impl Rest {
    fn see(&mut self, status: Status, mirrored: [i64; 4]) {
        match self.since {
            Some(since) if since.positions == status.positions => {
                self.is_reached = status.usec - since.usec >= REST_US;
            }
            _ => *self = Rest { since: Some(status), mirrored, is_reached: false },
        }
    }

    /// Whether the board's axes rest, and are not only slow. They do if the mirror's axes rest, too. They also do if
    /// the mirror's axes have gone on alone: then the board does not follow the lines, because it has refused one or
    /// because its stored deadman has stopped it.
    fn is_complete(&self, mirror: &Mirror) -> bool {
        let leads = mirror.made().iter().zip(self.mirrored).any(|(now, then)| now.abs_diff(then) > LEAD_STEPS);
        self.is_reached && (leads || mirror.is_at_rest())
    }
}

/// A person without a terminal, for files and programs: lines come in, and all that the board sends is printed.
pub struct Plain<'a> {
    lines: Receiver<String>,
    out: &'a mut dyn io::Write,
    has_stopped: bool,
}

impl<'a> Plain<'a> {
    /// `lines` is closed when its sender has no more.
    pub fn new(lines: Receiver<String>, out: &'a mut dyn io::Write) -> Plain<'a> {
        Plain { lines, out, has_stopped: false }
    }
}

impl Person for Plain<'_> {
    fn inputs(&mut self) -> io::Result<Vec<ConsoleInput>> {
        if interrupt::wanted() {
            let is_first = !std::mem::replace(&mut self.has_stopped, true);
            return Ok(if is_first { vec![ConsoleInput::Stop, ConsoleInput::End] } else { vec![ConsoleInput::End] });
        }
        /// A program that writes without an end leaves time for the board.
        const MAX_LINES: usize = 64;
        let mut inputs = Vec::new();
        loop {
            if inputs.len() == MAX_LINES {
                return Ok(inputs);
            }
            match self.lines.try_recv() {
                Ok(line) => inputs.push(ConsoleInput::Line(line)),
                Err(TryRecvError::Empty) => return Ok(inputs),
                Err(TryRecvError::Disconnected) => {
                    inputs.push(ConsoleInput::End);
                    return Ok(inputs);
                }
            }
        }
    }

    fn show(&mut self, said: &BoardLine) -> io::Result<()> {
        match said {
            BoardLine::Status(Status { usec, positions: [x, y, z, a] }) => {
                writeln!(self.out, "txyza {usec} {x} {y} {z} {a}")
            }
            BoardLine::Line(line) => writeln!(self.out, "{line}"),
        }
    }

    fn tell(&mut self, text: &str) -> io::Result<()> {
        write!(self.out, "{text}")
    }

    fn waits_for_rest(&self) -> bool {
        true
    }
}
